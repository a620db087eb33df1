"""Route graphs of Nav2's route server (GeoJSON)."""

from __future__ import annotations

import copy
import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import shapely

from energyplan.errors import MapError
from energyplan.io.documents import read_features
from energyplan.io.files import atomic_write
from energyplan.io.geojson import check_metres
from energyplan.records import NO_NUMBER

RouteGraph = Any
"""A `networkx.MultiDiGraph` whose edges are keyed by their id."""

LINES = frozenset({"LineString", "MultiLineString"})
"""Geometries of edges."""

_MAX_ID = 2**32
"""The route server keeps ids as unsigned 32-bit numbers."""


def read_route_graph(path: str | Path) -> RouteGraph:
    """Read a route graph."""
    file = Path(path)
    document, features = read_features(file)
    graph: RouteGraph = nx.MultiDiGraph(document=document)
    for k, feature in enumerate(features):
        if feature["geometry"].get("type") == "Point":
            place = f"{file}: feature {k}"
            node = _id(feature["properties"], "id", place)
            if node in graph:
                raise MapError(f"{place}: a second node with id {node}; give each its own")
            graph.add_node(node, pos=_position(feature["geometry"], place), feature=k)
    for k, feature in enumerate(features):
        if str(feature["geometry"].get("type")) in LINES:
            place = f"{file}: feature {k}"
            properties = feature["properties"]
            edge = _id(properties, "id", place)
            ends = [_id(properties, key, place) for key in ("startid", "endid")]
            for key, node in zip(("startid", "endid"), ends, strict=True):
                if node not in graph:
                    raise MapError(f"{place}: {key}: there is no node {node}")
            # ids that stand twice are common and harmless as long as they join other nodes
            if graph.has_edge(*ends, key=edge):
                raise MapError(f"{place}: a second edge with id {edge}; give each its own")
            known = {"cost": _cost(properties, place)} if "cost" in properties else {}
            graph.add_edge(*ends, key=edge, feature=k, **known)
    if graph.number_of_nodes() == 0 or graph.number_of_edges() == 0:
        raise MapError(f"{file}: no nodes or no edges; is it a route graph?")
    check_metres(file, [shapely.Point(at) for at in nx.get_node_attributes(graph, "pos").values()])
    return graph


def _id(properties: dict[str, Any], key: str, place: str) -> int:
    value = properties.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _MAX_ID:
        raise MapError(f"{place}: {key} is {str(value)[:60]!r}; give a whole number >= 0")
    return value


def _position(geometry: dict[str, Any], place: str) -> tuple[float, float]:
    try:
        x, y = (float(v) for v in geometry["coordinates"][:2])
    except (*NO_NUMBER, KeyError):
        raise MapError(f"{place}: malformed coordinates; give [x, y] in metres") from None
    if not (np.isfinite(x) and np.isfinite(y)):
        raise MapError(f"{place}: coordinates are not finite")
    return x, y


def _cost(properties: dict[str, Any], place: str) -> float:
    value = properties["cost"]
    try:
        cost = float("nan") if isinstance(value, (bool, str)) else float(value)
    except (TypeError, OverflowError):
        cost = float("nan")
    if not (np.isfinite(cost) and cost >= 0):
        raise MapError(f"{place}: cost is {str(value)[:60]!r}; give a number >= 0")
    return cost


def write_route_graph(graph: RouteGraph, path: str | Path) -> None:
    """Write a route graph with the edges' ``cost``, for Nav2's route server to plan with.

    Each edge that carries a ``cost`` (see `energyplan.planning.graphs.price_edges` and
    `energyplan.planning.graphs.plan_edges`) is written with it and with ``overridable:
    false``, without which the route server would replace it by the scores of its plug-ins. Edges
    that were read and are no longer in the graph are left out. Everything else that was read is
    written back as it was.
    """
    document = graph.graph.get("document")
    read = document is not None
    document = copy.deepcopy(document) if read else _document(graph)
    for (source, target, number), (_, _, data) in zip(
        _numbered(graph), graph.edges(data=True), strict=True
    ):
        if "cost" not in data:
            continue
        cost = float(data["cost"])
        if not (np.isfinite(cost) and cost > 0):
            raise MapError(
                f"the edge {number} from {source!r} to {target!r} costs {cost}; the route server "
                "takes positive costs alone"
            )
        properties = document["features"][data.get("feature", len(graph) + number)]["properties"]
        properties["cost"] = cost
        properties["overridable"] = False
    if read:
        kept = {data.get("feature") for _, _, data in graph.edges(data=True)}
        document["features"] = [
            feature
            for k, feature in enumerate(document["features"])
            if k in kept or feature["geometry"].get("type") not in LINES
        ]
    atomic_write(Path(path), json.dumps(document, indent=1) + "\n")


def _numbered(graph: RouteGraph) -> list[tuple[Hashable, Hashable, int]]:
    """Return source, target and number of each edge."""
    return [(source, target, k) for k, (source, target) in enumerate(graph.edges())]


def _document(graph: RouteGraph) -> dict[str, Any]:
    """Return the GeoJSON of a graph that was not read from a file."""
    if not graph.is_directed():
        raise MapError("a route graph is directed; convert the graph with .to_directed()")
    place: dict[Hashable, tuple[float, float]] = {}
    features: list[dict[str, Any]] = []
    for node, data in graph.nodes(data=True):
        if isinstance(node, bool) or not isinstance(node, int) or not 0 <= node < _MAX_ID:
            raise MapError(f"node {node!r} is no whole number >= 0; relabel the graph")
        place[node] = _position({"coordinates": data.get("pos")}, f"node {node}")
        features.append(_feature("Point", list(place[node]), {"id": node, "frame": "map"}))
    for source, target, number in _numbered(graph):
        line = [list(place[source]), list(place[target])]
        properties = {"id": number, "startid": source, "endid": target}
        features.append(_feature("MultiLineString", [line], properties))
    return {"type": "FeatureCollection", "name": "graph", "features": features}


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
