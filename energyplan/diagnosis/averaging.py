"""Predictions of future runs: two terms, small extensions and the explanation, averaged.

Runs of one robot on one ground differ as a whole, and few runs, or short ones, say little about
which effects the next one will show. An average of models that err differently is then better than
the best of them, and better than a choice among them (Timmermann 2006, "Forecast combinations").
Models count by the energies of what they were not fitted to. From five runs on, their weights are
those whose average misses whole runs least (Breiman 1996, "Stacked regressions"). Weights fitted to
fewer runs vary more than they gain: there the odds of the models follow from their errors, with
four runs of all models, with fewer of the two terms and the explanation, by the errors of runs and
of kinds of motion. Blocks of time would not do there: neighbouring ones are alike, and an
explanation that fits them may be wrong about the first motion that they do not have.

The two terms, and one or two further terms that many robots have, are fitted by least absolute
errors of means over half a second, as `identify` fits samples, and fitted again without each run.
Losses that the powers of both sides measure are no matter of weights: every model has them.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, compress

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.optimize import nnls

from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.result import Average
from energyplan.fit.estimate import (
    FLOOR,
    PAPER,
    Fitted,
    Problem,
    by_name,
    left_out,
    run_effect,
    weighted,
)
from energyplan.fit.regressors import DesignMatrix, held_forces
from energyplan.fit.solvers import Bounds, lad
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Term
from energyplan.power.effects import WHEEL_FIGHT

FEWEST_RUNS = 4
"""Runs from which leaving one out is enough to estimate how well future runs are predicted."""

_LEAST = 0.1  # least power that a run counts as drawing, over the typical power
_PART = 1.0  # the same of a kind of motion, which is only a part of a run
_NEGLIGIBLE = 0.02  # weight that is too small for a further model
_TOGETHER = 2  # most terms of an extension
_PAIRED = 6  # runs from which on two further terms are more than luck
_RATHER = 0.5  # weight from which on an explanation is more than a suspicion
_SHOWN = 0.05  # weight from which on an extension is named
_SLOW = 1  # scale at which an explanation is found to leave nothing: two seconds
_NOTHING = (USUAL_RUN_SPREAD / FLOOR) ** 2  # of the floor, less than which runs differ by anyway
_MOTIONS = 8  # most kinds of motion
_MEMBERS = 3  # windows of a kind of motion, in the mean
_GROUPINGS = 50  # rounds of grouping
_EXACT = 1e-6  # relative error that is none
_DRAWS = 400  # of the Bayesian bootstrap
_SUM = 1e3  # weight of the equation that weights add up to one, over that of the largest error


@dataclass(frozen=True)
class Averaged:
    """A model for future runs."""

    fitted: Fitted  # the average
    average: Average | None  # weights, and why


@dataclass(frozen=True)
class _WindowTotals:
    """Means of plain totals over the longest windows."""

    run: NDArray[np.intp]  # (w,): run of each window
    block: NDArray[np.intp]  # (w,): block of each window
    time: FloatArray  # (w,): time that a window stands for [s]
    power: FloatArray  # (w,): measured power [W]

    @classmethod
    def of(cls, problem: Problem, design: DesignMatrix) -> _WindowTotals:
        time, power = [], []
        for drive in problem.drives:
            windows = drive.windows[-1]
            time.append(windows.counts * drive.weights.sum() / windows.counts.sum())
            power.append(windows.mean(drive.power))
        block = design.longest_blocks
        return cls(design.drives[block], block, np.concatenate(time), np.concatenate(power))

    def energies(self, fold: NDArray[np.intp], least: float = _LEAST) -> FloatArray:
        """Measured energy of each fold [J], at least that of a share of the typical power."""
        energy, seconds = (
            np.bincount(fold, values) for values in (self.time * self.power, self.time)
        )
        return np.asarray(np.maximum(energy, least * energy.sum() / seconds.sum() * seconds))

    def misses(
        self, fold: NDArray[np.intp], columns: FloatArray, power: FloatArray, values: FloatArray
    ) -> FloatArray:
        """Relative error of each fold's energy, by the coefficients without it, (folds, k)."""
        lost = np.bincount(fold, self.time * (np.sum(columns * values[fold], axis=1) - power))
        return np.asarray(lost / self.energies(fold, _LEAST if fold is self.run else _PART))


@dataclass(frozen=True)
class _Member:
    """A model of the average: terms, and their coefficients with all runs and without each."""

    names: tuple[str, ...]  # of what it adds to the two terms
    terms: tuple[Term, ...]
    values: FloatArray  # (k,): coefficients
    covariance: FloatArray
    errors: FloatArray  # (folds,): relative errors of energies
    explains: bool = False  # whether it is the explanation


@dataclass(frozen=True)
class _RefittedExplanation:
    """The explanation, and how it is fitted again without some of the blocks."""

    fitted: Fitted
    names: tuple[str, ...]
    whole: DesignMatrix  # as it predicts future runs
    grams: FloatArray  # of what it is fitted to, by block
    own: NDArray[np.bool_]  # which of its terms are fitted
    leaves_nothing: bool

    @classmethod
    def of(
        cls, problem: Problem, plain: Problem, fitted: Fitted, parts: Sequence[Part]
    ) -> _RefittedExplanation:
        """Prepare an explanation."""
        # What contacts hold on straights was found separately from the fit, and stays as it is.
        own = np.array([term.name != WHEEL_FIGHT.name for term in fitted.model.terms])
        start = by_name(fitted.model.terms, fitted.model.coefficients)
        whole = plain.design(fitted.model.terms, None, start, rounds=1)
        design = problem.design(list(compress(fitted.model.terms, own)), None, start, rounds=1)
        errors = problem.reference(design)
        nothing = bool(errors[_SLOW] <= _NOTHING * problem.floor[_SLOW])
        names = tuple(part.effect.name for part in parts)
        return cls(fitted, names, whole, weighted(design, errors), own, nothing)

    def measured(self, problem: Problem) -> tuple[Term, ...]:
        """Return losses, and their heat on straights, that the powers of both sides measure."""
        terms = self.fitted.model.terms
        lossy = any(term.kind == "loss" for term in terms)
        if problem.drives[0].equations == 1 or not lossy:
            return ()
        return tuple(term for term in terms if term.kind == "loss")

    def member(self, windows: _WindowTotals, fold: NDArray[np.intp]) -> _Member:
        """Fit it without each fold."""
        last = np.searchsorted(windows.block, np.arange(len(self.grams)), side="right") - 1
        refits = left_out(self.grams.sum(axis=0), self.grams, fold[np.maximum(last, 0)])
        refits = refits[np.minimum(np.arange(int(fold.max()) + 1), len(refits) - 1)]
        model, columns = self.fitted.model, self.whole.longest[0][:, :-1]
        values = np.array(model.coefficients)
        power = self.whole.longest[0][:, -1] - columns[:, ~self.own] @ values[~self.own]
        errors = windows.misses(fold, columns[:, self.own], power, refits)
        covariance = np.zeros((len(values),) * 2) if model.covariance is None else model.covariance
        return _Member(self.names, model.terms, values, covariance, errors, explains=True)


@dataclass(frozen=True)
class _Table:
    """Window means of the two terms and their extensions."""

    problem: Problem
    windows: _WindowTotals
    terms: tuple[Term, ...]
    shown: DesignMatrix  # what the terms are fitted to
    design: DesignMatrix  # as they predict future runs
    fitted: Fitted
    given: dict[str, float]  # terms that every member has, and their coefficients
    measured: tuple[Term, ...]  # those of them that the powers of both sides measure
    ratio: FloatArray | None  # of the two terms, where drives leave both open

    @classmethod
    def of(
        cls, problem: Problem, plain: Problem, explanation: _RefittedExplanation,
        parts: Sequence[Part], common: Sequence[Term],
    ) -> _Table:  # fmt: skip
        """Average the columns of drives over windows."""
        fitted = explanation.fitted
        values = by_name(fitted.model.terms, fitted.model.coefficients)
        usual = () if common else tuple(
            term for part in parts for term in part.terms
            if part.effect.usual and not part.effect.grid and not part.effect.channels
            and term.kind != "loss"
        )  # fmt: skip
        open_ = [term.name for term in PAPER if term.name in fitted.assumed]
        both = len(open_) == len(PAPER)
        measured = explanation.measured(problem)
        given = {term.name: values[term.name] for term in (*usual, *measured)}
        given |= {} if both else {name: values[name] for name in open_}
        terms = (*PAPER, *usual, *measured, *common)
        shown = design = plain.design(terms, None, values, rounds=1)
        if measured:  # the moments of these very drives are known, and their heat
            still = [0.0 if term.name == WHEEL_FIGHT.name else 1.0 for term in terms]
            shown = problem.design(terms, None, values, rounds=1)
            shown = replace(shown, rows=tuple(rows * [*still, 1.0] for rows in shown.rows))
        return cls(
            plain, _WindowTotals.of(plain, explanation.whole), terms, shown, design, fitted, given,
            measured,
            np.array([values[term.name] for term in PAPER]) if both else None,
        )  # fmt: skip

    def member(self, extension: Sequence[Term], fold: NDArray[np.intp]) -> _Member:
        """Fit the two terms and some more with all runs, and without each fold."""
        beside = [term for term in self.terms if term.name in self.given and term not in PAPER]
        terms = (*PAPER, *beside, *extension)
        at = [self.terms.index(term) for term in terms]
        pick = [*at, -1]
        short, long = self.shown.rows[0][:, pick], self.design.rows[-1][:, pick]
        fixed = np.array([self.given.get(term.name, np.nan) for term in terms])
        values = self._fit(short, fixed, terms)
        block = self.shown.blocks[0]
        last = np.searchsorted(self.windows.block, np.arange(int(block.max()) + 1), "right") - 1
        of_row = fold[np.maximum(last, 0)][block]
        count = int(fold.max()) + 1
        refits = np.array([self._fit(short[of_row != k], fixed, terms) for k in range(count)])
        errors = self.windows.misses(fold, long[:, :-1], long[:, -1], refits)
        moved = refits - values
        covariance = (count - 1) / count * moved.T @ moved
        if self.fitted.model.covariance is not None:  # leaving one out misses what no drive shows
            names = [term.name for term in self.fitted.model.terms]
            known = {*self.fitted.assumed, *(term.name for term in self.measured)}
            open_ = [k for k, term in enumerate(terms) if term.name in known]
            theirs = [names.index(terms[k].name) for k in open_]
            covariance[np.ix_(open_, open_)] += self.fitted.model.covariance[np.ix_(theirs, theirs)]
        names = [term.name for term in extension]
        return _Member(tuple(names), terms, values, covariance, errors)

    def _fit(self, table: FloatArray, fixed: FloatArray, terms: Sequence[Term]) -> FloatArray:
        """Fit the terms that are not fixed by least absolute errors, within their ends."""
        values, free = np.array(fixed), np.isnan(fixed)
        if not free.any():
            return values
        X, ends = table[:, :-1], self.problem.ends(terms)
        y = table[:, -1] - X[:, ~free] @ values[~free]
        if self.ratio is None:
            values[free] = lad(X[:, free], y, Bounds(*ends[free].T))
            return values
        first = len(PAPER)
        free[:first] = False
        joined = np.column_stack([X[:, :first] @ self.ratio, X[:, free]])
        ends = np.vstack([[0.0, np.inf], ends[free]])
        found = lad(joined, y, Bounds(*ends.T))
        values[:first], values[free] = found[0] * self.ratio, found[1:]
        return values

    def extensions(self, fold: NDArray[np.intp]) -> list[_Member]:
        """Fit all sets of one or two further terms that resist whatever the robot does."""
        common = [term for term in self.terms if term not in PAPER and term.name not in self.given]
        most = _TOGETHER if len(self.problem.drives) >= _PAIRED else 1
        made = (
            self.member(some, fold)
            for size in range(1, most + 1) for some in combinations(common, size)
        )  # fmt: skip
        return [one for one in made if self._resists(one)]

    def _resists(self, one: _Member) -> bool:
        """Return whether steady motion on level ground always draws power."""
        motions = [drive.motion for drive in self.problem.drives]
        v = max(float(np.max(np.abs(motion.v))) for motion in motions)
        w = max(float(np.max(np.abs(motion.omega))) for motion in motions)
        ahead, turn = np.meshgrid(np.linspace(0.0, 2.0 * v, 9), np.linspace(0.0, 2.0 * w, 9))
        still = {name: 0.0 for term in one.terms for name in term.channels}
        vehicle = self.problem.vehicle
        motion = Motion.from_twist(ahead.ravel(), turn.ravel(), vehicle.icr, **still)
        return bool(np.all(PowerModel(vehicle, one.terms, one.values).power(motion) >= 0.0))


def _stacked(errors: FloatArray) -> FloatArray:
    """Return the weights of models, (m,), whose average has the least errors, from (m, folds)."""
    total = _SUM * max(float(np.abs(errors).max(initial=0.0)), _EXACT)
    rows = np.vstack([errors.T, np.full(len(errors), total)])
    weights, _ = nnls(rows, np.append(np.zeros(errors.shape[1]), total))
    return np.asarray(weights / weights.sum())


def _by_odds(errors: FloatArray, handicap: FloatArray) -> FloatArray:
    """Return the weights of models by the odds of their errors, (m, folds), less a handicap."""
    count = errors.shape[1]
    share = np.random.default_rng(0).dirichlet(np.ones(count), _DRAWS)
    missed = np.maximum(share @ np.abs(errors).T, _EXACT)
    odds = -count * np.log(missed) - handicap
    chance = np.exp(odds - odds.max(axis=1, keepdims=True))
    return np.asarray(np.mean(chance / chance.sum(axis=1, keepdims=True), axis=0))


def _by_runs(errors: FloatArray) -> tuple[FloatArray, float]:
    """Return the weights of models by left-out runs, and the error of an average of a run.

    That error, the root mean square over the runs, is by weights that the run had no part in.
    Weights are fitted where four runs or more are left without one; three are no more than the
    models that such an average uses. Odds are a mean over draws of the runs already.
    """
    models, count = errors.shape
    no_handicap = np.zeros(models)  # what was fitted to the other runs shows in the errors
    rest = [np.delete(errors, run, axis=1) for run in range(count)]
    if count > FEWEST_RUNS:
        without = np.array([_stacked(one) for one in rest])
        weights = without.mean(axis=0)
    else:
        without = np.array([_by_odds(one, no_handicap) for one in rest])
        weights = _by_odds(errors, no_handicap)
        weights = np.where(weights < _NEGLIGIBLE, 0.0, weights)
        weights /= weights.sum()
    missed = np.sum(without * errors.T, axis=1)
    return weights, float(np.sqrt(np.mean(missed**2)))


def averaged(
    problem: Problem,
    fitted: Fitted,
    parts: Sequence[Part] = (),
    common: Sequence[Term] = (),
) -> Averaged | None:
    """Average two terms, extensions and an explanation, by how each predicts unseen runs."""
    count = len(problem.drives)
    picked = sum(bool(part.terms) and not part.effect.usual for part in parts)
    telling = _telling(problem)
    few = int(telling.sum()) < FEWEST_RUNS
    if few and not picked and (count == 1 or not parts):
        return None
    plain = problem.of_totals
    explanation = _RefittedExplanation.of(problem, plain, fitted, parts)
    if few and explanation.leaves_nothing:
        return None
    table = _Table.of(problem, plain, explanation, parts, () if few else common)
    windows = table.windows
    if not np.all(windows.energies(windows.run) > 0.0):
        return None
    folds = {"run": windows.run} if count > 1 else {}
    if few and picked:
        halves = np.arange(len(windows.run)) * 2 // len(windows.run)
        folds["kind of motion"] = _motions(plain, table.member((), halves).values)
    compared, missed = [], 0.0
    for what, fold in folds.items():
        members = [table.member((), fold), *table.extensions(fold)]
        if parts or few:
            members.append(explanation.member(windows, fold))
        errors = np.array([one.errors for one in members])
        if what == "run":
            errors = errors[:, telling]
        if few:
            weights = _by_odds(errors, np.array([0.0, picked]))
        else:
            weights, missed = _by_runs(errors)
        compared.append((what, members, errors, weights))
    # All must be predicted: runs that are to come, and motions and ground that are in them.
    what, members, errors, weights = min(compared, key=lambda one: float(one[3][-1]))
    own = float(weights[-1]) if members[-1].explains else 0.0
    if 1.0 - own < _NEGLIGIBLE:
        return None if few else Averaged(replace(fitted, run=fitted.run.at_least(missed)), None)
    model = _mixed(plain, fitted, members, weights)
    run = run_effect(plain, model.terms, np.array(model.coefficients))
    mixed = replace(fitted, model=model, run=run.at_least(missed))
    theirs = errors[-1] if members[-1].explains else weights @ errors
    sizes = [float(np.mean(np.abs(some))) for some in (theirs, errors[0])]
    shares = {
        name: sum(float(w) for w, one in zip(weights, members, strict=True)
                  if name in one.names and not one.explains)
        for name in (term.name for term in common)
    }  # fmt: skip
    return Averaged(mixed, Average(own, what, sizes[0], sizes[1], shares))


def _telling(problem: Problem) -> NDArray[np.bool_]:
    """Return which runs took enough energy for its relative error to be informative."""
    energy = np.array([float(drive.weights @ drive.power) for drive in problem.drives])
    seconds = np.array([float(drive.weights.sum()) for drive in problem.drives])
    return np.asarray(energy > _LEAST * energy.sum() / seconds.sum() * seconds)


def _mixed(
    plain: Problem, fitted: Fitted, members: Sequence[_Member], weights: FloatArray
) -> PowerModel:
    """Average coefficients; their covariance includes by how much the models differ."""
    kept = [k for k, weight in enumerate(weights) if weight > 0.0]
    every = {term.name: term for k in kept for term in members[k].terms}
    places = list(every)
    values = np.zeros((len(kept), len(places)))
    covariance = np.zeros((len(places), len(places)))
    for row, k in zip(values, kept, strict=True):
        one = members[k]
        at = [places.index(term.name) for term in one.terms]
        row[at] = one.values
        covariance[np.ix_(at, at)] += weights[k] * one.covariance
    mean = weights[kept] @ values
    terms = list(every.values())
    mean *= [_share(plain, term, members, weights, terms, mean) for term in terms]
    centred = values - mean
    covariance += centred.T @ (weights[kept][:, None] * centred)
    # What all models put at nothing is no part of what is handed on.
    there = [k for k, term in enumerate(terms) if term in PAPER or mean[k] != 0.0]
    covariance = covariance[np.ix_(there, there)]
    model = fitted.model
    return PowerModel(
        model.vehicle, tuple(terms[k] for k in there), mean[there],
        0.5 * (covariance + covariance.T), None, model.name,
    )  # fmt: skip


def _share(
    plain: Problem, loss: Term, members: Sequence[_Member], weights: FloatArray,
    terms: Sequence[Term], mean: FloatArray,
) -> float:  # fmt: skip
    """Return by what to multiply the mean of a loss, so that mean powers are those of the models.

    It acts on forces, which are averaged too.
    """
    if loss.kind != "loss":
        return 1.0

    def lost(terms: Sequence[Term], values: FloatArray) -> float:
        total = 0.0
        for drive in plain.drives:
            forces = held_forces(drive, plain.vehicle, terms, values)
            own = loss.function(drive.held, plain.vehicle, forces, **loss.params)
            total += float(drive.weights @ own.total)
        return total * float(values[list(terms).index(loss)])

    wanted = sum(
        float(weight) * lost(one.terms, one.values)
        for one, weight in zip(members, weights, strict=True) if weight > 0.0 and loss in one.terms
    )  # fmt: skip
    made = lost(terms, mean)
    return wanted / made if made > 0.0 else 1.0


def _motions(problem: Problem, paper: FloatArray) -> NDArray[np.intp]:
    """Group the longest windows by what the robot did in them, as far as it takes power."""
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


def _grouped(points: FloatArray) -> NDArray[np.intp]:
    count = int(np.clip(len(points) // _MEMBERS, 2, _MOTIONS))

    def distance(centre: FloatArray) -> FloatArray:
        return np.asarray(np.sum((points - centre) ** 2, axis=1))

    centres = [points[np.argmin(distance(points.mean(axis=0)))]]
    gap = distance(centres[0])
    while len(centres) < count and gap.max() > 0.0:
        centres.append(points[np.argmax(gap)])
        gap = np.minimum(gap, distance(centres[-1]))
    if len(centres) == 1:  # alike throughout: the first half and the last
        return np.asarray(np.arange(len(points)) * 2 // len(points))
    with warnings.catch_warnings():  # a group without members keeps its centre
        warnings.filterwarnings("ignore", "One of the clusters is empty")
        _, label = kmeans2(points, np.array(centres), iter=_GROUPINGS, minit="matrix")
    return np.asarray(np.unique(label, return_inverse=True)[1])


def note_of(average: Average, names: Sequence[str]) -> str:
    """Describe the contents of the model for future runs."""
    why = (
        "runs differ as a whole" if average.left_out == "run"
        else "these drives do not show how the effects act on other motions, or elsewhere"
    )  # fmt: skip
    own = (
        f"the explanation ({', '.join(names)}), weight {average.weight:.2f}, with " if names else ""
    )
    further = [
        f"{name} {share:.2f}" for name, share in average.extensions.items() if share >= _SHOWN
    ]
    with_more = f", alone and with further terms ({', '.join(further)})" if further else ""
    text = (
        f"{why}: the model averages {own}the paper's two terms by least absolute errors{with_more};"
        f" leaving out one {average.left_out} after the other, "
        f"{'the explanation' if own else 'it'} "
        f"misses its energy by {100 * average.explanation_error:.1f} % and the two terms by "
        f"{100 * average.cautious_error:.1f} %"
    )
    if own and average.weight < _RATHER and average.explanation_error >= average.cautious_error:
        text += ". The explanation is a suspicion only: it predicts them no better"
    return text
