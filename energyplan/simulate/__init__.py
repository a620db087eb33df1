"""Drive logs of a robot that obeys a given power model, for examples and tests.

The robot moves exactly as its tread ICRs say and draws exactly what the model says; sensors add
noise, offsets, delays. A hidden effect is simply a further term of the model handed in.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from energyplan.errors import InvalidInputError, UnknownNameError
from energyplan.logs import DriveLog
from energyplan.motion import Motion, travelled
from energyplan.path import FloatArray, Pose, Trajectory
from energyplan.power import PowerModel
from energyplan.records import checked
from energyplan.vehicle import GRAVITY, Vehicle

__all__ = ["PATTERNS", "Setpoint", "drive", "identification_drive", "validation_drive"]


@dataclass(frozen=True)
class Setpoint:
    """Tread speeds to reach by a linear ramp, then to hold.

    Parameters
    ----------
    v_left, v_right : float
        Tread speeds [m/s].
    hold : float
        How long to hold them [s].
    ramp : float
        How long the ramp takes [s]; longer where the acceleration limit asks for it.

    Examples
    --------
    >>> from energyplan import simulate
    >>> from energyplan.power import PowerModel
    >>> model = PowerModel.preset("quadriga:full:marble")
    >>> log = simulate.drive(model, [Setpoint(0.4, 0.4, hold=5.0), Setpoint(-0.2, 0.2, hold=5.0)])
    >>> round(float(log.channel("v_left").max()), 2)
    0.4
    """

    v_left: float
    v_right: float
    hold: float = 0.0
    ramp: float = 0.0

    def __post_init__(self) -> None:
        values = np.array([self.v_left, self.v_right, self.hold, self.ramp])
        if not np.all(np.isfinite(values)) or self.hold < 0 or self.ramp < 0:
            raise InvalidInputError(f"{self} needs finite speeds, and hold and ramp >= 0 s")


@dataclass(frozen=True)
class Schedule:
    """Tread speeds over time, linear between corners."""

    t: FloatArray  # (n,): times of the corners [s]
    v_left: FloatArray  # (n,): left tread speed at the corners [m/s]
    v_right: FloatArray  # (n,): right tread speed at the corners [m/s]

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.t[-1])


def _ramp(before: Setpoint, setpoint: Setpoint, accel_limit: float) -> float:
    """Time that the change of speeds takes [s]."""
    change = max(abs(setpoint.v_left - before.v_left), abs(setpoint.v_right - before.v_right))
    return max(setpoint.ramp, change / accel_limit) if change > 0 else 0.0


def schedule(setpoints: Sequence[Setpoint], accel_limit: float) -> Schedule:
    """Join setpoints from rest to rest."""
    here, corners = Setpoint(0.0, 0.0), [(0.0, 0.0, 0.0)]
    for setpoint in [*setpoints, Setpoint(0.0, 0.0)]:
        for step in (_ramp(here, setpoint, accel_limit), setpoint.hold):
            if step > 0:
                corners.append((corners[-1][0] + step, setpoint.v_left, setpoint.v_right))
        here = setpoint
    if len(corners) < 2:
        raise InvalidInputError("the setpoints take no time; give one that moves or holds")
    return Schedule(*np.array(corners).T)


def _fill(
    targets: Sequence[tuple[float, float]], duration: float, accel_limit: float
) -> list[Setpoint]:
    """Setpoints: to the target speeds and back to rest, held equally long to fill `duration`."""
    setpoints = [Setpoint(left, right) for left, right in targets]
    ends = [Setpoint(0.0, 0.0), *setpoints, Setpoint(0.0, 0.0)]
    ramps = sum(_ramp(a, b, accel_limit) for a, b in pairwise(ends))
    spare = duration - ramps
    if spare < 0:
        raise InvalidInputError(
            f"the manoeuvre's speed ramps alone take {ramps:.1f} s, longer than its {duration:g} s;"
            " give a longer duration, a lower speed or a higher accel_limit"
        )
    held = spare / len(setpoints)
    return [*(Setpoint(s.v_left, s.v_right, held) for s in setpoints), Setpoint(0.0, 0.0)]


@dataclass(frozen=True)
class Brief:
    """Inputs of a pattern: robot, time, speed, acceleration limit and random generator."""

    vehicle: Vehicle
    duration: float
    speed: float
    accel_limit: float
    rng: np.random.Generator


def rest(brief: Brief) -> list[Setpoint]:
    """Stand still."""
    return [Setpoint(0.0, 0.0, brief.duration)]


def spin(brief: Brief) -> list[Setpoint]:
    """Turn on the spot, left and right, at half and at full tread speed."""
    speeds = brief.speed * np.array([-0.5, 0.5, -1.0, 1.0])
    return _fill([(float(s), float(-s)) for s in speeds], brief.duration, brief.accel_limit)


def straight(brief: Brief) -> list[Setpoint]:
    """Drive straight, forwards and backwards, at half and at full speed."""
    speeds = brief.speed * np.array([0.5, -0.5, 1.0, -1.0])
    return _fill([(float(s), float(s)) for s in speeds], brief.duration, brief.accel_limit)


def spiral(brief: Brief) -> list[Setpoint]:
    """From straight through ever tighter arcs to a spin and back, right, then left."""
    s, limit = brief.speed, brief.accel_limit
    sweep = (brief.duration - 2 * s / limit) / 4
    if sweep < 2 * s / limit:
        raise InvalidInputError(
            f"a spiral at {s:g} m/s needs {10 * s / limit:.1f} s or more, not {brief.duration:g} s"
        )
    inner = ((s, -s), (s, s), (-s, s), (s, s))
    return [
        Setpoint(s, s),
        *(Setpoint(left, right, ramp=sweep) for left, right in inner),
        Setpoint(0.0, 0.0),
    ]


def figure8_time(vehicle: Vehicle, speed: float, accel_limit: float) -> float:
    """Return the least duration of a figure-8, whose circles are spins then [s]."""
    return 2 * (np.pi * vehicle.icr.slip_track / speed + speed / accel_limit)


def figure8(brief: Brief) -> list[Setpoint]:
    """Draw a circle to the left, then one to the right, each of a full turn."""
    s, limit, track = brief.speed, brief.accel_limit, brief.vehicle.icr.slip_track
    # Each circle's yaw rate integrates to a full turn, the ramps included: a quadratic in the
    # difference of the tread speeds.
    time = brief.duration / 2 - s / (2 * limit)
    root = time**2 - 2 * np.pi * track / limit
    difference = 2 * limit * (time - float(np.sqrt(root))) if min(time, root) > 0 else np.inf
    if difference > 2 * s:
        need = figure8_time(brief.vehicle, s, limit)
        raise InvalidInputError(
            f"a figure-8 at {s:g} m/s takes this robot {need:.1f} s or more, "
            f"not {brief.duration:g} s"
        )
    inner = s - difference
    targets = [(inner, s), (s, inner)]
    return _fill(targets, brief.duration, brief.accel_limit)


def _random_targets(brief: Brief, count: int) -> list[tuple[float, float]]:
    """Speeds of a robot at work: mostly forwards, turning at random, within the tread speed."""
    rng = brief.rng
    forward = rng.uniform(0.2, 1.0, count) * np.where(rng.random(count) < 0.15, -0.6, 1.0)
    turn = rng.uniform(-1.0, 1.0, count) ** 3
    pairs = np.stack([forward - turn, forward + turn], axis=1)
    pairs /= np.maximum(1.0, np.abs(pairs).max(axis=1, keepdims=True))
    return [(float(left), float(right)) for left, right in brief.speed * pairs]


def survey(brief: Brief) -> list[Setpoint]:
    """Random smooth manoeuvres, a new one every four seconds or so."""
    pause = 4.0 + brief.speed / brief.accel_limit
    count = max(1, int(brief.duration / pause))
    return _fill(_random_targets(brief, count), brief.duration, brief.accel_limit)


def stop_and_go(brief: Brief) -> list[Setpoint]:
    """Random manoeuvres with a stop after each."""
    pause = 3.0 + 2 * brief.speed / brief.accel_limit
    targets = _random_targets(brief, max(1, int(brief.duration / pause)))
    stops = [pair for target in targets for pair in (target, (0.0, 0.0))]
    return _fill(stops, brief.duration, brief.accel_limit)


@dataclass(frozen=True)
class Pattern:
    """A named manoeuvre and the time that it takes where none is given [s]."""

    setpoints: Callable[[Brief], list[Setpoint]]
    duration: float


PATTERNS = {
    "rest": Pattern(rest, 5.0),
    "spin": Pattern(spin, 30.0),
    "straight": Pattern(straight, 30.0),
    "spiral": Pattern(spiral, 60.0),
    "figure8": Pattern(figure8, 24.0),
    "survey": Pattern(survey, 60.0),
    "stop_and_go": Pattern(stop_and_go, 40.0),
}
"""Manoeuvres by name."""

Part = str | tuple[str, float] | Setpoint
"""A pattern's name, a name with its duration [s], or a setpoint of one's own."""

Slope = float | Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Inclination of the ground plane [rad], or a function of x, y, yaw that returns the slope."""

IDENTIFICATION: tuple[tuple[str, float], ...] = (
    ("rest", 3.0), ("spin", 25.0), ("rest", 3.0), ("straight", 20.0), ("spiral", 40.0),
    ("figure8", 20.0), ("survey", 36.0), ("rest", 3.0),
)  # fmt: skip
VALIDATION: tuple[tuple[str, float], ...] = (
    ("rest", 2.0), ("survey", 40.0), ("stop_and_go", 18.0), ("figure8", 20.0), ("spiral", 25.0),
    ("survey", 13.0), ("rest", 2.0),
)  # fmt: skip

_SPEED = 0.75  # [m/s]
_ACCELERATION = 0.3  # [m/s^2]
_STEP = 0.05  # longest step of the pose integration [s]


@checked()
def drive(
    model: PowerModel,
    pattern: str | Sequence[Part] | Trajectory,
    *,
    duration: float | None = None,
    speed: float = _SPEED,
    accel_limit: float = _ACCELERATION,
    rate: float = 20.0,
    power_noise: float = 0.0,
    speed_noise: float = 0.0,
    correlation_time: float = 0.0,
    noise: Mapping[str, float] | None = None,
    slope: Slope = 0.0,
    uphill: float = 0.0,
    channels: Mapping[str, float | Callable[[FloatArray], FloatArray]] | None = None,
    changes: Sequence[tuple[float, PowerModel]] = (),
    delays: Mapping[str, float] | None = None,
    gains: Mapping[str, float] | None = None,
    biases: Mapping[str, float] | None = None,
    without: Collection[str] = (),
    measured: Literal["sides", "total", "battery"] = "sides",
    voltage: float = 24.0,
    seed: int = 0,
    name: str | None = None,
) -> DriveLog:
    """Simulate a drive.

    The log has ``t``, ``v_left``, ``v_right``, ``p_left``, ``p_right``, ``x``, ``y``, ``yaw``,
    ``yaw_rate``, ``accel_x``, and ``slope`` where the ground is not level. Power that belongs to
    no side, such as a hotel load, is split evenly between ``p_left`` and ``p_right``.

    Parameters
    ----------
    model : PowerModel
        What the robot draws; its vehicle's tread ICRs say how it moves.
    pattern : str, sequence or Trajectory
        Name of a pattern in `PATTERNS`; or a sequence of names, of ``(name, duration)`` pairs and
        of `Setpoint` objects, driven one after the other; or a trajectory, whose speeds are driven
        from its first pose on.
    duration : float, optional
        Length of the drive [s]; the named patterns of a sequence share it in proportion to their
        own durations, a trajectory is driven faster or slower.
    speed : float
        Largest tread speed of a pattern [m/s].
    accel_limit : float
        Tread acceleration of a pattern's speed ramps [m/s^2].
    rate : float
        Samples per second [Hz].
    power_noise, speed_noise : float
        Standard deviation of the noise of each side's power [W] and tread speed [m/s].
    correlation_time : float
        Time constant of the power noise, a first-order Markov process [s]; 0 for white noise.
    noise : mapping of str to float, optional
        Standard deviation of the white noise of further channels, in their units.
    slope : float or callable
        Inclination of the ground plane [rad], or a function of x, y, yaw that returns the slope
        along the heading.
    uphill : float
        Heading that climbs the ground plane straight [rad].
    channels : mapping of str to float or callable, optional
        Further channels, such as ``temperature``: constants, or functions of time [s]. The model's
        terms may read them; the log holds them.
    changes : sequence of (float, PowerModel)
        Times [s], increasing, and the models that hold from then on: another surface or payload.
    delays : mapping of str to float, optional
        By how much channels lag behind the truth [s].
    gains, biases : mapping of str to float, optional
        Sensor errors: factor, and offset in the channel's unit.
    without : collection of str
        Channels that the log does not have.
    measured : {"sides", "total", "battery"}
        Log ``p_left`` and ``p_right``, or ``power``, or ``voltage`` and ``current``.
    voltage : float
        Battery voltage [V], where that is measured.
    seed : int
        Seed of the noise and of random patterns. Each channel has a stream of its own, so that
        another option leaves the noise of the others as it was.
    name : str, optional
        Name of the log.

    Returns
    -------
    DriveLog
        The drive.

    Raises
    ------
    UnknownNameError
        If a pattern or a channel does not exist.
    InvalidInputError
        If an option is out of range, or a pattern has too little time.
    MissingChannelError
        If a term of the model needs a channel that is not given.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:marble")
    >>> log = drive(model, "figure8", duration=30.0)
    >>> len(log), round(float(log.channels["yaw"].max()), 1)
    (601, 6.3)
    """
    _check(speed, accel_limit, rate, model, {"power_noise": power_noise, "speed_noise": speed_noise,
           "correlation_time": correlation_time, **(noise or {})})  # fmt: skip
    start = Pose(0.0, 0.0, 0.0)
    if isinstance(pattern, Trajectory):
        plan, start = _followed(model, pattern, duration)
    else:
        plan = schedule(_setpoints(model, pattern, duration, speed, accel_limit, seed), accel_limit)
    t = np.arange(int(np.floor(plan.duration * rate + 1e-9)) + 1) / rate
    world = _World(plan, ((0.0, model), *changes), slope, uphill, channels or {}, start)
    log = _logged(world.at(t), measured, voltage, ground=slope != 0.0)
    unknown = {*(delays or {}), *(gains or {}), *(biases or {}), *(noise or {}), *without}
    for channel in sorted(unknown - set(log)):
        raise UnknownNameError("channel of this drive", channel, log)
    for channel, delay in (delays or {}).items():
        late = _logged(world.at(np.clip(t - delay, 0.0, plan.duration)), measured, voltage, True)
        log[channel] = late[channel]
    deviation = {
        **dict.fromkeys(("p_left", "p_right", "power"), power_noise),
        **dict.fromkeys(("v_left", "v_right"), speed_noise),
        **(noise or {}),
    }
    for channel, values in log.items():
        tau = correlation_time if channel in ("p_left", "p_right", "power") else 0.0
        error = _noise(len(t), deviation.get(channel, 0.0), tau * rate, seed, channel)
        gain, bias = (gains or {}).get(channel, 1.0), (biases or {}).get(channel, 0.0)
        log[channel] = gain * values + bias + error
    kept = {channel: values for channel, values in log.items() if channel not in without}
    return DriveLog({"t": t, **kept}, name or f"simulated {model.name}")


@checked()
def identification_drive(model: PowerModel, **options: Any) -> DriveLog:
    """Simulate the most informative drive: spins, straights, a spiral, a figure-8, a survey.

    Parameters
    ----------
    model : PowerModel
        What the robot draws.
    **options
        Options of `drive`.

    Returns
    -------
    DriveLog
        A drive of 150 s, longer for a robot that turns or speeds up slowly; or of `duration`.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:marble")
    >>> identification_drive(model).duration
    150.0
    """
    return drive(model, _in_time(IDENTIFICATION, model, **options), **options)


@checked()
def validation_drive(model: PowerModel, **options: Any) -> DriveLog:
    """Simulate another drive, to predict: a survey, stops, a figure-8, a spiral.

    Parameters
    ----------
    model : PowerModel
        What the robot draws.
    **options
        Options of `drive`.

    Returns
    -------
    DriveLog
        A drive of 120 s, longer for a robot that turns or speeds up slowly; or of `duration`.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:marble")
    >>> validation_drive(model).duration
    120.0
    """
    return drive(model, _in_time(VALIDATION, model, **options), **options)


def _in_time(
    parts: Sequence[tuple[str, float]],
    model: PowerModel,
    *,
    speed: float = _SPEED,
    accel_limit: float = _ACCELERATION,
    duration: float | None = None,
    **_: Any,
) -> list[tuple[str, float]]:
    """Return the parts, as much longer as a wide or a slow robot needs to get through them."""
    longer = 1.0
    if duration is None and speed > 0 and accel_limit > 0:
        ramp = speed / accel_limit
        least = {
            "figure8": figure8_time(model.vehicle, speed, accel_limit),
            "spiral": 10 * ramp, "spin": 6 * ramp, "straight": 6 * ramp,
        }  # fmt: skip
        # In the least time circles are spins, and nothing is steady.
        shares = [least[label] / time for label, time in parts if label in least]
        longer = 1.0 if max(shares) <= 1.0 else 1.5 * max(shares)
    return [(label, longer * time) for label, time in parts]


def _check(
    speed: float, accel_limit: float, rate: float, model: PowerModel, deviations: dict[str, float]
) -> None:
    for label, value in (("speed", speed), ("accel_limit", accel_limit), ("rate", rate)):
        if not (np.isfinite(value) and value > 0):
            raise InvalidInputError(f"{label} is {value}; give a positive number")
    if speed > model.vehicle.motor.speed:
        raise InvalidInputError(
            f"speed is {speed} m/s, but {model.vehicle.name} reaches {model.vehicle.motor.speed}"
        )
    for label, value in deviations.items():
        if not (np.isfinite(value) and value >= 0):
            raise InvalidInputError(f"{label} is {value}; give a number >= 0")


def _stream(seed: int, label: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(label.encode())])


def _noise(count: int, deviation: float, tau: float, seed: int, label: str) -> FloatArray:
    """Stationary first-order Markov noise; `tau` in samples."""
    white = deviation * _stream(seed, label).standard_normal(count)
    if tau <= 0:
        return white
    from scipy.signal import lfilter  # slow to import, and rarely needed

    keep = float(np.exp(-1.0 / tau))
    innovation = white * np.sqrt(1.0 - keep**2)
    innovation[:1] = white[:1]  # start in the stationary state
    return np.asarray(lfilter([1.0], [1.0, -keep], innovation))


def _followed(
    model: PowerModel, trajectory: Trajectory, duration: float | None
) -> tuple[Schedule, Pose]:
    """Tread speeds of a trajectory, linear between its samples, and its first pose."""
    if duration is not None:
        if not (np.isfinite(duration) and duration > 0):
            raise InvalidInputError(f"duration is {duration}; give seconds > 0")
        trajectory = trajectory.scaled(trajectory.duration / duration)
    motion = Motion.from_twist(trajectory.v, trajectory.omega, model.vehicle.icr)
    plan = Schedule(trajectory.t - trajectory.t[0], motion.v_left, motion.v_right)
    return plan, Pose(*(float(value) for value in trajectory.poses[0]))


def _setpoints(
    model: PowerModel,
    pattern: str | Sequence[Part],
    duration: float | None,
    speed: float,
    accel_limit: float,
    seed: int,
) -> list[Setpoint]:
    parts: list[tuple[str, float] | Setpoint] = []
    for part in [pattern] if isinstance(pattern, str) else pattern:
        label = part if isinstance(part, str) else part[0] if isinstance(part, tuple) else "rest"
        if label not in PATTERNS:
            raise UnknownNameError("drive pattern", label, PATTERNS)
        parts.append((part, PATTERNS[part].duration) if isinstance(part, str) else part)
    whole = sum(part[1] for part in parts if isinstance(part, tuple))
    scale = duration / whole if duration is not None and whole else 1.0
    setpoints: list[Setpoint] = []
    for k, part in enumerate(parts):
        if isinstance(part, Setpoint):
            setpoints.append(part)
            continue
        label, time = part
        brief = Brief(model.vehicle, time * scale, speed, accel_limit, _stream(seed, f"{label}{k}"))
        setpoints += PATTERNS[label].setpoints(brief)
    return setpoints


def _logged(
    truth: dict[str, FloatArray], measured: str, voltage: float, ground: bool
) -> dict[str, FloatArray]:
    """Pick what the robot's logger writes, except time."""
    hidden = {"t", "accel", "yaw_accel", "common", *(() if ground else ("slope",))}
    log = {name: values for name, values in truth.items() if name not in hidden}
    left = log.pop("p_left") + truth["common"] / 2
    right = log.pop("p_right") + truth["common"] / 2
    if measured == "sides":
        return {"p_left": left, "p_right": right, **log}
    if measured == "total":
        return {"power": left + right, **log}
    if measured == "battery":
        return {
            "voltage": np.full_like(left, voltage), "current": (left + right) / voltage, **log
        }  # fmt: skip
    raise UnknownNameError("way to measure power", measured, ("sides", "total", "battery"))


class _World:
    """What truly happens during a drive, at any time."""

    def __init__(
        self,
        plan: Schedule,
        phases: Sequence[tuple[float, PowerModel]],
        slope: Slope,
        uphill: float,
        extra: Mapping[str, float | Callable[[FloatArray], FloatArray]],
        start: Pose,
    ) -> None:
        self._plan, self._phases, self._extra, self._start = plan, phases, extra, start
        self._slope, self._uphill = slope, uphill
        self._starts = np.array([start for start, _ in phases])
        if np.any(np.diff(self._starts) <= 0):
            raise InvalidInputError(
                f"changes happen at {self._starts[1:].tolist()} s; give increasing times > 0"
            )

    def at(self, t: FloatArray) -> dict[str, FloatArray]:
        """Return every channel at times `t` [s], sorted."""
        truth = self._kinematics(t)
        for name, value in self._extra.items():
            truth[name] = np.broadcast_to(value(t) if callable(value) else value, t.shape)
        truth |= {name: np.zeros(len(t)) for name in ("p_left", "p_right", "common")}
        phase = self._phase(t)
        for k, (_, model) in enumerate(self._phases):
            now = phase == k
            if not np.any(now):
                continue
            known = {name: values[now] for name, values in truth.items()}
            motion = Motion(known.pop("v_left"), known.pop("v_right"), model.vehicle.icr, known)
            sides = model.sides(motion)
            truth["p_left"][now], truth["p_right"][now] = sides.left, sides.right
            truth["common"][now] = model.power(motion) - sides.total
        return truth

    def _phase(self, t: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
        return np.searchsorted(self._starts, t, side="right") - 1

    def _kinematics(self, t: FloatArray) -> dict[str, FloatArray]:
        """Tread speeds, pose, rates and slope; the pose to rounding, by Gauss quadrature."""
        plan = self._plan
        steps = np.linspace(0.0, plan.duration, int(plan.duration / _STEP) + 2)
        inside = self._starts[self._starts < plan.duration]
        grid = np.unique(np.concatenate([plan.t, steps, inside, t]))
        left = np.interp(grid, plan.t, plan.v_left)
        right = np.interp(grid, plan.t, plan.v_right)
        icrs = [model.vehicle.icr for _, model in self._phases]
        phase = self._phase(0.5 * (grid[:-1] + grid[1:]))
        track = np.array([icr.slip_track for icr in icrs])[phase]
        share = np.array([icr.left / icr.slip_track for icr in icrs])[phase]
        ahead = np.array([icr.longitudinal for icr in icrs])[phase]
        h = np.diff(grid)
        start, end = slice(None, -1), slice(1, None)
        w0, w1 = ((right[k] - left[k]) / track for k in (start, end))
        v0, v1 = ((1 - share) * left[k] + share * right[k] for k in (start, end))
        poses = travelled(self._start, h, (v0, v1), (w0, w1), ahead)
        node = np.searchsorted(grid, t)
        piece = np.minimum(node, len(h) - 1)
        late = node > piece
        at = {
            "t": t,
            "v_left": left[node],
            "v_right": right[node],
            **dict(zip(("x", "y", "yaw"), poses[node].T, strict=True)),
            "yaw_rate": np.where(late, w1[piece], w0[piece]),
        }
        # From the corners, not from the grid, whose shortest steps are mere rounding.
        corner = np.clip(np.searchsorted(plan.t, t, side="right") - 1, 0, len(plan.t) - 2)
        a_left, a_right = (
            (np.diff(speed) / np.diff(plan.t))[corner] for speed in (plan.v_left, plan.v_right)
        )
        at["accel"] = (1 - share[piece]) * a_left + share[piece] * a_right
        at["yaw_accel"] = (a_right - a_left) / track[piece]
        if callable(self._slope):
            at["slope"] = np.asarray(self._slope(at["x"], at["y"], at["yaw"]), float)
        else:
            heading = np.cos(at["yaw"] - self._uphill)
            at["slope"] = np.asarray(np.arcsin(np.sin(self._slope) * heading))
        at["accel_x"] = at["accel"] + GRAVITY * np.sin(at["slope"])
        return at
