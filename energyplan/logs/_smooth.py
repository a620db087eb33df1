"""Derivatives of noisy, unevenly sampled channels by local regression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from energyplan.path import FloatArray

_BLOCK = 1 << 13  # samples worked on at once, to stay in the cache


def derivative(
    t: FloatArray, values: FloatArray, runs: Sequence[slice], window: float
) -> FloatArray:
    """Rate of change by a local quadratic fit.

    Each sample's rate is that of the parabola that fits the samples of a window around it best; on
    even sampling this is the Savitzky-Golay filter of order two. At the ends of a run the window
    is shifted inwards. Windows never cross the gap between two runs.

    Source: Savitzky and Golay (1964), doi 10.1021/ac60214a047.
    """
    rate = np.zeros(len(t))
    for run in runs:
        time, value = t[run], values[run]
        count = len(time)
        if count < 3:
            if count == 2:
                rate[run] = (value[1] - value[0]) / (time[1] - time[0])
            continue
        half = max(1, round(window / 2 / float(np.median(np.diff(time)))))
        width = min(2 * half + 1, count - (count + 1) % 2)
        rate[run] = _local_rate(time, value, width)
    return rate


def _local_rate(time: FloatArray, value: FloatArray, width: int) -> FloatArray:
    """Rate at each sample from the `width` samples (an odd number) around it."""
    times, values = sliding_window_view(time, width), sliding_window_view(value, width)
    count, half = len(time), width // 2
    rate = np.empty(count)
    for start in range(0, count, _BLOCK):
        index = np.arange(start, min(start + _BLOCK, count))
        first = np.clip(index - half, 0, count - width)
        span = time[first + width - 1] - time[first]
        u = (times[first] - time[index, None]) / span[:, None]
        y = values[first] - value[index, None]
        # Normal equations of c0 + c1 u + c2 u^2; c1 by Cramer's rule.
        u2 = u * u
        s1, b0 = u.sum(axis=1), y.sum(axis=1)
        s2, s3, s4, b1, b2 = (
            np.einsum("ij,ij->i", p, q) for p, q in ((u, u), (u2, u), (u2, u2), (u, y), (u2, y))
        )
        m00, m01, m02 = width * s2 - s1 * s1, width * s3 - s1 * s2, width * s4 - s2 * s2
        r1, r2 = width * b1 - s1 * b0, width * b2 - s2 * b0
        det = m00 * m02 - m01 * m01
        # Times that all but coincide tell a slope, but no curvature.
        curved = det > 1e-12 * m00 * m02
        parabola = (r1 * m02 - r2 * m01) / np.where(curved, det, 1.0)
        rate[index] = np.where(curved, parabola, r1 / m00) / span
    return rate
