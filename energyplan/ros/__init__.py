"""ROS messages to the library and back, and Nav2's planning actions, without importing ROS.

A message is anything with the fields of the ROS message: what rclpy hands over, what rosbags reads,
or an object of one's own. `energyplan.ros.messages` converts maps, poses, footprints, paths and
whole plans; `energyplan.ros.nav2` answers what a node is asked.
"""

from energyplan.ros.messages import (
    costs_from_message,
    footprint_from_message,
    grid_from_message,
    note_of_keepout,
    path_to_message,
    pose_from_message,
    pose_from_transform,
    speed_limit_from_message,
    updated_grid,
    write_recording,
)  # fmt: skip
from energyplan.ros.nav2 import (
    HEADING_MODES,
    DriveFeed,
    PlanResult,
    ThroughPosesError,
    ToPoseError,
    aborted,
    answer,
    blocked_poses,
    diagnostics_message,
    error_code,
    fill_result,
    mission_answer,
    model_values,
    plan_values,
    request_to_problems,
    warm_up,
)  # fmt: skip

__all__ = [
    "HEADING_MODES",
    "DriveFeed",
    "PlanResult",
    "ThroughPosesError",
    "ToPoseError",
    "aborted",
    "answer",
    "blocked_poses",
    "costs_from_message",
    "diagnostics_message",
    "error_code",
    "fill_result",
    "footprint_from_message",
    "grid_from_message",
    "mission_answer",
    "model_values",
    "note_of_keepout",
    "path_to_message",
    "plan_values",
    "pose_from_message",
    "pose_from_transform",
    "request_to_problems",
    "speed_limit_from_message",
    "updated_grid",
    "warm_up",
    "write_recording",
]  # fmt: skip
