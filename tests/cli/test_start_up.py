"""What a command loads: no more than it needs, so that it starts at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

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


def loaded(*arguments: str) -> str:
    """Return which of the slow modules a command has loaded when it ends."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan", "--help"],
        ["plan", *GROUND, *ENDS],
        ["compare", *GROUND, *ENDS],
        ["range", *GROUND, "--start", "2,2,0", "--energy", "500"],
    ],
)
def test_planning_loads_neither_fitting_nor_plotting(arguments: list[str]) -> None:
    loaded(*arguments)  # what had to be compiled loads what it is compiled with
    assert loaded(*arguments) == "[]"


def test_a_check_loads_neither_fitting_nor_plotting(tmp_path: Path) -> None:
    table = tmp_path / "trajectory.csv"
    table.write_text("t,x,y,yaw,v,omega\n0,0,0,0,0.5,0\n1,0.5,0,0,0.5,0\n2,1,0,0,0.5,0\n")
    command = ["check", str(table), "--model", "quadriga:empty:concrete"]
    loaded(*command)
    assert loaded(*command) == "['pandas']"  # which reads the table
