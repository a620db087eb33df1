"""Sets of effects worth a closer look: the quick half of the search (private).

All candidates' columns go into one Gram matrix a fold; the cross-validated error of any set is then
a few small linear solves. Every pair of the best is tried, and larger sets grow from the best
smaller ones: effects mask each other, so that none can be judged alone (docs/theory, section 7).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from energyplan.diagnosis.change_points import mark_changes
from energyplan.diagnosis.ground import Ground
from energyplan.diagnosis.part import Part
from energyplan.fit.drives.design import Design
from energyplan.fit.drives.drive import Drive, channels_of
from energyplan.fit.drives.late import Late
from energyplan.fit.least_squares import WEIGHTS, fit, solve, squared_errors
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import Term
from energyplan.power.effects import Effect

RARE = -6.0
"""Logarithm of the odds of an effect before the data, against its absence."""

OF_LOG = -1.0
"""What is added for an effect of the log: the robot is the first suspect."""

PAIRED = 24
"""Effects of which all pairs are tried."""

_NEAR = 4.0  # logarithm of the odds at which a replacement is a rival
_BEAM = 8  # sets that grow
_EXACT = 6  # sets that are worth a closer look
_FOLDS = 40  # most folds
_BATCH = 128  # sets evaluated at once


@dataclass(frozen=True)
class Candidate:
    """An effect with some values of its parameters, and where its columns are."""

    part: Part  # the effect
    columns: tuple[int, ...]  # its columns in the table of all candidates
    prior: float  # logarithm of its odds before the data
    marked: Problem | None = None  # the drives with the times of a change
    settled: bool = False

    @property
    def always(self) -> bool:
        """Whether nearly every robot has it, whatever its parameters."""
        return self.part.effect.usual and not self.part.params

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

Labels = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Names of candidates with their parameters."""


def with_changes(problem: Problem, marked: Problem) -> Problem:
    """Return the drives with the times at which those of another problem changed."""
    drives = [
        drive.with_channels(changed=other.motion.channels["changed"])
        for drive, other in zip(problem.drives, marked.drives, strict=True)
    ]
    return Problem(drives, problem.vehicle, problem.memory)


Key = tuple[str, tuple[tuple[str, float], ...]]
About = dict[Key, float]
"""Coefficients of terms, by their name and parameters: variants share a name."""


def _key(term: Term) -> Key:
    return term.name, tuple(sorted(term.params.items()))


def terms_of(parts: Sequence[Part]) -> list[Term]:
    """Return the paper's terms and those of the parts."""
    return [*PAPER, *(term for part in parts for term in part.terms)]


class Proposals:
    """Quick search over the sets of a catalogue."""

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        limit: int,
        judged: Sequence[Drive] = (),
    ) -> None:
        self.problem, self.limit, self.judged = problem, limit, tuple(judged)
        self.untested: list[tuple[str, str]] = []
        testable = [effect for effect in effects if self._testable(effect)]
        self.delay = next((e for e in testable if e.name == "time_offset"), None)
        self.effects = [
            e for e in testable if e.acts not in ("kinematics", "hold") and e is not self.delay
        ]
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
            blind = [d.name for d in self.judged if name not in d.motion.channels]
            if blind:
                self.untested.append(
                    (effect.name, f"{', '.join(blind)} of the hold-out has no channel {name!r}")
                )
                return False
        if effect.acts == "place" and not self.variants(effect):
            self.untested.append((effect.name, "the robot hardly moves"))
            return False
        return True

    def variants(self, effect: Effect) -> list[Part]:
        """Return an effect with every combination of the values to try of its parameters."""
        if effect.acts == "place":
            return list(Ground(self.problem.drives, self.problem.vehicle).lines(effect))
        chosen: list[tuple[tuple[str, float], ...]] = [()]
        for key, values in effect.grid.items():
            chosen = [(*before, (key, value)) for before in chosen for value in values]
        return [Part(effect, params) for params in chosen]

    def _candidates(self, marked: Problem | None) -> list[Candidate]:
        found, first = [], len(PAPER)
        # Changes last: they are numbered only once their times are known.
        for effect in sorted(self.effects, key=lambda effect: effect.acts == "change"):
            parts = self.variants(effect)
            if not parts:
                continue  # nothing moves in an excerpt
            prior = RARE - np.log(len(parts))
            if effect.usual:  # the less so, the more of it has to be searched
                prior = 0.5 * RARE - np.log(len(parts)) if effect.grid else 0.0
            prior += OF_LOG if effect.acts == "log" else 0.0
            if effect.acts == "change":
                if marked is None:
                    continue
                # Every drive has a time of its own, which no other foretells.
                windows = [len(drive.windows[0].starts) for drive in self.problem.drives]
                prior -= float(np.sum(np.log(windows)))
            for part in parts:
                columns = tuple(range(first, first + len(part.terms)))
                first += len(columns)
                change = marked if effect.acts == "change" else None
                found.append(Candidate(part, columns, float(prior), change))
        return found

    def _table(self, problem: Problem, candidates: Sequence[Candidate], about: About) -> Design:
        """Columns of the paper's terms and of all candidates, linearised about coefficients."""
        terms = [*PAPER, *(term for one in candidates for term in one.part.terms)]
        values = np.array([about.get(_key(term), 0.0) for term in terms])
        marked = next((one.marked for one in candidates if one.marked is not None), None)
        if marked is not None:
            problem = with_changes(problem, marked)
        return problem.design_about(terms, values).with_folds(_FOLDS)

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
                joint = np.tensordot(weight, part, 1).swapaxes(0, 1)
                total = joint.sum(axis=1, keepdims=True)
                held, values = solve(total - joint), solve(total[:, 0])
                low, high = bounds[:, index[:, :-1]]
                possible = np.all((values >= low) & (values <= high), axis=-1)
                squares = squared_errors(part, held.swapaxes(0, 1)).sum(axis=1)
                score = self.problem.likelihood(squares / design.counts[:, None], design.evidence)
                found[some] = np.where(possible, score, -np.inf)
        prior = [sum(candidates[one].prior for one in chosen) for chosen in sets]
        return np.asarray(found + np.array(prior))

    def _bounds(self, candidates: Sequence[Candidate]) -> FloatArray:
        """Return the range of each column's coefficient, shape (2, columns); a usual one's is free.

        What nearly every robot has stays in while others are tried, however little it is. A loss
        has no upper end here: about forces that are not yet right it seems larger than it is.
        """
        rows = [(-np.inf, np.inf)] * len(PAPER)
        for one in candidates:
            for term in one.part.terms:
                low, high = term.bounds if not one.part.effect.usual else (-np.inf, np.inf)
                rows.append((low, np.inf if term.kind == "loss" else high))
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
        chosen = list(best.values())[:PAIRED]
        score(tuple(sorted({*start, *pair})) for pair in combinations(chosen, 2))
        for size in range(2, limit):
            level = [one for one in known if len(one) == len(start) + size]
            beam = sorted(level, key=lambda one: -known[one])[:_BEAM]
            before = max(known.values())
            score(tuple(sorted({*one, new})) for one in beam for new in every if new not in one)
            if max(known.values()) <= before:
                break
        return known

    def pool(self, late: Late, usual: Sequence[Part]) -> tuple[list[Candidate], list[Set]]:
        """Return the candidates at a time offset, and the best sets of them."""
        problem = self.problem.delayed(late)
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
                marked = self._marked(problem, parts, errors)
            # Losses act on the forces: those of the best set show others than the usual ones do.
            losses = any(one.part.lossy for one in candidates)
            if marked is None and not (losses and set(top) != set(start)):
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

    def _marked(
        self, problem: Problem, parts: Sequence[Part], errors: FloatArray
    ) -> Problem | None:
        """Find when the drives changed; None where whole drives differ, and nothing within one."""
        problem, errors = problem.of_totals, errors[: len(WEIGHTS)]
        marked = mark_changes(problem, terms_of(parts), errors)
        if not all("changed" in drive.motion.channels for drive in marked.drives):
            return None
        change = next(effect for effect in self.effects if effect.acts == "change")
        terms = terms_of([*(p for p in parts if p.effect.acts != "change"), Part(change)])
        base = fit(problem.design(terms_of(parts), errors), errors, by_block=True).loss
        within, between = (
            fit(case.design(terms, errors), errors, by_block=True).loss
            for case in (marked, marked.without_transitions())
        )
        return None if between - within < 0.5 * (base - within) else marked

    def _about(self, problem: Problem, parts: Sequence[Part], errors: FloatArray | None) -> About:
        """Return coefficients to linearise losses about: those of a model."""
        design = problem.design(terms_of(parts), errors)
        scale = problem.reference(design) if errors is None else errors
        values = fit(design, scale).values
        return dict(zip((_key(t) for t in terms_of(parts)), values.tolist(), strict=True))

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
            if new not in best and not candidates[old].always
        ]  # fmt: skip
        trials = [one for one in dict.fromkeys(trials) if self._compatible(candidates, one)]
        if not trials:
            return []
        scores = self._scores(design, candidates, [best, *trials], errors)
        near = np.flatnonzero(scores[1:] > scores[0] - _NEAR)
        order = near[np.argsort(-scores[1:][near], kind="stable")]
        return [trials[k] for k in order[:_EXACT]]
