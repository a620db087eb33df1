"""Maps, poses, footprints and paths from message-like objects and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import FrameError, InvalidInputError, MessageError
from energyplan.path import FloatArray, Path, Pose
from energyplan.terrain import CostMap, OccupancyGrid
from energyplan.vehicle import Vehicle

Factory = Callable[[str], Callable[..., Any]]
"""Gives the class of a message by its name, such as ``"nav_msgs/msg/Path"``."""

OCCUPIED_OF_MAP = 65
"""Occupancy from which on a cell of nav_msgs/OccupancyGrid is occupied: map_server's 0.65 [%]."""

LETHAL, NO_INFORMATION = 254, 255
"""Costs of nav2_msgs/Costmap: an obstacle in the cell; nothing known of it."""

_NORM = 1e-2  # how far a quaternion's squared length may be from 1
_TILT = 1e-3  # cosine lost by a map's tilt: 2.6 deg


def field(message: Any, name: str) -> Any:
    """Return a field of a message by its dotted name.

    Raises
    ------
    MessageError
        If the message has no such field.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> field(Message(header=Message(frame_id="map")), "header.frame_id")
    'map'
    """
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
    except (TypeError, ValueError):
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


def _same_frame(one: str, other: str) -> bool:
    return one.lstrip("/") == other.lstrip("/")


def pose_from_message(message: Any, frame: str | None = None) -> Pose:
    """Return the planar pose of a geometry_msgs Pose or PoseStamped; height and tilt are left out.

    Parameters
    ----------
    message : object
        The message.
    frame : str, optional
        Frame that a stamped pose must be in; any if left out.

    Returns
    -------
    Pose
        Position [m] and heading [rad].

    Raises
    ------
    FrameError
        If a stamped pose is in another frame.
    MessageError
        If a field is missing, not finite, or the quaternion is not of length 1.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> turned = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    >>> pose_from_message(Message(position=Message(x=1.0, y=2.0, z=0.0), orientation=turned))
    Pose(x=1.0, y=2.0, yaw=0.0)
    """
    stamped = hasattr(message, "pose")
    if stamped and frame is not None:
        name = str(field(message, "header.frame_id"))
        if not _same_frame(name, frame):
            raise FrameError(
                f"the pose is in the frame {name!r}, expected {frame!r}; transform it first"
            )
    body = message.pose if stamped else message
    x, y = _numbers(body, "position.x", "position.y")
    return Pose(float(x), float(y), _yaw(_rotation(body, "orientation")))


def pose_from_transform(message: Any) -> Pose:
    """Return a geometry_msgs Transform or TransformStamped as the pose of the child in the parent.

    Raises
    ------
    MessageError
        If a field is missing, not finite, or the quaternion is not of length 1.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> turned = Message(x=0.0, y=0.0, z=1.0, w=0.0)
    >>> transform = Message(translation=Message(x=2.0, y=1.0, z=0.0), rotation=turned)
    >>> [round(value, 3) for value in pose_from_transform(transform)]
    [2.0, 1.0, 3.142]
    """
    body = message.transform if hasattr(message, "transform") else message
    x, y = _numbers(body, "translation.x", "translation.y")
    return Pose(float(x), float(y), _yaw(_rotation(body, "rotation")))


def grid_from_message(
    message: Any, *, occupied_from: int | None = None, unknown_is_free: bool = False
) -> OccupancyGrid:
    """Return the map of a nav_msgs/OccupancyGrid or nav2_msgs/Costmap.

    Parameters
    ----------
    message : object
        The message. Its origin may be turned about the vertical.
    occupied_from : int, optional
        Least value that counts as occupied; lower ones are free to enter. If left out, 65 for an
        OccupancyGrid (percent) and 254, lethal, for a Costmap. A costmap that Nav2 publishes as
        an OccupancyGrid needs 100: what is below comes from inflation, and the planner tests the
        footprint itself.
    unknown_is_free : bool
        Whether the robot may enter cells of which nothing is known: -1, or 255 in a Costmap.

    Returns
    -------
    OccupancyGrid
        The map, in the frame of the message.

    Raises
    ------
    MessageError
        If a field is missing, sizes and data do not fit, a value is out of range, or the origin
        is tilted.
    MapError
        If the map has too many cells or no sensible resolution.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> origin = Message(
    ...     position=Message(x=0.0, y=0.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0)
    ... )
    >>> info = Message(resolution=0.1, width=3, height=2, origin=origin)
    >>> grid = grid_from_message(Message(info=info, data=[0, 0, 100, 0, 0, -1]))
    >>> grid.shape, int(grid.blocked.sum())  # the unknown cell is blocked too
    ((2, 3), 2)
    """
    cells = _cells(message, occupied_from)
    place = _placed(message)
    return OccupancyGrid(
        occupied=cells.occupied,
        resolution=place.resolution,
        origin=place.origin,
        unknown=cells.unknown,
        unknown_is_free=unknown_is_free,
    )


def updated_grid(
    grid: OccupancyGrid, message: Any, *, occupied_from: int | None = None
) -> OccupancyGrid:
    """Return a map with the patch of a map_msgs/OccupancyGridUpdate; see `OccupancyGrid.updated`.

    Parameters
    ----------
    grid : OccupancyGrid
        The map before.
    message : object
        The message: `x` and `y` are the column and the row of its first cell.
    occupied_from : int, optional
        As for `grid_from_message`.

    Returns
    -------
    OccupancyGrid
        The map now.

    Raises
    ------
    MessageError
        As for `grid_from_message`.
    MapError
        If the patch does not lie on the map.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> origin = Message(
    ...     position=Message(x=0.0, y=0.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0)
    ... )
    >>> info = Message(resolution=0.1, width=3, height=2, origin=origin)
    >>> grid = grid_from_message(Message(info=info, data=[0, 0, 100, 0, 0, -1]))
    >>> patch = Message(x=0, y=1, width=1, height=1, data=[100])
    >>> int(updated_grid(grid, patch).blocked.sum())
    3
    """
    cells = _cells(message, occupied_from)
    column, row = _numbers(message, "x", "y")
    return grid.updated(cells.occupied, int(row), int(column), cells.unknown)


def costs_from_message(message: Any) -> CostMap:
    """Return the soft costs of a nav2_msgs/Costmap, or of a costmap as nav_msgs/OccupancyGrid.

    Parameters
    ----------
    message : object
        The message. Costs count from 0 to 254 in a Costmap, to 100 in an OccupancyGrid; what is
        unknown costs nothing.

    Returns
    -------
    CostMap
        The costs from 0 to 1, for `PlanningProblem`.

    Raises
    ------
    MessageError
        As for `grid_from_message`.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> origin = Message(
    ...     position=Message(x=0.0, y=0.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0)
    ... )
    >>> info = Message(resolution=0.1, width=3, height=2, origin=origin)
    >>> costs = costs_from_message(Message(info=info, data=[0, 50, 100, 0, 0, -1]))
    >>> costs.at([0.15, 0.05]).item()
    0.5
    """
    cells, place = _cells(message, None), _placed(message)
    most = LETHAL if hasattr(message, "metadata") else 100
    costs = np.where(cells.unknown, 0.0, cells.values / most)
    return CostMap(costs, place.resolution, place.origin)


class _Cells(NamedTuple):
    """Cells of a message, shape (rows, columns)."""

    values: NDArray[np.int_]
    occupied: NDArray[np.bool_]
    unknown: NDArray[np.bool_]


class _Place(NamedTuple):
    """Where the cells of a message lie."""

    resolution: float
    origin: Pose


def _cells(message: Any, occupied_from: int | None) -> _Cells:
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
    except ValueError as error:
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
    return _Cells(cells.astype(int), (cells >= least) & ~unknown, unknown)


def _placed(message: Any) -> _Place:
    info = field(message, "metadata" if hasattr(message, "metadata") else "info")
    (resolution,) = _numbers(info, "resolution")
    quaternion = _rotation(info, "origin.orientation")
    if 2.0 * (quaternion[0] ** 2 + quaternion[1] ** 2) > _TILT:
        raise MessageError("the map's origin is tilted; give one that turns about z alone")
    x, y = _numbers(info, "origin.position.x", "origin.position.y")
    return _Place(float(resolution), Pose(float(x), float(y), _yaw(quaternion)))


def footprint_from_message(message: Any, vehicle: Vehicle, frame: str | None = None) -> Vehicle:
    """Return a vehicle with the footprint of a geometry_msgs Polygon or PolygonStamped.

    A vehicle's footprint is a rectangle along its axes, so it gets the smallest one that holds
    the polygon: plans keep clear of more ground than the polygon covers, never of less.

    Parameters
    ----------
    message : object
        The corners in the body frame [m].
    vehicle : Vehicle
        The vehicle.
    frame : str, optional
        The body frame's name. Nav2's ``published_footprint`` is in the map's frame and is refused
        if this is given.

    Returns
    -------
    Vehicle
        The vehicle with that footprint.

    Raises
    ------
    FrameError
        If a stamped polygon is in another frame.
    MessageError
        If there are fewer than three corners, or one is not finite.
    VehicleError
        If the polygon has no area.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> corners = [(0.5, 0.3), (0.5, -0.3), (-0.5, -0.3), (-0.5, 0.3)]
    >>> polygon = Message(points=[Message(x=x, y=y, z=0.0) for x, y in corners])
    >>> from energyplan.vehicle import Vehicle
    >>> footprint_from_message(polygon, Vehicle.preset("quadriga")).footprint.tolist()
    [[-0.5, -0.3], [0.5, 0.3]]
    """
    if hasattr(message, "polygon"):
        name = str(field(message, "header.frame_id"))
        if frame is not None and not _same_frame(name, frame):
            raise FrameError(
                f"the footprint is in the frame {name!r}, expected {frame!r}; give it in the "
                "robot's own frame"
            )
        message = message.polygon
    points = field(message, "points")
    if len(points) < 3:
        raise MessageError(f"the footprint has {len(points)} corners; give three or more")
    corners = np.array([_numbers(point, "x", "y") for point in points])
    return replace(vehicle, footprint=np.stack([corners.min(axis=0), corners.max(axis=0)]))


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

    Parameters
    ----------
    paths : Path or sequence of Path
        What to drive; ``plan.path`` of a plan. None at all makes a message without poses.
    frame : str
        Frame of the map.
    stamp : object
        A builtin_interfaces/Time.
    factory : callable
        Gives a message's class by its name: ``rosidl_runtime_py.utilities.get_message`` under ROS,
        ``typestore.types.__getitem__`` with rosbags.
    max_ds, max_dtheta : float
        Largest step between two poses [m], [rad].

    Returns
    -------
    object
        The message.

    Examples
    --------
    >>> from rosbags.typesys import Stores, get_typestore
    >>> factory = get_typestore(Stores.ROS2_HUMBLE).types.__getitem__
    >>> stamp = factory("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    >>> path = Path(Pose(1, 2, 0), ds=[1.0], dtheta=[0.0])
    >>> message = path_to_message(path, "map", stamp, factory)
    >>> message.header.frame_id, message.poses[-1].pose.position.x
    ('map', 2.0)
    """
    legs = [paths] if isinstance(paths, Path) else list(paths)
    rows = [leg.poses(max_ds, max_dtheta)[min(k, 1) :] for k, leg in enumerate(legs)]
    header = factory("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)
    point, quaternion = factory("geometry_msgs/msg/Point"), factory("geometry_msgs/msg/Quaternion")
    pose, stamped = factory("geometry_msgs/msg/Pose"), factory("geometry_msgs/msg/PoseStamped")
    poses = [
        stamped(
            header=header,
            pose=pose(
                position=point(x=x, y=y, z=0.0),
                orientation=quaternion(
                    x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
                ),
            ),
        )
        for x, y, yaw in (row for leg in rows for row in leg.tolist())
    ]
    return factory("nav_msgs/msg/Path")(header=header, poses=poses)
