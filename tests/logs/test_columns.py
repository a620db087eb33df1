"""Tables as robots and spreadsheets write them: names, separators, decimal signs, times, units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.logs.mapping import known_unit, parse_columns

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
    numbers = {
        "v_left": drive.channel("v_left") / RADIUS,
        "v_right": drive.channel("v_right") / RADIUS,
        "power": drive.power / 1e3,
        "yaw": np.degrees(drive.channel("yaw")),
        "yaw_rate": np.degrees(drive.channel("yaw_rate")),
    }
    columns = [times, *([f"{value:.9f}" for value in values] for values in numbers.values())]
    names = [NAMES["t"], *(NAMES[name] for name in numbers)]
    quote = '"{}"'.format if mark == "," else str
    rows = [mark.join(map(quote, names))]
    for cells in zip(*columns, strict=True):
        cells = [cell.replace(".", ",") for cell in cells] if comma else cells
        cells = [f'"{cell}"' if comma and mark == "," else cell for cell in cells]
        if stamp == "iso":
            cells[0] = cells[0].replace(",", ".")
        rows.append(mark.join(cells))
    return "\n".join(rows) + "\n"


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
