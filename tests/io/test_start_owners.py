"""Logs as owners of robots have them: clocks, headers, rows and files of many tools.

Each is read right by `start`, or refused with the way.
"""

from __future__ import annotations

import re
import sqlite3
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_logs import EPOCH, ROVER, At, drive
from small_bags import BATTERY, JOINTS, Recorder

import energyplan as ep
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start

AT = At(drive(ROVER), ROVER)
SPEEDS = {"left_speed": AT.left, "right_speed": AT.right, "gyro_z": AT.yaw_rate}
CLOCKED = {"time": AT.t, **SPEEDS}
DRAWN = {"voltage": AT.volts, "current": AT.amps}
MS = np.round(1e3 * AT.t)
COLUMNS: dict[str, dict[str, object]] = {
    # clocks that start again at zero
    "day in ms": {"time [ms]": (86_300_000 + MS) % 86_400_000, **SPEEDS, **DRAWN},
    "second of the day": {"second_of_day": (86_300 + AT.t) % 86_400, **SPEEDS, **DRAWN},
    "week of satellites": {"gps_tow_ms": (604_700_000 + MS) % 604_800_000, **SPEEDS, **DRAWN},
    "32 bits of us": {"micros": (2**32 - 5e7 + 1e3 * MS) % 2**32, **SPEEDS, **DRAWN},
    "16 bits of ms": {"millis": MS % 2**16, **SPEEDS, **DRAWN},
    # clocks in several columns
    "minutes and seconds": {"minutes": AT.t // 60, "seconds": AT.t % 60, **SPEEDS, **DRAWN},
    "year to second": {"Year": 2026, "Month": 5, "Day": 4, "Hour": 12, "Minute": AT.t // 60,
                       "Second": AT.t % 60, **SPEEDS, **DRAWN},
    # clocks as text
    "since the start": {"time": [f"{int(t // 60):02d}:{t % 60:06.3f}" for t in AT.t],
                        **SPEEDS, **DRAWN},
    "ms after a colon": {"time": [f"{s[:8]}:{s[9:12]}" for s in AT.stamps.strftime("%H:%M:%S.%f")],
                         **SPEEDS, **DRAWN},
    # units
    "coulombs counted": {**CLOCKED, "voltage": AT.volts, "coulomb_count": AT.summed(AT.amps)},
    "joules in all": {**CLOCKED, "joules_total": AT.summed(AT.power)},
    "tenths in brackets": {**CLOCKED, "voltage [0.01 V/bit]": np.round(100 * AT.volts),
                           "current [10mA]": np.round(100 * AT.amps)},
    "encoders in mm/s": {"t [ns]": np.round(1e9 * (EPOCH + AT.t)),
                         "front_leftEncoder_mm_s": 1e3 * AT.left,
                         "front_rightEncoder_mm_s": 1e3 * AT.right, **DRAWN},
    "metres a minute": {"time": AT.t, "left.speed_m_min": 60.0 * AT.left,
                        "right.speed_m_min": 60.0 * AT.right, "gyro_z": AT.yaw_rate, **DRAWN},
    "joined words": {"time": AT.t, "speedleft [km/h]": 3.6 * AT.left,
                     "speedright [km/h]": 3.6 * AT.right, "gyro_z": AT.yaw_rate, **DRAWN},
    # languages
    "French": {"Temps (s)": AT.t, "Vitesse gauche (m/s)": AT.left,
               "Vitesse droite (m/s)": AT.right, "Tension batterie (V)": AT.volts,
               "Courant batterie (A)": AT.amps},
    "Spanish": {"tiempo_ms": MS, "velocidad_izquierda": AT.left, "velocidad_derecha": AT.right,
                "tensi\u00f3n": AT.volts, "corriente": AT.amps},
    "Italian": {"tempo": AT.t, "velocit\u00e0_sinistra [m/s]": AT.left,
                "velocit\u00e0_destra [m/s]": AT.right, "potenza [W]": AT.power},
    # a driver that does not fill a field
    "power of zeros": {**CLOCKED, **DRAWN, "power": 0.0 * AT.t},
}  # fmt: skip


def check_right(file: Path, **known: object) -> None:
    made = start(file, Given(**ROVER.measures, **known))
    assert made.sound, made.checks
    log = read_log(file, dict(made.project.columns) or None, topics=made.project.topics)
    found = ep.identify(log, made.project.vehicle).model
    assert found.coefficient("traction_resistance") == pytest.approx(ROVER.K, rel=0.02)


def said_of(file: Path) -> str:
    with pytest.raises(DriveLogError) as error:
        start(file, Given(**ROVER.measures))
    return str(error.value)


@pytest.mark.parametrize("name", COLUMNS)
def test_columns_are_read_right(tmp_path: Path, name: str) -> None:
    pd.DataFrame(COLUMNS[name]).to_csv(tmp_path / "log.csv", index=False)
    check_right(tmp_path / "log.csv")


def test_instants_and_numbers_with_commas_are_read(tmp_path: Path) -> None:
    """As a German spreadsheet writes them."""
    table = pd.DataFrame({
        "Zeit": AT.stamps.strftime("%Y-%m-%dT%H:%M:%S,%f"), "Drehzahl links [U/min]": AT.left,
        "Drehzahl rechts [U/min]": AT.right, "Spannung [V]": AT.volts, "Strom [A]": AT.amps,
    })  # fmt: skip
    for name in ("Drehzahl links [U/min]", "Drehzahl rechts [U/min]"):
        table[name] *= 30 / np.pi / ROVER.radius
    table.to_csv(tmp_path / "log.csv", index=False, sep=";", decimal=",")
    check_right(tmp_path / "log.csv")


def test_a_clock_that_was_set_back_is_refused(tmp_path: Path) -> None:
    """It goes on after no period of a clock."""
    back = np.where(AT.t < 100.0, AT.t, AT.t - 70.0)
    pd.DataFrame({"time": back, **SPEEDS, **DRAWN}).to_csv(tmp_path / "log.csv", index=False)
    assert "t does not increase" in said_of(tmp_path / "log.csv")


def test_states_of_entities_stand_in_rows(tmp_path: Path) -> None:
    """As a home automation exports them, with times under a name of its own."""
    pd.concat([
        pd.DataFrame({"entity_id": f"sensor.{name}", "state": values,
                      "last_changed": AT.stamps.strftime("%Y-%m-%dT%H:%M:%S.%fZ")})
        for name, values in {**SPEEDS, **DRAWN}.items()
    ]).to_csv(tmp_path / "log.csv", index=False)  # fmt: skip
    check_right(tmp_path / "log.csv")


def test_what_keeps_one_robot_can_be_typed(tmp_path: Path) -> None:
    rows = [pd.DataFrame({**CLOCKED, **DRAWN, "robot_id": number}) for number in (7, 9)]
    pd.concat(rows).sort_values("time").to_csv(tmp_path / "log.csv", index=False)
    assert "table[table['robot_id'] == 7]" in said_of(tmp_path / "log.csv")


BEGINNINGS = {
    "MATLAB": b"MATLAB 5.0 MAT-file, Platform" + bytes(200), "PX4": b"ULog\x01\x12\x35\x01",
    "ArduPilot": b"\xa3\x95\x80\x80\x59FMT\0", "read_pickle": b"\x80\x04\x95" + bytes(50),
    "asammdf": b"MDF     4.10    " + bytes(90), "LabVIEW": b"TDSm" + bytes(90),
    "workbook": b"\xd0\xcf\x11\xe0\xa1\xb1" + bytes(90), "unlz4": b"\x04\x22\x4d\x18" + bytes(9),
    "7z x": b"7z\xbc\xaf\x27\x1c" + bytes(90), "JSON": b'[{"t": 0.0, "v": 1.0}]',
    "page or XML": b"<!DOCTYPE html><html>", "Arrow": b"\xff\xff\xff\xff\x10\0\0\0" + bytes(90),
    "decoded": b"(1609459200.000000) can0 123#0102030405060708\n",
}  # fmt: skip


@pytest.mark.parametrize("way", BEGINNINGS)
def test_a_file_of_another_kind_is_known_by_its_first_bytes(tmp_path: Path, way: str) -> None:
    (tmp_path / "log.csv").write_bytes(BEGINNINGS[way])
    assert way in said_of(tmp_path / "log.csv")


def record(path: Path, kind: str, definitions: dict[str, str] | None = None) -> Path:
    """Write a bag of two joints and a battery."""
    pytest.importorskip("rosbags")
    with Recorder(path, kind, definitions) as bag:
        for k, t in enumerate(EPOCH + AT.t):
            turning = [AT.left[k] / ROVER.radius, AT.right[k] / ROVER.radius]
            bag.write("/joints", JOINTS, t, name=["left_wheel", "right_wheel"], velocity=turning)
            bag.write("/battery", BATTERY, t, voltage=AT.volts[k], current=-AT.amps[k])
            for kind_of in definitions or ():
                bag.write("/own", kind_of, t, reading=1.0)
    return path


def test_a_bag_without_definitions_is_read_by_those_of_ros(tmp_path: Path) -> None:
    """What no package of ROS defines is named."""
    bag = record(tmp_path / "bag", "sqlite", {"own_msgs/msg/Own": "float64 reading\n"})
    with sqlite3.connect(bag / "bag.db3") as base:
        base.execute("delete from message_definitions")
    check_right(bag)
    notes = start(bag, Given(**ROVER.measures)).notes
    assert any("/own is left out: the bag does not hold the definition" in one for one in notes)


def test_a_compressed_bag_alone_is_refused_with_the_way(tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", "sqlite-message")
    check_right(bag)
    alone = (bag / "bag.db3").rename(tmp_path / "alone.db3")
    assert "give the folder with both" in said_of(alone)


def test_a_database_that_is_no_bag_is_refused_with_the_way(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    with sqlite3.connect(tmp_path / "log.db3") as base:
        base.execute("create table log (t, v)")
    assert "it has no table of messages; sqlite3" in said_of(tmp_path / "log.db3")


@pytest.mark.parametrize(
    ("suffix", "head", "way"),
    [(".mcap", b"\x28\xb5\x2f\xfd", "unzstd"), (".bag", b"\x1f\x8b", "gunzip")],
)
def test_a_packed_bag_is_refused_with_the_way(
    tmp_path: Path, suffix: str, head: bytes, way: str
) -> None:
    pytest.importorskip("rosbags")
    file = tmp_path / f"log{suffix}"
    file.write_bytes(head + bytes(90))
    assert way in said_of(file)


def test_a_question_says_why_and_what_answers_it(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    parts = {"traction_power_W": 0.8 * AT.power, "hotel_power": 0.2 * AT.power}
    pd.DataFrame({**CLOCKED, **parts}).to_csv(file, index=False)
    question = said_of(file)
    assert "traction_power_W by its name, in [W] (score 3), hotel_power by its name (score 2)" in (
        question
    )
    ways = re.findall(r"--columns '([^']+)'", question)
    assert "power=traction_power_W+hotel_power" in ways
    check_right(file, columns="power=traction_power_W+hotel_power")
    for way in ways:  # each can be typed
        start(file, Given(**ROVER.measures, columns=way))


def test_parts_in_several_units_are_added_by_their_sizes(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    parts = {"traction_power_kW": 0.8e-3 * AT.power, "hotel_power_W": 0.2 * AT.power}
    pd.DataFrame({**CLOCKED, **parts}).to_csv(file, index=False)
    way = "power=1000*traction_power_kW+1*hotel_power_W[W]"
    assert f"--columns '{way}'" in said_of(file)
    check_right(file, columns=way)
