"""Frictions that drives leave open are as of robots elsewhere, and their errors say so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from energyplan import PowerModel, diagnose, identify, simulate
from energyplan.errors import DriveLogError
from energyplan.fit.doubts import USUAL, with_usual
from energyplan.fit.drive import prepared
from energyplan.fit.estimate import PAPER, Problem, joint_fit
from energyplan.io.husky import read_husky
from energyplan.power import HOTEL, SLIP, TRACTION
from energyplan.power.effects import ANGULAR_INERTIA
from energyplan.power.presets import MODEL_PRESETS
from energyplan.vehicle import GRAVITY, Vehicle

MODEL = PowerModel.preset("quadriga:full:concrete")
WEIGHT = MODEL.vehicle.mass * GRAVITY
MEAN = np.array([USUAL["slip_friction"][0], USUAL["traction_resistance"][0] * WEIGHT])
ERROR = np.array([USUAL["slip_friction"][1], USUAL["traction_resistance"][1] * WEIGHT])


def test_what_is_usual_is_what_the_presets_have() -> None:
    models = [PowerModel.preset(name) for name in MODEL_PRESETS]
    found = np.array(
        [
            (m.coefficient("slip_friction"),
             m.coefficient("traction_resistance") / (m.vehicle.mass * GRAVITY))
            for m in models
        ]
    )  # fmt: skip
    for column, (mean, error) in zip(found.T, USUAL.values(), strict=True):
        assert column.mean() == pytest.approx(mean, rel=0.1)
        assert column.std(ddof=1) == pytest.approx(error, rel=0.25)


def test_frictions_that_drives_tell_stay_as_they_are() -> None:
    values, covariance = np.array([0.2, 300.0]), np.diag([0.01**2, 2.0**2])
    gram = np.array([[4.0, 1.0], [1.0, 9.0]])
    told, error, taken = with_usual(values, covariance, (SLIP, TRACTION), gram, MODEL.vehicle)
    assert np.array_equal(told, values)
    assert np.array_equal(error, covariance)
    assert taken == ()


@pytest.mark.parametrize("unseen", [0, 1])
def test_a_friction_that_no_drive_shows_is_as_usual(unseen: int) -> None:
    values, covariance = np.array([0.4, 90.0]), np.diag([0.01**2, 2.0**2])
    gram = np.diag([4.0, 9.0])
    values[unseen] = covariance[unseen, unseen] = gram[unseen, unseen] = 0.0
    told, error, taken = with_usual(values, covariance, (SLIP, TRACTION), gram, MODEL.vehicle)
    assert told[unseen] == pytest.approx(MEAN[unseen], rel=1e-5)
    assert np.sqrt(error[unseen, unseen]) == pytest.approx(ERROR[unseen], rel=1e-5)
    assert told[1 - unseen] == values[1 - unseen]
    assert error[1 - unseen, 1 - unseen] == covariance[1 - unseen, 1 - unseen]
    assert taken == (("slip_friction", "traction_resistance")[unseen],)


def test_of_two_frictions_that_go_together_only_the_sum_is_told() -> None:
    """Against least squares with the usual values as two more readings."""
    rng = np.random.default_rng(1)
    shape = rng.uniform(0.2, 1.0, 400)
    columns = np.stack([60.0 * shape, 0.5 * shape, np.ones(400)], axis=1)
    power = columns @ [0.3, 80.0, 20.0] + rng.normal(0.0, 2.0, 400)
    rows, right = np.diag([1.0, 1.0, 0.0])[:2] / ERROR[:, None], MEAN / ERROR
    all_rows = np.vstack([columns / 2.0, rows])
    expected = np.linalg.lstsq(all_rows, np.concatenate([power / 2.0, right]))[0]
    known = np.linalg.inv(all_rows.T @ all_rows)
    # A fit with a ridge: the sum is right, the share and its error are not.
    gram = columns.T @ columns
    values = np.linalg.solve(gram + 1e-9 * np.diag(np.diag(gram)), columns.T @ power)
    values[:2] = [0.5 * (values[0] + values[1] / 120.0), 60.0 * (values[0] + values[1] / 120.0)]
    share = np.array([[0.5, 0.0], [60.0, 0.0], [0.0, 1.0]])
    covariance = share @ np.linalg.inv((columns @ share).T @ (columns @ share) / 4.0) @ share.T
    terms = (SLIP, TRACTION, HOTEL)
    told, error, taken = with_usual(values, covariance, terms, gram, MODEL.vehicle)
    assert taken == ("slip_friction", "traction_resistance")
    assert told == pytest.approx(expected, rel=1e-3)
    assert error == pytest.approx(known, rel=1e-3, abs=1e-3 * np.abs(known).max())


def test_who_only_drove_straight_foretells_turns_with_the_error_of_the_unknown() -> None:
    noise = {"power_noise": 4.0, "speed_noise": 0.002, "without": {"accel_x"}}
    straight = simulate.drive(MODEL, [("straight", 60.0)], seed=1, **noise)
    unseen = simulate.validation_drive(MODEL, seed=2, **noise)
    told = diagnose(straight, unseen, MODEL.vehicle)
    assert told.model.coefficient("slip_friction") == pytest.approx(MEAN[0], rel=1e-3)
    assert told.model.std_error("slip_friction") == pytest.approx(ERROR[0], rel=1e-3)
    assert told.model.std_error("traction_resistance") < 5.0
    (one,) = told.predictions
    low, high = one.energy_interval
    assert low < one.measured < high
    assert high - low > 0.5 * one.measured
    assert told.advice[0].startswith("slip_friction (mu) cannot be identified")
    assert any(line.startswith("these drives leave slip_friction open") for line in told.advice)
    assert not any("traction_resistance open" in line for line in told.advice)


def test_a_robot_that_is_unlike_all_others_is_not_made_like_them() -> None:
    """One that is towed all the time, say, or whose mass is wrong by a factor of five."""
    values, covariance = np.array([0.6, 12.0 * MEAN[1]]), np.diag([0.01**2, (2.0 * ERROR[1]) ** 2])
    gram = np.diag([4.0, 9.0])
    told, error, taken = with_usual(values, covariance, (SLIP, TRACTION), gram, MODEL.vehicle)
    assert taken == ("traction_resistance",)
    assert told[1] > 0.9 * values[1]
    assert 0.9 * 2.0 * ERROR[1] < np.sqrt(error[1, 1]) < 2.0 * ERROR[1]
    # one that is within three deviations is
    values[1] = MEAN[1] + 6.0 * ERROR[1]
    told, error, _ = with_usual(values, covariance, (SLIP, TRACTION), gram, MODEL.vehicle)
    assert told[1] == pytest.approx(MEAN[1] + 6.0 / 5.0 * ERROR[1])
    assert error[1, 1] == pytest.approx(0.8 * ERROR[1] ** 2)


@pytest.mark.parametrize(("unit", "told"), [(1.0, False), (100.0, True)])
def test_a_resistance_beyond_the_weight_is_doubted(unit: float, told: bool) -> None:
    """As where centimetres per second are taken for metres, or kilowatts for watts."""
    K = unit * MODEL.coefficient("traction_resistance")
    shown = PowerModel.paper(MODEL.vehicle, K=K, mu=0.5)
    log = simulate.identification_drive(shown, seed=1, power_noise=5.0)
    found = identify(log, MODEL.vehicle)
    assert any("more than the robot weighs" in line for line in found.warnings) == told


@pytest.mark.shared
def test_single_runs_on_sandy_loam_foretell_others_within_their_intervals(
    shared_data: Path,
) -> None:
    """Most hold one manoeuvre alone, and most others another one."""
    logs = [read_husky(path) for path in sorted(shared_data.glob("borealtc/SANDY_LOAM/pro_*.csv"))]
    within, errors = [], []
    for one, other in zip(logs, [*logs[1:], logs[0]], strict=True):
        try:
            told = diagnose(one, other, Vehicle.preset("husky_a200"))
        except DriveLogError:
            continue  # too short
        (energy,) = told.predictions
        low, high = energy.energy_interval
        within.append(low <= energy.measured <= high)
        errors.append(abs(energy.energy / energy.measured - 1.0))
    assert len(within) >= 12
    assert np.mean(within) >= 0.8
    assert np.median(errors) < 0.15


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_turns_on_the_spot_alone_are_fitted_whatever_share_each_friction_has(seed: int) -> None:
    """Noise of the speeds gives one of both a wrong sign, which the usual share of both has not."""
    vehicle = Vehicle.preset("husky_a200")
    truth = PowerModel.paper(vehicle, K=40.0, mu=0.6).with_term(HOTEL, 30.0)
    truth = truth.with_term(ANGULAR_INERTIA, 8.0)
    rng = np.random.default_rng(seed)
    sides, holds = rng.uniform(-0.8, 0.8, 25), rng.uniform(1.0, 6.0, 25)
    log = simulate.drive(
        truth, [simulate.Setpoint(-s, s, hold=float(h)) for s, h in zip(sides, holds, strict=True)],
        accel_limit=3.0, power_noise=4.0, speed_noise=0.02, measured="total", seed=seed,
        without=("x", "y", "yaw", "accel_x"),
    )  # fmt: skip
    problem = Problem(prepared([log], vehicle), vehicle)
    terms = [*PAPER, HOTEL, ANGULAR_INERTIA]
    told = joint_fit(problem, terms)
    assert told.assumed == ("slip_friction", "traction_resistance")
    longest = problem.design(terms).rows[-1]
    left = longest[:, -1] - longest[:, :-1] @ np.array(told.model.coefficients)
    assert np.sqrt(np.mean(left**2)) < 0.02 * np.sqrt(np.mean(longest[:, -1] ** 2))
    assert told.model.coefficient("hotel_load") == pytest.approx(30.0, abs=3.0)
