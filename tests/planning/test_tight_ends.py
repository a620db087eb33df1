"""Starts and goals with hardly any room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from tight_poses import tight_problem
from worlds import MAPS, box_robot, room

from energyplan import EnergyCost, Path, PlanningProblem, Pose, PowerModel, plan, read_map
from energyplan.planning import Budget
from energyplan.planning.budget import UNLIMITED
from energyplan.planning.ends import Ends
from energyplan.planning.search.narrow.escape import spin_room, tight, ways_out
from energyplan.planning.settings import ESCAPE
from energyplan.planning.space.compiled import CompiledProblem

EFFORT = 25_000
"""Within which every problem must be solved: half a second's."""

ROBOT = box_robot(0.9, 0.6)
COST = EnergyCost.from_coefficients(150.0, 60.0, 0.4)


@pytest.mark.parametrize("seed", by_day(range(80), [1, 2, 60]))
def test_who_drove_into_a_tight_place_gets_out_again(seed):
    problem, known = tight_problem(seed)
    found = plan(problem, effort=EFFORT, initial=[])
    assert found.energy < problem.cost.energy(known)  # which wandered


def test_a_goal_3_mm_beside_a_wall():
    # more than a lattice of headings can resolve: the first turn there is of 6 milliradians
    cost = EnergyCost(PowerModel.preset("husky_a200:flooring"))
    grid = read_map(MAPS / "office.yaml")
    start, goal = (3.10, 3.0, np.pi / 2), (19.46, 12.12, np.pi / 2)
    for ends in ((start, goal), (goal, start)):
        found = plan(PlanningProblem(grid, cost, *ends), effort=5000)
        roomy = plan(PlanningProblem(grid, cost, start, (19.0, 12.0, np.pi / 2)), effort=5000)
        assert found.energy < 1.4 * roomy.energy


def alley(spare, closed):
    """A robot between two walls, `spare` on both sides, perhaps with one behind as well."""
    aisle, behind = round((0.6 + 2 * spare) / 0.02), 20 if closed else 0
    low = 80 - aisle // 2
    walls = np.s_[40:low, :100], np.s_[low + aisle : 120, :100], np.s_[40:120, :behind]
    grid, start = room(160, 160, 0.02, *walls), (0.9, 0.02 * (low + aisle / 2), 0.0)
    return PlanningProblem(grid, COST, start, (2.6, 0.6, 0.0), vehicle=ROBOT)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("spare", [0.01, 0.02, 0.04])
def test_the_way_out_of_an_alley_is_known_both_ways(spare, closed):
    problem = alley(spare, closed)
    y = problem.start.y
    query = CompiledProblem(problem)
    assert tight(query, problem.start)
    assert not tight(query, problem.goal)
    for swapped in (False, True):
        if swapped:
            problem = replace(problem, start=problem.goal, goal=problem.start)
        # out, and to the side
        turns = 0.5 * np.pi * np.array([0, -1, 0, 1])
        simple = Path(Pose(0.9, y, 0.0), [1.7, 0.0, y - 0.6, 0.0], turns)
        assert problem.map.path_free(simple, problem.robot)
        found = plan(problem, effort=5000)
        assert found.energy <= problem.cost.energy(simple)


def test_ways_out_are_free_and_lead_to_room():
    problem, _ = tight_problem(1)
    query = CompiledProblem(problem)
    assert tight(query, problem.start)
    assert tight(query, problem.goal)
    several = ways_out(query, UNLIMITED)
    assert len(several) > 1
    for ways in several:
        ends = Ends(query, *ways)
        assert not tight(query, ends.problem.start)
        assert not tight(query, ends.problem.goal)
        away = ends.around(plan(ends.problem, effort=2000).path)
        assert problem.map.path_free(away, problem.robot)
        np.testing.assert_allclose(away.end[:2], problem.goal[:2], atol=1e-9)


def test_where_there_is_no_way_out_ends_stay_as_they_are():
    cell = room(60, 60, 0.05, np.s_[:10], np.s_[23:], np.s_[:, :10], np.s_[:, 32:])
    problem = PlanningProblem(cell, COST, (1.0, 0.825, 0.0), (1.05, 0.825, 0.0), vehicle=ROBOT)
    budget = Budget(effort=10**6)
    assert ways_out(CompiledProblem(problem), budget) == []
    assert budget.spent < 20_000
    assert plan(problem, effort=5000).energy == pytest.approx(0.05 * 150.0)


@pytest.mark.parametrize("gap", [0.0005, 0.005, 0.05])
def test_room_to_turn_beside_a_wall_is_what_geometry_says(gap):
    grid, pose = room(100, 100, 0.05, np.s_[:20]), (2.5, 1.0 + 0.3 + gap, 0.0)
    query = CompiledProblem(PlanningProblem(grid, COST, pose, pose, vehicle=ROBOT))
    turn = ESCAPE.turn
    free = spin_room(grid.space, query.body, query.centre(query.problem.start))
    angle = np.linspace(0, turn, 100_001)
    reach = 0.3 * np.cos(angle) + 0.45 * np.sin(angle)
    exact = 2 * angle[np.nonzero(reach <= 0.3 + gap)[0][-1]]
    # found by halving, a fifth at most below what is free
    assert 0.79 * exact <= free <= exact * (1 + 1e-6)
