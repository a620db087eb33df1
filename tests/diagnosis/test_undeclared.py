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


def bent_axle(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Drag of the right side that comes back every 0.9 m."""
    left, right = speeds(drive)
    steps = 0.5 * np.diff(drive.t) * (right[1:] + right[:-1])
    turned = 2 * np.pi * np.concatenate([[0.0], np.cumsum(steps)]) / 0.9
    return np.zeros_like(left), 0.5 * K * (1 + np.sin(turned)) * np.abs(right)


def hill(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """A ridge across the way, 9 cm high, that no slope channel shows."""
    left, right = speeds(drive)
    at = drive.channel("x") - float(np.median(drive.channel("x")))
    climb = -0.09 * at / 1.5**2 * np.exp(-(at**2) / (2 * 1.5**2))
    weight = ROBOT.vehicle.mass * 9.81 * climb * np.cos(drive.channel("yaw"))
    return weight * left / 2, weight * right / 2


def swinging_payload(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """A load of 100 kg on a cable of 0.7 m, which every change of speed makes swing."""
    left, right = speeds(drive)
    accel = np.gradient(0.5 * (left + right), drive.t)
    stiff, step = 9.81 / 0.7, float(drive.t[1] - drive.t[0])
    angle, rate, force = 0.0, 0.0, np.zeros(len(drive))
    for k, push in enumerate(accel):
        rate -= (push + stiff * angle + 0.1 * rate) * step
        angle += rate * step
        force[k] = -100.0 * stiff * angle
    return force * left / 2, force * right / 2


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


def patch(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    left, right = speeds(drive)
    far = (drive.channel("x") - 1.0) ** 2 + (drive.channel("y") - 0.5) ** 2
    more = 0.6 * K * np.exp(-far / (2 * 1.5**2))
    return more * np.abs(left), more * np.abs(right)


def gear_slips(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """A gear that takes the more of what is beyond a torque, as it slips."""
    left, right = drive.channel("p_left"), drive.channel("p_right")
    return 1.2 * np.clip(left - 130.0, 0.0, None), 1.2 * np.clip(right - 130.0, 0.0, None)


def clock_drifts(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Power from a file whose clock runs 1.2 % slow."""
    powers = drive.channel("p_left"), drive.channel("p_right")
    late = [np.interp(0.988 * drive.t, drive.t, power) - power for power in powers]
    return late[0], late[1]


def sensor_hangs(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    last = np.maximum.accumulate(np.where(drive.t % 13.0 < 2.0, 0, np.arange(len(drive))))
    powers = drive.channel("p_left"), drive.channel("p_right")
    return powers[0][last] - powers[0], powers[1][last] - powers[1]


def friction_with_sag(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Friction that grows as the battery empties, and as it sags under load."""
    left, right = speeds(drive)
    sag = 0.3 + 0.5 * drive.t / drive.t[-1] + 0.3 * drive.power / np.max(np.abs(drive.power))
    return 0.6 * K * sag * np.abs(left), 0.6 * K * sag * np.abs(right)


def greased(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Cold grease, which each metre makes run more easily."""
    left, right = speeds(drive)
    steps = 0.5 * np.abs(left + right) * np.diff(drive.t, prepend=0.0)
    stiff = 0.7 * K * np.exp(-np.cumsum(steps) / 15.0)
    return stiff * np.abs(left), stiff * np.abs(right)


def drag_above_a_speed(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    left, right = speeds(drive)
    force = 200.0 * np.clip(0.5 * np.abs(left + right) - 0.45, 0.0, None)
    return force * np.abs(left), force * np.abs(right)


def rubs_in_fast_turns(drive: DriveLog) -> tuple[FloatArray, FloatArray]:
    """Tyres that rub by the centripetal force."""
    left, right = speeds(drive)
    force = 2.0 * K * np.abs(0.5 * (left + right) * (right - left))
    return force * np.abs(left), force * np.abs(right)


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
        pytest.param(eccentric_wheel, {"left tread"}, id="eccentric wheel"),
        pytest.param(hill, {"x"}, id="hill"),
        pytest.param(swinging_payload, set(), id="swinging payload", marks=pytest.mark.nightly),
        pytest.param(rubs_in_fast_turns, set(), id="rubs in fast turns", marks=pytest.mark.nightly),
        pytest.param(tyre_loses_pressure, {"t", "distance"}, id="tyre loses pressure"),
        pytest.param(backlash, {"since_start"}, id="backlash"),
        pytest.param(clock_drifts, set(), id="clock drifts"),
        pytest.param(gear_slips, set(), id="gear slips at high torque", marks=pytest.mark.nightly),
        pytest.param(sensor_hangs, set(), id="sensor hangs", marks=pytest.mark.nightly),
        pytest.param(
            friction_with_sag, {"t", "distance"}, id="friction with sag", marks=pytest.mark.nightly
        ),
        pytest.param(greased, {"t", "distance"}, id="greased", marks=pytest.mark.nightly),
    ],
)
def test_what_the_catalogue_lacks_is_unexplained(kind: Kind, channels: set[str]) -> None:
    found = told(kind)
    assert found.verdict == "unexplained"
    assert channels == set() or {one.channel for one in found.unexplained} & channels
    # A name, where there is one, is doubted: it may stand in for what has none.
    usual = {name for name, entry in catalogue().items() if entry.usual}
    named = [one.probability for one in found.effects if one.name not in usual]
    assert max(named, default=0.0) < 0.95
    assert found.none_of_these > 0.05
    stated = sum(one.probability for one in found.explanations)
    stated += found.none_of_these + found.further_effects
    assert stated == pytest.approx(1.0, abs=0.01)  # improbable explanations are left out
    assert abs(found.after.energy_error) < abs(found.before.energy_error) + 0.02


@pytest.mark.parametrize(("kind", "seed"), [(weak_pushes_return_nothing, 11), (stripes, 21)])
def test_a_map_that_probably_stands_in_for_something_else_predicts_nothing(
    kind: Kind, seed: int
) -> None:
    """A border fits the ways of the training drive, and would mislead on others."""
    found = told(kind, seed)
    assert found.verdict == "unexplained"
    assert "surface_border" in found.withdrawn
    assert "surface_border" not in {one.name for one in found.effects}
    assert not {"slip_beyond", "traction_beyond"} & {term.name for term in found.model.terms}
    assert any("surface border would fit" in line for line in found.advice)
    assert found.after.rmse < 1.05 * found.before.rmse
    assert found.none_of_these > 0.5


def test_a_drag_of_each_turn_is_told_with_its_side_and_length() -> None:
    found = told(bent_axle)
    turning = next(one for one in found.unexplained if one.channel == "right tread")
    every = float(turning.shape.split("comes back every ")[1].split(" m")[0])
    assert every == pytest.approx(0.9, abs=0.005)


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


def test_a_load_that_comes_and_goes_is_told_with_its_period() -> None:
    # A total, and rests in which the load is on at times: their scatter is not the sensor's.
    found = told(auxiliary_load, total=True)
    assert found.verdict == "unexplained"
    periodic = next(one for one in found.unexplained if one.channel == "t")
    assert "30 s" in periodic.shape


def test_wind_is_a_slope_that_foretells_other_drives() -> None:
    # A force by heading is what a tilted plane gives: the same predictions, by another name.
    found = told(wind)
    assert [effect.name for effect in found.effects] == ["tilted_plane"]
    assert found.after.rmse < 1.1 * np.sqrt(2.0) * NOISE < found.before.rmse


@pytest.mark.nightly
def test_drag_above_a_speed_is_air_drag_that_foretells_other_drives() -> None:
    found = told(drag_above_a_speed)
    assert found.effects[0].name == "air_drag"
    noise = 2.0 * NOISE**2
    # Of what is more than noise, most is foretold.
    assert found.after.rmse**2 - noise < 0.25 * (found.before.rmse**2 - noise)
    assert "v" in {one.channel for one in found.unexplained}  # and that this is not all


def test_what_does_not_hold_on_other_drives_is_not_explained() -> None:
    # A round patch: a line and a time fit the drive that was learned from, and no other.
    found = told(patch, seed=21)
    assert found.after.rmse > 2.0 * found.adequacy.residual
    assert found.verdict == "unexplained"
    assert any("do not believe" in line for line in found.advice)
