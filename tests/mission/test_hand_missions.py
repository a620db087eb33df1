"""Sixty missions whose answers are worked out here: by enumeration, closed form, or small steps.

The legs of a corridor cost 180 J a metre, so the best order, subset and charging stops can be
enumerated by lines of arithmetic that share nothing with the library.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from by_day import by_day
from corridors import METRE, at, charger, corridor
from worlds import tiny

from energyplan.mission import Mission, evaluate
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import VISCOUS_LOSS

START = 15.0


def tour(mission: Mission, stops: list[tuple[str, float]]) -> float | None:
    """Energy of a tour along the corridor [J], or None if the battery does not last for it."""
    full = mission.battery.full_energy
    floor = mission.reserve * full
    docks = {c.name: c.pose.x for c in mission.chargers}
    here, left, spent = mission.start.x, mission.soc * full, 0.0
    ends = [mission.start.x, *docks.values()]
    for name, x in stops:
        use = METRE * abs(x - here)
        left, spent, here = left - use, spent + use, x
        if name in docks:
            if left < floor - 1e-6:
                return None
            left = max(left, full)
        else:
            work = next(t.power * t.dwell for t in mission.tasks if t.name == name)
            left, spent = left - work, spent + work
            if left - METRE * min(abs(x - end) for end in ends) < floor - 1e-6:
                return None
    home = METRE * min(abs(here - end) for end in ends)
    return None if left - home < floor - 1e-6 else spent + home


def enumerated(mission: Mission) -> tuple[float, float]:
    """Return worth and energy of the best tour, of all subsets, orders and charges."""
    tasks = {task.name: task for task in mission.tasks}
    whole = 1.0 + sum(task.prize for task in mission.tasks)
    names, best = list(tasks), (-1.0, np.inf)
    for count in range(len(names) + 1):
        for order in permutations(names, count):
            if mission.order == "given" and list(order) != [n for n in names if n in order]:
                continue
            worth = sum(tasks[n].prize + whole * tasks[n].required for n in order)
            for charges in product((None, *mission.chargers), repeat=count + 1):
                stops: list[tuple[str, float]] = []
                for dock, name in zip(charges, (*order, None), strict=True):
                    stops += [] if dock is None else [(dock.name, dock.pose.x)]
                    stops += [] if name is None else [(name, tasks[name].pose.x)]
                energy = tour(mission, stops)
                if energy is not None and (-worth, energy) < (-best[0], best[1] - 1e-6):
                    best = worth, energy
    return best


def drawn(seed: int, order: str) -> Mission:
    """A mission by chance: three tasks, up to one charger, some of them optional, any battery."""
    rng = np.random.default_rng(seed)
    places = rng.choice(np.arange(4, 31), 3, replace=False).astype(float)
    tasks = tuple(
        at(f"t{k}", float(x), prize=float(rng.integers(1, 5)), required=bool(rng.random() < 0.4),
           dwell=float(rng.choice([0.0, 60.0])), power=10.0)
        for k, x in enumerate(places)
    )  # fmt: skip
    docks = (charger(float(rng.integers(5, 30)), "dock"),) if rng.random() < 0.5 else ()
    return corridor(
        float(rng.uniform(1500, 9000)), tasks, START, soc=float(rng.uniform(0.4, 1.0)),
        reserve=float(rng.choice([0.0, 0.1])), order=order, chargers=docks,
    )  # fmt: skip


@pytest.mark.parametrize("order", ["given", "free"])
@pytest.mark.parametrize("seed", by_day(range(20), range(4)))
def test_the_best_of_all_tours_is_found(seed: int, order: str) -> None:
    asked = drawn(seed, order)
    (best, least), report = enumerated(asked), evaluate(asked)
    whole = 1.0 + sum(task.prize for task in asked.tasks)
    worth = sum(
        task.prize + whole * task.required
        for task in asked.tasks
        if report.task(task.name).verdict == "reachable"
    )
    assert worth == pytest.approx(max(best, 0.0))
    if order == "free":
        assert report.proven
        assert report.energy == pytest.approx(least, rel=2e-3)
    else:
        assert report.energy >= least * (1 - 2e-3)


# -- closed forms --------------------------------------------------------------------------------

CLOSED: dict[str, tuple[dict[str, Any], float, float]] = {
    # what is changed, energy [J], state of charge at the end; 14 m there and back, 1e4 J
    "plain": ({}, 28 * METRE, 1 - 28 * METRE / 1e4),
    "start at 60 %": ({"soc": 0.6}, 28 * METRE, 0.6 - 28 * METRE / 1e4),
    "tool": ({"tool": (100.0, 20.0)}, 28 * METRE + 2000, 1 - (28 * METRE + 2000) / 1e4),
    "idle tool": ({"tool": (0.0, 20.0)}, 28 * METRE, 1 - 28 * METRE / 1e4),
    "dwell without a tool": ({"tool": (50.0, 0.0)}, 28 * METRE, 1 - 28 * METRE / 1e4),
    "waiting without hotel load": ({"waiting": 60.0}, 28 * METRE, 1 - 28 * METRE / 1e4),
    "other home": ({"home": Pose(25.0, 1.5, 0.0)}, 18 * METRE, 1 - 18 * METRE / 1e4),
    "start is the task": ({"at": START}, 0.0, 1.0),
    "behind": ({"at": 5.0}, 20 * METRE, 1 - 20 * METRE / 1e4),
    "slowly": ({"speed": 0.2}, 28 * METRE, 1 - 28 * METRE / 1e4),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_task_in_closed_form(name: str) -> None:
    changes, energy, soc = CLOSED[name]
    changes = dict(changes)
    dwell, power = changes.pop("tool", (0.0, 0.0))
    task = at("end", changes.pop("at", 29.0), dwell=dwell, power=power)
    report = evaluate(corridor(1e4, (task,), START, **changes))
    assert report.feasible
    assert (report.order, report.end) == (("end",), "home" if "home" in changes else "start")
    assert report.energy == pytest.approx(energy, rel=1e-3, abs=1e-6)
    assert report.soc_end == pytest.approx(soc, abs=1e-3)
    # at confidence 0.5 nothing is held back
    assert report.soc_end_lower == pytest.approx(report.soc_end, abs=1e-12)


# -- small steps ---------------------------------------------------------------------------------


def stepped(report: Any, resistance: float, volts: float, charge: float) -> float:
    """State of charge after the mission's power through a resistance, second by second."""
    line, left = report.timeline, charge
    for begin, end, power in zip(line.t[:-1], line.t[1:], line.power[:-1], strict=True):
        count = max(int(np.ceil(end - begin)), 1)
        for _ in range(count):
            current = (volts - np.sqrt(volts**2 - 4 * resistance * power)) / (2 * resistance)
            left -= current * (end - begin) / count
    return left / charge


@pytest.mark.parametrize("resistance", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("hotel", [0.0, 15.0, 40.0])
def test_a_battery_with_resistance_in_small_steps(resistance: float, hotel: float) -> None:
    model = PowerModel.preset("quadriga:empty:marble")
    model = model.with_term(HOTEL, hotel) if hotel else model
    pack = replace(tiny(6e4), resistance=resistance, ocv_points=np.array([30.0, 30.0]))
    task = at("end", 25.0, dwell=120.0, power=25.0)
    report = evaluate(corridor(6e4, (task,), START, model=model, battery=pack, speed=0.4))
    assert report.feasible
    told = 20 * METRE + 120 * 25.0 + hotel * report.duration
    assert report.energy == pytest.approx(told, rel=2e-3)
    charge = pack.available_capacity
    assert report.soc_end == pytest.approx(stepped(report, resistance, 30.0, charge), abs=1e-5)


# -- windows, partial charges, hurry ---------------------------------------------------------------


@pytest.mark.parametrize("order", ["given", "free"])
def test_charging_ends_in_time_for_a_window(order: str) -> None:
    """The dock is 10 m ahead, the task 10 m further; a whole charge would take too long."""
    docks = (charger(25.0, "dock"),)
    asked = corridor(4000.0, {"end": 29.0}, START, speed=0.5, soc=0.6, order=order, chargers=docks)
    # 10 m take 1800 of 2400 J; the task and the way back to the dock take 1440 J: 840 J are missing
    whole = evaluate(asked)
    assert whole.order == ("dock", "end", "dock")
    (use,) = whole.chargers
    assert use.energy == pytest.approx(4000 - 600, rel=0.02)
    assert use.duration == pytest.approx(3400 / 500, abs=0.11)
    arrival = whole.task("end").arrival
    shut = replace(asked.tasks[0], window=(0.0, arrival - 2.5))
    pressed = evaluate(replace(asked, tasks=(shut,)))
    assert pressed.task("end").verdict == "reachable"
    assert pressed.task("end").arrival <= arrival - 2.5 + 1e-6
    (part,) = pressed.chargers
    assert part.duration < use.duration
    assert pressed.soc_end >= -1e-9


@pytest.mark.parametrize("order", ["given", "free"])
def test_a_robot_hurries_where_a_window_presses(order: str) -> None:
    """With viscous loss there is a cheapest speed; the window asks for more."""
    model = PowerModel.preset("quadriga:empty:marble").with_term(VISCOUS_LOSS, 60.0)
    model = model.with_term(HOTEL, 10.0)
    calm = corridor(1e5, {"end": 29.0}, 5.0, model=model, order=order, speed="cheapest")
    slow = evaluate(calm)
    quickest = evaluate(replace(calm, speed=float(calm.vehicle.motor.speed)))
    assert quickest.task("end").arrival < 0.999 * slow.task("end").arrival
    between = 0.5 * (quickest.task("end").arrival + slow.task("end").arrival)
    shut = replace(calm.tasks[0], window=(0.0, between))
    lines: list[str] = []
    report = evaluate(replace(calm, tasks=(shut,)), lines.append)
    assert report.task("end").verdict == "reachable"
    assert report.paths == slow.paths  # of which one route is known
    assert len({line for line in lines if line.startswith("planning")}) <= 1
    assert report.task("end").arrival == pytest.approx(quickest.task("end").arrival, rel=1e-3)
    assert report.energy > slow.energy


def test_an_order_that_is_not_proven_tells_its_gap() -> None:
    """A battery with resistance lasts for less than its charge says: the bound stays open.

    To the task and back are 28 m, for which the charge would last without losses. With them the
    robot charges first, 3 m behind it.
    """
    pack = replace(tiny(6000.0), resistance=0.025)
    docks = (charger(12.0, "dock"),)
    asked = corridor(6000.0, {"end": 29.0}, START, battery=pack, soc=0.85, order="free",
                     chargers=docks)  # fmt: skip
    report = evaluate(asked)
    assert report.order == ("dock", "end")
    assert not report.proven
    assert report.gap == pytest.approx(1 - 28 / 34, rel=2e-3)
    lossless = evaluate(replace(asked, battery=tiny(6000.0)))
    assert lossless.order == ("end",)
    assert lossless.proven
    assert lossless.gap == 0.0
