"""What a log holds: `describe_log` and ``energyplan start``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import Run

from energyplan import PowerModel, simulate
from energyplan.errors import DriveLogError
from energyplan.io.logs import describe_log
from energyplan.io.tables import write_log


@pytest.fixture(scope="module")
def drive():
    return simulate.drive(PowerModel.preset("quadriga:full:marble"), "spiral", rate=10.0, seed=3)


@pytest.fixture
def table(drive, tmp_path: Path) -> Path:
    return write_log(drive, tmp_path / "drive.csv")


def test_a_table_lists_its_columns_and_what_they_serve_for(drive, table: Path) -> None:
    told = describe_log(table)
    assert told.kind == "table"
    assert told.duration == pytest.approx(drive.t[-1] - drive.t[0])
    entries = {entry.name: entry for entry in told.entries}
    assert set(entries) == set(drive.channels)
    assert entries["v_left"].serves == "v_left [m/s]"
    assert entries["v_left"].count == len(drive)
    assert entries["v_left"].rate == pytest.approx(10.0, rel=0.01)
    assert set(told.channels["columns"]) == set(drive.channels)


def test_foreign_columns_are_told_with_what_is_missing(tmp_path: Path) -> None:
    file = tmp_path / "foreign.csv"
    file.write_text("t,velL,velR,power,note\n0,1,1,50,start\n1,1,1,,go\n2,1,1,50,stop\n")
    told = describe_log(file)
    entries = {entry.name: entry for entry in told.entries}
    assert entries["velL"].serves == "v_left, it seems"
    assert entries["power"].count == 2
    assert entries["note"].type == "text"
    (note,) = told.notes
    assert "v_left, v_right" in note
    assert "power," not in note
    assert "energyplan start foreign.csv" in note


def test_names_of_others_are_guessed_and_time_is_told_in_their_unit(tmp_path: Path) -> None:
    file = tmp_path / "foreign.csv"
    clock = [1770000000000 + 50 * k for k in (*range(100), *range(60))]  # and begins anew
    rows = "".join(f"{t};1,5;1,5;75,2;80,1\n" for t in clock)
    file.write_text("clock [ms];v_l_kph;v_left_raw;P_left [kW];foo\n" + rows)
    told = describe_log(file)
    assert told.duration == pytest.approx(4.95 + 2.95)
    serves = {entry.name: entry.serves for entry in told.entries}
    assert serves["clock [ms]"] == "t, it seems [ms]"
    assert serves["P_left [kW]"] == "p_left, it seems [kW]"
    assert serves["foo"] == ""
    (entry,) = (one for one in told.entries if one.name == "foo")
    assert entry.rate == pytest.approx(20.0, rel=0.02)


def test_a_husky_recording_is_known(tmp_path: Path) -> None:
    t = np.arange(0.0, 10.0, 0.1)
    columns = np.column_stack([t, *(np.full_like(t, 1.0) for _ in range(4))])
    file = tmp_path / "pro_01.csv"
    np.savetxt(file, columns, delimiter=",", header="time,curL,curR,velL,velR", comments="")
    told = describe_log(file)
    assert told.kind == "husky"
    assert told.duration == pytest.approx(9.9)
    assert {"p_left", "p_right", "v_left", "v_right"} <= set(told.channels["columns"])


@pytest.mark.parametrize("name", ["absent.csv", "absent.bag", "notes.txt"])
def test_what_is_no_log_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(DriveLogError, match=name):
        describe_log(tmp_path / name)


def bag(folder: Path, topics: dict[str, str]) -> Path:
    """Write a bag of ten empty messages per topic, a second long."""
    writer = pytest.importorskip("rosbags.rosbag1").Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    folder.mkdir(exist_ok=True)
    file = folder / "drive.bag"
    with writer(file) as made:
        for topic, kind in topics.items():
            connection = made.add_connection(topic, kind, typestore=store)
            for k in range(10):
                made.write(connection, 10**9 + k * 10**8, b"")
    return file


def test_a_bag_lists_topics_and_the_channels_of_each_map(tmp_path: Path) -> None:
    battery, joints = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/JointState"
    topics = {"/joint_states": joints, "/battery_state": battery, "/rosout": "std_msgs/msg/String"}
    told = describe_log(bag(tmp_path, topics))
    assert told.kind == "bag"
    entries = {entry.name: entry for entry in told.entries}
    assert set(entries) == set(topics)
    assert entries["/joint_states"].count == 10
    assert "v_left" in entries["/joint_states"].serves
    assert entries["/rosout"].serves == ""
    assert {"t", "v_left", "v_right", "voltage", "current"} <= set(told.channels["jackal"])
    assert "husky" in told.notes[0]


def test_a_bag_without_power_says_so(tmp_path: Path) -> None:
    told = describe_log(bag(tmp_path, {"/joint_states": "sensor_msgs/msg/JointState"}))
    assert "lacks power" in told.notes[0]
    told = describe_log(bag(tmp_path / "other", {"/rosout": "std_msgs/msg/String"}))
    assert "t, v_left, v_right, power" in told.notes[0]
    assert told.channels["husky"] == ()


def test_topic_maps_are_chosen_by_name(tmp_path: Path, run: Run) -> None:
    """A map finds the joints' topic or not; either way the answer names the map."""
    file = bag(tmp_path, {"/rosout": "std_msgs/msg/String"})
    for topics, words in (("jackal", ("'jackal'", "/rosout")), ("tractor", ("tractor", "warthog"))):
        told = run("identify", file, "--vehicle", "jackal", "--topics", topics)
        assert told.code == 2
        assert all(word in told.err for word in words)
