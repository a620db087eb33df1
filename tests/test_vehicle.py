from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import MotorLimits, TreadICR, Vehicle
from energyplan.errors import UnknownNameError, VehicleError
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"loads": [1e308] * 4}, r"loads\[0\] is 1e\+308; give 0 to 1e\+06 N"),
        ({"loads": [1.0, 1.0, 1.0, 2e9]}, r"loads\[3\] is 2000000000.0"),
        ({"contacts": [(1e5, 1), (-1, 1), (1, -1), (-1, -1)]}, r"contacts\[0\]\[0\] is 100000"),
        ({"footprint": [(-1, -1), (1, 1e308)]}, r"footprint\[1\]\[1\] is 1e\+308; give -30"),
        ({"footprint": [(-1, -1), (1, np.nan)]}, r"footprint\[1\]\[1\] is nan"),
        ({"loads": [0.0] * 4}, "loads are all 0"),
        ({"footprint": [(-0.05, -1), (0.05, 1)]}, "outside the footprint along x.*enlarge length"),
        ({"footprint": [(-1, -1), (1, 0.1)]}, "outside the footprint along y.*enlarge width"),
        ({"contacts": np.zeros((0, 2)), "loads": []}, "give rows"),
    ],
)
def test_what_no_vehicle_has_is_an_error(change: dict[str, list[float]], words: str) -> None:
    """Such numbers would overflow in the slip moment, or in what is made of it."""
    with pytest.raises(VehicleError, match=words):
        replace(Vehicle.preset("jackal"), **change)


@pytest.mark.parametrize("value", [1e308, -1e308, np.inf, np.nan, 2e4])
def test_tread_icrs_beyond_any_vehicle_are_an_error(value: float) -> None:
    with pytest.raises(VehicleError, match=r"tread ICR .* give -1000 to 1000 m"):
        TreadICR(value, 0.4)


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"loads": [1.0, 1.0]}, "one load each"),
        ({"loads": [1.0, 1.0, 1.0, -1.0]}, r"loads\[3\] is -1"),
        ({"loads": [1.0, 1.0, 1.0, np.nan]}, r"loads\[3\] is nan"),
        ({"contacts": np.full((4, 2), 0.1)}, "on one side"),
        ({"contacts": np.zeros((4, 3))}, "rows of"),
        ({"footprint": [[0.5, 0.5], [-0.5, -0.5]]}, "x_max > x_min"),
        ({"drive_efficiency": 0.0}, "drive_efficiency"),
        ({"regen_efficiency": 1.2}, "regen_efficiency"),
        ({"max_yaw_rate": -1.0}, "max_yaw_rate"),
    ],
)
def test_bad_vehicles_are_refused(change: dict[str, object], message: str) -> None:
    good = vars(Vehicle.preset("quadriga"))
    with pytest.raises(VehicleError, match=message):
        Vehicle(**{**good, **change})


def test_bad_limits_and_icrs_are_refused() -> None:
    with pytest.raises(VehicleError, match="below continuous_power"):
        MotorLimits(continuous_power=100.0, peak_power=50.0)
    with pytest.raises(VehicleError, match="nan"):
        MotorLimits(force=float("nan"))
    with pytest.raises(VehicleError, match="slip track"):
        TreadICR(0.1, -0.2)
    with pytest.raises(UnknownNameError, match="jackal"):
        Vehicle.preset("jakal")
    with pytest.raises(VehicleError, match="mass"):
        Vehicle.from_geometry("x", mass=0, wheelbase=1, track=1, length=1, width=1)


@pytest.mark.parametrize("name", ["quadriga:empty", "quadriga:full", "husky_a200", "jackal"])
def test_yaw_inertia_is_that_of_a_uniform_box(name: str) -> None:
    vehicle = Vehicle.preset(name)
    (x_min, y_min), (x_max, y_max) = vehicle.footprint
    cells = 400
    x = np.linspace(x_min, x_max, cells, endpoint=False) + 0.5 * (x_max - x_min) / cells
    y = np.linspace(y_min, y_max, cells, endpoint=False) + 0.5 * (y_max - y_min) / cells
    squares = (x[:, None] - x.mean()) ** 2 + (y[None, :] - y.mean()) ** 2
    assert vehicle.yaw_inertia == pytest.approx(vehicle.mass * squares.mean(), rel=1e-4)
