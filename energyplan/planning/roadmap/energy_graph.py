"""Graphs of places made into graphs of states, whose arcs cost the energy of edges and turns.

A state is an edge of the user's graph with the gear it is driven in: where the robot is and which
way it faces when it arrives. A graph of places cannot carry the cost of turning, because what a
turn costs depends on where the robot came from; a graph of states can, and every shortest-path
algorithm applies to it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.path import FloatArray, wrap_angle
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.scene.prices import Prices
from energyplan.terrain import SurfaceMap

Graph = Any
"""A networkx graph of any kind; its nodes carry ``pos`` or ``x`` and ``y``."""

_RADII = np.linspace(0.0, 1.0, 9)
"""Radii at which a rounded corner is priced, as fractions of the largest."""

_CHUNK = 20_000
"""Turns or edges between two looks at the clock."""

_PRICED = 0.05
"""Units of work that an edge or a turn that is priced counts as."""


class State(NamedTuple):
    """An edge as it is driven."""

    source: Hashable  # its nodes
    target: Hashable  # its nodes
    key: Hashable  # its key in a multigraph
    gear: int  # 1 forwards, -1 backwards


def positions(graph: Graph) -> dict[Hashable, tuple[float, float]]:
    """Return the position of each node [m]."""
    found = {}
    for node, data in graph.nodes(data=True):
        place = data.get("pos", (data.get("x"), data.get("y")))
        try:
            x, y = (float(v) for v in place)
        except (TypeError, ValueError):
            raise InvalidInputError(
                f"node {node!r} has no position; give each node pos=(x, y) or x= and y= [m]"
            ) from None
        if not (np.isfinite(x) and np.isfinite(y)):
            raise InvalidInputError(f"node {node!r} lies at ({x}, {y}); give finite metres")
        found[node] = (x, y)
    return found


@dataclass(frozen=True)
class Corner:
    """How a route turns from one edge to the next."""

    radius: FloatArray  # (n,): radius of the arc [m]
    price: FloatArray  # (n,): price of the arc, less that of the straight lines that it cuts off


def round_corner(
    price: Callable[[ArrayLike, ArrayLike], FloatArray],
    half_track: float,
    turn: FloatArray,
    limit: FloatArray,
    gear: FloatArray,
) -> Corner:
    """Return the best way round corners.

    Both lines that meet at a corner are left at the same distance before it and joined by an
    arc. Of all radii up to `limit` the cheapest is chosen. Where energy counts and every joule of
    an inner, generating motor comes back, that is the largest one, which cuts off most of the way;
    where it is lost, it is often the pivot about a tread's ICR. So nine radii and the pivot are
    tried, then nine between the neighbours of the best.
    """
    size = np.abs(turn)[:, None]
    way = gear[:, None]
    # a half turn cannot be rounded: its lines never meet
    tangent = np.tan(np.minimum(0.5 * size, 1.5))
    row = np.arange(len(turn))

    def extra(radius: FloatArray) -> FloatArray:
        arc = price(way * radius * size, np.broadcast_to(turn[:, None], radius.shape))
        return np.asarray(arc - price(way * 2 * radius * tangent, np.zeros(1)))

    pivot = np.where(limit >= half_track, half_track, 0.0)
    radius = np.concatenate([limit[:, None] * _RADII, pivot[:, None]], axis=1)
    value = extra(radius)
    k = np.argmin(value, axis=1)
    best, least = radius[row, k], value[row, k]
    near = _RADII[1] * limit
    low, high = np.maximum(best - near, 0.0), np.minimum(best + near, limit)
    between = low[:, None] + (high - low)[:, None] * _RADII
    value = extra(between)
    k = np.argmin(value, axis=1)
    # a radius in between must be worth more than rounding
    better = value[row, k] < least - 1e-9 * np.abs(least)
    return Corner(np.where(better, between[row, k], best), np.where(better, value[row, k], least))


@dataclass(frozen=True)
class Edges:
    """All ways to drive the edges of a graph, as arrays in the order of `states`."""

    states: tuple[State, ...]
    start: FloatArray
    heading: FloatArray
    length: FloatArray
    gear: FloatArray

    @property
    def yaw(self) -> FloatArray:
        """Yaw of the robot on each [rad]."""
        return self.heading + np.where(self.gear > 0, 0.0, np.pi)


def edges_of(graph: Graph, reverse: bool) -> Edges:
    """Return every way to drive a graph's edges; undirected edges can be driven both ways."""
    place = positions(graph)
    states: list[State] = []
    rows: list[tuple[float, float, float, float, float]] = []
    keyed = (
        graph.edges(keys=True)
        if graph.is_multigraph()
        else ((source, target, None) for source, target in graph.edges())
    )
    for source, target, key in keyed:
        if source == target:
            # a loop leads nowhere
            continue
        ways = [(source, target)]
        if not graph.is_directed():
            ways.append((target, source))
        for a, b in ways:
            (ax, ay), (bx, by) = place[a], place[b]
            length = float(np.hypot(bx - ax, by - ay))
            if length == 0.0:
                raise InvalidInputError(
                    f"the edge from {a!r} to {b!r} has no length; merge these nodes"
                )
            for gear in (1, -1) if reverse else (1,):
                states.append(State(a, b, key, gear))
                rows.append((ax, ay, float(np.arctan2(by - ay, bx - ax)), length, gear))
    table = np.array(rows, float).reshape(-1, 5)
    return Edges(tuple(states), table[:, :2], table[:, 2], table[:, 3], table[:, 4])


def edge_prices(edges: Edges, prices: Prices, budget: Budget = UNLIMITED) -> FloatArray:
    """Return the price of driving each edge straight."""
    ds = edges.gear * edges.length
    if prices.surfaces is None:
        return prices.motion(ds, 0.0)
    heading = np.column_stack([np.cos(edges.heading), np.sin(edges.heading)])
    ends = edges.start + edges.length[:, None] * heading
    total = np.zeros(len(ds))
    for part in _parts(len(ds)):
        budget.spend(_PRICED * len(ds[part]))
        budget.check(f"{part.start} of {len(ds)} edges had been priced")
        shares = prices.surfaces.line_shares(edges.start[part], ends[part])
        for region, share in enumerate(shares.T):
            total[part] += prices.motion(ds[part] * share, 0.0, region)
    return total


def _parts(count: int) -> Iterator[slice]:
    return (slice(k, min(k + _CHUNK, count)) for k in range(0, count, _CHUNK))


def energy_graph(
    graph: Graph,
    cost: EnergyCost,
    *,
    surfaces: SurfaceMap | None = None,
    reverse: bool = True,
    radius: float = 0.0,
    objective: str | Mapping[str, float] = "energy",
    budget: Budget = UNLIMITED,
) -> nx.DiGraph[State]:
    """Return the graph of states whose shortest paths are the routes of least energy.

    Its nodes are `State` tuples, with the price of driving that edge straight as ``cost``.
    Its arcs join an edge to the next one; their ``weight`` is the price of the turn at the
    node between them plus that of the next edge, and ``radius`` [m] says how the turn is made.
    It may start forwards and go on backwards, in which case it turns on the spot. Prices are
    joules, or of the objective's unit.
    """
    prices = Prices(cost, surfaces, objective)
    edges = edges_of(graph, reverse)
    straight = edge_prices(edges, prices, budget)
    out: nx.DiGraph[State] = nx.DiGraph()
    for state, price in zip(edges.states, straight.tolist(), strict=True):
        out.add_node(state, cost=price)
    first, then = _successions(graph, edges)
    region = np.zeros(len(edges.states), int)
    if surfaces is not None and len(region):
        region = surfaces.region_at(edges.start)
    known = {node: float(data.get("radius", radius)) for node, data in graph.nodes(data=True)}
    widest = np.array([known[state.source] for state in edges.states])
    for part in _parts(len(first)):
        budget.spend(_PRICED * len(first[part]))
        budget.check(f"{part.start} of {len(first)} turns had been priced")
        a, b = first[part], then[part]
        corner = _corners(edges, a, b, widest[b], region[b], prices)
        out.add_edges_from(
            (edges.states[i], edges.states[j], {"weight": w, "radius": r})
            for i, j, w, r in zip(
                a.tolist(),
                b.tolist(),
                (corner.price + straight[b]).tolist(),
                corner.radius.tolist(),
                strict=True,
            )
        )
    return out


def _corners(
    edges: Edges,
    first: NDArray[np.intp],
    then: NDArray[np.intp],
    widest: FloatArray,
    region: NDArray[np.intp],
    prices: Prices,
) -> Corner:
    """Return how to turn from the first edges to those that come then."""
    turn = wrap_angle(edges.yaw[then] - edges.yaw[first])
    # rounding errors must not tell a turn to the left from one to the right
    turn = np.where(np.abs(np.abs(turn) - np.pi) < 1e-9, np.pi, turn)
    room = 0.5 * np.minimum(edges.length[first], edges.length[then])
    tangent = np.tan(np.minimum(0.5 * np.abs(turn), 1.5))
    limit = np.minimum(widest, room / np.maximum(tangent, 1e-9))
    same_gear = (edges.gear[first] == edges.gear[then]) & (np.abs(turn) < 3.0)
    limit = np.where(same_gear, limit, 0.0)
    radius, price = np.zeros(len(turn)), np.zeros(len(turn))
    for number, cost in enumerate(prices.costs):
        here = region == number
        if np.any(here):
            charge = partial(prices.motion, region=number)
            way = edges.gear[then][here]
            corner = round_corner(charge, cost.half_track, turn[here], limit[here], way)
            radius[here], price[here] = corner.radius, corner.price
    return Corner(radius, price)


def _successions(graph: Graph, edges: Edges) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which state may follow which: the first ones, and those that come then."""
    number = {node: k for k, node in enumerate(graph)}
    source = np.array([number[state.source] for state in edges.states], int)
    target = np.array([number[state.target] for state in edges.states], int)
    order = np.argsort(source, kind="stable")
    begin = np.searchsorted(source[order], target, "left")
    count = np.searchsorted(source[order], target, "right") - begin
    first = np.repeat(np.arange(len(target)), count)
    rank = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    then = order[np.repeat(begin, count) + rank]

    # At the corner of an obstacle a cheapest route turns only to get around the obstacle.
    rims = [data.get("rim") for _, data in graph.nodes(data=True)]
    at_corner = np.array([rim is not None for rim in rims], bool)[source[then]]
    rim = np.array([np.sum(rim or np.zeros((2, 2)), axis=0) for rim in rims])[source[then]]
    arriving, leaving = edges.heading[first], edges.heading[then]
    turn = wrap_angle(leaving - arriving)
    # positive where the obstacle lies to the left
    side_before = np.cos(arriving) * rim[:, 1] - np.sin(arriving) * rim[:, 0]
    side_after = np.cos(leaving) * rim[:, 1] - np.sin(leaving) * rim[:, 0]
    around = (turn * side_before >= -1e-9) & (turn * side_after >= -1e-9)
    keep = ~at_corner | (around & (edges.gear[first] == edges.gear[then]))
    return first[keep], then[keep]
