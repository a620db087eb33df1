"""Definitions of Nav2's messages that rosbags does not carry, as published with Nav2."""

from __future__ import annotations

from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

COSTMAP_METADATA = """
builtin_interfaces/Time map_load_time
builtin_interfaces/Time update_time
string layer
float32 resolution
uint32 size_x
uint32 size_y
geometry_msgs/Pose origin
"""
COSTMAP = """
std_msgs/Header header
nav2_msgs/CostmapMetaData metadata
uint8[] data
"""
TO_POSE = """
geometry_msgs/PoseStamped goal
geometry_msgs/PoseStamped start
string planner_id
bool use_start
"""
THROUGH_POSES = """
geometry_msgs/PoseStamped[] goals
geometry_msgs/PoseStamped start
string planner_id
bool use_start
"""
THROUGH_POSES_KILTED = THROUGH_POSES.replace("geometry_msgs/PoseStamped[]", "nav_msgs/Goals")
RESULT_HUMBLE = """
nav_msgs/Path path
builtin_interfaces/Duration planning_time
"""
RESULT = (
    RESULT_HUMBLE
    + """
uint16 error_code
string error_msg
"""
)


def store(distribution: str) -> Any:
    """Return the types of a distribution with Nav2's own added."""
    types = get_typestore(Stores[f"ROS2_{distribution.upper()}"])
    through = THROUGH_POSES_KILTED if distribution == "kilted" else THROUGH_POSES
    result = RESULT_HUMBLE if distribution == "humble" else RESULT
    for name, text in (
        ("nav2_msgs/msg/CostmapMetaData", COSTMAP_METADATA),
        ("nav2_msgs/msg/Costmap", COSTMAP),
        ("nav2_msgs/action/ComputePathToPose_Goal", TO_POSE),
        ("nav2_msgs/action/ComputePathThroughPoses_Goal", through),
        ("nav2_msgs/action/ComputePath_Result", result),
    ):
        types.register(get_types_from_msg(text, name))
    return types
