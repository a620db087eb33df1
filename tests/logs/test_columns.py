"""Tables as others write them: names, marks, times, units, counts of encoders; and DataFrames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.logs.mapping import TOTAL, count_rate, known_unit, parse_columns
from energyplan.logs.tables import read_table

MODEL = ep.PowerModel.preset("quadriga:empty:marble")
RADIUS = 0.2
NAMES = {
    "t": "Time (UTC)",
    "v_left": "wheel speed, left [rad/s]",
    "v_right": "wheel speed, right [rad/s]",
    "power": "P [kW]",
    "yaw": "Heading [°]",
    "yaw_rate": "gyro z (dps)",
}


@pytest.fixture(scope="module")
def drive() -> ep.DriveLog:
    return simulate.drive(MODEL, "spiral", rate=10.0, power_noise=2.0, seed=7)


def foreign(drive: ep.DriveLog, mark: str, comma: bool, stamp: str) -> str:
    """Write a drive with foreign names and units."""
    instants = np.datetime64("2024-05-06T07:08:09", "us") + (drive.t * 1e6).astype("m8[us]")
    times = {
        "iso": [f"{t}Z" for t in instants],
        "ms": [f"{1.7e12 + 1e3 * t:.6f}" for t in drive.t],
        "ns": [str(1_700_000_000_000_000_000 + round(1e9 * t)) for t in drive.t],
    }[stamp]
    frame = pd.DataFrame({
        NAMES["t"]: times,
        NAMES["v_left"]: drive.channel("v_left") / RADIUS,
        NAMES["v_right"]: drive.channel("v_right") / RADIUS,
        NAMES["power"]: drive.power / 1e3,
        NAMES["yaw"]: np.degrees(drive.channel("yaw")),
        NAMES["yaw_rate"]: np.degrees(drive.channel("yaw_rate")),
    })  # fmt: skip
    return str(frame.to_csv(index=False, sep=mark, decimal="," if comma else "."))


MAPPING = {
    "t": NAMES["t"],
    "v_left": f'"{NAMES["v_left"]}"[rad/s*{RADIUS}]',
    "v_right": f'"{NAMES["v_right"]}"[rad/s*{RADIUS}]',
    "power": NAMES["power"],
    "yaw": NAMES["yaw"],
    "yaw_rate": NAMES["yaw_rate"],
}


@pytest.mark.parametrize("stamp", ["iso", "ms", "ns"])
@pytest.mark.parametrize(("mark", "comma"), [(",", False), (";", True), (";", False), ("\t", True),
                                             (",", True)])  # fmt: skip
def test_foreign_tables_are_read_as_what_they_mean(
    drive: ep.DriveLog, tmp_path: Path, mark: str, comma: bool, stamp: str
) -> None:
    file = tmp_path / "foreign.csv"
    file.write_text(foreign(drive, mark, comma, stamp), encoding="utf-8")
    unit = {"iso": "", "ms": "[ms]", "ns": "[ns]"}[stamp]
    mapping = {**MAPPING, "t": f'"{NAMES["t"]}"{unit}'}
    text = ",".join(f"{channel}={source}" for channel, source in mapping.items())
    for given in (mapping, text):
        log = ep.DriveLog.read(file, given)
        # a time of ten digits before the point is good to a quarter of a microsecond
        np.testing.assert_allclose(log.t - log.t[0], drive.t - drive.t[0], atol=1e-6)
        for name in ("v_left", "v_right", "yaw_rate"):
            np.testing.assert_allclose(log.channel(name), drive.channel(name), atol=1e-8)
        np.testing.assert_allclose(log.power, drive.power, atol=1e-5)
        np.testing.assert_allclose(np.exp(1j * log.channel("yaw")),
                                   np.exp(1j * drive.channel("yaw")), atol=1e-8)  # fmt: skip


def test_what_a_name_says_of_its_unit_is_believed() -> None:
    names = ["speed [km/h]", "plain"]
    found = parse_columns("v_left=speed [km/h],v_right=plain[mm/s]", names)
    assert found["v_left"].conversion.factor == pytest.approx(1 / 3.6)
    assert found["v_right"].field == "plain"
    steps = parse_columns("current=bus_current_10mA", ["bus_current_10mA"])
    assert steps["current"].conversion.factor == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("channel", "written", "meant"),
    [("v_left", "RPM", "rpm"), ("yaw", "degrees", "deg"), ("t", "µs", "us"), ("power", "kw", "kW"),
     ("v_left", "KM/H", "km/h"), ("v_left", "mmps", "mm/s"), ("power", "MW", None),
     ("yaw_rate", "°/s", "deg/s"), ("x", "rpm", None)],
)  # fmt: skip
def test_units_are_known_by_what_people_write(channel: str, written: str, meant: str) -> None:
    assert known_unit(channel, written) == meant


def test_times_that_are_none_stay_text(drive: ep.DriveLog, tmp_path: Path) -> None:
    file = tmp_path / "foreign.csv"
    text = foreign(drive, ",", False, "iso").splitlines()
    text[5] = text[5].replace("2024-05-06T", "yesterday ", 1)
    file.write_text("\n".join(text))
    with pytest.raises(DriveLogError, match="line 6: 'Time"):
        ep.DriveLog.read(file, MAPPING)


RATE = 20.0


def counted(bits: int | None = None, per_metre: float = 5000.0) -> tuple[np.ndarray, ...]:
    """Time, a speed that comes and goes, and what an encoder makes of it."""
    t = np.arange(0.0, 60.0, 1 / RATE)
    speed = 0.8 * np.sin(0.3 * t)
    way = 0.8 / 0.3 * (1 - np.cos(0.3 * t))
    counts = np.floor(per_metre * way)
    return t, speed, counts if bits is None else counts % 2.0**bits


@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_counter_tells_the_speed_where_it_runs_over_too(bits: int | None) -> None:
    t, speed, counts = counted(bits, per_metre=5000.0 if bits != 32 else 2e9)
    found = count_rate(t, counts, TOTAL) / (5000.0 if bits != 32 else 2e9)
    # One count over two rows, and the curvature of the speed.
    np.testing.assert_allclose(found, speed, atol=RATE / 2 / 5000.0 + 0.003)


def test_a_counter_that_is_set_back_begins_anew() -> None:
    t, speed, counts = counted()
    counts[600:] -= counts[600]
    found = count_rate(t, counts, TOTAL) / 5000.0
    np.testing.assert_allclose(found, speed, atol=RATE / 5000.0 + 0.02)


def test_holes_pauses_and_repeated_times_are_not_counted_across() -> None:
    t, speed, counts = counted()
    counts[100:130] = np.nan
    later = np.where(np.arange(len(t)) >= 800, t + 30.0, t)
    later[401], counts[401] = later[400], counts[400]
    found = count_rate(later, counts, TOTAL) / 5000.0
    known = np.isfinite(counts)
    assert np.array_equal(np.isfinite(found), known)
    np.testing.assert_allclose(found[known], speed[known], atol=0.05)


def test_the_newest_row_first_is_no_robot_that_reverses() -> None:
    t, speed, counts = counted()
    np.testing.assert_allclose(count_rate(t[::-1], counts[::-1], TOTAL)[::-1] / 5000.0, speed,
                               atol=0.01)  # fmt: skip


@pytest.mark.parametrize(
    "values", [[], [5.0], [np.nan, np.nan], [7.0, 7.0, 7.0]], ids=["none", "one", "holes", "still"]
)
def test_what_tells_no_speed_is_none(values: list[float]) -> None:
    found = count_rate(np.arange(float(len(values))), np.array(values), TOTAL)
    assert not np.nan_to_num(found).any()


def test_counters_of_several_wheels_run_over_one_by_one() -> None:
    t, speed, counts = counted(16)
    columns = {"t": t, "a": counts, "b": (counts + 3e4) % 65536, "power": 50.0 + 0.0 * t}
    log = ep.DriveLog.read(
        pd.DataFrame(columns), f"v_left=a+b[ticks*{0.5 / 5000}],v_right=a[ticks*{1 / 5000}]"
    )  # fmt: skip
    for name in ("v_left", "v_right"):
        np.testing.assert_allclose(log.channel(name), speed, atol=0.01)


def test_a_log_survives_the_way_through_a_frame() -> None:
    log = simulate.drive(MODEL, "figure8", power_noise=5.0, seed=1)
    again = ep.DriveLog.read(log.to_frame())
    assert set(again.channels) == set(log.channels)
    for name, values in log.channels.items():
        assert np.array_equal(again.channel(name), values)


def test_frames_of_other_programs_are_read_as_files_are() -> None:
    frame = pd.DataFrame(
        {
            "t": pd.to_datetime([0, 500, 1000, 1500], unit="ms"),
            "velL": [50, 50, None, 50],
            "velR": pd.array([50, 50, 50, 50], dtype="Int64"),
            "watt": ["120", "120", "120", "120"],
            "state": ["a", "b", "c", "d"],
        }
    )
    log = ep.DriveLog.read(frame, "v_left=velL[cm/s],v_right=velR[cm/s],power=watt")
    assert log.t == pytest.approx([0.0, 0.5, 1.5])
    assert log.channel("v_left") == pytest.approx(0.5)
    assert [one.count for one in log.set_aside] == [1]
    assert any("state" in warning for warning in log.warnings)


def test_numbers_are_read_alike_with_and_without_other_columns(tmp_path: Path) -> None:
    """A table of numbers alone is read by NumPy, any other by pandas."""
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(200, 3)) * 10.0 ** rng.integers(-9, 9, (200, 3))
    rows = [",".join(map(repr, row)) for row in numbers.tolist()]
    rows[7] = "1e400, -0 ,1E30"
    plain, mixed = tmp_path / "plain.csv", tmp_path / "mixed.csv"
    plain.write_text("\n".join(["a,b,c", *rows]))
    mixed.write_text("\n".join(["a,b,c,word", *(f"{row},x" for row in rows)]))
    one, other = (read_table(file, DriveLogError) for file in (plain, mixed))
    assert list(other.text) == ["word"]
    exact = int(pd.__version__.partition(".")[0]) >= 3  # before, pandas rounds texts its own way
    for name in "abc":
        same = np.testing.assert_array_equal if exact else np.testing.assert_allclose
        same(one.column(name), other.column(name))
    np.testing.assert_array_equal(np.delete(one.column("b"), 7), np.delete(numbers[:, 1], 7))


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        (pd.DataFrame({"t": [0.0, 1.0], "v_left": 0.5}), "v_right"),
        (pd.DataFrame({"t": [0.0, 1.0], "v_left": 0.5, "v_right": ["a", "b"], "power": 1.0}),
         "row 0"),
        (pd.DataFrame([[0, 0], [1, 1]], columns=["t", "t"]), "two columns are named 't'"),
        (pd.DataFrame(), "no columns"),
        ([1, 2], "give a pandas DataFrame"),
    ],
)  # fmt: skip
def test_frames_that_are_no_log_are_refused(frame: pd.DataFrame, told: str) -> None:
    with pytest.raises(DriveLogError, match=told):
        ep.DriveLog.read(frame)


def test_a_trajectory_survives_the_way_through_a_frame() -> None:
    drive = ep.Trajectory([0, 2], x=[0, 1], y=[0, 0], yaw=[0, 0], v=[0.5, 0.5], omega=[0, 0])
    frame = drive.to_frame()
    assert list(frame.columns) == ["t", "x", "y", "yaw", "v", "omega"]
    again = ep.Trajectory(**frame)
    assert np.array_equal(again.poses, drive.poses)
