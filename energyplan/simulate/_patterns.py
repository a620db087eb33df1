"""Manoeuvres as setpoints: tread speeds to reach and to hold, and the schedule they add up to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.path import FloatArray
from energyplan.vehicle import Vehicle


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

    t: FloatArray  # (n,): corners
    v_left: FloatArray  # (n,): corners
    v_right: FloatArray  # (n,): corners

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
    """What a pattern is told: robot, time, speed, acceleration limit and chance."""

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
