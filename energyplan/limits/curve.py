"""Least time along a smooth curve: the controllable rates backwards, then as fast as they allow.

A curve of many short arcs is a row of points between which the speeds of both treads run straight,
exactly as a trajectory is defined (`energyplan.limits.drive`). Limits are kept cell by cell for
what happens there, so nothing is given away to the worst case of a run: a tread that has to slow
down for the curve anyway may do so while the other speeds up.

Source: Pham and Pham (2018), "A new approach to time-optimal path parameterization based on
reachability analysis".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import AnyTable, Column, njit
from energyplan.errors import InfeasibleMotionError
from energyplan.limits.acceleration_table import UNLIMITED
from energyplan.limits.motor import Limits, relative
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel

SWEEPS = 40
"""How often the accelerations within power and force are found anew at most."""

SLACK = 1e-9
"""Fraction by which a limit counts as kept."""


class Points(NamedTuple):
    """Points along a curve with the motion at unit rate, n of them; cells lie between them."""

    forward: FloatArray  # (n,)
    turn: FloatArray  # (n,)
    length: FloatArray  # (n - 1,): length of each cell along the faster tread [m]
    channels: dict[str, FloatArray]  # (n,): further channels


class Curve(NamedTuple):
    """Points along a curve with what limits the motion there."""

    points: Points  # the points, n of them
    model: PowerModel  # the power model
    limits: Limits  # the limits
    cap: FloatArray  # largest steady rate at each point, and what is asked for at both ends [m/s]

    @property
    def acceleration(self) -> float:
        """Largest acceleration of a tread [m/s^2]."""
        return min(self.limits.motor.acceleration, UNLIMITED)

    def fastest(self, cap: FloatArray) -> FloatArray:
        """Return the greatest rates within `cap` and all limits; see `fastest_along`."""
        return fastest_along(self.points, self.model, self.limits, cap, self.acceleration)


@njit
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


@njit
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
            best = -1.0
            for share in (1.0, 0.97, 0.93, 0.87, 0.8, 0.7, 0.6, 0.45, 0.3, 0.15, 0.0):
                last = share * cap[j + 1]
                # The cell driven backwards in time: falls are rises.
                found = _farthest(
                    sides[j + 1], sides[j], last, cap[j], length[j], most, down[j], up[j]
                )
                best = max(best, found)
            cap[j] = min(cap[j], best)
            if best < 0.0:
                return cap
        rate[0] = cap[0]
        stuck = -1
        for j in range(n - 1):
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


def fastest_along(
    points: Points, model: PowerModel, limits: Limits, top: FloatArray, acceleration: float
) -> FloatArray:
    """Return the greatest rates at the points within all limits [m/s].

    Power and force bound the change of the rate in a cell by the part of it that the steady motion
    leaves; forces are straight in the acceleration. What is left depends on the rates, so it is
    found anew until nothing changes.
    """
    icr = model.vehicle.icr
    sides = np.column_stack(
        [points.forward - icr.left * points.turn, points.forward + icr.right * points.turn]
    )
    count = len(points.length)
    up, down = np.full(count, 1e9), np.full(count, 1e9)
    best: FloatArray | None = None
    for _ in range(SWEEPS):
        rate = fastest_rates(sides, points.length, top, acceleration, up, down)
        if rate.min() < 0.0:
            raise InfeasibleMotionError(
                "no speed along the curve keeps all limits; it takes a wider curve or stronger "
                "motors"
            )
        gain = np.diff(rate**2) / (2 * points.length)
        share = _share(points, model, limits, rate)
        over = share < 1.0 - 1e-9
        if not over.any():
            best = rate
            loose = (share > 1.0 + 1e-3) & ((up < 1e8) | (down < 1e8))
            if not loose.any():
                return rate
        bound = np.abs(gain) * np.where(over, share * (1 - 1e-7), np.minimum(share, 1.5))
        rises = gain >= 0
        change = over | ((share > 1.0) & (np.where(rises, up, down) < 1e8))
        up = np.where(change & rises, bound, up)
        down = np.where(change & ~rises, bound, down)
    return rate if best is None else best


def _share(points: Points, model: PowerModel, limits: Limits, rate: FloatArray) -> FloatArray:
    """Share of each cell's acceleration that the limits leave; more than 1 where there is room."""
    v, omega = points.forward * rate, points.turn * rate
    step = 2 * points.length / (rate[1:] + rate[:-1])
    accel, spin = np.diff(v) / step, np.diff(omega) / step
    part = np.array([0.0, 0.5, 1.0])
    edge = np.maximum(part * (1 - 2e-9) + 1e-9, 0.0)

    known = {"slope": np.zeros(()), **{k: inside(c, edge) for k, c in points.channels.items()}}

    def values(factor: float) -> list[FloatArray]:
        motion = Motion.from_twist(
            inside(v, edge), inside(omega, edge), model.vehicle.icr,
            accel=factor * accel[:, None], yaw_accel=factor * spin[:, None], **known,
        )  # fmt: skip
        return limits.loads(model, motion).values

    share = np.full(len(step), np.inf)
    for bound, steady, now in zip(limits.bounds, values(0.0), values(1.0), strict=True):
        change = now - steady
        room = np.maximum(bound.limit - steady, 0.0)
        left = np.divide(room, change, out=np.full_like(change, np.inf), where=change > 1e-12)
        within = relative(now, bound.limit) <= 1.0
        left = np.where(within, np.maximum(left, 1.0), np.minimum(left, 1.0))
        share = np.minimum(share, left.min(axis=1))
    return share


def inside(value: FloatArray, part: FloatArray) -> FloatArray:
    """Return values at parts of each cell, straight between its ends, shape (n - 1, parts)."""
    return np.asarray(value[:-1, None] + np.diff(value)[:, None] * part)


def subdivided(low: float, high: float, step: float) -> FloatArray:
    """Return points from `low` to `high`, at most `step` apart; one where they are the same."""
    if high - low <= 1e-9 * max(abs(high), 1e-9):
        return np.array([0.5 * (low + high)])
    return np.linspace(low, high, max(int(np.ceil((high - low) / step)), 1) + 1)
