"""Trajectories driven in the engine, and what sensors make of it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
from by_day import by_day
from commands import Run
from shapely import box

import energyplan as ep
from energyplan.io.files import bundled
from energyplan.io.tables import write_trajectory
from energyplan.limits.speed import profile
from energyplan.physics import Driven, EngineGround, EngineRobot, Sensors, drive
from energyplan.power import HOTEL
from energyplan.power.effects import term
from energyplan.terrain import Surface
from energyplan.vehicle import predict_icr

pytest.importorskip("mujoco")

VEHICLE = (
    ep.Vehicle.preset("quadriga:full")
    .with_mass(147.1)
    .with_icr(ep.TreadICR.symmetric(predict_icr(0.475, 0.5)))
)
MODEL = ep.PowerModel.paper(VEHICLE, K=118.0, mu=0.647)
ROUTE = ep.Path(ep.Pose(1, 1, 0.3), ds=[2, 0, 1.5, 0.47], dtheta=[0, -1.2, 0.5, 1.0])


def trajectory(path: ep.Path = ROUTE, speed: float = 0.6) -> ep.Trajectory:
    slow = replace(VEHICLE, motor=replace(VEHICLE.motor, speed=speed, acceleration=0.4))
    return profile(path, MODEL, vehicle=slow)


@pytest.fixture(scope="module")
def driven() -> Driven:
    return drive(trajectory(), EngineRobot.from_model(MODEL), MODEL)


def test_energy_taken_is_the_energy_told(driven: Driven) -> None:
    assert driven.arrived
    assert driven.tracking_error < 0.03
    assert abs(driven.error) < 0.015
    assert driven.energy_measured == pytest.approx(sum(driven.measured.values()), rel=1e-9)


def any_route(seed: int) -> tuple[ep.Trajectory, ep.PowerModel]:
    """Draw a robot of 5 to 500 kg and a route of straights, spins, pivots and arcs for it."""
    rng = np.random.default_rng(seed)
    mass = float(np.exp(rng.uniform(np.log(5.0), np.log(500.0))))
    base, track = (mass / 150.0) ** (1 / 3) * rng.uniform((0.4, 0.5), (1.0, 1.1))
    top = float(rng.choice([0.4, 0.8, 1.5, 2.5]))
    vehicle = ep.Vehicle.from_geometry(
        "any", mass=mass, wheelbase=base, track=track, length=1.5 * base, width=1.3 * track,
        motor=ep.MotorLimits(speed=1.6 * top, acceleration=1.0),
    )  # fmt: skip
    model = ep.PowerModel.paper(vehicle, K=9.81 * mass * rng.uniform(0.02, 0.1), mu=0.6)
    reach, ds, dtheta = vehicle.icr.half_track, list[float](), list[float]()
    for _ in range(2):
        turn = rng.uniform(-2.0, 2.0)
        wide = rng.choice([0.0, 1.0, rng.uniform(1.0, 4.0)]) * reach * abs(turn)
        ds += [float(rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 12.0) * reach), float(wide)]
        dtheta += [0.0, float(turn)]
    slow = replace(vehicle, motor=replace(vehicle.motor, speed=top, acceleration=0.4))
    return profile(ep.Path(ep.Pose(0, 0, 0.3), ds, dtheta), model, vehicle=slow), model


def fought(made: Driven) -> float:
    """Return the share of the energy that motors returned while the robot was to go straight."""
    run, asked = made.run, made.trajectory
    straight = np.abs(np.interp(run.t, asked.t, asked.omega)) < 0.01
    braking = np.minimum(run.shaft_left, 0.0) + np.minimum(run.shaft_right, 0.0)
    return -float(braking[straight].sum()) * run.period / made.energy_measured


LIGHT, USUAL, HEAVY = 3, 1, 10
"""Seeds of robots of 7, 53 and 408 kg."""


@pytest.mark.parametrize("seed", by_day(range(30), [LIGHT, HEAVY]))
def test_robots_of_any_size_follow_without_hunting(seed: int) -> None:
    asked, model = any_route(seed)
    made = drive(asked, EngineRobot.from_model(model), model)
    assert made.arrived
    assert abs(made.error) < 0.015
    assert made.tracking_error < 0.15 * model.vehicle.icr.half_track
    # Stops return what starts took; motors that push against each other returned a half and more.
    kinetic = 0.5 * model.vehicle.mass * float(np.square(asked.v).max())
    assert fought(made) < 0.03 + 2 * kinetic / made.energy_measured


def test_motors_that_share_no_load_push_against_each_other() -> None:
    alone = replace(EngineRobot.from_model(MODEL), sharing=np.inf)
    asked = trajectory(ep.Path(ep.Pose(1, 1, 0.3), ds=[0.0, 3.0], dtheta=[1.0, 0.0]))
    assert fought(drive(asked, alone, MODEL)) > 0.05
    assert fought(drive(asked, EngineRobot.from_model(MODEL), MODEL)) < 0.01


def test_an_effect_takes_what_its_term_tells(driven: Driven) -> None:
    told = MODEL.with_term(term("viscous_loss"), 80.0)
    made = drive(driven.trajectory, EngineRobot.from_model(told), told)
    assert abs(made.error) < 0.015
    assert made.measured["viscous_loss"] == pytest.approx(made.predicted["viscous_loss"], rel=0.03)
    ignorant = drive(driven.trajectory, EngineRobot.from_model(told), MODEL)
    share = made.measured["viscous_loss"] / made.energy_measured
    assert ignorant.error == pytest.approx(-share, abs=0.015)


def test_a_surface_under_the_wheels_is_felt() -> None:
    slick = ep.PowerModel.paper(VEHICLE, K=60.0, mu=0.3)
    ground = EngineGround(ep.SurfaceMap([Surface(box(-50, -50, 50, 50), slick)]))
    made = drive(trajectory(), EngineRobot.from_model(MODEL), MODEL, ground=ground)
    bare = drive(trajectory(), EngineRobot.from_model(slick), slick)
    assert made.energy_measured == pytest.approx(bare.energy_measured, rel=0.005)
    assert made.energy_predicted == pytest.approx(bare.energy_predicted, rel=1e-9)


def test_sensors(driven: Driven) -> None:
    run = driven.run
    clean = Sensors(power_noise=0.0, speed_noise=0.0).log(run)
    assert clean.energy == pytest.approx(driven.energy_measured, rel=0.005)
    assert np.allclose(np.diff(clean.t), 0.05)
    rough = Sensors(speed_step=1 / 127, current_step=0.1, unsigned=True, measured="battery")
    log = rough.log(run)
    assert log.battery_side
    assert np.allclose(log.channels["v_left"] * 127, np.round(log.channels["v_left"] * 127))
    assert np.all(log.channels["current"] >= 0)
    late = Sensors(power_noise=0.0, delay=0.3).log(run).power
    assert np.allclose(late[10:], clean.power[4:-6])
    again = Sensors(seed=4).log(run)
    assert np.array_equal(again.power, Sensors(seed=4).log(run).power)
    assert not np.array_equal(again.power, Sensors(seed=5).log(run).power)
    assert not Sensors(without=("x",)).log(run).has("x")


def test_hotel_load_is_in_the_log_and_in_the_energy(driven: Driven) -> None:
    made = drive(driven.trajectory, EngineRobot.from_model(MODEL.with_term(HOTEL, 40.0)), MODEL)
    more = 40.0 * made.run.period * len(made.run.t)
    assert made.energy_measured - driven.energy_measured == pytest.approx(more, rel=1e-6)
    assert Sensors(power_noise=0.0).log(made.run).power[0] >= 40.0 - 1e-6


def test_sensors_parse() -> None:
    expected = Sensors(rate=50.0, unsigned=True, measured="battery", seed=3)
    assert Sensors.parse("rate=50, unsigned=true,measured=battery,seed=3") == expected
    assert Sensors.parse("") == Sensors()


def test_identified_from_the_engine_it_is_the_truth() -> None:
    """What identification makes of an engine's drive is what the engine was built from."""
    pattern = ep.simulate.drive(MODEL, (("spin", 15.0), ("straight", 18.0), ("survey", 25.0)))
    poses, motion = (pattern.channel(one) for one in ("x", "y", "yaw")), pattern.motion(VEHICLE.icr)
    asked = ep.Trajectory(pattern.t, *poses, motion.v, motion.omega)
    made = drive(asked, EngineRobot.from_model(MODEL), MODEL)
    found = ep.identify(Sensors().log(made.run), VEHICLE)
    assert found.model.coefficient("slip_friction") == pytest.approx(0.647, rel=0.03)
    assert found.model.coefficient("traction_resistance") == pytest.approx(118.0, rel=0.03)
    assert found.icr.left == pytest.approx(VEHICLE.icr.left, rel=0.02)


def test_command(tmp_path: File, run: Run) -> None:
    file = tmp_path / "trajectory.csv"
    write_trajectory(trajectory(), file)
    log, truth = tmp_path / "log.csv", tmp_path / "truth.json"
    base = ["drive", file, "--model", "quadriga:full:concrete", "--json"]
    told = run(*base, "--effect", "hotel_load=50", "--out", log).json
    assert told["arrived"] is True
    assert {"energy_predicted", "energy_measured", "tracking_error"} <= set(told)
    assert ep.DriveLog.read(log).energy == pytest.approx(told["energy_measured"], rel=0.01)
    hidden = run(*base, "--hidden", "4", "--truth", truth).json
    assert all("taken" not in row for row in hidden["terms"])
    assert json.loads(truth.read_text())["effects"]
    wrong = run(*base, "--effect", "gravity=2")
    assert wrong.code == 2
    assert "viscous_loss" in wrong.err


def test_without_the_extra_the_error_names_it(
    tmp_path: File, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    file = tmp_path / "trajectory.csv"
    write_trajectory(trajectory(), file)
    assert run("drive", file, "--model", "quadriga").code == 2  # bad input comes first
    model = ["--model", "quadriga:full:concrete"]
    loop = ["close-the-loop", "--map", bundled("warehouse.yaml"), "--start", "2,2,0",
            "--goal", "20,12,90deg"]  # fmt: skip
    for command in (["drive", file], loop):
        done = run(*command, *model)
        assert done.code == 2
        assert "[physics]" in done.err
    # A design needs no engine.
    assert run("design", *model, "--duration", "20").code == 0
