"""A robot that the library does not know: its drives, as arrays and as a bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.vehicle import Vehicle

RADIUS = 0.11
ROBOT = Vehicle.from_geometry(
    "own robot", mass=30.0, wheelbase=0.62, track=0.4, length=0.8, width=0.5
)
MODEL = ep.PowerModel.paper(ROBOT, K=22.0, mu=0.6)


def drive(seed: int = 1) -> ep.DriveLog:
    return simulate.identification_drive(MODEL, power_noise=3.0, speed_noise=0.004, seed=seed)


JOINTS = {"front_left": "v_left", "front_right": "v_right", "rear_left": "v_left",
          "rear_right": "v_right"}  # fmt: skip


def bag(
    folder: Path, log: ep.DriveLog, pose: bool = True, joints: Mapping[str, str] = JOINTS
) -> Path:
    """Write an MCAP file of joint states, a battery, an inertial unit and an odometry.

    Each joint turns as a side's tread does; one that does not stands still. Their order is another
    in every second message.
    """
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {
        "/rover/joints": "sensor_msgs/msg/JointState", "/rover/battery":
        "sensor_msgs/msg/BatteryState", "/rover/imu": "sensor_msgs/msg/Imu",
    }  # fmt: skip
    kinds |= {"/slam/odom": "nav_msgs/msg/Odometry"} if pose else {}
    make = store.types
    Time, Header = make["builtin_interfaces/msg/Time"], make["std_msgs/msg/Header"]
    V3, Q = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Quaternion"]
    zero9, zero36 = np.zeros(9), np.zeros(36)
    with rosbag2.Writer(folder / "bag", version=8,
                        storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:  # fmt: skip
        topics = {name: writer.add_connection(name, kind, typestore=store)
                  for name, kind in kinds.items()}  # fmt: skip
        for k, t in enumerate(log.t):
            ns = 1_700_000_000_000_000_000 + round(1e9 * float(t))
            header = Header(Time(ns // 10**9, ns % 10**9), "base")
            at = {name: float(values[k]) for name, values in log.channels.items()}
            half = at["yaw"] / 2
            turn = Q(0.0, 0.0, np.sin(half), np.cos(half))
            names = list(joints) if k % 2 else list(joints)[::-1]
            wheels = np.array([at.get(joints[name], 0.0) for name in names]) / RADIUS
            battery = {
                name: np.float32(0) for name in
                ("temperature", "charge", "capacity", "design_capacity", "percentage")
            }  # fmt: skip
            messages = {
                "/rover/joints": make[kinds["/rover/joints"]](
                    header, names, np.zeros(len(names)), wheels, np.zeros(len(names))),
                "/rover/battery": make[kinds["/rover/battery"]](
                    header=header, voltage=25.0, current=-float(log.power[k]) / 25.0, **battery,
                    power_supply_status=0, power_supply_health=0, power_supply_technology=0,
                    present=True, cell_voltage=np.zeros(0, np.float32),
                    cell_temperature=np.zeros(0, np.float32), location="", serial_number=""),
                "/rover/imu": make[kinds["/rover/imu"]](
                    header, turn, zero9, V3(0.0, 0.0, at["yaw_rate"]), zero9, V3(0.0, 0.0, 9.8),
                    zero9),
            }  # fmt: skip
            if pose:
                Point, Pose = make["geometry_msgs/msg/Point"], make["geometry_msgs/msg/Pose"]
                place = make["geometry_msgs/msg/PoseWithCovariance"](
                    Pose(Point(at["x"], at["y"], 0.0), turn), zero36)  # fmt: skip
                still = make["geometry_msgs/msg/TwistWithCovariance"](
                    make["geometry_msgs/msg/Twist"](V3(0.0, 0.0, 0.0), V3(0.0, 0.0, 0.0)), zero36
                )
                messages["/slam/odom"] = make[kinds["/slam/odom"]](header, "base", place, still)
            for name, message in messages.items():
                writer.write(topics[name], ns, store.serialize_cdr(message, kinds[name]))
    return folder / "bag"
