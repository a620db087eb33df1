"""Starts the planning node in place of Nav2's planner_server, with a lifecycle_manager of its own.

ros2 launch energyplan_ros planner.launch.py params_file:=/path/to/planner.yaml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the node, and the manager unless another one manages it."""
    here = FindPackageShare("energyplan_ros")
    sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    return LaunchDescription([
        DeclareLaunchArgument(
            "params_file", default_value=PathJoinSubstitution([here, "config", "planner.yaml"])
        ),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
        DeclareLaunchArgument(
            "manage", default_value="true",
            description="false where Nav2's own lifecycle_manager has planner_server in node_names",
        ),
        Node(
            package="energyplan_ros", executable="planner", name="planner_server",
            output="screen",
            parameters=[LaunchConfiguration("params_file"), {"use_sim_time": sim_time}],
        ),
        Node(
            package="nav2_lifecycle_manager", executable="lifecycle_manager",
            name="lifecycle_manager_energyplan", output="screen",
            condition=IfCondition(LaunchConfiguration("manage")),
            parameters=[
                {"use_sim_time": sim_time},
                {"autostart": True},
                {"node_names": ["planner_server"]},
            ],
        ),
    ])  # fmt: skip
