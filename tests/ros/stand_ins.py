"""Stand-ins for what the nodes import of ROS, enough to run them: they hold what a node makes."""

from __future__ import annotations

import sys
import threading
import time
from enum import Enum
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar


def _definitions() -> Any:
    spec = spec_from_file_location("ros_definitions", Path(__file__).with_name("definitions.py"))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Message(SimpleNamespace):
    """A message with whatever fields it is given."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        made = Message()
        setattr(self, name, made)
        return made


class Action:
    """The type of an action."""

    @staticmethod
    def Result() -> Any:  # noqa: N802
        return SimpleNamespace(path=None, planning_time=None, error_code=0, error_msg="")


class Return(Enum):
    SUCCESS, FAILURE, ERROR = 0, 1, 2


class Answer(Enum):
    ACCEPT, REJECT = 1, 2


class RCLError(RuntimeError):
    """What rclpy raises of rcl's errors."""


class ParameterException(Exception):  # noqa: N818
    """What rclpy raises of parameters."""


class ClockType(Enum):
    ROS_TIME, STEADY_TIME = 1, 3


class Clock:
    def __init__(self, *, clock_type: ClockType) -> None:
        self.clock_type = clock_type


class ReentrantCallbackGroup:
    """A group whose callbacks run beside each other."""

    def enter(self, timeout: float) -> bool:
        return True

    def leave(self) -> None:
        pass


class MutuallyExclusiveCallbackGroup(ReentrantCallbackGroup):
    """A group of which one callback runs at a time."""

    def __init__(self) -> None:
        self.enter_in = threading.Lock()

    def enter(self, timeout: float) -> bool:
        return self.enter_in.acquire(timeout=timeout)

    def leave(self) -> None:
        self.enter_in.release()


class Timer:
    def __init__(self, period: float, callback: Any, group: Any, steady: bool) -> None:
        self.period, self.callback, self.group, self.steady = period, callback, group, steady
        self.due, self.cancelled = period, False

    def cancel(self) -> None:
        self.cancelled = True


class Descriptor(SimpleNamespace):
    read_only = False
    integer_range = floating_point_range = ()


class Node:
    """Holds what a node makes; refuses parameters, keeps groups and counts time as rclpy does."""

    overrides: ClassVar[dict[str, Any]] = {}  # parameters that are given from outside
    namespace = "/"

    def __init__(self, name: str) -> None:
        self._name, self._parameters, self._descriptors = name, {}, {}
        self._heard, self._published, self._log = {}, {}, []
        self._services: list[Any] = []
        self._timers: list[Timer] = []
        self._time = 100.0
        self.default_callback_group = MutuallyExclusiveCallbackGroup()
        self.topics: list[tuple[str, list[str]]] = []

    def get_name(self) -> str:
        return self._name

    def get_namespace(self) -> str:
        return self.namespace

    def resolve_topic_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self.namespace.rstrip('/')}/{topic}"

    def _refused(self, name: str, value: Any, descriptor: Any) -> str:
        for one in (*descriptor.integer_range, *descriptor.floating_point_range):
            if not one.from_value <= value <= one.to_value:
                return f"Parameter {name} out of range Min: {one.from_value}, Max: {one.to_value}"
        return ""

    def declare_parameter(self, name: str, value: Any, descriptor: Any = None) -> None:
        given, descriptor = self.overrides.get(name, value), descriptor or Descriptor()
        if type(given) is not type(value):
            raise ParameterException(
                f"Trying to set parameter {name!r} to {given!r} of type {type(given).__name__}, "
                f"expecting type {type(value).__name__}: {name}"
            )
        if reason := self._refused(name, given, descriptor):
            raise ParameterException(f"Invalid parameter value. Reason: {reason}: {name}")
        self._parameters[name], self._descriptors[name] = given, descriptor

    def declare_parameters(self, namespace: str, parameters: list[Any]) -> None:
        for row in parameters:
            self.declare_parameter(*row)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self._parameters[name])

    def set_parameters(self, parameters: list[Any]) -> list[Any]:
        results = []
        for one in parameters:
            descriptor = self._descriptors[one.name]
            reason = self._refused(one.name, one.value, descriptor)
            if descriptor.read_only:
                reason = f"Trying to set a read-only parameter: {one.name}."
            if not reason:
                self._parameters[one.name] = one.value
            results.append(SimpleNamespace(successful=not reason, reason=reason))
        return results

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, qos: Any, *, callback_group: Any = None
    ) -> None:
        self._heard[topic] = callback, callback_group or self.default_callback_group

    def create_publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        sent = self._published.setdefault(topic, [])
        return SimpleNamespace(publish=sent.append)

    def create_service(
        self, kind: Any, name: str, callback: Any, *, callback_group: Any = None
    ) -> None:
        group = callback_group or self.default_callback_group
        self._services.append(
            SimpleNamespace(srv_type=kind, srv_name=name, callback=callback, group=group)
        )

    @property
    def services(self) -> Any:
        yield from self._services

    def create_timer(
        self, period: float, callback: Any, callback_group: Any = None, clock: Any = None
    ) -> Timer:
        group = callback_group or self.default_callback_group
        steady = clock is not None and clock.clock_type is ClockType.STEADY_TIME
        self._timers.append(Timer(period, callback, group, steady))
        return self._timers[-1]

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return self.topics

    def get_clock(self) -> Any:
        stamp = STORE.types["builtin_interfaces/msg/Time"](sec=int(self._time), nanosec=0)
        now = SimpleNamespace(to_msg=lambda: stamp, nanoseconds=round(self._time * 1e9))
        return SimpleNamespace(now=lambda: now)

    def get_logger(self) -> Any:
        def log(level: str) -> Any:
            def write(text: str, **options: Any) -> None:
                self._log.append((level, text))
                sys.stderr.write(f"[{level}] {text}\n")

            return write

        return SimpleNamespace(**{n: log(n) for n in ("info", "warning", "error", "fatal")})

    def destroy_node(self) -> None:
        sys.stderr.write("node destroyed\n")

    # what tests ask

    def hear(self, topic: str, message: Any, timeout: float = 5.0) -> bool:
        """Hand a message over; tell whether its group let it in."""
        callback, group = self._heard[topic]
        if not group.enter(timeout):
            return False
        try:
            callback(message)
        finally:
            group.leave()
        return True

    def call(self, name: str, request: Any = None, timeout: float = 5.0, **answer: Any) -> Any:
        """Return a service's answer, or None if none is sent: it waits, or its callback raises."""
        (service,) = (one for one in self._services if one.srv_name == name)
        if not service.group.enter(timeout):
            return None
        try:
            return service.callback(request, Message(**answer))
        except Exception as error:  # noqa: BLE001
            sys.stderr.write(f"{error!r} in {name}\n")
            return None
        finally:
            service.group.leave()

    def wait(self, seconds: float, *, simulated: float | None = None) -> None:
        """Let time pass, on the simulated clock less or none; call the timers that are due."""
        shown = seconds if simulated is None else simulated
        self._time += shown
        for timer in self._timers:
            timer.due -= seconds if timer.steady else shown
            while timer.due <= 1e-9 and not timer.cancelled:
                timer.due += timer.period
                if not timer.group.enter(0.0):
                    break
                try:
                    timer.callback()
                finally:
                    timer.group.leave()

    def sent(self, topic: str) -> list[Any]:
        return list(self._published[topic])

    def told(self, level: str) -> str:
        return "\n".join(text for one, text in self._log if one == level)


CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
STEPS = {
    ("unconfigured", CONFIGURE): ("configuring", "on_configure", "inactive", "unconfigured"),
    ("inactive", CLEANUP): ("cleaningup", "on_cleanup", "unconfigured", "inactive"),
    ("inactive", ACTIVATE): ("activating", "on_activate", "active", "inactive"),
    ("active", DEACTIVATE): ("deactivating", "on_deactivate", "inactive", "active"),
    ("unconfigured", 5): ("shuttingdown", "on_shutdown", "finalized", "finalized"),
    ("inactive", 6): ("shuttingdown", "on_shutdown", "finalized", "finalized"),
    ("active", 7): ("shuttingdown", "on_shutdown", "finalized", "finalized"),
}
"""Transitions: the state meanwhile, the callback, the state after success and after failure."""


class ChangeState:
    """The type of a service."""


class LifecycleNodeMixin:
    """The state machine; a transition that is not registered raises inside its service."""

    def __init__(self, *, callback_group: Any = None) -> None:
        self._state = "unconfigured"
        for kind, name, callback in (
            (ChangeState, "change_state", self._on_change_state),
            (Message, "get_state", self._on_get_state),
        ):
            self.create_service(
                kind, f"{self.get_name()}/{name}", callback, callback_group=callback_group
            )

    def _change_state(self, number: int) -> Return:
        if (self._state, number) not in STEPS:
            raise RCLError(
                "Failed to trigger lifecycle state machine transition: Transition is not registered"
            )
        self._state, name, done, failed = STEPS[self._state, number]
        try:
            code = getattr(self, name)(None)
        except Exception:  # noqa: BLE001  rclpy says nothing of it either
            code = Return.ERROR
        self._state = {Return.SUCCESS: done, Return.FAILURE: failed}.get(code, "unconfigured")
        return code

    def _on_change_state(self, request: Any, response: Any) -> Any:
        response.success = self._change_state(request.transition.id) is Return.SUCCESS
        return response

    def _on_get_state(self, request: Any, response: Any) -> Any:
        response.current_state.label = self._state
        return response

    def trigger_configure(self) -> Return:
        return self._change_state(CONFIGURE)

    def trigger_activate(self) -> Return:
        return self._change_state(ACTIVATE)


class LifecycleNode(LifecycleNodeMixin, Node):
    """A node with its lifecycle's services in the default group."""

    def __init__(self, name: str) -> None:
        Node.__init__(self, name)
        LifecycleNodeMixin.__init__(self)


class ActionServer:
    def __init__(
        self, node: Any, kind: Any, name: str, execute: Any, *, goal_callback: Any,
        cancel_callback: Any, callback_group: Any, result_timeout: float = 900,
    ) -> None:  # fmt: skip
        self.name, self.execute, self.goal_callback = name, execute, goal_callback
        self.result_timeout = result_timeout

    def destroy(self) -> None:
        pass


class Buffer:
    at: Any = None  # the robot's stamped pose, if TF knows it

    def lookup_transform(self, target: str, frame: str, when: Any) -> Any:
        if self.at is None:
            raise TransformException(f"{frame} is not known")
        place = self.at.pose
        return SimpleNamespace(
            header=self.at.header,
            transform=SimpleNamespace(translation=place.position, rotation=place.orientation),
        )


class TransformException(Exception):  # noqa: N818
    pass


class Executor:
    def __init__(self, num_threads: int) -> None:
        pass

    def add_node(self, node: Any) -> None:
        self.node = node
        sys.stderr.write("spinning\n")

    def spin_once(self, timeout_sec: float) -> None:
        time.sleep(timeout_sec)
        threading.Thread(target=self.node.wait, args=(timeout_sec,), daemon=True).start()

    def shutdown(self, timeout_sec: float) -> None:
        pass


def _get_message(name: str) -> Any:
    package = name.partition("/")[0]
    if package == "missing_msgs":
        raise ModuleNotFoundError(f"No module named {package!r}")
    return STORE.types[name]


STORE = _definitions().store("jazzy")


def _any(*args: Any, **options: Any) -> Any:
    return SimpleNamespace(**options)


MODULES: dict[str, dict[str, Any]] = {
    "rclpy": {"init": _any, "ok": lambda: True, "try_shutdown": _any},
    "rclpy.executors": {
        "MultiThreadedExecutor": Executor,
        "ExternalShutdownException": type("ExternalShutdownException", (Exception,), {}),
    },
    "rclpy.logging": {"get_logger": lambda name: Node(name).get_logger()},
    "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
    "rclpy.action": {
        "ActionServer": ActionServer, "CancelResponse": Answer, "GoalResponse": Answer,
    },
    "rclpy.callback_groups": {
        "MutuallyExclusiveCallbackGroup": MutuallyExclusiveCallbackGroup,
        "ReentrantCallbackGroup": ReentrantCallbackGroup,
    },
    "rclpy.clock": {"Clock": Clock, "ClockType": ClockType},
    "rclpy.exceptions": {
        "NameValidationException": type("NameValidationException", (Exception,), {}),
        "ParameterException": ParameterException,
    },
    "rclpy.lifecycle": {
        "LifecycleNode": LifecycleNode, "LifecycleNodeMixin": LifecycleNodeMixin,
        "TransitionCallbackReturn": Return,
    },
    "rclpy.node": {"Node": Node},
    "rclpy.qos": {
        "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1), "QoSProfile": _any,
        "qos_profile_sensor_data": 5,
    },
    "rclpy.time": {"Time": _any},
    "tf2_ros": {
        "Buffer": Buffer, "TransformException": TransformException, "TransformListener": _any,
    },
    "rcl_interfaces.msg": {
        "FloatingPointRange": _any, "IntegerRange": _any, "ParameterDescriptor": Descriptor,
    },
    "rosidl_runtime_py": {},
    "rosidl_runtime_py.utilities": {"get_message": _get_message},
    "bond.msg": {"Status": Message},
    "diagnostic_msgs.msg": {"DiagnosticArray": Message},
    "geometry_msgs.msg": {"PolygonStamped": Message},
    "lifecycle_msgs.srv": {"ChangeState": ChangeState},
    "map_msgs.msg": {"OccupancyGridUpdate": Message},
    "nav_msgs.msg": {"OccupancyGrid": Message, "Path": Message},
    "nav2_msgs.action": {"ComputePathThroughPoses": Action, "ComputePathToPose": Action},
    "nav2_msgs.srv": {"ClearEntireCostmap": Message, "IsPathValid": Message},
}  # fmt: skip


def install() -> None:
    """Make the nodes' imports find the stand-ins."""
    for name, content in MODULES.items():
        parent, _, _ = name.partition(".")
        for module in (parent, name):
            sys.modules.setdefault(module, ModuleType(module))
        vars(sys.modules[name]).update(content)
    sys.path.insert(0, str(Path(__file__).parents[2] / "ros" / "energyplan_ros"))
