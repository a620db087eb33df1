"""Sizes of effects: what explanations differ in, and masses that tell which is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d

from energyplan import PowerModel, diagnose, simulate
from energyplan.diagnosis.joint_fit import size_spread
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.plausible import likeness
from energyplan.diagnosis.result import Explanation
from energyplan.diagnosis.wheel_fight import _Case
from energyplan.fit.drives.drive import prepared
from energyplan.fit.least_squares import Fit
from energyplan.fit.problem import Problem
from energyplan.power import DRIVE_LOSS, HOTEL, REGENERATION_LOSS
from energyplan.power.effect_terms import DRAGGING_LEFT
from energyplan.power.effects import COPPER_LOSS, catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
DRAG = catalogue()["dragging_wheel_left"]


def explanation(probability: float, drag: float | None, loss: bool) -> Explanation:
    """A drag behind one of two losses that powers cannot tell apart."""
    model = ROBOT.with_term(DRIVE_LOSS if loss else REGENERATION_LOSS, 0.3)
    names = ["drive_efficiency" if loss else "regeneration_efficiency"]
    if drag is not None:
        model, names = model.with_term(DRAGGING_LEFT, drag), [*names, DRAG.name]
    return Explanation(tuple(names), probability, model)


def test_the_error_of_a_size_holds_what_explanations_differ_in() -> None:
    told = [explanation(0.5, 40.0, False), explanation(0.3, 30.0, True)]
    spread = size_spread(DRAG, 40.0, [*told, explanation(0.2, None, False)])
    assert spread == pytest.approx(np.sqrt(0.3 / 0.8) * 10.0)
    assert size_spread(DRAG, 40.0, told[:1]) == 0.0
    assert size_spread(catalogue()["time_offset"], 0.3, told) == 0.0


def test_a_mass_that_noise_hides_tells_nothing() -> None:
    part = Part(catalogue()["linear_inertia"])

    def of(mass: float, error: float) -> float:
        found = Fit(
            np.array([0.5, 100.0, mass]), np.zeros(1), np.diag([0.0, 0.0, error**2]),
            np.zeros((3, 1)), 9, np.zeros((9, 3)),
        )  # fmt: skip
        return likeness(ROBOT.vehicle, [part], found)

    own = ROBOT.vehicle.mass
    assert of(own, 0.0) == 1.0
    assert of(0.5 * own, 0.01 * own) < 0.3
    # Half of a mass is a vote of 20 to 1 where both are known, and next to none where neither is.
    assert of(0.02 * own, 0.001 * own) > 20.0 * of(0.01 * own, 0.0005 * own)
    assert of(0.02 * own, 0.1 * own) < 1.2 * of(0.01 * own, 0.05 * own)


def test_a_load_at_rest_beside_losses_is_as_far_off_as_its_error_says() -> None:
    """Noise at rest is no moment that contacts hold, and a noisy start is no long one."""
    truth = ROBOT.with_term(HOTEL, 30.0).with_term(COPPER_LOSS, 4e-4)
    effects = [catalogue()[name] for name in ("copper_loss", "hotel_load")]
    pattern = [*simulate.IDENTIFICATION, ("rest", 60.0)]
    beside = []
    for seed in range(6):
        noise = {"power_noise": 10.0, "speed_noise": 0.005}
        train = simulate.drive(truth, pattern, seed=100 + seed, **noise)
        unseen = simulate.validation_drive(truth, seed=99, **noise)
        told = diagnose(train, unseen, ROBOT.vehicle, effects=effects, choose=False)
        (load,) = (one for one in told.effects if one.name == "hotel_load")
        assert load.std_error < 1.0
        beside.append((load.value - 30.0) / load.std_error)
    assert np.sqrt(np.mean(np.square(beside))) < 1.6
    assert abs(np.mean(beside)) < 1.2


def test_what_the_beginning_of_a_turn_costs_is_no_fight_of_the_sides() -> None:
    """Samples next to those that slide have a moment of their own, that of turning."""
    truth = ROBOT.with_term(COPPER_LOSS, 4e-4)
    log = simulate.identification_drive(truth, seed=1)
    (drive,) = prepared([log], ROBOT.vehicle)
    drive = replace(drive, drift=0.01, fields={})
    case = _Case.of(drive, Problem([drive], ROBOT.vehicle), truth)
    beside = drive.holds & (maximum_filter1d((~drive.holds).astype(float), 3) > 0.0)
    assert np.count_nonzero(beside & (drive.motion.omega != 0.0)) > 5
    assert not case.moment[beside].any()
    assert case.moment.any()
