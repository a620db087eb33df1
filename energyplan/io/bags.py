"""Drive logs from ROS 1 and ROS 2 bags and MCAP files, and what serves as which channel."""

from __future__ import annotations

import re
import sqlite3
import struct
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache
from importlib import import_module
from math import atan2, nan
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, field_validator

from energyplan.errors import (
    ConfigError,
    DriveLogError,
    EnergyPlanError,
    MissingDependencyError,
    UnknownNameError,
)
from energyplan.io.documents import Document, Loc, load
from energyplan.io.files import is_file
from energyplan.logs import DriveLog
from energyplan.logs.align import AS_LOGGED, Series, align
from energyplan.logs.clean import SetAside
from energyplan.logs.guess import guess, side_of, words
from energyplan.logs.mapping import (
    RATES,
    UNITS,
    Column,
    count_rate,
    counting,
    formula,
    scale_of,
)
from energyplan.path import FloatArray

_FIELD = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)\s*(?:\[([^\[\]]+)\])?\Z")
_NAME = r"(?:/[\w/]+\.)?(?:yaw\([\w.\s]+\)|[A-Za-z_][\w.]*(?:\s*\[[^\[\]]+\])?)"


_FIELDS = "write a field such as angular_velocity.z, a.b[0], yaw(a.b) or a.b-0.25*c.d"


def _apart(name: str) -> tuple[str, str]:
    """Split a field of another topic, such as ``/battery_2.current``; the topic may be empty."""
    topic, _, field = name.partition(".") if name.startswith("/") else ("", "", name)
    return topic, field


class _Place(NamedTuple):
    """Where in a message a value stands."""

    parts: tuple[str, ...]
    element: str | None
    heading: bool


@lru_cache(maxsize=256)
def _place(field: str) -> _Place:
    text = _apart(field.strip())[1]
    heading = text.startswith("yaw(") and text.endswith(")")
    match = _FIELD.match(text[4:-1].strip() if heading else text)
    if match is None:
        raise ValueError(_FIELDS)
    return _Place(tuple(match[1].split(".")), match[2], heading)


def _number(message: Any, place: _Place) -> float:
    value = message
    for part in place.parts:
        value = getattr(value, part, None)
    if value is None:
        return nan
    if place.heading:
        sine = 2 * (value.w * value.z + value.x * value.y)
        return atan2(sine, 1 - 2 * (value.y**2 + value.z**2))
    if place.element is None:
        return float(value)
    if place.element.isdecimal():
        index = [int(place.element)]
    else:
        names = _joints(message)
        wanted = place.element.split("|")
        index = [k for k, name in enumerate(names) if any(fnmatchcase(name, w) for w in wanted)]
    found = [float(value[k]) for k in index if k < len(value)]
    return sum(found) / len(found) if found else nan


def _joints(message: Any) -> list[str]:
    """Return the names of what a message holds an array of."""
    return [str(name) for name in getattr(message, "name", getattr(message, "joint_names", ()))]


def _readable(column: Column) -> Column:
    """Return a message's field, or a sum of fields with factors, as what serves as a channel."""
    if not column.topic:
        raise ValueError(f"give the topic of {column.field}")
    if column.times is not None:
        _place(column.times)
    added = column.model_copy(update={"times": None})
    made = formula(added.written if column.plus else column.field, _NAME)
    if made is None or made.times is not None:
        raise ValueError(_FIELDS)
    for name in made.names:
        _place(name)
    first, *rest = made.names
    return column.model_copy(update={"field": first, "plus": tuple(rest), "weights": made.weights})


def source(channel: str, topic: str, field: str) -> Column:
    """Return what serves as a channel."""
    return _readable(Column(topic=topic, field=field, channel=channel))


def read_message(column: Column, message: Any) -> float:
    """Return a channel's value from a message; NaN where the field holds none."""
    return float(column.value(lambda field: _number(message, _place(field))))


class TopicMap(BaseModel):
    """Sources of each channel, the preferred one first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["topics"] = "topics"  # what a YAML file of a topic map says it is
    name: str = "topics"  # what to call it
    channels: dict[str, list[Annotated[Column, AfterValidator(_readable)]]]  # by channel

    @field_validator("channels", mode="before")
    @classmethod
    def _lists(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {key: item if isinstance(item, list) else [item] for key, item in value.items()}

    @field_validator("channels")
    @classmethod
    def _named(cls, value: dict[str, list[Column]]) -> dict[str, list[Column]]:
        return {key: [one.changed(channel=key) for one in many] for key, many in value.items()}

    def described(self) -> dict[str, Any]:
        """Return the map as its file holds it."""
        channels = {key: [one.described() for one in many] for key, many in self.channels.items()}
        return {"name": self.name, "channels": channels}

    @classmethod
    def read(cls, source: str | Path) -> TopicMap:
        """Return a ready-made map (``husky``, ``jackal``, ``warthog``) or one from a YAML file."""
        if isinstance(source, str) and not source.endswith((".yaml", ".yml")):
            if source not in TOPIC_MAPS:
                raise UnknownNameError("topic map", source, [*TOPIC_MAPS, "FILE.yaml"])
            return TOPIC_MAPS[source]
        document = load(source, ConfigError)
        if document.data.get("kind") != "project":
            return document.check(cls)
        if not isinstance(document.data.get("topics"), dict):
            raise document.fail(
                ("topics",),
                "the project has no topic map: it was made from a table, not from a bag",
            )
        return Document(
            document.source, document.data["topics"], _below(document.lines, "topics"), ConfigError
        ).check(cls)


def _below(lines: dict[Loc, int], key: str) -> dict[Loc, int]:
    """Return the lines of what stands below a key."""
    return {place[1:]: line for place, line in lines.items() if place[:1] == (key,)}


_FURTHER: dict[str, list[dict[str, Any]]] = {
    "voltage": [
        {"topic": "platform/bms/state", "field": "voltage"},
        {"topic": "battery_state", "field": "voltage"},
    ],
    "current": [  # of a sensor_msgs/BatteryState: negative when discharging
        {"topic": "platform/bms/state", "field": "current", "scale": -1.0},
        {"topic": "battery_state", "field": "current", "scale": -1.0},
    ],
    "yaw_rate": [
        {"topic": "sensors/imu_0/data", "field": "angular_velocity.z"},
        {"topic": "imu/data", "field": "angular_velocity.z"},
    ],
    "accel_x": [
        {"topic": "sensors/imu_0/data", "field": "linear_acceleration.x"},
        {"topic": "imu/data", "field": "linear_acceleration.x"},
    ],
    **{
        channel: [
            {"topic": topic, "field": field}
            for topic in ("platform/odom/filtered", "odometry/filtered")
        ]
        for channel, field in (
            ("x", "pose.pose.position.x"),
            ("y", "pose.pose.position.y"),
            ("yaw", "yaw(pose.pose.orientation)"),
        )
    },
}


def _wheels(radius: float) -> dict[str, list[dict[str, Any]]]:
    """Tread speeds from the joints' rates, all wheels of a side together."""
    return {
        f"v_{side}": [
            {"topic": topic, "field": f"velocity[*{side}*]", "scale": radius}
            for topic in ("platform/joint_states", "joint_states")
        ]
        for side in ("left", "right")
    }


def _power_message(voltage: int, current: int) -> dict[str, Any]:
    return {
        "topic": "platform/mcu/status/power",
        "field": f"measured_currents[{current}]",
        "times": f"measured_voltages[{voltage}]",
    }


TOPIC_MAPS = {
    name: TopicMap.model_validate({"name": name, "channels": channels})
    for name, channels in {
        "husky": {
            **_wheels(0.1651),
            **{
                f"p_{side}": [
                    {
                        "topic": topic,
                        "field": f"{side}_driver_current",
                        "times": f"{side}_driver_voltage",
                    }
                    for topic in ("husky/status", "status")
                ]
                + [_power_message(k, k)]
                for k, side in ((1, "left"), (2, "right"))
            },
            **_FURTHER,
        },
        "jackal": {**_wheels(0.098), "power": [_power_message(0, 2)], **_FURTHER},
        "warthog": {**_wheels(0.3), "power": [_power_message(0, 0)], **_FURTHER},
    }.items()
}
"""Ready-made topic maps of Clearpath robots, ROS 1 and ROS 2."""

_PRESETS = {"husky_a200": "husky", "jackal": "jackal", "warthog": "warthog"}


def topic_map_of(vehicle: str) -> str | None:
    """Return the name of the ready-made topic map of a vehicle preset, if it has one."""
    return _PRESETS.get(vehicle.partition(":")[0])


BAG_SUFFIXES = (".bag", ".mcap", ".db3")
"""Kinds of file that are read as bags, beside folders with a ``metadata.yaml``."""
_LARGEST_SKEW = 5.0  # median difference of stamp and arrival: beyond, stamps are not believed [s]
_MAGIC = b"#ROSBAG V2.0\n"
_LARGEST_CHUNK = 1 << 26  # bytes; ROS makes them of 768 kB, or of one larger message
_LARGEST_METADATA = 1 << 23  # bytes; a topic takes a few hundred
# What the packages that read bags raise when the bytes make no sense to them.
_UNSOUND = (
    AssertionError, AttributeError, EOFError, IndexError, KeyError, MemoryError, OSError,
    OverflowError, RecursionError, StopIteration, SyntaxError, TypeError, ValueError,
    struct.error, zlib.error,
)  # fmt: skip


def is_bag(path: str | Path) -> bool:
    """Tell whether a path is a bag, by its suffix or its metadata."""
    file = Path(path)
    return file.suffix.lower() in BAG_SUFFIXES or is_file(file / "metadata.yaml")


def read_bag(
    path: str | Path,
    topics: TopicMap | str | Path | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> DriveLog:
    """Read a drive log from a bag."""
    file = Path(path)
    if topics is None:
        raise DriveLogError(
            f"{file.name}: the robot, and so the radius of its wheels, is not known; give "
            f"topics={' or '.join(repr(name) for name in TOPIC_MAPS)}, or a topic map of your own: "
            f"energyplan start {file.name} --wheel-radius M --out PROJECT.yaml writes one"
        )
    mapping = topics if isinstance(topics, TopicMap) else TopicMap.read(topics)
    with opened_bag(file) as bag:
        chosen = _choose(mapping, sorted(bag.topics))
        for channel in _SIDES:
            if channel not in chosen:
                there = ", ".join(sorted(bag.topics)) or "none"
                raise DriveLogError(
                    f"{file.name}: no topic serves as {channel} in the topic map {mapping.name!r}; "
                    f"the bag has {there}; write a topic map of your own"
                )
        return bag.collect(chosen.values(), progress).log(chosen)


def _choose(mapping: TopicMap, names: list[str]) -> dict[str, Column]:
    """Pick each channel's first source that the bag has; of several topics the shortest."""
    chosen: dict[str, Column] = {}

    def named(topic: str) -> str | None:
        wanted = Column(topic=topic, field="data")
        return min((name for name in names if wanted.matches(name)), key=len, default=None)

    def moved(name: str) -> str | None:
        topic, field = _apart(name)
        return f"/{(named(topic) or '').strip('/')}.{field}" if topic and named(topic) else name

    for channel, sources in mapping.channels.items():
        for one in sources:
            topic = named(one.topic)
            if topic is not None:
                plus = tuple(filter(None, map(moved, one.plus)))
                times = None if one.times is None else moved(one.times)
                chosen[channel] = one.changed(topic=topic, plus=plus, times=times)
                break
    return chosen


@dataclass(frozen=True)
class Recording:
    """Numbers of a bag's messages, as they came: fields by topic, on the topic's own clock."""

    name: str
    clocks: Mapping[str, FloatArray]  # by topic [s]
    fields: Mapping[tuple[str, str], FloatArray]  # by topic and field
    warnings: tuple[str, ...] = ()

    def series(self, column: Column) -> Series:
        """Return a channel at the times of its first field's messages; NaN where it has no value.

        What another topic adds or multiplies by is interpolated.
        """
        clock = self.clocks[column.topic]

        def reading(name: str) -> FloatArray:
            topic, field = _apart(name)
            topic = topic or column.topic
            t, values = self.clocks[topic], self.fields[topic, field]
            if topic == column.topic:
                return values
            known = np.isfinite(values) & np.append(True, np.diff(t) > 0)
            return align(Series(t[known], values[known]), clock).values

        kind = column.counts
        rate = (lambda name: count_rate(clock, reading(name), kind)) if kind else None
        return Series(clock, np.asarray(column.value(reading, rate), float))

    def log(self, chosen: Mapping[str, Column]) -> DriveLog:
        """Return the channels on the clock of the left tread speed, as a log."""
        aside, warnings = [], [*self.warnings]
        found: dict[str, Series] = {}
        for channel, column in chosen.items():
            t, y = self.series(column)
            usable = np.isfinite(y) & np.append(True, np.diff(t) > 0)[: len(t)]
            if not np.all(usable):
                reason = f"{channel}: no value, or the time of the message before; left out"
                where = f"from {t[int(np.argmin(usable))]:.3f} s of {self.name}"
                aside.append(SetAside(reason, int(np.count_nonzero(~usable)), where))
            if np.any(usable):
                y = y[usable]
                found[channel] = Series(t[usable], np.unwrap(y) if channel == "yaw" else y)
        if not {*_SIDES} <= set(found):
            raise DriveLogError(
                f"{self.name}: the topics of the tread speeds hold no usable value; check the "
                "joints' names in the topic map"
            )
        clock = found["v_left"].t
        channels = {"t": clock - clock[0]}
        plain = []
        for name, one in found.items():
            aligned = align(one, clock)
            channels[name] = aligned.values
            told = f"{name} is {chosen[name].topic} {chosen[name].written}"
            if aligned.how == AS_LOGGED:
                plain.append(told)
            else:
                warnings.append(f"{told}, {aligned.how}")
        if plain:
            warnings.append(f"{AS_LOGGED}: {', '.join(plain)}")
        log = DriveLog.from_columns(channels, self.name)
        return replace(
            log, set_aside=(*aside, *log.set_aside), warnings=(*warnings, *log.warnings)
        )


class Bag:
    """An open bag. Topics whose messages cannot be read are left out, and said."""

    def __init__(self, name: str, reader: Any, stores: Sequence[Any], lost: dict[str, str]) -> None:
        self.name, self._reader, self._stores, self.lost = name, reader, stores, lost
        self.connections = [c for c in reader.connections if c.topic not in lost]
        self.topics = {c.topic: c.msgtype for c in self.connections}

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not read, and why."""
        return tuple(f"{topic} is left out: {why}" for topic, why in self.lost.items())

    def messages(self, connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time of arrival [ns] and bytes of messages; of none, nothing."""
        return iter(self._reader.messages(connections=connections) if connections else ())

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """Return a message."""
        store = next((one for one in self._stores if kind in one.types), self._stores[-1])
        first = not hasattr(self._reader, "ros_distro")
        return (store.deserialize_ros1 if first else store.deserialize_cdr)(raw, kind)

    def collect(
        self, columns: Iterable[Column], progress: Callable[[float], None] | None = None
    ) -> Recording:
        """Stream the messages and keep the fields that columns are made of."""
        wanted: dict[str, dict[str, array[float]]] = {}
        for one in columns:
            for topic, field in map(_apart, one.names):
                wanted.setdefault(topic or one.topic, {})[field] = array("d")
        times = {topic: (array("d"), array("d")) for topic in wanted}
        start, span = self._reader.start_time, max(self._reader.duration, 1)
        connections = [c for c in self.connections if c.topic in wanted]
        for number, (connection, arrival, raw) in enumerate(self.messages(connections)):
            message = self.deserialize(raw, connection.msgtype)
            header = getattr(message, "header", None)
            stamps, arrivals = times[connection.topic]
            stamp = 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
            arrivals.append((arrival - start) * 1e-9)
            stamps.append((stamp - start) * 1e-9 if stamp else np.nan)
            for field, values in wanted[connection.topic].items():
                values.append(_number(message, _place(field)))
            if progress is not None and number % 1000 == 0:
                progress((arrival - start) / span)
        if progress is not None:
            progress(1.0)
        clocks, fields, warnings = {}, {}, []
        for topic, one in wanted.items():
            t, arrived = (np.array(part) for part in times[topic])
            skew = np.abs(t - arrived)
            if len(t) and (not np.all(np.isfinite(skew)) or np.median(skew) > _LARGEST_SKEW):
                t = arrived
                warnings.append(
                    f"{topic} carries no stamp to believe; its messages count at arrival"
                )
            order = np.argsort(t, kind="stable")
            clocks[topic] = t[order]
            fields |= {(topic, field): np.array(values)[order] for field, values in one.items()}
        return Recording(self.name, clocks, fields, tuple(warnings))


@contextmanager
def opened_bag(file: Path, definitions: Mapping[str, str] = MappingProxyType({})) -> Iterator[Bag]:
    """Open a bag; what goes wrong inside it becomes a named error."""
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    except ImportError:
        raise MissingDependencyError(
            f"reading {file} needs rosbags; install it with pip install 'energyplan[bags]'"
        ) from None
    unsound: tuple[type[Exception], ...] = (
        *_UNSOUND, *_database_errors(), SerdeError, TypesysError, rosbag1.ReaderError,
        rosbag2.ReaderError, RuntimeError, _zstd().ZstdError,
    )  # fmt: skip
    try:
        _check_beginning(file)
        first = file.suffix.lower() == ".bag"
        own = get_typestore(Stores.EMPTY)
        # Bags of ROS 2 before Iron do not carry their message definitions.
        usual = get_typestore(Stores.EMPTY if first else Stores.ROS2_HUMBLE)
        for kind, text in definitions.items():
            usual.register(get_types_from_msg(text, kind))
        with (rosbag1.Reader if first else rosbag2.Reader)(file) as reader:
            if first:
                reader.chunks = {
                    place: chunk._replace(decompressor=_bounded(chunk.decompressor))
                    for place, chunk in reader.chunks.items()
                }
            lost: dict[str, str] = {}
            for one in reader.connections:
                try:
                    _define(own, one)
                except unsound as problem:
                    lost[one.topic] = f"its type {one.msgtype} cannot be read: {_said(problem)}"
                if one.msgtype not in own.types and one.msgtype not in usual.types:
                    lost.setdefault(
                        one.topic, f"the bag does not hold the definition of {one.msgtype}"
                    )
            yield Bag(file.name, reader, (own, usual), lost)
    except EnergyPlanError:
        raise
    except unsound as problem:
        encoding = _encoding(file)
        if encoding:
            raise DriveLogError(
                f"{file} holds messages in {encoding}, not in CDR as ROS 2 writes them: export "
                "the topics as one CSV, as PlotJuggler does, or several, and give a.csv+b.csv"
            ) from None
        raise DriveLogError(
            f"{file} is no sound bag: {_said(problem)}; copy it again, or mend one that was cut by "
            "rosbag reindex, ros2 bag reindex or mcap recover"
        ) from None


def _said(problem: Exception) -> str:
    return (str(problem).splitlines() or [""])[0] or type(problem).__name__


def _define(store: Any, connection: Any) -> None:
    """Learn the type of a connection's messages, if the bag defines it."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    form, text = connection.msgdef
    if form.name == "MSG":
        store.register(get_types_from_msg(text, connection.msgtype))
    elif form.name == "IDL":
        parts = re.split("^=+\nIDL: .*\n", text, flags=re.MULTILINE)
        for part in filter(str.strip, parts):
            store.register(get_types_from_idl(part))
    digest = str(connection.digest)
    if digest.startswith("RIHS") and store.hash_rihs01(connection.msgtype) != digest:
        raise ValueError("its definition is not the one that it was recorded with")


_ENCODINGS = {"json": "JSON", "protobuf": "Protobuf", "flatbuffer": "FlatBuffers", "cbor": "CBOR"}
"""Other encodings of messages in an MCAP file than that of ROS 2."""


def _encoding(file: Path) -> str:
    """Return the encoding of an MCAP file's messages where ROS 2 does not write it."""
    if file.is_dir():
        file = next(iter(sorted(file.glob("*.mcap"))), file)
    if file.suffix.lower() != ".mcap" or not file.is_file():
        return ""
    with file.open("rb") as stream:
        head = stream.read(1 << 20)
        stream.seek(max(0, file.stat().st_size - (1 << 20)))
        data = head + stream.read()
    return next(
        (name for key, name in _ENCODINGS.items()
         if data.startswith(b"\x89MCAP0") and struct.pack("<I", len(key)) + key.encode() in data),
        "",
    )  # fmt: skip


def _check_beginning(file: Path) -> None:
    """Refuse what rosbags would wait for, or take into memory whole before it finds it no bag."""
    if file.exists() and not (file.is_file() or file.is_dir()):
        raise ValueError("it is no regular file")
    if file.suffix.lower() == ".bag":
        with file.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise ValueError("it does not begin as a ROS 1 bag does")
    metadata = file / "metadata.yaml"
    if is_file(metadata) and metadata.stat().st_size > _LARGEST_METADATA:
        raise ValueError(f"its metadata.yaml is larger than {_LARGEST_METADATA >> 20} MiB")


def _bounded(unpack: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """Return what unpacks a chunk of a ROS 1 bag, which may be small and hold gigabytes."""
    from rosbags.rosbag1.reader import decompressors

    kinds = {"bz2": ("bz2", "BZ2Decompressor"), "lz4": ("lz4.frame", "LZ4FrameDecompressor")}
    packing = next((name for name in kinds if decompressors[name] is unpack), None)
    if packing is None:  # it is as large as it is in the file
        return unpack
    module, name = kinds[packing]

    def bounded(packed: bytes) -> bytes:
        reader = getattr(import_module(module), name)()
        content: bytes = reader.decompress(packed, max_length=_LARGEST_CHUNK)
        if not reader.eof:
            raise ValueError(f"a chunk is cut short, or unpacks to over {_LARGEST_CHUNK >> 20} MiB")
        return content

    return bounded


def _database_errors() -> tuple[type[Exception], ...]:
    """Errors of the database inside a ROS 2 bag; which package reads it is rosbags' affair."""
    try:
        import apsw
    except ImportError:
        return (sqlite3.Error,)
    return (sqlite3.Error, apsw.Error)


def _zstd() -> Any:
    """Return the module of Zstandard that rosbags brings along."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")


_DEEPEST = 6
_LONGEST = 16  # elements of an array that are looked at
_SIDES = ("v_left", "v_right")
_JOINTS, _ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
_MEANING = {
    ("sensor_msgs/msg/BatteryState", "voltage"): "voltage",
    ("sensor_msgs/msg/BatteryState", "current"): "current",
    ("sensor_msgs/msg/Imu", "angular_velocity.z"): "yaw_rate",
    ("sensor_msgs/msg/Imu", "linear_acceleration.x"): "accel_x",
    **{
        (kind, f"{prefix}{field}"): channel
        for kind, prefix in ((_ODOMETRY, "pose.pose."), ("geometry_msgs/msg/PoseStamped", "pose."))
        for field, channel in (("position.x", "x"), ("position.y", "y"))
    },
    (_ODOMETRY, "yaw(pose.pose.orientation)"): "yaw",
    ("geometry_msgs/msg/PoseStamped", "yaw(pose.orientation)"): "yaw",
}
"""Channels of the fields of message types, by type and field."""
_ROLLING = {"wheel", "wheels", "track", "tread", "drivewhl", "drive", "whl"}


@dataclass(frozen=True)
class BagFields:
    """Fields of a bag's messages that hold numbers, by a name that tells topic and field."""

    fields: dict[str, Column]
    types: dict[str, str]  # type of each topic's messages

    def channels(self) -> dict[str, Column]:
        """Guess the field that makes each channel."""
        typed = self._typed()
        found = {**self._named(), **typed}
        if {"voltage", "current"} <= set(typed):
            found.pop("power", None)  # a battery's own readings are surer than a name
        if not {"p_left", "p_right"} <= set(found):
            found = {k: v for k, v in found.items() if k not in ("p_left", "p_right")}
        return found

    def twist(self, track: float) -> dict[str, Column]:
        """Return tread speeds made from speed and turn rate of the body, of a track [m]."""
        ahead, turn = "twist.twist.linear.x", "twist.twist.angular.z"
        for one in self.fields.values():
            if self.types[one.topic] == _ODOMETRY and one.field == ahead:
                return {
                    channel: source(channel, one.topic, f"{ahead}{sign}{0.5 * track:.6g}*{turn}")
                    for channel, sign in (("v_left", "-"), ("v_right", "+"))
                }
        return {}

    def _typed(self) -> dict[str, Column]:
        """Channels of the message types that ROS gives a meaning."""
        found: dict[str, Column] = {}
        joints: dict[tuple[str, str], list[tuple[str, str]]] = {}
        for label, one in self.fields.items():
            kind = self.types[one.topic]
            channel = _MEANING.get((kind, one.field))
            if channel is not None:
                unit = "-A" if channel == "current" else ""
                found.setdefault(channel, one.changed(channel=channel, unit=unit))
            if kind == _JOINTS and one.field.startswith("velocity[") and side_of(label):
                joint = one.field.removeprefix("velocity[")[:-1]
                joints.setdefault((side_of(label), one.topic), []).append((label, joint))
        for (side, topic), every in joints.items():
            # Arms and steering have joints, too.
            rolling = [joint for label, joint in every if _ROLLING & set(words(label))]
            names = "|".join(rolling or [joint for _, joint in every])
            channel = f"v_{side}"
            found.setdefault(
                channel, Column(topic=topic, field=f"velocity[{names}]", channel=channel)
            )
        return found

    def _named(self) -> dict[str, Column]:
        """Channels that the names of topics and fields tell."""
        others = [
            label for label, one in self.fields.items()
            if self.types[one.topic] not in (_JOINTS, _ODOMETRY)
        ]  # fmt: skip
        guesses = guess(others)
        found = {
            channel: self.fields[one.field].model_copy(
                update={"channel": channel, "unit": one.unit}
            )
            for channel, one in guesses.items()
            if channel in UNITS and channel != "t" and not counting(channel, one.unit)
        }
        for side in ("left", "right"):
            amps, volts = (guesses.get(f"{kind}_{side}") for kind in ("current", "voltage"))
            if f"p_{side}" in found or amps is None or volts is None:
                continue
            current, voltage = self.fields[amps.field], self.fields[volts.field]
            factor = scale_of("current", amps.unit).factor * scale_of("voltage", volts.unit).factor
            if voltage.topic == current.topic:
                found[f"p_{side}"] = current.changed(
                    channel=f"p_{side}", times=voltage.field,
                    unit="" if factor == 1.0 else f"*{factor:g}",
                )  # fmt: skip
        return found

    def torques(self, sources: Mapping[str, Column]) -> str:
        """Say how efforts of the joints that make a tread speed make its side's power."""
        one = sources.get("v_left")
        joints = "" if one is None else one.field.removeprefix("velocity[").removesuffix("]")
        if one is None or f"effort[{joints.partition('|')[0]}]" not in {
            other.field for other in self.fields.values() if other.topic == one.topic
        }:
            return ""
        return (
            f"; where the efforts of {one.topic} are torques [N m], p_left is {{topic: {one.topic},"
            f" field: '{joints.count('|') + 1}*effort[{joints}]', times: '{one.field}'}}, and so "
            "is p_right"
        )

    def wheel_rates(self, sources: Mapping[str, Column]) -> bool:
        """Tell whether the tread speeds are rates of joints, which take a wheel radius."""
        one = sources["v_left"]
        rates = {"rate", "omega", "angular", "joint"}
        named = set(words(f"{one.topic}.{one.field}")) & rates if not (one.plus or one.unit) else ()
        return self.types[one.topic] == _JOINTS or one.unit in RATES or bool(named)

    def topic_map(self, sources: Mapping[str, Column], radius: float, name: str) -> TopicMap:
        """Return the topic map that reads these fields, of wheels of a radius [m]."""
        rolling = _SIDES if self.wheel_rates(sources) else ()
        channels = {
            channel: [one.changed(unit=f"{one.unit}*{radius!r}") if channel in rolling else one]
            for channel, one in sources.items()
        }
        return TopicMap(name=name, channels=channels)


def bag_fields(path: str | Path) -> BagFields:
    """List the numbers in the first message of each topic of a bag."""
    fields: dict[str, Column] = {}
    types: dict[str, str] = {}
    with opened_bag(Path(path)) as reader:
        for name, topic in sorted(reader.topics.items()):
            connections = [one for one in reader.connections if one.topic == name]
            first = next(reader.messages(connections=connections), None)
            if first is None:
                continue
            connection, _, raw = first
            message = reader.deserialize(raw, connection.msgtype)
            types[name] = str(topic.msgtype)
            for field in _numbers(message, "", 0):
                label = re.sub(r"[\[\]()]+", ".", f"{name}.{field}").strip("/.")
                fields[label] = Column(topic=name, field=field)
    return BagFields(fields, types)


def _numbers(message: Any, prefix: str, depth: int) -> Iterator[str]:
    """Yield the fields of a message that hold numbers, as a topic map writes them."""
    if depth > _DEEPEST:
        return
    joints = [str(name) for name in getattr(message, "name", ())] if depth == 0 else []
    for key in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, key, None)
        field = f"{prefix}{key}"
        if key.startswith("__") or key == "header" or "covariance" in key:
            continue
        if isinstance(value, bool | str | bytes) or value is None:
            continue
        if isinstance(value, int | float):
            yield field
        elif hasattr(value, "w") and hasattr(value, "z"):
            yield f"yaw({field})"
        elif hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, f"{field}.", depth + 1)
        elif hasattr(value, "__len__") and 0 < len(value) <= _LONGEST:
            if not isinstance(value[0], int | float) and not hasattr(value[0], "dtype"):
                continue
            for k in range(len(value)):
                element = joints[k] if len(joints) == len(value) and key != "name" else str(k)
                yield f"{field}[{element}]"
