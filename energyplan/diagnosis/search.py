"""Which set of effects explains the drives, with a probability for each (private).

The sets that the quick search proposes are fitted as they are, losses and all, and each effect of
a set must earn its place in it. What is left is weighed by likelihood and prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from energyplan.diagnosis.change_points import mark_changes
from energyplan.diagnosis.evidence import Account, classes
from energyplan.diagnosis.explanations import Explanation, Found
from energyplan.diagnosis.fitted_sets import LATE, WORTHWHILE
from energyplan.diagnosis.neighbouring_sets import NeighbouringSets
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.plausible import likeness
from energyplan.diagnosis.proposals import (
    OF_LOG,
    RARE,
    Candidate,
    Set,
    terms_of,
)
from energyplan.diagnosis.settled_sets import Weighed, most_probable
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.late import ON_TIME, Late, least_late
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import PAPER, Problem
from energyplan.fit.solvers import column_scale
from energyplan.fit.usual import usual_friction
from energyplan.path import FloatArray
from energyplan.power import HOTEL
from energyplan.power.effects import Effect

_NOISE = 0.05
"""Singular value of regressors, each of unit size in means over two seconds, that the noise of
speeds makes: up to 0.042 where they are read in steps as large as a third of them. Drives of many
motions show 0.11 and more."""

_WEIGHT = 0.1
"""Weight of an effect in a combination of regressors that is noise: had it more, it would change by
more than a tenth of the power with how friction is shared between mu and K."""

_TURNING = np.array([1.0, -1.0])
"""Deviations of mu and K from the usual at which turning takes most of the power."""


def separable(problem: Problem, parts: Sequence[Part]) -> NDArray[np.bool_]:
    """Tell which effects drives tell from the paper's two terms."""
    usual = _friction(problem)
    means = [_means(problem, parts, usual[0] + by * usual[1]) for by in (0.0, _TURNING)]
    owner = np.repeat(np.arange(len(parts)), np.array([len(part.terms) for part in parts], int))
    told = np.bincount(owner, np.any([_tells(one) for one in means], axis=0), len(parts)) > 0
    acts = np.bincount(owner, means[0][:, len(PAPER) :].any(axis=0), len(parts)) > 0
    return np.asarray(told | ~acts)


def _tells(means: FloatArray) -> NDArray[np.bool_]:
    """Tell which regressors after the paper's are in no combination that is noise, nor zero."""
    table, count = means / column_scale(means), len(PAPER)
    gram = table.T @ table / len(table)
    tells = np.diagonal(gram)[count:] > 0.0
    for new in np.flatnonzero(tells):
        which = [*range(count), count + new]
        square, axes = np.linalg.eigh(gram[np.ix_(which, which)])
        tells[new] = np.linalg.norm(axes[-1, square < _NOISE**2]) < _WEIGHT
    return tells


def varies(problem: Problem) -> bool:
    """Tell whether the power of drives changes by more than noise: only then it can be late."""
    friction = _friction(problem)[0]
    power = _means(problem, (), friction) @ friction
    return bool(np.std(power) > _NOISE * np.sqrt(np.mean(power**2)))


def _friction(problem: Problem) -> FloatArray:
    """Coefficients of the paper's terms that are usual for the robot, and their deviations."""
    return np.array([usual_friction(term, problem.vehicle) for term in PAPER]).T


def _means(problem: Problem, parts: Sequence[Part], friction: FloatArray) -> FloatArray:
    """Return means over two seconds of the regressors, losses about a friction."""
    terms = terms_of(parts)
    values = np.append(friction, np.zeros(len(terms) - len(PAPER)))
    return problem.as_predicted.design_about(terms, values).rows[1][:, :-1]


SIGNIFICANCE = 0.01
"""Chance that a channel is called a reason where it is none, over all channels together."""

_AS_GOOD = 1.5  # odds of two explanations up to which neither is the better one
_COMPARED = 1e-3  # probability from which on explanations are held against each other
_APART = 0.05  # delays that are worth sets of their own [s]
_PERIOD = 0.1  # over which the search averages drives [s]; sizes are fitted to all samples
_SAMPLES = 60_000  # that the search works on
_DRIVES = 40  # and of so many drives


class Search(NeighbouringSets):
    """Joint search over a catalogue."""

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        progress: Callable[[float, str], object],
        limit: int,
        judged: Sequence[Drive] = (),
    ) -> None:
        super().__init__(problem, effects, limit, judged)
        self.progress = progress
        self.whole, self.excerpted = problem, False
        self.followed: FloatArray = np.array([])
        self.odds: dict[str, float] = {}

    def _best_delay(self, parts: Sequence[Part], problem: Problem) -> Late:
        """Return the time offset of the power at which a model predicts best.

        Nothing is taken as known of what contacts hold: beside a turn it would stand for a delay.
        Where losses make it cost power, that may leave more than one offset: then what contacts
        hold decides which.
        """
        terms, unknown = terms_of(parts), problem.as_predicted

        def loss(late: Late) -> float:
            design = unknown.delayed(late).design(terms)
            errors = fit(design, np.ones(len(design.rows))).errors
            return -float(self.problem.likelihood(errors, design.evidence))

        found = least_late(loss, -RARE, _APART)
        if len(found) == 1 or not any(part.lossy for part in parts):
            return found[0]
        totals = problem.of_totals
        return max(found, key=lambda late: self.score(self._fitted(totals.delayed(late), parts)))

    def _delays(self, nuisance: Sequence[Part]) -> list[Late]:
        if self.delay is None:
            return [ON_TIME]
        linear = [part for part in nuisance if not part.lossy]
        found = self._best_delay(linear, self.problem)
        plain, late = (
            self.score(self._fitted(self.problem.delayed(each), linear))
            for each in (ON_TIME, found)
        )
        return [ON_TIME, found] if late + RARE + OF_LOG > plain else [ON_TIME]

    def _masked_delay(self, pools: Mapping[Late, tuple[list[Candidate], list[Set]]]) -> Late | None:
        """Return a time offset that a strong effect hid; None where there is none."""
        if self.delay is None:
            return None
        best = self._best_of(pools)
        totals = best.problem.of_totals.delayed(ON_TIME)
        found = self._best_delay(best.parts, totals)
        if min(max(abs(found.mean - one.mean), abs(found.lag - one.lag)) for one in pools) < _APART:
            return None
        plain, late = (
            self.score(self._fitted(totals.delayed(each), best.parts))
            for each in (best.problem.drives[0].late, found)
        )
        return found if late + LATE > plain else None

    def run(self) -> Found:
        """Search, and return the explanations, the most probable one first."""
        self.progress(0.0, f"trying {len(self.effects)} effects together")
        usual = [
            part for effect in self.effects if effect.usual and not effect.grid
            for part in self.variants(effect)
        ]  # fmt: skip
        nuisance = [*usual, *(Part(e) for e in self.effects if e.terms == (HOTEL,))]
        self.whole = self.whole.levelled(terms_of(nuisance))
        means = self.whole.averaged(_PERIOD)
        self.problem = means.excerpt(_SAMPLES, _DRIVES)
        self.excerpted = self.problem is not means
        self._leave_inseparable()
        pools: dict[Late, tuple[list[Candidate], list[Set]]] = {}
        for late in self._delays(nuisance):
            pools[late] = self.pool(late, usual)
        self.progress(0.5, "fitting the best sets")
        masked = self._masked_delay(pools)
        if masked is not None:
            pools[masked] = self.pool(masked, usual)
        self.errors = self._best_of(pools).errors
        weighed: Weighed = {}
        for late, (candidates, sets) in pools.items():
            for chosen in sets:
                self._weigh(weighed, chosen, candidates, late)
        candidates_at = {late: pool[0] for late, pool in pools.items()}
        self._climb(weighed, candidates_at)
        return self._explained(weighed, candidates_at)

    def _leave_inseparable(self) -> None:
        """Leave out effects that drives of such motions do not tell from friction."""
        tried = [e for e in self.effects if e.terms and e.acts in ("motion", "log")]
        parts = [part for effect in tried for part in self.variants(effect)]
        told = {
            part.effect.name
            for part, one in zip(parts, separable(self.problem, parts), strict=True) if one
        }  # fmt: skip
        gone = [effect for effect in tried if effect.name not in told]
        self.effects = [effect for effect in self.effects if effect not in gone]
        if self.delay is not None and not varies(self.problem):
            gone.append(self.delay)
            self.delay = None
        reason = "these drives hold too few motions to tell it from friction"
        self.untested.extend((effect.name, reason) for effect in gone)

    def _climb(
        self,
        weighed: Weighed,
        pools: dict[Late, list[Candidate]],
    ) -> None:
        """Add to the best set, or replace in it, one effect after the other while that helps.

        The quick search weighs sets about coefficients of another one. About its own, a set shows
        what else it needs.
        """
        stones: set[tuple[Set, Late]] = set()
        searched: set[frozenset[str]] = set()
        for _ in range(self.limit):
            self._redelay(weighed, pools)
            self._settle_best(weighed, pools)
            self._settle_delay(weighed, pools)
            chosen, late = most_probable(weighed)
            now, candidates = tuple(sorted(chosen)), pools[late]
            before = set(weighed)
            sets, scores, self.followed = self._weigh_neighbours(weighed, now, candidates, late)
            self.odds = self._odds(now, sets, scores, candidates, late)
            if most_probable(weighed) not in before:
                continue
            stone = self._stepping_stone(weighed, pools, stones)
            if stone is not None:
                stones.add(stone)
                self._weigh_neighbours(weighed, stone[0], pools[stone[1]], stone[1])
            if most_probable(weighed) in before:
                self._search_lines_again(weighed, pools, searched)
            if most_probable(weighed) in before:
                self._lessened(weighed, now, candidates, late)
                return

    def _stepping_stone(
        self,
        weighed: Weighed,
        pools: Mapping[Late, list[Candidate]],
        stones: set[tuple[Set, Late]],
    ) -> tuple[Set, Late] | None:
        """Return a set that is more probable than the best, and of which something earns no place.

        What it lacks may be what hides that: of two strong effects each may be nothing alone.
        """
        found = {
            (some, late): self._posterior(some, pools[late], late)
            for (some, late), one in self.evaluated.items()
            if one.sound and late in pools
            and (frozenset(some), late) not in weighed and (some, late) not in stones
        }  # fmt: skip
        best = max(found, key=lambda key: found[key], default=None)
        return best if best and found[best] > max(weighed.values()) - RARE else None

    def _odds(
        self, now: Set, sets: Sequence[Set], scores: FloatArray, candidates: Sequence[Candidate],
        late: Late,
    ) -> dict[str, float]:  # fmt: skip
        """Return the odds of each effect beside a set's that earns no place in it.

        One that drives do not show is as probable as the quick search says. One that they show and
        that is too small to be named may as well be an imperfection of the others. What nearly
        every robot has does not count.
        """
        odds: dict[str, float] = {}
        for some, score in zip(sets, scores, strict=True):
            if len(some) > len(now) + 1 or not set(now) < set(some):
                continue
            (new,) = set(some) - set(now)
            one, full = candidates[new], self.evaluated.get((some, late))
            if one.part.effect.usual:
                continue
            likely = np.exp(score) if score < 0.0 else 0.0
            if full is not None and new in full.gains:
                gain = full.gains[new]
                if self._shown(gain, one, full) and not self._large(gain, full):
                    likely = 1.0
            odds[one.name] = min(odds.get(one.name, 0.0) + float(likely), 1.0)
        return odds

    def _lessened(
        self, weighed: Weighed, now: Set, candidates: Sequence[Candidate], late: Late
    ) -> None:
        """Weigh a set without one of its effects each."""
        for k in now:
            less = tuple(j for j in now if j != k)
            if self._evaluate(less, candidates, late).sound:
                self._gains(less, candidates, late)
                weighed.setdefault((frozenset(less), late), self._posterior(less, candidates, late))

    def _redelay(
        self,
        weighed: Weighed,
        pools: Mapping[Late, list[Candidate]],
    ) -> None:
        """Weigh the best set at each other time offset, too.

        Each offset has a pool of its own. A set of which one pool has only a part may be found in
        that of an offset that it does not need.
        """
        chosen, found = most_probable(weighed)
        wanted = [pools[found][k] for k in sorted(chosen)]
        for late, candidates in pools.items():
            same = [
                k for k, one in enumerate(candidates)
                if any((one.part, one.marked) == (other.part, other.marked) for other in wanted)
            ]  # fmt: skip
            known = (frozenset(same), late) in weighed
            apart = max(abs(late.mean - found.mean), abs(late.lag - found.lag)) >= _APART
            if apart and len(same) == len(wanted) and not known:
                self._weigh(weighed, tuple(same), candidates, late)

    def _explained(
        self,
        weighed: Weighed,
        pools: dict[Late, list[Candidate]],
    ) -> Found:
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
            if offset != ON_TIME and self.delay is not None:
                still = self._evaluate(numbers, candidates, ON_TIME) if pools.get(ON_TIME) else one
                late = Part(self.delay, offset.params)
                gain = self._gain(one, still, late, 1.0)
                if gain.weight + LATE < 0.0 or gain.improvement < WORTHWHILE:
                    continue
                place = sum(other.weight > gain.weight for other in gains)
                usual = sum(part.effect.usual for part in parts)
                place = min(place, len(parts) - usual)
                parts.insert(place, late)
                gains.insert(place, gain)
            problem = one.problem.starting_from(self._coefficients(one))
            explanations.append(
                Explanation(tuple(parts), float(probability), problem, tuple(gains))
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
        ranked = self._classed(
            [
                replace(new, probability=new.probability / total)
                for new in sorted(joined.values(), key=lambda n: -round(n.probability / total, 3))
            ]
        )
        ranked = [replace(one, problem=self._of_all(one)) for one in ranked]
        ranked[0] = self._refined(ranked[0])
        return Found(tuple(ranked), tuple(self.untested), self.followed, self.odds)

    def _of_all(self, one: Explanation) -> Problem:
        """Return whole drives with what an explanation says of their means, or of excerpts."""
        few, whole = one.problem, self.whole.delayed(one.problem.drives[0].late)
        whole = whole.starting_from(few.memory)
        others = [part for part in one.parts if part.effect.acts != "change"]
        if len(others) == len(one.parts):
            return whole
        if self.excerpted:  # which do not show when, between them, something changed
            return mark_changes(whole, terms_of(others), _errors(whole, others))
        pairs = zip(whole.drives, few.drives, strict=True)
        drives = [drive.changed_as(means) for drive, means in pairs]
        return Problem(drives, whole.vehicle, whole.memory)

    def _classed(self, ranked: Sequence[Explanation]) -> list[Explanation]:
        """Say of each explanation which others these drives cannot tell it from.

        Of those the one is first whose masses are most like the vehicle's; where these hardly tell
        either, the one whose effects the catalogue has first: losses while returning power stand
        before those while drawing, which divide all other sizes.
        """
        compared = [one for one in ranked if one.probability > _COMPARED]
        accounts = []
        for one in compared:
            design = one.problem.design(terms_of(one.parts), self.errors)
            errors = one.problem.reference(design)
            accounts.append(Account(design, fit(design, errors), errors))
        number = classes(accounts, lambda e, n: float(self.problem.likelihood(e, n)))
        share = np.array([one.probability for one in compared])
        pairs = zip(compared, accounts, strict=True)
        like = np.array([likeness(e.problem.vehicle, e.parts, a.fit) for e, a in pairs])
        for head in set(number):
            same = np.flatnonzero(np.array(number) == head)
            weighed = share[same] * like[same]
            if weighed.any():
                share[same] = weighed * (share[same].sum() / weighed.sum())
            near = same[_AS_GOOD * share[same] >= share[same].max()]
            share[near] = share[near].mean()
        told = list(ranked)
        for k, one in enumerate(compared):
            alike = (j for j in range(len(compared)) if j != k and number[j] == number[k])
            names = tuple(compared[j].names for j in alike)
            told[k] = replace(one, probability=float(share[k]), alike=names)
        order = {effect.name: k for k, effect in enumerate(self.effects)}
        places = [sorted(order.get(name, -1) for name in one.names) for one in told]
        shares = [-round(one.probability, 3) for one in told]
        return [told[k] for k in sorted(range(len(told)), key=lambda k: (shares[k], places[k]))]

    def take_all(self) -> Found:
        """Take every effect whether it helps or not, in the order given.

        Losses are fitted first, and where something changes last: what they take, and what is
        missing, looks like other effects, whose parameters are chosen one effect after the other.
        """
        parts: list[Part] = []
        problem = self.problem
        order = sorted(
            self.effects, key=lambda e: (not Part(e).lossy, e.acts in ("change", "place"))
        )
        for effect in order:
            variants = self.variants(effect)
            if effect.acts == "change":
                problem = mark_changes(problem, terms_of(parts), _errors(problem, parts))
            trials = [self._fitted(problem, [*parts, part]) for part in variants]
            parts.append(variants[int(np.argmax([self.score(one) for one in trials]))])
        parts.sort(key=lambda part: self.effects.index(part.effect))
        if self.delay is not None:
            late = self._best_delay(parts, problem)
            problem = problem.delayed(late)
            parts.append(Part(self.delay, late.params))
        full = self._fitted(problem, parts)
        for k, part in enumerate(parts):
            if part.effect.acts == "place":
                parts[k] = self._nearest(parts, k, full) or part
                full = self._fitted(problem, parts)
        gains = []
        for part in parts:
            rest = [other for other in parts if other is not part]
            gains.append(self._gain(full, self._fitted(problem, rest), part, 1.0))
        one = Explanation(tuple(parts), 1.0, problem, tuple(gains))
        return Found((self._refined(one),), tuple(self.untested), np.array([]), {})


def _errors(problem: Problem, parts: Sequence[Part]) -> FloatArray:
    return problem.reference(problem.design(terms_of(parts)))
