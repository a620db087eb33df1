"""Read heights of the ground: ESRI ASCII grids, as geographic tools export them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from energyplan.errors import MapError
from energyplan.io.documents import read_bytes
from energyplan.kinds import checked
from energyplan.path import Pose
from energyplan.terrain.grid import MAX_CELLS
from energyplan.terrain.heights import HeightMap

MAX_FILE = 2**28
"""Largest file that is read [bytes]."""

_KEYS = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize")
_NO_DATA = "nodata_value"


@checked(MapError)
def read_heights(path: str | Path) -> HeightMap:
    """Read an ESRI ASCII grid of heights (``.asc``), in metres in the map's frame.

    Parameters
    ----------
    path : str or Path
        The file: ``ncols``, ``nrows``, ``xllcorner`` and ``yllcorner`` (or ``xllcenter`` and
        ``yllcenter``), ``cellsize``, optionally ``NODATA_value``, then the rows from the top. A
        value stands for the centre of its cell.

    Returns
    -------
    HeightMap
        The heights.

    Raises
    ------
    MapError
        If the file is missing, malformed or too large, or has cells without data; the message
        names the place.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "ramp.asc"
    ...     head = ("ncols 2", "nrows 2", "xllcorner 0", "yllcorner 0", "cellsize 1")
    ...     _ = file.write_text(chr(10).join((*head, "0 1", "0 1")))
    ...     ramp = read_heights(file)
    >>> ramp.heights.shape
    (2, 2)
    """
    file = Path(path)
    lines = read_bytes(file, MAX_FILE).splitlines()
    header: dict[str, float] = {}
    row = 0
    for row, line in enumerate(lines[:12]):
        words = line.split()
        key = words[0].decode("ascii", "replace").lower() if words else ""
        if key not in (*_KEYS, _NO_DATA):
            break
        try:
            header[key] = float(words[1])
        except (IndexError, ValueError):
            raise MapError(f"{file}, line {row + 1}: {key} needs a number") from None
    where = "corner" if "xllcorner" in header else "center"
    for key in ("ncols", "nrows", "cellsize", f"xll{where}", f"yll{where}"):
        if key not in header:
            raise MapError(f"{file}: no {key}; is it an ESRI ASCII grid?")
        if not np.isfinite(header[key]):
            raise MapError(f"{file}: {key} is {header[key]}; give a finite number")
    shape = header["nrows"], header["ncols"]
    if any(n != round(n) or n < 2 for n in shape) or shape[0] * shape[1] > MAX_CELLS:
        raise MapError(
            f"{file}: {shape[0]:g} rows of {shape[1]:g}; give whole numbers from 2, and at most "
            f"{MAX_CELLS} cells"
        )
    values = _values(file, lines, row, int(shape[0]), int(shape[1]))
    if _NO_DATA in header and np.any(values == header[_NO_DATA]):
        k = int(np.argmax(np.any(values == header[_NO_DATA], axis=1)))
        raise MapError(
            f"{file}, line {row + 1 + k}: cells without data; fill them or crop the grid"
        )
    size = header["cellsize"]
    shift = 0.5 * size if where == "corner" else 0.0
    origin = Pose(header[f"xll{where}"] + shift, header[f"yll{where}"] + shift, 0.0)
    try:
        return HeightMap(values[::-1], size, origin)
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


def _values(
    file: Path, lines: list[bytes], first: int, rows: int, columns: int
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    body = lines[first : first + rows]
    if len(body) < rows:
        raise MapError(f"{file}: {len(body)} rows of heights where nrows is {rows}")
    parsed = []
    for k, line in enumerate(body):
        try:
            parsed.append(np.array(line.split(), dtype=np.float64))
        except ValueError as error:
            raise MapError(f"{file}, line {first + 1 + k}: {error}") from None
        if len(parsed[-1]) != columns:
            raise MapError(
                f"{file}, line {first + 1 + k}: {len(parsed[-1])} heights where ncols is {columns}"
            )
    return np.array(parsed)
