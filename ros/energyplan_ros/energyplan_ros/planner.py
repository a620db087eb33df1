"""The planning node: hands messages to energyplan.ros, and its answers back.

A lifecycle node with the actions and services that Nav2 asks of planner_server.
"""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace
from functools import partial
from typing import Any

import shapely
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from lifecycle_msgs.srv import ChangeState
from map_msgs.msg import OccupancyGridUpdate
from nav2_msgs.action import ComputePathThroughPoses, ComputePathToPose
from nav2_msgs.msg import SpeedLimit
from nav2_msgs.srv import ClearEntireCostmap, IsPathValid
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rosidl_runtime_py.utilities import get_message
from tf2_ros import Buffer, TransformException, TransformListener

import energyplan as ep
from energyplan import ros
from energyplan.compilation import telling
from energyplan.errors import CancelledError, EnergyPlanError, FrameError
from energyplan.ros.messages import KEEPOUT, check_frame
from energyplan.ros.nav2 import planner_of
from energyplan_ros.bond import Bond
from energyplan_ros.running import declared, run

PARAMETERS = {
    "model": "quadriga:empty:concrete",
    "map_topic": "map",  # its updates come on the same name with _updates
    "keepout_topic": "",  # a mask of Nav2's keep-out filter; none if empty
    "footprint_topic": "",  # a PolygonStamped in the base frame; the model's vehicle if empty
    "speed_limit_topic": "speed_limit",  # a SpeedLimit, as controller_server hears; none if empty
    "mission_folder": "",  # where missions find their files; no mission service if empty
    "occupied_from": 0,  # 0: as the map's kind has it
    "unknown_is_free": False,
    "base_frame": "base_link",
    "transform_tolerance": 1.0,  # age at which a position of the robot is refused [s]
    "planner": "lattice",
    "effort": 0,  # units of work for a request; 0: as many as the library usually does
    "time_limit": 60.0,  # after which a request's planning stops [s]
    "clearance": 0.0,
    "goal_heading_mode": "DEFAULT",  # or BIDIRECTIONAL or ALL_DIRECTION, as of Nav2's Smac
    "goal_tolerance": 0.0,  # how far from a goal a path may end [m]
    "reverse": True,  # whether it may drive backwards, where the model's vehicle may
    "to_pose_action": "compute_path_to_pose",
    "through_poses_action": "compute_path_through_poses",
    "is_path_valid_service": "is_path_valid",
    # Nav2's behaviour trees call it to clear the global costmap, which this node does not have
    "clear_service": "global_costmap/clear_entirely_global_costmap",  # none if empty
    "autostart": False,  # whether it configures and activates itself, without lifecycle_manager
}

RANGES = {
    "occupied_from": (0, 100),
    "transform_tolerance": (0.01, 3600.0),
    "effort": (0, 10**9),
    "time_limit": (0.01, 3600.0),
    "clearance": (0.0, 100.0),
    "goal_tolerance": (0.0, 100.0),
}
CHOICES = {"goal_heading_mode": tuple(ros.HEADING_MODES)}
CHANGING = (
    "transform_tolerance", "effort", "time_limit", "clearance", "goal_heading_mode",
    "goal_tolerance",
)  # fmt: skip
"""Parameters that can be changed at run time; they count from the next goal on."""

RESULT_TIMEOUT = 10
"""How long results are kept for whoever asks late [s]; Nav2's servers have the same."""

DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class PlannerNode(LifecycleNodeMixin, Node):
    """Serves both planning actions on the latest map while it is active."""

    def __init__(self) -> None:
        Node.__init__(self, "planner_server")
        # other services, and maps, are not held up while activating waits for the kernels
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        (change,) = (one for one in self.services if one.srv_type is ChangeState)
        change.callback = partial(self.on_change_state, change.callback)
        self.settings = declared(self, PARAMETERS, RANGES, CHANGING, CHOICES)
        planner_of(self.settings["planner"])
        self.active = self.ending = False
        self.cost: ep.EnergyCost | None = None
        self.outline: PolygonStamped | None = None
        self.planning = threading.Lock()  # one plan at a time
        self.goals: set[int] = set()  # under way or waiting
        self.newest: dict[Any, Any] = {}  # the goal of each action that was accepted last
        self.limit: SpeedLimit | None = None
        self.warming: threading.Thread | None = None
        self.frame = "map"
        self.grid: ep.OccupancyGrid | None = None
        self.mask: ep.OccupancyGrid | None = None
        self.zones: OccupancyGrid | None = None  # the message that the mask came by
        self.said: set[str] = set()  # of masks, which may come again and again
        self.open: ep.OccupancyGrid | None = None  # the map with the mask
        self.missing = f"no map has come on {self.settings['map_topic']}; publish one"
        self.answered: ros.PlanResult | None = None  # Nav2 asks for the same goal again and again
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.bond = Bond(self)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        map_topic = self.settings["map_topic"]
        for kind, name, callback, qos in (
            (OccupancyGrid, map_topic, self.on_map, latched),
            (OccupancyGridUpdate, f"{map_topic}_updates", self.on_update, 10),
            (OccupancyGrid, self.settings["keepout_topic"], self.on_mask, latched),
            (PolygonStamped, self.settings["footprint_topic"], self.on_footprint, latched),
            (SpeedLimit, self.settings["speed_limit_topic"], self.on_speed_limit, 10),
        ):
            if name:
                self.create_subscription(kind, name, callback, qos)
        self.paths = self.create_publisher(Path, "plan", 1)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        # goals are cancelled, and services asked, while a plan is made
        beside = ReentrantCallbackGroup()
        self.servers = [
            ActionServer(
                self, kind, self.settings[name], partial(self.on_goal, kind),
                goal_callback=self.on_request,
                handle_accepted_callback=partial(self.on_accepted, kind),
                cancel_callback=lambda handle: CancelResponse.ACCEPT, callback_group=beside,
                result_timeout=RESULT_TIMEOUT,
            )
            for kind, name in (
                (ComputePathToPose, "to_pose_action"),
                (ComputePathThroughPoses, "through_poses_action"),
            )
        ]  # fmt: skip
        services = [
            (IsPathValid, self.settings["is_path_valid_service"], self.on_is_path_valid),
            (ClearEntireCostmap, self.settings["clear_service"], self.on_clear),
        ]
        if self.settings["mission_folder"]:
            from energyplan_interfaces.srv import EvaluateMission

            services.append((EvaluateMission, "~/evaluate_mission", self.on_mission))
        for kind, name, callback in services:
            if name:
                self.create_service(kind, name, callback, callback_group=beside)
        if self.settings["autostart"]:
            self.starting = self.create_timer(
                0.1, self.start, callback_group=MutuallyExclusiveCallbackGroup(),
                clock=Clock(clock_type=ClockType.STEADY_TIME),
            )  # fmt: skip

    # -- lifecycle ------------------------------------------------------------------------------

    def start(self) -> None:
        """Configure and activate without a lifecycle_manager, as soon as the node is spun."""
        self.starting.cancel()
        try:
            if self.trigger_configure() == DONE:
                self.trigger_activate()
        except RuntimeError as error:  # rclpy's RCLError
            self.get_logger().warning(f"autostart: {error}")

    def on_change_state(self, change: Any, request: Any, response: Any) -> Any:
        """Change the state; rclpy raises where it is impossible, and would answer nothing."""
        try:
            return change(request, response)
        except RuntimeError as error:  # rclpy's RCLError
            self.get_logger().warning(f"transition {request.transition.id}: {error}")
            response.success = False
            return response

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        """Read the model, and begin to compile what planning needs."""
        if self.ending:
            return FAILED
        try:
            model = ep.read_model(self.settings["model"])
            reverse = model.vehicle.reverse and self.settings["reverse"]
            self.cost = ep.EnergyCost(
                replace(model, vehicle=replace(model.vehicle, reverse=reverse))
            )
        except EnergyPlanError as error:
            self.get_logger().error(f"model: {error}")
            return FAILED
        self.take_footprint()
        self.warming = threading.Thread(target=self.warm_up, args=(self.cost,), daemon=True)
        self.warming.start()
        return DONE

    def warm_up(self, cost: ep.EnergyCost) -> None:
        """Compile what planning needs, so that no goal waits for it."""
        log, began = self.get_logger(), time.monotonic()

        def say(kernel: str) -> None:
            log.info("compiling takes minutes once; `energyplan warmup` does it ahead", once=True)

        try:
            with telling(say):
                ros.warm_up(cost, self.settings["planner"], lambda: self.ending)
        except EnergyPlanError as error:
            if not self.ending:
                log.warning(f"compiling: {error}")
            return
        log.info(f"ready to plan after {time.monotonic() - began:.1f} s")

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Take goals, once everything is compiled."""
        while self.warming is not None and self.warming.is_alive() and not self.ending:
            self.warming.join(0.1)
        if self.ending:
            return FAILED
        self.active = True
        self.bond.start()
        return DONE

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Take no more goals; those under way are aborted."""
        self.active = False
        self.bond.stop()
        return DONE

    def on_cleanup(self, state: Any) -> TransitionCallbackReturn:
        """Forget the model and the last answer."""
        self.cost = self.answered = None
        return DONE

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        """End as deactivated."""
        return self.on_deactivate(state)

    def stop(self) -> Any:
        """Abort what is under way; return what tells whether anything still is."""
        self.active, self.ending = False, True
        self.bond.stop()
        return lambda: bool(self.goals) or (self.warming is not None and self.warming.is_alive())

    def destroy_node(self) -> None:
        """Destroy the action servers first."""
        for server in self.servers:
            server.destroy()
        super().destroy_node()

    # -- what is known --------------------------------------------------------------------------

    def on_map(self, message: OccupancyGrid) -> None:
        """Keep the map; a malformed one leaves none."""
        self.frame, self.grid = message.header.frame_id, None
        try:
            self.grid = ros.grid_from_message(
                message,
                occupied_from=self.settings["occupied_from"] or None,
                unknown_is_free=self.settings["unknown_is_free"],
            )
        except EnergyPlanError as error:
            self.missing = f"the last map is malformed: {error}"
            self.get_logger().error(self.missing)
        self.mask_map()

    def on_update(self, message: OccupancyGridUpdate) -> None:
        """Change a part of the map, as costmaps do that do not send themselves whole."""
        if self.grid is None:
            return
        least = self.settings["occupied_from"] or None
        try:
            self.grid = ros.updated_grid(self.grid, message, occupied_from=least, frame=self.frame)
        except EnergyPlanError as error:
            self.get_logger().error(f"update of the map: {error}")
            return
        self.mask_map()

    def on_mask(self, message: OccupancyGrid) -> None:
        """Keep the mask of the keep-out filter, which 100 alone closes."""
        try:
            self.mask = ros.grid_from_message(message, occupied_from=KEEPOUT)
        except EnergyPlanError as error:
            self.get_logger().error(f"keep-out mask: {error}")
            return
        self.zones = message
        self.mask_map()
        notes = [ros.note_of_keepout(message)]
        if self.open is not None:
            notes.append(self.grid.note_of_mask(self.mask))
        for note in notes:
            if note and note not in self.said:
                self.said.add(note)
                self.get_logger().warning(f"keep-out mask: {note}")

    def mask_map(self) -> None:
        """Make the map that is planned on; where the mask cannot be laid on it there is none."""
        self.open = self.grid
        if self.grid is None or self.mask is None:
            return
        self.open = None
        try:
            check_frame(self.zones, self.frame, "keep-out mask")
            self.open = self.grid.with_mask(self.mask)
        except EnergyPlanError as error:
            self.missing = str(error)
            self.get_logger().error(self.missing, throttle_duration_sec=10.0)

    def on_speed_limit(self, message: SpeedLimit) -> None:
        """Keep the speed limit, by which plans are timed; none where it is zero."""
        try:
            limit = ros.speed_limit_from_message(message, shapely.box(0.0, 0.0, 1.0, 1.0))
            if limit is not None and self.cost is not None:
                limit.of(self.cost.vehicle)
        except EnergyPlanError as error:
            self.get_logger().error(f"speed limit: {error}")
            return
        self.limit = message

    def on_footprint(self, message: PolygonStamped) -> None:
        """Keep the footprint."""
        self.outline = message
        self.take_footprint()

    def take_footprint(self) -> None:
        """Plan with the footprint that has come, if any has."""
        if self.cost is None or self.outline is None:
            return
        model = self.cost.model
        try:
            vehicle = ros.footprint_from_message(
                self.outline, model.vehicle, self.settings["base_frame"]
            )
        except EnergyPlanError as error:
            self.get_logger().error(f"footprint: {error}")
            return
        if not (vehicle.footprint == model.vehicle.footprint).all():
            self.cost = ep.EnergyCost(replace(model, vehicle=vehicle))

    def lookup(self, target: str, frame: str) -> Any:
        """Return the transform that brings what is in a frame into the map's.

        The robot's own must be recent: a localisation that has died leaves its last one behind.
        """
        try:
            found = self.buffer.lookup_transform(target, frame, Time())
        except TransformException as error:
            raise FrameError(f"no transform from {frame!r} to {target!r}: {error}") from None
        stamp, allowed = found.header.stamp, self.settings["transform_tolerance"]
        seconds = stamp.sec + 1e-9 * stamp.nanosec  # 0 where all frames between are fixed
        age = 1e-9 * self.get_clock().now().nanoseconds - seconds
        if frame == self.settings["base_frame"] and seconds > 0 and age > allowed:
            raise FrameError(
                f"the last transform from {frame!r} to {target!r} is {age:.1f} s old; check "
                f"localisation, or raise transform_tolerance ({allowed:g} s)"
            )
        return found

    # -- services -------------------------------------------------------------------------------

    def on_mission(self, request: Any, response: Any) -> Any:
        """Tell whether a mission can be done."""
        response.answer = ros.mission_answer(request.mission, self.settings["mission_folder"])
        return response

    def on_clear(self, request: Any, response: Any) -> Any:
        """Plan the next goal anew; there is no costmap here to clear."""
        self.answered = None
        if hasattr(response, "success"):
            response.success = True
        return response

    def on_is_path_valid(self, request: Any, response: Any) -> Any:
        """Tell whether a path is free from where the robot is."""
        response.is_valid, blocked, answered = False, [], False
        frame, grid, cost = self.frame, self.open, self.cost
        if grid is not None and cost is not None:
            try:
                blocked = ros.blocked_poses(
                    request.path, grid, cost.vehicle, frame,
                    partial(self.lookup, frame), self.settings["base_frame"],
                )  # fmt: skip
                response.is_valid = len(request.path.poses) > 0 and not blocked
                answered = True
            except EnergyPlanError as error:
                self.get_logger().warning(f"is_path_valid: {error}")
        if hasattr(response, "invalid_pose_indices"):
            response.invalid_pose_indices = blocked
        if hasattr(response, "success"):
            response.success = answered
        return response

    # -- goals ----------------------------------------------------------------------------------

    def on_request(self, request: Any) -> GoalResponse:
        """Take goals while active."""
        if not self.active:
            self.get_logger().warning("a goal was rejected: the node is not active")
        return GoalResponse.ACCEPT if self.active else GoalResponse.REJECT

    def on_accepted(self, kind: Any, handle: Any) -> None:
        """Start a goal, which ends those before it of the same action, as Nav2's servers do."""
        self.newest[kind] = handle
        handle.execute()

    def on_goal(self, kind: Any, handle: Any) -> Any:
        """Answer a goal; one of the other action waits for its turn."""
        self.goals.add(id(handle))
        try:
            return self.answer(kind, handle)
        finally:
            self.goals.discard(id(handle))

    def answer(self, kind: Any, handle: Any) -> Any:
        """Plan, publish and end a goal."""

        def unwanted() -> bool:
            newer = self.newest[kind] is not handle
            return bool(handle.is_cancel_requested) or newer or not self.active

        settings = self.settings
        while not self.planning.acquire(timeout=0.05):
            if unwanted():
                return self.ended(kind, handle)
        try:
            if unwanted():
                return self.ended(kind, handle)
            frame = self.frame
            found = ros.answer(
                handle.request,
                self.open,
                self.cost,
                frame=frame,
                base=settings["base_frame"],
                lookup=partial(self.lookup, frame),
                planner=settings["planner"],
                effort=settings["effort"] or None,
                time_limit=settings["time_limit"],
                clearance=settings["clearance"],
                heading_mode=settings["goal_heading_mode"],
                tolerance=settings["goal_tolerance"],
                unwanted=unwanted,
                former=self.answered,
                missing=self.missing,
            )
            if found.plans:  # what fails now leaves the former plan to go on from
                self.answered = found
        except CancelledError:
            return self.ended(kind, handle)
        finally:
            self.planning.release()
        stamp = self.get_clock().now().to_msg()
        result = ros.fill_result(kind.Result(), found, frame, stamp, get_message)
        values = ros.plan_values(found, self.limit)
        self.diagnostics.publish(
            ros.diagnostics_message(
                "energyplan: plan", found.message or "planned", values, stamp,
                get_message, error=not found.plans,
            )
        )  # fmt: skip
        for note in found.notes:
            self.get_logger().info(note, throttle_duration_sec=10.0)
        if found.plans:
            self.paths.publish(result.path)
            handle.succeed()
        else:
            self.get_logger().warning(f"{found.code.name}: {found.message}")
            handle.abort()
        return result

    def ended(self, kind: Any, handle: Any) -> Any:
        """End a goal that was cancelled, or that a newer one or the node's own end aborts."""
        if handle.is_cancel_requested:
            handle.canceled()
            return kind.Result()
        handle.abort()
        why = "a newer goal has come" if self.active else "the planner was deactivated"
        told = ros.aborted(handle.request, f"{why} while it planned")
        stamp = self.get_clock().now().to_msg()
        return ros.fill_result(kind.Result(), told, self.frame, stamp, get_message)


def main() -> None:
    """Run the node until it is stopped."""
    sys.exit(run(PlannerNode))
