"""ROS messages to the library and back, and Nav2's planning actions, without importing ROS.

A message is anything with the fields of the ROS message: what rclpy hands over, what rosbags reads,
or an object of one's own. `energyplan.ros.messages` converts maps, poses, footprints and paths;
`energyplan.ros.nav2` answers the requests that Nav2's ``planner_server`` answers.
"""

from energyplan.ros.messages import (
    footprint_from_message,
    grid_from_message,
    path_to_message,
    pose_from_message,
    pose_from_transform,
)
from energyplan.ros.nav2 import (
    Answer,
    ThroughPosesError,
    ToPoseError,
    answer,
    error_code,
    fill_result,
    request_to_problems,
)

__all__ = [
    "Answer",
    "ThroughPosesError",
    "ToPoseError",
    "answer",
    "error_code",
    "fill_result",
    "footprint_from_message",
    "grid_from_message",
    "path_to_message",
    "pose_from_message",
    "pose_from_transform",
    "request_to_problems",
]
