"""Compiled loops of the limit check; each ``.py_func`` is the plain twin that tests compare."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import AnyInts, Column, Floats, Ints, lean, njit
from energyplan.path import ROUNDING

EDGE = 1e-12  # fraction of a subinterval's middle speed that replaces zero at its edges


@njit
def cut_intervals(
    v: Column, omega: Column, left: float, right: float, first: int, last: int
) -> tuple[Ints, Floats, Floats]:
    """Cut the intervals [first, last) where v, omega or a tread's speed passes through zero."""
    interval = np.empty(5 * (last - first), np.int64)
    begin, end = np.empty(5 * (last - first)), np.empty(5 * (last - first))
    cuts = np.empty(5)
    total = 0
    for k in range(first, last):
        count = 0
        for j in range(4):
            if j == 0:
                a, b = v[k], v[k + 1]
            elif j == 1:
                a, b = omega[k], omega[k + 1]
            elif j == 2:
                a, b = v[k] - left * omega[k], v[k + 1] - left * omega[k + 1]
            else:
                a, b = v[k] + right * omega[k], v[k + 1] + right * omega[k + 1]
            if a * b < 0.0:
                part = a / (a - b)
                if ROUNDING < part < 1.0 - ROUNDING:
                    place = count  # where it comes in order
                    while place > 0 and cuts[place - 1] > part:
                        cuts[place] = cuts[place - 1]
                        place -= 1
                    cuts[place] = part
                    count += 1
        if count == 0:
            interval[total], begin[total], end[total] = k, 0.0, 1.0
            total += 1
            continue
        low = 0.0
        for j in range(count + 1):
            high = cuts[j] if j < count else 1.0
            if high - low > ROUNDING:
                interval[total], begin[total], end[total] = k, low, high
                total += 1
                low = high
        end[total - 1] = 1.0
    return interval[:total], begin[:total], end[:total]


@lean
def _onesided(value: float, middle: float) -> float:
    """Speed at the edge of a subinterval, with the direction that it has inside."""
    if value * middle < 0.0 or abs(value) < EDGE * abs(middle):
        return EDGE * middle
    return value


class Nodes(NamedTuple):
    """Motion at the begin, the middle and the end of subintervals, each of shape (m, 3)."""

    v_left: Floats  # left tread speed [m/s]
    v_right: Floats  # right tread speed [m/s]
    accel: Floats  # acceleration [m/s^2]
    yaw_accel: Floats  # yaw acceleration [rad/s^2]
    x: Floats  # x of the pose [m]
    y: Floats  # y of the pose [m]
    yaw: Floats  # heading of the pose [rad]


@njit
def piece_nodes(
    t: Column, x: Column, y: Column, yaw: Column, v: Column, omega: Column, left: float,
    right: float, interval: AnyInts, begin: Column, end: Column, scale: float,
) -> Nodes:  # fmt: skip
    """Motion at the begin, the middle and the end of subintervals, driven `scale` times as fast.

    A speed that rounding alone keeps from zero is zero. One that is zero at the edge of a
    subinterval keeps the direction that it has inside, so that friction there is as it is inside.
    """
    count = len(interval)
    v_left, v_right = np.empty((count, 3)), np.empty((count, 3))
    accel, yaw_accel = np.empty((count, 3)), np.empty((count, 3))
    px, py, heading = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    for m in range(count):
        k = interval[m]
        step, dv, dw = t[k + 1] - t[k], v[k + 1] - v[k], omega[k + 1] - omega[k]
        # What the poses differ from integrated speeds is spread over the interval.
        turn = step * (omega[k] + 0.5 * dw)
        way = step * (v[k] + 0.5 * dv)
        off = yaw[k + 1] - yaw[k] - turn
        towards = yaw[k] + 0.5 * (yaw[k + 1] - yaw[k])
        off_x = x[k + 1] - x[k] - way * np.cos(towards)
        off_y = y[k + 1] - y[k] - way * np.sin(towards)
        middle = 0.5 * (begin[m] + end[m])
        v_mid, w_mid = v[k] + dv * middle, omega[k] + dw * middle
        if abs(w_mid) * (left + right) <= ROUNDING * abs(v_mid):
            w_mid = 0.0
        left_mid, right_mid = v_mid - left * w_mid, v_mid + right * w_mid
        if abs(left_mid) <= ROUNDING * abs(right_mid):
            left_mid = 0.0
        if abs(right_mid) <= ROUNDING * abs(left_mid):
            right_mid = 0.0
        for j in range(3):
            f = begin[m] if j == 0 else (middle if j == 1 else end[m])
            speed = _onesided(v[k] + dv * f, v_mid)
            rate = 0.0 if w_mid == 0.0 else _onesided(omega[k] + dw * f, w_mid)
            a, b = speed - left * rate, speed + right * rate
            v_left[m, j] = 0.0 if left_mid == 0.0 else scale * _onesided(a, left_mid)
            v_right[m, j] = 0.0 if right_mid == 0.0 else scale * _onesided(b, right_mid)
            accel[m, j] = scale * scale * dv / step
            yaw_accel[m, j] = scale * scale * dw / step
            heading[m, j] = yaw[k] + step * f * (omega[k] + 0.5 * dw * f) + f * off
            gone = step * f * (v[k] + 0.5 * dv * f)
            toward = 0.5 * (yaw[k] + heading[m, j])
            px[m, j] = x[k] + gone * np.cos(toward) + f * off_x
            py[m, j] = y[k] + gone * np.sin(toward) + f * off_y
    return Nodes(v_left, v_right, accel, yaw_accel, px, py, heading)


@njit
def intervals(
    t: Column, value: Column, limit: float, tolerance: float
) -> tuple[Floats, Floats, Floats]:
    """Start, end and peak of each interval where `value` exceeds `limit`.

    The value runs straight between samples; `t` may hold a time twice, where it jumps. An
    interval needs a sample above ``limit + tolerance``.
    """
    size = len(t) // 2 + 1
    start, stop, peak = np.empty(size), np.empty(size), np.empty(size)
    count, inside = 0, False
    for k in range(len(t)):
        above = value[k] > limit + tolerance
        if above and not inside:
            start[count], peak[count] = t[k], value[k]
            if k > 0:
                part = (limit - value[k - 1]) / (value[k] - value[k - 1])
                start[count] = t[k - 1] + max(part, 0.0) * (t[k] - t[k - 1])
        elif above:
            peak[count] = max(peak[count], value[k])
        elif inside:
            part = (value[k - 1] - limit) / (value[k - 1] - value[k])
            stop[count] = t[k - 1] + min(part, 1.0) * (t[k] - t[k - 1])
            count += 1
        inside = above
    if inside:
        stop[count] = t[len(t) - 1]
        count += 1
    return start[:count], stop[:count], peak[:count]


@njit
def window_mean(t: Column, power: Column, window: float) -> Floats:
    """Mean power over the window that ends at each sample; before the first one it was zero."""
    mean = np.empty(len(t))
    drawn, gone, j = 0.0, 0.0, 0
    for k in range(len(t)):
        if k > 0:
            drawn += 0.5 * (power[k] + power[k - 1]) * (t[k] - t[k - 1])
        since = t[k] - window
        if since <= t[0]:
            mean[k] = drawn / window
            continue
        while t[j + 1] <= since:
            gone += 0.5 * (power[j] + power[j + 1]) * (t[j + 1] - t[j])
            j += 1
        into, step = since - t[j], t[j + 1] - t[j]
        before = gone + into * (power[j] + 0.5 * (power[j + 1] - power[j]) * into / step)
        mean[k] = (drawn - before) / window
    return mean


@njit
def shortest_window(t: Column, power: Column, budget: float) -> float:
    """Length of the shortest window, ending at a sample, in which `budget` joules are drawn.

    Infinite where the whole drive draws no more than the budget. Driven s times as fast, a drive
    whose forces do not change draws the same energy in 1/s of the time: a window of fixed length
    holds the budget first at the speed scale shortest / window.
    """
    energy = np.zeros(len(t))
    for k in range(1, len(t)):
        energy[k] = energy[k - 1] + 0.5 * (power[k] + power[k - 1]) * (t[k] - t[k - 1])
    shortest = np.inf
    j = 0
    for k in range(len(t)):
        spare = energy[k] - budget
        if spare < 0.0 or budget <= 0.0:
            continue
        while j + 1 < k and energy[j + 1] <= spare:
            j += 1
        # Solve p0 x + slope x^2 / 2 = need for the time x after sample j, free of cancellation.
        need, step = spare - energy[j], t[j + 1] - t[j]
        slope = (power[j + 1] - power[j]) / step if step > 0.0 else 0.0
        root = np.sqrt(max(power[j] ** 2 + 2.0 * slope * need, 0.0))
        into = 0.0 if need <= 0.0 else min(2.0 * need / (power[j] + root), step)
        shortest = min(shortest, t[k] - t[j] - into)
    return shortest
