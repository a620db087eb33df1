"""What `.ci/nodes` builds and stands in for ROS' packages holds no tests."""

collect_ignore = ["nodes"]
