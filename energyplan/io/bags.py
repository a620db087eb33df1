"""Drive logs from ROS 1 and ROS 2 bags and MCAP files, and what serves as which channel."""

from __future__ import annotations

import re
import sqlite3
import struct
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from importlib import import_module
from itertools import islice, product
from math import atan2, inf, isfinite, nan
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import quote

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, field_validator

from energyplan.errors import (
    ConfigError,
    DriveLogError,
    EnergyPlanError,
    UnknownNameError,
    needs_extra,
)
from energyplan.io.documents import Document, Loc, load
from energyplan.io.files import is_file, is_folder
from energyplan.logs.align import Series, align, derivative, find_runs, usable
from energyplan.logs.consistency import correlation
from energyplan.logs.guess import side_of, words
from energyplan.logs.mapping import (
    COUNTS,
    TOTAL,
    Column,
    formula,
    split_unit,
)
from energyplan.logs.tables import Recording, of_messages, other_kind
from energyplan.path import FloatArray
from energyplan.units import RATES

_WORD, _MIDDLE = r"[A-Za-z_]\w*", r"(?:\[[\w/-]+\]\.)"
_FIELD = re.compile(rf"({_WORD}(?:(?:\.|{_MIDDLE}){_WORD})*)\s*(?:\[([^\[\]]+)\])?\Z")
_NAME = (
    r"(?:/[\w/]+\.)?(?:yaw\([\w.\s]+\)"
    rf"|[A-Za-z_][\w.]*(?:{_MIDDLE}[\w.]+)*(?:\s*\[[^\[\]]+\])?)"
)


_FIELDS = "write a field such as angular_velocity.z, a.b[0], yaw(a.b) or a.b-0.25*c.d"


def _apart(name: str) -> tuple[str, str]:
    """Split a field of another topic, such as ``/battery_2.current``; the topic may be empty."""
    topic, _, field = name.partition(".") if name.startswith("/") else ("", "", name)
    return topic, field


class _Place(NamedTuple):
    """Where in a message a value stands."""

    parts: tuple[str, ...]  # fields; of arrays of messages, elements begin with a bracket
    element: str | None
    heading: bool


@lru_cache(maxsize=256)
def _place(field: str) -> _Place:
    text = _apart(field.strip())[1]
    heading = text.startswith("yaw(") and text.endswith(")")
    match = _FIELD.match(text[4:-1].strip() if heading else text)
    if match is None:
        raise ValueError(_FIELDS)
    parts = re.findall(r"\[[^\]]+|\w+", match[1])
    return _Place(tuple(parts), match[2], heading)


def _number(message: Any, place: _Place) -> float:
    value, holder = message, message
    for part in place.parts:
        if part.startswith("["):
            labels = [*map(str, range(len(value)))] if value is not None else []
            labels = labels if part[1:].isdecimal() else _joints(message)
            place_of = labels.index(part[1:]) if part[1:] in labels else -1
            value = value[place_of] if value is not None and 0 <= place_of < len(value) else None
        else:
            holder, value = value, getattr(value, part, None)
    if value is None:
        return nan
    if place.heading:
        return heading(value)
    if place.element is None:
        return float(value)
    if place.element.isdecimal():
        index = [int(place.element)]
    else:
        names = _joints(holder) or _joints(message)
        wanted = place.element.split("|")
        index = [k for k, name in enumerate(names) if any(fnmatchcase(name, w) for w in wanted)]
    found = [float(value[k]) for k in index if k < len(value)]
    return sum(found) / len(found) if found else nan


def heading(turn: Any) -> float:
    """Return the yaw of a quaternion [rad]."""
    sine = 2 * (turn.w * turn.z + turn.x * turn.y)
    return atan2(sine, 1 - 2 * (turn.y**2 + turn.z**2))


def _joints(message: Any) -> list[str]:
    """Return the names of what a message holds an array of."""
    for key in ("name", "joint_names", "interface_names"):
        names = getattr(message, key, None)
        if names is not None and not isinstance(names, str):
            return [str(name) for name in names]
    return []


def _readable(column: Column) -> Column:
    """Return a message's field, or a sum of fields with factors, as what serves as a channel."""
    if not column.topic:
        raise ValueError(f"give the topic of {column.field}")
    if column.times is not None:
        _place(column.times)
    added = column.model_copy(update={"times": None})
    result = formula(added.written if column.plus else column.field, _NAME)
    if result is None or result.times is not None:
        raise ValueError(_FIELDS)
    for name in (*result.names, *filter(None, result.each)):
        _place(name)
    first, *rest = result.names
    return column.model_copy(
        update={"field": first, "plus": tuple(rest), "weights": result.weights,
                "each": result.each}
    )  # fmt: skip


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
        """Return a preset map (``husky``, ``jackal``, ``warthog``) or one from a YAML file."""
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


_FURTHER = """\
voltage  platform/bms/state|battery_state           voltage
current  platform/bms/state|battery_state           current                      *-1.0
yaw_rate sensors/imu_0/data|imu/data                angular_velocity.z
accel_x  sensors/imu_0/data|imu/data                linear_acceleration.x
x        platform/odom/filtered|odometry/filtered   pose.pose.position.x
y        platform/odom/filtered|odometry/filtered   pose.pose.position.y
yaw      platform/odom/filtered|odometry/filtered   yaw(pose.pose.orientation)
"""
"""Channel, topics, field and unit; the current of a BatteryState is negative when discharging."""
_CLEARPATH: dict[str, tuple[float, dict[str, tuple[int, int]]]] = {
    "husky": (0.1651, {"p_left": (1, 1), "p_right": (2, 2)}),
    "jackal": (0.098, {"power": (0, 2)}),
    "warthog": (0.3, {"power": (0, 0)}),
}
"""Wheel radius [m], and which voltage and current of the power message make which power."""


def _clearpath(name: str) -> TopicMap:
    """Return the topic map of one of Clearpath's robots."""
    radius, powers = _CLEARPATH[name]
    joints = "platform/joint_states|joint_states"
    wheels = (f"v_{side} {joints} velocity[*{side}*] *{radius}" for side in ("left", "right"))
    found: dict[str, list[dict[str, Any]]] = {}
    for channel, topics, field, *unit in map(str.split, (*wheels, *_FURTHER.splitlines())):
        found[channel] = [
            {"topic": topic, "field": field, "unit": "".join(unit)} for topic in topics.split("|")
        ]
    for channel, (voltage, current) in powers.items():
        side = channel.removeprefix("p_")
        drivers = ("husky/status", "status") if side != channel else ()
        found[channel] = [
            *({"topic": topic, "field": f"{side}_driver_current", "times": f"{side}_driver_voltage"}
              for topic in drivers),
            {"topic": "platform/mcu/status/power", "field": f"measured_currents[{current}]",
             "times": f"measured_voltages[{voltage}]"},
        ]  # fmt: skip
    return TopicMap.model_validate({"name": name, "channels": found})


TOPIC_MAPS = {name: _clearpath(name) for name in _CLEARPATH}
"""Preset topic maps of Clearpath robots, ROS 1 and ROS 2."""

_PRESETS = {"husky_a200": "husky", "jackal": "jackal", "warthog": "warthog"}


def topic_map_of(vehicle: str) -> str | None:
    """Return the name of the preset topic map of a vehicle preset, if it has one."""
    return _PRESETS.get(vehicle.partition(":")[0])


BAG_SUFFIXES = (".bag", ".mcap", ".db3")
"""Kinds of file that are read as bags, in addition to folders with a ``metadata.yaml``."""


class BagLimits(NamedTuple):
    """What is read of a bag, and what its fields must show."""

    skew: float = 5.0  # median difference of stamp and arrival: beyond, stamps are not believed [s]
    message: int = 1 << 16  # bytes; larger ones are images and the like
    metadata: int = 1 << 23  # bytes; a topic takes a few hundred
    deepest: int = 6
    least: int = 20  # least number of values of a field from which anything follows
    one_battery: float = 0.1  # relative difference up to which two sensors may show one battery
    turn_rate: float = 0.7  # correlation from which a turn rate is the robot's


_BAG = BagLimits()
_MAGIC = {".bag": b"#ROSBAG V2.0\n", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3"}
_LARGEST_CHUNK = 1 << 26  # bytes; ROS makes them of 768 kB, or of one larger message
# What the packages that read bags raise when the bytes make no sense to them.
_UNSOUND = (
    AssertionError, AttributeError, EOFError, IndexError, KeyError, MemoryError, OSError,
    OverflowError, RecursionError, StopIteration, SyntaxError, TypeError, ValueError,
    struct.error, zlib.error,
)  # fmt: skip


def is_bag(path: str | Path) -> bool:
    """Return whether a path is a bag, by its suffix or its metadata."""
    file = Path(path)
    return file.suffix.lower() in BAG_SUFFIXES or is_file(file / "metadata.yaml")


def read_bag(
    path: str | Path,
    wanted: Callable[[str], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read all numbers of a bag's messages in one pass; of some topics, or all but images."""
    file = Path(path)
    with opened_bag(file) as bag:
        topics: dict[str, _Topic] = {}
        start, span = bag.start, max(bag.duration, 1)
        connections = [
            one for one in bag.connections
            if (bag.is_small(one) if wanted is None else wanted(one.topic))
        ]  # fmt: skip
        for number, (connection, arrival, raw) in enumerate(bag.messages(connections)):
            name = connection.topic
            topic = topics.setdefault(name, _Topic())
            if name not in bag.lost:
                try:
                    topic.add(bag.deserialize(raw, connection.msgtype), arrival)
                except _UNSOUND as problem:
                    if len(topic.arrivals):
                        raise
                    bag.lost[name] = f"its messages cannot be read: {said(problem)}"
            if progress is not None and number % 1000 == 0:
                progress((arrival - start) / span)
        if progress is not None:
            progress(1.0)
        kinds = {name: bag.topics[name] for name in sorted(bag.topics) if name not in bag.lost}
        notes = {topic: f"{topic} is left out: {why}" for topic, why in bag.lost.items()}
    series: dict[str, Mapping[str, FloatArray]] = {}
    clocks: dict[str, FloatArray] = {}
    for name in (name for name in kinds if name in topics):
        clock = topics[name].clock(start)
        if clock.t is clock.values:
            notes[name] = f"{name} carries no stamp to believe; its messages count at arrival"
        clocks[name] = clock.t
        series[name] = {
            field: np.append(values, np.full(len(clock.t) - len(values), nan))
            for field, values in topics[name].columns.items()
        }
    return of_messages(file.name, series, clocks, kinds, notes)


class _Topic:
    """The numbers of a topic's messages, as these come."""

    def __init__(self) -> None:
        self.stamps, self.arrivals = array("q"), array("q")  # [ns]
        self.columns: dict[str, array[float]] = {}
        self._fields: list[tuple[str, Callable[[Any], Any]]] = []

    def add(self, message: Any, arrival: int) -> None:
        """Keep the numbers of a message; what other messages alone hold is nan in it."""
        row = len(self.arrivals)
        if not row:
            self._fields = [(name, attrgetter(name)) for name in _leaves(message)]
        header = getattr(message, "header", None)
        stamp = 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        self.stamps.append(stamp)
        self.arrivals.append(arrival)
        names = _joints(message)
        for name, value_of in self._fields:
            value = value_of(message)
            if isinstance(value, int | float):
                self._keep(name, value, row)
            elif hasattr(value, "w"):
                self._keep(f"yaw({name})", heading(value), row)
            elif len(value) and (hasattr(value, "dtype") or isinstance(value[0], int | float)):
                named = len(names) == len(value)
                if named or len(value) <= LONGEST:
                    for k, one in enumerate(value):
                        self._keep(f"{name}[{names[k] if named else k}]", float(one), row)
            elif 0 < len(value) <= LONGEST and hasattr(value[0], "__dataclass_fields__"):
                self._keep_parts(name, names, value, row)

    def _keep_parts(self, name: str, names: Sequence[str], parts: Sequence[Any], row: int) -> None:
        """Keep the numbers of an array of messages, such as a driver's for each wheel."""
        for k, part in enumerate(parts):
            label = names[k] if len(names) == len(parts) else k
            inner = _joints(part)
            for field in _leaves(part):
                value, whole = attrgetter(field)(part), f"{name}[{label}].{field}"
                if isinstance(value, int | float):
                    self._keep(whole, value, row)
                elif 0 < len(value) <= LONGEST and isinstance(value[0], int | float | np.number):
                    for j, one in enumerate(value):
                        kind = inner[j] if len(inner) == len(value) else j
                        self._keep(f"{whole}[{kind}]", float(one), row)

    def _keep(self, field: str, value: float, row: int) -> None:
        column = self.columns.setdefault(field, array("d"))
        if len(column) <= row:
            column.extend([nan] * (row - len(column)))
            column.append(value)

    def clock(self, start: int) -> Series:
        """Return when each message was sent since the start of the bag [ns], and arrived [s].

        Stamps far from the arrival are not believed.
        """
        stamps, arrivals = (np.array(part, np.int64) for part in (self.stamps, self.arrivals))
        t, arrived = (np.asarray((part - start) * 1e-9) for part in (stamps, arrivals))
        skew = np.abs(t - arrived)
        stamped = bool(np.all(stamps)) and np.median(skew) <= _BAG.skew
        return Series(t if stamped else arrived, arrived)


def _leaves(message: Any, prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Yield the fields of a message that hold numbers, orientations or arrays."""
    for key in getattr(message, "__dataclass_fields__", {}) if depth <= _BAG.deepest else ():
        value, field = getattr(message, key, None), f"{prefix}{key}"
        if key.startswith("__") or key == "header" or "covariance" in key or key.isupper():
            continue
        if isinstance(value, bool | str | bytes) or value is None:
            continue
        if isinstance(value, int | float) or (hasattr(value, "w") and hasattr(value, "z")):
            yield field
        elif hasattr(value, "__dataclass_fields__"):
            yield from _leaves(value, f"{field}.", depth + 1)
        elif hasattr(value, "__len__"):
            yield field


NO_TOPICS = (
    "the robot, and so the radius of its wheels, is not known; give "
    f"topics={' or '.join(repr(name) for name in TOPIC_MAPS)}, or a topic map of your own: "
    "energyplan start {} --wheel-radius M --out PROJECT.yaml writes one"
)
"""What to say of a bag without a topic map."""


def topic_map(topics: TopicMap | str | Path) -> TopicMap:
    """Return a topic map, by its name or file too."""
    return topics if isinstance(topics, TopicMap) else TopicMap.read(topics)


def columns_of(recording: Recording, mapping: TopicMap) -> dict[str, Column]:
    """Return which series of a bag serve as which channels, by a topic map."""
    chosen = held_of(recording, mapping)
    for channel in _SIDES:
        if channel not in chosen:
            there = ", ".join(sorted(recording.kinds)) or "none"
            raise DriveLogError(
                f"{recording.source}: no topic serves as {channel} in the topic map "
                f"{mapping.name!r}; the bag has {there}; write a topic map of your own"
            )
    return chosen


def held_of(recording: Recording, mapping: TopicMap) -> dict[str, Column]:
    """Return those channels of a topic map that a bag holds.

    Of several sources of a channel the first that the bag holds, of several topics the shortest.
    """

    def named(topic: str) -> str | None:
        meant = Column(topic=topic, field="data")
        return min((one for one in recording.kinds if meant.matches(one)), key=len, default=None)

    def moved(name: str) -> str:
        topic, field = _apart(name)
        return f"/{(named(topic) or topic).strip('/')}.{field}" if topic else name

    chosen: dict[str, Column] = {}
    for channel, sources in mapping.channels.items():
        for one in sources:
            topic = named(one.topic) or one.topic
            column = one.renamed(moved, topic=topic).joined()
            if all(map(recording.elements, column.names)):
                chosen[channel] = column
                break
    return chosen


def topics_of(recording: Recording, columns: Mapping[str, Column], name: str) -> TopicMap:
    """Return the topic map that reads these series, of messages as they come, too."""
    known = dict(recording.written)

    def written(series: str, of: str = "") -> str:
        topic, field = _apart(known.get(series, series))
        return field if topic == of else f"{topic}.{field}"

    channels = {}
    for channel, one in columns.items():
        topic = _apart(known.get(one.field, one.field))[0]
        channels[channel] = [one.renamed(partial(written, of=topic), topic=topic)]
    return TopicMap(name=name, channels=channels)


class Bag:
    """An open bag. Topics whose messages cannot be read are left out, and said."""

    def __init__(self, name: str, reader: Any, stores: Sequence[Any], lost: dict[str, str]) -> None:
        self.name, self._reader, self._stores, self.lost = name, reader, stores, lost
        self.connections = [c for c in reader.connections if c.topic not in lost]
        self.topics = {c.topic: str(c.msgtype) for c in self.connections}
        self.start, self.duration = reader.start_time, reader.duration  # [ns]

    def messages(self, connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time of arrival [ns] and bytes of messages; of none, nothing."""
        return iter(self._reader.messages(connections=connections) if connections else ())

    def is_small(self, connection: Any) -> bool:
        """Return whether these may be readings and no images, by the first message."""
        return all(len(raw) <= _BAG.message for _, _, raw in islice(
            self.messages([connection]), 1))  # fmt: skip

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """Return a message."""
        store = next((one for one in self._stores if kind in one.types), self._stores[-1])
        first = not hasattr(self._reader, "ros_distro")
        return (store.deserialize_ros1 if first else store.deserialize_cdr)(raw, kind)


@contextmanager
def opened_bag(file: Path, definitions: Mapping[str, str] = MappingProxyType({})) -> Iterator[Bag]:
    """Open a bag; what goes wrong inside it becomes a named error."""
    with needs_extra("bags", f"reading {file}"):
        from rosbags import rosbag1, rosbag2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    unsound: tuple[type[Exception], ...] = (
        *_UNSOUND, *_database_errors(), SerdeError, TypesysError, rosbag1.ReaderError,
        rosbag2.ReaderError, RuntimeError, _zstd().ZstdError,
    )  # fmt: skip
    try:
        _check_beginning(file)
        first = file.suffix.lower() == ".bag"
        own = get_typestore(Stores.EMPTY)
        # Bags of ROS 2 before Iron do not carry their message definitions.
        stock = get_typestore(Stores.EMPTY if first else Stores.ROS2_HUMBLE)
        for kind, text in definitions.items():
            stock.register(get_types_from_msg(text, kind))
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
                    if one.msgtype not in own.types and one.msgtype in stock.types:
                        _check_digest(stock, one)
                except unsound as problem:
                    lost[one.topic] = f"its type {one.msgtype} cannot be read: {said(problem)}"
                if one.msgtype not in own.types and one.msgtype not in stock.types:
                    lost.setdefault(
                        one.topic, f"the bag does not hold the definition of {one.msgtype}; record "
                        "it where its package is installed, or republish it as a type of ROS"
                    )  # fmt: skip
            yield Bag(file.name, reader, (own, stock), lost)
    except EnergyPlanError:
        raise
    except unsound as problem:
        if kind := _database_kind(file):
            raise DriveLogError(f"{file} {kind}") from None
        encoding = _encoding(file)
        if encoding:
            raise DriveLogError(
                f"{file} holds messages in {encoding}, not in CDR as ROS 2 writes them: export "
                "the topics as one CSV, as PlotJuggler does, or several, and give a.csv+b.csv"
            ) from None
        raise DriveLogError(
            f"{file} is no sound bag: {said(problem)}; copy it again, or mend one that was cut by "
            "rosbag reindex, ros2 bag reindex or mcap recover"
        ) from None


def said(problem: Exception) -> str:
    """Return the first line of what an error says."""
    return (str(problem).splitlines() or [""])[0] or type(problem).__name__


def _define(store: Any, connection: Any) -> None:
    """Learn the type of a connection's messages, if the bag defines it."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    form, text = connection.msgdef
    if not text.strip():  # it was recorded where the definition was not installed
        return
    if form.name == "MSG":
        store.register(get_types_from_msg(text, connection.msgtype))
    elif form.name == "IDL":
        parts = re.split("^=+\nIDL: .*\n", text, flags=re.MULTILINE)
        for part in filter(str.strip, parts):
            store.register(get_types_from_idl(part))
    _check_digest(store, connection)


def _check_digest(store: Any, connection: Any) -> None:
    """Refuse a type that is not the one that a connection's messages were recorded with."""
    digest = str(connection.digest)
    if digest.startswith("RIHS") and store.hash_rihs01(connection.msgtype) != digest:
        raise ValueError("its definition is not the one that it was recorded with")


_ENCODINGS = {"json": "JSON", "protobuf": "Protobuf", "flatbuffer": "FlatBuffers", "cbor": "CBOR"}
"""Other encodings of messages in an MCAP file than that of ROS 2."""


def _database_kind(file: Path) -> str:
    """Say of an SQLite database why it alone is no bag; empty where it may be one."""
    if file.suffix.lower() != ".db3" or not is_file(file):
        return ""
    try:
        with closing(
            sqlite3.connect(f"file:{quote(str(file.resolve()))}?mode=ro", uri=True)
        ) as base:
            first = base.execute("select data from messages limit 1").fetchone()
    except sqlite3.OperationalError as problem:
        if "no such table" not in str(problem):
            return ""
        return (
            "is an SQLite database, and no bag: it has no table of messages; sqlite3 -header -csv "
            f"{file.name} 'select * from TABLE' > log.csv makes a table of it"
        )
    except (sqlite3.Error, UnicodeError):  # what is broken may not even be text
        return ""
    if first is not None and isinstance(first[0], bytes) and first[0][:4] == b"\x28\xb5\x2f\xfd":
        return (
            "holds messages that are compressed one by one, which its metadata.yaml alone says: "
            "give the folder with both"
        )
    return ""


def _encoding(file: Path) -> str:
    """Return the encoding of an MCAP file's messages where ROS 2 does not write it."""
    if is_folder(file):
        file = next(iter(sorted(file.glob("*.mcap"))), file)
    if file.suffix.lower() != ".mcap" or not is_file(file):
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
    mark = _MAGIC.get(file.suffix.lower())
    if mark is not None and file.is_file():
        with file.open("rb") as stream:
            sound = stream.read(len(mark)) == mark
        if not sound and (kind := other_kind(file)):
            raise DriveLogError(f"{file} is {kind}")
        if not sound and file.suffix.lower() == ".bag":
            raise ValueError("it does not begin as a ROS 1 bag does")
    metadata = file / "metadata.yaml"
    if is_file(metadata) and metadata.stat().st_size > _BAG.metadata:
        raise ValueError(f"its metadata.yaml is larger than {_BAG.metadata >> 20} MiB")


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


LONGEST = 64  # elements of an array without names that are looked at
_SIDES = ("v_left", "v_right")
_JOINTS, _IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
_MEANING = [
    (kind, {c: split_unit(field) for c, _, field in (part.partition("=") for part in parts)})
    for kind, *parts in map(str.split, """\
sensor_msgs/msg/BatteryState voltage=voltage current=current[-A]
BATTERY_STATUS               voltage=voltage[mV] current=current_battery[cA]
SYS_STATUS                   voltage=voltage_battery[mV] current=current_battery[cA]
battery_status               voltage=voltage_v current=current_a
BAT                          voltage=Volt current=Curr
CURR                         voltage=Volt current=Curr
sensor_msgs/msg/Imu          yaw_rate=angular_velocity.z accel_x=linear_acceleration.x
ATTITUDE                     yaw_rate=yawspeed[-rad/s]
vehicle_angular_velocity     yaw_rate=xyz.2[-rad/s]
IMU                          yaw_rate=GyrZ[-rad/s] accel_x=AccX
nav_msgs/msg/Odometry        x=pose.pose.position.x y=pose.pose.position.y \
yaw=yaw.pose.pose.orientation
geometry_msgs/msg/PoseStamped x=pose.position.x y=pose.position.y yaw=yaw.pose.orientation
vehicle_local_position       x=x y=y[-m] yaw=heading[-rad]
XKF1                         x=PN y=PE[-m] yaw=Yaw[-deg]
NKF1                         x=PN y=PE[-m] yaw=Yaw[-deg]
ATT                          yaw=Yaw[-deg]
ATTITUDE                     yaw=yaw[-rad]
LOCAL_POSITION_NED           x=x y=y[-m]
wheel_encoders               v_left=wheel_speed.1[rad/s] v_right=wheel_speed.0[rad/s]
WENC                         v_left=Dist0[ticks*1] v_right=Dist1[ticks*1]
WHEEL_DISTANCE               v_left=distance.0[ticks*1] v_right=distance.1[ticks*1]
nav_msgs/msg/Odometry        ahead=twist.twist.linear.x turn=twist.twist.angular.z
vehicle_local_position       ahead=ahead
THR                          ahead=Speed
GPS                          ahead=Spd
VFR_HUD                      ahead=groundspeed""".splitlines())
]  # fmt: skip
"""Which fields of types of messages, of ROS, MAVLink, PX4 and ArduPilot, are which channels.

Flight controllers count yaw clockwise and y to the east; ``ahead`` and ``turn`` make tread speeds.
"""
_ROLLING = {"wheel", "wheels", "track", "tread", "drivewhl", "drive", "whl"}

Sources = dict[str, Column]


class Typed(NamedTuple):
    """What message types show: channels whose units are known, rates of wheels, notes."""

    sources: Sources
    rates: Sources
    notes: tuple[str, ...]


def of_types(recording: Recording, given: Sources, named: Sources, track: float) -> Typed:
    """Choose among the topics of each type the one that goes with the treads, and say so."""
    treads = []
    if not {*_SIDES} & set(given):
        by_name = [named] if {*_SIDES} <= set(named) else []
        wheels = [*_joints_of_sides(recording), *_meant(recording, "v_left")]
        treads = [*wheels, *by_name, *_twists(recording, track)]
    moving = [one for one in treads if all(_varies(recording, column) for column in one.values())]
    speeds = next(iter(moving or treads), {})
    twisted = speeds is not named and bool(speeds) and not speeds["v_left"].unit
    found, notes = (dict(speeds) if twisted else {}), list[str]()
    if "current" in given:  # named by hand: its own topic's voltage goes with it
        own = _meant(recording, "voltage")
        own.sort(key=lambda one: _topic(one["voltage"]) != _topic(given["current"]))
        packs = Typed(own[0] if own else {}, {}, ())
    else:
        packs = _batteries(recording)
    if {"voltage", "current"} <= set(packs.sources):
        found |= packs.sources
        notes += packs.notes
    sides = speeds | {c: one for c, one in given.items() if c in _SIDES}
    if not {*_SIDES} <= set(sides):
        return Typed(found, {}, tuple(notes))
    left, right = (_series(recording, sides[name]) for name in _SIDES)
    turning = align(usable(right), left.t).values - left.values
    rated = {
        name: [
            (_alike(recording, one[name], left.t, turning), one) for one in _meant(recording, name)
            if any(_varies(recording, column) for column in one.values())
        ]
        for name in ("yaw_rate", "yaw")
    }  # fmt: skip
    if not rated["yaw"]:
        rated["yaw"] = [
            (alike, {"yaw": one}) for one in _of_imus(recording, "yaw", ["yaw.orientation"])
            if abs(alike := _alike(recording, one, left.t, turning)) > _BAG.turn_rate
        ]  # fmt: skip
    if all(
        abs(alike) < _BAG.turn_rate for alike, _ in rated["yaw_rate"]
    ):  # as of a camera's, on its side
        turned = [
            (_alike(recording, one, left.t, turning), one)
            for one in _of_imus(recording, "yaw_rate", _LYING)
        ]
        rated["yaw_rate"] += [
            (abs(alike), {"yaw_rate": one if alike > 0 else one.negative()})
            for alike, one in turned if abs(alike) > _SURELY
        ]  # fmt: skip
    for name, several in rated.items():
        # What equals the treads' value to the last digit is computed from them, and shows no slip.
        several.sort(key=_preferred)
        if several:
            found |= several[0][1]
        if len(several) > 1:
            said = [f"{one[name].field} {r:.2f}" for r, one in several]
            notes.append(
                f"{name} is that of {several[0][1][name].field}, which goes with the treads best "
                f"(correlation {', '.join(said)})"
            )
    if "x" not in found:
        found |= next((one for one in _meant(recording, "x") if _varies(recording, one["x"])), {})
    if twisted:  # computed from the body's own turn rate
        found = {c: one for c, one in found.items() if c not in ("yaw", "yaw_rate")}
    return Typed(found, {} if twisted or speeds is named else speeds, tuple(notes))


def _topic(column: Column) -> str:
    return _apart(column.field)[0]


def _named(recording: Recording, topic: str) -> dict[str, str]:
    """Return the series of a topic's messages by the rest of their names."""
    start = f"/{topic.strip('/')}."
    return {n.removeprefix(start): n for n in recording.columns if n.startswith(start)}


def _meant(recording: Recording, wanted: str) -> list[Sources]:
    """Return the channels of each topic of a type whose fields include a channel."""
    found = []
    for kind, fields in _MEANING:
        for topic in (topic for topic, one in recording.kinds.items() if one == kind):
            names = _named(recording, topic) if wanted in fields else {}
            found.append({
                channel: Column(field=names[field], channel=channel, unit=unit)
                for channel, (field, unit) in fields.items() if field in names
            })  # fmt: skip
    return [one for one in found if wanted in one]


def untyped(recording: Recording) -> list[str]:
    """Return the series of messages whose types say nothing: their names do, those of ROS."""
    typed = (_JOINTS, *(kind for kind, _ in _MEANING))
    rates = electrical_rates(recording)
    return [
        name for topic, kind in recording.kinds.items() if kind not in typed and "/" in kind
        for name in _named(recording, topic).values() if name not in rates
    ]  # fmt: skip


_ELECTRICAL = {"VescState": "speed", "VescStateStamped": "state.speed", "VescStatus": "erpm",
               "ESCStatus": "esc.rpm"}  # fmt: skip
"""Fields of motor controllers' messages that count turns of the field, pole pairs times a turn."""


def electrical_rates(recording: Recording) -> list[str]:
    """Return the series that are motors' electrical rates, by the types of their messages."""
    return [
        name for topic, kind in recording.kinds.items()
        for field, name in _named(recording, topic).items()
        if field == _ELECTRICAL.get(kind.rpartition("/")[2])
    ]  # fmt: skip


def serving(recording: Recording, channel: str) -> list[str]:
    """Return the flight controllers' messages that hold a channel, in a log of one of these."""
    if not recording.kinds or any("/" in kind for kind in recording.kinds.values()):
        return []
    return [kind for kind, fields in _MEANING if channel in fields and "/" not in kind]


def _joints_of_sides(recording: Recording) -> list[Sources]:
    """Return what may be tread speeds: rates or angles of joints."""
    result: list[tuple[bool, Sources]] = []
    joints_of = [topic for topic, one in recording.kinds.items() if one == _JOINTS]
    for kind, topic in product(("velocity", "position"), joints_of):
        joints = [n.removeprefix(f"{kind}.") for n in _named(recording, topic)
                  if n.startswith(f"{kind}.")]  # fmt: skip
        found: Sources = {}
        rolls, every = False, [f"{topic}.{one}" for one in joints]
        for side in ("left", "right"):
            own = [one for one in joints if side_of(f"{topic}.{one}", every) == side]
            # Arms and steering have joints, too.
            wheels = [one for one in own if _ROLLING & set(words(f"{topic}.{one}"))]
            rolls = rolls or bool(wheels)
            if own:
                found[f"v_{side}"] = _of_joints(topic, f"v_{side}", kind, wheels or own)
        if found:
            result.append((rolls, found))
    result.sort(key=lambda one: not one[0])
    whole = [one for _, one in result if {*_SIDES} <= set(one)]
    parts = {c: one for _, some in reversed(result) for c, one in some.items()}
    whole += [parts] if {*_SIDES} <= set(parts) and not whole else []
    return whole


def _of_joints(topic: str, channel: str, kind: str, joints: Sequence[str]) -> Column:
    base = f"/{topic.strip('/')}.{kind}"
    if kind == "velocity":
        field = f"{base}[{'|'.join(joints)}]"
        return Column(field=field, unit="rad/s", channel=channel)
    # For angles of wheels that turn independently, each message gives the mean of all wheels.
    first, *rest = (f"{base}.{joint}" for joint in joints)
    weights = (1.0 / len(joints),) * len(joints)
    return Column(field=first, plus=tuple(rest), weights=weights, unit=TOTAL, channel=channel)


def of_body(ahead: Column, turn: Column, track: float) -> Sources:
    """Return tread speeds computed from speed and turn rate of the body, with a track [m]."""
    half = 0.5 * track if isfinite(track) else 1.0
    rate = float(f"{half:.6g}") * turn.conversion.factor
    return {
        channel: Column(field=ahead.field, plus=(turn.field,), channel=channel,
                        weights=(ahead.conversion.factor, sign * rate))
        for channel, sign in zip(_SIDES, (-1.0, 1.0), strict=True)
    }  # fmt: skip


def _twists(recording: Recording, track: float) -> list[Sources]:
    """Return tread speeds of messages with a speed ahead; the turn rate may be another's."""
    rates = [one["yaw_rate"] for one in _meant(recording, "yaw_rate")]
    return [
        of_body(one["ahead"], turn, track) for one in _meant(recording, "ahead")
        for turn in ([one["turn"]] if "turn" in one else rates[:1])
    ]  # fmt: skip


_SURELY, _MADE_OF_TREADS = 0.9, 0.99995  # correlations
_LYING = ("angular_velocity.x", "angular_velocity.y")


def _preferred(rated: tuple[float, Sources]) -> tuple[bool, bool, float]:
    alike = abs(rated[0])
    return alike < _BAG.turn_rate, alike > _MADE_OF_TREADS, -round(alike, 3)


def _of_imus(recording: Recording, channel: str, names: Iterable[str]) -> list[Column]:
    """Return fields of inertial units in addition to those that usually serve."""
    topics = [topic for topic, kind in recording.kinds.items() if kind == _IMU]
    return [
        Column(field=series, channel=channel)
        for topic in topics for name, series in _named(recording, topic).items() if name in names
    ]  # fmt: skip


def _series(recording: Recording, column: Column) -> Series:
    """Return readings, of wheels' rates and angles those of wheels of 1 m."""
    rolls = column.unit in RATES or column.unit in COUNTS
    return recording.series(column.changed(unit=f"{column.unit}*1") if rolls else column)


def _varies(recording: Recording, column: Column) -> bool:
    """Return whether a field's readings change at all."""
    values = _series(recording, column).values
    values = values[np.isfinite(values)]
    return len(values) >= _BAG.least and float(np.ptp(values)) > 0.0


def _alike(recording: Recording, column: Column, clock: FloatArray, turning: FloatArray) -> float:
    """Return the correlation of a turn rate, or the rate of a heading, with that of the treads."""
    t, values = usable(recording.series(column))
    if column.channel == "yaw":
        values = derivative(t, np.unwrap(values), find_runs(t), 0.5)
    rate = align(Series(t, values), clock).values
    both = np.isfinite(rate) & np.isfinite(turning)
    return correlation(rate[both], turning[both])


def _batteries(recording: Recording) -> Typed:
    """Return current and voltage of all batteries together, and say which count."""
    every = [one for one in _meant(recording, "current") if "voltage" in one]
    packs = [one for one in every if _varies(recording, one["current"])]
    kinds = [recording.kinds[_topic(one["current"])] for one in packs]
    packs = [one for one, kind in zip(packs, kinds, strict=True) if kind == kinds[0]]
    if len(packs) < 2:
        return Typed(dict((packs or every or [{}])[0]), {}, ())
    clock = recording.series(packs[0]["current"]).t
    amps = [align(usable(recording.series(one["current"])), clock).values for one in packs]
    volts = [float(np.nanmedian(recording.series(one["voltage"]).values)) for one in packs]
    names = [_topic(one["current"]) for one in packs]
    amps = [-one if np.nansum(one) < 0 < np.nansum(amps[0]) or np.nansum(amps[0]) < 0
            < np.nansum(one) else one for one in amps]  # fmt: skip
    notes: list[str] = []
    for k in range(len(packs)):
        others = [j for j in range(len(packs)) if j != k]
        if len(others) > 1 and _apart_by(amps[k], np.sum([amps[j] for j in others], axis=0)) < 0.05:
            listed = " and ".join(names[j] for j in others)
            notes.append(f"the current of {names[k]} is the sum of {listed}; it counts alone")
            return Typed(packs[k], {}, tuple(notes))
    for k in range(1, len(packs)):
        alike = re.sub(r"\d+", "0", names[k]) == re.sub(r"\d+", "0", names[0])
        if not alike and _apart_by(amps[k], amps[0]) < _BAG.one_battery:
            raise DriveLogError(
                f"{recording.source}: {names[0]} and {names[k]} may be two batteries, or one "
                f"that is measured twice: say --columns 'current={names[0]}.current[-A]' for one, "
                f"or --columns 'current={names[0]}.current+{names[k]}.current[-A]' for two"
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
    plus = tuple(one["current"].field for one in packs[1:])
    first |= {"current": first["current"].model_copy(
        update={"plus": plus, "weights": () if set(weights) == {1.0} else weights})}  # fmt: skip
    notes.append(f"the current counts {' and '.join(names)}")
    return Typed(first, {}, tuple(notes))


def _apart_by(one: FloatArray, other: FloatArray) -> float:
    """Return the difference of two readings, as a share of the second."""
    both = np.isfinite(one) & np.isfinite(other)
    size = float(np.sqrt(np.mean(other[both] ** 2))) if np.any(both) else 0.0
    return float(np.sqrt(np.mean((one - other)[both] ** 2))) / size if size > 0 else inf
