from __future__ import annotations

import numpy as np
import pytest

from energyplan import TreadICR, Vehicle
from energyplan.errors import VehicleError
from energyplan.vehicle import GRAVITY, predict_icr, wheel_loads


@pytest.mark.parametrize(
    ("name", "published"), [("quadriga:empty", 264.0), ("quadriga:full", 466.0)]
)
def test_slip_moment_of_quadriga_is_the_published_one(name: str, published: float) -> None:
    assert Vehicle.preset(name).slip_moment == pytest.approx(published, rel=5e-3)


def test_predicted_icr_balances_the_moment_of_a_steady_spin() -> None:
    # With the ICRs at +-C each contact slides square to its reach from the tread's ICR. Isotropic
    # friction then gives a longitudinal force on each wheel; in a steady spin the slip force of a
    # wheel must do the work that its own sliding dissipates, which fixes C.
    wheelbase, track = 0.61, 0.45
    ax, ay = track / 2, wheelbase / 2
    best = min(
        np.linspace(ax, 4 * ax, 20001),
        key=lambda C: abs((C - ax) / np.hypot(C - ax, ay) * ax - ay**2 / np.hypot(C - ax, ay)),
    )
    assert predict_icr(wheelbase, track) == pytest.approx(best, rel=1e-3)


def test_wheel_loads_balance_force_and_moments() -> None:
    contacts = [(0.3, 0.2), (0.0, 0.25), (-0.3, 0.2), (0.3, -0.2), (0.0, -0.25), (-0.3, -0.2)]
    cog = np.array([0.05, -0.03])
    loads = wheel_loads(contacts, 40.0, cog)
    assert loads.sum() == pytest.approx(40.0 * GRAVITY)
    assert loads @ np.array(contacts) / loads.sum() == pytest.approx(cog)
    assert loads[0] > loads[2]


def test_a_wheel_that_would_lift_is_an_error() -> None:
    with pytest.raises(VehicleError, match="lift off"):
        wheel_loads([(1, 1), (-1, 1), (1, -1), (-1, -1)], 10.0, (1.5, 0.0))


def test_asymmetric_icr() -> None:
    icr = TreadICR(0.5, 0.4, 0.1)
    assert icr.half_track == pytest.approx(0.45)
    assert icr.centre == pytest.approx((0.1, 0.05))


def test_slip_moment_with_general_contacts() -> None:
    vehicle = Vehicle(
        "three", np.array([(0.5, 0.0001), (-0.2, 0.3), (-0.2, -0.3)]), np.array([10.0, 20.0, 30.0]),
        TreadICR(0.4, 0.6, -0.2), np.array([(-0.5, -0.5), (0.5, 0.5)]),
    )  # fmt: skip
    by_hand = 10 * np.hypot(0.7, 0.3999) + 20 * 0.1 + 30 * 0.3
    assert vehicle.slip_moment == pytest.approx(by_hand)


@pytest.mark.parametrize("name", ["quadriga:empty", "quadriga:full", "husky_a200", "jackal"])
def test_yaw_inertia_is_that_of_a_uniform_box(name: str) -> None:
    vehicle = Vehicle.preset(name)
    (x_min, y_min), (x_max, y_max) = vehicle.footprint
    cells = 400
    x = np.linspace(x_min, x_max, cells, endpoint=False) + 0.5 * (x_max - x_min) / cells
    y = np.linspace(y_min, y_max, cells, endpoint=False) + 0.5 * (y_max - y_min) / cells
    squares = (x[:, None] - x.mean()) ** 2 + (y[None, :] - y.mean()) ** 2
    assert vehicle.yaw_inertia == pytest.approx(vehicle.mass * squares.mean(), rel=1e-4)
