"""Visibility graphs: the corners of obstacles that a route can turn at, and what each one sees."""

from __future__ import annotations

from collections.abc import Iterable

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from energyplan.errors import InvalidInputError
from energyplan.maps import OccupancyGrid
from energyplan.path import FloatArray

MAX_CORNERS = 3000
"""Most corners of which a visibility graph is built; its size grows with their square."""

_SLACK = 1e-6
"""How far a line may run inside an obstacle's rim, for rounding [m]."""


def traced(grid: OccupancyGrid, tolerance: float) -> BaseGeometry:
    """Return the blocked cells of a map as polygons with few corners, in the world.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    tolerance : float
        How much larger obstacles may become on the way [m].

    Returns
    -------
    shapely geometry
        Polygons.
    """
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
) -> nx.Graph[int]:
    """Return the visibility graph of polygons, for a route whose turns are rounded.

    Its nodes are the corners of the obstacles grown by `clearance`, with mitred corners, and the
    `points`. Its edges are the lines of sight between them that a shortest route may take: those
    that touch the obstacle at either end without cutting into it. Around a corner of such a line
    an arc of any radius up to `clearance` keeps that distance from the obstacle, so that each
    node of a corner carries ``radius=clearance``: which radius is best is for `energy_graph` to
    find. It also carries ``rim``, so that a route turns there only around the obstacle.

    Parameters
    ----------
    obstacles : shapely geometry or iterable of them
        Polygons in the world [m].
    clearance : float
        Distance that the route keeps from them [m]: half the width of a robot that turns about
        the corner, or more.
    points : iterable of tuple of float
        Further places (x, y) [m], such as start and goal; they are the nodes 0, 1 and so on. No
        corner is rounded there.

    Returns
    -------
    networkx.Graph
        Nodes with ``pos`` and ``radius``, edges with ``length`` [m].

    Raises
    ------
    InvalidInputError
        If `clearance` is not positive or there are too many corners.

    References
    ----------
    Lozano-Perez and Wesley (1979), An algorithm for planning collision-free paths among
    polyhedral obstacles.
    """
    if not clearance > 0:
        raise InvalidInputError(f"clearance is {clearance} m; give a positive number")
    areas = [obstacles] if isinstance(obstacles, BaseGeometry) else list(obstacles)
    grown = shapely.union_all(
        shapely.buffer(np.array(areas, object), clearance, join_style="mitre", mitre_limit=2.0)
    )
    places = np.array(list(points), float).reshape(-1, 2)
    corner, before, after = _corners(grown)
    if len(corner) > MAX_CORNERS:
        raise InvalidInputError(
            f"the obstacles have {len(corner)} corners; at most {MAX_CORNERS} are taken: simplify "
            "them first"
        )
    place = np.concatenate([places, corner])
    # a point has no neighbours on a rim: any line touches it
    before = np.concatenate([places, before]) - place
    after = np.concatenate([places, after]) - place
    pairs = [_touching_pairs(k, place, before, after) for k in range(len(place))]
    i, j = np.concatenate([np.empty((2, 0), int), *pairs], axis=1)
    length = np.hypot(*(place[j] - place[i]).T)
    sight = shapely.linestrings(np.stack([place[i], place[j]], axis=1))
    core = shapely.buffer(grown, -_SLACK, join_style="mitre")
    shapely.prepare(core)
    seen = ~shapely.intersects(core, sight)
    graph: nx.Graph[int] = nx.Graph()
    for node, (x, y) in enumerate(place.tolist()):
        if node < len(places):
            graph.add_node(node, pos=(x, y), radius=0.0)
        else:
            rim = (tuple(before[node].tolist()), tuple(after[node].tolist()))
            graph.add_node(node, pos=(x, y), radius=clearance, rim=rim)
    graph.add_edges_from(
        (a, b, {"length": d})
        for a, b, d in zip(i[seen].tolist(), j[seen].tolist(), length[seen].tolist(), strict=True)
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


def _touching(line: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Tell which lines have both neighbours of their corner on one side."""
    p, n = _cross(line, before), _cross(line, after)
    size = 1e-9 * np.hypot(line[:, 0], line[:, 1])
    return np.asarray((p >= -size) & (n >= -size) | (p <= size) & (n <= size))
