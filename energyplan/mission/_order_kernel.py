"""Labels over (tasks done, place): the exact search for an order, compiled.

A label is a way to have done a subset of the tasks and to stand at one place: the energy that it
took, the charge that is left, and the time. Where time matters charging may stop early. Such a
label is a segment: after `time` with `left` on board, each further second, up to `slack`, adds
`rate`; how much of it is used shows later. Waiting for a window is time to charge at no cost.
Of the labels of a subset and place only those are kept that no other one beats in every respect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import njit
from energyplan.compilation.arrays import (
    FloatBlock,
    Floats,
    FloatTable,
    Ints,
    IntTable,
    WideBlock,
)

_GRAM = 1e-3
_EPSILON = 1e-9
_FEW = 4096


class Table(NamedTuple):
    """An order problem as arrays; n tasks, m chargers, N places, L loads, M ways of driving.

    Attributes
    ----------
    energy : ndarray, shape (L, M, N, N)
        Energies from place to place [J].
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
    load : ndarray, shape (2^n,)
        Payload after each subset of tasks [kg].
    load_index : ndarray of int, shape (2^n,)
        Which of the L loads that is.
    change : ndarray, shape (n,)
        Change of the payload by each task [kg].
    capacity, charge_power : ndarray, shape (m,)
        Energy on leaving each charger when full [J], and stored per second [W].
    budget : float
        Energy at the start [J].
    start_time : float
        Time at the start [s].
    timed : bool
        Whether windows make time decide.
    most : int
        Most labels to keep.
    width : int
        Most labels to keep of a subset and place; fewer than there are make the search quick and
        its answer one that need not be the best.
    known : float
        Energy of an order that does everything: labels that cannot be better are left out [J].
    """

    energy: WideBlock
    finish: FloatTable
    time: FloatBlock
    finish_time: Floats
    service: Floats
    service_time: Floats
    window: FloatTable
    worth: Floats
    load: Floats
    load_index: Ints
    change: Floats
    capacity: Floats
    charge_power: Floats
    budget: float
    start_time: float
    timed: bool
    most: int
    width: int
    known: float


class Found(NamedTuple):
    """What the search found.

    Attributes
    ----------
    complete : bool
        Whether all labels fitted; if not, nothing is known.
    feasible : bool
        Whether any order can be done and ended.
    energy : float
        Energy of the best order, the way to its end included [J].
    stops, ways : ndarray of int
        Places in the order of their visits, and the way of driving to each.
    """

    complete: bool
    feasible: bool
    energy: float
    stops: Ints
    ways: Ints


class Label(NamedTuple):
    """One label; see the module."""

    energy: float
    left: float
    time: float
    rate: float
    slack: float


@njit
def _spend(label: Label, energy: float, seconds: float) -> Label:
    """Drive or work; charges longer before it where the charge would not do. May end below 0."""
    left, time, slack = label.left - energy, label.time + seconds, label.slack
    if left < 0.0 and slack > 0.0:
        more = min(-left / label.rate, slack)
        left, time, slack = left + label.rate * more, time + more, slack - more
        if left > -_EPSILON * max(label.left, 1.0):
            left = max(left, 0.0)
    return Label(label.energy + energy, left, time, label.rate, slack)


@njit
def _begin(label: Label, earliest: float, latest: float) -> Label:
    """Wait for a window, charging meanwhile what may be charged; the time tells a miss."""
    left, time, slack = label.left, label.time, label.slack
    if time < earliest:
        more = min(slack, earliest - time)
        left, slack, time = left + label.rate * more, slack - more, earliest
    return Label(label.energy, left, time, label.rate, max(min(slack, latest - time), 0.0))


@njit
def _charged(label: Label) -> Label:
    """Charge as long as may be."""
    left = label.left + label.rate * label.slack
    return Label(label.energy, left, label.time + label.slack, 0.0, 0.0)


@njit
def _grown(table: FloatTable) -> FloatTable:
    return np.concatenate((table, np.empty_like(table)))


@njit
def _grown_links(table: IntTable) -> IntTable:
    return np.concatenate((table, np.empty_like(table)))


@njit
def _nothing() -> Found:
    return Found(False, False, np.inf, np.empty(0, np.int64), np.empty(0, np.int64))


@njit
def _left_at(label: Label, time: float) -> float:
    return label.left + label.rate * min(max(time - label.time, 0.0), label.slack)


@njit
def _as_good(one: Label, other: Label, timed: bool) -> bool:
    """Tell whether a label is as good as another in every respect."""
    if one.energy > other.energy + _EPSILON:
        return False
    if not timed:
        return one.left >= other.left - _EPSILON
    if one.time > other.time + _EPSILON or _left_at(one, other.time) < other.left - _EPSILON:
        return False
    end = other.time + other.slack
    return _left_at(one, end) >= other.left + other.rate * other.slack - _EPSILON


@njit
def _rest(table: Table) -> Floats:
    """Return what it takes at least to do the tasks that a subset leaves, and to end [J]."""
    n = len(table.worth)
    least = np.empty(n)
    for t in range(n):
        least[t] = table.service[t] + table.energy[:, :, : 1 + t, 1 + t].min()
        if 2 + t < table.energy.shape[2]:
            later = table.energy[:, :, 2 + t :, 1 + t].min()
            least[t] = min(least[t], table.service[t] + later)
    rest = np.full(2**n, table.finish.min())
    for mask in range(2**n):
        for t in range(n):
            if not mask >> t & 1:
                rest[mask] += least[t]
    return rest


@njit
def search(table: Table) -> Found:
    """Find the order of greatest worth, of least energy and then time among those.

    Parameters
    ----------
    table : Table
        The problem.

    Returns
    -------
    Found
        The best order.
    """
    n, m, ways = len(table.worth), len(table.capacity), table.energy.shape[1]
    places = 1 + n + m
    value = np.empty((_FEW, 5))
    link = np.empty((_FEW, 4), np.int64)  # parent, place, way, next in the bucket
    head = np.full(2**n * places, -1, np.int64)
    value[0, 0], value[0, 1], value[0, 2], value[0, 3], value[0, 4] = (
        0.0, table.budget, table.start_time, 0.0, 0.0,
    )  # fmt: skip
    link[0, 0], link[0, 1], link[0, 2], link[0, 3] = -1, 0, 0, -1
    head[0], count = 0, 1
    best, best_worth, best_energy, best_time = -1, -1.0, np.inf, np.inf
    queue = np.empty(256, np.int64)
    rest = _rest(table)
    for mask in range(2**n):
        first_bucket = mask * places
        load = table.load[mask]
        energy, finish = table.energy[table.load_index[mask]], table.finish[table.load_index[mask]]
        # chargers may lead to chargers: their labels stay within the subset
        waiting = 0
        for place in range(places):
            k = head[first_bucket + place]
            while k >= 0:
                if waiting == len(queue):
                    queue = np.append(queue, np.empty(len(queue), np.int64))
                queue[waiting] = k
                waiting += 1
                k = link[k, 3]
        while waiting > 0 and m > 0:
            waiting -= 1
            k = queue[waiting]
            if link[k, 3] == -2:
                continue
            here = Label(value[k, 0], value[k, 1], value[k, 2], value[k, 3], value[k, 4])
            for c in range(m):
                place = 1 + n + c
                if place == link[k, 1]:
                    continue
                for way in range(ways):
                    spent = energy[way, link[k, 1], place]
                    if not np.isfinite(spent):
                        continue
                    docked = _spend(here, spent, table.time[way, link[k, 1], place])
                    if docked.left < 0.0:
                        continue
                    power, full = table.charge_power[c], table.capacity[c]
                    # after a quicker charger: charge here only, there first, or there alone
                    quicker = table.timed and docked.slack > 0.0 and docked.rate > power
                    for kind in range(3 if quicker else 1):
                        new = docked
                        if kind == 1:
                            new = _charged(docked)
                        if kind < 2:
                            room = max(full - new.left, 0.0) / power
                            new = Label(new.energy, new.left, new.time, power, room)
                            if not table.timed:
                                new = _charged(new)
                        if new.energy + rest[mask] > table.known + _EPSILON:
                            continue
                        if count == len(value):
                            if count >= table.most:
                                return _nothing()
                            value, link = _grown(value), _grown_links(link)
                        if _keep(head, value, link, first_bucket + place, new, count, table):
                            link[count, 0], link[count, 1], link[count, 2] = k, place, way
                            if waiting == len(queue):
                                queue = np.append(queue, np.empty(len(queue), np.int64))
                            queue[waiting] = count
                            waiting += 1
                            count += 1
        worth = 0.0
        for t in range(n):
            if mask >> t & 1:
                worth += table.worth[t]
        for place in range(places):
            k = head[first_bucket + place]
            while k >= 0:
                here = Label(value[k, 0], value[k, 1], value[k, 2], value[k, 3], value[k, 4])
                last = _spend(here, finish[place], table.finish_time[place])
                if last.left >= 0.0 and np.isfinite(last.energy):
                    better = worth > best_worth + _EPSILON
                    if not better and worth > best_worth - _EPSILON:
                        better = last.energy < best_energy - _EPSILON or (
                            last.energy < best_energy + _EPSILON and last.time < best_time
                        )
                    if better:
                        best, best_worth = k, worth
                        best_energy, best_time = last.energy, last.time
                for t in range(n):
                    if mask >> t & 1 or load + table.change[t] < -_GRAM:
                        continue
                    for way in range(ways):
                        spent = energy[way, place, 1 + t]
                        if not np.isfinite(spent):
                            continue
                        there = _spend(here, spent, table.time[way, place, 1 + t])
                        if there.left < 0.0 or there.time > table.window[t, 1] + _EPSILON:
                            continue
                        begun = _begin(there, table.window[t, 0], table.window[t, 1])
                        done = _spend(begun, table.service[t], 0.0)
                        if done.left < 0.0 or done.time > table.window[t, 1] + _EPSILON:
                            continue
                        done = Label(
                            done.energy, done.left, done.time + table.service_time[t], done.rate,
                            done.slack,
                        )  # fmt: skip
                        if count == len(value):
                            if count >= table.most:
                                return _nothing()
                            value, link = _grown(value), _grown_links(link)
                        if done.energy + rest[mask | 1 << t] > table.known + _EPSILON:
                            continue
                        bucket = (mask | 1 << t) * places + 1 + t
                        if _keep(head, value, link, bucket, done, count, table):
                            link[count, 0], link[count, 1], link[count, 2] = k, 1 + t, way
                            count += 1
                k = link[k, 3]
    length, k = 0, best
    while k > 0:
        length, k = length + 1, link[k, 0]
    stops, driven = np.empty(length, np.int64), np.empty(length, np.int64)
    k = best
    while k > 0:
        length -= 1
        stops[length], driven[length] = link[k, 1], link[k, 2]
        k = link[k, 0]
    return Found(True, best >= 0, best_energy, stops, driven)


@njit
def _keep(
    head: Ints,
    value: FloatTable,
    link: IntTable,
    bucket: int,
    new: Label,
    place: int,
    table: Table,
) -> bool:
    """Add a label to its bucket unless one there is as good; take out those that it beats."""
    there, k = 0, head[bucket]
    while k >= 0:
        old = Label(value[k, 0], value[k, 1], value[k, 2], value[k, 3], value[k, 4])
        if _as_good(old, new, table.timed):
            return False
        k = link[k, 3]
        there += 1
    if there >= table.width:
        return False
    before, k = -1, head[bucket]
    while k >= 0:
        after = link[k, 3]
        old = Label(value[k, 0], value[k, 1], value[k, 2], value[k, 3], value[k, 4])
        if _as_good(new, old, table.timed):
            if before < 0:
                head[bucket] = after
            else:
                link[before, 3] = after
            link[k, 3] = -2  # no longer in any bucket
        else:
            before = k
        k = after
    value[place, 0], value[place, 1], value[place, 2] = new.energy, new.left, new.time
    value[place, 3], value[place, 4] = new.rate, new.slack
    link[place, 3] = head[bucket]
    head[bucket] = place
    return True
