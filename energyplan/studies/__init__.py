"""Questions that take several plans: least against shortest, energy against time, the range."""

from __future__ import annotations

from energyplan.studies.comparison import Comparison, compare
from energyplan.studies.energy_map import Contour, EnergyMap, energy_map
from energyplan.studies.pareto import ParetoFront, ParetoPoint, pareto

__all__ = [
    "Comparison",
    "Contour",
    "EnergyMap",
    "ParetoFront",
    "ParetoPoint",
    "compare",
    "energy_map",
    "pareto",
]
