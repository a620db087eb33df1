"""What a robot cannot have done is no explanation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import simulate
from energyplan.diagnosis.search import Rest, drags, drivable
from energyplan.fit.drive import Late, prepared
from energyplan.fit.estimate import Problem
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel
from energyplan.power.effect_terms import (
    SLIP_CHANGE,
    TOWED_DRAG,
    TRACTION_CHANGE,
    VISCOUS_LOSS,
)
from energyplan.vehicle import GRAVITY, MotorLimits, Vehicle


def _case(motor: MotorLimits, size: float) -> tuple[Problem, PowerModel]:
    vehicle = Vehicle.from_geometry(
        "any", mass=60.0 * size**3, wheelbase=0.5 * size, track=0.55 * size, length=0.9 * size,
        width=0.7 * size, motor=motor,
    )  # fmt: skip
    model = PowerModel.paper(vehicle, K=0.08 * vehicle.mass * GRAVITY / 2, mu=0.5)
    log = simulate.identification_drive(model, power_noise=1.0, seed=1)
    return Problem(prepared([log], vehicle), vehicle), model


@pytest.mark.parametrize("size", [0.6, 1.0])
@pytest.mark.parametrize("term", [TOWED_DRAG, VISCOUS_LOSS], ids=lambda term: term.name)
def test_a_force_beyond_motors_or_weight_is_no_explanation(term: object, size: float) -> None:
    problem, model = _case(MotorLimits(force=300.0 * size**3, peak_power=400.0 * size**3), size)
    mass = model.vehicle.mass
    small, large = (model.with_term(term, share * mass * GRAVITY) for share in (0.1, 10.0))
    assert drivable(problem, (term,), small)
    assert not drivable(problem, (term,), large)


def test_without_known_limits_the_weight_bounds_what_treads_hold() -> None:
    problem, model = _case(MotorLimits(), 1.0)
    weight = model.vehicle.mass * GRAVITY
    assert np.isinf(model.vehicle.motor.force)
    assert drivable(problem, (TOWED_DRAG,), model.with_term(TOWED_DRAG, weight))
    assert not drivable(problem, (TOWED_DRAG,), model.with_term(TOWED_DRAG, 4 * weight))
    # A load beside the motors is no force of theirs.
    assert drivable(problem, (HOTEL,), model.with_term(HOTEL, 1e5))


def test_a_peak_power_bounds_what_a_tread_gives_at_its_speed() -> None:
    problem, model = _case(MotorLimits(peak_power=50.0), 1.0)
    force = model.with_term(TOWED_DRAG, 0.5 * model.vehicle.mass * GRAVITY)
    assert not drivable(problem, (TOWED_DRAG,), force)
    strong = replace(model.vehicle, motor=MotorLimits(peak_power=5000.0))
    assert drivable(Problem(problem.drives, strong), (TOWED_DRAG,), force)


@pytest.mark.parametrize(
    ("slip", "traction", "possible"),
    [(-0.4, -40.0, True), (0.4, 40.0, True), (-0.8, -10.0, False), (-0.1, -150.0, False)],
)
def test_friction_after_a_change_still_drags(slip: float, traction: float, possible: bool) -> None:
    """Another surface or a lighter robot: never one that is paid for turning or for driving."""
    terms = (SLIP, TRACTION, SLIP_CHANGE, TRACTION_CHANGE)
    assert drags(terms, np.array([0.7, 110.0, slip, traction])) is possible
    assert drags(terms[:2], np.array([0.7, 110.0]))


@pytest.mark.parametrize("delay", [0.0, 0.5])
def test_power_that_is_logged_late_shows_rest_late(delay: float) -> None:
    """Right after a stop it is still that of the drive: no load at rest."""
    load = 20.0
    truth = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, load)
    log = simulate.drive(
        truth, [("spin", 6.0), ("rest", 2.0)] * 8, rate=10.0, accel_limit=2.0, seed=1,
        power_noise=1.0, measured="total", delays={"power": delay} if delay else None,
    )  # fmt: skip
    rest = Rest(Problem(prepared([log], truth.vehicle), truth.vehicle))
    count, mean = rest.drawn(Late(delay))
    assert count > 50
    assert mean == pytest.approx(load, abs=0.5)
    if delay:
        assert rest.drawn(Late())[1] > 1.5 * load
