"""Commands about routes that others keep: plan --former, export graph, export lattice."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import Run

from energyplan import OccupancyGrid, PowerModel, write_model
from energyplan.export.graph import read_route_graph
from energyplan.io.maps import write_map
from energyplan.power.effects import term

MODEL = "quadriga:empty:concrete"


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    write_map(OccupancyGrid(np.zeros((80, 120), bool), 0.1), tmp_path / "hall.yaml")
    return tmp_path / "hall.yaml"


def test_a_path_is_kept_while_it_is_free_and_bypassed_where_it_is_not(
    run: Run, hall: Path, tmp_path: Path
) -> None:
    asked = "--model", MODEL, "--json"
    path = tmp_path / "path.csv"
    code, out, _ = run("plan", "--map", hall, *asked, "--start", "1,4,0", "--goal", "11,4,0",
                       "--effort", 3000, "--out", path)  # fmt: skip
    assert code == 0
    whole = json.loads(out)["energy"]
    code, out, _ = run(
        "plan", "--former", path, "--map", hall, *asked, "--start", "3,4,0", "--effort", 3000
    )
    assert code == 0
    rest = json.loads(out)
    # eight of ten metres are left
    assert rest["energy"] == pytest.approx(0.8 * whole, rel=1e-3)
    cells = np.zeros((80, 120), bool)
    cells[36:44, 60:64] = True
    write_map(OccupancyGrid(cells, 0.1), tmp_path / "now.yaml")
    after = tmp_path / "after.csv"
    code, out, err = run("plan", "--former", path, "--map", tmp_path / "now.yaml", *asked,
                         "--start", "3,4,0", "--effort", 3000, "--out", after)  # fmt: skip
    assert code == 0, err
    assert json.loads(out)["energy"] > rest["energy"] + 1
    assert np.ptp(np.genfromtxt(after, delimiter=",", names=True)["y"]) > 0.4
    cells[:, 60:64] = True
    write_map(OccupancyGrid(cells, 0.1), tmp_path / "shut.yaml")
    code, out, _ = run("plan", "--former", path, "--map", tmp_path / "shut.yaml", *asked,
                       "--start", "3,4,0", "--effort", 3000, "--strict")  # fmt: skip
    assert code == 3
    code, _, err = run(
        "plan", "--former", tmp_path / "none.csv", "--map", hall, *asked, "--start", "3,4,0"
    )
    assert code == 2
    assert "none.csv" in err.splitlines()[-1]


def test_the_edges_of_a_route_graph_are_priced_and_the_closed_ones_named(
    run: Run, tmp_path: Path
) -> None:
    cells = np.zeros((80, 120), bool)
    cells[50:, 60:64] = True
    write_map(OccupancyGrid(cells, 0.1), tmp_path / "hall.yaml")
    places = {0: (2, 2), 1: (10, 2), 2: (6.2, 7)}
    ends = {3: (0, 1), 4: (1, 2)}
    features = [
        {"type": "Feature", "properties": {"id": k},
         "geometry": {"type": "Point", "coordinates": at}}
        for k, at in places.items()
    ] + [
        {"type": "Feature", "properties": {"id": k, "startid": a, "endid": b},
         "geometry": {"type": "MultiLineString", "coordinates": [[places[a], places[b]]]}}
        for k, (a, b) in ends.items()
    ]  # fmt: skip
    graph, out = tmp_path / "graph.geojson", tmp_path / "priced.geojson"
    graph.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    code, told, err = run("export", "graph", graph, "--map", tmp_path / "hall.yaml",
                          "--model", MODEL, "--effort", 1000, "--out", out, "--json")  # fmt: skip
    assert code == 0, err
    told = json.loads(told)
    (edge,) = told["edges"]
    assert (edge["source"], edge["target"]) == (0, 1)
    (closed,) = told["closed"]
    assert (closed["source"], closed["target"]) == (1, 2)
    assert "goal" in closed["reason"]
    (priced,) = read_route_graph(out).edges(data=True)
    assert priced[2]["cost"] == pytest.approx(edge["energy"])
    graph.write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    code, _, err = run("export", "graph", graph, "--map", tmp_path / "hall.yaml", "--model", MODEL)
    assert code == 2
    assert "graph.geojson" in err


def test_primitives_and_penalties_are_written_for_nav2(run: Run, tmp_path: Path) -> None:
    out, parameters = tmp_path / "lattice.json", tmp_path / "planner.yaml"
    code, told, err = run("export", "lattice", "--model", MODEL, "--resolution", 0.1, "--out", out,
                          "--penalties", parameters, "--json")  # fmt: skip
    assert code == 0, err
    told = json.loads(told)
    assert len(json.loads(out.read_text())["primitives"]) == told["primitives"]
    kept = yaml.safe_load(parameters.read_text())["GridBased"]
    assert kept["lattice_filepath"] == str(out)
    assert kept["rotation_penalty"] == pytest.approx(told["penalties"]["rotation"], abs=1e-4)
    code, _, err = run("export", "lattice", "--model", MODEL, "--resolution", 0, "--out", out)
    assert code == 2
    assert "resolution" in err


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
