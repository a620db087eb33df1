"""Channels of different rates on one clock: interpolation, means, shifts, derivatives, blocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
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


def usable_rows(series: Series) -> NDArray[np.bool_]:
    """Return which readings are numbers, and later than the number before."""
    known = np.isfinite(series.t) & np.isfinite(series.values)
    rows = np.flatnonzero(known)
    known[rows[1:][np.diff(series.t[rows]) <= 0]] = False
    return known


def usable(series: Series) -> Series:
    """Return the readings that are numbers, and later than the number before."""
    known = usable_rows(series)
    return Series(series.t[known], series.values[known])


class Aligned(NamedTuple):
    """A channel on another clock, NaN where it is unknown, and how it got there."""

    values: FloatArray
    how: str


def gap_limit(t: FloatArray) -> float:
    """Longest time step that still counts as continuous [s]."""
    steps = np.diff(t)
    # The lower median: of two steps, one may be the gap.
    return max(4.0 * float(np.quantile(steps, 0.5, method="lower")), 0.2)


def find_runs(t: FloatArray) -> list[slice]:
    """Stretches of samples without a gap."""
    cuts = np.flatnonzero(np.diff(t) > gap_limit(t)) + 1
    bounds = [0, *(int(cut) for cut in cuts), len(t)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def time_weights(t: FloatArray, runs: Iterable[slice]) -> FloatArray:
    """Return the time that each sample stands for [s]: the trapezoidal rule, gaps left out."""
    weights = np.zeros(len(t))
    for run in runs:
        half = 0.5 * np.diff(t[run])
        weights[run][:-1] += half
        weights[run][1:] += half
    return weights


def integral(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integral up to each sample: the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1]))])


def align(series: Series, clock: FloatArray) -> Aligned:
    """Bring a channel to another clock."""
    t, values = series
    if len(t) == len(clock) and np.array_equal(t, clock):
        return Aligned(values, AS_LOGGED)
    if len(t) < 2:
        return Aligned(np.full(len(clock), np.nan), "sampled once")
    step, period = float(np.median(np.diff(t))), float(np.median(np.diff(clock)))
    after = np.clip(np.searchsorted(t, clock), 1, len(t) - 1)
    hole = t[after] - t[after - 1] > max(LONGEST_BRIDGE, gap_limit(t))
    unknown = (
        (clock < t[0]) | (clock > t[-1]) | (hole & (clock != t[after]) & (clock != t[after - 1]))
    )
    if step < period / 1.5:
        total = integral(t, values)
        low = np.clip(clock - period / 2, t[0], t[-1])
        high = np.clip(clock + period / 2, t[0], t[-1])
        width = np.where(high > low, high - low, 1.0)
        found = (np.interp(high, t, total) - np.interp(low, t, total)) / width
        return Aligned(np.where(unknown, np.nan, found), f"averaged from {1 / step:.3g} Hz")
    found = np.where(unknown, np.nan, np.interp(clock, t, values))
    return Aligned(found, f"interpolated from {1 / step:.3g} Hz")


class Means(NamedTuple):
    """Means by channel, and how many samples lie behind the last whole interval of their run."""

    channels: dict[str, FloatArray]
    unused: int


def at_common_times(one: Series, other: Series) -> tuple[FloatArray, FloatArray]:
    """Return two channels at the times of the one that is read less often, where both are known."""
    pair = usable(one), usable(other)
    if min(len(part.t) for part in pair) < 2:
        return np.zeros(0), np.zeros(0)
    clock = max(pair, key=lambda part: float(np.median(np.diff(part.t)))).t
    first, second = (align(part, clock).values for part in pair)
    both = np.isfinite(first) & np.isfinite(second)
    return first[both], second[both]


def interval_means(
    t: FloatArray, channels: Mapping[str, FloatArray], runs: Sequence[slice], period: float
) -> Means:
    """Mean of each channel over successive intervals of each run."""
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
    """First samples of blocks of about a duration [s], none across a gap, and the end."""
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


class DerivativeSizes(NamedTuple):
    """How a derivative is computed quickly."""

    block: int = 1 << 13  # samples worked on at once, to stay in the cache
    wide: int = 129  # samples of a window from which running sums are quicker


_SIZES = DerivativeSizes()


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
    count, half = len(time), width // 2
    rate = np.empty(count)
    wide = width > _SIZES.wide
    block = max(width, 1 << 10) if wide else _SIZES.block
    for start in range(0, count, block):
        index = np.arange(start, min(start + block, count))
        first = np.clip(index - half, 0, count - width)
        if wide:
            part = slice(int(first[0]), int(first[-1]) + width)
            span = np.full(len(index), time[part][-1] - time[part][0])
            one = (time[part] - time[start]) / span[0]
            sums = _running_sums(one, value[part] - value[start], first - part.start, width,
                                 index - part.start)  # fmt: skip
        else:
            times, values = sliding_window_view(time, width), sliding_window_view(value, width)
            span = time[first + width - 1] - time[first]
            u = (times[first] - time[index, None]) / span[:, None]
            y = values[first] - value[index, None]
            u2 = u * u
            sums = [u.sum(axis=1), *(
                np.einsum("ij,ij->i", p, q) for p, q in ((u, u), (u2, u), (u2, u2))
            ), y.sum(axis=1), *(np.einsum("ij,ij->i", p, y) for p in (u, u2))]  # fmt: skip
        # Normal equations of c0 + c1 u + c2 u^2; c1 by Cramer's rule.
        s1, s2, s3, s4, b0, b1, b2 = sums
        m00, m01, m02 = width * s2 - s1 * s1, width * s3 - s1 * s2, width * s4 - s2 * s2
        r1, r2 = width * b1 - s1 * b0, width * b2 - s2 * b0
        det = m00 * m02 - m01 * m01
        # Times that all but coincide show a slope, but no curvature.
        curved = det > 1e-12 * m00 * m02
        parabola = (r1 * m02 - r2 * m01) / np.where(curved, det, 1.0)
        rate[index] = np.where(curved, parabola, r1 / m00) / span
    return rate


def _running_sums(
    u: FloatArray, y: FloatArray, first: NDArray[np.intp], width: int, at: NDArray[np.intp]
) -> list[FloatArray]:
    """Return sums over windows of powers of the times since a sample, and of those by readings."""
    parts = np.stack([u, u**2, u**3, u**4, y, u * y, u**2 * y])
    total = np.concatenate([np.zeros((7, 1)), np.cumsum(parts, axis=1)], axis=1)
    r1, r2, r3, r4, p0, p1, p2 = total[:, first + width] - total[:, first]
    c, own = u[at], y[at]
    s1, s2 = r1 - c * width, r2 - 2 * c * r1 + c**2 * width
    return [
        s1, s2, r3 - 3 * c * r2 + 3 * c**2 * r1 - c**3 * width,
        r4 - 4 * c * r3 + 6 * c**2 * r2 - 4 * c**3 * r1 + c**4 * width,
        p0 - own * width, p1 - c * p0 - own * s1, p2 - 2 * c * p1 + c**2 * p0 - own * s2,
    ]  # fmt: skip


LARGEST_OFFSET = 2.0
"""Longest time offset between channels that is looked for [s]."""


class OffsetLimits(NamedTuple):
    """From which on an offset is shown."""

    # share of the variance that a shift explains beyond the log as it is, at least
    explains: float = 1e-4
    shortest: float = 0.1  # shares of a time step that a delay is, at least


_OFFSET = OffsetLimits()


@dataclass(frozen=True)
class Offset:
    """Time offset of a channel against the tread speeds."""

    channel: str  # the channel
    seconds: float  # by how much it lags behind [s]
    explained: float  # share of its variance that the tread speeds explain once it is shifted
    before: float  # the same as logged
    sign: int  # sign of the relation at that offset
    duration: float  # length of the stretches compared [s]
    step: float = 0.0  # time between samples [s]

    @property
    def certain(self) -> bool:
        """Whether the shift explains clearly more, over a long enough time."""
        return (
            self.duration >= 30.0
            and self.explained > 0.3
            and self.explained - self.before >= _OFFSET.explains
            and abs(self.seconds) >= max(0.005, _OFFSET.shortest * self.step)
            and 1 - self.before > 1.15 * (1 - self.explained)
        )


def find_offset(
    channel: str,
    t: FloatArray,
    values: FloatArray,
    regressors: Sequence[FloatArray],
    runs: Sequence[slice],
    *,
    largest: float = LARGEST_OFFSET,
    centred: bool = True,
) -> Offset | None:
    """Find the time offset at which regressors explain a channel best."""
    long = [run for run in runs if t[run][-1] - t[run][0] >= 4 * largest]
    if not long:
        return None
    # Where most samples crowd together the grid must not grow without bound.
    spread = sum(float(t[run][-1] - t[run][0]) for run in long) / (4 * len(t))
    step = max(float(np.median(np.diff(t))), spread)
    lags = round(largest / step)
    if lags < 1:
        return None
    columns = [*regressors, np.ones(len(t))] if centred else list(regressors)
    size = len(columns)
    cross, gram = np.zeros((2 * lags + 1, size)), np.zeros((2 * lags + 1, size, size))
    square = total = count = 0.0
    for run in long:
        grid = t[run][0] + step * np.arange(int((t[run][-1] - t[run][0]) / step) + 1)
        # The channel's samples that every lag can reach; the regressors move past them.
        y = np.interp(grid, t[run], values[run])[lags:-lags]
        X = np.stack([np.interp(grid, t[run], column[run]) for column in columns])
        square, total, count = square + float(y @ y), total + float(y.sum()), count + len(y)
        length = 1 << (X.shape[1] - 1).bit_length()
        spectrum = np.conj(np.fft.rfft(y, length))
        for j in range(size):
            # Correlation at every lag at once; it wraps round only beyond the lags wanted.
            product = np.fft.rfft(X[j], length) * spectrum
            cross[:, j] += np.fft.irfft(product, length)[2 * lags :: -1]
            for k in range(size):
                sums = np.concatenate([[0.0], np.cumsum(X[j] * X[k])])
                gram[:, j, k] += (sums[len(y) :] - sums[: 2 * lags + 1])[::-1]
    if square - centred * total**2 / max(count, 1.0) <= 1e-12 * square:
        return None
    scale = np.sqrt(np.einsum("ijj->ij", gram))
    if np.any(scale <= 0):
        return None
    # Regressors may be collinear, as those of a robot that never turns or has one side dead.
    unit = gram / (scale[:, :, None] * scale[:, None, :])
    inverse = np.linalg.pinv(unit, rcond=1e-9, hermitian=True)
    weights = (inverse @ (cross / scale)[..., None])[..., 0] / scale
    mean = total**2 / count if centred else 0.0
    explained = (np.einsum("ij,ij->i", cross, weights) - mean) / (square - mean)
    best = int(np.argmax(explained))
    shift = 0.0
    if 0 < best < 2 * lags:
        a, b, c = explained[best - 1 : best + 2]
        shift = 0.5 * float(a - c) / float(a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
    return Offset(
        channel, (best - lags + shift) * step, float(explained[best]), float(explained[lags]),
        int(np.sign(weights[best, 0])), count * step, step,
    )  # fmt: skip
