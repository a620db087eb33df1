"""Planning on slopes: against closed forms, the models themselves, and an exhaustive search."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import networkx as nx
import numpy as np
import pytest
import shapely
from by_day import by_day
from worlds import MODEL as LEVEL
from worlds import room

import energyplan as ep
from energyplan.errors import InvalidInputError, MapError, ModelError
from energyplan.mission.routes import Legs
from energyplan.path import point_ahead
from energyplan.planning.space import motions as kernels
from energyplan.planning.space import prices as _prices
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power.effects import GRADE, VISCOUS_LOSS, reads_slope, term, with_weight
from energyplan.terrain import Surface, path_price, with_weights
from energyplan.vehicle import GRAVITY

MODEL = with_weight(LEVEL)
WEIGHT = MODEL.vehicle.mass * GRAVITY
HALL = room(120, 160, 0.1)


def at_battery(model=MODEL, drive=0.8, back=0.0):
    """Cost at the battery, of drives that lose on the way out, and of what comes back."""
    vehicle = replace(model.vehicle, drive_efficiency=drive, regen_efficiency=back)
    return ep.EnergyCost(replace(model, vehicle=vehicle), battery=True)


def plane(x, y, resolution=1.0):
    i, j = np.indices((13, 17)) * resolution
    return ep.HeightMap(x * j + y * i, resolution)


def hills(seed, height=0.4, resolution=0.5):
    """Smooth random hills over the hall, a few metres wide."""
    rng = np.random.default_rng(seed)
    i, j = np.indices((30, 36)) * resolution
    total = np.zeros(i.shape)
    tops = rng.uniform(0, 17, 14), rng.uniform(0, 14, 14), rng.normal(size=14)
    for x, y, h in zip(*tops, strict=True):
        total += height * h * np.exp(-((j - x) ** 2 + (i - y) ** 2) / 4.0)
    return ep.HeightMap(total, resolution)


def ridge(height):
    """A ridge across the hall at x = 8, which ends at about y = 8."""
    i, j = np.indices((49, 65)) * 0.25
    return ep.HeightMap(
        height * np.exp(-(((j - 8) / 1.5) ** 2)) / (1 + np.exp((i - 8) / 0.5)), 0.25
    )


def turn_drive(*points):
    """The path from the first pose by way of points to the last pose, turning on the spot."""
    x, y, yaw = points[0]
    ds, dtheta = [], []
    for px, py, *rest in points[1:]:
        way = np.arctan2(py - y, px - x)
        ds += [0.0, np.hypot(px - x, py - y)]
        dtheta += [way - yaw, 0.0]
        x, y, yaw = px, py, way
        if rest:
            ds, dtheta = [*ds, 0.0], [*dtheta, rest[0] - yaw]
    return ep.Path(ep.Pose(*points[0]), ds, dtheta)


# -- closed forms ----------------------------------------------------------------------------------


def test_without_losses_a_tilted_plane_adds_the_weight_times_the_rise():
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(MODEL), (2, 3, 0), (13, 9, 1.5))
    tilted = replace(problem, heights=plane(0.03, -0.02))
    level, found = ep.plan(problem, effort=6_000), ep.plan(tilted, seed=1, effort=6_000)
    rise = 0.03 * 11 - 0.02 * 6
    assert found.potential == pytest.approx(WEIGHT * rise, rel=1e-9)
    # lengths on the slope exceed those in plan view by half the square of the slope
    assert found.energy == pytest.approx(level.energy + WEIGHT * rise, rel=3e-4)
    assert found.energy == pytest.approx(tilted.terrain.price(found.path, tilted.cost).energy)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy)
    assert found.length == pytest.approx(level.length, rel=1e-3)
    assert found.turning == pytest.approx(level.turning, rel=1e-2)
    assert found.gap < 1e-3


def test_nothing_comes_back_and_a_gentle_descent_still_saves():
    """Where the weight stays below the resistance, no power is lost on the way down."""
    cost = at_battery()
    problem = ep.PlanningProblem(HALL, cost, (14, 6, np.pi), (2, 6, np.pi), heights=plane(0.1, 0.0))
    found = ep.plan(problem, effort=6_000)
    expected = (226 * np.hypot(1, 0.1) - WEIGHT * 0.1) * 12 / 0.8
    assert found.energy == pytest.approx(expected, rel=1e-6)
    assert found.potential == pytest.approx(-WEIGHT / 0.8 * 0.1 * 12, rel=1e-6)


def test_level_heights_change_nothing():
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(MODEL), (2, 3, 0), (13, 9, 1.5))
    flat = replace(problem, heights=plane(0.0, 0.0))
    assert CompiledProblem(flat).setting.hills is kernels.LEVEL
    energies = [ep.plan(one, effort=6_000).energy for one in (flat, problem)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


@pytest.mark.parametrize(("height", "around"), [(0.6, False), (5.0, True)])
def test_a_ridge_is_crossed_or_avoided_by_what_is_cheaper(height, around):
    ground, cost = ridge(height), at_battery()
    start, goal = (2.0, 5.0, 0.0), (14.0, 5.0, 0.0)
    found = ep.plan(ep.PlanningProblem(HALL, cost, start, goal, heights=ground), effort=10_000)
    over = path_price(turn_drive(start, goal), cost, None, ground).energy
    detours = [
        path_price(turn_drive(start, (x, y), (16 - x, y), goal), cost, None, ground).energy
        for x in (5.0, 6.5, 8.0)
        for y in np.arange(6.0, 11.0, 0.25)
    ]
    assert (min(detours) < over) == around
    assert found.energy <= min(over, *detours) * (1 + 1e-9)
    assert found.energy == pytest.approx(path_price(found.path, cost, None, ground).energy)
    assert (found.poses[:, 1].max() > 7.0) == around


# -- prices and bounds -----------------------------------------------------------------------------


def motions(count, seed):
    rng = np.random.default_rng(seed)
    poses = rng.uniform((2, 2, -4), (12, 10, 4), (count, 3))
    rows = np.hstack([poses, rng.normal(size=(count, 2))])
    rows[: count // 5, 3] = 0.0
    rows[count // 5 : count // 3, 4] = 0.0
    # between straight motion and the first ray the price jumps, where the slip moment sets in
    first = np.tan(2 * np.pi / kernels.DIRECTIONS) / 0.42
    return rows[(rows[:, 4] == 0) | (np.abs(rows[:, 4]) > first * np.abs(rows[:, 3]))]


@pytest.mark.parametrize("icr", [ep.TreadICR(0.47, 0.47), ep.TreadICR(0.5, 0.42, 0.05)])
@pytest.mark.parametrize("back", [0.0, 0.6, 1.0])
def test_prices_are_those_of_the_models(icr, back):
    """Kernel, its plain twin, and the height map agree; no price falls below the bounds."""
    cost = at_battery(replace(MODEL, vehicle=MODEL.vehicle.with_icr(icr)), 0.8, back)
    ground = hills(3, 0.25)
    query = CompiledProblem(ep.PlanningProblem(HALL, cost, (2, 2, 0), (12, 9, 0), heights=ground))
    setting, static = query.setting, query.steering
    somewhere = ep.Pose(3, 4, 0.2)
    height = ground.height(point_ahead(somewhere, icr.longitudinal))
    worth, c_y, errors = query.height_potential(somewhere) / height, icr.centre[1], []
    for x, y, yaw, ds, dtheta in motions(200, 1):
        start = ep.Pose(x, y, yaw)
        path = ep.Path(start, [ds], [dtheta], icr.longitudinal)
        args = (setting, query.centre(start), ds - c_y * dtheta, dtheta)
        kernel = kernels.cost_in_parts(*args)
        assert kernel == pytest.approx(kernels.cost_in_parts.py_func(*args), rel=1e-9)
        before, after = ground.height(point_ahead(path.vertices[[0, -1]], icr.longitudinal))
        exact = path_price(path, cost, None, ground).energy - worth * (after - before)
        errors.append(kernel / exact - 1)
        least = setting.least_metre * abs(ds - c_y * dtheta) + setting.least_radian * abs(dtheta)
        track = static.metre * max(abs(ds - c_y * dtheta), static.track * abs(dtheta))
        assert 0 < least <= exact * (1 + 1e-6)
        assert track + static.radian * abs(dtheta) <= exact * (1 + 1e-6)
    assert np.max(np.abs(errors)) < 0.006
    assert abs(np.mean(errors)) < 1e-4


def test_the_price_of_height_is_the_best_one():
    """The linear programme against a scan over all prices."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        travel = rng.uniform(0.1, 1.0, 40)
        rise = rng.normal(size=40)
        prices = 3.0 * rise + travel * rng.uniform(1.0, 4.0, 40)
        found = _prices.potential(prices, travel, rise)
        scan = np.linspace(-10, 10, 4001)
        least = ((prices - scan[:, None] * rise) / travel).min(axis=1)
        assert ((prices - found * rise) / travel).min() >= least.max() - 1e-9


def exhaustive(problem, worth, headings=8):
    """Least cost over all drives of straight lines between nodes and turns on the spot."""
    graph, angle = nx.DiGraph(), 2 * np.pi / headings
    width, height = (range(1, int(size)) for size in problem.map.size)
    for x, y, k in product(width, height, range(headings)):
        c, s = round(np.cos(k * angle)), round(np.sin(k * angle))
        for ahead, turn in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            pose = ep.Pose(x, y, k * angle)
            path = ep.Path(pose, [ahead * np.hypot(c, s)], [turn * angle])
            rise = problem.heights.rise(path)
            price = problem.terrain.price(path, problem.cost).energy - worth * rise
            assert price > 0
            to = x + ahead * c, y + ahead * s, (k + turn) % headings
            graph.add_edge((x, y, k), to, weight=price)
    begin, end = (
        (round(x), round(y), round(yaw / angle)) for x, y, yaw in (problem.start, problem.goal)
    )
    return nx.dijkstra_path_length(graph, begin, end)


@pytest.mark.parametrize("seed", by_day(range(3), [0]))
def test_plans_lie_between_the_bound_and_an_exhaustive_search(seed):
    yard, ends = room(100, 100, 0.1), ((2, 2, 0), (8, 7, np.pi / 2))
    problem = ep.PlanningProblem(yard, at_battery(), *ends, heights=hills(seed, 1.2))
    query = CompiledProblem(problem)
    worth = query.height_potential(ep.Pose(3, 4, 0)) / float(problem.heights.height((3, 4)))
    least = exhaustive(problem, worth) + query.potential(problem.goal)
    found = ep.plan(problem, effort=10_000)
    assert found.lower_bound <= found.energy <= least * (1 + 1e-9)
    excess, bound = (one - found.potential for one in (found.cost, found.lower_bound))
    assert found.cost == pytest.approx(found.energy_steady, rel=1e-4)
    assert found.gap == pytest.approx(excess / bound - 1)


def test_energy_against_time_where_the_way_down_pays_for_itself():
    model = MODEL.with_term(VISCOUS_LOSS, 80.0)
    ends = (2, 6, 0), (14, 6, 0)
    options = {"speed": "cheapest"}, {"time_value": 30.0}, {"time_value": 120.0}
    problems = [
        ep.PlanningProblem(HALL, ep.EnergyCost(model, **one), *ends, heights=plane(-0.4, 0.0))
        for one in options
    ]
    plans = [ep.plan(problem, effort=2_000) for problem in problems]
    assert np.all(np.diff([found.energy for found in plans]) > 0)
    assert np.all(np.diff([found.duration for found in plans]) < 0)
    assert plans[0].energy < 0
    for found in plans:
        excess, bound = (
            one - found.potential for one in (found.cost_steady, found.lower_bound_steady)
        )
        assert 0 <= excess / bound - 1 < 0.2
        assert found.gap is None  # the drive passes slower speeds, at which less is lost


# -- surfaces --------------------------------------------------------------------------------------


def test_surfaces_and_slopes_together():
    """Against a plain sum over short straight lines, each on the surface under its middle."""
    marble = with_weight(ep.PowerModel.preset("quadriga:empty:marble"))
    ground = ep.SurfaceMap((Surface(shapely.box(5, 0, 9, 12), marble),))
    cost, heights = at_battery(back=0.5), hills(7, 0.6)
    path = ep.Path(ep.Pose(2, 3, 0.4), [10.0, 2.0], [0.0, 0.0])
    costs = ground.costs(cost)
    fine = path.subdivide(1e-3)
    middle = 0.5 * (fine.vertices[1:] + fine.vertices[:-1])
    region = ground.region_at(middle[:, :2])
    slope = heights.slope(middle)
    total = sum(
        float(c.segment_energy(1e-3 / np.cos(slope[region == k]), 0.0, slope[region == k]).sum())
        for k, c in enumerate(costs)
    )
    assert path_price(path, cost, ground, heights).energy == pytest.approx(total, rel=2e-4)
    problem = ep.PlanningProblem(HALL, cost, (2, 3, 0), (13, 8, 0), ground, heights=heights)
    found = ep.plan(problem, effort=6_000)
    assert found.energy == pytest.approx(path_price(found.path, cost, ground, heights).energy)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy)
    assert found.energy < path_price(found.path, cost, None, heights).energy  # marble is cheaper


def test_surfaces_whose_weights_differ_are_a_free_lunch():
    light, heavy = LEVEL.with_term(GRADE, 10.0), LEVEL.with_term(GRADE, 300.0)
    ground = ep.SurfaceMap((Surface(shapely.box(5, 0, 9, 12), heavy),))
    ends = (2, 6, 0), (13, 6, 0)
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(light), *ends, ground, heights=plane(0.3, 0.0))
    with pytest.raises(ModelError, match=r"climbing 16\.7 deg .* drive for ever"):
        ep.plan(problem, effort=6_000)


# -- refusals --------------------------------------------------------------------------------------


def test_models_that_know_no_slope_are_refused():
    assert not reads_slope(LEVEL)
    assert reads_slope(MODEL)
    assert reads_slope(LEVEL.with_term(term("specific_force"), 80.0))
    assert with_weight(MODEL) is MODEL
    ends = (2, 6, 0), (13, 6, 0)
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(LEVEL), *ends, heights=plane(0.1, 0.0))
    with pytest.raises(InvalidInputError, match=r"with_weight\(model\).* 83\.1 kg"):
        ep.plan(problem, effort=6_000)
    bare = ep.SurfaceMap((Surface(shapely.box(5, 0, 9, 12), LEVEL, "lawn"),))
    problem = replace(problem, cost=ep.EnergyCost(MODEL), surfaces=bare)
    with pytest.raises(InvalidInputError, match="surface 'lawn'"):
        ep.plan(problem, effort=6_000)
    found = ep.plan(replace(problem, surfaces=with_weights(bare)), effort=6_000)
    assert found.energy == pytest.approx(226 * 11 * np.hypot(1, 0.1) + WEIGHT * 1.1, rel=1e-6)


def test_heights_must_cover_the_map():
    small = ep.HeightMap(np.zeros((6, 6)) + 0.1 * np.arange(6), 1.0)
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(MODEL), (2, 3, 0), (4, 4, 0), heights=small)
    with pytest.raises(MapError, match=r"do not cover the map: \(15\..* y from 0 to 5 m"):
        ep.plan(problem, effort=6_000)
    # what the robot cannot reach needs no heights
    walled = ep.OccupancyGrid(np.pad(np.zeros((44, 44), bool), 3, constant_values=True), 0.1)
    assert ep.plan(replace(problem, map=walled, goal=(3.5, 3.5, 0)), effort=6_000).energy > 0


def test_steep_ground_that_the_robot_cannot_reach_does_not_count():
    cliff = np.zeros((25, 33))
    cliff[:, 22:] = 8.0
    heights = ep.HeightMap(cliff + 0.02 * np.arange(33), 0.5)
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(MODEL), (2, 3, 0), (6, 6, 0), heights=heights)
    assert CompiledProblem(problem).steepest == pytest.approx((8 + 0.02) / 0.5)
    fenced = replace(problem, map=room(120, 160, 0.1, np.s_[:, 98:]))
    assert CompiledProblem(fenced).steepest == pytest.approx(0.04)


# -- missions --------------------------------------------------------------------------------------


def mission(model=MODEL, **changes):
    values = {
        "model": model, "map": HALL, "battery": ep.Battery.preset("quadriga"),
        "start": ep.Pose(2.0, 6.0, 0.0), "tasks": (ep.Task("top", ep.Pose(13.0, 6.0, 0.0)),),
        "planning_effort": 3_000, "confidence": 0.5, "heights": plane(0.05, 0.0),
    }  # fmt: skip
    return ep.Mission(**{**values, **changes})


@pytest.mark.parametrize(("lossy", "slope"), [(False, 0.05), (True, 0.4)])
def test_a_mission_pays_for_the_climb_and_gets_back_what_drives_do_not_lose(lossy, slope):
    """Of the steep descent nothing: there the weight pushes, whatever the way down."""
    model = at_battery(back=0.0).model if lossy else MODEL
    report = ep.evaluate(mission(model, heights=plane(slope, 0.0)))
    level, climb = 226 * 11 * np.hypot(1, slope), WEIGHT * 11 * slope
    up = (level + climb) / (0.8 if lossy else 1.0)
    down = 0.0 if lossy else level - climb
    assert report.task("top").energy == pytest.approx(up, rel=1e-6)
    assert report.energy == pytest.approx(up + down, rel=2e-3 if lossy else 1e-6)


# -- files -----------------------------------------------------------------------------------------


def test_the_command_line_plans_on_slopes(tmp_path, run):
    (tmp_path / "yard.pgm").write_bytes(b"P5 80 60 255\n" + b"\xfe" * 4800)
    (tmp_path / "yard.yaml").write_text(
        "image: yard.pgm\nresolution: 0.2\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    (tmp_path / "site.yaml").write_text("map: yard.yaml\nheights: yard.asc\n")
    row = " ".join(f"{0.05 * (0.5 * k + 0.25):.4f}" for k in range(32))  # 5 cm a metre in x
    (tmp_path / "yard.asc").write_text(
        "ncols 32\nnrows 24\nxllcorner 0\nyllcorner 0\ncellsize 0.5\n" + (row + "\n") * 24
    )
    asked = [
        "--map", tmp_path / "site.yaml", "--model", "quadriga:empty:concrete",
        "--start", "2,6,0", "--goal", "13,6,0", "--effort", 6000,
    ]  # fmt: skip
    done = run("plan", *asked, "--json")
    assert "83.1 kg" in done.err
    energy = 226 * 11 * np.hypot(1, 0.05) + WEIGHT * 0.55
    assert done.json["energy"] == pytest.approx(energy, rel=1e-3)
    assert done.json["potential"] == pytest.approx(WEIGHT * 0.55, rel=1e-3)
    assert done.json["breakdown"]["grade"] == pytest.approx(WEIGHT * 0.55, rel=1e-3)
    report = tmp_path / "compared.html"
    compared = run("compare", *asked, "--at-battery", "--report", report)
    assert "of it for the height [J]" in compared.out
    assert report.stat().st_size > 10_000


def test_bounds_of_a_mission_hold_on_slopes():
    poses = [ep.Pose(4, 3, 0.0), ep.Pose(12, 9, 2.0)]
    tasks = tuple(ep.Task(f"t{k}", pose) for k, pose in enumerate(poses))
    legs = Legs(mission(at_battery().model, heights=hills(8, 0.6), tasks=tasks))
    bounds = legs.lower_bounds(0.0)
    for i in range(3):
        for j in range(3):
            assert bounds[i, j] <= legs.leg(i, j, 0.0).energy.mean + 1e-6
    assert bounds[0, 2] > 500
