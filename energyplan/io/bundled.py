"""Files that come with the library: its own maps, surfaces and missions."""

from __future__ import annotations

from pathlib import Path

from energyplan.errors import UnknownNameError

_PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> dict[str, Path]:
    """Return the files that come with the library by name.

    Examples
    --------
    >>> sorted(name for name in bundle() if name.startswith("office"))
    ['office.png', 'office.yaml', 'office_surfaces.geojson']
    """
    folders = (_PACKAGE / "bundle", _PACKAGE.parent / "maps", _PACKAGE.parent / "examples")
    return {file.name: file for folder in folders if folder.is_dir() for file in folder.iterdir()}


def bundled(name: str) -> Path:
    """Return the path of a file that comes with the library.

    Parameters
    ----------
    name : str
        File name, such as ``"warehouse.yaml"``.

    Returns
    -------
    Path
        The file: in the installed package, or in ``maps/`` or ``examples/`` of a checkout.

    Raises
    ------
    UnknownNameError
        If the library has no such file.

    Examples
    --------
    >>> bundled("warehouse.yaml").suffix
    '.yaml'
    """
    files = bundle()
    if name not in files:
        raise UnknownNameError("bundled file", name, files)
    return files[name]
