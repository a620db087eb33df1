"""What ``energyplan start`` says of a log without a project to write, and of topic maps."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import Run

from energyplan import DriveLog, PowerModel, simulate
from energyplan.io.files import bundled
from energyplan.io.tables import write_log


def test_start_without_a_project_checks_a_log_all_the_same(tmp_path: Path, run: Run) -> None:
    log = simulate.drive(PowerModel.preset("quadriga:full:marble"), "spiral", rate=10.0, seed=3)
    table = write_log(log, tmp_path / "drive.csv")
    told = run("start", table, "--track", 0.5, "--wheelbase", 0.475, "--mass", 147)
    assert told.code == 0 and "v_left" in told.out and "give --out PROJECT.yaml" in told.out
    project = tmp_path / "robot.yaml"
    with table.open("a") as rows:
        rows.write("300" + (len(log.channels) - 1) * ",1e308")  # whose square is no number
    told = run("start", table, "--like", "quadriga", "--out", project)
    assert told.code == 0
    assert "quadriga stands for quadriga:empty, of 83.1 kg; known: quadriga:empty, " in told.err
    assert "assumed mass" not in run("start", table, "--project", project).out
    table.write_text("t,velL,velR,note\n0,1,1,start\n1,1,1,go\n")
    told = run("start", table)
    assert told.code == 2 and "nothing seems to be power" in told.err and "note" in told.err


def test_watch_follows_one_of_several_robots(tmp_path: Path, run: Run) -> None:
    """Its own tasks are looked at, and no other robot's."""
    for name in ("warehouse.yaml", "warehouse.png", "warehouse_surfaces.geojson"):
        shutil.copy(bundled(name), tmp_path)
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(bundled("fleet_warehouse.yaml").read_text().replace("3000", "100"))
    still = {
        "v_left": 0.0,
        "v_right": 0.0,
        "power": 5.0,
        "x": 20.0,
        "y": 2.0,
        "yaw": 0.0,
        "soc": 0.35,
    }
    t = np.arange(0.0, 3.0, 0.1)
    log = DriveLog({"t": t} | {name: np.full_like(t, value) for name, value in still.items()})
    words = (
        "watch",
        write_log(log, tmp_path / "gamma.csv"),
        "--mission",
        fleet,
        "--once",
        "--json",
    )
    events = [json.loads(line) for line in run(*words, "--robot", "gamma").out.splitlines()]
    report, *_ = [one["mission"] for one in events if one["event"] == "reassessed"]
    planned = json.loads(run("mission", fleet, "--json").out)["robots"]
    tasks = {robot["name"]: {one["name"] for one in robot["tasks"]} for robot in planned}
    assert {one["name"] for one in report["tasks"]} == tasks["gamma"]
    assert tasks["gamma"] and tasks["alpha"]
    for robot, message in (
        ("delta", "the robots are alpha, beta, gamma"),
        (None, "say whose: --robot NAME"),
    ):
        refused = run(*words, *(("--robot", robot) if robot else ()))
        assert refused.code == 2 and message in refused.err


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
