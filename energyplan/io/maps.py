"""Maps and masks: ROS map_server YAML with its image, MovingAI and GeoJSON."""

from __future__ import annotations

import io
import math
import struct
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import shapely
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from energyplan.errors import MapError
from energyplan.io.documents import (
    MAP,
    Checked,
    beside,
    load,
    read_bytes,
    unused,
    warn_of_unused,
)
from energyplan.io.files import atomic_write, is_file, is_folder
from energyplan.io.geojson import read_obstacles
from energyplan.path import Pose, as_pose
from energyplan.records import checked, warn
from energyplan.terrain import CostMap, SpeedLimit
from energyplan.terrain.grid import MAX_CELLS, OccupancyGrid, from_raster

MAX_FILE = 2**28
"""Largest map image that is read [bytes]."""

ALIKE = 0.75
"""How alike two keys are, from 0 to 1, of which one is taken for the other, misspelt."""

ROUNDING = 1e-9
"""By how much the occupancy of a pixel may miss a threshold that it equals."""

_most_cells: ContextVar[int] = ContextVar("most_cells", default=MAX_CELLS)
_BAND = 256  # rows of an image whose colours are weighed at a time

LETHAL = 100
"""Value of an occupied cell of nav_msgs/OccupancyGrid."""

LUMA = (0.212656, 0.715158, 0.072186)
"""Weights of red, green and blue in the brightness of a pixel (ITU-R BT.709)."""

WIDE = 2e4
"""Size of a map beyond which its resolution is doubted [m]."""

IMAGES = (".png", ".pgm", ".bmp")
"""Endings of the images that a map may be."""

MOVINGAI_FREE = b".GS"
"""Characters of passable cells in a MovingAI map: ground, ground too, swamp."""

_BROKEN = (
    OSError, SyntaxError, ValueError, EOFError, OverflowError, TypeError, KeyError, IndexError,
    struct.error, MemoryError, Image.DecompressionBombError,
)  # fmt: skip


@contextmanager
def at_most(cells: int) -> Iterator[None]:
    """Refuse maps and heights of more cells inside, as a service does."""
    token = _most_cells.set(min(cells, MAX_CELLS))
    try:
        yield
    finally:
        _most_cells.reset(token)


def fit(file: Path, rows: float, columns: float) -> None:
    """Refuse a raster of too many cells."""
    if rows * columns > (most := _most_cells.get()):
        raise MapError(
            f"{file}: {rows:g} rows of {columns:g} cells; at most {most} cells are read: crop or "
            "coarsen it"
        )


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


class Placed(Checked, BaseModel):
    """An image, and where it lies."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0)
    origin: Annotated[Pose, AfterValidator(lambda at: as_pose([*at], "the origin"))]


class _MapHeader(Placed):
    """What a map_server YAML says."""

    negate: int | bool = False
    occupied_thresh: float = Field(ge=0, le=1)
    free_thresh: float = Field(ge=0, le=1)
    mode: Annotated[Literal["trinary", "scale", "raw"], BeforeValidator(_lower)] = "trinary"

    @model_validator(mode="after")
    def _ordered(self) -> _MapHeader:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh; swap or correct them")
        return self


class _SpeedMaskHeader(_MapHeader):
    """The YAML of a speed mask: that of a map, with what Nav2's costmap filter info says of it."""

    type: Literal[1, 2]  # percent of the top speed, or m/s
    base: float = 0.0
    multiplier: float = 1.0


_IDLE = frozenset({
    "name", "description", "author", "date", "frame_id", "header",  # say nothing of cells
    "type", "base", "multiplier",  # of Nav2's filters, and read where a map is a mask of speeds
})  # fmt: skip
"""Keys of a map that change no answer."""

Header = TypeVar("Header", bound=_MapHeader)


def _header(file: Path, kind: type[Header], *, costs: bool = False) -> Header:
    """Read the YAML of a map; other files, and keys that are misspelt, are refused by name."""
    document = load(file, MapError)
    if document.kind not in (None, MAP) and "image" not in document.data:
        raise MapError(
            f"{file.name} seems to be {document.kind}, not a map of map_server; give the YAML file "
            "with the map's image, resolution and origin"
        )
    keys = list(kind.model_fields)
    for key in document.data:
        near = get_close_matches(str(key).lower(), keys, 1, ALIKE)
        if near and near[0] not in document.data:
            raise document.fail((key,), f"there is no such key; write it {near[0]}")
    if costs and _lower(document.data.get("mode")) == "raw":
        whole = {**document.data, "occupied_thresh": 1.0, "free_thresh": 0.0}
        document = replace(document, data=whole)
    if kind is _SpeedMaskHeader and "type" not in document.data:
        raise document.fail(
            ("type",),
            "is missing; write what Nav2's costmap_filter_info_server has: type 1 for percent of "
            "the top speed or 2 for m/s, base and multiplier",
        )
    warn_of_unused(file.name, unused(document.data, keys, _IDLE))
    return document.check(kind)


@checked(MapError)
def read_map(
    path: str | Path, *, unknown_is_free: bool = False, resolution: float | None = None
) -> OccupancyGrid:
    """Read a map: map_server YAML (``.yaml``, ``.yml``), an image, MovingAI or GeoJSON.

    Parameters
    ----------
    path : str or Path
        The file. The image that a YAML names must lie in its folder or below. GeoJSON
        (``.geojson``) holds obstacles, see `read_obstacles`, and is read in cells of 5 cm. Of an
        image alone (``.png``, ``.pgm``, ``.bmp``), dark pixels are obstacles and bright ones are
        free; its lower left corner is the origin.
    unknown_is_free : bool
        Whether the robot may enter cells of which the map knows nothing.
    resolution : float, optional
        Size of a pixel of an image alone, which does not know it [m].

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
    >>> from energyplan.io.files import bundled
    >>> read_map(bundled("office.yaml")).resolution
    0.05
    """
    file = Path(path)
    if file.suffix.lower() in IMAGES:
        header = _header_of_image(file, resolution)
        return _grid(file, header, _values(file, header), unknown_is_free)
    if resolution is not None:
        raise MapError(f"{file} has a resolution of its own; give one with an image alone")
    if file.suffix == ".map":
        return _read_movingai(file)
    if file.suffix == ".geojson":
        drawn = read_obstacles(file)
        fit(file, *drawn.shape)
        return drawn
    if is_folder(file):
        raise MapError(f"{str(file)!r} is a folder; give the map's .yaml in it")
    if file.suffix not in {".yaml", ".yml"}:
        raise MapError(
            f"{file}: unknown kind of map {file.suffix!r}; give a map_server .yaml, an image with "
            "its resolution, a MovingAI .map or a .geojson"
        )
    header = _header(file, _MapHeader)
    return _grid(file, header, _values(file, header), unknown_is_free)


def _header_of_image(file: Path, resolution: float | None) -> _MapHeader:
    """Return what the YAML of an image says that has none."""
    if resolution is None:
        beside = [one for end in (".yaml", ".yml") if is_file(one := file.with_suffix(end))]
        raise MapError(
            f"{file} is an image without its resolution; give {beside[0]}, which names it"
            if beside
            else f"{file} is an image without its resolution; give the size of a pixel in m, as in "
            f"--resolution 0.05, or write its YAML: energyplan start {quote(str(file))} "
            f"--resolution 0.05 --out {quote(file.with_suffix('.yaml').name)}"
        )
    if not (math.isfinite(resolution) and resolution > 0):
        raise MapError(f"the resolution of {file} is {resolution:g} m; give a positive size")
    return _MapHeader(**_common_header(file, resolution, (0.0, 0.0, 0.0)))


def _common_header(image: Path, resolution: float, origin: Iterable[float]) -> dict[str, Any]:
    """Return the YAML of an image whose dark pixels are obstacles."""
    return {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(resolution),
        "origin": [float(v) for v in origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def write_map_of_image(image: str | Path, resolution: float, path: str | Path) -> OccupancyGrid:
    """Write the map_server YAML of an image that has none, beside it, and return the map."""
    picture, file = Path(image), Path(path)
    if file.resolve().parent != picture.resolve().parent:
        raise MapError(f"{file}: write the YAML of {picture.name} in its folder, {picture.parent}")
    grid = read_map(picture, resolution=resolution)
    _write_header(file, _common_header(picture, resolution, grid.origin))
    return grid


def _write_header(file: Path, header: dict[str, Any]) -> None:
    atomic_write(file, yaml.safe_dump(header, sort_keys=False, default_flow_style=None))


def _grid(
    file: Path, header: _MapHeader, values: NDArray[np.int8], unknown_is_free: bool
) -> OccupancyGrid:
    """Return the map that values of cells are."""
    rows, columns = values.shape
    if max(rows, columns) * header.resolution > WIDE:
        warn(
            f"{file}: the map is {columns * header.resolution / 1e3:.3g} x "
            f"{rows * header.resolution / 1e3:.3g} km; check that its resolution, "
            f"{header.resolution:g}, is in m"
        )
    # between free and occupied nothing is certain
    free = values <= LETHAL * header.free_thresh if header.mode == "raw" else values == 0
    try:
        return OccupancyGrid(
            # images start with the top row, maps with the bottom one
            occupied=values[::-1] == LETHAL,
            resolution=header.resolution,
            origin=header.origin,
            unknown=((values < 0) | ~(free | (values == LETHAL)))[::-1],
            unknown_is_free=unknown_is_free,
        )
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


class KeepOut(NamedTuple):
    """A mask of Nav2's keep-out filter."""

    closed: OccupancyGrid  # the robot stays out of its occupied cells
    weights: CostMap | None  # soft costs of the cells between free and closed, if there are any


def read_keepout(path: str | Path) -> KeepOut:
    """Read a keep-out mask: a map whose occupied cells are closed, with weights of the others."""
    mask, file = read_map(path), Path(path)
    weights = None
    if file.suffix in {".yaml", ".yml"}:
        values = _values(file, _header(file, _MapHeader))[::-1]
        if np.any((values > 0) & (values < LETHAL)):
            weights = CostMap(np.maximum(values, 0) / LETHAL, mask.resolution, mask.origin)
    return KeepOut(mask, weights)


@checked(MapError)
def read_costmap(path: str | Path) -> CostMap:
    """Read the soft costs of a map_server YAML with an image of costs."""
    file = Path(path)
    header = _header(file, _MapHeader, costs=True)
    if header.mode == "raw":
        grey = _pixels(_image(file, header.image)).grey
        most = LETHAL if not np.any((grey > LETHAL) & (grey < 255)) else 254
        costs = np.where(grey < 255, grey / most, 0.0)
    else:
        costs = np.maximum(_values(file, header), 0) / LETHAL
    try:
        return CostMap(costs[::-1], header.resolution, header.origin)
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


@checked(MapError)
def read_speed_mask(path: str | Path) -> tuple[SpeedLimit, ...]:
    """Read a mask of Nav2's speed filter: a map_server YAML with `type`, `base` and `multiplier`.

    A cell of value 1 to 100 limits the speed to ``base + multiplier * value``: percent of the
    robot's top speed where `type` is 1, m/s where it is 2. As in Nav2, the value 0 and results
    outside the range (0, 100] %, or not above 0 m/s, are no limit. Unknown cells are none either.

    References
    ----------
    Nav2, nav2_costmap_2d/plugins/costmap_filters/speed_filter.cpp.
    """
    file = Path(path)
    header = _header(file, _SpeedMaskHeader)
    values = _values(file, header)[::-1]
    limits = []
    for value in np.unique(values[values > 0]):
        limit = header.base + header.multiplier * float(value)
        if limit <= 0 or (header.type == 1 and limit > 100):
            continue
        row, first = np.nonzero(np.diff(values == value, axis=1, prepend=False) & (values == value))
        _, last = np.nonzero(np.diff(values == value, axis=1, append=False) & (values == value))
        boxes = shapely.box(first, row, last + 1, row + 1)
        area = shapely.transform(
            shapely.union_all(boxes),
            lambda at: from_raster(at, header.origin, header.resolution),
        )
        relative = header.type == 1
        limits.append(SpeedLimit(area, limit / 100 if relative else limit, relative))
    return tuple(limits)


def _values(file: Path, header: _MapHeader) -> NDArray[np.int8]:
    """Return the cells that Nav2's map_server makes of an image: 0 to 100, and -1 for unknown."""
    image = _pixels(_image(file, header.image))
    level = np.arange(256)
    if header.mode == "raw":
        # the pixel is the value; neither negate nor a threshold has a say
        return np.where(level <= LETHAL, level, -1).astype(np.int8)[image.grey]
    occupancy = level / 255 if header.negate else 1.0 - level / 255
    low, high = header.free_thresh, header.occupied_thresh
    between = np.full(256, -1.0)
    if header.mode == "scale" and high > low:
        between = np.round(LETHAL * (occupancy - low) / (high - low))
    values = np.select(
        [occupancy >= high - ROUNDING, occupancy <= low + ROUNDING], [LETHAL, 0.0], between
    )
    # of coloured pixels some releases take the mean and some the luma: the more occupied one counts
    shade = (np.maximum if header.negate else np.minimum)(image.grey, image.luma)
    return np.where(image.opaque, values.astype(np.int8)[shade], np.int8(-1))


def _image(file: Path, name: str) -> Path:
    """Return the image that a map names."""
    image = beside(file, "image", name)
    if not is_file(image):
        raise MapError(f"{file}: image: there is no {name!r} beside the map; copy it there")
    return image


class _Pixels(NamedTuple):
    """An image, top row first, in steps of 8 bits."""

    grey: NDArray[np.uint8]  # mean of the colours
    luma: NDArray[np.uint8]  # their brightness to the eye
    opaque: NDArray[np.bool_]


@contextmanager
def opened_image(file: Path, formats: tuple[str, ...], otherwise: str) -> Iterator[Image.Image]:
    """Open an image whose size is sane; what goes wrong inside it becomes a named error."""
    content = read_bytes(file, MAX_FILE)
    try:
        # the size stands in the header: nothing is decompressed before it is known to be sane
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(io.BytesIO(content), formats=formats) as image,
        ):
            fit(file, image.height, image.width)
            yield image
    except MapError:
        raise
    except UnidentifiedImageError:
        raise MapError(f"{file}: {otherwise}") from None
    except _BROKEN as error:
        raise MapError(f"{file}: a broken image: {error}") from None


def _pixels(file: Path) -> _Pixels:
    """Return the pixels of an image of any depth, with colours, a palette or alpha."""
    with opened_image(file, ("PPM", "PNG", "BMP"), "not a PGM, PNG or BMP image") as image:
        clear = image.info.get("transparency")
        if image.mode == "F":
            raise MapError(f"{file}: pixels of floating point; save it in 8 or 16 bits")
        if image.mode in {"1", "L"} and clear is None:
            grey = np.asarray(image.convert("L"))
            return _Pixels(grey, grey, np.broadcast_to(np.True_, grey.shape))
        deep = image.mode.startswith("I")  # sixteen bits
        pixels = np.asarray(image if deep else image.convert("RGBA"))
        opaque = pixels != clear if deep else pixels[..., 3] == 255
        grey, luma = np.empty((2, *opaque.shape), np.uint8)
        for top in range(0, len(pixels), _BAND):  # a number of floating point has eight bytes
            band = slice(top, top + _BAND)
            if deep:
                grey[band] = luma[band] = np.round(pixels[band] / 257)
            else:
                colours = pixels[band, :, :3].astype(np.float64)
                grey[band], luma[band] = np.round(colours.mean(axis=2)), np.round(colours @ LUMA)
        return _Pixels(grey, luma, opaque)


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
    fit(file, size["height"], size["width"])
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
    """Write a map as map_server YAML with a PNG of the same name in its folder."""
    file = Path(path)
    if is_folder(file):
        raise MapError(f"{str(file)!r} is a folder; give the map's .yaml in it")
    if file.suffix not in {".yaml", ".yml"}:
        raise MapError(f"{file}: name the map something.yaml; its image stands beside it")
    pixels = np.where(grid.occupied, 0, 254).astype(np.uint8)
    if grid.unknown is not None:
        pixels[grid.unknown & ~grid.occupied] = 205
    image = io.BytesIO()
    Image.fromarray(pixels[::-1]).save(image, format="PNG", optimize=True)
    header = _common_header(file.with_suffix(".png"), grid.resolution, grid.origin)
    atomic_write(file.with_suffix(".png"), image.getvalue())
    _write_header(file, header)
