"""Ways whose turns are counted, against those that are merely short."""

from dataclasses import replace

import numpy as np
import pytest
from ompl import base
from worlds import COST, box_robot, room

from energyplan import (
    Candidate,
    EnergyCost,
    Path,
    Planner,
    PlanningProblem,
    PowerModel,
    TreadICR,
    plan,
)
from energyplan.errors import InvalidPathError, UnsupportedPlannerError
from energyplan.planning.budget import Budget
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.search.routes import cheapest_routes
from energyplan.planning.search.tracking import track_route
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.cost_to_go import cost_to_go


def slalom(radian: float = 2.0) -> PlanningProblem:
    """Return a problem with a short way through a slalom and a straight one beside it.

    A radian costs as much as so many metres.
    """
    poles = [
        (slice(0, 62) if k % 2 else slice(50, 112), slice(55 + 40 * k, 59 + 40 * k))
        for k in range(6)
    ]
    grid = room(180, 320, 0.05, np.s_[112:116, 30:290], *poles)
    cost = EnergyCost.from_coefficients(200.0, 200.0 * radian, COST.icr)
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
    to_go = cost_to_go(setting)
    short = track_route(setting, to_go, Budget()).motions
    found = cheapest_routes(setting, to_go, Budget(effort=6000))
    best = min(refined(problem, way) for way in found)
    assert best < 0.9 * refined(problem, short)
    # and planning finds it with little effort
    assert plan(problem, effort=10_000).energy < best


def test_a_way_that_was_passed_is_left_for_another_one():
    setting = CompiledProblem(slalom()).setting
    to_go = cost_to_go(setting)
    ways = cheapest_routes(setting, to_go, Budget(effort=200_000))
    lengths = [np.abs(way.ds).sum() for way in ways]
    assert len(ways) > 1 and lengths[0] != pytest.approx(lengths[1], rel=0.02)


# -- a least turning radius --


def tightest(problem, path) -> float:
    """Return the least radius of the arcs of a path, of the point between the tread ICRs."""
    turns = path.dtheta != 0.0
    ahead = path.ds - problem.cost.icr.centre[1] * path.dtheta
    return float(np.min(np.abs(ahead[turns] / path.dtheta[turns]), initial=np.inf))


@pytest.mark.parametrize("seed", range(4))
def test_on_free_ground_the_least_length_is_that_of_reeds_and_shepp(seed):
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.4, 2.0)
    cost = EnergyCost.from_coefficients(1.0, 1e-6, 0.4)  # a metre is all that counts
    start, goal = (np.array([10.0, 10.0, 0.0]) + rng.uniform(-3, 3, 3) for _ in range(2))
    problem = PlanningProblem(room(100, 100, 0.2), cost, start, goal, turning=radius)
    found = plan(problem, effort=2000, gap=1e-6)
    space = base.ReedsSheppStateSpace(radius)
    states = [space.allocState(), space.allocState()]
    for state, pose in zip(states, (start, goal), strict=True):
        state.setX(pose[0])
        state.setY(pose[1])
        state.setYaw(pose[2])
    least = space.distance(*states)
    assert found.length == pytest.approx(least, rel=1e-4)
    assert found.lower_bound == pytest.approx(least, rel=1e-4)
    assert tightest(problem, found.path) >= radius * (1 - 1e-6)


@pytest.mark.parametrize(
    ("turning", "icr"),
    [("forward", TreadICR(0.5, 0.3, 0.1)), (0.8, TreadICR(0.4, 0.4, 0.0)),
     (2.0, TreadICR(0.5, 0.3, 0.1))],
)  # fmt: skip
def test_among_obstacles_no_point_of_the_path_is_tighter(turning, icr):
    walls = room(120, 160, 0.05, np.s_[:70, 60:66], np.s_[50:, 110:116])
    cost = EnergyCost.from_coefficients(150.0, 60.0, icr)
    free = PlanningProblem(walls, cost, (1.5, 1.5, 0.0), (7.0, 4.5, 3.0))
    problem = replace(free, turning=turning)
    radius = 0.5 * (icr.left + icr.right) if turning == "forward" else turning
    found, loose = plan(problem, effort=5000), plan(free, effort=5000)
    assert tightest(problem, found.path) >= radius * (1 - 1e-6)
    assert tightest(problem, loose.path) < radius
    assert found.lower_bound >= loose.lower_bound * (1 - 1e-6)
    assert found.energy >= loose.lower_bound
    shortest = plan(replace(problem, objective="length"), effort=5000)
    assert tightest(problem, shortest.path) >= radius * (1 - 1e-6)


def test_what_cannot_keep_a_radius_is_refused():
    cost = EnergyCost.from_coefficients(150.0, 60.0, 0.4)
    problem = PlanningProblem(room(100, 100, 0.1), cost, (2, 5, 0), (2, 5, 2), turning=1.0)
    spin = Path(problem.start, [0.0], [2.0])
    with pytest.raises(UnsupportedPlannerError, match="least turning radius"):
        plan(problem, Planner(lambda problem, budget: Candidate(spin)))
    spinning = Planner(lambda problem, budget: Candidate(spin), turning=True, effort=True)
    with pytest.raises(InvalidPathError, match="less than 1 m"):
        plan(problem, spinning, effort=1000)


def test_in_a_box_a_robot_turns_to_and_fro_on_its_arcs():
    box = room(60, 60, 0.05, np.s_[:20], np.s_[44:], np.s_[:, :20], np.s_[:, 44:])
    cost, robot = EnergyCost.from_coefficients(150.0, 60.0, 0.4), box_robot(0.8, 0.6)
    problem = PlanningProblem(box, cost, (1.6, 1.6, 0.0), (1.6, 1.6, np.pi), vehicle=robot)
    free = plan(problem, effort=1000)
    found = plan(replace(problem, turning=5.0), effort=3000)
    assert tightest(problem, found.path) >= 5.0 * (1 - 1e-6)
    assert found.energy > 2.0 * free.energy


@pytest.mark.parametrize("radius", [4.6, 4.8, 10.0, 100.0])
@pytest.mark.parametrize(("aside", "objective"), [(4, "energy"), (1, "energy"), (0, "energy"),
                                                  (1, "length"), (1, "time")])  # fmt: skip
def test_a_wide_radius_keeps_its_bound_and_its_path_on_empty_ground(radius, aside, objective):
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    hall = PlanningProblem(
        room(400, 400, 0.1),
        cost,
        (2, 2, 0),
        (35, 2 + aside, 0),
        turning=radius,
        objective=objective,
    )
    found = plan(hall, effort=3000)
    assert tightest(hall, found.path) >= radius * (1 - 1e-6)
    assert 0 <= found.cost_steady / found.lower_bound_steady - 1 + 1e-9 < 2e-3
    # where stops take time their price is in no bound, which closes no gap then
    assert objective == "time" or found.effort < 3000


def test_on_a_large_empty_map_a_wide_radius_costs_hardly_more_than_none():
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    field = PlanningProblem(room(2000, 2000, 0.1), cost, (20, 20, 0), (150, 60, 0))
    free, found = plan(field), plan(replace(field, turning=5.0))
    assert free.energy <= found.energy < 1.001 * free.energy
    assert found.gap < 1e-3
