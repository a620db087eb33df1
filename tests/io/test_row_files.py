"""Files of rows as the tasks of a mission: lines of GeoJSON, tables of points and of poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from energyplan.errors import MissionError
from energyplan.io.mission import read_mission
from energyplan.mission import Mission

HEAD = """\
model: quadriga:empty:concrete
map: warehouse.yaml
battery: quadriga
start: [1.5, 1.5, 0]
"""


def lines(*features: tuple[Any, dict[str, Any] | None], kind: str = "LineString") -> str:
    shapes = [
        {"type": "Feature", "properties": keys, "geometry": {"type": kind, "coordinates": points}}
        for points, keys in features
    ]
    return json.dumps({"type": "FeatureCollection", "features": shapes})


def mission(folder: Path, tasks: str) -> Mission:
    (folder / "rows.yaml").write_text(HEAD + tasks)
    return read_mission(folder / "rows.yaml")


@pytest.mark.parametrize("robots", ["", "robots: [{name: a}, {name: b, start: [2, 8, 0]}]\n"])
def test_each_line_is_a_task_with_its_properties_as_keys(tmp_path: Path, robots: str) -> None:
    """A height that a program wrote beside x and y is no yaw."""
    north = {"name": "north", "power": "180 W", "speed": 0.5, "direction": "given"}
    north |= {"fid": 7, "crop": "maize"}  # programs that draw number their shapes by fid
    south = {"name": None, "payload_per_metre": 0.5, "required": False, "window": [0, 900]}
    (tmp_path / "rows.geojson").write_text(
        lines(([[2, 1.5, 30.0], [2, 8, 31.0]], north), ([[2, 8], [11, 8]], south))
    )
    found = mission(tmp_path, "tasks: rows.geojson\n" + robots)
    one, two = found.tasks
    assert (one.name, one.power, one.speed, one.direction) == ("north", 180.0, 0.5, "given")
    assert one.path == ((2.0, 1.5), (2.0, 8.0)) and len(one.options) == 1
    assert (two.name, two.change, two.required, two.window) == ("row 2", 4.5, False, (0, 900))
    assert "properties of the lines that are not used: crop" in found.notes


def test_parts_of_a_line_are_tasks_of_their_own(tmp_path: Path) -> None:
    parts = [[[2, 1.5], [2, 8]], [[2, 8], [11, 8]]]
    text = lines((parts, {"name": "all"}), kind="MultiLineString")
    (tmp_path / "rows.geojson").write_text(text)
    names = [task.name for task in mission(tmp_path, "tasks: rows.geojson\n").tasks]
    assert names == ["all", "all (2)"]


def test_a_path_may_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("x,y\n2,1.5\n2,8\n")
    (tmp_path / "poses.csv").write_text("x,y,yaw_deg\n2,1.5,90\n2,8,90\n")
    (tmp_path / "line.geojson").write_text(lines(([[2, 8], [11, 8]], {})))
    names = "points.csv", "poses.csv", "line.geojson"
    tasks = [f"{{name: {name}, path: {name}}}" for name in names]
    found = mission(tmp_path, f"tasks: [{', '.join(tasks)}]\n").tasks
    assert [len(task.path[0]) for task in found] == [2, 3, 2]
    np.testing.assert_allclose(found[1].options[0].exit, (2.0, 8.0, np.pi / 2))


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("rows.geojson", lines(([[0.5e-5, 0.1e-5], [0.6e-5, 0.1e-5]], {})), "degrees of longitude"),
        ("rows.geojson", lines(([2.0, 1.5], {}), kind="Point"), "a Point; give one of LineString"),
        ("rows.geojson", lines(), "draw a line for each row"),
        ("rows.json", lines(([[2, 1.5], [2, 8]], {})), "name the file .geojson"),
        ("rows.geojson", lines(([[2, 1.5], [2, 8]], {"power": "60 parsec"})), "parsec"),
        ("rows.geojson", lines(([[2, 1.5], [200, 8]], {})), "outside the map"),
    ],
)
def test_a_file_that_holds_no_rows_is_refused(
    tmp_path: Path, file: str, text: str, words: str
) -> None:
    (tmp_path / file).write_text(text)
    with pytest.raises(MissionError, match=words):
        mission(tmp_path, f"tasks: {file}\n")


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("line.csv", "x,z\n1,2\n", "has no column 'y'"),
        ("line.csv", "x,y\n2,1.5\n", "a path of 1 points"),
        ("line.geojson", lines(([[2, 1.5], [2, 8]], {}), ([[2, 1.5], [2, 8]], {})), "has 2 lines"),
        ("other.csv", "", "there is no file 'line.csv'"),
    ],
)
def test_a_file_that_holds_no_path_is_refused(
    tmp_path: Path, file: str, text: str, words: str
) -> None:
    (tmp_path / file).write_text(text)
    name = file if file.startswith("line") else "line.csv"
    with pytest.raises(MissionError, match=words) as caught:
        mission(tmp_path, f"tasks:\n  - name: one\n    path: {name}\n")
    assert "rows.yaml, line" in str(caught.value)
