"""What the rest of an order takes at least, by a programme over subsets without the battery.

From each subset of tasks and place on: the least energy of doing what reaches a worth and ending,
with at least so many visits to chargers on the way. Every charge that the battery needs is such a
visit, so the fewest visits that a charge can do with tell what the rest takes (`energy_left`). The
same programme over times tells when to leave at the latest for no window to be missed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import (
    Flags,
    FloatBlock,
    Floats,
    FloatTable,
    Ints,
    WideBlock,
)

_GRAM = 1e-3
_EPSILON = 1e-9


class Table(NamedTuple):
    """An order problem as arrays; n tasks, m chargers, N places, L loads, M ways of driving.

    Attributes
    ----------
    energy : ndarray, shape (L, M, N, N)
        Energies from place to place [J]; infinite where no battery lasts for the way.
    finish : ndarray, shape (L, N)
        Energy to where the mission may end [J].
    time : ndarray, shape (M, N, N)
        Travel times [s].
    finish_time : ndarray, shape (N,)
        Time to where the mission may end [s].
    service, service_time : ndarray, shape (n,)
        Energy [J] and time [s] of each task.
    window : ndarray, shape (n, 2)
        Earliest and latest begin [s].
    worth : ndarray, shape (n,)
        What each task is worth.
    worth_of : ndarray, shape (2^n,)
        What each subset of tasks is worth.
    load : ndarray, shape (2^n,)
        Payload after each subset of tasks [kg].
    load_index : ndarray of int, shape (2^n,)
        Which of the L loads that is.
    pressing : ndarray of bool, shape (2^n,)
        Whether a window of the tasks that each subset leaves ends.
    change : ndarray, shape (n,)
        Change of the payload by each task [kg].
    need : ndarray, shape (N,)
        Charge without which no charger and no end is reached from a place [J].
    capacity, charge_power : ndarray, shape (m,)
        Energy on leaving each charger when full [J], and stored per second [W].
    budget, full : float
        Energy at the start and of a full battery [J].
    start_time : float
        Time at the start [s].
    visits : int
        Visits to chargers that are told apart.
    most : int
        Most labels to keep.
    width : int
        Most labels to keep of a subset and place; fewer than there are make the search quick and
        its answer one that need not be the best.
    """

    energy: WideBlock
    finish: FloatTable
    time: FloatBlock
    finish_time: Floats
    service: Floats
    service_time: Floats
    window: FloatTable
    worth: Floats
    worth_of: Floats
    load: Floats
    load_index: Ints
    pressing: Flags
    change: Floats
    need: Floats
    capacity: Floats
    charge_power: Floats
    budget: float
    full: float
    start_time: float
    visits: int
    most: int
    width: int


class Rest(NamedTuple):
    """What is to be done at least, by bucket: a subset of tasks done and a place.

    Attributes
    ----------
    energy : ndarray, shape (2^n * N, visits + 1)
        Least energy with at least so many visits to chargers ahead [J].
    latest : ndarray, shape (2^n * N,)
        When to leave at the latest [s].
    charge : float
        Energy that one visit adds at most [J].
    """

    energy: FloatTable
    latest: Floats
    charge: float


@inner
def loosely(limit: float) -> float:
    """Return a limit with room for rounding."""
    return limit + _EPSILON * max(abs(limit), 1.0) if np.isfinite(limit) else limit


@inner
def energy_left(rest: Rest, bucket: int, charge: float) -> float:
    """Return what the rest takes at least with a charge on board [J]; infinite if it cannot be."""
    visits = rest.energy.shape[1] - 1
    for k in range(visits):
        least = float(rest.energy[bucket, k])
        if least <= loosely(charge + k * rest.charge):
            return least
    return float(rest.energy[bucket, visits])


@njit
def completions(table: Table, worth: float) -> Rest:
    """Bound what is left to do from each bucket on.

    Parameters
    ----------
    table : Table
        The problem.
    worth : float
        Worth that the whole order is to have at least.

    Returns
    -------
    Rest
        The bounds.
    """
    n, m, ways = len(table.worth), len(table.capacity), table.energy.shape[1]
    places = 1 + n + m
    visits = table.visits if m > 0 else 0
    least = np.full((2**n * places, visits + 1), np.inf)
    latest = np.full(2**n * places, -np.inf)
    quickest = table.time[0].copy()
    for way in range(1, ways):
        quickest = np.minimum(quickest, table.time[way])
    for mask in range(2**n - 1, -1, -1):
        enough = table.worth_of[mask] >= worth - _EPSILON
        energy, finish = table.energy[table.load_index[mask]], table.finish[table.load_index[mask]]
        for p in range(places):
            if (p == 0 and mask > 0) or (0 < p <= n and not mask >> (p - 1) & 1):
                continue
            bucket = mask * places + p
            if enough and np.isfinite(finish[p]):
                least[bucket, 0] = finish[p]
                latest[bucket] = np.inf
            for t in range(n):
                if mask >> t & 1 or table.load[mask] + table.change[t] < -_GRAM:
                    continue
                way = energy[0, p, 1 + t]
                for other in range(1, ways):
                    way = min(way, energy[other, p, 1 + t])
                if not np.isfinite(way):
                    continue
                after = (mask | 1 << t) * places + 1 + t
                for k in range(visits + 1):
                    through = way + table.service[t] + least[after, k]
                    least[bucket, k] = min(least[bucket, k], through)
                begin = min(table.window[t, 1], latest[after] - table.service_time[t])
                if begin >= table.window[t, 0]:
                    latest[bucket] = max(latest[bucket], begin - quickest[p, 1 + t])
        # over chargers, which may lead to chargers
        for turn in range(m + 1 if m > 0 else 0):
            last = turn == m
            for p in range(places):
                if (p > n) == last or (p == 0 and mask > 0):
                    continue
                if 0 < p <= n and not mask >> (p - 1) & 1:
                    continue
                for c in range(m):
                    if 1 + n + c == p:
                        continue
                    way = energy[0, p, 1 + n + c]
                    for other in range(1, ways):
                        way = min(way, energy[other, p, 1 + n + c])
                    if not np.isfinite(way):
                        continue
                    bucket, there = mask * places + p, mask * places + 1 + n + c
                    least[bucket, 0] = min(least[bucket, 0], way + least[there, 0])
                    for k in range(1, visits + 1):
                        through = way + least[there, k - 1]
                        least[bucket, k] = min(least[bucket, k], through)
                    latest[bucket] = max(latest[bucket], latest[there] - quickest[p, 1 + n + c])
    most = table.budget
    for c in range(m):
        most = max(most, table.capacity[c])
    return Rest(least, latest, most if m > 0 else 0.0)
