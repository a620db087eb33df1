"""Little effort: the shortest path is short, and plans say what more effort may save."""

from itertools import pairwise

import numpy as np
import pytest
from worlds import COST, cluttered, free_poses, room

from energyplan import PlanningProblem, compare, plan
from energyplan.output import documents
from energyplan.planning.budget import EFFORT, Budget, plan_budget


def hall(start, goal, **more):
    return PlanningProblem(room(200, 200, 0.1), COST, start, goal, **more)


@pytest.mark.parametrize("effort", [300, 1000, 3000])
@pytest.mark.parametrize("ends", [((2, 2, 0.0), (18, 2, 1.5)), ((2, 5, 1.5), (18, 2, -2.0))])
def test_the_shortest_path_through_an_empty_hall_is_straight(ends, effort):
    start, goal = ends
    found = compare(hall(start, goal), effort=effort)
    straight = np.hypot(goal[0] - start[0], goal[1] - start[1])
    assert found.shortest.length == pytest.approx(straight, rel=1e-6)


def across(seed, **more):
    grid = cluttered(seed)
    poses = free_poses(grid, 400, seed)
    goal = poses[np.argmax(np.hypot(*(poses[:, :2] - poses[0, :2]).T))]
    return PlanningProblem(grid, COST, poses[0], goal, **more)


@pytest.mark.parametrize("seed", [0, 3])
def test_little_effort_shortens_the_shortest_path(seed):
    little = compare(across(seed), effort=2000).shortest
    much = compare(across(seed), effort=60_000).shortest
    assert little.length < 1.02 * much.length


def test_a_plan_says_what_more_effort_may_save():
    asked = across(3)
    found = plan(asked, effort=1500)
    assert found.gap > 0.03
    said = found.advice.removeprefix("effort 3000 may save up to ").removesuffix(" %")
    assert 0 <= float(said) - 100 * (found.cost - found.lower_bound) / found.cost < 0.1
    assert found.advice in documents.plan(found)["notes"]
    assert plan(hall((2, 2, 0), (18, 2, 0)), effort=1500).advice == ""


def test_more_effort_of_any_amount_is_never_worse():
    asked = across(5)
    costs = [plan(asked, effort=effort).cost for effort in range(900, 4000, 310)]
    assert all(more <= less * (1 + 1e-6) for less, more in pairwise(costs))


def test_a_default_effort_grows_up_to_four_times_and_one_that_was_given_does_not():
    budget = plan_budget(np.inf, None)
    assert not budget.part(0.5).extend()
    assert [budget.extend() for _ in range(8)] == [True] * 6 + [False] * 2
    assert budget.limit == 4 * EFFORT
    assert not Budget(effort=EFFORT).extend()
