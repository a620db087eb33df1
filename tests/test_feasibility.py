import numpy as np
import pytest

from energyplan.feasibility import check
from energyplan.path import Trajectory
from energyplan.power import PowerModel


def spin(rate, n=201, duration=10.0):
    t = np.linspace(0, duration, n)
    return Trajectory(t, 0 * t, 0 * t, rate * t, 0 * t, rate + 0 * t)


def test_speed_scale_of_a_spin_is_the_speed_limit_over_the_tread_speed():
    model = PowerModel.preset("quadriga:empty:concrete")
    report = check(spin(3.0), model)
    assert not report.feasible
    assert report.max_speed_scale == pytest.approx(1.2 / (0.47 * 3.0), rel=1e-12)
    assert report.energy == pytest.approx(
        10 * float(model.coefficients @ [model.vehicle.slip_moment * 3.0, 2 * 0.47 * 3.0])
    )
