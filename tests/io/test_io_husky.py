"""Husky recordings: a simulated drive comes back through the sensors' flaws, real ones are read."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_day import by_day
from numpy.testing import assert_allclose

from energyplan.errors import DriveLogError
from energyplan.fit import identify
from energyplan.fit.estimate import problem_of
from energyplan.io.given import Given
from energyplan.io.husky import HuskyDrive, read_husky
from energyplan.io.logs import read_log
from energyplan.io.start import start
from energyplan.logs import DriveLog
from energyplan.power import PowerModel
from energyplan.simulate import drive, identification_drive
from energyplan.vehicle import TreadICR, Vehicle

TRAIN = HuskyDrive()
PERIOD = 2 / 13  # 6.5 Hz


@pytest.fixture(scope="module")
def model():
    vehicle = Vehicle.preset("husky_a200").with_icr(TreadICR.symmetric(0.42))
    return PowerModel.paper(vehicle, 40.0, 0.5)


def write_drive(folder, log, lag, number="00"):
    """Write a drive as a Husky's sensors see it; `lag` is that of the IMU's clock."""
    t = np.arange(0.0, log.t[-1], PERIOD)

    def at(name, when):
        return np.interp(when, log.t, log.channels[name])

    columns = {"time": t}
    for side, name in (("L", "left"), ("R", "right")):
        speed, power = at(f"v_{name}", t), at(f"p_{name}", t)
        force = np.divide(power, speed, out=np.zeros_like(t), where=np.abs(speed) > 1e-3)
        drawn = np.where(power > 0, np.abs(force) / TRAIN.power_per_current, 0.0)
        columns[f"cur{side}"] = np.where(drawn > TRAIN.dead_band, drawn, 0.0)
        columns[f"vel{side}"] = np.round(speed * 127) / 127
    clock = np.arange(0.0, log.t[-1], 0.01)
    rng = np.random.default_rng(1)
    imu = {
        "time": clock,
        "wz": at("yaw_rate", clock - lag) + 0.02 * rng.standard_normal(len(clock)),
        "ax": at("accel_x", clock - lag) + 0.5 * rng.standard_normal(len(clock)),
    }
    for stem, table in (("pro", columns), ("imu", imu)):
        rows = np.column_stack(list(table.values()))
        np.savetxt(
            folder / f"{stem}_{number}.csv", rows, "%.12g", ",", header=",".join(table), comments=""
        )
    return folder / f"pro_{number}.csv"


def test_motor_constant_of_a_husky():
    assert pytest.approx(21.4, abs=0.02) == TRAIN.power_per_current
    geared = replace(TRAIN, gear=2 * TRAIN.gear)
    assert geared.power_per_current == pytest.approx(2 * TRAIN.power_per_current)


@pytest.mark.parametrize("lag", [-0.73, 0.0, 0.21, 1.5])
def test_clock_offset_is_found_and_set_right(tmp_path, model, lag):
    truth = identification_drive(model, duration=200.0)
    log = read_husky(write_drive(tmp_path, truth, lag))
    told = next(warning for warning in log.warnings if "IMU's clock is" in warning)
    seconds = float(told.split()[4]) * (1 if "behind" in told else -1)
    assert seconds == pytest.approx(lag, abs=0.03)
    expected = np.interp(log.t, truth.t, truth.channels["yaw_rate"])
    assert np.std(log.channels["yaw_rate"] - expected) < 0.02
    accel = np.interp(log.t, truth.t, truth.channels["accel_x"])
    assert np.std(log.channels["accel_x"] - accel) < 0.15
    kept = read_husky(tmp_path / "pro_00.csv", blind="keep")
    assert DriveLog.from_columns(kept.channels).warnings == ()


def test_power_comes_back_but_for_what_the_sensors_cannot_see(tmp_path, model):
    truth = identification_drive(model, duration=200.0)
    file = write_drive(tmp_path, truth, 0.2)
    kept, dropped = read_husky(file, blind="keep"), read_husky(file, blind="drop")
    for name in ("p_left", "p_right"):
        drawn = np.maximum(np.interp(kept.t, truth.t, truth.channels[name]), 0.0)
        # Half the dead band at the tread speed, and half a speed step at the force.
        unseen = 0.5 * TRAIN.dead_band * TRAIN.power_per_current * 0.75
        assert np.abs(kept.channels[name] - drawn).max() < unseen + 0.004 * 200.0
    missing = len(kept) - len(dropped)
    blind = next(item for item in dropped.set_aside if "inner motor" in item.reason)
    assert missing > 100
    assert blind.reason.endswith("left out")
    assert blind.count == pytest.approx(missing, abs=10)
    # Without the blind samples the power is the model's, generating motors and all.
    motion = dropped.motion(model.vehicle.icr)
    steady = np.abs(motion.channel("accel")) + np.abs(motion.channel("yaw_accel")) < 0.05
    error = dropped.power - model.power(motion)
    assert np.median(np.abs(error[steady])) < 2.0
    generated = kept.power - model.power(kept.motion(model.vehicle.icr))
    assert generated.max() > 20.0


def test_currents_in_the_dead_band_are_counted(tmp_path):
    (tmp_path / "pro_00.csv").write_text(WHEELS)
    log = read_husky(tmp_path / "pro_00.csv")
    unit = TRAIN.power_per_current * 0.5
    assert_allclose(log.sides.left, unit * np.array([0.295, 0.295, 1.0]))
    assert_allclose(log.sides.right, unit * 2.0)
    assert (log.set_aside[0].count, log.set_aside[0].where) == (2, "line 2, line 3")
    assert any("no IMU" in warning for warning in log.warnings)
    assert any("steps of 0.0079 m/s" in warning for warning in log.warnings)


def test_a_steady_drive_tells_no_clock_offset(tmp_path, model):
    log = read_husky(write_drive(tmp_path, drive(model, "straight"), 0.5))
    assert any("too steady" in warning for warning in log.warnings)
    assert log.has("yaw_rate")


WHEELS = (
    "time,curL,curR,velL,velR\n0.0,0.0,2.0,0.5,0.5\n0.2,0.59,2.0,0.5,0.5\n0.4,1.0,2.0,0.5,0.5\n"
)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("0,0,0\n0.01,0,0\n0.01,0,0\n", "imu_00.csv, line 4"),
        ("0,0,0\n,0,0\n1,0,0\n", "imu_00.csv, line 3"),
        ("", "imu_00.csv: no row follows"),
    ],
)
def test_malformed_files_are_refused_with_the_line(tmp_path, rows, words):
    (tmp_path / "pro_00.csv").write_text(WHEELS)
    (tmp_path / "imu_00.csv").write_text("time,wz,ax\n" + rows)
    with pytest.raises(DriveLogError, match=words):
        read_husky(tmp_path / "pro_00.csv")
    with pytest.raises(DriveLogError, match=r"no column 'curL'|no row follows"):
        read_husky(tmp_path / "imu_00.csv")


@pytest.mark.shared
def test_real_drives_are_read_and_their_yaw_follows_the_treads(shared_data):
    files = sorted((shared_data / "borealtc").glob("*/pro_*.csv"))
    assert len(files) > 30
    offsets, tracks = {}, {}
    for file in files:
        log = read_husky(file, blind="keep")
        assert np.all(log.power >= 0)
        name = f"{file.parent.name}/{file.stem}"
        for warning in log.warnings:
            if "IMU's clock is" in warning:
                offsets[name] = float(warning.split()[4]) * (1 if "behind" in warning else -1)
        if name in offsets:
            difference = log.channels["v_right"] - log.channels["v_left"]
            rate = log.channels["yaw_rate"]
            tracks[name] = float(difference @ difference) / float(difference @ rate)
    assert {f"{d}/pro_{k}" for d, k in (("FLOORING", "04"), ("ICE", "01"))}.isdisjoint(offsets)
    assert len(offsets) >= 12
    assert np.abs(list(offsets.values())).max() < 1.6
    # The slip track is wider than the wheel track of 0.555 m: the true yaw rate is 0.55 to 0.7 of
    # the one that the wheel track suggests.
    floors = [track for name, track in tracks.items() if name.startswith("FLOORING")]
    assert 0.55 / 0.7 < np.median(floors) < 0.555 / 0.55


@pytest.mark.shared
@pytest.mark.parametrize("surface", by_day(["FLOORING", "ICE", "SANDY_LOAM"], ["ICE"]))
def test_parameters_agree_with_the_currents_of_spins_and_straights(shared_data, surface):
    """Straight, a side takes K; in a spin it takes K + mu S / B. No fit is needed for these."""
    files = sorted((shared_data / "borealtc" / surface).glob("pro_*.csv"))
    raw = [np.genfromtxt(file, delimiter=",", names=True) for file in files]
    left, right = (np.concatenate([r[f"vel{s}"] for r in raw]) for s in "LR")
    current = 0.5 * np.concatenate([r["curL"] + r["curR"] for r in raw])
    straight = (np.abs(left - right) < 0.02) & (np.abs(left) > 0.15)
    spin = (np.abs(left + right) < 0.2 * np.abs(right - left)) & (np.abs(right - left) > 0.1)
    K = TRAIN.power_per_current * np.median(current[straight])
    force = TRAIN.power_per_current * np.median(current[spin]) - K

    # what a motor gives back is not measured: without those samples the fit is that of the ground
    logs = [read_husky(file, blind="drop") for file in files]
    found = identify(logs, Vehicle.preset("husky_a200")).model
    mu = force * found.vehicle.icr.slip_track / found.vehicle.slip_moment
    assert found.coefficient("traction_resistance") == pytest.approx(K, rel=0.15)
    assert found.coefficient("slip_friction") == pytest.approx(mu, rel=0.15)


@pytest.mark.shared
@pytest.mark.parametrize("surface", ["FLOORING", "ICE"])
def test_the_example_goes_from_raw_files_to_parameters(shared_data, surface, capsys):
    example = Path(__file__).resolve().parents[2] / "examples" / "husky_log.py"
    runpy.run_path(str(example))["main"](shared_data / "borealtc" / surface)
    told = capsys.readouterr().out
    for words in ("21.4 V per m/s", "mu  =", "K   =", "dead band", "see no direction"):
        assert words in told
    errors = [float(text) for text in re.findall(r"predicted \(([+-][\d.]+)%\)", told)]
    assert len(errors) >= 3
    assert np.abs(errors).max() < 15.0


def test_a_table_with_these_columns_is_not_taken_for_a_husky_s(tmp_path: Path) -> None:
    write_drive(tmp_path, drive(PowerModel.preset("quadriga:empty:marble"), "straight"), 0.5)
    file = tmp_path / "pro_00.csv"
    with pytest.raises(DriveLogError, match=r"--vehicle husky_a200.*--columns t=time"):
        read_log(file)
    with pytest.raises(DriveLogError, match=r"pro_00\.csv"):
        read_log(file, topics="jackal")
    with pytest.raises(DriveLogError, match="--like husky_a200"):
        start(file)
    assert read_log(file, topics="husky").energy == read_husky(file).energy
    like = start(file, Given(like=Vehicle.preset("husky_a200")))
    assert like.project.topics is not None
    assert like.project.topics.name == "husky"
    mapped = "t=time,v_left=velL,v_right=velR,p_left=curL*velL,p_right=curR*velR"
    own = read_log(file, mapped)
    raw = np.genfromtxt(file, delimiter=",", names=True)
    np.testing.assert_allclose(own.channel("p_left"), raw["curL"] * raw["velL"])


def test_the_log_says_that_its_powers_have_no_sign(tmp_path, model):
    """Whatever the samples look like: the total is fitted, of the log and of its parts."""
    file = write_drive(tmp_path, identification_drive(model, duration=120.0), 0.2)
    log = read_husky(file)
    named = read_log(file, topics="husky")
    for part in (log, named, log.segment(0.0, 60.0), log.resample(0.5), log.blocks(40.0)[1]):
        assert part.signed is False
        assert problem_of([part], model.vehicle, ()).drives[0].equations == 1
