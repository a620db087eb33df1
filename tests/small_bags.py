"""Bags of every kind with half a second of two joints' speeds, as small as they can be."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from energyplan.io.bags import TopicMap

TOPICS = TopicMap.model_validate(
    {
        "channels": {
            "v_left": {"topic": "joint_states", "field": "velocity[left]"},
            "v_right": {"topic": "joint_states", "field": "velocity[right]"},
            "power": {"topic": "joint_states", "field": "effort[0]"},
        }
    }
)
COUNT = 50
POWER = [20.0 + k for k in range(COUNT)]
_MESSAGE = "sensor_msgs/msg/JointState"


def record(path: Path, kind: str, padding: int = 0) -> Path:
    """Write a bag.

    `kind` is ``ros1``, ``mcap``, ``sqlite``, or one of them with what it is compressed by after a
    dash: ``ros1-bz2``, ``ros1-lz4``, ``mcap-zstd``, ``mcap-lz4``, and ``sqlite-message`` or
    ``sqlite-file``. The padding is bytes of zero in the last message.
    """
    from rosbags.typesys import Stores, get_typestore

    first = kind.startswith("ros1")
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    dump = store.serialize_ros1 if first else store.serialize_cdr
    with writer(path, kind) as bag:
        topic = bag.add_connection("/joint_states", _MESSAGE, typestore=store)
        for k in range(COUNT):
            stamp = store.types["builtin_interfaces/msg/Time"](sec=5, nanosec=k * 10**7)
            more = {"seq": k} if first else {}
            message = store.types[_MESSAGE](
                header=store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **more),
                name=["left", "right"], position=np.zeros(padding // 8 if k == COUNT - 1 else 0),
                velocity=np.array([0.5, 0.4]), effort=np.array([POWER[k]]),
            )  # fmt: skip
            bag.write(topic, 5 * 10**9 + k * 10**7, dump(message, _MESSAGE))
    return path


def writer(path: Path, kind: str) -> Any:
    """Return a writer of bags of a kind; see `record`. ``sqlite-zstd`` packs each message."""
    from rosbags import rosbag1, rosbag2

    form, _, packing = kind.partition("-")
    if form == "ros1":
        first = rosbag1.Writer(path)
        if packing:
            first.set_compression(rosbag1.Writer.CompressionFormat[packing.upper()])
        return first
    plugin = rosbag2.StoragePlugin.MCAP if form == "mcap" else rosbag2.StoragePlugin.SQLITE3
    second = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if packing:
        modes = {"sqlite-message": "MESSAGE", "sqlite-zstd": "MESSAGE", "sqlite-file": "FILE"}
        mode = rosbag2.CompressionMode[modes.get(kind, "STORAGE")]
        second.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    if packing == "lz4":  # which rosbags reads and does not write
        import lz4.frame

        second.open()
        second.storage.compression, second.storage.compressor = "lz4", lz4.frame.compress
        return contextlib.closing(second)
    return second
