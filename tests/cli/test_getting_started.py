"""From a robot's log to a trajectory and a mission as a new user would, in an empty folder, cold.

Nothing is edited by hand: every file comes from a command, but for the log and the map.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from own_robot import bag, drive

ROOT = Path(__file__).resolve().parents[2]


def run(folder: Path, *arguments: object) -> dict[str, Any]:
    """Run a command of its own process; return its JSON document."""
    command = [sys.executable, "-m", "energyplan", *map(str, arguments), "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}: {done.stderr}"
    document = json.loads(done.stdout)
    assert isinstance(document, dict)
    return document


def chain(folder: Path, log: str, measures: tuple[object, ...], poses: tuple[str, str]) -> None:
    """Start, identify, diagnose, plan, check and budget, each with one command."""
    project, route = ("--project", "robot.yaml"), ("--map", "map.yaml", "--model", "extended.yaml")
    started = run(folder, "start", log, *measures, "--out", "robot.yaml")
    assert all(check["ok"] for check in started["checks"])
    assert len(started["checks"]) >= 6
    found = run(folder, "identify", log, *project, "--out", "model.yaml")
    assert {term["name"] for term in found["terms"]} == {"slip_friction", "traction_resistance"}
    for term in found["terms"]:
        assert 0 < term["std_error"] < 0.2 * term["value"]
    told = run(folder, "diagnose", log, *project, "--out", "extended.yaml")
    assert len(told["training"]) == len(told["judging"]) == 1
    start, goal = poses
    plan = run(folder, "plan", *project, *route, "--start", start, "--goal", goal, "--effort",
               20_000, "--trajectory", "trajectory.csv")  # fmt: skip
    checked = run(folder, "check", "trajectory.csv", "--model", "extended.yaml", *project)
    assert checked["feasible"]
    assert checked["energy"] == pytest.approx(plan["energy_driven"], rel=1e-3)
    # equal where the plan is optimal: the file's digits round the twelfth
    assert checked["energy"] >= plan["lower_bound"] * (1 - 1e-9)
    mission = run(folder, "mission", *project, *route, "--battery", "quadriga", "--start", start,
                  "--task", f"look={goal}", "--effort", 20_000)  # fmt: skip
    assert [task["name"] for task in mission["tasks"]] == ["look"]
    assert mission["tasks"][0]["reachable_alone"]


@pytest.mark.shared
@pytest.mark.slow
def test_from_the_log_of_a_warthog(shared_data: Path, tmp_path: Path) -> None:
    shutil.copy(shared_data / "drive" / "warthog_grass.csv", tmp_path / "drive.csv")
    shutil.copy(shared_data / "maps" / "depot.pgm", tmp_path)
    shutil.copy(shared_data / "maps" / "depot.yaml", tmp_path / "map.yaml")
    measures = ("--track", 1.13, "--wheelbase", 0.91, "--mass", 470)
    chain(tmp_path, "drive.csv", measures, ("4.6,7.7,0", "10.5,7.8,90deg"))


@pytest.mark.slow
def test_from_a_bag_of_a_robot_that_no_preset_knows(tmp_path: Path) -> None:
    from energyplan.io.bundled import bundled
    from energyplan.io.files import files_behind

    bag(tmp_path, drive())
    for file in files_behind(bundled("warehouse.yaml")):
        shutil.copy(file, tmp_path / (file.name if file.suffix != ".yaml" else "map.yaml"))
    measures = ("--track", 0.4, "--wheelbase", 0.62, "--mass", 30)
    chain(tmp_path, "bag", measures, ("14,10.6,0", "21,11.8,90deg"))
