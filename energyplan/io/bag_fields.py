"""The numbers in a bag's messages, and which channels they could be."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from energyplan.io.bags import opened_bag
from energyplan.io.topics import TopicMap
from energyplan.logs.guess import guess, side_of, words

_DEEPEST = 6
_LONGEST = 16  # elements of an array that are looked at
_SIDES = ("v_left", "v_right")
_ROLLING = {"wheel", "wheels", "track", "tread", "drivewhl", "drive", "whl"}


class Field(NamedTuple):
    """A number of a message: its topic, the message's type, the field, and a name for it."""

    topic: str
    type: str
    field: str
    label: str


@dataclass(frozen=True)
class BagFields:
    """Fields of a bag's messages that hold numbers, by a name that tells topic and field."""

    fields: dict[str, Field]

    def names(self) -> list[str]:
        """Return the fields' names."""
        return list(self.fields)

    def channels(self) -> dict[str, list[Field]]:
        """Guess the fields that make each channel; two of them are multiplied."""
        found: dict[str, list[Field]] = {}
        for rule in (self._typed, self._named):
            for channel, sources in rule().items():
                found.setdefault(channel, sources)
        if {"voltage", "current"} <= set(self._typed()):
            found.pop("power", None)  # a battery's own readings are surer than a name
        if {"p_left", "p_right"} & set(found) and not {"p_left", "p_right"} <= set(found):
            found = {k: v for k, v in found.items() if k not in ("p_left", "p_right")}
        return found

    def twist(self, track: float) -> dict[str, list[Field]]:
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

    def _typed(self) -> dict[str, list[Field]]:
        """Channels of the message types that ROS gives a meaning."""
        found: dict[str, list[Field]] = {}
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

    def _named(self) -> dict[str, list[Field]]:
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

    def wheel_rates(self, sources: dict[str, list[Field]]) -> bool:
        """Tell whether the tread speeds are rates of joints, which take a wheel radius."""
        first = sources["v_left"][0]
        said = set(words(first.label))
        return first.type == "sensor_msgs/msg/JointState" or bool(
            said & {"rate", "omega", "angular", "rpm", "joint"}
        )

    def topic_map(self, sources: dict[str, list[Field]], radius: float, name: str) -> TopicMap:
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
    fields: dict[str, Field] = {}
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
                fields[label] = Field(name, str(topic.msgtype), field, label)
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
