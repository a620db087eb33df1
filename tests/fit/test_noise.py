"""Noise of a power sensor, as a residual shows it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, identify, simulate


def drive(preset: str, shape: str, duration: float, seed: int) -> DriveLog:
    """Drive that obeys the model, with noise of 10 W a side that is correlated over 0.2 s."""
    return simulate.drive(
        PowerModel.preset(preset), shape, duration=duration, power_noise=10.0,
        correlation_time=0.2, speed_noise=0.005, seed=seed, name=shape,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("preset", "seed"), [("quadriga:full:marble", 6), ("quadriga:empty:concrete", 9)]
)
def test_noise_is_a_part_of_the_residual(preset: str, seed: int) -> None:
    left = identify(drive(preset, "spiral", 90.0, seed), PowerModel.preset(preset).vehicle).adequacy
    assert left.noise <= left.residual
    assert left.noise == pytest.approx(np.hypot(10.0, 10.0), rel=0.1)
    assert left.adequate


def test_what_is_negligible_is_no_noise() -> None:
    """A residual of hundredths of a watt, of a log without noise, was called noise of a watt."""
    truth = PowerModel.preset("quadriga:full:marble")
    left = identify(simulate.drive(truth, "spiral", duration=60.0), truth.vehicle).adequacy
    assert left.noise <= left.residual < left.negligible
    assert left.adequate


def test_intervals_are_as_wide_as_is_said_of_them() -> None:
    truth = PowerModel.preset("quadriga:full:marble")
    found = diagnose(
        drive("quadriga:full:marble", "spiral", 90.0, 6),
        drive("quadriga:full:marble", "figure8", 40.0, 6), truth.vehicle,
    )  # fmt: skip
    (told,) = (line for line in found.advice if "fewer than three" in line)
    share = int(re.search(r"90 % intervals of energies allow (\d+) %", told)[1]) / 100
    (one,) = found.predictions
    low, high = one.energy_interval
    assert 0.5 * (high - low) == pytest.approx(share * one.energy, rel=0.1)
