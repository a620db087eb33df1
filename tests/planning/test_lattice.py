from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from worlds import COST, MODEL, cluttered, free_poses, room

from energyplan import EnergyCost, PlanningProblem, Pose, TreadICR, plan, read_map, steering
from energyplan.path import point_ahead
from energyplan.planning import Budget
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space import motions as motion_kernels
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.cost_to_go import cost_to_go
from energyplan.power import HOTEL

# -- kernels -------------------------------------------------------------------------------------


def test_curved_prices_are_tabulated_closely_and_never_below():
    cost = EnergyCost(MODEL.with_term(HOTEL, 80.0))
    query = CompiledProblem(PlanningProblem(room(100, 100, 0.1), cost, (2, 5, 0), (8, 5, 0)))
    rng = np.random.default_rng(0)
    for ds, dtheta in rng.normal(size=(200, 2)):
        kernel = motion_kernels.price(query.prices, 0, cost.half_track, ds, dtheta)
        assert kernel == pytest.approx(float(cost.segment_energy(ds, dtheta)), rel=2e-3)
        static = query.steering
        turn = abs(dtheta)
        bound = static.metre * max(abs(ds), static.track * turn) + static.radian * turn
        assert bound <= kernel * (1 + 1e-9)


def test_how_two_poses_are_joined_does_not_depend_on_the_limit():
    """Where steering is not exact, as for time, what a limit lets pass is found without it too."""
    query = CompiledProblem(PlanningProblem(room(100, 100, 0.1), COST, (2, 5, 0), (8, 5, 0)))
    timed = CompiledProblem(replace(query.problem, objective="time"))
    rng = np.random.default_rng(2)
    joined = 0
    for size in rng.uniform(0.05, 2.0, 60):
        a = Pose(5.0, 5.0, 0.0)
        b = Pose(*(np.array(a) + size * rng.normal(size=3)).tolist())
        for setting in (query.setting, timed.setting):
            cost, count = motion_kernels.join(setting, a, b, np.inf, *np.empty((2, 16)))
            for limit in cost * np.array([0.9, 0.99, 0.999999, 1.1]) if np.isfinite(cost) else ():
                again = motion_kernels.join(setting, a, b, limit, *np.empty((2, 16)))
                assert again == ((cost, count) if limit > cost else (np.inf, again[1]))
                joined += 1
    assert joined > 40


# -- search and refinement ------------------------------------------------------------------------


@pytest.mark.parametrize("icr", [TreadICR.symmetric(0.47), TreadICR(0.40, 0.54, 0.05)])
def test_free_space_plan_is_the_exact_steering_motion(icr):
    rng = np.random.default_rng(3)
    cost = EnergyCost(replace(MODEL, vehicle=MODEL.vehicle.with_icr(icr)))
    for _ in range(5):
        start, goal = rng.uniform((2, 2, -np.pi), (8, 8, np.pi), (2, 3))
        found = plan(PlanningProblem(room(100, 100, 0.1), cost, start, goal), effort=15_000)
        exact = float(steering.energy(start, goal, cost))
        assert found.energy == pytest.approx(exact, rel=1e-9)
        assert found.lower_bound == pytest.approx(exact, rel=1e-9)
        assert found.gap <= 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_refinement_only_ever_improves(seed):
    grid = cluttered(seed)
    start, goal = free_poses(grid, 4, seed + 20, COST.vehicle)[:2]
    query = CompiledProblem(PlanningProblem(grid, COST, start, goal))
    search = Search(query.setting, cost_to_go(query.setting), lattice_for(query.setting), 2.0)
    search.run(Budget(), 200_000)
    assert search.found
    refiner = Refiner(query.setting, search.segments(), seed)
    costs = [refiner.cost]
    refiner.shortcut(Budget())
    costs.append(refiner.cost)
    for _ in range(3):
        refiner.polish(Budget(), most=800)
        costs.append(refiner.cost)
        refiner.again(Budget())
        costs.append(refiner.cost)
    assert np.all(np.diff(costs) <= 1e-6 * costs[0])
    path = query.path(refiner.segments)
    assert grid.path_free(path, COST.vehicle)
    assert COST.energy(path) == pytest.approx(refiner.cost, rel=1e-7)
    assert np.hypot(path.end.x - goal[0], path.end.y - goal[1]) < 1e-6


@pytest.mark.shared
def test_depot_reference_query(shared_data):
    grid = read_map(shared_data / "maps" / "depot.yaml")
    problem = PlanningProblem(grid, COST, (2, 2, 0), (28, 13, np.pi / 2))
    found = plan(problem, effort=250_000, gap=0.007)
    # RRT* with a disc of 0.4 m is known to reach 6868 J in 30 s
    assert found.energy < 6750


@pytest.mark.parametrize("spare", by_day([0.0003, 0.001], [0.0003]))
def test_ends_that_almost_touch_are_left_with_room(spare):
    # start and goal alongside shelves, with less room than planning keeps elsewhere
    shelves = np.s_[:20, 30:50], np.s_[:20, 150:170], np.s_[20:40, 90:110]
    grid = room(120, 200, 0.05, *shelves)
    y = 1.0 + 0.32 + spare
    for yaw in (0.0, np.pi):
        problem = PlanningProblem(grid, COST, (2.0, y, 0.0), (8.0, y, yaw))
        assert not CompiledProblem(problem).has_margin(problem.start)
        found = plan(problem, effort=10_000)
        # little is lost by it
        above = replace(problem, start=(2.0, y + 0.01, 0.0), goal=(8.0, y + 0.01, yaw))
        spacious = plan(above, effort=12_000).energy
        assert found.energy < 1.1 * spacious
        # a path that is known and cheaper is kept
        again = plan(problem, effort=2_500, initial=[found.path])
        assert again.energy <= found.energy * (1 + 1e-12)


@pytest.mark.parametrize("turn", [np.pi, 3.0, -2.0])
@pytest.mark.parametrize("icr", [TreadICR(0.5, 0.5, 0.0), TreadICR(0.6, 0.4, 0.1)])
def test_a_turn_in_place_is_one_spin_and_not_pivots_of_the_same_energy(turn, icr):
    cost = EnergyCost(replace(MODEL, vehicle=MODEL.vehicle.with_icr(icr)))
    # about the centre of the tread ICRs
    ahead, lateral = icr.centre
    start = np.array([5.0, 5.0, 0.4])
    goal = start + np.array([0.0, 0.0, turn])
    for pose in (start, goal):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose[:2] -= [c * ahead - s * lateral, s * ahead + c * lateral]
    found = plan(PlanningProblem(room(100, 100, 0.1), cost, start, goal), effort=2000)
    assert found.path.turning == pytest.approx(abs(turn))
    assert len(found.path) == 1
    assert found.gap == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("treads", [(0.47, 0.47, 0.0), (0.62, 0.32, 0.0), (0.34, 0.6, -0.05)])
def test_the_shortest_route_turns_where_turning_has_no_length(treads):
    """Wherever the tread ICRs lie: about the reference point, whose metres count."""
    model = replace(MODEL, vehicle=MODEL.vehicle.with_icr(TreadICR(*treads)))
    cost = EnergyCost(model)
    start, goal = (2.0, 5.0, 1.2), (9.0, 5.0, -1.9)
    problem = PlanningProblem(room(100, 120, 0.1), cost, start, goal, objective="length")
    points = [point_ahead(Pose(*end), treads[2]) for end in (start, goal)]
    apart = np.hypot(*np.subtract(*points))
    found = plan(problem, effort=2000)
    assert apart * (1 - 1e-9) <= found.length <= 1.002 * apart  # it also prefers little energy
    assert found.gap < 0.01
    # about a box, and seen from one place among many
    about = replace(problem, map=room(100, 120, 0.1, np.s_[30:62, 50:58]))
    assert plan(about, effort=4000).gap < 0.04
