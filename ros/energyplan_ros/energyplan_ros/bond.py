"""The bond by which Nav2's lifecycle_manager sees that an active node is alive."""

from __future__ import annotations

from threading import Lock
from typing import Any
from uuid import uuid4

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType

try:
    from bond.msg import Status
except ImportError:  # without the package there is no bond: lifecycle_manager's bond_timeout is 0
    Status = None

TOPIC, PERIOD, TIMEOUT = "bond", 0.1, 4.0
"""Topic, period and timeout [s], as nav2_util::LifecycleNode has them."""


class Bond:
    """Sends heartbeats while the node is active, and says goodbye."""

    def __init__(self, node: Any) -> None:
        self.node, self.instance = node, str(uuid4())
        self.alive = False
        self.lock = Lock()  # so that no heartbeat follows the goodbye
        if Status is None:
            node.get_logger().warning(
                "the package bond is not installed: set bond_timeout of lifecycle_manager to 0.0"
            )
            return
        group = ReentrantCallbackGroup()  # beats while other callbacks wait
        self.publisher = node.create_publisher(Status, TOPIC, 5)
        node.create_subscription(Status, TOPIC, self.on_status, 5, callback_group=group)
        # as bondcpp, on a clock that runs while the simulated one stands still
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self.beat, callback_group=group, clock=steady)

    def start(self) -> None:
        """Begin to send heartbeats."""
        self.instance, self.alive = str(uuid4()), True

    def stop(self) -> None:
        """Say that the node ends in order."""
        with self.lock:
            if self.alive:
                self.alive = False
                self.send(active=False)

    def beat(self) -> None:
        """Send a heartbeat."""
        with self.lock:
            if self.alive:
                self.send(active=True)

    def on_status(self, message: Any) -> None:
        """Answer the manager's goodbye with one's own."""
        of_manager = message.id == self.node.get_name() and message.instance_id != self.instance
        if of_manager and not message.active and self.alive:
            self.send(active=False)

    def send(self, *, active: bool) -> None:
        """Send a status."""
        if Status is None:
            return
        message = Status()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.id, message.instance_id, message.active = (
            self.node.get_name(), self.instance, active,
        )  # fmt: skip
        message.heartbeat_timeout, message.heartbeat_period = TIMEOUT, PERIOD
        self.publisher.publish(message)
