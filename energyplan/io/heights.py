"""Heights of the ground: ESRI ASCII grids, GeoTIFF, images of 16 bits, and grid_map in bags."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import DriveLogError, MapError
from energyplan.io import geotiff
from energyplan.io.bags import is_bag, opened_bag
from energyplan.io.documents import beside, load, read_bytes
from energyplan.io.maps import MAX_FILE, Placed, fit, opened_image
from energyplan.path import Pose
from energyplan.records import NO_NUMBER, checked
from energyplan.terrain.grid import from_raster
from energyplan.terrain.heights import HeightMap

FINEST = 1e-3
"""Size of the finest cells [m]; smaller ones count in degrees."""

LAYERS = ("elevation_inpainted", "elevation_smooth", "elevation", "height")
"""Layers of a grid_map that hold heights, the first without holes is taken."""

LOWEST, HIGHEST = -500.0, 9000.0
"""Heights that dry ground can have [m]: from below the Dead Sea to above Mount Everest."""

# tags of TIFF, and values of keys of GeoTIFF
_SCALE, _TIE_POINT, _TRANSFORM, _GDAL_NO_DATA = 33550, 33922, 34264, 42113
_GEOGRAPHIC, _POINT = 2, 2
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
        from the top. A GeoTIFF (``.tif``) of one band in a projection, in metres or feet as
        its keys say. A YAML file
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
        If the file is missing, malformed or too large, has cells without data or heights that no
        ground has, counts in degrees, or does not say its unit; the message names the place.

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
    odd = np.argwhere((raster.heights < LOWEST) | (raster.heights > HIGHEST))
    if len(odd):
        row, column = odd[0]
        raise MapError(
            f"{file}: {len(odd)} cells of heights that no ground has, the first of "
            f"{raster.heights[row, column]:g} m in row {row + 1}, column {column + 1} from the "
            "top; cells without data want the tag NODATA (gdal_edit.py -a_nodata VALUE), then fill "
            "them or crop the grid; heights in another unit want it written"
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
    fit(file, *shape)
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


class _Image(Placed):
    """What the YAML of an image of heights says."""

    min_height: float
    max_height: float


def _from_image(file: Path) -> _Raster:
    """Read a 16 bit PNG by the YAML that names it."""
    header = load(file, MapError).check(_Image)
    values, _ = _decoded(beside(file, "image", header.image), "PNG")
    if values.dtype == np.uint8:
        step = (header.max_height - header.min_height) / 255
        raise MapError(
            f"{file}: image: 8 bits a pixel make steps of {step:.2g} m, which are no slopes; "
            "export 16 bits"
        )
    heights = (
        header.min_height
        + (header.max_height - header.min_height) * values.astype(np.float64) / 65535
    )
    x, y = from_raster((0.5, 0.5), header.origin, header.resolution).tolist()
    return _Raster(heights, header.resolution, Pose(x, y, header.origin.yaw))


def _decoded(file: Path, form: str) -> tuple[NDArray[np.generic], Mapping[int, Any]]:
    """Return the values of an image of one band, and its tags."""
    remedy = "give one band of 16 or 32 bits (gdal_translate -ot Float32 writes one)"
    with opened_image(file, (form,), f"no {form} that can be read; {remedy}") as image:
        if image.mode != "F" and not image.mode.startswith("I") and image.mode != "L":
            raise MapError(f"{file}: pixels of the kind {image.mode}; give one band of heights")
        return np.asarray(image), dict(getattr(image, "tag_v2", {}))


def _from_geotiff(file: Path) -> _Raster:
    """Read a GeoTIFF (OGC 19-008r4) of one band in metres."""
    values, tags = _decoded(file, "TIFF")
    heights = values.astype(np.float64)
    try:
        known = geotiff.keys_of(tags)
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
    if known.get(geotiff.MODEL) == _GEOGRAPHIC:
        raise MapError(
            f"{file}: heights over degrees of longitude and latitude; reproject them to metres, as "
            "with gdalwarp -t_srs EPSG:..."
        )
    unit = geotiff.units(file, tags)
    size = float(np.hypot(along_x, along_y))
    if max(abs(down_x - along_y), abs(down_y + along_x)) > 1e-6 * size:
        raise MapError(f"{file}: cells of {along_x:g} by {-down_y:g}; resample to square ones")
    heights[heights == no_data] = np.nan
    heights = (heights * unit.scale + unit.offset) * unit.up
    offset = 0.0 if known.get(geotiff.RASTER) == _POINT else 0.5
    last = heights.shape[0] - 1 + offset
    lowest = Pose(
        unit.across * float(left + offset * along_x + last * down_x),
        unit.across * float(top + offset * along_y + last * down_y),
        float(np.arctan2(along_y, along_x)),
    )
    return _Raster(heights, unit.across * size, lowest)


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
