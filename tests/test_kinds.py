"""What a hurried caller gives: another kind of value is refused with its place and what to give."""

import copy
import dataclasses
import importlib
import inspect
import math
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely

import energyplan as ep
from energyplan import live, records
from energyplan.diagnosis.result import Evidence, FoundEffect
from energyplan.errors import EnergyPlanError, InvalidInputError
from energyplan.io.config import Project
from energyplan.logs.mapping import Column
from energyplan.mission import Robot
from energyplan.physics.robot import HiddenEffect
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


jackal = partial(dataclasses.replace, ep.Vehicle.preset("jackal"))
cells = partial(
    ep.Battery.from_units, "a", "lead_acid", parallel=1, unit_capacity=1e5, unit_resistance=0.01
)
DATES = pd.date_range("2026", periods=2)


def log(*times: float, power: float = 9.0) -> ep.DriveLog:
    same = dict.fromkeys(("v_left", "v_right"), [1.0] * len(times))
    return ep.DriveLog.from_columns({"t": times, **same, "power": [power] * len(times)})


def robot(**changes: object) -> ep.Vehicle:
    sizes = {"mass": 20, "wheelbase": 0.3, "track": 0.4, "length": 0.5, "width": 0.45}
    return ep.Vehicle.from_geometry("small", **sizes | changes)  # type: ignore[arg-type]


NAMES = globals() | {"Terrain": Terrain, "math": math, "replan": replan, "shapely": shapely}
WRONG = r"""
# names where objects are wanted
ep.EnergyCost('quadriga') | model .* give a PowerModel: PowerModel.preset
ep.PowerModel.paper('jackal', 50.0, 0.5) | vehicle .* Vehicle.preset\(NAME\)
ep.identify('drive.csv', VEHICLE) | logs .* DriveLog.read\(FILE\) or a list
ep.identify(['drive.csv'], VEHICLE) | logs\[0\] is the text 'drive.csv'
ep.identify(LOG.to_frame(), VEHICLE) | logs is a DataFrame
ep.identify(LOG, 'jackal') | vehicle is the text 'jackal'
ep.identify(LOG, VEHICLE, terms=['slip_friction']) | terms\[0\] .* give a Term
ep.diagnose([LOG], ['b.csv'], VEHICLE) | holdout\[0\]
ep.diagnose([LOG], [LOG], VEHICLE, progress=3) | progress is 3; give a function
problem(map='hall.yaml') | map .* read_map\(FILE\)
problem(surfaces='hall.geojson') | surfaces .* read_surfaces\(FILE\)
problem(cost=MODEL) | cost is a PowerModel; give an EnergyCost: EnergyCost\(model\)
ep.plan('hall.yaml') | problem .* give a PlanningProblem
ep.plan(problem(), 0.5) | planner is 0.5; give a text or a Planner
ep.plan(problem(), effort=50, resolution=0.1) | 'resolution'.* takes .*seed
ep.plan(problem(), effort=50, gap=-1.0) | gap is -1
ep.plan(problem(), ep.Planner(lambda problem: None), 0.1) | too many positional
ep.Planner('lattice') | by its name alone
ep.evaluate('mission.yaml') | mission .* read_mission\(FILE\)
mission(battery=24) | battery is 24; give a Battery, or words
mission(tasks=TASK) | tasks is a Task; give a list
mission(tasks={'gate': (4, 3, 0)}) | tasks is {'gate'
mission(tasks=[(4, 3, 0)]) | tasks\[0\] is \(4, 3, 0\): .* an instance of Task
mission(payload_models={'a': MODEL}) | payload_models of 'a'
mission(payload_models=[MODEL]) | payload_models is .*give a Mapping
mission(planning_effort=True) | planning_effort is True; give a number
dataclasses.replace(BATTERY, max_voltage=np.nan) | max_voltage is nan
mission(speed='fast') | speed is the text 'fast'; give .* or 'cheapest'
ep.check(LINE, MODEL) | trajectory is a Path; give a Trajectory: profile
ep.check(TIMED, COST) | model is an EnergyCost; give a PowerModel
ep.speed.profile(TIMED, MODEL) | path is a Trajectory; give a Path
MODEL.power(TIMED) | motion is a Trajectory; give a Motion
COST.energy([(0, 0, 0), (1, 0, 0)]) | path .* give a Path
ep.steering.energy((0, 0, 0), (1, 0, 0), MODEL) | cost is a PowerModel
HALL.path_free(LINE, MODEL) | vehicle is a PowerModel; give a Vehicle
HALL.first_collision(VEHICLE, LINE) | path is a Vehicle; give a Path
HALL.with_blocked([(1, 1), (2, 2)]) | an area is .* give a polygon of shapely
HALL.with_mask(np.zeros((3, 3), bool)) | mask is an array of shape
Terrain('hall.yaml') | grid .* give an OccupancyGrid
ep.SurfaceMap([shapely.box(0, 0, 1, 1)]) | surfaces\[0\] is a Polygon
replan(problem(), LINE.poses(), start=(2, 3, 0)) | former is an array
ep.energy_map('hall.yaml') | problem
ep.write_model(ep.identify, 'a.yaml') | model is a function; give a PowerModel
ep.read_map(None) | path is None; give a text or the name of a file
ep.read_vehicle({'mass': 3}) | source is {'mass': 3}
ep.OnlineIdentifier('jackal') | prior is the text 'jackal'
ep.OnlineIdentifier(MODEL).run('drive.csv') | log is the text 'drive.csv'
ep.watch('drive.csv', VEHICLE) | lines .* live.follow\(FILE\)
list(ep.watch(['0,1,2,3'], VEHICLE)) | lines\[0\] .* live.follow\(FILE\)
robot(icr=0.4) | icr is 0.4; give a TreadICR: TreadICR.symmetric\(METRES\)
robot(motor={'speed': 1}) | motor is {'speed': 1}; give a MotorLimits
ep.Motion.from_twist(0.5, 0.0, 0.4) | icr is 0.4
# another kind of value for each function that checks its arguments
BATTERY.larger('twice') | ^energy is the text 'twice'; give
BATTERY.simulate(['a', 'b'], [0, 1]) | ^t is \['a', 'b'\]; give
ep.Battery.of(12) | ^words is 12; give
LOG.motion(0.47) | ^icr is 0\.47; give
LOG.blocks('10 s') | ^duration is the text '10 s'; give
LOG.resample('20 Hz') | ^period is the text '20 Hz'; give
LOG.shifted(power='1 s') | ^power is the text '1 s'; give
ep.EnergyCost.from_coefficients('a', 1.0, 0.5) | ^per_metre is the text 'a'; give
COST.breakdown([(0, 0), (1, 1)]) | ^path is \[\(0, 0\), \(1, 1\)\]; give
COST.per_metre('0.1') | ^curvature is the text '0\.1'; give
COST.per_radian('0.1') | ^radius is the text '0\.1'; give
COST.lower_bound('here') | ^point is the text 'here'; give
ep.HeightMap(np.zeros((3, 3)), 1.0).rise([(0, 0), (1, 1)]) | ^path is \[\(0, 0\), \(1, 1\)\]; give
mission().resume((2, 3, 0), 'full') | ^soc is the text 'full'; give
mission().resume_robots('quadriga') | ^states is the text 'quadriga'; give
mission().with_remedy('drop') | ^remedy is the text 'drop'; give
ep.Motion.from_trajectory(LINE, VEHICLE.icr) | ^trajectory is a Path; give
HALL.updated(np.ones((2, 2), bool), 'first', 0) | ^row is the text 'first'; give
LINE.subdivide('10 cm') | ^max_ds is the text '10 cm'; give
TIMED.scaled('twice') | ^factor is the text 'twice'; give
VEHICLE.with_mass('heavy') | ^mass is the text 'heavy'; give
ep.compare('hall') | ^problem is the text 'hall'; give
ep.read_heights(3) | ^path is 3; give
ep.read_mission(3) | ^path is 3; give
ep.read_model(3) | ^source is 3; give
ep.read_surfaces(3) | ^path is 3; give
ep.simulate.drive('quadriga', 'spiral') | ^model is the text 'quadriga'; give
ep.simulate.identification_drive('quadriga') | ^model is the text 'quadriga'; give
ep.simulate.validation_drive('quadriga') | ^model is the text 'quadriga'; give
ep.steering.path((0, 0, 0), (1, 1, 1), MODEL) | ^cost is a PowerModel; give
# texts, units, dates, nothing where numbers are wanted
ep.TreadICR('0.4', 0.4) | tread ICR left is the text '0.4'; give a number
ep.MotorLimits(speed=None) | motor limit speed is None
robot(mass='20 kg') | mass is the text '20 kg'
ep.Task('gate', (4, 3, 0), dwell='soon') | task: dwell is the text 'soon'
ep.Charger('dock', (4, 3, 0), '100 V') | power is the text '100 V'.*W, kW
mission(soc='much') | soc is the text 'much'; give a number
ep.Path((0, 0, 0), ['a'], [0]) | ds is \['a'\]; give numbers
ep.Path((0, 0, 0), [1j], [0]) | ds is \[1j\]; give numbers
ep.Path('0,0,0', [1], [0]) | start is the text '0,0,0'; give x, y
ep.Path.from_poses([(0, 0, 0), (1, 1)]) | poses is .* give numbers
ep.plan(problem(), effort='300') | effort is the text '300'; give a whole number
ep.plan(problem(), effort=300.5) | effort is 300.5; give a whole number
ep.OccupancyGrid(np.zeros((3, 3), bool), '5 cm') | resolution is the text '5 cm'
ep.OccupancyGrid(np.zeros((3, 3), int), 0.1) | such as values > 0
ep.HeightMap('hill', 1.0) | heights is the text 'hill'
ep.EnergyCost(MODEL, battery=BATTERY) | battery is a Battery; give True or False
BATTERY.usable_energy('a lot') | power is the text 'a lot'
LOG.segment('10 s', '20 s') | t0 is the text '10 s'
ep.DriveLog.from_columns(None) | log is None; give channels by name
ep.DriveLog.read(LOG.to_frame(), columns={'v_left': 1}) | the column of 'v_left' is 1
ONLINE.update(0.0, None, 0.5, 100.0) | a sample holds .*None
ep.PowerModel.paper(VEHICLE, 0.5, 118.0) | K is 0.5 N and mu is 118.0; they seem to be swapped
MODEL.with_term('hotel_load', 30) | term is the text 'hotel_load'; give a Term
# shapes
HALL.footprint_free((2, 3), VEHICLE) | poses has shape \(2,\); give x, y \[m\], yaw
HALL.clearance_at((2, 3, 0)) | points has shape \(3,\); give x, y \[m\]
HALL.motions_free((2, 3, 0), [1, 2], 0.0, VEHICLE) | ds has shape \(2,\)
ep.HeightMap(np.zeros((3, 3)), 1.0).height((math.nan, 1)) | lies off the height map
COST.segment_energy([1, 2], [0, 0, 0]) | ds has shape \(2,\), dtheta \(3,\)
COST.energy(LINE, slope=[0, 0]) | slope has shape \(2,\); give one for each of 1
ep.Motion.from_twist([1, 2], [1, 2, 3], VEHICLE.icr) | do not broadcast
ep.OccupancyGrid.from_polygons(shapely.box(0, 0, 1, 1), (5, 5)) | bounds has shape \(2,\)
ep.energy_map(problem(), energy=300.0).energy_at((2, 3, 0)) | points has shape \(3,\)
# degrees, centimetres, far too much
problem(goal=(4, 3, 90)) | the yaw of goal is 90 rad.*math.radians\(90\)
ep.Task('gate', (4, 3, -45)) | seems to be in degrees
ep.OccupancyGrid(np.zeros((3, 3), bool), 0.1, (0, 0, 90)) | seems to be in degrees
ep.steering.energy((0, 0, 0), (1, 1, 180), COST) | the yaw of goal is 180 rad
ep.steering.energy((0, 0, 0), (1e+300, 1, 0), COST) | goal lies beyond
robot(track=40) | track is 40; give 0.01 to 30 m \(not centimetres\)
robot(icr=ep.TreadICR.symmetric(40)) | tread ICR lies 40 m
LINE.poses(1e-12) | segments
ep.Trajectory(DATES, [0, 1], [0, 0], [0, 0], [1, 1], [0, 0]) | t is a DatetimeIndex
cells(series='2') | series is the text '2'
ep.DriveLog.from_columns(dict(t=['a'], v_left=[1], v_right=[1], power=[1])) | log: t is \['a'\]
# what no vehicle has: such numbers would overflow in the slip moment, or in what follows from it
jackal(loads=[1e308] * 4) | loads\[0\] is 1e\+308; give 0 to 1e\+06 N
jackal(loads=[1.0, 1.0, 1.0, 2e9]) | loads\[3\] is 2000000000.0
jackal(contacts=[(1e5, 1), (-1, 1), (1, -1), (-1, -1)]) | contacts\[0\]\[0\] is 100000
jackal(footprint=[(-1, -1), (1, 1e308)]) | footprint\[1\]\[1\] is 1e\+308; give -30
jackal(footprint=[(-1, -1), (1, np.nan)]) | footprint\[1\]\[1\] is nan
jackal(loads=[0.0] * 4) | loads are all 0
jackal(footprint=[(-0.05, -1), (0.05, 1)]) | outside the footprint along x.*enlarge length
jackal(footprint=[(-1, -1), (1, 0.1)]) | outside the footprint along y.*enlarge width
jackal(contacts=np.zeros((0, 2)), loads=[]) | give rows
jackal(loads=[1.0, 1.0]) | one load each
jackal(loads=[1.0, 1.0, 1.0, -1.0]) | loads\[3\] is -1
jackal(loads=[1.0, 1.0, 1.0, np.nan]) | loads\[3\] is nan
jackal(contacts=np.full((4, 2), 0.1)) | on one side
jackal(contacts=np.zeros((4, 3))) | rows of
jackal(footprint=[[0.5, 0.5], [-0.5, -0.5]]) | x_max > x_min
jackal(drive_efficiency=0.0) | drive_efficiency is 0.0; give 0.01 to 1
jackal(regen_efficiency=1.2) | regen_efficiency
jackal(max_yaw_rate=-1.0) | max_yaw_rate
ep.TreadICR(1e308, 0.4) | tread ICR left is 1e\+308; give -1000 to 1000 m
ep.TreadICR(np.inf, 0.4) | tread ICR left is inf; give -1000 to 1000 m
ep.TreadICR(np.nan, 0.4) | tread ICR left is nan; give -1000 to 1000 m
ep.TreadICR(0.4, -2e4) | tread ICR right is -20000.0; give -1000 to 1000 m
ep.TreadICR(0.1, -0.2) | slip track
ep.MotorLimits(continuous_power=100.0, peak_power=50.0) | below continuous_power
ep.MotorLimits(force=float('nan')) | motor limit force is nan
ep.Vehicle.preset('jakal') | unknown vehicle preset 'jakal'; known: .*jackal
robot(mass=0) | mass is 0; give 0.05 to
# nothing, or too little
log() | 0 usable samples are left, two are needed
log(0) | 1 usable samples are left
log(0, 0) | the row repeats the one before
log(0, 1, power=math.nan) | power has no usable reading
ep.identify([], VEHICLE) | no logs; give at least one drive
ep.speed.profile(ep.Path((0, 0, 0), [], []), MODEL) | the path has no length
ep.OccupancyGrid(np.zeros((0, 0), bool), 0.1) | shape \(0, 0\)
LOG.segment(0.01, 0.02) | 0 samples lie in 0.01 <= t < 0.02 s
mission(tasks=[]) | the mission has no task; list at least one
ep.Battery('none', 3600.0, [], [], 0.1) | soc_points is \[\]
"""
"""What Python is given, and what the message says."""


def test_yaws_of_many_turns_are_no_degrees() -> None:
    spun = ep.Path((2, 2, 0), [0.0], [40.0]).end
    assert spun.yaw == 40.0
    assert problem(start=spun).start.yaw == 40.0
    unwrapped = [(0, 0, 9.7), (0, 0, 10.0), (0, 0, 10.3)]
    assert np.all(ep.steering.energy((0, 0, 0), unwrapped, COST) > 0)


@pytest.mark.parametrize("case", [line for line in WRONG.split("\n")[1:-1] if line[0] != "#"])
def test_a_wrong_kind_of_value_is_refused_with_its_place(case: str) -> None:
    call, words = case.split(" | ", 1)
    with pytest.raises(EnergyPlanError) as caught:
        eval(call, NAMES)
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
    lambda: HiddenEffect.parse("tilted_plane=0.05,direction=1.57"),
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
    for name, source in records.SOURCES.items():
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
            told = records._kinds(value.__wrapped__)
            wanted = set(inspect.signature(value).parameters) - {"options"}
            assert wanted & set(told), name


SI = {
    "2 m": 2.0, "2 cm": 0.02, "2 mm": 0.002, "2 s": 2.0, "2 min": 120.0, "2 h": 7200.0,
    "2 W": 2.0, "2 kW": 2000.0, "2 Ah": 7200.0, "2 mAh": 7.2, "2 ohm": 2.0,
    "2 mohm": 0.002, "2 V": 2.0, "2 mV": 0.002, "2 A": 2.0, "2 mA": 0.002, "2 J": 2.0,
    "2 Wh": 7200.0, "2 kWh": 7.2e6, "2 kg": 2.0, "2 g": 0.002, "2 %": 0.02, "2 m/s": 2.0,
    "36 km/h": 10.0, "2 degC": 2.0, "2 °C": 2.0, "2 rad": 2.0, "90 deg": math.pi / 2,
    "2 dm": 0.2, "2 km": 2000.0, "10 ft": 3.048, "100 in": 2.54, "10 yd": 9.144,
    "2 ms": 0.002, "2 us": 2e-6, "2 ns": 2e-9, "2 d": 172800.0,
    "2 mW": 0.002, "2 uW": 2e-6, "2 hp": 1491.39974, "2 PS": 1470.9975,
    "2 uAh": 0.0072, "2 mC": 0.002, "2 uC": 2e-6, "2 kC": 2000.0, "2 As": 2.0, "2 mAs": 0.002,
    "2 cV": 0.02, "2 dV": 0.2, "2 kV": 2000.0, "2 uV": 2e-6,
    "2 cA": 0.02, "2 dA": 0.2, "2 kA": 2000.0, "2 uA": 2e-6,
    "2 kJ": 2000.0, "2 MJ": 2e6, "2 mJ": 0.002, "2 mWh": 7.2, "2 Ws": 2.0, "2 mWs": 0.002,
    "2 kWs": 2000.0, "2 lb": 0.90718474, "2 kg/m": 2.0, "2 g/m": 0.002,
    "100 cm/s": 1.0, "1000 mm/s": 1.0, "10 dm/s": 1.0, "100 mph": 44.704, "10 ft/s": 3.048,
    "100 in/s": 2.54, "3600 kn": 1851.9984, "60 m/min": 1.0, "600 ft/min": 3.048,
    "6000 cm/min": 1.0, "60000 mm/min": 1.0, "3600 m/h": 1.0,
    "300 K": 26.85, "50 degF": 10.0, "2 C": 2.0, "2 mrad": 0.002, "2 urad": 2e-6,
    "9000 cdeg": math.pi / 2, "90000 mdeg": math.pi / 2, "2 rev": 4 * math.pi,
}  # fmt: skip
"""Amounts, and what they are in SI units."""


def test_every_unit_is_what_the_si_says() -> None:
    for kind, units in records.UNITS.items():
        for unit in units:
            (text,) = (text for text in SI if text.split()[1] == unit)
            assert records.amount(kind, text) == pytest.approx(SI[text], rel=1e-14), (kind, text)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [("power", "60 w", 60.0), ("time", "5 sec", 5.0), ("time", "2 hours", 7200.0),
     ("energy", "3 KJ", 3000.0), ("length", "10 feet", 3.048), ("speed", "100 MPH", 44.704),
     ("charge", "36 ah", 129600.0), ("time", "3 \u00b5s", 3e-6)],
)  # fmt: skip
def test_a_unit_may_be_spelt_as_people_do(kind: str, text: str, value: float) -> None:
    assert records.amount(kind, text) == pytest.approx(value, rel=1e-14)


def test_capitals_that_may_be_a_million_are_no_thousandth() -> None:
    for kind, text in (("power", "2 MW"), ("energy", "2 MWh"), ("resistance", "2 Mohm")):
        with pytest.raises(ValueError, match="the unit of a"):
            records.amount(kind, text)


@pytest.mark.parametrize("text", ["-5 degC", "-5 °C", "-5 C", "-5"])
def test_temperatures_are_written_in_degrees_of_either_spelling(text: str) -> None:
    assert records.amount("temperature", text) == -5.0
    assert records.amount("temperature", "268.15 K") == pytest.approx(-5.0)
    with pytest.raises(ValueError, match="one of degC, K, degF, °C, C, or none for degC"):
        records.amount("temperature", "268 R")


CHECKED = """
Battery.larger Battery.of Battery.simulate Battery.usable_energy Battery.from_units
DriveLog.blocks DriveLog.motion DriveLog.read DriveLog.resample DriveLog.segment DriveLog.shifted
EnergyCost.breakdown EnergyCost.energy EnergyCost.from_coefficients EnergyCost.lower_bound
EnergyCost.per_metre EnergyCost.per_radian EnergyMap.contours EnergyMap.reachable
HeightMap.rise Identification.energy Identification.interval Mission.resume Mission.resume_robots
Mission.with_remedy Motion.from_trajectory OccupancyGrid.from_polygons OccupancyGrid.updated
OccupancyGrid.with_mask OnlineIdentifier.__init__ OnlineIdentifier.run Path.__add__ Path.from_poses
Path.subdivide PowerModel.paper PowerModel.with_term Terrain.price Trajectory.scaled
Vehicle.from_geometry Vehicle.with_mass check compare diagnose energy_map evaluate feasible_region
identify plan profile read_costmap read_heights read_map read_mission read_model read_site
read_speed_mask read_surfaces read_vehicle replan simulate.drive simulate.identification_drive
simulate.validation_drive steering.energy steering.path watch write_model
"""
ELSEWHERE = ("energyplan.io.sites", "energyplan.io.maps", "energyplan.planning.replanning",
             "energyplan.limits.feasibility",
             "energyplan.terrain", "energyplan.fit.identification", "energyplan.reach")  # fmt: skip


@pytest.mark.parametrize("name", CHECKED.split())
def test_the_first_argument_that_is_wrong_is_named(name: str) -> None:
    owner, _, method = name.rpartition(".")
    places = [ep, *map(importlib.import_module, ELSEWHERE)]
    first = (owner or name).split(".")[0]
    found = next(getattr(place, first) for place in places if hasattr(place, first))
    function = getattr(found, method) if owner else found
    given, options = list[object](), dict[str, object]()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            options[parameter.name] = object()
        elif parameter.kind is inspect.Parameter.VAR_KEYWORD:
            options["p_left"] = object()
        else:
            given.append(object())
    with pytest.raises(EnergyPlanError, match=r"^\w+(\[0\])? is an? \w+; give "):
        function(*given, **options)
