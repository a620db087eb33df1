"""Cost, lower bound and gap of a plan are of driving it; what a program reads is of one energy."""

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

import energyplan as ep
from energyplan.output import documents
from energyplan.planning.bound import lower_bound
from energyplan.planning.driven import drive_plan, driven_bound
from energyplan.planning.space.compiled import compiled
from energyplan.power.effects import term, with_weight
from energyplan.terrain import SurfaceMap
from energyplan.terrain.surfaces import SpeedLimit
from tests.random_models import random_model

MODEL = ep.PowerModel.preset("quadriga:empty:concrete")
HALL = ep.OccupancyGrid(np.zeros((60, 90), bool), resolution=0.1)
LINE = (1.5, 3, 0), (7.5, 3, 0)


def model_of(drive=1.0, back=1.0, **sizes):
    made = replace(
        MODEL, vehicle=replace(MODEL.vehicle, drive_efficiency=drive, regen_efficiency=back)
    )
    for name, size in sizes.items():
        made = made.with_term(term(name), size)
    return made


def planned(model, ends=LINE, *, battery=False, effort=1500, **more):
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(model, battery=battery), *ends, **more)
    return ep.plan(problem, effort=effort)


def test_a_drive_below_the_steady_bound_has_a_bound_of_its_own():
    """Viscous losses are smaller while the robot speeds up, so driving takes less than steadily."""
    plan = planned(model_of(viscous_loss=20.0))
    assert plan.energy_driven < plan.lower_bound_steady
    assert plan.lower_bound <= plan.energy_driven == plan.cost
    # at a standstill the viscous losses vanish: what is left is the traction resistance
    assert 0.99 * 2 * 113.0 * 6.0 < plan.lower_bound <= 2 * 113.0 * 6.0
    assert plan.gap == plan.cost / plan.lower_bound - 1
    assert plan.gap_of == "driven"


@pytest.mark.parametrize("seed", range(40))
def test_no_drive_takes_less_than_the_bound(seed):
    cost = random_model(seed)
    if cost is None:
        pytest.skip("no model")
    rng = np.random.default_rng(seed)
    if rng.random() < 0.5:
        cost = replace(cost, model=cost.model.with_term(term("linear_inertia"), 200.0))
    ends = (1.5, 1.5, rng.uniform(-3, 3)), (rng.uniform(4, 7), 4.0, rng.uniform(-3, 3))
    objective = ["energy", "time", {"energy": 1, "time": 50}][seed % 3]
    try:
        problem = ep.PlanningProblem(HALL, cost, *ends, objective=objective)
        plan = ep.plan(problem, effort=800)
    except ep.errors.EnergyPlanError as error:
        pytest.skip(str(error))
    assert plan.gap_of == "driven"
    if plan.lower_bound is None:
        assert plan.gap is None
        return
    weight = problem.weights
    paths = [plan.path, ep.steering.path(*ends, cost), *([plan.shortest] if plan.shortest else [])]
    for path in paths:
        drive = drive_plan(problem, path)
        value = weight.get("energy", 0) * drive.energy + weight.get("time", 0) * drive.duration
        assert plan.lower_bound <= value


def test_where_stops_and_speeds_cost_nothing_the_numbers_are_those_at_steady_speeds():
    plan = planned(MODEL, ((1.5, 1.5, 0), (7, 4, 2)))
    assert (plan.cost, plan.lower_bound) == (plan.cost_steady, plan.lower_bound_steady)
    assert plan.energy_steady == plan.energy == pytest.approx(plan.energy_driven, rel=1e-9)
    assert pickle.loads(pickle.dumps(plan)).gap == plan.gap


def test_kinetic_energy_comes_back_unless_treads_lose_it():
    inertia = planned(model_of(linear_inertia=300.0), ((1.5, 1.5, 0), (7, 4, 2)))
    assert inertia.lower_bound == pytest.approx(inertia.lower_bound_steady)
    assert inertia.lower_bound <= inertia.cost * (1 + 1e-9)
    assert inertia.cost == pytest.approx(inertia.energy_driven, rel=1e-9)
    lossy = planned(model_of(0.7, 0.5, linear_inertia=300.0), battery=True)
    # the power of the treads, without the losses of a drive of 70 %
    assert lossy.lower_bound <= 0.7 * lossy.lower_bound_steady * (1 + 1e-9)
    assert 0.5 * lossy.lower_bound_steady < lossy.lower_bound


def test_where_no_bound_of_drives_is_known_there_is_no_gap_and_a_note():
    cold = planned(model_of(warm_up=50.0))
    assert (cold.lower_bound, cold.gap) == (None, None)
    assert "no gap" in str(cold)
    document = documents.plan(cold)
    assert document["gap"] is document["lower_bound"] is None
    assert any("no gap" in note for note in document["notes"])
    assert document["lower_bound_steady"] <= document["energy_steady"] * (1 + 1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("objective", ["energy", "time"])
def test_power_alone_limits_no_speed_at_which_drives_could_be_bounded(objective):
    strong = ep.MotorLimits(force=900.0, continuous_power=400.0, peak_power=800.0)
    model = model_of(hotel_load=20.0)
    free = replace(model, vehicle=replace(model.vehicle, motor=strong, usual_speed=np.inf))
    plan = planned(free, objective=objective)
    assert plan.energy_driven > 0
    assert (plan.lower_bound, plan.gap) == (None, None)
    assert "nothing limits the speed of the treads" in str(plan)


@pytest.mark.parametrize(("name", "known"), [("hotel_load", False), ("turn_asymmetry", True)])
def test_on_slopes_speed_must_not_matter(name, known):
    rise = ep.HeightMap(np.tile(np.linspace(0, 0.5, 20), (14, 1)), 0.5)
    plan = planned(with_weight(model_of(**{name: 0.1})), heights=rise)
    assert (plan.gap is not None) == known


def test_the_gap_of_the_least_time_is_that_of_the_drive():
    """A zone of 0.1 m/s across the hall is in the bound too; stops and its borders are not."""
    zone = SurfaceMap((), speed_limits=(SpeedLimit(shapely.box(4, 0, 6, 6), 0.1),))
    plan = planned(MODEL, objective="time", surfaces=zone)
    assert plan.cost == plan.driven.duration > plan.cost_steady > 2 / 0.1
    assert plan.gap == plan.cost / plan.lower_bound - 1
    assert plan.gap < 0.3
    assert "lower bound of the cost [s]" in str(plan)


@pytest.mark.parametrize("value", [60.0, 300.0])
def test_a_drive_hurries_as_much_as_the_seconds_that_its_route_was_priced_with(value):
    """No constant speed drives the line for less energy and time together."""
    model = model_of(hotel_load=60.0, viscous_loss=120.0)
    both = {"energy": 1.0, "time": value}
    cost = ep.EnergyCost(model, speed="cheapest", time_value=value)
    plan = ep.plan(ep.PlanningProblem(HALL, cost, *LINE, objective=both), effort=1500)
    assert plan.cost == pytest.approx(plan.energy_driven + value * plan.driven.duration)
    assert plan.lower_bound <= plan.cost
    assert plan.speed == pytest.approx(plan.driven.speed_priced, rel=0.03)
    others = [ep.EnergyCost(model, speed=speed) for speed in np.linspace(0.2, 1.2, 11)]
    drives = [drive_plan(replace(plan.problem, cost=one), plan.path) for one in others]
    assert plan.cost <= 1.002 * min(one.energy + value * one.duration for one in drives)


def test_the_speed_is_the_largest_of_the_drive():
    zone = SurfaceMap((), speed_limits=(SpeedLimit(shapely.box(-1, -1, 10, 10), 0.3),))
    plan = planned(MODEL, surfaces=zone)
    document = documents.plan(plan)
    assert document["speed"] == plan.speed == pytest.approx(0.3, rel=1e-6)
    assert document["speed_priced"] == MODEL.vehicle.driving_speed
    line = next(one for one in str(plan).splitlines() if "largest tread speed" in one)
    assert line.split()[-1] == "0.3"


def test_no_minus_zero_is_printed():
    plan = planned(MODEL)
    assert "-0" not in str(plan) and plan.gap_percent == "0"


def test_json_says_which_key_goes():
    document = json.loads(json.dumps(documents.plan(planned(model_of(hotel_load=50.0)))))
    assert document["energy"] == document["energy_steady"] < document["energy_driven"]
    assert "energy_driven" in document["deprecated"]["energy"]
    assert document["gap_of"] == "driven"
    assert document["cost"] == document["energy_driven"]


@pytest.mark.parametrize("length", [0.3, 6.0])
def test_speeding_up_and_slowing_down_once_is_in_the_bound_of_the_least_time(length):
    """Straight ahead nothing else is left of the gap, however short the way is."""
    plan = planned(MODEL, ((1.5, 3, 0), (1.5 + length, 3, 0)), objective="time")
    assert plan.cost > 1.05 * plan.cost_steady
    assert 0.0 <= plan.gap < 1e-3


def of_treads(start, times, left, right, parts=8):
    """Return the path of treads whose speeds run straight between these, in small arcs."""
    fine = np.unique(np.concatenate(
        [np.linspace(a, b, parts + 1) for a, b in pairwise(times)]
    ))  # fmt: skip
    way = [np.interp(fine, times, one) for one in (left, right)]
    moved = [0.5 * (one[1:] + one[:-1]) * np.diff(fine) for one in way]
    ds, turn = 0.5 * (moved[0] + moved[1]), (moved[1] - moved[0]) / MODEL.vehicle.icr.slip_track
    return ep.Path(start, ds, turn)


def at_random(rng, start):
    """Return a path that never stops on the way, by treads that speed up and slow down at random.

    Each keeps the limits of speed and acceleration, and they begin and end at rest.
    """
    top, most = MODEL.vehicle.motor.speed, MODEL.vehicle.motor.acceleration
    speeds = rng.uniform(-1, 1, (2, 6)) + rng.uniform(0, 1)
    speeds = np.clip(top * np.pad(speeds, ((0, 0), (1, 1))), -top, top)
    speeds[:, 0] = speeds[:, -1] = 0.0
    gain = np.abs(np.diff(speeds, axis=1)).max(axis=0)
    steps = gain / most + rng.exponential(0.3, len(gain)) + 1e-3
    return of_treads(start, np.append(0.0, np.cumsum(steps)), *speeds)


@pytest.mark.parametrize("objective", ["time", {"energy": 1, "time": 50}])
@pytest.mark.parametrize("seed", range(4))
def test_no_path_without_stops_takes_less_than_the_bound(seed, objective):
    """Turns at speed need no stop, so none is in the bound; an obstacle beside the path is."""
    rng = np.random.default_rng(seed)
    cost = ep.EnergyCost(MODEL)
    tried = 0
    while tried < 12:
        path = at_random(rng, (12.0, 12.0, rng.uniform(-3, 3)))
        cells = np.zeros((240, 240), bool)
        row, column = rng.integers(60, 180, 2)
        cells[row : row + 12, column : column + 12] = True
        grid = ep.OccupancyGrid(cells, resolution=0.1)
        if not grid.path_free(path, MODEL.vehicle):
            grid = ep.OccupancyGrid(0 * cells > 0, resolution=0.1)
        if not grid.path_free(path, MODEL.vehicle) or np.abs(path.ds).sum() < 0.2:
            continue
        tried += 1
        problem = ep.PlanningProblem(grid, cost, path.start, path.end, objective=objective)
        drive = drive_plan(problem, path)
        weight = problem.weights
        value = weight.get("energy", 0) * drive.energy + weight["time"] * drive.duration
        least = lower_bound(compiled(problem), 1.5 * value).value
        assert driven_bound(problem, least) <= value


def test_a_path_without_stops_meets_the_bound_of_the_least_time():
    """Turning at both ends while driving takes hardly more."""
    top, most = MODEL.vehicle.motor.speed, MODEL.vehicle.motor.acceleration
    back, ramp = 0.35, top / most
    first = [0.0, back, 2 * back, ramp, 2 * back + ramp]
    left = [0.0, -most * back, 0.0, most * (ramp - 2 * back), top]
    right = [0.0, most * back, most * 2 * back, top, top]
    times = np.array([*first, *(2 * (first[-1] + 2.0) - np.array(first))[::-1]])
    path = of_treads((12.0, 12.0, 0.5), times, [*left, *right[::-1]], [*right, *left[::-1]])
    grid = ep.OccupancyGrid(np.zeros((240, 240), bool), resolution=0.1)
    problem = ep.PlanningProblem(grid, ep.EnergyCost(MODEL), path.start, path.end, objective="time")
    plan = ep.plan(problem, effort=1500)
    smooth = drive_plan(problem, path).duration
    assert plan.lower_bound <= smooth < 1.04 * plan.lower_bound
    assert plan.path.turning > 1.0
