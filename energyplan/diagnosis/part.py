"""An effect as it stands in a model (private)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from energyplan.path import FloatArray
from energyplan.power import Term
from energyplan.power.effects import Effect


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
