"""Missions of kinds that are easily forgotten, with answers in closed form: 180 J a metre."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from corridors import METRE, at, charger, corridor
from worlds import tiny

from energyplan.errors import MissionError
from energyplan.mission import Charger, Robot, RobotState, Task, evaluate
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap

ORDERS = pytest.mark.parametrize("order", ["given", "free"])


DOCKED = {"chargers": (charger(25, "dock"),)}
CASES: dict[str, tuple[dict[str, Any], tuple[Task, ...], float, tuple[str, ...]]] = {
    # what is changed, tasks, energy [J], the first stops in their order
    "a charger on the place of the task": (DOCKED, (at("end", 25.0),), 10 * METRE, ()),
    "and back from there": (
        {**DOCKED, "return_to": "start"}, (at("end", 25.0),), 20 * METRE, (),
    ),
    "a charger under the wheels": (
        {"chargers": (charger(15, "dock"),), "battery": tiny(25 * METRE), "soc": 0.2},
        (at("end", 25.0),), 20 * METRE, ("dock", "end"),
    ),
    "two tasks at one place": (
        {"battery": tiny(1e4)},
        (at("one", 25.0, dwell=30.0, power=20.0), at("two", 25.0, dwell=10.0, power=40.0)),
        20 * METRE + 1000.0, (),
    ),
    "beyond a charger: 17 m and 7 back to it are too far for one charge": (
        {**DOCKED, "battery": tiny(2970.0)},
        (at("near", 18.0), at("beyond", 32.0, required=False)), (10 + 7 + 7) * METRE,
        ("near", "dock", "beyond"),
    ),
}  # fmt: skip


@ORDERS
@pytest.mark.parametrize("name", CASES)
def test_what_is_easily_forgotten(name: str, order: str) -> None:
    """From 15 m with charge for 11 m, where nothing else is said."""
    changes, tasks, energy, stops = CASES[name]
    report = evaluate(corridor(11 * METRE, tasks, 15.0, order=order, **changes))
    assert report.left_out == ()
    assert report.energy == pytest.approx(energy, rel=1e-3)
    assert report.order[: len(stops)] == stops
    if changes is DOCKED:
        assert report.end == "dock"


@ORDERS
def test_a_charger_that_gives_less_than_standing_takes(order: str) -> None:
    """A charger's power is that at the terminals: hotel load is met before it."""
    model = PowerModel.preset("quadriga:empty:marble").with_term(HOTEL, 40.0)
    slow = Charger("dock", Pose(15.0, 1.5, 0.0), power=10.0, until=1.0)
    asked = corridor(
        3000.0, {"end": 20.0}, 15.0, order=order, soc=0.1, model=model, chargers=(slow,), speed=0.5
    )
    report = evaluate(asked)
    assert report.feasible
    (use,) = report.chargers
    assert use.duration == pytest.approx(0.9 * 3000 / 10.0, abs=0.2)


@ORDERS
def test_a_window_that_closed_before_the_start(order: str) -> None:
    tasks = at("late", 20.0, window=(0.0, 500.0)), at("fine", 25.0)
    asked = corridor(1e4, tasks, 15.0, order=order, time=1000.0, speed=0.5)
    report = evaluate(asked)
    assert (report.task("late").verdict, report.task("late").reason) == ("unreachable", "late")
    assert report.task("fine").verdict == "reachable"
    assert report.energy == pytest.approx(20 * METRE, rel=1e-3)
    (remedy,) = (r for r in report.task("late").remedies if r.kind == "window")
    assert remedy.amount is not None
    # 5 m at 0.5 m/s, and what speeding up takes; or first the other task, then 5 m back
    assert 510 <= remedy.amount <= (515 if order == "given" else 535)
    assert evaluate(asked.with_remedy(remedy)).task("late").verdict == "reachable"


@ORDERS
def test_a_window_of_one_instant(order: str) -> None:
    """It opens and closes at 100 s: the robot waits there and begins in time."""
    tasks = at("now", 20.0, window=(100.0, 100.0)), at("then", 25.0)
    report = evaluate(corridor(1e4, tasks, 15.0, order=order, speed=0.5))
    assert report.feasible
    assert report.task("now").start == pytest.approx(100.0)


@ORDERS
@pytest.mark.parametrize("height", [1.0, 2.5])
def test_down_a_slope_into_a_full_battery(order: str, height: float) -> None:
    """What comes back on the way down finds no room; the way up takes all of it from the battery.

    Down 10 m and up again: the sum is that of level ground, and what found no room beside it.
    """
    model = with_weight(PowerModel.preset("quadriga:empty:marble"))
    x = np.linspace(0, 35, 71)
    hill = HeightMap(np.tile(np.interp(x, [16, 24], [height, 0.0]), (8, 1)), 0.5)
    asked = corridor(1e5, {"below": 25.0}, 15.0, model=model, heights=hill, order=order)
    report = evaluate(asked)
    assert report.feasible
    weight = model.coefficients[[term.name for term in model.terms].index("grade")] * 9.81
    slope = float(np.hypot(8.0, height)) * METRE
    up = weight * height + slope + 2 * METRE
    # a metre on, down the slope and a metre on; what is more than full is lost
    below = 1 - METRE / 1e5 - (slope - weight * height) / 1e5
    lost = max(below - 1.0, 0.0) * 1e5
    assert report.energy == pytest.approx(2 * (slope + 2 * METRE) + lost, rel=2e-3)
    below = min(below, 1.0) - METRE / 1e5
    assert (below > 1 - METRE / 1e5 - 1e-9) == (height == 2.5)
    assert report.soc_end == pytest.approx(below - up / 1e5, abs=3e-4)
    # a battery for the sum alone does not do
    short = evaluate(replace(asked, battery=replace(asked.battery, capacity=0.99 * up / 10.0)))
    assert short.task("below").verdict == "unreachable"


@ORDERS
def test_a_payload_that_is_taken_and_left(order: str) -> None:
    """With 10 kg each metre takes half as much again; nothing is left before it is taken."""
    model = PowerModel.preset("quadriga:empty:marble")
    heavy = model.with_coefficients(1.5 * model.coefficients)
    take, leave = at("take", 20.0, payload=10.0), at("leave", 30.0, payload=-10.0)
    models = {model.name: {10.0: heavy}}
    asked = corridor(1e5, (take, leave), 15.0, order=order, model=model, payload_models=models)
    report = evaluate(asked)
    assert report.feasible
    assert report.energy == pytest.approx((5 + 1.5 * 10 + 15) * METRE, rel=1e-3)
    turned = evaluate(replace(asked, tasks=(leave, take)))
    if order == "free":
        assert turned.order == ("take", "leave")
        assert turned.proven
        assert turned.energy == pytest.approx(report.energy)
    else:
        assert turned.task("leave").verdict == "unreachable"
        assert "takes the payload on board" in turned.task("leave").remedy
        assert (turned.task("leave").reason, turned.task("leave").reachable_alone) == (
            "payload", False,
        )  # fmt: skip
        assert "it leaves 10 kg, and 0 kg are on board" in turned.task("leave").detail


@ORDERS
def test_what_was_given_up_cannot_be_left(order: str) -> None:
    """The robot goes on without the payload; what it drives never weighs less than itself."""
    take, leave = at("take", 20.0, payload=10.0), at("leave", 30.0, payload=-500.0)
    asked = corridor(1e5, (take, leave, at("look", 10.0)), 15.0, order=order)
    told = evaluate(asked.resume(asked.start, 1.0, ["take"], payload=0.0))
    assert {one.name: one.reason for one in told.tasks} == {"leave": "payload", "look": "none"}
    alone = evaluate(corridor(1e5, {"look": 10.0}, 15.0, order=order))
    assert told.energy == pytest.approx(alone.energy)
    with pytest.raises(MissionError, match="leave 500 kg more than was ever on board"):
        asked.resume(asked.start, 1.0, ["leave"])
    both = replace(asked, robots=(Robot("one"),))
    state = RobotState(asked.start, 1.0, ("leave",))
    with pytest.raises(MissionError, match="leave 500 kg more than was ever on board"):
        both.resume_robots({"one": state})


@ORDERS
def test_tasks_that_take_the_last_joule(order: str) -> None:
    """28 m there and back, and a battery for a hair more or less."""
    for share, verdict in ((1.002, "reachable"), (0.99, "unreachable")):
        asked = corridor(share * 28 * METRE, {"end": 29.0}, 15.0, order=order)
        assert evaluate(asked).task("end").verdict == verdict


def test_a_task_that_lasts_for_years_is_out_of_reach() -> None:
    years = at("end", 25.0, dwell=1e8, power=30.0)
    (task,) = evaluate(corridor(25 * METRE, (years,), 15.0)).tasks
    assert (task.verdict, task.reason) == ("unreachable", "battery")


def test_energies_that_cancel_do_not_blow_the_power_up() -> None:
    """Up and down a hill the energy nearly cancels; the uncertainty of the power does not."""
    x = np.linspace(0, 35, 71)
    hill = np.interp(x, [0, 7, 11, 24, 35], [0.0, 0.0, 0.3, -1.1, -1.1])
    model = with_weight(PowerModel.preset("quadriga:empty:marble"))
    asked = corridor(
        1e6, {"below": 25.0}, 5.0, model=model, heights=HeightMap(np.tile(hill, (8, 1)), 0.5),
        confidence=0.95, coefficient_spread=0.05, return_to="any",
    )  # fmt: skip
    report = evaluate(asked)
    line = report.timeline
    there = line.t <= report.task("below").start
    # the charge at the bound never falls faster than a quarter above what is expected at most
    moving = np.diff(line.t[there]) > 0
    step = np.diff(line.t[there])[moving]
    fall = -np.diff(line.soc[there])[moving] / step
    bound = -np.diff(line.soc_lower[there])[moving] / step
    assert bound.max() < 1.35 * fall.max()
    assert report.energy_upper > report.energy
