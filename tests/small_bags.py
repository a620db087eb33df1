"""Bags of every kind, of messages that are told by what is not zero or empty in them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
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
JOINTS, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
BATTERY, ODOMETRY = "sensor_msgs/msg/BatteryState", "nav_msgs/msg/Odometry"


def record(path: Path, kind: str, padding: int = 0) -> Path:
    """Write half a second of two joints' speeds, as small as can be; see `writer` for the kinds.

    The padding is bytes of zero in the last message.
    """
    with Recorder(path, kind) as bag:
        for k, effort in enumerate(POWER):
            bag.write(
                "/joint_states", JOINTS, 5.0 + 0.01 * k, name=["left", "right"], effort=[effort],
                position=np.zeros(padding // 8 if k == COUNT - 1 else 0), velocity=[0.5, 0.4],
            )  # fmt: skip
    return path


class Recorder:
    """Writes a bag of a kind; types of messages that ROS does not have are defined by a text."""

    def __init__(self, path: Path, kind: str, definitions: Mapping[str, str] | None = None) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self.first = path, kind.startswith("ros1")
        self.store = get_typestore(Stores.ROS1_NOETIC if self.first else Stores.ROS2_HUMBLE)
        for name, text in (definitions or {}).items():
            self.store.register(get_types_from_msg(text, name))
        self.file, self.topics = writer(path, kind), dict[str, Any]()

    def __enter__(self) -> Recorder:
        self.bag = self.file.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.file.__exit__(*error)

    def message(self, kind: str, content: Mapping[str, Any]) -> Any:
        """Return a message; what the content leaves out is zero or empty."""
        from rosbags.interfaces import Nodetype

        _, fields = self.store.fielddefs[kind]
        assert content.keys() <= {name for name, _ in fields}, (kind, content)
        values: dict[str, Any] = {}
        for name, (node, of) in fields:
            given = content.get(name)
            if node == Nodetype.NAME:
                values[name] = self.message(of, given or {})
            elif node == Nodetype.BASE:
                values[name] = {"string": "", "bool": False}.get(of[0], 0)
                values[name] = values[name] if given is None else given
            elif of[0][0] == Nodetype.NAME:
                values[name] = [self.message(of[0][1], one) for one in given or ()]
            elif of[0][1][0] == "string":
                values[name] = list(given or ())
            else:
                values[name] = np.asarray(np.zeros(of[1]) if given is None else given, of[0][1][0])
        return self.store.types[kind](**values)

    def write(self, topic: str, kind: str, t: float, late: float = 0.0, **content: Any) -> None:
        """Write a message of a time, by its header where it has one, that arrives a little late."""
        if topic not in self.topics:
            self.topics[topic] = self.bag.add_connection(topic, kind, typestore=self.store)
        if self.store.fielddefs[kind][1][0][0] == "header":
            sec, nanosec = divmod(round(t * 1e9), 10**9)
            stamp = {"sec": sec, "nanosec": nanosec}
            content["header"] = {"stamp": stamp, "frame_id": "base"}
        dump = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        data = dump(self.message(kind, content), kind)
        self.bag.write(self.topics[topic], round((t + late) * 1e9), data)


def heading(yaw: float) -> dict[str, float]:
    """Return the quaternion of a heading."""
    return {"z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}


def writer(path: Path, kind: str) -> Any:
    """Return a writer of bags.

    `kind` is ``ros1``, ``mcap``, ``sqlite``, or one of them with what it is compressed by after a
    dash: ``ros1-bz2``, ``ros1-lz4``, ``mcap-zstd``, ``mcap-lz4``, ``sqlite-message`` or
    ``sqlite-zstd`` for each message, and ``sqlite-file``.
    """
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
