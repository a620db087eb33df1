"""The greatest rates along a path: reachability over its points, which serves every limit.

Each point has a largest steady rate. A pass backwards lowers it to what the next point can be
reached from, a pass forwards drives as fast as that allows. Limits are kept cell by cell for what
happens there, so nothing is given away to the worst case of a run: a tread that has to slow down
for a curve anyway may do so while the other speeds up.

Source: Pham and Pham (2018), "A new approach to time-optimal path parameterization based on
reachability analysis".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import AnyTable, Column, inner, njit
from energyplan.errors import InfeasibleMotionError, InvalidInputError
from energyplan.limits.course import SETTINGS, Points
from energyplan.limits.motor import Limits, largest_within, relative
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel

UNLIMITED = 1e6
"""Tread acceleration where no limit is known [m/s^2]: in effect a step."""

SLACK = 1e-9
"""Fraction by which a limit counts as kept."""


@dataclass(frozen=True)
class Kinds:
    """Steady motions at unit rate, n of them: the points of a path without doubles."""

    forward: FloatArray  # (n,): speed along the heading [1]
    turn: FloatArray  # (n,): yaw rate [1/m]
    channels: Mapping[str, FloatArray]  # (n,): further channels
    model: PowerModel

    def motion(self, rate: FloatArray) -> Motion:
        """Motion at steady rates of shape (..., n)."""
        known = {"slope": np.zeros_like(self.forward), **self.channels}
        return Motion.from_twist(
            self.forward * rate, self.turn * rate, self.model.vehicle.icr,
            accel=0.0, yaw_accel=0.0, **known,
        )  # fmt: skip

    def top_rate(self, limits: Limits) -> FloatArray:
        """Largest rate up to which every steady rate is within the limits."""
        bounds = (
            np.full_like(self.turn, limits.motor.speed),
            _ratio(limits.yaw_rate, np.abs(self.turn)),
            np.sqrt(_ratio(limits.lateral_acceleration, np.abs(self.forward * self.turn))),
        )
        top = np.min(bounds, axis=0)
        if np.any(top == 0):
            k = int(np.argmin(top))
            raise InfeasibleMotionError(f"{self._place(k)} a limit of 0 forbids any speed")

        def use(rate: FloatArray) -> FloatArray:
            return limits.use(self.model, self.motion(rate))

        free = ~np.isfinite(top)
        top = np.where(free, 1.0, top)
        while np.any(growing := free & (use(top) <= 1.0)):
            if top.max() > 1e3:
                raise InvalidInputError(
                    "nothing limits the speed; give the vehicle's motor a speed or a power limit, "
                    "as in motor=MotorLimits(speed=1.5)"
                )
            top = np.where(growing, 2 * top, top)
        rate = largest_within(use, top)
        if np.any(rate == 0):
            raise InfeasibleMotionError(self._why_not(limits, int(np.argmin(rate)), 1e-6 * top))
        return rate

    def _why_not(self, limits: Limits, k: int, rate: FloatArray) -> str:
        values = limits.loads(self.model, self.motion(rate)).values
        over = [
            bound.describe(value[k])
            for bound, value in zip(limits.bounds, values, strict=True)
            if value[k] > bound.limit
        ]
        return (
            f"{self._place(k)} no speed is feasible: {'; '.join(over)}. It takes another path, "
            "less load, other ground or stronger motors"
        )

    def _place(self, k: int) -> str:
        if self.forward[k] == 0:
            return "while spinning on the spot"
        return f"at curvature {self.turn[k] / self.forward[k]:.4g} 1/m"


@dataclass(frozen=True)
class Reach:
    """Points with what limits the motion there."""

    points: Points
    model: PowerModel
    limits: Limits
    corner: FloatArray  # (n,): largest rate for other reasons, such as a stop [m/s]

    @cached_property
    def _kinds(self) -> tuple[Kinds, NDArray[np.intp]]:
        columns = self.points.channels.values()
        table = np.column_stack([self.points.forward, self.points.turn, *columns])
        _, first, kind = np.unique(table.round(9), axis=0, return_index=True, return_inverse=True)
        channels = {name: value[first] for name, value in self.points.channels.items()}
        forward, turn = self.points.forward[first], self.points.turn[first]
        return Kinds(forward, turn, channels, self.model), kind.reshape(-1)

    @cached_property
    def _top(self) -> FloatArray:
        """Largest steady rate of each kind [m/s]."""
        return self._kinds[0].top_rate(self.limits)

    @cached_property
    def top(self) -> FloatArray:
        """Largest rate at each point [m/s]."""
        return np.asarray(np.minimum(self._top[self._kinds[1]], self.corner))

    @cached_property
    def _steady(self) -> tuple[FloatArray, FloatArray]:
        """Rates of each kind [m/s] and the power at them [W], shape (rungs, kinds)."""
        rate = self._top * np.linspace(0.0, 1.0, SETTINGS.rungs + 1)[1:, None]
        kinds = self._kinds[0]
        return rate, kinds.model.power(kinds.motion(rate))

    def cheapest(self, price: float, slowest: float) -> FloatArray:
        """Rates of least energy, plus `price` [W] times time, per distance [m/s]."""
        rate, power = self._steady
        worth = (power + price) / rate
        allowed = rate >= np.minimum(slowest, rate[-1])
        least = np.min(worth, axis=0, where=allowed, initial=np.inf)
        allowed &= worth <= least + 1e-9 * np.abs(worth).max(axis=0)
        best = len(rate) - 1 - np.argmax(allowed[::-1], axis=0)
        cheap = rate[best, np.arange(rate.shape[1])]
        return np.asarray(np.minimum(cheap[self._kinds[1]], self.corner))

    def fastest(self, cap: FloatArray) -> FloatArray:
        """Return the greatest rates within `cap` and all limits [m/s].

        Power and force bound the change of the rate in a cell by the part of it that the steady
        motion leaves; forces are straight in the acceleration. What is left depends on the rates,
        so it is found anew until nothing changes.
        """
        points, icr = self.points, self.model.vehicle.icr
        most = min(self.limits.motor.acceleration, UNLIMITED)
        sides = np.column_stack(
            [points.forward - icr.left * points.turn, points.forward + icr.right * points.turn]
        )
        up, down = np.full((2, len(points.cell)), 1e9)
        best: FloatArray | None = None
        for _ in range(SETTINGS.sweeps):
            rate = fastest_rates(sides, points.cell, cap, most, up, down)
            if rate.min() < 0.0:
                raise InfeasibleMotionError(
                    "no speed along the curve keeps all limits; it takes a wider curve or stronger "
                    "motors"
                )
            gain = np.divide(
                np.diff(rate**2), 2 * points.cell, out=np.zeros_like(up), where=points.cell > 0
            )
            share = self._share(rate)
            over = share < 1.0 - 1e-9
            if not over.any():
                best = rate
                if not np.any((share > 1.0 + 1e-3) & ((up < 1e8) | (down < 1e8))):
                    return rate
            # Beside the top a cell has next to no share for a while: it must be able to recover.
            bound = np.abs(gain) * np.where(over, share * (1 - 1e-7), np.minimum(share, 1e9) ** 0.5)
            rises = gain >= 0
            change = over | ((share > 1.0) & (np.where(rises, up, down) < 1e8))
            up = np.where(change & rises, bound, up)
            down = np.where(change & ~rises, bound, down)
        return rate if best is None else best

    def _share(self, rate: FloatArray) -> FloatArray:
        """Share of each cell's acceleration that the limits leave; above 1 where there is room."""
        points, model = self.points, self.model
        v, omega = points.forward * rate, points.turn * rate
        whole = rate[1:] + rate[:-1]
        step = np.where(whole > 0, 2 * points.cell / np.where(whole > 0, whole, 1.0), 0.0)
        moving = step > 0
        step = np.where(moving, step, 1.0)
        accel, spin = np.diff(v) / step, np.diff(omega) / step
        edge = np.array([1e-9, 0.5, 1.0 - 1e-9])

        def inside(value: FloatArray) -> FloatArray:
            return np.asarray(value[:-1, None] + np.diff(value)[:, None] * edge)

        known = {"slope": np.zeros(()), **{k: inside(c) for k, c in points.channels.items()}}

        def values(factor: float) -> list[FloatArray]:
            motion = Motion.from_twist(
                inside(v), inside(omega), model.vehicle.icr,
                accel=factor * accel[:, None], yaw_accel=factor * spin[:, None], **known,
            )  # fmt: skip
            return self.limits.loads(model, motion).values

        share = np.full(len(step), np.inf)
        for bound, steady, now in zip(self.limits.bounds, values(0.0), values(1.0), strict=True):
            change = now - steady
            room = np.maximum(bound.limit - steady, 0.0)
            left = np.divide(room, change, out=np.full_like(change, np.inf), where=change > 1e-12)
            within = relative(now, bound.limit) <= 1.0
            left = np.where(within, np.maximum(left, 1.0), np.minimum(left, 1.0))
            share = np.minimum(share, left.min(axis=1))
        return np.where(moving, share, np.inf)


def _ratio(limit: float, value: FloatArray) -> FloatArray:
    """Limit over value; infinite where there is nothing to limit."""
    return np.divide(limit, value, out=np.full_like(value, np.inf), where=value > 0)


@inner
def _kept(
    before: Column, after: Column, first: float, last: float,
    length: float, most: float, up: float, down: float,
) -> bool:  # fmt: skip
    """Whether a cell driven from rate `first` to `last` keeps all accelerations."""
    gain = (last * last - first * first) / (2.0 * length)
    if gain > up + SLACK * (1.0 + up) or gain < -down - SLACK * (1.0 + down):
        return False
    for side in range(2):
        change = (after[side] * last - before[side] * first) * (first + last) / (2.0 * length)
        if abs(change) > most * (1.0 + SLACK):
            return False
    return True


@inner
def _farthest(
    before: Column, after: Column, first: float, cap: float,
    length: float, most: float, up: float, down: float,
) -> float:  # fmt: skip
    """Largest last rate of a cell, at most `cap`, after the rate `first`; negative if none."""
    best = -1.0
    if _kept(before, after, first, cap, length, most, up, down):
        return cap
    for k in range(5):
        for sign in (-1.0, 1.0):
            # after last^2 + (after - before) first last - before first^2 = +- 2 length most
            if k < 2:
                a = after[k]
                b = (after[k] - before[k]) * first
                c = -before[k] * first * first - sign * 2.0 * length * most
            elif k == 2:
                a, b, c = 1.0, 0.0, -first * first - 2.0 * length * up
            elif k == 3:
                a, b, c = 1.0, 0.0, -first * first + 2.0 * length * down
            else:
                a, b, c = 1.0, 0.0, 0.0
            for branch in (-1.0, 1.0):
                if abs(a) > 1e-12:
                    root = b * b - 4.0 * a * c
                    if root < 0.0:
                        continue
                    x = (-b + branch * np.sqrt(root)) / (2.0 * a)
                elif abs(b) > 1e-12:
                    x = -c / b
                else:
                    continue
                if (
                    best < x <= cap
                    and x + first > 0.0
                    and _kept(before, after, first, x, length, most, up, down)
                ):
                    best = x
    return best


@njit
def fastest_rates(
    sides: AnyTable, length: Column, top: Column, most: float,
    up: Column, down: Column,
) -> FloatArray:  # fmt: skip
    """Greatest rates at the points, within `top`; negative at a point that cannot be passed."""
    n = len(top)
    cap = top.copy()
    rate = np.empty(n)
    for _ in range(50 * n):
        # Backwards: from which rates can the next point be reached at a rate that it allows?
        for j in range(n - 2, -1, -1):
            if length[j] == 0.0:  # a stop
                continue
            alike = sides[j, 0] == sides[j + 1, 0] and sides[j, 1] == sides[j + 1, 1]
            best = -1.0
            for share in (1.0, 0.97, 0.93, 0.87, 0.8, 0.7, 0.6, 0.45, 0.3, 0.15, 0.0):
                last = share * cap[j + 1]
                # The cell driven backwards in time: falls are rises.
                found = _farthest(
                    sides[j + 1], sides[j], last, cap[j], length[j], most, down[j], up[j]
                )
                if alike:  # with one shape all below what the greatest rate comes from will do
                    best = cap[j] if found < 0.0 else found
                    break
                best = max(best, found)
                if best >= cap[j]:
                    break
            cap[j] = min(cap[j], best)
            if best < 0.0:
                return cap
        rate[0] = cap[0]
        stuck = -1
        for j in range(n - 1):
            if length[j] == 0.0:
                rate[j + 1] = 0.0
                continue
            found = _farthest(
                sides[j], sides[j + 1], rate[j], cap[j + 1], length[j], most, up[j], down[j]
            )
            if found < 0.0 or (found + rate[j] <= 0.0):
                stuck = j
                break
            rate[j + 1] = found
        if stuck < 0:
            return rate
        # Too fast here to go on: a little slower, and everything before it.
        cap[stuck] = 0.98 * rate[stuck]
    cap[0] = -1.0
    return cap
