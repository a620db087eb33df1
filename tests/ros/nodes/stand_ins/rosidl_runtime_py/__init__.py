"""Stands in for ROS' package of this name, which no wheel brings."""
