"""Drive logs from ROS 1 and ROS 2 bags and MCAP files, and what serves as which channel."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import struct
import tempfile
import zlib
from array import array
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache
from importlib import import_module
from math import atan2, nan
from pathlib import Path
from types import MappingProxyType, SimpleNamespace, TracebackType
from typing import Annotated, Any, BinaryIO, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from energyplan.errors import (
    ConfigError,
    DriveLogError,
    EnergyPlanError,
    MissingDependencyError,
    UnknownNameError,
)
from energyplan.io.documents import Checked, Document, Loc, load
from energyplan.io.files import is_file
from energyplan.logs import DriveLog
from energyplan.logs.align import AS_LOGGED, Series, align
from energyplan.logs.clean import SetAside
from energyplan.logs.guess import guess, side_of, words

_FIELD = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)\s*(?:\[([^\[\]]+)\])?\Z")


_FIELDS = "write a field such as angular_velocity.z, a.b[0], yaw(a.b) or a.b-0.25*c.d"


class _Place(NamedTuple):
    """Where in a message a value stands."""

    parts: tuple[str, ...]
    element: str | None
    heading: bool


_TERM = re.compile(
    r"\s*([-+]?)\s*(?:(\d+\.?\d*(?:[eE][-+]?\d+)?)\s*\*)?\s*([^-+*\[]+(?:\[[^\]]*\])?\)?)"
)


@lru_cache(maxsize=256)
def _parse(formula: str) -> tuple[tuple[float, _Place], ...]:
    """Read a field, or a sum of fields with factors such as ``a.b-0.25*c.d``."""
    terms: list[tuple[float, _Place]] = []
    at = 0
    while at < len(formula.rstrip()):
        match = _TERM.match(formula, at)
        if match is None or (terms and not match[1]):
            raise ValueError(_FIELDS)
        weight = float(match[2] or 1.0)
        terms.append((-weight if match[1] == "-" else weight, _place(match[3])))
        at = match.end()
    if not terms:
        raise ValueError(_FIELDS)
    return tuple(terms)


def _place(field: str) -> _Place:
    text = field.strip()
    heading = text.startswith("yaw(") and text.endswith(")")
    match = _FIELD.match(text[4:-1].strip() if heading else text)
    if match is None:
        raise ValueError(_FIELDS)
    return _Place(tuple(match[1].split(".")), match[2], heading)


def _read(message: Any, field: str) -> float:
    """Return a number from a message; NaN where there is none."""
    return sum(weight * _number(message, place) for weight, place in _parse(field))


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
        names = getattr(message, "name", ())
        wanted = place.element.split("|")
        index = [k for k, name in enumerate(names) if any(fnmatchcase(name, w) for w in wanted)]
    found = [float(value[k]) for k in index if k < len(value)]
    return sum(found) / len(found) if found else nan


class TopicSource(Checked, BaseModel):
    """A message field that serves as a channel."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str  # topic
    field: str  # field of the message, such as ``angular_velocity.z``
    scale: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    times: str | None = None  # A further field of the same message to multiply by

    @field_validator("field", "times")
    @classmethod
    def _readable(cls, text: str | None) -> str | None:
        if text is not None:
            _parse(text)
        return text

    def matches(self, topic: str) -> bool:
        """Tell whether a bag's topic is meant."""
        wanted = self.topic.strip("/")
        return topic.strip("/") == wanted or topic.endswith(f"/{wanted}")

    def value(self, message: Any) -> float:
        """Return the channel's value from a message; NaN where the field holds none."""
        found = self.scale * _read(message, self.field)
        return found if self.times is None else found * _read(message, self.times)


class TopicMap(BaseModel):
    """Sources of each channel, the preferred one first."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["topics"] = "topics"  # what a YAML file of a topic map says it is
    name: str = "topics"  # what to call it
    channels: dict[str, list[TopicSource]]  # the sources by channel

    @field_validator("channels", mode="before")
    @classmethod
    def _lists(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {key: item if isinstance(item, list) else [item] for key, item in value.items()}

    @classmethod
    def read(cls, source: str | Path) -> TopicMap:
        """Return a ready-made map (``husky``, ``jackal``, ``warthog``) or one from a YAML file.

        A project's file is read for the topic map that it holds.
        """
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


_DEEPEST = 6
_LONGEST = 16  # elements of an array that are looked at
_SIDES = ("v_left", "v_right")
_ROLLING = {"wheel", "wheels", "track", "tread", "drivewhl", "drive", "whl"}


class Number(NamedTuple):
    """A number of a message: its topic, the message's type, the field, and a name for it."""

    topic: str
    type: str
    field: str
    label: str


@dataclass(frozen=True)
class BagFields:
    """Fields of a bag's messages that hold numbers, by a name that tells topic and field."""

    fields: dict[str, Number]

    def names(self) -> list[str]:
        """Return the fields' names."""
        return list(self.fields)

    def channels(self) -> dict[str, list[Number]]:
        """Guess the fields that make each channel; two of them are multiplied."""
        found: dict[str, list[Number]] = {}
        for rule in (self._typed, self._named):
            for channel, sources in rule().items():
                found.setdefault(channel, sources)
        if {"voltage", "current"} <= set(self._typed()):
            found.pop("power", None)  # a battery's own readings are surer than a name
        if {"p_left", "p_right"} & set(found) and not {"p_left", "p_right"} <= set(found):
            found = {k: v for k, v in found.items() if k not in ("p_left", "p_right")}
        return found

    def twist(self, track: float) -> dict[str, list[Number]]:
        """Return tread speeds made from speed and turn rate of the body, of a track [m]."""
        for one in self.fields.values():
            ahead, turn = "twist.twist.linear.x", "twist.twist.angular.z"
            if one.type == "nav_msgs/msg/Odometry" and one.field == ahead:
                return {
                    channel: [one._replace(field=f"{ahead}{sign}{0.5 * track:.6g}*{turn}",
                                           label=f"{one.topic}.twist")]
                    for channel, sign in (("v_left", "-"), ("v_right", "+"))
                }  # fmt: skip
        return {}

    def _typed(self) -> dict[str, list[Number]]:
        """Channels of the message types that ROS gives a meaning."""
        found: dict[str, list[Number]] = {}
        meaning = {
            ("sensor_msgs/msg/BatteryState", "voltage"): "voltage",
            ("sensor_msgs/msg/BatteryState", "current"): "current",
            ("sensor_msgs/msg/Imu", "angular_velocity.z"): "yaw_rate",
            ("sensor_msgs/msg/Imu", "linear_acceleration.x"): "accel_x",
            ("nav_msgs/msg/Odometry", "pose.pose.position.x"): "x",
            ("nav_msgs/msg/Odometry", "pose.pose.position.y"): "y",
            ("nav_msgs/msg/Odometry", "yaw(pose.pose.orientation)"): "yaw",
            ("geometry_msgs/msg/PoseStamped", "pose.position.x"): "x",
            ("geometry_msgs/msg/PoseStamped", "pose.position.y"): "y",
            ("geometry_msgs/msg/PoseStamped", "yaw(pose.orientation)"): "yaw",
        }
        for one in self.fields.values():
            channel = meaning.get((one.type, one.field))
            if channel is not None:
                found.setdefault(channel, [one])
            if one.type == "sensor_msgs/msg/JointState" and one.field.startswith("velocity["):
                side = side_of(one.label)
                if side:
                    found.setdefault(f"v_{side}", []).append(one)
        for channel in _SIDES:
            # Arms and steering have joints, too.
            rolling = [one for one in found.get(channel, []) if _ROLLING & set(words(one.label))]
            if rolling:
                found[channel] = rolling
        return found

    def _named(self) -> dict[str, list[Number]]:
        """Channels that the names of topics and fields tell."""
        others = [
            label
            for label, one in self.fields.items()
            if one.type not in ("sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry")
        ]
        guesses = guess(others)
        found = {channel: [self.fields[one.name]] for channel, one in guesses.items()}
        for side in ("left", "right"):
            current = found.pop(f"current_{side}", None)
            voltage = found.pop(f"voltage_{side}", None)
            if f"p_{side}" in found or current is None:
                continue
            if voltage is not None and voltage[0].topic == current[0].topic:
                found[f"p_{side}"] = [current[0], voltage[0]]
        found.pop("t", None)
        return found

    def wheel_rates(self, sources: dict[str, list[Number]]) -> bool:
        """Tell whether the tread speeds are rates of joints, which take a wheel radius."""
        first = sources["v_left"][0]
        said = set(words(first.label))
        return first.type == "sensor_msgs/msg/JointState" or bool(
            said & {"rate", "omega", "angular", "rpm", "joint"}
        )

    def topic_map(self, sources: dict[str, list[Number]], radius: float, name: str) -> TopicMap:
        """Return the topic map that reads these fields."""
        channels: dict[str, list[dict[str, Any]]] = {}
        for channel, fields in sources.items():
            first = fields[0]
            entry: dict[str, Any] = {"topic": first.topic, "field": first.field}
            if channel in _SIDES:
                if first.type == "sensor_msgs/msg/JointState" and len(fields) > 1:
                    joints = (one.field.removeprefix("velocity[")[:-1] for one in fields)
                    entry["field"] = f"velocity[{'|'.join(joints)}]"
                if radius != 1.0:
                    entry["scale"] = radius
            elif len(fields) == 2:
                entry["times"] = fields[1].field
            if channel == "current" and first.type == "sensor_msgs/msg/BatteryState":
                entry["scale"] = -1.0
            channels[channel] = [entry]
        return TopicMap.model_validate({"name": name, "channels": channels})


def bag_fields(path: str | Path) -> BagFields:
    """List the numbers in the first message of each topic of a bag."""
    fields: dict[str, Number] = {}
    with opened_bag(Path(path)) as reader:
        for name, topic in sorted(reader.topics.items()):
            connections = [one for one in reader.connections if one.topic == name]
            first = next(reader.messages(connections=connections), None)
            if first is None:
                continue
            connection, _, raw = first
            message = reader.deserialize(raw, connection.msgtype)
            for field in _numbers(message, "", 0):
                label = re.sub(r"[\[\]()]+", ".", f"{name}.{field}").strip("/.")
                fields[label] = Number(name, str(topic.msgtype), field, label)
    return BagFields(fields)


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


LARGEST = 1 << 28
"""Most that a part of a bag holds when unpacked [bytes]. Recorders end a part after a few MiB, and
no message is as large."""
LARGEST_RATIO = 1000
"""Most that a file grows which is compressed as a whole; what sensors see does not repeat so."""


def unpacked(make: Callable[[], Any], data: bytes, most: int = LARGEST) -> bytes:
    """Unpack a compressed part of a bag."""
    most = min(most, LARGEST)
    parts: list[bytes] = []
    while data or not parts:
        one = make()
        try:
            part = one.decompress(data, max_length=most - sum(map(len, parts)) + 1)
        except (OSError, EOFError, RuntimeError, _zstd_error()) as problem:
            raise ValueError(f"a compressed part is damaged ({problem})") from None
        parts.append(part)
        if sum(map(len, parts)) > most:
            raise ValueError(f"a compressed part holds more than the {most} bytes it may hold")
        if not one.eof:
            raise ValueError("a compressed part ends early")
        data = one.unused_data or b""
    return b"".join(parts)


class UnpackedFile:
    """A compressed file as it is unpacked, with an end to its size."""

    def __init__(self, stream: BinaryIO, most: int) -> None:
        self._stream, self._left = stream, most

    def __enter__(self) -> UnpackedFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stream.close()

    def read(self, size: int) -> bytes:
        """Return the next bytes, at most so many."""
        try:
            data = self._stream.read(size)
        except _zstd_error() as problem:
            raise ValueError(f"a compressed file is damaged ({problem})") from None
        self._left -= len(data)
        if self._left < 0:
            raise ValueError("a compressed file is too large when unpacked, for a bag or this disk")
        return data


def bound_unpacking() -> None:
    """Have rosbags unpack by `unpacked`, in the whole process; doing so again changes nothing."""
    zstd = _zstd()
    lz4 = import_module("lz4.frame")
    mcap = import_module("rosbags.rosbag2.storage_mcap")
    makers = {"lz4": lz4.LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor}
    for name, make in makers.items():
        mcap.DECOMPRESSORS[name] = lambda data, size, make=make: unpacked(make, data, size)
    first = import_module("rosbags.rosbag1.reader")
    for name, make in {"lz4": makers["lz4"], "bz2": BZ2Decompressor}.items():
        first.decompressors[name] = lambda data, make=make: unpacked(make, data)

    def unpacked_file(stream: BinaryIO, mode: str) -> UnpackedFile:
        most = LARGEST_RATIO * os.fstat(stream.fileno()).st_size
        free = shutil.disk_usage(tempfile.gettempdir()).free
        return UnpackedFile(zstd.open(stream, mode), min(most, free // 2))

    second: Any = import_module("rosbags.rosbag2.reader")
    second.zstd = SimpleNamespace(
        open=unpacked_file, decompress=lambda data: unpacked(zstd.ZstdDecompressor, data)
    )


def _zstd() -> Any:
    """Return the module of Zstandard that rosbags brings along."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")


def _zstd_error() -> type[Exception]:
    error: type[Exception] = _zstd().ZstdError
    return error
