"""The identifying node: learns the model while the robot drives, and tells it as diagnostics."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

import energyplan as ep
from energyplan import ros
from energyplan.errors import EnergyPlanError
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.bags import TopicMap
from energyplan_ros.running import run

PARAMETERS = {
    "model": "quadriga:empty:concrete",  # where learning starts
    "topics": "jackal",  # a topic map: a file, or the name of a ready-made one
    "battery_side": True,  # whether the power is measured at the battery
    "period": 5.0,  # between two diagnostics [s]
    "out": "",  # file that the model is written to; none if empty
}


class IdentifierNode(Node):
    """Listens to the topics of a topic map, as soon as somebody publishes them."""

    def __init__(self) -> None:
        super().__init__("energyplan_identifier")
        self.declare_parameters("", list(PARAMETERS.items()))
        self.settings = {name: self.get_parameter(name).value for name in PARAMETERS}
        prior = ep.read_model(self.settings["model"])
        self.online = OnlineIdentifier(prior, battery=self.settings["battery_side"])
        self.feed = ros.DriveFeed(self.online, TopicMap.read(self.settings["topics"]))
        self.heard: set[str] = set()
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.create_timer(1.0, self.listen)
        self.create_timer(self.settings["period"], self.tell)

    def listen(self) -> None:
        """Subscribe to what has come up; what cannot be read is told once, and left out."""
        for topic, kinds in self.get_topic_names_and_types():
            wanted = any(topic.endswith(f"/{name.strip('/')}") for name in self.feed.topics)
            if wanted and topic not in self.heard:
                self.heard.add(topic)
                try:
                    self.create_subscription(
                        get_message(kinds[0]), topic, partial(self.on_message, topic),
                        qos_profile_sensor_data,
                    )  # fmt: skip
                except Exception as error:  # noqa: BLE001  whatever an import or a type support raises
                    package = kinds[0].partition("/")[0]
                    self.get_logger().error(
                        f"{topic}: messages of the type {kinds[0]} cannot be read ({error}); "
                        f"install the package {package}. The other topics are read on"
                    )

    def on_message(self, topic: str, message: Any) -> None:
        """Feed a message."""
        try:
            changed = self.feed.take(topic, message, self.get_clock().now().nanoseconds * 1e-9)
        except EnergyPlanError as error:
            self.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=10.0)
            return
        if changed:
            self.get_logger().info("the ground has changed")
            self.tell()

    def tell(self) -> None:
        """Publish the model, and write it."""
        values = {"samples": str(self.feed.samples), **ros.model_values(self.online.model)}
        message = f"{len(self.online.changes)} changes of ground"
        stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(
            ros.diagnostics_message("energyplan: model", message, values, stamp, get_message)
        )
        if self.settings["out"] and self.feed.samples:
            ep.write_model(self.online.model, self.settings["out"])


def main() -> None:
    """Run the node until it is stopped."""
    sys.exit(run(IdentifierNode))
