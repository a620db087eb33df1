"""The greatest rates along a path: reachability over its points, which serves every limit.

Each point has a largest steady rate. A pass backwards lowers it to what the next point can be
reached from, a pass forwards drives as fast as that allows. How fast a rate may change is known for
each motion and each rate, by the power model of the ground there, so nothing is given away to the
worst case of a run: a tread that has to slow down for a curve anyway may do so while the other
speeds up.

Source: Pham and Pham (2018), "A new approach to time-optimal path parameterization based on
reachability analysis".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.compilation import AnyTable, Column, Floats, FloatTable, Ints, lean, njit
from energyplan.errors import InfeasibleMotionError, InvalidInputError
from energyplan.limits.course import SETTINGS, Course, Points, Sampled, times
from energyplan.limits.drive import Ground, Traversal
from energyplan.limits.feasibility import LimitedDrive, Survey
from energyplan.limits.motor import Limits, Room, largest_within
from energyplan.motion import Motion
from energyplan.path import ROUNDING, FloatArray, wrap_angle
from energyplan.power import PowerModel
from energyplan.power.effects import reads_heading

UNLIMITED = 1e6  # tread acceleration where no limit is known [m/s^2]: in effect a step
UNBOUND = 1e9  # rate of change of the rate that no limit of power or force has lowered yet [m/s^2]

STANDSTILL = 1e-6
"""Fraction of the largest rate that is treated as zero, where friction has no direction [1]."""


class Changes(NamedTuple):
    """Largest changes of the rate within limits of power and force, times the rate [m^2/s^3]."""

    up: FloatTable  # (n, rungs + 1): for n steady motions at equally spaced rates
    down: FloatTable  # the same where the rate falls
    scale: Floats  # (n,): rungs over the largest rate [s/m]
    kind: Ints  # which of the motions each point has


@dataclass(frozen=True)
class Steady:
    """Steady motions at unit rate, n of them: the points of a path without doubles."""

    ground: Ground
    region: NDArray[np.intp]  # (n,): index of the power model among the ground's models
    forward: FloatArray  # (n,): speed along the heading [1]
    turn: FloatArray  # (n,): yaw rate [1/m]
    channels: Mapping[str, FloatArray]  # (n,): further channels

    def evaluate(
        self,
        function: Callable[[PowerModel, Motion], FloatArray],
        rate: FloatArray,
        gain: FloatArray | None = None,
    ) -> FloatArray:
        """Return a function's values at rates of shape (..., n), each by its own power model.

        `gain` is the change of the rates [m/s^2]; steady where not given.
        """
        out = np.empty(np.shape(rate))
        for here, model, motion in self._motions(rate, gain):
            out[..., here] = function(model, motion)
        return out

    def _motions(
        self, rate: FloatArray, gain: FloatArray | None = None
    ) -> Iterator[tuple[NDArray[np.bool_], PowerModel, Motion]]:
        """Yield the motions of each power model, and which they are."""
        gain = np.zeros_like(rate) if gain is None else gain
        for region in np.unique(self.region):
            here, model = self.region == region, self.ground.models[int(region)]
            forward, turn = self.forward[here], self.turn[here]
            known = {name: value[here] for name, value in self.channels.items()}
            yield here, model, Motion.from_twist(
                forward * rate[..., here], turn * rate[..., here], model.vehicle.icr,
                accel=forward * gain[..., here], yaw_accel=turn * gain[..., here], **known,
            )  # fmt: skip

    def top_rate(self, limits: Limits) -> FloatArray:
        """Largest rate up to which every steady rate is within the limits."""
        bounds = (
            np.full_like(self.turn, limits.motor.speed),
            over(limits.yaw_rate, np.abs(self.turn)),
            np.sqrt(over(limits.lateral_acceleration, np.abs(self.forward * self.turn))),
        )
        top = np.min(bounds, axis=0)
        if np.any(top == 0):
            k = int(np.argmin(top))
            raise InfeasibleMotionError(f"{self._place(k)} a limit of 0 forbids any speed")

        def use(rate: FloatArray) -> FloatArray:
            return self.evaluate(limits.use, rate)

        free = ~np.isfinite(top)
        top = np.where(free, 1.0, top)
        while np.any(growing := free & (use(top) <= 1.0)):
            if top.max() > 1e3:
                raise InvalidInputError(
                    "nothing limits the speed; give the vehicle's motor a speed or a power limit, "
                    "such as a speed of 1.5 m/s"
                )
            top = np.where(growing, 2 * top, top)
        rate = largest_within(use, top)
        if np.any(rate == 0):
            raise InfeasibleMotionError(self._why_not(limits, int(np.argmin(rate)), 1e-6 * top))
        return rate

    def _why_not(self, limits: Limits, k: int, rate: FloatArray) -> str:
        exceeded = []
        for here, model, motion in self._motions(rate):
            if here[k]:
                place, values = np.count_nonzero(here[:k]), limits.loads(model, motion).values
                exceeded = [
                    bound.describe(value[place])
                    for bound, value in zip(limits.bounds, values, strict=True)
                    if value[place] > bound.limit
                ]
        return (
            f"{self._place(k)} no speed is feasible: {'; '.join(exceeded)}. It takes another path, "
            "less load, other ground or stronger motors"
        )

    def _place(self, k: int) -> str:
        if self.forward[k] == 0:
            return "while spinning on the spot"
        return f"at curvature {self.turn[k] / self.forward[k]:.4g} 1/m"


@dataclass(frozen=True)
class Reach:
    """Points along a path with what limits the motion there."""

    course: Course
    points: Points
    ground: Ground
    limits: Limits
    corner: FloatArray  # (n,): largest rate for other reasons, such as a stop [m/s]
    channels: Mapping[str, FloatArray]  # those of the path's runs that power terms read
    period: float  # largest time between two samples [s]

    def sampled(self, rate: FloatArray) -> Sampled:
        """Return the trajectory that passes the points at given rates."""
        return self.course.timed(self.points, rate, self.period)

    def _drive(self, rate: FloatArray) -> Traversal:
        trajectory, run = self.sampled(rate)
        along = {name: value[run] for name, value in self.channels.items()}
        return Traversal(trajectory, self.ground, along)

    def survey(self, rate: FloatArray) -> Survey:
        """Hold the trajectory of given rates against every limit."""
        return LimitedDrive(self._drive(rate), self.limits).survey()

    @cached_property
    def _steady(self) -> tuple[Steady, NDArray[np.intp]]:
        """Motions at the points, without doubles, and which of them each point has."""
        points = self.points
        poses = self.course.poses(points.run, points.at)
        region, slope = self.ground.regions(poses), self.ground.slopes(poses)
        known = {"slope": slope}
        known |= {name: value[points.run] for name, value in self.channels.items()}
        given = {name: float(value[0]) for name, value in known.items()}
        if "yaw" not in known and any(reads_heading(one, given) for one in self.ground.models):
            known["yaw"] = wrap_angle(poses[:, 2])
        forward = points.forward / np.cos(slope) if self.ground.heights else points.forward
        table = np.column_stack([region, forward, points.turn, *known.values()])
        _, first, kind = np.unique(table.round(9), axis=0, return_index=True, return_inverse=True)
        known = {name: value[first] for name, value in known.items()}
        motions = Steady(self.ground, region[first], forward[first], points.turn[first], known)
        return motions, kind.reshape(-1)

    @cached_property
    def _top(self) -> FloatArray:
        """Largest rate of each steady motion [m/s]."""
        return self._steady[0].top_rate(self.limits)

    @cached_property
    def top(self) -> FloatArray:
        """Largest rate at each point [m/s]."""
        return np.asarray(np.minimum(self._top[self._steady[1]], self.corner))

    @cached_property
    def _powers(self) -> tuple[FloatArray, FloatArray]:
        """Rates of each steady motion [m/s] and the power at them [W], shape (rungs, n)."""
        rate = self._top * np.linspace(0.0, 1.0, SETTINGS.rungs + 1)[1:, None]
        return rate, self._steady[0].evaluate(PowerModel.power, rate)

    def cheapest(self, price: float, slowest: float) -> FloatArray:
        """Rates of least energy, plus `price` [W] times time, per distance [m/s]."""
        rate, power = self._powers
        cost = (power + price) / rate
        allowed = rate >= np.minimum(slowest, rate[-1])
        least = np.min(cost, axis=0, where=allowed, initial=np.inf)
        allowed &= cost <= least + ROUNDING * np.abs(cost).max(axis=0)
        best = len(rate) - 1 - np.argmax(allowed[::-1], axis=0)
        cheap = rate[best, np.arange(rate.shape[1])]
        return np.asarray(np.minimum(cheap[self._steady[1]], self.corner))

    @cached_property
    def _changes(self) -> Changes:
        """Changes of the rate that the limits allow at rates of each steady motion."""
        rate = np.vstack([STANDSTILL * self._top, self._powers[0][3::4]])

        def share_of(model: PowerModel, motion: Motion) -> FloatArray:
            return self.limits.room(model, motion).share

        def most(sign: float) -> FloatArray:
            gain = np.full_like(rate, self._acceleration)
            # loads grow between straight and squared: from above, then from below
            for power in (0.5, 0.5, 0.5, 0.5, 1.0):
                share = self._steady[0].evaluate(share_of, rate, sign * gain)
                if np.all(share >= 1.0):
                    break
                gain = np.minimum(gain * np.maximum(share, 0.0) ** power, self._acceleration)
                gain = np.maximum(gain, ROUNDING)
            return np.ascontiguousarray((gain * rate).T)

        return Changes(most(1.0), most(-1.0), (len(rate) - 1) / self._top, self._steady[1])

    @property
    def _acceleration(self) -> float:
        return min(self.limits.motor.acceleration, UNLIMITED)

    def fastest(self, cap: FloatArray) -> FloatArray:
        """Return the greatest rates within `cap` and all limits [m/s].

        They are timed, and every limit is tested at the samples by the power model of the ground
        there. Where a steady motion exceeds it too, the rates are lowered; elsewhere their change
        is, until nothing is exceeded.
        """
        points, icr = self.points, self.ground.model.vehicle.icr
        sides = np.column_stack(
            [points.forward - icr.left * points.turn, points.forward + icr.right * points.turn]
        )
        cap, (up, down) = cap.copy(), np.full((2, len(points.cell)), UNBOUND)
        for _ in range(SETTINGS.sweeps):
            rate = fastest_rates(
                sides, points.cell, cap, self._acceleration, up, down, self._changes
            )
            if rate.min() < 0.0:
                raise InfeasibleMotionError(
                    "no speed along the curve keeps all limits; it takes a wider curve or stronger "
                    "motors"
                )
            share, scale = self._room(rate)
            if np.all(share >= 1.0):
                break
            slower = (share < 0.0) | ((share < 1.0) & points.bent)
            for side in (slice(None, -1), slice(1, None)):
                lower = np.minimum(cap[side], rate[side] * scale)
                cap[side] = np.where(slower, lower, cap[side])
            gain = over(np.diff(rate**2), 2 * points.cell)
            gentler = (share < 1.0) & ~slower
            bound = np.abs(gain) * np.where(gentler, share, 1.0) * (1.0 - ROUNDING)
            up = np.where(gentler & (gain >= 0), np.minimum(up, bound), up)
            down = np.where(gentler & (gain < 0), np.minimum(down, bound), down)
        return rate

    def _room(self, rate: FloatArray) -> Room:
        """Return what the limits leave in each cell: the least of all samples in it."""
        drive = self._drive(rate)
        begin, end, share, scale = [], [], [], []
        for k in range(drive.block_count):
            pieces = drive.pieces(k)
            t = drive.times(pieces)
            found = Room(np.empty_like(t), np.empty_like(t))
            for part in drive.parts(pieces):
                room = self.limits.room(part.model, part.motion)
                found.share[part.which], found.scale[part.which] = room
            if drive.ground.has_speed_limits:
                speed, limit = drive.speeds(pieces), drive.speed_limits(pieces)
                fast = speed > limit * (1.0 + ROUNDING)
                found.share[fast] = -1.0
                found.scale[fast] = np.minimum(found.scale[fast], limit[fast] / speed[fast])
            begin.append(t[:, 0])
            end.append(t[:, 2])
            share.append(found.share.min(axis=1))
            scale.append(found.scale.min(axis=1))
        step = times(self.points.cell, rate)
        clock = np.append(0.0, np.cumsum(step))
        first = np.searchsorted(np.concatenate(end), clock[:-1] + 1e-6 * step, side="right")
        last = np.searchsorted(np.concatenate(begin), clock[1:] - 1e-6 * step)
        place = np.column_stack([first, np.maximum(last, first + 1)]).reshape(-1)

        def least(values: list[FloatArray], still: float) -> FloatArray:
            found = np.minimum.reduceat(np.concatenate([*values, [np.inf]]), place)[::2]
            return np.where(step > 0, found, still)

        return Room(least(share, np.inf), least(scale, 1.0))


def over(limit: ArrayLike, value: FloatArray) -> FloatArray:
    """Return a limit over a value; infinite where there is nothing to limit."""
    return np.divide(limit, value, out=np.full_like(value, np.inf), where=value > 0)


@lean
def _kept(
    before: Column, after: Column, first: float, last: float,
    length: float, most: float, up: float, down: float,
) -> bool:  # fmt: skip
    """Whether a cell driven from rate `first` to `last` keeps all accelerations."""
    gain = (last * last - first * first) / (2.0 * length)
    if gain > up + ROUNDING * (1.0 + up) or gain < -down - ROUNDING * (1.0 + down):
        return False
    for side in range(2):
        change = (after[side] * last - before[side] * first) * (first + last) / (2.0 * length)
        if abs(change) > most * (1.0 + ROUNDING):
            return False
    return True


@lean
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


@lean
def _allowed(table: FloatTable, scale: Floats, kind: int, rate: float) -> float:
    """Largest change of a rate that a table of products allows for one of the motions."""
    rungs = table.shape[1] - 1
    place = min(rate * scale[kind], float(rungs))
    rung = min(int(place), rungs - 1)
    step = table[kind, rung + 1] - table[kind, rung]
    product: float = table[kind, rung] + (place - rung) * step
    slowest: float = STANDSTILL * rungs / scale[kind]
    return product / max(rate, slowest)


@lean
def _farthest_allowed(
    before: Column, after: Column, first: float, cap: float, length: float, most: float,
    up: float, down: float, rises: FloatTable, falls: FloatTable, scale: Floats, here: int,
    there: int,
) -> float:  # fmt: skip
    """Return `_farthest` within the changes that tables allow at both ends of the cell."""
    up = min(up, _allowed(rises, scale, here, first))
    down = min(down, _allowed(falls, scale, here, first))
    last = _farthest(before, after, first, cap, length, most, up, down)
    gain = (last * last - first * first) / (2.0 * length)
    if last < 0.0 or gain <= _allowed(rises, scale, there, last) * (1.0 + ROUNDING) + ROUNDING:
        if -gain > _allowed(falls, scale, there, last) * (1.0 + ROUNDING) + ROUNDING:
            return -1.0
        return last
    low, high = first, last
    while high - low > ROUNDING * high:
        last = 0.5 * (low + high)
        gain = (last * last - first * first) / (2.0 * length)
        if gain <= _allowed(rises, scale, there, last):
            low = last
        else:
            high = last
    return low if _kept(before, after, first, low, length, most, up, down) else -1.0


@njit
def fastest_rates(
    sides: AnyTable, length: Column, top: Column, most: float, up: Column, down: Column,
    changes: Changes,
) -> FloatArray:  # fmt: skip
    """Greatest rates at the points, within `top`; negative at a point that cannot be passed."""
    n, rises, falls = len(top), changes.up, changes.down
    scale, kind = changes.scale, changes.kind
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
                found = _farthest_allowed(
                    sides[j + 1], sides[j], last, cap[j], length[j], most, down[j], up[j],
                    falls, rises, scale, kind[j + 1], kind[j],
                )  # fmt: skip
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
            found = _farthest_allowed(
                sides[j], sides[j + 1], rate[j], cap[j + 1], length[j], most, up[j], down[j],
                rises, falls, scale, kind[j], kind[j + 1],
            )  # fmt: skip
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
