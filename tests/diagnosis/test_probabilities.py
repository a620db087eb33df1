"""Evidence: slight turns, and explanations that drives cannot tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.fit.drive import quiet, reading_noise
from energyplan.motion import Motion
from energyplan.vehicle import TreadICR

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
