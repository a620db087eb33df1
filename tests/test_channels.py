"""Channels of logs: one table says what each is, in which unit, and what it may hold."""

from __future__ import annotations

import pytest

from energyplan.logs.clean import LIMITS
from energyplan.logs.mapping import UNITS, scale_of
from energyplan.motion import CHANNELS, LOGGED


def test_every_table_of_channels_comes_from_the_one() -> None:
    assert list(UNITS) == list(LIMITS) == list(LOGGED)
    for name, one in LOGGED.items():
        assert one.least < one.most
        assert next(iter(UNITS[name])) == one.unit
        assert scale_of(name, one.unit).factor == 1.0
        assert LIMITS[name] == (one.least, one.most, one.unit)


@pytest.mark.parametrize("name", ["t", "yaw", "slope", "accel_x", "payload", "cmd_left"])
def test_a_motion_carries_what_a_log_holds_besides_speeds_and_powers(name: str) -> None:
    assert CHANNELS[name] == f"{LOGGED[name].meaning} [{LOGGED[name].unit}]"
