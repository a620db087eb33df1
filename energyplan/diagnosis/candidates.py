"""Sets of effects to examine more closely: the quick half of the search (private).

Effects vary in parameters that are not linear: when something changed, where a border lies. All
variants' columns go into one Gram matrix a fold; the cross-validated error of any set is then a few
small linear solves. Every pair of the best is tried, and larger sets grow from the best smaller
ones: effects mask each other, so that none can be judged alone (docs/theory, section 7).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from energyplan.fit.drive import Drive, Late, channels_of, column
from energyplan.fit.estimate import PAPER, WEIGHTS, Problem, fit, solve, squared_errors
from energyplan.fit.regressors import DesignMatrix
from energyplan.path import FloatArray
from energyplan.power import Term
from energyplan.power.effects import Effect
from energyplan.vehicle import Vehicle

# -- an effect as it stands in a model -------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """An effect with the values of the parameters in which it is not linear."""

    effect: Effect
    params: tuple[tuple[str, float], ...] = ()

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The effect's terms, with these parameters where they have them."""
        chosen = dict(self.params)
        return tuple(
            replace(term, params={key: chosen.get(key, v) for key, v in term.params.items()})
            for term in self.effect.terms
        )

    @property
    def values(self) -> FloatArray:
        """The values of its parameters."""
        return np.array([value for _, value in self.params])

    @property
    def lossy(self) -> bool:
        """Whether it takes a part of what the forces do."""
        return any(term.kind == "loss" for term in self.effect.terms)


# -- when a payload or a surface changed -----------------------------------------------------------

_SWEEPS = 3
_LEAST_SIDE = 0.1  # share of a drive before a change in it, and after


def _window_grams(problem: Problem, terms: Sequence[Term], values: FloatArray) -> list[FloatArray]:
    """Cumulative Gram matrices over half-second windows of [columns, paper's columns, power]."""
    sums = []
    about = problem.tables(terms, values)
    for drive, table, target in zip(problem.drives, about.columns, about.targets, strict=True):
        windows = drive.windows[0]
        table, target = table[:, 0], target[:, 0]  # of the total
        paper = [drive.seen(column(term, drive, problem.vehicle)) for term in PAPER]
        rows = windows.mean(np.column_stack([table, *paper, target]))
        products = np.einsum("ni,nj->nij", rows, rows)
        sums.append(np.concatenate([np.zeros((1, *products.shape[1:])), np.cumsum(products, 0)]))
    return sums


def _masked(total: FloatArray, after: FloatArray, count: int) -> FloatArray:
    """Gram matrix in which the last two columns count only in the windows `after`."""
    gram = np.broadcast_to(total, after.shape).copy()
    late = slice(count, count + 2)
    gram[..., late, :] = after[..., late, :]
    gram[..., :, late] = after[..., :, late]
    return gram


def mark_changes(problem: Problem, terms: Sequence[Term], errors: FloatArray) -> Problem:
    """Find when each drive changed state, and give the drives the channel ``changed``."""
    design = problem.design(terms, errors)
    values = solve(design.grams.sum(axis=(0, 1)))
    sums = _window_grams(problem, terms, values)
    count = len(terms)
    totals = [part[-1] for part in sums]
    afters = [np.zeros_like(total) for total in totals]
    splits: list[tuple[int, bool]] = [(len(part) - 1, True) for part in sums]
    for _ in range(_SWEEPS):
        settled = list(splits)
        for k, part in enumerate(sums):
            others_total = sum((totals[j] for j in range(len(sums)) if j != k), 0.0 * totals[k])
            others_after = sum((afters[j] for j in range(len(sums)) if j != k), 0.0 * totals[k])
            margin = int(np.ceil(_LEAST_SIDE * len(part)))
            times = np.arange(margin, len(part) - margin)
            if not len(times):
                continue  # too short to have changed within
            late = part[-1] - part[times]
            options = [late] if k == 0 else [late, part[times], part[-1:], 0.0 * part[-1:]]
            best = (np.inf, splits[k], afters[k])
            for number, after in enumerate(options):
                grams = _masked(others_total + totals[k], others_after + after, count)
                losses = squared_errors(grams, solve(grams))
                place = int(np.argmin(losses))
                if losses[place] < best[0] * (1 - 1e-9):
                    time = (int(times[place]), int(times[place]), 0, len(part) - 1)[number]
                    best = (float(losses[place]), (time, number != 1), after[place])
            splits[k], afters[k] = best[1], best[2]
        if settled == splits:
            break
    pairs = zip(problem.drives, splits, strict=True)
    return problem.on([_marked(drive, *split) for drive, split in pairs])


def _marked(drive: Drive, window: int, rising: bool) -> Drive:
    starts = np.append(drive.windows[0].starts, len(drive.t))
    after = np.arange(len(drive.t)) >= starts[window]
    return drive.with_channels(changed=np.asarray(after if rising else ~after, float))


def settle_change(
    drive: Drive, base: FloatArray, terms: Sequence[Term], values: FloatArray, vehicle: Vehicle
) -> Drive:
    """Find when a drive changed state, its coefficients known."""
    whole = drive.with_channels(changed=np.ones(len(drive.t)))
    step = sum(
        (column(term, whole, vehicle) * float(v)
         for term, v in zip(terms, values, strict=True)),
        np.zeros(len(drive.t)),
    )  # fmt: skip
    windows = drive.windows[0]
    residual = windows.mean(drive.power - base)
    shift = windows.mean(drive.seen(np.asarray(step)))
    before, after = residual**2, (residual - shift) ** 2
    early = np.concatenate([[0.0], np.cumsum(before - after)])
    rising, falling = early, -early + early[-1]
    # Sum of squares of changing at window k, less that of having changed all along.
    k_up, k_down = int(np.argmin(rising)), int(np.argmin(falling))
    if rising[k_up] <= falling[k_down]:
        return _marked(drive, k_up, True)
    return _marked(drive, k_down, False)


def change_time(drive: Drive) -> dict[str, float]:
    """Return when a drive changed state [s], by the words of a report; nothing where it did not."""
    if "changed" not in drive.motion.channels:
        return {}
    changed = drive.motion.channels["changed"]
    at = np.flatnonzero(np.diff(changed))
    return {f"time in {drive.name}": float(drive.t[at[0] + 1])} if len(at) else {}


# -- lines on the ground that a drive crossed, and those among them that may be a border -----------

_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8)  # of the time that contacts are on one side of a line
_FINE_SHARES = tuple(np.linspace(0.03, 0.97, 17))
_TURN = np.pi / 16  # between fine lines [rad]
_CLOSE = 0.125  # distance of the closest lines over that of a contact from the robot's middle
_LEAST_BEYOND = 0.1  # share of the time on either side of a line, from which it can be identified
_LEAST_VISITED = 0.03  # of a side that was visited as often as this:
_VISITS = 3


@dataclass(frozen=True)
class ContactTraces:
    """Where the contacts of a robot were while it moved."""

    drives: Sequence[Drive]  # drives with ``x`` and ``y``
    vehicle: Vehicle  # gives the positions of the contacts

    @cached_property
    def places(self) -> tuple[FloatArray, ...]:
        """Place of each contact on each drive, shape (n, contacts, 2) [m]; NaN at rest."""
        found = []
        for drive in self.drives:
            motion = drive.motion
            at = np.column_stack([motion.channels[name] for name in "xy"])[:, None]
            if "yaw" in motion.channels:
                ahead, aside = (part(motion.channels["yaw"]) for part in (np.cos, np.sin))
                x, y = self.vehicle.contacts.T
                rotated = [np.outer(ahead, x) - np.outer(aside, y)]
                rotated += [np.outer(aside, x) + np.outer(ahead, y)]
                at = at + np.stack(rotated, axis=-1)
            moves = (motion.v_left != 0.0) | (motion.v_right != 0.0)
            found.append(np.where(moves[:, None, None], at, np.nan))
        return tuple(found)

    @cached_property
    def _visited(self) -> FloatArray:
        """Places of all contacts while the robot moved, shape (m, 2) [m]."""
        every = np.concatenate([place.reshape(-1, 2) for place in self.places])
        return np.asarray(every[np.isfinite(every).all(axis=1)])

    @cached_property
    def middle(self) -> FloatArray:
        """Mean place, shape (2,) [m]: lines turn about it, however far the map's origin is."""
        return np.asarray(self._visited.mean(axis=0) if len(self._visited) else np.zeros(2))

    def from_middle(self, line: FloatArray) -> FloatArray:
        """Return a line's direction, and its offset from the middle [m]."""
        direction, offset = line
        return np.array([direction, offset - self.middle @ _normal(direction)])

    def from_origin(self, line: FloatArray) -> FloatArray:
        """Return a line's direction, and its offset from the origin, given that from the middle."""
        direction, apart = line
        return np.array([direction, apart + self.middle @ _normal(direction)])

    def lines(self, effect: Effect, fine: bool = False) -> Iterator[Part]:
        """Yield variants of an effect for lines that cross the ground driven on."""
        count, shares = (16, _FINE_SHARES) if fine else (8, _SHARES)
        for direction in np.arange(count) * np.pi / count:
            along = self._visited @ _normal(direction)
            for offset in np.quantile(along, shares) if len(along) else ():
                line = np.array([direction, offset])
                if not fine or self.crosses(line):
                    yield _at(effect, line)

    @cached_property
    def _span(self) -> float:
        """Length of the ground driven on, but for its fringes [m]."""
        low, high = np.quantile(self._visited, (0.03, 0.97), axis=0)
        return float(np.max(high - low))

    @cached_property
    def levels(self) -> int:
        """Number of refinements of fine lines until their ends are close, one at least."""
        turns = 0.5 * _TURN * self._span / (_CLOSE * self._reach)
        return int(np.ceil(np.log2(max(turns, 2.0))))

    def about(self, parts: Sequence[Part], level: int) -> Iterator[Part]:
        """Yield each of some lines, and up to eight about it, the closer the higher the level."""
        steps = self._steps(level)
        for part in parts:
            middle = self.from_middle(part.values)
            for away in product((0, -1, 1), repeat=2):
                line = self.from_origin(middle + np.array(away) * steps)
                if away == (0, 0) or self.crosses(line):
                    yield _at(part.effect, line)

    def apart(self, ranked: Sequence[Part], level: int) -> list[Part]:
        """Return lines without those that are next to a better one, best first."""
        steps = self._steps(level)
        kept: list[Part] = []
        for part in ranked:
            place = self.from_middle(part.values)
            gaps = (np.abs(place - self.from_middle(other.values)) for other in kept)
            if all(np.any(gap > 1.5 * steps) for gap in gaps):
                kept.append(part)
        return kept

    def crosses(self, line: FloatArray) -> bool:
        """Return whether contacts were on both sides of a line for long enough, or often enough."""
        along = [place @ _normal(line[0]) - line[1] for place in self.places]
        beyond = [each > 0.0 for each in along]
        before = [each < 0.0 for each in along]
        counts = [sum(int(np.count_nonzero(each)) for each in side) for side in (before, beyond)]
        share = min(counts) / max(sum(counts), 1)
        if share >= _LEAST_BEYOND or share < _LEAST_VISITED:
            return share >= _LEAST_BEYOND
        side = before if counts[0] < counts[1] else beyond
        return sum(map(_visits, self.drives, side)) >= _VISITS

    @cached_property
    def _reach(self) -> float:
        """Distance of the outermost contact from the robot's middle [m]."""
        return float(np.hypot(*self.vehicle.contacts.T).max())

    @property
    def first_step(self) -> FloatArray:
        """First step from a line that is close to the best one [rad] and [m]."""
        return np.array([0.25 * _TURN, 2.0 * _CLOSE * self._reach])

    def _steps(self, level: int) -> FloatArray:
        """Distance of neighbouring lines [rad] and [m]: of fine ones first, and of close ones."""
        close, fine = _CLOSE * self._reach, self._span / len(_FINE_SHARES)
        share = level / self.levels
        return np.array([_TURN / 2.0**level, fine ** (1.0 - share) * close**share])


def _normal(direction: float) -> FloatArray:
    return np.array([np.cos(direction), np.sin(direction)])


def _at(effect: Effect, line: FloatArray) -> Part:
    return Part(effect, (("direction", float(line[0])), ("offset", float(line[1]))))


def _visits(drive: Drive, there: NDArray[np.bool_]) -> int:
    """Return how often half of the contacts came to a side of a line."""
    half = there.mean(axis=1) >= 0.5
    some = drive.windows[0].mean(half.astype(float)) > 0.0
    return int(np.count_nonzero(np.diff(some, prepend=False) & some))


# -- sets of effects to examine more closely: the quick half of the search -------------------------

RARE = -6.0
"""Logarithm of the odds of an effect before the data, against its absence."""

OF_LOG = -1.0
"""What is added for an effect of the log: the robot is the first suspect."""

PAIRED = 24
"""Effects of which all pairs are tried."""

_BEAM = 8  # sets that grow
_EXACT = 6  # sets to examine more closely
_FOLDS = 40  # most folds
_BATCH = 128  # sets evaluated at once


@dataclass(frozen=True)
class EffectCandidate:
    """An effect with some values of its parameters, and where its columns are."""

    part: Part  # the effect
    columns: tuple[int, ...]  # its columns in the table of all candidates
    prior: float  # logarithm of its odds before the data
    marked: Problem | None = None  # the drives with the times of a change

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
    return problem.on(drives)


Key = tuple[str, tuple[tuple[str, float], ...]]
About = dict[Key, float]
"""Coefficients of terms, by their name and parameters: variants share a name."""


def _key(term: Term) -> Key:
    return term.name, tuple(sorted(term.params.items()))


def terms_of(parts: Sequence[Part]) -> list[Term]:
    """Return the paper's terms and those of the parts."""
    return [*PAPER, *(term for part in parts for term in part.terms)]


def _columns(candidates: Sequence[EffectCandidate], chosen: Set) -> list[int]:
    """Return the columns of a set in the table of all candidates, the paper's first."""
    return [*range(len(PAPER)), *(c for one in chosen for c in candidates[one].columns)]


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
        self.delay = next((e for e in testable if e.delays), None)
        self.effects = [
            e for e in testable if e.acts not in ("kinematics", "hold") and e is not self.delay
        ]
        self.errors: FloatArray | None = None

    def _testable(self, effect: Effect) -> bool:
        why = self.shown(effect)
        if why is not None:
            self.untested.append((effect.name, why))
        return why is None

    def shown(self, effect: Effect) -> str | None:
        """Return why the drives cannot show an effect; None where they can."""
        common = channels_of(self.problem.drives)
        for name in effect.channels:
            if name not in common:
                return f"the logs have no channel {name!r}"
            if all(np.ptp(d.motion.channels[name]) < 1e-9 for d in self.problem.drives):
                return f"the channel {name!r} never changes"
            if blind := [d.name for d in self.judged if name not in d.motion.channels]:
                return f"{', '.join(blind)} of the hold-out has no channel {name!r}"
        if effect.acts == "place" and not self.variants(effect):
            return "the robot hardly moves"
        return None

    def variants(self, effect: Effect) -> list[Part]:
        """Return an effect with every combination of the values to try of its parameters."""
        if effect.acts == "place":
            return list(ContactTraces(self.problem.drives, self.problem.vehicle).lines(effect))
        chosen: list[tuple[tuple[str, float], ...]] = [()]
        for key, values in effect.grid.items():
            chosen = [(*before, (key, value)) for before in chosen for value in values]
        return [Part(effect, params) for params in chosen]

    def candidates_for(self, marked: Problem | None) -> list[EffectCandidate]:
        """Return all effects with each of their variants; changes where their times are known."""
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
                # Prior penalty: one free time a drive (logarithm of the number of windows).
                windows = [len(drive.windows[0].starts) for drive in self.problem.drives]
                prior -= float(np.sum(np.log(windows)))
            for part in parts:
                columns = tuple(range(first, first + len(part.terms)))
                first += len(columns)
                change = marked if effect.acts == "change" else None
                found.append(EffectCandidate(part, columns, float(prior), change))
        return found

    def table(
        self, problem: Problem, candidates: Sequence[EffectCandidate], about: About
    ) -> DesignMatrix:
        """Columns of the paper's terms and of all candidates, linearised about coefficients."""
        terms = [*PAPER, *(term for one in candidates for term in one.part.terms)]
        values = np.array([about.get(_key(term), 0.0) for term in terms])
        marked = next((one.marked for one in candidates if one.marked is not None), None)
        if marked is not None:
            problem = with_changes(problem, marked)
        return problem.design_about(terms, values).with_folds(_FOLDS)

    def scores(
        self,
        design: DesignMatrix,
        candidates: Sequence[EffectCandidate],
        sets: Sequence[Set],
        reference: FloatArray,
    ) -> FloatArray:
        """Likelihood times prior of sets, as logarithms."""
        grams = design.grams
        bounds = self._bounds(candidates)
        found = np.full(len(sets), -np.inf)
        wide = [_columns(candidates, chosen) for chosen in sets]
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

    def _bounds(self, candidates: Sequence[EffectCandidate]) -> FloatArray:
        """Return ranges of coefficients, (2, columns); infinite if nearly all robots have them."""
        rows = [(-np.inf, np.inf)] * len(PAPER)
        for one in candidates:
            for term in one.part.terms:
                low, high = term.bounds if not one.part.effect.usual else (-np.inf, np.inf)
                rows.append((low, np.inf if term.kind == "loss" else high))
        return np.array(rows).T

    def compatible(self, candidates: Sequence[EffectCandidate], chosen: Iterable[int]) -> bool:
        """Return whether no two candidates share a term."""
        names = [name for one in chosen for name in candidates[one].terms]
        return len(set(names)) == len(names)

    def _grow(
        self,
        design: DesignMatrix,
        candidates: Sequence[EffectCandidate],
        start: Set,
        reference: FloatArray,
        limit: int,
    ) -> dict[Set, float]:
        """Score single candidates, all pairs of the best, and what grows from the best sets."""
        known: dict[Set, float] = {}

        def score(sets: Iterable[Set]) -> None:
            fresh = [
                one for one in dict.fromkeys(sets)
                if one not in known and self.compatible(candidates, one)
            ]  # fmt: skip
            if fresh:
                values = self.scores(design, candidates, fresh, reference)
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

    def pool(self, late: Late, usual: Sequence[Part]) -> tuple[list[EffectCandidate], list[Set]]:
        """Return the candidates at a time offset, and the best sets of them."""
        problem = self.problem.delayed(late)
        about, marked = self.about(problem, usual, None), None
        pooled: dict[frozenset[str], tuple[float, Labels]] = {}
        candidates: list[EffectCandidate] = []
        for stage in range(2):
            candidates = self.candidates_for(marked)
            start = tuple(k for k, one in enumerate(candidates) if one.part in usual)
            design = self.table(problem, candidates, about)
            errors = problem.reference(design.picked(_columns(candidates, start)))
            known = self._grow(design, candidates, start, errors, 2)
            # Weigh the scales by what the best set leaves, and look again.
            top = max(known, key=lambda one: known[one])
            errors = problem.reference(design.picked(_columns(candidates, top)))
            known = self._grow(design, candidates, start, errors, self.limit)
            ranked = sorted(known, key=lambda one: -known[one])
            pooled = self._merged(pooled, ranked[: 4 * _EXACT], known, candidates, stage)
            if stage:
                break
            top = ranked[0]
            parts = [candidates[k].part for k in top]
            about = self.about(problem, parts, errors)
            change = next((effect for effect in self.effects if effect.acts == "change"), None)
            if change is not None:
                marked = self.marked(problem, parts, errors, change)
            # Losses act on the forces: those of the best set differ from those of the first one.
            losses = any(one.part.lossy for one in candidates)
            if marked is None and not (losses and set(top) != set(start)):
                break
        names = {(one.name, one.part.params): k for k, one in enumerate(candidates)}
        sets = []
        for _, (_, labels) in sorted(pooled.items(), key=lambda item: -item[1][0]):
            if all(label in names for label in labels):
                sets.append(tuple(sorted(names[label] for label in labels)))
        # The effects of nearly every robot, alone: where all others turn out to be nonsense.
        plain = tuple(k for k, one in enumerate(candidates) if one.part in usual)
        return candidates, [*list(dict.fromkeys(sets))[:_EXACT], plain]

    def marked(
        self, problem: Problem, parts: Sequence[Part], errors: FloatArray, change: Effect
    ) -> Problem | None:
        """Find when the drives changed; None where whole drives differ, and nothing within one."""
        problem, errors = problem.of_totals, errors[: len(WEIGHTS)]
        marked = mark_changes(problem, terms_of(parts), errors)
        if not all("changed" in drive.motion.channels for drive in marked.drives):
            return None
        terms = terms_of([*(p for p in parts if p.effect.acts != "change"), Part(change)])
        base = fit(problem.design(terms_of(parts), errors), errors, by_block=True).loss
        within, between = (
            fit(case.design(terms, errors), errors, by_block=True).loss
            for case in (marked, marked.without_transitions())
        )
        return None if between - within < 0.5 * (base - within) else marked

    def about(self, problem: Problem, parts: Sequence[Part], errors: FloatArray | None) -> About:
        """Return coefficients to linearise losses about: those of a model."""
        design = problem.design(terms_of(parts), errors)
        scale = problem.reference(design) if errors is None else errors
        values = fit(design, scale).values
        return dict(zip((_key(t) for t in terms_of(parts)), values.tolist(), strict=True))

    def _merged(
        self,
        pooled: Mapping[frozenset[str], tuple[float, Labels]],
        ranked: Sequence[Set],
        known: Mapping[Set, float],
        candidates: Sequence[EffectCandidate],
        stage: int,
    ) -> dict[frozenset[str], tuple[float, Labels]]:
        """Join the best sets of both looks; the second one knows losses and changes better."""
        merged = dict(pooled)
        for chosen in ranked:
            names = frozenset(candidates[k].name for k in chosen)
            labels = tuple((candidates[k].name, candidates[k].part.params) for k in chosen)
            if names not in merged or (stage and known[chosen] > merged[names][0]):
                merged[names] = (known[chosen], labels)
        return merged
