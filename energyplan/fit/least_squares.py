"""Fits of a sum of terms to drives, with cross-validation and jackknife (private).

Least squares on the means of `energyplan.fit.drives.design`: every scale counts by its error
relative to the error of a reference model, so that each has one vote. Leaving out one block after
the other is a small linear solve each, because the design is kept as one Gram matrix per block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc
from scipy.stats import norm
from scipy.stats import t as student

from energyplan.fit.drives.design import Design
from energyplan.path import FloatArray

WEIGHTS = np.array([1.0, 2.0, 3.0]) / 6.0
"""Say of each scale: what lasts adds up to energy."""


@dataclass(frozen=True)
class Fit:
    """Coefficients of a design, with what leaving out blocks or drives does to them."""

    values: FloatArray  # (k,): coefficients
    losses: FloatArray  # (b,): cross-validated loss of each block
    covariance: FloatArray  # (k, k): jackknife over the blocks
    squares: FloatArray  # (scales, b) [W^2]
    blocks: int  # blocks that say something of the coefficients
    deviations: FloatArray  # (b, k): the jackknife's coefficients, less their mean

    @property
    def reported(self) -> FloatArray:
        """Covariance whose 95 % intervals are those of Student's distribution.

        Of some coefficients few blocks tell nearly all, and a variance that comes from few is
        itself uncertain. The degrees of freedom are Satterthwaite's: as many as there are blocks
        where all tell alike.
        """
        square = np.sum(self.deviations**2, axis=0)
        freedom = 3.0 * square**2 / np.maximum(np.sum(self.deviations**4, axis=0), 1e-300)
        freedom = np.clip(freedom, 3.0, len(self.deviations)) - 1.0
        stretch = student.ppf(0.975, freedom) / norm.ppf(0.975)
        return np.asarray(self.covariance * np.outer(stretch, stretch))

    @property
    def errors(self) -> FloatArray:
        """Cross-validated mean square error at each scale [W^2]."""
        return np.asarray(self.squares.sum(axis=1))

    @property
    def loss(self) -> float:
        """Cross-validated loss."""
        return float(self.losses.sum())

    def p_value(self, which: Sequence[int]) -> float:
        """Probability of coefficients this far from zero by chance (Hotelling's T^2)."""
        count, width = max(self.blocks, 2), len(which)
        value = self.values[list(which)]
        block = self.covariance[np.ix_(list(which), list(which))]
        squared = float(value @ np.linalg.pinv(block, hermitian=True) @ value)
        freedom = max(count - width, 1)
        return float(fdtrc(width, freedom, squared * freedom / ((count - 1) * width)))


def solve(gram: FloatArray) -> FloatArray:
    """Least-squares coefficients from Gram matrices, shape (..., k+1, k+1)."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-300))[..., :-1]
    normal = gram[..., :-1, :-1] / (scale[..., :, None] * scale[..., None, :])
    moment = gram[..., :-1, -1] / scale
    ridge = 1e-9 * np.eye(normal.shape[-1])
    return np.asarray(np.linalg.solve(normal + ridge, moment[..., None])[..., 0] / scale)


def squared_errors(grams: FloatArray, values: FloatArray) -> FloatArray:
    """Return what coefficients, shape (..., k), leave of Gram matrices, shape (..., k+1, k+1)."""
    signed = np.concatenate([values, -np.ones((*values.shape[:-1], 1))], axis=-1)
    products = signed[..., :, None] * signed[..., None, :]
    flat = (*products.shape[:-2], -1)
    rows = grams.reshape(*grams.shape[:-2], -1)
    return np.asarray(np.einsum("...k,...k->...", rows, products.reshape(flat)))


def evidence_of(windows: FloatArray) -> FloatArray:
    """Return how many windows each scale counts for in a likelihood: a weighted mean over them."""
    return np.asarray(np.tile(WEIGHTS, len(windows) // len(WEIGHTS)) * windows)


def left_out(total: FloatArray, grams: FloatArray, fold: np.ndarray) -> FloatArray:
    """Coefficients fitted without each fold, shape (folds, k)."""
    count = int(fold.max()) + 1
    sums = np.zeros((count, *total.shape))
    np.add.at(sums, fold, grams)
    return solve(total - sums)


def weighted(design: Design, errors: FloatArray) -> FloatArray:
    """Gram matrices of the blocks, summed over scales, each divided by its reference error."""
    return np.asarray(np.tensordot(1.0 / (errors * design.counts), design.grams, 1))


def fit(design: Design, errors: FloatArray, by_block: bool = False) -> Fit:
    """Fit a design and cross-validate it."""
    grams = weighted(design, errors)
    total = grams.sum(axis=0)
    values = solve(total)
    moved = 0.0 if design.ended is None else design.ended - values
    values = values + moved
    blocks = np.arange(len(grams))
    jack = left_out(total, grams, blocks) + moved
    centred = jack - jack.mean(axis=0)
    covariance = (len(grams) - 1) / len(grams) * centred.T @ centred
    by_drive = design.comparable and not by_block
    held = left_out(total, grams, design.drives)[design.drives] + moved if by_drive else jack
    losses, squares = squared_errors(grams, held), squared_errors(design.grams, held)
    telling = int(np.count_nonzero(design.telling))
    return Fit(
        values, np.maximum(losses, 0.0), covariance, squares / design.counts[:, None], telling,
        centred,
    )  # fmt: skip


def difference(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Sum of the paired differences of block losses, and its standard error."""
    gap = one - other
    return float(gap.sum()), float(np.sqrt(len(gap)) * gap.std(ddof=1))
