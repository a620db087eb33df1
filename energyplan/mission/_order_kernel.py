"""Labels over (tasks done, place): the exact search for an order, compiled.

A label is a way to have done a subset of the tasks and to stand at one place: the energy that it
took, the charge that is left, and the time. Where time matters charging may stop early. Such a
label is a segment: after `time` with `left` on board, each further second, up to `slack`, adds
`rate`; how much of it is used shows later. Waiting for a window is time to charge at no cost.
Of the labels of a subset and place only those are kept that no other one beats in every respect,
and only those that can still lead to a better order than the best one known (`_order_bounds`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, IntTable, njit
from energyplan.mission._order_bounds import Rest, Table, energy_left, loosely

_GRAM = 1e-3
_EPSILON = 1e-9
_FEW = 4096
_GONE = -2
_FAR = 1e15
"""Rank of labels that do not lead to the worth that is known, beyond their energy [J]."""


class Known(NamedTuple):
    """An order that is known, and what is asked of a better one."""

    worth: float  # its worth
    energy: float  # its energy [J], and when it ends [s]
    time: float  # its energy [J], and when it ends [s]
    same: Rest  # what it takes at least to reach its worth
    more: Rest  # what it takes at least to reach more


class Found(NamedTuple):
    """What the search found."""

    better: bool  # whether it is better than what was known
    worth: float
    energy: float
    time: float
    bound: float  # energy that no order of this worth undercuts [J]
    open: bool  # whether an order of greater worth may have been left out
    labels: int  # labels kept
    stops: Ints  # places in the order of their visits, and the way of driving to each
    ways: Ints  # places in the order of their visits, and the way of driving to each


class Label(NamedTuple):
    """One label; see the module."""

    energy: float
    left: float
    time: float
    rate: float
    slack: float


class Store(NamedTuple):
    """All labels."""

    value: FloatTable  # each label's fields, and the least energy of an order that it leads to [J]
    link: IntTable  # (n, 4): label before, place, way of driving, next label of the bucket
    head: Ints  # (2^n * places,): first label of each bucket
    lost: Floats  # (2,)


@njit
def _spend(label: Label, energy: float, seconds: float, full: float) -> Label:
    """Drive or work; charges longer before it where the charge would not do. May end below 0.

    What comes back finds room up to a full battery.
    """
    left, time, slack = label.left - energy, label.time + seconds, label.slack
    if left > full:
        left = max(full, label.left)
    room = max(full - left, 0.0)
    if slack * label.rate > room:
        slack = room / label.rate
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
def _label(store: Store, k: int) -> Label:
    value = store.value
    return Label(value[k, 0], value[k, 1], value[k, 2], value[k, 3], value[k, 4])


@njit
def _with_room(store: Store, count: int, most: int) -> Store:
    """Return a store with room for one more label, unless there are too many."""
    if count < len(store.value) or count >= most:
        return store
    more = min(len(store.value), most - len(store.value))
    return Store(
        np.concatenate((store.value, np.empty((more, 6)))),
        np.concatenate((store.link, np.empty((more, 4), np.int64))),
        store.head,
        store.lost,
    )


@njit
def _take_out(store: Store, bucket: int, k: int, before: int) -> None:
    """Take a label out of its bucket; what followed from it stays."""
    if before < 0:
        store.head[bucket] = store.link[k, 3]
    else:
        store.link[before, 3] = store.link[k, 3]
    store.link[k, 3] = _GONE


@njit
def _more(known: Known, bucket: int, label: Label) -> bool:
    """Tell whether a label may lead to more worth than is known."""
    if not len(known.more.latest) or label.time > loosely(known.more.latest[bucket]):
        return False
    return energy_left(known.more, bucket, label.left + label.rate * label.slack) < np.inf


@njit
def _least(known: Known, bucket: int, label: Label) -> float:
    """Return the least energy of an order of the worth known that a label leads to [J]."""
    if label.time > loosely(known.same.latest[bucket]):
        return np.inf
    may = label.left + label.rate * label.slack
    return label.energy + energy_left(known.same, bucket, may)


@njit
def _lose(store: Store, least: float, more: bool) -> None:
    """Note what a label that is left out for want of room may have led to."""
    store.lost[0] = min(store.lost[0], least)
    if more:
        store.lost[1] = 1.0


@njit
def _rank(label: Label, least: float) -> float:
    return least if np.isfinite(least) else _FAR + label.energy


@njit
def _keep(
    store: Store, bucket: int, new: Label, count: int, timed: bool, width: int, known: Known
) -> bool:
    """Add a label to its bucket; not where one there is as good, or where nothing comes of it."""
    least, more = _least(known, bucket, new), _more(known, bucket, new)
    if not (more or least <= loosely(known.energy)):
        return False
    there, k = 0, store.head[bucket]
    while k >= 0:
        if _as_good(_label(store, k), new, timed):
            return False
        k = store.link[k, 3]
    if count >= len(store.value):
        _lose(store, least, more)
        return False
    before, worst, before_worst, k = -1, -1, -1, store.head[bucket]
    highest = _rank(new, least)
    while k >= 0:
        after, old = store.link[k, 3], _label(store, k)
        if _as_good(new, old, timed):
            _take_out(store, bucket, k, before)
        else:
            there += 1
            if _rank(old, store.value[k, 5]) > highest:
                highest, worst, before_worst = _rank(old, store.value[k, 5]), k, before
            before = k
        k = after
    if there >= width:
        # as many labels as there may be: the one that promises least goes
        if worst < 0:
            _lose(store, least, more)
            return False
        _lose(store, store.value[worst, 5], _more(known, bucket, _label(store, worst)))
        _take_out(store, bucket, worst, before_worst)
    value = store.value
    value[count, 0], value[count, 1], value[count, 2] = new.energy, new.left, new.time
    value[count, 3], value[count, 4], value[count, 5] = new.rate, new.slack, least
    store.link[count, 3] = store.head[bucket]
    store.head[bucket] = count
    return True


@njit
def _docked(table: Table, here: Label, charger: int, kind: int) -> Label:
    """Begin to charge; after another charger: here only (0), there first (1), or not here (2)."""
    power, full = table.charge_power[charger], table.capacity[charger]
    new = _charged(here) if kind == 1 else here
    if kind == 2:
        return new
    room = max(full - new.left, 0.0) / power
    return Label(new.energy, new.left, new.time, power, room)


@njit
def search(table: Table, known: Known) -> Found:
    """Find an order of greater worth than the one known, or of the same and less energy.

    Of orders of the same energy the quickest is taken.
    """
    n, m, ways = len(table.worth), len(table.capacity), table.energy.shape[1]
    places, width = 1 + n + m, table.width
    store = Store(
        np.empty((min(_FEW, table.most), 6)),
        np.empty((min(_FEW, table.most), 4), np.int64),
        np.full(2**n * places, -1, np.int64),
        np.array([np.inf, 0.0]),
    )
    best, best_worth, best_energy, best_time = -1, known.worth, known.energy, known.time
    count = 0
    start = Label(0.0, table.budget, table.start_time, 0.0, 0.0)
    if _keep(store, 0, start, 0, table.pressing[0], table.width, known):
        store.link[0, 0], store.link[0, 1], store.link[0, 2] = -1, 0, 0
        count = 1
    queue = np.empty(256, np.int64)
    for mask in range(2**n):
        first, load = mask * places, table.load[mask]
        energy, finish = table.energy[table.load_index[mask]], table.finish[table.load_index[mask]]
        # chargers may lead to chargers: their labels stay within the subset
        waiting = 0
        for place in range(places if m > 0 else 0):
            k = store.head[first + place]
            while k >= 0:
                if waiting == len(queue):
                    queue = np.append(queue, np.empty(len(queue), np.int64))
                queue[waiting] = k
                waiting += 1
                k = store.link[k, 3]
        while waiting > 0:
            waiting -= 1
            k = queue[waiting]
            if store.link[k, 3] == _GONE:
                continue
            here, at = _label(store, k), store.link[k, 1]
            for c in range(m):
                place = 1 + n + c
                if place == at:
                    continue
                for way in range(ways):
                    spent = energy[way, at, place]
                    if not np.isfinite(spent):
                        continue
                    there = _spend(here, spent, table.time[way, at, place], table.full)
                    if there.left < 0.0:
                        continue
                    timed = table.pressing[mask]
                    quicker = timed and there.slack > 0.0 and there.rate > table.charge_power[c]
                    for kind in range(3 if quicker else 1):
                        new = _docked(table, there, c, kind)
                        if not timed:
                            new = _charged(new)
                        store = _with_room(store, count, table.most)
                        if _keep(store, first + place, new, count, timed, width, known):
                            link = store.link
                            link[count, 0], link[count, 1], link[count, 2] = k, place, way
                            if waiting == len(queue):
                                queue = np.append(queue, np.empty(len(queue), np.int64))
                            queue[waiting] = count
                            waiting += 1
                            count += 1
        worth = table.worth_of[mask]
        for place in range(places):
            k = store.head[first + place]
            while k >= 0:
                here = _label(store, k)
                last = _spend(here, finish[place], table.finish_time[place], table.full)
                if last.left >= 0.0 and np.isfinite(last.energy):
                    better = worth > best_worth + _EPSILON
                    if not better and worth > best_worth - _EPSILON:
                        rounding = loosely(best_energy) - best_energy
                        better = last.energy < best_energy - rounding or (
                            last.energy <= best_energy + rounding and loosely(last.time) < best_time
                        )
                    if better:
                        best, best_worth = k, worth
                        best_energy, best_time = last.energy, last.time
                        known = Known(best_worth, best_energy, best_time, known.same, known.more)
                for t in range(n):
                    if mask >> t & 1 or load + table.change[t] < -_GRAM:
                        continue
                    after = mask | 1 << t
                    pressing = table.pressing[after]
                    for way in range(ways):
                        spent = energy[way, place, 1 + t]
                        if not np.isfinite(spent):
                            continue
                        there = _spend(here, spent, table.time[way, place, 1 + t], table.full)
                        if there.left < 0.0 or there.time > table.window[t, 1] + _EPSILON:
                            continue
                        begun = _begin(there, table.window[t, 0], table.window[t, 1])
                        done = _spend(begun, table.service[t], 0.0, table.full)
                        if done.left < 0.0 or done.time > table.window[t, 1] + _EPSILON:
                            continue
                        done = Label(
                            done.energy, done.left, done.time + table.service_time[t], done.rate,
                            done.slack,
                        )  # fmt: skip
                        if not pressing:
                            done = _charged(done)
                        if done.left + done.rate * done.slack < table.need[1 + t] - _EPSILON:
                            continue
                        store = _with_room(store, count, table.most)
                        if _keep(
                            store, after * places + 1 + t, done, count, pressing, width, known
                        ):
                            link = store.link
                            link[count, 0], link[count, 1], link[count, 2] = k, 1 + t, way
                            count += 1
                k = store.link[k, 3]
    length, k = 0, best
    while k > 0:
        length, k = length + 1, store.link[k, 0]
    stops, driven = np.empty(length, np.int64), np.empty(length, np.int64)
    k = best
    while k > 0:
        length -= 1
        stops[length], driven[length] = store.link[k, 1], store.link[k, 2]
        k = store.link[k, 0]
    bound = min(best_energy, store.lost[0])
    return Found(
        best >= 0, best_worth, best_energy, best_time, bound, store.lost[1] > 0.0, count, stops,
        driven,
    )  # fmt: skip
