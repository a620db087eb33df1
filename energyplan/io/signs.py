"""Reading a table whose power, yaw or one side's speed counts the other way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from energyplan.logs import DriveLog, UnfitLogError
from energyplan.logs.checks import mirrored_side
from energyplan.logs.mapping import Column


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
        except UnfitLogError as problem:
            turned = tuple(name for name in problem.check.turned if name in made)
            if not turned or done & set(turned):
                raise
        else:
            side = mirrored_side(log.channels, log.runs)
            if not side or side in done:
                return Signed(log, made, tuple(notes))
            turned = (side,)
        made |= {name: made[name].negative() for name in turned}
        done |= set(turned)
        notes.append(f"{' and '.join(turned)} had the opposite sign, which was corrected")
