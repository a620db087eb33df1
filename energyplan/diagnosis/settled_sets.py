"""Parameters that sets have from a grid, moved to where the sets fit best (private)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from energyplan.diagnosis.explanations import Evaluated, Explanation
from energyplan.diagnosis.fitted_sets import FittedSets
from energyplan.diagnosis.ground import Ground
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import About, Candidate, Set, terms_of
from energyplan.fit.drives.late import ON_TIME, Late
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import PAPER, ROUNDS, Problem
from energyplan.path import FloatArray

_NOWHERE = 1e9  # loss of a line that was not crossed: finite, since a simplex takes differences

Make = Callable[[FloatArray], tuple[list[Part], Problem]]
"""From a part's parameters to the parts and drives with them."""


def settled(part: Part, made: Make, errors: FloatArray) -> FloatArray | None:
    """Move the parameters of a part to where the loss is least.

    While they move, losses are linear about the coefficients found where they start; the outcome is
    taken where the fit with losses as they are finds it better, too.
    """
    start = part.values
    trial, case = made(start)
    ground = Ground(case.drives, case.vehicle) if part.effect.acts == "place" else None
    terms = terms_of(trial)
    found_there = fit(case.design(terms, errors), errors).values.tolist()
    known = dict(zip((term.name for term in terms), found_there, strict=True))
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
        if part.effect.grid and not _is_delay(part)
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


def _is_delay(part: Part) -> bool:
    return part.effect.name == "time_offset"


def _span(part: Part) -> FloatArray:
    """First step of each searched parameter: a good part of the grid's."""
    if _is_delay(part):
        return np.array([0.03, 0.05])[: len(part.params)]
    return np.asarray(0.2 * np.abs(part.values))


_KEPT = 8  # lines about which others are tried
_KEPT_LAST = 16  # the same where nothing else is sought any more: more of them find no better line
_TOGETHER = 16  # lines in one table
_TELLS = 5.0  # by which a line raises the logarithm of the likelihood, at least; chance up to 4
_SAMPLES = 5  # in a shortest window, that tell where a line may be

Weighed = dict[tuple[frozenset[int], Late], float]
"""Likelihood times prior of sets at time offsets, as logarithms."""


def most_probable(weighed: Weighed) -> tuple[frozenset[int], Late]:
    """Return the most probable set, and its time offset."""
    return max(weighed, key=lambda key: weighed[key])


class SettledSets(FittedSets):
    """Sets with parameters where they fit best; its parameters are those of `Proposals`."""

    def _weigh(
        self, weighed: Weighed, chosen: Set, candidates: Sequence[Candidate], late: Late
    ) -> None:
        """Weigh what of a set earns a place in it."""
        one = self._reduced(chosen, candidates, late)
        weighed[frozenset(one), late] = self._posterior(one, candidates, late)

    def _settle_best(
        self,
        weighed: Weighed,
        pools: Mapping[Late, list[Candidate]],
    ) -> None:
        """Move the parameters of the best set, which a grid has, to where it fits best.

        What a value of the grid beside the true one leaves would look like one effect or another.
        """
        self._settle_some(weighed, pools, lambda one: bool(one.part.params) and not one.settled)

    def _search_lines_again(
        self,
        weighed: Weighed,
        pools: Mapping[Late, list[Candidate]],
        searched: set[frozenset[str]],
    ) -> None:
        """Look for the lines of the best set once more: they were found without most of it.

        And for lines that it lacks: none of a grid may be near enough to the border to tell of it.
        Names of sets for which that was done are in `searched`, and join it.
        """
        chosen, late = most_probable(weighed)
        names = frozenset(pools[late][k].name for k in chosen)
        if names not in searched:
            searched.add(names)
            self._settle_some(
                weighed, pools, lambda one: one.settled and one.part.effect.acts == "place",
                _KEPT_LAST,
            )  # fmt: skip
            for some in self._with_lines(chosen, pools[late], late):
                self._weigh(weighed, some, pools[late], late)

    def _with_lines(
        self, chosen: Iterable[int], candidates: list[Candidate], late: Late
    ) -> list[Set]:
        """Return a set with a line of each effect of a place that it lacks, where one tells much.

        And without its changes: what a border does looks like a change, which is always found where
        it fits best.
        """
        now = tuple(sorted(chosen))
        found = []
        for core in dict.fromkeys([now, tuple(k for k in now if candidates[k].marked is None)]):
            one = self._evaluate(core, candidates, late)
            first: dict[str, int] = {}
            for k, other in enumerate(candidates):
                if other.part.effect.acts == "place":
                    first.setdefault(other.name, k)
            for name in first.keys() - {candidates[k].name for k in core}:
                line = first[name]
                some = tuple(sorted((*core, line)))
                moved = self._settle(line, some, candidates, one, least=_TELLS)
                if moved is not None:
                    found.append(moved)
        return found

    def _settle_some(
        self,
        weighed: Weighed,
        pools: Mapping[Late, list[Candidate]],
        which: Callable[[Candidate], bool],
        kept: int = _KEPT,
    ) -> None:
        """Weigh the best set with the parameters of some of its effects where it fits best."""
        chosen, late = most_probable(weighed)
        candidates, now = pools[late], tuple(sorted(chosen))
        one = self._evaluate(now, candidates, late)
        moved: Set | None = None
        for k in now:
            if which(candidates[k]):
                moved = self._settle(k, moved or now, candidates, one, kept) or moved
        if moved is not None:
            self._weigh(weighed, moved, candidates, late)

    def _settle_delay(
        self,
        weighed: Weighed,
        pools: dict[Late, list[Candidate]],
    ) -> None:
        """Move a time offset to where the best set fits best.

        It was found without most of the set, and what it is beside the true one by looks like one
        effect or another.
        """
        chosen, late = most_probable(weighed)
        if self.delay is None or late == ON_TIME:
            return
        one = self._evaluate(tuple(sorted(chosen)), pools[late], late)
        part = Part(self.delay, late.params)
        made = self._moved([*one.parts, part], len(one.parts), one.problem)
        better = settled(part, made, one.errors)
        if better is not None:
            moved = Late.of(made(better)[0][-1].params)
            pools[moved] = pools[late]
            self._weigh(weighed, tuple(sorted(chosen)), pools[moved], moved)

    def _settle(
        self, k: int, chosen: Set, candidates: list[Candidate], now: Evaluated, kept: int = _KEPT,
        least: float = -np.inf,
    ) -> Set | None:  # fmt: skip
        """Return a set with a candidate's parameters moved to where it fits best, if it does.

        What is moved becomes a further candidate, as probable before the data as it was. A line
        has to raise the logarithm of the likelihood by `least`.
        """
        parts, at = [candidates[j].part for j in chosen], chosen.index(k)
        if parts[at].effect.acts == "place":
            line = self._nearest(parts, at, now, kept, least)
            if line is None:
                return None
            parts[at] = line
        part, made = parts[at], self._moved(parts, at, now.problem)
        better = settled(part, made, now.errors)
        if better is None:
            if part == candidates[k].part:
                return None
            better = part.values
        last = max(one.columns[-1] for one in candidates if one.columns)
        columns = tuple(range(last + 1, last + 1 + len(part.terms)))
        part = made(better)[0][at]
        candidates.append(replace(candidates[k], part=part, columns=columns, settled=True))
        return tuple(sorted({*chosen, len(candidates) - 1} - {k}))

    def _nearest(
        self, parts: Sequence[Part], at: int, now: Evaluated, kept: int = _KEPT_LAST,
        least: float = -np.inf,
    ) -> Part | None:  # fmt: skip
        """Return the line with which a set fits best, of many: the nearest to start from.

        Wheels cross a border one after the other, so that lines beside the best one are worse than
        others that are far from it. About the best of a grid further ones are tried, closer and
        closer to each other. None where none of that grid tells as much as `least`.
        """
        problem = now.problem.thinned(_SAMPLES)
        about = self._about(now.problem, now.parts, now.errors)
        rest = [part for k, part in enumerate(parts) if k != at]
        ground = Ground(problem.drives, problem.vehicle)
        best = [*ground.lines(parts[at].effect, fine=True), parts[at]]
        for level in range(ground.levels + 1):
            if level:
                best = list(ground.about(best, level))
            tables = [
                self._alone(rest, best[k : k + _TOGETHER], problem, about, now.errors)
                for k in range(0, len(best), _TOGETHER)
            ]
            scores = np.concatenate([table[1:] for table in tables])
            if scores.max() < tables[0][0] + least:
                return None
            ranked = [best[k] for k in np.argsort(-scores, kind="stable")]
            best = ground.apart(ranked, level)[:kept]
        return best[0]

    def _alone(
        self, rest: Sequence[Part], new: Sequence[Part], problem: Problem, about: About,
        errors: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Score a set, and the set with one of several further parts each."""
        candidates, first = [], len(PAPER)
        for part in (*rest, *new):
            columns = tuple(range(first, first + len(part.terms)))
            first += len(columns)
            candidates.append(Candidate(part, columns, 0.0))
        design = self._table(problem, candidates, about)
        own = tuple(range(len(rest)))
        sets = [own, *((*own, len(rest) + k) for k in range(len(new)))]
        return self._scores(design, candidates, sets, errors)

    def _settled_lines(
        self, sets: Sequence[Set], scores: FloatArray, candidates: list[Candidate], now: Evaluated
    ) -> list[Set]:
        """Return the best set with each effect of a place, its line moved to where it fits best.

        Lines of a grid lie up to half a step beside the border, and tell only part of it. One that
        tells nothing is beside none. Sets with a further loss do not count: the quick search takes
        it for linear about none.
        """
        found: list[Set] = []
        losses = {part.effect.name for part in now.parts if part.lossy}
        plain = [
            k for k in np.argsort(-scores, kind="stable")
            if not any(candidates[j].marked for j in sets[k])
            and losses >= {candidates[j].name for j in sets[k] if candidates[j].part.lossy}
        ]  # fmt: skip
        known = {part.effect.name for part in now.parts}
        if any(part.effect.acts == "change" for part in now.parts):
            known = set()
        for effect in self.effects:
            if effect.acts != "place" or effect.name in known:
                continue
            own = {
                k for k, one in enumerate(candidates)
                if one.part.effect is effect and not one.settled
            }  # fmt: skip
            best, other = (
                next((k for k in plain if bool(own & set(sets[k])) == crossed), None)
                for crossed in (True, False)
            )
            if best is None:
                continue
            (line,) = own & set(sets[best])
            likely = scores[best] - candidates[line].prior
            if other is not None and likely < scores[other] + _TELLS:
                continue
            moved = self._settle(line, sets[best], candidates, now)
            if moved is not None:
                found.append(moved)
        return found

    def _refined(self, best: Explanation) -> Explanation:
        """Move the parameters that were searched on a grid to where the loss is least."""
        parts, problem = list(best.parts), best.problem
        design = problem.design(terms_of(parts))
        errors = problem.reference(design)
        for k, part in enumerate(parts):
            if not part.params:
                continue

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
            late = part.effect is self.delay
            return trial, problem.delayed(Late.of(trial[k].params)) if late else problem

        return made
