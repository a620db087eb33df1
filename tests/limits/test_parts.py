"""Parts of speed profiles, each against an integral or a derivative by hand."""

from __future__ import annotations

import numpy as np
import pytest
from limits.test_speed import INERTIA, PAPER
from numpy.testing import assert_allclose

from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.speed import profile
from energyplan.path import Path, Pose
from energyplan.power.effects import term
from energyplan.terrain import HeightMap
from energyplan.vehicle import GRAVITY

RNG = np.random.default_rng(6)


def test_a_steady_speed_is_held_back_by_no_inertia() -> None:
    curvature, speed = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 1.5, 16)
    still, heavy = (feasible_region(model, curvature, speed) for model in (PAPER, INERTIA))
    assert 0 < still.sustained.sum() < still.sustained.size
    assert np.array_equal(still.sustained, heavy.sustained)
    assert_allclose(still.use, heavy.use)
    assert_allclose(still.max_speed, heavy.max_speed)


def test_energy_up_a_slope_is_that_of_the_longer_way_and_the_climb() -> None:
    """Resistance acts along the ground, which is longer than the plan, and gravity up it."""
    model = PAPER.with_term(term("grade"), 50.0)
    rise = 0.3
    ground = HeightMap(rise * np.arange(12.0) * np.ones((4, 1)), 1.0)
    trajectory = profile(Path(Pose(2.0, 2.0, 0.0), [6.0], [0.0]), model, heights=ground)
    found = check(trajectory, model, heights=ground).energy
    resistance = 2.0 * model.coefficient("traction_resistance") * 6.0 * np.hypot(1.0, rise)
    assert found == pytest.approx(resistance + 50.0 * GRAVITY * rise * 6.0, rel=1e-3)
