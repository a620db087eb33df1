"""Channels of different rates on one clock, with the error of doing so."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from energyplan.path import FloatArray

LONGEST_BRIDGE = 1.0
"""Longest hole in a channel that is interpolated across [s]."""


AS_LOGGED = "as logged"
"""How a channel came that is on the clock already."""


class Series(NamedTuple):
    """A channel on its own clock."""

    t: FloatArray
    values: FloatArray


class Aligned(NamedTuple):
    """A channel on another clock, NaN where it is unknown, and how it got there.

    ``error`` is the root mean square error of interpolation [the channel's unit], or None where the
    channel was averaged or its clock is the same.
    """

    values: FloatArray
    how: str
    error: float | None


def gap_limit(t: FloatArray) -> float:
    """Longest time step that still counts as continuous [s]."""
    steps = np.diff(t)
    # The lower median: of two steps, one may be the gap.
    return max(4.0 * float(np.quantile(steps, 0.5, method="lower")), 0.2)


def time_weights(t: FloatArray, runs: Iterable[slice]) -> FloatArray:
    """Return the time that each sample stands for [s]: the trapezoidal rule, gaps left out.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time [s].
    runs : iterable of slice
        Stretches without a gap.

    Returns
    -------
    ndarray, shape (n,)
        Times [s].
    """
    weights = np.zeros(len(t))
    for run in runs:
        half = 0.5 * np.diff(t[run])
        weights[run][:-1] += half
        weights[run][1:] += half
    return weights


def align(series: Series, clock: FloatArray) -> Aligned:
    """Bring a channel to another clock.

    A channel that is sampled more than one and a half times as fast is averaged over the interval
    around each instant; a slower one is linear between its samples. Holes longer than a second, or
    than four of its steps, are not bridged.

    Parameters
    ----------
    series : Series
        The channel; time increases.
    clock : ndarray, shape (n,)
        Where to evaluate it [s].

    Returns
    -------
    Aligned
        The channel on the clock.
    """
    t, values = series
    if len(t) == len(clock) and np.array_equal(t, clock):
        return Aligned(values, AS_LOGGED, None)
    if len(t) < 2:
        return Aligned(np.full(len(clock), np.nan), "sampled once", None)
    step, period = float(np.median(np.diff(t))), float(np.median(np.diff(clock)))
    after = np.clip(np.searchsorted(t, clock), 1, len(t) - 1)
    hole = t[after] - t[after - 1] > max(LONGEST_BRIDGE, gap_limit(t))
    unknown = (
        (clock < t[0]) | (clock > t[-1]) | (hole & (clock != t[after]) & (clock != t[after - 1]))
    )
    if step < period / 1.5:
        integral = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1]))])
        low = np.clip(clock - period / 2, t[0], t[-1])
        high = np.clip(clock + period / 2, t[0], t[-1])
        width = np.where(high > low, high - low, 1.0)
        found = (np.interp(high, t, integral) - np.interp(low, t, integral)) / width
        return Aligned(np.where(unknown, np.nan, found), f"averaged from {1 / step:.3g} Hz", None)
    found = np.where(unknown, np.nan, np.interp(clock, t, values))
    how = f"interpolated from {1 / step:.3g} Hz"
    return Aligned(found, how, interpolation_error(series))


def interpolation_error(series: Series) -> float:
    """Root mean square error of linear interpolation halfway between samples.

    Each sample is interpolated from its neighbours at one and at two steps. How the error shrinks
    from the one to the other, by four for a smooth channel, by less for one that jumps or is noisy,
    is carried on to half a step.
    """
    t, values = series
    if len(t) < 5:
        return float("nan")
    near, far = (_midway_error(t, values, reach) for reach in (1, 2))
    if near == 0 or far == 0:
        return 0.0
    return near / float(np.clip(far / near, 1.0, 4.0))


def _midway_error(t: FloatArray, values: FloatArray, reach: int) -> float:
    """Root mean square error of interpolating each sample from those `reach` before and after."""
    before, here, after = slice(None, -2 * reach), slice(reach, -reach), slice(2 * reach, None)
    share = (t[here] - t[before]) / (t[after] - t[before])
    guess = (1 - share) * values[before] + share * values[after]
    return float(np.sqrt(np.mean((values[here] - guess) ** 2)))
