"""Plans for a robot under way: the rest of the former plan, ways around, what the bound is."""

from __future__ import annotations

from dataclasses import replace
from pickle import dumps, loads

import numpy as np
import pytest
from worlds import COST, box_robot, cluttered, free_poses, room

from energyplan import EnergyCost, Path, PlanningProblem, Pose, PowerModel, plan, steering
from energyplan.errors import InvalidInputError, NoPathError, StartInCollisionError
from energyplan.planning.replanning import remainder, replan
from energyplan.planning.space.compiled import compiled
from energyplan.terrain import CostMap

ROUNDED = 1 + 1e-12
"""What sums over a few dozen motions may be off by."""


@pytest.fixture(scope="module")
def door():
    """A wall with two doors, and a plan through the lower one."""
    wall = np.s_[:20, 100:104], np.s_[60:110, 100:104], np.s_[140:, 100:104]
    problem = PlanningProblem(room(160, 200, 0.05, *wall), COST, (1.5, 2, 0), (8.5, 2, 0))
    return problem, plan(problem, effort=4000)


def test_on_the_path_the_rest_of_it_is_left(door):
    problem, former = door
    for share in (0.0, 0.4, 0.97, 1.0):
        fine = former.path.subdivide(0.013, 0.02)
        here = fine.vertices[round(share * len(fine))]
        rest = remainder(former.path, here, problem)
        passed = slice(round(share * len(fine)))
        driven = COST.energy(replace(fine, ds=fine.ds[passed], dtheta=fine.dtheta[passed]))
        # the nearest place looked at is up to half a step off, and the way to it is no dearer
        assert COST.energy(rest) <= former.energy - driven + 1e-6 * former.energy
        assert np.allclose(rest.start, here)
        assert np.allclose(np.subtract(rest.end, problem.goal)[:2], 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_beside_the_path_the_way_leads_back_to_it(seed):
    rng = np.random.default_rng(seed)
    grid = cluttered(seed, 6)
    ends = free_poses(grid, 2, seed, COST.vehicle)
    problem = PlanningProblem(grid, COST, *ends)
    former = plan(problem, effort=2000)
    fine = former.path.poses(0.05, 0.05)
    for _ in range(5):
        here = fine[rng.integers(0, len(fine))] + rng.normal(0, (0.03, 0.03, 0.1))
        if not grid.footprint_free(here, COST.vehicle):
            continue
        rest = remainder(former.path, here, problem)
        if rest is None:
            continue
        assert grid.path_free(rest, COST.vehicle)
        assert np.allclose(rest.start, here)
        assert COST.energy(rest) >= steering.energy(here, problem.goal, COST) * (1 - 1e-9)


@pytest.mark.parametrize("size", [0.08, 0.5, 6.0])
def test_robots_of_any_size_get_back_to_their_path_over_a_way_of_their_size(size):
    """A robot beside its path goes on at an angle rather than turning twice on the spot."""
    hall = room(100, 200, 0.1 * size)
    cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=500.0 * size, icr=0.5 * size)
    start, goal = (3.0 * size, 5.0 * size, 0.0), (17.0 * size, 5.0 * size, 0.0)
    problem = PlanningProblem(hall, cost, start, goal)
    path = Path(Pose(*start), [14.0 * size], [0.0])
    here = (6.0 * size, 5.2 * size, 0.05)
    rest = remainder(path, here, problem)
    least = float(steering.energy(here, goal, cost))
    assert cost.energy(rest) <= 1.02 * least
    # and around what has closed, though nothing but the path is known
    row, column = 46, 110
    shut = hall.updated(np.ones((8, 8), bool), row, column)
    found = replan(problem, path, start=here, map=shut, effort=1500)
    assert found.length > 11.0 * size
    assert found.cost <= 1.1 * plan(replace(problem, start=here, map=shut), effort=6000).cost


def test_while_nothing_became_free_the_rest_is_the_plan(door):
    problem, former = door
    here = former.path.poses()[20]
    added = problem.map.updated(np.ones((3, 3), bool), 150, 20)
    for grid in (None, problem.map, added):
        again = replan(problem, former, start=here, map=grid, effort=1)
        rest = remainder(former.path, here, problem)
        assert again.energy == pytest.approx(COST.energy(rest), rel=1e-12)
        assert again.effort == 0


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_what_is_left_of_the_bound_is_a_bound(door, share):
    problem, former = door
    poses = former.path.poses()
    here = poses[int(share * len(poses))]
    added = problem.map.updated(np.ones((3, 3), bool), 150, 20)
    left = replan(problem, former, start=here, map=added, effort=1)
    best = plan(replace(problem, start=here, map=added), effort=20_000)
    assert left.lower_bound <= best.cost * ROUNDED
    assert left.lower_bound >= steering.energy(here, problem.goal, COST) * (1 - 1e-9)


@pytest.mark.parametrize(("closed", "other"), [(18, False), (40, True)])
def test_a_closed_place_is_bypassed(door, closed, other):
    """Half of the door, or all of it, so that the way leads through the other one."""
    problem, former = door
    here = former.path.poses()[5]
    shut = problem.map.updated(np.ones((closed, 4), bool), 20, 100)
    assert remainder(former.path, here, replace(problem, map=shut)) is None
    again = replan(problem, former, start=here, map=shut, effort=8000 if other else 4000)
    anew = plan(replace(problem, start=here, map=shut), effort=20_000)
    assert again.energy <= 1.03 * anew.energy
    assert again.lower_bound <= anew.cost * ROUNDED


def test_what_cannot_be_is_said(door):
    problem, former = door
    walled = problem.map.updated(np.ones((160, 4), bool), 0, 100)
    with pytest.raises(NoPathError):
        replan(problem, former, start=former.path.poses()[10], map=walled, effort=4000)
    with pytest.raises(StartInCollisionError):
        replan(problem, former, start=(5.1, 4.0, 0.0))
    with pytest.raises(InvalidInputError, match="plan again"):
        replan(replace(problem, goal=(8.0, 2.0, 0.0)), former, start=(2, 2, 0))


def test_what_became_free_is_used(door):
    problem, _ = door
    shut = problem.map.updated(np.ones((40, 4), bool), 20, 100)
    around = plan(replace(problem, map=shut), effort=6000)
    here = around.path.poses()[3]
    again = replan(replace(problem, map=shut), around, start=here, map=problem.map, effort=6000)
    rest = remainder(around.path, here, problem)
    assert again.energy < 0.9 * COST.energy(rest)


def test_a_start_that_was_moved_or_that_is_blocked_by_now_is_left_behind(door):
    """The robot is under way: the place that it left need not be free, as asked or any more."""
    problem, former = door
    front = COST.vehicle.footprint[1, 0]
    touching = replace(problem, start=(5.0 - front + 0.02, 4.0, 0.0))
    beside = plan(touching, effort=4000)
    assert beside.notes
    assert beside.path.start != touching.start
    poses = beside.path.poses()
    for here in poses[[5, len(poses) // 2]]:
        again = replan(touching, beside, start=here, effort=4000)
        best = plan(replace(problem, start=here), effort=8000)
        assert steering.energy(here, problem.goal, COST) < again.lower_bound <= best.cost * ROUNDED
        assert again.energy <= 1.03 * best.energy
    box = problem.map.updated(np.ones((4, 4), bool), 38, 28)  # on the start
    here = former.path.poses()[60]
    again = replan(replace(problem, map=box), former.path, start=here, effort=1)
    assert again.energy == pytest.approx(COST.energy(remainder(former.path, here, problem)))


@pytest.fixture(scope="module")
def hall():
    """A hall, the same with a wall across most of it, and a plan around that wall."""
    free = room(100, 200, 0.1)
    shut = free.updated(np.ones((85, 4), bool), row=0, column=100)
    cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    problem = PlanningProblem(free, cost, (4, 2, 0), (18, 2, 0))
    return problem, plan(replace(problem, map=shut, start=(2, 2, 0)), effort=10_000)


def test_what_opened_is_used_where_nothing_but_a_path_is_known(hall):
    problem, around = hall
    best = plan(problem, effort=10_000)
    rest = remainder(around.path, problem.start, problem)
    assert problem.cost.energy(rest) > 1.3 * best.energy
    for former in (around.path, loads(dumps(around)), around):
        found = replan(problem, former, start=problem.start, effort=10_000)
        assert found.energy == pytest.approx(best.energy, rel=1e-3)
        assert found.energy < 3170


@pytest.mark.parametrize(
    "change",
    [{"cost": EnergyCost(PowerModel.preset("quadriga:empty:marble"))},
     {"cost": EnergyCost(PowerModel.preset("quadriga:full:concrete"), speed=0.2)},
     {"objective": "length"}, {"objective": "time"}, {"clearance": 0.2}, {"turning": 1.0},
     {"costmap": CostMap(np.full((100, 200), 0.5), 0.1), "costmap_weight": 50.0},
     {"vehicle": box_robot(0.6, 0.4)}],
    ids=lambda change: "+".join(change),
)  # fmt: skip
def test_a_plan_for_another_question_is_a_first_path_alone(hall, change):
    problem, _ = hall
    former = plan(problem, effort=2000)
    now = replace(problem, **change)
    here = former.path.poses()[20]
    found = replan(now, former, start=here, effort=2000)
    best = plan(replace(now, start=here), effort=4000)
    assert found.effort > 0
    assert found.lower_bound <= best.cost * ROUNDED
    rest = remainder(former.path, here, now)
    if rest is not None:
        assert found.cost_steady <= compiled(replace(now, start=here)).value(rest) * (1 + 1e-9)
    # the same question in other objects is the same one
    again = replan(replace(problem, cost=replace(problem.cost)), former, start=here, effort=1)
    assert again.effort == 0


def test_no_bound_is_handed_on_from_where_the_former_plan_could_not_be(door):
    """Beside its path a robot may be nearer to a wall than the former plan was allowed to be."""
    problem, _ = door
    shut = problem.map.updated(np.ones((40, 4), bool), 20, 100)
    problem = replace(problem, map=shut, clearance=0.2)
    former = plan(problem, effort=4000)
    here = former.path.poses()[5]
    clear = replan(problem, former, start=here, effort=2000)
    assert clear.lower_bound > 1.05 * compiled(clear.problem).least_in_free_space
    beside = former.path.poses(0.02, 0.02) - np.array([0.0, 0.1, 0.0])
    near = beside[np.argmin(problem.map.footprint_free(beside, problem.robot))]
    assert problem.map.footprint_free(near, problem.cost.vehicle)
    found = replan(problem, former, start=near, effort=2000)
    free = compiled(found.problem.without_clearance).least_in_free_space
    assert found.lower_bound_steady == free
