from __future__ import annotations

import numpy as np
import pytest

from energyplan import Motion, Trajectory, TreadICR
from energyplan.errors import InvalidInputError, MissingChannelError

ICR = TreadICR(0.5, 0.4, 0.1)


def test_twist_and_tread_speeds_are_inverse() -> None:
    rng = np.random.default_rng(0)
    v, omega = rng.normal(size=(2, 3, 4))
    motion = Motion.from_twist(v, omega, ICR)
    assert motion.shape == (3, 4)
    assert motion.v == pytest.approx(v)
    assert motion.omega == pytest.approx(omega)


def test_equation_1() -> None:
    motion = Motion(0.2, 0.67, TreadICR.symmetric(0.47))
    assert float(motion.omega) == pytest.approx(0.47 / 0.94)
    assert float(motion.v) == pytest.approx(0.435)


def test_missing_channel_is_named() -> None:
    with pytest.raises(MissingChannelError, match="'slope': ground slope"):
        Motion(0.0, 0.0, ICR).channel("slope")


def test_shapes_that_do_not_broadcast_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="slope"):
        Motion(np.zeros(3), np.zeros(3), ICR, {"slope": np.zeros(4)})
    with pytest.raises(InvalidInputError, match=r"'v': \(3,\), 'omega': \(4,\)"):
        Motion.from_twist(np.zeros(3), np.zeros(4), ICR)


def test_accelerations_of_a_trajectory() -> None:
    t = np.linspace(0, 2, 201)
    yaw = 0.2 * t**2
    trajectory = Trajectory(t, t, t, yaw, 0.3 * t, 0.4 * t)
    motion = Motion.from_trajectory(trajectory, ICR)
    assert motion.channel("accel") == pytest.approx(np.full(201, 0.3))
    assert motion.channel("yaw_accel") == pytest.approx(np.full(201, 0.4))
    assert motion.channel("slope") == pytest.approx(np.zeros(201))
