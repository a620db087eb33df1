"""Read and write maps: ROS map_server YAML with its image, and MovingAI benchmark maps."""

from __future__ import annotations

import io
import math
import warnings
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from energyplan.errors import MapError
from energyplan.io.documents import MAP, Checked, beside, load, read_bytes
from energyplan.io.files import atomic_write
from energyplan.io.geojson import read_obstacles
from energyplan.kinds import checked
from energyplan.path import Pose
from energyplan.terrain import CostMap
from energyplan.terrain.grid import MAX_CELLS, OccupancyGrid

MAX_FILE = 2**28
"""Largest map image that is read [bytes]."""

ALIKE = 0.75
"""How alike two keys are, from 0 to 1, of which one is taken for the other, misspelt."""

ROUNDING = 1e-9
"""By how much the occupancy of a pixel may miss a threshold that it equals."""

LETHAL = 100
"""Value of an occupied cell of nav_msgs/OccupancyGrid."""

LUMA = (0.212656, 0.715158, 0.072186)
"""Weights of red, green and blue in the brightness of a pixel (ITU-R BT.709)."""

MOVINGAI_FREE = b".GS"
"""Characters of passable cells in a MovingAI map: ground, ground too, swamp."""


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


class _MapHeader(Checked, BaseModel):
    """What a map_server YAML says."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0)
    origin: tuple[float, float, float]
    negate: int | bool = False
    occupied_thresh: float = Field(ge=0, le=1)
    free_thresh: float = Field(ge=0, le=1)
    mode: Annotated[Literal["trinary", "scale", "raw"], BeforeValidator(_lower)] = "trinary"

    @model_validator(mode="after")
    def _ordered(self) -> _MapHeader:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh; swap or correct them")
        return self


def _header(file: Path, *, costs: bool = False) -> _MapHeader:
    """Read the YAML of a map; other files, and keys that are misspelt, are refused by name.

    Raw costs need no thresholds.
    """
    document = load(file, MapError)
    kind = document.kind
    if kind not in (None, MAP) and "image" not in document.data:
        raise MapError(
            f"{file.name} seems to be {kind}, not a map of map_server; give the YAML file "
            "with the map's image, resolution and origin"
        )
    keys = list(_MapHeader.model_fields)
    for key in document.data:
        near = get_close_matches(str(key).lower(), keys, 1, ALIKE)
        if near and near[0] not in document.data:
            raise document.fail((key,), f"there is no such key; write it {near[0]}")
    if costs and _lower(document.data.get("mode")) == "raw":
        document.data.update(occupied_thresh=1.0, free_thresh=0.0)
    return document.check(_MapHeader)


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
        The map, by the rules of Nav2's map_server. Cells that the modes ``scale`` and ``raw`` put
        between free and occupied, values of 1 to 99, count as unknown.

    Raises
    ------
    MapError
        If a file is missing, malformed, too large, or outside the folder; the message names the
        file, the place and the remedy.

    References
    ----------
    Nav2, nav2_map_server/src/map_io.cpp; Sturtevant (2012), Benchmarks for grid-based pathfinding.

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
    header = _header(file)
    values = _values(file, header)
    # between free and occupied nothing is certain
    free = values <= LETHAL * header.free_thresh if header.mode == "raw" else values == 0
    try:
        return OccupancyGrid(
            # images start with the top row, maps with the bottom one
            occupied=values[::-1] == LETHAL,
            resolution=header.resolution,
            origin=Pose(*header.origin),
            unknown=((values < 0) | ~(free | (values == LETHAL)))[::-1],
            unknown_is_free=unknown_is_free,
        )
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


@checked(MapError)
def read_costmap(path: str | Path) -> CostMap:
    """Read the soft costs of a map_server YAML with an image of costs."""
    file = Path(path)
    header = _header(file, costs=True)
    if header.mode == "raw":
        grey = _pixels(_image(file, header.image)).grey
        most = LETHAL if not np.any((grey > LETHAL) & (grey < 255)) else 254
        costs = np.where(grey < 255, grey / most, 0.0)
    else:
        costs = np.maximum(_values(file, header), 0) / LETHAL
    try:
        return CostMap(costs[::-1], header.resolution, Pose(*header.origin))
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


def _values(file: Path, header: _MapHeader) -> NDArray[np.int16]:
    """Return the cells that Nav2's map_server makes of an image: 0 to 100, and -1 for unknown."""
    image = _pixels(_image(file, header.image))
    if header.mode == "raw":
        # the pixel is the value; neither negate nor a threshold has a say
        return np.where(image.grey <= LETHAL, image.grey, -1).astype(np.int16)
    # of coloured pixels some releases take the mean and some the luma: the more occupied one counts
    shades = np.stack([image.grey, image.luma]) / 255
    occupancy = (shades if header.negate else 1.0 - shades).max(axis=0)
    low, high = header.free_thresh, header.occupied_thresh
    between = np.full(occupancy.shape, -1.0)
    if header.mode == "scale" and high > low:
        between = np.round(LETHAL * (occupancy - low) / (high - low))
    values = np.select(
        [occupancy >= high - ROUNDING, occupancy <= low + ROUNDING], [LETHAL, 0.0], between
    )
    return np.where(image.opaque, values, -1).astype(np.int16)


def _image(file: Path, name: str) -> Path:
    """Return the image that a map names."""
    image = beside(file, "image", name)
    if not image.exists():
        raise MapError(f"{file}: image: there is no {name!r} beside the map; copy it there")
    return image


class _Pixels(NamedTuple):
    """An image, top row first, in steps of 8 bits."""

    grey: NDArray[np.float64]  # mean of the colours, 0 to 255
    luma: NDArray[np.float64]  # their brightness to the eye, 0 to 255
    opaque: NDArray[np.bool_]


def _pixels(file: Path) -> _Pixels:
    """Return the pixels of an image of any depth, with colours, a palette or alpha."""
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
            clear = image.info.get("transparency")
            if image.mode.startswith("I") or image.mode == "F":
                deep = np.asarray(image, np.float64)  # sixteen bits
                grey = np.round(deep / 257)
                return _Pixels(
                    grey, grey, np.full(grey.shape, True) if clear is None else deep != clear
                )
            if image.mode in {"1", "L"} and clear is None:
                grey = np.asarray(image.convert("L"), np.float64)
                return _Pixels(grey, grey, np.full(grey.shape, True))
            rgba = np.asarray(image.convert("RGBA"), np.float64)
            colours = rgba[..., :3]
            return _Pixels(
                np.round(colours.mean(axis=2)), np.round(colours @ LUMA), rgba[..., 3] == 255
            )
    except UnidentifiedImageError:
        raise MapError(f"{file}: not a PGM, PNG or BMP image") from None
    except (OSError, SyntaxError, ValueError, EOFError, OverflowError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(f"{file}: a broken image: {error}") from None
    except Image.DecompressionBombError as error:
        raise MapError(f"{file}: {error}") from None


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
