"""Bags written with rosbags come back as the drive that was simulated; damaged ones are refused."""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from small_bags import BATTERY, IMU, JOINTS, ODOMETRY, POWER, TOPICS, Recorder, heading
from small_bags import record as record_joints

from energyplan.errors import DriveLogError, UnknownNameError
from energyplan.io.bags import is_bag, read_message
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start
from energyplan.io.tables import write_log
from energyplan.logs.align import Series, align
from energyplan.power import PowerModel
from energyplan.simulate import identification_drive
from energyplan.vehicle import Vehicle

rosbags = pytest.importorskip("rosbags")

START = 1_700_000_000  # seconds since the epoch
STATUS = "husky_msgs/msg/HuskyStatus"
HUSKY_STATUS = {
    STATUS: """\
std_msgs/Header header
float64 left_driver_current
float64 right_driver_current
float64 left_driver_voltage
float64 right_driver_voltage
"""
}
WHEELS = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]
KINDS = ("ros1", "sqlite", "mcap")


@pytest.fixture(scope="module")
def drive():
    vehicle = Vehicle.preset("husky_a200")
    return identification_drive(PowerModel.paper(vehicle, 40.0, 0.6), duration=120.0, rate=100.0)


def seen(log, rate):
    """Return what the channels of a log are at a rate, time by time."""
    t = np.arange(0.0, log.t[-1], 1 / rate)
    table = {name: np.interp(t, log.t, values) for name, values in log.channels.items()}
    return pd.DataFrame(table).itertuples()


def record(folder, kind, log, *, prefix="", battery=False, joints=True):
    """Record a drive at the rates of a real robot."""
    sent = [
        (at.t, "imu/data", IMU, {
            "orientation": {"w": 1.0}, "angular_velocity": {"z": at.yaw_rate},
            "linear_acceleration": {"x": at.accel_x, "z": 9.81},
        })
        for at in seen(log, 100.0)
    ]  # fmt: skip
    for at in seen(log, 50.0) if joints else ():
        speeds = np.array([at.v_left, at.v_right] * 2) / 0.1651
        sent.append((at.t, "joint_states", JOINTS, {"name": WHEELS, "velocity": speeds}))
    for at in seen(log, 20.0):
        pose = {"position": {"x": at.x, "y": at.y}, "orientation": heading(at.yaw)}
        sent.append((at.t, "odometry/filtered", ODOMETRY, {"pose": {"pose": pose}}))
    for at in seen(log, 10.0):
        left, right = at.p_left / 24.0, at.p_right / 24.0
        if battery:
            state = {"voltage": 24.0, "current": -left - right}
            sent.append((at.t, "battery_state", BATTERY, state))
        else:
            amps = {"left_driver_current": left, "right_driver_current": right}
            volts = dict.fromkeys(("left_driver_voltage", "right_driver_voltage"), 24.0)
            sent.append((at.t, "status", STATUS, amps | volts))
    path = folder / ("drive.bag" if kind == "ros1" else "drive")
    with Recorder(path, kind, HUSKY_STATUS) as bag:
        for t, topic, message, content in sorted(sent, key=itemgetter(0)):
            bag.write(f"{prefix}/{topic}", message, START + t, late=0.004, **content)
    return path


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
    said = " ".join(log.warnings)
    assert "v_left is /joint_states.velocity[*left*]" in said
    assert "yaw_rate averaged from 100 Hz" in said
    assert "p_left interpolated from 10 Hz" in said


MEASURES = {"track": 0.555, "wheelbase": 0.512, "mass": 70.0, "wheel_radius": 0.1651}


def test_units_in_the_names_of_topics_are_kept(tmp_path, drive):
    factors = {"left_wheel/rpm": 0.2 * np.pi / 30, "right_wheel/rpm": 0.2 * np.pi / 30,
               "power/voltage_mv": 1e-3, "power/current_dA": 0.1, "in_wh": 1.0}  # fmt: skip
    readings = (drive.channels["v_left"], drive.channels["v_right"], np.full(len(drive), 24.0),
                drive.power / 24.0, np.cumsum(drive.power))  # fmt: skip
    with Recorder(tmp_path / "drive", "mcap") as bag:
        for k in range(0, len(drive), 10):
            for (topic, factor), values in zip(factors.items(), readings, strict=True):
                reading = float(values[k] / factor)
                bag.write(f"/{topic}", "std_msgs/msg/Float64", START + drive.t[k], data=reading)
    topics = start(bag.path, Given(**MEASURES | {"wheel_radius": 0.2})).project.topics
    made = {channel: sources[0].conversion.factor for channel, sources in topics.channels.items()}
    assert made == pytest.approx(
        {"v_left": 0.2 * np.pi / 30, "v_right": 0.2 * np.pi / 30, "voltage": 1e-3, "current": 0.1}
    )


def test_battery_currents_change_sign_and_namespaces_match(tmp_path, drive):
    bag = record(tmp_path, "sqlite", drive, prefix="/a200_0000", battery=True)
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
    log = read_log(bags["sqlite"], topics=file)
    assert set(log.channels) == {"t", "v_left", "v_right", "power", "yaw"}
    truth = np.interp(log.t, drive.t, 2 * drive.channels["p_left"])
    assert np.median(np.abs(log.power - truth)) < 0.1


def test_unknown_topic_maps_and_missing_topics_are_named(tmp_path, drive, bags):
    with pytest.raises(UnknownNameError, match="warthog"):
        read_log(bags["sqlite"], topics="hsuky")
    with pytest.raises(DriveLogError, match=r"radius of its wheels.*topics='husky' or 'jackal'"):
        read_log(bags["sqlite"])
    bag = record(tmp_path, "mcap", drive.segment(0.0, 5.0), joints=False)
    with pytest.raises(DriveLogError, match=r"no topic serves as v_left.*imu/data"):
        read_log(bag, topics="husky")


def test_bags_are_told_from_tables(tmp_path, bags, drive):
    assert all(is_bag(path) for path in bags.values())
    table = write_log(drive, tmp_path / "drive.csv")
    assert not is_bag(table)
    assert read_log(table).energy == pytest.approx(drive.energy)


def several(folder, log, packs, *, strange=False):
    """Record joints' angles alone, by two publishers in turn, and batteries by topic."""
    means = {side: log.channels[f"v_{side}"] for side in ("left", "right")}
    gone = {side: 0.5 * np.diff(log.t) * (v[1:] + v[:-1]) for side, v in means.items()}
    angles = {side: np.append(0.0, np.cumsum(way)) / 0.1651 for side, way in gone.items()}
    table = pd.DataFrame({**log.channels, **angles, "power": log.power})[::5]
    with Recorder(folder / "drive", "mcap") as bag:
        for at in table.itertuples():
            t, late = START + at.t, 0.004
            bag.write("/joint_states", JOINTS, t, late, name=["elbow"] * 20, position=np.zeros(20))
            wheels = {"name": ["right_wheel", "left_wheel"], "position": [at.right, at.left]}
            bag.write("/joint_states", JOINTS, t, late, **wheels)
            rates = {"/camera/imu": {"y": -at.yaw_rate}, "/imu/data": {"z": at.yaw_rate}}
            for topic in list(rates)[: 1 if strange else 2]:
                bag.write(
                    topic, IMU, t, late, orientation={"w": 1.0}, angular_velocity=rates[topic],
                    linear_acceleration={"z": 9.8},
                )  # fmt: skip
            for topic, share in packs.items():
                amps = -share(at.t) * at.power / 24.0
                bag.write(topic, BATTERY, t, late, voltage=24.0, current=amps)
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
    made = start(path, Given(**MEASURES))
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
    with pytest.raises(DriveLogError, match=r"twice: say --columns 'current=/battery\.c"):
        start(path, Given(**MEASURES))
    made = start(path, Given(**MEASURES, columns="current=/battery.current[-A]"))
    log = read_log(path, topics=made.project.topics)
    assert log.energy == pytest.approx(drive.energy, rel=0.01)


def test_columns_of_a_bag_are_named_by_hand(bags, drive):
    total = "power=/status.left_driver_current*/status.left_driver_voltage"
    made = start(bags["mcap"], Given(**MEASURES, columns=total))
    (column,) = made.project.topics.channels["power"]
    assert column.written == "left_driver_current * left_driver_voltage"
    with pytest.raises(DriveLogError, match=r"no column '/status.current'; near it"):
        start(bags["mcap"], Given(**MEASURES, columns="power=/status.current[W]"))


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


PACKED = ("mcap-zstd", "mcap-lz4", "sqlite-message", "sqlite-file", "ros1-bz2", "ros1-lz4")


@pytest.mark.parametrize("kind", PACKED)
def test_compressed_bags_are_read_and_damaged_parts_refused_by_name(tmp_path, kind):
    """Bytes in the middle of the compressed part are lost; its beginning is overwritten."""
    path = record_joints(tmp_path / ("drive.bag" if kind.startswith("ros1") else "drive"), kind)
    assert read_log(path, topics=TOPICS).power.tolist() == POWER
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    sound = file.read_bytes()
    magic = {"bz2": b"BZh9", "lz4": b"\x04\x22\x4d\x18"}.get(kind[-3:], b"\x28\xb5\x2f\xfd")
    start = sound.rindex(magic) if kind == "sqlite-message" else sound.index(magic)
    for spoiled in (
        sound[: start + 6] + bytes(20) + sound[start + 26 :],
        sound[:start] + b"none" + sound[start + 4 :],
    ):
        file.write_bytes(spoiled)
        with pytest.raises(DriveLogError, match="no sound bag"):
            read_log(path, topics=TOPICS)


def test_what_would_be_read_whole_before_it_is_known_for_a_bag_is_refused(tmp_path):
    file = tmp_path / "none.bag"
    file.write_bytes(bytes(10_000))
    with pytest.raises(DriveLogError, match="does not begin as a ROS 1 bag"):
        read_log(file, topics=TOPICS)
    (tmp_path / "metadata.yaml").write_bytes(b"a" * (9 << 20))
    with pytest.raises(DriveLogError, match=r"metadata\.yaml is larger than 8 MiB"):
        read_log(tmp_path, topics=TOPICS)


@pytest.mark.parametrize("kind", ["ros1-bz2", "ros1-lz4"])
def test_a_small_bag_that_unpacks_to_much_is_refused(tmp_path, monkeypatch, kind):
    file = record_joints(tmp_path / "a.bag", kind, padding=1 << 20)
    assert file.stat().st_size < 1 << 15
    assert read_log(file, topics=TOPICS).power.tolist() == POWER
    monkeypatch.setattr("energyplan.io.bags._LARGEST_CHUNK", 1 << 19)
    with pytest.raises(DriveLogError, match="unpacks to over 0 MiB"):
        read_log(file, topics=TOPICS)


DRIVER = "own_msgs/msg/Driver"
PARTS = {
    "own_msgs/msg/Wheels": ("std_msgs/Header header\nown_msgs/Driver[] units\nfloat64 bus_power\n"),
    "own_msgs/msg/Interfaces": (
        "std_msgs/Header header\nstring[] joint_names\nown_msgs/Values[] interface_values\n"
        "float64 bus_power\n"
    ),
    DRIVER: "float64 wheel_speed\nfloat64 bridge_temperature\n",
    "own_msgs/msg/Values": "string[] interface_names\nfloat64[] values\n",
}


@pytest.mark.parametrize("kind", ["numbered", "named"])
def test_arrays_of_messages_are_read_and_listed(tmp_path, drive, kind):
    """As of motor drivers, and of ros2_control's dynamic joint states."""
    order = [DRIVER, "own_msgs/msg/Values", "own_msgs/msg/Wheels", "own_msgs/msg/Interfaces"]
    path = tmp_path / "bag"
    with Recorder(path, "mcap", {name: PARTS[name] for name in order}) as bag:
        for t, left, right, power in zip(
            drive.t, drive.channel("v_left"), drive.channel("v_right"), drive.power, strict=True
        ):
            at = 1_700_000_000 + float(t)
            if kind == "numbered":
                units = [{"wheel_speed": left / 0.1}, {"wheel_speed": right / 0.1}]
                bag.write("/base", "own_msgs/msg/Wheels", at, units=units, bus_power=power)
            else:
                values = [{"interface_names": ["velocity"], "values": [v / 0.1]}
                          for v in (left, right)]  # fmt: skip
                bag.write(
                    "/base", "own_msgs/msg/Interfaces", at, interface_values=values,
                    joint_names=["left_wheel", "right_wheel"], bus_power=power,
                )  # fmt: skip
    names = {
        "numbered": ("units.0.wheel_speed", "units.1.wheel_speed"),
        "named": ("interface_values.left_wheel.values.velocity",
                  "interface_values.right_wheel.values.velocity"),
    }[kind]  # fmt: skip
    given = Given(track=0.5, wheelbase=0.4, mass=50.0, wheel_radius=0.1)
    if kind == "numbered":
        with pytest.raises(DriveLogError, match=r"/base.units.0.wheel_speed.* which side"):
            start(path, given)
    columns = ",".join(
        f"{channel}=/base.{name}[rad/s*0.1]"
        for channel, name in zip(("v_left", "v_right"), names, strict=True)
    )
    made = start(path, replace(given, columns=columns))
    log = read_log(path, topics=made.project.topics)
    np.testing.assert_allclose(log.channel("v_left"), drive.channel("v_left"), atol=1e-9)
    assert log.power == pytest.approx(drive.power)
    source = made.project.topics.channels["v_left"][0]  # of messages as they come, too
    part = SimpleNamespace(wheel_speed=7.0, interface_names=["effort", "velocity"],
                           values=[1.0, 7.0])  # fmt: skip
    message = SimpleNamespace(
        units=[part], interface_values=[part], joint_names=["left_wheel"], bus_power=1.0
    )
    assert read_message(source, message) == pytest.approx(0.7)
