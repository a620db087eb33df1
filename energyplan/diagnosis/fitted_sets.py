"""Sets of effects fitted as they are, losses included, and what an effect earns in one (private).

The quick search proposes sets. Which effects of a set have a place in it is decided here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import f as fisher

from energyplan.diagnosis.evidence import innovations, residuals
from energyplan.diagnosis.explanations import Evaluated, Gain
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.plausible import Rest
from energyplan.diagnosis.proposals import (
    RARE,
    Candidate,
    Proposals,
    Set,
    terms_of,
    with_changes,
)
from energyplan.fit.drives.denoise import speed_noise
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.late import DELAYS, ON_TIME, Late
from energyplan.fit.drives.windows import SCALES
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import FLOOR, Problem
from energyplan.power.effects import Effect

_CHANCE = 0.05
"""Chance of an effect's coefficients, over all candidates together, that is accepted of one that
predicts unseen blocks better and outweighs its prior: three gates, each of which it must pass."""

WORTHWHILE = 0.05
"""Smallest fall of the cross-validated error, mean over the scales, that is worth an effect."""

WORTH = 0.004
"""Part of the root mean square power from which on an effect is worth its place whatever else is
missing. A smaller one is where it is more than what its set leaves beyond noise: what a model does
not have looks like one effect or another of at most that size."""

_LASTING = 0.45
"""Part of what a change is worth that is left without the block that shows most of it, at least.
Changes that are there leave half and more; an odd block that some line or time fits, two fifths at
most."""

_LASTING_COMPLETE = 0.3
"""The same where what the set leaves beyond noise is worth no effect: then no block is odd."""

_BY_CHANCE = 1e-3  # that noise alone leaves something of a set, over all scales
_FEWEST = 4  # samples that tell no noise

LATE = -float(np.log(len(DELAYS)))
"""Logarithm of the odds of a delay before the data: most logs' power is late, so that only the
search for it counts."""


class FittedSets(Proposals):
    """Sets of a catalogue's effects, each fitted once; its parameters are those of `Proposals`."""

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        limit: int,
        judged: Sequence[Drive] = (),
    ) -> None:
        super().__init__(problem, effects, limit, judged)
        self.rest = Rest(problem)
        self.evaluated: dict[tuple[Set, Late], Evaluated] = {}

    def _best_of(self, pools: Mapping[Late, tuple[list[Candidate], list[Set]]]) -> Evaluated:
        every = [
            self._evaluate(chosen, candidates, late)
            for late, (candidates, sets) in pools.items() for chosen in sets
        ]  # fmt: skip
        return max(every, key=self.score)

    def score(self, one: Evaluated) -> float:
        """Return the logarithm of an evaluated set's likelihood, that of its innovations.

        What the past of a residual foretells is no evidence against a set, and a fall of what lasts
        alone is none for it.
        """
        return float(self.problem.likelihood(one.fit.errors * one.shares, one.counts)) - one.odds

    def _evaluate(self, chosen: Set, candidates: Sequence[Candidate], late: Late) -> Evaluated:
        """Fit a set as it is, losses included."""
        key = (chosen, late)
        if key not in self.evaluated:
            parts = tuple(candidates[one].part for one in chosen)
            marked = next(
                (candidates[one].marked for one in chosen if candidates[one].marked), None
            )
            problem = self.problem if marked is None else with_changes(self.problem, marked)
            problem = problem.delayed(late)
            self.evaluated[key] = self._fitted(problem, parts, self._of_a_part(chosen, late))
        return self.evaluated[key]

    def _of_a_part(self, chosen: Set, late: Late) -> dict[str, float] | None:
        """Return the coefficients of the best part of a set that was fitted before; None of none.

        A fit with losses that begins there takes fewer steps, and explains no less.
        """
        parts = [
            one for (some, at), one in self.evaluated.items()
            if at == late and one.sound and set(some) < set(chosen)
        ]  # fmt: skip
        return self._coefficients(max(parts, key=self.score)) if parts else None

    def _fitted(
        self, problem: Problem, parts: Sequence[Part], start: Mapping[str, float] | None = None
    ) -> Evaluated:
        """Fit parts, losses included; from the other side of a bound where a loss ends beyond it.

        What losses take is not linear, and may fit as well with the sign that no robot has.
        """
        one = self._fitted_from(problem, parts, start)
        values = self._coefficients(one)
        beyond = {
            term.name: 2.0 * term.bounds[0] - values[term.name]
            for part in parts for term in part.terms
            if term.kind == "loss" and values[term.name] < term.bounds[0]
        }  # fmt: skip
        if one.sound or not beyond:
            return one
        other = self._fitted_from(problem, parts, values | beyond)
        return other if other.sound else one

    def _fitted_from(
        self, problem: Problem, parts: Sequence[Part], start: Mapping[str, float] | None
    ) -> Evaluated:
        terms = terms_of(parts)
        design = problem.design(terms, self.errors, start)
        errors = problem.reference(design)
        found = fit(design, errors)
        sound = self.rest.agrees(problem, parts, found)
        shares = innovations(design, residuals(design, found.values))
        odds = problem.odds(terms, found.values)
        return Evaluated(design.evidence, shares, errors, found, problem, sound, tuple(parts), odds)

    def _coefficients(self, one: Evaluated) -> dict[str, float]:
        """Return the coefficients of an evaluated set, by name of their term."""
        pairs = zip(terms_of(one.parts), one.fit.values.tolist(), strict=True)
        return {term.name: value for term, value in pairs}

    def _gain(self, full: Evaluated, less: Evaluated, part: Part, looks: float) -> Gain:
        """Return what a part is worth in a set, against the set without it."""
        floor = self.problem.floor
        scale = 1.0 / (less.errors + floor)
        # What shows in one equation alone is no less worth for it.
        fall = less.fit.squares - full.fit.squares
        falls, shares = (
            (fall * by[:, None]).reshape(-1, len(SCALES), fall.shape[1]).mean(axis=1)
            for by in (scale, FLOOR**2 / floor)
        )
        blocks = falls[np.argmax(falls.sum(axis=1))]
        return Gain(
            float(blocks.sum()), float(np.sqrt(len(blocks)) * blocks.std(ddof=1)),
            self._p_value(full, part, looks), self.score(full) - self.score(less),
            float(np.sqrt(max(shares.sum(axis=1).max(), 0.0))), fall.sum(axis=1)[: len(SCALES)],
            float(blocks.sum() - blocks.max()),
        )  # fmt: skip

    def _p_value(self, full: Evaluated, part: Part, looks: float) -> float:
        """Chance of a part's coefficients being this far from zero, over all candidates."""
        own = {term.name for term in part.terms}
        which = [k for k, term in enumerate(terms_of(full.parts)) if term.name in own]
        return min(full.fit.p_value(which) * looks, 1.0) if which else 0.0

    def _missing(self, one: Evaluated) -> float:
        """Return what a set leaves beyond noise, over the root mean square power.

        Of means of the total power at each scale, whichever leaves most. By chance noise alone
        leaves nothing in all but one of a thousand sets.
        """
        noise, power = [], []
        for drive in one.problem.drives:
            noise.append(speed_noise(drive.power) ** 2 if len(drive.power) > _FEWEST else 0.0)
            power.append(float(np.mean(drive.power**2)))
        samples = float(sum(len(drive.t) for drive in one.problem.drives))
        means = one.counts[: len(SCALES)]
        limit = fisher.isf(_BY_CHANCE / len(SCALES), means, samples) * np.median(noise)
        left = one.fit.errors[: len(SCALES)] - limit * means / samples
        return float(np.sqrt(max(left.max(), 0.0) / max(np.mean(power), 1e-300)))

    def _acceptable(self, gain: Gain, one: Candidate, full: Evaluated, less: Evaluated) -> bool:
        """Tell whether an effect earns its place in a set, given the set with and without it.

        However small, an effect is needed where the others are impossible without it.
        """
        return (self._large(gain, full) or not less.sound) and self._shown(gain, one, full)

    def _large(self, gain: Gain, full: Evaluated) -> bool:
        """Tell whether an effect is large enough to be named."""
        return gain.improvement > WORTHWHILE and (
            gain.share > WORTH or gain.share > self._missing(full)
        )

    def _shown(self, gain: Gain, one: Candidate, full: Evaluated) -> bool:
        """Tell whether drives show an effect, however small it is."""
        if one.part.effect.acts in ("change", "place"):
            # Where or when something changes was searched with all blocks: the block that shows
            # most of it is not foretold by the others.
            foretold = gain.lasting > _LASTING * gain.improvement or (
                gain.lasting > _LASTING_COMPLETE * gain.improvement and self._missing(full) <= WORTH
            )
        else:
            foretold = gain.lasting > 0.0 or gain.improvement > gain.error
        return foretold and gain.p_value < _CHANCE and gain.weight + one.prior > 0.0

    def _posterior(self, chosen: Set, candidates: Sequence[Candidate], late: Late) -> float:
        one = self._evaluate(chosen, candidates, late)
        prior = sum(candidates[k].prior for k in chosen)
        if late != ON_TIME:
            prior += LATE
        return self.score(one) + prior

    def _reduced(self, chosen: Set, candidates: Sequence[Candidate], late: Late) -> Set:
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
                # Nonsense that fits: what explains least is the culprit.
                weak = min(poor or now, key=lambda k: gains[k].weight + candidates[k].prior)
            now = tuple(k for k in now if k != weak)
        return now

    def _looks(self, one: Candidate) -> float:
        """Return how many effects were looked for where one was found; a usual one is always."""
        return 1.0 if one.part.effect.usual else float(len(self.effects))

    def _gains(
        self, now: Set, candidates: Sequence[Candidate], late: Late
    ) -> tuple[dict[int, Gain], dict[int, Evaluated]]:
        """Return what each effect of a set is worth in it, and the sets without it."""
        full = self._evaluate(now, candidates, late)
        less = {k: self._evaluate(tuple(j for j in now if j != k), candidates, late) for k in now}
        for k in now:
            looks = self._looks(candidates[k])
            full.gains[k] = self._gain(full, less[k], candidates[k].part, looks)
        return full.gains, less

    def _fit_from(
        self, part: Set, chosen: Set, candidates: Sequence[Candidate], late: Late
    ) -> None:
        """Fit a set again from the coefficients of a part of it that explains more.

        That is no smaller than what the whole can explain: a fit with losses has ended elsewhere.
        """
        less, full = (self._evaluate(some, candidates, late) for some in (part, chosen))
        if self.score(full) < self.score(less) + RARE:
            again = self._fitted(full.problem, full.parts, self._coefficients(less))
            if self.score(again) > self.score(full):
                self.evaluated[chosen, late] = again
