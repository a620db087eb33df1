"""What the rest of an order takes at least, by a programme over subsets without the battery.

From each subset of tasks and place on: the least energy of doing what reaches a worth and ending,
with at least so many visits to chargers on the way. Every charge that the battery needs is such a
visit, so the fewest visits that a charge can do with tell what the rest takes (`energy_left`). The
same programme over times tells when to leave at the latest for no window to be missed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import (
    Flags,
    FloatBlock,
    Floats,
    FloatTable,
    Ints,
    WideBlock,
    njit,
)

_GRAM = 1e-3
_EPSILON = 1e-9


class Table(NamedTuple):
    """An order problem as arrays; n tasks, m chargers, N places, L loads, M ways of driving."""

    energy: WideBlock  # (L, M, N, N): energies from place to place [J]
    finish: FloatTable  # (L, N): energy to where the mission may end [J]
    time: FloatBlock  # (M, N, N): travel times [s]
    finish_time: Floats  # (N,): time to where the mission may end [s]
    service: Floats  # (n,): energy [J] and time [s] of each task
    service_time: Floats  # (n,): energy [J] and time [s] of each task
    window: FloatTable  # (n, 2): earliest and latest begin [s]
    worth: Floats  # (n,): what each task is worth
    worth_of: Floats  # (2^n,): what each subset of tasks is worth
    load: Floats  # (2^n,): payload after each subset of tasks [kg]
    load_index: Ints  # (2^n,): which of the L loads that is
    pressing: Flags  # (2^n,): whether a window of the tasks that each subset leaves ends
    change: Floats  # (n,): change of the payload by each task [kg]
    need: Floats  # (N,): charge without which no charger and no end is reached from a place [J]
    capacity: Floats  # energy on leaving each charger when full [J], and stored per second [W]
    charge_power: Floats  # energy on leaving each charger when full [J], and stored per second [W]
    budget: float  # energy at the start and of a full battery [J]
    full: float  # energy at the start and of a full battery [J]
    start_time: float  # time at the start [s]
    visits: int  # visits to chargers that are told apart
    most: int  # most labels to keep
    width: int  # most labels to keep of a subset and place


class Rest(NamedTuple):
    """What is to be done at least, by bucket: a subset of tasks done and a place."""

    energy: FloatTable  # least energy with at least so many visits to chargers ahead [J]
    latest: Floats  # (2^n * N,): when to leave at the latest [s]
    charge: float  # energy that one visit adds at most [J]


@njit
def loosely(limit: float) -> float:
    """Return a limit with room for rounding."""
    return limit + _EPSILON * max(abs(limit), 1.0) if np.isfinite(limit) else limit


@njit
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
    """Bound what is left to do from each bucket on."""
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
