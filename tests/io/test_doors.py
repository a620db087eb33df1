"""The same question by command, HTTP, Python and ROS 2: one answer, one refusal, word by word."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import commands
import numpy as np
import pytest
import yaml

import energyplan as ep
from energyplan import ros
from energyplan.errors import EnergyPlanError, NoPathError
from energyplan.io.config import read_model
from energyplan.io.maps import write_map
from energyplan.io.mission import read_battery, read_mission
from energyplan.io.sites import SiteFile, load_site, models_of, problem_from, with_presets
from energyplan.output import documents
from energyplan.reach import UsableCharge

pytest.importorskip("fastapi", reason="the service needs the extra serve")
from fastapi.testclient import TestClient

from energyplan.serve import create_app

MARBLE = "quadriga:full:marble"
PLAN: dict[str, Any] = {"map": "room.yaml", "model": MARBLE, "start": [1, 1, 0], "goal": [4, 1, 0]}
SPENT = {"effort": 300, "time_limit": 60}
RANGE = {"map": "room.yaml", "model": MARBLE, "start": [1, 1, 0]}
MISSION: dict[str, Any] = {
    "model": MARBLE, "map": "room.yaml", "battery": "24 V 20 Ah lead-acid", "start": [1, 1, 0],
    "planning_effort": 300, "coefficient_spread": 0.05,
    "tasks": [{"name": "look", "pose": [4, 1, 0], "dwell": "1 min", "power": "20 W"}],
}  # fmt: skip
WEIGHT = "no term of quadriga:full:marble depends on slope: the weight of 147.1 kg is added"
OTHER = "models of the surfaces are of another robot, husky_a200, whose footprint is not that"


class Said(NamedTuple):
    """What a door answered: its figures and what it said beside them, or why it refused."""

    figures: tuple[float, ...] = ()
    notes: frozenset[str] = frozenset()
    presets: tuple[str, ...] = ()
    refusal: str = ""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("doors")
    room = np.zeros((40, 60), bool)
    write_map(ep.OccupancyGrid(room, 0.1), place / "room.yaml")
    room[:, 25:28] = True
    write_map(ep.OccupancyGrid(room, 0.1), place / "mask.yaml")
    heights = "\n".join(" ".join(f"{0.02 * x:.2f}" for x in range(8)) for _ in range(6))
    header = "ncols 8\nnrows 6\nxllcorner -1\nyllcorner -1\ncellsize 1\n"
    (place / "hill.asc").write_text(header + heights + "\n")
    for name, at in (("hill", 0), ("far", 90)):
        area = [[[at, 0], [at + 6, 0], [at + 6, 4], [at, 4], [at, 0]]]
        feature = {"type": "Feature", "properties": {"model": "husky_a200:flooring"},
                   "geometry": {"type": "Polygon", "coordinates": area}}  # fmt: skip
        collection = {"type": "FeatureCollection", "features": [feature]}
        (place / f"{name}.geojson").write_text(json.dumps(collection))
    for name, parts in (
        ("slope", {"heights": "hill.asc"}),
        ("both", {"heights": "hill.asc", "surfaces": "hill.geojson"}),
        ("broken", {"heights": "none.asc"}),
        ("costly", {"costmap": "mask.yaml"}),
    ):
        (place / f"{name}.yaml").write_text(yaml.safe_dump({"map": "room.yaml", **parts}))
    (place / "wrong.yaml").write_text("terms: [{name: slip_friction, value: much}]\n")
    return place


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[TestClient]:
    with TestClient(create_app(folder), "http://localhost") as made:
        yield made


def said(document: dict[str, Any], *notes: str) -> Said:
    """Return what an answer says, with what was said beside it."""
    keys = ("energy", "lower_bound", "area", "soc_end", "energy_upper")
    beside = {*notes, *document.get("notes", ()), *document.get("warnings", ())}
    return Said(
        tuple(float(document[key]) for key in keys if key in document),
        frozenset(beside),
        tuple(one["name"] for one in document.get("preset", ())),
        document.get("reason", ""),
    )


def by_command(capsys: pytest.CaptureFixture[str], *words: object) -> Said:
    left = commands.run(capsys, *words, "--json")
    lines = left.err.splitlines()
    if left.code:
        (line,) = lines
        line = line.removeprefix("energyplan: ").replace(f"{Path.cwd()}/", "")
        return Said(refusal=line)  # the service names no folder
    return said(left.json, *(one for one in lines if not one.startswith("preset ")))


def by_http(client: TestClient, path: str, body: dict[str, Any]) -> Said:
    answer = client.post(f"/api/{path}", json=body)
    told = answer.json()
    return said(told) if answer.status_code == 200 else Said(refusal=told["detail"])


def by_python(work: Callable[[], tuple[dict[str, Any], tuple[str, ...]]]) -> Said:
    try:
        document, notes = work()
    except NoPathError as error:
        return said(documents.no_path(error))
    except EnergyPlanError as error:
        return Said(refusal=" ".join(str(error).split()).replace(f"{Path.cwd()}/", ""))
    return said(document, *notes)


def test_what_is_known_of_each_of_several_robots_is_in_the_answer(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    robots = [{"name": name, "model": model} for name, model in
              (("a", MARBLE), ("b", "jackal:flooring"), ("c", "husky_a200:flooring"))]  # fmt: skip
    Path("fleet.yaml").write_text(
        yaml.safe_dump({**MISSION, "surfaces": "hill.geojson", "robots": robots})
    )
    warnings = ep.evaluate(read_mission("fleet.yaml")).warnings
    models = [one.rpartition("the model's ")[2] for one in warnings if OTHER in one]
    assert models == ["quadriga:full", "jackal"]  # the surfaces are a Husky's


def options(asked: dict[str, Any]) -> list[str]:
    """Return a request as the options of a command."""
    words = []
    for key, value in asked.items():
        poses = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        words += [f"--{key.replace('_', '-')}", poses]
    return words


def problem_of(asked: dict[str, Any], **more: Any) -> tuple[Any, tuple[str, ...]]:
    """Return the problem of a request in Python, and what is said beside it."""
    names = {k: v for k, v in asked.items() if k in SiteFile.model_fields}
    site = load_site(SiteFile(**names), lambda key, name, read: read(Path(name)))
    ends = tuple(ep.path.as_pose(asked[key], key) for key in ("start", "goal") if key in asked)
    return problem_from(
        site, read_model(asked["model"]), (ends[0], ends[-1]), **more,
        **{key: asked[key] for key in ("costmap_weight", "objective") if key in asked},
    )  # fmt: skip


def plan(asked: dict[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    problem, notes = problem_of({k: v for k, v in asked.items() if k not in SPENT})
    return with_presets(documents.plan(ep.plan(problem, **SPENT)), models_of(problem)), notes


def reach(asked: dict[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    problem, notes = problem_of(asked, battery="battery" in asked)
    reserve = asked.get("reserve", 0.0)
    usable: float | UsableCharge = (1.0 - reserve) * asked.get("energy", 0.0)
    if "battery" in asked:
        battery = read_battery(asked["battery"])
        usable = UsableCharge(problem.cost, battery, asked.get("soc", 1.0), reserve)
        notes += battery.notes
    found = ep.energy_map(problem, energy=usable)
    document = documents.energy_map(found, found.areas(usable))
    return with_presets(document, models_of(problem)), notes


def assert_alike(one: Said, other: Said) -> None:
    assert one.figures == pytest.approx(other.figures, rel=1e-12)
    assert one[1:] == other[1:]


@pytest.mark.parametrize(
    ("command", "change", "words"),
    [
        ("plan", {}, ""),
        ("plan", {"map": "slope.yaml"}, WEIGHT),
        ("plan", {"map": "both.yaml"}, OTHER),
        ("plan", {"surfaces": "hill.geojson"}, OTHER),
        ("plan", {"surfaces": "far.geojson"}, "none of the surfaces lies on the map"),
        ("plan", {"keepout": "mask.yaml"}, "no path leads from"),
        ("plan", {"clearance": 0.3}, ""),
        ("plan", {"map": "costly.yaml"}, "the costmap of the site does not count"),
        ("plan", {"map": "broken.yaml"}, "broken.yaml, line 1, heights: "),
        ("plan", {"model": "quadriga:full:lava"}, "lava"),
        ("plan", {"model": "wrong.yaml"}, "wrong.yaml, line 1"),
        ("plan", {"start": [-5, 1, 0]}, "outside the map"),
        ("range", {"energy": 400.0}, ""),
        ("range", {"battery": "24 V 20 Ah lead-acid", "soc": 0.21, "reserve": 0.209}, "resistance"),
        ("range", {"battery": "quadriga", "soc": 0.3, "reserve": 0.299, "map": "slope.yaml"},
         WEIGHT),
        ("range", {"battery": "24 V of hope"}, "24 V of hope"),
    ],
)  # fmt: skip
def test_an_answer_is_the_same_by_every_door(
    command: str, change: dict[str, Any], words: str, folder: Path, client: TestClient,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    asked = {**(PLAN | SPENT if command == "plan" else RANGE), **change}
    pack = {"pack" if key == "battery" else key: value for key, value in asked.items()}
    told = by_command(capsys, command, *options(asked))
    assert_alike(by_http(client, command, pack), told)
    own = by_python(lambda: (plan if command == "plan" else reach)(asked))
    assert_alike(own._replace(presets=told.presets) if own.refusal else own, told)
    assert words in " ".join((*told.notes, told.refusal))
    assert told.refusal or told.presets


def test_an_objective_that_there_is_not_is_refused_by_every_door(
    folder: Path, client: TestClient,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The service has a list of what may stand there."""
    monkeypatch.chdir(folder)
    asked = {**PLAN, "objective": "money"}
    assert "money" in by_command(capsys, "plan", *options(asked)).refusal
    assert "'energy', 'length' or 'time'" in by_http(client, "plan", asked).refusal


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "typical of its chemistry"),
        ({"map": "slope.yaml"}, WEIGHT),
        ({"surfaces": "hill.geojson"}, OTHER),
        ({"surfaces": "hill.geojson", "tasks": [{"name": "look", "pose": [4, 1]}]}, OTHER),
        ({"keepout": "mask.yaml"}, ""),
        ({"model": "quadriga:full:lava"}, "lava"),
        ({"map": "broken.yaml"}, "broken.yaml, line 1, heights: "),
    ],
)
def test_a_mission_is_the_same_by_every_door(
    change: dict[str, Any], words: str, folder: Path, client: TestClient,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    asked = {**MISSION, **change}
    file = Path("mission.yaml")
    text = yaml.safe_dump(asked)
    file.write_text(text)

    def python() -> tuple[dict[str, Any], tuple[str, ...]]:
        mission = read_mission(file)
        return with_presets(documents.mission(ep.evaluate(mission)), models_of(mission)), ()

    answer = json.loads(ros.mission_answer(text, "."))
    refused = answer.get("error", "").replace(f"{folder}/", "")
    node = Said(refusal=refused) if refused else said(answer)
    own = by_python(python)
    doors = [
        node, by_http(client, "mission", {"mission": "mission.yaml"}),
        by_command(capsys, "mission", file),
    ]  # fmt: skip
    changed = by_http(client, "mission", {"mission": "mission.yaml", "document": asked})
    if own.refusal:  # what is no file has no name and no line
        lines = own.refusal.partition(": ")[2]
        assert changed.refusal.endswith(lines) and words in own.refusal
        doors = [one._replace(refusal=one.refusal.partition(": ")[2]) for one in doors]
        assert {one.refusal for one in doors} == {lines}
        return
    for door in (*doors, changed):
        assert_alike(door, own)
    assert words in " ".join(own.notes) and MARBLE in own.presets
