"""Which set of effects explains the drives, with a probability for each (private).

The sets that the quick search proposes are fitted as they are, losses and all, and each effect of
a set must earn its place in it. What is left is weighed by likelihood and prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize
from scipy.stats import f as fisher

from energyplan.diagnosis.candidates import (
    OF_LOG,
    RARE,
    About,
    ContactTraces,
    EffectCandidate,
    Part,
    Proposals,
    Set,
    mark_changes,
    terms_of,
    with_changes,
)
from energyplan.fit.drive import (
    DELAYS,
    ON_TIME,
    SCALES,
    Drive,
    Late,
    least_late,
    speed_noise,
)
from energyplan.fit.estimate import FLOOR, PAPER, ROUNDS, Fit, Problem, by_name, fit
from energyplan.fit.regressors import DesignMatrix
from energyplan.fit.solvers import innovation_share
from energyplan.path import FloatArray
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import Effect

# -- is what an effect asks for what this robot can do? --------------------------------------------

_OVER = 0.05  # over the upper end of a coefficient, by which noise of the speeds may put it beyond


def possible(problem: Problem, parts: Sequence[Part], found: Fit) -> bool:
    """Return whether coefficients, and the sizes of effects, are within their ranges."""
    terms = terms_of(parts)
    slack = 3 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    ends = problem.ends(terms)
    for term, value, wide, (low, high) in zip(terms, found.values, slack, ends, strict=True):
        # What is at its upper end is estimated beyond it as often as not; none is no effect.
        above = float(wide) + _OVER * abs(high)
        if not low - (float(wide) if term in PAPER else 0.0) <= value <= high + above:
            return False
    model = PowerModel(problem.vehicle, tuple(terms), np.minimum(found.values, ends[:, 1]))
    for part in parts:
        low, high = part.effect.limits(problem.vehicle)
        if part.terms and not low <= part.effect.value(model) <= high:
            return False
    return True


# -- what a residual counts as evidence, and which explanations drives cannot distinguish ----------


def residuals(design: DesignMatrix, values: FloatArray) -> list[FloatArray]:
    """Return what coefficients leave of each window, at each scale [W]."""
    return [table[:, -1] - table[:, :-1] @ values for table in design.rows]


def innovations(design: DesignMatrix, left: Sequence[FloatArray]) -> FloatArray:
    """Return the share of a residual that its own past does not predict, at each scale."""
    shares = []
    for table, block, residual in zip(design.rows, design.blocks, left, strict=True):
        kept = np.any(table != 0.0, axis=1)
        owner = design.drives[block[kept]]
        edges = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
        pieces = [slice(a, b) for a, b in pairwise(edges.tolist())]
        shares.append(innovation_share(residual[kept], pieces) if len(owner) else 1.0)
    return np.array(shares)


# -- what the search weighs: sets of effects, the gain of each effect, probabilities ---------------

_RIVAL = 0.05  # probability of another explanation, over that of the best, from which it is named


@dataclass(frozen=True)
class EffectSet:
    """A set of effects that may be the reason."""

    parts: tuple[Part, ...]  # the effects, the one that explains most first
    probability: float  # that this set is the right one, among those of the catalogue
    problem: Problem  # the drives, with delays and times of changes as this set has them
    gains: tuple[Gain, ...]  # gain of each effect of the set, given the others

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(part.effect.name for part in self.parts)


@dataclass(frozen=True)
class Gain:
    """Gain of an effect, given the others of its set."""

    improvement: float
    error: float
    p_value: float  # of its coefficients being zero, times the number of candidates
    weight: float  # by how much it raises the logarithm of the set's likelihood
    share: float  # root of the fall of the mean square error, over the root mean square power
    lasting: float  # fall of the cross-validated loss without the block that shows most of it


@dataclass(frozen=True)
class SearchResult:
    """Outcome of the search: explanations, the most probable one first."""

    explanations: tuple[EffectSet, ...]
    untested: tuple[tuple[str, str], ...]
    suspects: tuple[Effect, ...] = ()  # that were not searched, and that the residual looks like

    @property
    def best(self) -> EffectSet:
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
class FittedSet:
    """A set fitted as it is."""

    counts: FloatArray
    shares: FloatArray
    errors: FloatArray
    fit: Fit
    problem: Problem
    sound: bool
    parts: tuple[Part, ...]
    gains: dict[int, Gain] = field(default_factory=dict)


# -- sets of effects fitted as they are, losses included, and what an effect earns in one ----------

_CHANCE = 0.05
"""Chance of an effect's coefficients, over all candidates together, that is accepted of one that
predicts unseen blocks better and outweighs its prior: three gates, each of which it must pass."""

WORTHWHILE = 0.05
"""Smallest fall of the cross-validated error, mean over the scales, that justifies an effect."""

WORTH = 0.004
"""Part of the root mean square power from which on an effect is kept whatever else is
missing. A smaller one is where it is more than what its set leaves beyond noise: what a model does
not have looks like one effect or another of at most that size."""

_LASTING = 0.45
"""Least part of a change's gain that is left without the block that shows most of it.
Changes that are there leave half and more; an odd block that some line or time fits, two fifths at
most."""

_BY_CHANCE = 1e-3  # that noise alone leaves something of a set, over all scales
_FEWEST = 4  # samples from which noise cannot be estimated

LATE = -float(np.log(len(DELAYS)))
"""Logarithm of the odds of a delay before the data: most logs' power is late, so that only the
search for it counts."""


# -- parameters that sets have from a grid, moved to where the sets fit best -----------------------

_NOWHERE = 1e9  # loss of a line that was not crossed: finite, since a simplex takes differences

Make = Callable[[FloatArray], tuple[list[Part], Problem]]
"""From a part's parameters to the parts and drives with them."""


def settled(part: Part, made: Make, errors: FloatArray) -> FloatArray | None:
    """Move the parameters of a part to where the loss is least."""
    start = part.values
    trial, case = made(start)
    ground = ContactTraces(case.drives, case.vehicle) if part.effect.acts == "place" else None
    terms = terms_of(trial)
    known = by_name(terms, fit(case.design(terms, errors), errors).values)
    if ground is not None:
        start = ground.from_middle(start)

    def fitted(values: FloatArray, rounds: int) -> float:
        if ground is not None:
            values = ground.from_origin(values)
            if not ground.crosses(values):
                return _NOWHERE
        trial, case = made(values)
        return fit(case.design(terms_of(trial), errors, known, rounds), errors).loss

    def loss(values: FloatArray) -> float:
        return fitted(values, 1)

    span = _span(part) if ground is None else ground.first_step
    inside = (
        [(0.3 * x, 3.0 * x) for x in start]
        if part.effect.grid and not part.effect.delays
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
    better = found.fun < loss(start) and fitted(found.x, ROUNDS) < fitted(start, ROUNDS)
    if not better:
        return None
    return np.asarray(found.x) if ground is None else ground.from_origin(found.x)


def _span(part: Part) -> FloatArray:
    """First step of each searched parameter: a good part of the grid's."""
    if part.effect.delays:
        return np.array([0.03, 0.05])[: len(part.params)]
    return np.asarray(0.2 * np.abs(part.values))


_KEPT_LAST = 16  # lines kept at each refinement; keeping more of them finds no better line
_TOGETHER = 16  # lines in one table
_SAMPLES = 5  # in a shortest window, that show where a line may be

Weighed = dict[tuple[frozenset[int], Late], float]
"""Likelihood times prior of sets at time offsets, as logarithms."""

_TRIED = 18  # neighbours of a set, each of other effects, that are fitted as they are


# -- which set of effects explains the drives, with a probability for each -------------------------

SIGNIFICANCE = 0.01
"""Chance that a channel is called a reason where it is none, over all channels together."""

_APART = 0.05  # difference of delays from which each gets its own sets [s]
_PERIOD = 0.1  # over which the search averages drives [s]; sizes are fitted to all samples
_MOST_SAMPLES = 60_000  # that the search works on
_MOST_DRIVES = 40  # and of so many drives


class EffectSearch:
    """Joint search over a catalogue: pool of sets, exact fits, best set moved and extended."""

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        progress: Callable[[float, str], object],
        limit: int,
        judged: Sequence[Drive] = (),
        on_demand: Sequence[Effect] = (),
    ) -> None:
        self.quick = Proposals(problem, effects, limit, judged)
        self.on_demand = [one for one in on_demand if self.quick.shown(one) is None]
        self.progress = progress
        self.whole, self.excerpted = problem, False
        self.evaluated: dict[tuple[Set, Late], FittedSet] = {}

    def _best_delay(self, parts: Sequence[Part], problem: Problem) -> Late:
        """Return the time offset of the power at which a model predicts best."""
        terms, unknown = terms_of(parts), problem.of_totals

        def loss(late: Late) -> float:
            design = unknown.delayed(late).design(terms)
            errors = fit(design, np.ones(len(design.rows))).errors
            return -float(self.quick.problem.likelihood(errors, design.evidence))

        return least_late(loss, -RARE, _APART)

    def _delays(self, nuisance: Sequence[Part]) -> list[Late]:
        if self.quick.delay is None:
            return [ON_TIME]
        linear = [part for part in nuisance if not part.lossy]
        found = self._best_delay(linear, self.quick.problem)
        plain, late = (
            self.score(self._fitted(self.quick.problem.delayed(each), linear))
            for each in (ON_TIME, found)
        )
        return [ON_TIME, found] if late + RARE + OF_LOG > plain else [ON_TIME]

    def run(self) -> SearchResult:
        """Search, and return the explanations, the most probable one first."""
        self.progress(0.0, f"trying {len(self.quick.effects)} effects together")
        usual = [
            part for effect in self.quick.effects if effect.usual and not effect.grid
            for part in self.quick.variants(effect)
        ]  # fmt: skip
        nuisance = [*usual, *(Part(e) for e in self.quick.effects if e.terms == (HOTEL,))]
        means = self.whole.averaged(_PERIOD)
        self.quick.problem = means.excerpt(_MOST_SAMPLES, _MOST_DRIVES)
        self.excerpted = self.quick.problem is not means
        pools: dict[Late, tuple[list[EffectCandidate], list[Set]]] = {}
        for late in self._delays(nuisance):
            pools[late] = self.quick.pool(late, usual)
        self.progress(0.5, "fitting the best sets")
        proposed = [
            self._evaluate(chosen, candidates, late)
            for late, (candidates, sets) in pools.items() for chosen in sets
        ]  # fmt: skip
        self.quick.errors = max(proposed, key=self.score).errors
        weighed: Weighed = {}
        for late, (candidates, sets) in pools.items():
            for chosen in sets:
                self._weigh(weighed, chosen, candidates, late)
        candidates_at = {late: pool[0] for late, pool in pools.items()}
        # Effects are added to the best set, or replaced in it, while that helps.
        for _ in range(self.quick.limit):
            best, late = max(weighed, key=lambda key: weighed[key])
            before = set(weighed)
            self._weigh_neighbours(weighed, tuple(sorted(best)), candidates_at[late], late)
            if max(weighed, key=lambda key: weighed[key]) in before:
                break
        return self._explained(weighed, candidates_at)

    def _explained(
        self, weighed: Weighed, pools: dict[Late, list[EffectCandidate]]
    ) -> SearchResult:
        """Return what is weighed as explanations, variants of the same effects as one."""
        # Exact ties go to the effect that comes first in the catalogue.
        keys = sorted(weighed, key=lambda key: (-round(weighed[key], 2), sorted(key[0])))
        values = np.array([weighed[key] for key in keys])
        share = np.exp(values - values.max())
        share /= share.sum()
        explanations = []
        for (chosen, offset), probability in zip(keys, share, strict=True):
            candidates = pools[offset]
            numbers = tuple(sorted(chosen))
            one = self._evaluate(numbers, candidates, offset)
            order = sorted(
                numbers,
                key=lambda k: (candidates[k].part.effect.usual, -one.gains[k].weight),
            )
            parts = [candidates[k].part for k in order]
            gains = [one.gains[k] for k in order]
            if offset != ON_TIME and self.quick.delay is not None:
                still = self._evaluate(numbers, candidates, ON_TIME) if pools.get(ON_TIME) else one
                late = Part(self.quick.delay, offset.params)
                gain = self._gain(one, still, late, 1.0)
                if gain.weight + LATE < 0.0 or gain.improvement < WORTHWHILE:
                    continue
                place = sum(other.weight > gain.weight for other in gains)
                usual = sum(part.effect.usual for part in parts)
                place = min(place, len(parts) - usual)
                parts.insert(place, late)
                gains.insert(place, gain)
            explanations.append(
                EffectSet(tuple(parts), float(probability), one.problem, tuple(gains))
            )
        # Variants of the same effects are one explanation: that of the best of them.
        joined: dict[frozenset[str], EffectSet] = {}
        for new in explanations:
            names = frozenset(new.names)
            known = joined.get(names)
            joined[names] = (
                new if known is None
                else replace(known, probability=known.probability + new.probability)
            )  # fmt: skip
        total = sum(new.probability for new in joined.values())
        listed = [effect.name for effect in self.quick.effects]

        def rank(one: EffectSet) -> tuple[float, list[int]]:
            """Put equally probable ones in the order of the catalogue."""
            places = [listed.index(name) if name in listed else -1 for name in one.names]
            return -round(one.probability / total, 3), sorted(places)

        ranked = [
            replace(one, probability=one.probability / total, problem=self._of_all(one))
            for one in sorted(joined.values(), key=rank)
        ]
        ranked[0] = self._refined(ranked[0])
        suspects = self._suspects(
            [part for part in ranked[0].parts if not part.effect.delays],
            ranked[0].problem.drives[0].late,
        )
        return SearchResult(tuple(ranked), tuple(self.quick.untested), suspects)

    def _suspects(self, parts: Sequence[Part], late: Late) -> tuple[Effect, ...]:
        """Return which effects that were not searched would join the best set."""
        if not self.on_demand:
            return ()
        problem = self.quick.problem.delayed(late)
        now = self._fitted(problem, parts)
        found = []
        for effect in self.on_demand:
            with_it, prior = problem, RARE
            if effect.acts == "change":
                marked = self.quick.marked(problem, parts, now.errors, effect)
                if marked is None:
                    continue
                with_it, part = with_changes(problem, marked), Part(effect)
                prior -= float(sum(np.log(len(one.windows[0].starts)) for one in problem.drives))
            else:
                thin = problem.thinned(_SAMPLES)
                lines = list(ContactTraces(thin.drives, thin.vehicle).lines(effect))
                if not lines:
                    continue
                about = self.quick.about(problem, parts, now.errors)
                part = lines[int(np.argmax(self._alone(parts, lines, thin, about, now.errors)))]
                prior -= float(np.log(len(lines)))
            more = self._fitted(with_it, [*parts, part])
            gain = self._gain(more, now, part, 1.0)
            lasts = gain.lasting > _LASTING * gain.improvement
            if gain.weight + prior > 0.0 and gain.improvement > WORTHWHILE and lasts:
                found.append(effect)
        return tuple(found)

    def _of_all(self, one: EffectSet) -> Problem:
        """Return whole drives with what an explanation says of their means, or of excerpts."""
        few, whole = one.problem, self.whole.delayed(one.problem.drives[0].late)
        others = [part for part in one.parts if part.effect.acts != "change"]
        if len(others) == len(one.parts):
            return whole
        if self.excerpted:  # which do not show when, between them, something changed
            return mark_changes(whole, terms_of(others), _errors(whole, others))
        pairs = zip(whole.drives, few.drives, strict=True)
        drives = [drive.changed_as(means) for drive, means in pairs]
        return whole.on(drives)

    def take_all(self) -> SearchResult:
        """Take every effect whether it helps or not, in the order given."""
        parts: list[Part] = []
        problem = self.quick.problem
        order = sorted(
            self.quick.effects, key=lambda e: (not Part(e).lossy, e.acts in ("change", "place"))
        )
        for effect in order:
            variants = self.quick.variants(effect)
            if effect.acts == "change":
                problem = mark_changes(problem, terms_of(parts), _errors(problem, parts))
            trials = [self._fitted(problem, [*parts, part]) for part in variants]
            parts.append(variants[int(np.argmax([self.score(one) for one in trials]))])
        parts.sort(key=lambda part: self.quick.effects.index(part.effect))
        if self.quick.delay is not None:
            late = self._best_delay(parts, problem)
            problem = problem.delayed(late)
            parts.append(Part(self.quick.delay, late.params))
        full = self._fitted(problem, parts)
        gains = []
        for part in parts:
            rest = [other for other in parts if other is not part]
            gains.append(self._gain(full, self._fitted(problem, rest), part, 1.0))
        one = EffectSet(tuple(parts), 1.0, problem, tuple(gains))
        return SearchResult((self._refined(one),), tuple(self.quick.untested))

    def _weigh_neighbours(
        self, weighed: Weighed, now: Set, candidates: list[EffectCandidate], late: Late
    ) -> None:
        """Weigh the neighbours of a set that promise most."""
        one = self._evaluate(now, candidates, late)
        about = self.quick.about(one.problem, one.parts, one.errors)
        design = self.quick.table(self.quick.problem.delayed(late), candidates, about)
        others = [k for k in range(len(candidates)) if k not in now]
        # A change absorbs errors of the others in its set: try the set without changes, too.
        cores = [now, tuple(k for k in now if candidates[k].marked is None)]
        trials = [set(core) for core in cores if core != now]
        for core in dict.fromkeys(cores):
            trials += [{*core, new} for new in others]
            trials += [
                {*core, new} - {old} for old in core for new in others
                if not candidates[old].always
            ]  # fmt: skip
        sets = [tuple(sorted(some)) for some in trials]
        sets = [some for some in sets if self.quick.compatible(candidates, some)]
        scores = self.quick.scores(design, candidates, sets, one.errors)
        best: dict[frozenset[str], Set] = {}
        for k in np.argsort(-scores, kind="stable"):
            best.setdefault(frozenset(candidates[j].name for j in sets[k]), sets[k])
        for some in [*best.values()][:_TRIED]:
            self._weigh(weighed, some, candidates, late)

    def _weigh(
        self, weighed: Weighed, chosen: Set, candidates: Sequence[EffectCandidate], late: Late
    ) -> None:
        """Weigh what of a set earns a place in it."""
        kept = self._reduced(chosen, candidates, late)
        prior = sum(candidates[k].prior for k in kept) + (0.0 if late == ON_TIME else LATE)
        weighed[frozenset(kept), late] = self.score(self._evaluate(kept, candidates, late)) + prior

    def _nearest(self, parts: Sequence[Part], at: int, now: FittedSet) -> Part:
        """Return the line with which a set fits best, of many: the nearest to start from."""
        problem = now.problem.thinned(_SAMPLES)
        about = self.quick.about(now.problem, now.parts, now.errors)
        rest = [part for k, part in enumerate(parts) if k != at]
        ground = ContactTraces(problem.drives, problem.vehicle)
        best = [*ground.lines(parts[at].effect, fine=True), parts[at]]
        for level in range(ground.levels + 1):
            if level:
                best = list(ground.about(best, level))
            scores = np.concatenate(
                [
                    self._alone(rest, best[k : k + _TOGETHER], problem, about, now.errors)
                    for k in range(0, len(best), _TOGETHER)
                ]
            )
            ranked = [best[k] for k in np.argsort(-scores, kind="stable")]
            best = ground.apart(ranked, level)[:_KEPT_LAST]
        return best[0]

    def _alone(
        self, rest: Sequence[Part], new: Sequence[Part], problem: Problem, about: About,
        errors: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Score a set with one of several further parts each."""
        candidates, first = [], len(PAPER)
        for part in (*rest, *new):
            columns = tuple(range(first, first + len(part.terms)))
            first += len(columns)
            candidates.append(EffectCandidate(part, columns, 0.0))
        design = self.quick.table(problem, candidates, about)
        own = tuple(range(len(rest)))
        sets = [(*own, len(rest) + k) for k in range(len(new))]
        return self.quick.scores(design, candidates, sets, errors)

    def _refined(self, best: EffectSet) -> EffectSet:
        """Move the parameters that were searched on a grid to where the loss is least."""
        parts, problem = list(best.parts), best.problem
        design = problem.design(terms_of(parts))
        errors = problem.reference(design)
        for k, part in enumerate(parts):
            if not part.params:
                continue

            if part.effect.acts == "place":
                part = parts[k] = self._nearest(parts, k, self._fitted(problem, parts))
            made = self._moved(parts, k, problem)
            better = settled(part, made, errors)
            if better is not None:
                parts, problem = made(better)
        return replace(best, parts=tuple(parts), problem=problem)

    def _moved(self, parts: Sequence[Part], k: int, problem: Problem) -> Make:
        """Return a function from a part's parameters to the parts and drives with them."""
        part = parts[k]

        def made(values: FloatArray) -> tuple[list[Part], Problem]:
            named = zip((key for key, _ in part.params), values.tolist(), strict=True)
            trial = [*parts[:k], replace(part, params=tuple(named)), *parts[k + 1 :]]
            late = part.effect is self.quick.delay
            return trial, problem.delayed(Late.of(trial[k].params)) if late else problem

        return made

    def score(self, one: FittedSet) -> float:
        """Return the logarithm of an evaluated set's likelihood, that of its innovations."""
        return float(self.quick.problem.likelihood(one.fit.errors * one.shares, one.counts))

    def _evaluate(
        self, chosen: Set, candidates: Sequence[EffectCandidate], late: Late
    ) -> FittedSet:
        """Fit a set as it is, losses included."""
        key = (chosen, late)
        if key not in self.evaluated:
            parts = tuple(candidates[one].part for one in chosen)
            marked = next(
                (candidates[one].marked for one in chosen if candidates[one].marked), None
            )
            problem = (
                self.quick.problem if marked is None else with_changes(self.quick.problem, marked)
            )
            problem = problem.delayed(late)
            self.evaluated[key] = self._fitted(problem, parts)
        return self.evaluated[key]

    def _fitted(self, problem: Problem, parts: Sequence[Part]) -> FittedSet:
        terms = terms_of(parts)
        design = problem.design(terms, self.quick.errors)
        errors = problem.reference(design)
        found = fit(design, errors)
        sound = possible(problem, parts, found)
        shares = innovations(design, residuals(design, found.values))
        return FittedSet(design.evidence, shares, errors, found, problem, sound, tuple(parts))

    def _gain(self, full: FittedSet, less: FittedSet, part: Part, looks: float) -> Gain:
        """Return the gain of a part in a set, over the set without it."""
        floor = self.quick.problem.floor
        scale = 1.0 / (less.errors + floor)
        # An effect that shows in one equation alone counts in full.
        fall = less.fit.squares - full.fit.squares
        falls, shares = (
            (fall * by[:, None]).reshape(-1, len(SCALES), fall.shape[1]).mean(axis=1)
            for by in (scale, FLOOR**2 / floor)
        )
        blocks = falls[np.argmax(falls.sum(axis=1))]
        return Gain(
            float(blocks.sum()), float(np.sqrt(len(blocks)) * blocks.std(ddof=1)),
            self._p_value(full, part, looks), self.score(full) - self.score(less),
            float(np.sqrt(max(shares.sum(axis=1).max(), 0.0))), float(blocks.sum() - blocks.max()),
        )  # fmt: skip

    def _p_value(self, full: FittedSet, part: Part, looks: float) -> float:
        """Chance of a part's coefficients being this far from zero, over all candidates."""
        own = {term.name for term in part.terms}
        which = [k for k, term in enumerate(terms_of(full.parts)) if term.name in own]
        return min(full.fit.p_value(which) * looks, 1.0) if which else 0.0

    def _missing(self, one: FittedSet) -> float:
        """Return what a set leaves beyond noise, over the root mean square power."""
        noise, power = [], []
        for drive in one.problem.drives:
            noise.append(speed_noise(drive.power) ** 2 if len(drive.power) > _FEWEST else 0.0)
            power.append(float(np.mean(drive.power**2)))
        samples = float(sum(len(drive.t) for drive in one.problem.drives))
        means = one.counts[: len(SCALES)]
        limit = fisher.isf(_BY_CHANCE / len(SCALES), means, samples) * np.median(noise)
        left = one.fit.errors[: len(SCALES)] - limit * means / samples
        return float(np.sqrt(max(left.max(), 0.0) / max(np.mean(power), 1e-300)))

    def _acceptable(
        self, gain: Gain, one: EffectCandidate, full: FittedSet, less: FittedSet
    ) -> bool:
        """Return whether an effect is large and certain enough, by its set with and without it."""
        large = gain.improvement > WORTHWHILE and gain.share > min(WORTH, self._missing(full))
        if less.sound and not large:
            return False
        # Where or when something changes was searched with all blocks: the block that shows most
        # of it is not predicted by the others.
        searched = one.part.effect.acts in ("change", "place")
        least = _LASTING * gain.improvement if searched else 0.0
        lasts = gain.lasting > least or (not searched and gain.improvement > gain.error)
        return lasts and gain.p_value < _CHANCE and gain.weight + one.prior > 0.0

    def _reduced(self, chosen: Set, candidates: Sequence[EffectCandidate], late: Late) -> Set:
        """Take out what earns no place, the worst first."""
        now = chosen
        while now:
            full = self._evaluate(now, candidates, late)
            chance = {
                k: self._p_value(full, candidates[k].part, self._looks(candidates[k])) for k in now
            }
            weak = max(now, key=lambda k: chance[k])
            if chance[weak] < _CHANCE:
                gains, less = self._gains(now, candidates, late)
                poor = [
                    k for k in now
                    if not self._acceptable(gains[k], candidates[k], full, less[k])
                ]  # fmt: skip
                if full.sound and not poor:
                    return now
                # If the fit is beyond what is possible, the least supported effect is dropped.
                weak = min(poor or now, key=lambda k: gains[k].weight + candidates[k].prior)
            now = tuple(k for k in now if k != weak)
        return now

    def _looks(self, one: EffectCandidate) -> float:
        """Return how many effects were searched to find one; 1 if nearly every robot has it."""
        return 1.0 if one.part.effect.usual else float(len(self.quick.effects))

    def _gains(
        self, now: Set, candidates: Sequence[EffectCandidate], late: Late
    ) -> tuple[dict[int, Gain], dict[int, FittedSet]]:
        """Return the gain of each effect in a set, and the sets without it."""
        full = self._evaluate(now, candidates, late)
        less = {k: self._evaluate(tuple(j for j in now if j != k), candidates, late) for k in now}
        for k in now:
            looks = self._looks(candidates[k])
            full.gains[k] = self._gain(full, less[k], candidates[k].part, looks)
        return full.gains, less


def _errors(problem: Problem, parts: Sequence[Part]) -> FloatArray:
    return problem.reference(problem.design(terms_of(parts)))
