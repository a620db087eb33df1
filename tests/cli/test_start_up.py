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
    ("arguments", "needed"),
    [
        (["plan", "--help"], []),
        (["plan", *GROUND, *ENDS], []),
        (["compare", *GROUND, *ENDS], []),
        (["range", *GROUND, "--start", "2,2,0", "--energy", "500"], []),
        (["check", "trajectory.csv", "--model", "quadriga:empty:concrete"], ["pandas"]),
    ],
)
def test_planning_and_checking_load_neither_fitting_nor_plotting(
    arguments: list[str], needed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table is read by pandas."""
    monkeypatch.chdir(tmp_path)
    rows = "t,x,y,yaw,v,omega\n0,0,0,0,0.5,0\n1,0.5,0,0,0.5,0\n2,1,0,0,0.5,0\n"
    Path("trajectory.csv").write_text(rows)
    loaded(*arguments)  # what had to be compiled loads what it is compiled with
    assert loaded(*arguments) == str(needed)
