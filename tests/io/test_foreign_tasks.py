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
    ({"places": []}, "give an order of VDA 5050 or waypoints of Nav2"),
])  # fmt: skip
def test_what_holds_no_tasks_is_refused_with_its_line(
    tmp_path: Path, tasks: dict[str, Any], message: str
) -> None:
    with pytest.raises(MissionError, match=message):
        mission(tmp_path, tasks)


def test_an_order_alone_is_named(tmp_path: Path) -> None:
    (tmp_path / "order.json").write_text(json.dumps(ORDER))
    with pytest.raises(MissionError, match="VDA 5050: give it as the tasks of a mission"):
        read_mission(tmp_path / "order.json")
