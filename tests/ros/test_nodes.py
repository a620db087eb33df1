"""The nodes under ROS 2: clients in the same process ask them over the wire, as Nav2 does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

WHY = "the nodes need ROS 2: `.ci/nodes` runs these tests with wheels, `.ci/ros` in a container"
rclpy = pytest.importorskip("rclpy", reason=WHY, exc_type=ImportError)
pytest.importorskip("energyplan_ros", reason=WHY, exc_type=ImportError)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)  # processes do not hear each other

from action_msgs.msg import GoalStatus
from bond.msg import Status
from diagnostic_msgs.msg import DiagnosticArray
from energyplan_interfaces.srv import EvaluateMission
from energyplan_ros import identifier, planner, running
from geometry_msgs.msg import PoseStamped, TransformStamped
from lifecycle_msgs.srv import ChangeState, GetState
from map_msgs.msg import OccupancyGridUpdate
from nav2_msgs.action import ComputePathToPose
from nav2_msgs.msg import SpeedLimit
from nav2_msgs.srv import ClearEntireCostmap, IsPathValid
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.action import ActionClient, ActionServer
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState, JointState

import energyplan as ep
from energyplan.power import HOTEL

CONFIGURE, ACTIVATE, DEACTIVATE = 1, 3, 4
HALL = np.zeros((60, 80))
WALLED = HALL.copy()
WALLED[:, 40:42] = 100


def until(holds: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Wait until something holds, and return it."""
    end = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)
    return found


class Running:
    """A node, and a client beside it, spun by threads of their own."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self.node, self.client = make(), rclpy.create_node("client")
        self.goals = ActionClient(self.client, ComputePathToPose, "compute_path_to_pose")
        self.executor = running.Executor()
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.spin, daemon=True)

    def spin(self) -> None:
        for each in (self.node, self.client):
            self.executor.add_node(each)
        while not self.ending.is_set():
            self.executor.spin_once(timeout_sec=0.1)

    def end(self) -> None:
        """End as `running.run` does, so that nothing is left for the next test to discover."""
        if hasattr(self.node, "stop"):
            busy = self.node.stop()
            until(lambda: not busy())
        self.ending.set()
        if self.thread.is_alive():
            self.thread.join(30.0)
        self.executor.shutdown(timeout_sec=30.0)
        self.goals.destroy()
        for each in (self.node, self.client):
            each.destroy_node()
        rclpy.try_shutdown()

    def ask(self, kind: Any, name: str, request: Any = None) -> Any:
        """Return a service's answer."""
        service = self.client.create_client(kind, name)
        assert service.wait_for_service(timeout_sec=30.0), name
        future = service.call_async(request or kind.Request())
        until(future.done)
        return future.result()

    def change(self, number: int) -> bool:
        """Ask for a transition as a lifecycle_manager does."""
        request = ChangeState.Request()
        request.transition.id = number
        return bool(self.ask(ChangeState, "planner_server/change_state", request).success)

    def activate(self) -> None:
        assert self.change(CONFIGURE)
        assert self.change(ACTIVATE)

    def state(self) -> str:
        return str(self.ask(GetState, "planner_server/get_state").current_state.label)

    def send(self, goal: PoseStamped, start: PoseStamped | None = None) -> Any:
        """Send a goal; return its handle."""
        request = ComputePathToPose.Goal(
            goal=goal, start=start or PoseStamped(), use_start=start is not None
        )
        assert self.goals.wait_for_server(timeout_sec=30.0)
        future = self.goals.send_goal_async(request)
        until(future.done)
        return future.result()

    def plan(self, *ends: PoseStamped) -> Any:
        """Return the result of a goal."""
        handle = self.send(*ends or (stamped(6, 3), stamped(2, 3)))
        assert handle.accepted
        return ended(handle).result

    def publish_map(self) -> None:
        """Publish the hall as map servers do, for who comes later as well."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.client.create_publisher(OccupancyGrid, "map", latched).publish(grid_message(HALL))

    def robot_at(self, x: float, y: float, age: float | None = 0.0) -> None:
        """Have TF know the robot's position, of so long ago [s]; None if its frames are fixed."""
        known = TransformStamped(child_frame_id="base_link")
        known.header.frame_id = "map"
        known.transform.translation.x, known.transform.translation.y = float(x), float(y)
        self.node.buffer = planner.Buffer()
        if age is None:
            self.node.buffer.set_transform_static(known, "test")
        else:
            then = self.node.get_clock().now() - Duration(seconds=age)
            known.header.stamp = then.to_msg()
            self.node.buffer.set_transform(known, "test")


def ended(handle: Any) -> Any:
    """Return what became of a goal: status and result."""
    future = handle.get_result_async()
    until(future.done)
    return future.result()


def hear(node: Any, topic: str, message: Any) -> None:
    """Hand a node a message at once, as from a topic that it listens to."""
    (one,) = (each for each in node.subscriptions if each.topic_name == topic)
    one.callback(message)


def stamped(x: float, y: float, frame: str = "map") -> PoseStamped:
    found = PoseStamped()
    found.header.frame_id = frame
    found.pose.position.x, found.pose.position.y = float(x), float(y)
    return found


def grid_message(cells: np.ndarray, frame: str = "map") -> OccupancyGrid:
    found = OccupancyGrid(data=cells.astype(np.int8).ravel().tolist())
    found.header.frame_id, found.info.resolution = frame, 0.1
    found.info.height, found.info.width = cells.shape
    return found


def patch(value: int, frame: str = "map") -> OccupancyGridUpdate:
    """Return an update of two columns of the hall."""
    found = OccupancyGridUpdate(x=40, y=0, width=2, height=60, data=[value] * 120)
    found.header.frame_id = frame
    return found


Start = Callable[..., Running]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a node with parameters and remappings; it ends with the test."""
    made: list[Running] = []

    def begin(
        *words: str, make: Callable[[], Any] = planner.PlannerNode, spun: bool = True
    ) -> Running:
        arguments = ["--ros-args", *words]
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        made.append(Running(make))
        if spun:
            made[0].thread.start()
        return made[0]

    yield begin
    for one in made:
        one.end()


@pytest.fixture
def active(start: Start) -> Running:
    """A planner that is active and knows the hall."""
    found = start()
    found.activate()
    hear(found.node, "/map", grid_message(HALL))
    return found


def test_a_goal_is_answered_only_while_the_node_is_active(start: Start) -> None:
    """The map was sent before the node came, and there is no other."""
    found = start(spun=False)
    found.publish_map()
    plans: list[Any] = []
    found.client.create_subscription(PathMessage, "plan", plans.append, 1)
    found.thread.start()
    ends = stamped(6, 3), stamped(2, 3)
    assert not found.send(*ends).accepted
    assert found.change(CONFIGURE)
    assert not found.send(*ends).accepted
    assert found.change(ACTIVATE)
    assert not found.node.warming.is_alive()
    until(lambda: found.node.open is not None)
    result = found.plan(*ends)
    assert result.error_code == 0
    assert result.path.poses[-1].pose.position.x == pytest.approx(6.0)
    assert until(lambda: plans)[0] == result.path
    assert found.change(DEACTIVATE)
    assert not found.send(*ends).accepted


def test_a_model_that_cannot_be_read_fails_to_configure(start: Start, capfd: Any) -> None:
    assert not start("-p", "model:=nowhere.yaml").change(CONFIGURE)
    assert "nowhere.yaml" in capfd.readouterr().err


def test_a_map_that_changes_by_updates_and_a_mask(active: Running, capfd: Any) -> None:
    hear(active.node, "/map_updates", patch(100))
    assert active.plan().error_code == 208
    hear(active.node, "/map_updates", patch(0))
    assert active.plan().error_code == 0
    active.node.on_mask(grid_message(HALL))
    assert "closes no cell" in capfd.readouterr().err
    active.node.on_mask(grid_message(WALLED))
    assert active.plan().error_code == 208


def test_the_start_comes_from_a_recent_position_unless_the_goal_brings_it(active: Running) -> None:
    assert active.plan(stamped(6, 3)).error_code == 202
    for age in (0.0, 0.5, None):
        active.robot_at(2, 3, age)
        result = active.plan(stamped(6, 3))
        assert result.path.poses[0].pose.position.x == pytest.approx(2.0)
    active.robot_at(2, 3, 80.0)
    result = active.plan(stamped(6, 3))
    assert result.error_code == 202
    assert " s old" in result.error_msg
    assert "transform_tolerance" in result.error_msg


def test_is_path_valid_looks_from_the_robot_on(active: Running) -> None:
    path = PathMessage(poses=[stamped(0.1 * k, 3.0) for k in range(5, 70)])
    active.robot_at(2, 3)

    def asked(path: PathMessage) -> Any:
        return active.ask(IsPathValid, "is_path_valid", IsPathValid.Request(path=path))

    assert asked(path).is_valid
    cells = HALL.copy()
    cells[28:32, 5:8] = 100  # behind it
    hear(active.node, "/map", grid_message(cells))
    assert asked(path).is_valid
    cells[28:32, 50:52] = 100
    hear(active.node, "/map", grid_message(cells))
    found = asked(path)
    assert not found.is_valid
    assert 45 in found.invalid_pose_indices
    assert min(found.invalid_pose_indices) > 30
    assert not asked(PathMessage()).is_valid


def test_is_path_valid_says_whether_it_could_answer_where_the_service_asks(
    active: Running,
) -> None:
    path = PathMessage(poses=[stamped(0.1 * k, 3.0) for k in range(20, 60)])

    def asked(path: PathMessage) -> Any:
        response = SimpleNamespace(is_valid=None, success=None)
        return active.node.on_is_path_valid(SimpleNamespace(path=path), response)

    found = asked(path)
    assert (found.is_valid, found.success) == (False, False)  # the robot's position is not known
    active.robot_at(2, 3)
    found = asked(path)
    assert (found.is_valid, found.success) == (True, True)
    found = asked(PathMessage())
    assert (found.is_valid, found.success) == (False, True)


def test_a_failed_goal_leaves_the_former_plan(active: Running) -> None:
    active.robot_at(2, 3)
    assert active.plan(stamped(6, 3)).error_code == 0
    former = active.node.answered
    active.robot_at(2, 3, 80.0)
    assert active.plan(stamped(6, 3)).error_code == 202
    assert active.node.answered is former
    active.robot_at(2, 3)
    assert active.plan(stamped(6, 3)).error_code == 0
    assert active.node.answered.plans[0].effort == 0


def test_a_goal_is_reached_as_its_parameters_say(active: Running) -> None:
    """The goal's heading is against the way; a robot that may choose comes as it drives."""
    goal = stamped(6, 3)
    goal.pose.orientation.w, goal.pose.orientation.z = 0.0, 1.0

    def end() -> Any:
        return active.plan(goal, stamped(2, 3)).path.poses[-1].pose

    assert end().orientation.z ** 2 == pytest.approx(1.0, abs=1e-6)
    modes = [Parameter("goal_heading_mode", value="BIDIRECTIONAL"),
             Parameter("goal_tolerance", value=0.5)]  # fmt: skip
    for one in modes:
        assert active.node.set_parameters([one])[0].successful
    last = end()
    assert last.orientation.z == pytest.approx(0.0, abs=1e-6)
    assert last.position.x == pytest.approx(5.5, abs=0.01)


def test_open_cells_of_a_mask_are_said_once(active: Running, capfd: Any) -> None:
    cells = WALLED.copy()
    cells[:30, 40], cells[30:, 41] = 99, -1
    for _ in range(2):
        active.node.on_mask(grid_message(cells))
    said = capfd.readouterr().err
    assert said.count("30 cells from 1 to 99 and 30 unknown cells are open; give 100") == 1


def test_plans_are_timed_by_a_speed_limit(
    start: Start, monkeypatch: pytest.MonkeyPatch, capfd: Any, tmp_path: Path
) -> None:
    """The longer computers draw power, the more energy driving takes."""
    model = ep.PowerModel.preset("quadriga:empty:concrete").with_term(HOTEL, 20.0)
    ep.write_model(model, tmp_path / "model.yaml")
    active = start("-p", f"model:={tmp_path / 'model.yaml'}", "-p", "effort:=1000")
    active.activate()
    hear(active.node, "/map", grid_message(HALL))
    told: list[DiagnosticArray] = []
    monkeypatch.setattr(active.node.diagnostics, "publish", told.append)

    def planned(**limit: Any) -> dict[str, str]:
        hear(active.node, "/speed_limit", SpeedLimit(**limit))
        assert active.plan().error_code == 0
        return {pair.key: pair.value for pair in told[-1].status[0].values}

    slow = planned(speed_limit=0.1)
    assert "the route was chosen without it" in slow["speed limit 0.1 m/s"]
    assert float(slow["driving time [s]"]) > 39.0  # for 4 m
    share = planned(speed_limit=20.0, percentage=True)
    assert 5.0 < float(share["driving time [s]"]) < float(slow["driving time [s]"])
    more, longer = (
        float(slow[key]) - float(share[key]) for key in ("driven energy [J]", "driving time [s]")
    )
    assert more == pytest.approx(20.0 * longer, rel=0.05)
    assert "driving time [s]" not in planned(speed_limit=0.0)
    hear(active.node, "/speed_limit", SpeedLimit(speed_limit=-1.0))
    assert "speed limit: " in capfd.readouterr().err
    assert active.node.limit.speed_limit == 0.0


def test_what_a_cleared_costmap_leaves_is_planned_anew(active: Running) -> None:
    active.plan()
    assert active.node.answered is not None
    active.ask(ClearEntireCostmap, "global_costmap/clear_entirely_global_costmap")
    assert active.node.answered is None


def test_a_mission_is_evaluated_from_a_folder(start: Start, tmp_path: Path) -> None:
    found = start("-p", f"mission_folder:={tmp_path}")
    name = "planner_server/evaluate_mission"
    answer = found.ask(EvaluateMission, name, EvaluateMission.Request(mission="{}")).answer
    assert "error" in answer and "model" in answer


def test_a_newer_goal_ends_the_older_and_all_end_by_cancel_and_by_deactivating(
    active: Running,
) -> None:
    active.node.planning.acquire()  # as a plan that is under way does
    first = active.send(stamped(6, 3), stamped(2, 3))
    second = active.send(stamped(5, 3), stamped(2, 3))
    found = ended(first)
    assert found.status == GoalStatus.STATUS_ABORTED
    assert "a newer goal has come" in found.result.error_msg
    cancelled = second.cancel_goal_async()
    until(cancelled.done)
    assert ended(second).status == GoalStatus.STATUS_CANCELED
    third = active.send(stamped(6, 3), stamped(2, 3))
    busy = active.node.stop()
    active.node.planning.release()
    found = ended(third)
    assert found.status == GoalStatus.STATUS_ABORTED
    assert "deactivated" in found.result.error_msg
    until(lambda: not busy())


def test_a_newer_goal_is_planned_while_the_older_is(
    active: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, answer = threading.Event(), planner.ros.answer

    def endless(request: Any, *args: Any, unwanted: Any, **options: Any) -> Any:
        if request.goal.pose.position.x != 6.0:
            return answer(request, *args, unwanted=unwanted, **options)
        begun.set()
        until(unwanted)
        raise planner.CancelledError("the plan is not wanted any more")

    monkeypatch.setattr(planner.ros, "answer", endless)
    older = active.send(stamped(6, 3), stamped(2, 3))
    assert begun.wait(60.0)
    assert active.plan(stamped(5, 3), stamped(2, 3)).error_code == 0
    assert ended(older).status == GoalStatus.STATUS_ABORTED


def test_a_task_is_handed_to_the_threads_once(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All threads are busy, so tasks wait; meanwhile the executor hears what else comes."""
    start(spun=False)
    handed: list[Any] = []
    submit = ThreadPoolExecutor.submit

    def counted(pool: Any, *args: Any) -> Any:
        handed.append(args)
        return submit(pool, *args)

    monkeypatch.setattr(ThreadPoolExecutor, "submit", counted)
    executor, free, done = running.Executor(), threading.Event(), list[int]()

    def work(number: int) -> None:
        free.wait(60.0)
        done.append(number)

    count = running.THREADS + 2
    tasks = [executor.create_task(work, number) for number in range(count)]
    for _ in range(5 * count):
        executor.spin_once(timeout_sec=0.0)
    assert len(handed) == count
    free.set()
    until(lambda: all(task.done() for task in tasks))
    assert sorted(done) == list(range(count))
    executor.shutdown()


def test_a_task_that_waits_for_another_goes_on_after_it(start: Start) -> None:
    start(spun=False)
    executor = running.Executor()

    async def both() -> int:
        return await executor.create_task(lambda: 1) + 1

    task = executor.create_task(both)
    for _ in range(200):
        executor.spin_once(timeout_sec=0.05)
        if task.done():
            break
    assert task.result() == 2
    executor.shutdown()


@pytest.mark.parametrize("steps", [(4,), (3,), (2,), (99,), (1, 1), (1, 3, 3), (1, 3, 1), (5, 1)])
def test_a_transition_that_is_impossible_is_answered_at_once(
    steps: tuple[int, ...], start: Start, capfd: Any
) -> None:
    """A lifecycle_manager waits for the answer without end."""
    found = start()
    *before, impossible = steps
    for number in before:
        assert found.change(number)
    was = found.state()
    assert not found.change(impossible)
    assert found.state() == was
    assert f"transition {impossible}: " in capfd.readouterr().err


def test_the_bond_beats_while_the_simulated_clock_stands_still(start: Start) -> None:
    found = start("-p", "use_sim_time:=true")
    beats: list[Any] = []
    found.client.create_subscription(Status, "bond", beats.append, 10)
    found.activate()
    until(lambda: len(beats) >= 4)
    assert {(one.id, one.active, one.heartbeat_timeout) for one in beats} == {
        ("planner_server", True, 4.0)
    }
    found.node.bond.on_status(Status(id="planner_server", instance_id="manager", active=False))
    until(lambda: not all(one.active for one in beats))
    beats.clear()
    assert found.change(DEACTIVATE)
    until(lambda: not all(one.active for one in beats))


@pytest.mark.parametrize("stopped", [False, True])
def test_while_activating_waits_for_the_kernels_all_else_is_answered(
    stopped: bool, start: Start, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    compiled = threading.Event()
    monkeypatch.setattr(planner.ros, "warm_up", lambda *args: compiled.wait(60))
    found = start()
    assert found.change(CONFIGURE)
    answers: list[bool] = []
    manager = threading.Thread(target=lambda: answers.append(found.change(ACTIVATE)))
    manager.start()
    try:
        until(lambda: found.state() == "activating")
        assert not found.change(DEACTIVATE)
        found.publish_map()
        until(lambda: found.node.grid is not None)
        assert answers == []
        if stopped:
            found.node.stop()
            manager.join(10)
    finally:
        compiled.set()
        manager.join(10)
    assert answers == [not stopped]
    assert found.state() == ("inactive" if stopped else "active")
    assert "minutes" not in capfd.readouterr().err  # nothing was compiled
    found.node.stop()
    assert not found.change(ACTIVATE)


def test_a_node_without_a_manager_activates_itself(start: Start) -> None:
    found = start("-p", "autostart:=true", "-p", "use_sim_time:=true")
    until(lambda: found.state() == "active")


def test_a_manager_may_be_faster_than_autostart(start: Start, capfd: Any) -> None:
    found = start("-p", "autostart:=true", spun=False)
    assert found.node.trigger_configure() == planner.DONE
    found.thread.start()
    until(lambda: "autostart" in capfd.readouterr().err)
    assert found.state() == "inactive"


def test_masks_and_patches_of_another_frame_are_refused(active: Running, capfd: Any) -> None:
    active.node.on_mask(grid_message(WALLED, "odom"))
    result = active.plan()
    assert result.error_code == 200
    assert "keep-out mask is in the frame 'odom', expected 'map'" in result.error_msg
    active.node.on_mask(grid_message(HALL))
    hear(active.node, "/map_updates", patch(100, "odom"))
    assert "patch of the map is in the frame 'odom'" in capfd.readouterr().err
    assert active.plan().error_code == 0
    # a map in the frame of a mask that came before it
    active.node.on_mask(grid_message(WALLED, "odom"))
    hear(active.node, "/map", grid_message(HALL, "odom"))
    assert active.plan(stamped(6, 3, "odom"), stamped(2, 3, "odom")).error_code == 208


def test_the_result_says_why_there_is_no_map(start: Start) -> None:
    found = start("-p", "map_topic:=floor")
    found.activate()
    assert "no map has come on floor" in found.plan().error_msg
    message = grid_message(HALL)
    message.info.resolution = 0.0
    hear(found.node, "/floor", message)
    assert "resolution is 0.0 m" in found.plan().error_msg
    hear(found.node, "/floor", grid_message(HALL))
    assert found.plan().error_code == 0


def test_results_are_kept_for_seconds(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[float] = []

    def server(*args: Any, result_timeout: float, **options: Any) -> ActionServer:
        kept.append(result_timeout)
        return ActionServer(*args, result_timeout=result_timeout, **options)

    monkeypatch.setattr(planner, "ActionServer", server)
    start()
    assert kept == [10, 10]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("clearance", "0", "expecting type"),
        ("clearance", "-0.3", "out of range"),
        ("time_limit", "-1.0", "out of range"),
        ("time_limit", ".nan", "out of range"),
        ("occupied_from", "500", "out of range"),
        ("transform_tolerance", "0.0", "out of range"),
        ("planner", "smac", "no planner 'smac'; known: "),
        ("goal_tolerance", "-0.1", "out of range"),
        ("goal_heading_mode", "any", "give one of DEFAULT, BIDIRECTIONAL, ALL_DIRECTION"),
    ],
)
def test_a_parameter_that_cannot_be_is_said_in_a_line(
    name: str, value: str, said: str, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *args: None)
    monkeypatch.setattr(running.rclpy, "ok", lambda: False)  # a node that is made ends at once
    monkeypatch.setattr("sys.argv", ["planner", "--ros-args", "-p", f"{name}:={value}"])
    assert running.run(planner.PlannerNode) == 2
    (line,) = (one for one in capfd.readouterr().err.splitlines() if "[FATAL]" in one)
    assert name in line
    assert said in line


def test_parameters_change_at_run_time_or_say_that_they_need_a_restart(start: Start) -> None:
    node = start(spun=False).node
    values = {"time_limit": 5.0, "effort": 7000, "clearance": 0.2, "transform_tolerance": 2.0,
              "goal_heading_mode": "BIDIRECTIONAL", "goal_tolerance": 0.3}  # fmt: skip

    def changed(name: str, value: Any) -> Any:
        (result,) = node.set_parameters([Parameter(name, value=value)])
        return result

    for name, value in values.items():
        assert changed(name, value).successful
        assert node.settings[name] == value
    wrong = {"time_limit": -1.0, "clearance": 2, "effort": -1, "goal_tolerance": -1.0,
             "goal_heading_mode": "any"}  # fmt: skip
    for name, value in wrong.items():
        assert not changed(name, value).successful
        assert node.settings[name] == values[name]
    for name in set(node.settings) - set(values):
        was = node.settings[name]
        result = changed(name, was)
        assert not result.successful
        assert f"{name} is read when the node starts" in result.reason


def test_the_identifier_says_that_its_parameters_need_a_restart(start: Start) -> None:
    node = start(make=identifier.IdentifierNode, spun=False).node
    for name, value in node.settings.items():
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert "start it again" in result.reason


# -- the identifier ------------------------------------------------------------------------------

JOINTS = ["sensor_msgs/msg/JointState"]
BATTERY = ["sensor_msgs/msg/BatteryState"]


def learning(start: Start, *words: str) -> Running:
    """Return an identifier that is not spun; what it tells is kept in `told`."""
    return start(*words, make=identifier.IdentifierNode, spun=False)


def test_the_identifier_learns_from_joint_states_and_a_battery_by_its_own_map(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, clock, told = learning(start).node, [100.0], list[DiagnosticArray]()
    monkeypatch.setattr(node, "now", lambda: clock[0])
    monkeypatch.setattr(node.diagnostics, "publish", told.append)

    def status() -> Any:
        node.listen()
        node.tell()
        return told[-1].status[0]

    topics = [("/joint_states", JOINTS)]
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: topics)
    found = status()
    assert found.level == b"\x02"
    for missing in (
        "v_left (platform/joint_states or joint_states)",
        "voltage (platform/bms/state or battery_state)",
        "power (platform/mcu/status/power)",
    ):
        assert missing in found.message
    topics.append(("/battery_state", BATTERY))
    node.listen()
    wheels = ["front_left", "front_right", "rear_left", "rear_right"]
    for _ in range(40):
        clock[0] += 0.05
        hear(node, "/joint_states", JointState(name=wheels, velocity=[10.0, 8.0, 10.0, 8.0]))
        hear(node, "/battery_state", BatteryState(voltage=25.0, current=-4.0))
    assert node.feed.samples > 15
    found = status()
    assert (found.level, found.message) == (b"\x00", "0 changes of ground")
    clock[0] += 60.0  # both fall silent
    found = status()
    assert "v_left" in found.message
    assert "voltage" in found.message
    assert "power (" not in found.message  # the battery is what it learns from


def test_the_identifier_names_a_current_of_the_wrong_sign(
    start: Start, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    node, clock, told = learning(start).node, [100.0], list[DiagnosticArray]()
    monkeypatch.setattr(node, "now", lambda: clock[0])
    monkeypatch.setattr(node.diagnostics, "publish", told.append)
    topics = [("/joint_states", JOINTS), ("/battery_state", BATTERY)]
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: topics)
    node.listen()
    wheels = ["front_left", "front_right", "rear_left", "rear_right"]
    for _ in range(160):
        clock[0] += 0.05
        hear(node, "/joint_states", JointState(name=wheels, velocity=[10.0, 8.0, 10.0, 8.0]))
        hear(node, "/battery_state", BatteryState(voltage=25.0, current=4.0))
    node.tell()
    found = told[-1].status[0]
    assert found.level == b"\x02"
    assert "give the other sign to the scale of current" in found.message
    assert "battery_state" in found.message
    assert "the power is below zero" in capfd.readouterr().err


def test_the_identifier_hears_and_tells_while_the_simulated_clock_stands_still(
    start: Start,
) -> None:
    found = learning(start, "-p", "use_sim_time:=true", "-p", "period:=0.1")
    told: list[Any] = []
    found.client.create_subscription(DiagnosticArray, "/diagnostics", told.append, 10)
    found.client.create_publisher(JointState, "/joint_states", 1)
    found.thread.start()
    until(lambda: "/joint_states" in found.node.heard)
    until(lambda: len(told) > 2)


def test_robots_are_not_mixed(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    node = learning(start, "-r", "__ns:=/robot1").node
    topics = [
        (f"{space}/{name}", kinds)
        for space in ("", "/robot1", "/robot2", "/robot1/robot2")
        for name, kinds in (("joint_states", JOINTS), ("battery_state", BATTERY))
    ]
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: topics)
    node.listen()
    assert node.heard == {"/robot1/joint_states", "/robot1/battery_state"}


def test_the_identifier_names_a_topic_that_it_cannot_read_and_goes_on(
    start: Start, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    node = learning(start).node
    wanted, *others = node.feed.topics
    topics = [(f"/{wanted}", ["missing_msgs/msg/Feedback"])]
    topics += [("/platform/motors/feedback", ["clearpath_platform_msgs/msg/Feedback"])]
    topics += [(f"/{name}", JOINTS) for name in others]
    monkeypatch.setattr(node, "get_topic_names_and_types", lambda: topics)
    node.listen()
    said = capfd.readouterr().err
    assert f"/{wanted}: messages of the type missing_msgs/msg/Feedback cannot be read" in said
    assert "install the package missing_msgs" in said
    assert node.heard == {f"/{name}" for name in node.feed.topics}
    node.listen()
    assert capfd.readouterr().err == ""


# -- how a node ends -----------------------------------------------------------------------------

ENDING = """
import sys, time
from energyplan_ros import planner, running

class Node(planner.PlannerNode):
    def __init__(self):
        super().__init__()
        print("made", flush=True)

    def destroy_node(self):
        super().destroy_node()
        print("destroyed", flush=True)

def warm_up(*args):  # which nothing interrupts
    print("compiling", flush=True)
    time.sleep(100)

running.GRACE, planner.PlannerNode, planner.ros.warm_up = 0.5, Node, warm_up
planner.main()
"""


@pytest.mark.parametrize(("number", "autostart"), [(signal.SIGINT, False), (signal.SIGTERM, True)])
def test_a_signal_ends_a_node_in_order_also_while_it_compiles(number: int, autostart: bool) -> None:
    words = ["--ros-args", "-p", f"autostart:={str(autostart).lower()}"]
    run = subprocess.Popen(
        [sys.executable, "-c", ENDING, *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    try:
        for line in run.stdout:
            if ("compiling" if autostart else "made") in line:
                run.send_signal(number)
                break
        told, _ = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 0, told
    assert "Traceback" not in told
    assert ("destroyed" in told) is not autostart
