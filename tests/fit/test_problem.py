"""Fits with losses: what they say they leave, and where they end."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.fit.drives.windows import prepared
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import PAPER, Problem
from energyplan.power import HOTEL, REGENERATION_LOSS

TERMS = [*PAPER, HOTEL, REGENERATION_LOSS]


@pytest.fixture(scope="module")
def unsigned() -> Problem:
    """A robot whose sensors lack the sign, which no loss of it explains: losses bend often."""
    model = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
    log = simulate.identification_drive(
        model, seed=1, power_noise=5.0, speed_noise=0.002, without={"accel_x"}
    )
    shown = {name: np.abs(log.channel(name)) for name in ("p_left", "p_right")}
    drives = prepared([DriveLog({**log.channels, **shown}, "rectified")], model.vehicle)
    return Problem(drives, model.vehicle)


@pytest.mark.parametrize("resistance", [118.0, 248.0])
def test_a_fit_with_losses_leaves_what_its_coefficients_leave(
    unsigned: Problem, resistance: float
) -> None:
    start = {"slip_friction": 0.4, "traction_resistance": resistance}
    design = unsigned.design(TERMS, None, start)
    found = fit(design, np.ones(len(design.rows)))
    about = unsigned.design_about(TERMS, found.values)
    for told, true in zip(design.rows, about.rows, strict=True):
        left = told[:, -1] - told[:, :-1] @ found.values
        assert left == pytest.approx(true[:, -1] - true[:, :-1] @ found.values, abs=1e-6)


def test_one_round_is_a_linearisation_about_the_start(unsigned: Problem) -> None:
    start = dict(zip((term.name for term in TERMS), [0.6, 130.0, 20.0, 0.5], strict=True))
    design = unsigned.design(TERMS, None, start, rounds=1)
    about = unsigned.design_about(TERMS, np.array(list(start.values())))
    assert design.ended is None
    assert np.array_equal(design.rows[0], about.rows[0])
