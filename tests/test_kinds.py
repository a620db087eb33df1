"""What a hurried caller gives: another kind of value is refused with its place and what to give."""

import copy
import dataclasses
import inspect
import math
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely

import energyplan as ep
from energyplan import kinds, live
from energyplan.diagnosis.result import Evidence, FoundEffect
from energyplan.errors import EnergyPlanError, InvalidInputError
from energyplan.io.config import Project
from energyplan.logs.mapping import Column
from energyplan.mission import Robot
from energyplan.physics.robot import Effect
from energyplan.planning.replanning import replan
from energyplan.power import Sides
from energyplan.terrain import Terrain
from energyplan.terrain.grid import CostMap

VEHICLE = ep.Vehicle.preset("quadriga:full")
MODEL = ep.PowerModel.preset("quadriga:full:concrete")
COST = ep.EnergyCost(MODEL)
HALL = ep.OccupancyGrid(np.zeros((60, 60), bool), 0.1)
LINE = ep.Path((1, 3, 0), [1.0], [0.0])
TIMED = ep.Trajectory([0, 2], [1, 2], [3, 3], [0, 0], [0.5, 0.5], [0, 0])
BATTERY = ep.Battery.preset("quadriga")
TASK = ep.Task("gate", (4, 3, 0))
LOG = ep.simulate.drive(MODEL, "spiral", duration=40.0)
ONLINE = ep.OnlineIdentifier(MODEL)


def problem(**changes: object) -> ep.PlanningProblem:
    plain = {"map": HALL, "cost": COST, "start": (2, 3, 0), "goal": (4, 3, 0)}
    return ep.PlanningProblem(**plain | changes)  # type: ignore[arg-type]


def mission(**changes: object) -> ep.Mission:
    plain = {"model": MODEL, "map": HALL, "battery": BATTERY, "start": (2, 3, 0), "tasks": [TASK]}
    return ep.Mission(**plain | changes)  # type: ignore[arg-type]


def robot(**changes: object) -> ep.Vehicle:
    sizes = {"mass": 20, "wheelbase": 0.3, "track": 0.4, "length": 0.5, "width": 0.45}
    return ep.Vehicle.from_geometry("small", **sizes | changes)  # type: ignore[arg-type]


WRONG: list[tuple[Callable[[], object], str]] = [
    # names where objects are wanted
    (lambda: ep.EnergyCost("quadriga"), r"model .* give a PowerModel: PowerModel.preset"),
    (lambda: ep.PowerModel.paper("jackal", 50.0, 0.5), r"vehicle .* Vehicle.preset\(NAME\)"),
    (lambda: ep.identify("drive.csv", VEHICLE), r"logs .* DriveLog.read\(FILE\) or a list"),
    (lambda: ep.identify(["drive.csv"], VEHICLE), r"logs\[0\] is the text 'drive.csv'"),
    (lambda: ep.identify(LOG.to_frame(), VEHICLE), "logs is a DataFrame"),
    (lambda: ep.identify(LOG, "jackal"), "vehicle is the text 'jackal'"),
    (lambda: ep.identify(LOG, VEHICLE, terms=["slip_friction"]), r"terms\[0\] .* give a Term"),
    (lambda: ep.diagnose([LOG], ["b.csv"], VEHICLE), r"holdout\[0\]"),
    (lambda: ep.diagnose([LOG], [LOG], VEHICLE, progress=3), "progress is 3; give a function"),
    (lambda: problem(map="hall.yaml"), r"map .* read_map\(FILE\)"),
    (lambda: problem(surfaces="hall.geojson"), r"surfaces .* read_surfaces\(FILE\)"),
    (lambda: problem(cost=MODEL), r"cost is a PowerModel; give an EnergyCost: EnergyCost\(model\)"),
    (lambda: ep.plan("hall.yaml"), "problem .* give a PlanningProblem"),
    (lambda: ep.plan(problem(), 0.5), "planner is 0.5; give a text or a Planner"),
    (lambda: ep.plan(problem(), effort=50, resolution=0.1), "'resolution'.* takes .*finest"),
    (lambda: ep.plan(problem(), effort=50, finest=0), "finest is 0"),
    (lambda: ep.plan(problem(), ep.Planner(lambda problem: None), 0.1), "too many positional"),
    (lambda: ep.Planner("lattice"), "by its name alone"),
    (lambda: ep.evaluate("mission.yaml"), r"mission .* read_mission\(FILE\)"),
    (lambda: mission(battery=24), "battery is 24; give a Battery, or words"),
    (lambda: mission(tasks=TASK), "tasks is a Task; give a list"),
    (lambda: mission(tasks={"gate": (4, 3, 0)}), "tasks is {'gate'"),
    (lambda: mission(tasks=[(4, 3, 0)]), r"tasks\[0\] is \(4, 3, 0\): .* an instance of Task"),
    (lambda: mission(payload_models={"a": MODEL}), "payload_models of 'a'"),
    (lambda: mission(payload_models=[MODEL]), "payload_models is .*give a Mapping"),
    (lambda: mission(planning_effort=True), "planning_effort is True; give a number"),
    (lambda: dataclasses.replace(BATTERY, max_voltage=np.nan), "max_voltage is nan"),
    (lambda: mission(speed="fast"), "speed is the text 'fast'; give .* or 'cheapest'"),
    (lambda: ep.check(LINE, MODEL), "trajectory is a Path; give a Trajectory: profile"),
    (lambda: ep.check(TIMED, COST), "model is an EnergyCost; give a PowerModel"),
    (lambda: ep.speed.profile(TIMED, MODEL), "path is a Trajectory; give a Path"),
    (lambda: MODEL.power(TIMED), "motion is a Trajectory; give a Motion"),
    (lambda: COST.energy([(0, 0, 0), (1, 0, 0)]), "path .* give a Path"),
    (lambda: ep.steering.energy((0, 0, 0), (1, 0, 0), MODEL), "cost is a PowerModel"),
    (lambda: HALL.path_free(LINE, MODEL), "vehicle is a PowerModel; give a Vehicle"),
    (lambda: HALL.first_collision(VEHICLE, LINE), "path is a Vehicle; give a Path"),
    (lambda: HALL.with_blocked([(1, 1), (2, 2)]), "an area is .* give a polygon of shapely"),
    (lambda: HALL.with_mask(np.zeros((3, 3), bool)), "mask is an array of shape"),
    (lambda: Terrain("hall.yaml"), "grid .* give an OccupancyGrid"),
    (lambda: ep.SurfaceMap([shapely.box(0, 0, 1, 1)]), r"surfaces\[0\] is a Polygon"),
    (lambda: replan(problem(), LINE.poses(), start=(2, 3, 0)), "former is an array"),
    (lambda: ep.energy_map("hall.yaml"), "problem"),
    (lambda: ep.write_model(ep.identify, "a.yaml"), "model is a function; give a PowerModel"),
    (lambda: ep.read_map(None), "path is None; give a text or the name of a file"),
    (lambda: ep.read_vehicle({"mass": 3}), "source is {'mass': 3}"),
    (lambda: ep.OnlineIdentifier("jackal"), "prior is the text 'jackal'"),
    (lambda: ep.OnlineIdentifier(MODEL).run("drive.csv"), "log is the text 'drive.csv'"),
    (lambda: ep.watch("drive.csv", VEHICLE), r"lines .* live.follow\(FILE\)"),
    (
        lambda: list(ep.watch(["0,1,2,3"], VEHICLE)),
        r"lines\[0\] .* live.follow\(FILE\)",
    ),
    (lambda: robot(icr=0.4), r"icr is 0.4; give a TreadICR: TreadICR.symmetric\(METRES\)"),
    (lambda: robot(motor={"speed": 1}), "motor is {'speed': 1}; give a MotorLimits"),
    (lambda: ep.Motion.from_twist(0.5, 0.0, 0.4), "icr is 0.4"),
    # texts, units, dates, nothing where numbers are wanted
    (lambda: ep.TreadICR("0.4", 0.4), "tread ICR left is the text '0.4'; give a number"),
    (lambda: ep.MotorLimits(speed=None), "motor limit speed is None"),
    (lambda: robot(mass="20 kg"), "mass is the text '20 kg'"),
    (lambda: ep.Task("gate", (4, 3, 0), dwell="soon"), "task: dwell is the text 'soon'"),
    (lambda: ep.Charger("dock", (4, 3, 0), "100 V"), "power is the text '100 V'.*W, kW"),
    (lambda: mission(soc="much"), "soc is the text 'much'; give a number"),
    (lambda: ep.Path((0, 0, 0), ["a"], [0]), r"ds is \['a'\]; give numbers"),
    (lambda: ep.Path((0, 0, 0), [1j], [0]), r"ds is \[1j\]; give numbers"),
    (lambda: ep.Path("0,0,0", [1], [0]), "start is the text '0,0,0'; give x, y"),
    (lambda: ep.Path.from_poses([(0, 0, 0), (1, 1)]), "poses is .* give numbers"),
    (
        lambda: ep.Trajectory(
            pd.date_range("2026", periods=2), [0, 1], [0, 0], [0, 0], [1, 1], [0, 0]
        ),
        "t is a DatetimeIndex",
    ),
    (lambda: ep.plan(problem(), effort="300"), "effort is the text '300'; give a whole number"),
    (lambda: ep.plan(problem(), effort=300.5), "effort is 300.5; give a whole number"),
    (lambda: ep.OccupancyGrid(np.zeros((3, 3), bool), "5 cm"), "resolution is the text '5 cm'"),
    (lambda: ep.OccupancyGrid(np.zeros((3, 3), int), 0.1), "such as values > 0"),
    (lambda: ep.HeightMap("hill", 1.0), "heights is the text 'hill'"),
    (lambda: ep.EnergyCost(MODEL, battery=BATTERY), "battery is a Battery; give True or False"),
    (
        lambda: ep.Battery.from_units(
            "a", "lead_acid", series="2", parallel=1, unit_capacity=1e5, unit_resistance=0.01
        ),
        "series is the text '2'",
    ),
    (lambda: BATTERY.usable_energy("a lot"), "power is the text 'a lot'"),
    (lambda: LOG.segment("10 s", "20 s"), "t0 is the text '10 s'"),
    (lambda: ep.DriveLog.from_columns(None), "log is None; give channels by name"),
    (
        lambda: ep.DriveLog.from_columns({"t": ["a"], "v_left": [1], "v_right": [1], "power": [1]}),
        r"log: t is \['a'\]",
    ),
    (
        lambda: ep.DriveLog.read(LOG.to_frame(), columns={"v_left": 1}),
        "the column of 'v_left' is 1",
    ),
    (lambda: ONLINE.update(0.0, None, 0.5, 100.0), "a sample holds .*None"),
    (
        lambda: ep.PowerModel.paper(VEHICLE, 0.5, 118.0),
        "K is 0.5 N and mu is 118.0; they seem to be swapped",
    ),
    (lambda: MODEL.with_term("hotel_load", 30), "term is the text 'hotel_load'; give a Term"),
    # shapes
    (lambda: HALL.footprint_free((2, 3), VEHICLE), r"poses has shape \(2,\); give x, y \[m\], yaw"),
    (lambda: HALL.clearance_at((2, 3, 0)), r"points has shape \(3,\); give x, y \[m\]"),
    (lambda: HALL.motions_free((2, 3, 0), [1, 2], 0.0, VEHICLE), r"ds has shape \(2,\)"),
    (lambda: ep.HeightMap(np.zeros((3, 3)), 1.0).height((math.nan, 1)), "lies off the height map"),
    (lambda: COST.segment_energy([1, 2], [0, 0, 0]), r"ds has shape \(2,\), dtheta \(3,\)"),
    (lambda: COST.energy(LINE, slope=[0, 0]), r"slope has shape \(2,\); give one for each of 1"),
    (lambda: ep.Motion.from_twist([1, 2], [1, 2, 3], VEHICLE.icr), "do not broadcast"),
    (
        lambda: ep.OccupancyGrid.from_polygons(shapely.box(0, 0, 1, 1), (5, 5)),
        r"bounds has shape \(2,\)",
    ),
    (
        lambda: ep.energy_map(problem(), energy=300.0).energy_at((2, 3, 0)),
        r"points has shape \(3,\)",
    ),
    # degrees, centimetres, far too much
    (lambda: problem(goal=(4, 3, 90)), r"the yaw of goal is 90 rad.*math.radians\(90\)"),
    (lambda: ep.Task("gate", (4, 3, -45)), "seems to be in degrees"),
    (lambda: ep.OccupancyGrid(np.zeros((3, 3), bool), 0.1, (0, 0, 90)), "seems to be in degrees"),
    (lambda: ep.steering.energy((0, 0, 0), (1, 1, 180), COST), "the yaw of goal is 180 rad"),
    (lambda: ep.steering.energy((0, 0, 0), (1e300, 1, 0), COST), "goal lies beyond"),
    (lambda: robot(track=40), r"track is 40; give 0.01 to 30 m \(not centimetres\)"),
    (lambda: robot(icr=ep.TreadICR.symmetric(40)), "tread ICR lies 40 m"),
    (lambda: LINE.poses(1e-12), "segments"),
]


def test_yaws_of_many_turns_are_no_degrees() -> None:
    spun = ep.Path((2, 2, 0), [0.0], [40.0]).end
    assert spun.yaw == 40.0
    assert problem(start=spun).start.yaw == 40.0
    unwrapped = [(0, 0, 9.7), (0, 0, 10.0), (0, 0, 10.3)]
    assert np.all(ep.steering.energy((0, 0, 0), unwrapped, COST) > 0)


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_a_wrong_kind_of_value_is_refused_with_its_place(number: int) -> None:
    call, words = WRONG[number]
    with pytest.raises(EnergyPlanError) as caught:
        call()
    assert isinstance(caught.value, InvalidInputError)
    assert re.search(words, str(caught.value)), str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_missing_argument_is_told_by_python_alone() -> None:
    with pytest.raises(
        TypeError, match="missing 1 required keyword-only argument: 'width'"
    ) as caught:
        ep.Vehicle.from_geometry("my", mass=20, wheelbase=0.5, track=0.5, length=0.6)  # type: ignore[call-arg]
    assert caught.value.__context__ is None


RIGHT: list[Callable[[], object]] = [
    lambda: ep.simulate.drive(MODEL, "spiral", duration=40.0, changes=[(20.0, MODEL)]),
    lambda: ep.TreadICR(np.float32(0.5), np.int64(1)),
    lambda: ep.Path([0, 0, 0], pd.Series([1, 2], index=[5, 9]), (0, 0)),
    lambda: ep.Path.from_poses(pd.DataFrame({"x": [0, 1], "y": [0, 0], "yaw": [0, 0]})),
    lambda: problem(start=pd.Series([2, 3, 0], index=["x", "y", "yaw"])),
    lambda: problem(goal=np.array([4, 3, 62.83])),  # ten turns, as an odometer counts them
    lambda: ep.plan(problem(), effort=np.int64(50)),
    lambda: ep.plan(problem(), effort=50.0),
    lambda: mission(tasks=(TASK,), start=[2, 3, 0], soc="80 %"),
    lambda: ep.identify((LOG,), VEHICLE),
    lambda: ep.identify((log for log in [LOG]), VEHICLE),
    lambda: ep.Trajectory(**TIMED.to_frame()),
]


@pytest.mark.parametrize("number", range(len(RIGHT)))
def test_what_means_the_same_is_taken(number: int) -> None:
    assert RIGHT[number]() is not None


def test_numpy_scalars_are_kept_as_numbers() -> None:
    assert repr(ep.TreadICR(np.float64(0.5), np.int64(1)).right) == "1"
    assert type(ep.MotorLimits(speed=np.float32(1.5)).speed) is float


ALIKE: list[Callable[[], object]] = [
    lambda: ep.Path((0, 0, 0), [1, 2], [0, 0]),
    lambda: ep.Trajectory([0, 2], [1, 2], [3, 3], [0, 0], [0.5, 0.5], [0, 0]),
    lambda: ep.Vehicle.preset("jackal"),
    lambda: ep.PowerModel.preset("jackal:flooring"),
    lambda: ep.Battery.preset("quadriga"),
    lambda: ep.Motion.from_twist([0.5, 0.6], [0.0, 0.1], VEHICLE.icr, slope=[0.0, 0.1]),
    lambda: Sides(np.array([1.0]), np.array([2.0])),
    lambda: ep.identify(LOG, VEHICLE),
]


@pytest.mark.parametrize("number", range(len(ALIKE)))
def test_records_with_arrays_compare_by_value(number: int) -> None:
    one, other = ALIKE[number](), ALIKE[number]()
    assert one == other
    assert one == pickle.loads(pickle.dumps(one))
    assert one == copy.deepcopy(one)
    assert one != 3
    assert hash(one) == hash(other)
    first = dataclasses.fields(one)[0].name  # type: ignore[arg-type]
    assert one != ALIKE[number - 1]()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(one, first, None)


def test_records_that_differ_in_one_number_are_not_equal() -> None:
    assert ep.Path((0, 0, 0), [1, 2], [0, 0]) != ep.Path((0, 0, 0), [1, 2], [0, 0.1])
    assert dataclasses.replace(MODEL, covariance=np.eye(2)) != MODEL
    lossy = dataclasses.replace(MODEL.vehicle, drive_efficiency=0.9)
    assert dataclasses.replace(MODEL, vehicle=lossy) != MODEL


HELD: list[Callable[[], object]] = [
    *ALIKE,
    lambda: ep.OccupancyGrid(np.zeros((9, 9), bool), 0.1, unknown=np.eye(9, dtype=bool)),
    lambda: ep.HeightMap(np.zeros((9, 9)), 0.1),
    lambda: CostMap(np.zeros((9, 9)), 0.1),
    lambda: LOG,
    lambda: mission(payload_models={"a": {10.0: MODEL}}, confidence=0.5),
    lambda: mission(confidence=0.5, robots=(Robot("one", changes={"soc": 0.9}),)),
    lambda: FoundEffect(
        "hotel_load", "P_0", 40.2, "W", 0.6, Evidence(0.42, 0.06, 1e-8), details={"phase": 0.1}
    ),
    lambda: Effect.parse("tilted_plane=0.05,direction=1.57"),
    lambda: Project("a", VEHICLE, {"t": Column(field="time")}, defaults={"mass": 3.0}),
]
COPIES: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda record: pickle.loads(pickle.dumps(record)),
    "replace": dataclasses.replace,
}


def parts(value: object) -> Iterator[object]:
    """Give the arrays and mappings of a field, with those within."""
    if isinstance(value, Mapping | np.ndarray):
        yield value
    for item in value.values() if isinstance(value, Mapping) else ():
        yield from parts(item)


def writable(part: object) -> bool:
    return part.flags.writeable if isinstance(part, np.ndarray) else isinstance(part, dict)


@cache
def built(number: int) -> Any:
    return HELD[number]()


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("number", range(len(HELD)))
def test_what_nobody_writes_to_stays_so_in_a_copy(number: int, way: str) -> None:
    record = built(number)
    again = COPIES[way](record)
    for field in dataclasses.fields(record):
        before, after = getattr(record, field.name), getattr(again, field.name)
        for was, part in zip(parts(before), parts(after), strict=True):
            assert writable(was) or not writable(part), field.name


def test_sources_name_public_things() -> None:
    """What a message tells to call exists, with the names of the library."""
    for name, source in kinds.SOURCES.items():
        for called in re.findall(r"([A-Za-z_.]+)\(", source):
            found: object = ep
            for part in called.removeprefix("live.").split("."):
                found = getattr(found, part, None) or getattr(live, part)
            assert callable(found), (name, called)


def test_annotations_of_public_functions_are_understood() -> None:
    """A name that only type checkers know is found among the public ones, or nothing is checked."""
    for name in dir(ep):
        value = getattr(ep, name)
        if inspect.isfunction(value) and hasattr(value, "__wrapped__"):
            told = kinds._kinds(value.__wrapped__)
            wanted = set(inspect.signature(value).parameters) - {"options"}
            assert wanted & set(told), name
