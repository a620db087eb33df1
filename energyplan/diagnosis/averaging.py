"""Predictions of runs to come: the explanation, averaged with the paper's two terms (private).

Runs of one robot on one ground differ as a whole, and few runs, or short ones, say little about
which effects the next one will show. An average of models that err differently is then better than
the best of them, and better than a choice among them (Timmermann 2006, "Forecast combinations").
Each model counts by how it predicts what it was not fitted to: whole runs, and where there are few
of them, kinds of motion too. Blocks of time would not do there: neighbouring ones are alike, and an
explanation that fits them may be wrong about the first motion that they do not have.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from energyplan.diagnosis.joint_fit import FinalFit
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.result import Average
from energyplan.fit.drives.design import Design
from energyplan.fit.drives.windows import SCALES
from energyplan.fit.least_squares import left_out, weighted
from energyplan.fit.problem import FLOOR, PAPER, Problem
from energyplan.fit.run_spread import RunSpread
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Term
from energyplan.power.effect_terms import WHEEL_FIGHT

FEWEST_RUNS = 4
"""Runs from which on leaving one out alone tells how runs to come are predicted."""

_ROUNDS = 40
_CORE = 0.005  # relative error below which squares count, so that the fit is smooth
_LEAST = 0.1  # of the usual power, that a run counts as drawing at least
_PART = 1.0  # of the usual power, that a kind of motion counts as: it is but a part of a run
_NEGLIGIBLE = 0.02  # weight that is not worth a further term
_SLOW = 1  # scale at which an explanation is told to leave nothing: two seconds
_NOTHING = (USUAL_RUN_SPREAD / FLOOR) ** 2  # of the floor, less than which runs differ by anyway
_MOTIONS = 8  # most kinds of motion
_MEMBERS = 3  # windows of a kind of motion, in the mean
_GROUPINGS = 50  # rounds of grouping
_EXACT = 1e-6  # relative error that is none
_DRAWS = 400  # of the Bayesian bootstrap


@dataclass(frozen=True)
class Averaged:
    """A model for runs to come."""

    fitted: FinalFit  # the average
    average: Average | None  # weight of the explanation, and why


@dataclass(frozen=True)
class _Windows:
    """Means of plain totals over the longest windows."""

    run: NDArray[np.intp]  # (w,): run and block of each window
    block: NDArray[np.intp]  # (w,): run and block of each window
    time: FloatArray  # (w,): time that a window stands for [s]
    power: FloatArray  # (w,): measured power [W]

    @classmethod
    def of(cls, problem: Problem, design: Design) -> _Windows:
        time, power = [], []
        for drive in problem.drives:
            windows = drive.windows[-1]
            time.append(windows.counts * drive.weights.sum() / windows.counts.sum())
            power.append(windows.mean(drive.power))
        block = design.longest_blocks
        return cls(design.drives[block], block, np.concatenate(time), np.concatenate(power))

    def energies(self, fold: NDArray[np.intp], least: float = _LEAST) -> FloatArray:
        """Measured energy of each fold [J]; of one that took less, a share of the usual power."""
        energy, seconds = (
            np.bincount(fold, values) for values in (self.time * self.power, self.time)
        )
        return np.asarray(np.maximum(energy, least * energy.sum() / seconds.sum() * seconds))


@dataclass(frozen=True)
class _Rows:
    """Means of the paper's columns, and of the power that inertia leaves them."""

    columns: FloatArray  # (w, 2): columns of the paper's terms
    power: FloatArray  # (w,): power that they are to explain [W]
    block: NDArray[np.intp]  # (w,): block of each
    given: FloatArray  # coefficients are the given ones and any combination of the free ones
    free: FloatArray  # coefficients are the given ones and any combination of the free ones

    @classmethod
    def of(cls, design: Design, usual: FloatArray, scale: int, fitted: FinalFit) -> _Rows:
        """Take the windows of a scale; the columns after the paper's have given coefficients.

        A friction that the drives leave open is the explanation's; where they leave both open, the
        explanation's are both in one proportion.
        """
        scale %= len(SCALES)
        table, first = design.rows[scale], len(PAPER)
        values = np.array([fitted.model.coefficient(term.name) for term in PAPER])
        open_ = np.array([term.name in fitted.assumed for term in PAPER])
        given = np.where(open_ & ~open_.all(), values, 0.0)
        free = values[:, None] if open_.all() else np.eye(first)[:, ~open_]
        power = table[:, -1] - table[:, first:-1] @ usual
        return cls(table[:, :first], power, design.blocks[scale], given, free)

    def fit(self, kept: NDArray[np.bool_]) -> FloatArray:
        """Fit by least absolute errors some of the rows (iteratively reweighted)."""
        X, y = self.columns[kept] @ self.free, (self.power - self.columns @ self.given)[kept]
        level = float(np.mean(np.abs(y))) or 1.0
        size = np.sqrt(np.mean(X**2, axis=0))
        scale = np.divide(level, size, out=np.zeros_like(size), where=size > 0)
        Z, pull = X * scale, np.full(len(y), 1.0 / len(y))
        found = np.zeros(Z.shape[1])
        for _ in range(_ROUNDS):
            normal = Z.T @ (Z * pull[:, None]) + 1e-8 * level**2 * np.eye(Z.shape[1])
            found = np.linalg.solve(normal, Z.T @ (pull * y))
            pull = 1.0 / len(y) / np.maximum(np.abs(y - Z @ found) / level, _CORE)
        return np.asarray(self.given + self.free @ (found * scale))


@dataclass(frozen=True)
class _Comparison:
    """Two models on what was left out, fold by fold, neither of them fitted to it."""

    what: str  # what a fold is
    explanation: FloatArray  # (folds,): relative errors of the energies
    paper: FloatArray  # (folds,): relative errors of the energies
    refits: FloatArray  # (folds, 2): coefficients of the paper's terms without each fold

    def mixed(self, weight: float) -> FloatArray:
        """Relative errors of the average, by the weight of the explanation."""
        return weight * self.explanation + (1.0 - weight) * self.paper

    def weight(self, handicap: float) -> float:
        """Weight of the explanation: pseudo Bayesian model averaging, bootstrapped.

        Errors of folds have Laplace's distribution, so that one run like no other does not decide,
        and a size that is not known; few folds tell it roughly, which the Bayesian bootstrap allows
        for (Yao et al. 2018, "Using stacking to average Bayesian predictive distributions"). The
        handicap is taken from the logarithm of the odds.
        """
        count = len(self.explanation)
        share = np.random.default_rng(0).dirichlet(np.ones(count), _DRAWS)
        one, other = (share @ np.abs(errors) for errors in (self.explanation, self.paper))
        odds = count * np.log(np.maximum(other, _EXACT) / np.maximum(one, _EXACT)) - handicap
        return float(np.mean(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))))


def averaged(
    problem: Problem,
    fitted: FinalFit,
    parts: Sequence[Part] = (),
    tried: int = 1,
) -> Averaged | None:
    """Average an explanation with the paper's terms, by how well each predicts what it has not met.

    The paper's terms are fitted by least absolute errors of means over half a second, as `identify`
    fits samples. Inertia, which nearly every robot has and which comes to nothing over a run, is in
    both. An effect that was picked out of many is worth less than it seems: each takes the
    logarithm of their number from the odds (Foster and George 1994, "The risk inflation criterion
    for multiple regression"). So an explanation has to be clearly better than two terms before it
    leaves them behind, and what is predicted is seldom worse than by two terms alone.
    """
    count = len(problem.drives)
    picked = sum(bool(part.terms) and not part.effect.usual for part in parts)
    if count < FEWEST_RUNS and not picked and (count == 1 or not parts):
        return None
    plain = problem.as_predicted.with_factors([1.0] * count)
    values = np.array(fitted.model.coefficients)
    start = {t.name: float(v) for t, v in zip(fitted.terms, values, strict=True)}
    whole = plain.design(fitted.terms, None, start, rounds=1)
    windows = _Windows.of(plain, whole)
    if not np.all(windows.energies(windows.run) > 0.0):
        return None
    usual = [
        term for part in parts for term in part.terms
        if part.effect.usual and not part.effect.grid and not part.effect.channels
        and term.kind != "loss"
    ]  # fmt: skip
    inert = np.array([start[term.name] for term in usual])
    inertial = plain.design([*PAPER, *usual])
    short, long = (_Rows.of(inertial, inert, scale, fitted) for scale in (0, -1))
    paper = short.fit(np.ones(len(short.block), bool))

    # What contacts hold on straights was found beside the fit, and stays as it is.
    own = np.array([term.name != WHEEL_FIGHT.name for term in fitted.terms])
    columns, power = whole.longest[0][:, :-1], whole.longest[0][:, -1]
    table = np.column_stack([columns[:, own], power - columns[:, ~own] @ values[~own]])

    design = problem.design(list(compress(fitted.terms, own)), None, start, rounds=1)
    errors = problem.reference(design)
    foretold = errors[_SLOW] <= _NOTHING * problem.floor[_SLOW]
    if count < FEWEST_RUNS and foretold:
        return None
    grams = weighted(design, errors)
    folds = {"run": windows.run} if count > 1 else {}
    if count < FEWEST_RUNS and picked:
        folds["kind of motion"] = _motions(plain, paper)
        if any(part.effect.acts == "place" for part in parts):
            folds["part of the ground"] = _places(plain)
    compared = [
        _compared(what, fold, windows, table, (short, long), grams) for what, fold in folds.items()
    ]
    # All must be foretold: runs that are to come, and motions and ground that are in them.
    handicap = picked * float(np.log(max(tried, 1)))
    weight, worst = min(((one.weight(handicap), one) for one in compared), key=lambda pair: pair[0])
    missed = None
    if count >= FEWEST_RUNS:
        (runs,) = compared
        missed = float(np.sqrt(np.mean(runs.mixed(weight) ** 2)))
    if 1.0 - weight < _NEGLIGIBLE:
        return None if missed is None else Averaged(replace(fitted, run_error=missed), None)
    model = _mixed(fitted, [*PAPER, *usual], np.append(paper, inert), worst, weight)
    about = {t.name: float(v) for t, v in zip(model.terms, model.coefficients, strict=True)}
    between = RunSpread.of(
        plain.design(model.terms, None, about, rounds=1), np.array(model.coefficients)
    )
    told = replace(
        fitted, model=model, run_spread=None if between is None else between.deviation,
        run_error=missed,
    )  # fmt: skip
    sizes = (float(np.mean(np.abs(errors))) for errors in (worst.explanation, worst.paper))
    return Averaged(told, Average(weight, worst.what, *sizes))


def _motions(problem: Problem, paper: FloatArray) -> NDArray[np.intp]:
    """Group the longest windows by what the robot did in them, as far as it takes power.

    Speed and yaw rate, with and without their signs, each by the power that it takes; Lloyd's
    grouping (k-means), from windows that are far from each other.
    """
    driving = 2.0 * abs(float(paper[1]))
    turning = abs(float(paper[0])) * problem.vehicle.slip_moment
    scale = np.array([driving, driving, turning, turning])
    points = scale * np.concatenate(
        [
            drive.windows[-1].mean(
                np.column_stack([m.v, np.abs(m.v), m.omega, np.abs(m.omega)])
            )
            for drive, m in ((drive, drive.motion) for drive in problem.drives)
        ]
    )  # fmt: skip
    return _grouped(points)


def _places(problem: Problem) -> NDArray[np.intp]:
    """Group the longest windows by where the robot was."""
    return _grouped(
        np.concatenate(
            [
                drive.windows[-1].mean(
                    np.column_stack([drive.motion.channels[name] for name in ("x", "y")])
                )
                for drive in problem.drives
            ]
        )
    )


def _grouped(points: FloatArray) -> NDArray[np.intp]:
    count = int(np.clip(len(points) // _MEMBERS, 2, _MOTIONS))

    def apart(centre: FloatArray) -> FloatArray:
        return np.asarray(np.sum((points - centre) ** 2, axis=1))

    centres = [points[np.argmin(apart(points.mean(axis=0)))]]
    gap = apart(centres[0])
    while len(centres) < count and gap.max() > 0.0:
        centres.append(points[np.argmax(gap)])
        gap = np.minimum(gap, apart(centres[-1]))
    if len(centres) == 1:  # alike throughout: the first half and the last
        return np.asarray(np.arange(len(points)) * 2 // len(points))
    with warnings.catch_warnings():  # a group without members keeps its centre
        warnings.filterwarnings("ignore", "One of the clusters is empty")
        _, label = kmeans2(points, np.array(centres), iter=_GROUPINGS, minit="matrix")
    return np.asarray(np.unique(label, return_inverse=True)[1])


def _compared(
    what: str,
    fold: NDArray[np.intp],
    windows: _Windows,
    table: FloatArray,
    paper: tuple[_Rows, _Rows],
    grams: FloatArray,
) -> _Comparison:
    """Leave out one fold after the other, and predict its energy by both models."""
    last = np.searchsorted(windows.block, np.arange(len(grams)), side="right") - 1
    of_block = fold[np.maximum(last, 0)]
    held = left_out(grams.sum(axis=0), grams, of_block)
    number = range(int(fold.max()) + 1)
    short, long = paper
    refits = np.array([short.fit(of_block[short.block] != k) for k in number])
    energies = windows.energies(fold, _LEAST if fold is windows.run else _PART)

    def misses(columns: FloatArray, values: Callable[[int], FloatArray]) -> FloatArray:
        gaps = [columns[fold == k, :-1] @ values(k) - columns[fold == k, -1] for k in number]
        lost = [windows.time[fold == k] @ gap for k, gap in zip(number, gaps, strict=True)]
        return np.asarray(np.array(lost) / energies)

    first = misses(table, lambda k: held[min(k, len(held) - 1)])
    other = np.column_stack([long.columns, long.power])
    return _Comparison(what, first, misses(other, lambda k: refits[k]), refits)


def _mixed(
    fitted: FinalFit,
    terms: Sequence[Term],
    paper: FloatArray,
    compared: _Comparison,
    weight: float,
) -> PowerModel:
    """Average coefficients; their covariance counts by how much the models differ too."""
    model = fitted.model
    every = {term.name: term for term in chain(model.terms, terms)}
    names, first = list(every), len(model.terms)
    one, other = np.zeros(len(names)), np.zeros(len(names))
    one[:first] = model.coefficients
    at = [names.index(term.name) for term in terms]
    other[at] = paper
    mean = weight * one + (1.0 - weight) * other
    covariance = np.zeros((len(names), len(names)))
    if model.covariance is not None:
        covariance[:first, :first] += weight * model.covariance
    number, width = compared.refits.shape
    centred = compared.refits - paper[:width]
    covariance[np.ix_(at[:width], at[:width])] += (
        (1.0 - weight) * (number - 1) / number * centred.T @ centred
    )
    if model.covariance is not None:  # what no drive tells, leaving one out does not
        open_ = [names.index(name) for name in fitted.assumed]
        covariance[np.ix_(open_, open_)] += (1.0 - weight) * model.covariance[np.ix_(open_, open_)]
    for values, share in ((one, weight), (other, 1.0 - weight)):
        covariance += share * np.outer(values - mean, values - mean)
    return PowerModel(
        model.vehicle, tuple(every.values()), mean, 0.5 * (covariance + covariance.T), None,
        model.name,
    )  # fmt: skip


def note_of(told: Average, names: Sequence[str]) -> str:
    """Say what the model for runs to come is made of."""
    what = f"the explanation ({', '.join(names)})" if names else "the paper's terms and inertia"
    why = (
        "runs differ as a whole" if told.left_out == "run"
        else "these drives do not show how the effects act on other motions, or elsewhere"
    )  # fmt: skip
    return (
        f"{why}: the model averages {what}, weight {told.weight:.2f}, with the paper's two terms "
        "by least absolute errors; leaving out one "
        f"{told.left_out} after the other, they miss its energy by "
        f"{100 * told.explanation_error:.1f} % and {100 * told.cautious_error:.1f} %"
    )
