"""Missions of kinds that are easily forgotten, with answers in closed form: 180 J a metre."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_corridor import METRE, charger, corridor

from energyplan.mission import Charger, Mission, Task, evaluate
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap

ORDERS = pytest.mark.parametrize("order", ["given", "free"])


def at(name: str, x: float, **changes: Any) -> Task:
    return Task(name, Pose(x, 1.5, 0.0), **changes)


def with_tasks(mission: Mission, *tasks: Task) -> Mission:
    return replace(mission, tasks=tasks)


@ORDERS
def test_a_charger_on_the_place_of_a_task(order: str) -> None:
    """The battery holds 11 m; the task is 10 m away, and so is the charger."""
    asked = corridor(11 * METRE, {"end": 25.0}, 15.0, order=order, chargers=(charger(25, "dock"),))
    report = evaluate(asked)
    assert report.feasible
    assert report.end == "dock"
    assert report.energy == pytest.approx(10 * METRE, rel=1e-3)
    back = evaluate(replace(asked, return_to="start"))
    assert back.feasible
    assert back.energy == pytest.approx(20 * METRE, rel=1e-3)
    assert [use.name for use in back.chargers if use.visits] == ["dock"]


@ORDERS
def test_a_robot_that_stands_on_a_charger_charges_before_it_leaves(order: str) -> None:
    """20 m there and back, and charge for 5; the dock is under the wheels."""
    asked = corridor(
        25 * METRE, {"end": 25.0}, 15.0, order=order, soc=0.2, chargers=(charger(15, "dock"),)
    )
    report = evaluate(asked)
    assert report.feasible
    assert report.energy == pytest.approx(20 * METRE, rel=1e-3)


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
def test_two_tasks_at_one_place(order: str) -> None:
    asked = with_tasks(
        corridor(1e4, {"x": 20.0}, 15.0, order=order),
        at("one", 25.0, dwell=30.0, power=20.0), at("two", 25.0, dwell=10.0, power=40.0),
    )  # fmt: skip
    report = evaluate(asked)
    assert report.feasible
    assert report.energy == pytest.approx(20 * METRE + 1000.0, rel=1e-3)


@ORDERS
def test_a_window_that_closed_before_the_start(order: str) -> None:
    asked = with_tasks(
        corridor(1e4, {"x": 20.0}, 15.0, order=order, time=1000.0, speed=0.5),
        at("late", 20.0, window=(0.0, 500.0)), at("fine", 25.0),
    )  # fmt: skip
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
    asked = with_tasks(
        corridor(1e4, {"x": 20.0}, 15.0, order=order, speed=0.5),
        at("now", 20.0, window=(100.0, 100.0)), at("then", 25.0),
    )  # fmt: skip
    report = evaluate(asked)
    assert report.feasible
    assert report.task("now").start == pytest.approx(100.0)


@ORDERS
@pytest.mark.parametrize("height", [1.0, 2.5])
def test_down_a_slope_into_a_full_battery(order: str, height: float) -> None:
    """What comes back on the way down finds no room; the way up takes all of it from the battery.

    Down 10 m and up again: the sum is that of level ground, the battery gives more.
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
    assert report.energy == pytest.approx(2 * (slope + 2 * METRE), rel=2e-3)
    # a metre on, down the slope and a metre on; what is more than full is lost
    below = 1 - METRE / 1e5
    below = min(below - (slope - weight * height) / 1e5, 1.0) - METRE / 1e5
    assert (below > 1 - METRE / 1e5 - 1e-9) == (height == 2.5)
    assert report.soc_end == pytest.approx(below - up / 1e5, abs=3e-4)
    # a battery for the sum alone does not do
    short = evaluate(replace(asked, battery=replace(asked.battery, capacity=0.99 * up / 10.0)))
    assert short.task("below").verdict == "unreachable"


@ORDERS
def test_an_optional_task_beyond_a_charger(order: str) -> None:
    """17 m to the task and 7 back to the charger are too far for one charge, not for two."""
    asked = with_tasks(
        corridor(2970.0, {"x": 9.0}, 5.0, order=order, chargers=(charger(15, "dock"),)),
        at("near", 8.0), at("beyond", 22.0, required=False),
    )  # fmt: skip
    report = evaluate(asked)
    assert report.task("beyond").verdict == "reachable"
    assert report.order[:3] == ("near", "dock", "beyond")
    assert report.energy == pytest.approx((10 + 7 + 7) * METRE, rel=1e-3)


@ORDERS
def test_a_payload_that_is_taken_and_left(order: str) -> None:
    """With 10 kg each metre takes half as much again; nothing is left before it is taken."""
    model = PowerModel.preset("quadriga:empty:marble")
    heavy = model.with_coefficients(1.5 * model.coefficients)
    asked = corridor(
        1e5, {"x": 20.0}, 15.0, order=order, model=model,
        payload_models={model.name: {10.0: heavy}},
    )  # fmt: skip
    take, leave = at("take", 20.0, payload=10.0), at("leave", 30.0, payload=-10.0)
    report = evaluate(with_tasks(asked, take, leave))
    assert report.feasible
    assert report.energy == pytest.approx((5 + 1.5 * 10 + 15) * METRE, rel=1e-3)
    turned = evaluate(with_tasks(asked, leave, take))
    if order == "free":
        assert turned.order == ("take", "leave")
        assert turned.proven
        assert turned.energy == pytest.approx(report.energy)
    else:
        assert turned.task("leave").verdict == "unreachable"
        assert "takes the payload on board" in turned.task("leave").remedy


@ORDERS
def test_tasks_that_take_the_last_joule(order: str) -> None:
    """28 m there and back, and a battery for a hair more or less."""
    for share, verdict in ((1.002, "reachable"), (0.99, "unreachable")):
        asked = corridor(share * 28 * METRE, {"end": 29.0}, 15.0, order=order)
        assert evaluate(asked).task("end").verdict == verdict


def test_a_task_that_lasts_for_years_is_out_of_reach() -> None:
    asked = corridor(25 * METRE, {"end": 25.0}, 15.0)
    report = evaluate(with_tasks(asked, at("end", 25.0, dwell=1e8, power=30.0)))
    assert report.tasks[0].verdict == "unreachable"
    assert report.tasks[0].reason == "battery"
