"""Logs of flight controllers, which drive rovers too: PX4, ArduPilot, and MAVLink telemetry."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from energyplan.errors import DriveLogError, EnergyPlanError, needs_extra
from energyplan.io.bags import LONGEST, said
from energyplan.logs.tables import MAX_BYTES, MAX_COLUMNS, Recording, of_messages
from energyplan.path import FloatArray

_CLOCKS = {"TimeUS", "TimeMS"}
_INSTANCES = ("I", "Instance", "C")  # columns of ArduPilot's messages that number their sources
_NO_AUTOPILOT = 8  # of MAVLink: a ground station, a camera
_NO_CELL = 65535.0  # voltage of a cell that there is none of [mV]


class _Stream(NamedTuple):
    """What the messages of one kind and source hold."""

    kind: str
    t: FloatArray
    fields: dict[str, FloatArray]


class _Messages:
    """The numbers of messages of one kind and source, as these come."""

    def __init__(self, kind: str) -> None:
        self.kind, self.t = kind, array("d")
        self.fields: dict[str, array[float]] = {}

    def add(self, t: float, message: Any, names: list[str]) -> None:
        """Keep the numbers of a message, and the elements of its arrays."""
        self.t.append(t)
        for name in names:
            value = getattr(message, name)
            if isinstance(value, int | float):
                self.fields.setdefault(name, array("d")).append(value)
            elif isinstance(value, list | array) and len(value) <= LONGEST:
                for k, one in enumerate(value):
                    self.fields.setdefault(f"{name}[{k}]", array("d")).append(one)

    @property
    def topic(self) -> _Stream:
        """All of them; fields that only some messages hold are left out."""
        whole = {name: np.array(v) for name, v in self.fields.items() if len(v) == len(self.t)}
        return _Stream(self.kind, np.array(self.t), whole)


def is_flight(path: str | Path) -> bool:
    """Return whether a path is a flight controller's log, by its suffix."""
    return Path(path).suffix.lower() in FLIGHT_SUFFIXES


def read_flight(path: str | Path, wanted: Callable[[str], bool] | None = None) -> Recording:
    """Read all numbers of a flight controller's log; of some messages, or all."""
    file = Path(path)
    form = _FORMATS[file.suffix.lower()]
    with _named(file):
        with file.open("rb") as stream:
            if stream.read(len(form.beginning)) != form.beginning:
                raise ValueError("it does not begin as such a log does")
            if stream.seek(0, os.SEEK_END) > MAX_BYTES:
                raise ValueError(f"it holds more than {MAX_BYTES >> 20} MiB")
        topics = {
            name: one for name, one in form.read(str(file)).items()
            if wanted is None or wanted(name)
        }  # fmt: skip
    fields = {name: one.fields | _computed(one) for name, one in topics.items()}
    clocks = {name: one.t for name, one in topics.items()}
    kinds = {name: one.kind for name, one in topics.items()}
    return of_messages(file.name, fields, clocks, kinds, {})


@contextmanager
def _named(file: Path) -> Iterator[None]:
    """Name the file in what a package complains of; what it prints is no answer of ours."""
    stderr = os.dup(2)
    try:
        with Path(os.devnull).open("w") as none, redirect_stdout(none), redirect_stderr(none):
            os.dup2(none.fileno(), 2)  # where compiled code prints
            with needs_extra("flight", f"reading {file}"):
                yield
    except EnergyPlanError:
        raise
    except OSError as problem:
        raise DriveLogError(f"{file} cannot be read: {problem.strerror or problem}") from None
    except Exception as problem:  # noqa: BLE001  as pymavlink raises
        raise DriveLogError(
            f"{file} is no sound log of a flight controller: {said(problem)}; copy it again, or "
            "export it as CSV, as ulog2csv and mavlogdump.py --format csv do"
        ) from None
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def _of_px4(file: str) -> dict[str, _Stream]:
    """Read what PX4 logs."""
    from pyulog import ULog

    formats = ULog(file, parse_header_only=True).message_formats

    @cache
    def size(kind: str) -> int:
        parts = formats[kind].fields if kind in formats else ()
        return sum(max(count, 1) * size(part) for part, count, _ in parts) if parts else 1

    if any(size(kind) > MAX_COLUMNS for kind in formats):
        raise ValueError(f"a message holds more than {MAX_COLUMNS} fields")
    return {
        f"/{one.name}_{one.multi_id}": _Stream(
            one.name, one.data["timestamp"] * 1e-6,
            {name: values.astype(float) for name, values in one.data.items()},
        )
        for one in ULog(file).data_list
    }  # fmt: skip


def _of_ardupilot(file: str) -> dict[str, _Stream]:
    """Read what ArduPilot logs."""
    from pymavlink.DFReader import DFReader_binary

    topics: dict[str, _Messages] = {}
    with DFReader_binary(file) as log:
        while (message := log.recv_msg()) is not None:
            kind, names = message.get_type(), message.fmt.columns
            by = message.fmt.instance_field or next((n for n in _INSTANCES if n in names), "")
            if _CLOCKS & {*names}:
                name = f"/{kind}_{getattr(message, by)}" if by else f"/{kind}"
                one = topics.setdefault(name, _Messages(kind))
                one.add(message._timestamp, message, names)
    return {name: one.topic for name, one in topics.items()}


def _of_telemetry(file: str) -> dict[str, _Stream]:
    """Read what a ground station received by MAVLink."""
    from pymavlink import mavutil

    systems: dict[int, dict[str, _Messages]] = {}
    vehicles = set[int]()
    log = mavutil.mavlogfile(file)
    try:
        while (message := log.recv_msg()) is not None:
            kind, system = message.get_type(), message.get_srcSystem()
            if kind == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT:
                vehicles.add(system)
            by = getattr(message, "instance_field", None)
            name = f"/{kind}_{getattr(message, by)}" if by else f"/{kind}"
            one = systems.setdefault(system, {}).setdefault(name, _Messages(kind))
            one.add(message._timestamp, message, message.get_fieldnames())
    finally:
        log.close()
    if len(vehicles) != 1:
        several = f"messages of {len(vehicles)} vehicles" if vehicles else "no vehicle's heartbeat"
        raise DriveLogError(
            f"{file} holds {several}; write those of one alone, as in mavlogdump.py "
            f"--source-system {min(vehicles, default=1)} --output one.tlog {Path(file).name}"
        )
    return {name: one.topic for name, one in systems[vehicles.pop()].items()}


class _Format(NamedTuple):
    """A kind of log: its first bytes, and what reads it."""

    beginning: bytes
    read: Callable[[str], Mapping[str, _Stream]]


_FORMATS = {
    ".ulg": _Format(b"ULog\x01\x12\x35", _of_px4),
    ".bin": _Format(b"\xa3\x95", _of_ardupilot),
    ".tlog": _Format(b"", _of_telemetry),
}
FLIGHT_SUFFIXES = (*_FORMATS,)


def _computed(topic: _Stream) -> dict[str, FloatArray]:
    """Return fields that are computed of others: the speed ahead, the voltage of all cells."""
    held, found = topic.fields, dict[str, FloatArray]()
    if {"vx", "vy", "heading"} <= held.keys():
        yaw = held["heading"]
        found["ahead"] = held["vx"] * np.cos(yaw) + held["vy"] * np.sin(yaw)
    cells = [values for name, values in held.items() if name.startswith("voltages[")]
    if cells:
        found["voltage"] = np.sum([np.where(one == _NO_CELL, 0.0, one) for one in cells], axis=0)
    return found
