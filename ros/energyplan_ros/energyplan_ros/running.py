"""Runs a node until SIGINT or SIGTERM, and ends it in order: goals aborted, exit code 0."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from types import MappingProxyType
from typing import Any

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    NameValidationException,
    ParameterException,
)
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

from energyplan.errors import EnergyPlanError, InvalidInputError

THREADS = 8
"""Callbacks at once: goals, of which one is planned and others wait, and all that is quick."""

GRACE = 3.0
"""How long what is under way may take to end [s]; launch sends SIGTERM after five."""

FAREWELL = 0.5
"""How long requests are still answered then [s]: a manager that lost the bond asks at once."""


class _Pool(ThreadPoolExecutor):
    """Runs an executor's tasks; a task that waits for a thread counts as being executed."""

    def __init__(self, threads: int, wake: Callable[[], None]) -> None:
        super().__init__(threads)
        self.wake = wake

    def submit(self, task: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a task of rclpy, whose own `executing` is only true once a thread has taken it."""
        task.executing = lambda: True
        return super().submit(self.run, task)

    def run(self, task: Any) -> None:
        """Run the task until it ends or has to wait."""
        try:
            task()
        finally:
            del task.executing
        if not task.done():
            self.wake()


class Executor(MultiThreadedExecutor):
    """A MultiThreadedExecutor that hands each task to its threads once.

    That of rclpy hands a task that waits for a thread over again and again, and meanwhile hears
    no topic (ros2/rclpy#1452).
    """

    def __init__(self) -> None:
        super().__init__(num_threads=THREADS)
        self._executor.shutdown()  # it has no threads yet
        self._executor = _Pool(THREADS, self.wake)


def declared(
    node: Any,
    parameters: Mapping[str, Any],
    ranges: Mapping[str, tuple[Any, Any]],
    changing: Collection[str] = (),
    choices: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> dict[str, Any]:
    """Declare parameters, and return their values, of which those in `changing` follow changes."""

    def fault(name: str, value: Any) -> str:
        known = choices.get(name, (value,))
        return "" if value in known else f"{name} is {value!r}; give one of {', '.join(known)}"

    for name, value in parameters.items():
        descriptor = ParameterDescriptor()
        if name in ranges:
            least, most = ranges[name]
            if isinstance(value, int):
                descriptor.integer_range = [IntegerRange(from_value=least, to_value=most)]
            else:
                between = FloatingPointRange(from_value=least, to_value=most)
                descriptor.floating_point_range = [between]
        node.declare_parameter(name, value, descriptor)
    settings = {name: node.get_parameter(name).value for name in parameters}
    for name, value in settings.items():
        if wrong := fault(name, value):
            raise InvalidInputError(wrong)

    def check(wanted: list[Any]) -> SetParametersResult:
        for one in wanted:
            if one.name in settings and one.name not in changing:
                return SetParametersResult(
                    successful=False,
                    reason=f"{one.name} is read when the node starts; start it again with the new "
                    f"value (at run time: {', '.join(changing) or 'none'})",
                )
            if wrong := fault(one.name, one.value):
                return SetParametersResult(successful=False, reason=wrong)
        return SetParametersResult(successful=True)

    def follow(changed: list[Any]) -> None:
        settings.update({one.name: one.value for one in changed if one.name in changing})

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(follow)
    return settings


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
        remedy = ""
        if isinstance(error, InvalidParameterTypeException):
            remedy = "; write a whole number that may have decimals as 1.0"
        get_logger("energyplan").fatal(" ".join(str(error).split()) + remedy)
        rclpy.try_shutdown()
        return 2
    executor = Executor()
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
