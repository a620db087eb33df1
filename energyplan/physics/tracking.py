"""The tracking controller: Samson's law about a reference that moves along a trajectory."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.path import Trajectory, wrap_angle
from energyplan.physics.record import PERIOD, State
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
