"""The drives that a regression sees: cleaned speeds, pieces between gaps, left and right alike."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan.fit import identify
from energyplan.fit.drives.denoise import quiet
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel

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


@pytest.mark.parametrize("samples", range(1, 12))
def test_a_stretch_shorter_than_any_average_keeps_its_turn(samples: int) -> None:
    """Before a gap of the clock lie few samples; beyond it, a drive with noise to be taken out."""
    rng = np.random.default_rng(samples)
    n = 400
    t = PERIOD * np.arange(n)
    t[samples:] += 5.0
    left, right = np.full(n, 0.5), np.full(n, 0.5)
    left[:samples], right[200:300] = 0.3, 0.9
    left, right = (v + rng.normal(0.0, 0.01, n) for v in (left, right))
    rate = (right - left) / ICR.slip_track + rng.normal(0.0, 0.01, n)
    clean = quiet(Motion(left, right, ICR, {"yaw_rate": rate}), t)
    assert np.all(clean.omega[:samples] > 0.0)
    assert np.all(np.isfinite(clean.v))


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
