"""What readings tell of their noise and steps, and how sure coefficients are because of them."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.fit.drive import prepared, quiet, reading_noise, reading_step
from energyplan.fit.estimate import PAPER, Problem, joint_fit
from energyplan.fit.solvers import innovation_share, jackknife, repeats_of
from energyplan.motion import Motion
from energyplan.power import HOTEL
from energyplan.vehicle import TreadICR

ROBOT = PowerModel.preset("quadriga:full:concrete")
TERMS = (*PAPER, HOTEL)


@pytest.mark.parametrize(
    ("values", "step"),
    [
        (np.random.default_rng(5).normal(size=300), 0.0),
        (np.zeros(300), 0.0),
        (np.arange(4.0), 0.0),
        (np.round(np.random.default_rng(4).normal(20.0, 1.0, 2000)), 1.0),
        (0.3 * np.round(np.random.default_rng(4).normal(0.0, 9.0, 2000)), 0.3),
    ],
    ids=["without steps", "dead", "too few", "whole", "steps of 0.3"],
)
def test_the_step_of_a_sensor_is_told_by_its_readings(values: np.ndarray, step: float) -> None:
    assert reading_step(values) == pytest.approx(step)


def problem_of(seed: int, step: float) -> tuple[Problem, float]:
    """A drive with a hotel load, its power read in steps, and the load."""
    load = float(np.random.default_rng(seed).uniform(20.0, 60.0))
    log = simulate.drive(
        ROBOT.with_term(HOTEL, load), [*simulate.VALIDATION, ("rest", 40.0)], rate=10.0,
        measured="total", power_noise=2.0, seed=seed,
    )  # fmt: skip
    power = log.power if not step else step * np.round(log.power / step)
    log = DriveLog({**log.channels, "power": power}, log.name)
    return Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle), load


def deviations(step: float) -> np.ndarray:
    """By how many standard errors constant loads were missed."""
    found = []
    for seed in range(12):
        problem, load = problem_of(seed, step)
        model = joint_fit(problem, TERMS).model
        error = np.sqrt(np.asarray(model.covariance)[2, 2])
        found.append((model.coefficient(HOTEL.name) - load) / error)
    return np.array(found)


@pytest.mark.parametrize("step", [0.0, 20.0])
def test_standard_errors_hold_though_power_is_read_in_steps(step: float) -> None:
    assert np.sqrt(np.mean(deviations(step) ** 2)) < 1.5


def autoregression(a: float, n: int = 4000, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=n)
    series = np.zeros(n)
    for k in range(1, n):
        series[k] = a * series[k - 1] + noise[k]
    return series


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_a_series_tells_its_process_whatever_its_unit(a: float) -> None:
    """Of a first-order autoregression ``1 - a^2`` is new, and ``(1 + a) / (1 - a)`` repeats."""
    series, pieces = autoregression(a), [slice(0, 4000)]
    for unit in (1e-6, 1.0, 1e3):
        assert innovation_share(unit * series, pieces) == pytest.approx(1 - a**2, rel=0.1)
        assert repeats_of(unit * series, pieces) == pytest.approx((1 + a) / (1 - a), rel=0.2)


def test_the_jackknife_of_a_mean_is_the_variance_of_its_mean() -> None:
    values = np.random.default_rng(2).normal(size=(5000, 2)) * [1.0, 3.0]
    moved = (values.sum(axis=0) - values) / (len(values) - 1)
    by_hand = np.cov(values.T) / len(values)
    assert jackknife(moved) == pytest.approx(by_hand, rel=0.01, abs=1e-6)


def test_intervals_of_few_blocks_hold_as_often_as_they_say() -> None:
    rng, inside = np.random.default_rng(3), []
    for _ in range(2000):
        values = rng.normal(size=(8, 1))
        moved = (values.sum(axis=0) - values) / 7
        inside.append(abs(values.mean()) < 1.96 * np.sqrt(jackknife(moved)[0, 0]))
    assert 0.93 < np.mean(inside) < 0.98


ICR = TreadICR(0.45, 0.45)


def test_noise_of_readings_in_steps() -> None:
    true = 0.4 + np.random.default_rng(0).normal(0.0, 0.003, 4000)
    stepped = 0.02 * np.round(true / 0.02)
    assert 0.0 <= reading_noise(stepped) <= 0.5 * 0.02
    flickering = 0.02 * np.round((true + 0.01) / 0.02)
    # Half of the readings on either side of a step: a deviation of half a step.
    assert reading_noise(flickering) == pytest.approx(0.01, rel=0.1)
    fine = np.random.default_rng(1).normal(0.0, 0.003, 4000)
    assert reading_noise(fine) == pytest.approx(0.003, rel=0.1)
    # Without noise the corners of a schedule are no noise.
    t = np.arange(0.0, 60.0, 0.05)
    assert reading_noise(np.interp(t, [0, 10, 12, 30, 33, 60], [0, 0, 0.6, 0.6, 0.2, 0.2])) < 1e-12


def slight_turn(rate_noise: float, offset: float, seed: int = 0) -> tuple[Motion, np.ndarray]:
    """Standing, spinning, then a turn of 3 mm/s that the wheels' noise hides, then none."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.05)
    mean = np.select([t < 10, t < 30], [0.0, 0.0], 0.5)
    difference = np.select([t < 10, t < 30, t < 45], [0.0, 0.6, 0.003], 0.0)
    left, right = mean - difference / 2, mean + difference / 2
    rate = difference / ICR.slip_track + offset + rng.normal(0.0, rate_noise, len(t))
    moving = (mean != 0.0) | (difference != 0.0)
    left, right = (v + moving * rng.normal(0.0, 0.015, len(t)) for v in (left, right))
    return Motion(left, right, ICR, {"yaw_rate": rate}), t


def test_a_gyroscope_tells_slight_turns() -> None:
    motion, t = slight_turn(rate_noise=0.003, offset=0.01)
    plain = quiet(Motion(motion.v_left, motion.v_right, ICR), t)
    told = quiet(motion, t)
    turns, straight = (t > 32) & (t < 43), (t > 47) & (t < 58)
    assert np.mean(plain.omega[turns] > 0) < 0.5
    assert np.mean(told.omega[turns] > 0) > 0.95
    assert np.mean(told.omega[straight] == 0.0) > 0.95
