"""Files that ask for too much are refused before it is spent."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from energyplan.errors import InvalidInputError, MapError
from energyplan.export.graph import read_route_graph
from energyplan.io.documents import MAX_NODES, parse
from energyplan.logs import tables
from energyplan.logs.tables import MAX_LINE, read_table
from energyplan.mission import Charger
from energyplan.vehicle import Vehicle


def unpacked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return how many bytes are unpacked at a time from now on."""
    found, read = list[int](), gzip.GzipFile.read

    def counted(self: gzip.GzipFile, size: int | None = -1) -> bytes:
        part = read(self, size)
        found.append(len(part))
        return part

    monkeypatch.setattr(gzip.GzipFile, "read", counted)
    return found


def test_a_document_of_too_many_values_is_refused_before_it_is_composed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    composed = 0
    node = yaml.SequenceNode.__init__

    def counted(self: yaml.SequenceNode, *args: object, **more: object) -> None:
        nonlocal composed
        composed += 1
        node(self, *args, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(yaml.SequenceNode, "__init__", counted)
    with pytest.raises(InvalidInputError, match="too many values"):
        parse("image: [" + "[]," * (3 * MAX_NODES) + "[]]", "bomb.yaml", InvalidInputError)
    assert composed <= MAX_NODES


def test_a_long_line_is_refused_while_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "log.csv.gz"
    file.write_bytes(gzip.compress(b"t,x\n" + b"0" * (40 * MAX_LINE)))
    read = unpacked(monkeypatch)
    with pytest.raises(InvalidInputError, match="line longer than"):
        read_table(file, InvalidInputError)
    assert sum(read) <= 4 * MAX_LINE


@pytest.mark.parametrize("value", [2**64, -(10**30), 10**400])
def test_whole_numbers_beyond_64_bits_are_refused_by_name(value: int) -> None:
    with pytest.raises(InvalidInputError, match="mass"):
        replace(Vehicle.preset("quadriga:full"), mass=value)
    with pytest.raises(InvalidInputError, match="places"):
        Charger(name="c", pose=(0.0, 0.0, 0.0), power=100.0, places=value)


def test_a_geometry_whose_type_is_no_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "g.geojson"
    file.write_text(
        '{"type": "FeatureCollection", "features": [{"geometry": {"type": []}, "properties": {}}]}'
    )
    with pytest.raises(MapError, match="no nodes"):
        read_route_graph(file)


@pytest.mark.parametrize(
    ("text", "events"),
    [
        ("image: [" + "[]," * 300_000 + "[]]", 3 * MAX_NODES),
        ("? [" + "[]," * 300_000 + "[]]\n: 1", 3 * MAX_NODES),
        ("{" + ",".join(f"k{k}" for k in range(120_000)) + "}", 3 * MAX_NODES),
        ("[" * 900_000, 100),
        ("- " * 500_000, 100),
        ("{a: " * 250_000, 100),
        ("".join(f"%TAG !a{k}! tag:\n" for k in range(45_000)) + "--- {a: 1}", 0),
    ],
)
def test_hostile_yaml_is_refused_by_its_events_before_a_node_is_built(
    text: str, events: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, whole = 0, yaml.parse

    def counted(*args: object, **more: object) -> Iterator[object]:
        nonlocal seen
        for event in whole(*args, **more):  # type: ignore[arg-type]
            seen += 1
            yield event

    def composed(*args: object, **more: object) -> None:
        raise AssertionError("a node was built")

    monkeypatch.setattr(yaml, "parse", counted)
    monkeypatch.setattr(yaml.Node, "__init__", composed)
    for kind in (yaml.ScalarNode, yaml.SequenceNode, yaml.MappingNode):
        monkeypatch.setattr(kind, "__init__", composed)
    with pytest.raises(InvalidInputError, match="too many"):
        parse(text[: 1 << 20], "bomb.yaml", InvalidInputError)
    assert seen <= events


@pytest.mark.parametrize("content", [b"t,x\n" + b"1,2\n" * 2**18, b"t,x\n" + bytes(2**20)])
def test_a_table_is_unpacked_up_to_a_size(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "log.csv.gz"
    file.write_bytes(gzip.compress(content * 8))
    read = unpacked(monkeypatch)
    with (
        tables.unpacked_at_most(2**20),
        pytest.raises(InvalidInputError, match="holds more than 1 MiB"),
    ):
        read_table(file, InvalidInputError)
    assert sum(read) <= 2 * MAX_LINE


def test_a_table_of_many_cells_is_refused_before_they_are_read(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("t,x\n" + "1,2\n" * 51)
    with tables.unpacked_at_most(2**20, cells=102):
        assert len(read_table(file, InvalidInputError).columns["t"]) == 51
    with (
        tables.unpacked_at_most(2**20, cells=101),
        pytest.raises(InvalidInputError, match="more than 50 rows"),
    ):
        read_table(file, InvalidInputError)
