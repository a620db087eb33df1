"""A trajectory driven in the engine, and its energy beside the prediction of a power model."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from energyplan import html
from energyplan.errors import InvalidInputError
from energyplan.limits.drive import Drive
from energyplan.limits.drive import Ground as ModelledGround
from energyplan.path import Pose, Trajectory, wrap_angle
from energyplan.physics.engine import PERIOD, Engine, Run, State
from energyplan.physics.robot import Ground, Robot
from energyplan.power import PowerModel
from energyplan.terrain import laid_out
from energyplan.vehicle import Vehicle

STRAIGHT = 0.01
"""Curvature, times half the slip track, up to which a reference counts as straight [1]."""
AHEAD = 2.0
"""Distance at which a robot beside a straight reference is to be near it, in half slip tracks."""
ALIGNED = 1e-3
"""Heading that is left of a correction [rad]."""
QUICK = 10.0
"""Yaw rate of a correction per heading that is missing [1/s]."""
LEAST = 0.03
"""Least tread speed with which the robot turns there [m/s]: the wheels have to break away."""


@dataclass(frozen=True)
class Tracking:
    """Gains of the tracking controller, and when it has arrived.

    Source: Samson (1993), "Time-varying feedback stabilization of car-like wheeled mobile
    robots"; Kanayama et al. (1990), "A stable tracking control method for an autonomous mobile
    robot".
    """

    along: float = 2.0  # speed per distance that the robot is behind the reference [1/s]
    across: float = 6.0  # yaw rate per speed and distance to the side of it [1/m^2]
    heading: float = 3.0  # yaw rate per heading error [1/s]
    slack: float = 0.02  # [1]
    settle: float = 0.5  # time after the trajectory's end in which the robot may still close up [s]
    position: float = 0.1  # how near the end counts as arrived [m], [rad]
    angle: float = 0.1  # how near the end counts as arrived [m], [rad]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0):
                raise InvalidInputError(f"tracking: {name} is {value}; give a number >= 0")


class Tracker:
    """A controller that follows a trajectory with what it believes of the vehicle."""

    def __init__(self, trajectory: Trajectory, vehicle: Vehicle, gains: Tracking) -> None:
        self.trajectory, self.vehicle, self.gains = trajectory, vehicle, gains
        self._turning = 0.0
        self._times = (trajectory.t - trajectory.t[0]).tolist()
        turns = wrap_angle(np.diff(trajectory.yaw))
        yaw = trajectory.yaw[0] + np.concatenate([[0.0], np.cumsum(turns)])
        columns = (trajectory.x, trajectory.y, yaw, trajectory.v, trajectory.omega)
        self._rows = np.column_stack(columns).tolist()  # one is asked for at a time

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
        """Return the yaw rate that brings the robot back to a straight reference [rad/s].

        None as long as it passes near enough a little further on. Then it turns at once to where
        it meets the reference twice as far away, and lets go: wheels that slide sideways take as
        much for a slow turn as for a quick one, and push against each other in between.
        """
        track = self.vehicle.icr.half_track
        missing = turn + aside / (2 * AHEAD * track)
        if abs(AHEAD * turn + aside / track) > self.gains.slack and not self._turning:
            self._turning = float(np.sign(missing))
        if missing * self._turning <= ALIGNED:
            self._turning = 0.0
        return self._turning * max(QUICK * abs(missing), LEAST / track)

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
        if abs(omega) * self.vehicle.icr.half_track > STRAIGHT * abs(v):
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

    trajectory: Trajectory  # what was asked
    run: Run  # what happened
    told: dict[str, float]  # energy that the power model predicts for the trajectory, by term [J]
    taken: dict[str, float]  # energy that the battery delivered, by the term that stands for it [J]
    arrived: bool  # whether the robot stands at the end of the trajectory
    tracking_error: float
    heading_error: float
    final_error: float  # distance from the end of the trajectory [m]

    @property
    def energy_told(self) -> float:
        """Energy that the model predicts [J]."""
        return sum(self.told.values())

    @property
    def energy_taken(self) -> float:
        """Energy that the battery delivered [J]."""
        return self.run.taken

    @property
    def error(self) -> float:
        """Predicted over taken energy, minus one."""
        return self.energy_told / self.energy_taken - 1.0

    @property
    def terms(self) -> list[tuple[str, float, float]]:
        """Rows of term, predicted energy [J] and energy taken [J]; the largest first."""
        names = dict.fromkeys([*self.told, *self.taken])
        rows = [(name, self.told.get(name, 0.0), self.taken.get(name, 0.0)) for name in names]
        rows = [row for row in rows if row[1] or row[2]]
        return sorted(rows, key=lambda row: -max(abs(row[1]), abs(row[2])))

    def _summaries(self) -> list[html.Summary]:
        return [
            html.Summary(
                f"predicted {self.energy_told:.0f} J, taken {self.energy_taken:.0f} J "
                f"({100 * self.error:+.1f} %), {'arrived' if self.arrived else 'not arrived'}",
                ("term", "predicted [J]", "measured [J]"),
                self.terms,
            )
        ]


def energy_told(
    trajectory: Trajectory, model: PowerModel, ground: Ground | None = None
) -> dict[str, float]:
    """Return the energy of a trajectory by term, as a power model predicts it [J]."""
    here = ground or Ground()
    law, surfaces, heights = laid_out(model, trajectory.poses[:, :2], here.surfaces, here.heights)
    grounds = () if surfaces is None else surfaces.surfaces
    others = tuple(surface.model.battery_side() for surface in grounds)
    driven_on = ModelledGround(law.battery_side(), surfaces, heights, others)
    return Drive(trajectory, driven_on).breakdown()


def drive(
    trajectory: Trajectory,
    robot: Robot,
    model: PowerModel,
    *,
    ground: Ground | None = None,
    tracking: Tracking | None = None,
) -> Driven:
    """Drive a trajectory in the engine."""
    gains = tracking or Tracking()
    tracker = Tracker(trajectory, model.vehicle, gains)
    start = Pose(*(float(value) for value in trajectory.poses[0]))
    told = energy_told(trajectory, model, ground)
    run = Engine(robot, ground, start).drive(tracker, longest=2 * trajectory.duration + 60.0)
    wanted = np.array([tracker.reference(float(t))[:3] for t in run.t])
    apart = np.hypot(run.x - wanted[:, 0], run.y - wanted[:, 1])
    turned = np.abs(wrap_angle(run.yaw - wanted[:, 2]))
    return Driven(
        trajectory, run, told, run.energy,
        bool(apart[-1] <= gains.position and turned[-1] <= gains.angle),
        float(apart.max()), float(turned.max()), float(apart[-1]),
    )  # fmt: skip
