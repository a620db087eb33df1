"""Sides in different units, and powers without sign, are told from what arcs make of sides."""

from __future__ import annotations

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.logs.one_side import compare_powers, find_lost_sign


def _channels(unit: float) -> dict[str, np.ndarray]:
    """Straight on with 100 W a side, then turns on which the left side takes 1 W."""
    turns = np.repeat([0.0, 1.0], 50)
    return {
        "t": 0.1 * np.arange(100),
        "v_left": 0.5 - 0.3 * turns,
        "v_right": 0.5 + 0.3 * turns,
        "p_left": unit * (100.0 - 99.0 * turns),
        "p_right": 100.0 + 100.0 * turns,
    }


def test_an_inner_side_that_takes_next_to_nothing_is_in_no_other_unit() -> None:
    assert compare_powers(_channels(1.0)) == ""


def test_a_side_in_kilowatts_is_told() -> None:
    assert "map both in one unit, as in p_left=NAME[kW]" in compare_powers(_channels(1e-3))


def test_powers_without_sign_are_told_where_the_robot_turns_one_way_alone() -> None:
    """The inner side of left turns is held back more than a straight line costs."""
    model = ep.PowerModel.preset("quadriga:full:concrete")
    parts = (("straight", 20.0), ("figure8", 30.0), ("rest", 3.0))
    log = simulate.drive(model, parts, power_noise=5.0, speed_noise=0.005, seed=1)
    left = log.channel("v_right") >= log.channel("v_left")
    channels = {name: values[left] for name, values in log.channels.items()}
    found = ep.identify(ep.DriveLog.from_columns(channels), model.vehicle)
    assert not any("Log signed currents" in text for text in found.warnings)
    lost = {name: np.abs(channels[name]) for name in ("p_left", "p_right")}
    found = ep.identify(ep.DriveLog.from_columns({**channels, **lost}), model.vehicle)
    assert any("Log signed currents" in text for text in found.warnings)


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
