"""What the steps of sensors leave uncertain, against many readings and many drives."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.fit.drive import prepared, reading_step
from energyplan.fit.estimate import PAPER, Problem, joint_fit
from energyplan.power import HOTEL

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
