"""Sets beside another one: what it may lack, or have in place of something else (private)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from energyplan.diagnosis.explanations import Evaluated
from energyplan.diagnosis.proposals import PAIRED, RARE, Candidate, Set
from energyplan.diagnosis.settled_sets import SettledSets, Weighed
from energyplan.diagnosis.stand_ins import followed_in
from energyplan.fit.drives.late import Late
from energyplan.path import FloatArray

_TRIED = 18  # neighbours of a set, each of other effects, that are fitted as they are


class NeighbouringSets(SettledSets):
    """Sets that differ from another one by an effect or two; parameters as of `Proposals`."""

    def _weigh_neighbours(
        self, weighed: Weighed, now: Set, candidates: list[Candidate], late: Late
    ) -> tuple[list[Set], FloatArray, FloatArray]:
        """Weigh the neighbours of a set that promise most."""
        one = self._evaluate(now, candidates, late)
        about = self._about(one.problem, one.parts, one.errors)
        design = self._table(self.problem.delayed(late), candidates, about)
        follows = followed_in(design, candidates, one)
        others = [k for k in range(len(candidates)) if k not in now]
        # A change takes up what others of its set are beside the truth by: without one, too.
        cores = [now, tuple(k for k in now if candidates[k].marked is None)]
        trials = [set(core) for core in cores if core != now]
        for core in dict.fromkeys(cores):
            trials += [{*core, new} for new in others]
            trials += [
                {*core, new} - {old} for old in core for new in others
                if not candidates[old].always
            ]  # fmt: skip
        sets = [tuple(sorted(some)) for some in trials]
        sets = [some for some in sets if self._compatible(candidates, some)]
        scores = self._scores(design, candidates, sets, one.errors)
        pairs = [
            one
            for core in dict.fromkeys(cores)
            for one in self._pairs(core, sets, scores, candidates)
        ]
        scores = np.append(scores, self._scores(design, candidates, pairs, one.errors))
        sets += pairs
        best: dict[frozenset[str], Set] = {}
        for k in np.argsort(-scores, kind="stable"):
            best.setdefault(frozenset(candidates[j].name for j in sets[k]), sets[k])
        tried = [*best.values()][:_TRIED]
        tried += self._losses(sets, scores, candidates, one)
        tried += self._other_losses(now, candidates, late)
        for some in [*tried, *self._settled_lines(sets, scores, candidates, one)]:
            if set(now) < set(some):
                self._fit_from(now, some, candidates, late)
            self._weigh(weighed, some, candidates, late)
        own = float(self._scores(design, candidates, [now], one.errors)[0])
        # Where the quick search takes the set itself for impossible, it has no odds to tell.
        return sets, scores - own if np.isfinite(own) else np.full(len(sets), -np.inf), follows

    def _pairs(
        self, now: Set, sets: Sequence[Set], scores: FloatArray, candidates: Sequence[Candidate]
    ) -> list[Set]:
        """Return a set with two further effects, of those that add most to it: they may mask."""
        best: dict[str, int] = {}
        for k in np.argsort(-scores, kind="stable"):
            if set(now) < set(sets[k]) and len(sets[k]) == len(now) + 1:
                (new,) = set(sets[k]) - set(now)
                best.setdefault(candidates[new].name, new)
        pairs = combinations(list(best.values())[:PAIRED], 2)
        some = (tuple(sorted({*now, *pair})) for pair in pairs)
        return [one for one in some if self._compatible(candidates, one)]

    def _losses(
        self, sets: Sequence[Set], scores: FloatArray, candidates: Sequence[Candidate],
        now: Evaluated,
    ) -> list[Set]:  # fmt: skip
        """Return the best set with each loss.

        How much a loss explains, the quick search cannot see: it takes for linear what multiplies
        all other forces.
        """
        found: dict[str, Set] = {}
        names = {part.effect.name for part in now.parts}
        for k in np.argsort(-scores, kind="stable"):
            for one in (candidates[j] for j in sets[k]):
                if one.name not in names and one.part.lossy:
                    found.setdefault(one.name, sets[k])
        return list(found.values())

    def _other_losses(self, now: Set, candidates: Sequence[Candidate], late: Late) -> list[Set]:
        """Return sets with another loss in place of one, where these explain nearly as much.

        What is lost while drawing divides all forces, and powers tell it from what is lost while
        returning by little or nothing. Both are to be weighed, and the quick search sees neither.
        """
        names = {candidates[k].name for k in now}
        losses = [k for k, one in enumerate(candidates) if one.part.lossy]
        new = [k for k in losses if candidates[k].name not in names]
        least = self.score(self._evaluate(now, candidates, late)) + RARE
        found = []
        for old, other in product(set(now) & set(losses), new):
            some = tuple(sorted({*now, other} - {old}))
            if self._compatible(candidates, some):
                one = self._evaluate(some, candidates, late)
                if one.sound and self.score(one) > least:
                    found.append(some)
        return found
