"""Questions that take several plans: least against shortest, the range."""

from __future__ import annotations

from energyplan.studies.comparison import Comparison, compare
from energyplan.studies.energy_map import Contour, EnergyMap, energy_map

__all__ = [
    "Comparison",
    "Contour",
    "EnergyMap",
    "compare",
    "energy_map",
]
