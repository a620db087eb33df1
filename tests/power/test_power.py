from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import check_refusal, lines

from energyplan import Motion, PowerModel, TreadICR, Vehicle
from energyplan.power import (
    DRIVE_LOSS,
    HOTEL,
    REGENERATION_LOSS,
    SLIP,
    TRACTION,
    Sides,
    effects,
    tread_forces,
)

speed = st.floats(-1.5, 1.5)
offset = st.floats(0.1, 1.0)


@given(speed, speed, offset, offset, st.floats(-0.3, 0.3))
def test_sides_add_up_to_the_paper_for_any_motion(
    v_left: float, v_right: float, left: float, right: float, ahead: float
) -> None:
    vehicle = Vehicle.preset("quadriga:full").with_icr(TreadICR(left, right, ahead))
    model = PowerModel.paper(vehicle, K=118.0, mu=0.647)
    motion = Motion(v_left, v_right, vehicle.icr)
    omega = (v_right - v_left) / (left + right)
    slip = 0.647 * abs(omega) * vehicle.slip_moment
    total = slip + 118.0 * (abs(v_left) + abs(v_right))
    assert float(model.power(motion)) == pytest.approx(total, rel=1e-12, abs=1e-12)
    assert float(model.sides(motion).total) == pytest.approx(total, rel=1e-12, abs=1e-9)
    forces = model.forces(motion)
    assert float(forces.left * v_left + forces.right * v_right) == pytest.approx(total, abs=1e-9)


def test_the_inner_motor_generates_in_a_forward_arc_on_marble_with_a_full_tank() -> None:
    model = PowerModel.preset("quadriga:full:marble")
    sides = model.sides(Motion(0.8, 0.4, model.vehicle.icr))  # to the right, as in Fig. 5
    assert float(sides.right) < 0 < float(sides.left)
    slip_force = 0.431 * model.vehicle.slip_moment / 0.94
    assert float(sides.right) == pytest.approx((110.0 - slip_force) * 0.4)


@given(speed, speed, st.floats(-500, 500), st.floats(-500, 500))
def test_tread_forces_do_the_virtual_work(
    v: float, omega: float, force: float, moment: float
) -> None:
    motion = Motion.from_twist(v, omega, TreadICR(0.55, 0.41, 0.1))
    sides = tread_forces(motion, force, moment)
    work = sides.left * motion.v_left + sides.right * motion.v_right
    assert float(work) == pytest.approx(force * v + moment * omega, abs=1e-9)


def test_breakdown_adds_up_and_knows_no_special_terms() -> None:
    vehicle = Vehicle.preset("quadriga:full")
    terms = (SLIP, TRACTION, HOTEL, effects.GRADE, effects.LINEAR_INERTIA, effects.VISCOUS_LOSS)
    model = PowerModel(vehicle, terms, np.array([0.6, 110.0, 30.0, 147.0, 161.0, 12.0]))
    motion = Motion.from_twist(
        [0.5, -0.3], [0.2, 0.1], vehicle.icr, slope=[0.05, 0.02], accel=[0.3, -0.1]
    )
    parts = model.breakdown(motion)
    assert sum(parts.values()) == pytest.approx(model.power(motion), abs=1e-9)
    assert parts["grade"] == pytest.approx(147 * 9.81 * np.sin([0.05, 0.02]) * [0.5, -0.3])
    assert parts["linear_inertia"] == pytest.approx(161 * np.array([0.3 * 0.5, 0.1 * 0.3]))
    assert parts["hotel_load"] == pytest.approx([30.0, 30.0])
    assert model.sides(motion).total == pytest.approx(model.power(motion) - 30.0)


def test_battery_side_loses_what_the_efficiencies_say() -> None:
    vehicle = replace(Vehicle.preset("quadriga:full"), drive_efficiency=0.8, regen_efficiency=0.5)
    model = PowerModel.paper(vehicle, K=118.0, mu=0.647)
    motion = Motion([0.8, 0.5, -0.4], [0.4, 0.5, 0.4], vehicle.icr)
    sides = model.sides(motion)
    expected = sum(np.where(p > 0, p / 0.8, 0.5 * p) for p in (sides.left, sides.right))
    assert model.battery_side().power(motion) == pytest.approx(expected)


def test_an_efficiency_found_in_data_is_not_counted_twice() -> None:
    vehicle = replace(Vehicle.preset("quadriga:full"), regen_efficiency=0.5)
    model = PowerModel.paper(vehicle, 118.0, 0.647).with_term(REGENERATION_LOSS, 0.9)
    assert model.battery_side().coefficient("regeneration_efficiency") == 0.9


def test_coefficients_never_lose_their_covariance_silently() -> None:
    cov = np.array([[1e-4, 0.0], [0.0, 4.0]])
    model = PowerModel.paper(Vehicle.preset("quadriga"), 100.0, 0.5, covariance=cov)
    assert model.std_error("traction_resistance") == pytest.approx(2.0)
    wider = model.with_term(HOTEL, 20.0)
    assert wider.covariance is not None
    assert wider.std_error("hotel_load") == 0.0
    assert PowerModel.preset("quadriga:full:marble").std_error("slip_friction") is None


def test_losses_are_fractions_of_what_a_side_draws_or_returns() -> None:
    """Also at powers far below one watt, and for each side alone."""
    vehicle = Vehicle.preset("quadriga:full")
    speeds = np.array([[1.0, 1.0], [1e-3, 2e-3], [0.5, -0.5], [-1e-3, 1.0], [0.0, 0.0]])
    motion = Motion(speeds[:, 0], speeds[:, 1], vehicle.icr)
    forces = Sides(np.array([10.0, 10.0, -3.0, 7.0, 1.0]), np.array([10.0, -10.0, 3.0, 7.0, 1.0]))
    for side in ("left", "right"):
        power = getattr(forces, side) * getattr(motion, f"v_{side}")
        drawn = getattr(DRIVE_LOSS.function(motion, vehicle, forces), side)
        assert drawn == pytest.approx(np.where(power > 0, power, 0))
        lost = getattr(REGENERATION_LOSS.function(motion, vehicle, forces), side)
        assert lost == pytest.approx(np.where(power < 0, -power, 0))


QUADRIGA = Vehicle.preset("quadriga")
BOTH = (SLIP, TRACTION)
MOVING = Motion(1.0, 1.0, QUADRIGA.icr)
REFUSED = r"""
ModelError: PowerModel(QUADRIGA, (SLIP, SLIP), [1.0, 1.0]) | twice
ModelError: PowerModel(QUADRIGA, BOTH, [1.0]) | one finite value each
ModelError: PowerModel(QUADRIGA, BOTH, [1.0, np.nan]) | one finite value each
ModelError: PowerModel(QUADRIGA, BOTH, [1.0, 1.0], np.eye(3)) | of shape \(2, 2\)
ModelError: PowerModel(QUADRIGA, BOTH, [1.0, 1.0], [[1.0, 2.0], [0.0, 1.0]]) | symmetric
ModelError: PowerModel(QUADRIGA, BOTH, [1.0, 1.0], [[-1.0, 0.0], [0.0, 1.0]]) | negative
UnknownNameError: PowerModel.preset("quadriga:full:ice") | quadriga:full:marble
UnknownNameError: PowerModel.preset("quadriga:full:marble").coefficient("slip") | slip_friction
MissingChannelError: PowerModel(QUADRIGA, (effects.GRADE,), [8.0]).power(MOVING) | 'grade'.*'slope'
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case: str) -> None:
    check_refusal(case, globals())
