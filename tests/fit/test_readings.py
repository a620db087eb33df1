"""What the steps of sensors leave uncertain, against many readings and many drives."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.fit.drive import Steps, prepared
from energyplan.fit.estimate import (
    PAPER,
    Problem,
    fit,
    joint_fit,
    reading_covariance,
)
from energyplan.power import HOTEL

ROBOT = PowerModel.preset("quadriga:full:concrete")
TERMS = (*PAPER, HOTEL)


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


def test_sensors_without_steps_add_nothing() -> None:
    problem, _ = problem_of(2, 0.0)
    errors = problem.reference(problem.design(TERMS))
    values = fit(problem.design(TERMS, errors), errors).values
    design = problem.design(TERMS, errors)
    assert not np.any(reading_covariance(problem, TERMS, values, design, errors))
