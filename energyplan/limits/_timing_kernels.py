"""Compiled loops that lay phases of constant acceleration; ``.py_func`` is the plain twin.

All rates are squared here, so that they are piecewise linear in distance. A table has one column
per run and one row per rung of its ladder.
"""

from __future__ import annotations

import numpy as np

from energyplan.compilation import njit
from energyplan.compilation.arrays import AnyTable, Column, Floats, FloatTable, Ints


@njit
def interpolate(x: float, known: Column, value: Column) -> float:
    """Value at `x` of the piecewise linear function through the non-decreasing `known`."""
    low, high = 0, len(known) - 1
    if x <= known[low]:
        return float(value[low])
    if x >= known[high]:
        return float(value[high])
    while high - low > 1:
        middle = (low + high) // 2
        if known[middle] <= x:
            low = middle
        else:
            high = middle
    part = (x - known[low]) / (known[high] - known[low])
    return float(value[low] + part * (value[high] - value[low]))


@njit
def limit_corners(
    square: AnyTable,
    climb: AnyTable,
    descent: AnyTable,
    length: Column,
    nodes: Floats,
) -> None:
    """Lower the rates at the corners to what can be reached: a pass forwards, one backwards."""
    for k in range(len(length)):
        if nodes[k + 1] > 0.0:
            start = interpolate(nodes[k], square[:, k], climb[:, k])
            reach = interpolate(start + length[k], climb[:, k], square[:, k])
            nodes[k + 1] = min(nodes[k + 1], reach)
    for k in range(len(length) - 1, -1, -1):
        if nodes[k] > 0.0:
            stop = interpolate(nodes[k + 1], square[:, k], descent[:, k])
            reach = interpolate(stop + length[k], descent[:, k], square[:, k])
            nodes[k] = min(nodes[k], reach)


@njit
def ramp(
    square: Column, gain: Column, first: float, last: float, out: FloatTable, count: int
) -> int:
    """Append the phases from rate `first` to `last`; columns distance, rate, gain, time.

    Rising rates use `gain` as it is, falling ones its negative. Neighbouring rungs of equal
    acceleration are one phase. Returns the new count.
    """
    rungs = len(gain)
    falling = last < first
    x = first
    for step in range(rungs):
        j = rungs - 1 - step if falling else step
        if falling:
            goal = max(square[j], last)
            if goal >= x:
                continue
        else:
            goal = min(square[j + 1], last)
            if goal <= x:
                continue
        a = -gain[j] if falling else gain[j]
        before, after = np.sqrt(x), np.sqrt(goal)
        distance, time = (goal - x) / (2.0 * a), (after - before) / a
        x = goal
        if count > 0 and abs(out[2, count - 1] - a) <= 1e-9 * abs(a):
            out[0, count - 1] += distance
            out[3, count - 1] += time
        else:
            out[0, count], out[1, count] = distance, before
            out[2, count], out[3, count] = a, time
            count += 1
    return count


@njit
def lay_run(
    square: Column,
    up: Column,
    down: Column,
    climb: Column,
    descent: Column,
    length: float,
    first: float,
    last: float,
    cruise: float,
    out: FloatTable,
) -> int:
    """Lay one run from rate `first` over `cruise` to `last`; returns the number of phases."""
    begin = interpolate(first, square, climb)
    end = interpolate(last, square, descent)
    peak = min(interpolate(length + begin + end, climb + descent, square), cruise)
    count = 0
    for _ in range(2):
        middle = ramp(square, up if peak >= first else down, first, peak, out, 0)
        used = out[0, :middle].sum()
        out[0, middle], out[1, middle] = 0.0, np.sqrt(peak)
        out[2, middle], out[3, middle] = 0.0, 0.0
        count = ramp(square, down if peak >= last else up, peak, last, out, middle + 1)
        used += out[0, middle + 1 : count].sum()
        if used <= length * (1.0 + 1e-9):
            break
        # Too short to slow down to the cruising rate in between.
        peak = max(first, last)
    rest = max(length - used, 0.0)
    if rest > 0.0:
        out[0, middle], out[3, middle] = rest, rest / np.sqrt(peak)
    return count


@njit
def lay_phases(
    square: AnyTable,
    up: AnyTable,
    down: AnyTable,
    climb: AnyTable,
    descent: AnyTable,
    length: Column,
    nodes: Column,
    cruise: Column,
) -> tuple[Ints, FloatTable]:
    """Run, and rows at, rate, gain and time, of every phase of every run."""
    runs, most = len(length), 2 * up.shape[0] + 1
    run = np.empty(runs * most, np.int64)
    rows = np.empty((4, runs * most))
    buffer = np.empty((4, most))
    total = 0
    for k in range(runs):
        count = lay_run(
            square[:, k], up[:, k], down[:, k], climb[:, k], descent[:, k],
            length[k], nodes[k], nodes[k + 1], cruise[k], buffer,
        )  # fmt: skip
        at = 0.0
        for i in range(count):
            if buffer[3, i] > 1e-12:
                run[total] = k
                rows[0, total] = at
                rows[1:, total] = buffer[1:, i]
                total += 1
            at += buffer[0, i]
    return run[:total].copy(), rows[:, :total].copy()
