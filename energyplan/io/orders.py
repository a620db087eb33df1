"""Orders of other tools as the tasks of a mission: VDA 5050, waypoints of Nav2, lines of GeoJSON.

What changes time, energy or place is used, or named in a note. Keys that say nothing of these are
listed beside each kind with the reason; what is in neither list is named too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import atan2, isfinite
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import (
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from energyplan.errors import MissionError
from energyplan.io.bags import heading
from energyplan.io.documents import load, unused
from energyplan.io.geojson import DRAWN, read_lines
from energyplan.mission import Task
from energyplan.path import parse_pose


class TaskOrder(NamedTuple):
    """What an order says of a mission."""

    tasks: list[dict[str, Any]]  # as the list of a mission's file
    notes: tuple[str, ...]  # what of it is not used
    speed: float | None  # what it limits the speed to [m/s]


class _Keyed(BaseModel):
    """A part of an order; keys that are neither read nor idle are named in a note."""

    model_config = ConfigDict(extra="allow", populate_by_name=True)
    idle: ClassVar[frozenset[str]] = frozenset()

    def unread(self) -> list[str]:
        """Return the keys that are not used, here and in the parts of this one."""
        found = unused(self.model_extra or (), (), self.idle)
        for name in type(self).model_fields:
            value = getattr(self, name)
            for one in value if isinstance(value, list) else [value]:
                found += one.unread() if isinstance(one, _Keyed) else []
        return found


class _Position(_Keyed):
    """Where a node, or the pose of a waypoint, is [m], and its heading [rad]."""

    # the map is the mission's, the ground says the height, and a task is reached without deviation
    idle = frozenset(
        {"z", "mapId", "mapDescription", "allowedDeviationXY", "allowedDeviationXy",
         "allowedDeviationTheta"}
    )  # fmt: skip
    x: float
    y: float
    theta: float | None = None


class _Orientation(_Keyed):
    """A quaternion."""

    x: float = 0.0
    y: float = 0.0
    z: float
    w: float


class _PoseOfROS(_Keyed):
    """A pose as ROS writes it."""

    # the frame is the map's
    idle = frozenset({"header"})
    position: _Position
    orientation: _Orientation | None = None


class _Parameter(_Keyed):
    """A parameter of an action."""

    key: str
    value: Any = None


class _Action(_Keyed):
    """An action of VDA 5050 at a node or on an edge."""

    # who started it, and whether the robot may move meanwhile; its time counts either way
    idle = frozenset({"actionId", "actionDescription", "blockingType", "retriable"})
    kind: str = Field("", alias="actionType")
    parameters: list[_Parameter] = Field([], alias="actionParameters")

    @property
    def duration(self) -> float | None:
        """How long it takes [s], where it says so."""
        for one in self.parameters:
            if one.key.lower() in ("duration", "waittime", "wait_time", "time"):
                try:
                    value = float(one.value)
                except (TypeError, ValueError):
                    return None
                return value if isfinite(value) and value >= 0 else None
        return None


class _Node(_Keyed):
    """A node of an order of VDA 5050."""

    idle = frozenset({"sequenceId", "nodeDescription", "nodeDescriptor"})
    name: str = Field(alias="nodeId")
    place: _Position = Field(alias="nodePosition")
    released: bool = True
    actions: list[_Action] = []


class _Edge(_Keyed):
    """An edge of an order of VDA 5050; the planner finds its own way from node to node."""

    idle = frozenset(
        {"sequenceId", "edgeDescription", "edgeDescriptor", "startNodeId", "endNodeId",
         "maxHeight", "minHeight", "maximumMobileRobotHeight", "minimumLoadHandlingDeviceHeight",
         "length", "corridor"}
    )  # fmt: skip
    name: str = Field("", alias="edgeId")
    released: bool = True
    fastest: float | None = Field(None, alias="maxSpeed", gt=0)
    actions: list[_Action] = []


class _Waypoint(_Keyed):
    """A waypoint of Nav2, or a pose of a path or an array of ROS."""

    idle = frozenset({"header"})
    name: str = ""
    pose: _PoseOfROS

    @model_validator(mode="before")
    @classmethod
    def _of_any(cls, given: Any) -> Any:
        """Take a pose without a name, or a list of its numbers, for a waypoint."""
        if isinstance(given, Mapping) and "position" in given:
            named = {key: given[key] for key in ("name",) if key in given}
            return {**named, "pose": {k: v for k, v in given.items() if k not in named}}
        if isinstance(given, list) and 2 <= len(given) <= 3:
            pose = parse_pose([*given, 0.0][:3])
            turn = {"theta": pose.yaw} if len(given) > 2 else {}
            return {"pose": {"position": {"x": pose.x, "y": pose.y, **turn}}}
        if not isinstance(given, Mapping):
            raise ValueError(
                "give a pose as {position: {x: X, y: Y}, orientation: {z: Z, w: W}}, or [X, Y, YAW]"
            )
        return given

    @property
    def place(self) -> _Position:
        at, turn = self.pose.position, self.pose.orientation
        return at if turn is None else _Position(x=at.x, y=at.y, theta=heading(turn))


class _Visits(_Keyed):
    """What an order, or waypoints, say."""

    # who sent it, when and to whom
    idle = frozenset(
        {"headerId", "timestamp", "version", "manufacturer", "serialNumber",
         "orderUpdateId", "zoneSetId", "orderDescription", "orderDescriptor", "header"}
    )  # fmt: skip
    orderId: str = ""  # noqa: N815  as VDA 5050 spells it
    nodes: list[_Node] = []
    edges: list[_Edge] = []
    waypoints: list[_Waypoint] = Field([], validation_alias=AliasChoices("waypoints", "poses"))

    @field_validator("waypoints", mode="before")
    @classmethod
    def _of_rviz(cls, given: Any) -> Any:
        """Return waypoints as a list, where RViz's panel saved them by name, w first."""
        if not isinstance(given, Mapping):
            return given
        found = []
        for name, one in given.items():
            pose, turn = (
                (one.get("pose"), one.get("orientation")) if isinstance(one, Mapping) else (0, 0)
            )
            if not (isinstance(pose, list) and isinstance(turn, list)) or (
                (len(pose), len(turn)) != (3, 4)
            ):
                raise ValueError(
                    f"{name}: give pose: [x, y, z] and orientation: [w, x, y, z] as the panel of "
                    "RViz does, or a list of poses as in waypoints: [{pose: {position: ..., "
                    "orientation: ...}}]"
                )
            position = dict(zip("xyz", pose, strict=True))
            orientation = dict(zip("wxyz", turn, strict=True))
            found.append({"name": name, "pose": {"position": position, "orientation": orientation}})
        return found


def _listed(names: Sequence[str]) -> str:
    """Return names, each once."""
    return ", ".join(dict.fromkeys(names))


def _notes(found: _Visits, waiting: list[str], untimed: list[str]) -> list[str]:
    """Say what of an order is not used, or in another way than it says."""
    notes = []
    if waiting:
        notes.append(f"not released yet, and left out: {_listed(waiting)}")
    if untimed:
        notes.append(
            f"actions that say no duration take no time and no energy: {_listed(untimed)}; write "
            "the tasks with dwell and power where they do"
        )
    if keys := found.unread():
        notes.append(f"keys of the order that are not used: {_listed(keys)}")
    return notes


def read_order(file: Path) -> TaskOrder:
    """Return the tasks of an order of VDA 5050, of waypoints of Nav2, or of lines, in their order.

    A node without a heading is left as it is reached. Actions that say their duration are dwelt for
    at the node they stand at or lead to. Each line of a GeoJSON file is a path, and its properties
    are the keys of its task.
    """
    if file.suffix.lower() == ".geojson":
        return _rows(file)
    document = load(file, MissionError)
    if "features" in document.data:
        raise document.fail((), "this seems to be GeoJSON; name the file .geojson")
    if not {"nodes", "waypoints", "poses"} & {*document.data}:
        seems = f"this seems to be {document.kind}; " if document.kind else ""
        raise document.fail(
            (), f"{seems}give an order of VDA 5050, waypoints of Nav2 or lines of GeoJSON as tasks"
        )
    found = document.check(_Visits)
    nodes = [node for node in found.nodes if node.released]
    edges = [edge for edge in found.edges if edge.released]
    waiting = [node.name for node in found.nodes if not node.released]
    tasks: list[dict[str, Any]] = []
    untimed: list[str] = []
    stops: list[_Node | _Waypoint] = [*nodes, *found.waypoints]
    for k, stop in enumerate(stops, 1):
        x, y, yaw = stop.place.x, stop.place.y, stop.place.theta
        before = tasks[-1]["pose"] if tasks else (x - 1.0, y)
        yaw = atan2(y - before[1], x - before[0]) if yaw is None else yaw
        twice = any(one["name"] == stop.name for one in tasks)
        label = f"{stop.name} ({k})" if twice else stop.name or str(k)
        task: dict[str, Any] = {"name": label, "pose": [x, y, yaw]}
        if isinstance(stop, _Node):
            known = [one.duration for one in stop.actions if one.duration is not None]
            untimed += [one.kind for one in stop.actions if one.duration is None]
            task |= {"dwell": sum(known)} if known else {}
        tasks.append(task)
    untimed += [one.kind for edge in edges for one in edge.actions]
    limits = [edge.fastest for edge in edges if edge.fastest is not None]
    return TaskOrder(tasks, tuple(_notes(found, waiting, untimed)), min(limits, default=None))


_OF_TASKS = frozenset(item.name for item in fields(Task)) - {"pose", "path"}


def _rows(file: Path) -> TaskOrder:
    """Return a task for each line of a GeoJSON file; properties that are no keys are named."""
    tasks: list[dict[str, Any]] = []
    unread: list[str] = []
    for k, line in enumerate(read_lines(file), 1):
        given = {key: value for key, value in line.properties.items() if value is not None}
        unread += unused(given, _OF_TASKS, DRAWN)
        task = {key: value for key, value in given.items() if key in _OF_TASKS}
        name = str(task.pop("name", "") or f"row {k}")
        twice = any(one["name"] == name for one in tasks)
        tasks.append({"name": f"{name} ({k})" if twice else name, "path": line.points, **task})
    note = f"properties of the lines that are not used: {_listed(unread)}"
    return TaskOrder(tasks, (note,) if unread else (), None)
