"""Speed limits on the ground: kept by profiles, seen by the check, read as Nav2 writes them."""

import json
from dataclasses import replace
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
import shapely
from limits.test_speed import HOTEL, PAPER, random_path
from PIL import Image
from shapely.affinity import rotate

import energyplan as ep
from energyplan.battery import Battery
from energyplan.errors import MapError
from energyplan.io.geojson import write_surfaces
from energyplan.io.maps import read_speed_mask
from energyplan.io.sites import read_site
from energyplan.mission import Mission, Spreads, Task, evaluate
from energyplan.planning.driven import drive_plan
from energyplan.planning.graphs import Roadmap
from energyplan.power.effects import term
from energyplan.terrain import SpeedLimit, Surface

STRAIGHT = ep.Path(ep.Pose(0.0, 0.0, 0.0), [8.0], [0.0])
ZONES = ep.SurfaceMap(
    (),
    speed_limits=(
        SpeedLimit(shapely.box(2, -1, 4, 1), 0.3),
        SpeedLimit(shapely.box(4, -1, 5, 1), 0.5, relative=True),
    ),
)


def closed_form(ends, caps, gain):
    """Least time on a line of stretches that each leave room to reach their cap."""
    rates = [0.0, *(min(pair) for pair in pairwise(caps)), 0.0]
    total = 0.0
    for length, cap, first, last in zip(np.diff(ends), caps, rates[:-1], rates[1:], strict=True):
        way = ((cap**2 - first**2) + (cap**2 - last**2)) / (2 * gain)
        assert way <= length
        total += (2 * cap - first - last) / gain + (length - way) / cap
    return total


def test_least_time_on_a_straight_is_the_closed_form():
    motor = PAPER.vehicle.motor
    caps = [motor.speed, 0.3, 0.5 * motor.speed, motor.speed]
    expected = closed_form([0.0, 2.0, 4.0, 5.0, 8.0], caps, motor.acceleration)
    found = ep.profile(STRAIGHT, PAPER, surfaces=ZONES).duration
    assert expected <= found <= (1 + 5e-4) * expected  # speeds change from cell to cell


def fine(trajectory, lever, steps=60):
    """Reference points and sizes of speeds, by small steps from each sample to the next."""
    part = (np.arange(steps) + 0.5) / steps
    step = np.diff(trajectory.t)[:, None] / steps
    v = trajectory.v[:-1, None] + np.diff(trajectory.v)[:, None] * part
    omega = trajectory.omega[:-1, None] + np.diff(trajectory.omega)[:, None] * part
    yaw = trajectory.yaw[:-1, None] + np.cumsum(omega * step, axis=1) - 0.5 * omega * step
    # the reference point moves along the heading
    x = trajectory.x + lever * np.cos(trajectory.yaw)
    y = trajectory.y + lever * np.sin(trajectory.yaw)
    x = x[:-1, None] + np.cumsum(v * step * np.cos(yaw), axis=1) - 0.5 * v * step * np.cos(yaw)
    y = y[:-1, None] + np.cumsum(v * step * np.sin(yaw), axis=1) - 0.5 * v * step * np.sin(yaw)
    return x, y, np.abs(v)


@pytest.mark.parametrize(
    "more",
    [{}, {"objective": "energy"}, {"duration": 90.0}, {"smooth": 1.0, "tolerance": 0.05}],
)
def test_no_instant_is_faster_than_its_ground_allows(more):
    """On random paths over random areas, by an integration of its own, a micrometre inside."""
    rng = np.random.default_rng(8)
    model = replace(HOTEL, vehicle=HOTEL.vehicle.with_icr(ep.TreadICR(0.45, 0.5, 0.1)))
    slowed = 0
    for _ in range(10):
        path = replace(random_path(rng), longitudinal=0.1)
        middle = path.vertices[rng.integers(0, len(path) + 1, 3), :2]
        areas = [
            shapely.Point(*at).buffer(float(rng.uniform(0.2, 1.0)), quad_segs=3)
            for at in middle + rng.normal(0, 0.3, (3, 2))
        ]
        limits = [SpeedLimit(area, float(rng.uniform(0.05, 0.5))) for area in areas]
        surfaces = ep.SurfaceMap((), speed_limits=limits)
        driven = ep.profile(path, model, surfaces=surfaces, **more)
        x, y, speed = fine(driven, 0.1)
        for limit in limits:
            inside = shapely.intersects_xy(limit.area.buffer(-1e-5), x, y)
            slowed += inside.sum()
            assert np.all(speed[inside] <= limit.speed * (1 + 1e-9))
        assert ep.check(driven, model, surfaces=surfaces).feasible
    assert slowed > 10_000


def test_a_limit_on_slopes_with_a_channel_of_each_segment_is_kept():
    ground = ep.HeightMap(0.1 * np.arange(12.0) * np.ones((4, 1)), 1.0, ep.Pose(-1.0, -2.0, 0.0))
    path = ep.Path(ep.Pose(0.0, 0.0, 0.0), [3.0, 5.0], [0.0, 0.0])
    driven = ep.profile(path, PAPER, surfaces=ZONES, heights=ground, channels={"load": [1.0, 2.0]})
    assert ep.check(driven, PAPER, surfaces=ZONES, heights=ground).feasible
    assert driven.duration > 10.0


def test_a_check_names_the_limit_and_how_much_slower_to_drive():
    t = np.linspace(0.0, 10.0, 201)
    driven = ep.Trajectory(t, 0.6 * t, 0 * t, 0 * t, 0.6 + 0 * t, 0 * t)
    report = ep.check(driven, PAPER, surfaces=ZONES)
    (found,) = report.violations
    assert (found.kind, found.side, found.peak, found.limit) == ("ground_speed", "both", 0.6, 0.3)
    assert (found.start, found.end) == pytest.approx((2 / 0.6, 4 / 0.6), abs=0.05)
    assert report.max_speed_scale == pytest.approx(0.5)
    assert ep.check(driven.scaled(0.5), PAPER, surfaces=ZONES).feasible


def test_a_relative_limit_needs_a_top_speed():
    motor = replace(PAPER.vehicle.motor, speed=np.inf)
    model = replace(PAPER, vehicle=replace(PAPER.vehicle, motor=motor))
    with pytest.raises(MapError, match=r"50 % of the top speed.*give its motor a speed"):
        ep.profile(STRAIGHT, model, surfaces=ZONES)


# -- files --------------------------------------------------------------------------------------


def features(*properties):
    square = {"type": "Polygon", "coordinates": [[[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]]}
    return json.dumps(
        {
            "type": "FeatureCollection",
            "features": [
                {"type": "Feature", "properties": one, "geometry": square} for one in properties
            ],
        }
    )


def test_surfaces_with_a_speed_are_read_and_written(tmp_path):
    file = tmp_path / "ground.geojson"
    marble = {"model": "quadriga:empty:marble", "speed": 0.4}
    file.write_text(features(marble, {"speed": "12.5 %"}, {"surface": "keep_out"}))
    ground = ep.read_surfaces(file)
    assert [(one.speed, one.relative) for one in ground.speed_limits] == [
        (0.4, False), (0.125, True),
    ]  # fmt: skip
    assert (len(ground.surfaces), len(ground.keep_out)) == (1, 1)
    write_surfaces(ground, file)
    assert ep.read_surfaces(file).speed_limits == ground.speed_limits


@pytest.mark.parametrize(
    ("speed", "message"),
    [
        (0, "feature 0: speed limit: speed is 0.0; give 0.001 to 50 m/s"),
        (-0.5, "speed limit: speed is -0.5"),
        ("120 %", "a speed limit is 120 %"),
        ("slow", "speed is 'slow'; give m/s, such as 0.4, or '50 %'"),
        (True, "speed is True"),
        ([1], "speed is"),
        (float("nan"), "speed limit: speed is nan"),
    ],
)
def test_a_speed_that_is_none_is_refused(tmp_path, speed, message):
    file = tmp_path / "ground.geojson"
    file.write_text(features({"speed": speed}))
    with pytest.raises(MapError, match=message):
        ep.read_surfaces(file)


def mask(folder, pixels, **keys):
    Image.fromarray(pixels).save(folder / "mask.png")
    header = {"image": "mask.png", "resolution": 0.5, "origin": [1.0, 2.0, 0.3], "mode": "raw",
              "negate": 0, "occupied_thresh": 1.0, "free_thresh": 0.0, **keys}  # fmt: skip
    file = folder / "mask.yaml"
    file.write_text("\n".join(f"{key}: {value}" for key, value in header.items()))
    return file


@pytest.mark.parametrize(
    ("keys", "limit"),
    [
        ({"type": 1, "base": 100.0, "multiplier": -1.0}, lambda value: 1.2 * (100 - value) / 100),
        ({"type": 1}, lambda value: 1.2 * value / 100),
        ({"type": 2, "base": -0.2, "multiplier": 0.01}, lambda value: 0.01 * value - 0.2),
        ({"type": 1, "multiplier": 2.0}, lambda value: np.where(value > 50, 0, 0.024 * value)),
    ],
)
def test_each_cell_of_a_mask_limits_as_nav2_says(tmp_path, keys, limit):
    """0 and unknown are no limit; nor are results that are not above 0, or above 100 %."""
    pixels = np.random.default_rng(1).choice([0, 1, 30, 50, 80, 100, 180], (9, 13)).astype(np.uint8)
    ground = ep.SurfaceMap((), speed_limits=read_speed_mask(mask(tmp_path, pixels, **keys)))
    value = pixels[::-1].astype(float)
    expected = np.asarray(limit(value))
    expected = np.where((value > 0) & (value <= 100) & (expected > 1e-12), expected, np.inf)
    row, column = np.indices(value.shape)
    along, up = 0.5 * (column + 0.5), 0.5 * (row + 0.5)
    c, s = np.cos(0.3), np.sin(0.3)
    at = np.stack([1.0 + c * along - s * up, 2.0 + s * along + c * up], axis=-1)
    np.testing.assert_allclose(ground.top_speed(at, PAPER.vehicle), expected)


def test_the_shades_of_a_scaled_mask_are_percents(tmp_path):
    """As in Nav2's tutorial: 40 % grey slows to 60 %, and 70 % grey to 30 % of the top speed."""
    pixels = np.array([[255, 153, 77]], np.uint8)
    file = mask(tmp_path, pixels, mode="scale", type=1, base=100.0, multiplier=-1.0)
    found = sorted(one.speed for one in read_speed_mask(file))
    assert found == pytest.approx([0.3, 0.6])


def test_a_site_has_the_limits_of_its_mask_beside_those_of_its_surfaces(tmp_path):
    mask(tmp_path, np.full((2, 2), 60, np.uint8), type=1)
    (tmp_path / "map.yaml").write_text((tmp_path / "mask.yaml").read_text().replace("type", "#"))
    (tmp_path / "ground.geojson").write_text(features({"speed": 0.3}))
    for more, found in (("", [0.6]), ("surfaces: ground.geojson\n", [0.3, 0.6])):
        (tmp_path / "site.yaml").write_text(f"map: map.yaml\nspeed_mask: mask.yaml\n{more}")
        surfaces = read_site(tmp_path / "site.yaml").surfaces
        assert [one.speed for one in surfaces.speed_limits] == found


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "mask.yaml, line 1, type: is missing; write what Nav2's costmap_filter_info_server"),
        ({"type": 0}, "mask.yaml, line 8, type"),
        ({"type": 2, "multiplier": "fast"}, "mask.yaml, line 9, multiplier"),
        ({"type": 2, "multiplyer": 0.1}, "there is no such key; write it multiplier"),
    ],
)
def test_a_mask_that_does_not_say_what_it_means_is_refused(tmp_path, keys, message):
    with pytest.raises(MapError, match=message):
        read_speed_mask(mask(tmp_path, np.zeros((2, 2), np.uint8), **keys))


@pytest.fixture
def slow_hall():
    """A hall with a slow zone between start and goal."""
    zone = ep.SurfaceMap((), speed_limits=[SpeedLimit(shapely.box(8, 2, 12, 8), 0.1)])
    hall = ep.OccupancyGrid(np.zeros((100, 200), bool), resolution=0.1)
    cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
    return ep.PlanningProblem(hall, cost, (2, 5, 0), (18, 5, 0), surfaces=zone)


def with_hotel_load(problem, watts=150.0):
    model = problem.cost.model.with_term(term("hotel_load"), watts)
    return replace(problem, cost=replace(problem.cost, model=model))


def test_the_least_time_leads_round_a_slow_zone(slow_hall):
    found = ep.plan(replace(slow_hall, objective="time"), effort=5000)
    # straight through takes 12 m at 1.2 m/s and 4 m at 0.1 m/s; round it are 17.42 m and turns
    assert 14.5 < found.cost_steady < found.cost == found.driven.duration < 21.0
    assert found.notes == ()


def test_the_least_energy_of_a_hotel_load_leads_round_a_slow_zone(slow_hall):
    found = ep.plan(with_hotel_load(slow_hall), effort=5000)
    assert found.cost == found.energy_driven < 7907
    assert found.lower_bound <= found.cost


def test_limits_that_change_no_price_change_no_plan(slow_hall):
    shortest = replace(slow_hall, objective="length")
    hotel = with_hotel_load(slow_hall)
    slower = replace(hotel, cost=replace(hotel.cost, speed=0.1))
    for problem in (slow_hall, shortest, slower):
        found, free = (
            ep.plan(one, effort=1000) for one in (problem, replace(problem, surfaces=None))
        )
        assert np.array_equal(found.path.vertices, free.path.vertices)
        assert (found.lower_bound_steady, found.effort) == (free.lower_bound_steady, free.effort)
        assert found.all_notes == ()


def test_a_limit_that_must_be_crossed_is_in_the_price_and_in_the_bound(slow_hall):
    across = ep.SurfaceMap((), speed_limits=[SpeedLimit(shapely.box(8, -1, 12, 11), 0.1)])
    problem = replace(slow_hall, surfaces=across, objective="time")
    found = ep.plan(problem, effort=3000)
    assert found.cost_steady == pytest.approx(12 / 1.2 + 4 / 0.1, rel=1e-6)
    assert found.duration == pytest.approx(found.cost_steady, rel=1e-12)
    assert 0.9 * found.cost_steady < found.lower_bound_steady <= found.cost_steady
    # spins are as fast as elsewhere: it is the reference point that keeps the limit
    spin = ep.Path((10, 5, 0), [0.0], [np.pi])
    price = problem.terrain.price(spin, problem.cost)
    assert price.duration == pytest.approx(problem.cost.duration(spin), rel=1e-12)


def test_of_limits_that_overlap_the_lowest_is_priced_on_every_surface(slow_hall):
    """The price of a path is the sum over pieces cut by hand."""
    marble = Surface(shapely.box(6, 0, 12, 10), ep.PowerModel.preset("quadriga:empty:marble"))
    limits = [SpeedLimit(shapely.box(4, 0, 9, 10), 0.2), SpeedLimit(shapely.box(8, 0, 14, 10), 0.4),
              SpeedLimit(shapely.box(0, 0, 30, 10), 0.5, relative=True)]  # fmt: skip
    ground = ep.SurfaceMap([marble], speed_limits=limits)
    problem = replace(with_hotel_load(slow_hall), surfaces=ground)
    price = problem.terrain.price(ep.Path(problem.start, [16.0], [0.0]), problem.cost)
    lengths_and_speeds = [(2, 0.6), (5, 0.2), (5, 0.4), (4, 0.6)]
    assert price.duration == pytest.approx(sum(m / v for m, v in lengths_and_speeds), rel=1e-9)


def test_a_comparison_prices_both_paths_on_the_same_ground(slow_hall):
    found = ep.compare(with_hotel_load(slow_hall), effort=5000)
    # the shortest way crosses the zone
    assert found.energy_optimal.energy_driven < 0.75 * found.shortest.energy_driven


def test_graphs_range_and_missions_go_round_a_slow_zone_too(slow_hall):
    problem = with_hotel_load(slow_hall)
    graph = nx.Graph()
    for name, place in {"a": (2, 5), "b": (18, 5), "c": (2, 9), "d": (18, 9)}.items():
        graph.add_node(name, pos=place)
    graph.add_edges_from(["ab", "ac", "cd", "db"])
    route = Roadmap(graph, problem.cost, problem.surfaces).route("a", "b")
    assert route.nodes == ("a", "c", "d", "b")
    within_reach = float(ep.energy_map(problem).energy_at((18, 5)))
    mission = Mission(
        model=problem.cost.model, map=problem.map, surfaces=problem.surfaces, start=problem.start,
        tasks=(Task("there", problem.goal),), battery=Battery.preset("quadriga"),
        spreads=Spreads.none(), planning_effort=5000, confidence=0.5,
    )  # fmt: skip
    leg = evaluate(mission).task("there").energy
    # 16 m at 226 J/m, and the hotel load for as long as straight ways take with and without limit
    free, across = (16 * 226 + 150 * time for time in (16 / 1.2, 12 / 1.2 + 4 / 0.1))
    assert all(free < energy < 0.8 * across for energy in (within_reach, leg))


@pytest.mark.parametrize("seed", range(20))
def test_no_path_costs_less_than_the_bound_among_random_zones(slow_hall, seed):
    rng = np.random.default_rng(seed)
    limits = []
    for _ in range(rng.integers(1, 5)):
        x, y = rng.uniform((2, 0), (16, 9))
        area = rotate(
            shapely.box(x, y, x + rng.uniform(0.5, 6), y + rng.uniform(0.5, 6)), rng.uniform(0, 90)
        )
        limits.append(SpeedLimit(area, float(rng.uniform(0.05, 0.9)), bool(rng.random() < 0.5)))
    marble = Surface(shapely.box(6, 0, 12, 10), ep.PowerModel.preset("quadriga:empty:marble"))
    ground = ep.SurfaceMap([marble] * int(rng.integers(2)), speed_limits=limits)
    problem = replace(slow_hall, surfaces=ground, goal=(18, 5, float(rng.uniform(-3, 3))))
    if rng.random() < 0.6:
        problem = with_hotel_load(problem)
    speed = [None, "cheapest", 0.5][seed % 3]
    problem = replace(problem, cost=replace(problem.cost, speed=speed))
    problem = replace(problem, objective=["energy", "time", {"energy": 1, "time": 50}][seed % 3])
    found = ep.plan(problem, effort=1500)
    assert found.lower_bound <= found.cost * (1 + 1e-9)
    weights = problem.weights
    others = [ep.plan(replace(problem, surfaces=None), effort=300).path,
              ep.steering.path(problem.start, problem.goal, problem.cost)]  # fmt: skip
    for path in others:
        price = problem.terrain.price(path, problem.cost)
        steady = weights.get("energy", 0) * price.energy + weights.get("time", 0) * price.duration
        assert found.lower_bound_steady <= steady * (1 + 1e-9)
        if found.lower_bound is not None:
            drive = drive_plan(problem, path)
            value = weights.get("energy", 0) * drive.energy
            value += weights.get("time", 0) * drive.duration
            assert found.lower_bound <= value * (1 + 1e-9)


def test_what_cannot_price_speed_limits_is_refused(slow_hall):
    timed = replace(slow_hall, objective="time")
    planner = ep.Planner(lambda problem, budget: None, objectives=("energy", "time"))
    assert planner.lacks(timed, counted=False) == ["speed limits"]
    assert planner.lacks(slow_hall, counted=False) == []  # no speed changes this energy
    areas = [shapely.box(4 + 0.1 * k, 2, 4.1 + 0.1 * k, 8) for k in range(60)]
    limits = [SpeedLimit(area, 0.1 + 0.01 * k) for k, area in enumerate(areas)]
    marble = ep.PowerModel.preset("quadriga:empty:marble")
    ground = ep.SurfaceMap([Surface(area, marble) for area in areas[:4]], speed_limits=limits)
    with pytest.raises(MapError, match="4 surfaces under speed limits of 60 speeds make 305 kinds"):
        ep.plan(replace(timed, surfaces=ground), effort=100)
    with pytest.raises(ep.errors.InvalidInputError, match="speed_limit is 0"):
        replace(slow_hall.cost, speed_limit=0.0)
