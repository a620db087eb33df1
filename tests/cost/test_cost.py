"""EnergyCost against closed forms, bounds, and the power model evaluated motion by motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from refusals import check_refusal, lines

from energyplan import (
    EnergyCost,
    Motion,
    MotorLimits,
    Path,
    Pose,
    PowerModel,
    SurfaceMap,
    TreadICR,
    Vehicle,
    steering,
)
from energyplan.cost.speeds import parse_speed
from energyplan.errors import MissingChannelError
from energyplan.power import HOTEL, TRACTION, Term
from energyplan.power.effects import GRADE, VISCOUS_LOSS, catalogue, empirical_term, term
from energyplan.terrain import Surface

MODEL = PowerModel.preset("quadriga:full:marble")
C = MODEL.vehicle.icr.half_track
K, MU = MODEL.coefficient("traction_resistance"), MODEL.coefficient("slip_friction")
SLIP_FORCE = MU * MODEL.vehicle.slip_moment / (2 * C)


def with_vehicle(model: PowerModel, **changes: object) -> PowerModel:
    return replace(model, vehicle=replace(model.vehicle, **changes))


def random_elements(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    ds, dtheta = rng.normal(size=(2, n))
    return ds, dtheta


@pytest.mark.parametrize("hotel", [0.0, 60.0])
def test_cost_is_the_closed_form(hotel: float) -> None:
    """A hotel load adds the time at the speed limit."""
    model = with_vehicle(MODEL, motor=MotorLimits(speed=1.2)).with_term(HOTEL, hotel)
    ds, dtheta = random_elements(1000)
    expected = 2 * K * np.maximum(abs(ds), C * abs(dtheta)) + 2 * C * SLIP_FORCE * abs(dtheta)
    expected = expected + hotel * (abs(ds) + C * abs(dtheta)) / 1.2
    found = EnergyCost(model).segment_energy(ds, dtheta)
    np.testing.assert_allclose(found, expected, rtol=1e-9 if hotel else 1e-12)


def test_lossy_regeneration_is_the_closed_form() -> None:
    eta, back = 0.8, 0.3
    model = with_vehicle(MODEL, drive_efficiency=eta, regen_efficiency=back)
    ds, dtheta = random_elements(1000)
    left, right = ds - C * dtheta, ds + C * dtheta
    expected = np.zeros(1000)
    for travel, force in ((left, -SLIP_FORCE), (right, SLIP_FORCE)):
        work = force * np.sign(dtheta) * travel + K * abs(travel)
        expected += np.where(work > 0, work / eta, back * work)
    cost = EnergyCost(model, battery=True)
    np.testing.assert_allclose(cost.segment_energy(ds, dtheta), expected, rtol=1e-9)
    # The straight line has no slip force: it costs less than the arcs beside it.
    straight, arc = cost.segment_energy([1.0, 1.0], [0.0, 1e-6])
    assert straight == pytest.approx(2 * K / eta)
    assert arc > 1.2 * straight


def test_cheapest_speed_balances_hotel_load_and_viscous_loss() -> None:
    model = with_vehicle(
        MODEL.with_term(HOTEL, 50.0).with_term(VISCOUS_LOSS, 40.0), motor=MotorLimits(speed=3.0)
    )
    cost = EnergyCost(model, speed="cheapest")
    best = np.sqrt(50.0 / (2 * 40.0))  # least of 2 K + 2 B v + P / v
    least = 2 * K + 2 * 40.0 * best + 50.0 / best
    assert float(cost.cheapest_speed(0.0)) == pytest.approx(best, rel=1e-6)
    assert float(cost.per_metre(0.0)) == pytest.approx(least, rel=1e-9)
    slow = EnergyCost(model, speed=0.3)
    assert float(slow.cheapest_speed(0.0)) == pytest.approx(0.3)
    assert float(slow.per_metre(0.0)) == pytest.approx(2 * K + 2 * 40.0 * 0.3 + 50.0 / 0.3)


def test_table_of_a_smooth_cost_keeps_its_stated_error() -> None:
    model = MODEL.with_term(HOTEL, 50.0).with_term(VISCOUS_LOSS, 40.0)
    cost = EnergyCost(model, speed="cheapest")
    ds, dtheta = random_elements(500, seed=3)
    exact = cost.segment_energy(ds, dtheta, slope=0.0)  # through the model, not the table
    error = np.max(np.abs(cost.segment_energy(ds, dtheta) / exact - 1))
    assert error <= 1.5 * cost.gauge.error
    assert cost.gauge.error < 1e-6


def test_per_metre_and_per_radian_at_a_speed_are_the_models_power() -> None:
    model = MODEL.with_term(HOTEL, 50.0).with_term(VISCOUS_LOSS, 40.0)
    cost = EnergyCost(model)
    curvature = np.array([-3.0, -0.5, 0.0, 0.7])
    power = model.power(Motion.from_twist(0.4, 0.4 * curvature, model.vehicle.icr))
    np.testing.assert_allclose(cost.per_metre(curvature, 0.4), power / 0.4, rtol=1e-12)
    radius = np.array([-C, 0.0, C, 2.0])
    power = model.power(Motion.from_twist(0.3 * radius, 0.3, model.vehicle.icr))
    np.testing.assert_allclose(cost.per_radian(radius, 0.3), power / 0.3, rtol=1e-12)


def test_motor_power_limits_the_speed() -> None:
    model = with_vehicle(MODEL, motor=MotorLimits(continuous_power=200.0, speed=5.0))
    cost = EnergyCost(model)
    assert float(cost.admissible_speed(0.0)) == pytest.approx(200.0 / K)
    outer = (SLIP_FORCE + K) * (1 + C * 0.5)  # W per m/s of the outer side at 0.5 1/m
    assert float(cost.admissible_speed(0.5)) == pytest.approx(200.0 / outer)
    spinning = EnergyCost(with_vehicle(MODEL, max_yaw_rate=0.4))
    path = Path(Pose(0, 0, 0), [0.0], [2.0])
    assert spinning.duration(path) == pytest.approx(5.0)
    assert float(spinning.segment_duration(0.0, 2.0)) == pytest.approx(5.0)


@pytest.mark.parametrize("worth", [0.0, 50.0, 400.0])
def test_a_second_is_worth_something(worth: float) -> None:
    """Straight on, ``2 K v + 2 B v^2 + P + w`` over v is least at ``v^2 = (P + w) / (2 B)``."""
    viscous, hotel = 300.0, 40.0
    model = with_vehicle(MODEL, motor=MotorLimits(speed=1.2))
    cost = EnergyCost(
        model.with_term(VISCOUS_LOSS, viscous).with_term(HOTEL, hotel), speed="cheapest",
        time_value=worth,
    )  # fmt: skip
    speed = min(np.sqrt((hotel + worth) / (2 * viscous)), 1.2)
    assert float(cost.cheapest_speed(0.0)) == pytest.approx(speed, rel=1e-4)
    # and no other energy is counted than the model's
    expected = 2 * K + 2 * viscous * speed + hotel / speed
    assert float(cost.segment_energy(1.0, 0.0)) == pytest.approx(expected, rel=1e-4)
    assert float(cost.segment_duration(1.0, 0.0)) == pytest.approx(1 / speed, rel=1e-4)


@pytest.mark.parametrize("battery", [False, True])
def test_breakdown_adds_up(battery: bool) -> None:
    icr = TreadICR(0.5, 0.42, 0.05)
    model = with_vehicle(
        MODEL.with_term(HOTEL, 50.0), icr=icr, drive_efficiency=0.8, regen_efficiency=0.4
    )
    cost = EnergyCost(model, battery=battery)
    rng = np.random.default_rng(5)
    path = Path(Pose(0, 0, 0), rng.normal(size=20), rng.normal(size=20), longitudinal=0.05)
    parts = cost.breakdown(path)
    assert sum(parts.values()) == pytest.approx(cost.energy(path), rel=1e-12)
    assert parts["hotel_load"] == pytest.approx(50.0 * cost.duration(path), rel=1e-12)
    arcs = cost.segment_energy(path.ds, path.dtheta)
    assert arcs.sum() == pytest.approx(cost.energy(path), rel=1e-6)
    times = cost.segment_duration(path.ds, path.dtheta)
    assert times.sum() == pytest.approx(cost.duration(path), rel=1e-6)
    assert ("regeneration_efficiency" in parts) == battery


@pytest.mark.parametrize("point", [(0.0, 0.0), (0.3, -0.2), (-0.1, 0.4)])
def test_lower_bound_holds_for_every_element(point: tuple[float, float]) -> None:
    icr = TreadICR(0.55, 0.4, 0.07)
    for model in (MODEL, MODEL.with_term(HOTEL, 300.0), MODEL.with_term(VISCOUS_LOSS, 60.0)):
        cost = EnergyCost(with_vehicle(model, icr=icr), battery=True)
        bound = cost.lower_bound(point)
        ds, dtheta = random_elements(2000, seed=4)
        travel = np.hypot(ds - point[1] * dtheta, (point[0] - icr.longitudinal) * dtheta)
        energy = cost.segment_energy(ds, dtheta)
        assert np.all(energy >= bound.energy(travel, dtheta) * (1 - 1e-9))
        assert bound.per_metre > 0


@pytest.mark.parametrize("coefficients", [(200.0, 70.0), (0.8, 0.05)], ids=["usual", "desk"])
def test_lower_bound_of_the_static_model_is_a_and_beta(coefficients: tuple[float, float]) -> None:
    bound = EnergyCost.from_coefficients(*coefficients, icr=0.5).lower_bound()
    assert (bound.per_metre, bound.per_radian) == pytest.approx(coefficients)


WEIGHT = 9.81 * MODEL.vehicle.mass


def test_slope_without_losses_is_a_potential() -> None:
    cost = EnergyCost(MODEL.with_term(GRADE, MODEL.vehicle.mass))
    ds, dtheta = random_elements(300, seed=6)
    slope = np.random.default_rng(7).uniform(-0.4, 0.4, 300)
    rise = ds * np.sin(slope)
    level = cost.segment_energy(ds, dtheta)
    sloping = cost.segment_energy(ds, dtheta, slope)
    np.testing.assert_allclose(sloping - WEIGHT * rise, level, rtol=1e-9)


def test_slope_with_losses_never_undercuts_its_potential() -> None:
    model = with_vehicle(
        MODEL.with_term(GRADE, MODEL.vehicle.mass), drive_efficiency=0.8, regen_efficiency=0.5
    )
    cost = EnergyCost(model, battery=True)
    ds, dtheta = random_elements(2000, seed=8)
    dtheta[:500] = 0.0
    slope = np.random.default_rng(9).uniform(-0.6, 0.6, 2000)
    energy = cost.segment_energy(ds, dtheta, slope)
    assert np.any(energy < 0)  # steep descents return energy
    assert np.all(energy - 0.5 * WEIGHT * ds * np.sin(slope) >= 0)


def test_constant_channels_reach_the_terms() -> None:
    warm = Term(
        "warmth", "w", "N/K", "force",
        lambda motion, vehicle: TRACTION.function(motion, vehicle)
        * float(motion.channel("temperature").flat[0]),
        channels=("temperature",),
    )  # fmt: skip
    model = MODEL.with_term(warm, -0.5)
    with pytest.raises(MissingChannelError, match="temperature"):
        EnergyCost(model)
    cost = EnergyCost(model, channels={"temperature": 20.0})
    assert float(cost.per_metre(0.0)) == pytest.approx(2 * (K - 10.0))


@pytest.mark.parametrize(
    ("of", "channel"),
    [(Term("mud", "c", "W", "power", lambda motion, vehicle: motion.channels["x"] ** 2), "x"),
     (Term("mud", "c", "W", "power", lambda motion, vehicle: 1.0 * (motion.channel("y") > 9)), "y"),
     (Term("cold", "c", "W", "power", lambda motion, vehicle: motion.channel("temperature"),
           channels=("temperature",)), "temperature"),
     (empirical_term("empirical_ground_x", [0, 5], [0, 9]), "x"),
     (empirical_term("empirical_traction_displacement", [0, 5], [0, 9]), "x")],
)  # fmt: skip
def test_a_term_that_reads_what_no_cost_knows_is_refused_by_name(of: Term, channel: str) -> None:
    model = PowerModel.preset("quadriga:empty:marble").with_term(of, 10.0)
    wanted = rf"'{of.name}' of the model .* reads the channel '{channel}' .*channels=.*'{channel}'"
    with pytest.raises(MissingChannelError, match=wanted):
        EnergyCost(model)
    with pytest.raises(MissingChannelError, match=wanted):
        SurfaceMap((Surface(shapely.box(0, 0, 1, 1), model),)).costs(
            EnergyCost(PowerModel.preset("quadriga:empty:marble"))
        )
    known = EnergyCost(model, channels=dict.fromkeys((channel, "x", "y", "yaw"), 0.5))
    assert float(known.segment_energy(1.0, 0.0)) > 0.0


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_costs_take_every_effect_of_the_catalogue(name: str) -> None:
    model = PowerModel.preset("quadriga:empty:marble")
    for one in catalogue()[name].terms:
        model = model if model.has(one.name) else model.with_term(one, 0.1)
    assert float(EnergyCost(model).segment_energy(1.0, 0.0)) > 0.0


def test_a_cost_leaves_the_ground_of_a_place_out_wherever_its_line_lies() -> None:
    model = PowerModel.preset("quadriga:empty:marble")
    beyond = replace(term("traction_beyond"), params={"direction": 0.0, "offset": -5.0})
    found = EnergyCost(model.with_term(beyond, 50.0)).segment_energy(2.0, 1.0)
    assert float(found) == float(EnergyCost(model).segment_energy(2.0, 1.0))


def test_steady_motion_is_long_past_its_start() -> None:
    backlash = empirical_term("empirical_traction_since_start", [0.0, 0.5, 1.0], [90.0, 30.0, 0.0])
    model = PowerModel.preset("quadriga:empty:marble")
    ways = np.array([[1.0, 0.2], [-1.0, 0.1], [0.5, -0.4], [-0.3, 0.9]]).T
    found = EnergyCost(model.with_term(backlash, 1.0)).segment_energy(*ways, 0.0)
    assert found == pytest.approx(EnergyCost(model).segment_energy(*ways, 0.0), rel=1e-12)


def test_steering_misses_the_minimum_by_no_more_than_it_says() -> None:
    """Straight ahead nothing is cheaper than the straight line, as the model prices it."""
    assert EnergyCost(MODEL).steering_error == 0.0
    limited = with_vehicle(
        MODEL.with_term(HOTEL, 50.0).with_term(VISCOUS_LOSS, 40.0), motor=MotorLimits(speed=3.0)
    )
    cost = EnergyCost(limited)
    assert 0 < cost.gauge.error < cost.steering_error < 0.01
    straight = float(cost.segment_energy(2.0, 0.0))
    found = float(steering.energy((0, 0, 0), (2.0, 0, 0), cost))
    assert (1 - cost.steering_error) * straight <= found <= (1 + 1e-9) * straight


LINE = Path(Pose(0, 0, 0), [1.0], [0.0])
FREE = with_vehicle(MODEL, motor=MotorLimits())
HUSKY = Vehicle.preset("husky_a200")
ODD = replace(HUSKY, motor=replace(HUSKY.motor, speed=1.2277168))
WEAK = replace(HUSKY.motor, continuous_power=0.0)
REFUSED = r"""
InvalidInputError: EnergyCost.from_coefficients(0.0, 1.0, icr=0.5) | per_metre
InvalidInputError: EnergyCost.from_coefficients(1.0, -1.0, icr=0.5) | per_radian
InvalidInputError: EnergyCost(MODEL, speed=0.0) | speed
InvalidInputError: EnergyCost(MODEL).energy(replace(LINE, longitudinal=0.2)) | longitudinal
InvalidInputError: EnergyCost(FREE).duration(LINE) | no speed limit
ModelError: EnergyCost(FREE.with_term(HOTEL, 10.0)) | no speed limit
ModelError: EnergyCost(MODEL.with_coefficients([MU, -K])) | must cost energy
ModelError: EnergyCost(with_vehicle(MODEL, motor=WEAK)) | no speed lets the motors.*0 W
# speeds as they are written
InvalidInputError: parse_speed("0", HUSKY) | metres per second
InvalidInputError: parse_speed("-1.0", HUSKY) | metres per second
InvalidInputError: parse_speed("inf", HUSKY) | metres per second
InvalidInputError: parse_speed("nan", HUSKY) | metres per second
InvalidInputError: parse_speed("as fast as it goes", HUSKY) | metres per second
InvalidInputError: parse_speed("", HUSKY) | metres per second
InvalidInputError: parse_speed("90", HUSKY) | give 1 m/s at most
InvalidInputError: parse_speed("1.229", ODD) | speed 1.229 m/s .* give 1.228 m/s at most
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case: str) -> None:
    check_refusal(case, {"parse_speed": parse_speed, **globals()})
