"""How well a model foretells the energy of driving that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.linear import linearise_drive
from energyplan.fit.solvers import column_scale
from energyplan.path import FloatArray
from energyplan.power import PowerModel

_FEWEST = 4
"""Drives from which on whole ones are left out."""
_STRETCHES = 5
_LEAST = 0.1
"""Share of the usual power that what is left out counts as taking at least."""


@dataclass(frozen=True)
class Foretold:
    """Errors of energies, each foretold from all other driving."""

    left_out: Literal["drive", "stretch"]
    count: int  # how many
    duration: float  # their median length [s]
    error: float  # mean and largest size of the relative error of their energies
    largest: float  # mean and largest size of the relative error of their energies

    @property
    def in_words(self) -> str:
        """What was left out, and how far its energy was missed."""
        what = "drives" if self.left_out == "drive" else "stretches"
        return (
            f"{what} of {self.duration:.3g} s, each predicted from the others, miss their energy "
            f"by {100 * self.error:.2g} %, at most {100 * self.largest:.2g} %"
        )


def foretold(
    model: PowerModel, drives: Sequence[Drive], powers: Sequence[FloatArray]
) -> Foretold | None:
    """Leave out one drive after the other, or one stretch of few drives, and foretell its energy.

    The coefficients without it are those of the fit, moved by one step of robust least squares of
    all other samples: those that the fit misses by more than half of the samples count less, as in
    Huber's estimate. What only the stretch itself shows is taken from it.
    """
    parts = _parts(drives)
    table = np.concatenate(
        [
            linearise_drive(drive, model.vehicle, model.terms, model.coefficients).columns[:, 0]
            for drive in drives
        ]
    )
    power = np.concatenate([drive.power for drive in drives])
    time = np.concatenate([drive.weights for drive in drives])
    residual = power - np.concatenate(powers)
    energy, seconds, missed = (
        np.bincount(parts, values) for values in (time * power, time, time * residual)
    )
    count = len(energy)
    if count < 2 or energy.sum() <= 0.0:
        return None
    size = np.maximum(np.abs(residual), np.median(np.abs(residual)))
    weight = time / np.maximum(size, 1e-9 * float(np.abs(power).max()))
    X = table / column_scale(table)
    grams = np.array([_gram(X[parts == k], weight[parts == k]) for k in range(count)])
    sums = np.array([(weight * residual)[parts == k] @ X[parts == k] for k in range(count)])
    every = _step(grams.sum(axis=0), sums.sum(axis=0))
    steps = np.array(
        [_step(grams.sum(axis=0) - grams[k], sums.sum(axis=0) - sums[k]) for k in range(count)]
    )
    columns = np.array([time[parts == k] @ X[parts == k] for k in range(count)])
    missed = missed - np.sum(columns * (steps - every), axis=1)
    usual = energy.sum() / seconds.sum() * seconds
    errors = np.abs(missed) / np.maximum(np.abs(energy), _LEAST * usual)
    what: Literal["drive", "stretch"] = "drive" if len(drives) >= _FEWEST else "stretch"
    return Foretold(
        what, count, float(np.median(seconds)), float(errors.mean()), float(errors.max())
    )


def _parts(drives: Sequence[Drive]) -> NDArray[np.intp]:
    """Return the number of the drive, or of the stretch of few drives, of each sample."""
    whole = sum(float(drive.t[-1]) for drive in drives)
    numbers: list[NDArray[np.intp]] = []
    first = 0
    for drive in drives:
        share = float(drive.t[-1]) / whole if whole > 0 else 0.0
        pieces = 1 if len(drives) >= _FEWEST else max(round(_STRETCHES * share), 1)
        edges = np.linspace(0.0, float(drive.t[-1]), pieces + 1)[1:-1]
        numbers.append(first + np.searchsorted(edges, drive.t, side="right"))
        first += pieces
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _gram(X: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(X.T @ (weight[:, None] * X))


def _step(gram: FloatArray, sums: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(gram, 1e-10, hermitian=True) @ sums)
