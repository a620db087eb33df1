"""The catalogue: every regressor against its equation, and how plugins join it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import EnergyCost, Motion, PowerModel, Vehicle
from energyplan.errors import ModelError, UnknownNameError
from energyplan.power import TRACTION, Sides, Term, effects, tread_forces
from energyplan.power.effects import Effect, catalogue, effect, empirical_term, term
from energyplan.power.empirical import CARRIERS, signal
from energyplan.vehicle import GRAVITY

VEHICLE = Vehicle.preset("quadriga:full")
T = np.array([0.0, 30.0, 90.0])


def _motion(v: object = (0.6, -0.4, 0.3), omega: object = (0.2, 0.5, -0.8), **channels: object):
    return Motion.from_twist(v, omega, VEHICLE.icr, **channels)


def _power(made: Term | str, motion: Motion, **params: float) -> np.ndarray:
    """Power of the term alone, per unit of its coefficient."""
    made = term(made) if isinstance(made, str) else made
    made = replace(made, params=params) if params else made
    return PowerModel(VEHICLE, (made,), np.array([1.0])).power(motion)


def test_every_term_equals_its_equation() -> None:
    slope, accel, yaw_accel = np.array([0.1, -0.05, 0.2]), np.array([0.3, -1.0, 0.2]), 0.7
    yaw, x, y = np.array([0.0, 1.0, -2.0]), np.array([0.0, 2.0, 5.0]), np.array([1.0, -1.0, 0.0])
    m = _motion(slope=slope, accel=accel, yaw_accel=yaw_accel, t=T, x=x, y=y)
    headed = _motion(yaw=yaw)
    left, right, v, w, S = m.v_left, m.v_right, m.v, m.omega, VEHICLE.slip_moment
    reach = S / float(VEHICLE.loads.sum())
    slip, both, ahead = S * np.abs(w), np.abs(left) + np.abs(right), np.abs(v)
    for name, params, power in (
        ("grade", {}, GRAVITY * np.sin(slope) * v),
        ("linear_inertia", {}, accel * v),
        ("angular_inertia", {}, yaw_accel * w),
        ("specific_force", {}, (accel + GRAVITY * np.sin(slope)) * v),
        ("viscous_loss", {}, left**2 + right**2),
        ("air_drag", {}, ahead**3),
        ("towing_force", {}, v),
        ("towed_drag", {}, ahead),
        ("dragging_wheel_left", {}, np.abs(left)),
        ("turn_asymmetry", {}, S * w),
        ("slip_speed_friction", {}, S * reach * w**2),
        ("friction_mobilisation", {}, -slip * ahead / (ahead + np.abs(w))),
        ("warm_up", {}, np.exp(-T / 60) * both),
        ("slip_change", {"time": 30.0}, slip * (T >= 30)),
        ("traction_change", {"time": 31.0}, both * (T > 31)),
        ("slip_beyond", {"direction": 0.0, "offset": 3.0}, slip * (x > 3)),
        ("traction_beyond", {"direction": np.pi / 2, "offset": 0.5}, both * (y > 0.5)),
        ("stribeck_friction", {"slip_speed": 0.2}, slip * np.exp(-reach * np.abs(w) / 0.2)),
    ):
        assert _power(name, m, **params) == pytest.approx(power, abs=1e-9), name
    assert _power("tilt_x", headed) == pytest.approx(GRAVITY * np.cos(yaw) * v)
    assert _power("tilt_y", headed) == pytest.approx(GRAVITY * np.sin(yaw) * v)


def test_sides_fight_on_a_straight_whichever_way_and_not_in_a_turn() -> None:
    motion = _motion([0.5, -0.5, 0.5, -0.5, 0.0], [0.0, 0.0, 0.2, -0.2, 0.3])
    none = np.zeros(motion.shape)
    heat = term("wheel_fight").function(motion, VEHICLE, Sides(none, none))
    assert heat.total == pytest.approx([1.0, 1.0, 0.0, 0.0, 0.0])


def test_wheels_cross_a_border_one_after_the_other() -> None:
    """Seen from the ground: each contact is moved there and weighed by its load."""
    direction, offset = 0.4, 1.0
    x, y, yaw = np.array([0.6, 1.0, 1.1, 1.3]), np.full(4, 0.1), np.array([0.0, 0.7, -2.0, 3.0])
    share = np.zeros(4)
    for k in range(4):
        turn = np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
        feet = VEHICLE.contacts @ turn.T + np.array([x[k], y[k]])
        beyond = feet @ np.array([np.cos(direction), np.sin(direction)]) > offset
        share[k] = VEHICLE.loads[beyond].sum() / VEHICLE.loads.sum()
    assert 0 < share.min() < 1 or 0 < share[1] < 1
    motion = _motion(0.3, np.full(4, -0.6), x=x, y=y, yaw=yaw)
    power = _power("slip_beyond", motion, direction=direction, offset=offset)
    assert power == pytest.approx(0.6 * VEHICLE.slip_moment * share)


def test_a_tilted_plane_is_the_grade_of_its_slope() -> None:
    angle, uphill = 0.06, 0.7
    yaw = np.linspace(-3, 3, 50)
    slope = np.arcsin(np.sin(angle) * np.cos(yaw - uphill))
    weight = VEHICLE.mass * np.sin(angle)
    tilts = (term("tilt_x"), term("tilt_y"))
    plane = PowerModel(VEHICLE, tilts, weight * np.array([np.cos(uphill), np.sin(uphill)]))
    graded = PowerModel(VEHICLE, (term("grade"),), np.array([VEHICLE.mass]))
    one = plane.power(_motion(0.5, 0.1, yaw=yaw))
    assert one == pytest.approx(graded.power(_motion(0.5, 0.1, slope=slope)))
    assert catalogue()["tilted_plane"].value(plane) == pytest.approx(angle)
    # Where the slope is known the plane must not count twice.
    assert np.all(plane.power(_motion(0.5, 0.1, yaw=yaw, slope=slope)) == 0.0)


def test_losses_act_on_the_forces_of_all_terms() -> None:
    paper = PowerModel.paper(VEHICLE, 110.0, 0.43)
    motion = _motion(0.5, 0.4)  # the inner side generates
    force, sides = paper.forces(motion), paper.sides(motion)
    assert float(sides.left) < 0 < float(sides.right)
    copper = paper.with_term(term("copper_loss"), 2e-4).power(motion)
    heat = 2e-4 * (force.left**2 + force.right**2)
    assert float(copper) == pytest.approx(float(sides.total + heat))
    unsigned = paper.with_term(term("unsigned_power"), 1.0).power(motion)
    assert float(unsigned) == pytest.approx(float(np.abs(sides.left) + np.abs(sides.right)))
    gain = paper.with_term(term("side_gain"), 0.1).power(motion)
    assert float(gain) == pytest.approx(float(1.1 * sides.left + 0.9 * sides.right))


def test_the_size_of_a_change_of_payload_is_the_mass_that_explains_it() -> None:
    """A robot that is so much heavier draws what the changed one draws."""
    light, motion = PowerModel.paper(VEHICLE, 110.0, 0.43), _motion(0.5, 0.2)
    changed = light.with_term(term("slip_change"), 0.06).with_term(term("traction_change"), 0.0)
    added = catalogue()["payload_change"].value(changed)
    heavy = PowerModel.paper(VEHICLE.with_mass(VEHICLE.mass + added), 110.0, 0.43)
    assert float(changed.power(motion)) == pytest.approx(float(heavy.power(motion)), rel=1e-12)
    assert float(changed.power(motion)) > 1.01 * float(light.power(motion))


def test_every_term_of_the_catalogue_prices_motion_for_a_planner() -> None:
    for entry in catalogue().values():
        model = PowerModel.paper(VEHICLE, 110.0, 0.43)
        for made in entry.terms:
            model = model.with_term(made, 1e-3)
        energy = EnergyCost(model, speed=0.5).segment_energy(np.array([1.0]), np.array([0.3]))
        assert np.all(np.isfinite(energy)), entry.name


def test_entries_are_complete_and_resolve_by_name() -> None:
    for name, entry in catalogue().items():
        assert name == entry.name
        assert entry.meaning and entry.manoeuvre and entry.unit and entry.symbol, name
        for made in entry.terms:
            assert term(made.name).function is made.function
            assert set(made.params) <= set(entry.grid) | {"time", "direction", "offset"}
    assert len(catalogue()) >= 20
    with pytest.raises(UnknownNameError, match="power term 'gremlins'"):
        term("gremlins")


def test_an_empirical_term_follows_its_knots_and_resolves_by_name() -> None:
    made = empirical_term("empirical_traction_temperature", [0.0, 10.0, 20.0], [5.0, 0.0, 20.0])
    motion = _motion([0.5] * 3, 0.0, temperature=[0.0, 15.0, 40.0])
    assert _power(made, motion) == pytest.approx(np.array([5.0, 10.0, 20.0]) * 2 * 0.5)
    found = replace(term(made.name), params=made.params)
    assert _power(found, motion) == pytest.approx(_power(made, motion))
    assert float(_power(made, _motion(0.5, 0.0))) == 0.0
    with pytest.raises(UnknownNameError, match="empirical term"):
        empirical_term("empirical_magic_t")


def test_signals_of_a_drive_are_what_they_are_named() -> None:
    v, w = np.array([0.5, 0.0, 0.001, -0.4, -0.5]), np.array([0.2, 0.3, -0.9, 0.2, 0.0])
    t, x, y = np.arange(5.0) * 0.5, np.array([1.0, 1.3, 1.3, 1.0, 4.0]), np.array([2.0] * 4 + [6.0])
    motion = _motion(v, w, t=t, x=x, y=y)
    # 20 per metre is all that is told of a spin
    assert signal(motion, "curvature") == pytest.approx([0.4, 20.0, -20.0, -0.5, 0.0])
    assert signal(motion, "displacement") == pytest.approx([0.0, 0.3, 0.3, 0.0, 5.0])
    assert np.all(signal(_motion(v, w, x=x), "displacement") == 0.0)
    assert np.all(signal(_motion(v, w), "since_start") == 0.0)
    assert signal(motion, "v") == pytest.approx(v)
    assert signal(motion, "omega") == pytest.approx(w)
    assert np.all(signal(motion, "temperature") == 0.0)


@pytest.mark.parametrize("carrier", sorted(CARRIERS))
def test_an_empirical_shape_scales_with_its_carrier(carrier: str) -> None:
    """Its power on top of the paper's terms, by hand."""
    channel = "y" if carrier == "ground" else "temperature"
    paper = PowerModel.paper(VEHICLE, 110.0, 0.43)
    yaw = np.array([0.3, 2.0, -1.0])
    motion = _motion(yaw=yaw, y=np.array([2.0, 4.0, 6.0]), temperature=np.array([2.0, 4.0, 6.0]))
    shape = np.array([1.0, 2.0, 3.0])
    made = empirical_term(f"empirical_{carrier}_{channel}", [0.0, 8.0], [0.0, 4.0])
    by_hand = {
        "power": shape,
        "traction": shape * (np.abs(motion.v_left) + np.abs(motion.v_right)),
        "slip": shape * np.abs(motion.omega),
        "whole": shape * paper.power(motion),
        "ground": shape * np.sin(yaw) * motion.v,
    }[carrier]
    more = paper.with_term(made, 1.0).power(motion) - paper.power(motion)
    assert more == pytest.approx(by_hand, abs=1e-9)


def test_one_function_makes_an_effect_and_a_plugin_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @effect("rail_friction", "F_r", "N", meaning="a guide rail", plausible=(0.0, 100.0))
    def rail(motion: Motion, vehicle: Vehicle):
        return tread_forces(motion, longitudinal=np.sign(motion.v))

    assert isinstance(rail, Effect)
    assert _power(rail.terms[0], _motion(-0.5, 0.0)) == pytest.approx(0.5)

    class Point:
        name = "rail"

        def __init__(self, made: object) -> None:
            self._made = made

        def load(self) -> object:
            return self._made

    for made in (rail, rail.terms[0]):
        monkeypatch.setattr(effects, "entry_points", lambda group, made=made: [Point(made)])
        assert catalogue()["rail_friction"].unit == "N"
        assert term("rail_friction") is rail.terms[0]
    grade = Effect.of(term("grade"))
    monkeypatch.setattr(effects, "entry_points", lambda group: [Point(grade)])
    with pytest.raises(ModelError, match="redefines"):
        catalogue()
    monkeypatch.setattr(effects, "entry_points", lambda group: [Point(3)])
    with pytest.raises(ModelError, match="no Effect"):
        catalogue()


EVERY = {one.name: one for effect in catalogue().values() for one in effect.terms}


@pytest.mark.parametrize("name", sorted(EVERY))
def test_what_changes_its_sign_with_the_sides_may_be_of_either_sign(name: str) -> None:
    """A robot whose sides change places is a robot, too: bounds that hold for one hold for it."""
    rng, one = np.random.default_rng(0), EVERY[name]
    left, right = rng.uniform(-1.0, 1.0, (2, 40))
    told = {channel: rng.uniform(0.1, 1.0, 40) for channel in (*one.channels, "accel_x")}
    turning = {channel: -told[channel] for channel in told if channel.startswith("yaw_")}
    powers = [
        PowerModel(VEHICLE, (TRACTION, one), np.array([80.0, size])).power(motion)
        for motion in (
            Motion(left, right, VEHICLE.icr, told),
            Motion(right, left, VEHICLE.icr, told | turning),
        )
        for size in (0.5, 0.6)
    ]
    change, mirrored = powers[1] - powers[0], powers[3] - powers[2]
    if np.abs(change).max() > 0 and np.allclose(change, -mirrored, rtol=1e-9):
        assert one.bounds[0] == -one.bounds[1]
