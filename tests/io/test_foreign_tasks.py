"""Orders and waypoints of other tools as the tasks of a mission."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from energyplan.errors import MissionError
from energyplan.io.mission import read_mission
from energyplan.mission import Mission

HEAD = """\
model: quadriga:empty:concrete
map: warehouse.yaml
battery: quadriga
start: [1.5, 1.5, 0]
tasks: tasks.yaml
"""


def mission(folder: Path, tasks: dict[str, Any], head: str = HEAD) -> Mission:
    (folder / "tasks.yaml").write_text(json.dumps(tasks, indent=1))
    (folder / "round.yaml").write_text(head)
    return read_mission(folder / "round.yaml")


def node(name: str, **position: float) -> dict[str, Any]:
    return {"nodeId": name, "released": True, "actions": [], "nodePosition": position}


ORDER = {
    "orderId": "o1",
    "edges": [],
    "nodes": [
        node("dock", x=2.0, y=1.5, mapId=1),
        node("gate", x=2.0, y=8.0, theta=3.0),
        node("hall", x=11.0, y=8.0),
        node("gate", x=11.0, y=10.0),
    ],
}


@pytest.mark.parametrize("robots", ["", "robots: [{name: a}, {name: b, start: [2, 8, 0]}]\n"])
def test_the_nodes_of_an_order_are_tasks(tmp_path: Path, robots: str) -> None:
    """A node without a heading is reached along the line from the one before."""
    tasks = mission(tmp_path, ORDER, HEAD + robots).tasks
    assert [task.name for task in tasks] == ["dock", "gate", "hall", "gate (4)"]
    poses = [(2.0, 1.5, 0.0), (2.0, 8.0, 3.0), (11.0, 8.0, 0.0), (11.0, 10.0, np.pi / 2)]
    np.testing.assert_allclose([task.pose for task in tasks], poses)


def test_waypoints_with_quaternions_are_tasks(tmp_path: Path) -> None:
    yaws = (-2.0, 0.5)
    waypoints = [
        {"pose": {"position": {"x": 2.0, "y": 8.0, "z": 0.0},
                  "orientation": {"x": 0.0, "y": 0.0, "z": np.sin(a / 2), "w": np.cos(a / 2)}}}
        for a in yaws
    ]  # fmt: skip
    tasks = mission(tmp_path, {"waypoints": waypoints}).tasks
    assert [task.name for task in tasks] == ["1", "2"]
    np.testing.assert_allclose([task.pose for task in tasks], [(2.0, 8.0, yaw) for yaw in yaws])


@pytest.mark.parametrize(("tasks", "message"), [
    ({"orderId": "o", "nodes": [{"nodeId": "n"}]}, r"nodePosition: this key is missing; give.*e$"),
    ({"orderId": "o1", "nodes": [node("a", x=2.0)]}, "line 8, nodes.0.nodePosition.y: this key"),
    ({"nodes": "all"}, "tasks.yaml, line 2, nodes"),
    ({"fileType": "Plan", "mission": {}}, "plan of QGroundControl, over longitude and latitude"),
    ({"places": []}, "give an order of VDA 5050, waypoints of Nav2 or lines of"),
])  # fmt: skip
def test_what_holds_no_tasks_is_refused_with_its_line(
    tmp_path: Path, tasks: dict[str, Any], message: str
) -> None:
    with pytest.raises(MissionError, match=message):
        mission(tmp_path, tasks)


def edge(name: str, **more: Any) -> dict[str, Any]:
    return {"edgeId": name, "released": True, "startNodeId": "a", "endNodeId": "b", **more}


def test_the_least_speed_of_edges_is_that_of_the_mission(tmp_path: Path) -> None:
    slow = {**ORDER, "edges": [edge("e1", maxSpeed=0.3), edge("e2", maxSpeed=0.2)]}
    found = mission(tmp_path, slow)
    assert found.speed == 0.2
    assert any("0.2 m/s" in note and "maxSpeed" in note for note in found.notes)
    fast = mission(tmp_path, {**ORDER, "edges": [edge("e1", maxSpeed=50.0)]})
    assert fast.speed is None and not any("maxSpeed" in note for note in fast.notes)
    own = mission(tmp_path, slow, HEAD + "speed: 0.1\n")
    assert own.speed == 0.1
    cheapest = mission(tmp_path, slow, HEAD + "speed: cheapest\n")
    assert cheapest.speed == "cheapest"
    assert any("give speed: 0.2" in note for note in cheapest.notes)


def test_what_is_not_released_or_not_known_is_named(tmp_path: Path) -> None:
    held = {**node("later", x=12.0, y=10.0), "released": False}
    waits = {**node("wait", x=2.0, y=8.0), "actions": [
        {"actionType": "wait", "actionId": "1", "blockingType": "HARD",
         "actionParameters": [{"key": "duration", "value": "90"}]},
        {"actionType": "pick", "actionId": "2", "blockingType": "HARD"}]}  # fmt: skip
    turned = edge("e1", rotationAllowed=False, released=True)
    asked = {"orderId": "o", "nodes": [waits, held], "edges": [turned], "vendorKey": 1}
    found = mission(tmp_path, asked)
    assert [(task.name, task.dwell) for task in found.tasks] == [("wait", 90.0)]
    said = " ".join(found.notes)
    assert "left out: later" in said and "no energy: pick" in said
    assert "not used: vendorKey, rotationAllowed" in said
    assert not mission(tmp_path, {**asked, "nodes": [node("a", x=2.0, y=8.0)], "edges": [],
                                  "vendorKey": None}).notes[:-1]  # fmt: skip


def test_waypoints_as_the_panel_of_rviz_saves_them(tmp_path: Path) -> None:
    yaws = (-2.0, 0.5)
    saved = {
        f"waypoint{k}": {"pose": [2.0, 8.0, 0.0],
                         "orientation": [float(np.cos(a / 2)), 0.0, 0.0, float(np.sin(a / 2))]}
        for k, a in enumerate(yaws)
    }  # fmt: skip
    tasks = mission(tmp_path, {"waypoints": saved}).tasks
    assert [task.name for task in tasks] == ["waypoint0", "waypoint1"]
    np.testing.assert_allclose([task.pose for task in tasks], [(2.0, 8.0, yaw) for yaw in yaws])
    with pytest.raises(MissionError, match=r"waypoint0: give pose: \[x, y, z\]"):
        mission(tmp_path, {"waypoints": {"waypoint0": {"pose": [1.0, 2.0]}}})


@pytest.mark.parametrize(("begin", "said"), [
    ("QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t38.1\t-122.4\t12\t1\n", "MAVLink, over longitude"),
    ('<?xml version="1.0"?>\n<launch/>\n', "XML"),
    ('<root main_tree_to_execute="M"><BehaviorTree ID="M"/></root>', "behaviour tree"),
    ("PK\x03\x04\x14", "zip archive"),
    ("move_base:\n  ros__parameters: {frequency: 2.0}\n", "parameters file of ROS 2"),
    ("poses:\n  ros__parameters: {points: [1, 2]}\n", "parameters file of ROS 2"),
])  # fmt: skip
def test_files_of_other_kinds_are_known_by_what_they_hold(
    tmp_path: Path, begin: str, said: str
) -> None:
    (tmp_path / "tasks.yaml").write_text(begin)
    (tmp_path / "round.yaml").write_text(HEAD)
    for file in ("round.yaml", "tasks.yaml"):
        with pytest.raises(MissionError, match=said):
            read_mission(tmp_path / file)


def test_an_order_alone_is_named(tmp_path: Path) -> None:
    (tmp_path / "order.json").write_text(json.dumps(ORDER))
    with pytest.raises(MissionError, match="VDA 5050: give it as the tasks of a mission"):
        read_mission(tmp_path / "order.json")


def posed(x: float, y: float, yaw: float) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": np.sin(yaw / 2), "w": np.cos(yaw / 2)}
    return {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}


@pytest.mark.parametrize("tasks", [
    {"poses": [posed(2.0, 8.0, 0.5), posed(11.0, 8.0, -2.0)]},
    {"header": {"frame_id": "map"}, "poses": [
        {"header": {"frame_id": "map"}, "pose": posed(2.0, 8.0, 0.5)},
        {"header": {"frame_id": "map"}, "pose": posed(11.0, 8.0, -2.0)}]},
    {"waypoints": [posed(2.0, 8.0, 0.5), [11.0, 8.0, "-114.591559deg"]]},
])  # fmt: skip
def test_poses_of_messages_and_lists_are_tasks(tmp_path: Path, tasks: dict[str, Any]) -> None:
    found = mission(tmp_path, tasks)
    poses = [(2.0, 8.0, 0.5), (11.0, 8.0, -2.0)]
    np.testing.assert_allclose([task.pose for task in found.tasks], poses, atol=1e-6)
    assert not any("not used" in note for note in found.notes)


def test_a_message_that_is_echoed_ends_with_dashes(tmp_path: Path) -> None:
    (tmp_path / "round.yaml").write_text(HEAD)
    text = json.dumps({"poses": [posed(2.0, 8.0, 0.5)]}, indent=1)
    (tmp_path / "tasks.yaml").write_text(f"{text}\n---\n")
    (task,) = read_mission(tmp_path / "round.yaml").tasks
    np.testing.assert_allclose(task.pose, (2.0, 8.0, 0.5))


@pytest.mark.parametrize(("content", "kind"), [
    ('<?xml version="1.0"?>\n<gpx version="1.1"><wpt lat="47" lon="8"/></gpx>', "GPX"),
    ('<kml xmlns="http://www.opengis.net/kml/2.2"/>', "KML"),
    ('{"docking_stations": [], "areas": []}', "a map of OpenMower"),
])  # fmt: skip
def test_files_of_other_tools_are_named(tmp_path: Path, content: str, kind: str) -> None:
    (tmp_path / "round.yaml").write_text(HEAD)
    (tmp_path / "tasks.yaml").write_text(content)
    with pytest.raises(MissionError, match=kind):
        read_mission(tmp_path / "round.yaml")
