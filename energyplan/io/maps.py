"""Read and write maps: ROS map_server YAML with its image, and MovingAI benchmark maps."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import BaseModel, ConfigDict, Field, model_validator

from energyplan.errors import MapError
from energyplan.io.documents import Checked, beside, load, read_bytes
from energyplan.io.files import atomic_write
from energyplan.io.geojson import read_obstacles
from energyplan.kinds import checked
from energyplan.path import Pose
from energyplan.terrain import CostMap
from energyplan.terrain.grid import MAX_CELLS, OccupancyGrid

MAX_FILE = 2**28
"""Largest map image that is read [bytes]."""

MOVINGAI_FREE = b".GS"
"""Characters of passable cells in a MovingAI map: ground, ground too, swamp."""


class _MapHeader(Checked, BaseModel):
    """What a map_server YAML says."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0)
    origin: tuple[float, float, float]
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: bool = False
    occupied_thresh: float = Field(default=0.65, ge=0, le=1)
    free_thresh: float = Field(default=0.25, ge=0, le=1)

    @model_validator(mode="after")
    def _ordered(self) -> _MapHeader:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh; swap or correct them")
        return self


@checked(MapError)
def read_map(path: str | Path, *, unknown_is_free: bool = False) -> OccupancyGrid:
    """Read a map: map_server YAML (``.yaml``, ``.yml``), MovingAI (``.map``) or GeoJSON.

    Parameters
    ----------
    path : str or Path
        The file. The image that a YAML names must lie in its folder or below. GeoJSON
        (``.geojson``) holds obstacles, see `read_obstacles`, and is read in cells of 5 cm.
    unknown_is_free : bool
        Whether the robot may enter cells of which the map knows nothing.

    Returns
    -------
    OccupancyGrid
        The map. Cells that the modes ``scale`` and ``raw`` put between free and occupied count
        as unknown.

    Raises
    ------
    MapError
        If a file is missing, malformed, too large, or outside the folder; the message names the
        file, the place and the remedy.

    References
    ----------
    ROS wiki, map_server, "Map format" and "Value interpretation"; Sturtevant (2012), Benchmarks
    for grid-based pathfinding.

    Examples
    --------
    >>> from energyplan.io.bundled import bundled
    >>> read_map(bundled("office.yaml")).resolution
    0.05
    """
    file = Path(path)
    if file.suffix == ".map":
        return _read_movingai(file)
    if file.suffix == ".geojson":
        return read_obstacles(file)
    if file.is_dir():
        raise MapError(f"{str(file)!r} is a folder; give the map's .yaml in it")
    if file.suffix not in {".yaml", ".yml"}:
        raise MapError(
            f"{file}: unknown kind of map {file.suffix!r}; give a map_server .yaml, a MovingAI "
            ".map or a .geojson"
        )
    header = load(file, MapError).check(_MapHeader)
    values, alpha = _pixels(_image(file, header.image))
    occupied, free = _interpret(values, alpha, header)
    try:
        return OccupancyGrid(
            # images start with the top row, maps with the bottom one
            occupied=occupied[::-1],
            resolution=header.resolution,
            origin=Pose(*header.origin),
            unknown=~(occupied | free)[::-1],
            unknown_is_free=unknown_is_free,
        )
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


@checked(MapError)
def read_costmap(path: str | Path) -> CostMap:
    """Read the soft costs of a map_server YAML with an image of costs."""
    file = Path(path)
    header = load(file, MapError).check(_MapHeader)
    shade, alpha = _pixels(_image(file, header.image))
    if header.mode == "raw":
        value = np.round(shade * 255)
        known = value < 255
        most = 100.0 if not np.any(value[known] > 100) else 254.0
        costs = np.where(known, value / most, 0.0)
    elif header.mode == "trinary":
        costs = _interpret(shade, alpha, header)[0].astype(float)
    else:
        darkness = shade if header.negate else 1 - shade
        span = max(header.occupied_thresh - header.free_thresh, 1e-9)
        costs = np.clip((darkness - header.free_thresh) / span, 0.0, 1.0)
        if alpha is not None:
            costs = np.where(alpha == 255, costs, 0.0)
    try:
        return CostMap(costs[::-1], header.resolution, Pose(*header.origin))
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


def _image(file: Path, name: str) -> Path:
    """Return the image that a map names."""
    image = beside(file, "image", name)
    if not image.exists():
        raise MapError(f"{file}: image: there is no {name!r} beside the map; copy it there")
    return image


def _pixels(file: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    """Return an image's grey values in [0, 1] and its alpha channel, if it has one.

    With an alpha channel the colours alone are averaged; what alpha means is up to the mode.
    """
    content = read_bytes(file, MAX_FILE)
    try:
        # the size stands in the header: nothing is decompressed before it is known to be sane
        with (
            warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(io.BytesIO(content), formats=("PPM", "PNG", "BMP")) as image,
        ):
            width, height = image.size
            if width * height > MAX_CELLS:
                raise MapError(
                    f"{file}: {width} x {height} pixels; at most {MAX_CELLS} are taken: crop or "
                    "coarsen the map"
                )
            alpha = None
            if image.mode in {"LA", "RGBA", "PA"} or "transparency" in image.info:
                rgba = np.asarray(image.convert("RGBA"))
                return rgba[..., :3].mean(axis=2) / 255, rgba[..., 3]
            if image.mode.startswith("I") or image.mode == "F":
                # sixteen bits a pixel
                return np.asarray(image, np.float64) / 65535, alpha
            if image.mode == "P" or image.mode not in {"1", "L"}:
                return np.asarray(image.convert("RGB")).mean(axis=2) / 255, alpha
            return np.asarray(image.convert("L"), np.float64) / 255, alpha
    except UnidentifiedImageError:
        raise MapError(f"{file}: not a PGM, PNG or BMP image") from None
    except (OSError, SyntaxError, ValueError, EOFError, OverflowError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(f"{file}: a broken image: {error}") from None
    except Image.DecompressionBombError as error:
        raise MapError(f"{file}: {error}") from None


def _interpret(
    shade: NDArray[np.float64], alpha: NDArray[np.uint8] | None, header: _MapHeader
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which pixels are occupied and which are free; the others are unknown."""
    if header.mode == "raw":
        # the pixel is the occupancy in percent, 101 to 255 unknown; negate has no say
        percent = np.round(shade * 255)
        known = percent <= 100
        occupied = known & (percent > 100 * header.occupied_thresh)
        return occupied, known & (percent < 100 * header.free_thresh)
    if header.mode == "trinary" and alpha is not None:
        # as map_server does: alpha counts as one more channel of brightness
        shade = (3 * shade + alpha / 255) / 4
    darkness = shade if header.negate else 1 - shade
    occupied, free = darkness > header.occupied_thresh, darkness < header.free_thresh
    if header.mode == "scale" and alpha is not None:
        opaque = alpha == 255
        return occupied & opaque, free & opaque
    return occupied, free


def _read_movingai(file: Path) -> OccupancyGrid:
    """Read a MovingAI map: cells of 1 m, lower left corner at the origin."""
    lines = read_bytes(file, MAX_FILE).splitlines()
    size: dict[str, int] = {}
    for number, line in enumerate(lines[:16], start=1):
        words = line.split()
        if words == [b"map"]:
            break
        if len(words) == 2 and words[0] in {b"height", b"width"}:
            digits = words[1]
            if not (digits.isdigit() and len(digits) < 10 and int(digits) > 0):
                raise MapError(f"{file}, line {number}: a size must be a positive whole number")
            size[words[0].decode()] = int(digits)
    else:
        raise MapError(f"{file}: no line 'map' in the first 16; is it a MovingAI map?")
    if set(size) != {"height", "width"}:
        raise MapError(f"{file}: give 'height' and 'width' before 'map'")
    if math.prod(size.values()) > MAX_CELLS:
        raise MapError(f"{file}: {size} makes more than {MAX_CELLS} cells; crop the map")
    rows = lines[number : number + size["height"]]
    if len(rows) < size["height"]:
        raise MapError(f"{file}: {len(rows)} rows where the height is {size['height']}")
    for k, row in enumerate(rows):
        if len(row) != size["width"]:
            raise MapError(
                f"{file}, line {number + 1 + k}: {len(row)} cells where the width is "
                f"{size['width']}"
            )
    cells = np.frombuffer(b"".join(rows), np.uint8).reshape(size["height"], size["width"])
    passable = np.isin(cells, np.frombuffer(MOVINGAI_FREE, np.uint8))
    return OccupancyGrid(~passable[::-1], resolution=1.0)


def write_map(grid: OccupancyGrid, path: str | Path) -> None:
    """Write a map as map_server YAML with a PNG of the same name beside it."""
    file = Path(path)
    if file.is_dir():
        raise MapError(f"{str(file)!r} is a folder; give the map's .yaml in it")
    if file.suffix not in {".yaml", ".yml"}:
        raise MapError(f"{file}: name the map something.yaml; its image stands beside it")
    pixels = np.where(grid.occupied, 0, 254).astype(np.uint8)
    if grid.unknown is not None:
        pixels[grid.unknown & ~grid.occupied] = 205
    image = io.BytesIO()
    Image.fromarray(pixels[::-1]).save(image, format="PNG", optimize=True)
    header = {
        "image": file.with_suffix(".png").name,
        "mode": "trinary",
        "resolution": float(grid.resolution),
        "origin": [float(v) for v in grid.origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    atomic_write(file.with_suffix(".png"), image.getvalue())
    atomic_write(file, yaml.safe_dump(header, sort_keys=False, default_flow_style=None))
