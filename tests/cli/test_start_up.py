"""What a command loads: no more than it needs, so that it starts at once."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import own_robot
import pytest

import energyplan

MAPS = Path(energyplan.__file__).parents[1] / "maps"
GROUND = ["--map", str(MAPS / "warehouse.yaml"), "--model", "quadriga:full:concrete"]
ENDS = ["--start", "2,2,0", "--goal", "6,2,0", "--effort", "1000"]

RUN = """
import sys
from energyplan.cli import main
try:
    main()
finally:
    slow = ("matplotlib", "pandas", "scipy.linalg", "scipy.ndimage", "scipy.optimize",
            "scipy.signal", "scipy.stats", "energyplan.fit", "networkx", "ompl")
    print([name for name in slow if name in sys.modules], file=sys.stderr)
"""


def run(folder: Path, code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True, text=True, check=False, cwd=folder,
    )  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan", "--help"],
        ["plan", *GROUND, *ENDS],
        ["compare", *GROUND, *ENDS],
        ["range", *GROUND, "--start", "2,2,0", "--energy", "500"],
        ["check", "trajectory.csv", "--model", "quadriga:empty:concrete"],
    ],
)
def test_plans_and_checks_load_neither_fitting_nor_plotting(
    arguments: list[str], folder: Path
) -> None:
    run(folder, RUN, *arguments)  # what had to be compiled loads what it is compiled with
    done = run(folder, RUN, *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == "[]"


SMALL = """
import sys
for name in sys.argv.pop(1).split():
    sys.modules[name] = None
from energyplan.cli import main
main()
"""
MISSION = f"""
model: quadriga:full:concrete
map: {MAPS / "office.yaml"}
battery: quadriga
confidence: 0.5
start: [1.2, 2.0, 90deg]
tasks: [{{name: look, pose: [3.9, 2.0, 90deg]}}]
"""
DATED = "time,v_left,v_right,power\n" + "".join(
    f"2026-03-01 10:00:{k:02},0.5,0.5,100\n" for k in range(60)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("small")
    (place / "mission.yaml").write_text(MISSION)
    (place / "dated.csv").write_text(DATED)
    (place / "trajectory.csv").write_text(
        "t,x,y,yaw,v,omega\n0,0,0,0,0.5,0\n1,0.5,0,0,0.5,0\n2,1,0,0,0.5,0\n"
    )
    own_robot.bag(place, own_robot.drive())
    return place


BARE = "pandas matplotlib rosbags"
MEASURES = ["--track", "0.4", "--wheelbase", "0.62", "--mass", "30"]


@pytest.mark.parametrize(
    ("commands", "missing", "extra"),
    [
        (
            [
                ["plan", *GROUND, *ENDS, "--trajectory", "timed.csv"],
                ["check", "timed.csv", "--model", "quadriga:full:concrete", "--out", "slow.csv"],
            ],
            BARE,
            None,
        ),
        ([["mission", "mission.yaml", "--effort", "1000", "--trajectories", "legs"]], BARE, None),
        ([["start", "bag", *MEASURES]], "pandas matplotlib", None),
        ([["start", "bag", *MEASURES]], BARE, "bags"),
        ([["start", "dated.csv", "--like", "jackal"]], BARE, "logs"),
        ([["plan", *GROUND, *ENDS, "--plot", "route.png"]], BARE, "plots"),
        ([["plan", *GROUND, *ENDS, "--out", "path.mcap"]], BARE, "bags"),
        ([["mission", "mission.yaml", "--report", "mission.html"]], BARE, "plots"),
        ([["demo"]], BARE, "plots"),
    ],
    ids=lambda value: " ".join(line[0] for line in value) if isinstance(value, list) else value,
)
def test_without_optional_packages(
    commands: list[list[str]], missing: str, extra: str | None, folder: Path
) -> None:
    """A plan, a check and a mission need none; what does names the extra that has it."""
    for words in commands:
        done = run(folder, SMALL, missing, *words)
        if extra is None:
            assert done.returncode == 0, done.stderr
        else:
            assert done.returncode == 2
            assert len(done.stderr.splitlines()) == 1
            checkout = Path(energyplan.__file__).parents[1]
            line = rf"install it with pip install (-e )?'?{checkout}\[{extra}\]'?$"
            assert re.search(line, done.stderr.rstrip())
