"""Linear fits under bounds: least absolute error (exact), Huber, and Nelder-Mead (private).

All take a design matrix ``X``, a target ``y`` and bounds, and return the coefficients that minimise
a sum over the residuals ``y - X c``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.optimize import linprog, lsq_linear

from energyplan.errors import NotIdentifiableError
from energyplan.path import FloatArray

NORMAL_MAD = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""

HUBER_TUNING = 1.345
"""Where Huber's loss turns linear, in standard deviations (95 % efficient for normal noise)."""

_BAND = 1000
"""Least rows that a reduced linear program holds; up to twice as many are solved as they are."""

_SAMPLED = 8
"""One row in so many leads near the solution of all."""

_REACH = 12.0
"""Rows of a band, over the root of coefficients times rows: four standard errors of that lead."""

_ROUNDING = 1e-12
"""Residual over the largest target that is zero but for rounding."""

_FEW_WRONG = 0.1
"""Share of the band, up to which rows with another sign than expected join it."""


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
    found = lsq_linear(root, target, (bounds.lower * scale, bounds.upper * scale), tol=1e-14)
    return np.asarray(bounds.clip(found.x / scale))


def robust_scale(residual: FloatArray) -> float:
    """Return the standard deviation of the residual's normal core."""
    return NORMAL_MAD * float(np.median(np.abs(residual)))


def huber(X: FloatArray, y: FloatArray, bounds: Bounds) -> FloatArray:
    """Minimise Huber's loss by iteratively reweighted least squares.

    The scale is that of the residual's normal core, so that outliers have a bounded pull and the
    bulk of the samples is weighted as in least squares.
    """
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
    """Solve ``min sum |y - X c| - fixed . c`` as a linear program, by its dual.

    The dual has one bounded variable a row and one equation a coefficient; the coefficients are
    the multipliers of the equations. A finite bound of a coefficient is one more variable.
    """
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


def lad(X: FloatArray, y: FloatArray, bounds: Bounds) -> FloatArray:
    """Minimise the sum of absolute residuals exactly, for any number of rows (Eq. 7).

    Rows far from the fitted surface only matter through the sign of their residual. They are
    summed into one vector, the rest is a small linear program, and rows whose sign turns out
    otherwise join it, or a wider band takes its place where they are many, until there are none:
    then the solution is that of the whole problem, because the reduced objective never exceeds the
    full one and equals it there.

    Source: Portnoy and Koenker (1997), "The Gaussian hare and the Laplacian tortoise",
    Statistical Science 12(4); docs/theory, section 6.
    """
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
    c = lad(Xs[::_SAMPLED], ys[::_SAMPLED], inner)
    size = max(_BAND, round(_REACH * np.sqrt(Xs.size)))
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
    """Minimise an objective by Nelder and Mead's simplex, restarted until it stays where it is.

    Source: Morales et al. (2010), Eq. 7 and reference 14.
    """
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
