"""Batteries that are not the library's own, and remedies that a program applies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from statistics import NormalDist
from typing import Any, get_args

import numpy as np
import pytest
from by_day import by_day
from corridors import METRE, at, charger, corridor
from numpy.typing import ArrayLike
from troubled_missions import trials
from worlds import tiny

from energyplan.battery import BatteryRun
from energyplan.errors import MissionError
from energyplan.mission import Mission, MissionReport, Remedy, Routes, Spreads, evaluate
from energyplan.mission.types import RemedyKind
from energyplan.output import documents
from energyplan.path import FloatArray
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.power import HOTEL, PowerModel


@dataclass(frozen=True)
class Bucket:
    """A battery without voltage: energy goes in and out."""

    full_energy: float
    cutoff_soc: float = 0.0
    charge_efficiency: float = 1.0

    def simulate(
        self, t: ArrayLike, power: ArrayLike, *, soc: float = 1.0, polarisation: float = 0.0
    ) -> BatteryRun:
        times, load = np.asarray(t, float), np.asarray(power, float)
        spent = np.concatenate([[0.0], np.cumsum(load[:-1] * np.diff(times))]) / self.full_energy
        left = soc - spent
        empty = np.flatnonzero(left < self.cutoff_soc - 1e-12)
        died = float(times[empty[0]]) if len(empty) else np.inf
        level, none = np.clip(left, self.cutoff_soc, 1.0), np.zeros(len(times))
        reason = "charge" if len(empty) else "none"
        return BatteryRun(times, level, none, none, none, none, died, reason, polarisation)

    def usable_energy(self, power: ArrayLike, soc: ArrayLike = 1.0) -> FloatArray:
        _, start = np.broadcast_arrays(np.asarray(power, float), np.asarray(soc, float))
        return np.asarray(self.full_energy * np.maximum(start - self.cutoff_soc, 0.0))

    def larger(self, energy: float) -> Bucket:
        return Bucket(self.full_energy + energy, self.cutoff_soc, self.charge_efficiency)


@pytest.mark.parametrize("battery", [tiny(2970.0), Bucket(2970.0)], ids=["ours", "own"])
@pytest.mark.parametrize("order", ["given", "free"])
def test_any_battery_goes_from_charger_to_charger(order: str, battery: Any) -> None:
    """10 m to the first, 10 m to the second, 4 m to the task: no hop may take more than 16.5 m."""
    asked = corridor(
        1.0, {"end": 29.0}, 5.0, order=order, battery=battery,
        chargers=(charger(15, "near"), charger(25, "far")),
    )  # fmt: skip
    report = evaluate(asked)
    assert report.order == ("near", "far", "end", "far")
    assert report.energy == pytest.approx(METRE * (10 + 10 + 4 + 4), rel=1e-3)
    assert report.soc_end == pytest.approx(1 - METRE * 8 / 2970, rel=1e-3)


def test_the_remedy_of_a_battery_of_ones_own_is_sized_by_it() -> None:
    """24 m there and back take 8640 J; the bucket holds 5000 J."""
    told = evaluate(corridor(1.0, {"end": 29.0}, 5.0, battery=Bucket(5000.0))).task("end")
    assert told.reason == "battery"
    assert told.shortfall == pytest.approx(8640 - 5000, rel=1e-3)
    assert "a battery with 2 Wh more" in told.remedy


TASKS = {"a": 11.0, "b": 17.0, "c": 29.0}
"""Places along the corridor [m]; the start is at 5 m."""


def troubled() -> dict[str, Mission]:
    """Missions with tasks that cannot be done, each for another reason."""
    asked = {
        "far": corridor(5000.0, {"end": 29.0}, 5.0),
        "reserve": corridor(9500.0, {"end": 29.0}, 5.0, reserve=0.2),
        "charge": corridor(9000.0, {"end": 29.0}, 5.0, soc=0.6),
        "row": corridor(7000.0, TASKS, 5.0),
        "back and forth": corridor(11000.0, {"a": 29.0, "b": 6.0, "c": 28.0}, 5.0),
        "short of all": corridor(1500.0, TASKS, 5.0, soc=0.9, reserve=0.1),
        "current": corridor(
            1e5, TASKS, 5.0, speed=1.0, battery=replace(tiny(1e5), max_discharge_current=9.0)
        ),
        "wasteful": corridor(
            12000.0, TASKS, 5.0, speed=0.3,
            model=PowerModel.preset("quadriga:empty:marble").with_term(HOTEL, 60.0),
        ),
    }  # fmt: skip
    for name, degrees in {"cold": -5.0, "hot": 50.0}.items():
        pack = replace(
            tiny(2970.0), temperature=degrees, min_charge_temperature=0.0,
            max_charge_temperature=45.0,
        )  # fmt: skip
        asked[name] = corridor(
            1.0, {"end": 29.0}, 5.0, battery=pack, chargers=(charger(15, "a"), charger(25, "b"))
        )
    soon, long = at("soon", 25.0, window=(0.0, 60.0)), at("long", 29.0, dwell=100.0)
    asked["late"] = corridor(1e6, (soon,), 5.0, speed=0.25)
    asked["late in turn"] = corridor(1e6, (long, soon), 5.0, speed=0.5)
    weighed = at("optional", 5.0, required=False), at("required", 25.0)
    asked["given up"] = corridor(6000.0, weighed, 15.0)
    return asked


@cache
def reported(name: str, order: str) -> MissionReport:
    return evaluate(replace(troubled()[name], order=order))


@pytest.mark.parametrize("order", ["given", "free"])
@pytest.mark.parametrize("name", list(troubled()))
def test_every_remedy_that_is_told_holds(name: str, order: str) -> None:
    report = reported(name, order)
    asked, told = report.mission, [t for t in report.tasks if t.verdict == "unreachable"]
    for task in told:
        assert task.remedies, task
        for remedy in task.remedies:
            assert str(remedy) in task.remedy
            again = evaluate(asked.with_remedy(remedy)).task(task.name)
            assert again.verdict == "reachable", (task.name, remedy)
    if order == "given":
        assert told
    if name == "given up":
        assert report.feasible
        assert [(task.name, task.reason) for task in told] == [("optional", "blocked_by_earlier")]


@pytest.mark.parametrize("order", ["given", "free"])
def test_what_takes_no_charge_is_said_where_charge_is_needed_and_where_not(order: str) -> None:
    cold = replace(troubled()["cold"], order=order)
    report = evaluate(cold)
    told = report.task("end")
    assert (told.verdict, told.reason) == ("unreachable", "battery")
    assert "the battery is at -5 degC and is charged from 0 to 45 degC only" in told.detail
    assert told.remedy.startswith("charge at a battery temperature of 0 degC, or")
    said = "no charge at 'a', 'b': the battery is at -5 degC"
    assert [one for one in report.warnings if one.startswith(said)]
    rich = evaluate(replace(cold, battery=replace(cold.battery, capacity=3600.0)))
    assert rich.feasible
    assert [one for one in rich.warnings if one.startswith(said)]
    warm = replace(cold, battery=replace(cold.battery, temperature=0.0))
    indoors = replace(cold, chargers=tuple(replace(c, temperature=20.0) for c in cold.chargers))
    for asked in (warm, indoors):
        again = evaluate(asked)
        assert again.order == ("a", "b", "end", "b")
        assert not [one for one in again.warnings if "no charge" in one]


def test_each_kind_of_remedy_is_told_of_some_mission() -> None:
    reports = [evaluate(charged()), *(reported(name, "given") for name in troubled())]
    kinds = {
        (remedy.kind, remedy.amount is None, remedy.unit, remedy.where)
        for report in reports
        for remedies in (report.remedies, *(task.remedies for task in report.tasks))
        for remedy in remedies
    }
    assert {kind for kind, *_ in kinds} == set(get_args(RemedyKind))
    assert len(get_args(RemedyKind)) == 7
    for of_two in (("capacity", False, "1", "start"), ("speed", True, "", "start"),
                   ("charge", False, "1", "chargers")):  # fmt: skip
        assert of_two in kinds


@pytest.mark.parametrize("drawn", by_day([((6,), 2), ((1, 5, 6, 9, 10), 18)], [((6,), 2)]))
def test_remedies_hold_where_everything_is_uncertain(drawn: tuple[tuple[int, ...], int]) -> None:
    """Real batteries, windows, chargers, given and free orders, all at 90 %."""
    seeds, least = drawn
    tried = list(trials(seeds))
    assert len(tried) >= least
    assert [trial for trial in tried if not trial.holds] == []


def test_what_is_open_about_a_larger_battery_is_its_own() -> None:
    """3 % of the charge is more energy in a larger battery; the remedy allows for it."""
    asked = corridor(
        5000.0, {"end": 29.0}, 5.0, confidence=0.95, coefficient_spread=1e-9,
        spreads=replace(Spreads.none(), soc=0.03),
    )  # fmt: skip
    (remedy,) = (r for r in evaluate(asked).tasks[0].remedies if r.kind == "capacity")
    assert remedy.amount is not None
    quantile = NormalDist().inv_cdf(0.95)
    # 48 m there and back out of what the gauge leaves
    needed = 48 * METRE / (1.0 - quantile * 0.03) - 5000.0
    assert needed <= remedy.amount <= needed + 3600.0
    assert evaluate(asked.with_remedy(remedy)).feasible


def test_where_power_is_the_limit_the_remedy_names_power() -> None:
    """9 A at 10 V are 90 W; 180 N at 1 m/s take 180 W, and the battery holds far more energy."""
    asked = troubled()["current"]
    told = evaluate(asked).tasks[0]
    assert told.shortfall == 0
    (battery,) = (remedy for remedy in told.remedies if remedy.kind == "capacity")
    assert battery.unit == "1" and "Wh more" not in told.remedy
    assert battery.amount == pytest.approx(2.0, rel=0.03)
    assert "2 times the strings in parallel" in told.remedy
    # capacity alone, with the currents as they are, does not help
    battery = asked.battery
    fuller = replace(asked, battery=replace(battery, capacity=3 * battery.capacity))
    assert evaluate(fuller).tasks[0].verdict == "unreachable"


def test_another_speed_is_told_with_the_routes_that_are_planned_for_it(monkeypatch) -> None:
    """Energy depends on speed, so routes may: the mission with the remedy plans none anew."""
    planned: list[float | None] = []

    def watched(problem: PlanningProblem, *args: Any, **options: Any) -> Plan:
        planned.append(problem.cost.speed)
        return plan(problem, *args, **options)

    monkeypatch.setattr("energyplan.mission.routes.plan", watched)
    for name in ("current", "late"):
        asked = troubled()[name]
        asked = replace(asked, map=replace(asked.map))  # on which no route is known
        routes = Routes()
        tasks = evaluate(asked, routes=routes).tasks
        told = [remedy for task in tasks for remedy in task.remedies]
        speed = min(remedy.amount for remedy in told if remedy.kind == "speed" and remedy.amount)
        assert speed in planned
        planned.clear()
        assert evaluate(asked.with_remedy(Remedy("speed", speed, "m/s")), routes=routes).feasible
        assert planned == []


def charged(**changes: Any) -> Mission:
    """Two tools far from each other that need most of 1 kWh each, charged at 500 W in between."""
    docks = (charger(5.0, "near"), charger(29.0, "far"))
    work = at("a", 6.0, dwell=4000.0, power=300.0), at("b", 28.0, dwell=2000.0, power=500.0)
    return corridor(
        3.6e6, work, 5.0, soc=0.5, reserve=0.2,
        chargers=tuple(replace(one, until=0.9) for one in docks), **changes,
    )  # fmt: skip


@pytest.mark.parametrize("order", ["given", "free"])
def test_charging_no_further_than_needed_is_proposed_with_the_minutes_that_it_saves(order) -> None:
    """2.2 MJ and the drives, 1.08 MJ of them on board above the reserve.

    Of the levels in whole per cent around it, and of others, the one proposed takes the least time.
    """
    asked = charged(order=order)
    report = evaluate(asked)
    (remedy,) = report.remedies
    assert remedy == Remedy("charge", remedy.amount, "1", where="chargers")
    best = round(100 * remedy.amount)
    tried = {
        percent: evaluate(asked.with_remedy(Remedy("charge", percent / 100, "1", where="chargers")))
        for percent in (best - 10, best - 2, best - 1, best, best + 1, best + 2, best + 10, 90)
    }
    lasting = {percent: one.duration for percent, one in tried.items() if one.feasible}
    assert remedy.amount == pytest.approx(min(lasting, key=lasting.__getitem__) / 100)
    shortest = min(lasting.values())
    assert report.time_saved == pytest.approx(report.duration - shortest)
    minutes = f"{report.time_saved / 60:.0f} min less"
    told = f"leave the chargers at {100 * remedy.amount:.0f} %: {minutes}"
    assert told in report.sentence
    document = documents.mission(report)
    assert document["remedies"] == [{"kind": "charge", "amount": remedy.amount, "unit": "1",
                                     "task": "", "where": "chargers"}]  # fmt: skip
    assert document["time_saved"] == report.time_saved
    assert evaluate(asked.with_remedy(remedy)).remedies == ()


def test_a_remedy_for_another_mission_is_refused() -> None:
    with pytest.raises(MissionError, match="no task is called 'x'"):
        troubled()["far"].with_remedy(Remedy("drop", task="x"))
