"""A plan for the least energy takes no more than the shortest route of the same effort."""

from __future__ import annotations

import numpy as np
import pytest
from by_day import by_day
from worlds import COST, MAPS, free_poses

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, compare, plan, read_map
from energyplan.errors import PlanningError
from energyplan.power.effects import term


def pairs(grid, count, seed=5):
    """Return pairs of random free poses."""
    poses = free_poses(grid, 2 * count, seed, draws=2000)
    return list(zip(poses[::2], poses[1::2], strict=True))


def both(problem, effort):
    """Return the plan of least energy and the shortest one; None where there is none."""
    try:
        return plan(problem, effort=effort), plan(problem.shortest, effort=effort)
    except PlanningError:
        return None


def compared(name, count, effort):
    """Compare both on random pairs of poses; return how many pairs were."""
    grid = read_map(MAPS / f"{name}.yaml")
    done = 0
    for start, goal in pairs(grid, count):
        made = both(PlanningProblem(grid, COST, start, goal), effort)
        if made is not None:
            found, shortest = made
            assert found.energy <= shortest.energy * (1 + 1e-9), (start, goal)
            done += 1
    return done


def strewn(seed):
    """Return a floor of boxes at all angles, many of them a robot's width apart."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.06, 0.12)
    y, x = (np.indices((round(14 / size), round(18 / size))) + 0.5) * size
    blocked = np.zeros(x.shape, bool)
    for _ in range(rng.integers(14, 26)):
        u, v = x - rng.uniform(0, 18), y - rng.uniform(0, 14)
        turn, (long, wide) = rng.uniform(0, np.pi), rng.uniform(0.3, 2.6, 2)
        along, across = u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)
        blocked |= (abs(along) < long / 2) & (abs(across) < wide / 2)
    return OccupancyGrid(blocked, size)


@pytest.mark.parametrize("name", ["office", "warehouse", "orchard"])
def test_a_plan_is_never_dearer_than_the_shortest_route(name):
    assert compared(name, 4, 3000) > 1


@pytest.mark.parametrize("effort", [300, 1500])
@pytest.mark.parametrize("seed", by_day(range(4), range(2)))
def test_no_floor_that_is_drawn_has_a_plan_dearer_than_the_shortest_route(seed, effort):
    grid = strewn(seed)
    made = [both(PlanningProblem(grid, COST, *ends), effort) for ends in pairs(grid, 3, seed)]
    assert any(made)
    for found, shortest in filter(None, made):
        assert found.energy <= shortest.energy * (1 + 1e-9)
        # a part of the effort makes the shortest: it is so up to a percent
        assert shortest.length <= found.length * 1.01


def test_what_stops_take_makes_no_plan_dearer_either():
    model = COST.model.with_term(term("hotel_load"), 30.0)
    model = model.with_term(term("linear_inertia"), COST.vehicle.mass)
    cost = EnergyCost(model, speed=0.5)
    grid = strewn(7)
    made = [both(PlanningProblem(grid, cost, *ends), 6000) for ends in pairs(grid, 2)]
    assert any(made)
    for found, shortest in filter(None, made):
        assert found.energy_driven <= shortest.energy_driven * (1 + 1e-9)


def test_a_comparison_tells_of_the_plans_that_are_made_without_it():
    grid = strewn(4)
    problem = PlanningProblem(grid, COST, *pairs(grid, 1, 4)[0])
    told = compare(problem, effort=1500)
    found, shortest = both(problem, 1500)
    assert told.energy_optimal.energy == found.energy
    # both are shortened further: a plan of the shortest path by the whole effort, that of a
    # comparison by a quarter, by the length of the way of the body's middle
    assert shortest.length <= found.shortest.length
    assert told.shortest.length <= found.shortest.length * (1.0 + 1e-6)
    assert told.shortest.cost_steady == pytest.approx(shortest.cost_steady, rel=1e-3)
    # one plan, and a quarter of its effort to shorten, and a bound
    assert told.energy_optimal.effort == found.effort
    assert told.shortest.effort < 0.5 * 1500
    assert 0 < told.shortest.lower_bound <= told.shortest.cost


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["office", "warehouse", "orchard"])
def test_no_plan_of_many_is_dearer_than_the_shortest_route(name):
    assert compared(name, 70, 5000) > 40
