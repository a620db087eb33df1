"""Files of Nav2: primitives of SmacPlannerLattice (JSON) and route graphs (GeoJSON)."""

from __future__ import annotations

import copy
import json
from collections.abc import Hashable
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import networkx as nx
import numpy as np
import shapely
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from energyplan.errors import MapError
from energyplan.io.documents import read_bytes, read_features
from energyplan.io.files import atomic_write
from energyplan.io.geojson import check_metres
from energyplan.path import Path as Motion
from energyplan.path import Pose, wrap_angle
from energyplan.studies.control_set import ControlSet, Penalties, Primitive

MAX_FILE = 2**26
"""Largest file that is read [bytes]."""

DIGITS = 5
"""Digits of lengths [m] after the point."""

Length = Annotated[float, Field(ge=0)]


class _Metadata(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    motion_model: str = "diff"
    turning_radius: float = Field(gt=0)
    grid_resolution: float = Field(gt=0)
    num_of_headings: int = Field(ge=1, le=4096)
    heading_angles: list[float]
    number_of_trajectories: int = Field(ge=0)


class _Trajectory(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    trajectory_id: int
    start_angle_index: int = Field(ge=0)
    end_angle_index: int = Field(ge=0)
    left_turn: bool
    trajectory_radius: Length
    trajectory_length: Length
    arc_length: Length
    straight_length: Length
    poses: list[tuple[float, float, float]] = Field(min_length=1)


class _File(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    lattice_metadata: _Metadata
    primitives: list[_Trajectory] = Field(min_length=1)


def write_lattice(controls: ControlSet, path: str | Path, *, made: date | None = None) -> None:
    """Write a control set for SmacPlannerLattice (its parameter ``lattice_filepath``)."""
    document = {
        "version": 1.0,
        "date_generated": (date.today() if made is None else made).isoformat(),
        "lattice_metadata": {
            "motion_model": "diff",
            "turning_radius": controls.radius,
            "grid_resolution": controls.resolution,
            "stopping_threshold": 0,
            "num_of_headings": len(controls.headings),
            "heading_angles": list(controls.headings),
            "number_of_trajectories": len(controls.primitives),
        },
        "primitives": [
            _trajectory(k, primitive, controls) for k, primitive in enumerate(controls.primitives)
        ],
    }
    atomic_write(Path(path), json.dumps(document, indent=1) + "\n")


def _trajectory(number: int, primitive: Primitive, controls: ControlSet) -> dict[str, Any]:
    """Return a primitive as it stands in the file."""
    start = controls.headings[primitive.start]
    ds, turn = primitive.motions.T
    path = Motion(Pose(0.0, 0.0, start), ds, turn)
    fine = path.subdivide(controls.resolution, 0.2)
    poses = fine.vertices[1:] if primitive.length > 0 else fine.vertices
    poses[-1] = (
        primitive.column * controls.resolution,
        primitive.row * controls.resolution,
        controls.headings[primitive.end],
    )
    rounded = [
        [round(x, DIGITS) + 0.0, round(y, DIGITS) + 0.0, yaw % (2 * np.pi)]
        for x, y, yaw in poses.tolist()
    ]
    return {
        "trajectory_id": number,
        "start_angle_index": primitive.start,
        "end_angle_index": primitive.end,
        "left_turn": primitive.turn >= 0,
        "trajectory_radius": round(primitive.radius, DIGITS),
        "trajectory_length": round(primitive.length, DIGITS),
        "arc_length": round(primitive.arc, DIGITS),
        "straight_length": round(primitive.before + primitive.after, DIGITS),
        "poses": rounded,
    }


def read_lattice(path: str | Path) -> ControlSet:
    """Read a control set of SmacPlannerLattice."""
    file = Path(path)
    try:
        found = _File.model_validate_json(read_bytes(file, MAX_FILE))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise MapError(f"{file}: {place or 'the file'}: {first['msg']}") from None
    meta = found.lattice_metadata
    if meta.motion_model == "omni":
        raise MapError(
            f"{file}: lattice_metadata.motion_model: primitives of an omnidirectional robot, which "
            "drives sideways; give those of the model diff or ackermann"
        )
    if len(meta.heading_angles) != meta.num_of_headings:
        raise MapError(
            f"{file}: lattice_metadata.heading_angles: {len(meta.heading_angles)} angles where "
            f"num_of_headings is {meta.num_of_headings}"
        )
    if len(found.primitives) != meta.number_of_trajectories:
        raise MapError(
            f"{file}: lattice_metadata.number_of_trajectories: {meta.number_of_trajectories} where "
            f"there are {len(found.primitives)} primitives"
        )
    primitives = tuple(
        _primitive(primitive, meta, f"{file}: primitives.{k}")
        for k, primitive in enumerate(found.primitives)
    )
    return ControlSet(
        meta.grid_resolution, meta.turning_radius, tuple(meta.heading_angles), primitives
    )


def _primitive(primitive: _Trajectory, meta: _Metadata, place: str) -> Primitive:
    """Return a primitive of the file."""
    count = meta.num_of_headings
    if max(primitive.start_angle_index, primitive.end_angle_index) >= count:
        raise MapError(f"{place}: a heading beyond the {count} that there are")
    start, end = (
        meta.heading_angles[k] for k in (primitive.start_angle_index, primitive.end_angle_index)
    )
    turn = float(wrap_angle(end - start))
    x, y, _ = primitive.poses[-1]
    cells = np.array([x, y]) / meta.grid_resolution
    column, row = (int(v) for v in np.round(cells))
    if np.abs(cells - (column, row)).max() > 0.05:
        raise MapError(f"{place}: it ends at ({x}, {y}), in the middle of no cell")
    before, after = primitive.straight_length, 0.0
    if primitive.arc_length > 0 and primitive.straight_length > 0:
        before = _first_straight(primitive, (x, y), start, end, turn)
        after = primitive.straight_length - before
    found = Primitive(
        primitive.start_angle_index, primitive.end_angle_index, before, primitive.arc_length,
        after, turn, column, row,
    )  # fmt: skip
    ds, dtheta = found.motions.T
    reached = Motion(Pose(0.0, 0.0, start), ds, dtheta).end
    if np.hypot(reached.x - x, reached.y - y) > 0.05 * meta.grid_resolution:
        raise MapError(
            f"{place}: arc and straight pieces lead to ({reached.x:.3f}, {reached.y:.3f}), its "
            f"poses to ({x:.3f}, {y:.3f}); sideways motion is not taken"
        )
    return found


def _first_straight(
    primitive: _Trajectory, at: tuple[float, float], start: float, end: float, turn: float
) -> float:
    """Return how much of the straight length lies before the arc [m]."""
    # from the end of the first tangent: the whole is what leads ahead along both headings
    det = np.sin(end - start)
    x, y = at
    first = (x * np.sin(end) - y * np.cos(end)) / det
    then = (y * np.cos(start) - x * np.sin(start)) / det
    return primitive.straight_length if first > then else 0.0


def write_penalties(penalties: Penalties, path: str | Path, lattice: str | Path) -> None:
    """Write the penalties as parameters of SmacPlannerLattice (YAML)."""
    parameters = {
        "plugin": "nav2_smac_planner::SmacPlannerLattice",
        "lattice_filepath": str(lattice),
        "allow_reverse_expansion": True,
        "non_straight_penalty": round(penalties.non_straight, 4),
        "change_penalty": round(penalties.change, 4),
        "reverse_penalty": round(penalties.reverse, 4),
        "rotation_penalty": round(penalties.rotation, 4),
        "retrospective_penalty": 0.0,
    }
    atomic_write(Path(path), yaml.safe_dump({"GridBased": parameters}, sort_keys=False))


RouteGraph = Any
"""A `networkx.MultiDiGraph` whose edges are keyed by their id."""

LINES = frozenset({"LineString", "MultiLineString"})
"""Geometries of edges."""

_MAX_ID = 2**32
"""The route server keeps ids as unsigned 32-bit numbers."""


def read_route_graph(path: str | Path) -> RouteGraph:
    """Read a route graph.

    Source: Nav2 documentation, "Route Graph Generation"; GeoJSON (RFC 7946).
    """
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
        if feature["geometry"].get("type") in LINES:
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
    except (KeyError, TypeError, ValueError, OverflowError):
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

    Each edge that carries a ``cost`` (see `energyplan.planning.roadmap.price_edges` and
    `energyplan.planning.roadmap.planned.plan_edges`) is written with it and with ``overridable:
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
