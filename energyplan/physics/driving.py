"""A trajectory driven by the engine under a tracking controller, and what its sensors record."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, fields
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from energyplan import html
from energyplan.errors import InvalidInputError, UnknownNameError
from energyplan.limits.drive import Ground as ModelledGround
from energyplan.limits.drive import Traversal
from energyplan.logs import DriveLog
from energyplan.path import FloatArray, Pose, Trajectory, wrap_angle
from energyplan.physics.engine import PERIOD, Engine, Run, State
from energyplan.physics.robot import Amount, EngineGround, EngineRobot, Positive
from energyplan.power import PowerModel
from energyplan.records import in_words, record
from energyplan.terrain import laid_out
from energyplan.vehicle import Vehicle


@record(InvalidInputError, whose="sensors: ")
class Sensors:
    """How a drive is recorded."""

    rate: Positive = 20.0  # samples per second [Hz]
    power_noise: Amount = 2.0  # standard deviation of each side's power [W]
    speed_noise: Amount = 0.002  # standard deviation of each tread speed [m/s]
    speed_step: Amount = 0.0  # resolution of each tread speed; 0 for none [m/s]
    current_step: Amount = 0.0  # resolution of the battery current; 0 for none [A]
    pose_noise: Amount = 0.0  # standard deviation of x and of y [m]
    yaw_noise: Amount = 0.0  # standard deviation of the heading [rad] and of the yaw rate [rad/s]
    delay: Amount = 0.0  # by how much power is logged later than speed [s]
    unsigned: bool = False  # whether the sensors of the sides lose the sign of the power
    measured: Literal["sides", "total", "battery"] = "sides"
    voltage: Positive = 24.0  # battery voltage [V]
    without: tuple[str, ...] = ()  # channels that the log does not have
    seed: Annotated[int, Field(ge=0)] = 0  # seed of the noise

    @classmethod
    def parse(cls, text: str) -> Sensors:
        """Return the sensors that ``NAME=VALUE,NAME=VALUE`` stands for."""
        known = [item.name for item in fields(cls) if item.name != "without"]
        given: dict[str, str] = {}
        for part in filter(None, text.split(",")):
            name, _, value = (word.strip() for word in part.partition("="))
            if name not in known:
                raise UnknownNameError("property of sensors", name, known)
            given[name] = value
        try:
            return TypeAdapter(cls).validate_python(given, context={})
        except ValidationError as problem:
            wrong = problem.errors(include_url=False)[0]
            place, message = in_words(wrong["loc"]), wrong["msg"].removeprefix("Value error, ")
            raise InvalidInputError(
                f"sensors {text!r}: {place} is {wrong['input']}; {message}; write NAME=VALUE, "
                "like rate=50,measured=battery"
            ) from None

    def log(self, run: Run, name: str = "engine drive") -> DriveLog:
        """Return a drive as these sensors record it."""
        wide = max(1, round(1.0 / (self.rate * run.period)))
        count = len(run.t) // wide
        if count < 2:
            raise InvalidInputError(
                f"the drive of {len(run.t) * run.period:.2f} s is too short for two samples at "
                f"{self.rate:g} Hz; give a higher rate or a longer drive"
            )

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(values[: count * wide].reshape(count, wide).mean(axis=1))

        rng = np.random.default_rng([self.seed, 0x106])

        def noisy(values: FloatArray, deviation: float) -> FloatArray:
            return values + deviation * rng.standard_normal(count)

        t = mean(run.t)
        speeds = [noisy(mean(v), self.speed_noise) for v in (run.v_left, run.v_right)]
        if self.speed_step:
            speeds = [np.round(v / self.speed_step) * self.speed_step for v in speeds]
        drawn = [power + run.hotel / 2 for power in (run.battery_left, run.battery_right)]
        sides = [noisy(self._late(t, mean(p)), self.power_noise) for p in drawn]
        channels = {"t": t, "v_left": speeds[0], "v_right": speeds[1], **self._power(sides)}
        channels |= {
            "x": noisy(mean(run.x), self.pose_noise),
            "y": noisy(mean(run.y), self.pose_noise),
            "yaw": noisy(mean(run.yaw), self.yaw_noise),
            "yaw_rate": noisy(mean(run.omega), self.yaw_noise),
            "accel_x": mean(run.accel_x),
            "cmd_left": mean(run.cmd_left),
            "cmd_right": mean(run.cmd_right),
        }
        if np.any(run.slope != 0.0):
            channels["slope"] = mean(run.slope)
        for channel in sorted(set(self.without) - {*channels, "slope"}):
            raise UnknownNameError("channel of this drive", channel, channels)
        kept = {key: values for key, values in channels.items() if key not in self.without}
        return DriveLog(kept, name, signed=not self.unsigned)

    def _late(self, t: FloatArray, power: FloatArray) -> FloatArray:
        return np.interp(t - self.delay, t, power) if self.delay else power

    def _power(self, sides: list[FloatArray]) -> dict[str, FloatArray]:
        if self.measured == "sides":
            seen = [self._read(p) for p in sides]
            return {"p_left": seen[0], "p_right": seen[1]}
        total = sides[0] + sides[1]
        if self.measured == "total":
            return {"power": self._read(total)}
        current = self._read(total) / self.voltage
        return {"voltage": np.full_like(current, self.voltage), "current": current}

    def _read(self, power: FloatArray) -> FloatArray:
        """Round the current behind a power, and lose its sign, as the sensor does."""
        if self.current_step:
            step = self.current_step * self.voltage
            power = np.trunc(power / step) * step
        return np.abs(power) if self.unsigned else power


class Correction(NamedTuple):
    """How a robot returns to a straight reference."""

    # curvature, times half the slip track, up to which a reference counts as straight [1]
    straight: float = 0.01
    # distance in which a robot off a straight reference returns to it, in half slip tracks
    ahead: float = 2.0
    aligned: float = 1e-3  # heading that is left of a correction [rad]
    quick: float = 10.0  # yaw rate of a correction per heading that is missing [1/s]
    # least tread speed with which the robot turns there [m/s]: the wheels have to break away
    least: float = 0.03


_CORRECTION = Correction()


@record(InvalidInputError, whose="tracking: ")
class Tracking:
    """Gains of the tracking controller, and when it has arrived."""

    # Source: Samson (1993), "Time-varying feedback stabilization of car-like wheeled mobile
    # robots"; Kanayama et al. (1990), "A stable tracking control method for an autonomous mobile
    # robot".

    along: Amount = 2.0  # speed per distance that the robot is behind the reference [1/s]
    across: Amount = 6.0  # yaw rate per speed and distance to the side of it [1/m^2]
    heading: Amount = 3.0  # yaw rate per heading error [1/s]
    slack: Amount = 0.02  # deviation from a straight reference that is left alone [1]
    settle: Amount = 0.5  # time after the trajectory's end to close up [s]
    position: Amount = 0.1  # distance to the goal that counts as arrived [m]
    angle: Amount = 0.1  # heading error that counts as arrived [rad]


class Tracker:
    """A controller that follows a trajectory with what it believes of the vehicle."""

    def __init__(self, trajectory: Trajectory, vehicle: Vehicle, gains: Tracking) -> None:
        self.trajectory, self.vehicle, self.gains = trajectory, vehicle, gains
        self._turning = 0.0
        self._times = (trajectory.t - trajectory.t[0]).tolist()
        turns = wrap_angle(np.diff(trajectory.yaw))
        yaw = trajectory.yaw[0] + np.concatenate([[0.0], np.cumsum(turns)])
        columns = (trajectory.x, trajectory.y, yaw, trajectory.v, trajectory.omega)
        self._rows = np.column_stack(columns).tolist()  # read one at a time

    def reference(self, t: float) -> tuple[float, ...]:
        """Return x, y, yaw, v, omega of the reference at a time since the start [s]."""
        last = len(self._rows) - 1
        k = min(max(bisect_right(self._times, t) - 1, 0), last - 1)
        share = (t - self._times[k]) / (self._times[k + 1] - self._times[k])
        share = min(max(share, 0.0), 1.0)
        row = [a + share * (b - a) for a, b in zip(self._rows[k], self._rows[k + 1], strict=True)]
        if t >= self._times[-1]:
            row[3:] = [0.0, 0.0]
        return tuple(row)

    def _straightening(self, aside: float, turn: float) -> float:
        """Return the yaw rate that brings the robot back to a straight reference [rad/s]."""
        track = self.vehicle.icr.half_track
        missing = turn + aside / (2 * _CORRECTION.ahead * track)
        if abs(_CORRECTION.ahead * turn + aside / track) > self.gains.slack and not self._turning:
            self._turning = float(np.sign(missing))
        if missing * self._turning <= _CORRECTION.aligned:
            self._turning = 0.0
        return self._turning * max(_CORRECTION.quick * abs(missing), _CORRECTION.least / track)

    def __call__(self, state: State) -> tuple[float, float] | None:
        """Return the tread speeds to reach by the next tick [m/s], or None at the end."""
        gains, icr = self.gains, self.vehicle.icr
        if state.t >= self._times[-1] + gains.settle:
            return None
        x, y, yaw, _, _ = self.reference(state.t)
        *_, v, omega = self.reference(state.t + PERIOD)
        c, s = np.cos(state.pose.yaw), np.sin(state.pose.yaw)
        dx, dy = x - state.pose.x, y - state.pose.y
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        turn = float(wrap_angle(np.array(yaw - state.pose.yaw)))
        forward = v * np.cos(turn) + gains.along * ahead
        if abs(omega) * self.vehicle.icr.half_track > _CORRECTION.straight * abs(v):
            self._turning = 0.0
            damped = min(2 * abs(v) * np.sqrt(gains.across), 0.2 / PERIOD)  # at any speed
            heading = max(gains.heading, damped)
            rate = omega + gains.across * v * np.sinc(turn / np.pi) * aside + heading * turn
        else:
            rate = self._straightening(float(np.sign(v)) * aside, turn)
        left, right = forward - icr.left * rate, forward + icr.right * rate
        over = max(abs(left), abs(right)) / self.vehicle.motor.speed
        if over > 1:  # slower, in the same curvature
            left, right = left / over, right / over
        return float(left), float(right)


@dataclass(frozen=True)
class Driven(html.Readable):
    """A trajectory as it was driven."""

    trajectory: Trajectory  # the reference
    run: Run  # what happened
    predicted: dict[str, float]  # what the power model predicts, by term [J]
    measured: dict[str, float]  # what the battery delivered, by the term that stands for it [J]
    arrived: bool  # whether the robot stands at the end of the trajectory
    tracking_error: float
    heading_error: float
    final_error: float  # distance from the end of the trajectory [m]

    @property
    def energy_predicted(self) -> float:
        """Energy that the model predicts [J]."""
        return sum(self.predicted.values())

    @property
    def energy_measured(self) -> float:
        """Energy that the battery delivered [J]."""
        return self.run.taken

    @property
    def error(self) -> float:
        """Predicted over measured energy, minus one."""
        return self.energy_predicted / self.energy_measured - 1.0

    @property
    def terms(self) -> list[tuple[str, float, float]]:
        """Rows of term, predicted energy [J] and measured energy [J]; the largest first."""
        names = dict.fromkeys([*self.predicted, *self.measured])
        rows = [
            (name, self.predicted.get(name, 0.0), self.measured.get(name, 0.0)) for name in names
        ]
        rows = [row for row in rows if row[1] or row[2]]
        return sorted(rows, key=lambda row: -max(abs(row[1]), abs(row[2])))

    def _summaries(self) -> list[html.Summary]:
        note = (
            f"{'arrived' if self.arrived else 'not arrived'}: {100 * self.final_error:.1f} cm from "
            f"the end; at most {100 * self.tracking_error:.1f} cm and "
            f"{np.degrees(self.heading_error):.1f} deg off on the way"
        )
        title = (
            f"energy predicted: {html.number(self.energy_predicted, 5)} J, measured: "
            f"{html.number(self.energy_measured, 5)} J ({100 * self.error:+.2f} %)"
        )
        header = ("term", "predicted [J]", "measured [J]")
        shown = iter(html.column([part for _, *both in self.terms for part in both], 4))
        rows = [(name, next(shown), next(shown)) for name, *_ in self.terms]
        return [html.Summary(title, header, rows, [note])]


def energy_predicted(
    trajectory: Trajectory, model: PowerModel, ground: EngineGround | None = None
) -> dict[str, float]:
    """Return the energy of a trajectory by term, as a power model predicts it [J]."""
    here = ground or EngineGround()
    law, surfaces, heights = laid_out(model, trajectory.poses[:, :2], here.surfaces, here.heights)
    regions = () if surfaces is None else surfaces.surfaces
    others = tuple(surface.model.battery_side() for surface in regions)
    driven_on = ModelledGround(law.battery_side(), surfaces, heights, others)
    return Traversal(trajectory, driven_on).breakdown()


def drive(
    trajectory: Trajectory,
    robot: EngineRobot,
    model: PowerModel,
    *,
    ground: EngineGround | None = None,
    tracking: Tracking | None = None,
) -> Driven:
    """Drive a trajectory in the engine."""
    gains = tracking or Tracking()
    tracker = Tracker(trajectory, model.vehicle, gains)
    start = Pose(*(float(value) for value in trajectory.poses[0]))
    predicted = energy_predicted(trajectory, model, ground)
    run = Engine(robot, ground, start).drive(tracker, longest=2 * trajectory.duration + 60.0)
    wanted = np.array([tracker.reference(float(t))[:3] for t in run.t])
    offset = np.hypot(run.x - wanted[:, 0], run.y - wanted[:, 1])
    misaligned = np.abs(wrap_angle(run.yaw - wanted[:, 2]))
    return Driven(
        trajectory, run, predicted, run.energy,
        bool(offset[-1] <= gains.position and misaligned[-1] <= gains.angle),
        float(offset.max()), float(misaligned.max()), float(offset[-1]),
    )  # fmt: skip
