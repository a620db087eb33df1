"""Sides in different units, and powers without sign, are told from what arcs make of sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.io.start import Given, start
from energyplan.logs.checks import find_lost_sign


@pytest.mark.parametrize(("unit", "said"), [(1.0, False), (1e-3, True)])
def test_a_side_in_kilowatts_is_told_from_one_that_takes_next_to_nothing(
    unit: float, said: bool
) -> None:
    """Straight on with 100 W a side, then turns on which the left side takes 1 W."""
    turns = np.repeat([0.0, 1.0], 50)
    made = {"t": 0.1 * np.arange(100), "v_left": 0.5 - 0.3 * turns, "v_right": 0.5 + 0.3 * turns,
            "p_left": unit * (100.0 - 99.0 * turns), "p_right": 100.0 + 100.0 * turns}  # fmt: skip
    warnings = " ".join(ep.DriveLog.from_columns(made).warnings)
    assert ("map both in one unit, as in p_left=NAME[kW]" in warnings) == said == bool(warnings)


def test_powers_without_sign_are_told_where_the_robot_turns_one_way_alone() -> None:
    """The inner side of left turns is held back more than a straight line costs."""
    model = ep.PowerModel.preset("quadriga:full:concrete")
    parts = (("straight", 20.0), ("figure8", 30.0), ("rest", 3.0))
    log = simulate.drive(model, parts, power_noise=5.0, speed_noise=0.005, seed=1)
    left = log.channel("v_right") >= log.channel("v_left")
    channels = {name: values[left] for name, values in log.channels.items()}
    found = ep.identify(ep.DriveLog.from_columns(channels), model.vehicle)
    assert not any("log signed currents" in text for text in found.warnings)
    lost = {name: np.abs(channels[name]) for name in ("p_left", "p_right")}
    found = ep.identify(ep.DriveLog.from_columns({**channels, **lost}), model.vehicle)
    assert any("log signed currents" in text for text in found.warnings)


@pytest.mark.parametrize("side", ["p_left", "p_right"])
def test_a_side_that_alone_lost_its_sign_is_told(side: str) -> None:
    """A machine of 3 t, once a second: K was a fifth too large without a word about it."""
    vehicle = ep.Vehicle.from_geometry(
        "mule", mass=3000, wheelbase=1.3, track=1.3, length=2, width=2
    )
    model = ep.PowerModel.paper(vehicle, K=1000.0, mu=0.5)
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=1.0, speed=1.1, accel_limit=0.5, power_noise=20.0,
        speed_noise=0.003, seed=13,
    )  # fmt: skip
    lost = {**log.channels, side: np.abs(log.channel(side))}
    assert find_lost_sign(log.channels) == ""
    assert find_lost_sign(lost).startswith(f"{side} is never negative")


def _survey(seed: int = 1) -> dict[str, np.ndarray]:
    model = ep.PowerModel.preset("quadriga:full:concrete")
    log = simulate.identification_drive(model, power_noise=5.0, speed_noise=0.005, seed=seed)
    return {name: np.array(values) for name, values in log.channels.items()}


def test_a_steady_turn_by_a_gyroscope_of_few_digits_is_no_frozen_one() -> None:
    spot = [simulate.Setpoint(-0.3, 0.3, hold=20.0), simulate.Setpoint(0.5, 0.2, hold=40.0)]
    model = ep.PowerModel.preset("quadriga:full:concrete")
    made = {**simulate.drive(model, spot, speed_noise=0.005, seed=1).channels}
    made["yaw_rate"] = np.round(made["yaw_rate"], 1)
    log = ep.DriveLog.from_columns({k: v[:-60] for k, v in made.items() if k != "yaw"})
    assert np.ptp(log.channel("yaw_rate")[-400:]) == 0.0
    assert not any("stays at" in text for text in log.warnings)


def test_the_noise_of_a_dead_ammeter_is_in_no_other_unit(tmp_path: Path) -> None:
    """It had been taken for kilowatts, in which a robot's power may be that small."""
    made = _survey()
    rng = np.random.default_rng(3)
    made |= {name: rng.normal(0.0, 0.5, len(made["t"])) for name in ("p_left", "p_right")}
    pd.DataFrame(made).to_csv(tmp_path / "dead.csv", index=False)
    begun = start(tmp_path / "dead.csv", Given(track=0.5, wheelbase=0.475, mass=147.0))
    assert {begun.project.columns[name].unit for name in ("p_left", "p_right")} == {""}
