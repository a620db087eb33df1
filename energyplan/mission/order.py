"""The best order and subset of tasks on an energy matrix: prizes against a budget.

The answer is exact for few tasks: labels (energy, charge left, time) over every subset and last
stop, of which only those that no other one beats in every respect are kept (the dynamic programme
of Held and Karp, with resources). Charging stops early where windows press. Beyond `EXACT` tasks,
or where there would be too many labels, OR-Tools searches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from energyplan.mission._order_kernel import Table, search
from energyplan.path import FloatArray

EXACT = 15
"""Largest number of tasks that is solved exactly."""

_MOST_LABELS = 2**21
_FEW, _WIDTH = 8, 4


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
    hurried_energy, hurried_time : optional
        As `energy` and `time`, for driving as quickly as may be; where windows press.
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
    hurried : tuple of bool
        Whether the way to each stop is driven as quickly as may be.
    """

    stops: tuple[int, ...]
    prize: float
    energy: float
    proven: bool
    hurried: tuple[bool, ...] = ()


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
    if problem.tasks <= EXACT:
        found = solve_exactly(problem)
        if found is not None:
            return found
    from energyplan.mission.routing import solve_by_search

    return solve_by_search(problem, time_limit=time_limit, effort=effort, progress=progress)


def solve_exactly(problem: OrderProblem) -> Order | None:
    """Find the best order by labels over subsets and last stops.

    Parameters
    ----------
    problem : OrderProblem
        The problem.

    Returns
    -------
    Order or None
        The best order, proven; None where more labels would be needed than there is room for.
    """
    table = _table(problem)
    if problem.tasks > _FEW:
        # an order that does everything, found quickly, spares most labels of the exact search
        quick = search(table._replace(width=_WIDTH))
        tasks = {int(stop) for stop in quick.stops if stop <= problem.tasks}
        if quick.complete and len(tasks) == problem.tasks:
            table = table._replace(known=float(quick.energy))
    found = search(table)
    if not found.complete:
        return None
    stops = tuple(int(stop) for stop in found.stops)
    prize = sum(float(problem.prize[s - 1]) for s in stops if s <= problem.tasks)
    energy = float(found.energy) if found.feasible else 0.0
    hurried = tuple(bool(way) for way in found.ways)
    return Order(stops, prize, energy, True, hurried)


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
    return Table(
        energy=np.array([[np.asarray(way(load), float) for way in ways] for load in can]),
        finish=np.array([np.asarray(problem.finish(load), float) for load in can]),
        time=np.array(times, float),
        finish_time=np.asarray(problem.finish_time, float),
        service=np.asarray(problem.service, float),
        service_time=np.asarray(problem.service_time, float),
        window=np.ascontiguousarray(problem.window, float),
        worth=np.asarray(problem.worth, float),
        load=loads,
        load_index=index.ravel().astype(np.int64),
        change=np.asarray(problem.payload_change, float),
        capacity=np.asarray(problem.capacity, float),
        charge_power=np.asarray(problem.charge_power, float),
        budget=float(problem.budget),
        start_time=float(problem.start_time),
        timed=problem.timed,
        most=_MOST_LABELS,
        width=_MOST_LABELS,
        known=np.inf,
    )
