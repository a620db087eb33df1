"""Graphs of places with networkx: routes that pay for turns, and edges planned among obstacles.

Any networkx graph with positions becomes a graph of states. A state is an edge with the gear it is
driven in: where the robot is and which way it faces when it arrives. A graph of places cannot carry
the cost of turning, because what a turn costs depends on where the robot came from; a graph of
states can, and every shortest-path algorithm applies to it.

For Nav2's route server and most roadmaps, an edge is the straight line between its places. Among
obstacles (`plan_edges`) it is the path of the planner from one place to the other, at both in the
direction of the edge; its cost includes the mean of the turns that may follow it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from itertools import pairwise
from math import inf
from operator import add
from typing import Any, Generic, NamedTuple, TypeVar

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import (
    GoalInCollisionError,
    InvalidInputError,
    NoPathError,
    OutsideMapError,
    StartInCollisionError,
    TimeLimitError,
)
from energyplan.path import ROUNDING, FloatArray, Path, Pose, point_ahead, wrap_angle
from energyplan.planning.budget import Budget
from energyplan.planning.goal import Goal
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.search import planner as lattice
from energyplan.planning.search.lattice import joined
from energyplan.planning.search.planner import compile_planning
from energyplan.planning.several import least_costs
from energyplan.planning.space.compiled import Segments, compiled, merged
from energyplan.planning.space.prices import Prices
from energyplan.records import NO_NUMBER
from energyplan.terrain import SurfaceMap, path_price

R = TypeVar("R")

Graph = Any
"""A networkx graph of any kind, directed or not; its nodes carry ``pos`` or ``x`` and ``y`` [m]."""

EFFORT = 4000  # units of work for each edge that is planned among obstacles

_HEADINGS = 36  # headings at which a route may pass a place of a planned graph

_RADII = np.linspace(0.0, 1.0, 9)
"""Radii at which a rounded corner is priced, as fractions of the largest."""


class DrivenEdge(NamedTuple):
    """An edge as it is driven."""

    source: Hashable
    target: Hashable
    key: Hashable  # in a multigraph
    gear: int  # 1 forwards, -1 backwards


@dataclass(frozen=True)
class Edges:
    """All ways to drive the edges of a graph, as arrays in the order of `states`."""

    states: tuple[DrivenEdge, ...]
    start: FloatArray  # (n, 2)
    heading: FloatArray
    length: FloatArray
    gear: FloatArray

    @property
    def yaw(self) -> FloatArray:
        """Yaw of the robot on each [rad]."""
        return self.heading + np.where(self.gear > 0, 0.0, np.pi)


def positions(graph: Graph) -> dict[Hashable, tuple[float, float]]:
    """Return the position of each node [m]."""
    found = {}
    for node, data in graph.nodes(data=True):
        place = data.get("pos", (data.get("x"), data.get("y")))
        try:
            x, y = (float(v) for v in place)
        except NO_NUMBER:
            raise InvalidInputError(
                f"node {node!r} has no position; give each node pos=(x, y) or x= and y= [m]"
            ) from None
        if not (np.isfinite(x) and np.isfinite(y)):
            raise InvalidInputError(f"node {node!r} lies at ({x}, {y}); give finite metres")
        found[node] = (x, y)
    return found


def edges_of(graph: Graph, reverse: bool) -> Edges:
    """Return every way to drive a graph's edges; undirected edges can be driven both ways."""
    place = positions(graph)
    states: list[DrivenEdge] = []
    rows: list[tuple[float, ...]] = []
    for source, target, *key in graph.edges(keys=True) if graph.is_multigraph() else graph.edges():
        if source == target:
            # a loop leads nowhere
            continue
        for a, b in [(source, target)] + [(target, source)] * (not graph.is_directed()):
            (ax, ay), (bx, by) = place[a], place[b]
            length = float(np.hypot(bx - ax, by - ay))
            if length == 0.0:
                raise InvalidInputError(
                    f"the edge from {a!r} to {b!r} has no length; merge these nodes"
                )
            for gear in (1, -1) if reverse else (1,):
                states.append(DrivenEdge(a, b, key[0] if key else None, gear))
                rows.append((ax, ay, float(np.arctan2(by - ay, bx - ax)), length, gear))
    table = np.array(rows, float).reshape(-1, 5)
    return Edges(tuple(states), table[:, :2], table[:, 2], table[:, 3], table[:, 4])


def _straight_prices(edges: Edges, prices: Prices) -> FloatArray:
    """Return the price of driving each edge straight."""
    ds = edges.gear * edges.length
    if prices.surfaces is None:
        return prices.motion(ds, 0.0, yaw=edges.yaw)
    heading = np.column_stack([np.cos(edges.heading), np.sin(edges.heading)])
    ends = edges.start + edges.length[:, None] * heading
    shares = prices.surfaces.line_shares(edges.start, ends, prices.slow)
    return np.asarray(
        sum(prices.motion(ds * part, 0.0, k, yaw=edges.yaw) for k, part in enumerate(shares.T))
    )


def _with_costs(graph: Graph, costs: Mapping[DrivenEdge, float]) -> Graph:
    """Return a copy of a graph with the costs of its edges, the greater of both ways."""
    priced = graph.copy()
    several = graph.is_multigraph()
    edges = [(*state[:3],) if several else state[:2] for state in costs]
    for edge in edges:
        priced.edges[edge].pop("cost", None)
    for edge, cost in zip(edges, costs.values(), strict=True):
        data = priced.edges[edge]
        data["cost"] = max(cost, data.get("cost", cost))
    costly = priced.edges(keys=True, data="cost") if several else priced.edges(data="cost")
    priced.remove_edges_from([edge for edge in costly if edge[-1] == inf])
    return priced


def price_edges(graph: Graph, cost: EnergyCost, surfaces: SurfaceMap | None = None) -> Graph:
    """Return a copy of a graph whose edges carry the energy of driving them as ``cost`` [J].

    A graph of places cannot carry the energy of the turns at its nodes: a planner that adds up
    these costs sees none of it, `Roadmap` does.
    """
    edges = edges_of(graph, reverse=False)
    energies = _straight_prices(edges, Prices(cost, surfaces)).tolist()
    return _with_costs(graph, dict(zip(edges.states, energies, strict=True)))


@dataclass(frozen=True)
class Corner:
    """How a route turns from one edge to the next."""

    radius: FloatArray  # (n,): radius of the arc [m]
    price: FloatArray  # (n,): price of the arc, less that of the straight lines that it cuts off


def round_corner(
    arc: Callable[[FloatArray, FloatArray], FloatArray],
    lines: Callable[[FloatArray], FloatArray],
    half_track: float,
    turn: FloatArray,
    limit: FloatArray,
    gear: FloatArray,
) -> Corner:
    """Return the best way round corners.

    Both lines that meet at a corner are left at the same distance before it and joined by an
    arc, whose price `arc` returns; `lines` returns that of as much of both lines. Of all radii up
    to `limit` the cheapest is chosen. Where energy counts and every joule of an inner, generating
    motor comes back, that is the largest one, which cuts off most of the way; where it is lost, it
    is often the pivot about a tread's ICR. So nine radii and the pivot are tried, then nine between
    the neighbours of the best.
    """
    size = np.abs(turn)[:, None]
    way = gear[:, None]
    # a half turn cannot be rounded: its lines never meet
    tangent = np.tan(np.minimum(0.5 * size, 1.5))
    row = np.arange(len(turn))

    def extra(radius: FloatArray) -> FloatArray:
        whole = arc(way * radius * size, np.broadcast_to(turn[:, None], radius.shape))
        return np.asarray(whole - lines(way * 2 * radius * tangent))

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
    # a radius in between must gain more than rounding errors
    better = value[row, k] < least - 1e-9 * np.abs(least)
    return Corner(np.where(better, between[row, k], best), np.where(better, value[row, k], least))


def energy_graph(
    graph: Graph,
    cost: EnergyCost,
    *,
    surfaces: SurfaceMap | None = None,
    reverse: bool = True,
    radius: float = 0.0,
    objective: str | Mapping[str, float] = "energy",
) -> nx.DiGraph[DrivenEdge]:
    """Return the graph of states whose shortest paths are the routes of least energy.

    Its nodes are `DrivenEdge` tuples, with the price of driving that edge straight as ``cost``.
    Its arcs join an edge to the next one; their ``weight`` is the price of the turn at the
    node between them plus that of the next edge, and ``radius`` [m] defines the turn.
    It may start forwards and go on backwards, in which case it turns on the spot. Prices are
    joules, or of the objective's unit.
    """
    prices = Prices(cost, surfaces, objective)
    edges = edges_of(graph, reverse and cost.vehicle.reverse)
    straight = _straight_prices(edges, prices)
    states = edges.states
    out: nx.DiGraph[DrivenEdge] = nx.DiGraph()
    for state, price in zip(states, straight.tolist(), strict=True):
        out.add_node(state, cost=price)
    first, then = _successions(graph, edges)
    region = prices.class_at(edges.start)
    known = {node: float(data.get("radius", radius)) for node, data in graph.nodes(data=True)}
    widest = np.array([known[state.source] for state in states])
    corner = _corners(edges, first, then, widest[then], region[then], prices)
    weights = (corner.price + straight[then]).tolist()
    rows = zip(first.tolist(), then.tolist(), weights, corner.radius.tolist(), strict=True)
    out.add_edges_from((states[i], states[j], {"weight": w, "radius": r}) for i, j, w, r in rows)
    return out


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
    return first, order[np.repeat(begin, count) + rank]


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
    # rounding errors must not decide between a left turn and a right turn
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
            before, after = (edges.yaw[which][here][:, None] for which in (first, then))
            arc = partial(prices.turning, region=number, yaw=before)
            lines = partial(_both_lines, prices, number, before, after)
            way = edges.gear[then][here]
            corner = round_corner(arc, lines, cost.half_track, turn[here], limit[here], way)
            radius[here], price[here] = corner.radius, corner.price
    return Corner(radius, price)


def _both_lines(
    prices: Prices, region: int, before: FloatArray, after: FloatArray, ds: FloatArray
) -> FloatArray:
    """Return the price of lines of which one half has the one heading, one half the other."""
    if not prices.costs[region].of_heading:
        return prices.motion(ds, 0.0, region)
    halves = (prices.motion(0.5 * ds, 0.0, region, yaw=yaw) for yaw in (before, after))
    return np.asarray(sum(halves))


def _cheapest(
    states: nx.DiGraph[DrivenEdge],
    source: Hashable,
    targets: Sequence[Hashable],
    leave: Callable[[DrivenEdge], float],
    arrive: Callable[[DrivenEdge], float],
) -> list[DrivenEdge]:
    """Return the cheapest states from one node to one of others; none if nothing joins them."""
    # two more states for the ends, taken out again whatever happens
    begin, end = DrivenEdge(source, source, "start", 0), DrivenEdge(source, source, "goal", 0)
    first = [(begin, state, leave(state)) for state in states if state.source == source]
    last = [(state, end, arrive(state)) for state in states if state.target in targets]
    try:
        states.add_weighted_edges_from([*first, *last])
        return list(nx.dijkstra_path(states, begin, end)[1:-1])
    except (nx.NetworkXNoPath, nx.NodeNotFound):
        return []
    finally:
        states.remove_nodes_from([begin, end])


def _targets(graph: Graph, source: Hashable, target: Any) -> list[Hashable]:
    """Return the nodes of which a route is to reach one: a list of nodes, or a single one."""
    targets = list(target) if isinstance(target, list) else [target]
    if not targets:
        raise InvalidInputError("the route has no target; give a node, or a list of nodes")
    for node in (source, *targets):
        try:
            known = node in graph
        except TypeError:  # no hashable value, so no node
            known = False
        if not known:
            raise InvalidInputError(
                f"node {node!r} is not in the graph; routes lead from node to node, to other "
                "places, poses and circles a plan does"
            )
    return targets


def _end_yaws(
    name: str, place: tuple[float, float], yaw: float | None, heading: str
) -> tuple[float, ...]:
    """Return the yaws that a route may begin or end with [rad]; none where all are allowed."""
    try:
        return Goal(*place, yaw, heading).headings
    except InvalidInputError as error:
        raise InvalidInputError(f"{name} of the route: {error}") from None


@dataclass(frozen=True)
class Route:
    """A route on a graph of places."""

    nodes: tuple[Hashable, ...]  # the places, from the source to the target
    states: tuple[DrivenEdge, ...]  # each edge as it is driven
    path: Path  # the motions
    energy: float  # its energy, priced by the model itself [J]
    cost: float  # the objective's value


class _EndYaws(NamedTuple):
    """Yaws that a route may begin and end with [rad]; none where all are allowed."""

    first: tuple[float, ...]
    last: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Routed(ABC, Generic[R]):
    """A graph of places on which routes are found."""

    graph: Graph  # of places

    @cached_property
    def _places(self) -> dict[Hashable, tuple[float, float]]:
        return positions(self.graph)

    def route(
        self,
        source: Hashable,
        target: Any,
        *,
        start_yaw: float | None = None,
        goal_yaw: float | None = None,
        start_heading: str = "",
        goal_heading: str = "",
    ) -> R:
        """Return the route from one node to another, or to one of a list, whose objective is least.

        At both ends a yaw may be given [rad], and its heading as in `Goal`: ``"given"``,
        ``"either"`` for it or its opposite, or ``"any"``, which it is without a yaw.
        """
        targets = _targets(self.graph, source, target)
        first = _end_yaws("the start", self._places[source], start_yaw, start_heading)
        last = _end_yaws("the goal", self._places[targets[0]], goal_yaw, goal_heading)
        return self._route(source, targets, _EndYaws(first, last))

    @abstractmethod
    def _route(self, source: Hashable, targets: Sequence[Hashable], ends: _EndYaws) -> R:
        """Return the route from a node to one of others."""


@dataclass(frozen=True, eq=False)
class Roadmap(_Routed[Route]):
    """A graph of places, priced for a robot."""

    cost: EnergyCost  # cost of motions
    surfaces: SurfaceMap | None = None  # surfaces with power models of their own
    reverse: bool = True  # whether the robot may drive backwards
    radius: float = 0.0  # with which nodes are rounded at most that have none of their own [m]
    objective: str | Mapping[str, float] = "energy"  # what to make least, as in `PlanningProblem`

    @cached_property
    def _prices(self) -> Prices:
        return Prices(self.cost, self.surfaces, self.objective)

    @cached_property
    def states(self) -> nx.DiGraph[DrivenEdge]:
        """The graph of states; see `energy_graph`."""
        return energy_graph(
            self.graph, self.cost, surfaces=self.surfaces, reverse=self.reverse,
            radius=self.radius, objective=self.objective,
        )  # fmt: skip

    def _yaw(self, state: DrivenEdge) -> float:
        """Return the robot's yaw while it drives a state [rad]."""
        (ax, ay), (bx, by) = self._places[state.source], self._places[state.target]
        return float(np.arctan2(by - ay, bx - ax)) + (0.0 if state.gear > 0 else np.pi)

    def _spin(self, node: Hashable, before: float, after: float) -> float:
        """Return the price of turning on the spot at a node."""
        turn = float(wrap_angle(after - before))
        region = int(self._prices.class_at(self._places[node]))
        return float(self._prices.turning(0.0, turn, region, before))

    def _least_spin(
        self, node: Hashable, yaws: Sequence[float], yaw: float, *, leaving: bool
    ) -> tuple[float, float]:
        """Return the least price of turning from one of some yaws, or to one, and that yaw."""
        return min(
            ((self._spin(node, *((one, yaw) if leaving else (yaw, one))), one) for one in yaws),
            default=(0.0, yaw),
        )

    def _route(self, source: Hashable, targets: Sequence[Hashable], ends: _EndYaws) -> Route:
        """Return the motions from node to node, straight and with rounded corners."""
        first, last = ends
        states: list[DrivenEdge] = []
        if source not in targets:
            known = self.states

            def leave(state: DrivenEdge) -> float:
                spin = self._least_spin(source, first, self._yaw(state), leaving=True)[0]
                return spin + float(known.nodes[state]["cost"])

            def arrive(state: DrivenEdge) -> float:
                return self._least_spin(state.target, last, self._yaw(state), leaving=False)[0]

            states = _cheapest(known, source, targets, leave, arrive)
            if not states:
                raise NoPathError(self._nearest(source, targets))
        path = self._drive(source, states, first, last)
        nodes = (source, *(state.target for state in states))
        price = path_price(path, self.cost, self.surfaces)
        value = self._prices.value(price.energy, path.length, price.duration) + price.seconds
        return Route(nodes, tuple(states), path, price.energy, value)

    def _nearest(self, source: Hashable, targets: Sequence[Hashable]) -> str:
        """Return how near to the first target one gets, in words."""
        target = targets[0]
        first = [state for state in self.states if state.source == source]
        after = nx.multi_source_dijkstra_path_length(self.states, first) if first else {}
        goal = np.array(self._places[target])
        gap, near = min(
            (float(np.hypot(*(goal - self._places[node]))), k, node)
            for k, node in enumerate([source, *dict.fromkeys(s.target for s in after)])
        )[::2]
        (sx, sy), (gx, gy), (x, y) = self._places[source], goal, self._places[near]
        others = f" or any of {len(targets) - 1} other nodes" * (len(targets) > 1)
        return (
            f"no route leads from {source!r} at ({sx:.2f}, {sy:.2f}) to {target!r} at ({gx:.2f}, "
            f"{gy:.2f}){others}; the nearest node that is reached is {near!r} at ({x:.2f}, "
            f"{y:.2f}), {gap:.2f} m from there"
        )

    def _drive(
        self,
        source: Hashable,
        sequence: Sequence[DrivenEdge],
        first_yaws: Sequence[float],
        last_yaws: Sequence[float],
    ) -> Path:
        """Return the motions of a sequence of states, spins and arcs at its nodes included."""
        lon = self.cost.icr.longitudinal
        x, y = self._places[source]
        if sequence:
            first = self._yaw(sequence[0])
            start_yaw = self._least_spin(source, first_yaws, first, leaving=True)[1]
        else:
            turns = [(self._spin(source, one, two), one, two)
                     for one in first_yaws or last_yaws for two in last_yaws or [one]]  # fmt: skip
            _, start_yaw, first = min(turns, default=(0.0, 0.0, 0.0))
        start_x, start_y = point_ahead((x, y, start_yaw), -lon).tolist()
        moves = [(0.0, float(wrap_angle(first - start_yaw)))]
        yaw, cut = first, 0.0
        for k, state in enumerate(sequence):
            (ax, ay), (bx, by) = self._places[state.source], self._places[state.target]
            length = float(np.hypot(bx - ax, by - ay)) - cut
            if k + 1 == len(sequence):
                moves.append((state.gear * length, 0.0))
                break
            ahead = sequence[k + 1]
            radius = float(self.states[state][ahead]["radius"])
            turn = float(wrap_angle(self._yaw(ahead) - yaw))
            cut = radius * float(np.tan(0.5 * abs(turn))) if radius > 0 else 0.0
            moves += [
                (state.gear * (length - cut), 0.0),
                (state.gear * radius * abs(turn), turn),
            ]
            yaw = self._yaw(ahead)
        if sequence:
            end = self._least_spin(sequence[-1].target, last_yaws, yaw, leaving=False)[1]
            moves.append((0.0, float(wrap_angle(end - yaw))))
        ds, dtheta = np.array(moves).T
        keep = np.hypot(ds, dtheta) > 1e-12
        return Path(Pose(start_x, start_y, start_yaw), ds[keep], dtheta[keep], lon)


class ClosedEdge(NamedTuple):
    """An edge that no path was found for, and why."""

    source: Hashable
    target: Hashable
    reason: str


@dataclass(frozen=True, eq=False)
class PlannedGraph(_Routed[Path]):
    """A graph whose edges were planned among obstacles; those that are closed are left out."""

    paths: dict[DrivenEdge, Path]  # what is driven on each edge, by direction
    energies: dict[DrivenEdge, float]  # what that takes [J]
    turns: dict[tuple[DrivenEdge, DrivenEdge], float]  # [J]
    closed: tuple[ClosedEdge, ...]  # the edges that no path was found for
    problem: PlanningProblem  # whose robot, ground and objective hold

    def _route(self, source: Hashable, targets: Sequence[Hashable], ends: _EndYaws) -> Path:
        """Return the path along planned edges whose energies and turns add up to the least.

        Along them the robot passes each place at the heading that takes least: exact motions
        replace an edge and its turns where these are free and take less.
        """
        if source in targets:
            raise InvalidInputError(f"the route from {source!r} leads to itself; give two places")
        first, last = ends
        states: nx.DiGraph[DrivenEdge] = nx.DiGraph()
        states.add_nodes_from(self.energies)
        for (here, ahead), energy in self.turns.items():
            states.add_edge(here, ahead, weight=energy + self.energies[ahead])

        def leave(state: DrivenEdge) -> float:
            turn = _least_turn(self.problem, self.paths[state].start, first)
            return self.energies[state] + turn

        def arrive(state: DrivenEdge) -> float:
            return _least_turn(self.problem, self.paths[state].end, last)

        found = _cheapest(states, source, targets, leave, arrive)
        if not found:
            several = f" or {len(targets) - 1} others" * (len(targets) > 1)
            raise NoPathError(
                f"no route of edges that can be driven leads from {source!r} to {targets[0]!r}"
                f"{several}; {len(self.closed)} edges are closed"
            )
        return _through([self.paths[state] for state in found], self.problem, first, last)


def _least_turn(problem: PlanningProblem, pose: Pose, yaws: Sequence[float]) -> float:
    """Return the least energy of turning on the spot from a pose to one of some yaws.

    A turn from there takes the same, but for terms that read the direction of turning.
    """
    turns = (_motion(pose, 0.0, float(wrap_angle(yaw - pose.yaw)), problem.cost.icr.longitudinal)
             for yaw in yaws)  # fmt: skip
    return min((problem.terrain.price(turn, problem.cost).energy for turn in turns), default=0.0)


class _HeadingCosts(NamedTuple):
    """Ways between the headings at one place and those at the next."""

    cost: FloatArray  # (n, m)
    path: Callable[[int, int], Path]  # what is driven from one heading to another


def _through(
    paths: Sequence[Path], problem: PlanningProblem, first: Sequence[float], last: Sequence[float]
) -> Path:
    """Return the path along others that passes each place at the heading that costs least."""
    round_about = (np.arange(_HEADINGS) * (2.0 * np.pi / _HEADINGS)).tolist()
    yaws = [list(first) or [*round_about, paths[0].start.yaw]]
    for here, ahead in pairwise(paths):
        yaws.append([*round_about, here.end.yaw, ahead.start.yaw])
    yaws.append(list(last) or [*round_about, paths[-1].end.yaw])
    legs = [_leg(path, problem, *ends) for path, *ends in zip(paths, yaws, yaws[1:], strict=False)]
    # the least cost from each heading to the end, from the last leg on
    onward = [np.zeros(len(yaws[-1]))]
    for leg in reversed(legs):
        onward.insert(0, np.min(leg.cost + onward[0], axis=1))
    at = int(np.argmin(onward[0]))
    if onward[0][at] == inf:
        raise NoPathError(
            "at an end of the route the robot has no room to turn to the yaw that is given; give "
            "another yaw, or none"
        )
    parts = []
    for leg, rest in zip(legs, onward[1:], strict=True):
        to = int(np.argmin(leg.cost[at] + rest))
        parts.append(leg.path(at, to))
        at = to
    return reduce(add, parts)


def _leg(
    path: Path, problem: PlanningProblem, before: Sequence[float], after: Sequence[float]
) -> _HeadingCosts:
    """Return the ways along a path, or in its place, between headings at its two ends."""
    lon = path.longitudinal

    def turned(pose: Pose, yaw: float, *, back: bool) -> Path | None:
        """Return the turn on the spot from a pose to a yaw, or back, where it is free."""
        turn = float(wrap_angle(yaw - pose.yaw))
        away = _motion(pose, 0.0, turn, lon)
        if not problem.terrain.obstacles.path_free(away, problem.robot):
            return None
        return _motion(away.end, 0.0, -turn, lon) if back else away

    def value(part: Path | None) -> float:
        return inf if part is None else query.value(part)

    query = compiled(replace(problem, start=path.start, goal=path.end, goals=()))
    leaving = [turned(path.start, yaw, back=True) for yaw in before]
    arriving = [turned(path.end, yaw, back=False) for yaw in after]
    cost = np.add.outer([value(part) for part in leaving], [value(part) for part in arriving])
    cost += query.value(path)
    centres = [
        np.array([query.centre(_at(pose, yaw, lon)) for yaw in yaws])
        for pose, yaws in ((path.start, before), (path.end, after))
    ]
    least = least_costs(query, *centres) + query.potential(path.end)
    motions: dict[tuple[int, int], Segments] = {}
    for i, j in np.argwhere(least < cost).tolist():
        found, price = joined(query.setting, Pose(*centres[0][i]), Pose(*centres[1][j]))
        price += query.potential(path.end)
        if price < cost[i, j] * (1.0 - ROUNDING):
            cost[i, j] = price
            motions[i, j] = found

    def driven(i: int, j: int) -> Path:
        if (i, j) in motions:
            moved = query.reference(*merged(motions[i, j]))
            return Path(_at(path.start, before[i], lon), moved.ds, moved.dtheta, lon)
        parts = [part for part in (leaving[i], path, arriving[j]) if part is not None]
        return reduce(add, [part for part in parts if part.dtheta.any() or part.ds.any()])

    return _HeadingCosts(cost, driven)


def _at(pose: Pose, yaw: float, longitudinal: float) -> Pose:
    """Return the pose that turning a pose on the spot to a yaw leads to."""
    x, y = point_ahead(pose, longitudinal)
    c, s = np.cos(yaw), np.sin(yaw)
    return Pose(float(x - longitudinal * c), float(y - longitudinal * s), yaw)


def plan_edges(graph: Graph, problem: PlanningProblem, *, effort: int = EFFORT) -> PlannedGraph:
    """Plan every edge of a graph among obstacles."""
    edges = edges_of(graph, reverse=False)
    compile_planning(problem, tight=True)
    paths: dict[DrivenEdge, Path] = {}
    energies: dict[DrivenEdge, float] = {}
    closed = []
    longitudinal = problem.cost.icr.longitudinal
    for state, start, yaw, length in zip(
        edges.states, edges.start, edges.heading.tolist(), edges.length.tolist(), strict=True
    ):
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        x, y = (start - longitudinal * ahead).tolist()
        ends = Pose(x, y, yaw), Pose(x + length * ahead[0], y + length * ahead[1], yaw)
        asked = replace(problem, start=ends[0], goal=ends[1], goals=())
        try:
            asked.check_poses()
            known = [_motion(ends[0], length, 0.0, longitudinal)]
            bound = compiled(asked).least_in_free_space
            path = lattice.plan(asked, Budget(effort=effort), initial=known, bound=bound).path
        except (
            NoPathError, TimeLimitError, StartInCollisionError, GoalInCollisionError,
            OutsideMapError,
        ) as error:  # fmt: skip
            closed.append(ClosedEdge(state.source, state.target, str(error)))
            continue
        paths[state] = path
        energies[state] = problem.terrain.price(path, problem.cost).energy
    turns = _turns(paths, problem)
    after: dict[DrivenEdge, list[float]] = {}
    for (here, ahead_of_it), energy in turns.items():
        # who turns back where there is another way has come in vain
        if ahead_of_it.target != here.source:
            after.setdefault(here, []).append(energy)
    costs = {
        state: energies.get(state, inf) + float(np.mean(after.get(state, [0.0])))
        for state in edges.states
    }
    return PlannedGraph(_with_costs(graph, costs), paths, energies, turns, tuple(closed), problem)


def _motion(start: Pose, ds: float, turn: float, longitudinal: float) -> Path:
    """Return a path of a single motion."""
    return Path(start, np.array([ds]), np.array([turn]), longitudinal)


def _turns(
    paths: dict[DrivenEdge, Path], problem: PlanningProblem
) -> dict[tuple[DrivenEdge, DrivenEdge], float]:
    """Return what turns on the spot from each edge to those that may follow take, where free."""
    leaving: dict[Hashable, list[DrivenEdge]] = {}
    for state in paths:
        leaving.setdefault(state.source, []).append(state)
    found = {}
    for here, path in paths.items():
        for ahead in leaving.get(here.target, []):
            turn = float(wrap_angle(paths[ahead].start.yaw - path.end.yaw))
            spin = _motion(path.end, 0.0, turn, path.longitudinal)
            if problem.terrain.obstacles.path_free(spin, problem.robot):
                found[here, ahead] = problem.terrain.price(spin, problem.cost).energy
    return found
