"""Edges of a graph planned among obstacles, and routes with the turns at its places."""

from __future__ import annotations

import json

import networkx as nx
import numpy as np
import pytest

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError
from energyplan.export.graph import read_route_graph, write_route_graph
from energyplan.planning import PlanningProblem
from energyplan.planning.roadmap import price_edges
from energyplan.planning.roadmap.planned import plan_edges
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def problem(*boxes: tuple[int, int, int, int]) -> PlanningProblem:
    """Return a hall of 10 m by 8 m with boxes of cells."""
    occupied = np.zeros((160, 200), bool)
    for row, column, height, width in boxes:
        occupied[row : row + height, column : column + width] = True
    return PlanningProblem(OccupancyGrid(occupied, 0.05), COST, (1, 1, 0), (1, 1, 0))


def square(kind=nx.DiGraph) -> nx.Graph:
    graph = kind()
    for node, place in enumerate([(2, 2), (8, 2), (8, 6), (2, 6)]):
        graph.add_node(node, pos=place)
    graph.add_edges_from([(0, 1), (1, 2), (2, 3), (3, 0), (0, 3)])
    return graph


def test_free_edges_are_straight_and_pay_for_turns():
    found = plan_edges(square(), problem())
    assert found.closed == ()
    straight = price_edges(square(), COST)
    spin = float(COST.segment_energy(0.0, np.pi / 2))
    for source, target, data in found.graph.edges(data=True):
        expected = straight.edges[source, target]["cost"]
        # from place 3 the way leads on to 0 or back, from 2 on to 3 alone, and so on
        assert data["cost"] == pytest.approx(expected + (spin if (source, target) != (0, 3) else 0))


def test_a_route_pays_for_each_turn():
    found = plan_edges(square(), problem())
    path = found.route(0, 2)
    spin = float(COST.segment_energy(0.0, np.pi / 2))
    assert COST.energy(path) == pytest.approx(10 * 226.0 + spin)
    assert np.allclose(path.end[:2], (8, 6))


@pytest.mark.parametrize("kind", [nx.DiGraph, nx.MultiDiGraph, nx.Graph])
def test_an_obstacle_on_an_edge_is_driven_around(kind):
    asked = problem((30, 90, 20, 20))
    found = plan_edges(square(kind), asked)
    assert found.closed == ()
    state = next(s for s in found.paths if {s.source, s.target} == {0, 1})
    path = found.paths[state]
    assert asked.map.path_free(path, COST.vehicle)
    assert found.energies[state] == pytest.approx(COST.energy(path))
    assert found.energies[state] > 6 * 226.0 * 1.02
    assert found.energies[state] >= steering.energy(path.start, path.end, COST) * (1 - 1e-9)
    route = found.route(0, 2)
    assert asked.map.path_free(route, COST.vehicle)


def test_closed_edges_are_told_and_left_out(tmp_path):
    walled = problem((0, 100, 160, 4))
    found = plan_edges(square(), walled)
    assert {(edge.source, edge.target) for edge in found.closed} == {(0, 1), (2, 3)}
    assert "certainly" in found.closed[0].reason
    assert not found.graph.has_edge(0, 1)
    with pytest.raises(NoPathError, match="2 edges are closed"):
        found.route(0, 2)
    with pytest.raises(InvalidInputError):
        found.route(0, 7)
    # and of a file that was read
    write_route_graph(square(), tmp_path / "read.geojson")
    graph = read_route_graph(tmp_path / "read.geojson")
    write_route_graph(plan_edges(graph, walled).graph, tmp_path / "planned.geojson")
    again = read_route_graph(tmp_path / "planned.geojson")
    assert sorted(again.edges()) == [(0, 3), (1, 2), (3, 0)]
    told = json.loads((tmp_path / "planned.geojson").read_text())
    edges = [f["properties"] for f in told["features"] if "startid" in f["properties"]]
    assert all(edge["cost"] > 0 and edge["overridable"] is False for edge in edges)
    assert sum("startid" not in f["properties"] for f in told["features"]) == 4


def test_a_place_in_an_obstacle_closes_its_edges():
    found = plan_edges(square(), problem((110, 30, 20, 20)))
    assert {(edge.source, edge.target) for edge in found.closed} == {(2, 3), (3, 0), (0, 3)}
    assert all("touches an obstacle" in edge.reason for edge in found.closed)
