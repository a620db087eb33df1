"""Linear fits under bounds, and covariance of correlated estimates (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.fft import irfft, next_fast_len, rfft
from scipy.optimize import linprog, lsq_linear
from scipy.signal import detrend, lfilter, welch
from scipy.stats import norm
from scipy.stats import t as student

from energyplan.errors import NotIdentifiableError
from energyplan.path import FloatArray

# -- linear fits under bounds: least absolute error (exact), Huber, and Nelder-Mead ----------------

NORMAL_MAD = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""

HUBER_TUNING = 1.345
"""Where Huber's loss turns linear, in standard deviations (95 % efficient for normal noise)."""

_BAND = 1000
"""Least rows that a reduced linear program holds; up to twice as many are solved as they are."""

_SAMPLED = 8  # one row in so many leads near the solution of all

_REACH = 12.0
"""Rows of a band, over the root of coefficients times rows: four standard errors of that lead."""

_ROUNDING = 1e-12  # residual over the largest target that is zero but for rounding

_FEW_WRONG = 0.1  # share of the band, up to which rows with another sign than expected join it


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bound of each coefficient."""

    lower: FloatArray
    upper: FloatArray

    def clip(self, c: FloatArray) -> FloatArray:
        """Return the nearest coefficients within the bounds."""
        return np.clip(c, self.lower, self.upper)


def column_scale(X: FloatArray) -> FloatArray:
    """Root mean square of each column, 1 where a column is zero."""
    norm = np.sqrt(np.einsum("ij,ij->j", X, X) / max(len(X), 1))
    return np.where(norm > 0, norm, 1.0)


def weighted_least_squares(
    X: FloatArray, y: FloatArray, bounds: Bounds, weights: FloatArray | None = None
) -> FloatArray:
    """Minimise the weighted sum of squares: a bounded problem of the size of the coefficients."""
    scale = column_scale(X)
    XW = X if weights is None else X * weights[:, None]
    normal = (XW.T @ X) / np.outer(scale, scale)
    moment = (XW.T @ y) / scale
    value, vector = np.linalg.eigh(normal)
    keep = value > 1e-14 * value[-1]
    root = np.sqrt(value[keep])[:, None] * vector[:, keep].T
    target = (vector[:, keep].T @ moment) / np.sqrt(value[keep])
    least, most = bounds.lower * scale, bounds.upper * scale
    most = np.maximum(most, np.nextafter(least, np.inf))  # of a coefficient that can be but one
    found = lsq_linear(root, target, (least, most), tol=1e-14)
    return np.asarray(bounds.clip(found.x / scale))


def robust_scale(residual: FloatArray) -> float:
    """Return the standard deviation of the residual's normal core."""
    return NORMAL_MAD * float(np.median(np.abs(residual)))


def huber(X: FloatArray, y: FloatArray, bounds: Bounds) -> FloatArray:
    """Minimise Huber's loss by iteratively reweighted least squares."""
    c = weighted_least_squares(X, y, bounds)
    scale = column_scale(X)
    for _ in range(100):
        residual = y - X @ c
        sigma = max(robust_scale(residual), 1e-12 * float(np.max(np.abs(y), initial=1e-300)))
        weights = 1.0 / np.maximum(np.abs(residual) / (HUBER_TUNING * sigma), 1.0)
        before, c = c, weighted_least_squares(X, y, bounds, weights)
        if np.linalg.norm((c - before) * scale) <= 1e-9 * np.linalg.norm(c * scale):
            break
    return c


def _lad_program(
    X: FloatArray, y: FloatArray, bounds: Bounds, fixed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve ``min sum |y - X c| - fixed . c`` as a linear program, by its dual."""
    n, p = X.shape
    low, high = np.flatnonzero(np.isfinite(bounds.lower)), np.flatnonzero(np.isfinite(bounds.upper))
    unit = np.eye(p)
    equations = np.vstack([X, unit[low], -unit[high]]).T
    gain = np.concatenate([y, bounds.lower[low], -bounds.upper[high]])
    extra = len(low) + len(high)
    limits = [(-1.0, 1.0)] * n + [(0.0, np.inf)] * extra
    # X' d = -fixed: the gradient of all rows together, bounds included, is zero.
    found = linprog(-gain, None, None, equations, -fixed, limits, method="highs-ds")
    if found.x is None or found.status != 0:
        raise NotIdentifiableError(
            f"the linear program of least absolute error has no solution ({found.message}); "
            "a coefficient has no data in this log"
        )
    return bounds.clip(-np.asarray(found.eqlin.marginals)), np.asarray(found.x[:n])


def lad(X: FloatArray, y: FloatArray, bounds: Bounds, near: FloatArray | None = None) -> FloatArray:
    """Minimise the sum of absolute residuals exactly, for any number of rows (Eq. 7).

    Where the coefficients are nearly known, `near` saves work.
    """
    # Source: Portnoy and Koenker (1997), "The Gaussian hare and the Laplacian tortoise",
    # Statistical Science 12(4); docs/theory, section 6.
    acting = np.any(X != 0.0, axis=1)  # the residual of any other row is what it is
    if not acting.any():
        return bounds.clip(np.zeros(X.shape[1]))
    X, y = X[acting], y[acting]
    scale = column_scale(X)
    target = float(np.max(np.abs(y), initial=0.0)) or 1.0
    Xs, ys = X / scale, y / target
    inner = Bounds(bounds.lower * scale / target, bounds.upper * scale / target)
    if len(ys) <= 2 * _BAND:
        c, _ = _lad_program(Xs, ys, inner, np.zeros(X.shape[1]))
        return bounds.clip(c * target / scale)
    # Rows evenly picked lead near the solution, however skew the residual; squares would not.
    c = lad(Xs[::_SAMPLED], ys[::_SAMPLED], inner) if near is None else near * scale / target
    reach = _REACH if near is None else _REACH / np.sqrt(_SAMPLED)
    size = max(_BAND, round(reach * np.sqrt(Xs.size)))
    band, sign = _band(ys - Xs @ c, size)
    while True:
        fixed = Xs[~band].T @ sign[~band]
        try:
            found, _ = _lad_program(Xs[band], ys[band], inner, fixed)
        except NotIdentifiableError:
            if band.all():
                raise
            wrong = ~band  # the rows of the band do not hold a coefficient that all rows hold
        else:
            wrong = ~band & ((ys - Xs @ found) * sign < -_ROUNDING)
        count = np.count_nonzero(wrong)
        if count == 0:
            return bounds.clip(found * target / scale)
        if count > _FEW_WRONG * size:  # it left the band: a wider one holds it
            size = min(2 * size, len(ys))
            band, sign = _band(ys - Xs @ c, size)
        else:
            band |= wrong


def _band(residual: FloatArray, size: int) -> tuple[NDArray[np.bool_], FloatArray]:
    """Mark the rows of the smallest residuals, and return the signs of all (zero: positive)."""
    band = np.ones(len(residual), bool)
    if size < len(residual):
        band[np.argpartition(np.abs(residual), size)[size:]] = False
    return band, np.where(residual < 0.0, -1.0, 1.0)


def simplex(
    objective: Callable[[FloatArray], float], start: FloatArray, bounds: Bounds
) -> FloatArray:
    """Minimise an objective by Nelder and Mead's simplex, restarted until it stays where it is."""
    # Source: Morales et al. (2010), Eq. 7 and reference 14.
    unit = np.where(np.abs(start) > 0, np.abs(start), 1.0)
    limits = optimize.Bounds(bounds.lower / unit, bounds.upper / unit)
    best, value = start / unit, objective(start)

    def scaled(z: FloatArray) -> float:
        return objective(z * unit)

    for _ in range(20):
        found = optimize.minimize(
            scaled,
            best,
            method="Nelder-Mead",
            bounds=limits,
            options={"xatol": 1e-7, "fatol": 1e-12 * max(value, 1e-300), "maxfev": 4000},
        )
        settled = found.fun >= value * (1 - 1e-9)
        if found.fun <= value:
            best, value = np.asarray(found.x), float(found.fun)
        if settled:
            break
    return bounds.clip(best * unit)


# -- covariance of estimates from autocorrelated residuals -----------------------------------------

_LARGEST_ORDER = 30
_LARGEST_PARTIAL = 0.9995
_NEGLIGIBLE = 1e-3  # autocorrelation at which its tail is cut


def _padded(block: slice, lags: int) -> int:
    """Return the padded length of a slice, so that products at these lags do not wrap around."""
    return next_fast_len(block.stop - block.start + lags, real=True)


def _products(a: FloatArray, b: FloatArray, pieces: Sequence[slice], lags: int) -> FloatArray:
    """Sum ``a[t] b[t + k]`` within the pieces, for k from 0 to `lags`."""
    total = np.zeros(lags + 1)
    for block in pieces:
        size = _padded(block, lags)
        product = irfft(rfft(a[block], size).conj() * rfft(b[block], size), size)
        total += product[: lags + 1]
    return total


def _levinson(
    rho: FloatArray, current: FloatArray, variance: float, order: int
) -> tuple[FloatArray, float]:
    """Return the autoregression of the next order, and the share of the variance that it leaves."""
    partial = (rho[order] - float(current @ rho[order - 1 : 0 : -1])) / variance
    partial = min(max(partial, -_LARGEST_PARTIAL), _LARGEST_PARTIAL)
    longer = np.asarray(np.append(current - partial * current[::-1], partial))
    return longer, float(variance * (1.0 - partial**2))


def _extended(covariance: FloatArray, count: int, longest: int) -> FloatArray:
    """Continue an autocorrelation from its first lags by an autoregression, until it dies out."""
    given: FloatArray = covariance / covariance[0]
    current, variance, best, score = np.zeros(0), 1.0, np.zeros(0), 0.0
    for order in range(1, len(given)):
        before = variance
        current, variance = _levinson(given, current, variance, order)
        if order > 1 and variance <= before * (1.0 - _LARGEST_PARTIAL**2):
            break
        criterion = count * np.log(variance) + 2 * order
        if criterion < score:
            best, score = current, criterion
    order = len(best)
    start = given[: order + 1]
    reach = 64 if order else 0
    while reach:
        # The autoregression's own tail: a filter that starts at its last values and gets no input.
        state = [best[k:] @ start[order:k:-1] for k in range(order)]
        tail, _ = lfilter([1.0], np.append(1.0, -best), np.zeros(reach), zi=state)
        alive = np.flatnonzero(np.abs(tail) > _NEGLIGIBLE)
        last = int(alive[-1]) + 1 if len(alive) else 0
        if last < reach or reach >= longest:
            kept = max(min(last, longest - 1 - order), 0)
            return np.asarray(np.concatenate([start, tail[:kept]]))
        reach *= 4
    return start


def repeats_of(series: FloatArray, pieces: Sequence[slice]) -> float:
    """Return how many neighbouring samples make one independent sample."""
    # Source: Brockwell and Davis (1991), Time Series: Theory and Methods, sections 8.1 and 9.3.
    count = len(series)
    longest = max(s.stop - s.start for s in pieces)
    lags = min(_LARGEST_ORDER, longest // 4)
    centred = series - series.mean()
    observed = _products(centred, centred, pieces, lags) / count
    if observed[0] <= 0:
        return 1.0
    pairs = np.array([sum(max(s.stop - s.start - k, 0) for s in pieces) for k in range(lags + 1)])
    rho = _extended(observed * count / pairs, count, longest)
    return max(2.0 * float(rho.sum()) - 1.0, 1.0)


def jackknife(moved: FloatArray) -> FloatArray:
    """Return the covariance of coefficients, given those without each block, shape (b, k).

    Its 95 % intervals, with a normal distribution's quantile, are those of Student's.
    """
    # Source: Efron and Tibshirani (1993), An Introduction to the Bootstrap, chapter 11.
    count = len(moved)
    deviation = moved - moved.mean(axis=0)
    square = np.sum(deviation**2, axis=0)
    freedom = 3.0 * square**2 / np.maximum(np.sum(deviation**4, axis=0), 1e-300)
    freedom = np.clip(freedom, min(3.0, count), count) - 1.0
    stretch = student.ppf(0.975, freedom) / norm.ppf(0.975)
    return np.asarray((count - 1) / count * deviation.T @ deviation * np.outer(stretch, stretch))


_SEGMENT = 4.0  # length of the segments whose spectra are compared [s]
_LOWEST = 0.4  # below this frequency a residual may be systematic [Hz]
_LONGEST = 0.3  # memory of a sensor's noise, at most [s]
_FEW_BINS = 6  # frequencies below which only white noise can be estimated


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor: white noise, and a first-order autoregression."""

    count: float  # samples that it is estimated from
    white: float  # variance of a sample
    lasting: float = 0.0  # variance of a sample, of the autoregression
    rho: float = 0.0  # correlation of its neighbouring samples

    @classmethod
    def of(cls, residual: FloatArray, period: float) -> SensorNoise | None:
        """Fit the spectrum of a residual above the frequencies of systematic errors."""
        # Medians over time and a robust fit over frequencies: no event and no tone is noise.
        # Source: Welch (1967), IEEE Trans. Audio Electroacoust. 15, 70-73.
        length = min(round(_SEGMENT / period), len(residual) // 2)
        if length < 2 * _FEW_BINS:
            return None
        frequency, power = welch(
            residual, 1.0 / period, nperseg=length, detrend=detrend, average="median"
        )
        kept = (frequency > _LOWEST) & (np.arange(len(frequency)) < length // 2) & (power > 0.0)
        if np.count_nonzero(kept) < _FEW_BINS:
            return None
        cos = np.cos(2.0 * np.pi * period * frequency[kept])
        measured = np.log(power[kept] / (2.0 * period))
        scatter = max(float(np.sqrt(2.0 * length / len(residual))), 0.1)

        def misfit(x: FloatArray) -> FloatArray:
            rho = np.exp(-period / x[2])
            lasting = np.exp(x[1]) * (1.0 - rho**2) / (1.0 - 2.0 * rho * cos + rho**2)
            return np.asarray((np.log(np.exp(x[0]) + lasting) - measured) / scatter)

        low, high = float(measured.min()), float(measured.max())
        found = optimize.least_squares(
            misfit, [low, 0.5 * (low + high), 0.3 * _LONGEST], loss="soft_l1",
            bounds=([low - 20.0, low - 20.0, 1e-3], [high + 1.0, high + 5.0, _LONGEST]),
        )  # fmt: skip
        white, lasting = np.exp(found.x[:2]).tolist()
        part = min(float(np.mean(residual**2)) / (white + lasting), 1.0)  # which it is of that
        rho = float(np.exp(-period / found.x[2]))
        return cls(float(len(residual)), part * white, part * lasting, rho)

    @classmethod
    def of_repeats(cls, count: float, variance: float, repeats: float) -> SensorNoise:
        """Return noise of which so many neighbouring samples make one independent sample."""
        return cls(count, 0.0, variance, (repeats - 1.0) / (repeats + 1.0))

    @property
    def variance(self) -> float:
        """Variance of a sample."""
        return self.white + self.lasting

    @property
    def repeats(self) -> float:
        """How many neighbouring samples make one independent sample."""
        lasting = self.lasting * (1.0 + self.rho) / (1.0 - self.rho)
        return (self.white + lasting + 1e-300) / (self.variance + 1e-300)

    def of_means(self, number: float) -> float:
        """Variance of means over so many samples."""
        rho, rest = self.rho, 1.0 - self.rho
        shared = (1.0 + rho) / (rest * number)
        shared -= 2.0 * rho * (1.0 - rho**number) / (rest * number) ** 2
        return float(self.white / number + self.lasting * shared)


def innovation_share(series: FloatArray, pieces: Sequence[slice]) -> float:
    """Share of a series' variance that its own past does not predict."""
    # Source: Schweppe (1965), IEEE Trans. Inf. Theory 11, 61-70. Hurvich and Tsai (1989),
    # Biometrika 76.
    count = len(series)
    lags = min(_LARGEST_ORDER, max(s.stop - s.start for s in pieces) // 4)
    centred = series - series.mean()
    covariance = _products(centred, centred, pieces, lags) / count
    if covariance[0] <= 0.0:
        return 1.0
    rho, current, variance = covariance / covariance[0], np.zeros(0), 1.0
    best, least = 1.0, 2.0 * count / max(count - 2, 1)
    for order in range(1, min(lags, count - 4) + 1):
        current, variance = _levinson(rho, current, variance, order)
        criterion = count * np.log(variance) + 2.0 * count * (order + 1) / (count - order - 2)
        if criterion < least:
            best, least = variance, criterion
    return float(best)


def least_squares(
    X: FloatArray, y: FloatArray, pieces: Sequence[slice]
) -> tuple[FloatArray, FloatArray, float]:
    """Return least-squares coefficients, their covariance, and how many samples repeat another."""
    scale = column_scale(X)
    inverse = np.linalg.pinv((X.T @ X) / np.outer(scale, scale), 1e-10, hermitian=True)
    values = inverse @ (X.T @ y / scale) / scale
    rest = y - X @ values
    repeats = repeats_of(rest, pieces)
    variance = float(rest @ rest) / max(len(y) - X.shape[1], 1) * repeats
    return values, variance * inverse / np.outer(scale, scale), repeats


def correlation_time(residual: FloatArray, period: float, pieces: Sequence[slice]) -> float:
    """Integral time scale of a series: the area under its autocorrelation at positive lags [s]."""
    return 0.5 * period * repeats_of(residual, pieces)
