"""The data folder of a service: maps, models, missions and logs by name, nothing outside it."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from energyplan.errors import InvalidInputError
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.files import atomic_write
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.maps import read_map

T = TypeVar("T")

KINDS = {
    "maps": (".yaml", ".yml", ".map"),
    "models": (".yaml", ".yml"),
    "missions": (".yaml", ".yml"),
    "logs": (".csv", ".csv.gz", ".parquet", ".mcap", ".bag", ".db3"),
    "surfaces": (".geojson", ".json"),
    "heights": (".asc",),
}
"""What a data folder holds, and how the names end."""

_NAME = re.compile(r"[\w][\w .+-]*(/[\w][\w .+-]*)*")
_KEPT = 32


class UnknownFileError(InvalidInputError):
    """The data folder has no such file."""


class Store:
    """Files of a folder by name; what was read is kept until the file changes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        if not self.folder.is_dir():
            raise InvalidInputError(f"the data folder {folder} is no folder; create it first")
        self._kept: dict[tuple[str, Path], tuple[tuple[int, int], Any]] = {}
        self._lock = threading.Lock()

    def names(self, kind: str) -> list[str]:
        """Return the names of all files of a kind.

        Maps, models, vehicles and missions are all YAML: one is told from the other by its keys.
        """
        found = []
        for file in sorted(self.folder.rglob("*")):
            name = file.relative_to(self.folder).as_posix()
            if file.is_file() and name.endswith(KINDS[kind]) and _NAME.fullmatch(name):
                if file.suffix in (".yaml", ".yml") and _kind_of(file) != kind:
                    continue
                found.append(name)
        return found

    def path(self, name: str) -> Path:
        """Return the file of a name."""
        file = self._inside(name)
        if not file.is_file():
            raise UnknownFileError(f"the data folder has no file {name!r}")
        return file

    def _inside(self, name: str) -> Path:
        if not _NAME.fullmatch(name):
            raise UnknownFileError(f"{name!r} is no name of a file in the data folder")
        file = (self.folder / name).resolve()
        if not file.is_relative_to(self.folder):
            raise UnknownFileError(f"{name!r} lies outside the data folder")
        return file

    def map(self, name: str) -> Any:
        """Return a map; the same object, with its tables, as long as the file is the same."""
        return self._read("maps", name, read_map)

    def surfaces(self, name: str) -> Any:
        """Return surfaces."""
        return self._read("surfaces", name, read_surfaces)

    def heights(self, name: str) -> Any:
        """Return heights."""
        return self._read("heights", name, read_heights)

    def model(self, name: str) -> Any:
        """Return a power model: a file of the folder, or a preset."""
        return self._or_preset("models", name, read_model)

    def vehicle(self, name: str) -> Any:
        """Return a vehicle: a file of the folder, or a preset."""
        return self._or_preset("vehicles", name, read_vehicle)

    def _or_preset(self, kind: str, name: str, read: Callable[[Path | str], T]) -> T:
        """Return what a file of the folder holds, or a preset."""
        if name.endswith(KINDS["models"]):
            return self._read(kind, name, read)
        return read(_preset(name))

    def save(self, name: str, content: bytes) -> Path:
        """Write a new file, whole or not at all."""
        file = self._inside(name)
        if file.exists():
            raise InvalidInputError(f"the data folder has a file {name!r}; choose another name")
        file.parent.mkdir(parents=True, exist_ok=True)
        return atomic_write(file, content)

    def _read(self, kind: str, name: str, read: Callable[[Path], T]) -> T:
        file = self.path(name)
        stat = file.stat()
        stamp = stat.st_mtime_ns, stat.st_size
        with self._lock:
            known = self._kept.get((kind, file))
            if known is not None and known[0] == stamp:
                found: T = known[1]
                return found
        made = read(file)
        with self._lock:
            while len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[kind, file] = stamp, made
        return made


def _preset(name: str) -> str:
    """Return a preset's name; a path is none, for it could lie outside the folder."""
    if not re.fullmatch(r"[\w:-]+", name):
        raise UnknownFileError(f"{name!r} is neither a preset nor a file of the data folder")
    return name


def _kind_of(file: Path) -> str:
    """Return which kind of YAML file this is, by its keys."""
    with file.open("rb") as stream:
        text = stream.read(65536).decode("utf-8", "replace")
    keys = set(re.findall(r"^(\w+)\s*:", text, re.MULTILINE))
    if {"image", "resolution"} <= keys:
        return "maps"
    if "tasks" in keys:
        return "missions"
    return "models"
