"""Speeds that motions are priced at: as asked, within limits, and the cheapest of a range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan import EnergyCost, MotorLimits, Path, Pose, PowerModel, TreadICR, Vehicle
from energyplan.cost.speeds import admissible_rate, cheapest_rate, last_within, parse_speed
from energyplan.path import FloatArray
from energyplan.power import Sides
from energyplan.power.effects import term

VEHICLE = Vehicle.preset("husky_a200")
MODEL = PowerModel.paper(VEHICLE, K=40.0, mu=0.5)


def test_what_is_asked_is_a_speed_the_cheapest_or_the_usual_one() -> None:
    def driven(vehicle: Vehicle, **asked: Any) -> float | None:
        return EnergyCost(replace(MODEL, vehicle=vehicle), **asked).tread_speed

    assert driven(VEHICLE, speed="cheapest") is None
    assert driven(VEHICLE) == VEHICLE.motor.speed
    assert driven(replace(VEHICLE, usual_speed=0.4)) == 0.4
    assert driven(replace(VEHICLE, usual_speed=0.4), time_value=1.0) is None
    assert driven(replace(VEHICLE, motor=MotorLimits())) is None
    assert parse_speed(None, VEHICLE) is None
    assert parse_speed("cheapest", VEHICLE) == "cheapest"
    assert parse_speed("0.6", VEHICLE) == driven(VEHICLE, speed=0.6) == 0.6
    # a largest speed is accepted as it is printed, rounded to four digits
    odd = replace(VEHICLE, motor=replace(VEHICLE.motor, speed=1.2277168))
    assert parse_speed("1.228", odd) == 1.2277168


@pytest.mark.parametrize("per_radian", [0.0, 0.4, 90.0])
@pytest.mark.parametrize("icr", [0.5, TreadICR(0.6, 0.3, 0.1)])
def test_two_coefficients_make_a_cost(per_radian: float, icr: float | TreadICR) -> None:
    cost = EnergyCost.from_coefficients(201.5, per_radian, icr)
    ds, dtheta = np.array([1.0, 0.0, 0.3, -2.0]), np.array([0.0, 1.0, -1.5, 0.2])
    # the point midway between the treads' ICRs lies 0.15 m to the left of the second robot's origin
    C, aside = (0.5, 0.0) if icr == 0.5 else (0.45, 0.15)
    metres = np.maximum(np.abs(ds - aside * dtheta), C * np.abs(dtheta))
    expected = 201.5 * metres + per_radian * np.abs(dtheta)
    assert_allclose(cost.segment_energy(ds, dtheta), expected, rtol=1e-9)
    # its body is a square about the treads
    assert_allclose(np.ptp(cost.vehicle.footprint, axis=0), 4 * C)
    # a metre takes a second unless another speed is given
    assert cost.model.vehicle.motor.speed == 1.0
    assert EnergyCost.from_coefficients(200.0, 1.0, icr, 0.4).model.vehicle.motor.speed == 0.4


@pytest.mark.parametrize(
    ("law", "most"),
    [
        (lambda x, end: np.where(x <= end, 0.0, np.inf), 200),  # only on which side it is
        (lambda x, end: np.maximum(x / end, 1.0 + 9.0 * (x - end)), 200),  # bent where it ends
        (lambda x, end: np.maximum(0.7 * x / end, 1.0 + 9.0 * (x - end)), 60),
        (lambda x, end: (x / end) ** 3, 40),
    ],
    ids=["step", "bent there", "bent", "power"],
)
def test_the_last_value_within_limits_is_found_to_the_last_bits(
    law: Callable[[FloatArray, FloatArray], FloatArray], most: int
) -> None:
    ends, tried = np.array([0.1, 1.0 / 3.0, 0.77, 1.0 - 1e-9]), []

    def use(x: FloatArray) -> FloatArray:
        tried.append(len(x))
        return law(x, ends)

    found = last_within(use, np.zeros(4), np.ones(4))
    assert np.all(law(found, ends) <= 1)
    assert_allclose(found, ends, rtol=1e-14)
    assert sum(tried) <= most
    alone = [last_within(lambda x, end=end: law(x, end), np.zeros(1), np.ones(1)) for end in ends]
    assert found.tolist() == np.concatenate(alone).tolist()


def test_the_cheapest_rate_is_the_least_of_a_range_or_its_end() -> None:
    slowest, limit = np.array([0.01, 0.01, 2.0, 0.5]), np.array([4.0, 0.2, 5.0, 0.5])
    found = cheapest_rate(slowest, limit, lambda w: w + 1.0 / w)  # least at 1
    assert_allclose(found, [1.0, 0.2, 2.0, 0.5], rtol=1e-5)
    # of two valleys the deeper one
    two = cheapest_rate(
        np.array([0.05]), np.array([5.0]),
        lambda w: np.minimum(np.log(w / 0.2) ** 2 + 0.3, np.log(w / 2.0) ** 2),
    )  # fmt: skip
    assert_allclose(two, 2.0, rtol=1e-5)


def test_of_rates_that_cost_the_same_it_is_the_fastest() -> None:
    rng = np.random.default_rng(4)

    def noisy(w: FloatArray, energy: FloatArray) -> FloatArray:
        return energy * (1.0 + 1e-15 * rng.normal(size=w.shape))

    slowest, limit = np.full(50, 0.05), np.linspace(0.2, 3.0, 50)
    level = cheapest_rate(slowest, limit, lambda w: noisy(w, 7.0 + 0.0 * w))
    assert level.tolist() == limit.tolist()
    rising = cheapest_rate(slowest, limit, lambda w: noisy(w, 7.0 + np.maximum(w - 1.0, 0.0)))
    assert_allclose(rising, np.minimum(limit, 1.0), rtol=1e-5)


@pytest.mark.parametrize("turn", [0.0, 1e-16, -1e-14, 1e-13])
def test_a_straight_line_is_driven_fast_whatever_else_depends_on_speed(turn: float) -> None:
    """Friction that falls as treads slide is none on a straight line: its energy knows no speed."""
    model = replace(MODEL, vehicle=VEHICLE.with_icr(TreadICR(0.52, 0.41)))
    cost = EnergyCost(model.with_term(term("stribeck_friction"), 0.3))
    straight = Path(Pose(0, 0, 0), [0.0073], [turn])
    assert cost.duration(straight) == pytest.approx(0.0073 / VEHICLE.motor.speed)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_power_of_either_motor_limits_the_rate(side: str) -> None:
    """Constant forces: a side draws, or returns, its force times its speed."""
    vehicle = replace(
        VEHICLE, motor=MotorLimits(speed=50.0, continuous_power=40.0, regeneration=15.0)
    )
    x, y = np.array([1.0, 0.3, -0.5, 1.0]), np.array([0.2, 0.6, 0.1, -0.4])
    travel = x - y if side == "left" else x + y
    for force in (100.0, -100.0):
        other = Sides(*(force * (side == name) + 0 * x for name in ("left", "right")))
        power = force * travel
        expected = np.where(power > 0, 40.0, 15.0) / np.abs(power)
        found = admissible_rate(x, y, vehicle, lambda *_, other=other: other)
        assert_allclose(found, expected, rtol=1e-9)
