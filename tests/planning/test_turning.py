"""Ways whose turns are counted, against those that are merely short."""

from dataclasses import replace

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.budget import Budget
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.turning import cheapest_chain, ways_with_turns
from energyplan.planning.lattice.way_along import way_along
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.planning.scene.guide import distance_to_go
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def slalom(radian: float = 2.0) -> PlanningProblem:
    """Return a problem with a short way through a slalom and a straight one beside it.

    A radian costs as much as so many metres.
    """
    occupied = np.zeros((180, 320), bool)
    occupied[112:116, 30:290] = True
    for k in range(6):
        column = 55 + 40 * k
        rows = slice(0, 62) if k % 2 else slice(50, 112)
        occupied[rows, column : column + 4] = True
    cost = EnergyCost.from_coefficients(200.0, 200.0 * radian, COST.icr)
    grid = OccupancyGrid(occupied, 0.05)
    return PlanningProblem(grid, cost, (0.8, 2.8, 0.0), (15.2, 2.8, 0.0), vehicle=COST.vehicle)


def refined(problem: PlanningProblem, way) -> float:
    """Return what a way costs when it is short-cut, which must be free."""
    query = CompiledProblem(problem)
    refiner = Refiner(query.setting, way)
    refiner.shortcut(Budget())
    return query.value(query.path(refiner.segments))


def test_where_turning_is_dear_the_way_with_few_turns_is_found():
    problem = slalom(15.0)
    setting = CompiledProblem(problem).setting
    to_go = distance_to_go(setting)
    short = way_along(setting, to_go, Budget())
    found = ways_with_turns(setting, to_go, Budget(effort=6000))
    best = min(refined(problem, way) for way in found)
    assert best < 0.9 * refined(problem, short)
    # and planning finds it with little effort
    assert plan(problem, effort=10_000).energy < best


def test_where_turning_costs_little_the_short_way_is_found():
    problem = slalom(0.02)
    setting = CompiledProblem(problem).setting
    to_go = distance_to_go(setting)
    chain = cheapest_chain(to_go, setting, np.zeros(1, bool), 100_000)
    places = to_go.places
    rows = places.home[chain.chain] // (places.columns + 4)
    assert rows.max() * places.spacing < 6.0


def test_a_way_that_was_passed_is_left_for_another_one():
    setting = CompiledProblem(slalom()).setting
    to_go = distance_to_go(setting)
    ways = ways_with_turns(setting, to_go, Budget(effort=200_000))
    lengths = [np.abs(way.ds).sum() for way in ways]
    assert len(ways) > 1 and lengths[0] != pytest.approx(lengths[1], rel=0.02)


def test_a_closed_room_has_no_way():
    problem = slalom()
    occupied = problem.map.blocked.copy()
    occupied[:, 30:34] = True
    closed = replace(problem, map=OccupancyGrid(occupied, 0.05))
    setting = CompiledProblem(closed).setting
    to_go = distance_to_go(setting)
    assert len(cheapest_chain(to_go, setting, np.zeros(1, bool), 100_000).chain) == 0
