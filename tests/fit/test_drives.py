"""The drives that a regression sees: cleaned speeds, pieces between gaps, left and right alike."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan import simulate
from energyplan.fit import identify
from energyplan.fit.drive import Drive, prepared, quiet
from energyplan.fit.estimate import Problem
from energyplan.fit.regressors import (
    linearise_drive,
    power_of,
)
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.power import (
    HOTEL,
    REGENERATION_LOSS,
    SLIP,
    TRACTION,
    PowerModel,
    Term,
)
from energyplan.power.effects import COPPER_LOSS, catalogue
from energyplan.simulate import Setpoint

MODEL = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
ICR = MODEL.vehicle.icr
PERIOD = 0.05


def _speeds(rng: np.random.Generator) -> np.ndarray:
    """Straights, arcs, spins, pivots about either tread and rests, each a second or two."""
    kinds = [(0.6, 0.6), (0.5, -0.5), (0.7, 0.0), (0.0, 0.0), (0.0, 0.7), (-0.4, -0.4), (0.3, 0.8),
             (-0.6, 0.0), (0.0, 0.0), (-0.5, 0.5), (0.0, -0.6), (0.8, 0.3)]  # fmt: skip
    wanted = np.repeat(kinds, rng.integers(20, 40, len(kinds)), axis=0)
    return np.vstack([wanted, np.flipud(wanted)])


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_in_the_mirror_tells_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = _speeds(rng)
    power = MODEL.power(Motion(v[:, 0], v[:, 1], ICR)) + rng.normal(0.0, 8.0, len(v))
    v = v + rng.normal(0.0, 0.004, v.shape) * (v != 0.0)
    t = PERIOD * np.arange(len(v))
    rate = (v[:, 1] - v[:, 0]) / ICR.slip_track

    def told(left: int, right: int, way: float) -> np.ndarray:
        log = DriveLog.from_columns(
            {"t": t, "v_left": v[:, left], "v_right": v[:, right], "power": power,
             "yaw_rate": way * rate}
        )  # fmt: skip
        return identify(log, MODEL.vehicle, terms=(SLIP, TRACTION, HOTEL)).model.coefficients

    assert_allclose(told(1, 0, -1.0), told(0, 1, 1.0), rtol=1e-6)


def test_a_gyroscope_without_noise_is_not_smoothed() -> None:
    """Where the wheels' noise hides a slight turn, the gyroscope tells its edges to the sample."""
    rng = np.random.default_rng(1)
    n = 400
    t = PERIOD * np.arange(n)
    turn = np.zeros(n)
    turn[150:200], turn[300:350] = 0.02, -0.02
    turn[:40] = 0.6
    wheels = turn[:, None] * [-0.5, 0.5] + 0.6 + rng.normal(0.0, 0.01, (n, 2))
    clean = quiet(Motion(*wheels.T, ICR, {"yaw_rate": turn / ICR.slip_track}), t)
    at = np.arange(60, n)
    assert_allclose(np.sign(clean.omega[at]), np.sign(turn[at]))


def _lossy(turn: float, loss: str, wide: bool = True, **options: Any) -> tuple[Problem, list[Term]]:
    """Return a drive of which only the total is logged, and the terms of the robot.

    On two stretches it turns by less than the noise of its wheels shows: friction is that of a
    sharp turn, and what losses take because of it shows in the power alone.
    """
    model = PowerModel.preset("quadriga:full:concrete")
    extra = {"copper_loss": (COPPER_LOSS, 4.5e-4), "regeneration": (REGENERATION_LOSS, 0.5)}[loss]
    model = model.with_term(*extra)
    turns = [("spiral", 30.0), ("survey", 20.0)] if wide else []
    log = simulate.drive(
        model,
        [("rest", 3.0), ("spin", 20.0), ("straight", 16.0), *turns, ("rest", 3.0),
         Setpoint(0.5 - turn, 0.5 + turn, hold=8.0), ("rest", 3.0),
         Setpoint(-0.4 + turn, -0.4 - turn, hold=6.0)],
        rate=10.0, power_noise=4.0, speed_noise=0.003, measured="total",
        without={"x", "y", "yaw", "yaw_rate", "accel_x"}, **options,
    )  # fmt: skip
    return Problem(prepared([log], model.vehicle), model.vehicle), list(model.terms)


def test_derivatives_count_that_what_contacts_hold_follows_the_coefficients() -> None:
    """Its mean over a moment of time does, where both sides were logged and losses make it cost."""
    model = PowerModel.preset("quadriga:full:concrete").with_term(COPPER_LOSS, 4.5e-4)
    log = simulate.identification_drive(
        model, seed=3, rate=10.0, power_noise=4.0, speed_noise=0.004, without={"accel_x"}
    )
    (drive,) = prepared([log], model.vehicle)
    drive = replace(drive, breakaway=0.05, fields={})
    driven = drive.holds & (drive.held.v_left != 0.0)
    values, terms = model.coefficients, model.terms
    about = linearise_drive(drive, model.vehicle, terms, values)
    for k, value in enumerate(values):
        step = 1e-3 * value * np.eye(len(values))[k]
        more, less = (
            linearise_drive(drive, model.vehicle, terms, values + s) for s in (step, -step)
        )
        slope = (more.power - less.power)[driven, 0] / (2e-3 * value)
        told = about.columns[driven, 0, k]
        assert np.quantile(np.abs(told - slope), 0.9) < 0.02 * np.sqrt(np.mean(slope**2))
        assert told.sum() == pytest.approx(slope.sum(), rel=0.02)


def test_a_prediction_knows_nothing_of_the_power_that_was_measured() -> None:
    problem, terms = _lossy(8e-4, "copper_loss")
    values = np.array([*PowerModel.preset("quadriga:full:concrete").coefficients, 4.5e-4])
    model = PowerModel(problem.vehicle, tuple(terms), values)
    (drive,) = problem.drives
    unseen = replace(drive, power=np.zeros(len(drive.t)), fields={})
    assert_allclose(power_of(model, drive), power_of(model, unseen), rtol=0, atol=0)


def test_a_part_of_a_drive_goes_on_warming_up() -> None:
    (warm_up,) = catalogue()["warm_up"].terms
    truth = PowerModel.preset("quadriga:full:concrete").with_term(warm_up, 60.0)
    log = simulate.drive(truth, "spiral", rate=10.0)
    later = log.segment(40.0, 80.0).segment(50.0, 70.0)
    left = later.power - power_of(truth, Drive.of(later, truth.vehicle))
    assert np.abs(left).max() < 1e-6 * np.abs(later.power).max()


@pytest.mark.parametrize("accel", [0.1, 0.4])
@pytest.mark.parametrize("rate", [10.0, 20.0, 100.0])
def test_starts_and_stops_in_noise_last_as_long_as_they_do(accel: float, rate: float) -> None:
    """Treads move while they do, but for a sample or two; most of the time they rest here."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 1.0 / rate)
    way = np.where(t % 30.0 < 15.0, 1.0, -1.0)
    v = way * np.clip(accel * np.minimum(t % 15.0 - 4.0, 11.0 - t % 15.0), 0.0, 0.6)
    noisy = v[:, None] + rng.normal(0.0, 0.005, (len(t), 2))
    found = quiet(Motion(noisy[:, 0], noisy[:, 1], ICR), t)
    assert np.array_equal(found.v_left == 0.0, found.v_right == 0.0)
    rest, called = v == 0.0, found.v_left == 0.0
    # eight starts and stops; a tenth of a second each at most, or a sample
    most = 8 * max(0.1 * rate, 1.0)
    assert np.count_nonzero(rest & ~called) <= most
    assert np.count_nonzero(~rest & called) <= most
