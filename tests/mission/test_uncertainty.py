"""Bounds of missions against simulations in which everything is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from corridors import METRE, charger, corridor
from test_remedies import Bucket
from uncertain_missions import missions, simulated
from worlds import tiny

from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.mission import Charger, Spreads, Task, evaluate
from energyplan.output import documents, text
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel, Residual
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap

DRAWS = 1000
QUANTILE = 1.6448536


def test_the_bound_holds_as_often_as_it_says_whatever_is_unknown() -> None:
    held = {}
    for seed, (name, asked) in enumerate(missions().items()):
        report = evaluate(asked)
        held[name] = np.mean(simulated(report, DRAWS, seed) >= report.soc_end_lower)
    # each is no further from 93 to 97 % than three standard errors, all together are within
    error = np.sqrt(0.93 * 0.07 / DRAWS)
    assert all(0.93 - 3 * error < share < 0.97 + 3 * error for share in held.values()), held
    assert 0.93 <= np.mean(list(held.values())) <= 0.97


def test_numbers_taken_as_exact_strand_the_robot() -> None:
    asked = missions()["tools"]
    told = evaluate(replace(asked, spreads=Spreads.none()))
    open_ends = simulated(evaluate(asked), DRAWS, seed=5)
    assert np.mean(open_ends >= told.soc_end_lower) < 0.75


def test_each_unknown_costs_what_its_spread_says() -> None:
    """20 m there and back, 100 s of 50 W: each source by itself, in closed form."""
    work = Task("work", Pose(25.0, 1.5, 0.0), dwell=100.0, power=50.0)
    energy = 40 * METRE + 5000.0
    model = PowerModel.preset("quadriga:empty:marble")
    exact = model.with_coefficients(model.coefficients, 1e-18 * np.eye(2))
    asked = corridor(1e5, {"work": 25.0}, 5.0, model=exact, confidence=0.95, soc=0.9)
    asked = replace(asked, tasks=(work,))
    expected = {
        "soc": ("state of charge", 0.02 * 1e5),
        # where the bound lies it holds less, and whatever is drawn is a greater part of it
        "capacity": (
            "capacity of the battery",
            energy * (1 / (1 - 0.02 * QUANTILE) - 1) / QUANTILE,
        ),
        "power": ("power of tools", 0.02 * 5000),
        "dwell": ("duration of tasks", 0.02 * 5000),
        "run": ("difference from run to run", 0.02 * 40 * METRE),
    }
    for key, (source, joules) in expected.items():
        report = evaluate(replace(asked, spreads=replace(Spreads.none(), **{key: 0.02})))
        told = {doubt.source: doubt.energy for doubt in report.uncertainty}
        assert told[source] == pytest.approx(joules, rel=1e-3), key
        lower = 0.9 - (energy + QUANTILE * joules) / 1e5
        assert report.soc_end_lower == pytest.approx(lower, rel=1e-4), key
        if key in ("soc", "capacity"):  # these are the battery's, not the drive's
            assert report.energy_upper == pytest.approx(report.energy, rel=1e-6)


@pytest.mark.parametrize("health", [0.8, 0.97, 1.0])
def test_health_and_temperature_count_by_what_the_battery_then_holds(health: float) -> None:
    """What it holds is in proportion to its health, which is never better than new."""
    pack = replace(
        tiny(1e5), health=health, temperature=0.0, derating_temperature=np.array([-20.0, 20.0]),
        derating_factor=np.array([0.5, 0.9]),
    )  # fmt: skip
    asked = corridor(
        1e5, {"a": 25.0}, 5.0, battery=pack, confidence=0.95,
        spreads=replace(Spreads.none(), health=0.04, temperature=7.0), coefficient_spread=1e-9,
    )  # fmt: skip
    told = {doubt.source: QUANTILE * doubt.energy for doubt in evaluate(asked).uncertainty}
    aged, colder = health - 0.04 * QUANTILE, 0.7 - 0.07 * QUANTILE
    worn = (health / aged - 1) * 40 * METRE
    assert told["health of the battery"] == pytest.approx(worn, rel=1e-3)
    cooled = (0.7 / colder - 1) * 40 * METRE
    assert told["temperature of the battery"] == pytest.approx(cooled, rel=1e-3)


@pytest.mark.parametrize("limit", [{"temperature": -40.0}, {"temperature": 70.0}, {"health": 0.01}])
def test_a_battery_at_the_edge_of_what_is_possible_has_a_bound(limit: dict[str, float]) -> None:
    pack = replace(Battery.preset("quadriga"), **limit)
    report = evaluate(corridor(1e5, {"a": 25.0}, 5.0, battery=pack, spreads=Spreads()))
    assert 0.0 <= report.soc_end_lower <= report.soc_end


def test_a_drive_near_balance_has_the_bound_of_its_worse_side() -> None:
    """Downhill the weight drives the wheels; what they would return a brake resistor takes."""
    model = with_weight(PowerModel.preset("quadriga:empty:marble"))
    vehicle = replace(model.vehicle, regen_efficiency=0.0)
    slope = METRE / (9.80665 * model.coefficients[-1])  # the sine; small, so the tangent too
    x = np.linspace(0, 35, 71)
    asked = corridor(
        1e6, {"below": 25.0}, 5.0, model=replace(model, vehicle=vehicle), confidence=0.95,
        heights=HeightMap(np.tile(-slope * x, (8, 1)), 0.5), coefficient_spread=0.05,
        chargers=(charger(25.0, "dock"),), return_to="charger",
    )  # fmt: skip
    (told,) = evaluate(asked).uncertainty
    # were the gain of the other side averaged in, it would be a quarter less
    assert told.energy == pytest.approx(np.hypot(1.0, 1.0) * 0.05 * 20 * METRE, rel=0.02)


def test_a_temperature_without_data_is_told() -> None:
    asked = corridor(1e5, {"a": 25.0}, 5.0)
    for degrees, told in ((-35.0, "-20 to 40"), (-5.0, "")):
        pack = replace(Battery.preset("quadriga"), temperature=degrees)
        report = evaluate(replace(asked, battery=pack))
        assert ("capacity is known from" in " ".join(report.warnings)) == bool(told)
        assert told in " ".join(report.warnings)
        assert documents.mission(report)["warnings"] == list(report.warnings)
        assert any("warning: battery" in line for line in text.mission(report)) == bool(told)


def test_a_task_and_a_model_may_say_their_own_spread() -> None:
    work = Task("work", Pose(25.0, 1.5, 0.0), dwell=100.0, power=50.0, power_spread=25.0)
    again = Task("again", Pose(25.0, 1.5, 0.0), dwell=60.0, power=50.0, dwell_spread=30.0)
    residual = Residual(
        rmse=0.0, mae=0.0, bias=0.0, energy_error=0.0, correlation_time=0.0, run_spread=0.07
    )
    model = replace(PowerModel.preset("quadriga:empty:marble"), residual=residual)
    asked = corridor(
        1e5, {"work": 25.0}, 5.0, model=model, confidence=0.95,
        spreads=replace(Spreads.none(), power=0.1, run=0.5),
    )  # fmt: skip
    asked = replace(asked, tasks=(work, again))
    told = {doubt.source: doubt.energy for doubt in evaluate(asked).uncertainty}
    # two tools: one of 50 W known to 25 W, one of 50 W known to 10 %
    assert told["power of tools"] == pytest.approx(np.hypot(25 * 100, 5 * 60), rel=1e-3)
    assert told["duration of tasks"] == pytest.approx(30 * 50, rel=1e-3)
    assert told["difference from run to run"] == pytest.approx(0.07 * 40 * METRE, rel=1e-3)


def test_waiting_takes_time_and_what_the_robot_draws_meanwhile() -> None:
    model = PowerModel.preset("quadriga:empty:marble").with_term(HOTEL, 30.0)
    asked = corridor(1e5, {"a": 15.0, "b": 25.0}, 5.0, model=model)
    plain, late = evaluate(asked), evaluate(replace(asked, waiting=60.0))
    assert late.duration - plain.duration == pytest.approx(2 * 60.0)
    assert late.energy - plain.energy == pytest.approx(2 * 60.0 * 30.0)
    doubtful = replace(
        asked, waiting=60.0, confidence=0.95, spreads=replace(Spreads.none(), waiting=1.0),
        coefficient_spread=1e-9,
    )  # fmt: skip
    told = {doubt.source: doubt.energy for doubt in evaluate(doubtful).uncertainty}
    assert told["waiting"] == pytest.approx(np.sqrt(2) * 60 * 30, rel=1e-3)
    windowed = replace(asked, waiting=60.0, speed=0.5)
    (first, second) = windowed.tasks
    arrival = evaluate(windowed).task("a").arrival
    shut = replace(first, window=(0.0, arrival + 30.0))
    assert evaluate(replace(windowed, tasks=(shut, second))).task("a").reason == "late"


def test_after_a_charge_the_gauge_is_what_is_open() -> None:
    dock = Charger("dock", Pose(15.0, 1.5, 0.0), power=500.0, until=0.8)
    asked = corridor(
        3000.0, {"end": 20.0}, 5.0, soc=0.7, chargers=(dock,), confidence=0.95,
        spreads=replace(Spreads.none(), soc=0.03), coefficient_spread=1e-9, return_to="charger",
    )  # fmt: skip
    report = evaluate(asked)
    assert report.order == ("dock", "end", "dock")
    charged = next(stop for stop in report.route if stop.kind == "charge")
    assert charged.soc == pytest.approx(0.8)
    assert charged.soc_lower == pytest.approx(0.8 - QUANTILE * 0.03, rel=1e-6)
    assert report.soc_end - report.soc_end_lower == pytest.approx(QUANTILE * 0.03, rel=1e-3)


@pytest.mark.parametrize("key", ["soc", "run", "waiting"])
def test_a_spread_that_makes_no_sense_is_refused(key: str) -> None:
    with pytest.raises(MissionError, match=f"{key} is -1.0; give 0 to") as refused:
        Spreads(**{key: -1.0})
    assert refused.value.place == (key,)


def test_a_battery_of_ones_own_has_its_capacity_as_the_only_unknown() -> None:
    asked = corridor(1e5, {"a": 25.0}, 5.0, confidence=0.95, coefficient_spread=0.05)
    about = {"capacity of the battery", "health of the battery", "temperature of the battery"}
    for battery, known in ((Battery.preset("quadriga"), about), (Bucket(1e5), {min(about)})):
        report = evaluate(replace(asked, spreads=Spreads(), battery=battery))
        assert about & {doubt.source for doubt in report.uncertainty} == known
