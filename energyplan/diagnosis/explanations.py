"""What the search weighs: sets of effects, what each effect is worth, probabilities (private)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from energyplan.diagnosis.part import Part
from energyplan.fit.least_squares import Fit
from energyplan.fit.problem import Problem
from energyplan.path import FloatArray

_LIKELY = 0.5  # odds of an effect beside the best explanation from which on it is worth a word
_RIVAL = 0.05  # probability of another explanation, over that of the best, that is worth naming


@dataclass(frozen=True)
class Explanation:
    """A set of effects that may be the reason."""

    parts: tuple[Part, ...]  # the effects, the one that explains most first
    probability: float  # that this set is the right one, among those of the catalogue
    problem: Problem  # the drives, with delays, factors and times of changes as this set has them
    gains: tuple[Gain, ...]  # what each effect of the set is worth in it
    alike: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(part.effect.name for part in self.parts)


@dataclass(frozen=True)
class Gain:
    """What an effect is worth beside the others of its set."""

    improvement: float
    error: float
    p_value: float  # of its coefficients being zero, times the number of candidates
    weight: float  # by how much it raises the logarithm of the set's likelihood
    share: float  # root of the fall of the mean square error, over the root mean square power
    falls: FloatArray  # (scales,) [W^2]
    lasting: float  # fall of the cross-validated loss without the block that shows most of it


@dataclass(frozen=True)
class Found:
    """Outcome of the search: explanations, the most probable one first.

    `followed` is how well each effect would be followed by another one, were it not known, and
    `odds` those of each effect beside the best explanation that is too small or too improbable to
    be named.
    """

    explanations: tuple[Explanation, ...]
    untested: tuple[tuple[str, str], ...]
    followed: FloatArray
    odds: Mapping[str, float]

    @property
    def best(self) -> Explanation:
        """The most probable explanation."""
        return self.explanations[0]

    @property
    def further(self) -> float:
        """Probability that there are effects beside the best explanation; one half at most."""
        odds = min(sum(self.odds.values()), 1.0)
        return odds / (1.0 + odds)

    @property
    def likely(self) -> tuple[str, ...]:
        """Effects beside the best explanation that may well be there."""
        return tuple(name for name, odds in self.odds.items() if odds > _LIKELY)

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
        named = sum(one.probability for one in self.explanations if name in one.names)
        return float((1.0 - self.further) * named + self.further * (name in self.best.names))


@dataclass
class Evaluated:
    """A set fitted as it is.

    `shares` are those of the residual's variance, at each scale, that its past does not foretell;
    `odds` the logarithm of what it took from the likelihood that what contacts hold was not known.
    """

    counts: FloatArray
    shares: FloatArray
    errors: FloatArray
    fit: Fit
    problem: Problem
    sound: bool
    parts: tuple[Part, ...]
    odds: float = 0.0
    gains: dict[int, Gain] = field(default_factory=dict)
