"""Logs as others write them: the right coefficients, or an error that says what to do."""

from __future__ import annotations

import json
import re
from datetime import datetime
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_logs import LOADER, READ, REFUSED, ROBOTS, ROVER, TOY, At, Robot, drive, write

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.start import start


@cache
def sensors(robot: Robot, rate: float = 10.0) -> At:
    return At(drive(robot, rate), robot)


@cache
def coefficients(robot: Robot) -> np.ndarray:
    """What the same drive tells in the library's own format."""
    return ep.identify(sensors(robot).log, robot.vehicle).model.coefficients


def started(name: str, robot: Robot, folder: Path, **more: object) -> ep.DriveLog:
    """Read a log by what `start` makes of it."""
    file = write(name, sensors(robot), folder)
    made = start(file, Given(**robot.measures | more))
    assert made.sound, made.checks
    return ep.DriveLog.read(file, dict(made.project.columns), others=False)


def assert_right(log: ep.DriveLog, robot: Robot = ROVER, within: float = 0.004) -> None:
    found = ep.identify(log, robot.vehicle).model.coefficients
    np.testing.assert_allclose(found, coefficients(robot), rtol=within)


@pytest.mark.parametrize("name", READ)
def test_start_reads_what_others_write(tmp_path: Path, name: str) -> None:
    # The way that goes with a turn of motors before a gear is to be found from the log.
    more = {"wheel_radius": np.nan} if name == "motors_in_the_mirror" else {}
    log = started(name, ROVER, tmp_path, **more)
    # Stamps of a quarter of a second average the steps of speed.
    coarse = name in ("coarse_stamps", "speed_and_yaw_rate")
    assert_right(log, within=0.01 if coarse else 0.004)


def test_what_a_logger_left_blank_holds_and_is_counted(tmp_path: Path) -> None:
    at = sensors(ROVER)
    log = started("what_changed_alone", ROVER, tmp_path)
    assert len(log) > 0.98 * len(at.t)
    reasons = {item.reason.split(" ")[0]: item.count for item in log.set_aside}
    assert reasons["v_left"] > 0.05 * len(at.t)


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
@pytest.mark.parametrize("name", ["four_motors", "units_in_names"])
def test_robots_of_a_kilogram_and_of_five_tonnes_are_alike(
    tmp_path: Path, robot: Robot, name: str
) -> None:
    assert_right(started(name, robot, tmp_path), robot, 0.003)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_known_is_asked_for(tmp_path: Path, name: str) -> None:
    _, words, given = REFUSED[name]
    file = write(name, sensors(ROVER), tmp_path)
    try:
        made = start(file, Given(**ROVER.measures))
    except DriveLogError as error:
        said = str(error)
        assert file.name in said
        assert "\n" not in said
    else:
        assert not made.sound
        said = " ".join(check.remedy for check in made.checks if not check.ok)
    assert re.search(words, said), said
    if given:
        assert_right(started(name, ROVER, tmp_path, **given))


@pytest.mark.parametrize("robot", [TOY, LOADER], ids=lambda robot: robot.name)
def test_currents_without_their_sign_are_noticed(tmp_path: Path, robot: Robot) -> None:
    file = write("currents_without_sign", sensors(robot), tmp_path)
    made = start(file, Given(**robot.measures))
    assert "log signed currents" in " ".join(check.remedy for check in made.checks if not check.ok)
    read = ep.DriveLog.read(file, dict(made.project.columns))
    assert any("log signed currents" in warning for warning in read.warnings)


@pytest.mark.parametrize("rate", [2.0, 50.0])
def test_slow_and_fast_logs_tell_the_same(tmp_path: Path, rate: float) -> None:
    file = write("units_in_names", sensors(ROVER, rate), tmp_path)
    found = ep.identify(ep.DriveLog.read(file), ROVER.vehicle)
    np.testing.assert_allclose(found.model.coefficients, [ROVER.mu, ROVER.K], rtol=0.01)


REWRITTEN = {
    "utf16": lambda file: file.write_text(file.read_text("utf-16"), "utf-8"),
    "json_lines": lambda file: pd.json_normalize(
        [json.loads(row) for row in file.read_text().splitlines() if row]
    ).to_csv(file.with_suffix(".csv")),
    "american_dates": lambda file: pd.read_csv(file).assign(
        t=lambda frame: [datetime.strptime(one, "%m/%d/%Y %I:%M:%S.%f %p") for one in frame["t"]]
    ).to_csv(file),
    "two_recordings": lambda file: file.write_text("\n".join(file.read_text().split("\n")[:1502])),
}  # fmt: skip
"""What the remedies of other refusals ask for."""


@pytest.mark.parametrize("name", REWRITTEN)
def test_written_as_asked_for_they_are_read(tmp_path: Path, name: str) -> None:
    file = write(name, sensors(ROVER), tmp_path)
    REWRITTEN[name](file)
    file = file.with_suffix(".csv")
    made = start(file, Given(**ROVER.measures))
    assert_right(ep.DriveLog.read(file, dict(made.project.columns), others=False))


def test_a_side_in_the_mirror_is_turned_and_told(tmp_path: Path) -> None:
    known = {name: value for name, value in ROVER.measures.items() if name != "wheel_radius"}
    made = start(write("motors_in_the_mirror", sensors(ROVER), tmp_path), Given(**known))
    assert "v_left had the opposite sign, which was corrected" in made.notes
    assert made.project.columns["v_left"].unit.startswith("-rpm*")


@pytest.mark.parametrize("gyroscope", [True, False])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_the_unit_of_a_heading_that_jitters_is_found(
    tmp_path: Path, unit: str, gyroscope: bool
) -> None:
    """As of laser scans that are matched; in radians it goes on beyond a turn."""
    at = sensors(ROVER, 20.0)
    yaw = at.yaw + np.random.default_rng(5).normal(0.0, 0.06, len(at.t))
    assert 2 * np.pi < np.max(np.abs(yaw))
    columns = {"time": at.t, "left_speed": at.left, "right_speed": at.right, "power": at.power,
               "heading": yaw if unit == "rad" else np.degrees(yaw) % 360}  # fmt: skip
    columns |= {"gyro_z": at.yaw_rate} if gyroscope else {}
    pd.DataFrame(columns).to_csv(tmp_path / "slam.csv", index=False)
    made = start(tmp_path / "slam.csv", Given(**ROVER.measures))
    assert made.project.columns["yaw"].unit == ("" if unit == "rad" else "deg")


def test_a_side_in_the_mirror_is_turned_on_a_winding_path_too(tmp_path: Path) -> None:
    """The yaw seemed to fall while the right side was the faster."""
    rng = np.random.default_rng(23)
    bends = [simulate.Setpoint(0.8 - b, 0.8 + b, hold=2.0) for b in rng.normal(-0.03, 0.06, 30)]
    log = simulate.drive(ROVER.model, bends, rate=5.0, power_noise=0.5, seed=1)
    columns = {"time": log.t, "left_speed": -log.channel("v_left"), "power": log.power,
               "right_speed": log.channel("v_right"),
               "gyro_z": log.channel("yaw_rate")}  # fmt: skip
    pd.DataFrame(columns).to_csv(tmp_path / "path.csv", index=False)
    made = start(tmp_path / "path.csv", Given(**ROVER.measures))
    assert made.sound
    assert "v_left had the opposite sign, which was corrected" in made.notes


def test_stamps_in_two_columns_serve(tmp_path: Path) -> None:
    made = start(write("stamps_in_two_columns", sensors(ROVER), tmp_path), Given(**ROVER.measures))
    assert made.project.columns["t"].written == "header.stamp.sec + 1e-09*header.stamp.nanosec"
    assert not any("serve for nothing" in note for note in made.notes)


def rows(*parts: tuple[float, float, int]) -> dict[str, np.ndarray]:
    """Return channels over stretches of time, each from, to and of some samples."""
    t = np.concatenate([np.linspace(*part) for part in parts])
    noise = np.random.default_rng(1).normal(0, 0.01, len(t))
    return {"t": t, "v_left": 0.5 + noise, "v_right": 0.4 + noise, "power": 100 + noise}


def test_a_few_late_rows_are_sorted_and_many_refused() -> None:
    made = rows((0.0, 50.0, 501))
    made["t"][[100, 101, 300, 301]] = made["t"][[101, 100, 301, 300]]
    log = ep.DriveLog.from_columns(made)
    assert [item.count for item in log.set_aside] == [2]
    assert np.all(np.diff(log.t) > 0)
    made["t"][:500] = made["t"][:500].reshape(-1, 2)[:, ::-1].ravel()
    with pytest.raises(DriveLogError, match="give each recording a file of its own"):
        ep.DriveLog.from_columns(made)
