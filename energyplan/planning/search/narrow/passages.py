"""Narrow passages that the free configurations tested do not show.

Where a body passes with a centimetre to spare, hardly any of the poses tested is free. So the
cost-to-go is computed once more, over all headings at which the body may fit somewhere in a cell,
and its route is tracked by exact motions of the whole body, as any other. Where that gets stuck the
passage is penalised, and the next cheapest route is tracked.
"""

from __future__ import annotations

import numpy as np

from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.search.routes import cheapest_routes
from energyplan.planning.search.tracking import track_route
from energyplan.planning.settings import NARROW
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.cost_to_go import (
    CostToGo,
    cost_at_start,
    cost_through_passages,
    regions_for,
)
from energyplan.planning.space.motions import KernelProblem


def units_for_passages(known: CostToGo) -> float:
    """Return the units of work below which no narrow passage is searched for."""
    return max(NARROW.least, NARROW.costs_to_go * known.work / UNITS.nodes)


def paths_through_passages(
    setting: KernelProblem, known: CostToGo | None, budget: Budget
) -> list[Segments]:
    """Return paths through narrow passages: shorter ones than the route known, if there is one."""
    budget.beside(lambda: regions_for(setting, enlarged=True))
    limit = np.inf if known is None else NARROW.gain * cost_at_start(known, setting)
    to_go = cost_through_passages(setting, limit)
    budget.spend(to_go.work / UNITS.nodes)
    if budget.over or not cost_at_start(to_go, setting) < limit:
        return []
    tracked = track_route(setting, to_go, budget)
    if tracked.motions is not None:
        return [tracked.motions]
    return cheapest_routes(setting, to_go, budget, [tracked])
