"""Channels of different rates on one clock, with the error of doing so; means, shifts, blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    """Return the time that each sample stands for [s]: the trapezoidal rule, gaps left out."""
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


class Means(NamedTuple):
    """Means by channel, and how many samples lie behind the last whole interval of their run."""

    channels: dict[str, FloatArray]
    unused: int


def interval_means(
    t: FloatArray, channels: Mapping[str, FloatArray], runs: Sequence[slice], period: float
) -> Means:
    """Mean of each channel over successive intervals of each run.

    Channels count as linear between samples, so that an interval's mean is exact even where its
    ends fall between two of them.
    """
    unused = 0
    means: dict[str, list[FloatArray]] = {name: [] for name in channels}
    for run in runs:
        time = t[run]
        count = int((time[-1] - time[0]) / period * (1 + 1e-12))
        edges = time[0] + period * np.arange(count + 1)
        edges[-1] = min(edges[-1], time[-1])
        unused += int(np.count_nonzero(time > edges[-1] + 1e-9 * period))
        grid = np.union1d(time, edges)
        at = np.searchsorted(grid, edges)
        half = 0.5 * np.diff(grid)
        for name, values in channels.items():
            y = values[run] - values[run][0]  # small numbers sum more exactly
            y = np.interp(grid, time, y)
            integral = np.concatenate([[0.0], np.cumsum(half * (y[1:] + y[:-1]))])
            means[name].append(values[run][0] + np.diff(integral[at]) / np.diff(edges))
    return Means({name: np.concatenate(parts) for name, parts in means.items()}, unused)


def shift(
    t: FloatArray, values: FloatArray, runs: Sequence[slice], seconds: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Move a channel by `seconds`, later where positive."""
    moved, known = np.zeros(len(t)), np.zeros(len(t), bool)
    for run in runs:
        source = t[run] - seconds
        moved[run] = np.interp(source, t[run], values[run])
        # Rounding must not cost the sample that falls on the run's very end.
        slack = 1e-9 * (1.0 + abs(float(t[run][-1])))
        known[run] = (source >= t[run][0] - slack) & (source <= t[run][-1] + slack)
    return moved, known


def block_bounds(t: FloatArray, runs: Sequence[slice], duration: float) -> list[int]:
    """First samples of blocks of about a duration [s], none across a gap, and the last one's end.

    A sample alone between two gaps joins the block before it.
    """
    bounds = [0]
    for run in runs:
        if run.stop - run.start < 2:
            continue
        if len(bounds) > 1:
            bounds[-1] = run.start
        time = t[run]
        count = max(1, round(float(time[-1] - time[0]) / duration))
        edges = np.linspace(time[0], time[-1], count + 1)[1:-1]
        for cut in run.start + np.searchsorted(time, edges):
            if cut - bounds[-1] >= 2 and run.stop - cut >= 2:
                bounds.append(int(cut))
        bounds.append(run.stop)
    return [*bounds[: max(1, len(bounds) - 1)], len(t)]
