"""One search for an order: labels over stages and places, and what the rest of an order takes.

A stage says which tasks may come next: of a free order it is the set of tasks that are done, of a
given order the last one of them (see `energyplan.mission.order`). A label is one way of having come
to a stage and a place: the energy that it took, the charge that is left, the time, the prize of
what was done and the payload. Where time matters charging may stop early. Such a label is a
segment: after `time` with `left` on board, each further second, up to `slack`, adds `rate`; how
much of it is used shows later. Waiting for a window is time to charge first, and takes the power of
standing still once nothing more can be charged. Of the labels of
a stage and place only those are kept that no other one beats in every respect, and only those that
can still lead to a better order than the best one known.

A bound of the rest comes from a dynamic programme over stages without the battery: the least energy
of what reaches a prize and ends, with at least so many visits to chargers on the way. Every charge
that the battery needs is such a visit, so the number of charges still needed bounds the remaining
energy (`energy_left`). The same programme over times gives the latest time to leave at which no
window is missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.compilation import (
    Flags,
    FlagTable,
    FloatBlock,
    Floats,
    FloatTable,
    Ints,
    IntTable,
    WideBlock,
    inner,
    lean,
    njit,
)

GRAM, _MILLIGRAM = 1e-3, 1e-6
_EPSILON = 1e-9
_FEW = 4096
_FIELDS = 8
_GONE = -2

_FAR = 1e15  # rank of labels that do not lead to the prize that is known, beyond their energy [J]


class OrderProblem(NamedTuple):
    """Which tasks to do in which order, and how each.

    There are n tasks with K options in all, m chargers, L payloads, M ways of driving. Places are
    the start, the options and the chargers: N = 1 + K + m. A way leads from where one option leaves
    the robot to where the next one begins.
    """

    option: Ints  # (K,): task of each option, ascending
    loads: Floats  # (L,): payloads that energies are known for, ascending [kg]
    energy: WideBlock  # (L, M, N, N): energies from place to place [J]
    finish: FloatTable  # (L, N): energy to where the mission may end [J]
    time: FloatBlock  # (M, N, N): travel times [s]
    finish_time: Floats  # (N,): time to where the mission may end [s]
    service: Floats  # (K,): energy of each option [J]
    service_time: Floats  # (K,): time of each option [s]
    window: FloatTable  # (n, 2): earliest and latest begin [s]
    idle: Floats  # (K,): power of waiting at each option [W]
    prize: Floats  # (n,): prize of each task; any required one exceeds all optional ones together
    change: Floats  # (n,): change of the payload by each task [kg]
    capacity: Floats  # (m,): energy on leaving each charger when full, the reserve taken off [J]
    charge_power: Floats  # (m,): energy stored per second at each charger [W]
    budget: float  # energy at the start, the reserve taken off [J]
    # (L, M, N, N): charge that must be left after each way, and the option at its end, for the
    # battery to deliver their power, the reserve taken off [J]
    floor: WideBlock
    payload: float = 0.0  # payload at the start [kg]
    full: float = np.inf  # energy of a full battery, the reserve taken off [J]
    start_time: float = 0.0  # time at the start [s]
    given: bool = False  # whether no task may come before one of a lower number

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.prize)

    def at(self, load: ArrayLike) -> Any:
        """Return which of the payloads that energies are known for stands for a payload."""
        found = np.searchsorted(self.loads, np.asarray(load) - _MILLIGRAM)
        return np.minimum(found, len(self.loads) - 1)

    def options(self, tasks: Sequence[int]) -> Any:
        """Return the options of some tasks, in their sequence, shape (k,)."""
        found = [np.flatnonzero(self.option == task) for task in tasks]
        return np.concatenate([np.zeros(0, int), *found])

    def some(self, tasks: Sequence[int]) -> OrderProblem:
        """Return the problem of some of the tasks, in another sequence."""
        mine, ways = np.asarray(tasks, int), self.options(tasks)
        nodes = np.array([0, *(ways + 1), *range(1 + len(self.option), self.time.shape[1])])
        return self._replace(
            option=np.repeat(np.arange(len(mine)), [int((self.option == k).sum()) for k in mine]),
            energy=self.energy[..., nodes[:, None], nodes], finish=self.finish[:, nodes],
            floor=self.floor[..., nodes[:, None], nodes],
            time=self.time[..., nodes[:, None], nodes], finish_time=self.finish_time[nodes],
            service=self.service[ways], service_time=self.service_time[ways],
            window=self.window[mine], idle=self.idle[ways], prize=self.prize[mine],
            change=self.change[mine],
        )  # fmt: skip


class Stages(NamedTuple):
    """The S stages of a problem, and what its search reads of them."""

    after: IntTable  # (S, n): stage after each task, later ones being higher; -1 if out of turn
    there: FlagTable  # (S, N): whether the robot may be at a place
    done: Floats  # (S,): largest prize of what was done until a stage
    ahead: Floats  # (S,): largest prize of what may still be done
    load: Floats  # (S,): payload of a stage [kg], infinite if the stage does not fix it
    load_index: Ints  # (S,): which of the L loads that is, or L
    pressing: Flags  # (S,): whether a window of the tasks that may still be done ends
    opening: Floats  # (S,): when the last window of those for which waiting takes power opens [s]
    need: Floats  # (N,): charge without which no charger and no end is reached from a place [J]
    energy: FloatBlock  # (M, N, N): least energies with any payload [J]
    finish: Floats  # (N,): least energy to where the mission may end [J]
    idle: float  # largest power of waiting [W]
    visits: int  # most visits to chargers that the bound distinguishes
    most: int  # most labels to keep
    width: int  # most labels to keep of a stage and place


class Rest(NamedTuple):
    """What is to be done at least, by bucket: a stage and a place."""

    energy: FloatTable  # least energy with at least so many visits to chargers ahead [J]
    latest: Floats  # (S * N,): when to leave at the latest [s]
    charge: float  # energy that one visit adds at most [J]


@lean
def loosely(limit: float) -> float:
    """Return a limit with room for rounding."""
    return limit + _EPSILON * max(abs(limit), 1.0) if np.isfinite(limit) else limit


@lean
def energy_left(rest: Rest, bucket: int, charge: float) -> float:
    """Return what the rest takes at least with a charge on board [J]; infinite if it cannot be."""
    visits = rest.energy.shape[1] - 1
    for k in range(visits):
        least = float(rest.energy[bucket, k])
        if least <= loosely(charge + k * rest.charge):
            return least
    return float(rest.energy[bucket, visits])


@njit
def completions(problem: OrderProblem, stages: Stages, prize: float) -> Rest:
    """Bound what is left to do from each bucket on."""
    n, m, ways = len(problem.option), len(problem.capacity), problem.energy.shape[1]
    places, count = 1 + n + m, len(stages.after)
    visits = stages.visits if m > 0 else 0
    least = np.full((count * places, visits + 1), np.inf)
    latest = np.full(count * places, -np.inf)
    quickest = problem.time[0].copy()
    for way in range(1, ways):
        quickest = np.minimum(quickest, problem.time[way])
    for stage in range(count - 1, -1, -1):
        enough = stages.done[stage] >= prize - _EPSILON
        load = stages.load_index[stage]
        energy, finish = stages.energy, stages.finish
        if load < len(problem.loads):
            energy, finish = problem.energy[load], problem.finish[load]
        for p in range(places):
            if not stages.there[stage, p]:
                continue
            bucket = stage * places + p
            if enough and np.isfinite(finish[p]):
                least[bucket, 0] = finish[p]
                latest[bucket] = np.inf
            for o in range(n):
                t = problem.option[o]
                then = stages.after[stage, t]
                if then < 0 or stages.load[stage] + problem.change[t] < -GRAM:
                    continue
                way = energy[0, p, 1 + o]
                for other in range(1, ways):
                    way = min(way, energy[other, p, 1 + o])
                if not np.isfinite(way):
                    continue
                after = then * places + 1 + o
                for k in range(visits + 1):
                    through = way + problem.service[o] + least[after, k]
                    least[bucket, k] = min(least[bucket, k], through)
                begin = min(problem.window[t, 1], latest[after] - problem.service_time[o])
                if begin >= problem.window[t, 0]:
                    latest[bucket] = max(latest[bucket], begin - quickest[p, 1 + o])
        # over chargers, which may lead to chargers
        for turn in range(m + 1 if m > 0 else 0):
            last = turn == m
            for p in range(places):
                if (p > n) == last or not stages.there[stage, p]:
                    continue
                for c in range(m):
                    if 1 + n + c == p:
                        continue
                    way = energy[0, p, 1 + n + c]
                    for other in range(1, ways):
                        way = min(way, energy[other, p, 1 + n + c])
                    if not np.isfinite(way):
                        continue
                    bucket, there = stage * places + p, stage * places + 1 + n + c
                    least[bucket, 0] = min(least[bucket, 0], way + least[there, 0])
                    for k in range(1, visits + 1):
                        through = way + least[there, k - 1]
                        least[bucket, k] = min(least[bucket, k], through)
                    latest[bucket] = max(latest[bucket], latest[there] - quickest[p, 1 + n + c])
    most = problem.budget
    for c in range(m):
        most = max(most, problem.capacity[c])
    return Rest(least, latest, most if m > 0 else 0.0)


class Known(NamedTuple):
    """An order that is known, and what a better one must reach."""

    prize: float  # its prize
    energy: float  # energy that it takes [J]
    time: float  # when it ends [s]
    same: Rest  # what it takes at least to reach its prize
    more: Rest  # what it takes at least to reach `beyond`
    beyond: float


class BestOrder(NamedTuple):
    """What the search found."""

    better: bool  # whether it is better than what was known
    prize: float  # prize of the best order
    energy: float  # energy of the best order, to where the mission ends [J]
    time: float  # when the best order ends [s]
    bound: float  # energy that no order of this prize undercuts [J]
    open: bool  # whether an order of greater prize may have been left out
    stops: Ints  # numbers of places in the order of their visits
    ways: Ints  # the way of driving to each of them


class Label(NamedTuple):
    """One label; see the module."""

    energy: float
    left: float
    time: float
    rate: float
    slack: float
    prize: float
    load: float


class LabelStore(NamedTuple):
    """All labels."""

    value: FloatTable  # each label's fields, and the least energy of an order that it leads to [J]
    link: IntTable  # (n, 4): label before, place, way of driving, next label of the bucket
    head: Ints  # (S * N,): first label of each bucket
    lost: Floats  # (2,): least energy that what was left out leads to [J]; 1 if to a greater prize


@lean
def _spend(label: Label, energy: float, seconds: float, full: float, floor: float) -> Label:
    """Drive or work; charges longer before it where less than `floor` is left. May end below."""
    left, time, slack = label.left - energy, label.time + seconds, label.slack
    if left > full:
        left = max(full, label.left)
    room = max(full - left, 0.0)
    if slack * label.rate > room:
        slack = room / label.rate
    if left < floor and slack > 0.0:
        more = min((floor - left) / label.rate, slack)
        left, time, slack = left + label.rate * more, time + more, slack - more
        if left > floor - _EPSILON * max(label.left, 1.0):
            left = max(left, floor)
    return Label(label.energy + energy, left, time, label.rate, slack, label.prize, label.load)


@lean
def _begin(label: Label, earliest: float, latest: float, idle: float) -> Label:
    """Wait for a window, charging meanwhile; a time after the window is a miss."""
    energy, left, time, slack = label.energy, label.left, label.time, label.slack
    if time < earliest:
        more = min(slack, earliest - time)
        drawn = idle * (earliest - time - more)
        energy, left = energy + drawn, left + label.rate * more - drawn
        slack, time = slack - more, earliest
    slack = max(min(slack, latest - time), 0.0)
    return Label(energy, left, time, label.rate, slack, label.prize, label.load)


@lean
def _charged(label: Label) -> Label:
    """Charge as long as may be."""
    left = label.left + label.rate * label.slack
    time = label.time + label.slack
    return Label(label.energy, left, time, 0.0, 0.0, label.prize, label.load)


@lean
def _left_at(label: Label, time: float) -> float:
    return label.left + label.rate * min(max(time - label.time, 0.0), label.slack)


@lean
def _as_good(one: Label, other: Label, timed: bool, opening: float, idle: float) -> bool:
    """Return whether a label is as good as another in every respect.

    Whose charge ends earlier may have to wait longer for a window, at most at the power `idle`.
    """
    ready, end = one.time + one.slack, other.time + other.slack
    wait = idle * max(min(end, opening) - ready, 0.0) - _EPSILON
    if one.energy + wait > other.energy or one.prize < other.prize - _EPSILON:
        return False
    if abs(one.load - other.load) > _MILLIGRAM:
        return False
    if not timed:
        return one.left >= other.left + wait
    early = idle * max(min(other.time, opening) - ready, 0.0) - _EPSILON
    return (
        one.time <= other.time + _EPSILON
        and _left_at(one, other.time) >= other.left + early
        and _left_at(one, end) >= other.left + other.rate * other.slack + wait
    )


@lean
def _label(store: LabelStore, k: int) -> Label:
    v = store.value[k]
    return Label(v[0], v[1], v[2], v[3], v[4], v[5], v[6])


@inner
def _with_room(store: LabelStore, count: int, most: int) -> LabelStore:
    """Return a store with room for one more label, unless there are too many."""
    if count < len(store.value) or count >= most:
        return store
    more = min(len(store.value), most - len(store.value))
    return LabelStore(
        np.concatenate((store.value, np.empty((more, _FIELDS)))),
        np.concatenate((store.link, np.empty((more, 4), np.int64))),
        store.head,
        store.lost,
    )


@lean
def _take_out(store: LabelStore, bucket: int, k: int, before: int) -> None:
    """Take a label out of its bucket; what followed from it stays."""
    if before < 0:
        store.head[bucket] = store.link[k, 3]
    else:
        store.link[before, 3] = store.link[k, 3]
    store.link[k, 3] = _GONE


@lean
def _promise(known: Known, bucket: int, label: Label, ahead: float) -> tuple[float, bool]:
    """Return the least energy of an order of the known prize that a label leads to [J], or more."""
    prize, most = label.prize + ahead, label.left + label.rate * label.slack
    if prize < known.prize - _EPSILON:
        return np.inf, False
    least, more = np.inf, False
    if label.time <= loosely(known.same.latest[bucket]):
        least = label.energy + energy_left(known.same, bucket, most)
    if (
        len(known.more.latest) > 0
        and prize >= known.beyond - _EPSILON
        and label.time <= loosely(known.more.latest[bucket])
    ):
        more = energy_left(known.more, bucket, most) < np.inf
    return least, more


@lean
def _lose(store: LabelStore, promise: tuple[float, bool]) -> None:
    """Note what a label that is left out for want of room may have reached."""
    store.lost[0] = min(store.lost[0], promise[0])
    if promise[1]:
        store.lost[1] = 1.0


@lean
def _behind(one: Label, least: float, other: Label, other_least: float) -> bool:
    """Return whether a label promises less than another."""
    if abs(one.prize - other.prize) > _EPSILON:
        return one.prize < other.prize
    mine = least if np.isfinite(least) else _FAR + one.energy
    return mine > (other_least if np.isfinite(other_least) else _FAR + other.energy)


@lean
def _keep(
    store: LabelStore, stages: Stages, known: Known, stage: int, place: int, new: Label, count: int
) -> bool:
    """Add a label to its bucket; not where one there is as good, or where nothing comes of it."""
    bucket, ahead = stage * len(stages.need) + place, stages.ahead[stage]
    timed, opening, idle = stages.pressing[stage], stages.opening[stage], stages.idle
    least, more = _promise(known, bucket, new, ahead)
    if not (more or least <= loosely(known.energy)):
        return False
    there, k = 0, store.head[bucket]
    while k >= 0:
        if _as_good(_label(store, k), new, timed, opening, idle):
            return False
        k = store.link[k, 3]
    if count >= len(store.value):
        _lose(store, (least, more))
        return False
    previous, worst, before_worst, k = -1, -1, -1, store.head[bucket]
    last, last_least = new, least
    while k >= 0:
        after, old = store.link[k, 3], _label(store, k)
        if _as_good(new, old, timed, opening, idle):
            _take_out(store, bucket, k, previous)
        else:
            there += 1
            if _behind(old, store.value[k, 7], last, last_least):
                last, last_least, worst, before_worst = old, store.value[k, 7], k, previous
            previous = k
        k = after
    if there >= stages.width:
        # as many labels as there may be: the one that promises least goes
        if worst < 0:
            _lose(store, (least, more))
            return False
        _lose(store, _promise(known, bucket, last, ahead))
        _take_out(store, bucket, worst, before_worst)
    value = store.value
    value[count, 0], value[count, 1], value[count, 2] = new.energy, new.left, new.time
    value[count, 3], value[count, 4], value[count, 5] = new.rate, new.slack, new.prize
    value[count, 6], value[count, 7] = new.load, least
    store.link[count, 3] = store.head[bucket]
    store.head[bucket] = count
    return True


@lean
def _docked(problem: OrderProblem, here: Label, charger: int, kind: int) -> Label:
    """Begin to charge; after another charger: here only (0), there first (1), or not here (2)."""
    power, full = problem.charge_power[charger], problem.capacity[charger]
    new = _charged(here) if kind == 1 else here
    if kind == 2:
        return new
    room = max(full - new.left, 0.0) / power
    return Label(new.energy, new.left, new.time, power, room, new.prize, new.load)


@lean
def _priced(problem: OrderProblem, load: float) -> int:
    """Return which of the payloads that energies are known for stands for a payload."""
    return min(int(np.searchsorted(problem.loads, load - _MILLIGRAM)), len(problem.loads) - 1)


@inner
def _recharged(
    problem: OrderProblem, stages: Stages, known: Known, store: LabelStore, count: int, stage: int,
    stack: Ints,
) -> tuple[LabelStore, int]:  # fmt: skip
    """Return the labels, and how many, with those at chargers, which may lead to chargers again."""
    n, m, timed = len(problem.option), len(problem.capacity), stages.pressing[stage]
    size = 0
    for place in range(1 + n + m):
        k = store.head[stage * (1 + n + m) + place]
        while k >= 0:
            if size == len(stack):
                stack = np.append(stack, np.empty(len(stack), np.int64))
            stack[size] = k
            size += 1
            k = store.link[k, 3]
    while size > 0:
        size -= 1
        k = stack[size]
        if store.link[k, 3] == _GONE:
            continue
        here, at = _label(store, k), store.link[k, 1]
        load = _priced(problem, here.load)
        for charger in range(m):
            place = 1 + n + charger
            if place == at:
                continue
            for way in range(problem.energy.shape[1]):
                spent = problem.energy[load, way, at, place]
                if not np.isfinite(spent):
                    continue
                floor = problem.floor[load, way, at, place]
                there = _spend(here, spent, problem.time[way, at, place], problem.full, floor)
                if there.left < floor:
                    continue
                quicker = timed and there.slack > 0.0 and there.rate > problem.charge_power[charger]
                for kind in range(3 if quicker else 1):
                    new = _docked(problem, there, charger, kind)
                    if not timed:
                        new = _charged(new)
                    store = _with_room(store, count, stages.most)
                    if _keep(store, stages, known, stage, place, new, count):
                        link = store.link
                        link[count, 0], link[count, 1], link[count, 2] = k, place, way
                        if size == len(stack):
                            stack = np.append(stack, np.empty(len(stack), np.int64))
                        stack[size] = count
                        size += 1
                        count += 1
    return store, count


class OrderEnd(NamedTuple):
    """What an order comes to at its end."""

    prize: float
    energy: float  # [J]
    time: float  # [s]


@lean
def _improves(end: OrderEnd, known: OrderEnd) -> bool:
    """Return whether an order is of greater prize than another, or of the same and takes less."""
    if not end.prize > known.prize - _EPSILON:
        return False
    rounding = loosely(known.energy) - known.energy
    return (
        end.prize > known.prize + _EPSILON
        or end.energy < known.energy - rounding
        or (end.energy <= known.energy + rounding and loosely(end.time) < known.time)
    )


class Advance(NamedTuple):
    """How far the search is."""

    known: Known  # the best order known
    best: int  # the label that it comes from, or -1
    store: LabelStore
    labels: int  # number of labels


@inner
def _advanced(
    problem: OrderProblem, stages: Stages, known: Known, best: int, store: LabelStore, count: int,
    stage: int,
) -> Advance:  # fmt: skip
    """End with the labels of a stage, and do with each of them every task that may come next."""
    n, ways = len(problem.option), problem.energy.shape[1]
    places = 1 + n + len(problem.capacity)
    for place in range(places):
        k = store.head[stage * places + place]
        while k >= 0:
            here = _label(store, k)
            load = _priced(problem, here.load)
            energy, finish = problem.energy[load], problem.finish[load]
            last = _spend(here, finish[place], problem.finish_time[place], problem.full, 0.0)
            end = OrderEnd(here.prize, last.energy, last.time)
            ends = last.left >= 0.0 and np.isfinite(last.energy)
            if ends and _improves(end, OrderEnd(known.prize, known.energy, known.time)):
                best = k
                known = Known(end.prize, end.energy, end.time, known.same, known.more, known.beyond)
            for o in range(n):
                t = problem.option[o]
                after, carried = stages.after[stage, t], here.load + problem.change[t]
                if after < 0 or carried < -GRAM:
                    continue
                opens, closes = problem.window[t, 0], problem.window[t, 1]
                for way in range(ways):
                    spent = energy[way, place, 1 + o]
                    if not np.isfinite(spent):
                        continue
                    lasts = problem.time[way, place, 1 + o]
                    there = _spend(here, spent, lasts, problem.full, 0.0)
                    if there.left < 0.0 or there.time > closes + _EPSILON:
                        continue
                    begun = _begin(there, opens, closes, problem.idle[o])
                    floor = problem.floor[load, way, place, 1 + o]
                    done = _spend(begun, problem.service[o], 0.0, problem.full, floor)
                    if done.left < floor or done.time > closes + _EPSILON:
                        continue
                    done = Label(
                        done.energy, done.left, done.time + problem.service_time[o], done.rate,
                        done.slack, done.prize + problem.prize[t], carried,
                    )  # fmt: skip
                    if not stages.pressing[after]:
                        done = _charged(done)
                    if done.left + done.rate * done.slack < stages.need[1 + o] - _EPSILON:
                        continue
                    store = _with_room(store, count, stages.most)
                    if _keep(store, stages, known, after, 1 + o, done, count):
                        link = store.link
                        link[count, 0], link[count, 1], link[count, 2] = k, 1 + o, way
                        count += 1
            k = store.link[k, 3]
    return Advance(known, best, store, count)


@njit
def search(problem: OrderProblem, stages: Stages, known: Known) -> BestOrder:
    """Find an order of greater prize than the one known, or of the same and less energy or time."""
    places = 1 + len(problem.option) + len(problem.capacity)
    store = LabelStore(
        np.empty((min(_FEW, stages.most), _FIELDS)),
        np.empty((min(_FEW, stages.most), 4), np.int64),
        np.full(len(stages.after) * places, -1, np.int64),
        np.array([np.inf, 0.0]),
    )
    best, count, stack = -1, 0, np.empty(256, np.int64)
    start = Label(0.0, problem.budget, problem.start_time, 0.0, 0.0, 0.0, problem.payload)
    if _keep(store, stages, known, 0, 0, start, 0):
        store.link[0, 0], store.link[0, 1], store.link[0, 2] = -1, 0, 0
        count = 1
    for stage in range(len(stages.after)):
        if len(problem.capacity) > 0:
            store, count = _recharged(problem, stages, known, store, count, stage, stack)
        known, best, store, count = _advanced(problem, stages, known, best, store, count, stage)
    length, k = 0, best
    while k > 0:
        length, k = length + 1, store.link[k, 0]
    stops, driven = np.empty(length, np.int64), np.empty(length, np.int64)
    k = best
    while k > 0:
        length -= 1
        stops[length], driven[length] = store.link[k, 1], store.link[k, 2]
        k = store.link[k, 0]
    bound = min(known.energy, store.lost[0])
    return BestOrder(
        best >= 0, known.prize, known.energy, known.time, bound, store.lost[1] > 0.0, stops, driven
    )
