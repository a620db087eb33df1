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
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import lru_cache
from importlib import import_module
from math import atan2, inf, isfinite, nan
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
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
from energyplan.logs.align import AS_LOGGED, Series, align, derivative, find_runs
from energyplan.logs.clean import SetAside
from energyplan.logs.consistency import correlation
from energyplan.logs.guess import guess, side_of, words
from energyplan.logs.mapping import (
    COUNTS,
    RATES,
    TOTAL,
    UNITS,
    Column,
    count_rate,
    counting,
    formula,
    parse_columns,
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
    columns: Mapping[str, Column] | None = None,
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
        chosen = _choose(mapping, sorted(bag.topics)) | dict(columns or {})
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
            return align(_known(Series(t, values)), clock).values

        kind = column.counts
        rate = (lambda name: count_rate(clock, reading(name), kind)) if kind else None
        return Series(clock, np.asarray(column.value(reading, rate), float))

    def log(self, chosen: Mapping[str, Column]) -> DriveLog:
        """Return the channels on the clock of the left tread speed, as a log."""
        aside, warnings = [], [*self.warnings]
        found: dict[str, Series] = {}
        for channel, column in chosen.items():
            t, y = self.series(column)
            usable = _usable(t, y)
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
        return replace(log, set_aside=(*aside, *log.set_aside), warnings=(*warnings, *log.warnings))


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
        clocks: dict[str, FloatArray] = {}
        fields: dict[tuple[str, str], FloatArray] = {}
        warnings = []
        for topic, several in wanted.items():
            t, arrived = (np.array(part) for part in times[topic])
            skew = np.abs(t - arrived)
            if len(t) and (not np.all(np.isfinite(skew)) or np.median(skew) > _LARGEST_SKEW):
                t = arrived
                warnings.append(
                    f"{topic} carries no stamp to believe; its messages count at arrival"
                )
            order = np.argsort(t, kind="stable")
            clocks[topic] = t[order]
            fields |= {(topic, field): np.array(values)[order] for field, values in several.items()}
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
            if isinstance(reader, rosbag1.Reader):
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
_LONGEST = 64  # elements of an array without names that are looked at
_LEAST = 20  # values that a field has at least, to tell anything
_SIDES = ("v_left", "v_right")
_JOINTS, _ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
_POSE, _IMU = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Imu"
_BATTERY = "sensor_msgs/msg/BatteryState"
_MEANING: dict[str, dict[str, str]] = {
    _BATTERY: {"voltage": "voltage", "current": "current"},
    _IMU: {"yaw_rate": "angular_velocity.z", "accel_x": "linear_acceleration.x"},
    **{
        kind: {"x": f"{at}position.x", "y": f"{at}position.y", "yaw": f"yaw({at}orientation)"}
        for kind, at in ((_ODOMETRY, "pose.pose."), (_POSE, "pose."))
    },
}
"""Fields of the channels that message types hold."""
_ROLLING = {"wheel", "wheels", "track", "tread", "drivewhl", "drive", "whl"}
_ONE_BATTERY = 0.1  # relative difference up to which two sensors may show one battery
_TOLD = 0.7  # correlation from which a turn rate is the robot's

Sources = dict[str, Column]


@dataclass(frozen=True)
class BagFields:
    """Fields of a bag's messages that hold numbers, by a name that tells topic and field."""

    fields: dict[str, Column]
    types: dict[str, str]  # type of each topic's messages

    def parse(self, columns: str | Mapping[str, str | Column] | None) -> Sources:
        """Return the fields that are named by hand, as in ``current=/battery.current[-A]``."""
        known = {f"/{one.topic.strip('/')}.{one.field}": one for one in self.fields.values()}
        known |= {f"/{name}": one for name, one in self.fields.items()} | self.fields
        found: Sources = {}
        for channel, one in parse_columns(columns, known).items():
            lost = [name for name in one.names if name not in known]
            if one.topic or not lost:
                found[channel] = one if one.topic else self._of([known[n] for n in one.names], one)
                continue
            near = get_close_matches(lost[0], known, 5, 0.3)
            raise DriveLogError(
                f"no message has a field {lost[0]!r}; near it are {', '.join(near) or 'none'}"
            )
        if "t" in found:
            raise DriveLogError("messages of a bag bear their own times; leave t out")
        return found

    def _of(self, parts: Sequence[Column], like: Column) -> Column:
        """Return a column made of fields, of one topic or several."""
        first = parts[0]
        names = [
            one.field if one.topic == first.topic else f"/{one.topic.strip('/')}.{one.field}"
            for one in parts
        ]
        times = names.pop() if like.times is not None else None
        update = {"topic": first.topic, "field": names[0], "plus": tuple(names[1:]), "times": times}
        return like.model_copy(update=update)

    def of_type(self, kind: str) -> list[Sources]:
        """Return the channels of each topic of a type that ROS gives a meaning."""
        found: dict[str, Sources] = {}
        there = {(one.topic, one.field): one for one in self.fields.values()}
        for topic in (topic for topic, one in self.types.items() if one == kind):
            for channel, field in _MEANING[kind].items():
                if (topic, field) in there:
                    unit = "-A" if channel == "current" else ""
                    found.setdefault(topic, {})[channel] = Column(
                        topic=topic, field=field, channel=channel, unit=unit
                    )
        return [*found.values()]

    def treads(self, track: float) -> list[Sources]:
        """Return what may be tread speeds: rates or angles of joints, names, a body's twist."""
        made: list[tuple[bool, Sources]] = []
        for kind in ("velocity", "position"):
            sides: dict[str, dict[str, list[tuple[str, str]]]] = {}
            for label, one in self.fields.items():
                if self.types[one.topic] == _JOINTS and one.field.startswith(f"{kind}["):
                    joint = one.field.removeprefix(f"{kind}[")[:-1]
                    if side := side_of(label):
                        sides.setdefault(one.topic, {}).setdefault(side, []).append((label, joint))
            for topic, both in sides.items():
                found: Sources = {}
                # Arms and steering have joints, too.
                rolls = [_ROLLING & set(words(label)) for one in both.values() for label, _ in one]
                for side, every in both.items():
                    joints = [j for label, j in every if _ROLLING & set(words(label))]
                    joints = joints or [j for _, j in every]
                    found[f"v_{side}"] = self._joints(topic, f"v_{side}", kind, joints)
                made.append((any(rolls), found))
        made.sort(key=lambda one: not one[0])
        whole = [one for _, one in made if {*_SIDES} <= set(one)]
        parts = {c: one for _, some in reversed(made) for c, one in some.items()}
        whole += [parts] if {*_SIDES} <= set(parts) and not whole else []
        named = {c: one for c, one in self.named().items() if c in _SIDES}
        return [*whole, *([named] if {*_SIDES} <= set(named) else []), *self._twists(track)]

    def _joints(self, topic: str, channel: str, kind: str, joints: Sequence[str]) -> Column:
        if kind == "velocity":
            return Column(topic=topic, field=f"velocity[{'|'.join(joints)}]", channel=channel)
        # An angle counts; of wheels that turn apart the mean is that of all, in each message.
        first, *rest = (f"position[{joint}]" for joint in joints)
        weights = (1.0 / len(joints),) * len(joints)
        return Column(topic=topic, field=first, plus=tuple(rest), weights=weights, unit=TOTAL,
                      ).model_copy(update={"channel": channel})  # fmt: skip

    def _twists(self, track: float) -> list[Sources]:
        """Return tread speeds made from speed and turn rate of the body, of a track [m]."""
        ahead, turn = "twist.twist.linear.x", "twist.twist.angular.z"
        half = 0.5 * track if isfinite(track) else 1.0
        return [
            {
                channel: source(channel, one.topic, f"{ahead}{sign}{half:.6g}*{turn}")
                for channel, sign in zip(_SIDES, "-+", strict=True)
            }
            for one in self.fields.values()
            if self.types[one.topic] == _ODOMETRY and one.field == ahead
        ]

    def named(self) -> Sources:
        """Return the channels that the names of topics and fields tell."""
        others = [
            label for label, one in self.fields.items()
            if self.types[one.topic] not in (_JOINTS, _ODOMETRY, _BATTERY, _IMU, _POSE)
        ]  # fmt: skip
        guesses = guess(others)
        found = {}
        for channel, one in guesses.items():
            if channel in UNITS and channel != "t" and not counting(channel, one.unit):
                made = self._of([self.fields[name] for name in one.names], one)
                count = len(one.names)
                if channel in _SIDES and count > 1:  # of several wheels the mean
                    made = made.model_copy(update={"weights": (1.0 / count,) * count})
                found[channel] = made
        for side in ("left", "right"):
            amps, volts = (guesses.get(f"{kind}_{side}") for kind in ("current", "voltage"))
            if f"p_{side}" in found or amps is None or volts is None:
                continue
            factor = scale_of("current", amps.unit).factor * scale_of("voltage", volts.unit).factor
            unit = "" if factor == 1.0 else f"*{factor:g}"
            like = amps.changed(channel=f"p_{side}", times=volts.field, unit=unit)
            found[f"p_{side}"] = self._of([self.fields[name] for name in like.names], like)
        if not {"p_left", "p_right"} <= set(found):
            found = {k: v for k, v in found.items() if k not in ("p_left", "p_right")}
        return found

    def torques(self, sources: Mapping[str, Column]) -> str:
        """Say how efforts of the joints that make the tread speeds make the sides' powers."""
        made = []
        for side in ("left", "right"):
            one = sources.get(f"v_{side}")
            joints = re.findall(r"\[([^\]]+)\]", one.field)[:1] if one is not None else []
            names = joints[0].split("|") if joints and one is not None else []
            labels = {
                other.field: f"/{label.removeprefix('/')}" for label, other in self.fields.items()
                if one is not None and other.topic == one.topic
            }  # fmt: skip
            efforts = [labels.get(f"effort[{name}]", "") for name in names]
            if not efforts or not all(efforts) or f"velocity[{names[0]}]" not in labels:
                return ""
            made.append(f"p_{side}=({'+'.join(efforts)})*{labels[f'velocity[{names[0]}]']}")
        return (
            "; where the efforts of these joints are torques [N m], those of all wheels make the "
            f'powers of the sides, as in --columns "{",".join(made)}"'
        )

    def wheel_rates(self, sources: Mapping[str, Column]) -> bool:
        """Tell whether the tread speeds are rates of joints, which take a wheel radius."""
        one = sources["v_left"]
        rates = {"rate", "omega", "angular", "joint"}
        named = set(words(f"{one.topic}.{one.field}")) & rates if not (one.plus or one.unit) else ()
        of_joints = self.types[one.topic] == _JOINTS and one.unit.lstrip("-") in ("", TOTAL)
        return of_joints or one.unit in RATES or bool(named)

    def topic_map(self, sources: Mapping[str, Column], radius: float, name: str) -> TopicMap:
        """Return the topic map that reads these fields, of wheels of a radius [m]."""
        rolling = _SIDES if self.wheel_rates(sources) else ()
        channels = {
            channel: [one.changed(unit=f"{one.unit}*{radius!r}") if channel in rolling else one]
            for channel, one in sources.items()
        }
        return TopicMap(name=name, channels=channels)


def bag_fields(path: str | Path) -> BagFields:
    """List the numbers in a bag's messages."""
    with opened_bag(Path(path)) as bag:
        return list_fields(bag)


def list_fields(bag: Bag) -> BagFields:
    """List the numbers in a bag's messages; of those that name what they hold, in all of them."""
    fields: dict[str, Column] = {}
    types: dict[str, str] = {}
    for name, kind in sorted(bag.topics.items()):
        for connection, _, raw in bag.messages([c for c in bag.connections if c.topic == name]):
            try:
                message = bag.deserialize(raw, connection.msgtype)
            except _UNSOUND as problem:
                if name not in types:
                    bag.lost[name] = f"its messages cannot be read: {_said(problem)}"
                break
            types[name] = str(kind)
            for field in _numbers(message, "", 0, _joints(message)):
                label = re.sub(r"[\[\]()]+", ".", f"{name}.{field}").strip("/.")
                fields.setdefault(label, Column(topic=name, field=field))
            if not _joints(message):  # else several may publish, each what it has
                break
    return BagFields(fields, types)


def _numbers(message: Any, prefix: str, depth: int, joints: Sequence[str]) -> Iterator[str]:
    """Yield the fields of a message that hold numbers, as a topic map writes them."""
    if depth > _DEEPEST:
        return
    for key in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, key, None)
        field = f"{prefix}{key}"
        if key.startswith("__") or key == "header" or "covariance" in key or key.isupper():
            continue
        if isinstance(value, bool | str | bytes) or value is None:
            continue
        if isinstance(value, int | float):
            yield field
        elif hasattr(value, "w") and hasattr(value, "z"):
            yield f"yaw({field})"
        elif hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, f"{field}.", depth + 1, joints)
        elif hasattr(value, "__len__") and len(value):
            if not isinstance(value[0], int | float) and not hasattr(value[0], "dtype"):
                continue
            named = len(joints) == len(value)
            for k in range(len(value) if named or len(value) <= _LONGEST else 0):
                yield f"{field}[{joints[k] if named else k}]"


# -- which of several ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """Which fields of a recording serve as which channels, and why these."""

    sources: Sources
    notes: tuple[str, ...]


def choose(fields: BagFields, recording: Recording, given: Sources, track: float) -> Choice:
    """Choose among the topics of each kind the one that goes with the treads, and say so."""
    found, notes = fields.named() | given, list[str]()
    treads = [] if {*_SIDES} & set(given) else fields.treads(track)
    moving = [one for one in treads if all(_varies(recording, column) for column in one.values())]
    found |= next(iter(moving or treads), {}) | given
    if not {*_SIDES} <= set(found):
        return Choice(found, ())
    if "current" in given:  # named by hand: its own topic's voltage goes with it
        own = [one for one in fields.of_type(_BATTERY) if "voltage" in one]
        own.sort(key=lambda one: one["voltage"].topic != given["current"].topic)
        packs = Choice(own[0] if own else {}, ())
    else:
        packs = _batteries(fields, recording)
    if {"voltage", "current"} <= set(packs.sources):
        found.pop("power", None)  # a battery's own readings are surer than a name
        found |= packs.sources
        notes += packs.notes
    left, right = (_series(recording, found[name]) for name in _SIDES)
    turning = align(right, left.t).values - left.values
    rated: dict[str, list[tuple[float, Sources]]] = {"yaw_rate": [], "yaw": []}
    for kind in (_IMU, _ODOMETRY, _POSE):
        name = "yaw_rate" if kind == _IMU else "yaw"
        for one in fields.of_type(kind):
            if name in one and any(_varies(recording, column) for column in one.values()):
                rated[name].append((_alike(recording, one[name], left.t, turning), one))
    if not rated["yaw"]:
        rated["yaw"] = [
            (alike, {"yaw": one}) for one in _of_imus(fields, "yaw", ["yaw(orientation)"])
            if abs(alike := _alike(recording, one, left.t, turning)) > _TOLD
        ]  # fmt: skip
    if all(abs(alike) < _TOLD for alike, _ in rated["yaw_rate"]):  # as of a camera's, on its side
        turned = [
            (_alike(recording, one, left.t, turning), one)
            for one in _of_imus(fields, "yaw_rate", _LYING)
        ]
        rated["yaw_rate"] += [
            (abs(alike), {"yaw_rate": one if alike > 0 else one.negative()})
            for alike, one in turned if abs(alike) > _SURELY
        ]  # fmt: skip
    for name, several in rated.items():
        # What is as the treads say to the last digit is made of them, and tells no slip.
        several.sort(key=_preferred)
        if several:
            found |= several[0][1]
        if len(several) > 1:
            told = [f"{one[name].topic} {one[name].field} {r:.2f}" for r, one in several]
            notes.append(
                f"{name} is that of {told[0].rpartition(' ')[0]}, which goes with the treads best "
                f"(correlation {', '.join(told)})"
            )
    return Choice(found | given, tuple(notes))


_SURELY, _MADE_OF_TREADS = 0.9, 0.99995  # correlations
_LYING = ("angular_velocity.x", "angular_velocity.y")


def _preferred(rated: tuple[float, Sources]) -> tuple[bool, bool, float]:
    alike = abs(rated[0])
    return alike < _TOLD, alike > _MADE_OF_TREADS, -round(alike, 3)


def _of_imus(fields: BagFields, channel: str, names: Iterable[str]) -> list[Column]:
    """Return fields of inertial units beside those that usually serve."""
    return [
        Column(topic=one.topic, field=one.field, channel=channel)
        for one in fields.fields.values()
        if fields.types[one.topic] == _IMU and one.field in names
    ]


def _series(recording: Recording, column: Column) -> Series:
    """Return readings, of wheels' rates and angles those of wheels of 1 m."""
    rolls = column.unit in RATES or column.unit in COUNTS
    return recording.series(column.changed(unit=f"{column.unit}*1") if rolls else column)


def _varies(recording: Recording, column: Column) -> bool:
    """Tell whether a field's readings change at all."""
    values = _series(recording, column).values
    values = values[np.isfinite(values)]
    return len(values) >= _LEAST and float(np.ptp(values)) > 0.0


def _alike(recording: Recording, column: Column, clock: FloatArray, turning: FloatArray) -> float:
    """Return the correlation of a turn rate, or the rate of a heading, with that of the treads."""
    t, values = _known(recording.series(column))
    if column.channel == "yaw":
        values = derivative(t, np.unwrap(values), find_runs(t), 0.5)
    rate = align(Series(t, values), clock).values
    both = np.isfinite(rate) & np.isfinite(turning)
    return correlation(rate[both], turning[both])


def _batteries(fields: BagFields, recording: Recording) -> Choice:
    """Return current and voltage of all batteries together, and say which count."""
    every = [one for one in fields.of_type(_BATTERY) if {"voltage", "current"} <= set(one)]
    packs = [one for one in every if _varies(recording, one["current"])]
    if len(packs) < 2:
        return Choice(dict((packs or every or [{}])[0]), ())
    clock = recording.series(packs[0]["current"]).t
    amps = [align(_known(recording.series(one["current"])), clock).values for one in packs]
    volts = [float(np.nanmedian(recording.series(one["voltage"]).values)) for one in packs]
    names = [one["current"].topic for one in packs]
    amps = [-one if np.nansum(one) < 0 < np.nansum(amps[0]) or np.nansum(amps[0]) < 0
            < np.nansum(one) else one for one in amps]  # fmt: skip
    notes: list[str] = []
    for k in range(len(packs)):
        others = [j for j in range(len(packs)) if j != k]
        if len(others) > 1 and _apart_by(amps[k], np.sum([amps[j] for j in others], axis=0)) < 0.05:
            listed = " and ".join(names[j] for j in others)
            notes.append(f"the current of {names[k]} is the sum of {listed}; it counts alone")
            return Choice(packs[k], tuple(notes))
    for k in range(1, len(packs)):
        alike = re.sub(r"\d+", "0", names[k]) == re.sub(r"\d+", "0", names[0])
        if not alike and _apart_by(amps[k], amps[0]) < _ONE_BATTERY:
            raise DriveLogError(
                f"{recording.name}: {names[0]} and {names[k]} may be two batteries, or one that is "
                f"measured twice: say --columns 'current={names[0]}.current[-A]' for one, or "
                f"--columns 'current={names[0]}.current+{names[k]}.current[-A]' for two"
            )
    first = packs[0]
    # A share of the power is a share of the current at the first one's voltage.
    ratio = [volt / volts[0] if min(volt, volts[0]) > 0 else 1.0 for volt in volts]
    sums = [float(np.nansum(recording.series(one["current"]).values)) for one in packs]
    weights = tuple(
        float(
            (np.sign(total * np.nansum(amp)) or 1.0) * (1.0 if abs(r - 1) < 0.03 else round(r, 4))
        )
        for total, amp, r in zip(sums, amps, ratio, strict=True)
    )
    plus = tuple(f"/{name.strip('/')}.current" for name in names[1:])
    first |= {"current": first["current"].model_copy(
        update={"plus": plus, "weights": () if set(weights) == {1.0} else weights})}  # fmt: skip
    notes.append(f"the current counts {' and '.join(names)}")
    return Choice(first, tuple(notes))


def _usable(t: FloatArray, values: FloatArray) -> NDArray[np.bool_]:
    """Tell which readings are numbers, and later than the number before."""
    usable = np.isfinite(values)
    rows = np.flatnonzero(usable)
    usable[rows[1:][np.diff(t[rows]) <= 0]] = False
    return usable


def _known(series: Series) -> Series:
    known = _usable(*series)
    return Series(series.t[known], series.values[known])


def _apart_by(one: FloatArray, other: FloatArray) -> float:
    """Return the difference of two readings, as a share of the second."""
    both = np.isfinite(one) & np.isfinite(other)
    size = float(np.sqrt(np.mean(other[both] ** 2))) if np.any(both) else 0.0
    return float(np.sqrt(np.mean((one - other)[both] ** 2))) / size if size > 0 else inf


def wanted(fields: BagFields, given: Sources, track: float) -> list[Column]:
    """Return all the fields among which `choose` chooses."""
    every = [fields.named(), given, *fields.treads(track)]
    for kind in _MEANING:
        every += fields.of_type(kind)
    found = [column for one in every for column in one.values()]
    return [*found, *_of_imus(fields, "yaw_rate", (*_LYING, "yaw(orientation)"))]
