"""Files read back the same: vehicles, models, paths, trajectories, logs; none is half written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_bad_files import DIMENSIONS, MODEL, WHEELS

from energyplan import errors, simulate
from energyplan.cost import EnergyCost
from energyplan.io import tables
from energyplan.io.config import read_model, read_vehicle, write_model, write_vehicle
from energyplan.io.files import atomic_write
from energyplan.logs import DriveLog
from energyplan.path import Path, Pose, Trajectory
from energyplan.power import PowerModel, Residual
from energyplan.power.effects import HOTEL, WARM_UP, empirical_term
from energyplan.vehicle import GRAVITY, MotorLimits, TreadICR, Vehicle

PRESETS = ("quadriga", "quadriga:full", "husky_a200", "jackal")


def same_vehicle(one, other):
    for key, value in vars(one).items():
        if isinstance(value, np.ndarray):
            assert_array_equal(value, getattr(other, key))
        else:
            assert value == getattr(other, key)


def write(tmp_path, text):
    file = tmp_path / "it.yaml"
    file.write_text(text)
    return file


# -- vehicles -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_vehicles_read_back_the_same(tmp_path, name):
    vehicle = replace(
        Vehicle.preset(name), icr=TreadICR(0.41, 0.52, -0.03), regen_efficiency=0.25,
        motor=MotorLimits(speed=1.5, force=300.0),
    )  # fmt: skip
    same_vehicle(read_vehicle(write_vehicle(vehicle, tmp_path / "v.yaml")), vehicle)
    same_vehicle(read_vehicle(name), Vehicle.preset(name))


def test_a_vehicle_from_its_dimensions_and_from_its_wheels(tmp_path):
    sizes = read_vehicle(write(tmp_path, DIMENSIONS))
    expected = Vehicle.from_geometry(
        "mule", mass=120.0, wheelbase=0.6, track=0.7, length=1.0, width=0.9
    )
    same_vehicle(sizes, expected)
    wheels = read_vehicle(write(tmp_path, WHEELS))
    assert_allclose(np.sort(wheels.contacts, axis=0), np.sort(expected.contacts, axis=0))
    assert wheels.slip_moment == pytest.approx(expected.slip_moment)
    assert wheels.icr.left == pytest.approx(expected.icr.left)


def test_a_preset_with_changes(tmp_path):
    text = (
        "preset: jackal\nname: ours\nmass: 30\nicr: null\nusual_speed: null\n"
        "motor: {speed: 1.0, force: .inf, peak_power: null}\n"
    )
    vehicle, jackal = read_vehicle(write(tmp_path, text)), Vehicle.preset("jackal")
    assert vehicle.name == "ours"
    assert vehicle.loads.sum() == pytest.approx(30 * GRAVITY)
    assert (vehicle.motor.speed, vehicle.motor.peak_power) == (1.0, np.inf)
    assert vehicle.motor.continuous_power == jackal.motor.continuous_power
    assert_array_equal(vehicle.contacts, jackal.contacts)
    shifted = read_vehicle(write(tmp_path, "preset: jackal\ncog: [0.02, 0.0]\n"))
    assert shifted.loads.sum() == pytest.approx(jackal.loads.sum())
    assert shifted.loads @ shifted.contacts[:, 0] == pytest.approx(0.02 * shifted.loads.sum())


# -- models -------------------------------------------------------------------------------------


def test_a_model_reads_back_the_same_and_predicts_the_same(tmp_path):
    rng = np.random.default_rng(3)
    base = PowerModel.preset("quadriga:empty:concrete")
    warm = replace(WARM_UP, params={"time_constant": 45.0})
    shape = empirical_term("empirical_traction_v", [0.0, 0.4, 0.8], [0.0, 5.0, 20.0])
    terms = (*base.terms, warm, shape, HOTEL)
    root = rng.standard_normal((5, 5))
    model = PowerModel(
        base.vehicle.with_icr(TreadICR(0.4, 0.5, 0.01)), terms, [0.6, 110.0, 30.0, 1.0, 12.5],
        root @ root.T, Residual(3.0, 2.0, 0.1, 0.01, 0.7, 120.0), "found",
    )  # fmt: skip
    again = read_model(write_model(model, tmp_path / "m.yaml"))
    assert again.name == model.name
    assert again.residual == model.residual
    assert_array_equal(again.coefficients, model.coefficients)
    assert_array_equal(again.covariance, model.covariance)
    assert [dict(term.params) for term in again.terms] == [dict(t.params) for t in model.terms]
    same_vehicle(again.vehicle, model.vehicle)
    motion = simulate.validation_drive(base).motion(model.vehicle.icr)
    assert_array_equal(again.power(motion), model.power(motion))
    assert np.ptp(model.breakdown(motion)["empirical_traction_v"]) > 1.0
    missed = replace(model, residual=replace(model.residual, energy_error=-np.inf))
    assert read_model(write_model(missed, tmp_path / "m.yaml")).residual == missed.residual


def test_a_model_written_by_hand(tmp_path):
    model = read_model(write(tmp_path, MODEL))
    same_vehicle(model.vehicle, Vehicle.preset("quadriga:full"))
    assert model.coefficient("slip_friction") == 0.5
    assert model.std_error("slip_friction") == pytest.approx(0.1)
    assert model.std_error("traction_resistance") == pytest.approx(2.0)
    without = MODEL.replace(", std_error: 0.1", "").replace(", std_error: 2.0", "")
    assert read_model(write(tmp_path, without)).covariance is None


def test_a_term_that_no_file_could_name_is_refused(tmp_path):
    base = PowerModel.preset("quadriga:empty:marble")
    odd = base.with_term(replace(HOTEL, name="my_own"), 3.0)
    with pytest.raises(errors.ConfigError, match="my_own"):
        write_model(odd, tmp_path / "m.yaml")
    assert not (tmp_path / "m.yaml").exists()


# -- complaints ---------------------------------------------------------------------------------


def test_what_is_unusual_is_accepted_and_said_with_its_line(tmp_path):
    unusual = DIMENSIONS.replace("120.0", "17000") + "motor: {speed: 20}\nusual_speed: 0.01\n"
    model = MODEL.replace("quadriga:full", "{preset: jackal, loads: [0, 50, 50, 50]}")
    for text, read, words in (
        (
            unusual,
            read_vehicle,
            ("2, mass: 17000 is", "7, motor.speed: 20", "8, usual_speed: 0.01"),
        ),
        (model, read_model, ("2, vehicle.loads.0: 0 is unusual",)),
        (MODEL.replace("0.5,", "50,"), read_model, ("4, terms.0.value: 50 is unusual",)),
    ):
        with pytest.warns(errors.UnusualValueWarning) as said:
            read(write(tmp_path, text))
        told = [str(one.message) for one in said]
        assert len(told) == len(words)
        assert [w for w in words if not any(f"it.yaml, line {w}" in one for one in told)] == []


# -- files --------------------------------------------------------------------------------------


def test_atomic_write_keeps_the_old_file_when_it_fails(tmp_path, monkeypatch):
    file = tmp_path / "deep" / "it.txt"
    atomic_write(file, "old")
    monkeypatch.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError(28, "disk full")))
    with pytest.raises(errors.StorageError, match="disk full"):
        atomic_write(file, "new")
    assert file.read_text() == "old"
    assert [entry.name for entry in file.parent.iterdir()] == ["it.txt"]


def test_atomic_write_keeps_permissions_and_links(tmp_path):
    file, link = tmp_path / "it.txt", tmp_path / "link"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to(file)
    assert atomic_write(link, b"new") == link
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert file.stat().st_mode & 0o777 == 0o640
    with pytest.raises(errors.InvalidInputError, match="cannot be written"):
        atomic_write(tmp_path, "a folder")
    with pytest.raises(errors.InvalidInputError, match="cannot be written"):
        atomic_write("nul\0name", "x")


# -- numbers as they are written ----------------------------------------------------------------


@pytest.mark.parametrize(("text", "mass"), [("010", 10.0), ("0120.5", 120.5), ("12e1", 120.0)])
def test_a_number_is_read_in_tens(tmp_path, text, mass):
    file = write(tmp_path, DIMENSIONS.replace("120.0", text))
    assert read_vehicle(file).mass == pytest.approx(mass)


@pytest.mark.parametrize("name", ["010", "1:30", "2026-01-01", "true", "no", "1e3", "07"])
def test_any_word_is_a_name(tmp_path, name):
    vehicle = replace(Vehicle.preset("jackal"), name=name)
    write_vehicle(vehicle, tmp_path / "it.yaml")
    assert read_vehicle(tmp_path / "it.yaml").name == name
    assert read_vehicle(write(tmp_path, DIMENSIONS.replace("mule", f"'{name}'"))).name == name


def test_a_coefficient_beyond_all_numbers_is_refused_without_a_warning(tmp_path, recwarn):
    file = write(tmp_path, MODEL.replace("value: 0.5", "value: 1.0e+308"))
    with pytest.raises(errors.EnergyPlanError, match="motion must cost energy"):
        EnergyCost(read_model(file))
    assert [one.category for one in recwarn.list] == [errors.UnusualValueWarning]  # none of NumPy's


KINDS = ("it.csv", "it.csv.gz", "it.parquet")


@pytest.fixture
def path():
    """Arcs, a spin, a reversal and a turn across the heading pi."""
    return Path(
        Pose(1.0, -2.0, 3.0),
        ds=[1.3, 0.0, -0.7, 0.47 * 2.5],
        dtheta=[0.4, 1.9, 0.3, 2.5],
        longitudinal=0.03,
    )


def trajectory():
    t = np.linspace(0.0, 8.0, 161)
    v, omega = 0.5 * np.sin(t), 1.2 * np.cos(0.5 * t)
    fine = np.linspace(0.0, 8.0, 16001)
    yaw = 3.0 + 2.4 * np.sin(0.5 * fine)
    rate = 0.5 * np.sin(fine)
    x, y = (
        np.concatenate([[0.0], np.cumsum(np.diff(fine) * 0.5 * (f[1:] + f[:-1]))])[::100]
        for f in (rate * np.cos(yaw), rate * np.sin(yaw))
    )
    return Trajectory(t, x, y, yaw[::100], v, omega)


@pytest.mark.parametrize("name", KINDS)
def test_paths_read_back_the_same(tmp_path, path, name):
    again = tables.read_path(
        tables.write_path(path, tmp_path / name), longitudinal=path.longitudinal
    )
    assert again.length == pytest.approx(path.length, abs=1e-9)
    assert again.turning == pytest.approx(path.turning, abs=1e-9)
    assert_allclose(again.vertices, path.poses(), atol=1e-9)


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("x,y,qz,qw", lambda x, y, a: (x, y, np.sin(a / 2), np.cos(a / 2))),
        (
            "pose.position.x,pose.position.y,pose.orientation.x,pose.orientation.y,"
            "pose.orientation.z,pose.orientation.w",
            lambda x, y, a: (x, y, 0 * a, 0 * a, np.sin(a / 2), np.cos(a / 2)),
        ),
        ("x,y,yaw_deg", lambda x, y, a: (x, y, np.degrees(a))),
        ("x [mm],y [mm],yaw [deg]", lambda x, y, a: (1000 * x, 1000 * y, np.degrees(a))),
        ("x,y,theta", lambda x, y, a: (x, y, a)),
    ],
)
def test_a_path_in_other_words_and_units(tmp_path, path, names, values):
    poses = path.poses(0.05, 0.05)
    rows = np.column_stack(values(*poses.T))
    (tmp_path / "it.csv").write_text(
        "\n".join([names, *(",".join(f"{v:.15g}" for v in row) for row in rows)])
    )
    again = tables.read_path(tmp_path / "it.csv", longitudinal=path.longitudinal)
    assert_allclose(again.vertices, poses, atol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_trajectories_read_back_the_same(tmp_path, name):
    there = trajectory()
    back = tables.read_trajectory(tables.write_trajectory(there, tmp_path / name))
    for key, value in vars(there).items():
        assert_array_equal(getattr(back, key), value)


def test_wrapped_headings_are_unwrapped(tmp_path):
    there = trajectory()
    wrapped = Trajectory(
        there.t, there.x, there.y, np.angle(np.exp(1j * there.yaw)), there.v, there.omega
    )
    back = tables.read_trajectory(tables.write_trajectory(wrapped, tmp_path / "it.csv"))
    assert_allclose(np.diff(back.yaw), np.diff(there.yaw), atol=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_logs_read_back_the_same(tmp_path, name):
    log = simulate.drive(PowerModel.preset("quadriga:full:marble"), "survey", power_noise=5.0)
    again = DriveLog.read(tables.write_log(log, tmp_path / name))
    assert list(again.channels)[:5] == ["t", "v_left", "v_right", "p_left", "p_right"]
    for channel, values in log.channels.items():
        assert_array_equal(again.channels[channel], values)
    assert (again.set_aside, again.warnings) == ((), ())


def test_unknown_kinds_of_file_are_refused(tmp_path, path):
    with pytest.raises(errors.InvalidInputError, match="unknown type"):
        tables.write_path(path, tmp_path / "it.xlsx")
    assert not (tmp_path / "it.xlsx").exists()
