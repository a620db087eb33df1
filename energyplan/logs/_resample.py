"""Channels on another clock: means over intervals, and shifts in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.path import FloatArray


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

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time [s].
    channels : mapping of str to ndarray, shape (n,)
        The channels, ``t`` among them: its mean is the interval's centre.
    runs : sequence of slice
        Stretches without a gap.
    period : float
        Length of an interval [s].

    Returns
    -------
    Means
        The means, arrays of shape (m,), and the count of samples that entered none.
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
    """Move a channel by `seconds`, later where positive.

    Returns
    -------
    ndarray, shape (n,)
        The channel, linear between samples.
    ndarray of bool, shape (n,)
        Where it is known: inside the moved runs.
    """
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
