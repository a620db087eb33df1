"""Speeds from encoders that count."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from energyplan.logs._smooth import derivative
from energyplan.logs.align import gap_limit
from energyplan.path import FloatArray

TOTAL, SINCE, RATE = "ticks", "ticks/sample", "ticks/s"
"""How an encoder counts: on and on, since the row before, or in a second."""

_SIZES = (8, 16, 32)  # bits of counters that run over
_JUMP = 10.0  # times the fastest counting, from which on a counter was set back


def counting(unit: str) -> str:
    """Return how a unit counts: `TOTAL` or `SINCE`; empty where a factor is all that it takes."""
    bare = unit.lstrip("-").partition("*")[0].strip()
    return bare if bare in (TOTAL, SINCE) else ""


def count_rate(t: FloatArray, counts: FloatArray, unit: str) -> FloatArray:
    """Return how fast an encoder counts.

    A counter that runs over at 8, 16 or 32 bits counts on; one that is set back begins anew.
    """
    rate = np.full(len(t), np.nan)
    rows = np.flatnonzero(np.isfinite(t) & np.isfinite(counts))
    if not len(rows):
        return rate
    if len(rows) > 1 and np.mean(np.diff(t[rows]) < 0) > 0.5:  # newest first
        rows = rows[::-1]
    known = counts[rows]
    total = np.cumsum(known) if unit == SINCE else _unrolled(known)
    time = t[rows]
    # Rows of one time are one reading, the last of them.
    last = np.append(time[1:] != time[:-1], True)
    rate[rows] = _slopes(time[last], total[last])[np.cumsum(np.append(0, last[:-1]))]
    return rate


def _unrolled(counts: FloatArray) -> FloatArray:
    """Count on where a counter ran over."""
    steps = np.abs(np.diff(counts))
    low, high = float(np.min(counts)), float(np.max(counts))
    for bits in _SIZES:
        whole = 2.0**bits
        inside = (low >= 0 and high < whole) or (low >= -whole / 2 and high < whole / 2)
        if inside:
            over = steps > 0.75 * whole
            return np.unwrap(counts, period=whole) if over.any() else counts
    return counts


def _slopes(t: FloatArray, total: FloatArray) -> FloatArray:
    """Differentiate between the places where time or the counter breaks off."""
    if len(t) < 2:
        return np.zeros(len(t))
    step, count = np.diff(t), np.abs(np.diff(total))
    forward = step > 0
    if not forward.any():
        return np.zeros(len(t))
    speed = np.divide(count, step, out=np.zeros(len(step)), where=forward)
    counted = speed[speed > 0]
    fastest = float(np.quantile(counted, 0.9)) if len(counted) else 0.0
    broken: NDArray[np.bool_] = ~forward | (step > gap_limit(t)) | (speed > _JUMP * fastest)
    edges = [0, *(np.flatnonzero(broken) + 1).tolist(), len(t)]
    return derivative(t, total, [slice(a, b) for a, b in pairwise(edges)], 0.0)
