"""Orders of many tasks by OR-Tools' routing solver."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from energyplan.errors import MissingDependencyError
from energyplan.mission.order import Order, OrderProblem

_FAR = 10**12
"""Stands for an infinite energy or time in the solver's integers."""


_SOLUTION = 50
"""Units of work that an order which the search accepts counts as."""


def solve_by_search(
    problem: OrderProblem,
    *,
    time_limit: float = 10.0,
    effort: int | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Order:
    """Find a good order by guided local search.

    Energies are taken at the payload of the start; charging takes the time of a full charge.
    """
    solver = constraint_solver("a free order of many tasks")
    return _Search(problem, *solver).run(time_limit, effort, progress)


def constraint_solver(what: str) -> tuple[Any, Any]:
    """Return OR-Tools' routing solver and its enumerations."""
    try:
        from ortools.constraint_solver import pywrapcp, routing_enums_pb2
    except ImportError as error:
        raise MissingDependencyError(
            f"{what} needs OR-Tools; install energyplan[orienteering]"
        ) from error
    return pywrapcp, routing_enums_pb2


class _Search:
    """The problem in the solver's terms: node 0 start, tasks, chargers, last node the end."""

    def __init__(self, problem: OrderProblem, solver: Any, enums: Any) -> None:
        self._problem = problem
        self._enums = enums
        n, chargers = problem.tasks, len(problem.capacity)
        self._end = 1 + n + chargers
        self._solver = solver
        mean = problem.payload + 0.5 * float(problem.payload_change.sum())
        energy, finish = problem.energy(mean), problem.finish(mean)
        nodes = slice(0, self._end)
        service = np.concatenate([[0.0], problem.service, np.zeros(chargers)])
        spent = np.vstack(
            [np.column_stack([energy[nodes, nodes], finish[nodes]]), np.full(self._end + 1, np.inf)]
        )
        spent[:, :-1] += service
        self.spent = _whole(spent)
        stay = np.concatenate([[0.0], problem.service_time, self._charge_times()])
        times = np.column_stack([problem.time[nodes, nodes], problem.finish_time[nodes]])
        self.times = _whole(np.vstack([times + stay[:, None], np.zeros(self._end + 1)]))

    def _charge_times(self) -> np.ndarray:
        return np.asarray(self._problem.capacity / self._problem.charge_power)

    def run(
        self,
        time_limit: float,
        effort: int | None,
        progress: Callable[[float, float], None] | None,
    ) -> Order:
        problem, n = self._problem, self._problem.tasks
        manager = self._solver.RoutingIndexManager(self._end + 1, 1, [0], [self._end])
        routing = self._solver.RoutingModel(manager)
        spent, times = self.spent.tolist(), self.times.tolist()

        def cost(i: int, j: int) -> int:
            return int(spent[manager.IndexToNode(i)][manager.IndexToNode(j)])

        def duration(i: int, j: int) -> int:
            return int(times[manager.IndexToNode(i)][manager.IndexToNode(j)])

        priced = routing.RegisterTransitCallback(cost)
        routing.SetArcCostEvaluatorOfAllVehicles(priced)
        self._hold_charge(
            routing, manager, routing.RegisterTransitCallback(lambda i, j: -cost(i, j))
        )
        self._keep_windows(routing, manager, routing.RegisterTransitCallback(duration))
        scale = float(self.spent[self.spent < _FAR].max()) * (n + len(problem.capacity) + 1)
        for k, worth in enumerate(problem.worth):
            penalty = min(round(scale * worth) + 1, 2**60)
            routing.AddDisjunction([manager.NodeToIndex(k + 1)], penalty)
        for charger in range(n + 1, self._end):
            routing.AddDisjunction([manager.NodeToIndex(charger)], 0)
        begun = time.perf_counter()
        if progress is not None:
            routing.AddAtSolutionCallback(
                lambda: progress(time.perf_counter() - begun, float(routing.CostVar().Max()))
            )
        options = self._solver.DefaultRoutingSearchParameters()
        options.first_solution_strategy = (
            self._enums.FirstSolutionStrategy.PARALLEL_CHEAPEST_INSERTION
        )
        options.local_search_metaheuristic = (
            self._enums.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
        )
        if effort is None:
            options.time_limit.FromMilliseconds(int(1000 * time_limit))
        else:
            options.solution_limit = max(effort // _SOLUTION, 1)
        found = routing.SolveWithParameters(options)
        if found is None:
            return Order((), 0.0, 0.0, False)
        stops, index, energy = [], routing.Start(0), 0.0
        while not routing.IsEnd(index):
            after = found.Value(routing.NextVar(index))
            energy += cost(index, after)
            node = manager.IndexToNode(after)
            if node != self._end:
                stops.append(int(node))
            index = after
        prize = float(sum(problem.prize[s - 1] for s in stops if s <= n))
        return Order(tuple(stops), prize, energy, False)

    def _hold_charge(self, routing: Any, manager: Any, transit: int) -> None:
        """Keep the charge between nothing and its greatest; chargers fill it up."""
        problem = self._problem
        most = int(max(problem.budget, *problem.capacity, 0.0))
        routing.AddDimension(transit, most, most, False, "charge")
        charge = routing.GetDimensionOrDie("charge")
        charge.CumulVar(routing.Start(0)).SetValue(int(max(problem.budget, 0.0)))
        for k in range(problem.tasks + 1):
            charge.SlackVar(manager.NodeToIndex(k) if k else routing.Start(0)).SetValue(0)
        for c, full in enumerate(problem.capacity):
            node = manager.NodeToIndex(problem.tasks + 1 + c)
            filled = charge.CumulVar(node) + charge.SlackVar(node)
            routing.solver().Add(filled <= max(int(full), 0))

    def _keep_windows(self, routing: Any, manager: Any, transit: int) -> None:
        problem = self._problem
        routing.AddDimension(transit, _FAR, _FAR, False, "time")
        clock = routing.GetDimensionOrDie("time")
        clock.CumulVar(routing.Start(0)).SetValue(int(problem.start_time))
        for k, (earliest, latest) in enumerate(problem.window):
            clock.CumulVar(manager.NodeToIndex(k + 1)).SetRange(
                int(np.ceil(earliest)), int(min(latest, _FAR))
            )


def _whole(values: np.ndarray) -> np.ndarray:
    """Round up to whole joules or seconds, so that what fits the solver fits in truth."""
    return np.where(np.isfinite(values), np.ceil(np.minimum(values, _FAR)), _FAR).astype(np.int64)
