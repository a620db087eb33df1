"""Runs a node until SIGINT or SIGTERM, and ends it in order: goals aborted, exit code 0."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

from energyplan.errors import EnergyPlanError

THREADS = 8
"""Callbacks at once: goals, of which one is planned and others wait, and all that is quick."""

GRACE = 3.0
"""How long what is under way may take to end [s]; launch sends SIGTERM after five."""

FAREWELL = 0.5
"""How long requests are still answered then [s]: a manager that lost the bond asks at once."""


def declared(
    node: Any, parameters: Mapping[str, Any], ranges: Mapping[str, tuple[Any, Any]]
) -> dict[str, Any]:
    """Declare parameters, which stay as they are while the node runs, and return their values."""
    for name, value in parameters.items():
        descriptor = ParameterDescriptor(read_only=True)
        if name in ranges:
            least, most = ranges[name]
            if isinstance(value, int):
                descriptor.integer_range = [IntegerRange(from_value=least, to_value=most)]
            else:
                between = FloatingPointRange(from_value=least, to_value=most)
                descriptor.floating_point_range = [between]
        node.declare_parameter(name, value, descriptor)
    return {name: node.get_parameter(name).value for name in parameters}


def run(make: Callable[[], Any]) -> int:
    """Run the node that `make` returns; its `stop`, if it has one, ends what is under way."""
    # rclpy's own handlers would end the context while goals still need it to answer
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    try:
        node = make()
    except (EnergyPlanError, ParameterException, NameValidationException) as error:
        get_logger("energyplan").fatal(" ".join(str(error).split()))
        rclpy.try_shutdown()
        return 2
    executor = MultiThreadedExecutor(num_threads=THREADS)
    executor.add_node(node)

    def spin() -> None:
        try:
            executor.spin_once(timeout_sec=0.1)
        except ExternalShutdownException:
            stopped.set()
        except Exception as error:  # noqa: BLE001  one callback's fault does not end the node
            node.get_logger().error(f"{type(error).__name__}: {error}")

    while rclpy.ok() and not stopped.is_set():
        spin()
    busy = node.stop() if hasattr(node, "stop") else lambda: False
    end = time.monotonic() + GRACE
    while rclpy.ok() and busy() and time.monotonic() < end:
        spin()
    end = time.monotonic() + FAREWELL
    while rclpy.ok() and time.monotonic() < end:
        spin()
    late = busy()
    if not late:
        executor.shutdown(timeout_sec=GRACE)
        node.destroy_node()
        rclpy.try_shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    if late:  # a kernel is being compiled, which nothing interrupts
        os._exit(0)
    return 0
