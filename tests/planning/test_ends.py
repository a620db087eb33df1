"""Starts and goals with less clearance than is wanted elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import room

from energyplan import EnergyCost, PlanningProblem, PowerModel, plan, steering

COST = EnergyCost(PowerModel.preset("quadriga:empty:marble"))
HALF_WIDTH = 0.32


def beside_a_wall(gap, clearance):
    """A robot beside a long wall, to drive away to its left."""
    grid = room(240, 400, 0.05, np.s_[:20, :])
    start, goal = (3.0, 1.0 + HALF_WIDTH + gap, 0.0), (18.0, 6.0, np.pi / 2)
    return PlanningProblem(grid, COST, start, goal, clearance=clearance)


@pytest.mark.parametrize("clearance", [0.05, 0.1, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("gap", [0.02, 0.05, 0.1, 0.2, 0.28])
def test_a_wall_beside_the_start_costs_hardly_more_than_none(gap, clearance):
    problem = beside_a_wall(gap, clearance)
    found = plan(problem, effort=10_000)
    assert problem.fault(found.path) is None
    assert found.energy_steady < 1.02 * steering.energy(problem.start, problem.goal, COST)


@pytest.mark.parametrize("gap", [0.02, 0.2])
def test_a_wall_beside_the_goal_costs_hardly_more_than_none(gap):
    away = beside_a_wall(gap, 0.3)
    problem = replace(away, start=away.goal, goal=away.start)
    found = plan(problem, effort=10_000)
    assert found.energy_steady < 1.02 * steering.energy(problem.start, problem.goal, COST)


@pytest.mark.parametrize("y", [3.0, 5.6])
def test_a_start_that_lacks_little_clearance_costs_what_that_little_does(y):
    grid = room(240, 240, 0.05, np.s_[:120, 120:])
    start, goal = (6.0 - HALF_WIDTH - 0.585, y, np.pi / 2), (9.5, 8.5, 0.0)
    problem = PlanningProblem(grid, COST, start, goal, clearance=0.6)
    less = plan(replace(problem, clearance=0.58), effort=10_000)
    found = plan(problem, effort=10_000)
    assert found.energy_steady < 1.02 * less.energy_steady
    nearest = replace(problem, clearance=0.56).robot  # what turning may take
    fine = found.path.subdivide(0.05, 0.05)
    assert grid.footprint_free(fine.vertices, nearest).all()


@pytest.mark.parametrize("clearance_there", [0.02, 0.1, 0.3])
def test_a_start_in_a_corner_is_not_refused(clearance_there):
    grid = room(240, 240, 0.05, np.s_[:120, 120:])
    start, goal = (6.0 - HALF_WIDTH - clearance_there, 3.0, np.pi / 2), (9.5, 8.5, 0.0)
    problem = PlanningProblem(grid, COST, start, goal, clearance=0.6)
    found = plan(problem, effort=3_000)
    assert problem.fault(found.path) is None


def test_the_shortest_path_from_beside_a_wall_is_known_as_well():
    problem = beside_a_wall(0.05, 0.3)
    found = plan(problem, effort=3_000)
    assert problem.fault(found.shortest) is None
    assert found.shortest.length <= found.path.length
