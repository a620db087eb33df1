"""Which message field of a bag serves as which channel: topic maps, ready-made and from YAML."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from functools import lru_cache
from math import atan2, nan
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, field_validator

from energyplan.errors import ConfigError, UnknownNameError
from energyplan.io.documents import Checked, Document, Loc, load

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
