"""Graphs of places made into graphs of states, whose arcs cost the energy of edges and turns.

A state is an edge of the user's graph with the gear it is driven in: where the robot is and which
way it faces when it arrives. A graph of places cannot carry the cost of turning, because what a
turn costs depends on where the robot came from; a graph of states can, and every shortest-path
algorithm applies to it.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError
from energyplan.path import FloatArray, Path, Pose, point_ahead, wrap_angle
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.space.prices import Prices
from energyplan.terrain import SurfaceMap, path_price

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


_LOOK = 4096
"""Turns searched between two looks at the budget."""

_TURN = 0.1
"""Units of work that a turn searched counts as."""


@dataclass(frozen=True)
class Route:
    """A route on a graph of places."""

    nodes: tuple[Hashable, ...]  # the places, from the source to the target
    states: tuple[State, ...]  # each edge as it is driven
    path: Path  # the motions
    energy: float  # its energy, priced by the model itself [J]
    cost: float  # the objective's value


@dataclass(frozen=True, eq=False)
class Roadmap:
    """A graph of places, priced for a robot."""

    graph: Graph  # any graph, directed or not, multigraph or not [m]
    cost: EnergyCost  # cost of motions
    surfaces: SurfaceMap | None = None  # grounds with power models of their own
    reverse: bool = True  # whether the robot may drive backwards
    radius: float = 0.0  # [m]
    objective: str | Mapping[str, float] = "energy"  # what to make least, as in `PlanningProblem`
    budget: Budget = UNLIMITED

    @cached_property
    def prices(self) -> Prices:
        """What the objective makes of motions."""
        return Prices(self.cost, self.surfaces, self.objective)

    @cached_property
    def states(self) -> nx.DiGraph[State]:
        """The graph of states; see `energy_graph`."""
        return energy_graph(
            self.graph,
            self.cost,
            surfaces=self.surfaces,
            reverse=self.reverse,
            radius=self.radius,
            objective=self.objective,
            budget=self.budget,
        )

    @cached_property
    def _places(self) -> dict[Hashable, tuple[float, float]]:
        return positions(self.graph)

    def yaw(self, state: State) -> float:
        """Return the robot's yaw while it drives a state [rad]."""
        (ax, ay), (bx, by) = self._places[state.source], self._places[state.target]
        return float(np.arctan2(by - ay, bx - ax)) + (0.0 if state.gear > 0 else np.pi)

    def _turn(self, node: Hashable, ds: float, turn: float) -> float:
        """Return the price of a motion on the ground under a node."""
        ground = self.surfaces
        region = 0 if ground is None else int(ground.region_at(self._places[node]))
        return float(self.prices.motion(ds, turn, region))

    def route(
        self,
        source: Hashable,
        target: Hashable,
        *,
        start_yaw: float | None = None,
        goal_yaw: float | None = None,
    ) -> Route:
        """Return the route between two nodes whose objective is least."""
        for node in (source, target):
            if node not in self.graph:
                raise InvalidInputError(f"node {node!r} is not in the graph")
        sequence = self.search(source, target, start_yaw, goal_yaw)
        path = self.drive(source, sequence, start_yaw, goal_yaw)
        nodes = (source, *(state.target for state in sequence))
        price = path_price(path, self.cost, self.surfaces)
        value = self.prices.value(price.energy, path.length, price.duration)
        return Route(nodes, tuple(sequence), path, price.energy, value)

    def length(self, state: State) -> float:
        """Return the length of a state's edge [m]."""
        (ax, ay), (bx, by) = self._places[state.source], self._places[state.target]
        return float(np.hypot(bx - ax, by - ay))

    def pose(self, state: State, along: float) -> Pose:
        """Return the pose of the body frame so far along a state's edge [m]."""
        yaw = self.yaw(state)
        x, y = self._places[state.source]
        forward = state.gear * along - self.cost.icr.longitudinal
        x, y = point_ahead((x, y, yaw), forward).tolist()
        return Pose(x, y, yaw)

    def retune(self, here: State, ahead: State, radius: float) -> None:
        """Let the turn from one state to the next be driven with another radius [m]."""
        turn = float(wrap_angle(self.yaw(ahead) - self.yaw(here)))
        node = here.target
        cut = radius * float(np.tan(0.5 * abs(turn))) if radius > 0 else 0.0
        arc = self._turn(node, here.gear * radius * abs(turn), turn)
        saved = self._turn(node, here.gear * 2 * cut, 0.0)
        weight = arc - saved + self.states.nodes[ahead]["cost"]
        self.states.add_edge(here, ahead, weight=weight, radius=radius)

    def search(
        self,
        source: Hashable,
        target: Hashable,
        start_yaw: float | None = None,
        goal_yaw: float | None = None,
        closed: Container[tuple[str, State]] = (),
    ) -> list[State]:
        """Return the states of the best route; see `route`.

        `closed` holds the ends that must not be used: ``("start", state)`` for a state that the
        robot must not start with, ``("goal", state)`` for one that it must not arrive by.
        """
        if source == target:
            return []
        # two more states for the ends, taken out again whatever happens
        states = self.states
        looks, turns = 0, states.number_of_edges()

        def weight(_: State, __: State, arc: Mapping[str, float]) -> float:
            nonlocal looks
            looks += 1
            if looks % _LOOK == 0:
                self.budget.spend(_LOOK * _TURN)
                self.budget.check(f"{looks} of {turns} turns had been searched")
            return arc["weight"]

        begin, end = State(source, source, "start", 0), State(target, target, "goal", 0)
        try:
            for state in list(states):
                if state.source == source and ("start", state) not in closed:
                    turn = 0.0 if start_yaw is None else self.yaw(state) - start_yaw
                    spin = self._turn(source, 0.0, float(wrap_angle(turn)))
                    states.add_edge(begin, state, weight=spin + states.nodes[state]["cost"])
                if state.target == target and ("goal", state) not in closed:
                    turn = 0.0 if goal_yaw is None else goal_yaw - self.yaw(state)
                    spin = self._turn(target, 0.0, float(wrap_angle(turn)))
                    states.add_edge(state, end, weight=spin)
            if begin not in states or end not in states:
                raise nx.NetworkXNoPath
            found = nx.dijkstra_path(states, begin, end, weight=weight)
        except nx.NetworkXNoPath:
            raise NoPathError(self._nearest(source, target)) from None
        finally:
            states.remove_nodes_from([begin, end])
        return list(found[1:-1])

    def _nearest(self, source: Hashable, target: Hashable) -> str:
        """Return how near to the target one gets, in words."""
        first = [state for state in self.states if state.source == source]
        after = nx.multi_source_dijkstra_path_length(self.states, first) if first else {}
        goal = np.array(self._places[target])
        gap, near = min(
            (float(np.hypot(*(goal - self._places[node]))), k, node)
            for k, node in enumerate([source, *dict.fromkeys(s.target for s in after)])
        )[::2]
        (sx, sy), (gx, gy), (x, y) = self._places[source], goal, self._places[near]
        return (
            f"no route leads from {source!r} at ({sx:.2f}, {sy:.2f}) to {target!r} at ({gx:.2f}, "
            f"{gy:.2f}); the nearest node that is reached is {near!r} at ({x:.2f}, {y:.2f}), "
            f"{gap:.2f} m from there"
        )

    def drive(
        self,
        source: Hashable,
        sequence: Sequence[State],
        start_yaw: float | None = None,
        goal_yaw: float | None = None,
    ) -> Path:
        """Return the motions of a sequence of states, spins and arcs at its nodes included."""
        lon = self.cost.icr.longitudinal
        x, y = self._places[source]
        first = self.yaw(sequence[0]) if sequence else (goal_yaw or 0.0)
        yaw = first if start_yaw is None else start_yaw
        start_x, start_y = point_ahead((x, y, yaw), -lon).tolist()
        start = Pose(start_x, start_y, yaw)
        ds: list[float] = []
        dtheta: list[float] = []
        cut = 0.0
        for k, state in enumerate(sequence):
            turn = float(wrap_angle(self.yaw(state) - yaw))
            ahead = sequence[k + 1] if k + 1 < len(sequence) else None
            if k == 0 and turn != 0.0:
                ds.append(0.0)
                dtheta.append(turn)
            yaw = self.yaw(state)
            length = self.length(state) - cut
            if ahead is None:
                ds.append(state.gear * length)
                dtheta.append(0.0)
                break
            radius = float(self.states[state][ahead]["radius"])
            corner = float(wrap_angle(self.yaw(ahead) - yaw))
            cut = radius * float(np.tan(0.5 * abs(corner))) if radius > 0 else 0.0
            ds += [state.gear * (length - cut), state.gear * radius * abs(corner)]
            dtheta += [0.0, corner]
        if goal_yaw is not None:
            ds.append(0.0)
            dtheta.append(float(wrap_angle(goal_yaw - yaw)))
        keep = np.hypot(ds, dtheta) > 1e-12
        return Path(start, np.array(ds)[keep], np.array(dtheta)[keep], lon)
