"""Graphs of places whose edges are planned among obstacles, with the turns between them.

For Nav2's route server and most roadmaps, an edge is the straight line between its places. Among
obstacles it is the path of a planner from one place to the other, at both in the direction of the
edge. The cost of a turn at a place depends on where the robot comes from and goes to. A route
includes each turn. The cost of an edge includes the mean of the turns that may follow it.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import NamedTuple

import networkx as nx
import numpy as np

from energyplan.errors import (
    GoalInCollisionError,
    InvalidInputError,
    NoPathError,
    OutsideMapError,
    StartInCollisionError,
    TimeLimitError,
)
from energyplan.path import Path, Pose, wrap_angle
from energyplan.planning.budget import Budget
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.ready import compile_planning
from energyplan.planning.roadmap.routes import Graph, State, edges_of
from energyplan.planning.search import planner as lattice
from energyplan.planning.space.compiled import compiled

EFFORT = 4000
"""Units of work for each edge."""


class ClosedEdge(NamedTuple):
    """An edge that no path was found for, and why."""

    source: Hashable
    target: Hashable
    reason: str


@dataclass(frozen=True, eq=False)
class PlannedGraph:
    """A graph whose edges were planned among obstacles."""

    graph: Graph  # the graph less the edges that are closed [J]
    paths: dict[State, Path]  # what is driven on each edge, by direction
    energies: dict[State, float]  # what that takes [J]
    turns: dict[tuple[State, State], float]  # [J]
    closed: tuple[ClosedEdge, ...]  # the edges that no path was found for

    def route(self, source: Hashable, target: Hashable) -> Path:
        """Return the path of least energy along planned edges, turns at the places included."""
        for node in (source, target):
            if node not in self.graph:
                raise InvalidInputError(f"node {node!r} is not in the graph")
        if source == target:
            raise InvalidInputError(f"the route from {source!r} leads to itself; give two places")
        states: nx.DiGraph[Hashable] = nx.DiGraph()
        states.add_nodes_from(["start", "goal"])
        for state, energy in self.energies.items():
            if state.source == source:
                states.add_edge("start", state, weight=energy)
            if state.target == target:
                states.add_edge(state, "goal", weight=0.0)
        for (here, ahead), energy in self.turns.items():
            states.add_edge(here, ahead, weight=energy + self.energies[ahead])
        try:
            found = nx.dijkstra_path(states, "start", "goal")
        except nx.NetworkXNoPath:
            raise NoPathError(
                f"no route of edges that can be driven leads from {source!r} to {target!r}; "
                f"{len(self.closed)} edges are closed"
            ) from None
        whole, *others = [self.paths[state] for state in found if isinstance(state, State)]
        for leg in others:
            turn = float(wrap_angle(leg.start.yaw - whole.end.yaw))
            if turn != 0.0:
                whole = whole + _motion(whole.end, 0.0, turn, whole.longitudinal)
            whole = whole + leg
        return whole


def plan_edges(graph: Graph, problem: PlanningProblem, *, effort: int = EFFORT) -> PlannedGraph:
    """Plan every edge of a graph among obstacles."""
    edges = edges_of(graph, reverse=False)
    compile_planning(problem, tight=True)
    paths: dict[State, Path] = {}
    energies: dict[State, float] = {}
    closed = []
    longitudinal = problem.cost.icr.longitudinal
    for state, start, yaw, length in zip(
        edges.states, edges.start, edges.heading.tolist(), edges.length.tolist(), strict=True
    ):
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        x, y = (start - longitudinal * ahead).tolist()
        ends = Pose(x, y, yaw), Pose(x + length * ahead[0], y + length * ahead[1], yaw)
        asked = replace(problem, start=ends[0], goal=ends[1])
        try:
            asked.check_poses()
            path = _planned(asked, effort)
        except (
            NoPathError, TimeLimitError, StartInCollisionError, GoalInCollisionError,
            OutsideMapError,
        ) as error:  # fmt: skip
            closed.append(ClosedEdge(state.source, state.target, str(error)))
            continue
        paths[state] = path
        energies[state] = problem.terrain.price(path, problem.cost).energy
    turns = _turns(paths, problem)
    return PlannedGraph(
        _priced(graph, edges.states, energies, turns), paths, energies, turns, tuple(closed)
    )


def _planned(problem: PlanningProblem, effort: int) -> Path:
    """Return the path of least cost between two poses."""
    query = compiled(problem)
    length = float(np.hypot(*np.subtract(problem.goal[:2], problem.start[:2])))
    straight = _motion(problem.start, length, 0.0, problem.cost.icr.longitudinal)
    known = query.drivable([straight])
    bound = query.least_in_free_space
    return lattice.plan(problem, Budget(effort=effort), initial=known, bound=bound).path


def _motion(start: Pose, ds: float, turn: float, longitudinal: float) -> Path:
    """Return a path of a single motion."""
    return Path(start, np.array([ds]), np.array([turn]), longitudinal)


def _turns(paths: dict[State, Path], problem: PlanningProblem) -> dict[tuple[State, State], float]:
    """Return what turns on the spot from each edge to those that may follow take, where free."""
    leaving: dict[Hashable, list[State]] = {}
    for state in paths:
        leaving.setdefault(state.source, []).append(state)
    found = {}
    grid = problem.terrain.obstacles
    for here, path in paths.items():
        for ahead in leaving.get(here.target, []):
            turn = float(wrap_angle(paths[ahead].start.yaw - path.end.yaw))
            spin = _motion(path.end, 0.0, turn, path.longitudinal)
            if grid.path_free(spin, problem.robot):
                price = problem.terrain.price(spin, problem.cost) if turn else None
                found[here, ahead] = 0.0 if price is None else price.energy
    return found


def _priced(
    graph: Graph,
    states: tuple[State, ...],
    energies: dict[State, float],
    turns: dict[tuple[State, State], float],
) -> Graph:
    """Return a copy of a graph with the cost of its edges, less those that are closed."""
    priced = graph.copy()
    after: dict[State, list[float]] = {}
    for (here, ahead), energy in turns.items():
        # who turns back where there is another way has come in vain
        if ahead.target != here.source:
            after.setdefault(here, []).append(energy)
    for state in states:
        place = (state.source, state.target)
        edge = (*place, state.key) if graph.is_multigraph() else place
        if not priced.has_edge(*edge):
            continue
        if state not in energies:
            priced.remove_edge(*edge)
            continue
        cost = energies[state] + float(np.mean(after.get(state, [0.0])))
        data = priced.edges[edge]
        data["cost"] = max(cost, data["cost"]) if data.get("_planned") else cost
        data["_planned"] = True
    for *_, data in priced.edges(data=True):
        data.pop("_planned", None)
    return priced
