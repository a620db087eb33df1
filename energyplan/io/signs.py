"""Reading a table whose power, yaw or one side's speed counts the other way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from energyplan.errors import DriveLogError
from energyplan.logs import DriveLog
from energyplan.logs.columns import Column, column_from
from energyplan.logs.contradictions import mirrored_side
from energyplan.logs.units import UNITS


class Signed(NamedTuple):
    """A log, the columns it was read by, and what was turned to read it."""

    log: DriveLog
    columns: dict[str, Column]
    notes: tuple[str, ...]


def read_signed(file: Path, columns: Mapping[str, Column]) -> Signed:
    """Read a table, and turn round what counts the other way."""
    notes: list[str] = []
    made = dict(columns)
    done: set[str] = set()
    while True:
        try:
            log = DriveLog.read(file, made, others=False)
        except DriveLogError as problem:
            turned = _named(str(problem), made)
            if not turned or done & set(turned):
                raise
        else:
            side = mirrored_side(log.channels, log.runs)
            turned = [side] if side and side not in done else []
            if not turned:
                return Signed(log, made, tuple(notes))
        for name in turned:
            one = made[name]
            made[name] = column_from(
                name, one.source, _negative(name, one.unit), one.times, one.plus
            )
        done |= set(turned)
        notes.append(f"{' and '.join(turned)} had the opposite sign, which was corrected")


def _named(text: str, columns: Mapping[str, Column]) -> list[str]:
    """Return the channels of which an error says that they count the other way."""
    if "wrong sign" in text:
        subject = text.rpartition(": ")[0] if ": " not in text else text.split(": ", 1)[1]
        subject = subject.split(" has the wrong sign")[0].split(" have the wrong")[0]
        return [name for name in subject.replace(",", " ").split() if name in columns]
    sides = [side for side in ("v_left", "v_right") if f"{side} counts the other way" in text]
    if sides:
        return sides
    if "gyroscope's axis is flipped" in text:
        return ["yaw_rate"]
    return ["yaw"] if "yaw counts clockwise" in text else []


def _negative(channel: str, unit: str) -> str:
    return unit[1:] if unit.startswith("-") else f"-{unit or next(iter(UNITS[channel]))}"
