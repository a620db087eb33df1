"""Questions that take several plans: least energy against shortest, energy against time."""

from __future__ import annotations

from energyplan.studies.comparison import Comparison, compare
from energyplan.studies.pareto import ParetoFront, ParetoPoint, pareto

__all__ = ["Comparison", "ParetoFront", "ParetoPoint", "compare", "pareto"]
