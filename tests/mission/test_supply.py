"""What a battery gives and takes is the same in the search, the simulation and the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from battery_missions import worse
from corridors import at, corridor

from energyplan.battery import Battery
from energyplan.mission import Charger, Mission, evaluate
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap

PACK = Battery.of("24 V 20 Ah lead-acid")


def docked(power: float, *tasks: object, **changes: object) -> Mission:
    """Return a mission along the corridor with a charger where it starts, on a pack by name."""
    dock = Charger("dock", Pose(3.0, 1.5, 0.0), power)
    values = {"battery": PACK, "soc": 0.55, "reserve": 0.2, "chargers": (dock,), **changes}
    return corridor(1.0, tuple(tasks), 3.0, **values)


@pytest.mark.parametrize("power", [100.0, 150.0, 600.0])
def test_a_charger_gives_what_the_battery_takes(power: float) -> None:
    report = evaluate(docked(power, at("A", 10, dwell=3600, power=250.0), soc=0.3))
    taken = sum(
        float(np.trapezoid(-run.voltage * run.current, run.t))
        for part in report.charges
        for run in [PACK.simulate(np.arange(0.0, part.arrival - part.departure, 1.0),
                                  np.full(int(np.ceil(part.arrival - part.departure)), -power),
                                  soc=float(part.soc[0]))]
    )  # fmt: skip
    (dock,) = report.chargers
    assert dock.visits >= 1
    assert dock.energy == pytest.approx(taken, rel=2e-3)
    assert dock.energy < PACK.full_energy * dock.visits
    line = report.timeline
    given = line.power[:-1] @ np.diff(line.t)
    assert given == pytest.approx(report.energy - dock.energy, rel=1e-9)


def test_what_a_battery_does_not_take_back_is_in_the_energy() -> None:
    warm = Battery.of("25.6 V 20 Ah LiFePO4")
    model = with_weight(PowerModel.preset("quadriga:empty:marble"))
    heights = HeightMap(np.tile(0.3 * np.abs(np.arange(36.0) - 18.0), (4, 1)), 1.0)
    asked = corridor(1.0, (at("A", 8),), 28.0, battery=warm, soc=0.8, heights=heights, model=model)
    cold = evaluate(replace(asked, battery=replace(warm, temperature=-5.0)))
    drives = [part for part in cold.trip if part.kind == "drive"]
    assert sum(part.energy for part in drives) == pytest.approx(cold.energy, rel=1e-12)
    assert min(float(part.power.min()) for part in drives) >= -1e-9
    assert evaluate(asked).energy < cold.energy
    returned = sum(float(p.leg.consumption.power.clip(max=0) @ np.diff(p.t)) for p in drives)
    assert returned < 0.0
    assert all(np.diff(part.soc).max() <= 1e-12 for part in drives)


@pytest.mark.parametrize("power", [100.0, 150.0, 600.0])
def test_a_stronger_charger_takes_no_task_away(power: float) -> None:
    tasks = (
        at("A", 4, dwell=1800, power=200.0, window=(0, 3000)),
        at("B", 10, dwell=1800, power=200.0),
    )
    free, given = (evaluate(docked(power, *tasks, order=order)) for order in ("free", "given"))
    assert free.feasible and given.feasible
    assert free.energy <= given.energy * (1 + 1e-6)


@pytest.mark.parametrize("order", ["free", "given"])
def test_a_task_beyond_the_power_of_the_battery_is_left_out_alone(order: str) -> None:
    beyond = 1.2 * PACK.max_discharge_current * float(PACK.ocv(1.0))
    tasks = (
        at("A", 6, dwell=600, power=100.0),
        at("B", 10, dwell=60, power=beyond),
        at("C", 14, dwell=600, power=100.0),
    )
    report = evaluate(docked(200.0, *tasks, soc=0.9, order=order))
    assert [task.name for task in report.left_out] == ["B"]
    assert report.task("B").reason == "battery"
    assert "current" in report.task("B").detail


def test_a_task_near_the_power_of_the_battery_is_done_after_a_charge() -> None:
    small = replace(PACK, max_discharge_current=np.inf, resistance=0.4, pair_resistance=0.0)
    run = [small.simulate([0.0, 20.0], [200.0, 0.0], soc=soc).reason for soc in (0.4, 0.9)]
    assert run == ["voltage", "none"]
    task = at("A", 6, dwell=20, power=195.0)
    report = evaluate(docked(200.0, task, battery=small, soc=0.4, order="free"))
    assert report.feasible
    assert report.chargers[0].visits == 1


def test_no_given_order_is_better_than_a_free_one() -> None:
    assert list(worse(range(6))) == []
