"""Compiled loops of the limit check; each ``.py_func`` is the plain twin that tests compare."""

from __future__ import annotations

import numpy as np

from energyplan.compilation import njit
from energyplan.path import FloatArray


@njit
def tread_motion(
    t: FloatArray,
    v: FloatArray,
    omega: FloatArray,
    left: float,
    right: float,
    first: int,
    last: int,
    scale: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Tread speeds, acceleration and yaw acceleration of samples [first, last) in one pass.

    The same numbers as `Motion.from_trajectory` gives for the trajectory driven `scale` times as
    fast (second-order differences, one-sided at the two ends), for a slice that knows its
    neighbours.
    """
    count, end = last - first, len(t) - 1
    v_left, v_right = np.empty(count), np.empty(count)
    accel, yaw_accel = np.empty(count), np.empty(count)
    for k in range(first, last):
        i = k - first
        v_left[i] = scale * (v[k] - left * omega[k])
        v_right[i] = scale * (v[k] + right * omega[k])
        before, after = max(k - 1, 0), min(k + 1, end)
        if before == k or after == k:
            a = 0.0 if before == k else 1.0
            b = 1.0 - a
        else:
            b = (t[k] - t[before]) / (t[after] - t[before])
            a = 1.0 - b
        dv, dw = 0.0, 0.0
        if a > 0.0:
            step = t[k] - t[before]
            dv += a * (v[k] - v[before]) / step
            dw += a * (omega[k] - omega[before]) / step
        if b > 0.0:
            step = t[after] - t[k]
            dv += b * (v[after] - v[k]) / step
            dw += b * (omega[after] - omega[k]) / step
        accel[i] = scale * scale * dv
        yaw_accel[i] = scale * scale * dw
    return v_left, v_right, accel, yaw_accel


@njit
def intervals(
    t: FloatArray, value: FloatArray, limit: float, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Start, end, peak and time of the peak of each interval where `value` exceeds `limit`.

    The value runs straight between samples; `t` may hold a time twice, where it jumps. An
    interval needs a sample above ``limit + tolerance``.
    """
    size = len(t) // 2 + 1
    start, stop, peak, when = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    count, inside = 0, False
    for k in range(len(t)):
        above = value[k] > limit + tolerance
        if above and not inside:
            start[count], peak[count], when[count] = t[k], value[k], t[k]
            if k > 0:
                part = (limit - value[k - 1]) / (value[k] - value[k - 1])
                start[count] = t[k - 1] + max(part, 0.0) * (t[k] - t[k - 1])
        elif above and value[k] > peak[count]:
            peak[count], when[count] = value[k], t[k]
        elif inside and not above:
            part = (value[k - 1] - limit) / (value[k - 1] - value[k])
            stop[count] = t[k - 1] + min(part, 1.0) * (t[k] - t[k - 1])
            count += 1
        inside = above
    if inside:
        stop[count] = t[len(t) - 1]
        count += 1
    return start[:count], stop[:count], peak[:count], when[:count]


@njit
def energy_drawn(t: FloatArray, power: FloatArray) -> FloatArray:
    """Energy drawn up to each sample, where `power` runs straight between samples."""
    energy = np.zeros(len(t))
    for k in range(1, len(t)):
        energy[k] = energy[k - 1] + 0.5 * (power[k] + power[k - 1]) * (t[k] - t[k - 1])
    return energy


@njit
def window_mean(t: FloatArray, power: FloatArray, window: float) -> FloatArray:
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
def shortest_window(t: FloatArray, power: FloatArray, budget: float) -> float:
    """Length of the shortest window, ending at a sample, in which `budget` joules are drawn.

    Infinite where the whole drive draws no more than the budget. Driven s times as fast, a drive
    whose forces do not change draws the same energy in 1/s of the time: a window of fixed length
    holds the budget first at the speed scale shortest / window.
    """
    energy = energy_drawn(t, power)
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
        slope = (power[j + 1] - power[j]) / step
        root = np.sqrt(max(power[j] ** 2 + 2.0 * slope * need, 0.0))
        into = 0.0 if need <= 0.0 else min(2.0 * need / (power[j] + root), step)
        shortest = min(shortest, t[k] - t[j] - into)
    return shortest
