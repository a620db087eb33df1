"""Goals as people have them: a place, a pose either way round, a circle, one of several."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import shapely
from by_day import by_day
from worlds import cluttered, free_poses, room

import energyplan as ep
from energyplan.errors import GoalInCollisionError, InvalidInputError, PlanningError
from energyplan.planning.goal import as_goals
from energyplan.planning.replanning import replan
from energyplan.power import Sides, Term
from energyplan.terrain import Surface, SurfaceMap

MODEL = ep.PowerModel.preset("quadriga:empty:concrete")


def hall(walls: bool = False) -> ep.OccupancyGrid:
    """Return a hall of 12 x 8 m, with two walls that leave gaps at their ends."""
    cells = np.zeros((80, 120), bool)
    if walls:
        cells[:55, 40:43] = True
        cells[25:, 78:81] = True
    return ep.OccupancyGrid(cells, resolution=0.1)


def problem(goal: object, walls: bool = False, **more: object) -> ep.PlanningProblem:
    return ep.PlanningProblem(hall(walls), ep.EnergyCost(MODEL), (1.5, 2.0, 0.4), goal, **more)


@pytest.mark.parametrize(("walls", "place"), [(False, (6, 6)), (True, (6, 3)), (True, (10.5, 5))])
def test_a_place_costs_no_more_than_at_the_best_of_many_headings(walls, place):
    """Planning to a place finds its best heading, and its bound holds for every heading."""
    free = ep.plan(problem(place, walls), effort=10_000)
    given = [
        ep.plan(problem((*place, yaw), walls), effort=10_000).cost
        for yaw in np.arange(16) * 2 * np.pi / 16
    ]
    assert free.cost <= 1.005 * min(given)
    assert free.lower_bound <= min(given)
    assert free.lower_bound <= free.cost
    assert np.hypot(*np.subtract(free.path.end[:2], place)) < 1e-6
    assert free.problem.goal == free.path.end


def test_a_place_in_the_open_is_reached_by_the_exact_optimum_over_headings():
    """Without obstacles the gap to the bound over all headings is closed."""
    from energyplan import steering

    found = ep.plan(problem((6.0, 6.0)), effort=5000)
    cost, start = ep.EnergyCost(MODEL), (1.5, 2.0, 0.4)
    ends = [(6.0, 6.0, yaw) for yaw in np.linspace(0, 2 * np.pi, 3600, endpoint=False)]
    least = steering.energy(start, ends, cost).min()
    assert found.cost_steady == pytest.approx(least, rel=1e-4)
    assert found.lower_bound_steady <= least
    assert found.lower_bound_steady == pytest.approx(least, rel=1e-3)


def test_either_way_round_is_the_better_of_two_poses():
    """A pose either way round costs what the better of the two does."""
    either = ep.plan(problem(ep.Goal(6, 3, 1.0, heading="either"), True), effort=20_000)
    both = [ep.plan(problem((6, 3, yaw), True), effort=20_000) for yaw in (1.0, 1.0 + np.pi)]
    assert either.cost <= 1.005 * min(one.cost for one in both)
    assert either.lower_bound <= min(one.cost for one in both)
    assert np.cos(either.goal_reached.yaw - 1.0) ** 2 == pytest.approx(1.0)


def test_a_circle_is_reached_at_its_edge():
    """A radius takes less than the place itself, and the path ends within it."""
    place, circle = ep.Goal(6, 6), ep.Goal(6, 6, radius=1.0)
    to_place, to_circle = (ep.plan(problem(goal), effort=5000) for goal in (place, circle))
    assert circle.reached_by(to_circle.path.end)
    assert not place.reached_by(to_circle.path.end)
    saved = to_place.cost - to_circle.cost
    assert saved == pytest.approx(MODEL_METRE, rel=0.1)
    assert to_circle.lower_bound <= to_circle.cost
    exact = ep.Goal(6, 6, 1.2, radius=0.5)
    given = ep.plan(problem(exact), effort=5000)
    assert exact.reached_by(given.path.end)
    assert given.lower_bound <= given.cost < ep.plan(problem((6, 6, 1.2)), effort=5000).cost


MODEL_METRE = float(ep.EnergyCost(MODEL).segment_energy(1.0, 0.0))


def test_the_nearest_of_several_is_that_of_least_energy():
    """Of two docks the one that takes less is reached, though it lies farther away."""
    near, far = (1.5, 4.0, 0.4 + np.pi / 2), (4.5, 3.3, 0.4)
    alone = [ep.plan(problem(goal), effort=5000) for goal in (near, far)]
    assert alone[0].length < alone[1].length
    assert alone[0].cost > alone[1].cost
    found = ep.plan(problem([near, far]), effort=10_000)
    assert found.cost == pytest.approx(alone[1].cost, rel=2e-3)
    assert found.goal_reached == pytest.approx(far, abs=1e-6)
    assert found.lower_bound <= min(one.cost for one in alone) * (1 + 1e-9)


def test_one_of_several_that_cannot_be_reached_is_left_out():
    """A dock behind walls, or inside one, is no hindrance as long as another one is free."""
    inside = (4.15, 2.0, 0.0)
    found = ep.plan(problem([inside, (6, 3)], True), effort=10_000)
    assert found.goal_reached[:2] == pytest.approx((6, 3), abs=1e-6)
    (note,) = (note for note in found.notes if "left out" in note)
    assert "at every pose of the goal (4.15, 2, 0.0 deg); the nearest free pose" in note
    outside = ep.plan(problem([(99, 2, 0.0), (6, 3)], True), effort=2000)
    assert "left out: the goal (99, 2, 0.0 deg) lies outside the map" in outside.notes[0]
    with pytest.raises(GoalInCollisionError, match="at every pose of the goal"):
        ep.plan(problem([(4.15, 2.0), (4.15, 1.0, 0.0)], True), effort=10_000)


@pytest.mark.parametrize("reverse", [True, False])
@pytest.mark.parametrize(("heading", "part"), [("any", 0.97), ("given", 0.6), ("either", 0.6)])
def test_bounds_over_a_disc_hold_for_its_poses(reverse, heading, part):
    """The bound to a circle is below the exact energy to any of its poses."""
    from energyplan import steering
    from energyplan.planning.bound.goals import least_to_goal

    rng, ratios = np.random.default_rng(3), []
    model = replace(MODEL, vehicle=replace(MODEL.vehicle, reverse=reverse))
    cost = ep.EnergyCost(model)
    for _ in range(12):
        x, y = rng.uniform((2, 2), (10, 6))
        start = (*rng.uniform((2, 2), (10, 6)), rng.uniform(-3, 3))
        wanted = None if heading == "any" else rng.uniform(-3, 3)
        goal = ep.Goal(x, y, wanted, heading, radius=rng.uniform(0.1, 1.5))
        asked = ep.PlanningProblem(hall(), cost, start, (x, y, wanted or 0.0))
        bound = least_to_goal(asked, goal).value
        r, a, yaw = rng.uniform((0, 0, 0), (1, 2 * np.pi, 2 * np.pi), (3000, 3)).T
        yaw = rng.choice(goal.headings, len(r)) if goal.headings else yaw
        r = goal.radius * np.where(rng.random(3000) < 0.5, 1.0, np.sqrt(r))
        ends = np.column_stack([x + r * np.cos(a), y + r * np.sin(a), yaw])
        least = steering.energy(start, ends, cost, reverse=reverse).min()
        assert bound <= least
        ratios.append(bound / least if least > 0 else 1.0)
    assert np.mean(ratios) > part


def test_the_bound_to_a_circle_behind_a_wall_knows_the_way_round_it():
    grid = room(120, 160, 0.1, np.s_[30:120, 70:76])
    for goal, gap in (ep.Goal(12, 9, radius=1.0), 0.04), (ep.Goal(12, 9, 1.0, radius=1.0), 0.12):
        problem = ep.PlanningProblem(grid, ep.EnergyCost(MODEL), (3, 9, 0.0), goal)
        assert 0.0 <= ep.plan(problem, effort=8000).gap < gap


def point_robot(metre, radian):
    """Return a robot for which the bound's simpler robot is nearly the robot itself."""
    cost = ep.EnergyCost.from_coefficients(metre, radian, 0.01)
    footprint = np.array([[-0.05, -0.05], [0.05, 0.05]])
    vehicle = replace(cost.vehicle, footprint=footprint)
    return ep.EnergyCost(replace(cost.model, vehicle=vehicle))


KINDS = "plain", "point", "surfaces", "rows", "forward", "offset"


def circle_problem(kind, seed):
    """Return a problem among boxes whose goal is a circle of some kind."""
    rng = np.random.default_rng(seed)
    cost, surfaces = ep.EnergyCost(MODEL), None
    if kind == "point":
        cost = point_robot(rng.uniform(50, 300), rng.uniform(10, 200))
    elif kind == "surfaces":
        marble = ep.PowerModel.preset("quadriga:empty:marble")
        boxes = [shapely.box(x, y, x + 3, y + 3) for x, y in rng.uniform((0, 0), (7, 5), (4, 2))]
        surfaces = SurfaceMap(tuple(Surface(box, marble) for box in boxes))
    elif kind == "rows":
        cost = ep.EnergyCost(crop_rows(200.0))
    elif kind == "forward":
        cost = ep.EnergyCost(replace(MODEL, vehicle=replace(MODEL.vehicle, reverse=False)))
    elif kind == "offset":
        contacts = MODEL.vehicle.contacts + np.array([0.1, 0.0])
        cost = ep.EnergyCost(replace(MODEL, vehicle=replace(MODEL.vehicle, contacts=contacts)))
    grid = cluttered(seed)
    start, (x, y, yaw) = free_poses(grid, 2, 31 + seed, cost.vehicle)
    wanted, heading = ((None, "any"), (yaw, "given"), (yaw, "either"))[int(rng.integers(3))]
    goal = ep.Goal(x, y, wanted, heading, radius=rng.uniform(0.1, 1.5))
    return ep.PlanningProblem(grid, cost, start, goal, surfaces)


def crop_rows(size):
    """Return a model with a force on both sides that is largest across the rows [N]."""

    def both(motion, vehicle):
        share = np.abs(np.sin(motion.channels["yaw"]))
        return Sides(share * np.sign(motion.v_left), share * np.sign(motion.v_right))

    return MODEL.with_term(Term("crop_rows", "c", "N", "force", both, channels=("yaw",)), size)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", by_day(range(6), [1]))
def test_no_plan_to_a_circle_among_obstacles_beats_its_bound(kind, seed):
    """Neither the plan to it nor one to any of a few poses of it, the cheapest first."""
    from energyplan import steering
    from energyplan.planning.bound.goals import least_to_goal

    problem = circle_problem(kind, seed)
    goal, cost = problem.goals[0], problem.cost
    try:
        found = ep.plan(problem, effort=6000)
    except PlanningError:
        return
    assert found.lower_bound_steady <= found.cost_steady * (1 + 1e-9)
    poses = goal.samples(16, 12)
    poses = poses[problem.terrain.obstacles.footprint_free(poses, cost.vehicle)]
    order = np.argsort(steering.energy(problem.start, poses, cost))
    costs = [found.cost_steady]
    for pose in poses[order[:4]].tolist():
        with suppress(PlanningError):
            costs.append(ep.plan(replace(problem, goal=pose, goals=()), effort=1000).cost_steady)
    # what is known of paths, and how much effort there is, makes the bound no higher than the truth
    for most, effort in ((1.0, 5e7), (2.0, 5e7), (2.0, 5e5)):
        bound = least_to_goal(found.problem, goal, most * found.cost_steady, effort).value
        assert bound <= min(costs) * (1 + 1e-9)


def test_bounds_to_circles_among_obstacles_are_close():
    """Half of the gaps are below 3 %; a turn to a given heading near the start leaves more."""
    gaps = []
    for seed in range(10):
        with suppress(PlanningError):
            gaps.append(ep.plan(circle_problem("plain", seed), effort=6000).gap)
    assert len(gaps) > 8
    assert min(gaps) >= -1e-9
    assert np.median(gaps) < 0.03
    assert np.sum(np.array(gaps) > 0.1) <= 2


@pytest.mark.parametrize("heading", ["any", "given"])
def test_what_expensive_ground_within_a_circle_adds_is_in_no_bound(heading):
    """A circle all on expensive ground is reached at its edge: nothing of it is driven through."""
    grid = room(80, 160, 0.1)
    dear = ep.EnergyCost.from_coefficients(2000.0, 150.0, 0.3)
    cheap = ep.EnergyCost.from_coefficients(100.0, 150.0, 0.3)
    area = Surface(shapely.box(6, 0, 16, 8), dear.model)
    yaw = 0.0 if heading == "given" else None
    goal = ep.Goal(9.0, 4.0, yaw, radius=2.9)
    ends = (2.0, 4.0, 0.0), goal
    found = ep.plan(ep.PlanningProblem(grid, cheap, *ends, SurfaceMap((area,))), effort=5000)
    least = 100.0 * 4.0 + 2000.0 * 0.1
    assert found.cost_steady == pytest.approx(least, rel=0.05)
    assert 100.0 * 4.1 * (1 - 1e-5) <= found.lower_bound_steady <= least * (1 + 1e-9)


def test_a_circle_about_the_start_or_just_ahead_takes_no_detour():
    """A turn where the robot stands, or a few centimetres straight ahead."""
    cost, start = ep.EnergyCost(MODEL), (4.0, 4.0, 0.3)
    turn = ep.plan(ep.PlanningProblem(hall(), cost, start, ep.Goal(4.5, 4, 1.5, radius=0.8)))
    assert turn.cost_steady == pytest.approx(float(cost.segment_energy(0.0, 1.2)), rel=1e-6)
    assert turn.gap == pytest.approx(0.0, abs=1e-6)
    aside = ep.Goal(4.0 + np.cos(1.2), 4.0 + np.sin(1.2), radius=0.98)
    ahead = ep.plan(ep.PlanningProblem(hall(), cost, start, aside))
    assert ahead.length < 0.04
    assert ahead.cost_steady < 0.04 * MODEL_METRE


def test_goals_are_read_in_one_way():
    """Texts, numbers, mappings and records stand for the same goals."""
    assert as_goals("6,3") == as_goals((6, 3)) == as_goals({"x": 6, "y": 3}) == (ep.Goal(6, 3),)
    assert as_goals("6,3,90deg") == as_goals([6, 3, "90deg"]) == (ep.Goal(6, 3, np.pi / 2),)
    assert as_goals(["6,3", (1, 2, 0.5)]) == (ep.Goal(6, 3), ep.Goal(1, 2, 0.5))
    assert as_goals("6,3,1", "either", 0.2) == (ep.Goal(6, 3, 1.0, "either", 0.2),)
    assert as_goals("6,3,1", "any") == (ep.Goal(6, 3),)
    assert problem((6, 3, 1.0)).goals == ()


@pytest.mark.parametrize(
    ("goal", "match"),
    [
        ("6", "neither X,Y,YAW nor X,Y"),
        ((6, np.nan), "finite"),
        (ep.Goal, "goal is"),
        ({"x": 6}, "x, y, yaw, heading and radius"),
        ([], "goal is"),
        ([(6, 3), []], "goal is"),
    ],
)
def test_what_is_no_goal_is_refused(goal, match):
    """What stands for no goal is refused by name."""
    with pytest.raises(InvalidInputError, match=match):
        problem(goal)


def test_goals_that_contradict_themselves_are_refused():
    """Headings that are wanted but not given, and negative radii, are refused."""
    with pytest.raises(InvalidInputError, match="no yaw is given"):
        ep.Goal(1, 2, heading="either")
    with pytest.raises(InvalidInputError, match="one of given, either, any"):
        ep.Goal(1, 2, 0.0, heading="both")
    with pytest.raises(InvalidInputError, match="radius"):
        ep.Goal(1, 2, radius=-1.0)
    asked = problem((6, 3))
    with pytest.raises(InvalidInputError, match="none of those in goals"):
        replace(asked, goal=ep.Pose(7, 3, 0.0))


def test_comparing_routes_to_a_place():
    """The shortest route leads to the place too, and takes no less energy."""
    found = ep.compare(problem((6, 3), True), effort=20_000)
    for plan in (found.energy_optimal, found.shortest):
        assert plan.goal_reached[:2] == pytest.approx((6, 3), abs=1e-6)
    assert found.saving >= 0.0
    assert found.shortest.length <= found.energy_optimal.length + 1e-9


def test_replanning_to_a_place():
    """The rest of a plan to a place is kept, and another heading reached where it is closed."""
    asked = problem((10, 4))
    former = ep.plan(asked, effort=5000)
    half = former.path.subdivide(0.1, 0.1).vertices[20]
    on = replan(asked, former, start=half, effort=5000)
    assert on.cost_steady < former.cost_steady
    assert on.lower_bound <= on.cost
    closed = asked.map.updated(np.ones((20, 10), bool), row=25, column=70)
    around = replan(asked, former, start=half, map=closed, effort=10_000)
    assert around.cost > on.cost
    assert around.goal_reached[:2] == pytest.approx((10, 4), abs=1e-6)
    assert asked.map.updated(np.ones((1, 1), bool), row=0, column=0) is not asked.map


@pytest.mark.parametrize("planner", ["rrtstar"])
def test_other_planners_reach_places_too(planner):
    """A planner that knows single poses alone is used for a place."""
    found = ep.plan(problem((6, 3)), planner, effort=4000)
    assert found.goal_reached[:2] == pytest.approx((6, 3), abs=1e-6)
    assert found.lower_bound <= found.cost


def test_a_request_names_goals_as_python_does():
    """The service reads places, objects and lists, and refuses what stands for no goal."""
    pytest.importorskip("fastapi")
    from energyplan.serve.requests import PlanRequest

    def asked(goal: object) -> object:
        return PlanRequest(map="a.yaml", model="m", start=[0.0, 0.0, 0.0], goal=goal).goal

    assert asked([6, 3]) == (ep.Goal(6, 3),)
    either = {"x": 6, "y": 3, "yaw": 1.0, "heading": "either"}
    assert asked([[6, 3], either]) == (ep.Goal(6, 3), ep.Goal(6, 3, 1.0, "either"))
    for wrong in ([6], "x", {"x": 6}, [[6, 3]] * 21):
        with pytest.raises(ValueError, match="goal"):
            asked(wrong)
