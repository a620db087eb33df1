"""Drives whose sensors each have a clock of their own: read right by `start`, or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import Run
from small_bags import JOINTS, Recorder

import energyplan as ep
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import Start, start

SLIP, K, MU, MASS = 1.24, 10.5, 0.62, 62.0
"""Slip track [m], resistance of a side [N], friction coefficient and mass [kg] of the robot."""
MEASURES = Given(track=0.38, wheelbase=0.71, mass=MASS)
SIDES = ("left", "right")


@dataclass(frozen=True)
class Drive:
    """A drive, known at any time."""

    t: np.ndarray
    left: np.ndarray
    right: np.ndarray
    east: np.ndarray
    north: np.ndarray
    yaw: np.ndarray
    power: np.ndarray

    def at(self, t: np.ndarray, name: str) -> np.ndarray:
        return np.interp(t, self.t, getattr(self, name))

    def clock(self, rate: float, late: float = 0.0) -> np.ndarray:
        return np.arange(self.t[0] + late, self.t[-1], 1.0 / rate)


def drive(seconds: float, seed: int, speed: float = 0.7) -> Drive:
    """Drive at random: arcs, straights, spins and rests, with noise in the power alone."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    points = np.cumsum(rng.uniform(3.0, 9.0, int(seconds / 3.0) + 2))
    ahead = rng.choice([0.0, 0.5, 1.0, 1.0, -0.5], len(points)) * speed
    turning = rng.choice([0.0, 0.0, 0.3, -0.3], len(points))
    v, omega = (np.convolve(values[np.searchsorted(points, t)], np.full(60, 1 / 60), "same")
                for values in (ahead, turning))  # fmt: skip
    left, right = v - 0.5 * SLIP * omega, v + 0.5 * SLIP * omega
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(omega) * 0.01
    east, north = (np.cumsum(v * f(yaw)) * 0.01 for f in (np.cos, np.sin))
    slip = 0.25 * MASS * 9.81 * np.hypot(0.19, 0.355) * 4.0 * MU
    power = K * (np.abs(left) + np.abs(right)) + slip * np.abs(omega) + 20.0
    return Drive(t, left, right, east, north, yaw, power + rng.normal(0.0, 1.0, len(t)))


def wheels(made: Drive, t: np.ndarray, swapped: bool = False) -> dict[str, np.ndarray]:
    left, right = (made.at(t, side) * 60 / (2 * np.pi * 0.1) for side in SIDES)
    left, right = (right, left) if swapped else (left, right)
    power = made.at(t, "power")
    return {"stamp_ms": np.round(1e3 * t), "motL_rpm": left, "motR_rpm": right,
            "Ubat": np.full(len(t), 25.0), "Ibat": power / 25.0}  # fmt: skip


def pose(made: Drive, t: np.ndarray, compass: bool, jitter: float = 0.0) -> dict[str, np.ndarray]:
    noise = np.random.default_rng(5).normal(0.0, 1.0, (3, len(t)))
    yaw = made.at(t, "yaw")
    heading = np.degrees(np.pi / 2 - yaw if compass else yaw) + 40.0 * jitter * noise[2]
    return {"stamp_ms": np.round(1e3 * t), "east": made.at(t, "east") + jitter * noise[0],
            "north": made.at(t, "north") + jitter * noise[1],
            "heading_deg": np.mod(heading, 360.0)}  # fmt: skip


def written(folder: Path, name: str, columns: dict[str, np.ndarray]) -> Path:
    file = folder / f"{name}.csv"
    pd.DataFrame(columns).round(5).to_csv(file, index=False)
    return file


def joined(*files: Path) -> Path:
    return Path("+".join(map(str, files)))


def both(
    folder: Path, made: Drive, rates: tuple[float, float], compass: bool,
    swapped: bool = False, jitter: float = 0.0,
) -> Path:  # fmt: skip
    first, second = made.clock(rates[0]), made.clock(rates[1], late=0.013)
    return joined(
        written(folder, "wheels", wheels(made, first, swapped)),
        written(folder, "nav", pose(made, second, compass, jitter)),
    )


def said(made: Start) -> str:
    return " ".join(str(check) for check in made.checks if not check.ok)


def assert_right(file: Path, made: Start) -> None:
    assert made.sound, said(made)
    assert not any("correlation" in note for note in made.notes)
    log = read_log(file, dict(made.project.columns) or None, topics=made.project.topics)
    model = ep.identify(log, made.project.vehicle).model
    assert model.coefficient("traction_resistance") > 0.0
    assert 2.0 * model.vehicle.icr.half_track == pytest.approx(SLIP, rel=0.03)
    x, y, yaw = (log.channel(name) for name in ("x", "y", "yaw"))
    v, step = log.motion(model.vehicle.icr).v, np.diff(log.t)
    for place, way in ((x, np.cos(yaw)), (y, np.sin(yaw))):
        gone = np.concatenate([[0.0], np.cumsum(step * (v * way)[:-1])])
        np.testing.assert_allclose(place - place[0], gone, atol=0.03 * np.abs(v).sum() * step[0])


@pytest.mark.parametrize("compass", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_pose_at_another_rate_is_read_by_time(tmp_path: Path, seed: int, compass: bool) -> None:
    file = both(tmp_path, drive(250.0, seed), (20.0, 20.0 / 3.0), compass)
    made = start(file, MEASURES)
    assert_right(file, made)
    assert compass == any("x is north, y is west" in note for note in made.notes)


@pytest.mark.parametrize(("seed", "compass"), [(1, True), (2, False)])
def test_long_files_of_two_rates_are_not_compared_row_by_row(
    tmp_path: Path, seed: int, compass: bool
) -> None:
    """Both have more rows than are looked at for a unit."""
    file = both(tmp_path, drive(540.0, seed), (50.0, 40.0), compass, jitter=0.01)
    made = start(file, MEASURES)
    assert_right(file, made)
    assert compass == any("x is north, y is west" in note for note in made.notes)


@pytest.mark.parametrize("compass", [True, False])
@pytest.mark.parametrize("rates", [(20.0, 20.0 / 3.0), (50.0, 40.0), (10.0, 10.0)])
def test_sides_that_are_swapped_are_named(
    tmp_path: Path, rates: tuple[float, float], compass: bool
) -> None:
    file = both(tmp_path, drive(420.0, 4), rates, compass, swapped=True)
    try:
        assert "left and right are swapped" in said(start(file, MEASURES))
    except DriveLogError as error:
        assert "left and right are swapped" in str(error)


@pytest.mark.parametrize("seed", range(4))
def test_axes_stay_where_the_pose_shows_nothing(tmp_path: Path, seed: int) -> None:
    """A pose that only jitters, and a heading of it, belong to no drive."""
    made, rng = drive(250.0, seed), np.random.default_rng(seed)
    t = made.clock(10.0)
    walk = np.cumsum(rng.normal(0.0, 2.0, len(t)))
    nav = {"stamp_ms": 1e3 * t, "east": rng.normal(0.0, 1.0, len(t)),
           "north": rng.normal(0.0, 1.0, len(t)), "heading_deg": np.mod(walk, 360.0)}  # fmt: skip
    first = written(tmp_path, "wheels", wheels(made, made.clock(20.0)))
    file = joined(first, written(tmp_path, "nav", nav))
    result = start(file, replace(MEASURES, wheel_radius=0.1))
    assert any("does not show" in note for note in result.notes)
    assert result.project.columns["x"].field == "nav.east"
    assert "swapped" not in said(result)


def test_a_bag_of_wheels_and_plain_numbers_is_read_by_time(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    made = drive(200.0, 6)
    number = "std_msgs/msg/Float64"
    with Recorder(tmp_path / "bag", "mcap") as file:
        for t in made.clock(20.0):
            rates = [float(made.at(t, side)) / 0.1 for side in SIDES]
            file.write("/joint_states", JOINTS, 1e9 + t, name=["left_wheel", "right_wheel"],
                       velocity=rates, position=[0.0, 0.0], effort=[0.0, 0.0])  # fmt: skip
            file.write("/battery/power", number, 1e9 + t, data=float(made.at(t, "power")))
        for t in made.clock(20.0 / 3.0):
            heading = np.mod(90.0 - np.degrees(made.at(t, "yaw")), 360.0)
            for topic, value in (("/gps/east", made.at(t, "east")),
                                 ("/gps/north", made.at(t, "north")),
                                 ("/compass/heading_deg", heading)):  # fmt: skip
                file.write(topic, number, 1e9 + t, data=float(value))
    result = start(tmp_path / "bag", MEASURES)
    assert_right(tmp_path / "bag", result)
    assert any("x is north, y is west" in note for note in result.notes)


def test_orientation_in_a_file_of_its_own_has_its_own_times(tmp_path: Path) -> None:
    made = drive(250.0, 7)
    t = made.clock(7.0)
    nav = pose(made, t, compass=False)
    turn = {"pose.x": nav["east"], "pose.y": nav["north"], "t": t,
            "pose.orientation.z": np.sin(0.5 * made.at(t, "yaw")),
            "pose.orientation.w": np.cos(0.5 * made.at(t, "yaw"))}  # fmt: skip
    first = written(tmp_path, "wheels", wheels(made, made.clock(20.0)))
    file = joined(first, written(tmp_path, "nav", turn))
    assert_right(file, start(file, MEASURES))


@pytest.mark.parametrize("seconds", [250.0, 180.0])
def test_two_drives_are_not_joined(tmp_path: Path, run: Run, seconds: float) -> None:
    files = []
    for name, seed, length in (("monday", 1, 250.0), ("tuesday", 2, seconds)):
        made = drive(length, seed)
        t = made.clock(20.0)
        files.append(written(tmp_path, name, wheels(made, t) | pose(made, t, True)))
    told = run("start", joined(*files), "--track", 0.38, "--wheelbase", 0.71, "--mass", 62)
    assert told.code == 2
    assert "monday.csv and tuesday.csv are two drives" in told.err
    assert "as in monday.csv tuesday.csv" in told.err
    told = run("start", *files, "--track", 0.38, "--wheelbase", 0.71, "--mass", 62)
    assert told.code == 0, told.err


def test_two_logs_of_one_drive_are_joined(tmp_path: Path) -> None:
    """Each side's controller, and odometry beside wheels, are no drives of their own."""
    made = drive(250.0, 3)
    t, later = made.clock(20.0), made.clock(12.0, 0.02)
    columns = wheels(made, t)
    left, right = (
        written(tmp_path, side, {"stamp_ms": 1e3 * own, "rpm": made.at(own, side) * 95.493,
                                 "power": 0.5 * made.at(own, "power")})
        for side, own in (("left", t), ("right", later))
    )  # fmt: skip
    both_sides = start(joined(left, right), replace(MEASURES, wheel_radius=0.1))
    assert {"v_left", "v_right", "p_left", "p_right"} <= {*both_sides.project.columns}
    again = {"stamp_ms": 1e3 * later, "v_left": made.at(later, "left"),
             "v_right": made.at(later, "right")}  # fmt: skip
    twice = joined(written(tmp_path, "wheels", columns), written(tmp_path, "odom", again))
    assert "v_left" in start(twice, replace(MEASURES, wheel_radius=0.1)).project.columns
