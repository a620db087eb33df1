"""Kinds of effect that the catalogue does not have: told as such, never named with confidence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.path import FloatArray
from energyplan.power.effects import catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
K = ROBOT.coefficient("traction_resistance")
NOISE = 4.0  # of each side's power [W]

Kind = Callable[[DriveLog], tuple[FloatArray, FloatArray]]
"""What the left and the right side draw more than the model says [W], from the noiseless drive."""


def speeds(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    return drive.channel("v_left"), drive.channel("v_right")


def eccentric_wheel(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    left, right = speeds(drive)
    steps = 0.5 * np.diff(drive.t) * (left[1:] + left[:-1])
    turned = np.concatenate([[0.0], np.cumsum(steps)]) / 0.15
    return 0.6 * K * np.sin(turned) * left, np.zeros_like(right)


def hill(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """A ridge across the way, 9 cm high, that no slope channel shows."""
    left, right = speeds(drive)
    at = drive.channel("x") - float(np.median(drive.channel("x")))
    climb = -0.09 * at / 1.5**2 * np.exp(-(at**2) / (2 * 1.5**2))
    weight = ROBOT.vehicle.mass * 9.81 * climb * np.cos(drive.channel("yaw"))
    return weight * left / 2, weight * right / 2


def auxiliary_load(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    on = 60.0 * (drive.t % 30.0 < 10.0)
    return on / 2, on / 2


def tyre_loses_pressure(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    left, right = speeds(drive)
    half = drive.t[-1] / 2
    more = 0.8 * K * np.clip((drive.t - half) / half, 0.0, 1.0)
    return more * np.abs(left), np.zeros_like(right)


def weak_pushes_return_nothing(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Drivers that return power only above 60 W."""
    left, right = drive.channel("p_left"), drive.channel("p_right")
    kept_left, kept_right = (np.where((p < 0) & (p > -60), -p, 0.0) for p in (left, right))
    return kept_left, kept_right


def stripes(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Two floors in stripes of a metre and a half."""
    left, right = speeds(drive)
    more = 0.5 * K * (np.floor(drive.channel("x") / 1.5) % 2)
    return more * np.abs(left), more * np.abs(right)


def backlash(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    pulses = []
    for speed in speeds(drive):
        sign = np.sign(speed)
        starts = drive.t[1:][(sign[1:] != sign[:-1]) & (sign[1:] != 0)]
        since = drive.t[:, None] - starts
        pulses.append(80.0 * np.any((since >= 0.0) & (since < 0.5), axis=1) * (sign != 0))
    return pulses[0], pulses[1]


def wind(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    left, right = speeds(drive)
    along = 4.0 * np.cos(drive.channel("yaw") - 0.7) + 0.5 * (left + right)
    power = 1.2 * along * np.abs(along) * 0.5 * (left + right)
    return power / 2, power / 2


def clock_drifts(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Power from a file whose clock runs 1.2 % slow."""
    powers = drive.channel("p_left"), drive.channel("p_right")
    late = [np.interp(0.988 * drive.t, drive.t, power) - power for power in powers]
    return late[0], late[1]


def driven(kind: Kind, seed: int, *, validation: bool = False, total: bool = False) -> DriveLog:
    """A drive of a robot with that kind of effect, with noise."""
    pattern = simulate.validation_drive if validation else simulate.identification_drive
    left, right = kind(pattern(ROBOT, seed=seed))
    log = pattern(ROBOT, power_noise=NOISE, speed_noise=0.003, without={"accel_x"}, seed=seed)
    channels = dict(log.channels)
    channels["p_left"] = channels["p_left"] + left
    channels["p_right"] = channels["p_right"] + right
    if total:
        channels["power"] = channels.pop("p_left") + channels.pop("p_right")
    return DriveLog(channels, f"{kind.__name__} {seed}")


def told(kind: Kind, seed: int = 11, *, total: bool = False) -> Diagnosis:
    return diagnose(
        driven(kind, seed, total=total),
        driven(kind, seed + 1, validation=True, total=total),
        ROBOT.vehicle,
    )


@pytest.mark.parametrize(
    ("kind", "channels"),
    [
        pytest.param(eccentric_wheel, set(), id="eccentric wheel"),
        pytest.param(hill, {"x"}, id="hill"),
        pytest.param(tyre_loses_pressure, {"t", "distance"}, id="tyre loses pressure"),
        pytest.param(backlash, {"since_start"}, id="backlash"),
    ],
)
def test_what_the_catalogue_lacks_is_unexplained(kind: Kind, channels: set[str]) -> None:
    found = told(kind)
    assert found.verdict == "unexplained"
    assert channels == set() or {one.channel for one in found.unexplained} & channels
    assert abs(found.after.energy_error) < abs(found.before.energy_error) + 0.02


def test_a_clock_that_drifts_is_a_delay_that_leaves_something() -> None:
    """Its mean of 0.7 s is a delay: half of the error, and what is left is no noise."""
    found = told(clock_drifts)
    assert {effect.name for effect in found.effects} <= {"time_offset"}
    assert not found.adequacy.adequate
    assert any("so something is missing" in line for line in found.advice)


@pytest.mark.parametrize(("kind", "seed"), [(weak_pushes_return_nothing, 11), (stripes, 21)])
def test_a_map_that_probably_stands_in_for_something_else_predicts_nothing(
    kind: Kind, seed: int
) -> None:
    """A border fits the ways of the training drive, and would mislead on others."""
    found = told(kind, seed)
    assert found.verdict == "unexplained"
    assert found.after.rmse < 1.05 * found.before.rmse


def test_a_glitch_of_the_speed_makes_no_endless_way() -> None:
    """One reading of 10,000 km/s: turns of a wheel are sought over what was driven besides."""
    log = simulate.identification_drive(ROBOT, seed=1, power_noise=NOISE)
    speed = np.array(log.channel("v_left"))
    speed[1000] = 1e7
    with np.errstate(all="ignore"):
        found = diagnose(
            DriveLog({**log.channels, "v_left": speed}, "glitch"),
            simulate.validation_drive(ROBOT, seed=2, power_noise=NOISE),
            ROBOT.vehicle, effects=[catalogue()["hotel_load"]],
        )  # fmt: skip
    assert found.verdict == "unexplained"


def test_a_load_that_comes_and_goes_is_unexplained() -> None:
    # A total, and rests in which the load is on at times: their scatter is not the sensor's.
    found = told(auxiliary_load, total=True)
    assert found.verdict == "unexplained"


def test_wind_is_a_slope_that_foretells_other_drives() -> None:
    # A force by heading is what a tilted plane gives: the same predictions, by another name.
    found = told(wind)
    assert [effect.name for effect in found.effects] == ["tilted_plane"]
    assert found.after.rmse < 1.1 * np.sqrt(2.0) * NOISE < found.before.rmse
