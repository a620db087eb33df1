"""Logs of flight controllers that drive a rover tell what the same drive tells as a table."""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Run
from foreign_logs import ROVER, At, drive

import energyplan as ep
from energyplan.errors import DriveLogError, MissingDependencyError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start

BOOT = 12.5  # the clocks begin when the autopilot boots, or with the calendar [s]
EPOCH = 1_770_000_000
KNOWN = Given(**{k: v for k, v in ROVER.measures.items() if k != "wheel_radius"})
Rows = dict[str, tuple[dict[str, np.ndarray], int]]


@cache
def at() -> At:
    return At(drive(ROVER, 20.0), ROVER)


def rows(wheels: bool = True, **other: np.ndarray) -> Rows:
    """Return what each message holds, and how many times slower than the log it comes."""
    one = at()
    x, y = one.log.channel("x"), one.log.channel("y")
    turned = [np.cumsum(side) * 0.05 for side in (one.left, one.right)]
    speed = 0.5 * (one.left + one.right)
    found: Rows = {
        "wheels": ({"left": turned[0], "right": turned[1], "l": one.left / ROVER.radius,
                    "r": one.right / ROVER.radius}, 1),
        "battery": ({"volts": one.volts, "amps": one.amps}, 2),
        "gyro": ({"x": 0.0 * x, "z": -one.yaw_rate}, 1),
        "pose": ({"north": x, "east": -y, "heading": -one.yaw, "speed": speed,
                  "vn": speed * np.cos(one.yaw), "ve": -speed * np.sin(one.yaw)}, 2),
    }  # fmt: skip
    return found if wheels else {name: row for name, row in found.items() if name != "wheels"}


def events(table: Rows) -> Iterable[tuple[float, str, dict[str, float]]]:
    """Yield the messages by their times."""
    every = [
        (float(at().t[k]), name, {key: float(v[k]) for key, v in values.items()})
        for name, (values, step) in table.items() for k in range(0, len(at().t), step)
    ]  # fmt: skip
    return sorted(every, key=lambda one: one[0])


def ulog(folder: Path, table: Rows, batteries: int = 1) -> Path:
    """Write a file as PX4's format is described: formats, subscriptions, then data."""
    kinds = {
        "wheels": ("wheel_encoders", "float[2] wheel_speed;float[2] wheel_angle", "r l . ."),
        "battery": ("battery_status", "float voltage_v;float current_a", "volts amps"),
        "gyro": ("vehicle_angular_velocity", "float[3] xyz", "x x z"),
        "pose": ("vehicle_local_position", "float x;float y;float heading;float vx;float vy",
                 "north east heading vn ve"),
    }  # fmt: skip

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    stream = io.BytesIO()
    stream.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
    used = [(k, kinds[name], name) for k, name in enumerate(table)]
    for _, (kind, fields, _), _ in used:
        stream.write(message("F", f"{kind}:uint64_t timestamp;{fields};".encode()))
    numbers: dict[str, list[int]] = {}
    for k, (kind, _, _), name in used:
        for j in range(batteries if name == "battery" else 1):
            numbers.setdefault(name, []).append(k + 10 * j)
            stream.write(message("A", struct.pack("<BH", j, k + 10 * j) + kind.encode()))
    for t, name, values in events(table):
        cells = [values.get(key, 0.0) for key in kinds[name][2].split()]
        if name == "battery":
            cells[1] /= batteries
        for number in numbers[name]:
            head = struct.pack("<HQ", number, round(1e6 * (BOOT + t)))
            stream.write(message("D", head + struct.pack(f"<{len(cells)}f", *cells)))
    file = folder / "rover.ulg"
    file.write_bytes(stream.getvalue())
    return file


def dataflash(folder: Path, table: Rows) -> Path:
    """Write a file as ArduPilot does: FMT messages, then the others."""
    kinds = {
        "wheels": ("WENC", "Qfbfb", "TimeUS,Dist0,Qual0,Dist1,Qual1", "left . right ."),
        "battery": ("BAT", "QBff", "TimeUS,Inst,Volt,Curr", ". volts amps"),
        "gyro": ("IMU", "QBff", "TimeUS,I,GyrX,GyrZ", ". x z"),
        "pose": ("XKF1", "QBffff", "TimeUS,C,PN,PE,Yaw,VN", ". north east degrees vn"),
    }  # fmt: skip
    sizes = {"Q": "Q", "f": "f", "b": "b", "B": "B", "c": "h"}

    def written(number: int, *content: bytes) -> bytes:
        return b"\xa3\x95" + bytes([number]) + b"".join(content)

    def form(number: int, length: int, name: str, fields: str, columns: str) -> bytes:
        parts = [part.encode().ljust(n, b"\0")
                 for part, n in ((name, 4), (fields, 16), (columns, 64))]  # fmt: skip
        return written(128, bytes([number, length]), *parts)

    file = folder / "rover.bin"
    speed = ("THR", "Qf", "TimeUS,Speed", "speed")
    with file.open("wb") as stream:
        stream.write(form(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"))
        for k, (name, fields, columns, _) in enumerate([*kinds.values(), speed], 129):
            size = struct.calcsize("<" + "".join(sizes[one] for one in fields)) + 3
            stream.write(form(k, size, name, fields, columns))
        for t, name, values in events(table):
            values["degrees"] = np.degrees(values.get("heading", 0.0)) % 360.0
            for kind in ("pose", "speed") if name == "pose" else (name,):
                _, fields, _, keys = kinds.get(kind, speed)
                cells = [values.get(key, 0.0) for key in keys.split()]
                cells = [int(v) if f in "bB" else v
                         for v, f in zip(cells, fields[1:], strict=True)]  # fmt: skip
                number = 129 + [*kinds, "speed"].index(kind)
                content = struct.pack("<" + "".join(sizes[one] for one in fields),
                                      round(1e6 * (BOOT + t)), *cells)  # fmt: skip
                stream.write(written(number, content))
    return file


def telemetry(folder: Path, table: Rows, systems: tuple[int, ...] = (1,)) -> Path:
    """Write what a ground station receives, and says itself."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    file = folder / "rover.tlog"
    links = {number: mavlink.MAVLink(None, srcSystem=number) for number in (*systems, 255)}

    with file.open("wb") as stream:

        def put(t: float, system: int, message: Any) -> None:
            stream.write(struct.pack(">Q", round(1e6 * (EPOCH + t))))
            stream.write(message.pack(links[system]))

        for number in (*systems, 255):
            autopilot = 8 if number == 255 else 3
            put(0.0, number, mavlink.MAVLink_heartbeat_message(10, autopilot, 0, 0, 4, 3))
        for t, name, one in events(table):
            boot = round(1e3 * (BOOT + t))
            for number in systems:
                if name == "wheels":
                    way = [one["left"], one["right"], *[0.0] * 14]
                    put(t, number, mavlink.MAVLink_wheel_distance_message(1000 * boot, 2, way))
                elif name == "battery":
                    half = round(500 * one["volts"])
                    cells = [half, round(1e3 * one["volts"]) - half, *[65535] * 8]
                    for k in (0, 1):
                        put(t, number, mavlink.MAVLink_battery_status_message(
                            k, 0, 0, 0, cells, round(50 * one["amps"]), 0, 0, 90))  # fmt: skip
                    put(
                        t,
                        number,
                        mavlink.MAVLink_sys_status_message(
                            0, 0, 0, 0, sum(cells[:2]), round(50 * one["amps"]), 90, *[0] * 6
                        ),
                    )
                elif name == "gyro":
                    put(t, number, mavlink.MAVLink_attitude_message(
                        boot, 0.0, 0.0, 0.0, 0.0, 0.0, one["z"]))  # fmt: skip
                else:
                    put(
                        t,
                        number,
                        mavlink.MAVLink_local_position_ned_message(
                            boot, one["north"], one["east"], 0.0, one["vn"], one["ve"], 0.0
                        ),
                    )
                    put(t, number, mavlink.MAVLink_vfr_hud_message(
                        0.0, abs(one["speed"]), 0, 50, 0.0, 0.0))  # fmt: skip
    return file


WRITERS = {"ulog": ulog, "dataflash": dataflash, "telemetry": telemetry}
NEEDS = {"ulog": "pyulog", "dataflash": "pymavlink", "telemetry": "pymavlink"}


@cache
def coefficients() -> np.ndarray:
    return ep.identify(at().log, ROVER.vehicle).model.coefficients


@pytest.mark.parametrize("kind", WRITERS)
def test_start_reads_a_rovers_log(tmp_path: Path, kind: str) -> None:
    """Speeds by encoders, yaw to the left, power of all batteries, place to the left of north."""
    pytest.importorskip(NEEDS[kind])
    file = WRITERS[kind](tmp_path, rows())
    made = start(file, KNOWN)
    assert made.sound, made.checks
    log = read_log(file, topics=made.project.topics)
    found = ep.identify(log, ROVER.vehicle).model.coefficients
    np.testing.assert_allclose(found, coefficients(), rtol=0.02)
    for name in ("x", "y", "yaw_rate"):
        wanted = np.interp(log.t, at().t, at().log.channel(name))
        assert np.median(np.abs(log.channel(name) - wanted)) < 0.05, name
    assert log.has("voltage") and log.has("current")


def test_batteries_of_a_flight_controller_are_added(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    made = start(ulog(tmp_path, rows(), batteries=2), KNOWN)
    current = made.project.topics.channels["current"][0]
    assert current.plus == ("/battery_status_1.current_a",)
    log = read_log(tmp_path / "rover.ulg", topics=made.project.topics)
    assert log.energy == pytest.approx(at().log.energy, rel=0.01)


@pytest.mark.parametrize("kind", WRITERS)
def test_without_encoders_the_slip_is_unseen(tmp_path: Path, kind: str) -> None:
    """The speed ahead and the gyroscope make the tread speeds, with the track."""
    pytest.importorskip(NEEDS[kind])
    file = WRITERS[kind](tmp_path, rows(wheels=False))
    with pytest.raises(DriveLogError, match=r"no speeds of the wheels.*--track"):
        start(file, Given())
    made = start(file, KNOWN)
    assert any("how the wheels slip in turns is unseen" in note for note in made.notes)
    log = read_log(file, topics=made.project.topics)
    half = 0.5 * ROVER.track * np.interp(log.t, at().t, at().yaw_rate)
    difference = log.channel("v_right") - log.channel("v_left")
    assert np.median(np.abs(0.5 * difference - half)) < 0.01


@pytest.mark.parametrize(("kind", "lacks", "message"), [
    ("ulog", ("wheels", "pose"), "v_left or v_right; wheel_encoders or WENC"),
    ("dataflash", ("wheels", "pose"), "have the flight controller log that"),
    ("telemetry", ("battery",), "power; BATTERY_STATUS or SYS_STATUS"),
])  # fmt: skip
def test_what_a_flight_controller_does_not_log_is_named(
    tmp_path: Path, kind: str, lacks: tuple[str, ...], message: str
) -> None:
    pytest.importorskip(NEEDS[kind])
    file = WRITERS[kind](tmp_path, {k: v for k, v in rows().items() if k not in lacks})
    with pytest.raises(DriveLogError, match=message) as error:
        start(file, KNOWN)
    assert "nobody but you knows" not in str(error.value)


def test_a_log_of_two_vehicles_is_refused(tmp_path: Path) -> None:
    file = telemetry(tmp_path, {"gyro": (rows()["gyro"][0], 100)}, (1, 7))
    with pytest.raises(DriveLogError, match=r"2 vehicles.*--source-system 1"):
        start(file, KNOWN)


@pytest.mark.parametrize("suffix", [".ulg", ".bin", ".tlog"])
@pytest.mark.parametrize("content", [b"", b"no log", b"\0" * 5000, b"\xa3\x95\x80" + b"\xff" * 200])
def test_what_is_no_flight_log_is_refused(tmp_path: Path, suffix: str, content: bytes) -> None:
    pytest.importorskip("pyulog"), pytest.importorskip("pymavlink")
    file = tmp_path / f"drive{suffix}"
    file.write_bytes(content)
    with pytest.raises(DriveLogError, match=f"drive{suffix}"):
        start(file, KNOWN)


def test_a_damaged_log_is_read_without_noise(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """What was written over is left out; the packages' complaints are none of ours."""
    pytest.importorskip("pymavlink")
    file = dataflash(tmp_path, rows())
    content = bytearray(file.read_bytes())
    content[5000:5400] = b"\xff" * 400
    file.write_bytes(content)
    assert start(file, KNOWN).sound
    assert capfd.readouterr() == ("", "")


def test_a_type_of_gigabytes_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    parts = b"a:uint8_t[60000] x;", b"b:a[60000] y;"
    body = b"".join(struct.pack("<HB", len(one), ord("F")) + one for one in parts)
    file = tmp_path / "bomb.ulg"
    file.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + body)
    with pytest.raises(DriveLogError, match="more than 4096 fields"):
        start(file, KNOWN)


def test_the_extra_is_named_where_a_package_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = ulog(tmp_path, rows())
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(MissingDependencyError, match=r"\[flight\]"):
        start(file, KNOWN)


def test_commands_go_from_a_flight_log_to_a_model(tmp_path: Path, run: Run) -> None:
    pytest.importorskip("pymavlink")
    file, project = dataflash(tmp_path, rows()), tmp_path / "rover.yaml"
    measures = (f"--{name}={getattr(ROVER, name)}" for name in ("track", "wheelbase", "mass"))
    answer = run("start", file, *measures, "--out", project)
    assert answer.code == 0, answer.err
    found = run("identify", file, "--project", project, "--json").json["terms"]
    assert found[1]["value"] == pytest.approx(ROVER.K, rel=0.02)
