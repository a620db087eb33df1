"""Assignments of many tasks by OR-Tools' routing solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from energyplan.fleet.exact import Solution, best_tour
from energyplan.fleet.problem import RobotProblem, run
from energyplan.mission.routing import constraint_solver
from energyplan.path import FloatArray

_FAR = 10**10
"""Stands for an infinite energy or time in the solver's integers."""

_POLISHED = 8
"""Most tasks of a robot whose order is found exactly."""

_UNITS = 1e6
"""Whole units that the largest battery is counted in."""

_TICK = 0.1
"""Unit of time of the solver [s]."""


def solve_by_search(
    problems: Sequence[RobotProblem],
    worth: FloatArray,
    places: Sequence[int],
    *,
    time_limit: float = 10.0,
    effort: int | None = None,
) -> Solution:
    """Find a good assignment by guided local search.

    Each charger may be used by every robot once; that they share it is looked at afterwards.
    """
    solver = constraint_solver("a fleet of many robots or tasks")
    rough = _Search(problems, worth, *solver).run(time_limit, effort)
    sequences = _polished(problems, worth, rough)
    n = len(worth)
    done = [stop - 1 for stops in sequences for stop in stops if stop <= n]
    told = run(problems, sequences, places)
    energy = float("inf") if told is None else told.energy
    return Solution(sequences, float(worth[done].sum()), energy, -np.inf, False)


def _polished(
    problems: Sequence[RobotProblem], worth: FloatArray, rough: tuple[tuple[int, ...], ...]
) -> tuple[tuple[int, ...], ...]:
    """Give tasks that were left out to whom they cost least; order each robot's own exactly."""
    n = len(worth)
    tours = [(np.inf, stops) for stops in rough]
    mine = [[stop - 1 for stop in stops if stop <= n] for stops in rough]
    for r, problem in enumerate(problems):
        if len(mine[r]) <= _POLISHED:
            better = best_tour(problem, mine[r])
            tours[r] = better if np.isfinite(better[0]) else tours[r]
    rest = [k for k in range(n) if not any(k in tasks for tasks in mine)]
    for task in sorted(rest, key=lambda k: -float(worth[k])):
        best = (np.inf, 0, tours[0])
        for r, problem in enumerate(problems):
            if np.isfinite(tours[r][0]) and len(mine[r]) < _POLISHED:
                grown = best_tour(problem, [*mine[r], task])
                best = min(best, (grown[0] - tours[r][0], r, grown))
        if np.isfinite(best[0]):
            tours[best[1]] = best[2]
            mine[best[1]].append(task)
    return tuple(stops for _, stops in tours)


class _Search:
    """Nodes: a start and an end for each robot, the tasks, and each charger once a robot."""

    def __init__(
        self, problems: Sequence[RobotProblem], worth: FloatArray, solver: Any, enums: Any
    ) -> None:
        self._problems, self._worth, self._solver, self._enums = problems, worth, solver, enums
        robots, n = len(problems), problems[0].tasks
        chargers = len(problems[0].capacity)
        # the place of each of the solver's nodes in the problems
        self._place = [
            *range(1, 1 + n),
            *(1 + n + c for c in range(chargers) for _ in range(robots)),
        ]
        self._starts = [len(self._place) + r for r in range(robots)]
        self._ends = [len(self._place) + robots + r for r in range(robots)]
        self._size = len(self._place) + 2 * robots
        # whole numbers: fine enough for any battery
        self._unit = max(max(p.budget, *p.capacity, 1e-9) for p in problems) / _UNITS

    def run(self, time_limit: float, effort: int | None) -> tuple[tuple[int, ...], ...]:
        problems, n = self._problems, self._problems[0].tasks
        manager = self._solver.RoutingIndexManager(
            self._size, len(problems), self._starts, self._ends
        )
        routing = self._solver.RoutingModel(manager)
        energies = [self._matrix(r, p) for r, p in enumerate(problems)]
        times = [self._times(r, p) for r, p in enumerate(problems)]
        priced = [routing.RegisterTransitMatrix(m.tolist()) for m in energies]
        for r, one in enumerate(priced):
            routing.SetArcCostEvaluatorOfVehicle(one, r)
        drawn = [routing.RegisterTransitMatrix((-m).tolist()) for m in energies]
        self._hold_charge(routing, manager, drawn)
        if any(problem.timed for problem in problems):
            self._keep_windows(
                routing, manager, [routing.RegisterTransitMatrix(m.tolist()) for m in times]
            )
        finite = [float(m[m < _FAR].max(initial=1)) for m in energies]
        scale = max(finite) * (n + 1)
        for k, worth in enumerate(self._worth):
            able = [r for r, p in enumerate(problems) if np.isfinite(p.energy[:, k + 1]).any()]
            index = manager.NodeToIndex(k)
            routing.AddDisjunction([index], min(round(scale * float(worth)) + 1, 2**55))
            if len(able) < len(problems):
                routing.VehicleVar(index).SetValues([-1, *able])
        for node in range(n, len(self._place)):
            routing.AddDisjunction([manager.NodeToIndex(node)], 0)
        options = self._solver.DefaultRoutingSearchParameters()
        first = self._enums.FirstSolutionStrategy
        options.first_solution_strategy = first.PARALLEL_CHEAPEST_INSERTION
        local = self._enums.LocalSearchMetaheuristic
        options.local_search_metaheuristic = local.GUIDED_LOCAL_SEARCH
        if effort is None:
            options.time_limit.FromMilliseconds(int(1000 * time_limit))
        else:
            options.solution_limit = max(effort, 1)
        found = routing.SolveWithParameters(options)
        if found is None:
            return ((),) * len(problems)
        return tuple(self._stops(routing, manager, found, r) for r in range(len(problems)))

    def _stops(self, routing: Any, manager: Any, found: Any, robot: int) -> tuple[int, ...]:
        stops: list[int] = []
        index = found.Value(routing.NextVar(routing.Start(robot)))
        while not routing.IsEnd(index):
            place = self._place[manager.IndexToNode(index)]
            if place not in stops[-1:]:  # who is at a charger need not come to it again
                stops.append(place)
            index = found.Value(routing.NextVar(index))
        return tuple(stops)

    def _matrix(self, robot: int, problem: RobotProblem) -> np.ndarray:
        """Energy between the solver's nodes, with that of the task that one of them leaves."""
        service = np.concatenate([[0.0], problem.service, np.zeros(len(problem.capacity))])
        spent = problem.energy + service[:, None]
        return self._spread(robot, spent / self._unit, (problem.finish + service) / self._unit)

    def _times(self, robot: int, problem: RobotProblem) -> np.ndarray:
        # charging takes the time of a full charge
        stay = np.concatenate(
            [[0.0], problem.service_time, problem.capacity / problem.charge_power]
        )
        between = problem.time + stay[:, None]
        return self._spread(robot, between / _TICK, (problem.finish_time + stay) / _TICK)

    def _spread(self, robot: int, between: FloatArray, finish: FloatArray) -> np.ndarray:
        values = np.full((self._size, self._size), np.inf)
        inner = np.array(self._place)
        k = len(inner)
        values[:k, :k] = between[np.ix_(inner, inner)]
        values[self._starts[robot], :k] = between[0, inner]
        values[:k, self._ends[robot]] = finish[inner]
        values[self._starts[robot], self._ends[robot]] = finish[0]
        values[np.arange(self._size), np.arange(self._size)] = 0.0
        # rounded up, so that what fits the solver fits in truth
        whole = np.ceil(np.clip(values, 0.0, _FAR))
        return np.asarray(np.where(np.isfinite(values), whole, _FAR).astype(np.int64))

    def _hold_charge(self, routing: Any, manager: Any, drawn: list[int]) -> None:
        """Keep each robot's charge between nothing and its greatest; chargers fill it up."""
        n = self._problems[0].tasks
        most = int(_UNITS) + 1
        routing.AddDimensionWithVehicleTransits(drawn, most, most, False, "charge")
        charge = routing.GetDimensionOrDie("charge")
        for r, problem in enumerate(self._problems):
            start = routing.Start(r)
            charge.CumulVar(start).SetValue(int(max(problem.budget, 0.0) / self._unit))
            charge.SlackVar(start).SetValue(0)
        for k in range(n):
            charge.SlackVar(manager.NodeToIndex(k)).SetValue(0)
        solver = routing.solver()
        for node in range(n, len(self._place)):
            index = manager.NodeToIndex(node)
            charger = self._place[node] - 1 - n
            full = [int(max(p.capacity[charger], 0.0) / self._unit) for p in self._problems]
            filled = charge.CumulVar(index) + charge.SlackVar(index)
            if len(set(full)) == 1:
                solver.Add(filled <= full[0])
            else:  # a node that is left out belongs to no robot
                solver.Add(
                    filled <= solver.Element([*full, most], _owner(solver, routing, index, full))
                )

    def _keep_windows(self, routing: Any, manager: Any, transits: list[int]) -> None:
        routing.AddDimensionWithVehicleTransits(transits, _FAR, 2 * _FAR, False, "time")
        clock = routing.GetDimensionOrDie("time")
        for r, problem in enumerate(self._problems):
            clock.CumulVar(routing.Start(r)).SetValue(int(np.ceil(problem.start_time / _TICK)))
        for k, (earliest, latest) in enumerate(self._problems[0].window):
            clock.CumulVar(manager.NodeToIndex(k)).SetRange(
                int(np.ceil(earliest / _TICK)), int(min(latest / _TICK, _FAR))
            )


def _owner(solver: Any, routing: Any, index: int, full: list[int]) -> Any:
    """Return the robot at a node, as a place in a list with one more entry for none."""
    vehicle = routing.VehicleVar(index)
    return solver.ConditionalExpression(vehicle >= 0, vehicle, len(full)).Var()
