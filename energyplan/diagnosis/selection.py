"""Forward selection of effects by blocked cross-validation (private).

One step: fit every candidate beside what is already in the model; keep the one that predicts
blocks it was not fitted to best; name those that do as well. Then fit all together again, and take
out what became superfluous.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from energyplan.diagnosis.change_points import lines, mark_changes
from energyplan.diagnosis.fitting import PAPER, Fit, Part, Problem, difference, fit
from energyplan.diagnosis.residual import dependences
from energyplan.diagnosis.windows import Design, channels_of, window_means
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.power.effects import Effect

SIGNIFICANCE = 0.01
"""Chance of a false find that a step accepts, over all candidates together."""

WORTHWHILE = 0.05
"""Smallest fall of the cross-validated error, mean over the scales, that is worth an effect."""

_SAME = 0.98
"""Share of a rival's gain that counts as doing as well."""

_FINE = 0.04
"""Share of the floor, a fifth of the error, below which ranking does not look."""

_WEIGHTS = (1.0, 2.0, 3.0)
"""Weight of each scale in ranking."""

_SPENT = 0.5
"""Share of a rival's gain that must be gone once the effect is in the model."""

_CLEARLY = 0.05
"""By how much more of the error something smooth must explain than a sudden change."""


@dataclass(frozen=True)
class Trial:
    """A candidate fitted beside the present model.

    Parameters
    ----------
    part : Part
        The candidate.
    problem : Problem
        The drives that it was fitted to; a change or a delay alters them.
    fit : Fit
        The fit of all terms.
    gain, gain_error : float
        Fall of the cross-validated error, mean over the scales, and its standard error.
    p_value : float
        Of its coefficients being zero.
    looks : int
        Bonferroni's factor: effects tried, times the variants of this one.
    """

    part: Part
    problem: Problem
    fit: Fit
    gain: float
    gain_error: float
    p_value: float
    looks: int = 1


@dataclass(frozen=True)
class Chosen:
    """An effect that selection kept."""

    part: Part
    trial: Trial
    rivals: tuple[Trial, ...]


@dataclass(frozen=True)
class Selection:
    """Outcome of forward selection."""

    problem: Problem
    chosen: tuple[Chosen, ...]
    untested: tuple[tuple[str, str], ...]

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts of the model, in the order in which they were added."""
        return tuple(choice.part for choice in self.chosen)


def terms_of(parts: Sequence[Part]) -> list[Term]:
    """Return the paper's terms and those of the parts."""
    return [*PAPER, *(term for part in parts for term in part.terms)]


class Selector:
    """Forward selection over a catalogue.

    Parameters
    ----------
    problem : Problem
        Training drives.
    effects : sequence of Effect
        The catalogue; ties go to the one that comes first.
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
        self.problem = problem
        self.progress = progress
        self.limit = limit
        self.untested: list[tuple[str, str]] = []
        self.dropped: set[str] = set()
        testable = (effect for effect in effects if self._testable(effect))
        self.effects = tuple(effect for effect in testable if effect.acts != "kinematics")

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

    # -- one step -------------------------------------------------------------------------------

    def _looks(self, effect: Effect) -> int:
        """Count the models that one variant stands for: a change may come at any window."""
        if effect.acts != "change":
            return 1
        return sum(len(drive.windows[0].starts) for drive in self.problem.drives)

    def _variants(self, effect: Effect) -> Iterator[Part]:
        if effect.acts == "place":
            yield from lines(effect, self.problem.drives)
            return
        grids = [[(key, value) for value in values] for key, values in effect.grid.items()]
        chosen: list[tuple[tuple[str, float], ...]] = [()]
        for grid in grids:
            chosen = [(*before, pair) for before in chosen for pair in grid]
        yield from (Part(effect, params) for params in chosen)

    def _trial(
        self, part: Part, parts: Sequence[Part], now: Fit, design: Design, errors: FloatArray
    ) -> Trial | None:
        problem, width = self.problem, design.rows[0].shape[1] - 1
        if part.effect.acts == "change":
            problem = mark_changes(problem, terms_of(parts), errors)
            if self._only_between(part, parts, problem, now, design, errors):
                return None
        if any(term.kind == "loss" for term in part.terms):
            terms = terms_of([*parts, part])
            known = dict(zip((t.name for t in terms), now.values, strict=False))
            full = problem.design(terms, errors, known, rounds=3)
        elif part.effect.name == "time_offset":
            problem = problem.advanced(dict(part.params)["delay"])
            drives = problem.drives
            moved = window_means(
                drives,
                [
                    (d.power - e.power)[:, None]
                    for d, e in zip(drives, self.problem.drives, strict=True)
                ],
            )
            rows = [
                np.column_stack([a[:, :-1], a[:, -1:] + b])
                for a, b in zip(design.rows, moved, strict=True)
            ]
            full = replace(design, rows=tuple(rows))
        else:
            full = design.joined(problem.means(part.terms, terms_of(parts), now.values))
        new = fit(full, errors)
        gain, error = difference(now.losses, new.losses)
        added = range(width, full.rows[0].shape[1] - 1)
        p_value = new.p_value(added) if len(added) else 0.0
        scales = len(errors)
        return Trial(part, problem, new, gain / scales, error / scales, p_value)

    def _only_between(
        self,
        part: Part,
        parts: Sequence[Part],
        problem: Problem,
        now: Fit,
        design: Design,
        errors: FloatArray,
    ) -> bool:
        """Tell whether whole drives differ, rather than anything changing during one."""
        settled = problem.without_transitions()
        terms = terms_of(parts)
        changed, constant = (
            fit(design.joined(case.means(part.terms, terms, now.values)), errors, by_block=True)
            for case in (problem, settled)
        )
        base = fit(design, errors, by_block=True)
        return constant.loss - changed.loss < 0.5 * (base.loss - changed.loss)

    def _plausible(self, trial: Trial, parts: Sequence[Part]) -> bool:
        terms = terms_of([*parts, trial.part])
        if not trial.part.terms:
            return True
        values = dict(zip((term.name for term in terms), trial.fit.values, strict=True))
        slack = 3 * np.sqrt(np.maximum(np.diag(trial.fit.covariance), 0.0))
        for term, wide in zip(terms, slack, strict=True):
            low, high = term.bounds
            own = term in trial.part.terms
            margin = 0.0 if own else float(wide)
            if not low - margin <= values[term.name] <= high + margin:
                return False
        low, high = trial.part.effect.plausible
        return low <= self._size(trial.part, terms, trial.fit) <= high

    def _size(self, part: Part, terms: Sequence[Term], found: Fit) -> float:
        return part.effect.value(PowerModel(self.problem.vehicle, tuple(terms), found.values))

    def _acceptable(self, trial: Trial) -> bool:
        return (
            trial.gain > max(WORTHWHILE, trial.gain_error)
            and trial.p_value * trial.looks < SIGNIFICANCE
        )

    def trials(self, parts: Sequence[Part]) -> list[Trial]:
        """Fit the best variant of every effect that is not in the model yet."""
        errors = self.problem.reference(self.problem.design(terms_of(parts)))
        design = self.problem.design(terms_of(parts), errors)
        now = fit(design, errors)
        taken = {term.name for part in parts for term in part.effect.terms}
        found = []
        for effect in self.effects:
            if effect.name in self.dropped or taken & {term.name for term in effect.terms}:
                continue
            best = self._best(effect, parts, now, design, errors)
            if best is not None and self._plausible(best, parts):
                found.append(replace(best, looks=best.looks * len(self.effects)))
        return found

    def _best(
        self, effect: Effect, parts: Sequence[Part], now: Fit, design: Design, errors: FloatArray
    ) -> Trial | None:
        """Fit all variants of an effect and return the one that fits best."""
        best: Trial | None = None
        looks = 0
        for part in self._variants(effect):
            looks += self._looks(effect)
            trial = self._trial(part, parts, now, design, errors)
            if trial is not None and (best is None or trial.fit.loss < best.fit.loss):
                best = trial
        return None if best is None else replace(best, looks=looks)

    # -- the loop -------------------------------------------------------------------------------

    def run(self) -> Selection:
        """Add effects one at a time until none helps."""
        chosen: list[Chosen] = []
        while True:
            parts = [choice.part for choice in chosen]
            share = len(chosen) / (self.limit + 1)
            self.progress(share, f"trying {len(self.effects)} effects beside {len(chosen)}")
            found = self.trials(parts)
            if chosen:
                chosen[-1] = self._with_true_rivals(chosen[-1], found)
            good = [trial for trial in found if self._acceptable(trial)]
            if not good or len(chosen) >= self.limit:
                break
            good = self._without_ramps(good, parts)
            if not good:
                break
            top = max(self._merit(trial) for trial in good)
            # Exact ties go to the effect that comes first in the catalogue.
            best = next(trial for trial in good if self._merit(trial) >= top - 1e-6)
            rivals = tuple(
                trial for trial in good if trial is not best and self._rivals(trial, best)
            )
            part, self.problem = self._refined(best, parts)
            chosen.append(Chosen(part, best, rivals))
            chosen = self._without_superfluous(chosen)
        return Selection(self.problem, tuple(chosen), tuple(self.untested))

    def take_all(self) -> Selection:
        """Add every effect whether it helps or not, in the order given."""
        chosen: list[Chosen] = []
        for effect in self.effects:
            parts = [choice.part for choice in chosen]
            errors = self.problem.reference(self.problem.design(terms_of(parts)))
            design = self.problem.design(terms_of(parts), errors)
            best = self._best(effect, parts, fit(design, errors), design, errors)
            if best is None:
                self.untested.append((effect.name, "whole drives differ, and not within a drive"))
                continue
            part, self.problem = self._refined(best, parts)
            chosen.append(Chosen(part, best, ()))
        return Selection(self.problem, tuple(chosen), tuple(self.untested))

    def _merit(self, trial: Trial) -> float:
        """Return the mean logarithm of the fall of the error over the scales.

        An effect that removes the error of one scale ranks before one that halves that of all, and
        the longer scales count for more: what lasts adds up to energy.
        """
        fall = np.log(trial.fit.errors + _FINE * self.problem.floor)
        return -float(np.average(fall, weights=_WEIGHTS))

    def _with_true_rivals(self, choice: Chosen, found: Sequence[Trial]) -> Chosen:
        """Keep those rivals that help no longer once the effect is in the model."""
        after = {trial.part.effect.name: trial.gain for trial in found}
        rivals = tuple(
            rival
            for rival in choice.rivals
            if after.get(rival.part.effect.name, 0.0) < _SPENT * rival.gain
        )
        return replace(choice, rivals=rivals)

    def _rivals(self, trial: Trial, best: Trial) -> bool:
        gap, error = difference(trial.fit.losses, best.fit.losses)
        return gap <= error or trial.gain >= _SAME * best.gain

    def _without_ramps(self, good: list[Trial], parts: Sequence[Part]) -> list[Trial]:
        """Leave out sudden changes where something smooth fits better: they only mimic it."""
        sudden = [trial for trial in good if trial.part.effect.acts in ("change", "place")]
        best = max(good, key=lambda trial: trial.gain)
        if best not in sudden:
            return good
        smooth = dependences(self.problem, terms_of(parts))[0]
        if smooth.explained_variance < best.gain + _CLEARLY:
            return good
        return [trial for trial in good if trial not in sudden]

    def _refined(self, best: Trial, parts: Sequence[Part]) -> tuple[Part, Problem]:
        """Move each parameter between its grid's neighbours to where the loss is least."""
        part, problem = best.part, best.problem
        for key, start in part.params:
            if key not in part.effect.grid:
                continue
            grid = sorted(part.effect.grid[key])
            k = grid.index(start)
            ends = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
            base = self.problem if key == "delay" else problem
            errors = problem.reference(problem.design(terms_of([*parts, part])))

            def moved(x: float, key: str = key, now: Part = part) -> Part:
                return replace(now, params=tuple((n, x if n == key else v) for n, v in now.params))

            def loss(
                x: float,
                make: Callable[[float], Part] = moved,
                base: Problem = base,
                errors: FloatArray = errors,
            ) -> float:
                made = make(float(x))
                case = base.advanced(float(x)) if made.effect.name == "time_offset" else base
                design = case.design(terms_of([*parts, made]), errors)
                return fit(design, errors).loss

            found = minimize_scalar(
                loss, bounds=ends, method="bounded", options={"xatol": 0.01 * (ends[1] - ends[0])}
            )
            part = moved(float(found.x))
            problem = base.advanced(float(found.x)) if key == "delay" else problem
        return part, problem

    def _without_superfluous(self, chosen: list[Chosen]) -> list[Chosen]:
        """Take out effects that the later ones made unnecessary.

        None comes back: two that stand in for each other would take turns for ever.
        """
        for choice in chosen[:-1]:
            parts = [other.part for other in chosen]
            if is_needless(self.problem, parts, choice.part):
                self.dropped.add(choice.part.effect.name)
                chosen = [other for other in chosen if other is not choice]
        return chosen


def is_needless(problem: Problem, parts: Sequence[Part], which: Part) -> bool:
    """Tell whether a model predicts as well without one of its parts, or it makes no sense now."""
    errors = problem.reference(problem.design(terms_of(parts)))
    full = fit(problem.design(terms_of(parts), errors), errors)
    values = dict(zip((term.name for term in terms_of(parts)), full.values, strict=True))
    if any(not t.bounds[0] <= values[t.name] <= t.bounds[1] for t in which.terms):
        return True
    rest = [part for part in parts if part is not which]
    less = fit(problem.design(terms_of(rest), errors), errors)
    gap, error = difference(less.losses, full.losses)
    return gap <= max(error, WORTHWHILE * len(errors))
