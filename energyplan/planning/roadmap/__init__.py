"""Routes of least energy on graphs of places, with networkx.

Any networkx graph with positions becomes an energy graph, whose routes pay for the turns at its
nodes (`Roadmap`). As a planner it drives along a graph that it is given, or along the visibility
graph of the map's obstacles, with corners rounded by the best radius.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from itertools import pairwise

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError, TimeLimitError
from energyplan.kinds import checked
from energyplan.path import FloatArray, Path, Pose, point_ahead, wrap_angle
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.roadmap.routes import (
    Graph,
    Roadmap,
    Route,
    State,
    edge_prices,
    edges_of,
    energy_graph,
    positions,
)
from energyplan.planning.search.optimise import refine as refine_motions
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.cost_to_go import cost_to_go, node_at
from energyplan.planning.space.motions import DIRECTIONS
from energyplan.planning.space.prices import Prices
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.terrain.collision import first_collision

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


__all__ = [
    "Roadmap",
    "Route",
    "State",
    "energy_graph",
    "plan",
    "price_edges",
    "visibility_graph",
]

CHUNK = 5000
"""Edges tested for obstacles between two looks at the budget."""

_TESTED = 0.1
"""Units of work that an edge tested counts as."""


def price_edges(graph: Graph, cost: EnergyCost, surfaces: SurfaceMap | None = None) -> Graph:
    """Return a copy of a graph whose edges carry the energy of driving them as ``cost`` [J].

    A graph of places cannot carry the energy of the turns at its nodes: a planner that adds up
    these costs sees none of it, `Roadmap` does.
    """
    priced = graph.copy()
    edges = edges_of(graph, reverse=False)
    for source, target, data in priced.edges(data=True):
        if source != target:
            data["cost"] = 0.0
    for state, energy in zip(edges.states, edge_prices(edges, Prices(cost, surfaces)), strict=True):
        place = (state.source, state.target)
        data = priced.edges[(*place, state.key) if graph.is_multigraph() else place]
        data["cost"] = max(data["cost"], float(energy))
    return priced


@checked()
def plan(
    problem: PlanningProblem,
    budget: Budget,
    *,
    graph: Graph | None = None,
    obstacles: BaseGeometry | Iterable[BaseGeometry] | None = None,
    clearance: float | None = None,
    neighbours: int = 12,
    reverse: bool = True,
    radius: float = 0.0,
    refine: bool | None = None,
) -> Candidate:
    """Plan along a graph of places, or along the visibility graph of the obstacles.

    Every edge and every turn of the answer is tested with the whole footprint; those that are not
    free are left out, and the search is repeated without them.
    """
    polish = graph is None if refine is None else refine
    query = compiled(problem)
    places = [_reference(problem, problem.start), _reference(problem, problem.goal)]
    if graph is None:
        if clearance is None:
            half = float(np.abs(problem.robot.footprint[:, 1]).max())
            clearance = half + 0.5 * query.grid.resolution
        shapes = traced(query.grid, query.grid.resolution) if obstacles is None else obstacles
        budget.check("the outlines of the obstacles had been traced")
        path = _among(shapes, clearance, places, query, reverse, budget)
    else:
        graph, ends = _with_ends(graph, places, neighbours)
        roadmap = _roadmap(graph, query, reverse, radius, budget)
        path = _free_route(roadmap, ends, query)
    first = budget.elapsed
    if polish:
        path = _refined(path, query, budget)
    return Candidate(path, first_time=first)


def _roadmap(
    graph: Graph, query: CompiledProblem, reverse: bool, radius: float, budget: Budget
) -> Roadmap:
    problem = query.problem
    return Roadmap(
        graph, problem.cost, problem.surfaces, reverse, radius, problem.objective, budget
    )


def _among(
    shapes: BaseGeometry | Iterable[BaseGeometry],
    clearance: float,
    places: list[tuple[float, float]],
    query: CompiledProblem,
    reverse: bool,
    budget: Budget,
) -> Path:
    """Return the cheapest free route on the visibility graph of obstacles.

    A route leaves a corner aside by no more than a clearance, where it rounds it, and costs no
    less than the least price of a metre for each metre. So once a route is known, only lines of
    sight within an ellipse about start and goal can be on a better one. A first ellipse is guessed
    from the way of a disc around the obstacles.
    """
    # a line of sight has two ends, each passed by at a clearance
    least, rounding = query.setting.least_metre, 4.0 * clearance
    reach, whole = _first_reach(query) + rounding, _farthest(query, places)
    path: Path | None = None
    while True:
        try:
            graph = visibility_graph(shapes, clearance, places, reach=reach, budget=budget)
            roadmap = _roadmap(graph, query, reverse, 0.0, budget)
            path = _free_route(roadmap, (0, 1), query)
        except TimeLimitError:
            if path is None:
                raise
            return path
        except NoPathError:
            if reach >= whole:
                raise
            reach *= 2.0
            continue
        needed = query.value(path) / least + rounding
        if needed <= reach or reach >= whole:
            return path
        reach = needed


def _first_reach(query: CompiledProblem) -> float:
    """Return how long a good route may be, in metres of the least price, its turns included."""
    setting = query.setting
    to_go = cost_to_go(setting)
    start = node_at(to_go, setting.space, setting.start)
    way = float(to_go.distance[start]) if start >= 0 else np.inf
    radian = float(setting.prices[0, DIRECTIONS // 4]) * setting.half_track
    return 1.02 * way + np.pi * radian / setting.least_metre


def _farthest(query: CompiledProblem, places: Sequence[tuple[float, float]]) -> float:
    """Return the longest way from start to goal by way of any place on the map [m]."""
    corners = query.grid.corners
    return float(np.max(sum(np.hypot(*(corners - place).T) for place in places)))


def _reference(problem: PlanningProblem, pose: Pose) -> tuple[float, float]:
    """Return where the reference point is at a pose."""
    x, y = point_ahead(pose, problem.cost.icr.longitudinal).tolist()
    return x, y


def _with_ends(
    graph: Graph, places: Sequence[tuple[float, float]], neighbours: int
) -> tuple[Graph, tuple[Hashable, Hashable]]:
    """Return a copy of a graph with start and goal joined to it, and their nodes."""
    joined = graph.copy()
    known = positions(graph)
    ends = ("start of the plan", "goal of the plan")
    for node, place in zip(ends, places, strict=True):
        joined.add_node(node, pos=place)
        distance = {
            other: float(np.hypot(*(np.subtract(place, at)))) for other, at in known.items()
        }
        for other in sorted(distance, key=distance.__getitem__)[:neighbours]:
            if distance[other] < 1e-9:
                # the place itself: whatever leaves or enters it
                continue
            pair = (node, other) if node == ends[0] else (other, node)
            joined.add_edge(*pair)
    if np.hypot(*np.subtract(places[1], places[0])) > 1e-9:
        joined.add_edge(*ends)
    return joined, ends


def _free_route(roadmap: Roadmap, ends: tuple[Hashable, Hashable], query: CompiledProblem) -> Path:
    """Return the cheapest route whose footprint is free all along.

    Edges are tested at once; turns when a route wants them.
    """
    problem, states = query.problem, roadmap.states
    everything = list(states)
    for k in range(0, len(everything), CHUNK):
        roadmap.budget.check(f"{k} of {len(everything)} edges had been tested for obstacles")
        some = everything[k : k + CHUNK]
        roadmap.budget.spend(_TESTED * len(some))
        free = query.grid.motions_free(
            [roadmap.pose(state, 0.0) for state in some],
            [state.gear * roadmap.length(state) for state in some],
            np.zeros(len(some)),
            problem.robot,
            problem.cost.icr.longitudinal,
        )
        states.remove_nodes_from([s for s, good in zip(some, free, strict=True) if not good])
    closed: set[tuple[str, State]] = set()
    mended = 0
    while True:
        roadmap.budget.check(f"{mended} routes had been mended whose turns were not free")
        try:
            sequence = roadmap.search(*ends, problem.start.yaw, problem.goal.yaw, closed)
        except NoPathError as error:
            raise NoPathError(
                f"{error}, and no other way is free for the footprint; check the map for closed "
                "doors and unknown cells, add places to the graph, or use the planner 'lattice'"
            ) from None
        path = roadmap.drive(ends[0], sequence, problem.start.yaw, problem.goal.yaw)
        if query.grid.path_free(path, problem.robot):
            return path
        if not _mend(roadmap, sequence, query, closed):
            raise NoPathError("the footprint is not free where start and goal are the same place")
        mended += 1


def _refined(path: Path, query: CompiledProblem, budget: Budget) -> Path:
    """Return a route made cheaper with exact steering, or the route itself."""
    motions = query.of_centre(path.ds, path.dtheta)
    setting = query.setting
    centre = Path(query.centre(path.start), motions.ds, motions.dtheta)
    # the planners' footprint is a little larger than the robot's
    if first_collision(setting.space, setting.body, centre.vertices, *motions, 0.0) >= 0:
        return path
    better = query.path(refine_motions(query, motions, budget))
    return better if query.value(better) < query.value(path) else path


def _mend(
    roadmap: Roadmap,
    sequence: Sequence[State],
    query: CompiledProblem,
    closed: set[tuple[str, State]],
) -> bool:
    """Make the turns of a route tighter that are not free, or take them out; tell if any."""
    problem, found = query.problem, False
    lon = problem.cost.icr.longitudinal

    def is_free(start: Pose, ds: float, turn: float) -> bool:
        return query.grid.path_free(
            Path(start, np.array([ds]), np.array([turn]), lon), problem.robot
        )

    for here, ahead in pairwise(sequence):
        arc = roadmap.states[here][ahead]
        before = arc["radius"]
        turn = float(wrap_angle(roadmap.yaw(ahead) - roadmap.yaw(here)))
        for part in (1.0, 0.75, 0.5, 0.25, 0.0):
            radius = part * before
            back = radius * float(np.tan(0.5 * abs(turn))) if radius > 0 else 0.0
            start = roadmap.pose(here, roadmap.length(here) - back)
            if is_free(start, here.gear * radius * abs(turn), turn):
                if part < 1.0:
                    roadmap.retune(here, ahead, radius)
                break
        else:
            roadmap.states.remove_edge(here, ahead)
            part = -1.0
        found = found or part < 1.0
    if sequence:
        first, last = sequence[0], sequence[-1]
        leave = float(wrap_angle(roadmap.yaw(first) - problem.start.yaw))
        if not is_free(problem.start, 0.0, leave):
            closed.add(("start", first))
            found = True
        arrival = roadmap.pose(last, roadmap.length(last))
        if not is_free(arrival, 0.0, float(wrap_angle(problem.goal.yaw - arrival.yaw))):
            closed.add(("goal", last))
            found = True
    return found
