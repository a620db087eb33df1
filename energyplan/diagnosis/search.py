"""Joint search over sets of effects by cross-validation, with a probability for each set (private).

Effects mask each other, so that sets are compared and not single effects (docs/theory, section 7).
All candidates' columns go into one Gram matrix a fold; the cross-validated error of any set is then
a few small linear solves. Every pair is tried, and larger sets grow from the best smaller ones.
The best sets are fitted again as they are, losses and all, and each effect of a set must earn its
place in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from energyplan.diagnosis.change_points import lines, mark_changes
from energyplan.diagnosis.fitting import PAPER, Fit, Part, Problem, difference, fit, solve
from energyplan.diagnosis.linear import is_lossy, linearise
from energyplan.diagnosis.windows import Design, channels_of, column
from energyplan.fit.covariance import autocorrelation
from energyplan.path import FloatArray
from energyplan.power import HOTEL, PowerModel, Term
from energyplan.power.effects import Effect

SIGNIFICANCE = 0.01
"""Chance of a false find that is accepted, over all candidates together."""

WORTHWHILE = 0.05
"""Smallest fall of the cross-validated error, mean over the scales, that is worth an effect."""

_WEIGHTS = np.array([1.0, 2.0, 3.0]) / 6.0
"""Say of each scale: what lasts adds up to energy."""

_RARE = -6.0
"""Logarithm of the odds of an effect before the data, against its absence."""

_LOG = -1.0
"""What is added for an effect of the log: the robot is the first suspect."""

_PAIRED = 24  # effects of which all pairs are tried
_BEAM = 8  # sets that grow
_EXACT = 6  # sets that are fitted as they are
_FOLDS = 40  # most folds of the search
_BATCH = 128  # sets evaluated at once
_RIVAL = 0.05  # probability of another explanation, over that of the best, that is worth naming
_NEAR = 4.0  # logarithm of the odds at which a replacement is a rival
_DELAYS = np.round(np.arange(-1.0, 1.01, 0.1), 1)  # of the power [s]


@dataclass(frozen=True)
class Candidate:
    """An effect with some values of its parameters, and where its columns are.

    Parameters
    ----------
    part : Part
        The effect.
    columns : tuple of int
        Its columns in the table of all candidates.
    prior : float
        Logarithm of its odds before the data.
    marked : Problem or None
        The drives with the times of a change; None where nothing changes.
    """

    part: Part
    columns: tuple[int, ...]
    prior: float
    marked: Problem | None = None

    @cached_property
    def terms(self) -> tuple[str, ...]:
        """Names of its terms."""
        return tuple(term.name for term in self.part.terms)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.part.effect.name


Set = tuple[int, ...]
"""Numbers of candidates, ascending."""

Make = Callable[[FloatArray], tuple[list[Part], Problem]]

Labels = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Names of candidates with their parameters."""


@dataclass(frozen=True)
class Explanation:
    """A set of effects that may be the reason.

    Parameters
    ----------
    parts : tuple of Part
        The effects, the one that explains most first.
    probability : float
        That this set is the right one, among those of the catalogue.
    problem : Problem
        The drives, with delays, factors and times of changes as this set has them.
    gains : tuple of Gain
        What each effect of the set is worth in it.
    """

    parts: tuple[Part, ...]
    probability: float
    problem: Problem
    gains: tuple[Gain, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(part.effect.name for part in self.parts)


@dataclass(frozen=True)
class Gain:
    """What an effect is worth beside the others of its set.

    Parameters
    ----------
    improvement, error : float
        Fall of the cross-validated error when it joins, mean over the scales, and its standard
        error.
    p_value : float
        Of its coefficients being zero, times the number of candidates.
    weight : float
        By how much it raises the logarithm of the set's likelihood.
    """

    improvement: float
    error: float
    p_value: float
    weight: float


@dataclass(frozen=True)
class Found:
    """Outcome of the search: explanations, the most probable one first."""

    explanations: tuple[Explanation, ...]
    untested: tuple[tuple[str, str], ...]

    @property
    def best(self) -> Explanation:
        """The most probable explanation."""
        return self.explanations[0]

    def rivals(self, name: str) -> tuple[str, ...]:
        """Return the effects that may stand in for one of the best explanation."""
        best = self.best
        found: list[str] = []
        for other in self.explanations[1:]:
            new = set(other.names) - set(best.names)
            gone = set(best.names) - set(other.names)
            if name in gone and new and other.probability > _RIVAL * best.probability:
                found += [one for one in other.names if one in new and one not in found]
        return tuple(found)

    def probability(self, name: str) -> float:
        """Return the probability that an effect is there."""
        return float(sum(one.probability for one in self.explanations if name in one.names))


@dataclass
class _Evaluated:
    """A set fitted as it is."""

    counts: FloatArray
    errors: FloatArray
    fit: Fit
    problem: Problem
    sound: bool
    parts: tuple[Part, ...]
    gains: dict[int, Gain] = field(default_factory=dict)


def terms_of(parts: Sequence[Part]) -> list[Term]:
    """Return the paper's terms and those of the parts."""
    return [*PAPER, *(term for part in parts for term in part.terms)]


class Search:
    """Joint search over a catalogue.

    Parameters
    ----------
    problem : Problem
        Training drives.
    effects : sequence of Effect
        The catalogue.
    progress : callable
        Called with a fraction in [0, 1] and what is being done.
    limit : int
        Largest number of effects.
    """

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        progress: Callable[[float, str], object],
        limit: int,
    ) -> None:
        self.problem, self.progress, self.limit = problem, progress, limit
        self.untested: list[tuple[str, str]] = []
        testable = [effect for effect in effects if self._testable(effect)]
        self.delay = next((e for e in testable if e.name == "time_offset"), None)
        self.effects = [e for e in testable if e.acts != "kinematics" and e is not self.delay]
        self.rest = _Rest(problem)
        self.evaluated: dict[tuple[Set, float], _Evaluated] = {}
        self.repeats = np.ones(len(_WEIGHTS))
        self.errors: FloatArray | None = None

    def _testable(self, effect: Effect) -> bool:
        common = channels_of(self.problem.drives)
        for name in effect.channels:
            if name not in common:
                self.untested.append((effect.name, f"the logs have no channel {name!r}"))
                return False
            if all(np.ptp(d.motion.channels[name]) < 1e-9 for d in self.problem.drives):
                self.untested.append((effect.name, f"the channel {name!r} never changes"))
                return False
        return True

    # -- the likelihood -------------------------------------------------------------------------

    def likelihood(self, errors: FloatArray, windows: FloatArray) -> FloatArray:
        """Return the logarithm of a set's likelihood from its cross-validated errors.

        Parameters
        ----------
        errors : ndarray, shape (scales, ...)
            Mean square errors [W^2].
        windows : ndarray, shape (scales,)
            Number of windows, of which correlated ones count as fewer.

        Returns
        -------
        ndarray, shape (...)
            Normal likelihood, a weighted mean over the scales: each alone is one.
        """
        count = _WEIGHTS * windows / self.repeats
        fall = np.log(np.maximum(errors, 0.0) + self.problem.floor + 1e-300)
        return np.asarray(-0.5 * np.tensordot(count, fall, axes=(0, 0)))

    def _settle_repeats(self, pools: Mapping[float, tuple[list[Candidate], list[Set]]]) -> None:
        """Count neighbouring windows whose residuals repeat each other as fewer.

        By the residual of the set that fits best: what a worse one leaves is no noise.
        """
        every = [
            self._evaluate(chosen, candidates, delay)
            for delay, (candidates, sets) in pools.items() for chosen in sets
        ]  # fmt: skip
        best = max(every, key=self.score)
        self.errors = best.errors
        design = best.problem.design(terms_of(best.parts), best.errors)
        repeats = []
        for table, block in zip(design.rows, design.blocks, strict=True):
            residual = table[:, -1] - table[:, :-1] @ best.fit.values
            owner = design.drives[block]
            edges = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
            pieces = [slice(a, b) for a, b in pairwise(edges.tolist())]
            repeats.append(autocorrelation(residual, pieces).repeats)
        self.repeats = np.array(repeats)

    def score(self, one: _Evaluated) -> float:
        """Return the logarithm of an evaluated set's likelihood."""
        return float(self.likelihood(one.fit.errors, one.counts))

    # -- candidates -----------------------------------------------------------------------------

    def _variants(self, effect: Effect) -> list[Part]:
        if effect.acts == "place":
            return list(lines(effect, self.problem.drives))
        chosen: list[tuple[tuple[str, float], ...]] = [()]
        for key, values in effect.grid.items():
            chosen = [(*before, (key, value)) for before in chosen for value in values]
        return [Part(effect, params) for params in chosen]

    def _candidates(self, marked: Problem | None) -> list[Candidate]:
        found, first = [], len(PAPER)
        # Changes last: they are numbered only once their times are known.
        for effect in sorted(self.effects, key=lambda effect: effect.acts == "change"):
            parts = self._variants(effect)
            looks = len(parts)
            if effect.acts == "change":
                if marked is None:
                    continue
                looks = sum(len(drive.windows[0].starts) for drive in self.problem.drives)
            prior = 0.0 if effect.usual else _RARE
            prior += (_LOG if effect.acts == "log" else 0.0) - np.log(looks)
            for part in parts:
                columns = tuple(range(first, first + len(part.terms)))
                first += len(columns)
                change = marked if effect.acts == "change" else None
                found.append(Candidate(part, columns, float(prior), change))
        return found

    def _table(
        self, problem: Problem, candidates: Sequence[Candidate], about: dict[str, float]
    ) -> Design:
        """Columns of the paper's terms and of all candidates, linearised about coefficients."""
        terms = [*PAPER, *(term for one in candidates for term in one.part.terms)]
        values = np.zeros(len(terms))
        taken: set[str] = set()
        for k, term in enumerate(terms):
            if term.name in about and term.name not in taken:
                values[k] = about[term.name]
                taken.add(term.name)
        marked = next((one.marked for one in candidates if one.marked is not None), None)
        columns, targets = [], []
        for k, drive in enumerate(problem.drives):
            if marked is not None:
                changed = marked.drives[k].motion.channels["changed"]
                drive = drive.with_channels(changed=changed)
            if is_lossy(drive, terms):
                told = linearise(drive, problem.vehicle, terms, values)
                seen = drive.seen(np.column_stack([told.columns, told.power]))
                columns.append(seen[:, :-1])
                targets.append(drive.power - seen[:, -1] + seen[:, :-1] @ values)
            else:
                plain = [column(term, drive, problem.vehicle) for term in terms]
                columns.append(drive.seen(np.column_stack(plain)))
                targets.append(drive.power)
        return Design.of(problem.drives, columns, targets).with_folds(_FOLDS)

    # -- scoring many sets ----------------------------------------------------------------------

    def _scores(
        self,
        design: Design,
        candidates: Sequence[Candidate],
        sets: Sequence[Set],
        reference: FloatArray,
    ) -> FloatArray:
        """Likelihood times prior of sets, as logarithms."""
        grams = design.grams
        bounds = self._bounds(candidates)
        found = np.full(len(sets), -np.inf)
        wide = [
            [*range(len(PAPER)), *(c for one in chosen for c in candidates[one].columns)]
            for chosen in sets
        ]
        widths = np.array([len(columns) for columns in wide])
        weight = 1.0 / (reference * design.counts)
        for width in np.unique(widths):
            members = np.flatnonzero(widths == width)
            for first in range(0, len(members), _BATCH):
                some = members[first : first + _BATCH]
                index = np.array([[*wide[k], grams.shape[-1] - 1] for k in some])
                part = grams[:, :, index[:, :, None], index[:, None, :]]
                joint = np.einsum("s,sfbij->bfij", weight, part)
                total = joint.sum(axis=1, keepdims=True)
                held, values = solve(total - joint), solve(total[:, 0])
                low, high = bounds[:, index[:, :-1]]
                possible = np.all((values >= low) & (values <= high), axis=-1)
                signed = np.concatenate([held, -np.ones((*held.shape[:-1], 1))], axis=-1)
                squares = np.einsum("bfi,sfbij,bfj->sb", signed, part, signed, optimize=True)
                score = self.likelihood(squares / design.counts[:, None], design.counts)
                found[some] = np.where(possible, score, -np.inf)
        prior = [sum(candidates[one].prior for one in chosen) for chosen in sets]
        return np.asarray(found + np.array(prior))

    def _bounds(self, candidates: Sequence[Candidate]) -> FloatArray:
        """Return the range of each column's coefficient, shape (2, columns); a usual one's is free.

        What nearly every robot has stays in while others are tried, however little it is.
        """
        rows = [(-np.inf, np.inf)] * len(PAPER)
        for one in candidates:
            for term in one.part.terms:
                rows.append((-np.inf, np.inf) if one.part.effect.usual else term.bounds)
        return np.array(rows).T

    def _compatible(self, candidates: Sequence[Candidate], chosen: Iterable[int]) -> bool:
        names = [name for one in chosen for name in candidates[one].terms]
        return len(set(names)) == len(names)

    def _grow(
        self,
        design: Design,
        candidates: Sequence[Candidate],
        start: Set,
        reference: FloatArray,
        limit: int,
    ) -> dict[Set, float]:
        """Score single candidates, all pairs of the best, and what grows from the best sets."""
        known: dict[Set, float] = {}

        def score(sets: Iterable[Set]) -> None:
            fresh = [
                one for one in dict.fromkeys(sets)
                if one not in known and self._compatible(candidates, one)
            ]  # fmt: skip
            if fresh:
                values = self._scores(design, candidates, fresh, reference)
                known.update(zip(fresh, values.tolist(), strict=True))

        every = range(len(candidates))
        score([start])
        singles = [tuple(sorted({*start, one})) for one in every if one not in start]
        score(singles)
        # The best variant of each effect stands for it among the pairs.
        ranked = sorted((one for one in singles if one in known), key=lambda one: -known[one])
        best: dict[str, int] = {}
        for one in ranked:
            (new,) = set(one) - set(start)
            best.setdefault(candidates[new].name, new)
        chosen = list(best.values())[:_PAIRED]
        score(tuple(sorted({*start, *pair})) for pair in combinations(chosen, 2))
        for size in range(2, limit):
            level = [one for one in known if len(one) == len(start) + size]
            beam = sorted(level, key=lambda one: -known[one])[:_BEAM]
            before = max(known.values())
            score(tuple(sorted({*one, new})) for one in beam for new in every if new not in one)
            if max(known.values()) <= before:
                break
        return known

    # -- fitting single sets --------------------------------------------------------------------

    def _evaluate(self, chosen: Set, candidates: Sequence[Candidate], delay: float) -> _Evaluated:
        """Fit a set as it is, losses included."""
        key = (chosen, delay)
        if key not in self.evaluated:
            parts = tuple(candidates[one].part for one in chosen)
            marked = next(
                (candidates[one].marked for one in chosen if candidates[one].marked), None
            )
            problem = self._with_changes(marked).delayed(delay)
            self.evaluated[key] = self._fitted(problem, parts)
        return self.evaluated[key]

    def _with_changes(self, marked: Problem | None) -> Problem:
        if marked is None:
            return self.problem
        drives = [
            drive.with_channels(changed=other.motion.channels["changed"])
            for drive, other in zip(self.problem.drives, marked.drives, strict=True)
        ]
        return Problem(drives, self.problem.vehicle, self.problem.memory)

    def _fitted(self, problem: Problem, parts: Sequence[Part]) -> _Evaluated:
        terms = terms_of(parts)
        design = problem.design(terms, self.errors)
        errors = problem.reference(design)
        found = fit(design, errors)
        sound = self._plausible(problem, parts, found)
        return _Evaluated(design.counts, errors, found, problem, sound, tuple(parts))

    def _plausible(self, problem: Problem, parts: Sequence[Part], found: Fit) -> bool:
        """Tell whether coefficients are possible, and what the robot draws at rest too."""
        terms = terms_of(parts)
        slack = 3 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        for term, value, wide in zip(terms, found.values, slack, strict=True):
            margin = float(wide) if term in PAPER else 0.0
            if not term.bounds[0] - margin <= value <= term.bounds[1] + margin:
                return False
        model = PowerModel(problem.vehicle, tuple(terms), found.values)
        for part in parts:
            if not part.terms:
                continue
            low, high = part.effect.limits(problem.vehicle)
            if not low <= part.effect.value(model) <= high:
                return False
        constant = {term.name for part in parts for term in part.terms if term.kind == "power"}
        resting = sum(
            float(value)
            for term, value in zip(terms, found.values, strict=True)
            if term.name in constant
        )
        return self.rest.allows(resting)

    def _gain(self, full: _Evaluated, less: _Evaluated, part: Part, looks: float) -> Gain:
        """Return what a part is worth in a set, against the set without it."""
        floor = self.problem.floor
        scale = 1.0 / (less.errors + floor)
        improvement = float(np.mean((less.fit.errors - full.fit.errors) * scale))
        _, error = difference(less.fit.losses, full.fit.losses)
        p_value = self._p_value(full, part, looks)
        return Gain(improvement, error / len(scale), p_value, self.score(full) - self.score(less))

    def _p_value(self, full: _Evaluated, part: Part, looks: float) -> float:
        """Chance of a part's coefficients being this far from zero, over all candidates."""
        own = {term.name for term in part.terms}
        which = [k for k, term in enumerate(terms_of(full.parts)) if term.name in own]
        return min(full.fit.p_value(which) * looks, 1.0) if which else 0.0

    def _acceptable(self, gain: Gain, prior: float) -> bool:
        return (
            gain.improvement > max(WORTHWHILE, gain.error)
            and gain.p_value < SIGNIFICANCE
            and gain.weight + prior > 0.0
        )

    # -- delays ---------------------------------------------------------------------------------

    def _best_delay(self, parts: Sequence[Part], problem: Problem) -> float:
        """Return the delay of the power at which a model predicts best [s]."""
        terms = terms_of(parts)

        def loss(delay: float) -> float:
            design = problem.delayed(float(delay)).design(terms)
            return -float(
                self.likelihood(fit(design, np.ones(len(_WEIGHTS))).errors, design.counts)
            )

        losses = [loss(delay) for delay in _DELAYS]
        k = int(np.argmin(losses))
        found = minimize_scalar(
            loss,
            bounds=(float(_DELAYS[max(k - 1, 0)]), float(_DELAYS[min(k + 1, len(_DELAYS) - 1)])),
            method="bounded",
            options={"xatol": 0.005},
        )
        return float(found.x)

    def _delays(self, nuisance: Sequence[Part]) -> list[float]:
        if self.delay is None:
            return [0.0]
        linear = [part for part in nuisance if not any(t.kind == "loss" for t in part.terms)]
        found = self._best_delay(linear, self.problem)
        plain, late = (
            self.score(self._fitted(self.problem.delayed(delay), linear)) for delay in (0.0, found)
        )
        return [0.0, found] if late + _RARE + _LOG > plain else [0.0]

    # -- the whole ------------------------------------------------------------------------------

    def run(self) -> Found:
        """Search, and return the explanations, the most probable one first."""
        self.progress(0.0, f"trying {len(self.effects)} effects together")
        usual = [
            part for effect in self.effects if effect.usual and not effect.grid
            for part in self._variants(effect)
        ]  # fmt: skip
        nuisance = [*usual, *(Part(e) for e in self.effects if e.terms == (HOTEL,))]
        self.problem = self._levelled(nuisance)
        pools: dict[float, tuple[list[Candidate], list[Set]]] = {}
        for delay in self._delays(nuisance):
            pools[delay] = self._pool(delay, usual)
            self.progress(0.6, "fitting the best sets")
        self._settle_repeats(pools)
        weighed: dict[tuple[frozenset[int], float], float] = {}
        for delay, (candidates, sets) in pools.items():
            for chosen in sets:
                one = self._reduced(chosen, candidates, delay)
                weighed[(frozenset(one), delay)] = self._posterior(one, candidates, delay)
        return self._explained(weighed, {d: pool[0] for d, pool in pools.items()})

    def _levelled(self, nuisance: Sequence[Part]) -> Problem:
        """Give each run the factor by which it differs as a whole: else long runs decide."""
        return self.problem.levelled(terms_of(nuisance))

    def _pool(self, delay: float, usual: Sequence[Part]) -> tuple[list[Candidate], list[Set]]:
        """Return the candidates at a delay, and the best sets of them."""
        problem = self.problem.delayed(delay)
        about, marked = self._about(problem, usual, None), None
        pooled: dict[frozenset[str], tuple[float, Labels]] = {}
        candidates: list[Candidate] = []
        for stage in range(2):
            candidates = self._candidates(marked)
            start = tuple(k for k, one in enumerate(candidates) if one.part in usual)
            design = self._table(problem, candidates, about)
            first = [*range(len(PAPER)), *(c for k in start for c in candidates[k].columns)]
            errors = problem.reference(design.picked(first))
            known = self._grow(design, candidates, start, errors, 2)
            # Weigh the scales by what the best set leaves, and look again.
            top = max(known, key=lambda one: known[one])
            columns = [*range(len(PAPER)), *(c for k in top for c in candidates[k].columns)]
            best = design.picked(columns)
            errors = problem.reference(best)
            known = self._grow(design, candidates, start, errors, self.limit)
            ranked = sorted(known, key=lambda one: -known[one])
            pooled = self._merged(pooled, ranked[: 4 * _EXACT], known, candidates, stage)
            if stage:
                break
            top = ranked[0]
            columns = [*range(len(PAPER)), *(c for k in top for c in candidates[k].columns)]
            parts = [candidates[k].part for k in top]
            about = self._about(problem, parts, errors)
            if any(effect.acts == "change" for effect in self.effects):
                marked = mark_changes(problem, terms_of(parts), errors)
            lossy = any(t.kind == "loss" and abs(about[t.name]) > 0 for t in terms_of(parts))
            if marked is None and not lossy:
                break
        names = {self._label(one): k for k, one in enumerate(candidates)}
        sets = []
        for _, (_, labels) in sorted(pooled.items(), key=lambda item: -item[1][0]):
            if all(label in names for label in labels):
                sets.append(tuple(sorted(names[label] for label in labels)))
        sets = [
            self._pruned(one, candidates, design, errors)
            for one in list(dict.fromkeys(sets))[: 3 * _EXACT]
        ]
        # What is usual, alone: where all else turns out to be nonsense.
        plain = tuple(k for k, one in enumerate(candidates) if one.part in usual)
        sets = [*list(dict.fromkeys(sets))[:_EXACT], plain]
        return candidates, [*sets, *self._swapped(sets[0], candidates, design, errors)]

    def _pruned(
        self, chosen: Set, candidates: Sequence[Candidate], design: Design, errors: FloatArray
    ) -> Set:
        """Take out what lowers likelihood times prior."""
        while chosen:
            rest = [tuple(k for k in chosen if k != gone) for gone in chosen]
            scores = self._scores(design, candidates, [chosen, *rest], errors)
            best = int(np.argmax(scores))
            if best == 0:
                break
            chosen = rest[best - 1]
        return chosen

    def _swapped(
        self, best: Set, candidates: Sequence[Candidate], design: Design, errors: FloatArray
    ) -> list[Set]:
        """Return the best set with one of its effects replaced, where that fits about as well."""
        trials = [
            tuple(sorted({*best, new} - {old}))
            for old in best for new in range(len(candidates))
            if new not in best and not candidates[old].part.effect.usual
        ]  # fmt: skip
        trials = [one for one in dict.fromkeys(trials) if self._compatible(candidates, one)]
        if not trials:
            return []
        scores = self._scores(design, candidates, [best, *trials], errors)
        near = np.flatnonzero(scores[1:] > scores[0] - _NEAR)
        order = near[np.argsort(-scores[1:][near], kind="stable")]
        return [trials[k] for k in order[:_EXACT]]

    def _about(
        self, problem: Problem, parts: Sequence[Part], errors: FloatArray | None
    ) -> dict[str, float]:
        """Return coefficients to linearise losses about: those of a model, by name."""
        design = problem.design(terms_of(parts), errors)
        scale = problem.reference(design) if errors is None else errors
        values = fit(design, scale).values
        return dict(zip((t.name for t in terms_of(parts)), values.tolist(), strict=True))

    def _label(self, one: Candidate) -> tuple[str, tuple[tuple[str, float], ...]]:
        """Name a candidate in a way that outlasts a new numbering."""
        return one.name, one.part.params

    def _merged(
        self,
        pooled: Mapping[frozenset[str], tuple[float, Labels]],
        ranked: Sequence[Set],
        known: Mapping[Set, float],
        candidates: Sequence[Candidate],
        stage: int,
    ) -> dict[frozenset[str], tuple[float, Labels]]:
        """Join the best sets of both looks; the second one knows losses and changes better."""
        merged = dict(pooled)
        for chosen in ranked:
            names = frozenset(candidates[k].name for k in chosen)
            labels = tuple(self._label(candidates[k]) for k in chosen)
            if names not in merged or (stage and known[chosen] > merged[names][0]):
                merged[names] = (known[chosen], labels)
        return merged

    def _posterior(self, chosen: Set, candidates: Sequence[Candidate], delay: float) -> float:
        one = self._evaluate(chosen, candidates, delay)
        prior = sum(candidates[k].prior for k in chosen)
        if delay != 0.0:
            prior += _RARE + _LOG - np.log(len(_DELAYS))
        return self.score(one) + prior

    def _reduced(self, chosen: Set, candidates: Sequence[Candidate], delay: float) -> Set:
        """Take out what earns no place, the worst first."""
        now = chosen
        while now:
            full = self._evaluate(now, candidates, delay)
            looks = float(len(self.effects))
            chance = {k: self._p_value(full, candidates[k].part, looks) for k in now}
            weak = max(now, key=lambda k: chance[k])
            if chance[weak] < SIGNIFICANCE:
                gains = {
                    k: self._gain(
                        full,
                        self._evaluate(tuple(j for j in now if j != k), candidates, delay),
                        candidates[k].part,
                        looks,
                    )
                    for k in now
                }
                full.gains.update(gains)
                poor = [k for k in now if not self._acceptable(gains[k], candidates[k].prior)]
                if full.sound and not poor:
                    return now
                # Nonsense that fits: what explains least is the culprit.
                weak = min(poor or now, key=lambda k: gains[k].weight + candidates[k].prior)
            now = tuple(k for k in now if k != weak)
        return now

    def _explained(
        self,
        weighed: dict[tuple[frozenset[int], float], float],
        pools: dict[float, list[Candidate]],
    ) -> Found:
        # Exact ties go to the effect that comes first in the catalogue.
        keys = sorted(weighed, key=lambda key: (-round(weighed[key], 2), sorted(key[0])))
        values = np.array([weighed[key] for key in keys])
        share = np.exp(values - values.max())
        share /= share.sum()
        explanations = []
        for (chosen, delay), probability in zip(keys, share, strict=True):
            candidates = pools[delay]
            numbers = tuple(sorted(chosen))
            one = self._evaluate(numbers, candidates, delay)
            order = sorted(
                numbers,
                key=lambda k: (candidates[k].part.effect.usual, -one.gains[k].weight),
            )
            parts = [candidates[k].part for k in order]
            gains = [one.gains[k] for k in order]
            if delay != 0.0 and self.delay is not None:
                still = self._evaluate(numbers, candidates, 0.0) if pools.get(0.0) else one
                late = Part(self.delay, (("delay", delay),))
                gain = self._gain(one, still, late, 1.0)
                if gain.weight + _RARE + _LOG < 0.0 or gain.improvement < WORTHWHILE:
                    continue
                place = sum(other.weight > gain.weight for other in gains)
                usual = sum(part.effect.usual for part in parts)
                place = min(place, len(parts) - usual)
                parts.insert(place, late)
                gains.insert(place, gain)
            explanations.append(
                Explanation(tuple(parts), float(probability), one.problem, tuple(gains))
            )
        # Variants of the same effects are one explanation: that of the best of them.
        joined: dict[frozenset[str], Explanation] = {}
        for new in explanations:
            names = frozenset(new.names)
            known = joined.get(names)
            joined[names] = (
                new if known is None
                else replace(known, probability=known.probability + new.probability)
            )  # fmt: skip
        total = sum(new.probability for new in joined.values())
        ranked = sorted(joined.values(), key=lambda new: -round(new.probability / total, 3))
        ranked[0] = self._refined(ranked[0])
        return Found(
            tuple(replace(new, probability=new.probability / total) for new in ranked),
            tuple(self.untested),
        )

    def _refined(self, best: Explanation) -> Explanation:
        """Move the parameters that were searched on a grid to where the loss is least."""
        parts, problem = list(best.parts), best.problem
        design = problem.design(terms_of(parts))
        errors = problem.reference(design)
        for k, part in enumerate(parts):
            if not part.params:
                continue

            made = self._moved(parts, k, problem)
            better = self._settled(part, made, errors)
            if better is not None:
                parts, problem = made(better)
        return replace(best, parts=tuple(parts), problem=problem)

    def _settled(self, part: Part, made: Make, errors: FloatArray) -> FloatArray | None:
        """Return the parameters of least loss; None where those of the grid are as good."""

        def loss(values: FloatArray) -> float:
            trial, case = made(values)
            return fit(case.design(terms_of(trial), errors), errors).loss

        start, span = np.array([value for _, value in part.params]), self._span(part)
        inside = (
            [(0.3 * x, 3.0 * x) for x in start]
            if part.effect.grid and part.effect is not self.delay
            else [(x - 2 * s, x + 2 * s) for x, s in zip(start, span, strict=True)]
        )
        found = minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=inside,
            options={
                "initial_simplex": start + np.vstack([np.zeros(len(start)), np.diag(span)]),
                "maxfev": 30 * len(start),
                "xatol": 1e-3,
                "fatol": 1e-4,
            },
        )
        return np.asarray(found.x) if found.fun < loss(start) else None

    def _moved(self, parts: Sequence[Part], k: int, problem: Problem) -> Make:
        """Return a function from a part's parameters to the parts and drives with them."""
        part = parts[k]

        def made(values: FloatArray) -> tuple[list[Part], Problem]:
            named = zip((key for key, _ in part.params), values.tolist(), strict=True)
            trial = [*parts[:k], replace(part, params=tuple(named)), *parts[k + 1 :]]
            late = part.effect is self.delay
            return trial, problem.delayed(float(values[0])) if late else problem

        return made

    def _span(self, part: Part) -> FloatArray:
        """First step of each searched parameter: a good part of the grid's."""
        if part.effect.acts == "place":
            return np.array([np.pi / 16, 0.3])
        if part.effect is self.delay:
            return np.array([0.03])
        return np.array([0.2 * abs(value) for _, value in part.params])

    def take_all(self) -> Found:
        """Take every effect whether it helps or not, in the order given."""
        parts: list[Part] = []
        problem = self.problem
        for effect in self.effects:
            variants = self._variants(effect)
            if effect.acts == "change":
                problem = mark_changes(problem, terms_of(parts), _errors(problem, parts))
            trials = [self._fitted(problem, [*parts, part]) for part in variants]
            parts.append(variants[int(np.argmax([self.score(one) for one in trials]))])
        if self.delay is not None:
            delay = self._best_delay(parts, problem)
            problem = problem.delayed(delay)
            parts.append(Part(self.delay, (("delay", delay),)))
        full = self._fitted(problem, parts)
        gains = []
        for part in parts:
            rest = [other for other in parts if other is not part]
            gains.append(self._gain(full, self._fitted(problem, rest), part, 1.0))
        one = Explanation(tuple(parts), 1.0, problem, tuple(gains))
        return Found((one,), tuple(self.untested))


def without_mimics(
    problem: Problem, parts: tuple[Part, ...], smooth: Part
) -> tuple[tuple[Part, ...], list[str]]:
    """Take out effects that only stand in for what the catalogue does not have.

    Parameters
    ----------
    problem : Problem
        The drives.
    parts : tuple of Part
        Effects that were found.
    smooth : Part
        A smooth term of the channel that still explains most.

    Returns
    -------
    tuple
        What is left of the parts, and the names of those taken out: effects that are of no use
        beside the smooth term, where that alone does better than all of them.
    """
    usual = [part for part in parts if part.effect.usual or not part.terms]
    others = [part for part in parts if part not in usual]
    errors = _errors(problem, parts)

    def loss(some: Sequence[Part]) -> Fit:
        return fit(problem.design(terms_of(some), errors), errors)

    gap, error = difference(loss(parts).losses, loss([*usual, smooth]).losses)
    if not others or gap <= max(error, WORTHWHILE * len(errors)):
        return parts, []
    kept, gone = list(parts), list[str]()
    for part in others:
        rest = [other for other in kept if other is not part]
        gap, error = difference(loss([*rest, smooth]).losses, loss([*kept, smooth]).losses)
        if gap <= max(error, WORTHWHILE * len(errors)):
            kept = rest
            gone.append(part.effect.name)
    return tuple(kept), gone


def _errors(problem: Problem, parts: Sequence[Part]) -> FloatArray:
    return problem.reference(problem.design(terms_of(parts)))


class _Rest:
    """What the robot draws at rest, where the drives show it."""

    def __init__(self, problem: Problem) -> None:
        samples = []
        for drive in problem.drives:
            still = (drive.motion.v_left == 0) & (drive.motion.v_right == 0)
            samples.append(drive.power[still])
        power: NDArray[np.float64] = np.concatenate(samples)
        self.count = len(power)
        self.mean = float(power.mean()) if len(power) else 0.0

    def allows(self, constant: float) -> bool:
        """Tell whether a constant power agrees with what is drawn at rest."""
        if self.count < 10 or constant == 0.0:
            return True
        return abs(self.mean - constant) <= 0.5 * abs(constant)
