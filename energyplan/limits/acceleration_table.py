"""How fast a robot can speed up and slow down on an arc of constant curvature.

A run is a stretch of constant curvature. Its one degree of freedom is the rate r, the speed of the
faster tread [m/s]; its length is measured along that tread. On a run nothing but r changes, so
the way to speed up is the same wherever it starts: a ladder of rates with one acceleration between
neighbouring rungs. Squared rates are then piecewise linear in distance, which makes every question
about reaching a speed or a distance an exact interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from energyplan.errors import InfeasibleMotionError, InvalidInputError
from energyplan.limits.motor import Limits, largest_within
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel

UNLIMITED = 1e6
"""Tread acceleration where no limit is known [m/s^2]: in effect a step."""

IDLE = 1e-7
"""Fraction of the full acceleration that counts as none."""

CRAWL = 1e-6
"""Fraction of the top rate that stands for the moment of starting: friction has a direction."""


@dataclass(frozen=True)
class Runs:
    """Kinds of runs: body motion per unit of the faster tread's speed, n of them."""

    forward: FloatArray  # (n,): speed along the heading [1] and yaw rate [1/m] at unit rate
    turn: FloatArray  # (n,): speed along the heading [1] and yaw rate [1/m] at unit rate
    drift: FloatArray  # how fast `forward` and `turn` change along a smooth curve [1/m], [1/m^2]
    model: PowerModel  # the power model
    channels: Mapping[str, FloatArray]  # (n,): further channels, constant on a run

    @cached_property
    def bend(self) -> FloatArray:
        """How fast the speed of either tread changes along a smooth curve at unit rate [1/m]."""
        icr = self.model.vehicle.icr
        forward, turn = self.drift[::2], self.drift[1::2]
        sides = np.abs(forward - icr.left * turn), np.abs(forward + icr.right * turn)
        return np.asarray(np.max(sides, axis=(0, 1)))

    def motion(
        self, rate: FloatArray, gain: FloatArray | float = 0.0, end: int | None = None
    ) -> Motion:
        """Motion at rates of shape (..., n) that change by `gain` [m/s^2].

        With `end` 0 or 1, the motion about the start or the end of a run on a smooth curve.
        """
        rise = np.broadcast_to(np.asarray(gain, float), np.shape(rate))
        drift = np.zeros(2)[:, None] if end is None else self.drift[2 * end : 2 * end + 2]
        known = {"slope": np.zeros_like(self.forward), **self.channels}
        return Motion.from_twist(
            self.forward * rate,
            self.turn * rate,
            self.model.vehicle.icr,
            accel=self.forward * rise + drift[0] * rate**2,
            yaw_accel=self.turn * rise + drift[1] * rate**2,
            **known,
        )

    def power(self, rate: FloatArray, gain: FloatArray | float = 0.0) -> FloatArray:
        """Power under the model [W]."""
        return self.model.power(self.motion(rate, gain))

    def use(self, limits: Limits, rate: FloatArray, gain: FloatArray | float = 0.0) -> FloatArray:
        """Largest load over limit, as `Limits.use`."""
        worst = limits.use(self.model, self.motion(rate, gain))
        if self.drift.any():
            for end in (0, 1):
                worst = np.maximum(worst, limits.use(self.model, self.motion(rate, gain, end)))
        return worst

    def top_rate(self, limits: Limits) -> FloatArray:
        """Largest rate up to which every steady rate is within the limits."""
        full = min(limits.motor.acceleration, UNLIMITED)
        bounds = (
            np.full_like(self.turn, limits.motor.speed),
            _ratio(limits.yaw_rate, np.abs(self.turn)),
            np.sqrt(_ratio(limits.lateral_acceleration, np.abs(self.forward * self.turn))),
            np.sqrt(_ratio(0.99 * full, self.bend)),
        )
        top = np.min(bounds, axis=0)
        if np.any(top == 0):
            k = int(np.argmin(top))
            raise InfeasibleMotionError(f"{self.place(k)} a limit of 0 forbids any speed")
        free = ~np.isfinite(top)
        top = np.where(free, 1.0, top)
        while np.any(growing := free & (self.use(limits, top) <= 1.0)):
            if top.max() > 1e3:
                raise InvalidInputError(
                    "nothing limits the speed; give the vehicle's motor a speed or a power limit, "
                    "as in motor=MotorLimits(speed=1.5)"
                )
            top = np.where(growing, 2 * top, top)
        rate = largest_within(lambda r: self.use(limits, r), top)
        if np.any(rate == 0):
            k = int(np.argmin(rate))
            raise InfeasibleMotionError(self._why_not(limits, k, CRAWL * top))
        return rate

    def _why_not(self, limits: Limits, k: int, rate: FloatArray) -> str:
        values = limits.loads(self.model, self.motion(rate)).values
        over = [
            bound.describe(value[k])
            for bound, value in zip(limits.bounds, values, strict=True)
            if value[k] > bound.limit
        ]
        reasons = "; ".join(over)
        return (
            f"{self.place(k)} no speed is feasible: {reasons}. It takes another path, less load, "
            "other ground or stronger motors"
        )

    def place(self, k: int) -> str:
        """Describe run `k` for messages."""
        if self.forward[k] == 0:
            return "while spinning on the spot"
        return f"at curvature {self.turn[k] / self.forward[k]:.4g} 1/m"


@dataclass(frozen=True)
class Ladder:
    """Rates of each run with the acceleration between neighbouring ones."""

    rate: FloatArray  # (m + 1, n): rungs from 0 to the top rate [m/s]
    up: FloatArray  # (m, n): acceleration and deceleration between two rungs [m/s^2], both positive
    down: FloatArray  # acceleration and deceleration between two rungs [m/s^2], both positive

    @cached_property
    def square(self) -> FloatArray:
        """Squared rates [m^2/s^2]."""
        return self.rate**2

    @cached_property
    def climb(self) -> FloatArray:
        """Distance along the faster tread from a standstill to each rung [m], shape (m + 1, n)."""
        return self._distance(self.up)

    @cached_property
    def descent(self) -> FloatArray:
        """Distance from each rung to a standstill [m], shape (m + 1, n)."""
        return self._distance(self.down)

    def _distance(self, gain: FloatArray) -> FloatArray:
        steps = np.diff(self.square, axis=0) / (2 * gain)
        return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])

    def take(self, kinds: np.ndarray) -> Ladder:
        """Return the ladders of those runs, in that order."""
        return Ladder(self.rate[:, kinds], self.up[:, kinds], self.down[:, kinds])

    def with_gains(self, up: FloatArray, down: FloatArray) -> Ladder:
        """Return the same rungs with other accelerations."""
        return replace(self, up=up, down=down)

    @classmethod
    def fastest(cls, runs: Runs, limits: Limits, rungs: int) -> Ladder:
        """Return the ladder of greatest accelerations within the limits.

        The rungs stand closer at both ends. Between two rungs the smaller of both bounds holds,
        so that a motion which is feasible at the rungs is so in between.
        """
        top = runs.top_rate(limits)
        rate = top * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, rungs + 1)))[:, None]
        moving = np.maximum(rate, CRAWL * top)
        full = min(limits.motor.acceleration, UNLIMITED)
        spare = full - runs.bend * rate**2
        gains = []
        for sign in (1.0, -1.0):
            bound = _largest_gain(runs, limits, spare, moving, sign)
            gains.append(np.minimum(bound[:-1], bound[1:]))
        # A rung that takes for ever to reach, or to leave, ends the ladder.
        usable = np.logical_and.accumulate(np.minimum(*gains) > IDLE * full, axis=0)
        if not usable[0].all():
            k = int(np.argmin(usable[0]))
            raise InfeasibleMotionError(
                f"{runs.place(k)} the limits leave nothing to speed up or slow down with; "
                "use another path, less load, other ground or stronger motors"
            )
        last = np.take_along_axis(rate, usable.sum(axis=0)[None], axis=0)
        up, down = (np.where(usable, gain, full) for gain in gains)
        return cls(np.minimum(rate, last), up, down)


def _ratio(limit: float, value: FloatArray) -> FloatArray:
    """Limit over value; infinite where there is nothing to limit."""
    return np.divide(limit, value, out=np.full_like(value, np.inf), where=value > 0)


def _largest_gain(
    runs: Runs, limits: Limits, full: FloatArray, rate: FloatArray, sign: float
) -> FloatArray:
    """Largest acceleration at each rate that keeps all limits, at most `full`."""
    high = full
    within = runs.use(limits, rate, sign * high) <= 1
    if within.all():
        return high
    low = np.where(within, high, 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        fits = runs.use(limits, rate, sign * middle) <= 1
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return low


def drift_about(reach: FloatArray, shape: FloatArray, jump: FloatArray) -> FloatArray:
    """How fast the shape of the motion changes about both ends of each run of a smooth curve.

    A jump between two runs is spread over the distance `reach` on either side. The factor
    ``1 + 2 jump`` covers what straight interpolation across it leaves out.
    """
    share = np.divide(1 + 2 * jump, 2 * reach, out=np.zeros_like(jump), where=jump > 0)
    rate = np.diff(shape, axis=0) * share[:, None]
    none = np.zeros((1, 2))
    return np.hstack([np.vstack([none, rate]), np.vstack([rate, none])])
