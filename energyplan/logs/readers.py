"""Logs of formats that other packages read, by the entry point `energyplan.logs`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from energyplan.errors import DriveLogError, EnergyPlanError
from energyplan.logs.mapping import Column
from energyplan.logs.tables import Recording, read_table

GROUP = "energyplan.logs"

Reader = Callable[[Path], Recording | None]
"""From a file to what it holds; None where the file is of another kind."""


def read_recorded(path: str | Path, clock: Column | None = None) -> Recording:
    """Read what a file holds: by a reader of another package that knows it, else as a table."""
    file, there = Path(path), False
    with suppress(OSError, ValueError):  # a name that no file can have
        there = file.exists()
    if there:  # what is missing, or several files, is a matter of the reader of tables
        for name, reader in _readers(entry_points, tuple(sys.path)):
            if (found := _read_by(name, reader, file)) is not None:
                return found
    return read_table(path, DriveLogError, clock)


@lru_cache(maxsize=8)
def _readers(
    finder: Callable[..., Iterable[EntryPoint]], path: tuple[str, ...]
) -> tuple[tuple[str, Reader], ...]:
    """Look readers up once for each search path: metadata of every package are read for it."""
    return tuple(
        (point.name, point.load())
        for point in sorted(finder(group=GROUP), key=lambda point: point.name)
    )


def _read_by(name: str, reader: Reader, file: Path) -> Recording | None:
    whose = f"{file.name}: the reader {name!r} of the entry point {GROUP}"
    try:
        found = reader(file)
    except EnergyPlanError:
        raise
    except Exception as error:
        raise DriveLogError(
            f"{whose} failed: {type(error).__name__}: {error}; mend it, or uninstall its package"
        ) from error
    if not (found is None or isinstance(found, Recording)):
        raise DriveLogError(
            f"{whose} returned a {type(found).__name__}; it must return an "
            "energyplan.logs.tables.Recording, or None for a file of another kind"
        )
    return found
