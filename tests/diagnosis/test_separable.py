"""Drives of too few motions: what only the noise of the speeds would tell is not told."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.search import separable, varies
from energyplan.fit.drive import prepared
from energyplan.fit.estimate import Problem
from energyplan.motion import Motion
from energyplan.power.effects import catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
STATIC = ("hotel_load", "viscous_loss", "turn_asymmetry", "copper_loss")
FEW = "these drives hold too few motions to tell it from friction"


def _steady(
    speeds: tuple[tuple[float, float], ...], rate: float, noise: float, step: float, seed: int,
    power_step: float = 0.0,
) -> DriveLog:  # fmt: skip
    """Five minutes at a few speeds, a minute each in turn; the power is that of the model."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 1.0 / rate)
    true = np.array(speeds)[(t // 60).astype(int) % len(speeds)]
    power = ROBOT.power(Motion(true[:, 0], true[:, 1], ROBOT.vehicle.icr))
    if power_step:
        power = power_step * np.round(power / power_step)
    read = true + noise * rng.standard_normal(true.shape)
    if step:
        read = step * np.round(read / step)
    return DriveLog(
        {"t": t, "v_left": read[:, 0], "v_right": read[:, 1], "power": power}, f"steady {seed}"
    )


@pytest.mark.parametrize(
    ("rate", "noise", "step"),
    [(50.0, 0.02, 0.0), (10.0, 0.02, 0.1), (2.0, 0.005, 0.01), (100.0, 0.0, 0.0)],
    ids=["noise", "steps", "seldom", "exact"],
)
@pytest.mark.parametrize("speeds", [((0.3, 0.5),), ((0.3, 0.5), (-0.4, -0.25))], ids=["one", "two"])
@pytest.mark.parametrize("power_step", [0.0, 24.0], ids=["fine", "amperes"])
def test_a_robot_that_keeps_its_speeds_has_no_load_of_a_microwatt_accuracy(
    speeds: tuple[tuple[float, float], ...], rate: float, noise: float, step: float,
    power_step: float,
) -> None:  # fmt: skip
    train, other = (_steady(speeds, rate, noise, step, seed, power_step) for seed in range(2))
    told = diagnose([train], other, ROBOT.vehicle)
    for found in told.effects:
        assert found.std_error <= abs(found.value) < 3.0 * found.std_error
    assert any(FEW in one and "hotel load" in one and "copper loss" in one for one in told.advice)
    for one in told.predictions:
        low, high = one.energy_interval
        assert low < one.measured < high


def test_what_many_motions_show_is_tried() -> None:
    log = simulate.drive(
        ROBOT, simulate.IDENTIFICATION, rate=10.0, speed_noise=0.01, power_noise=3.0
    )
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    parts = [Part(catalogue()[name]) for name in STATIC]
    assert separable(problem, parts).all()
    assert varies(problem)


def test_what_never_acts_is_no_combination_of_friction() -> None:
    problem = Problem(
        prepared([_steady(((0.3, 0.5),), 10.0, 0.0, 0.0, 0)], ROBOT.vehicle), ROBOT.vehicle
    )
    parts = [Part(catalogue()[name]) for name in (*STATIC, "reverse_drag")]
    assert separable(problem, parts).tolist() == [False] * len(STATIC) + [True]
    assert not varies(problem)


def test_losses_are_told_by_many_motions() -> None:
    log = simulate.drive(ROBOT, simulate.IDENTIFICATION, rate=10.0)
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    names = ("copper_loss", "regeneration_efficiency", "drive_efficiency")
    assert separable(problem, [Part(catalogue()[name]) for name in names]).all()
    assert not len(separable(problem, []))
