"""The planning node: hands messages to energyplan.ros, and its answers back."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from energyplan_interfaces.srv import EvaluateMission
from geometry_msgs.msg import PolygonStamped
from nav2_msgs.action import ComputePathThroughPoses, ComputePathToPose
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rosidl_runtime_py.utilities import get_message
from tf2_ros import Buffer, TransformException, TransformListener

import energyplan as ep
from energyplan import ros
from energyplan.errors import CancelledError, EnergyPlanError, FrameError

PARAMETERS = {
    "model": "quadriga:empty:concrete",
    "map_topic": "map",
    "keepout_topic": "",  # a mask of Nav2's keep-out filter; none if empty
    "footprint_topic": "",  # a PolygonStamped in the base frame; the model's vehicle if empty
    "mission_folder": "",  # where missions find their files; no mission service if empty
    "occupied_from": 0,  # 0: as the map's kind has it
    "unknown_is_free": False,
    "base_frame": "base_link",
    "planner": "lattice",
    "time_limit": 1.0,
    "clearance": 0.0,
    "to_pose_action": "compute_path_to_pose",
    "through_poses_action": "compute_path_through_poses",
}


class PlannerNode(Node):
    """Serves both planning actions on the latest map, and publishes the path as ``plan``."""

    def __init__(self) -> None:
        super().__init__("energyplan_planner")
        self.declare_parameters("", list(PARAMETERS.items()))
        self.settings = {name: self.get_parameter(name).value for name in PARAMETERS}
        self.cost = ep.EnergyCost(ep.read_model(self.settings["model"]))
        self.planning = Lock()  # one plan at a time
        self.map: tuple[str, ep.OccupancyGrid | None] = ("map", None)
        self.mask: ep.OccupancyGrid | None = None
        self.answered: ros.Answer | None = None  # Nav2 asks for the same goal again and again
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, name, callback in (
            (OccupancyGrid, "map_topic", self.on_map),
            (OccupancyGrid, "keepout_topic", self.on_mask),
            (PolygonStamped, "footprint_topic", self.on_footprint),
        ):
            if self.settings[name]:
                self.create_subscription(kind, self.settings[name], callback, latched)
        self.paths = self.create_publisher(Path, "plan", 1)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        # goals are cancelled, and missions asked for, while a plan is made
        beside = ReentrantCallbackGroup()
        self.servers = [
            ActionServer(
                self, kind, self.settings[name], partial(self.on_goal, kind),
                cancel_callback=lambda handle: CancelResponse.ACCEPT, callback_group=beside,
            )
            for kind, name in (
                (ComputePathToPose, "to_pose_action"),
                (ComputePathThroughPoses, "through_poses_action"),
            )
        ]  # fmt: skip
        if self.settings["mission_folder"]:
            self.create_service(
                EvaluateMission, "~/evaluate_mission", self.on_mission, callback_group=beside
            )

    def grid_of(self, message: OccupancyGrid, name: str) -> ep.OccupancyGrid | None:
        """Return the grid of a message; of a malformed one none."""
        try:
            return ros.grid_from_message(
                message,
                occupied_from=self.settings["occupied_from"] or None,
                unknown_is_free=self.settings["unknown_is_free"],
            )
        except EnergyPlanError as error:
            self.get_logger().error(f"{name}: {error}")
            return None

    def on_map(self, message: OccupancyGrid) -> None:
        """Keep the map; a malformed one leaves none."""
        self.map = message.header.frame_id, self.grid_of(message, "map")

    def on_mask(self, message: OccupancyGrid) -> None:
        """Keep the mask of the keep-out filter."""
        self.mask = self.grid_of(message, "keep-out mask")

    def on_footprint(self, message: PolygonStamped) -> None:
        """Take over the footprint."""
        model = self.cost.model
        try:
            vehicle = ros.footprint_from_message(
                message, model.vehicle, self.settings["base_frame"]
            )
        except EnergyPlanError as error:
            self.get_logger().error(f"footprint: {error}")
            return
        if not (vehicle.footprint == model.vehicle.footprint).all():
            self.cost = ep.EnergyCost(replace(model, vehicle=vehicle))

    def on_mission(self, request: Any, response: Any) -> Any:
        """Tell whether a mission can be done."""
        response.answer = ros.mission_answer(request.mission, self.settings["mission_folder"])
        return response

    def lookup(self, target: str, frame: str) -> Any:
        """Return the transform that brings what is in a frame into the map's."""
        try:
            return self.buffer.lookup_transform(target, frame, Time())
        except TransformException as error:
            raise FrameError(f"no transform from {frame!r} to {target!r}: {error}") from None

    def on_goal(self, kind: Any, handle: Any) -> Any:
        """Answer a goal."""
        settings = self.settings
        with self.planning:
            frame, grid = self.map
            if grid is not None and self.mask is not None:
                grid = grid.with_mask(self.mask)
            try:
                found = ros.answer(
                    handle.request,
                    grid,
                    self.cost,
                    frame=frame,
                    base=settings["base_frame"],
                    lookup=partial(self.lookup, frame),
                    planner=settings["planner"],
                    time_limit=settings["time_limit"],
                    clearance=settings["clearance"],
                    unwanted=lambda: handle.is_cancel_requested,
                    former=self.answered,
                )
            except CancelledError:
                handle.canceled()
                return kind.Result()
            self.answered = found if found.plans else None
        stamp = self.get_clock().now().to_msg()
        result = ros.fill_result(kind.Result(), found, frame, stamp, get_message)
        self.diagnostics.publish(
            ros.diagnostics_message(
                "energyplan: plan", found.message or "planned", ros.plan_values(found), stamp,
                get_message, error=not found.plans,
            )
        )  # fmt: skip
        if found.plans:
            self.paths.publish(result.path)
            handle.succeed()
        else:
            self.get_logger().warning(f"{found.code.name}: {found.message}")
            handle.abort()
        return result


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = PlannerNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
