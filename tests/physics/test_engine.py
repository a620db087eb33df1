"""The engine against closed forms: it uses no equation of the power model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from refusals import check_refusal, lines
from scipy.optimize import fsolve

import energyplan as ep
from energyplan.diagnosis.design import Hypothesis, design
from energyplan.errors import PhysicsError
from energyplan.physics import (
    EFFECTS,
    Engine,
    EngineGround,
    EngineRobot,
    HiddenEffect,
    Run,
    Sensors,
    State,
    draw_effects,
    switch_on,
)
from energyplan.physics.engine import Controller
from energyplan.power.effects import term
from energyplan.vehicle import GRAVITY, predict_icr

pytest.importorskip("mujoco")

CENTRED = ep.Vehicle.preset("quadriga:full").with_mass(147.1)
VEHICLE = CENTRED.with_icr(ep.TreadICR.symmetric(predict_icr(0.475, 0.5)))
MODEL = ep.PowerModel.paper(VEHICLE, K=118.0, mu=0.647)
ROBOT = EngineRobot.from_model(MODEL)


def steady(left: float, right: float, duration: float = 6.0) -> Controller:
    """Ramp up in a second and a half, then hold the tread speeds."""

    def controller(state: State) -> tuple[float, float] | None:
        share = min(1.0, state.t / 1.5)
        return None if state.t >= duration else (left * share, right * share)

    return controller


def held(run: Run, values: np.ndarray) -> float:
    return float(values[run.t > 4.0].mean())


def test_steady_spin() -> None:
    run = Engine(ROBOT).drive(steady(-0.47, 0.47))
    omega = held(run, run.omega)
    icr = held(run, run.v_right - run.v_left) / (2 * omega)
    assert icr == pytest.approx(predict_icr(0.475, 0.5), rel=0.002)
    wanted = 0.647 * VEHICLE.slip_moment * omega + 118.0 * 2 * 0.47
    assert held(run, run.power) == pytest.approx(wanted, rel=0.002)


@pytest.mark.parametrize(("left", "right"), [(0.2, 0.6), (0.0, 0.5), (-0.1, 0.5)])
def test_each_side_in_an_arc(left: float, right: float) -> None:
    """Tread forces that carry the slip moment; a little is left for the centripetal force."""
    run = Engine(ROBOT).drive(steady(left, right))
    sides = MODEL.sides(ep.Motion(left, right, VEHICLE.icr))
    whole = float(MODEL.power(ep.Motion(left, right, VEHICLE.icr)))
    assert held(run, run.shaft_left) == pytest.approx(float(sides.left), abs=0.005 * whole)
    assert held(run, run.shaft_right) == pytest.approx(float(sides.right), abs=0.005 * whole)


@pytest.mark.parametrize(("speed", "acceleration"), [(0.72, 0.5), (0.36, 1.0)])
def test_starts_and_stops_straight_ahead_take_nothing(speed: float, acceleration: float) -> None:
    """From rest to rest only the metres count: what a start takes the stop returns."""
    cycle = 2 * speed / acceleration + 1.0

    def controller(state: State) -> tuple[float, float] | None:
        at = state.t % cycle
        v = float(np.clip(acceleration * min(at, cycle - 0.5 - at), 0.0, speed))
        return None if state.t >= 2 * cycle else (v, v)

    run = Engine(ROBOT).drive(controller)
    assert run.taken == pytest.approx(2 * 118.0 * (run.x[-1] - run.x[0]), rel=5e-4)
    assert run.energy["slip_friction"] == pytest.approx(0.0, abs=2e-4 * run.taken)


@pytest.mark.parametrize("direction", [0.0, np.pi, np.pi / 2])
def test_slope_adds_the_weight(direction: float) -> None:
    robot = HiddenEffect("tilted_plane", 0.05, {"direction": direction}).on(ROBOT)
    run = Engine(robot).drive(steady(0.5, 0.5))
    grade = 147.1 * GRAVITY * np.sin(0.05) * np.cos(direction)
    # On a slope the loads are less by its cosine, and so is the half that rolls.
    resistance = 236.0 * (0.5 + 0.5 * np.cos(0.05))
    assert held(run, run.power) == pytest.approx((resistance + grade) * 0.5, rel=0.003)


def test_heights_tilt_gravity_like_the_plane() -> None:
    ramp = ep.HeightMap(np.tile(0.1 * np.tan(0.05) * np.arange(101), (101, 1)), 0.1, (-5, -5, 0))
    on_map = Engine(ROBOT, EngineGround(heights=ramp)).drive(steady(0.5, 0.5))
    tilted = HiddenEffect("tilted_plane", 0.05).on(ROBOT)
    on_plane = Engine(tilted).drive(steady(0.5, 0.5))
    assert on_map.taken == pytest.approx(on_plane.taken, rel=1e-6)


def test_coasting_down() -> None:
    """Deceleration 2 K over the mass with the rotors', when no motor holds against it."""
    weak = replace(VEHICLE, motor=replace(VEHICLE.motor, force=130.0))
    robot = replace(ROBOT, vehicle=weak)

    def controller(state: State) -> tuple[float, float] | None:
        if state.t >= 6.0:
            return None
        speed = 0.5 * min(1.0, state.t / 5.0) if state.t < 5.0 else 0.0
        return speed, speed

    run = Engine(robot).drive(controller)
    braking = (run.t > 5.1) & (run.v > 0.1)
    slope = np.polyfit(run.t[braking], run.v[braking], 1)[0]
    mass = 147.1 * (1 + 2 * 0.005)
    assert slope == pytest.approx(-(2 * 118.0 + 2 * 130.0) / mass, rel=0.005)


ARC, AHEAD = (0.2, 0.6), (0.5, 0.5)


@pytest.mark.parametrize(
    ("name", "speeds"),
    [
        ("viscous_loss", ARC), ("dragging_wheel_left", ARC), ("copper_loss", ARC),
        ("drive_efficiency", ARC), ("regeneration_efficiency", ARC), ("hotel_load", ARC),
        # In an arc a net force shifts the tread ICRs as well, which no term stands for.
        ("towing_force", AHEAD), ("air_drag", AHEAD),
    ],
)  # fmt: skip
def test_an_effect_is_the_term_of_its_name(name: str, speeds: tuple[float, float]) -> None:
    size = EFFECTS[name].draw(ROBOT, np.random.default_rng(1))
    run = Engine(HiddenEffect(name, size).on(ROBOT)).drive(steady(*speeds))
    told = MODEL.with_term(term(name), size)
    wanted = float(told.power(ep.Motion(*speeds, VEHICLE.icr)))
    assert held(run, run.power) == pytest.approx(wanted, rel=0.005)


def test_every_joule_is_accounted_for() -> None:
    effects = draw_effects(ROBOT, 3, count=5)
    run = Engine(switch_on(ROBOT, effects)).drive(steady(0.1, 0.5))
    assert abs(run.closure) < 0.002 * run.taken
    assert sum(run.energy.values()) == pytest.approx(run.taken, rel=1e-9)


def any_robot(rng: np.random.Generator) -> EngineRobot:
    """Draw a robot of 5 to 500 kg: stance, centre of mass, motors, friction and slope."""
    mass = float(np.exp(rng.uniform(np.log(5.0), np.log(500.0))))
    size, weight = (mass / 150.0) ** (1 / 3), mass * GRAVITY
    base, track = size * rng.uniform(0.4, 1.2, 2)
    force = float(rng.choice([np.inf, rng.uniform(0.1, 1.5) * weight]))
    vehicle = ep.Vehicle.from_geometry(
        "any", mass=mass, wheelbase=base, track=track, length=base * rng.uniform(1.0, 1.8),
        width=track * rng.uniform(1.0, 1.6), cog=rng.uniform(-0.15, 0.15, 2) * (base, track),
        motor=ep.MotorLimits(force=force),
    )  # fmt: skip
    traction = weight * rng.uniform(0.01, 0.12) * np.array([1.0, rng.uniform(0.7, 1.4)])
    return EngineRobot(
        vehicle, rng.uniform(0.2, 1.0), (traction[0], traction[1]),
        tilt=tuple(rng.uniform(-0.1, 0.1, 2)), height=0.25 * min(base, track),
        viscous=float(rng.choice([0.0, 2 * traction[0]])), drive_loss=0.1,
    )  # fmt: skip


def jumping(hold: float, top: float, rng: np.random.Generator, duration: float = 2.0) -> Controller:
    """Ask for other tread speeds again and again, without any ramp."""
    speeds = rng.uniform(-top, top, (int(duration / hold) + 2, 2))
    speeds[rng.random(len(speeds)) < 0.3] = 0.0

    def controller(state: State) -> tuple[float, float] | None:
        left, right = speeds[int(state.t / hold)]
        return None if state.t >= duration else (float(left), float(right))

    return controller


@pytest.mark.parametrize("seed", by_day(range(108), range(4)))
def test_every_joule_is_accounted_for_whatever_is_commanded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = any_robot(rng)
    hold = (0.01, 0.1, 0.4, 1.0)[seed % 4]
    run = Engine(robot).drive(jumping(hold, rng.uniform(0.2, 1.5), rng))
    moved = float(np.abs([run.shaft_left, run.shaft_right]).sum()) * run.period
    assert abs(run.closure) < 0.002 * moved
    most = robot.vehicle.motor.force
    assert max(np.abs(run.force_left).max(), np.abs(run.force_right).max()) <= most * (1 + 1e-9)


def test_a_drive_that_does_not_add_up_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("energyplan.physics.engine.BALANCE", -1.0)
    with pytest.raises(PhysicsError, match=r"unaccounted for.*slowly"):
        Engine(ROBOT).drive(steady(0.5, 0.5, duration=1.0))


def test_the_centre_of_mass_moves_the_icr() -> None:
    """To where the friction of all four contacts is in balance, solved apart from the engine."""
    robot = replace(HiddenEffect("centre_of_mass", 0.06).on(ROBOT), height=0.01)
    run = Engine(robot).drive(steady(-0.1, 0.1, duration=8.0))
    vehicle, later = robot.vehicle, run.t > 5.0
    tread = np.where(vehicle.contacts[:, 1] > 0, -0.1, 0.1)

    def imbalance(twist: np.ndarray) -> list[float]:
        v, aside, omega = twist
        x, y = vehicle.contacts.T
        slip = np.array([v - omega * y - tread, aside + omega * x])
        force = -vehicle.loads * slip / np.hypot(*slip)
        return [force[0].sum(), force[1].sum(), float(np.sum(x * force[1] - y * force[0]))]

    v, aside, omega = fsolve(imbalance, [0.0, -0.02, 0.2], xtol=1e-12)
    assert held(run, run.omega) == pytest.approx(omega, rel=0.005)
    c, s = np.cos(run.yaw), np.sin(run.yaw)
    lateral = np.gradient(run.y, run.t) * c - np.gradient(run.x, run.t) * s
    assert lateral[later].mean() == pytest.approx(aside, rel=0.02)
    assert held(run, run.v) == pytest.approx(v, abs=1e-3)


def test_wheels_of_any_number_carry_their_loads() -> None:
    six = np.array([(x, y) for x in (0.4, 0.0, -0.4) for y in (0.3, -0.3)])
    vehicle = ep.Vehicle(
        "rover", six, np.array([100.0, 100.0, 220.0, 220.0, 100.0, 100.0]),
        ep.TreadICR.symmetric(0.5), np.array([[-0.5, -0.4], [0.5, 0.4]]),
    )  # fmt: skip
    run = Engine(EngineRobot(vehicle, 0.5, (60.0, 60.0))).drive(steady(0.4, 0.4))
    assert held(run, run.power) == pytest.approx(48.0, rel=0.002)


def test_a_top_heavy_robot_tips_over() -> None:
    robot = replace(HiddenEffect("tilted_plane", 0.5).on(ROBOT), height=1.5)
    with pytest.raises(PhysicsError, match="left the ground"):
        Engine(robot).drive(steady(0.5, 0.5))


def test_same_seed_same_effects_and_names_are_known() -> None:
    assert draw_effects(ROBOT, 5) == draw_effects(ROBOT, 5)
    names = {effect.name for seed in range(200) for effect in draw_effects(ROBOT, seed)}
    assert names == set(EFFECTS)
    for seed in range(40):
        switch_on(ROBOT, draw_effects(ROBOT, seed))  # none is out of range


LINE = np.array([(0.0, 0.3), (0.0, -0.3)])
RAIL = replace(VEHICLE, contacts=LINE, loads=np.array([50.0, 50.0]))
MOBILISED = MODEL.with_term(term("friction_mobilisation"), 0.1)
SPEEDS = (Hypothesis(("viscous_loss",)), Hypothesis(("air_drag",)))
REFUSED = r"""
UnknownNameError: HiddenEffect("viscosity", 3.0) | viscous_loss
UnknownNameError: HiddenEffect("tilted_plane", 0.1, {"angle": 1.0}) | direction
InvalidInputError: HiddenEffect.parse("viscous_loss") | NAME=SIZE
InvalidInputError: HiddenEffect.parse("viscous_loss=nan") | not a finite
ModelError: EngineRobot.from_model(MOBILISED) | friction_mobilisation
InvalidInputError: EngineRobot(RAIL, 0.5, (10, 10)) | one line
InvalidInputError: replace(ROBOT, sharing=0.0) | sharing
InvalidInputError: Engine(ROBOT).drive(lambda state: (np.nan, 0.5)) | at 0\.00 s; give two finite
InvalidInputError: Sensors(rate=0.0) | rate is 0
InvalidInputError: Sensors(measured="engine") | battery
UnknownNameError: Sensors(without=("z",)).log(SHORT) | channel
InvalidInputError: Sensors(rate=0.01).log(SHORT) | too short
InvalidInputError: Sensors.parse("rate=fast") | rate is fast; .*number
InvalidInputError: Sensors.parse("rate=0") | rate is 0
InvalidInputError: Sensors.parse("measured=") | 'battery'
UnknownNameError: Sensors.parse("colour=red") | power_noise
InvalidInputError: design(MODEL, duration=0.0) | duration
InvalidInputError: design(MODEL, SPEEDS, duration=1.0) | no manoeuvre fits
InvalidInputError: design(MODEL, square=0.5) | room
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case: str) -> None:
    short = Engine(ROBOT).drive(steady(0.1, 0.1, duration=1.0)) if "SHORT" in case else None
    check_refusal(case, {"SHORT": short, "Sensors": Sensors, "design": design, **globals()})
