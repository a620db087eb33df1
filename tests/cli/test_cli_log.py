"""What ``energyplan start`` says of a log without a project to write, and of topic maps."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import Run

from energyplan import PowerModel, simulate
from energyplan.io.tables import write_log


def test_start_without_a_project_checks_a_log_all_the_same(tmp_path: Path, run: Run) -> None:
    log = simulate.drive(PowerModel.preset("quadriga:full:marble"), "spiral", rate=10.0, seed=3)
    table = write_log(log, tmp_path / "drive.csv")
    told = run("start", table, "--track", 0.5, "--wheelbase", 0.475, "--mass", 147)
    assert told.code == 0 and "v_left" in told.out and "give --out PROJECT.yaml" in told.out
    project = tmp_path / "robot.yaml"
    with table.open("a") as rows:
        rows.write("300" + (len(log.channels) - 1) * ",1e308")  # whose square is no number
    assert run("start", table, "--like", "quadriga", "--out", project).code == 0
    assert "assumed mass" not in run("start", table, "--project", project).out
    table.write_text("t,velL,velR,note\n0,1,1,start\n1,1,1,go\n")
    told = run("start", table)
    assert told.code == 2 and "nothing seems to be power" in told.err and "note" in told.err


def test_topic_maps_are_chosen_by_name(tmp_path: Path, run: Run) -> None:
    """A map finds the joints' topic or not; either way the answer names the map."""
    writer = pytest.importorskip("rosbags.rosbag1").Writer
    from rosbags.typesys import Stores, get_typestore

    file = tmp_path / "drive.bag"
    with writer(file) as made:
        store = get_typestore(Stores.ROS1_NOETIC)
        connection = made.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        made.write(connection, 10**9, b"")
    for topics, words in (("jackal", ("'jackal'", "/rosout")), ("tractor", ("tractor", "warthog"))):
        told = run("identify", file, "--vehicle", "jackal", "--topics", topics)
        assert told.code == 2 and all(word in told.err for word in words)
