"""Files that come with the library: its own maps, surfaces and missions."""

from __future__ import annotations

from pathlib import Path

from energyplan.errors import UnknownNameError

_PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> dict[str, Path]:
    """Return the files that come with the library by name."""
    folders = (_PACKAGE / "bundle", _PACKAGE.parent / "maps", _PACKAGE.parent / "examples")
    return {file.name: file for folder in folders if folder.is_dir() for file in folder.iterdir()}


def bundled(name: str) -> Path:
    """Return the path of a file that comes with the library."""
    files = bundle()
    if name not in files:
        raise UnknownNameError("bundled file", name, files)
    return files[name]
