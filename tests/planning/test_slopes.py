"""Planning on slopes: against closed forms, the models themselves, and an exhaustive search."""

from __future__ import annotations

import heapq
import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from by_day import by_day

from energyplan import cli
from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.errors import (
    InvalidInputError,
    MapError,
    ModelError,
)
from energyplan.mission import Mission, Task, evaluate
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.space import motions as kernels
from energyplan.planning.space import prices as _prices
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power import PowerModel
from energyplan.power.effects import GRADE, VISCOUS_LOSS, reads_slope, term, with_weight
from energyplan.terrain import (
    HeightMap,
    OccupancyGrid,
    Surface,
    SurfaceMap,
    path_price,
    with_weights,
)
from energyplan.vehicle import GRAVITY, TreadICR

LEVEL = PowerModel.preset("quadriga:empty:concrete")
MODEL = with_weight(LEVEL)
WEIGHT = MODEL.vehicle.mass * GRAVITY
HALL = OccupancyGrid(np.zeros((120, 160), bool), 0.1)


def at_battery(model=MODEL, drive=0.8, back=0.0):
    """Cost at the battery, of drives that lose on the way out, and of what comes back."""
    vehicle = replace(model.vehicle, drive_efficiency=drive, regen_efficiency=back)
    return EnergyCost(replace(model, vehicle=vehicle), battery=True)


def plane(x, y, resolution=1.0):
    i, j = np.indices((13, 17)) * resolution
    return HeightMap(x * j + y * i, resolution)


def hills(seed, height=0.4, resolution=0.5):
    """Smooth random hills over the hall, a few metres wide."""
    rng = np.random.default_rng(seed)
    i, j = np.indices((30, 36)) * resolution
    total = np.zeros(i.shape)
    for x, y, h in zip(
        rng.uniform(0, 17, 14), rng.uniform(0, 14, 14), rng.normal(size=14), strict=True
    ):
        total += height * h * np.exp(-((j - x) ** 2 + (i - y) ** 2) / 4.0)
    return HeightMap(total, resolution)


def ridge(height):
    """A ridge across the hall at x = 8, which ends at about y = 8."""
    i, j = np.indices((49, 65)) * 0.25
    return HeightMap(height * np.exp(-(((j - 8) / 1.5) ** 2)) / (1 + np.exp((i - 8) / 0.5)), 0.25)


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
    return Path(Pose(*points[0]), ds, dtheta)


# -- closed forms ----------------------------------------------------------------------------------


def test_without_losses_a_tilted_plane_adds_the_weight_times_the_rise():
    problem = PlanningProblem(HALL, EnergyCost(MODEL), (2, 3, 0), (13, 9, 1.5))
    tilted = replace(problem, heights=plane(0.03, -0.02))
    level, found = plan(problem, effort=6_000), plan(tilted, seed=1, effort=6_000)
    rise = 0.03 * 11 - 0.02 * 6
    assert found.potential == pytest.approx(WEIGHT * rise, rel=1e-9)
    # lengths on the slope exceed those in plan view by half the square of the slope
    assert found.energy == pytest.approx(level.energy + WEIGHT * rise, rel=3e-4)
    assert found.energy == pytest.approx(tilted.terrain.price(found.path, tilted.cost).energy)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy)
    assert found.length == pytest.approx(level.length, rel=1e-3)
    assert found.turning == pytest.approx(level.turning, rel=1e-2)
    assert found.gap < 1e-3
    assert found.lower_bound <= found.energy


def test_nothing_comes_back_and_a_gentle_descent_still_saves():
    """Where the weight stays below the resistance, no power is lost on the way down."""
    cost = at_battery()
    problem = PlanningProblem(HALL, cost, (14, 6, np.pi), (2, 6, np.pi), heights=plane(0.1, 0.0))
    found = plan(problem, effort=6_000)
    expected = (226 * np.hypot(1, 0.1) - WEIGHT * 0.1) * 12 / 0.8
    assert found.energy == pytest.approx(expected, rel=1e-6)
    assert found.potential == pytest.approx(-WEIGHT / 0.8 * 0.1 * 12, rel=1e-6)


def test_level_heights_change_nothing():
    problem = PlanningProblem(HALL, EnergyCost(MODEL), (2, 3, 0), (13, 9, 1.5))
    flat = replace(problem, heights=plane(0.0, 0.0))
    assert CompiledProblem(flat).setting.hills is kernels.LEVEL
    assert plan(flat, effort=6_000).energy == pytest.approx(
        plan(problem, effort=6_000).energy, rel=1e-9
    )


@pytest.mark.parametrize(("height", "around"), [(0.6, False), (5.0, True)])
def test_a_ridge_is_crossed_or_avoided_by_what_is_cheaper(height, around):
    ground, cost = ridge(height), at_battery()
    start, goal = (2.0, 5.0, 0.0), (14.0, 5.0, 0.0)
    found = plan(PlanningProblem(HALL, cost, start, goal, heights=ground), effort=10_000)
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
    assert found.lower_bound <= found.energy


# -- prices and bounds -----------------------------------------------------------------------------


def motions(count, seed):
    rng = np.random.default_rng(seed)
    rows = np.column_stack(
        [
            rng.uniform(2, 12, count), rng.uniform(2, 10, count), rng.uniform(-4, 4, count),
            rng.normal(size=count), rng.normal(size=count),
        ]
    )  # fmt: skip
    rows[: count // 5, 3] = 0.0
    rows[count // 5 : count // 3, 4] = 0.0
    # between straight motion and the first ray the price jumps, where the slip moment sets in
    first = np.tan(2 * np.pi / kernels.DIRECTIONS) / 0.42
    return rows[(rows[:, 4] == 0) | (np.abs(rows[:, 4]) > first * np.abs(rows[:, 3]))]


@pytest.mark.parametrize("icr", [TreadICR(0.47, 0.47), TreadICR(0.5, 0.42, 0.05)])
@pytest.mark.parametrize("back", [0.0, 0.6, 1.0])
def test_prices_are_those_of_the_models(icr, back):
    """Kernel, its plain twin, and the height map agree; no price falls below the bounds."""
    cost = at_battery(replace(MODEL, vehicle=MODEL.vehicle.with_icr(icr)), 0.8, back)
    ground = hills(3, 0.25)
    query = CompiledProblem(PlanningProblem(HALL, cost, (2, 2, 0), (12, 9, 0), heights=ground))
    setting, static = query.setting, query.steering
    worth = query.height_potential(Pose(3, 4, 0.2)) / ground.height(
        (3 + icr.longitudinal * np.cos(0.2), 4 + icr.longitudinal * np.sin(0.2))
    )
    errors = []
    for x, y, yaw, ds, dtheta in motions(200, 1):
        start = Pose(x, y, yaw)
        path = Path(start, [ds], [dtheta], icr.longitudinal)
        centre = query.centre(start)
        c_y = icr.centre[1]
        args = (setting, centre, ds - c_y * dtheta, dtheta)
        kernel = kernels.sloping_cost(*args)
        assert kernel == pytest.approx(kernels.sloping_cost.py_func(*args), rel=1e-9)
        rises = worth * (query_height(ground, path, -1) - query_height(ground, path, 0))
        exact = path_price(path, cost, None, ground).energy - rises
        errors.append(kernel / exact - 1)
        least = setting.least_metre * abs(ds - c_y * dtheta) + setting.least_radian * abs(dtheta)
        track = static.metre * max(abs(ds - c_y * dtheta), static.track * abs(dtheta))
        assert 0 < least <= exact * (1 + 1e-6)
        assert track + static.radian * abs(dtheta) <= exact * (1 + 1e-6)
    assert np.max(np.abs(errors)) < 0.006
    assert abs(np.mean(errors)) < 1e-4


def query_height(ground, path, which):
    x, y, yaw = path.vertices[which]
    return ground.height((x + path.longitudinal * np.cos(yaw), y + path.longitudinal * np.sin(yaw)))


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


def exhaustive(problem, worth, step=1.0, headings=8):
    """Least cost over all drives of straight lines between nodes and turns on the spot."""
    width, height = (int(n / step) for n in problem.map.size)
    known = {}

    def price(x, y, k, ds, turn):
        key = (x, y, k, ds, turn)
        if key not in known:
            path = Path(Pose(x * step, y * step, k * 2 * np.pi / headings), [ds], [turn])
            rise = problem.heights.rise(path)
            known[key] = problem.terrain.price(path, problem.cost).energy - worth * rise
        return known[key]

    x, y, yaw = problem.start
    begin = (round(x / step), round(y / step), round(yaw / (2 * np.pi / headings)) % headings)
    x, y, yaw = problem.goal
    end = (round(x / step), round(y / step), round(yaw / (2 * np.pi / headings)) % headings)
    best, heap = {begin: 0.0}, [(0.0, begin)]
    while heap:
        d, node = heapq.heappop(heap)
        if node == end:
            return d
        if d > best[node]:
            continue
        x, y, k = node
        angle = 2 * np.pi / headings
        c, s = round(np.cos(k * angle)), round(np.sin(k * angle))
        nexts = [((x, y, (k + way) % headings), 0.0, way * angle) for way in (1, -1)]
        for way in (1, -1):
            length = way * step * np.hypot(c, s)
            nexts.append(((x + way * c, y + way * s, k), length, 0.0))
        for other, ds, turn in nexts:
            if not (1 <= other[0] <= width - 1 and 1 <= other[1] <= height - 1):
                continue
            total = d + price(x, y, k, ds, turn)
            assert total > d
            if total < best.get(other, np.inf):
                best[other] = total
                heapq.heappush(heap, (total, other))
    return np.inf


@pytest.mark.parametrize("seed", by_day(range(3), [0]))
def test_plans_lie_between_the_bound_and_an_exhaustive_search(seed):
    yard = OccupancyGrid(np.zeros((100, 100), bool), 0.1)
    problem = PlanningProblem(
        yard, at_battery(), (2, 2, 0), (8, 7, np.pi / 2), heights=hills(seed, 1.2)
    )
    query = CompiledProblem(problem)
    worth = query.height_potential(Pose(3, 4, 0)) / float(problem.heights.height((3, 4)))
    least = exhaustive(problem, worth) + query.potential(problem.goal)
    found = plan(problem, effort=10_000)
    assert found.lower_bound <= found.energy <= least * (1 + 1e-9)
    assert found.gap == pytest.approx(
        (found.energy - found.potential) / (found.lower_bound - found.potential) - 1
    )


def test_energy_against_time_where_the_way_down_pays_for_itself():
    model = MODEL.with_term(VISCOUS_LOSS, 80.0)
    costs = [
        EnergyCost(model, speed="cheapest"),
        *(EnergyCost(model, time_value=value) for value in (30.0, 120.0)),
    ]
    plans = [
        plan(PlanningProblem(HALL, cost, (2, 6, 0), (14, 6, 0), heights=plane(-0.4, 0.0)),
             effort=2_000)
        for cost in costs
    ]  # fmt: skip
    assert np.all(np.diff([found.energy for found in plans]) > 0)
    assert np.all(np.diff([found.duration for found in plans]) < 0)
    assert plans[0].energy < 0
    for found in plans:
        assert 0 <= found.gap < 0.2
        assert found.lower_bound <= found.cost


# -- surfaces --------------------------------------------------------------------------------------


def test_surfaces_and_slopes_together():
    """Against a plain sum over short straight lines, each on the surface under its middle."""
    marble = with_weight(PowerModel.preset("quadriga:empty:marble"))
    ground = SurfaceMap((Surface(shapely.box(5, 0, 9, 12), marble),))
    cost, heights = at_battery(back=0.5), hills(7, 0.6)
    path = Path(Pose(2, 3, 0.4), [10.0, 2.0], [0.0, 0.0])
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
    problem = PlanningProblem(HALL, cost, (2, 3, 0), (13, 8, 0), ground, heights=heights)
    found = plan(problem, effort=6_000)
    assert found.energy == pytest.approx(path_price(found.path, cost, ground, heights).energy)
    assert found.lower_bound <= found.energy
    assert sum(found.breakdown.values()) == pytest.approx(found.energy)
    assert found.energy < path_price(found.path, cost, None, heights).energy  # marble is cheaper


def test_surfaces_whose_weights_differ_are_a_free_lunch():
    light, heavy = LEVEL.with_term(GRADE, 10.0), LEVEL.with_term(GRADE, 300.0)
    ground = SurfaceMap((Surface(shapely.box(5, 0, 9, 12), heavy),))
    problem = PlanningProblem(
        HALL, EnergyCost(light), (2, 6, 0), (13, 6, 0), ground, heights=plane(0.3, 0.0)
    )
    with pytest.raises(ModelError, match=r"climbing 16\.7 deg .* drive for ever"):
        plan(problem, effort=6_000)


# -- refusals --------------------------------------------------------------------------------------


def test_models_that_know_no_slope_are_refused():
    assert not reads_slope(LEVEL)
    assert reads_slope(MODEL)
    assert reads_slope(LEVEL.with_term(term("specific_force"), 80.0))
    assert with_weight(MODEL) is MODEL
    problem = PlanningProblem(
        HALL, EnergyCost(LEVEL), (2, 6, 0), (13, 6, 0), heights=plane(0.1, 0.0)
    )
    with pytest.raises(InvalidInputError, match=r"with_weight\(model\).* 83\.1 kg"):
        plan(problem, effort=6_000)
    bare = SurfaceMap((Surface(shapely.box(5, 0, 9, 12), LEVEL, "lawn"),))
    with pytest.raises(InvalidInputError, match="surface 'lawn'"):
        plan(replace(problem, cost=EnergyCost(MODEL), surfaces=bare), effort=6_000)
    assert plan(
        replace(problem, cost=EnergyCost(MODEL), surfaces=with_weights(bare)), effort=6_000
    ).energy == pytest.approx(226 * 11 * np.hypot(1, 0.1) + WEIGHT * 1.1, rel=1e-6)


def test_heights_must_cover_the_map():
    small = HeightMap(np.zeros((6, 6)) + 0.1 * np.arange(6), 1.0)
    problem = PlanningProblem(HALL, EnergyCost(MODEL), (2, 3, 0), (4, 4, 0), heights=small)
    with pytest.raises(MapError, match=r"do not cover the map: \(15\..* y from 0 to 5 m"):
        plan(problem, effort=6_000)
    # what the robot cannot reach needs no heights
    walled = OccupancyGrid(np.pad(np.zeros((44, 44), bool), 3, constant_values=True), 0.1)
    assert plan(replace(problem, map=walled, goal=(3.5, 3.5, 0)), effort=6_000).energy > 0


def test_steep_ground_that_the_robot_cannot_reach_does_not_count():
    cliff = np.zeros((25, 33))
    cliff[:, 22:] = 8.0
    heights = HeightMap(cliff + 0.02 * np.arange(33), 0.5)
    blocked = np.zeros((120, 160), bool)
    blocked[:, 98:] = True
    problem = PlanningProblem(HALL, EnergyCost(MODEL), (2, 3, 0), (6, 6, 0), heights=heights)
    assert CompiledProblem(problem).steepest == pytest.approx((8 + 0.02) / 0.5)
    assert CompiledProblem(
        replace(problem, map=OccupancyGrid(blocked, 0.1))
    ).steepest == pytest.approx(0.04)


# -- missions --------------------------------------------------------------------------------------


def mission(model=MODEL, **changes):
    values = {
        "model": model, "map": HALL, "battery": Battery.preset("quadriga"),
        "start": Pose(2.0, 6.0, 0.0), "tasks": (Task("top", Pose(13.0, 6.0, 0.0)),),
        "planning_effort": 3_000, "confidence": 0.5, "heights": plane(0.05, 0.0),
    }  # fmt: skip
    return Mission(**{**values, **changes})


def test_a_mission_pays_for_the_climb_and_gets_it_back():
    told = evaluate(mission())
    length = 11 * np.hypot(1, 0.05)
    up, down = 226 * length + WEIGHT * 0.55, 226 * length - WEIGHT * 0.55
    assert told.task("top").energy == pytest.approx(up, rel=1e-6)
    assert told.energy == pytest.approx(up + down, rel=1e-6)


def test_a_mission_does_not_get_back_what_drives_lose():
    """Steep enough for the weight to push: nothing comes back, whatever the way down."""
    lossy = at_battery(back=0.0).model
    told = evaluate(mission(lossy, heights=plane(0.4, 0.0)))
    up = (226 * np.hypot(1, 0.4) + WEIGHT * 0.4) * 11 / 0.8
    assert told.task("top").energy == pytest.approx(up, rel=1e-6)
    assert told.energy == pytest.approx(up, rel=2e-3)


# -- files -----------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A yard of 16 m by 12 m on a slope that climbs 5 cm per metre in x."""
    (tmp_path / "yard.pgm").write_bytes(b"P5 80 60 255\n" + b"\xfe" * 4800)
    (tmp_path / "yard.yaml").write_text(
        "image: yard.pgm\nresolution: 0.2\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    row = " ".join(f"{0.05 * (0.5 * k + 0.25):.4f}" for k in range(32))
    (tmp_path / "yard.asc").write_text(
        "ncols 32\nnrows 24\nxllcorner 0\nyllcorner 0\ncellsize 0.5\n" + (row + "\n") * 24
    )
    return tmp_path


def run(capsys, monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["energyplan", *(str(a) for a in arguments)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    printed = capsys.readouterr()
    return left.value.code or 0, printed.out, printed.err


def test_the_command_line_plans_on_slopes(folder, capsys, monkeypatch):
    (folder / "site.yaml").write_text("map: yard.yaml\nheights: yard.asc\n")
    asked = [
        "--map", folder / "site.yaml", "--model", "quadriga:empty:concrete",
        "--start", "2,6,0", "--goal", "13,6,0",
    ]  # fmt: skip
    code, out, err = run(
        capsys, monkeypatch, "plan", *asked, "--json", "--plot", folder / "route.png"
    )
    told = json.loads(out)
    assert code == 0
    assert "83.1 kg" in err
    assert told["energy"] == pytest.approx(226 * 11 * np.hypot(1, 0.05) + WEIGHT * 0.55, rel=1e-3)
    assert told["potential"] == pytest.approx(WEIGHT * 0.55, rel=1e-3)
    assert told["breakdown"]["grade"] == pytest.approx(WEIGHT * 0.55, rel=1e-3)
    assert (folder / "route.png").stat().st_size > 10_000
    code, out, _ = run(
        capsys, monkeypatch, "compare", *asked, "--at-battery", "--report", folder / "told.html"
    )
    assert code == 0
    assert "of it for the height [J]" in out
    assert (folder / "told.html").stat().st_size > 10_000


def test_bounds_of_a_mission_hold_on_slopes():
    from energyplan.mission.routes import Legs

    poses = [Pose(4, 3, 0.0), Pose(12, 9, 2.0)]
    tasks = tuple(Task(f"t{k}", pose) for k, pose in enumerate(poses))
    legs = Legs(mission(at_battery().model, heights=hills(8, 0.6), tasks=tasks))
    bounds = legs.lower_bounds(0.0)
    for i in range(3):
        for j in range(3):
            assert bounds[i, j] <= legs.leg(i, j, 0.0).energy.mean + 1e-6
    assert bounds[0, 2] > 500
