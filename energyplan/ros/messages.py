"""Maps, poses, footprints and paths from message-like objects and back; recordings of plans."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from energyplan.errors import FrameError, InvalidInputError, MessageError, needs_extra
from energyplan.io.files import atomic_write
from energyplan.path import FloatArray, Path, Pose
from energyplan.records import NO_NUMBER
from energyplan.terrain import CostMap, OccupancyGrid, SpeedLimit
from energyplan.vehicle import Vehicle

Factory = Callable[[str], Callable[..., Any]]
"""Gives the class of a message by its name, such as ``"nav_msgs/msg/Path"``."""

OCCUPIED_OF_MAP = 65
"""Occupancy from which on a cell of nav_msgs/OccupancyGrid is occupied: map_server's 0.65 [%]."""

KEEPOUT = 100
"""Value from which on a cell of a keep-out mask is closed."""

LETHAL, NO_INFORMATION = 254, 255
"""Costs of nav2_msgs/Costmap: an obstacle in the cell; nothing known of it."""

_NORM = 1e-2  # how far a quaternion's squared length may be from 1
_TILT = 1e-3  # cosine lost by a map's tilt: 2.6 deg


def field(message: Any, name: str) -> Any:
    """Return a field of a message by its dotted name."""
    value = message
    for part in name.split("."):
        if not hasattr(value, part):
            raise MessageError(
                f"{type(message).__name__} has no field {name!r}; give a message of the kind "
                "that the function names"
            )
        value = getattr(value, part)
    return value


def _numbers(message: Any, *names: str) -> FloatArray:
    """Return finite numbers of a message by the names of their fields."""
    raw = [field(message, name) for name in names]
    try:
        values = np.array([float(value) for value in raw])
    except NO_NUMBER:
        raise MessageError(f"{', '.join(names)} are {raw}; give numbers") from None
    if not np.all(np.isfinite(values)):
        raise MessageError(f"{', '.join(names)} are {values.tolist()}; give finite numbers")
    return values


def _rotation(message: Any, name: str) -> FloatArray:
    """Return a unit quaternion x, y, z, w."""
    quaternion = _numbers(message, *(f"{name}.{part}" for part in "xyzw"))
    square = float(quaternion @ quaternion)
    if abs(square - 1.0) > _NORM:
        raise MessageError(
            f"the quaternion {name} is {quaternion.tolist()}, of length {np.sqrt(square):.3g}; "
            "give one of length 1 (no turn is x = y = z = 0, w = 1)"
        )
    return np.asarray(quaternion / np.sqrt(square))


def _yaw(quaternion: FloatArray) -> float:
    x, y, z, w = quaternion
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def check_frame(message: Any, frame: str | None, what: str) -> None:
    """Check that a message with a header is in a frame; None for any."""
    if frame is None:
        return
    name = str(field(message, "header.frame_id"))
    if name.lstrip("/") != frame.lstrip("/"):
        raise FrameError(f"the {what} is in the frame {name!r}, expected {frame!r}; transform it")


def pose_from_message(message: Any, frame: str | None = None) -> Pose:
    """Return the planar pose of a geometry_msgs Pose or PoseStamped, without its tilt."""
    stamped = hasattr(message, "pose")
    if stamped:
        check_frame(message, frame, "pose")
    body = message.pose if stamped else message
    x, y = _numbers(body, "position.x", "position.y")
    return Pose(float(x), float(y), _yaw(_rotation(body, "orientation")))


def pose_from_transform(message: Any) -> Pose:
    """Return a geometry_msgs Transform or TransformStamped as the child's pose in the parent."""
    body = message.transform if hasattr(message, "transform") else message
    x, y = _numbers(body, "translation.x", "translation.y")
    return Pose(float(x), float(y), _yaw(_rotation(body, "rotation")))


def grid_from_message(
    message: Any, *, occupied_from: int | None = None, unknown_is_free: bool = False
) -> OccupancyGrid:
    """Return the map of a nav_msgs/OccupancyGrid or nav2_msgs/Costmap."""
    cells = _cells(message, occupied_from)
    return OccupancyGrid(
        cells.occupied, *_placed(message), unknown=cells.unknown, unknown_is_free=unknown_is_free
    )


def updated_grid(
    grid: OccupancyGrid, message: Any, *, occupied_from: int | None = None, frame: str | None = None
) -> OccupancyGrid:
    """Return a map with the patch of a map_msgs/OccupancyGridUpdate; `frame` is the map's."""
    if field(message, "header.frame_id"):  # where none is named, the map's
        check_frame(message, frame, "patch of the map")
    cells = _cells(message, occupied_from)
    column, row = _numbers(message, "x", "y")
    return grid.updated(cells.occupied, int(row), int(column), cells.unknown)


def note_of_keepout(message: Any) -> str:
    """Say of how many cells of a keep-out mask the value closes nothing; empty for none."""
    cells = _cells(message, KEEPOUT)
    grey, unknown = int(((cells.values > 0) & (cells.values < KEEPOUT)).sum()), cells.unknown.sum()
    several = [f"{grey} cells from 1 to {KEEPOUT - 1}"] * bool(grey)
    several += [f"{unknown} unknown cells"] * bool(unknown)
    if not several:
        return ""
    return f"{' and '.join(several)} are open; give {KEEPOUT} where the robot must not go"


def speed_limit_from_message(message: Any, area: BaseGeometry) -> SpeedLimit | None:
    """Return the limit of a nav2_msgs/SpeedLimit in an area; None where it lifts the limit."""
    (speed,) = _numbers(message, "speed_limit")
    if speed == 0.0:
        return None
    share = bool(field(message, "percentage"))
    return SpeedLimit(area, float(speed) / (100 if share else 1), share)


def costs_from_message(message: Any) -> CostMap:
    """Return the soft costs of a nav2_msgs/Costmap, or of a costmap as nav_msgs/OccupancyGrid."""
    cells = _cells(message, None)
    most = LETHAL if hasattr(message, "metadata") else 100
    costs = np.where(cells.unknown, 0.0, cells.values / most)
    return CostMap(costs, *_placed(message))


class _Occupancy(NamedTuple):
    """Cells of a message, shape (rows, columns)."""

    values: NDArray[np.int_]
    occupied: NDArray[np.bool_]
    unknown: NDArray[np.bool_]


def _cells(message: Any, occupied_from: int | None) -> _Occupancy:
    costs = hasattr(message, "metadata")
    # an update says itself how large it is
    info = message if hasattr(message, "width") else field(message, "metadata" if costs else "info")
    width, height = _numbers(info, *(("size_x", "size_y") if costs else ("width", "height")))
    lowest, unknown_value, highest = (0, NO_INFORMATION, 255) if costs else (-1, -1, 100)
    least = occupied_from
    if least is None:
        least = LETHAL if costs else OCCUPIED_OF_MAP
    top = LETHAL if costs else highest
    if not 1 <= least <= top:
        raise InvalidInputError(f"occupied_from is {least}; give a value from 1 to {top}")
    try:
        data = np.asarray(field(message, "data"))
    except NO_NUMBER as error:
        raise MessageError(f"data is no row of numbers: {error}") from None
    if data.ndim != 1 or (data.size and data.dtype.kind not in "iu"):
        raise MessageError(
            f"data has shape {data.shape} and type {data.dtype}; give one row of whole numbers"
        )
    if min(width, height) < 1 or data.size != width * height:
        raise MessageError(
            f"the map is {width:g} by {height:g} cells, but data has {data.size}; give width times "
            "height, row by row from the origin"
        )
    wrong = np.flatnonzero((data < lowest) | (data > highest))
    if len(wrong):
        k = int(wrong[0])
        raise MessageError(
            f"data[{k}] is {int(data[k])}; give {lowest} to {highest}, {unknown_value} for unknown"
        )
    cells = data.reshape(int(height), int(width))
    unknown = cells == unknown_value
    return _Occupancy(cells.astype(int), (cells >= least) & ~unknown, unknown)


def _placed(message: Any) -> tuple[float, Pose]:
    """Return the resolution and the origin of a message's cells."""
    info = field(message, "metadata" if hasattr(message, "metadata") else "info")
    (resolution,) = _numbers(info, "resolution")
    quaternion = _rotation(info, "origin.orientation")
    if 2.0 * (quaternion[0] ** 2 + quaternion[1] ** 2) > _TILT:
        raise MessageError("the map's origin is tilted; give one that turns about z alone")
    x, y = _numbers(info, "origin.position.x", "origin.position.y")
    return float(resolution), Pose(float(x), float(y), _yaw(quaternion))


def footprint_from_message(message: Any, vehicle: Vehicle, frame: str | None = None) -> Vehicle:
    """Return a vehicle with the footprint of a geometry_msgs Polygon or PolygonStamped.

    A vehicle's footprint is a rectangle along its axes, so it gets the smallest one that holds
    the polygon: plans keep clear of more ground than the polygon covers, never of less.
    """
    if hasattr(message, "polygon"):
        check_frame(message, frame, "footprint")
        message = message.polygon
    points = field(message, "points")
    if len(points) < 3:
        raise MessageError(f"the footprint has {len(points)} corners; give three or more")
    corners = np.array([_numbers(point, "x", "y") for point in points])
    return replace(vehicle, footprint=np.stack([corners.min(axis=0), corners.max(axis=0)]))


def _pose_message(factory: Factory, pose: Iterable[float]) -> Any:
    x, y, yaw = (float(value) for value in pose)
    z, w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
    return factory("geometry_msgs/msg/Pose")(
        position=factory("geometry_msgs/msg/Point")(x=x, y=y, z=0.0),
        orientation=factory("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=z, w=w),
    )


def path_to_message(
    paths: Path | Sequence[Path],
    frame: str,
    stamp: Any,
    factory: Factory,
    max_ds: float = 0.05,
    max_dtheta: float = 0.1,
) -> Any:
    """Return a nav_msgs/Path along a path, or along several that follow each other.

    Every pose has the robot's heading as its orientation, also where it drives backwards or turns
    on the spot.
    """
    legs = [paths] if isinstance(paths, Path) else list(paths)
    rows = [leg.poses(max_ds, max_dtheta)[min(k, 1) :] for k, leg in enumerate(legs)]
    header = factory("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)
    stamped = factory("geometry_msgs/msg/PoseStamped")
    poses = [
        stamped(header=header, pose=_pose_message(factory, row)) for leg in rows for row in leg
    ]
    return factory("nav_msgs/msg/Path")(header=header, poses=poses)


FRAME = "map"
"""Frame of all messages."""


def write_recording(
    paths: Mapping[str, Path], file: str | File, grid: OccupancyGrid | None = None
) -> None:
    """Write paths, and the map that they lie on, as messages of ROS 2 in an MCAP file.

    Each path is a nav_msgs/Path on the topic of its name, the map a nav_msgs/OccupancyGrid on
    ``/map``. All have the time 0, so the same plan makes the same file.
    """
    with needs_extra("bags", f"writing {file}"):
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    make = store.types.__getitem__
    stamp = make("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    messages: dict[str, Any] = {} if grid is None else {"/map": _grid_message(grid, stamp, make)}
    messages |= {name: path_to_message(path, FRAME, stamp, make) for name, path in paths.items()}
    with tempfile.TemporaryDirectory() as folder:
        bag = File(folder) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for name, message in messages.items():
                kind = message.__msgtype__
                topic = writer.add_connection(name, kind, typestore=store)
                writer.write(topic, 0, store.serialize_cdr(message, kind))
        (made,) = bag.glob("*.mcap")
        atomic_write(file, made.read_bytes())


def _grid_message(grid: OccupancyGrid, stamp: Any, make: Any) -> Any:
    rows, columns = grid.occupied.shape
    cells = np.where(grid.occupied, 100, 0)
    if grid.unknown is not None:
        cells = np.where(grid.unknown & ~grid.occupied, -1, cells)
    return make("nav_msgs/msg/OccupancyGrid")(
        header=make("std_msgs/msg/Header")(stamp=stamp, frame_id=FRAME),
        info=make("nav_msgs/msg/MapMetaData")(
            map_load_time=stamp, resolution=grid.resolution, width=columns, height=rows,
            origin=_pose_message(make, grid.origin),
        ),
        data=cells.astype(np.int8).ravel(),
    )  # fmt: skip
