"""From a robot's log to a trajectory and a mission as a new user would, in an empty folder.

Every file comes from a command, but for the log, the map and the mission.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import Run
from own_robot import bag, drive

Ask = Callable[..., dict[str, Any]]

pytestmark = pytest.mark.usefixtures("hurried")


@pytest.fixture
def ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> Ask:
    """Run a command in an empty folder; return its JSON document."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run(*arguments, "--json").json


def chain(ask: Ask, log: str, measures: tuple[object, ...], poses: tuple[str, str]) -> None:
    """Start, identify, diagnose, plan, check and budget, each with one command."""
    project, route = ("--project", "robot.yaml"), ("--map", "map.yaml", "--model", "extended.yaml")
    started = ask("start", log, *measures, "--out", "robot.yaml")
    assert all(check["ok"] for check in started["checks"])
    assert len(started["checks"]) >= 6
    found = ask("identify", log, *project, "--out", "model.yaml")
    assert {term["name"] for term in found["terms"]} == {"slip_friction", "traction_resistance"}
    for term in found["terms"]:
        assert 0 < term["std_error"] < 0.2 * term["value"]
    told = ask("diagnose", log, *project, "--out", "extended.yaml")
    assert len(told["training"]) == len(told["judging"]) == 1
    start, goal = poses
    plan = ask("plan", *project, *route, "--start", start, "--goal", goal, "--effort",
               20_000, "--trajectory", "trajectory.csv")  # fmt: skip
    checked = ask("check", "trajectory.csv", "--model", "extended.yaml", *project)
    assert checked["feasible"]
    assert checked["energy"] == pytest.approx(plan["energy_driven"], rel=1e-3)
    # equal where the plan is optimal: the file's digits round the twelfth
    assert checked["energy"] >= plan["lower_bound"] * (1 - 1e-9)
    Path("mission.yaml").write_text(
        f"model: extended.yaml\nmap: map.yaml\nbattery: quadriga\nstart: [{start}]\n"
        f"tasks: [{{name: look, pose: [{goal}]}}]\n"
    )
    mission = ask("mission", "mission.yaml", *project, "--effort", 20_000)
    assert [task["name"] for task in mission["tasks"]] == ["look"]
    assert mission["tasks"][0]["reachable_alone"]


@pytest.mark.shared
@pytest.mark.slow
def test_from_the_log_of_a_warthog(shared_data: Path, tmp_path: Path, ask: Ask) -> None:
    shutil.copy(shared_data / "drive" / "warthog_grass.csv", tmp_path / "drive.csv")
    shutil.copy(shared_data / "maps" / "depot.pgm", tmp_path)
    shutil.copy(shared_data / "maps" / "depot.yaml", tmp_path / "map.yaml")
    measures = ("--track", 1.13, "--wheelbase", 0.91, "--mass", 470)
    chain(ask, "drive.csv", measures, ("4.6,7.7,0", "10.5,7.8,90deg"))


@pytest.mark.nightly  # by day the pages' commands are run, from a bag as well
def test_from_a_bag_of_a_robot_that_no_preset_knows(tmp_path: Path, ask: Ask) -> None:
    from energyplan.io.files import bundled, files_behind

    bag(tmp_path, drive())
    for file in files_behind(bundled("warehouse.yaml")):
        shutil.copy(file, tmp_path / (file.name if file.suffix != ".yaml" else "map.yaml"))
    measures = ("--track", 0.4, "--wheelbase", 0.62, "--mass", 30)
    chain(ask, "bag", measures, ("14,10.6,0", "21,11.8,90deg"))
