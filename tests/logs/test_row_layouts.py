"""Rows of several things, and numbers in parts: read as what they are, or refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_logs import EPOCH, ROVER, At, drive

import energyplan as ep
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start

AT = At(drive(ROVER), ROVER)
HOUSE = AT.house()


def started(file: Path) -> float:
    """Start, and return what is identified of the project as a share of the truth."""
    made = start(file, Given(**ROVER.measures))
    assert made.sound, made.checks
    log = read_log(file, dict(made.project.columns))
    found = ep.identify(log, ROVER.vehicle).model.coefficient("traction_resistance")
    return float(found) / ROVER.K


def in_rows(things: dict[object, dict[str, np.ndarray]], label: str, late: float) -> pd.DataFrame:
    """Write a row for each thing at each time, the second one a little late."""
    parts = [
        pd.DataFrame({"time": AT.t + late * k, label: name, **columns})
        for k, (name, columns) in enumerate(things.items())
    ]
    return pd.concat(parts).sort_values("time", kind="stable")


SIDES = {
    "port": {"velocity": AT.left, "amps": AT.p_left / AT.volts, "bus_volts": AT.volts},
    "starboard": {"velocity": AT.right, "amps": AT.p_right / AT.volts, "bus_volts": AT.volts},
}


@pytest.mark.parametrize("late", [0.0, 0.004])
def test_a_row_for_each_side_is_a_column_for_each(tmp_path: Path, late: float) -> None:
    in_rows(SIDES, "controller", late).to_csv(tmp_path / "log.csv", index=False)
    assert started(tmp_path / "log.csv") == pytest.approx(1.0, rel=0.05)


def test_a_row_for_each_numbered_motor_is_asked_for(tmp_path: Path) -> None:
    things = dict(enumerate(SIDES.values(), 1))
    in_rows(things, "can_id", 0.0).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DriveLogError, match=r"can_id1.velocity.* nobody but you knows which side"):
        start(tmp_path / "log.csv", Given(**ROVER.measures))


def test_clocks_beside_the_time_are_no_readings(tmp_path: Path) -> None:
    readings = {"wheel_left": AT.left, "wheel_right": AT.right, "battery_power": AT.power}
    rows = in_rows({name: {"x": values} for name, values in readings.items()}, "series", 0.0)
    rows["log_time"] = EPOCH + rows["time"]
    rows["publish_time"] = EPOCH + 0.01 + rows["time"]
    rows.to_csv(tmp_path / "log.csv", index=False)
    assert started(tmp_path / "log.csv") == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("frame", [False, True])
@pytest.mark.parametrize(("label", "names"), [("vehicle", ("a7", "b2")), ("unit_id", (3, 4))])
def test_rows_of_several_robots_are_no_drive(
    tmp_path: Path, label: str, names: tuple[object, object], frame: bool
) -> None:
    columns = {name: HOUSE[name].to_numpy() for name in HOUSE if name != "t"}
    other = {name: np.roll(values, 300) for name, values in columns.items()}
    rows = in_rows(dict(zip(names, (columns, other), strict=True)), label, 0.03)
    rows.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DriveLogError, match=f"rows of several '{label}'"):
        ep.DriveLog.read(rows) if frame else start(tmp_path / "log.csv", Given(**ROVER.measures))


def test_a_mode_that_changes_is_no_other_robot(tmp_path: Path) -> None:
    mode = np.where(np.sin(AT.t / 9.0) > 0.0, "auto", "manual")
    AT.house().assign(mode=mode).to_csv(tmp_path / "log.csv", index=False)
    assert started(tmp_path / "log.csv") == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    ("whole", "part", "size"),
    [("sec", "nanosec", 1e9), ("tv_sec", "tv_usec", 1e6), ("s", "ms", 1e3)],
)
def test_seconds_and_their_parts_are_one_time(
    tmp_path: Path, whole: str, part: str, size: float
) -> None:
    t = EPOCH + AT.t + np.where(AT.t > 60.0, 32.0, 0.0)  # with a pause
    seconds = np.floor(t)
    table = HOUSE.drop(columns="t").assign(
        **{whole: seconds.astype(int),
           part: np.round(size * (t - seconds)).astype(int)})  # fmt: skip
    table.to_csv(tmp_path / "log.csv", index=False)
    made = start(tmp_path / "log.csv", Given(**ROVER.measures))
    log = read_log(tmp_path / "log.csv", dict(made.project.columns))
    assert log.t[-1] - log.t[0] == pytest.approx(AT.t[-1] - AT.t[0] + 32.0, abs=0.01)


@pytest.mark.parametrize(
    ("written", "separator", "decimal"),
    [("{:,}", ",", "."), ("{:_}", ",", "."), ("{:,}", ";", ".")],
)
def test_marks_between_thousands_are_named(
    tmp_path: Path, written: str, separator: str, decimal: str
) -> None:
    marks = {"_": "'", ",": "," if separator == "," else "."}
    ms = [written.format(int(t)).translate(str.maketrans(marks)) for t in np.round(1e3 * AT.t)]
    table = HOUSE.drop(columns="t").round(3).assign(time_ms=ms)
    sign = "," if separator == ";" else decimal
    table.to_csv(tmp_path / "log.csv", index=False, sep=separator, decimal=sign)
    with pytest.raises(DriveLogError, match="marks between thousands"):
        start(tmp_path / "log.csv", Given(**ROVER.measures))


def test_commas_of_decimals_stay_decimals(tmp_path: Path) -> None:
    table = pd.DataFrame({"t": AT.t, "v_left": AT.left, "v_right": AT.right, "power": AT.power})
    table.round(3).to_csv(tmp_path / "log.csv", index=False, sep=";", decimal=",")
    assert started(tmp_path / "log.csv") == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    ("name", "size"), [("odom_{}_mm", 1e3), ("{}_wheel_travel [m]", 1.0), ("{}_dist_cm", 1e2)]
)
def test_distances_of_the_sides_are_their_speeds(tmp_path: Path, name: str, size: float) -> None:
    gone = {name.format(side): size * AT.summed(v)
            for side, v in (("left", AT.left), ("right", AT.right))}  # fmt: skip
    pd.DataFrame({"time": AT.t, **gone, "power": AT.power}).to_csv(
        tmp_path / "log.csv", index=False)  # fmt: skip
    assert started(tmp_path / "log.csv") == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("name", ["pack_current", "battery_amps"])
def test_what_is_never_measured_is_said_so(tmp_path: Path, name: str) -> None:
    table = HOUSE.drop(columns="power").assign(volts=AT.volts, **{name: np.nan})
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DriveLogError, match=f"{name} is never measured"):
        start(tmp_path / "log.csv", Given(**ROVER.measures))


@pytest.mark.parametrize(
    ("name", "head", "remedy"),
    [("log.feather", b"ARROW1\0\0", "read_feather"), ("a.sqlite", b"SQLite format 3\0", "sqlite3"),
     ("b.db3.zstd", b"\x28\xb5\x2f\xfd\0", "unzstd"), ("log.csv", b"PK\x03\x04\0", "CSV"),
     ("log.dat", b"PAR1\0", "ending .parquet"), ("log.csv", b"\x1f\x8b\x08", r"ending .csv.gz")],
)  # fmt: skip
def test_files_are_known_by_their_first_bytes(
    tmp_path: Path, name: str, head: bytes, remedy: str
) -> None:
    (tmp_path / name).write_bytes(head)
    with pytest.raises(DriveLogError, match=remedy):
        start(tmp_path / name, Given(**ROVER.measures))
