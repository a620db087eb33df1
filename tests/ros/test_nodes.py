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
from energyplan_ros import identifier, planner, running  # noqa: E402

ACCEPT, REJECT = stand_ins.Answer
SUCCESS, FAILURE, _ = stand_ins.Return

TURN = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)


def header(frame: str = "map", seconds: float = 100.0) -> Any:
    stamp = SimpleNamespace(sec=int(seconds), nanosec=0)
    return SimpleNamespace(frame_id=frame, stamp=stamp)


def stamped(x: float, y: float, **head: Any) -> Any:
    place = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=TURN)
    return SimpleNamespace(header=header(**head), pose=place)


def grid_message(cells: Any, frame: str = "map") -> Any:
    cells = np.asarray(cells, np.int8)
    origin = SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0, z=0.0), orientation=TURN)
    info = SimpleNamespace(
        resolution=0.1, width=cells.shape[1], height=cells.shape[0], origin=origin
    )
    return SimpleNamespace(header=header(frame), info=info, data=cells.ravel())


HALL = np.zeros((60, 80))


def change(node: Any, number: int) -> Any:
    """Ask for a transition as a lifecycle_manager does; None if no answer is sent."""
    request = SimpleNamespace(transition=SimpleNamespace(id=number, label=""))
    return node.call("planner_server/change_state", request, success=None)


def state(node: Any, timeout: float = 5.0) -> Any:
    answer = node.call("planner_server/get_state", timeout=timeout)
    return answer and answer.current_state.label


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
    assert change(made, stand_ins.CONFIGURE).success
    assert change(made, stand_ins.ACTIVATE).success
    made.hear("map", grid_message(HALL))
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
    data = np.full(120, 100, np.int8)
    wall = SimpleNamespace(header=header(), x=40, y=0, width=2, height=60, data=data)
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

    def asked(path: Any) -> Any:
        request = SimpleNamespace(path=path)
        return node.call("is_path_valid", request, is_valid=True, invalid_pose_indices=[])

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
    assert node.call("global_costmap/clear_entirely_global_costmap", success=False).success


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


@pytest.mark.parametrize("steps", [(4,), (3,), (2,), (99,), (1, 1), (1, 3, 3), (1, 3, 1), (5, 1)])
def test_a_transition_that_is_impossible_is_answered_at_once(steps: tuple[int, ...]) -> None:
    """A lifecycle_manager waits for the answer without end."""
    node = planner.PlannerNode()
    *before, impossible = steps
    for number in before:
        assert change(node, number).success
    was = state(node)
    answer = change(node, impossible)
    assert answer is not None
    assert answer.success is False
    assert state(node) == was
    assert "not registered" in node.told("warning")
    node.stop()


def test_the_bond_beats_while_the_simulated_clock_stands_still(node: Any) -> None:
    beats = len(node.sent("bond"))
    node.wait(4.0, simulated=0.0)
    assert len(node.sent("bond")) - beats >= 4
    assert node.sent("bond")[-1].heartbeat_timeout == 4.0


@pytest.mark.parametrize("ended", [False, True])
def test_while_activating_waits_for_the_kernels_all_else_is_answered(
    ended: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = threading.Event()
    monkeypatch.setattr(planner.ros, "warm_up", lambda *args: compiled.wait(60))
    node = planner.PlannerNode()
    assert change(node, stand_ins.CONFIGURE).success
    answers: list[Any] = []
    manager = threading.Thread(target=lambda: answers.append(change(node, stand_ins.ACTIVATE)))
    manager.start()
    try:
        assert state(node, timeout=0.5) == "activating"
        assert node.hear("map", grid_message(HALL), timeout=0.5)
        assert change(node, stand_ins.DEACTIVATE).success is False
        if ended:
            node.stop()
            manager.join(10)
    finally:
        compiled.set()
        manager.join(10)
    (answer,) = answers
    assert answer.success is not ended
    assert state(node) == ("inactive" if ended else "active")
    assert ("minutes" in node.told("info")) is False  # nothing was compiled
    node.stop()
    assert not change(node, stand_ins.ACTIVATE).success


def test_a_node_without_a_manager_activates_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(stand_ins.Node.overrides, "autostart", True)
    node = planner.PlannerNode()
    node.wait(1.0, simulated=0.0)
    assert state(node) == "active"
    node.stop()
    late = planner.PlannerNode()
    assert change(late, stand_ins.CONFIGURE).success  # a manager was faster
    late.wait(1.0)
    assert state(late) == "inactive"
    assert "autostart" in late.told("warning")
    late.stop()


def test_masks_and_patches_of_another_frame_are_refused(node: Any) -> None:
    cells = HALL.copy()
    cells[:, 40:42] = 100
    node.on_mask(grid_message(cells, "odom"))
    result = ask(node, Handle(stamped(6, 3), stamped(2, 3)))
    assert result.error_code == 200
    assert "keep-out mask is in the frame 'odom', expected 'map'" in result.error_msg
    node.on_mask(grid_message(HALL))
    assert ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_code == 0
    patch = SimpleNamespace(
        header=header("odom"), x=40, y=0, width=2, height=60, data=np.full(120, 100, np.int8)
    )
    node.hear("map_updates", patch)
    assert "patch of the map is in the frame 'odom'" in node.told("error")
    assert ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_code == 0
    # a map in the frame of a mask that came before it
    node.on_mask(grid_message(cells, "odom"))
    node.hear("map", grid_message(HALL, "odom"))
    ends = (stamped(x, 3, frame="odom") for x in (6, 2))
    assert ask(node, Handle(*ends)).error_code == 208


def test_a_position_of_long_ago_is_refused(node: Any) -> None:
    node.buffer.at = stamped(2, 3, seconds=100.0)
    assert ask(node, Handle(stamped(6, 3))).error_code == 0
    node.wait(0.9)
    assert ask(node, Handle(stamped(6, 3))).error_code == 0
    node.wait(11.1)
    result = ask(node, Handle(stamped(6, 3)))
    assert result.error_code == 202
    assert "12.0 s old" in result.error_msg
    assert "transform_tolerance" in result.error_msg
    node.buffer.at = stamped(2, 3, seconds=0.0)  # frames that are fixed have no time
    assert ask(node, Handle(stamped(6, 3))).error_code == 0


def test_the_result_says_why_there_is_no_map(node: Any) -> None:
    message = grid_message(HALL)
    message.info.resolution = 0.0
    node.hear("map", message)
    assert "resolution is 0.0 m" in ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_msg
    node.hear("map", grid_message(HALL))
    assert ask(node, Handle(stamped(6, 3), stamped(2, 3))).error_code == 0
    fresh = planner.PlannerNode()
    change(fresh, stand_ins.CONFIGURE)
    change(fresh, stand_ins.ACTIVATE)
    assert "map" in ask(fresh, Handle(stamped(6, 3), stamped(2, 3))).error_msg
    fresh.stop()


def test_results_are_kept_for_seconds(node: Any) -> None:
    assert {server.result_timeout for server in node.servers} == {10}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("clearance", 0, "expecting type"),
        ("clearance", -0.3, "out of range"),
        ("time_limit", -1.0, "out of range"),
        ("time_limit", float("nan"), "out of range"),
        ("occupied_from", 500, "out of range"),
        ("transform_tolerance", 0.0, "out of range"),
        ("planner", "smac", "no planner 'smac'; known: "),
    ],
)
def test_a_parameter_that_cannot_be_is_said_in_a_line(
    name: str, value: Any, said: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *args: None)
    monkeypatch.setattr(running.rclpy, "ok", lambda: False)  # a node that is made ends at once
    monkeypatch.setitem(stand_ins.Node.overrides, name, value)
    assert running.run(planner.PlannerNode) == 2
    (line,) = (one for one in capsys.readouterr().err.splitlines() if one.startswith("[fatal]"))
    assert name in line
    assert said in line


@pytest.mark.parametrize("make", [planner.PlannerNode, identifier.IdentifierNode])
def test_parameters_stay_as_they_are(make: Any) -> None:
    node = make()
    parameters = [SimpleNamespace(name=name, value=value) for name, value in node.settings.items()]
    for result in node.set_parameters(parameters):
        assert not result.successful
        assert "read-only" in result.reason


def drive(node: Any, steps: int = 40) -> None:
    """Send joint rates and a battery's state at 20 Hz, from where the node listens."""
    wheels = ("front_left", "front_right", "rear_left", "rear_right")
    for _ in range(steps):
        node.wait(0.05)
        for topic, message in (
            ("joint_states", SimpleNamespace(name=wheels, velocity=[10.0, 8.0, 10.0, 8.0])),
            ("battery_state", SimpleNamespace(voltage=25.0, current=-4.0)),
        ):
            if f"/{topic}" in node._heard:
                node.hear(f"/{topic}", message)


JOINTS = ("sensor_msgs/msg/JointState",)
BATTERY = ("sensor_msgs/msg/BatteryState",)


def test_the_identifier_learns_from_joint_states_and_a_battery_by_its_own_map() -> None:
    node = identifier.IdentifierNode()
    node.topics = [("/joint_states", JOINTS)]
    node.wait(5.0, simulated=0.0)
    (status,) = node.sent("/diagnostics")[-1].status
    assert status.level == 2
    assert "v_left (platform/joint_states or joint_states)" in status.message
    assert "voltage (platform/bms/state or battery_state)" in status.message
    assert "power (platform/mcu/status/power)" in status.message
    node.topics.append(("/battery_state", BATTERY))
    node.listen()
    drive(node)
    assert node.feed.samples > 15
    node.tell()
    (status,) = node.sent("/diagnostics")[-1].status
    assert (status.level, status.message) == (0, "0 changes of ground")
    node.wait(60.0)  # both fall silent
    (status,) = node.sent("/diagnostics")[-1].status
    assert "v_left" in status.message
    assert "voltage" in status.message
    assert "power (" not in status.message  # the battery is what it learns from


def test_robots_are_not_mixed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stand_ins.Node, "namespace", "/robot1")
    node = identifier.IdentifierNode()
    node.topics = [
        (f"{space}/{name}", kinds)
        for space in ("", "/robot1", "/robot2", "/robot1/robot2")
        for name, kinds in (("joint_states", JOINTS), ("battery_state", BATTERY))
    ]
    node.listen()
    assert set(node._heard) == {"/robot1/joint_states", "/robot1/battery_state"}


def test_the_identifier_names_a_topic_that_it_cannot_read_and_goes_on() -> None:
    node = identifier.IdentifierNode()
    node.topics = [("/platform/motors/feedback", ["clearpath_platform_msgs/msg/Feedback"])]
    node.topics += [
        (f"/{name.strip('/')}", ["sensor_msgs/msg/JointState"]) for name in node.feed.topics
    ]
    wanted = node.feed.topics[0]
    node.topics[1] = (f"/{wanted}", ["missing_msgs/msg/Feedback"])
    node.listen()
    told = node.told("error")
    assert f"/{wanted}" in told
    assert "missing_msgs/msg/Feedback" in told
    assert "install the package missing_msgs" in told
    assert set(node.heard) == {f"/{name}" for name in node.feed.topics}
    node.listen()
    assert node.told("error") == told


@pytest.mark.parametrize(("number", "autostart"), [(signal.SIGINT, False), (signal.SIGTERM, True)])
def test_a_signal_ends_a_node_in_order_also_while_it_compiles(number: int, autostart: bool) -> None:
    places = [str(HERE), str(HERE.parents[1])]
    code = (
        f"import sys, time; sys.path[:0] = {places}; import stand_ins; stand_ins.install()\n"
        f"stand_ins.Node.overrides['autostart'] = {autostart}\n"
        "from energyplan_ros import planner, running\n"
        "running.GRACE = 0.5\n"
        "def warm_up(*args):  # which nothing interrupts\n"
        "    sys.stderr.write('compiling\\n')\n"
        "    time.sleep(100)\n"
        "planner.ros.warm_up = warm_up\n"
        "planner.main()"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    try:
        for line in run.stdout:
            if ("compiling" if autostart else "spinning") in line:
                run.send_signal(number)
                break
        told, _ = run.communicate(timeout=30)
    finally:
        run.kill()
    assert run.returncode == 0, told
    assert "Traceback" not in told
    assert ("node destroyed" in told) is not autostart
