"""The page about answers in JSON names exactly the keys that the commands print."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import energyplan as ep
from energyplan import cli, simulate
from energyplan.io.bundled import bundled
from energyplan.io.files import files_behind
from energyplan.io.trajectory import write_log, write_trajectory

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "json.md"
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.M | re.S))
MODEL = ep.PowerModel.preset("quadriga:full:marble")

PLACE = "--map office.yaml --model quadriga:full:marble --effort 500"
WAY = "--start 1.2,2,90deg --goal 3.9,2,90deg"
COMMANDS = {
    "start": "start drive.csv --track 0.5 --wheelbase 0.475 --mass 147 --out robot.yaml",
    "identify": "identify drive.csv --vehicle quadriga:full",
    "diagnose": "diagnose drive.csv --vehicle quadriga:full",
    "icr": "icr drive.csv --vehicle quadriga:full",
    "plan": f"plan {PLACE} {WAY}",
    "compare": f"compare {PLACE} {WAY}",
    "check": "check trajectory.csv --model quadriga:full:marble",
    "mission": "mission --map office.yaml --model model.yaml --effort 500 --battery quadriga "
    "--start 1.2,2,90deg --task look=3.9,2,90deg",
    "rmf": "rmf --model quadriga:full:concrete --battery quadriga --charging-current 10",
    "nav2-lattice": "nav2-lattice --model quadriga:full:marble --out lattice.json",
    "cost-table": "cost-table --model quadriga:full:marble --out cost.csv",
    "plan-edges": f"plan-edges graph.geojson {PLACE}",
    "warmup": "warmup",
}


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("json")
    log = simulate.identification_drive(MODEL, power_noise=5.0, speed_noise=0.003, seed=2)
    write_log(log, folder / "drive.csv")
    ep.write_model(ep.identify(log, MODEL.vehicle).model, folder / "model.yaml")
    path = ep.Path(ep.Pose(0, 0, 0), ds=[2.0, 0.5], dtheta=[0.0, 1.0])
    write_trajectory(ep.speed.profile(path, MODEL), folder / "trajectory.csv")
    places = {0: (1.2, 2.0), 1: (3.9, 2.0), 2: (-5.0, 2.0)}  # the last is off the map
    features = [
        {"type": "Feature", "properties": {"id": k},
         "geometry": {"type": "Point", "coordinates": at}} for k, at in places.items()
    ] + [
        {"type": "Feature", "properties": {"id": 2 + k, "startid": 0, "endid": k},
         "geometry": {"type": "MultiLineString", "coordinates": [[places[0], places[k]]]}}
        for k in (1, 2)
    ]  # fmt: skip
    graph = {"type": "FeatureCollection", "features": features}
    (folder / "graph.geojson").write_text(json.dumps(graph))
    for file in files_behind(bundled("office.yaml")):
        shutil.copy(file, folder)
    return folder


def rows(section: str) -> dict[str, str]:
    """The meanings on the page, by key."""
    table = re.findall(r"^\| (`.+?) \| (.+) \|$", SECTIONS[section], re.M)
    return {key: meaning for keys, meaning in table for key in re.findall(r"`(\w+)`", keys)}


def nested(value: Any) -> set[str]:
    """Keys of the records in a list of them."""
    records = [one for one in value if isinstance(one, Mapping)] if isinstance(value, list) else []
    return {key for record in records for key in record}


@pytest.mark.parametrize("command", COMMANDS)
def test_keys_of_a_command(
    command: str,
    material: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(material)
    monkeypatch.setattr(sys, "argv", ["energyplan", *shlex.split(COMMANDS[command]), "--json"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    printed = capsys.readouterr()
    assert not left.value.code, printed.err
    document = json.loads(printed.out)
    document.pop("preset", None)
    said = rows(command)
    assert set(said) == set(document)
    for key, value in document.items():
        _, is_list, listed = said[key].partition("list of ")
        if is_list and nested(value):
            assert set(re.findall(r"`(\w+)`", listed)) == nested(value), key
