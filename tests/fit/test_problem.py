"""Fits with losses: what they say they leave, and where they end."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from energyplan import PowerModel, simulate
from energyplan.fit.drive import prepared
from energyplan.fit.estimate import PAPER, Problem, fit
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS
from energyplan.power.effects import COPPER_LOSS, STRIBECK

LOST = 0.7
TERMS = [*PAPER, DRIVE_LOSS]


@pytest.fixture(scope="module")
def returning() -> Problem:
    """Drives of a robot that loses most of what its sides return."""
    truth = PowerModel.preset("quadriga:full:concrete").with_term(REGENERATION_LOSS, LOST)
    log = simulate.identification_drive(
        truth, seed=1, power_noise=5.0, speed_noise=0.002, without={"accel_x"}
    )
    return Problem(prepared([log], truth.vehicle), truth.vehicle)


@pytest.mark.parametrize("start", [None, (0.4, 248.0), (0.9, 60.0)])
def test_a_fit_with_losses_ends_at_coefficients_that_leave_what_it_says(
    returning: Problem, start: tuple[float, float] | None
) -> None:
    errors = returning.reference(returning.design(PAPER))
    known = start and dict(zip((term.name for term in PAPER), start, strict=True))
    design = returning.design(TERMS, errors, known)
    found = fit(design, errors)
    about = returning.design_about(TERMS, found.values)
    for told, true in zip(design.rows, about.rows, strict=True):
        left = told[:, -1] - told[:, :-1] @ found.values
        assert left == pytest.approx(true[:, -1] - true[:, :-1] @ found.values, abs=1e-6)
    # Powers tell the round trip alone: the same share of it is lost while the robot draws.
    assert found.values[-1] == pytest.approx(1.0 / (1.0 - LOST) - 1.0, rel=0.02)


@pytest.mark.parametrize("lost", [0.5, 0.9])
@pytest.mark.parametrize("measured", ["sides", "total"])
def test_a_fit_with_a_loss_ends_at_the_least_of_all_whatever_the_loss(
    lost: float, measured: Literal["sides", "total"]
) -> None:
    """A loss multiplies all forces: along that valley no fit from another loss leaves less."""
    truth = PowerModel.preset("quadriga:full:concrete").with_term(REGENERATION_LOSS, lost)
    log = simulate.drive(
        truth, simulate.IDENTIFICATION, seed=1, rate=10.0, power_noise=5.0, speed_noise=0.002,
        without={"accel_x"}, measured=measured,
    )  # fmt: skip
    drives = prepared([log], truth.vehicle)
    problem = Problem(drives, truth.vehicle)
    errors = problem.reference(problem.design(PAPER))

    def left(start: dict[str, float] | None) -> float:
        design = Problem(drives, truth.vehicle).design(TERMS, errors, start)
        return fit(design, errors).loss

    paper = fit(problem.design(PAPER), errors).values
    others = [
        left(dict(zip((t.name for t in TERMS), [*paper / (1.0 + loss), loss], strict=True)))
        for loss in (0.1, 0.3, 1.0, 3.0, 10.0)
    ]
    assert left(None) < 1.02 * min(others)


@pytest.fixture(scope="module", params=["total", "sides"])
def slipping(request: pytest.FixtureRequest) -> tuple[PowerModel, Problem]:
    """A drive of a robot with copper loss, whose treads stick more the slower they slide."""
    stribeck = replace(STRIBECK, params={"slip_speed": 0.08})
    truth = PowerModel.preset("quadriga:full:concrete").with_term(stribeck, 0.2)
    truth = truth.with_term(COPPER_LOSS, 1.5e-3)
    log = simulate.drive(
        truth, simulate.IDENTIFICATION, seed=1, rate=10.0, power_noise=5.0, speed_noise=0.002,
        without={"accel_x"}, measured=request.param,
    )  # fmt: skip
    return truth, Problem(prepared([log], truth.vehicle), truth.vehicle)


@pytest.mark.parametrize("far", [(0.5, 0.4, 0.0, 8.0), (0.6, 0.45, 0.0, 2.5), None])
def test_a_fit_with_losses_comes_from_far_off(
    slipping: tuple[PowerModel, Problem], far: tuple[float, ...] | None
) -> None:
    """Where whole steps lead to nothing better, short ones do; impossible sizes are no start."""
    truth, problem = slipping
    errors = problem.reference(problem.design(PAPER))

    def left(factors: tuple[float, ...] | None) -> float:
        start = None
        if factors is not None:
            values = truth.coefficients * np.array(factors)
            start = dict(zip((term.name for term in truth.terms), values.tolist(), strict=True))
        fresh = Problem(problem.drives, truth.vehicle)
        return fit(fresh.design(truth.terms, errors, start), errors).loss

    assert left(far) == pytest.approx(left((1.0, 1.0, 1.0, 1.0)), rel=0.02)


def test_what_counts_as_nothing_is_a_part_of_the_power_and_of_the_sides_difference() -> None:
    """Where contacts hold, the difference says nothing."""
    model = PowerModel.preset("quadriga:full:concrete")
    log = simulate.identification_drive(model, seed=1)
    (drive,) = prepared([log], model.vehicle)
    found = Problem([drive], model.vehicle).floor
    power = log.channel("p_left") + log.channel("p_right")
    apart = (log.channel("p_right") - log.channel("p_left"))[drive.slides != 0.0]
    assert 0 < len(apart) < len(power)
    assert found[:3] == pytest.approx(0.01**2 * np.mean(power**2))
    assert found[3:] == pytest.approx(0.05**2 * np.sum(apart**2) / len(power))
