"""What routes and searches find, and with how much effort."""

from __future__ import annotations

import math
import pathlib

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.io.maps import read_map
from energyplan.path import Path
from energyplan.planning import Budget, PlanningProblem, plan
from energyplan.planning.lattice.portfolio import Portfolio
from energyplan.planning.lattice.search import EXPANSION, Search, lattice_for
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import distance_to_go
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
WAREHOUSE = pathlib.Path(__file__).resolve().parents[2] / "maps" / "warehouse.yaml"


def test_a_way_of_another_kind_is_found_before_fine_searches_have_taken_the_effort():
    grid = read_map(WAREHOUSE)
    ends = [
        (*grid.to_world(np.array(place) / grid.resolution), yaw + grid.origin.yaw)
        for place, yaw in (((2, 2), 0.0), ((20, 12), math.pi / 2))
    ]
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    found = plan(PlanningProblem(grid, cost, *ends), effort=20_000)
    # on the way of the other kind it is 6.5 % dearer
    assert found.gap < 0.005


@pytest.fixture(scope="module")
def hall():
    """A hall with a wall across, and the search of least cost from one side to the other."""
    occupied = np.zeros((80, 120), bool)
    occupied[15:80, 60] = True
    grid = OccupancyGrid(occupied, 0.1)
    query = CompiledProblem(PlanningProblem(grid, COST, (2, 6, 0), (10, 6, 0)))
    setting = query.setting
    return setting, Search(setting, distance_to_go(setting), lattice_for(setting, 2.0), 1.0)


def test_a_search_turns_away_from_what_costs_more_than_the_limit(hall):
    setting, search = hall
    search.run(Budget(), stop_at_first=False)
    least, needed = search.best, int(search.tree.counts[2])
    above, below = (Search(setting, search.to_go, search.lattice, 1.0) for _ in range(2))
    above.run(Budget(), stop_at_first=False, limit=1.05 * least)
    assert above.best == pytest.approx(least, rel=0.02)
    below.run(Budget(), stop_at_first=False, limit=0.9 * least)
    assert not below.found
    assert int(below.tree.counts[2]) < 0.9 * needed
    # none of the work is counted that is not done
    budget = Budget()
    Search(setting, search.to_go, search.lattice, 1.0).run(budget, False, limit=0.0)
    assert budget.spent < EXPANSION


def test_a_path_that_was_entered_is_not_refined_twice(hall):
    setting, search = hall
    if not search.found:
        search.run(Budget(), stop_at_first=True)
    motions = search.segments()
    portfolio = Portfolio(setting, seed=1)
    for _ in range(3):
        portfolio.enter(motions)
    assert len(portfolio.turns(0.0)) == 1
    path = Path((0, 0, 0), *motions)
    assert portfolio.cost == pytest.approx(COST.energy(path), rel=1e-6)
    portfolio.enter(Segments(np.append(motions.ds, [0.5, -0.5]), np.append(motions.dtheta, [0, 0])))
    assert len(portfolio.turns(0.0)) == 2
