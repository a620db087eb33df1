"""Commands about routes that others keep: plan --former, and what is exported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import Run

from energyplan import OccupancyGrid, PowerModel, write_model
from energyplan.io.maps import write_map
from energyplan.power.effects import term

MODEL = "quadriga:empty:concrete"


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    write_map(OccupancyGrid(np.zeros((80, 120), bool), 0.1), tmp_path / "hall.yaml")
    return tmp_path / "hall.yaml"


def test_a_path_that_is_shut_has_no_way_round(run: Run, hall: Path, tmp_path: Path) -> None:
    asked = ("--map", hall, "--model", MODEL, "--start", "3,4,0", "--effort", 3000)
    former = tmp_path / "path.csv"
    former.write_text("x,y,yaw\n1,4,0\n11,4,0\n")
    cells = np.zeros((80, 120), bool)
    cells[:, 60:64] = True
    write_map(OccupancyGrid(cells, 0.1), hall)
    assert run("plan", "--former", former, *asked, "--strict").code == 3


@pytest.mark.parametrize(
    "command",
    [("export", "lattice", "--resolution", 0.1, "--out"), ("export", "table", "--out")],
    ids=lambda c: c[0],
)
def test_what_knows_no_map_says_that_it_leaves_a_slope_out(
    run: Run, tmp_path: Path, command: tuple[object, ...]
) -> None:
    level = PowerModel.preset(MODEL)
    tilted = write_model(level.with_term(term("tilt_x"), 20.0), tmp_path / "tilted.yaml")
    plain = write_model(level, tmp_path / "level.yaml")
    out = {"lattice": "out.json", "table": "out.csv"}[str(command[1])]
    code, _, err = run(*command, tmp_path / out, "--model", tilted)
    assert code == 0, err
    assert "left out" in err
    code, _, err = run(*command, tmp_path / out, "--model", plain)
    assert code == 0, err
    assert "left out" not in err
