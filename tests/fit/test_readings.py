"""What the steps of sensors leave uncertain, against many readings and many drives."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.fit.drive import Steps, prepared
from energyplan.fit.estimate import (
    PAPER,
    Problem,
    _by_side,
    fit,
    joint_fit,
    moved_by,
    reading_covariance,
)
from energyplan.power import HOTEL

ROBOT = PowerModel.preset("quadriga:full:concrete")
TERMS = (*PAPER, HOTEL)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3])
def test_the_error_of_a_mean_is_that_of_many_means(noise: float) -> None:
    rng = np.random.default_rng(3)
    true = np.repeat(rng.uniform(0.0, 40.0, 400), 200)
    read = 0.5 * np.round((true + rng.normal(0.0, 0.5 * noise + 1e-12, len(true))) / 0.5)
    told = Steps.of(read)
    errors = (read - true).reshape(400, 200).mean(axis=1)
    assert told.size == pytest.approx(0.5)
    # It falls with the square of the noise in an exponent, and noise is known to a tenth: 3 % of a
    # step, where that is small.
    assert told.error == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.35, abs=0.015)


def test_noise_of_a_step_or_more_averages_steps_out() -> None:
    read = np.round(np.random.default_rng(4).normal(20.0, 1.0, 2000))
    assert Steps.of(read).error < 1e-3


@pytest.mark.parametrize(
    "values",
    [np.random.default_rng(5).normal(size=300), np.zeros(300), np.arange(4.0), np.ones(300)],
    ids=["without steps", "dead", "too few", "constant"],
)
def test_what_has_no_steps_leaves_nothing(values: np.ndarray) -> None:
    assert Steps.of(values) == Steps()


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


def test_coefficients_move_with_a_sample_as_another_fit_says() -> None:
    problem, _ = problem_of(1, 0.0)
    errors = problem.reference(problem.design(TERMS))
    design = problem.design(TERMS, errors)
    (moved,) = moved_by(problem.drives, design, errors)
    more = np.random.default_rng(0).normal(0.0, 5.0, len(problem.drives[0].t))
    rows = [np.array(table) for table in design.rows]
    for table, windows in zip(rows, problem.drives[0].windows, strict=True):
        table[:, -1] += windows.mean(more)
    other = fit(type(design)(tuple(rows), design.blocks, design.drives), errors).values
    assert other - fit(design, errors).values == pytest.approx(
        np.einsum("t,tk->k", more, moved[:, 0]), rel=1e-6
    )


def test_sensors_without_steps_add_nothing() -> None:
    problem, _ = problem_of(2, 0.0)
    errors = problem.reference(problem.design(TERMS))
    values = fit(problem.design(TERMS, errors), errors).values
    design = problem.design(TERMS, errors)
    assert not np.any(reading_covariance(problem, TERMS, values, design, errors))


def test_a_watt_more_of_one_side_is_one_of_the_sum_and_of_the_difference() -> None:
    drive = prepared([simulate.validation_drive(ROBOT, seed=3)], ROBOT.vehicle)[0]
    moved = np.random.default_rng(2).normal(size=(len(drive.t), 2, 3))
    left, right = (_by_side(drive, moved, side) for side in (0, 1))
    slides = drive.slides == 1.0
    assert 0 < np.count_nonzero(slides) < len(slides)
    # where contacts hold, the difference is no evidence
    np.testing.assert_allclose(left[~slides], moved[~slides, 0])
    np.testing.assert_allclose(right[slides], moved[slides].sum(axis=1))
    np.testing.assert_allclose(left + right, 2.0 * moved[:, 0])
