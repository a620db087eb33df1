"""Samples from the lines of a table, one by one, and the events of a drive as it happens."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import chain
from math import isfinite, isnan, nan
from pathlib import Path
from typing import BinaryIO

from energyplan.errors import DriveLogError
from energyplan.logs.clean import ANY, LIMITS, needed_channels
from energyplan.logs.mapping import Column, map_channels
from energyplan.logs.tables import LOOKED_AT, cut, find_dialect, reads
from energyplan.mission import MissionReport
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.records import instance


@dataclass(frozen=True)
class Trouble:
    """Something that could not be used."""

    place: str  # where, such as ``"line 12"``
    reason: str  # what was wrong, and what was done
    count: int = 1  # how often it came


@dataclass(frozen=True)
class Learned:
    """The model as it is known now."""

    t: float  # time [s]
    model: PowerModel  # the model of the ground at hand, with covariance
    samples: int  # samples so far
    factor: float = 1.0  # of the former runs' power, where the model is theirs


@dataclass(frozen=True)
class Changed:
    """The ground changed."""

    t: float  # when it was noticed [s]
    onset: float  # about when it happened [s]
    statistic: float  # how clear it is
    before: PowerModel  # the model up to then


@dataclass(frozen=True)
class Done:
    """A task was done."""

    t: float  # time [s]
    task: str  # its name


@dataclass(frozen=True)
class Reassessed:
    """The rest of the mission, as it looks now."""

    t: float  # time [s]
    pose: Pose  # where the robot is
    soc: float  # state of charge
    done: tuple[str, ...]  # tasks that are done
    driven: Mapping[str, float]  # of tasks whose paths are driven in part, how far [m]
    report: MissionReport | None  # the rest of the mission


@dataclass(frozen=True)
class Ended:
    """The log has ended, or nobody wants to know more."""

    samples: int  # samples that were learned from
    changes: int  # changes of the ground
    models: tuple[PowerModel, ...]  # what was learned
    set_aside: Mapping[str, int] = field(default_factory=dict)


Event = Trouble | Learned | Changed | Done | Reassessed | Ended


_BLOCK = 1 << 16
MAX_LINE = 1 << 16
"""Longest line that is read [bytes]."""


@dataclass(frozen=True)
class Line:
    r"""A line of a log."""

    number: int  # its number in the file
    text: str  # its text, without the end of line
    whole: bool = True  # whether its end has been written


@dataclass(frozen=True)
class Restart:
    """The file begins anew."""

    reason: str  # what happened to it


def follow(path: str | Path, wait: Callable[[], bool] | None = None) -> Iterator[Line | Restart]:
    """Yield the lines of a file, and those that are added to it."""
    file = Path(path)
    stream = _open(file)
    try:
        pending, number = b"", 0
        while True:
            block = stream.read(_BLOCK)
            if block:
                *ended, pending = (pending + block).split(b"\n")
                for raw in ended:
                    number += 1
                    yield Line(number, _text(raw))
                _limit(pending, file, number + 1)
                continue
            reason = _begun_anew(file, stream)
            if reason:
                if pending:
                    yield Line(number + 1, _text(pending), whole=False)
                stream.close()
                stream = _open(file)
                pending, number = b"", 0
                yield Restart(reason)
            elif wait is None or not wait():
                break
        if pending:
            yield Line(number + 1, _text(pending), whole=False)
    finally:
        stream.close()


def lines_of(stream: BinaryIO | Iterable[bytes]) -> Iterator[Line | Restart]:
    r"""Yield the lines of a pipe until it ends."""
    read = getattr(stream, "readline", None)
    raws = iter(stream) if read is None else iter(lambda: read(MAX_LINE + 1), b"")
    for number, raw in enumerate(raws, start=1):
        _limit(raw, Path("-"), number)
        yield Line(number, _text(raw), raw.endswith(b"\n"))


def _open(file: Path) -> BinaryIO:
    try:
        return file.open("rb")
    except OSError as problem:
        raise DriveLogError(f"{file} cannot be read: {problem.strerror or problem}") from None


def _begun_anew(file: Path, stream: BinaryIO) -> str:
    """Return what happened to the file; empty where nothing did, or where it is not there now."""
    try:
        there = file.stat()
    except OSError:
        return ""
    ours = os.fstat(stream.fileno())
    if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
        return "another file took its place"
    return "the file was cut" if there.st_size < stream.tell() else ""


def _limit(raw: bytes, file: Path, number: int) -> None:
    if len(raw) > MAX_LINE:
        raise DriveLogError(
            f"{file}, line {number} is longer than {MAX_LINE >> 10} KiB; this is no table of "
            "numbers in text"
        )


def _text(raw: bytes) -> str:
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("cp1252", "replace")
    return text.rstrip("\r\n")


@dataclass(frozen=True)
class Header:
    """What a log holds."""

    channels: tuple[str, ...]  # its channels
    battery_side: bool  # whether its power was measured at the battery


@dataclass(frozen=True)
class Sample:
    """One sample."""

    place: str  # where it stands, such as ``"line 12"``
    t: float  # time [s]
    v_left: float  # left tread speed [m/s]
    v_right: float  # right tread speed [m/s]
    power: float  # measured power [W]
    channels: Mapping[str, float]  # further readings, finite ones only


@dataclass(frozen=True)
class _LineFormat:
    """How the lines are to be read."""

    names: tuple[str, ...]
    separator: str
    columns: Mapping[str, Column]
    power: tuple[str, ...]
    needed: tuple[str, ...]
    first: int  # how many lines come before the readings


def read_samples(
    lines: Iterable[Line | Restart],
    columns: str | Mapping[str, str | Column] | None = None,
    needed: Collection[str] = (),
    name: str = "log",
) -> Iterator[Header | Sample | Trouble]:
    """Read samples from lines, of which one before the readings names the columns."""
    table: _LineFormat | None = None
    head: list[Line] = []  # up to the first readings
    fresh = False  # whether the next line may name the columns anew
    for line in chain(lines, [None]):
        if isinstance(line, Restart):
            yield Trouble(name, f"{line.reason}; it is read from its beginning")
            head, fresh = [], True
            continue
        if line is not None:
            instance(line, Line, "a line")
            if table is not None and fresh and line.text.strip():
                fresh = False
                if not any(isfinite(_number(cell)) for cell in cut(line.text, table.separator)):
                    table = None
            if table is None:
                head.append(line)
            elif line.text.strip():
                yield _sample(line, table, f"line {line.number}")
        if table is not None or not any(one.text.strip() for one in head):
            continue
        if line is None or reads(line.text) or "\0" in line.text or len(head) == LOOKED_AT:
            table = _table(head, columns, needed, name)
            yield Header(tuple(table.columns), table.power == ("voltage", "current"))
            rows = (one for one in head[table.first :] if one.text.strip())
            yield from (_sample(one, table, f"line {one.number}") for one in rows)
            head = []


def _table(
    head: list[Line],
    columns: str | Mapping[str, str | Column] | None,
    needed: Collection[str],
    label: str,
) -> _LineFormat:
    if not any(one.whole for one in head):
        raise DriveLogError(f"{label}, line {head[-1].number} is cut off; it must name the columns")
    if any("\0" in one.text for one in head):
        raise DriveLogError(
            f"{label} is no text in UTF-8, as a log must be that is followed; identify reads others"
        )
    text = "\n".join(one.text for one in head)
    dialect = find_dialect(text.encode(), True, label, DriveLogError)
    names = tuple(dialect.names)
    chosen = map_channels(columns, names)
    for channel, column in chosen.items():
        for source in column.names:
            if source not in names:
                raise DriveLogError(
                    f"{label}: {channel} is to come from {source!r}, which is no column; the "
                    f"columns are {', '.join(names)}"
                )
        if column.counts:
            raise DriveLogError(
                f"{label}: {channel} comes from {column.field}, which counts on: a drive as it "
                "happens is read from rates alone; give a column of speed, power or current"
            )
    basic = needed_channels(chosen, label)
    missing = [channel for channel in needed if channel not in chosen]
    if missing:
        raise DriveLogError(
            f"{label}: the model needs {', '.join(missing)}; map a column to it, such as "
            f"{missing[0]}=NAME, or give a model without it"
        )
    first = dialect.line - 1
    return _LineFormat(names, dialect.separator, chosen, basic[3:], (*basic, *needed), first)


def _number(cell: str) -> float:
    """Return a number, or the seconds since 1970 of an instant by ISO 8601; NaN for neither."""
    text = cell.strip()
    try:
        return float(text)
    except ValueError:
        pass
    try:
        instant = datetime.fromisoformat(text if text[4:5] == "-" else "")
    except ValueError:
        return nan
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()


def _sample(line: Line, table: _LineFormat, place: str) -> Sample | Trouble:
    """Return the sample of a line, or why there is none."""
    if not line.whole:
        return Trouble(place, "the line is cut off; set aside")
    cells = cut(line.text, table.separator)
    if len(cells) != len(table.names):
        return Trouble(
            place, f"cells are missing or too many (there are {len(table.names)} columns); set "
            "aside"
        )  # fmt: skip
    if table.separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    raw = dict(zip(table.names, map(_number, cells), strict=True))
    values = {channel: float(one.value(raw.__getitem__)) for channel, one in table.columns.items()}
    known = {}
    for channel, value in values.items():
        low, high, unit = LIMITS.get(channel, ANY)
        if low <= value <= high:
            known[channel] = value
        elif channel in table.needed:
            beyond = f"beyond {low:g} to {high:g} {unit}" if isfinite(value) else "no number"
            beyond += ", nor an instant by ISO 8601" if channel == "t" and isnan(value) else ""
            return Trouble(place, f"{channel} is {beyond}; set aside")
    power = [known.pop(channel) for channel in table.power]
    return Sample(
        place, known.pop("t"), known.pop("v_left"), known.pop("v_right"),
        power[0] * power[1] if table.power == ("voltage", "current") else sum(power), known,
    )  # fmt: skip
