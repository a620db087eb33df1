"""Predictions of runs to come: the explanation, averaged with a fit that assumes less (private).

Runs of one robot on one ground differ as a whole, and few runs say little about which effects the
next one will show. An average of models that err differently is then better than the best of them,
and better than a choice among them (Timmermann 2006, "Forecast combinations"). So each model counts
by how it predicts whole runs that it was not fitted to: an explanation that foretells them counts
alone, one that does no better than two terms counts half.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from energyplan.diagnosis.fitting import PAPER, Problem, RunSpread, left_out, weighted
from energyplan.diagnosis.joint_fit import FinalFit
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.power.effect_terms import SLIP_SPEED

FEWEST_RUNS = 4
"""Runs from which on leaving one out tells how runs to come are predicted."""

_LENIENT = (*PAPER, SLIP_SPEED)
_SHARE = 0.1  # of the power, that the further term is expected to be of
_ROUNDS = 40
_CORE = 0.05  # relative error below which squares count, so that the fit is smooth
_LEAST = 0.1  # of the usual power, that a run counts as drawing at least
_NEGLIGIBLE = 0.02  # weight that is not worth a further term


@dataclass(frozen=True)
class Averaged:
    """A model for runs to come.

    Parameters
    ----------
    fitted : FinalFit
        The average: terms of both models, coefficients by weight.
    weight : float
        Weight of the explanation; the rest is that of the cautious fit.
    errors : tuple of float
        Mean relative error of the energy of runs left out: explanation, cautious fit.
    """

    fitted: FinalFit
    weight: float
    errors: tuple[float, float]


@dataclass(frozen=True)
class _Runs:
    """Means over the longest windows, of plain totals.

    Parameters
    ----------
    owner : ndarray of int, shape (w,)
        Run of each window.
    time : ndarray, shape (w,)
        Time that a window stands for [s].
    energies : ndarray, shape (runs,)
        Measured energy of each run [J]; of one that took next to nothing, what it counts as.
    """

    owner: NDArray[np.intp]
    time: FloatArray
    energies: FloatArray

    @classmethod
    def of(cls, problem: Problem, owner: NDArray[np.intp]) -> _Runs:
        time, energies = [], []
        for drive in problem.drives:
            counts = drive.windows[-1].counts
            time.append(counts * float(drive.weights.sum()) / float(counts.sum()))
            energies.append(float(drive.weights @ drive.power))
        seconds = np.array([float(drive.weights.sum()) for drive in problem.drives])
        least = _LEAST * sum(energies) / float(seconds.sum()) * seconds
        return cls(owner, np.concatenate(time), np.maximum(energies, least))

    def misses(self, table: FloatArray, held: Callable[[int], FloatArray]) -> FloatArray:
        """Relative error of the energy of each run, by coefficients that are not fitted to it."""
        found = np.zeros(len(self.energies))
        for run, energy in enumerate(self.energies):
            own = self.owner == run
            gap = table[own, :-1] @ held(run) - table[own, -1]
            found[run] = float(self.time[own] @ gap) / energy
        return found


def averaged(problem: Problem, fitted: FinalFit) -> Averaged | None:
    """Average an explanation with a cautious fit, each by how well it predicts whole runs.

    The cautious fit has the paper's terms and a friction that may rise or fall with the slip speed,
    shrunk to none as far as the runs do not bear it; least absolute errors of means over eight
    seconds, each relative to the power of its run. Weights go with the inverse square of the mean
    error of runs left out (Bates and Granger 1969, "The combination of forecasts").

    Parameters
    ----------
    problem : Problem
        Training drives, with factors and delays of the explanation.
    fitted : FinalFit
        The explanation, fitted to them.

    Returns
    -------
    Averaged or None
        None where there are too few runs, or the cautious fit says nothing beside the explanation.
    """
    count = len(problem.drives)
    if count < FEWEST_RUNS:
        return None
    plain = problem.of_totals.with_factors([1.0] * count)
    values = np.array(fitted.model.coefficients)
    start = {t.name: float(v) for t, v in zip(fitted.terms, values, strict=True)}
    table, owner = plain.design(fitted.terms, None, start, rounds=1).longest
    runs = _Runs.of(plain, owner)
    if not np.all(runs.energies > 0.0):
        return None
    design = problem.design(fitted.terms, None, start, rounds=1)
    errors = problem.reference(design)
    grams = weighted(design, errors)
    held = left_out(grams.sum(axis=0), grams, design.drives)
    first = runs.misses(table, lambda run: held[run])

    lenient, _ = plain.design(_LENIENT).longest
    without = [_cautious(lenient, runs, np.arange(count) != run) for run in range(count)]
    second = runs.misses(lenient, lambda run: without[run])
    sizes = float(np.mean(np.abs(first))), float(np.mean(np.abs(second)))
    weight = sizes[1] ** 2 / max(sizes[0] ** 2 + sizes[1] ** 2, 1e-300)
    if not np.isfinite(weight) or 1.0 - weight < _NEGLIGIBLE:
        return None
    cautious = _cautious(lenient, runs, np.ones(count, bool))
    centred = np.array(without) - cautious
    spread = (count - 1) / count * centred.T @ centred
    model = _mixed(fitted.model, cautious, spread, weight)
    about = {t.name: float(v) for t, v in zip(model.terms, model.coefficients, strict=True)}
    mixed = plain.design(model.terms, None, about, rounds=1)
    between = RunSpread.of(mixed, np.array(model.coefficients))
    told = replace(fitted, model=model, run_spread=None if between is None else between.deviation)
    return Averaged(told, float(weight), sizes)


def _cautious(table: FloatArray, runs: _Runs, kept: NDArray[np.bool_]) -> FloatArray:
    """Fit the paper's terms and a shrunk further one to some of the runs.

    Laplace's distribution of the relative errors, a normal one of what the further term takes.
    """
    some = kept[runs.owner]
    X, y, time = table[some, :-1], table[some, -1], runs.time[some]
    seconds = np.bincount(runs.owner, runs.time, len(kept))
    weight = time * (seconds / runs.energies)[runs.owner[some]]
    weight = weight / weight.sum()
    level = float(weight @ y)
    size = np.sqrt(weight @ X**2)
    Z = X * np.divide(level, size, out=np.zeros_like(size), where=size > 0)

    def solve(columns: int, shrinkage: float) -> FloatArray:
        penalty = np.full(columns, 1e-8)
        penalty[len(PAPER) :] = shrinkage
        part, pull = Z[:, :columns], weight
        for _ in range(_ROUNDS):
            normal = part.T @ (part * pull[:, None]) + np.diag(penalty) * level**2
            found = np.linalg.solve(normal, part.T @ (pull * y))
            pull = weight / np.maximum(np.abs(y - part @ found) / level, _CORE)
        return np.asarray(found)

    plain = solve(len(PAPER), 0.0)
    scatter = float(weight @ np.abs(y - Z[:, : len(PAPER)] @ plain)) / level
    found = solve(Z.shape[1], scatter / (np.count_nonzero(kept) * _SHARE**2))
    return np.asarray(found * np.divide(level, size, out=np.zeros_like(size), where=size > 0))


def _mixed(
    model: PowerModel, cautious: FloatArray, spread: FloatArray, weight: float
) -> PowerModel:
    """Average coefficients; their covariance counts by how much the models differ too."""
    terms: list[Term] = list(model.terms)
    names = [term.name for term in terms]
    for term in _LENIENT:
        if term.name not in names:
            terms.append(term)
            names.append(term.name)
    size, first = len(terms), len(model.terms)
    one, other = np.zeros(size), np.zeros(size)
    one[:first] = model.coefficients
    at = [names.index(term.name) for term in _LENIENT]
    other[at] = cautious
    mean = weight * one + (1.0 - weight) * other
    covariance = np.zeros((size, size))
    if model.covariance is not None:
        covariance[:first, :first] += weight * model.covariance
    covariance[np.ix_(at, at)] += (1.0 - weight) * spread
    for values, share in ((one, weight), (other, 1.0 - weight)):
        covariance += share * np.outer(values - mean, values - mean)
    return PowerModel(
        model.vehicle, tuple(terms), mean, 0.5 * (covariance + covariance.T), None, model.name
    )


def note_of(told: Averaged, names: Sequence[str]) -> str:
    """Say what the model for runs to come is made of."""
    what = f"the explanation ({', '.join(names)})" if names else "the paper's terms"
    return (
        f"runs differ as a whole: the model averages {what}, weight {told.weight:.2f}, with a "
        "cautious fit of two terms and a slight dependence on slip speed; leaving out one run "
        f"after the other, they miss energies by {100 * told.errors[0]:.1f} % and "
        f"{100 * told.errors[1]:.1f} %"
    )
