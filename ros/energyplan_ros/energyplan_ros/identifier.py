"""The identifying node: learns the model while the robot drives, and tells it as diagnostics."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

import energyplan as ep
from energyplan import ros
from energyplan.errors import EnergyPlanError
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.bags import TopicMap
from energyplan_ros.running import declared, run

PARAMETERS = {
    "model": "quadriga:empty:concrete",  # where learning starts
    "topics": "jackal",  # a topic map: a file, or the name of a ready-made one
    "battery_side": True,  # whether the power is measured at the battery
    "period": 5.0,  # between two diagnostics [s]
    "out": "",  # file that the model is written to; none if empty
}
RANGES = {"period": (0.1, 3600.0)}


class IdentifierNode(Node):
    """Listens to the topics of a topic map, as soon as somebody publishes them."""

    def __init__(self) -> None:
        super().__init__("energyplan_identifier")
        self.settings = declared(self, PARAMETERS, RANGES)
        prior = ep.read_model(self.settings["model"])
        self.online = OnlineIdentifier(prior, battery=self.settings["battery_side"])
        self.feed = ros.DriveFeed(self.online, TopicMap.read(self.settings["topics"]))
        self.heard: set[str] = set()
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        # a simulated clock that stands still stops neither
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.listen, clock=steady)
        self.create_timer(self.settings["period"], self.tell, clock=steady)

    def listen(self) -> None:
        """Subscribe to what has come up in this namespace; what cannot be read is logged."""
        wanted = {self.resolve_topic_name(name): name for name in self.feed.topics}
        for topic, kinds in self.get_topic_names_and_types():
            if topic in wanted and topic not in self.heard:
                self.heard.add(topic)
                try:
                    self.create_subscription(
                        get_message(kinds[0]), topic, partial(self.on_message, wanted[topic]),
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
            changed = self.feed.take(topic, message, self.now())
        except EnergyPlanError as error:
            self.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=10.0)
            return
        if changed:
            self.get_logger().info("the ground has changed")
            self.tell()

    def now(self) -> float:
        """Return the time [s]."""
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def tell(self) -> None:
        """Publish the model, and write it; say what is missing to learn from."""
        values = {"samples": str(self.feed.samples), **ros.model_values(self.online.model)}
        message = f"{len(self.online.changes)} changes of ground"
        missing = self.feed.missing(self.now())
        if missing:
            message = f"nothing to learn from in {self.get_namespace()}: no {missing}"
            self.get_logger().warning(message, throttle_duration_sec=60.0)
        wrong = self.feed.wrong_sign
        if wrong:
            message = f"{message}; {wrong}"
            self.get_logger().warning(wrong, throttle_duration_sec=60.0)
        stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(
            ros.diagnostics_message(
                "energyplan: model",
                message,
                values,
                stamp,
                get_message,
                error=bool(missing or wrong),
            )
        )
        if self.settings["out"] and self.feed.samples:
            ep.write_model(self.online.model, self.settings["out"])


def main() -> None:
    """Run the node until it is stopped."""
    sys.exit(run(IdentifierNode))
