"""A robot that the library does not know: its drives, as arrays and as a bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_bags import BATTERY, IMU, ODOMETRY, Recorder, heading
from small_bags import JOINTS as JOINT_STATE

import energyplan as ep
from energyplan import simulate
from energyplan.vehicle import Vehicle

RADIUS = 0.11
START = 1_700_000_000
"""Of the recording, in seconds since the epoch."""
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
    pytest.importorskip("rosbags")
    channels = pd.DataFrame({**log.channels, "power": log.power})
    still = np.zeros(len(joints))
    with Recorder(folder / "bag", "mcap") as file:
        for k, at in enumerate(channels.itertuples()):
            t, turn = START + at.t, heading(at.yaw)
            names = list(joints) if k % 2 else list(joints)[::-1]
            wheels = [getattr(at, joints[name], 0.0) / RADIUS for name in names]
            file.write(
                "/rover/joints", JOINT_STATE, t, name=names, velocity=wheels, position=still,
                effort=still,
            )  # fmt: skip
            file.write("/rover/battery", BATTERY, t, voltage=25.0, current=-at.power / 25.0)
            file.write(
                "/rover/imu", IMU, t, orientation=turn, angular_velocity={"z": at.yaw_rate},
                linear_acceleration={"z": 9.8},
            )  # fmt: skip
            if pose:
                place = {"position": {"x": at.x, "y": at.y}, "orientation": turn}
                file.write("/slam/odom", ODOMETRY, t, child_frame_id="base", pose={"pose": place})
    return folder / "bag"
