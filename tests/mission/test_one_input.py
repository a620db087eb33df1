"""One input at a time: whatever was asked before, an answer is that of its own question.

Each field of each part of a mission and of a planning problem is changed in turn. With all that is
kept from the other questions (routes, tables of the map, compiled problems) the answer is the one
without, and it follows the field, unless the field is listed as one that cannot matter.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

import energyplan as ep
from energyplan.mission import Charger, Mission, Robot, Routes, Spreads, Task, evaluate
from energyplan.mission.routes import Legs
from energyplan.output import documents
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.budget import EFFORT
from energyplan.power import HOTEL, PowerModel, Residual
from energyplan.power.effects import with_weight
from energyplan.power.terms import Term
from energyplan.terrain import CostMap, HeightMap, OccupancyGrid, Site, SurfaceMap
from energyplan.terrain.surfaces import SpeedLimit, Surface
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle

CELL = 0.25
PLAN = "energyplan.mission.routes.plan"


def cells(left: float, low: float, right: float, high: float) -> NDArray[np.bool_]:
    """Return the cells of a hall of 8 m by 5 m whose centres lie in a rectangle [m]."""
    y, x = CELL * (np.indices((20, 32)) + 0.5)
    return (x > left) & (x < right) & (y > low) & (y < high)


def model(friction: float = 0.427, name: str = "base") -> PowerModel:
    base = PowerModel.preset("quadriga:empty:marble")
    values = [friction, *base.coefficients[1:]]
    robot = replace(
        base.vehicle, motor=MotorLimits(speed=1.2), usual_speed=0.8, drive_efficiency=0.9,
        regen_efficiency=0.5, tracking_tolerance=0.02,
    )  # fmt: skip
    return replace(
        base, vehicle=robot, coefficients=values, covariance=np.diag(np.square(values) * 1e-4),
        residual=Residual(3.0, 2.0, 0.0, 0.02, 1.0, 100.0), name=name,
    )  # fmt: skip


def hall() -> OccupancyGrid:
    return OccupancyGrid(cells(3.5, 2.0, 4.0, 3.3), CELL, unknown=cells(3.5, 0.7, 4.0, 2.0))


def ground() -> SurfaceMap:
    return SurfaceMap(
        (Surface(shapely.box(0, 0, 2, 5), model(0.6, "rough")),), (shapely.box(7.7, 0, 8, 1),),
        (SpeedLimit(shapely.box(4.5, 0, 8, 5), 0.5),),
    )  # fmt: skip


def slopes() -> HeightMap:
    return HeightMap(0.1 * np.cos(np.indices((10, 13))[1]), 1.0, (-2, -2, 0))


def battery() -> ep.Battery:
    return replace(
        ep.Battery.preset("quadriga"), capacity=7200.0, pair_resistance=0.05, temperature=15.0,
        peukert=1.05, rated_current=2.0,
    )  # fmt: skip


def mission() -> Mission:
    look = Task("look", (6.0, 2.5, 0.0), dwell=60.0, power=50.0, payload=5.0, window=(40.0, 500.0))
    wash = Task("wash", (2.6, 3.5, 0.5), dwell=100.0, power=60.0, required=False)
    return Mission(
        model(), hall(), battery(), (1.2, 2.5, 0.0), (look, wash),
        (Charger("dock", (1.2, 1.2, 0.0), power=400.0, until=0.9),), ground(), 2.0,
        {"base": {20.0: model(0.5, "heavy")}}, soc=0.9, planning_effort=100, waiting=10.0,
        clearance=0.05,
    )  # fmt: skip


def problem() -> PlanningProblem:
    cost = ep.EnergyCost(model(), battery=True, speed=0.8)
    return PlanningProblem(
        hall(), cost, (1.2, 2.5, 0.0), (6.0, 2.5, 1.0), ground(),
        costmap=CostMap(0.5 * cells(2, 3, 5, 5), CELL), costmap_weight=50.0,
    )  # fmt: skip


def site() -> Site:
    soft = CostMap(0.5 * cells(2, 3, 5, 5), CELL)
    return Site(hall(), ground(), None, None, soft, 0.05)


def hilly() -> Mission:
    sloped = with_weight(replace(model(), covariance=None, residual=None))
    task = Task("look", (3.0, 2.5, 0.0))
    return Mission(
        sloped, hall(), battery(), (1.2, 2.5, 0.0), (task,), heights=slopes(), soc=0.9,
        confidence=0.5, planning_effort=60,
    )  # fmt: skip


def charging() -> Mission:
    task = Task("look", (3.0, 2.5, 0.0), dwell=300.0, power=150.0)
    dock = Charger("dock", (2.0, 2.5, 0.0), power=400.0, until=0.9)
    return Mission(
        model(), OccupancyGrid(cells(0, 0, 0, 0), CELL), battery(), (1.2, 2.5, 0.0), (task,),
        (dock,), soc=0.3, planning_effort=60, waiting=10.0,
    )  # fmt: skip


def along() -> Mission:
    """A path whose near end comes last."""
    row = Task("row", path=((3.0, 3.6), (1.2, 3.6)), power=30.0)
    return replace(mission(), tasks=(row,), surfaces=None, payload=0.0)


def shared() -> Mission:
    """Two robots with a skill each; both have to charge at one place."""
    robots = (
        Robot("near", ("eye",), {"start": (2.6, 3.5, 0.0)}),
        Robot("far", ("arm",), {"start": (5.0, 4.0, 0.0), "soc": 0.4}),
    )
    look = Task("look", (3.0, 2.5, 0.0), dwell=500.0, power=150.0, needs=("eye",))
    wash = Task("wash", (2.6, 3.5, 0.5), dwell=500.0, power=150.0, needs=("arm",))
    return replace(charging(), tasks=(look, wash), robots=robots)


def sharing() -> Mission:
    """The same with two places at the charger."""
    one = shared()
    return replace(one, chargers=(replace(one.chargers[0], places=2),))


def reported(asked: Mission, routes: Routes) -> str:
    found = evaluate(asked, routes=routes)
    whole = documents.mission(found, trajectories=True)
    lines = [one.timeline.soc_lower.tolist() for one in found.robots or (found,)]
    return json.dumps([whole, lines, found.warnings])


def planned(asked: PlanningProblem, _: object = None) -> str:
    found = plan(asked, effort=100)
    told = {**documents.plan(found), "planning_time": None, "first_time": None}
    return json.dumps([told, None if found.driven is None else found.driven.duration])


def crossed(asked: Site, _: object = None) -> str:
    whole = problem()
    cost = ep.EnergyCost(hilly().model) if asked.surfaces is None else whole.cost
    return planned(PlanningProblem(asked, cost, whole.start, whole.goal, costmap_weight=50.0))


ASK: dict[type, Callable[[Any, Any], str]] = {
    Mission: reported, PlanningProblem: planned, Site: crossed
}  # fmt: skip


class Part(NamedTuple):
    """A part of a question: where it stands, another value for each field, and what is inert."""

    question: Callable[[], Any]
    place: tuple[str | int, ...]
    kind: type
    changes: dict[str, Callable[[], Any]]
    inert: Mapping[str, str] = MappingProxyType({})  # fields that cannot matter, and why not


def changed(whole: Any, place: tuple[str | int, ...], change: dict[str, Any]) -> Any:
    """Return a question with a change of the part that stands at a place."""
    if not place:
        return replace(whole, **change)
    first, *rest = place
    if isinstance(first, int):
        return (*whole[:first], changed(whole[first], (*rest,), change), *whole[first + 1 :])
    return replace(whole, **{first: changed(getattr(whole, first), (*rest,), change)})


def like(**values: Any) -> dict[str, Callable[[], Any]]:
    return {name: (lambda value=value: value) for name, value in values.items()}


LABEL = "it is what to call it"
PARTS = [
    Part(mission, (), Mission, {
        "model": lambda: model(0.5), "map": lambda: replace(hall(), unknown=None),
        "battery": lambda: ep.Battery.preset("jackal"),
        "tasks": lambda: mission().tasks[:1], "surfaces": lambda: None,
        "payload_models": dict, "spreads": Spreads.none,
        **like(start=(1.2, 2.2, 0.0), chargers=(), payload=6.0, soc=0.7, reserve=0.895,
               confidence=0.8, coefficient_spread=0.1, order="free",
               home=(1.5, 2.5, 0.0), time=30.0, speed=0.4, objective="length",
               planner="rrtstar", planning_time=9.0, planning_effort=3000, name="other",
               waiting=20.0, clearance=0.3, robots=(Robot("mission", changes={"soc": 0.8}),)),
    }, {
        "planning_time": "it is long enough",
        "name": LABEL,
    }),
    Part(hilly, (), Mission, like(heights=None)),
    Part(charging, (), Mission, like(return_to="start")),
    Part(mission, ("tasks", 0), Task, like(
        name="other", pose=(6.0, 2.2, 0.0), dwell=61.0, power=51.0, payload=6.0, prize=2.0,
        required=False, window=(41.0, 500.0), power_spread=30.0, dwell_spread=30.0,
        goals=(ep.Goal(6.0, 2.5),),
    ), {"prize": "all tasks fit", "required": "all tasks fit"}),
    Part(shared, ("tasks", 1), Task, like(needs=())),
    Part(along, ("tasks", 0), Task, like(
        path=((2.8, 3.6), (1.2, 3.6)), direction="given", speed=0.3, payload_per_metre=0.1,
    )),
    Part(shared, ("robots", 0), Robot, like(
        name="other", skills=("arm",), changes={"start": (2.6, 3.5, 0.0), "soc": 0.8},
    )),
    Part(shared, ("chargers", 0), Charger, like(places=2)),
    Part(sharing, ("chargers", 0), Charger, like(shared=True)),
    Part(charging, ("chargers", 0), Charger, like(
        name="other", pose=(1.2, 1.3, 0.0), power=300.0, until=0.8, temperature=25.0,
        efficiency=0.9, enough=True,
    )),
    Part(charging, ("spreads",), Spreads, like(
        soc=0.03, capacity=0.03, health=0.03, temperature=4.0, power=0.2, dwell=0.2, run=0.2,
        speed=0.2, waiting=0.2,
    )),
    Part(charging, ("battery",), ep.Battery, like(
        name="other", capacity=7300.0, soc_points=battery().soc_points**1.1,
        ocv_points=1.01 * battery().ocv_points, resistance=0.2, pair_resistance=0.1,
        pair_time=30.0, peukert=1.1, rated_current=1.0, charge_efficiency=0.8,
        cutoff_voltage=float(np.median(battery().ocv_points)), cutoff_soc=0.1, max_voltage=37.0,
        max_discharge_current=1.0, max_charge_current=1.0, temperature=5.0,
        min_charge_temperature=20.0, max_charge_temperature=12.0,
        derating_temperature=battery().derating_temperature + 3.0,
        derating_factor=0.9 * battery().derating_factor, resistance_coefficient=0.1,
        health=0.9, notes=("a note",),
    ), {"name": LABEL}),
    Part(mission, ("model", "vehicle"), Vehicle, {
        "icr": lambda: TreadICR.symmetric(0.5), "motor": lambda: MotorLimits(speed=0.6),
        "contacts": lambda: 1.1 * Vehicle.preset("quadriga:empty").contacts,
        "loads": lambda: 1.1 * Vehicle.preset("quadriga:empty").loads,
        "footprint": lambda: 1.1 * Vehicle.preset("quadriga:empty").footprint,
        **like(name="other", drive_efficiency=0.8, regen_efficiency=0.0, max_yaw_rate=0.2,
               battery_power=80.0, usual_speed=0.6, tracking_tolerance=0.0, reverse=False),
    }, {"name": LABEL}),
    Part(hilly, ("model", "vehicle"), Vehicle, like(battery_return=0.1),
         {"battery_return": "friction takes more than the slopes give"}),
    Part(mission, ("map",), OccupancyGrid, {
        "occupied": lambda: cells(3.5, 2.0, 4.2, 3.2), "unknown": lambda: None,
        **like(resolution=0.251, origin=(-0.05, 0.0, 0.0), unknown_is_free=True),
    }),
    Part(mission, ("surfaces",), SurfaceMap, {
        "surfaces": tuple, "keep_out": lambda: (shapely.box(3.5, 3.0, 4.2, 3.4),),
        "speed_limits": tuple,
    }),
    Part(mission, ("surfaces", "surfaces", 0), Surface, {
        "area": lambda: shapely.box(0, 0, 2.2, 5), "model": lambda: model(0.7, "rough"),
        **like(name="other", second=200.0, turning_radius=0.6),
    }, {"name": LABEL}),
    Part(mission, ("surfaces", "speed_limits", 0), SpeedLimit, {
        "area": lambda: shapely.box(4.0, 0, 8, 5), **like(speed=0.3, relative=True),
    }),
    Part(hilly, ("heights",), HeightMap, {
        "heights": lambda: 1.1 * slopes().heights, **like(resolution=1.1, origin=(-1.9, -2, 0)),
    }),
    Part(problem, (), PlanningProblem, {
        "map": lambda: replace(hall(), unknown=None), "surfaces": lambda: None,
        "cost": lambda: ep.EnergyCost(model(0.5), battery=True, speed=0.8),
        "vehicle": lambda: Vehicle.preset("husky_a200"), "costmap": lambda: None,
        **like(start=(1.2, 2.2, 0.0), goal=(6.0, 2.2, 1.0), goals=(ep.Goal(6.0, 2.5),),
               objective="time", clearance=0.2,
               costmap_weight=500.0, turning="forward"),
    }),
    Part(lambda: changed(problem(), (), {"cost": ep.EnergyCost(hilly().model, speed=0.8),
                                         "surfaces": None, "heights": slopes()}),
         (), PlanningProblem, like(heights=None)),
    Part(problem, ("cost",), ep.EnergyCost, {
        "model": lambda: model(0.5),
        **like(battery=False, speed=0.5, channels={"temperature": 20.0}, time_value=50.0,
               speed_limit=0.2),
    }, {"channels": "no term reads it", "time_value": "the speed is given"}),
    Part(site, (), Site, {
        "map": lambda: replace(hall(), unknown=None), "surfaces": lambda: None,
        "keepout": lambda: OccupancyGrid(cells(3.5, 3.3, 4.0, 3.6), CELL),
        "costmap": lambda: None, **like(clearance=0.2),
    }),
    Part(lambda: changed(site(), (), {"surfaces": None}), (), Site, {"heights": slopes}),
]  # fmt: skip


@pytest.mark.parametrize("kind", dict.fromkeys(part.kind for part in PARTS))
def test_each_field_is_changed(kind: type) -> None:
    """A field that is new fails here until another value of it is listed."""
    listed = {name for part in PARTS if part.kind is kind for name in part.changes}
    assert listed == {one.name for one in fields(kind) if one.init}


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.kind.__name__)
def test_an_answer_follows_each_field_whatever_was_asked_before(part: Part) -> None:
    kept, routes = part.question(), Routes()
    ask = ASK[type(kept)]
    before = ask(kept, routes)
    for name, value in part.changes.items():
        alone = ask(changed(part.question(), part.place, {name: value()}), Routes())
        assert ask(changed(kept, part.place, {name: value()}), routes) == alone, name
        if name != "name":  # it is told, or not
            assert (alone == before) == (name in part.inert), name
    assert ask(kept, routes) == before


def test_tables_of_a_map_follow_a_patch_of_it() -> None:
    for name in ("occupied", "unknown"):
        kept = problem()
        planned(kept)
        patch = cells(3.5, 3.3, 4.0, 3.8)[12:16]
        parts = {"occupied": np.zeros(patch.shape, bool), name: patch}
        now = kept.map.updated(row=12, column=0, **parts)
        new = OccupancyGrid(now.occupied, CELL, unknown=now.unknown)
        told = planned(replace(kept, map=now))
        assert told == planned(replace(problem(), map=new)) != planned(problem())


# -- routes that are shared ------------------------------------------------------------------------


def bent(motion: Any, vehicle: Any, **_: float) -> Any:
    """Return another power than the term whose name it is given."""
    return 2.0 * abs(motion.v)


def test_terms_of_one_name_are_told_apart_by_their_functions() -> None:
    def asked(function: Callable[..., Any]) -> Mission:
        term = Term("drag", "c", "W", "power", function)
        known = replace(model(), covariance=None).with_term(term, 30.0)
        return replace(mission(), model=known, payload_models={}, confidence=0.5)

    routes = Routes()
    for function in (lambda motion, vehicle: abs(motion.v), bent):
        found = [evaluate(asked(function), routes=one).energy for one in (routes, Routes())]
        assert found[0] == found[1]


@pytest.mark.parametrize("speed", [1.0, "cheapest"])
def test_legs_of_a_mission_at_another_speed_are_those_of_that_mission(speed: Any) -> None:
    """With computers that draw 300 W a slow drive takes more than a quick one at its best."""
    known = replace(model(), covariance=None).with_term(HOTEL, 300.0)
    asked = replace(
        mission(), model=known, surfaces=None, payload_models={}, confidence=0.5, speed=0.2
    )
    slow = Legs(asked)
    slow.leg(0, 1, 0.0)
    before = slow.lower_bounds(0.0)[0, 1]
    other = slow.under(replace(asked, speed=speed))
    alone = Legs(other.mission)
    assert np.array_equal(other.lower_bounds(0.0), alone.lower_bounds(0.0))
    assert other.lower_bounds(0.0)[0, 1] <= other.leg(0, 1, 0.0).energy.mean < before


def test_shared_routes_have_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("energyplan.mission.routes._SHARED", 60_000)
    routes, asked = Routes(), replace(charging(), soc=0.9)
    for x in np.linspace(1.0, 1.9, 10):
        found = evaluate(replace(asked, start=(float(x), 2.5, 0.0)), routes=routes)
    assert routes.size <= 60_000
    assert 0 < len(routes) < 30
    assert found.energy == evaluate(found.mission).energy
    monkeypatch.setattr("energyplan.mission.routes._SCENES", 2)
    for speed in (0.5, 0.6, 0.7):
        evaluate(replace(asked, speed=speed), routes=routes)
    assert 0 < len(routes) <= 10  # of two scenes


def test_routes_are_planned_by_work_of_which_each_has_less_where_they_are_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, int | None]] = []

    def planned(problem: Any, planner: str, limit: float, *, effort: int | None) -> Any:
        asked.append((limit, effort))
        return plan(problem, planner, effort=300)

    monkeypatch.setattr(PLAN, planned)
    free = replace(mission(), planning_effort=None)
    one = free.tasks[0]
    many = replace(free, tasks=tuple(replace(one, name=f"{k}", payload=0.0) for k in range(25)))
    for each, expected in (
        (free, (np.inf, EFFORT)),
        (many, (np.inf, EFFORT // 2)),
        (replace(free, planning_effort=400), (np.inf, 400)),
        (replace(free, planning_time=3.0), (3.0, EFFORT)),
    ):
        Legs(each).leg(0, 1, 0.0)
        assert set(asked) == {expected}
        asked.clear()


def test_a_report_says_that_the_clock_stopped_its_planning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert not any("clock" in note for note in evaluate(mission()).warnings)
    monkeypatch.setattr(PLAN, lambda *a, **b: replace(plan(a[0], effort=300), stopped=True))
    assert any("stopped by the clock on" in note for note in evaluate(mission()).warnings)
