"""Stand-ins for what the nodes import of ROS, enough to run them: they hold what a node makes."""

from __future__ import annotations

import sys
import time
from enum import Enum
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any


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
    SUCCESS, FAILURE = 0, 1


class Answer(Enum):
    ACCEPT, REJECT = 1, 2


class Node:
    """Holds publishers, subscriptions, services and what was logged."""

    def __init__(self, name: str) -> None:
        self._name, self._parameters = name, {}
        self._heard, self._published, self._log = {}, {}, []
        self.services_by_name: dict[str, Any] = {}
        self.topics: list[tuple[str, list[str]]] = []

    def get_name(self) -> str:
        return self._name

    def declare_parameters(self, namespace: str, parameters: list[tuple[str, Any]]) -> None:
        self._parameters.update(parameters)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self._parameters[name])

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, qos: Any, *, callback_group: Any = None
    ) -> None:
        self._heard[topic] = callback

    def create_publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        sent = self._published.setdefault(topic, [])
        return SimpleNamespace(publish=sent.append)

    def create_service(
        self, kind: Any, name: str, callback: Any, *, callback_group: Any = None
    ) -> None:
        self.services_by_name[name] = callback

    def create_timer(self, period: float, callback: Any, callback_group: Any = None) -> None:
        pass

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return self.topics

    def get_clock(self) -> Any:
        stamp = STORE.types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp, nanoseconds=10**9))

    def get_logger(self) -> Any:
        def log(level: str) -> Any:
            return lambda text, **options: self._log.append((level, text))

        return SimpleNamespace(**{n: log(n) for n in ("info", "warning", "error", "fatal")})

    def destroy_node(self) -> None:
        sys.stderr.write("node destroyed\n")

    # what tests ask

    def hear(self, topic: str, message: Any) -> None:
        self._heard[topic](message)

    def sent(self, topic: str) -> list[Any]:
        return list(self._published[topic])

    def told(self, level: str) -> str:
        return "\n".join(text for one, text in self._log if one == level)


class ActionServer:
    def __init__(
        self, node: Any, kind: Any, name: str, execute: Any, *, goal_callback: Any,
        cancel_callback: Any, callback_group: Any,
    ) -> None:  # fmt: skip
        self.name, self.execute, self.goal_callback = name, execute, goal_callback

    def destroy(self) -> None:
        pass


class Buffer:
    at: Any = None  # the robot's stamped pose, if TF knows it

    def lookup_transform(self, target: str, frame: str, when: Any) -> Any:
        if self.at is None:
            raise TransformException(f"{frame} is not known")
        place = self.at.pose
        return SimpleNamespace(
            transform=SimpleNamespace(translation=place.position, rotation=place.orientation)
        )


class TransformException(Exception):  # noqa: N818
    pass


class Executor:
    def __init__(self, num_threads: int) -> None:
        pass

    def add_node(self, node: Any) -> None:
        sys.stderr.write("spinning\n")

    def spin_once(self, timeout_sec: float) -> None:
        time.sleep(timeout_sec)

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
    "rclpy.callback_groups": {"ReentrantCallbackGroup": object},
    "rclpy.lifecycle": {"LifecycleNode": Node, "TransitionCallbackReturn": Return},
    "rclpy.node": {"Node": Node},
    "rclpy.qos": {
        "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1), "QoSProfile": _any,
        "qos_profile_sensor_data": 5,
    },
    "rclpy.time": {"Time": _any},
    "tf2_ros": {
        "Buffer": Buffer, "TransformException": TransformException, "TransformListener": _any,
    },
    "rosidl_runtime_py": {},
    "rosidl_runtime_py.utilities": {"get_message": _get_message},
    "bond.msg": {"Status": Message},
    "diagnostic_msgs.msg": {"DiagnosticArray": Message},
    "geometry_msgs.msg": {"PolygonStamped": Message},
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
