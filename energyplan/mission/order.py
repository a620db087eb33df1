"""The best order and subset of tasks on an energy matrix: prizes against a budget.

The answer is exact for few tasks: labels (energy, charge left, time) over every subset and last
stop, of which only those that no other one beats in every respect are kept (the dynamic programme
of Held and Karp, with resources). A first search keeps few labels of each subset and stop; what it
finds, and bounds of what is left to do, spare the exact one most of them. Charging stops early
where windows press. Where there would still be too many labels the answer tells its bound. Beyond
`EXACT` tasks OR-Tools searches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from energyplan.mission._order_bounds import Rest, Table, completions
from energyplan.mission._order_kernel import Known, search
from energyplan.path import FloatArray

EXACT = 15
"""Largest number of tasks that is solved exactly."""

_MOST_LABELS = 2**22
_WIDTHS = (1, 8, _MOST_LABELS)
"""Labels of a subset and stop that each search keeps."""

_VISITS = 6
"""Visits to chargers that bounds tell apart."""

_LEAST = 1e-8
"""Least difference of worth."""

_ROUNDING = 1e-9

_NO_REST = Rest(np.empty((0, 1)), np.empty(0), 0.0)
"""What it takes to be worth more than everything."""


@dataclass(frozen=True)
class OrderProblem:
    """Which tasks to do in which order.

    Node 0 is the start, nodes 1 to n the tasks, the others the chargers.
    """

    energy: Callable[[float], FloatArray]
    finish: Callable[[float], FloatArray]  # [J]
    time: FloatArray  # (N, N): travel times [s]
    finish_time: FloatArray  # (N,): time from each node to that place [s]
    service: FloatArray  # (n,): energy [J] and time [s] that each task takes
    service_time: FloatArray  # (n,): energy [J] and time [s] that each task takes
    payload: float  # payload at the start [kg]
    payload_change: FloatArray  # (n,): change of the payload by each task [kg]
    prize: FloatArray  # (n,): prizes
    required: np.ndarray  # (n,): tasks that must be done
    window: FloatArray  # (n, 2): earliest and latest start of each task [s]
    budget: float  # energy at the start, the reserve taken off [J]
    capacity: FloatArray  # (m,): energy on leaving each charger, the reserve taken off [J]
    charge_power: FloatArray  # (m,): energy stored per second at each charger [W]
    start_time: float = 0.0  # time at the start [s]
    full: float = np.inf  # energy of a full battery, the reserve taken off [J]
    hurried_energy: Callable[[float], FloatArray] | None = None
    hurried_time: FloatArray | None = None

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.prize)

    @property
    def timed(self) -> bool:
        """Whether windows make time decide beside energy and charge."""
        return bool(np.any(np.isfinite(self.window[:, 1])))

    @property
    def worth(self) -> FloatArray:
        """Prizes, with those of required tasks above the sum of all others."""
        return self.prize + np.where(self.required, 1.0 + self.prize.sum(), 0.0)


@dataclass(frozen=True)
class Order:
    """An order: nodes in the sequence of their visits, start and end left out."""

    stops: tuple[int, ...]  # nodes
    prize: float  # sum of the prizes of the tasks among them
    energy: float  # energy of the whole tour [J]
    proven: bool  # whether no better order exists
    hurried: tuple[bool, ...] = ()  # whether the way to each stop is driven as quickly as may be
    bound: float = np.nan  # energy that no order of this worth undercuts [J]


def solve(
    problem: OrderProblem,
    *,
    time_limit: float = 10.0,
    effort: int | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Order:
    """Find the order of greatest worth, and of least energy among those."""
    if problem.tasks <= EXACT:
        return solve_exactly(problem)
    from energyplan.mission.routing import solve_by_search

    return solve_by_search(problem, time_limit=time_limit, effort=effort, progress=progress)


def solve_exactly(problem: OrderProblem, widths: Sequence[int] = _WIDTHS) -> Order:
    """Find the best order by labels over subsets and last stops."""
    table = _table(problem)
    tasks = slice(1, 1 + problem.tasks)
    nearest = table.energy.min(axis=(0, 1, 2))[tasks]
    whole = float(table.worth[np.isfinite(nearest)].sum())
    # the first search looks for an order that does everything, and takes what it finds
    known = Known(-1.0, np.inf, np.inf, completions(table, whole), completions(table, -1.0))
    best, proven, bound = known, False, np.nan
    stops, hurried = np.empty(0, int), np.empty(0, int)
    for width in widths:
        found = search(table._replace(width=width), known)
        if found.better:
            bound = bound if found.worth < best.worth + _LEAST else np.nan
            best = best._replace(worth=found.worth, energy=found.energy, time=found.time)
            stops, hurried = found.stops, found.ways
        if not found.open or best.worth > whole - _LEAST:
            bound = np.nanmax([found.bound, bound])
        proven = bool(bound >= best.energy - _ROUNDING * abs(best.energy))
        if proven:
            break
        if best.worth >= 0:
            all_of_it = best.worth >= whole - _LEAST
            more = _NO_REST if all_of_it else completions(table, best.worth + _LEAST)
            known = best._replace(same=completions(table, best.worth), more=more)
    prize = sum(float(problem.prize[s - 1]) for s in stops if s <= problem.tasks)
    energy = best.energy if best.worth >= 0 else 0.0
    nodes, ways = tuple(map(int, stops)), tuple(map(bool, hurried))
    return Order(nodes, prize, energy, proven, ways, bound)


def _table(problem: OrderProblem) -> Table:
    """Return the problem as the kernel reads it."""
    n = problem.tasks
    done = (np.arange(2**n)[:, None] >> np.arange(n) & 1).astype(bool)
    loads = problem.payload + done @ problem.payload_change
    known, index = np.unique(np.round(loads, 9), return_inverse=True)
    # what cannot be carried is never reached; its energies are not asked for
    can = [float(max(load, 0.0)) for load in known]
    ways = [problem.energy] if problem.hurried_energy is None else [
        problem.energy, problem.hurried_energy
    ]  # fmt: skip
    times = [problem.time] if problem.hurried_time is None else [
        problem.time, problem.hurried_time
    ]  # fmt: skip
    energy = np.array([[np.asarray(way(load), float) for way in ways] for load in can])
    finish = np.array([np.asarray(problem.finish(load), float) for load in can])
    service = np.asarray(problem.service, float)
    size = energy.shape[2]
    energy[..., np.arange(size), np.arange(size)] = np.inf
    least = energy.min(axis=(0, 1))
    closed = _closed(least)
    need, left = _need(closed, finish.min(axis=0), n), _most_left(problem, closed, size)
    # no battery lasts for a way from which nothing can be reached
    asked = least + (need + np.concatenate([[0.0], service, np.zeros(size - 1 - n)]))[None, :]
    room = _ROUNDING * np.where(np.isfinite(left), np.maximum(np.abs(left), 1.0), 0.0)
    energy[:, :, asked > (left + room)[:, None]] = np.inf
    ends = np.isfinite(problem.window[:, 1])
    return Table(
        energy=energy,
        finish=finish,
        time=np.array(times, float),
        finish_time=np.asarray(problem.finish_time, float),
        service=service,
        service_time=np.asarray(problem.service_time, float),
        window=np.ascontiguousarray(problem.window, float),
        worth=np.asarray(problem.worth, float),
        worth_of=done @ np.asarray(problem.worth, float),
        load=loads,
        load_index=index.ravel().astype(np.int64),
        pressing=np.any(~done & ends, axis=1),
        change=np.asarray(problem.payload_change, float),
        need=need,
        capacity=np.asarray(problem.capacity, float),
        charge_power=np.asarray(problem.charge_power, float),
        budget=float(problem.budget),
        full=float(problem.full),
        start_time=float(problem.start_time),
        visits=_VISITS,
        most=_MOST_LABELS,
        width=_MOST_LABELS,
    )


def _closed(energy: FloatArray) -> FloatArray | None:
    """Return the least energies from place to place over any others; None where nothing is least.

    A round trip that gives energy away may be driven again and again.
    """
    ways = energy.copy()
    np.fill_diagonal(ways, 0.0)
    for k in range(len(ways)):
        ways = np.minimum(ways, ways[:, k : k + 1] + ways[k : k + 1, :])
    return None if np.any(np.diag(ways) < 0) else np.asarray(ways)


def _need(ways: FloatArray | None, finish: FloatArray, tasks: int) -> FloatArray:
    """Return the charge without which no charger and no end is reached from each place [J]."""
    if ways is None:
        return np.zeros(len(finish))
    last = np.concatenate([finish[: 1 + tasks], np.zeros(len(finish) - 1 - tasks)])
    return np.asarray(np.maximum((ways + last[None, :]).min(axis=1), 0.0))


def _most_left(problem: OrderProblem, ways: FloatArray | None, size: int) -> FloatArray:
    """Return the charge with which each place can be left at most [J]."""
    if ways is None:
        return np.full(size, np.inf)
    full = np.concatenate([[problem.budget], problem.capacity])
    most = (full[:, None] - ways[[0, *range(1 + problem.tasks, size)]]).max(axis=0)
    most[1 : 1 + problem.tasks] -= problem.service
    return np.asarray(most)
