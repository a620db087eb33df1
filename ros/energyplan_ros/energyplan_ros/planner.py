"""The node: hands messages to energyplan.ros, and its answers back."""

from __future__ import annotations

from functools import partial
from threading import Lock
from typing import Any

import rclpy
from nav2_msgs.action import ComputePathThroughPoses, ComputePathToPose
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rosidl_runtime_py.utilities import get_message
from tf2_ros import Buffer, TransformException, TransformListener

import energyplan as ep
from energyplan import ros
from energyplan.errors import EnergyPlanError, FrameError

PARAMETERS = {
    "model": "quadriga:empty:concrete",
    "map_topic": "map",
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
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(OccupancyGrid, self.settings["map_topic"], self.on_map, latched)
        self.paths = self.create_publisher(Path, "plan", 1)
        self.servers = [
            ActionServer(self, kind, self.settings[name], partial(self.on_goal, kind))
            for kind, name in (
                (ComputePathToPose, "to_pose_action"),
                (ComputePathThroughPoses, "through_poses_action"),
            )
        ]

    def on_map(self, message: OccupancyGrid) -> None:
        """Keep the map; a malformed one leaves none."""
        try:
            grid = ros.grid_from_message(
                message,
                occupied_from=self.settings["occupied_from"] or None,
                unknown_is_free=self.settings["unknown_is_free"],
            )
        except EnergyPlanError as error:
            self.get_logger().error(f"map: {error}")
            grid = None
        self.map = message.header.frame_id, grid

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
            )
        stamp = self.get_clock().now().to_msg()
        result = ros.fill_result(kind.Result(), found, frame, stamp, get_message)
        if found.plans:
            self.paths.publish(result.path)
            self.get_logger().info(
                f"{found.energy:.0f} J, at least {found.lower_bound:.0f} J, "
                f"planned in {found.planning_time:.2f} s"
            )
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
