"""Drive logs from ROS 1 bags, ROS 2 bags and MCAP files, without a ROS installation."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from energyplan.errors import DriveLogError, EnergyPlanError, MissingDependencyError
from energyplan.io._unpack import bound_unpacking
from energyplan.io.files import is_file
from energyplan.io.topics import TOPIC_MAPS, TopicMap, TopicSource
from energyplan.logs import DriveLog
from energyplan.logs.align import AS_LOGGED, Series, align
from energyplan.logs.clean import SetAside

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
"""Kinds of file that are read as bags, beside folders with a ``metadata.yaml``."""
_LARGEST_SKEW = 5.0  # median difference of stamp and arrival: beyond, stamps are not believed [s]
_MAGIC = b"#ROSBAG V2.0\n"
_LARGEST_METADATA = 1 << 23  # bytes; a topic takes a few hundred
_SERVES = {
    "sensor_msgs/msg/JointState": "v_left, v_right (wheel rates times radius)",
    "sensor_msgs/msg/BatteryState": "voltage, current (its sign is opposite)",
    "sensor_msgs/msg/Imu": "yaw_rate, accel_x",
    "nav_msgs/msg/Odometry": "x, y, yaw; v_left, v_right from the twist of wheel odometry",
    "husky_msgs/msg/HuskyStatus": "p_left, p_right (driver current times voltage)",
    "clearpath_platform_msgs/msg/Power": "p_left, p_right or power (currents times voltages)",
}
# What the packages that read bags raise when the bytes make no sense to them.
_UNSOUND = (
    AssertionError, AttributeError, EOFError, IndexError, KeyError, MemoryError, OSError,
    OverflowError, RecursionError, StopIteration, SyntaxError, TypeError, ValueError,
    struct.error, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag."""

    name: str  # topic and message type
    type: str  # topic and message type
    count: int  # number of messages
    rate: float  # messages per second over the bag's length [Hz]
    serves: str  # channels that it could serve for


@dataclass(frozen=True)
class BagInfo:
    """What a bag holds."""

    name: str  # name of the file or folder
    duration: float  # time from the first to the last message [s]
    topics: tuple[BagTopic, ...]  # the topics


def is_bag(path: str | Path) -> bool:
    """Tell whether a path is a bag, by its suffix or its metadata."""
    file = Path(path)
    return file.suffix.lower() in BAG_SUFFIXES or is_file(file / "metadata.yaml")


def bag_info(path: str | Path) -> BagInfo:
    """Tell what a bag holds, and what it could serve for."""
    with opened_bag(Path(path)) as reader:
        duration = max(reader.duration, 1) * 1e-9
        topics = tuple(
            BagTopic(
                name,
                str(topic.msgtype or "several types"),
                topic.msgcount,
                topic.msgcount / duration,
                _SERVES.get(str(topic.msgtype), ""),
            )
            for name, topic in sorted(reader.topics.items())
        )
    return BagInfo(Path(path).name, duration, topics)


def read_bag(
    path: str | Path,
    topics: TopicMap | str | Path | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> DriveLog:
    """Read a drive log from a bag.

    The bag is streamed: no more is kept than the numbers wanted. Channels come to the clock of the
    left tread speed, averaged where they are faster and interpolated where they are slower.
    Messages count at their stamp, or at their arrival where they have none that can be believed.
    """
    file = Path(path)
    if topics is None:
        raise DriveLogError(
            f"{file.name}: the robot, and so the radius of its wheels, is not known; give "
            f"topics={' or '.join(repr(name) for name in TOPIC_MAPS)}, or a topic map of your own: "
            f"energyplan start {file.name} --wheel-radius M --out PROJECT.yaml writes one"
        )
    mapping = topics if isinstance(topics, TopicMap) else TopicMap.read(topics)
    with opened_bag(file) as reader:
        chosen = _choose(mapping, sorted(reader.topics))
        for channel in ("v_left", "v_right"):
            if channel not in chosen:
                there = ", ".join(sorted(reader.topics)) or "none"
                raise DriveLogError(
                    f"{file.name}: no topic serves as {channel} in the topic map {mapping.name!r}; "
                    f"the bag has {there}; write a topic map of your own"
                )
        series, aside, warnings = _collect(reader, chosen, file.name, progress)
    clock = series["v_left"].t
    channels = {"t": clock - clock[0]}
    plain = []
    for name, one in series.items():
        aligned = align(one, clock)
        channels[name] = aligned.values
        source = chosen[name]
        told = f"{name} is {source.topic} {source.source.field}"
        if aligned.error is None and aligned.how == AS_LOGGED:
            plain.append(told)
            continue
        error = "" if aligned.error is None else f", error about {aligned.error:.2g} (rms)"
        warnings.append(f"{told}, {aligned.how}{error}")
    if plain:
        warnings.append(f"{AS_LOGGED}: {', '.join(plain)}")
    log = DriveLog.from_columns(channels, file.name)
    return replace(log, set_aside=(*aside, *log.set_aside), warnings=(*warnings, *log.warnings))


@dataclass(frozen=True)
class _Chosen:
    """A bag's topic that serves as a channel."""

    topic: str
    source: TopicSource


def _choose(mapping: TopicMap, names: list[str]) -> dict[str, _Chosen]:
    """Pick each channel's first source that the bag has; of several topics the shortest."""
    chosen: dict[str, _Chosen] = {}
    for channel, sources in mapping.channels.items():
        for source in sources:
            matching = sorted((n for n in names if source.matches(n)), key=len)
            if matching:
                chosen[channel] = _Chosen(matching[0], source)
                break
    return chosen


def channels_served(mapping: TopicMap, names: list[str]) -> tuple[str, ...]:
    """Return the channels that a topic map finds among topics of these names, ``t`` included."""
    chosen = _choose(mapping, sorted(names))
    return ("t", *chosen) if chosen else ()


def _collect(
    reader: Any,
    chosen: Mapping[str, _Chosen],
    name: str,
    progress: Callable[[float], None] | None,
) -> tuple[dict[str, Series], list[SetAside], list[str]]:
    """Stream the messages and keep the channels' numbers."""
    wanted = {choice.topic for choice in chosen.values()}
    stamps = {channel: array("d") for channel in chosen}
    arrivals = {channel: array("d") for channel in chosen}
    values = {channel: array("d") for channel in chosen}
    start, span = reader.start_time, max(reader.duration, 1)
    connections = [c for c in reader.connections if c.topic in wanted]
    for number, (connection, arrival, raw) in enumerate(reader.messages(connections=connections)):
        message = reader.deserialize(raw, connection.msgtype)
        header = getattr(message, "header", None)
        for channel, choice in chosen.items():
            if choice.topic == connection.topic:
                arrivals[channel].append((arrival - start) * 1e-9)
                stamp = 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
                stamps[channel].append((stamp - start) * 1e-9 if stamp else np.nan)
                values[channel].append(choice.source.value(message))
        if progress is not None and number % 1000 == 0:
            progress((arrival - start) / span)
    if progress is not None:
        progress(1.0)
    found: dict[str, Series] = {}
    aside: list[SetAside] = []
    warnings: list[str] = []
    for channel in chosen:
        t, arrived = np.array(stamps[channel]), np.array(arrivals[channel])
        if not len(t):
            continue
        skew = np.abs(t - arrived)
        if not np.all(np.isfinite(skew)) or np.median(skew) > _LARGEST_SKEW:
            t = arrived
            topic = chosen[channel].topic
            warnings.append(f"{topic} carries no stamp to believe; its messages count at arrival")
        order = np.argsort(t, kind="stable")
        t, y = t[order], np.array(values[channel])[order]
        usable = np.isfinite(y) & np.append(True, np.diff(t) > 0)
        if not np.all(usable):
            reason = f"{channel}: no value, or the time of the message before; left out"
            count = int(np.count_nonzero(~usable))
            where = f"from {t[int(np.argmin(usable))]:.3f} s of {name}"
            aside.append(SetAside(reason, count, where))
        if np.any(usable):
            y = y[usable]
            found[channel] = Series(t[usable], np.unwrap(y) if channel == "yaw" else y)
    if not {"v_left", "v_right"} <= set(found):
        raise DriveLogError(
            f"{name}: the topics of the tread speeds hold no usable value; check the joints' names "
            "in the topic map"
        )
    return found, aside, list(dict.fromkeys(warnings))


@contextmanager
def opened_bag(file: Path, definitions: Mapping[str, str] = MappingProxyType({})) -> Iterator[Any]:
    """Open a bag; what goes wrong inside it becomes a named error.

    The definitions are of messages, by type, that rosbags does not know and old bags do not carry.
    """
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    except ImportError:
        raise MissingDependencyError(
            f"reading {file} needs rosbags; install it with pip install 'energyplan[bags]'"
        ) from None
    bound_unpacking()
    unsound: tuple[type[Exception], ...] = (
        *_UNSOUND, *_database_errors(), AnyReaderError, SerdeError, TypesysError,
        rosbag1.ReaderError, rosbag2.ReaderError,
    )  # fmt: skip
    try:
        _check_beginning(file)
        # Bags of ROS 2 before Iron do not carry their message definitions.
        store = get_typestore(Stores.ROS2_HUMBLE)
        for kind, text in definitions.items():
            store.register(get_types_from_msg(text, kind))
        with AnyReader([file], default_typestore=store) as reader:
            yield reader
    except EnergyPlanError:
        raise
    except unsound as problem:
        first = (str(problem).splitlines() or [""])[0] or type(problem).__name__
        raise DriveLogError(f"{file} is no sound bag: {first}; record or copy it again") from None


def _check_beginning(file: Path) -> None:
    """Refuse what rosbags would take into memory whole before it finds that it is no bag."""
    if file.suffix.lower() == ".bag":
        with file.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise ValueError("it does not begin as a ROS 1 bag does")
    metadata = file / "metadata.yaml"
    if is_file(metadata) and metadata.stat().st_size > _LARGEST_METADATA:
        raise ValueError(f"its metadata.yaml is larger than {_LARGEST_METADATA >> 20} MiB")


def _database_errors() -> tuple[type[Exception], ...]:
    """Errors of the database inside a ROS 2 bag; which package reads it is rosbags' affair."""
    try:
        import apsw
    except ImportError:
        return (sqlite3.Error,)
    return (sqlite3.Error, apsw.Error)
