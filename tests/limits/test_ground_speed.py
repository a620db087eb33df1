"""Speed limits on the ground: kept by profiles, seen by the check, read as Nav2 writes them."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from limits.test_speed import HOTEL, PAPER, random_path
from PIL import Image

import energyplan as ep
from energyplan.errors import MapError
from energyplan.io.geojson import write_surfaces
from energyplan.io.maps import read_speed_mask
from energyplan.io.sites import read_site
from energyplan.output import documents
from energyplan.terrain import SpeedLimit

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
    cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:full:concrete"), speed=0.5)
    return ep.PlanningProblem(hall, cost, (2, 5, 0), (18, 5, 0), surfaces=zone)


@pytest.mark.parametrize("objective", ["energy", "time", {"energy": 1.0, "time": 50.0}])
def test_a_plan_that_limits_slow_down_says_so_and_its_gap_counts_them(slow_hall, objective):
    problem = replace(slow_hall, objective=objective)
    found, free = (
        ep.plan(problem, effort=3000),
        ep.plan(replace(problem, surfaces=None), effort=3000),
    )
    notes = [note for note in found.all_notes if "speed limits slow down 4 m" in note]
    assert len(notes) == 1 and notes[0] in str(found)
    assert notes[0] in documents.plan(found)["notes"]
    assert found.cost == pytest.approx(found.lower_bound * (1 + found.gap))
    if objective != "energy":  # 4 m at 0.1 in place of 0.5 m/s
        second = 1.0 if objective == "time" else 50.0
        assert found.cost - free.cost == pytest.approx(second * (4 / 0.1 - 4 / 0.5), rel=0.05)
        assert found.gap - free.gap == pytest.approx(
            (found.cost - free.cost) / found.lower_bound, rel=0.01
        )


def test_limits_that_slow_nothing_down_are_not_mentioned(slow_hall):
    beside = replace(slow_hall, start=(2, 1, 0), goal=(18, 1, 0))
    above = replace(slow_hall, cost=replace(slow_hall.cost, speed=0.1))
    shortest = replace(slow_hall, objective="length")
    for problem in (beside, above, shortest):
        found = ep.plan(problem, effort=3000)
        assert found.all_notes == ()


def test_a_comparison_names_the_limits_of_each_of_its_paths(slow_hall):
    found = ep.compare(slow_hall, effort=3000)
    assert len([note for note in found.energy_optimal.all_notes if "speed limits" in note]) == 1
    assert "speed limits slow down" in str(found)
