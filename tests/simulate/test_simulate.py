"""Simulated drives obey the model, the kinematics and the acceleration limit they were given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import check_refusal, lines

from energyplan import Motion, Path, Pose, PowerModel, Trajectory, TreadICR, Vehicle
from energyplan.errors import MissingChannelError
from energyplan.power import SLIP
from energyplan.power.effects import GRADE, LINEAR_INERTIA
from energyplan.simulate import PATTERNS, Setpoint, drive, identification_drive, validation_drive
from energyplan.vehicle import GRAVITY


@pytest.fixture(scope="module")
def model():
    return MODEL


@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_starts_and_ends_at_rest_within_speed_and_acceleration(model, pattern):
    log = drive(model, pattern, speed=0.8, accel_limit=0.4, rate=50.0)
    speeds = np.stack([log.channels["v_left"], log.channels["v_right"]])
    assert_allclose(speeds[:, [0, -1]], 0.0, atol=1e-12)
    assert np.abs(speeds).max() <= 0.8 + 1e-12
    assert np.abs(np.diff(speeds)).max() * 50.0 <= 0.4 + 1e-9
    assert log.t[-1] == pytest.approx(PATTERNS[pattern].duration, abs=0.021)


def test_power_and_yaw_rate_are_those_of_the_model(model):
    log = identification_drive(model)
    motion = log.motion(model.vehicle.icr)
    assert_allclose(log.power, model.power(motion), atol=1e-9)
    assert_allclose(log.sides.left, model.sides(motion).left, atol=1e-9)
    assert_allclose(log.channels["yaw_rate"], motion.omega, atol=1e-12)


def test_pose_is_that_of_the_same_arcs_driven_exactly(model):
    vehicle = model.vehicle.with_icr(TreadICR(0.4, 0.55, 0.07))
    lopsided = replace(model, vehicle=vehicle)
    # Both treads ramp in proportion, so that every ramp is an arc of one curvature.
    log = drive(
        lopsided,
        [Setpoint(0.3, 0.6, 4.0), Setpoint(0.0, 0.0, 1.0), Setpoint(-0.5, 0.1, 3.0)],
        rate=100.0,
    )
    icr = vehicle.icr
    seconds = (4.0 + 2.0, 3.0 + 0.5 / 0.3)
    arcs = Motion([0.3, -0.5], [0.6, 0.1], icr)
    path = Path(Pose(0, 0, 0), arcs.v * seconds, arcs.omega * seconds, icr.longitudinal)
    end = [log.channels[name][-1] for name in ("x", "y", "yaw")]
    assert_allclose(end, path.end, atol=5e-3)  # the last sample is up to 10 ms before the end
    k = 850  # at rest between the arcs
    middle = [log.channels[name][k] for name in ("x", "y", "yaw")]
    assert_allclose(middle, path.vertices[1], atol=1e-12)


def test_a_trajectory_is_driven_from_its_first_pose_to_its_last(model):
    t = np.linspace(2.0, 12.0, 401)
    v, omega = 0.4 * np.sin(0.6 * (t - 2)) ** 2, 0.5 * np.cos(t)
    known = drive(model, [Setpoint(0.2, 0.5, 4.0), Setpoint(-0.4, 0.3, 2.0)], rate=50.0)
    poses = [known.channels[name] for name in ("x", "y", "yaw")]
    motion = known.motion(model.vehicle.icr)
    there = Trajectory(known.t + 7.0, *poses, motion.v, motion.omega)
    again = drive(model, there, rate=50.0)
    for name in ("v_left", "v_right", "x", "y", "yaw"):
        # Corners between two samples are cut, by less than accel_limit dt^2.
        assert_allclose(again.channels[name], known.channels[name], atol=1.2e-4, err_msg=name)
    assert again.energy == pytest.approx(known.energy, rel=1e-3)
    slow = drive(model, there, duration=2 * there.duration, rate=50.0)
    assert slow.energy == pytest.approx(again.energy, rel=2e-3)  # a static model knows no speed
    assert slow.channels["x"][-1] == pytest.approx(poses[0][-1], abs=1e-4)
    moved = drive(model, Trajectory(t, t, t, 0 * t + 1.0, v, omega))
    assert [moved.channels[name][0] for name in ("x", "y", "yaw")] == [2.0, 2.0, 1.0]


def test_same_seed_same_log_and_each_channel_has_its_own_stream(model):
    options = {"power_noise": 5.0, "speed_noise": 0.005, "seed": 4}
    first, again = (validation_drive(model, **options) for _ in range(2))
    other = validation_drive(model, **{**options, "seed": 5})
    more = validation_drive(model, **options, noise={"yaw_rate": 0.02})
    for name in first.channels:
        assert_array_equal(first.channels[name], again.channels[name])
    assert np.any(first.channels["v_left"] != other.channels["v_left"])
    assert_array_equal(first.channels["p_left"], more.channels["p_left"])
    assert np.any(first.channels["yaw_rate"] != more.channels["yaw_rate"])


@pytest.mark.parametrize("tau", [0.0, 0.5])
def test_power_noise_has_the_deviation_and_the_correlation_asked_for(model, tau):
    log = drive(model, "rest", duration=2000.0, power_noise=5.0, correlation_time=tau, seed=2)
    for noise in (log.sides.left, log.sides.right):
        assert noise.std() == pytest.approx(5.0, rel=0.05)
        lag = np.corrcoef(noise[:-1], noise[1:])[0, 1]
        assert lag == pytest.approx(np.exp(-0.05 / tau) if tau else 0.0, abs=0.02)
    assert np.corrcoef(log.sides.left, log.sides.right)[0, 1] == pytest.approx(0.0, abs=0.05)


def test_inertia_costs_nothing_from_rest_to_rest(model):
    heavy = model.with_term(LINEAR_INERTIA, 150.0)
    bare, log = (drive(m, "straight", rate=200.0) for m in (model, heavy))
    assert np.abs(log.power - bare.power).max() > 30.0
    assert log.energy == pytest.approx(bare.energy, rel=2e-3)


def test_climbing_takes_the_potential_energy(model):
    mass, incline = 100.0, np.radians(6.0)
    log = drive(model.with_term(GRADE, mass), [Setpoint(0.6, 0.6, 10.0)], slope=incline)
    bare = drive(model, [Setpoint(0.6, 0.6, 10.0)])
    climbed = mass * GRAVITY * np.sin(incline) * log.channels["x"][-1]
    assert log.energy - bare.energy == pytest.approx(climbed, rel=1e-3)
    assert_allclose(log.channels["slope"], incline)
    steady = log.channels["accel_x"][len(log) // 2]
    assert steady == pytest.approx(GRAVITY * np.sin(incline))


def test_change_of_surface_and_of_icr_at_a_time(model):
    rough = PowerModel.preset("quadriga:full:concrete")
    wide = replace(rough, vehicle=rough.vehicle.with_icr(TreadICR.symmetric(0.6)))
    log = drive(model, [Setpoint(-0.5, 0.5, 10.0)], changes=[(5.0, wide)])
    before, after = log.t < 5.0, log.t >= 5.0
    motion = Motion(log.channels["v_left"], log.channels["v_right"], model.vehicle.icr)
    wider = Motion(log.channels["v_left"], log.channels["v_right"], wide.vehicle.icr)
    assert_allclose(log.power[before], model.power(motion)[before])
    assert_allclose(log.power[after], wide.power(wider)[after])
    assert_allclose(log.channels["yaw_rate"][after], wider.omega[after], atol=1e-12)
    turned = np.trapezoid(log.channels["yaw_rate"], log.t)
    assert log.channels["yaw"][-1] == pytest.approx(turned, abs=0.02)


def test_sensor_errors(model):
    clean = validation_drive(model)
    errors = {"delays": {"yaw_rate": 0.2}, "gains": {"p_left": 1.1}, "biases": {"p_right": 7.0}}
    log = validation_drive(model, **errors, without=["x", "y"])
    assert_allclose(log.channels["yaw_rate"][4:], clean.channels["yaw_rate"][:-4], atol=1e-9)
    assert_allclose(log.sides.left, 1.1 * clean.sides.left)
    assert_allclose(log.sides.right, 7.0 + clean.sides.right)
    assert not log.has("x")
    assert log.has("yaw")


def test_further_channels_reach_the_terms_and_the_log(model):
    warm = replace(
        SLIP, name="warm", kind="power", channels=("temperature",),
        function=lambda motion, vehicle: motion.channel("temperature"),
    )  # fmt: skip
    warmer = model.with_term(warm, 2.0)
    log = drive(warmer, "rest", channels={"temperature": lambda t: 20.0 + t})
    assert_allclose(log.power, 2.0 * (20.0 + log.t))
    assert_allclose(log.channels["temperature"], 20.0 + log.t)
    with pytest.raises(MissingChannelError, match="temperature"):
        drive(warmer, "rest")


@pytest.mark.parametrize(
    ("options", "wide"), [({}, True), ({"speed": 0.5}, True), ({"accel_limit": 0.1}, False)]
)
def test_wide_and_slow_robots_get_the_time_they_need(model, options, wide):
    """A machine of two tonnes could not draw the figure-8 of a drive to identify it from."""
    sizes = {"mass": 2000, "wheelbase": 1.4, "track": 1.6, "length": 2.6, "width": 2.0}
    machine = Vehicle.from_geometry("machine", **sizes)
    robot = PowerModel.paper(machine, K=600.0, mu=0.7) if wide else model
    for make, least in ((identification_drive, 150.0), (validation_drive, 120.0)):
        assert make(robot, **options).duration > least
        assert make(robot, duration=700.0, **options).duration == pytest.approx(700.0)


MODEL = PowerModel.preset("quadriga:full:marble")
REFUSED = r"""
UnknownNameError: drive(MODEL, "waltz") | spiral
UnknownNameError: drive(MODEL, "spiral", gains={"p_rihgt": 2.0}) | p_right
UnknownNameError: drive(MODEL, "spiral", measured="guess") | battery
InvalidInputError: drive(MODEL, "spiral", duration=2.0) | needs
InvalidInputError: drive(MODEL, "figure8", duration=6.0) | takes this robot
InvalidInputError: drive(MODEL, "spin", duration=6.0) | ramps alone
InvalidInputError: drive(MODEL, []) | no time
InvalidInputError: drive(MODEL, "spiral", speed=5.0) | reaches 1.2
InvalidInputError: drive(MODEL, "spiral", rate=0.0) | rate
InvalidInputError: drive(MODEL, "spiral", power_noise=-1.0) | power_noise
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, globals())
