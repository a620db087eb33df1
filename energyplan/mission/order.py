"""The best order and subset of tasks on an energy matrix: prizes against a budget.

The answer is exact for few tasks: labels (charge left, energy, time) over every subset and last
stop, of which only those that no other one dominates are kept (the dynamic programme of Held and
Karp, with resources). Where neither chargers nor windows matter one label a subset and stop is
enough, so that more tasks are exact (`exact_size`). Beyond that OR-Tools searches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.path import FloatArray

EXACT_PLAIN, EXACT_LABELLED = 15, 10
"""Largest numbers of tasks that are solved exactly: without and with chargers or windows."""


@dataclass(frozen=True)
class OrderProblem:
    """Which tasks to do in which order.

    Node 0 is the start, nodes 1 to n the tasks, the others the chargers.

    Parameters
    ----------
    energy : callable
        Matrix of the energy from node to node [J] for a payload [kg], shape (N, N); infinite
        where there is no way.
    finish : callable
        Energy from each node to the nearest place where the mission may end [J], for a payload,
        shape (N,).
    time : ndarray, shape (N, N)
        Travel times [s].
    finish_time : ndarray, shape (N,)
        Time from each node to that place [s].
    service, service_time : ndarray, shape (n,)
        Energy [J] and time [s] that each task takes.
    payload : float
        Payload at the start [kg].
    payload_change : ndarray, shape (n,)
        Change of the payload by each task [kg].
    prize : ndarray, shape (n,)
        Prizes.
    required : ndarray of bool, shape (n,)
        Tasks that must be done.
    window : ndarray, shape (n, 2)
        Earliest and latest start of each task [s].
    budget : float
        Energy at the start, the reserve taken off [J].
    capacity : ndarray, shape (m,)
        Energy on leaving each charger, the reserve taken off [J].
    charge_power : ndarray, shape (m,)
        Energy stored per second at each charger [W].
    start_time : float
        Time at the start [s].
    """

    energy: Callable[[float], FloatArray]
    finish: Callable[[float], FloatArray]
    time: FloatArray
    finish_time: FloatArray
    service: FloatArray
    service_time: FloatArray
    payload: float
    payload_change: FloatArray
    prize: FloatArray
    required: np.ndarray
    window: FloatArray
    budget: float
    capacity: FloatArray
    charge_power: FloatArray
    start_time: float = 0.0

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.prize)

    @property
    def labelled(self) -> bool:
        """Whether charge and time decide beside energy, so that several labels may be needed."""
        timed = np.any(np.isfinite(self.window[:, 1])) or np.any(self.window[:, 0] > 0)
        return bool(timed or len(self.capacity))

    @property
    def worth(self) -> FloatArray:
        """Prizes, with those of required tasks above the sum of all others."""
        return self.prize + np.where(self.required, 1.0 + self.prize.sum(), 0.0)


@dataclass(frozen=True)
class Order:
    """An order: nodes in the sequence of their visits, start and end left out.

    Parameters
    ----------
    stops : tuple of int
        Nodes.
    prize : float
        Sum of the prizes of the tasks among them.
    energy : float
        Energy of the whole tour [J].
    proven : bool
        Whether no better order exists.
    """

    stops: tuple[int, ...]
    prize: float
    energy: float
    proven: bool


def exact_size(labelled: bool) -> int:
    """Return the largest number of tasks that is solved exactly."""
    return EXACT_LABELLED if labelled else EXACT_PLAIN


class _Label(NamedTuple):
    left: float
    energy: float
    time: float
    stops: tuple[int, ...]


def solve(
    problem: OrderProblem,
    *,
    time_limit: float = 10.0,
    effort: int | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Order:
    """Find the order of greatest worth, and of least energy among those.

    Parameters
    ----------
    problem : OrderProblem
        The problem.
    time_limit : float
        Time for the search where there are too many tasks for an exact answer [s].
    effort : int, optional
        Units of work for that search, in place of the time; see `energyplan.Budget`.
    progress : callable, optional
        Called with the seconds that have passed and the energy of the best order so far.

    Returns
    -------
    Order
        The order; required tasks come before any prize, and are left out only where they do not
        fit.

    Raises
    ------
    MissingDependencyError
        If there are too many tasks for an exact answer and OR-Tools is not installed.
    """
    if problem.tasks <= exact_size(problem.labelled):
        return solve_exactly(problem) if problem.labelled else solve_plainly(problem)
    from energyplan.mission.routing import solve_by_search

    return solve_by_search(problem, time_limit=time_limit, effort=effort, progress=progress)


def solve_exactly(problem: OrderProblem) -> Order:
    """Find the best order by dynamic programming over subsets.

    Parameters
    ----------
    problem : OrderProblem
        The problem.

    Returns
    -------
    Order
        The best order; proven.
    """
    n = problem.tasks
    timed = bool(np.any(np.isfinite(problem.window[:, 1])) or np.any(problem.window[:, 0] > 0))
    layers: dict[int, dict[int, list[_Label]]] = {
        0: {0: [_Label(problem.budget, 0.0, problem.start_time, ())]}
    }
    worth = problem.worth
    best = Order((), 0.0, 0.0, True)
    best_worth, best_key = -1.0, (np.inf, np.inf)
    for mask in sorted(range(2**n), key=lambda m: (m.bit_count(), m)):
        here = layers.pop(mask, None)
        if here is None:
            continue
        done = [k for k in range(n) if mask >> k & 1]
        load = problem.payload + float(problem.payload_change[done].sum())
        matrix, finish = problem.energy(load), problem.finish(load)
        pending = [(node, label) for node, labels in here.items() for label in labels]
        while pending:  # chargers may lead to chargers
            node, label = pending.pop()
            for charger in _charged(problem, matrix, node, label):
                place = charger.stops[-1]
                if _keep(here.setdefault(place, []), charger, timed):
                    pending.append((place, charger))
        value = float(worth[done].sum())
        for node, labels in here.items():
            for label in labels:
                total = label.energy + finish[node]
                key = (total, label.time + problem.finish_time[node])
                if finish[node] <= label.left and (-value, *key) < (-best_worth, *best_key):
                    best_worth, best_key = value, key
                    best = Order(label.stops, float(problem.prize[done].sum()), float(total), True)
                for k in range(n):
                    if mask >> k & 1:
                        continue
                    grown = _served(problem, matrix, load, node, label, k)
                    if grown is not None:
                        layer = layers.setdefault(mask | 1 << k, {})
                        _keep(layer.setdefault(k + 1, []), grown, timed)
    return best


def _served(
    problem: OrderProblem, matrix: FloatArray, load: float, node: int, label: _Label, k: int
) -> _Label | None:
    spent = float(matrix[node, k + 1] + problem.service[k])
    arrival = label.time + float(problem.time[node, k + 1])
    earliest, latest = problem.window[k]
    if spent > label.left or arrival > latest or load + problem.payload_change[k] < -1e-3:
        return None
    begin = max(arrival, float(earliest))
    return _Label(
        label.left - spent,
        label.energy + spent,
        begin + float(problem.service_time[k]),
        (*label.stops, k + 1),
    )


def _charged(problem: OrderProblem, matrix: FloatArray, node: int, label: _Label) -> list[_Label]:
    first = problem.tasks + 1
    grown = []
    for c in range(len(problem.capacity)):
        spent = float(matrix[node, first + c])
        if node == first + c or spent > label.left:
            continue
        left = label.left - spent
        full = max(left, float(problem.capacity[c]))
        arrival = label.time + float(problem.time[node, first + c])
        ready = arrival + (full - left) / float(problem.charge_power[c])
        grown.append(_Label(full, label.energy + spent, ready, (*label.stops, first + c)))
    return grown


def _keep(labels: list[_Label], new: _Label, timed: bool) -> bool:
    """Add a label unless another is as good in every respect; drop those that it beats."""

    def as_good(a: _Label, b: _Label) -> bool:
        return a.left >= b.left and a.energy <= b.energy and (not timed or a.time <= b.time)

    if any(as_good(old, new) for old in labels):
        return False
    labels[:] = [old for old in labels if not as_good(new, old)]
    labels.append(new)
    return True


def solve_plainly(problem: OrderProblem) -> Order:
    """Find the best order where energy alone decides: without chargers and windows.

    Parameters
    ----------
    problem : OrderProblem
        The problem.

    Returns
    -------
    Order
        The best order; proven.
    """
    n = problem.tasks
    masks = np.arange(2**n)
    least = np.full((2**n, n), np.inf)  # energy of having done a subset, by its last task
    before = np.full((2**n, n), -1, np.int8)
    # of two ways to do the same the one of less energy leaves more charge, so one label suffices
    loads = problem.payload + (masks[:, None] >> np.arange(n) & 1) @ problem.payload_change
    known: dict[float, tuple[FloatArray, FloatArray]] = {}

    def at(mask: int) -> tuple[FloatArray, FloatArray]:
        load = float(loads[mask])
        if load not in known:
            known[load] = problem.energy(load), problem.finish(load)
        return known[load]

    best, best_worth, best_energy = (0, -1), 0.0, float(at(0)[1][0])
    worth = problem.worth
    feasible = best_energy <= problem.budget
    if not feasible:
        best_worth, best_energy = -1.0, np.inf
    for mask in range(2**n):
        here = least[mask]
        if mask and not np.isfinite(here).any():
            continue
        matrix, finish = at(mask)
        if mask:
            total = here + finish[1 : n + 1]
            last = int(np.argmin(total))
            value = float(worth[(mask >> np.arange(n) & 1).astype(bool)].sum())
            if total[last] <= problem.budget and (-value, total[last]) < (-best_worth, best_energy):
                best, best_worth, best_energy = (mask, last), value, float(total[last])
            ways = here[:, None] + matrix[1 : n + 1, 1 : n + 1]
            came = np.argmin(ways, axis=0)
            reached = ways[came, np.arange(n)]
        else:
            came, reached = np.full(n, -1), matrix[0, 1 : n + 1]
        reached = reached + problem.service
        light = loads[mask] + problem.payload_change < -1e-3
        free = (mask >> np.arange(n) & 1 == 0) & ~light & (reached <= problem.budget)
        (k,) = np.nonzero(free)
        grown = mask | 1 << k
        better = reached[k] < least[grown, k]
        k, grown = k[better], grown[better]
        least[grown, k], before[grown, k] = reached[k], came[k]
    if best_worth < 0:
        return Order((), 0.0, 0.0, True)
    stops: list[int] = []
    mask, last = best
    while last >= 0:
        stops.append(last + 1)
        mask, last = mask ^ 1 << last, int(before[mask, last])
    stops.reverse()
    prize = float(problem.prize[[s - 1 for s in stops]].sum()) if stops else 0.0
    return Order(tuple(stops), prize, best_energy, True)
