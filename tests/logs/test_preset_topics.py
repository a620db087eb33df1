"""A bag of a robot that the library knows is read by the robot's own topics."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start
from energyplan.logs.consistency import Measures
from energyplan.logs.guess import guess
from energyplan.vehicle import Vehicle

HUSKY = Vehicle.preset("husky_a200")
RADIUS = 0.1651
POWER = "std_msgs/Header header\nfloat32[] measured_voltages\nfloat32[] measured_currents\n"


@cache
def drive() -> ep.DriveLog:
    model = ep.PowerModel.paper(HUSKY, 40.0, 0.6)
    return simulate.identification_drive(model, duration=120.0, rate=20.0)


def husky_bag(folder: Path, prefix: str = "") -> Path:
    """Write what a Husky's computer records: the currents of battery and both drives."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(POWER, "clearpath_platform_msgs/msg/Power"))
    make, log = store.types, drive()
    vector, turn = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Quaternion"]
    wheels = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
    with rosbag2.Writer(folder / "husky", version=9) as writer:
        topics = {
            name: writer.add_connection(f"{prefix}/{name}", kind, typestore=store)
            for name, kind in (
                ("platform/joint_states", "sensor_msgs/msg/JointState"),
                ("platform/mcu/status/power", "clearpath_platform_msgs/msg/Power"),
                ("sensors/imu_0/data", "sensor_msgs/msg/Imu"),
            )
        }
        for k, t in enumerate(log.t):
            ns = 1_700_000_000_000_000_000 + round(1e9 * float(t))
            stamp = make["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
            header = make["std_msgs/msg/Header"](stamp, "base")
            at = {name: float(values[k]) for name, values in log.channels.items()}
            rates = np.array([at["v_left"], at["v_right"]] * 2) / RADIUS
            amps = np.array([at["p_left"] + at["p_right"] + 50.0, at["p_left"], at["p_right"]])
            messages = (
                make["sensor_msgs/msg/JointState"](header, wheels, 0 * rates, rates, 0 * rates),
                make["clearpath_platform_msgs/msg/Power"](
                    header, np.full(3, 25.0, np.float32), (amps / 25.0).astype(np.float32)
                ),
                make["sensor_msgs/msg/Imu"](
                    header, turn(0.0, 0.0, 0.0, 1.0), np.zeros(9),
                    vector(0.0, 0.0, at["yaw_rate"]), np.zeros(9), vector(at["accel_x"], 0.0, 9.8),
                    np.zeros(9),
                ),
            )  # fmt: skip
            for topic, message in zip(topics.values(), messages, strict=True):
                writer.write(topic, ns, store.serialize_cdr(message, topic.msgtype))
    return folder / "husky"


M = "/platform/mcu/status/power.measured_"


@pytest.mark.parametrize("prefix", ["", "/a200_0001"])
@pytest.mark.parametrize("radius", [np.nan, 1.1 * RADIUS])
def test_a_robot_that_is_known_is_read_by_its_topics(
    tmp_path: Path, prefix: str, radius: float
) -> None:
    """No element of the message bears the name of what it measures; the topic map says it."""
    file = husky_bag(tmp_path, prefix)
    made = start(file, Given(like=HUSKY, wheel_radius=radius))
    assert made.sound, made.checks
    log = read_log(file, topics=made.project.topics)
    assert log.energy == pytest.approx(drive().energy, rel=1e-3)
    size = 1.1 if radius == radius else 1.0
    np.testing.assert_allclose(log.channel("v_left"), size * drive().channel("v_left"), rtol=1e-4)


@pytest.mark.parametrize(("columns", "hotel"), [
    (f"p_left={M}currents[1]*{M}voltages[1],p_right={M}voltages[2]*{M}currents[2]", 0.0),
    (f"p_left={M}currents.1*{M}voltages.1,p_right={M}currents.2*{M}voltages.2", 0.0),
    (f"power={M}voltages[0]*{M}currents[0]", 50.0),
    (f"current={M}currents[0],voltage={M}voltages[0]", 50.0),
])  # fmt: skip
@pytest.mark.parametrize("like", [None, HUSKY])
def test_elements_of_an_array_are_named_by_their_number(
    tmp_path: Path, columns: str, hotel: float, like: Vehicle | None
) -> None:
    """They are units of nothing, and the others of the array are no power of their own."""
    file = husky_bag(tmp_path)
    measures = Measures.of(HUSKY)
    sizes = {name: getattr(measures, name) for name in ("track", "wheelbase", "mass")}
    made = start(file, Given(like=like, wheel_radius=RADIUS, columns=columns, **sizes))
    assert made.sound, [str(one) for one in made.checks if not one.ok]
    log = read_log(file, topics=made.project.topics)
    assert log.energy == pytest.approx(drive().energy + hotel * drive().duration, rel=1e-3)


def test_columns_of_a_table_may_bear_an_index(tmp_path: Path) -> None:
    log = drive()
    table = log.to_frame().rename(columns={"v_left": "wheel[left]", "v_right": "wheel[1]"})
    table.to_csv(tmp_path / "log.csv", index=False)
    for other in ("wheel[1]", "0.5*wheel[1]+0.5*wheel[1][m/s]"):
        read = ep.DriveLog.read(tmp_path / "log.csv", f"v_left=wheel[left],v_right={other}")
        np.testing.assert_allclose(read.channel("v_right"), log.channel("v_right"))


@pytest.mark.parametrize("plural", ["efforts", "commands", "setpoints", "voltages", "powers"])
def test_a_plural_means_what_the_singular_does(plural: str) -> None:
    singular = plural.removesuffix("s")
    for name in ("left_{}", "battery.{}", "/motors/power.{}.0"):
        channels = [[*guess([name.format(word)])] for word in (plural, singular)]
        assert channels[0] == channels[1], name
