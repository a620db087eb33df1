"""Bags written with rosbags come back as the drive that was simulated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan.errors import ConfigError, DriveLogError, UnknownNameError
from energyplan.io.bags import TopicMap, is_bag
from energyplan.io.logs import read_log
from energyplan.io.start import Given, start
from energyplan.io.tables import write_log
from energyplan.logs.align import Series, align
from energyplan.power import PowerModel
from energyplan.simulate import identification_drive
from energyplan.vehicle import Vehicle

rosbags = pytest.importorskip("rosbags")

START = 1_700_000_000  # seconds since the epoch
HUSKY_STATUS = """\
std_msgs/Header header
float64 left_driver_current
float64 right_driver_current
float64 left_driver_voltage
float64 right_driver_voltage
"""
KINDS = ("ros1", "ros2", "mcap")


@pytest.fixture(scope="module")
def drive():
    vehicle = Vehicle.preset("husky_a200")
    return identification_drive(PowerModel.paper(vehicle, 40.0, 0.6), duration=120.0, rate=100.0)


class Recorder:
    """Writes messages of every kind of bag."""

    def __init__(self, path, kind):
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.first = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.first else Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(HUSKY_STATUS, "husky_msgs/msg/HuskyStatus"))
        if self.first:
            self.path = path / "drive.bag"
            self.writer = Writer1(self.path)
        else:
            self.path = path / f"drive_{kind}"
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer2(self.path, version=9, storage_plugin=plugin)
        self.connections = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *error):
        self.writer.close()

    def header(self, t):
        sec, nanosec = divmod(round((START + t) * 1e9), 10**9)
        stamp = self.store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        more = {"seq": 0} if self.first else {}
        return self.store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **more)

    def make(self, kind, **fields):
        return self.store.types[kind](**fields)

    def write(self, topic, kind, t, message, late=0.004):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        dump = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        arrival = round((START + t + late) * 1e9)
        self.writer.write(self.connections[topic], arrival, dump(message, kind))


def record(folder, kind, log, *, prefix="", power="status", joints=True):
    """Record a drive at the rates of a real robot."""

    def at(name, t):
        return float(np.interp(t, log.t, log.channels[name]))

    events = []
    for topic, rate in (("joint", 50.0), ("imu", 100.0), ("odom", 20.0), ("status", 10.0)):
        events += [(t, topic) for t in np.arange(0.0, log.t[-1], 1 / rate)]
    none = np.zeros(0)
    with Recorder(folder, kind) as bag:
        for t, topic in sorted(events):
            header = bag.header(t)
            if topic == "joint" and joints:
                left, right = at("v_left", t) / 0.1651, at("v_right", t) / 0.1651
                message = bag.make(
                    "sensor_msgs/msg/JointState", header=header, position=none, effort=none,
                    name=["front_left_wheel", "front_right_wheel", "rear_left_wheel",
                          "rear_right_wheel"],
                    velocity=np.array([left, right, left, right]),
                )  # fmt: skip
                bag.write(f"{prefix}/joint_states", "sensor_msgs/msg/JointState", t, message)
            elif topic == "imu":
                zero = np.zeros(9)
                vector, turn = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"
                message = bag.make(
                    "sensor_msgs/msg/Imu", header=header,
                    orientation=bag.make(turn, x=0.0, y=0.0, z=0.0, w=1.0),
                    angular_velocity=bag.make(vector, x=0.0, y=0.0, z=at("yaw_rate", t)),
                    linear_acceleration=bag.make(vector, x=at("accel_x", t), y=0.0, z=9.81),
                    orientation_covariance=zero, angular_velocity_covariance=zero,
                    linear_acceleration_covariance=zero,
                )  # fmt: skip
                bag.write(f"{prefix}/imu/data", "sensor_msgs/msg/Imu", t, message)
            elif topic == "odom":
                bag.write(
                    f"{prefix}/odometry/filtered", "nav_msgs/msg/Odometry", t,
                    odometry(bag, header, at("x", t), at("y", t), at("yaw", t)),
                )  # fmt: skip
            elif topic == "status" and power == "status":
                volts = 24.0
                message = bag.make(
                    "husky_msgs/msg/HuskyStatus", header=header,
                    left_driver_current=at("p_left", t) / volts, left_driver_voltage=volts,
                    right_driver_current=at("p_right", t) / volts, right_driver_voltage=volts,
                )  # fmt: skip
                bag.write(f"{prefix}/status", "husky_msgs/msg/HuskyStatus", t, message)
            elif topic == "status" and power == "battery":
                total = at("p_left", t) + at("p_right", t)
                bag.write(
                    f"{prefix}/battery_state", "sensor_msgs/msg/BatteryState", t,
                    battery(bag, header, 24.0, -total / 24.0),
                )  # fmt: skip
    return bag.path


def odometry(bag, header, x, y, yaw):
    vector = bag.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    pose = bag.make(
        "geometry_msgs/msg/Pose",
        position=bag.make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=bag.make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2)
        ),
    )
    covariance = np.zeros(36)
    twist = bag.make("geometry_msgs/msg/Twist", linear=vector, angular=vector)
    return bag.make(
        "nav_msgs/msg/Odometry", header=header, child_frame_id="base_link",
        pose=bag.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
        twist=bag.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance),
    )  # fmt: skip


def battery(bag, header, voltage, current):
    none = np.zeros(0, np.float32)
    more = {} if bag.first else {"temperature": 20.0, "cell_temperature": none}
    return bag.make(
        "sensor_msgs/msg/BatteryState", header=header, voltage=voltage, current=current,
        charge=0.0, capacity=0.0, design_capacity=0.0, percentage=0.5, power_supply_status=2,
        power_supply_health=1, power_supply_technology=1, present=True, cell_voltage=none,
        location="", serial_number="", **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def bags(tmp_path_factory, drive):
    return {kind: record(tmp_path_factory.mktemp(kind), kind, drive) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_comes_back_from_every_kind_of_bag(bags, drive, kind):
    fractions = []
    log = read_log(bags[kind], topics="husky", progress=fractions.append)
    assert len(log) == pytest.approx(120 * 50, abs=30)
    for channel, tolerance in (
        ("v_left", 1e-9), ("v_right", 1e-9), ("x", 2e-3), ("y", 2e-3), ("yaw", 2e-3),
        ("yaw_rate", 0.01), ("accel_x", 0.2),
    ):  # fmt: skip
        truth = np.interp(log.t, drive.t, drive.channels[channel])
        assert_allclose(log.channels[channel], truth, atol=tolerance, err_msg=channel)
    assert log.energy == pytest.approx(drive.energy, rel=5e-3)
    assert fractions[-1] == 1.0
    assert np.all(np.diff(fractions) >= 0)


@pytest.mark.parametrize("kind", KINDS)
def test_every_channel_says_where_it_came_from_and_how(bags, kind):
    log = read_log(bags[kind], topics="husky")
    said = " ".join(log.warnings)
    assert "v_left is /joint_states.velocity[*left*]" in said
    assert "yaw_rate averaged from 100 Hz" in said
    assert "p_left interpolated from 10 Hz" in said


def test_units_in_the_names_of_topics_are_kept(tmp_path, drive):
    factors = {"left_wheel/rpm": 0.2 * np.pi / 30, "right_wheel/rpm": 0.2 * np.pi / 30,
               "power/voltage_mv": 1e-3, "power/current_dA": 0.1, "in_wh": 1.0}  # fmt: skip
    readings = (drive.channels["v_left"], drive.channels["v_right"], np.full(len(drive), 24.0),
                drive.power / 24.0, np.cumsum(drive.power))  # fmt: skip
    with Recorder(tmp_path, "mcap") as bag:
        for k in range(0, len(drive), 10):
            for (topic, factor), values in zip(factors.items(), readings, strict=True):
                message = bag.make("std_msgs/msg/Float64", data=float(values[k] / factor))
                bag.write(f"/{topic}", "std_msgs/msg/Float64", drive.t[k], message, late=0.0)
    measures = {"track": 0.555, "wheelbase": 0.512, "mass": 70.0, "wheel_radius": 0.2}
    topics = start(bag.path, Given(**measures)).project.topics
    made = {channel: sources[0].conversion.factor for channel, sources in topics.channels.items()}
    assert made == pytest.approx(
        {"v_left": 0.2 * np.pi / 30, "v_right": 0.2 * np.pi / 30, "voltage": 1e-3, "current": 0.1}
    )


def test_battery_currents_change_sign_and_namespaces_match(tmp_path, drive):
    bag = record(tmp_path, "ros2", drive, prefix="/a200_0000", power="battery")
    log = read_log(bag, topics="husky")
    assert log.battery_side
    assert log.energy == pytest.approx(drive.energy, rel=5e-3)


def test_a_topic_map_of_ones_own(tmp_path, bags, drive):
    file = tmp_path / "topics.yaml"
    file.write_text(
        "name: mine\nchannels:\n"
        "  v_left: {topic: joint_states, field: 'velocity[rear_left_wheel]', scale: 0.1651}\n"
        "  v_right: {topic: joint_states, field: 'velocity[3]', scale: 0.1651}\n"
        "  power:\n"
        "  - {topic: nowhere, field: current}\n  - {topic: status, field: no_such_field}\n"
        "  - {topic: status, field: left_driver_current, times: left_driver_voltage, scale: 2}\n"
        "  yaw: {topic: odometry/filtered, field: yaw(pose.pose.orientation)}\n"
    )
    log = read_log(bags["ros2"], topics=file)
    assert set(log.channels) == {"t", "v_left", "v_right", "power", "yaw"}
    truth = np.interp(log.t, drive.t, 2 * drive.channels["p_left"])
    assert np.median(np.abs(log.power - truth)) < 0.1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("channels: {v_left: {topic: a, field: 'b['}}\n", "channels.v_left: write a field"),
        ("channels: {v_left: {topic: a}}\n", "v_left.field: this key is missing"),
        ("channels: {v_left: {topic: a, field: b, gain: 2}}\n", "no such key"),
        ("name: x\n", "channels: this key is missing"),
    ],
)
def test_malformed_topic_maps_are_refused(tmp_path, text, words):
    file = tmp_path / "topics.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        TopicMap.read(file)


def test_unknown_topic_maps_and_missing_topics_are_named(tmp_path, drive, bags):
    with pytest.raises(UnknownNameError, match="warthog"):
        read_log(bags["ros2"], topics="hsuky")
    bag = record(tmp_path, "mcap", drive.segment(0.0, 5.0), joints=False)
    with pytest.raises(DriveLogError, match=r"no topic serves as v_left.*imu/data"):
        read_log(bag, topics="husky")


def test_no_wheel_radius_is_assumed(bags):
    with pytest.raises(DriveLogError, match=r"radius of its wheels.*topics='husky' or 'jackal'"):
        read_log(bags["ros2"])


def test_bags_are_told_from_tables(tmp_path, bags, drive):
    assert all(is_bag(path) for path in bags.values())
    table = write_log(drive, tmp_path / "drive.csv")
    assert not is_bag(table)
    assert read_log(table).energy == pytest.approx(drive.energy)


def several(folder, log, packs, *, strange=False):
    """Record joints' angles alone, by two publishers in turn, and batteries by topic."""
    vector, turn = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"
    zero, none = np.zeros(9), np.zeros(0)
    means = {side: log.channels[f"v_{side}"] for side in ("left", "right")}
    gone = {side: 0.5 * np.diff(log.t) * (v[1:] + v[:-1]) for side, v in means.items()}
    angles = {side: np.append(0.0, np.cumsum(way)) / 0.1651 for side, way in gone.items()}
    with Recorder(folder, "mcap") as bag:
        for k in range(0, len(log.t), 5):
            t = float(log.t[k])
            header = bag.header(t)
            arm = bag.make("sensor_msgs/msg/JointState", header=header, name=["elbow"] * 20,
                           position=np.zeros(20), velocity=none, effort=none)  # fmt: skip
            wheels = bag.make(
                "sensor_msgs/msg/JointState", header=header, name=["right_wheel", "left_wheel"],
                position=np.array([angles["right"][k], angles["left"][k]]), velocity=none,
                effort=none,
            )  # fmt: skip
            for message in (arm, wheels):
                bag.write("/joint_states", "sensor_msgs/msg/JointState", t, message)
            axes = {"/camera/imu": (0.0, -1.0, 0.0), "/imu/data": (0.0, 0.0, 1.0)}
            for topic, axis in axes.items():
                rate = dict(zip("xyz", np.array(axis) * log.channels["yaw_rate"][k], strict=True))
                imu = bag.make(
                    "sensor_msgs/msg/Imu", header=header, orientation_covariance=zero,
                    orientation=bag.make(turn, x=0.0, y=0.0, z=0.0, w=1.0),
                    angular_velocity=bag.make(vector, **rate), angular_velocity_covariance=zero,
                    linear_acceleration=bag.make(vector, x=0.0, y=0.0, z=9.8),
                    linear_acceleration_covariance=zero,
                )  # fmt: skip
                if not strange or topic == "/camera/imu":
                    bag.write(topic, "sensor_msgs/msg/Imu", t, imu)
            for topic, share in packs.items():
                amps = -share(t) * float(log.power[k]) / 24.0
                message = battery(bag, header, 24.0, amps)
                bag.write(topic, "sensor_msgs/msg/BatteryState", t, message)
    return bag.path


PACKS = {
    "two": ({"/battery_1": lambda t: 0.6, "/battery_2": lambda t: 0.4}, "counts /battery_1 and"),
    "sum": ({"/battery": lambda t: 1.0, "/battery_1": lambda t: 0.5 + 0.3 * np.sin(t),
             "/battery_2": lambda t: 0.5 - 0.3 * np.sin(t)}, "is the sum of"),
    "signs": ({"/battery_1": lambda t: 0.6, "/battery_2": lambda t: -0.4}, "counts /battery_1 and"),
}  # fmt: skip


@pytest.mark.parametrize("name", PACKS)
def test_all_batteries_count_once_and_the_robots_own_sensor_is_found(tmp_path, drive, name):
    packs, note = PACKS[name]
    path = several(tmp_path, drive, packs, strange=name == "signs")
    measures = {"track": 0.555, "wheelbase": 0.512, "mass": 70.0, "wheel_radius": 0.1651}
    made = start(path, Given(**measures))
    assert made.sound, made.checks
    assert any(note in one for one in made.notes), made.notes
    log = read_log(path, topics=made.project.topics)
    assert log.energy == pytest.approx(drive.energy, rel=0.01)
    truth = np.interp(log.t, drive.t, drive.channels["yaw_rate"])
    assert np.corrcoef(log.channel("yaw_rate"), truth)[0, 1] > 0.99
    assert np.median(np.abs(log.channel("v_left") - np.interp(
        log.t, drive.t, drive.channels["v_left"]))) < 0.01  # fmt: skip


@pytest.mark.parametrize("other", [lambda t: 1.0, lambda t: 1.02 + 0.01 * np.sin(t)])
def test_batteries_that_may_be_one_are_asked_for(tmp_path, drive, other):
    packs = {"/battery": lambda t: 1.0, "/relayed/battery": other}
    path = several(tmp_path, drive, packs)
    known = {"track": 0.555, "wheelbase": 0.512, "mass": 70.0, "wheel_radius": 0.1651}
    with pytest.raises(DriveLogError, match=r"twice: say --columns 'current=/battery\.c"):
        start(path, Given(**known))
    made = start(path, Given(**known, columns="current=/battery.current[-A]"))
    log = read_log(path, topics=made.project.topics)
    assert log.energy == pytest.approx(drive.energy, rel=0.01)


def test_columns_of_a_bag_are_named_by_hand(bags, drive):
    total = "power=/status.left_driver_current*/status.left_driver_voltage"
    measures = {"track": 0.555, "wheelbase": 0.512, "mass": 70.0, "wheel_radius": 0.1651}
    made = start(bags["mcap"], Given(**measures, columns=total))
    (column,) = made.project.topics.channels["power"]
    assert column.written == "left_driver_current * left_driver_voltage"
    with pytest.raises(DriveLogError, match=r"no column '/status.current'; near it"):
        start(bags["mcap"], Given(**measures, columns="power=/status.current[W]"))


# -- alignment ----------------------------------------------------------------------------------


def test_fast_channels_are_averaged_and_holes_stay_holes():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 50.0, 0.01)
    values = np.sin(t) + rng.standard_normal(len(t))
    clock = np.arange(1.0, 49.0, 0.2)
    aligned = align(Series(t, values), clock)
    assert np.std(aligned.values - np.sin(clock)) == pytest.approx(1 / np.sqrt(20), rel=0.15)
    keep = (t < 20.05) | (t > 23.05)
    holed = align(Series(t[keep], values[keep]), clock)
    assert_allclose(np.isnan(holed.values), (clock > 20.1) & (clock < 23.1))
