"""Coefficients of power terms fitted to drives together, with covariance (private)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.special import fdtrc

from energyplan.fit.doubts import usual_effects, with_usual
from energyplan.fit.drive import MOMENT, SCALES, Drive, Late, columns_of, prepared, reading_step
from energyplan.fit.regressors import DesignMatrix, is_lossy, linearise_drive, window_means
from energyplan.fit.run import RunEffect
from energyplan.fit.solvers import jackknife, least_squares
from energyplan.logs import DriveLog
from energyplan.logs.checks import find_lost_sign
from energyplan.path import FloatArray
from energyplan.power import HOTEL, REGENERATION_LOSS, SLIP, TRACTION, PowerModel, Term
from energyplan.power.effects import COPPER_LOSS, Effect, most_of
from energyplan.vehicle import Vehicle

# -- fits of a sum of terms to drives, with cross-validation and jackknife -------------------------

WEIGHTS = np.array([1.0, 2.0, 3.0]) / 6.0
"""Weight of each window length in the loss: slow errors matter more for energy."""


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
        """Covariance whose 95 % intervals are those of Student's distribution."""
        return jackknife(self.deviations)

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


def weighted(design: DesignMatrix, errors: FloatArray) -> FloatArray:
    """Gram matrices of the blocks, summed over scales, each divided by its reference error."""
    return np.asarray(np.tensordot(1.0 / (errors * design.counts), design.grams, 1))


def fit(design: DesignMatrix, errors: FloatArray, by_block: bool = False) -> Fit:
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


# -- drives and the terms that are to explain them: their columns, losses linearised ---------------

PAPER = (SLIP, TRACTION)


def by_name(terms: Sequence[Term], values: FloatArray) -> dict[str, float]:
    """Return coefficients by the name of their term."""
    return dict(zip((term.name for term in terms), values.tolist(), strict=True))


FINE = 0.1
"""Part of the floor that likelihoods count as nothing."""

FLOOR = 0.01
"""Error too small to justify an effect, as a fraction of the root mean square power."""

ROUNDS = 20
"""Most steps of a fit with losses."""

_SLIP_LAW = 0.05  # error of p_right - p_left, relative, that the friction law itself has
_KEPT = 0.1  # of friction and resistance in a step, at least
_SETTLED = 5e-3  # fall of the negative logarithm of the likelihood that is none
_SHORTER = 0.4  # part of a step that is tried where the step gave nothing better

_RESTING = 20  # samples at rest from which the power at rest is estimated
_SURE = 3.0  # standard errors within which that is

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)  # its multiples spread evenly


@dataclass(frozen=True)
class LinearisedColumns:
    """Columns of terms on drives, linearised about coefficients."""

    columns: list[FloatArray]  # (n, equations, k): of each drive
    targets: list[FloatArray]  # (n, equations): power that they are to explain [W]


@dataclass(frozen=True)
class _Tried:
    """Coefficients that were tried: the design about them, and what it says of them."""

    values: FloatArray
    design: DesignMatrix
    gram: FloatArray
    misfit: float  # negative logarithm of their likelihood
    promised: float  # by how much a full step is to lower it
    least: FloatArray  # coefficients of least squares there
    paid: NDArray[np.bool_]  # which a step leaves a tenth of, at least: the paper's, and losses
    loss: NDArray[np.bool_]

    def step(self, to: FloatArray) -> FloatArray:
        """Return coefficients to try next."""
        kept = _KEPT * self.values
        return np.where(self.paid & (kept > 0.0), np.maximum(to, kept), to)

    @property
    def rest(self) -> FloatArray:
        """Coefficients that a step leads to which leaves losses as they are."""
        free = np.flatnonzero(~self.loss)
        onto = np.zeros((len(self.values) + 1, len(free) + 1))
        onto[free, np.arange(len(free))] = 1.0
        onto[:-1, -1] = np.where(self.loss, -self.values, 0.0)
        onto[-1, -1] = 1.0
        to = self.values.copy()
        to[free] = solve(onto.T @ self.gram @ onto)
        return self.step(to)


class Problem:
    """Drives, vehicle, and the columns of terms on them."""

    def __init__(self, drives: Sequence[Drive], vehicle: Vehicle) -> None:
        both = all(drive.between is not None for drive in drives)
        self.drives = tuple(
            drive if both or drive.between is None else replace(drive, between=None)
            for drive in drives
        )
        self.vehicle = vehicle
        mean_square = np.mean(np.concatenate([drive.power**2 for drive in self.drives]))
        self.floor = np.full(len(SCALES), FLOOR**2 * float(mean_square))
        gaps = [drive.between * drive.slides for drive in self.drives if drive.between is not None]
        if gaps:
            allowed = _SLIP_LAW**2 * float(np.mean(np.concatenate(gaps) ** 2))
            self.floor = np.append(self.floor, np.full(len(SCALES), allowed))

    @cached_property
    def _rests(self) -> list[NDArray[np.bool_]]:
        """Samples of each drive at which the robot has come to rest."""
        return [
            minimum_filter1d(drive.rests.astype(float), drive.samples_in(2.0 * MOMENT)) > 0.0
            for drive in self.drives
        ]

    @cached_property
    def _drawn_at_rest(self) -> float:
        """Most power that the drives may draw at rest [W]."""
        pairs = zip(self.drives, self._rests, strict=True)
        power = np.concatenate([drive.power[rests] for drive, rests in pairs])
        if len(power) < _RESTING:
            return np.inf
        one = np.ones((len(power), 1))
        mean, variance, _ = least_squares(one, power, [slice(0, len(power))])
        return max(float(mean[0] + _SURE * np.sqrt(variance[0, 0])), 0.0)

    def ends(self, terms: Sequence[Term]) -> FloatArray:
        """Return the range of each coefficient that vehicle and logs admit, shape (k, 2).

        No term draws more at rest than the logs show there.
        """
        found = []
        for term in terms:
            low, high = term.bounds[0], most_of(term, self.vehicle)
            if term.kind == "power" and np.isfinite(self._drawn_at_rest):
                pairs = zip(self.drives, self._rests, strict=True)
                rest = [columns_of(term, one, self.vehicle)[some, 0] for one, some in pairs]
                unit = float(np.mean(np.concatenate(rest)))
                high = min(high, self._drawn_at_rest / unit) if unit > 0.0 else high
            found.append((low, max(low, high)))
        return np.array(found).reshape(-1, 2)

    def on(self, drives: Sequence[Drive]) -> Problem:
        """Return the problem on other drives."""
        return Problem(drives, self.vehicle)

    def without_transitions(self) -> Problem:
        """Return the drives, each throughout in the state that it was in for longer."""
        drives = []
        for drive in self.drives:
            state = round(float(np.mean(drive.motion.channels["changed"])))
            drives.append(drive.with_channels(changed=np.full(len(drive.t), float(state))))
        return self.on(drives)

    def thinned(self, samples: int) -> Problem:
        """Return the drives with so many samples in a shortest window, where they have more."""
        period = max(drive.clock.period for drive in self.drives)
        step = int(SCALES[0] / (samples * period))
        few = [drive.thinned(step) for drive in self.drives] if step > 1 else self.drives
        return self.on(few)

    def averaged(self, period: float) -> Problem:
        """Return means of the drives over a period [s], where they have more samples."""
        return self.on([drive.averaged(period) for drive in self.drives])

    def excerpt(self, samples: int, drives: int) -> Problem:
        """Return some drives, evenly chosen, and pieces of them where they have more samples."""
        some = list(self.drives)
        if len(some) > drives:
            some = [some[k] for k in np.linspace(0, len(some) - 1, drives).round().astype(int)]
        total = sum(len(drive.t) for drive in some)
        if total > samples:
            turns = ((_GOLDEN * np.arange(len(some))) % 1.0).tolist()
            share = samples / total
            some = [drive.pieces(share, turn) for drive, turn in zip(some, turns, strict=True)]
        elif len(some) == len(self.drives):
            return self
        return self.on(some)

    @cached_property
    def of_totals(self) -> Problem:
        """The drives with the power of both sides together alone."""
        if self.drives[0].equations == 1:
            return self
        return self.on([replace(drive, between=None) for drive in self.drives])

    def delayed(self, late: Late) -> Problem:
        """Return the drives with their power taken to be logged late."""
        return self.on([replace(drive, late=late) for drive in self.drives])

    def likelihood(self, errors: FloatArray, windows: FloatArray) -> FloatArray:
        """Return the logarithm of the likelihood of terms from their cross-validated errors."""
        count = evidence_of(windows)
        floor = (FINE * self.floor[: len(windows)]).reshape(-1, *[1] * (np.ndim(errors) - 1))
        fall = np.log(np.maximum(errors, 0.0) + floor + 1e-300)
        return np.asarray(-0.5 * np.tensordot(count, fall, axes=(0, 0)))

    def tables(self, terms: Sequence[Term], values: FloatArray) -> LinearisedColumns:
        """Return, for each drive, the columns of the terms and the power they are to explain."""
        columns, targets = [], []
        for drive in self.drives:
            if is_lossy(drive, terms):
                about = linearise_drive(drive, self.vehicle, terms, values)
                columns.append(about.columns)
                targets.append(drive.measured - about.power + about.columns @ values)
            else:
                found = np.stack([columns_of(t, drive, self.vehicle) for t in terms], axis=-1)
                columns.append(drive.observed(found))
                targets.append(drive.measured)
        return LinearisedColumns(columns, targets)

    def design_about(self, terms: Sequence[Term], values: FloatArray) -> DesignMatrix:
        """Return the design of some terms, losses linearised about `values`."""
        about = self.tables(terms, values)
        return DesignMatrix.of(self.drives, about.columns, about.targets)

    def design(
        self,
        terms: Sequence[Term],
        errors: FloatArray | None = None,
        start: Mapping[str, float] | None = None,
        rounds: int = ROUNDS,
    ) -> DesignMatrix:
        """Return the design of some terms: Gauss-Newton where they are not linear."""
        if not any(is_lossy(drive, terms) for drive in self.drives):
            return self.design_about(terms, np.zeros(len(terms)))
        start = self._start(terms, errors) if start is None else start
        values = np.array([start.get(term.name, 0.0) for term in terms])
        best = self._tried(terms, values, errors)
        onto, part, gain = best.step(best.least) - best.values, 1.0, np.inf
        for _ in range(rounds - 1):
            if min(gain, part * best.promised) < _SETTLED:
                break
            here = self._tried(terms, best.values + part * onto, errors)
            if here.misfit >= best.misfit:
                here = self._tried(terms, here.rest, errors)
            if here.misfit < best.misfit:
                gain, part, best = best.misfit - here.misfit, 1.0, here
                onto = best.step(best.least) - best.values
            else:
                part *= _SHORTER
        return replace(best.design, ended=best.values) if rounds > 1 else best.design

    def _tried(
        self, terms: Sequence[Term], values: FloatArray, errors: FloatArray | None
    ) -> _Tried:
        """Linearise losses about coefficients, and weigh these."""
        about = self.tables(terms, values)
        design = DesignMatrix.of(self.drives, about.columns, about.targets)
        scale = np.ones(len(design.rows)) if errors is None else errors
        gram = weighted(design, scale).sum(axis=0)
        least = solve(gram)
        nothing = float(np.sum(FINE * self.floor[: len(scale)] / scale)) + 1e-300
        left = np.maximum(squared_errors(gram, np.stack([values, least])), 0.0) + nothing
        misfit, hoped = 0.5 * float(evidence_of(design.evidence).sum()) * np.log(left)
        loss = np.array([term.kind == "loss" for term in terms])
        paid = loss | np.array([term in PAPER for term in terms])
        return _Tried(
            values, design, gram, float(misfit), float(misfit - hoped), least, paid,
            loss,
        )  # fmt: skip

    def _start(self, terms: Sequence[Term], errors: FloatArray | None) -> dict[str, float]:
        """Return coefficients of a fit without losses."""
        linear = [term for term in terms if term.kind != "loss"]
        if len(linear) == len(terms):
            return {}
        while True:
            design = self.design(linear, errors, {})
            scale = np.ones(len(design.rows)) if errors is None else errors
            values = solve(weighted(design, scale).sum(axis=0))
            found = by_name(linear, values)
            possible = [
                term for term in linear
                if term in PAPER or term.bounds[0] <= found[term.name] <= term.bounds[1]
            ]  # fmt: skip
            if len(possible) == len(linear):
                return found
            linear = possible

    def reference(self, design: DesignMatrix) -> FloatArray:
        """Return the cross-validated error of a design, plus the floor, at each scale [W^2]."""
        errors = np.full(len(design.rows), 1.0)
        for _ in range(2):
            errors = fit(design, errors).errors + self.floor
        return errors


# -- what the powers of both sides show ------------------------------------------------------------

_HOLDING = 0.01  # mean slip speed up to which contacts may hold [m/s]
_CLEAR = 3.0  # noise beyond which a side should return power
_RISES = 0.3  # rise of what a side shows with what it should return, from which it lacks a sign
_ENOUGH = 20  # samples that a sign needs
_LOST = 0.5  # misfit of the moment between the sides, over it, from which it is not used
_SLIDES = 0.3  # misfit in slight turns up to which contacts slide there; simulated ones: 0.2
_LEFT = 0.01  # share of the samples that must slide
_SLIGHT = 1e-5  # of the speed, by which sides differ in a turn that is not seen
_SETTLING = 5  # fits in which slight turns settle, at most
_CLEARLY = 5.0  # logarithm of the odds from which on they are there


def with_signs(
    logs: Sequence[DriveLog], vehicle: Vehicle, effects: Sequence[Effect],
    drives: Sequence[Drive] | None = None,
) -> list[DriveLog]:  # fmt: skip
    """Return drives of one robot that say whether its sides' powers have a sign.

    What nobody said of any drive is found from all of them together.
    """
    if any(log.signed is False for log in logs):
        return [replace(log, signed=False) for log in logs]
    unknown = [log for log in logs if log.signed is None]
    if not unknown or any(log.sides is None for log in logs):
        return list(logs)
    lost = any(find_lost_sign(log.channels) for log in unknown)
    if not lost:
        problem = Problem(prepared(logs, vehicle) if drives is None else drives, vehicle)
        terms = _usual_terms(effects)
        held = _holding(problem)
        lost = _slide(held) and _unsigned(held, terms, _fitted(held, terms))
    return [replace(log, signed=not lost) for log in logs]


def problem_of(
    logs: Sequence[DriveLog], vehicle: Vehicle, effects: Sequence[Effect],
    drives: Sequence[Drive] | None = None,
) -> Problem:  # fmt: skip
    """Return drives as they are fitted: each side an equation, where it slides and has its sign.

    Slight turns that speeds hardly show look like another surface, or another load, from some place
    or time on: totals are searched for them.
    """
    drives = prepared(logs, vehicle) if drives is None else drives
    problem, terms = Problem(drives, vehicle), _usual_terms(effects)
    if any(log.signed is False for log in with_signs(logs, vehicle, effects, drives)):
        return problem.of_totals
    if problem is not problem.of_totals:
        return with_sides(problem, terms)
    return with_slight_turns(problem, terms)


def _usual_terms(effects: Sequence[Effect]) -> list[Term]:
    """Return the paper's terms and those that nearly every drive shows."""
    usual = (effect for effect in usual_effects(effects) if not effect.grid)
    return [*PAPER, *(term for effect in usual for term in effect.terms)]


def _holding(problem: Problem) -> Problem:
    """Return the drives with contacts that may hold."""
    breakaway = _HOLDING / (problem.vehicle.slip_moment / float(problem.vehicle.loads.sum()))
    return problem.on([replace(one, breakaway=breakaway, fields={}) for one in problem.drives])


def _slide(held: Problem) -> bool:
    """Return whether contacts slide often enough for the powers of the sides to show forces."""
    slides = np.concatenate([drive.slides for drive in held.drives]) != 0.0
    return bool(np.mean(slides) > _LEFT)


def _fitted(held: Problem, terms: Sequence[Term]) -> FloatArray:
    design = held.design(terms)
    return fit(design, held.reference(design)).values


def with_sides(problem: Problem, terms: Sequence[Term]) -> Problem:
    """Return drives whose contacts may hold, or their totals if the sides show nothing."""
    total = problem.of_totals
    held = _holding(problem)
    if not _slide(held):
        return total
    values = _fitted(held, terms)
    if _misfit(held, terms, values, np.inf) > _LOST:
        return total
    slight = _misfit(problem, terms, values, held.drives[0].breakaway)
    return held if _SLIDES < slight < np.inf else problem  # which slides however little it turns


def with_slight_turns(problem: Problem, terms: Sequence[Term]) -> Problem:
    """Return drives with the turns that speeds hardly show, where losses show that contacts slide.

    The smallest turn takes the whole friction of turning, and noisy speeds show it as straight.
    """
    slight = [(one.motion.omega == 0.0) & (one.motion.v != 0.0) for one in problem.drives]
    if not any(some.any() for some in slight):
        return problem
    losses = (COPPER_LOSS, REGENERATION_LOSS)
    tried = [one for loss in losses for one in _settling(problem, slight, [*terms, HOTEL, loss])]
    straight = max(likelihood for likelihood, some in tried if some is problem)
    most, best = max(tried, key=lambda one: one[0])
    return best if most > straight + _CLEARLY else problem


def _settling(
    problem: Problem, slight: Sequence[NDArray[np.bool_]], terms: Sequence[Term]
) -> Iterator[tuple[float, Problem]]:
    """Yield drives with the turns that fit best, at first none; with the likelihood's logarithm."""
    turning = [_turned(*pair) for pair in zip(problem.drives, slight, strict=True)]
    now, turns = problem, [np.zeros_like(some) for some in slight]
    for _ in range(_SETTLING):
        design = now.design(terms)
        found = fit(design, now.reference(design))
        yield float(now.likelihood(found.errors, design.evidence)), now
        former = turns
        turns = [
            _turns(*one, problem.vehicle, terms, found.values)
            for one in zip(problem.drives, turning, slight, strict=True)
        ]
        if all(map(np.array_equal, former, turns)):
            return
        now = problem.on([_turned(*pair) for pair in zip(problem.drives, turns, strict=True)])


def _turned(drive: Drive, turns: NDArray[np.bool_]) -> Drive:
    """Return a drive that turns a little at some samples at which it drives straight."""
    motion = drive.motion
    push = np.where(turns, _SLIGHT * motion.v, 0.0)
    motion = replace(motion, v_left=motion.v_left - push, v_right=motion.v_right + push)
    return replace(drive, motion=motion, fields={})


def _turns(
    straight: Drive, turning: Drive, slight: NDArray[np.bool_], vehicle: Vehicle,
    terms: Sequence[Term], values: FloatArray,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return the straight stretches whose power is nearer to that of a slight turn."""
    label, misses = np.cumsum(np.diff(slight, prepend=False)), []
    for drive in (straight, turning):
        power = linearise_drive(drive, vehicle, terms, values, ()).power[:, 0]
        misses.append(np.bincount(label, np.abs(drive.power - power)))
    return np.asarray(slight & (misses[1] < misses[0])[label])


def _misfit(problem: Problem, terms: Sequence[Term], values: FloatArray, most: float) -> float:
    """Return the misfit of the moment over it, beyond noise, in turns of at most a yaw rate."""
    size = beyond = 0.0
    for drive in problem.drives:
        columns = np.column_stack([columns_of(t, drive, problem.vehicle)[:, 1] for t in terms])
        turns = drive.slides * (np.abs(drive.motion.omega) <= most)
        left = turns * (drive.measured[:, 1] * drive.slides - columns @ values)
        push = turns * columns[:, terms.index(SLIP)] * values[terms.index(SLIP)]
        size += float(push @ push)
        beyond += float(left @ left) - np.count_nonzero(turns) * drive.between_noise**2
    return float(np.sqrt(max(beyond, 0.0) / size)) if size > 0.0 else np.inf


def _unsigned(problem: Problem, terms: Sequence[Term], values: FloatArray) -> bool:
    """Return whether sensors show what sides return as if it were drawn."""
    due, shown, faint, lowest = list[FloatArray](), list[FloatArray](), 0, np.inf
    for drive in problem.drives:
        table = np.stack([columns_of(term, drive, problem.vehicle) for term in terms], axis=-1)
        total, more = (table @ values).T
        between = np.zeros(len(total)) if drive.between is None else drive.between
        for sign in (-1.0, 1.0):  # the left side, the right one
            expected, seen = 0.5 * (total + sign * more), 0.5 * (drive.power + sign * between)
            returns = (expected < -_CLEAR * drive.between_noise) & (drive.slides != 0.0)
            faint += int(np.count_nonzero(expected < 0.0))
            lowest = min(lowest, float(seen.min()))
            due.append(-expected[returns])
            shown.append(seen[returns])
    expected, seen = np.concatenate(due), np.concatenate(shown)
    if len(expected) < _ENOUGH:
        return lowest >= 0.0 and faint >= _ENOUGH
    return float(np.polyfit(expected, seen, 1)[0]) > _RISES


# -- all coefficients of a sum of terms, fitted together to window means of drives -----------------

Further = Callable[[Mapping[str, float]], Sequence[Sequence[FloatArray]]]
"""From coefficients by name to the derivatives of the power by further parameters, on each drive:
shape (n, equations) each."""


@dataclass(frozen=True)
class Fitted:
    """A sum of terms fitted to drives."""

    model: PowerModel  # the model with its covariance
    run: RunEffect  # by how much runs differ as a whole
    assumed: tuple[str, ...]  # terms of which drives show less than is known of any robot
    further: FloatArray  # covariance of further parameters, at whose values the terms were fitted
    errors: Mapping[str, float] = field(default_factory=dict)  # of parameters that were searched

    @property
    def run_spread(self) -> float | None:
        """Relative standard deviation of the energy between runs; None where none were compared."""
        return self.run.deviation if self.run.compared else None


def _offset(problem: Problem, design: DesignMatrix, errors: FloatArray) -> FloatArray:
    """Return the covariance of coefficients that an offset of a sensor with steps leaves.

    A sensor errs alike whenever it reads the same; a robot at rest is read the same throughout.
    """
    step = max(reading_step(drive.power) for drive in problem.drives)
    rows = tuple(
        np.column_stack([table[:, :-1], np.full(len(table), float(k < len(SCALES)))])
        for k, table in enumerate(design.rows)
    )
    by_watt = solve(weighted(replace(design, rows=rows), errors).sum(axis=0))
    return np.asarray(step**2 / 12.0 * np.outer(by_watt, by_watt))


def joint_fit(problem: Problem, terms: Sequence[Term], further: Further | None = None) -> Fitted:
    """Fit terms together."""
    errors = problem.reference(problem.design(terms))
    design = problem.design(terms, errors)
    found, count = fit(design, errors), len(terms)
    covariance = found.reported
    usual = partial(
        with_usual, terms=terms, gram=design.grams.sum(axis=(0, 1))[:count, :count],
        vehicle=problem.vehicle,
    )  # fmt: skip
    values, _, assumed = usual(found.values, covariance)  # what was searched does not move with it
    values = _within(problem, terms, errors, values, assumed)
    moved = further(by_name(terms, values)) if further else ()
    if moved:
        columns = [np.stack(column, axis=-1) for column in zip(*moved, strict=True)]
        design = design.joined(window_means(problem.drives, columns))
        covariance = fit(design, errors).reported
    covariance = covariance + _offset(problem, design, errors)
    covariance, rest = covariance[:count, :count], covariance[count:, count:]
    run = run_effect(problem, terms, values)
    covariance = covariance + run.shared(values, len(problem.drives))
    if assumed:
        covariance = usual(values, covariance)[1]
    model = PowerModel(problem.vehicle, tuple(terms), values, 0.5 * (covariance + covariance.T))
    return Fitted(model, run, assumed, rest)


def run_effect(problem: Problem, terms: Sequence[Term], values: FloatArray) -> RunEffect:
    """Compare what runs took with what a sum of terms says of them."""
    plain = problem.of_totals
    design = plain.design(terms, None, by_name(terms, values), rounds=1)
    return RunEffect.between(design, np.array(values), plain.drives[0].windows[-1].length)


def _within(
    problem: Problem, terms: Sequence[Term], errors: FloatArray, values: FloatArray,
    assumed: Sequence[str],
) -> FloatArray:  # fmt: skip
    """Put coefficients that are beyond an end of their range there, and fit the others again."""
    least, most = problem.ends(terms).T
    fixed = np.array([term.name in assumed for term in terms])
    while np.any(beyond := (values < least) | (values > most)):
        fixed |= beyond
        values = np.clip(values, least, most)
        if not np.all(fixed):
            about = problem.design_about(terms, values)
            values[~fixed] = fit(about.fixed(fixed, values), errors).values
    return values
