"""A plan as a recording that viewers of ROS bags open: MCAP with nav_msgs messages."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path as File
from typing import Any

import numpy as np

from energyplan.errors import MissingDependencyError
from energyplan.io.files import atomic_write
from energyplan.path import Path
from energyplan.ros.messages import path_to_message
from energyplan.terrain import OccupancyGrid

FRAME = "map"
"""Frame of all messages."""


def need_rosbags() -> None:
    """Check that recordings can be written."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "writing .mcap needs rosbags; install it with pip install 'energyplan[bags]'"
        ) from error


def write_recording(
    paths: Mapping[str, Path], file: str | File, grid: OccupancyGrid | None = None
) -> None:
    """Write paths, and the map that they lie on, as messages of ROS 2 in an MCAP file.

    Each path is a nav_msgs/Path on the topic of its name, the map a nav_msgs/OccupancyGrid on
    ``/map``. All have the time 0, so the same plan makes the same file.
    """
    need_rosbags()
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
    x, y, yaw = (float(value) for value in grid.origin)
    origin = make("geometry_msgs/msg/Pose")(
        position=make("geometry_msgs/msg/Point")(x=x, y=y, z=0.0),
        orientation=make("geometry_msgs/msg/Quaternion")(
            x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        ),
    )
    cells = np.where(grid.occupied, 100, 0)
    if grid.unknown is not None:
        cells = np.where(grid.unknown & ~grid.occupied, -1, cells)
    return make("nav_msgs/msg/OccupancyGrid")(
        header=make("std_msgs/msg/Header")(stamp=stamp, frame_id=FRAME),
        info=make("nav_msgs/msg/MapMetaData")(
            map_load_time=stamp, resolution=grid.resolution, width=columns, height=rows,
            origin=origin,
        ),
        data=cells.astype(np.int8).ravel(),
    )  # fmt: skip
