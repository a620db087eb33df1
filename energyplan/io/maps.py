"""Maps: ROS map_server YAML with its image, MovingAI, and heights of the ground."""

from __future__ import annotations

import io
import re
import struct
import warnings
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import shapely
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from energyplan.errors import DriveLogError, MapError
from energyplan.io.bags import is_bag, opened_bag
from energyplan.io.documents import MAP, Checked, beside, load, read_bytes
from energyplan.io.files import atomic_write, is_file
from energyplan.io.geojson import read_obstacles
from energyplan.kinds import NO_NUMBER, checked, warn
from energyplan.path import Pose, as_pose
from energyplan.terrain import CostMap, SpeedLimit
from energyplan.terrain.grid import MAX_CELLS, OccupancyGrid, from_raster
from energyplan.terrain.heights import HeightMap

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

MOVINGAI_FREE = b".GS"
"""Characters of passable cells in a MovingAI map: ground, ground too, swamp."""

Origin = Annotated[Pose, AfterValidator(lambda at: as_pose([*at], "the origin"))]

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


def _fit(file: Path, rows: float, columns: float) -> None:
    """Refuse a raster of too many cells."""
    if rows * columns > (most := _most_cells.get()):
        raise MapError(
            f"{file}: {rows:g} rows of {columns:g} cells; at most {most} cells are read: crop or "
            "coarsen it"
        )


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


class _MapHeader(Checked, BaseModel):
    """What a map_server YAML says."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0)
    origin: Origin
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
        document.data.update(occupied_thresh=1.0, free_thresh=0.0)
    if kind is _SpeedMaskHeader and "type" not in document.data:
        raise document.fail(
            ("type",),
            "is missing; write what Nav2's costmap_filter_info_server has: type 1 for percent of "
            "the top speed or 2 for m/s, base and multiplier",
        )
    return document.check(kind)


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
    >>> from energyplan.io.files import bundled
    >>> read_map(bundled("office.yaml")).resolution
    0.05
    """
    file = Path(path)
    if file.suffix == ".map":
        return _read_movingai(file)
    if file.suffix == ".geojson":
        drawn = read_obstacles(file)
        _fit(file, *drawn.shape)
        return drawn
    if file.is_dir():
        raise MapError(f"{str(file)!r} is a folder; give the map's .yaml in it")
    if file.suffix not in {".yaml", ".yml"}:
        raise MapError(
            f"{file}: unknown kind of map {file.suffix!r}; give a map_server .yaml, a MovingAI "
            ".map or a .geojson"
        )
    header = _header(file, _MapHeader)
    values = _values(file, header)
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


def read_keepout(path: str | Path) -> OccupancyGrid:
    """Read a keep-out mask: a map whose occupied cells are closed; its weights close nothing."""
    mask, file = read_map(path), Path(path)
    if file.suffix in {".yaml", ".yml"}:
        values = _values(file, _header(file, _MapHeader))
        share = float(np.mean((values > 0) & (values < LETHAL)))
        if share > 0.0:
            warn(
                f"{file.name}: {share:.1%} of the mask has weights between free and closed, which "
                "are ignored; give it as a costmap of the site, too, for them to count"
            )
    return mask


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
def _opened(file: Path, formats: tuple[str, ...], otherwise: str) -> Iterator[Image.Image]:
    """Open an image whose size is sane; what goes wrong inside it becomes a named error."""
    content = read_bytes(file, MAX_FILE)
    try:
        # the size stands in the header: nothing is decompressed before it is known to be sane
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(io.BytesIO(content), formats=formats) as image,
        ):
            _fit(file, image.height, image.width)
            yield image
    except MapError:
        raise
    except UnidentifiedImageError:
        raise MapError(f"{file}: {otherwise}") from None
    except _BROKEN as error:
        raise MapError(f"{file}: a broken image: {error}") from None


def _pixels(file: Path) -> _Pixels:
    """Return the pixels of an image of any depth, with colours, a palette or alpha."""
    with _opened(file, ("PPM", "PNG", "BMP"), "not a PGM, PNG or BMP image") as image:
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
    _fit(file, size["height"], size["width"])
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


FINEST = 1e-3
"""Size of the finest cells [m]; smaller ones count in degrees."""

LAYERS = ("elevation_inpainted", "elevation_smooth", "elevation", "height")
"""Layers of a grid_map that hold heights, the first without holes is taken."""

# tags of TIFF, keys of GeoTIFF and their values
_SCALE, _TIE_POINT, _TRANSFORM, _GEO_KEYS, _GDAL_NO_DATA = 33550, 33922, 34264, 34735, 42113
_GDAL_METADATA = 42112
_ITEM = re.compile(r'<Item\b(?=[^>]*\brole="(scale|offset|unittype)")[^>]*>([^<]*)<')
_HEIGHTS = {
    **dict.fromkeys(("", "m", "metre", "meter", "metres", "meters"), 1.0), "dm": 0.1, "cm": 0.01,
    "mm": 0.001, "km": 1000.0, **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot"), 1200 / 3937),
}  # fmt: skip
"""Metres of the units in which heights are said to be, in GDAL's metadata."""
_MODEL, _RASTER, _LINEAR_UNITS, _VERTICAL_UNITS = 1024, 1025, 3076, 4099
_GEOGRAPHIC, _POINT, _METRE, _BY_USER = 2, 2, 9001, 32767
_GRID_MAP = "grid_map_msgs/msg/GridMap"
_DEFINITIONS = {
    "grid_map_msgs/msg/GridMapInfo": (
        "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
    ),
    _GRID_MAP: (
        "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\nstring[] layers\n"
        "string[] basic_layers\nstd_msgs/Float32MultiArray[] data\n"
        "uint16 outer_start_index\nuint16 inner_start_index\n"
    ),
}

_KEYS = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize")
_NO_DATA = "nodata_value"


@checked(MapError)
def read_heights(path: str | Path) -> HeightMap:
    """Read heights of the ground, in metres in the map's frame.

    Parameters
    ----------
    path : str or Path
        An ESRI ASCII grid (``.asc``): ``ncols``, ``nrows``, ``xllcorner`` and ``yllcorner`` (or
        ``xllcenter`` and ``yllcenter``), ``cellsize``, optionally ``NODATA_value``, then the rows
        from the top. A GeoTIFF (``.tif``) of one band in a projection with metres. A YAML file
        that names a 16 bit PNG: ``image``, ``resolution``, ``origin`` as in a map of map_server,
        ``min_height`` and ``max_height`` of the least and the greatest value of a pixel. A bag
        with a grid_map_msgs/GridMap, of which the last message counts. A value stands for the
        centre of its cell.

    Returns
    -------
    HeightMap
        The heights.

    Raises
    ------
    MapError
        If the file is missing, malformed or too large, has cells without data, or counts in
        degrees; the message names the place.

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
    kind = file.suffix.lower()
    if is_bag(file):
        raster = _from_grid_map(file)
    elif kind in (".tif", ".tiff"):
        raster = _from_geotiff(file)
    elif kind in (".yaml", ".yml"):
        raster = _from_image(file)
    elif kind == ".png":
        raise MapError(
            f"{file}: an image does not say where it lies; give a YAML file with "
            f"{', '.join(_Image.model_fields)}"
        )
    else:
        raster = _from_ascii(file)
    lost = np.argwhere(~np.isfinite(raster.heights))
    if len(lost):
        row, column = lost[0]
        raise MapError(
            f"{file}: {len(lost)} cells without data, the first in row {row + 1}, column "
            f"{column + 1} from the top; fill them or crop the grid"
        )
    if 0.0 < raster.resolution < FINEST:
        raise MapError(
            f"{file}: cells of {raster.resolution:.3g}; these are degrees of longitude and "
            "latitude: reproject the heights to metres"
        )
    try:
        return HeightMap(raster.heights[::-1], raster.resolution, raster.lowest)
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


class _Raster(NamedTuple):
    """Heights from the top row on; NaN where there are none."""

    heights: NDArray[np.float64]
    resolution: float
    lowest: Pose  # of the first value of the last row


def _from_ascii(file: Path) -> _Raster:
    """Read an ESRI ASCII grid."""
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
    if any(n != round(n) or n < 2 for n in shape):
        raise MapError(f"{file}: {shape[0]:g} rows of {shape[1]:g}; give whole numbers from 2")
    _fit(file, *shape)
    values = _cells_of(file, lines, row, int(shape[0]), int(shape[1]))
    if _NO_DATA in header:
        values = np.where(values == header[_NO_DATA], np.nan, values)
    size = header["cellsize"]
    shift = 0.5 * size if where == "corner" else 0.0
    lowest = Pose(header[f"xll{where}"] + shift, header[f"yll{where}"] + shift, 0.0)
    return _Raster(values, size, lowest)


def _cells_of(
    file: Path, lines: list[bytes], first: int, rows: int, columns: int
) -> NDArray[np.float64]:
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


class _Image(Checked, BaseModel):
    """What the YAML of an image of heights says."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    image: str = Field(min_length=1)
    resolution: float = Field(gt=0)
    origin: Origin
    min_height: float
    max_height: float


def _from_image(file: Path) -> _Raster:
    """Read a 16 bit PNG by the YAML that names it."""
    told = load(file, MapError).check(_Image)
    values, _ = _decoded(beside(file, "image", told.image), "PNG")
    if values.dtype == np.uint8:
        step = (told.max_height - told.min_height) / 255
        raise MapError(
            f"{file}: image: 8 bits a pixel make steps of {step:.2g} m, which are no slopes; "
            "export 16 bits"
        )
    heights = (
        told.min_height + (told.max_height - told.min_height) * values.astype(np.float64) / 65535
    )
    x, y = from_raster((0.5, 0.5), told.origin, told.resolution).tolist()
    return _Raster(heights, told.resolution, Pose(x, y, told.origin.yaw))


def _decoded(file: Path, form: str) -> tuple[NDArray[np.generic], Mapping[int, Any]]:
    """Return the values of an image of one band, and its tags."""
    remedy = "give one band of 16 or 32 bits (gdal_translate -ot Float32 writes one)"
    with _opened(file, (form,), f"no {form} that can be read; {remedy}") as image:
        if image.mode != "F" and not image.mode.startswith("I") and image.mode != "L":
            raise MapError(f"{file}: pixels of the kind {image.mode}; give one band of heights")
        return np.asarray(image), dict(getattr(image, "tag_v2", {}))


def _from_geotiff(file: Path) -> _Raster:
    """Read a GeoTIFF (OGC 19-008r4) of one band in metres."""
    values, tags = _decoded(file, "TIFF")
    heights = values.astype(np.float64)
    try:
        keys = np.array(tags.get(_GEO_KEYS, (1, 1, 0, 0)), int).reshape(-1, 4)[1:]
        known = {int(key): int(value) for key, place, _, value in keys if place == 0}
        no_data = float(str(tags.get(_GDAL_NO_DATA, "nan")).strip("\0 "))
        matrix = np.array(tags.get(_TRANSFORM, ()), float)
        if len(matrix) == 0:
            dx, dy, _ = tags[_SCALE]
            i, j, _, x, y, _ = tags[_TIE_POINT][:6]
            matrix = np.array([dx, 0, 0, x - i * dx, 0, -dy, 0, y + j * dy])
        (along_x, down_x, _, left), (along_y, down_y, _, top) = matrix[:8].reshape(2, 4)
    except KeyError:
        raise MapError(f"{file}: it does not say where it lies; give a GeoTIFF") from None
    except NO_NUMBER as error:
        raise MapError(f"{file}: malformed GeoTIFF tags: {error}") from None
    if known.get(_MODEL) == _GEOGRAPHIC:
        raise MapError(
            f"{file}: heights over degrees of longitude and latitude; reproject them to metres, as "
            "with gdalwarp -t_srs EPSG:..."
        )
    for key in (_LINEAR_UNITS, _VERTICAL_UNITS):
        if known.get(key, _METRE) not in (_METRE, _BY_USER):
            raise MapError(f"{file}: the unit {known[key]} of EPSG; convert it to metres (9001)")
    size = float(np.hypot(along_x, along_y))
    if max(abs(down_x - along_y), abs(down_y + along_x)) > 1e-6 * size:
        raise MapError(f"{file}: cells of {along_x:g} by {-down_y:g}; resample to square ones")
    heights[heights == no_data] = np.nan
    told = dict(_ITEM.findall(str(tags.get(_GDAL_METADATA, ""))))
    unit = told.get("unittype", "").strip().lower()
    try:
        heights = heights * float(told.get("scale", 1.0)) + float(told.get("offset", 0.0))
        heights *= _HEIGHTS[unit]
    except (KeyError, ValueError):
        raise MapError(f"{file}: heights of {told}; convert them to metres") from None
    offset = 0.0 if known.get(_RASTER) == _POINT else 0.5
    last = heights.shape[0] - 1 + offset
    lowest = Pose(
        float(left + offset * along_x + last * down_x),
        float(top + offset * along_y + last * down_y),
        float(np.arctan2(along_y, along_x)),
    )
    return _Raster(heights, size, lowest)


def _from_grid_map(file: Path) -> _Raster:
    """Read the last grid_map of a bag."""
    message = None
    try:
        with opened_bag(file, _DEFINITIONS) as reader:
            for connection in reader.connections:
                if connection.msgtype != _GRID_MAP or message is not None:
                    continue
                for _, _, raw in deque(reader.messages(connections=[connection]), 1):
                    message = reader.deserialize(raw, _GRID_MAP)
    except DriveLogError as error:
        raise MapError(str(error)) from None
    if message is None:
        raise MapError(f"{file}: the bag has no {_GRID_MAP}; record the topic of the elevation map")
    layers = dict(zip(message.layers, message.data, strict=False))
    names = [name for name in LAYERS if name in layers]
    if not names:
        raise MapError(f"{file}: no layer {' or '.join(LAYERS)}, but {', '.join(layers)}")
    rasters = [_of_layer(file, message, layers[name]) for name in names]
    whole = [raster for raster in rasters if np.all(np.isfinite(raster.heights))]
    return (whole or rasters)[0]


def _of_layer(file: Path, message: Any, layer: Any) -> _Raster:
    """Return a layer of a grid_map, whose rows go against x and whose columns go against y."""
    info = message.info
    size = [dim.size for dim in layer.layout.dim]
    if len(size) != 2 or size[0] * size[1] != len(layer.data) or min(size) < 2:
        raise MapError(f"{file}: a layer of {size} values in which {len(layer.data)} stand")
    cells = np.asarray(layer.data, np.float64).reshape(size)
    if layer.layout.dim[0].label != "row_index":
        cells = cells.T
    # the buffer is a ring
    cells = np.roll(cells, (-message.outer_start_index, -message.inner_start_index), (0, 1))
    turn, at = info.pose.orientation, info.pose.position
    yaw = 2.0 * float(np.arctan2(turn.z, turn.w))
    reach = 0.5 * info.resolution * (1.0 - np.array(cells.shape))
    x, y = from_raster(reach, Pose(at.x, at.y, yaw), 1.0)
    return _Raster(cells[::-1].T, float(info.resolution), Pose(float(x), float(y), yaw))
