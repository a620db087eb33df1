"""The nodes themselves, on stand-ins for rclpy that hold what the nodes make and call them back."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

HERE = Path(__file__).parent
pytest.importorskip("rosbags", reason="the messages' definitions need the extra bags")
sys.path.insert(0, str(HERE))
import stand_ins  # noqa: E402

stand_ins.install()
from energyplan_ros import identifier, planner  # noqa: E402

ACCEPT, REJECT = stand_ins.Answer
SUCCESS, FAILURE = stand_ins.Return

TURN = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)


def stamped(x: float, y: float) -> Any:
    place = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=TURN)
    return SimpleNamespace(header=SimpleNamespace(frame_id="map"), pose=place)


def grid_message(cells: Any) -> Any:
    cells = np.asarray(cells, np.int8)
    origin = SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0, z=0.0), orientation=TURN)
    info = SimpleNamespace(
        resolution=0.1, width=cells.shape[1], height=cells.shape[0], origin=origin
    )
    return SimpleNamespace(header=SimpleNamespace(frame_id="map"), info=info, data=cells.ravel())


class Handle:
    """A goal's handle."""

    def __init__(self, goal: Any, start: Any = None) -> None:
        self.request = SimpleNamespace(
            goal=goal, start=start, use_start=start is not None, planner_id="GridBased"
        )
        self.is_cancel_requested = False
        self.ended: list[str] = []

    def succeed(self) -> None:
        self.ended.append("succeeded")

    def abort(self) -> None:
        self.ended.append("aborted")

    def canceled(self) -> None:
        self.ended.append("canceled")


@pytest.fixture
def node() -> Any:
    made = planner.PlannerNode()
    assert made.on_configure(None) is SUCCESS
    assert made.on_activate(None) is SUCCESS
    made.hear("map", grid_message(np.zeros((60, 80))))
    yield made
    made.stop()


def ask(node: Any, handle: Handle) -> Any:
    (server,) = [one for one in node.servers if one.name == "compute_path_to_pose"]
    assert server.goal_callback(handle.request) is ACCEPT
    return server.execute(handle)


def test_a_goal_is_answered_only_while_the_node_is_active() -> None:
    node = planner.PlannerNode()
    (server, _) = node.servers
    handle = Handle(stamped(6, 3), stamped(2, 3))
    assert server.goal_callback(handle.request) is REJECT
    node.on_configure(None)
    assert server.goal_callback(handle.request) is REJECT
    node.on_activate(None)
    assert not node.warming.is_alive()
    node.hear("map", grid_message(np.zeros((60, 80))))
    result = ask(node, handle)
    assert (handle.ended, result.error_code) == (["succeeded"], 0)
    assert result.path.poses[-1].pose.position.x == pytest.approx(6.0)
    beats = node.sent("bond")
    node.bond.beat()
    assert len(node.sent("bond")) == len(beats) + 1
    assert node.sent("bond")[-1].id == "planner_server"
    node.on_deactivate(None)
    assert not node.sent("bond")[-1].active
    assert server.goal_callback(handle.request) is REJECT


def test_a_model_that_cannot_be_read_fails_to_configure() -> None:
    node = planner.PlannerNode()
    node.settings["model"] = "nowhere.yaml"
    assert node.on_configure(None) is FAILURE
    assert "nowhere.yaml" in node.told("error")


def test_a_map_that_changes_by_updates_and_a_mask(node: Any) -> None:
    wall = SimpleNamespace(x=40, y=0, width=2, height=60, data=np.full(120, 100, np.int8))
    node.hear("map_updates", wall)
    blocked = Handle(stamped(6, 3), stamped(2, 3))
    assert ask(node, blocked).error_code == 208
    node.hear("map_updates", SimpleNamespace(**{**vars(wall), "data": np.zeros(120, np.int8)}))
    assert ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_code == 0
    node.on_mask(grid_message(np.zeros((60, 80))))
    assert "closes no cell" in node.told("warning")
    cells = np.zeros((60, 80))
    cells[:, 40:42] = 100
    node.on_mask(grid_message(cells))
    assert ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_code == 208


def test_the_start_comes_from_tf_unless_the_goal_brings_it(node: Any) -> None:
    assert ask(node, Handle(stamped(6, 3))).error_code == 202
    node.buffer.at = stamped(2, 3)
    result = ask(node, Handle(stamped(6, 3)))
    assert result.path.poses[0].pose.position.x == pytest.approx(2.0)


def test_is_path_valid_looks_from_the_robot_on(node: Any) -> None:
    path = SimpleNamespace(poses=[stamped(0.1 * k, 3.0) for k in range(5, 70)])
    node.buffer.at = stamped(2, 3)
    service = node.services_by_name["is_path_valid"]

    def asked(path: Any) -> Any:
        answer = SimpleNamespace(is_valid=True, invalid_pose_indices=[])
        return service(SimpleNamespace(path=path), answer)

    assert asked(path).is_valid
    cells = np.zeros((60, 80))
    cells[28:32, 5:8] = 100  # behind it
    node.hear("map", grid_message(cells))
    assert asked(path).is_valid
    cells[28:32, 50:52] = 100
    node.hear("map", grid_message(cells))
    found = asked(path)
    assert not found.is_valid
    assert 45 in found.invalid_pose_indices
    assert min(found.invalid_pose_indices) > 30
    assert not asked(SimpleNamespace(poses=[])).is_valid
    cleared = node.services_by_name["global_costmap/clear_entirely_global_costmap"]
    assert cleared(None, SimpleNamespace(success=False)).success


def test_goals_that_wait_or_are_planned_end_by_cancel_and_by_deactivating(node: Any) -> None:
    node.settings["time_limit"] = 60.0
    wall = np.zeros((60, 80))
    wall[5:, 40:42] = 100
    node.hear("map", grid_message(wall))
    first, second, third = (Handle(stamped(6, 3), stamped(2, 3)) for _ in range(3))
    node.planning.acquire()
    workers = [threading.Thread(target=ask, args=(node, one)) for one in (first, second, third)]
    for worker in workers:
        worker.start()
    second.is_cancel_requested = True
    workers[1].join(30)
    assert second.ended == ["canceled"]
    busy = node.stop()
    node.planning.release()
    for worker in workers:
        worker.join(30)
    assert first.ended == third.ended == ["aborted"]
    assert not busy()


def test_the_identifier_names_a_topic_that_it_cannot_read_and_goes_on() -> None:
    node = identifier.IdentifierNode()
    node.topics = [("/platform/motors/feedback", ["clearpath_platform_msgs/msg/Feedback"])]
    node.topics += [
        (f"/{name.strip('/')}", ["sensor_msgs/msg/JointState"]) for name in node.feed.topics
    ]
    wanted = node.feed.topics[0].strip("/")
    node.topics.insert(0, (f"/robot/{wanted}", ["missing_msgs/msg/Feedback"]))
    node.listen()
    told = node.told("error")
    assert f"/robot/{wanted}" in told
    assert "missing_msgs/msg/Feedback" in told
    assert "install the package missing_msgs" in told
    assert set(node.heard) == {f"/robot/{wanted}", *(f"/{n.strip('/')}" for n in node.feed.topics)}
    node.listen()
    assert node.told("error") == told


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_in_order(number: int) -> None:
    places = [str(HERE), str(HERE.parents[1])]
    code = (
        f"import sys; sys.path[:0] = {places}; import stand_ins; stand_ins.install()\n"
        "from energyplan_ros.planner import main; main()"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    while "spinning" not in run.stdout.readline():
        pass
    run.send_signal(number)
    told, _ = run.communicate(timeout=60)
    assert run.returncode == 0, told
    assert "Traceback" not in told
    assert "node destroyed" in told
