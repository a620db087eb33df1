"""Visibility graphs: the corners of obstacles that a route can turn at, and what each one sees."""

from __future__ import annotations

from collections.abc import Iterable

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from energyplan.errors import InvalidInputError
from energyplan.path import FloatArray
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.terrain import OccupancyGrid

_GROWN, _SIGHT = 10.0, 0.05
"""Units of work that an obstacle that is grown, and a line of sight that is tested, count as."""

_SLACK = 1e-6
"""How far a line may run inside an obstacle's rim, for rounding [m]."""


def traced(grid: OccupancyGrid, tolerance: float) -> BaseGeometry:
    """Return the blocked cells of a map as polygons with few corners, in the world."""
    # each row's runs of blocked cells are boxes
    padded = np.pad(grid.blocked, ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=1)
    row, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    cells = shapely.union_all(shapely.box(first, row, last, row + 1))
    area = shapely.transform(cells, grid.to_world)
    half = 0.5 * tolerance
    return shapely.simplify(shapely.buffer(area, half, join_style="mitre"), half)


def visibility_graph(
    obstacles: BaseGeometry | Iterable[BaseGeometry],
    clearance: float,
    points: Iterable[tuple[float, float]] = (),
    *,
    reach: float = np.inf,
    budget: Budget = UNLIMITED,
) -> nx.Graph[int]:
    """Return the visibility graph of polygons, for a route whose turns are rounded.

    Its nodes are the corners of the obstacles grown by `clearance`, with mitred corners, and the
    `points`. Its edges are the lines of sight between them that a shortest route may take: those
    that touch the obstacle at either end without cutting into it. Around a corner of such a line
    an arc of any radius up to `clearance` keeps that distance from the obstacle, so that each
    node of a corner carries ``radius=clearance``: which radius is best is for `energy_graph` to
    find. It also carries ``rim``, so that a route turns there only around the obstacle.

    Source: Lozano-Perez and Wesley (1979), An algorithm for planning collision-free paths among
    polyhedral obstacles.
    """
    if not clearance > 0:
        raise InvalidInputError(f"clearance is {clearance} m; give a positive number")
    places = np.array(list(points), float).reshape(-1, 2)
    if np.isfinite(reach) and len(places) < 2:
        raise InvalidInputError("reach is given without start and goal; give two points")
    areas = [obstacles] if isinstance(obstacles, BaseGeometry) else list(obstacles)
    parts = shapely.get_parts(np.array(areas, object))
    if np.isfinite(reach):
        # an obstacle touches what it grows into, at most two clearances away
        first, last = (shapely.distance(parts, shapely.Point(place)) for place in places[:2])
        parts = parts[first + last <= reach + 4.0 * clearance]
    grown = shapely.union_all(shapely.buffer(parts, clearance, join_style="mitre", mitre_limit=2.0))
    budget.spend(_GROWN * len(parts))
    budget.check(f"{len(parts)} obstacles had been grown by {clearance:.3g} m")
    corner, before, after = _corners(grown)
    if np.isfinite(reach):
        way = sum(np.hypot(*(corner - place).T) for place in places[:2])
        corner, before, after = (rows[way <= reach] for rows in (corner, before, after))
    place = np.concatenate([places, corner])
    # a point has no neighbours on a rim: any line touches it
    before = np.concatenate([places, before]) - place
    after = np.concatenate([places, after]) - place
    core = shapely.buffer(grown, -_SLACK, join_style="mitre")
    shapely.prepare(core)
    pairs = [np.empty((2, 0), int)]
    for k in range(len(place)):
        budget.spend(_SIGHT * len(place))
        budget.check(f"{k} of {len(place)} corners had been looked at from each other")
        pair = _touching_pairs(k, place, before, after)
        if np.isfinite(reach):
            pair = pair[:, _way(place, pair) <= reach]
        sight = shapely.linestrings(np.stack([place[pair[0]], place[pair[1]]], axis=1))
        pairs.append(pair[:, ~shapely.intersects(core, sight)])
    i, j = np.concatenate(pairs, axis=1)
    length = np.hypot(*(place[j] - place[i]).T)
    graph: nx.Graph[int] = nx.Graph()
    for node, (x, y) in enumerate(place.tolist()):
        if node < len(places):
            graph.add_node(node, pos=(x, y), radius=0.0)
        else:
            rim = (tuple(before[node].tolist()), tuple(after[node].tolist()))
            graph.add_node(node, pos=(x, y), radius=clearance, rim=rim)
    graph.add_edges_from(
        (a, b, {"length": d})
        for a, b, d in zip(i.tolist(), j.tolist(), length.tolist(), strict=True)
    )
    return graph


def _corners(area: BaseGeometry) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the corners at which a route can turn, and their neighbours on the rim."""
    corner = [np.empty((0, 2))]
    before, after = [np.empty((0, 2))], [np.empty((0, 2))]
    for part in shapely.get_parts(area):
        if part.geom_type != "Polygon":
            continue
        for ring in shapely.get_rings(shapely.orient_polygons(part)):
            here = shapely.get_coordinates(ring)[:-1]
            last, following = np.roll(here, 1, axis=0), np.roll(here, -1, axis=0)
            # the obstacle lies to the left of its rim: it is convex where the rim turns left
            convex = _cross(here - last, following - here) > 1e-12
            corner.append(here[convex])
            before.append(last[convex])
            after.append(following[convex])
    return np.concatenate(corner), np.concatenate(before), np.concatenate(after)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _touching_pairs(
    k: int, place: FloatArray, before: FloatArray, after: FloatArray
) -> NDArray[np.intp]:
    """Return the pairs of corner `k` and later ones whose line touches the obstacle at both."""
    line = place[k + 1 :] - place[k]
    touches = (np.hypot(line[:, 0], line[:, 1]) > 1e-9) & _touching(line, before[k], after[k])
    touches &= _touching(line, before[k + 1 :], after[k + 1 :])
    later = k + 1 + np.flatnonzero(touches)
    return np.stack([np.full_like(later, k), later])


def _way(place: FloatArray, pair: NDArray[np.intp]) -> FloatArray:
    """Return the shortest ways from the first place to the second by way of pairs of places."""
    i, j = place[pair]
    (start_i, start_j), (goal_i, goal_j) = (
        [np.hypot(*(here - end).T) for here in (i, j)] for end in place[:2]
    )
    return np.asarray(np.minimum(start_i + goal_j, start_j + goal_i) + np.hypot(*(j - i).T))


def _touching(line: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Tell which lines have both neighbours of their corner on one side."""
    p, n = _cross(line, before), _cross(line, after)
    size = 1e-9 * np.hypot(line[:, 0], line[:, 1])
    return np.asarray((p >= -size) & (n >= -size) | (p <= size) & (n <= size))
