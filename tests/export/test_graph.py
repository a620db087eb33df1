"""Route graphs of Nav2: read, priced, written back."""

from __future__ import annotations

import json

import networkx as nx
import pytest
import shapely
from worlds import COST

from energyplan import PowerModel, SurfaceMap, steering
from energyplan.errors import MapError
from energyplan.export.graph import read_route_graph, write_route_graph
from energyplan.planning.graphs import Roadmap, price_edges
from energyplan.terrain import Surface


def node(number, x, y, **more):
    return {
        "type": "Feature",
        "properties": {"id": number, **more},
        "geometry": {"type": "Point", "coordinates": [x, y]},
    }


def edge(number, start, end, **more):
    return {
        "type": "Feature",
        "properties": {"id": number, "startid": start, "endid": end, **more},
        "geometry": {"type": "MultiLineString", "coordinates": [[[0, 0], [1, 1]]]},
    }


GOOD = [
    node(3, 0, 0, frame="map"),
    node(4, 3, 4),
    edge(10, 3, 4, metadata={"speed_limit": 0.5}),
    edge(11, 4, 3, cost=7.0),
    edge(12, 3, 4),
]


def write(file, features):
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features, "name": "g"}))
    return file


def test_nodes_and_edges(tmp_path):
    graph = read_route_graph(write(tmp_path / "g.geojson", GOOD))
    assert dict(graph.nodes(data="pos")) == {3: (0.0, 0.0), 4: (3.0, 4.0)}
    assert sorted(graph.edges(keys=True)) == [(3, 4, 10), (3, 4, 12), (4, 3, 11)]
    assert graph.edges[4, 3, 11]["cost"] == 7.0


def test_energies_are_written_as_costs_that_stay(tmp_path):
    graph = read_route_graph(write(tmp_path / "g.geojson", GOOD))
    write_route_graph(price_edges(graph, COST), tmp_path / "priced.geojson")
    document = json.loads((tmp_path / "priced.geojson").read_text())
    assert document["name"] == "g"
    for feature, original in zip(document["features"], GOOD, strict=True):
        assert feature["geometry"] == original["geometry"]
        if "startid" in original["properties"]:
            # 5 m at twice 113 N
            assert feature["properties"].pop("cost") == pytest.approx(1130.0)
            assert feature["properties"].pop("overridable") is False
        rest = {k: v for k, v in original["properties"].items() if k != "cost"}
        assert feature["properties"] == rest
    again = read_route_graph(tmp_path / "priced.geojson")
    assert again.edges[3, 4, 10]["cost"] == pytest.approx(1130.0)


def test_a_graph_of_ones_own(tmp_path):
    graph = nx.DiGraph([(0, 1), (1, 2), (2, 0)])
    nx.set_node_attributes(graph, {0: (0, 0), 1: (1, 0), 2: (1, 1)}, "pos")
    write_route_graph(price_edges(graph, COST), tmp_path / "g.geojson")
    back = read_route_graph(tmp_path / "g.geojson")
    assert dict(back.nodes(data="pos")) == {0: (0, 0), 1: (1, 0), 2: (1, 1)}
    assert back.edges[1, 2, 1]["cost"] == pytest.approx(226.0)


def test_the_route_server_then_prefers_the_ground_that_saves_energy(tmp_path):
    """Two ways of one length; a planner that adds up the written costs takes the marble one."""
    corners = {0: (0, 0), 1: (5, 3), 2: (5, -3), 3: (10, 0)}
    features = [node(k, *place) for k, place in corners.items()]
    features += [edge(10 + k, *ends) for k, ends in enumerate([(0, 1), (1, 3), (0, 2), (2, 3)])]
    graph = read_route_graph(write(tmp_path / "g.geojson", features))
    marble = PowerModel.preset("quadriga:empty:marble")
    for area, best in ((shapely.box(0, 0, 10, 5), 1), (shapely.box(0, -5, 10, 0), 2)):
        ground = SurfaceMap([Surface(area, marble)])
        write_route_graph(price_edges(graph, COST, ground), tmp_path / "h.geojson")
        priced = read_route_graph(tmp_path / "h.geojson")
        assert nx.dijkstra_path(priced, 0, 3, weight="cost") == [0, best, 3]
        assert Roadmap(graph, COST, ground).route(0, 3).nodes == (0, best, 3)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["aws_graph", "sample_graph", "turtlebot4_graph"])
def test_nav2_graphs(shared_data, tmp_path, name):
    """All that Nav2 wrote is kept, and its Dijkstra then minimises the energy of driving."""
    file = shared_data / "route_graphs" / f"{name}.geojson"
    graph = read_route_graph(file)
    before = json.loads(file.read_text())["features"]
    write_route_graph(price_edges(graph, COST), tmp_path / "g.geojson")
    after = json.loads((tmp_path / "g.geojson").read_text())["features"]
    assert len(before) == len(after)
    for old, new in zip(before, after, strict=True):
        for key in ("cost", "overridable"):
            old["properties"].pop(key, None)
            new["properties"].pop(key, None)
        assert old == new
    priced = read_route_graph(tmp_path / "g.geojson")
    nodes = sorted(priced)
    source, target = nodes[0], nodes[-1]
    shortest = nx.dijkstra_path_length(priced, source, target, weight="cost")
    # the route that pays for turns, too, costs no less than the sum of the edges
    route = Roadmap(graph, COST).route(source, target)
    assert route.energy >= shortest * (1 - 1e-9)
    assert (route.nodes[0], route.nodes[-1]) == (source, target)
    # nor less than the exact motion where nothing is in the way
    for target in nodes[1::5]:
        route = Roadmap(graph, COST).route(source, target, start_yaw=0.3, goal_yaw=1.0)
        least = float(steering.energy(route.path.start, route.path.end, COST))
        assert route.energy >= least * (1 - 1e-9)


@pytest.mark.parametrize(
    ("features", "place"),
    [
        ([], "no nodes"),
        ([node(0, 0, 0)], "no edges"),
        ([node(0, 0, 0), node(0, 1, 1), edge(1, 0, 0)], "feature 1: a second node"),
        ([node(0, 0, 0), edge(1, 0, 5)], "feature 1: endid: there is no node 5"),
        ([*GOOD, edge(10, 3, 4)], "feature 5: a second edge"),
        ([node("a", 0, 0)], "feature 0: id"),
        ([node(-1, 0, 0)], "feature 0: id"),
        ([node(True, 0, 0)], "feature 0: id"),
        ([node(0, "x", 0)], "feature 0: malformed coordinates"),
        ([node(0, 10**400, 0)], "feature 0"),
        ([node(0, 0, 0), edge(1, 0, 0, cost="dear")], "feature 1: cost"),
        ([node(0, 0, 0), edge(1, 0, 0, cost=-1)], "feature 1: cost"),
    ],
)
def test_malformed_graphs_name_the_place(tmp_path, features, place):
    with pytest.raises(MapError, match=place):
        read_route_graph(write(tmp_path / "g.geojson", features))


def test_a_cost_of_zero_is_not_written(tmp_path):
    graph = read_route_graph(write(tmp_path / "g.geojson", GOOD))
    graph.edges[3, 4, 10]["cost"] = 0.0
    with pytest.raises(MapError, match="positive"):
        write_route_graph(graph, tmp_path / "h.geojson")
    assert not (tmp_path / "h.geojson").exists()


def test_a_graph_in_degrees_is_refused_by_what_it_is(tmp_path):
    graph = nx.MultiDiGraph()
    graph.add_nodes_from([(0, {"pos": (8.5, 47.1)}), (1, {"pos": (8.501, 47.102)})])
    graph.add_edge(0, 1, key=2)
    write_route_graph(graph, tmp_path / "g.geojson")
    with pytest.raises(MapError, match="degrees of longitude and latitude"):
        read_route_graph(tmp_path / "g.geojson")
