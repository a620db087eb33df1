"""What a battery gives and takes is the same in the search, the simulation and the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from battery_missions import worse
from corridors import at, corridor
from worlds import tiny

from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.html import number
from energyplan.mission import Charger, Mission, evaluate
from energyplan.output import documents
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap

PACK = Battery.of("24 V 20 Ah lead-acid")
HOLDS = tiny(1.5e6)


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


CURVE = [[0.0, 120.0], [0.6, 120.0], [1.0, 20.0]]


def test_the_power_of_a_charger_follows_its_curve() -> None:
    low = docked(100.0, at("A", 10, dwell=3600, power=250.0), soc=0.3, battery=HOLDS)
    report = evaluate(replace(low, chargers=(Charger("dock", low.start, CURVE, until=0.9),)))
    (charge,) = report.charges
    given, soc = -charge.power[:-1], 0.5 * (charge.soc[1:] + charge.soc[:-1])
    # the first and the last step, and the first of each hour, have the power of their begin
    assert given == pytest.approx(np.interp(soc, *np.array(CURVE).T), rel=3e-3)
    # of a pack without losses the rise of the charge is the power over the energy of the pack
    last = float(np.interp(0.9, *np.array(CURVE).T))
    even = (0.6 - charge.soc[0]) * HOLDS.full_energy / 120.0
    falling = 0.3 * HOLDS.full_energy / (120.0 - last) * np.log(120.0 / last)
    assert charge.arrival - charge.departure == pytest.approx(even + falling, rel=2e-3)


def test_a_flat_curve_is_a_number() -> None:
    tasks = (at("A", 10, dwell=3600, power=250.0),)
    one = docked(150.0, *tasks, soc=0.3)
    flat = Charger("dock", one.start, [(0.0, 150.0), (1.0, 150.0)])
    number, curve = (evaluate(m).duration for m in (one, replace(one, chargers=(flat,))))
    assert curve == pytest.approx(number, rel=1e-12)


def test_what_a_charger_draws_from_the_mains_is_reported() -> None:
    asked = docked(150.0, at("A", 10, dwell=3600, power=250.0), soc=0.3)
    dock = replace(asked.chargers[0], efficiency=0.8)
    report = evaluate(replace(asked, chargers=(dock,)))
    (used,) = report.chargers
    assert used.energy > 0.0
    assert used.energy_mains == pytest.approx(used.energy / 0.8, rel=1e-12)
    (table,) = (one for one in report.tables if one.title == "Chargers")
    assert table.rows == [
        ("dock", used.visits, f"{used.duration / 60:.1f}", number(used.energy / 3600),
         number(used.energy_mains / 3600))
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("power", "words"),
    [
        ([[0, 400]], "pairs"),
        ([[0.5, 400], [0.2, 300]], "ascend"),
        ([[0, 400], [1, 0]], "power[1][1] is 0.0; give 0.1 to 1e+06 W"),
        ([[0, 400], [1, "fast"]], "pairs"),
        ("fast", "a power (W, kW), or pairs"),
    ],
)
def test_a_curve_that_is_none_is_refused_with_its_place(power: object, words: str) -> None:
    with pytest.raises(MissionError) as refused:
        Charger("dock", Pose(3.0, 1.5, 0.0), power)
    assert words in str(refused.value)


def test_a_curve_is_read_with_units() -> None:
    dock = Charger("dock", Pose(3.0, 1.5, 0.0), [["0 %", "0.4 kW"], ["100 %", 50]])
    assert dock.power == ((0.0, 400.0), (1.0, 50.0))


def test_a_task_that_gives_way_to_another_one_may_need_a_charge_that_ends_when_it_is_enough() -> (
    None
):
    small = at("A", 10, dwell=3600, power=100.0, required=False, prize=1)
    large = at("B", 10, dwell=3600, power=100.0, required=False, prize=2, window=(0.0, 4000.0))
    asked = docked(150.0, small, large, soc=0.3, order="given")
    dock = replace(asked.chargers[0], enough=True)
    report = evaluate(replace(asked, chargers=(dock,)))
    assert report.task("B").verdict == "reachable"
    assert report.task("A").reason == "blocked_by_earlier"


def test_a_robot_leaves_a_charger_when_it_has_enough() -> None:
    """The least charge with which it is feasible, to a hundredth, and in time for a window."""
    asked = docked(150.0, at("A", 10, dwell=3600, power=100.0), soc=0.3)
    dock = replace(asked.chargers[0], enough=True)
    full, least = evaluate(asked), evaluate(replace(asked, chargers=(dock,)))
    level = float(least.charges[0].soc[-1])
    assert least.feasible and least.duration < full.duration - 1800
    assert least.energy == pytest.approx(full.energy, rel=1e-9)
    assert least.remedies == ()
    # a hundredth less would not do
    again = [
        evaluate(replace(asked, chargers=(replace(asked.chargers[0], until=until),)))
        for until in (level, round(level - 0.01, 2))
    ]
    assert [one.feasible for one in again] == [True, False]


def test_each_drive_has_the_peak_of_its_power_and_current() -> None:
    """By hand: straight at a constant power, where the current rises as the pack is emptied."""
    pack = replace(PACK, resistance=0.05, pair_resistance=0.0)
    asked = corridor(1.0, (at("A", 20),), 3.0, battery=pack, soc=0.6)
    report = evaluate(asked)
    out, home = documents.mission(report)["legs"]
    for leg, drive in zip((out, home), report.legs, strict=True):
        power, emf = drive.leg.consumption.power, pack.ocv(drive.soc[:-1])
        by_hand = (emf - np.sqrt(emf**2 - 4 * 0.05 * power)) / (2 * 0.05)
        assert leg["peak_power"] == pytest.approx(float(power.max()), rel=1e-12)
        assert leg["peak_current"] == pytest.approx(float(by_hand.max()), rel=1e-9)
    assert home["peak_current"] > out["peak_current"] > out["peak_power"] / float(pack.ocv(0.6))
