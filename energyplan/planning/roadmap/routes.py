"""Routes of least energy on a graph of places: the search, and the motions along it."""

from __future__ import annotations

from collections.abc import Container, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import networkx as nx
import numpy as np

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError
from energyplan.path import Path, Pose, point_ahead, wrap_angle
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.roadmap.energy_graph import Graph, State, energy_graph, positions
from energyplan.planning.scene.prices import Prices
from energyplan.terrain import SurfaceMap, path_price

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
