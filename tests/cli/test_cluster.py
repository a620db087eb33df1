"""Many files on a cluster of two worker processes: nothing is lost, and nothing comes twice."""

from __future__ import annotations

import json
import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
import yaml

import energyplan as ep
from energyplan.export.graph import read_route_graph
from energyplan.io.many import answers, cluster
from energyplan.io.maps import write_map
from energyplan.io.mission import read_mission
from energyplan.io.tables import write_log
from energyplan.output import documents
from energyplan.planning.graphs import price_edges

distributed = pytest.importorskip("distributed", reason="a cluster needs the extra cluster")

MARBLE = "quadriga:full:marble"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as made:
        yield made.scheduler_address


@pytest.fixture
def missions(tmp_path: Path) -> list[Path]:
    write_map(ep.OccupancyGrid(np.zeros((30, 60), bool), 0.1), tmp_path / "room.yaml")
    for k in range(6):
        (tmp_path / f"m{k}.yaml").write_text(yaml.safe_dump({
            "model": MARBLE, "map": "room.yaml", "battery": "24 V 20 Ah lead-acid",
            "start": [1, 1, 0], "planning_effort": 100, "coefficient_spread": 0.05,
            "tasks": [{"name": "look", "pose": [2 + 0.5 * k, 1, 0], "dwell": "1 min"}],
        }))  # fmt: skip
    return sorted(tmp_path.glob("m*.yaml"))


def evaluated(file: Path) -> dict[str, Any]:
    """Evaluate a mission; the worker dies of one file, the first time."""
    if file.name == "m2.yaml" and not (died := file.with_suffix(".died")).exists():
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    with file.with_suffix(".begun").open("a") as stream:
        stream.write("x")
    return documents.mission(ep.evaluate(read_mission(file)))


def test_a_worker_that_is_killed_loses_nothing(address: str, missions: list[Path]) -> None:
    results = missions[0].with_name("results.jsonl")
    with cluster(address, insecure=True) as executor:
        lines = [*answers(evaluated, missions, executor, results)]
    assert (missions[2].with_suffix(".died")).exists()
    assert Counter(line["file"] for line in lines) == Counter(map(str, missions))
    assert [json.loads(line) for line in results.read_text().splitlines()] == lines
    for line in lines:
        alone = documents.mission(ep.evaluate(read_mission(line["file"])))
        assert {key: line[key] for key in alone} == alone


def test_a_run_goes_on_where_the_last_one_ended(
    address: str, missions: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    bad, results = missions[1], missions[0].with_name("results.jsonl")
    whole = bad.read_text()
    bad.write_text(whole.replace("pose", "place"))
    words = "mission", *missions, "--cluster", address, "--insecure-cluster", "--results", results
    first = commands.run(capsys, *words)
    lines = {Path(one["file"]).name: one for one in map(json.loads, first.out.splitlines())}
    assert first.code == 1 and "1 of 6 missions failed" in first.err
    assert len(lines) == 6 and [name for name in lines if "error" in lines[name]] == ["m1.yaml"]
    assert "m1.yaml, line 13" in lines["m1.yaml"]["error"]
    alone = commands.run(capsys, "mission", missions[0], "--json").json
    assert {key: lines["m0.yaml"][key] for key in alone} == alone

    bad.write_text(whole)  # mended; another is changed; the last line is cut off
    missions[3].write_text(missions[3].read_text().replace("1 min", "2 min"))
    last = results.read_text().splitlines()[-1]
    results.write_text(results.read_text()[:-9])
    cut = Path(json.loads(last)["file"]).name
    again = commands.run(capsys, *words)
    told = [Path(json.loads(line)["file"]).name for line in again.out.splitlines()]
    assert again.code == 0 and sorted(told) == sorted({"m1.yaml", "m3.yaml", cut})
    kept = [json.loads(line) for line in results.read_text().splitlines()]
    assert Counter(line["file"] for line in kept) == Counter(map(str, missions))
    assert not any("error" in line for line in kept)
    assert commands.run(capsys, *words).out == ""
    other = commands.run(capsys, *words, "--effort", 200)
    assert len(other.out.splitlines()) == 6  # another question has other answers


def test_logs_and_route_graphs_are_answered_by_the_same_function(
    address: str, tmp_path: Path
) -> None:
    model = ep.PowerModel.preset(MARBLE)
    points = [
        {"type": "Feature", "properties": {"id": k},
         "geometry": {"type": "Point", "coordinates": [3.0 * k, 0.0]}}
        for k in (0, 1)
    ]  # fmt: skip
    edge = {"type": "Feature", "properties": {"id": 9, "startid": 0, "endid": 1},
            "geometry": {"type": "MultiLineString", "coordinates": []}}  # fmt: skip
    graph = tmp_path / "graph.geojson"
    graph.write_text(json.dumps({"type": "FeatureCollection", "features": [*points, edge]}))
    write_log(ep.simulate.identification_drive(model), tmp_path / "log.csv")

    def answered(file: Path) -> dict[str, Any]:
        if file == graph:
            edges = price_edges(read_route_graph(file), ep.EnergyCost(model)).edges(data="cost")
            return {"edges": [[*edge] for edge in edges]}
        return documents.identification(ep.identify(ep.DriveLog.read(file), model.vehicle))

    files = [graph, tmp_path / "log.csv"]
    with cluster(address, insecure=True) as executor:
        found = {line["file"]: line for line in answers(answered, files, executor)}
    for file in files:
        alone = answered(file)
        assert {key: found[str(file)][key] for key in alone} == alone


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("--cluster", "tcp://127.0.0.1:9", "--insecure-cluster"),
            "no cluster answers at 'tcp://127.0.0.1:9'",
        ),
        (("--results", "r.jsonl"), "need --cluster"),
        (("--cluster", "local", "--report", "r.html"), "--report"),
        (("--cluster", "local", "--results", "r.txt"), "must end with .jsonl"),
        (
            ("--cluster", "ADDRESS", "--insecure-cluster", "--results", "other.jsonl"),
            "other.jsonl, line 1 is no answer",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    words: tuple[str, ...], told: str, address: str, missions: list[Path],
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(missions[0].parent)
    Path("other.jsonl").write_text('{"name": "x"}\n')
    given = [address if word == "ADDRESS" else word for word in words]
    left = commands.run(capsys, "mission", missions[0], *given)
    assert left.code == 2 and told in left.err and left.err.count("\n") == 1
    assert Path("other.jsonl").read_text() == '{"name": "x"}\n'
