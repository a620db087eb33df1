"""Who does which tasks in which sequence: ruin and recreate, with charges where they are needed.

A tour is a sequence of options with the charger, if any, that the robot drives to before each. In
each round strings of tasks that are near each other are taken out of their tours, and each is put
in again where it adds least (Christiaens and Vanden Berghe 2020). What comes of it is kept if it is
better, or by chance, the less often the longer the search goes on. The rounds are counted and the
chances are drawn from a fixed seed, so that the answer is the same everywhere.
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
    IntTable,
    inner,
    njit,
)

_GRAM = 1e-3
_EPSILON = 1e-9
_STRING = 10  # most tasks of one string
_TOGETHER = 12  # most tasks that are taken out at once, on average
_PART, _ALL = 0.6, 8  # most part of all tasks, and number up to which that is all of them
_BLINK = 0.01  # chance of not seeing a place when a task is put in
_HOT, _COLD = 1.0, 0.01  # energies of a difference that chance accepts, over that of a way
_LABELS = 8  # ways of charging that are kept at each stop
_MODULUS, _FACTOR = 2**31 - 1, 48271  # of Lehmer's random numbers


class Tours(NamedTuple):
    """Robots that share n tasks, as arrays; R robots, N places: start, K options, m chargers."""

    option: Ints  # (K,): task of each option, ascending
    energy: FloatBlock  # (R, N, N): energies from place to place, the option at the end too [J]
    time: FloatBlock  # (R, N, N): travel times [s]
    finish: FloatTable  # (R, N): energy to where a robot may end [J]
    service_time: FloatTable  # (R, K): time of each option [s]
    window: FloatTable  # (n, 2): earliest and latest begin [s]
    idle: FloatTable  # (R, K): power of waiting at each option [W]
    change: Floats  # (n,): change of the payload by each task [kg]
    prize: Floats  # (n,): prize of each task as an energy, above that of any sequence [J]
    budget: Floats  # (R,): energy at the start [J]
    capacity: FloatTable  # (R, m): energy on leaving each charger when full [J]
    charge_power: FloatTable  # (R, m): energy stored per second at each charger [W]
    start_time: Floats  # (R,): time at the start [s]
    payload: Floats  # (R,): payload at the start [kg]


class Plans(NamedTuple):
    """The tours of all robots, and what putting a task in reads of them."""

    stops: IntTable  # (R, n): options in their sequence
    via: IntTable  # (R, n + 2): charger before each stop and before the end; -1 if none
    counts: Ints  # (R,): number of stops
    begin: FloatTable  # (R, n): when each stop begins, charges left out [s]
    latest: FloatTable  # (R, n + 1): when to begin at the latest [s]
    waits: FloatTable  # (R, n + 1): waiting from each stop on [s]
    load: FloatTable  # (R, n + 1): payload before each stop [kg]
    lowest: FloatTable  # (R, n + 1): least payload from before each stop on [kg]
    driven: Floats  # (R,): energy without charges [J]
    energy: Floats  # (R,): energy with charges [J]


@inner
def _drawn(state: Ints) -> float:
    """Return the next random number in (0, 1)."""
    state[0] = state[0] * _FACTOR % _MODULUS
    return float(state[0] / _MODULUS)


@inner
def _time_tour(tours: Tours, plans: Plans, r: int, timed: bool) -> bool:
    """Work out a robot's tour without charges; return whether windows and payload allow it."""
    count, here, stops = plans.counts[r], 0, plans.stops[r]
    energy, time, load = 0.0, tours.start_time[r], tours.payload[r]
    for k in range(count):
        option = stops[k]
        task = tours.option[option]
        energy += tours.energy[r, here, 1 + option]
        time += tours.time[r, here, 1 + option]
        wait = max(tours.window[task, 0] - time, 0.0)
        energy, time = energy + tours.idle[r, option] * wait, time + wait
        plans.begin[r, k], plans.waits[r, k], plans.load[r, k] = time, wait, load
        load += tours.change[task]
        if time > tours.window[task, 1] + _EPSILON or load < -_GRAM:
            return False
        time += tours.service_time[r, option]
        here = 1 + option
    plans.driven[r] = plans.energy[r] = energy + tours.finish[r, here]
    plans.load[r, count] = plans.lowest[r, count] = load
    plans.latest[r, count], plans.waits[r, count] = np.inf, 0.0
    for k in range(count - 1, -1, -1):
        plans.lowest[r, k] = min(plans.load[r, k], plans.lowest[r, k + 1])
        plans.waits[r, k] += plans.waits[r, k + 1]
        if timed:
            latest = tours.window[tours.option[stops[k]], 1]
            if k + 1 < count:
                onward = tours.time[r, 1 + stops[k], 1 + stops[k + 1]]
                onward += tours.service_time[r, stops[k]]
                latest = min(latest, plans.latest[r, k + 1] - onward)
            plans.latest[r, k] = latest
    return bool(np.isfinite(plans.driven[r]))


@inner
def _add(
    labels: FloatTable, links: IntTable, there: int, energy: float, left: float, time: float,
    before: int, charger: int,
) -> int:  # fmt: skip
    """Keep a label, ascending by energy, where no other one beats it; return how many there are."""
    at = there
    for k in range(there):
        if labels[k, 0] <= energy and labels[k, 1] >= left and labels[k, 2] <= time:
            return there
        if labels[k, 0] > energy and at == there:
            at = k
    if at >= _LABELS:
        return there
    there = min(there + 1, _LABELS)
    for k in range(there - 1, at, -1):
        labels[k] = labels[k - 1]
        links[k] = links[k - 1]
    labels[at, 0], labels[at, 1], labels[at, 2] = energy, left, time
    links[at, 0], links[at, 1] = before, charger
    return there


@inner
def _charge(tours: Tours, plans: Plans, r: int, timed: bool) -> bool:
    """Find where a robot's tour charges; return whether its battery lasts.

    A charge is full, or half of that where there are windows. There is one at most between two
    stops.
    """
    n, m, count = len(tours.option), tours.capacity.shape[1], plans.counts[r]
    plans.via[r, : count + 1] = -1
    plans.energy[r] = plans.driven[r]
    if plans.driven[r] <= tours.budget[r]:
        return True
    if m == 0:
        return False
    amounts = 2 if timed else 1  # charged to the full, or half of that
    value = np.empty((count + 2, _LABELS, 3))
    link = np.empty((count + 2, _LABELS, 2), np.int64)
    value[0, 0, 0], value[0, 0, 1] = 0.0, tours.budget[r]
    value[0, 0, 2] = tours.start_time[r] if timed else 0.0
    here, there = 0, 1
    for k in range(count + 1):
        now, after, links = value[k], value[k + 1], link[k + 1]
        goal = 1 + plans.stops[r, k] if k < count else -1
        opens, closes, idle, service = -np.inf, np.inf, 0.0, 0.0
        if goal > 0:
            task = tours.option[goal - 1]
            opens, closes = tours.window[task, 0], tours.window[task, 1]
            idle, service = tours.idle[r, goal - 1], tours.service_time[r, goal - 1]
        kept = 0
        for j in range(there):
            for choice in range(-1, m * amounts):
                energy, left, time = now[j, 0], now[j, 1], now[j, 2]
                place, c = here, choice // amounts
                if choice >= 0:
                    place = 1 + n + c
                    spent = tours.energy[r, here, place]
                    energy, left = energy + spent, left - spent
                    if not left >= 0.0:
                        continue
                    more = max(tours.capacity[r, c] - left, 0.0) / (1 + choice % amounts)
                    left += more
                    time += tours.time[r, here, place] + more / tours.charge_power[r, c]
                spent = tours.energy[r, place, goal] if goal > 0 else tours.finish[r, place]
                energy, left = energy + spent, left - spent
                if timed and goal > 0:
                    time += tours.time[r, place, goal]
                    wait = max(opens - time, 0.0)
                    energy, left, time = energy + idle * wait, left - idle * wait, time + wait
                    if time > closes + _EPSILON:
                        continue
                    time += service
                if left >= 0.0:
                    after_charging = c if choice >= 0 else -1
                    kept = _add(after, links, kept, energy, left, time, j, after_charging)
        if kept == 0:
            return False
        here, there = goal, kept
    plans.energy[r] = value[count + 1, 0, 0]
    at = 0
    for k in range(count, -1, -1):
        plans.via[r, k] = link[k + 1, at, 1]
        at = link[k + 1, at, 0]
    return True


@inner
def _more(tours: Tours, plans: Plans, r: int, k: int, option: int, timed: bool) -> float:
    """Return what an option adds to a tour before its k-th stop [J]; infinite if it cannot be."""
    count = plans.counts[r]
    task, place = tours.option[option], 1 + option
    here = 0 if k == 0 else 1 + plans.stops[r, k - 1]
    change = tours.change[task]
    if plans.load[r, k] + change < -_GRAM or plans.lowest[r, k] + change < -_GRAM:
        return np.inf
    into, energy = tours.energy[r, here, place], tours.energy[r]
    if k < count:
        goal = 1 + plans.stops[r, k]
        onward, direct = energy[place, goal], energy[here, goal]
    else:
        goal = -1
        onward, direct = tours.finish[r, place], tours.finish[r, here]
    added = into + onward - direct
    if plans.via[r, k] >= 0:
        charger = 1 + len(tours.option) + plans.via[r, k]
        last = tours.finish[r, charger] if goal < 0 else energy[charger, goal]
        added = min(
            into + energy[place, charger] - energy[here, charger],
            energy[charger, place] + onward - last,
        )
    if not timed:
        return float(added)
    time = tours.start_time[r]
    if k > 0:
        time = plans.begin[r, k - 1] + tours.service_time[r, plans.stops[r, k - 1]]
    time += tours.time[r, here, place]
    wait = max(tours.window[task, 0] - time, 0.0)
    added, time = added + tours.idle[r, option] * wait, time + wait
    if time > tours.window[task, 1] + _EPSILON:
        return np.inf
    if k == count:
        return float(added)
    time += tours.service_time[r, option] + tours.time[r, place, goal]
    if time > plans.latest[r, k] + _EPSILON:
        return np.inf
    # whoever is reached later waits less
    delay = time - plans.begin[r, k] + plans.waits[r, k] - plans.waits[r, k + 1]
    for later in range(k, count):
        if delay <= 0.0 or plans.waits[r, later] <= 0.0:
            break
        less = min(plans.waits[r, later] - plans.waits[r, later + 1], delay)
        added -= tours.idle[r, plans.stops[r, later]] * less
        delay -= less
    return float(added)


@inner
def _put_in(tours: Tours, plans: Plans, r: int, k: int, option: int, timed: bool) -> bool:
    """Put an option before a robot's k-th stop, or take the k-th out where there is no option."""
    count, stops, via = plans.counts[r], plans.stops[r], plans.via[r]
    if option >= 0:
        via[count + 1 :] = -1
        for j in range(count, k, -1):
            stops[j] = stops[j - 1]
        for j in range(count + 1, k, -1):
            via[j] = via[j - 1]
        stops[k] = option
        plans.counts[r] = count + 1
    else:
        for j in range(k, count - 1):
            stops[j] = stops[j + 1]
        for j in range(k, count):
            via[j] = via[j + 1]
        plans.counts[r] = count - 1
    return _time_tour(tours, plans, r, timed)


@inner
def _recreate(
    tours: Tours, plans: Plans, out: Flags, closed: Flags, way: int, strict: bool, timed: bool,
    first: Ints, state: Ints,
) -> None:  # fmt: skip
    """Put tasks that are out in again, each where it adds least."""
    n, robots, m = len(out), len(plans.counts), tours.capacity.shape[1]
    rank, tasks = np.empty(n), np.empty(n, np.int64)
    some = 0
    for t in range(n):
        if out[t]:
            nearest = tours.energy[0, 0, 1 + first[t]]
            chance = _drawn(state)
            if way == 0:
                rank[some] = chance
            elif way == 1:
                rank[some] = -nearest
            elif way == 2:
                rank[some] = nearest
            else:
                rank[some] = tours.window[t, 1]
            rank[some] -= tours.prize[t] if strict else 0.0
            tasks[some] = t
            some += 1
    for t in tasks[:some][np.argsort(rank[:some], kind="mergesort")]:
        barred = closed.copy()
        while True:
            least, robot, at, best = tours.prize[t], -1, 0, -1
            for r in range(robots):
                if barred[r]:
                    continue
                empty = plans.driven[r] if plans.counts[r] > 0 else 0.0
                used = plans.driven[r] - empty
                for option in range(first[t], first[t + 1]):
                    for k in range(plans.counts[r] + 1):
                        if _drawn(state) < _BLINK:
                            continue
                        added = _more(tours, plans, r, k, option, timed) + used
                        if added >= least:
                            continue
                        if m == 0 and empty + added > tours.budget[r]:
                            continue
                        least, robot, at, best = added, r, k, option
            if robot < 0:
                break
            before, was = plans.driven[robot], plans.energy[robot]
            possible = _put_in(tours, plans, robot, at, best, timed)
            if possible and strict:
                possible = _charge(tours, plans, robot, timed)
            if possible:
                out[t] = False
                break
            _put_in(tours, plans, robot, at, -1, timed)
            plans.driven[robot], plans.energy[robot] = before, was
            barred[robot] = True


@inner
def _copy(plans: Plans, other: Plans) -> None:
    """Let plans be as others."""
    plans.stops[:], plans.via[:], plans.counts[:] = other.stops, other.via, other.counts
    plans.begin[:], plans.latest[:], plans.waits[:] = other.begin, other.latest, other.waits
    plans.load[:], plans.lowest[:] = other.load, other.lowest
    plans.driven[:], plans.energy[:] = other.driven, other.energy


@inner
def _no_plans(robots: int, n: int) -> Plans:
    return Plans(
        np.zeros((robots, n), np.int64), np.full((robots, n + 2), -1, np.int64),
        np.zeros(robots, np.int64), np.zeros((robots, n)), np.zeros((robots, n + 1)),
        np.zeros((robots, n + 1)), np.zeros((robots, n + 1)), np.zeros((robots, n + 1)),
        np.zeros(robots), np.zeros(robots),
    )  # fmt: skip


@inner
def _spent(plans: Plans) -> float:
    """Return the energy of all tours; a robot that does nothing takes none [J]."""
    total = 0.0
    for r in range(len(plans.counts)):
        if plans.counts[r] > 0:
            total += plans.energy[r]
    return total


@inner
def _ruin(plans: Plans, where: IntTable, near: IntTable, out: Flags, state: Ints) -> None:
    """Take strings of tasks that are near each other out of their tours."""
    n = len(out)
    most = min(2.0 * _TOGETHER - 1.0, max(_PART * n, min(n, _ALL)))
    left = 1 + int(_drawn(state) * most)
    for t in near[int(_drawn(state) * n)]:
        if left <= 0:
            break
        r, k = where[t, 0], where[t, 1]
        if out[t] or r < 0:
            continue
        length = 1 + int(_drawn(state) * min(_STRING, left, plans.counts[r]))
        begin = max(k - int(_drawn(state) * length), 0)
        for j in range(begin, min(begin + length, plans.counts[r])):
            task = where[n + r * n + j, 0]
            if not out[task]:
                out[task] = True
                left -= 1


@inner
def _take_out(tours: Tours, plans: Plans, out: Flags, nothing: Plans, timed: bool) -> bool:
    """Take tasks out of their tours; return whether the rest can still be done in time."""
    possible = True
    for r in range(len(plans.counts)):
        kept = 0
        for k in range(plans.counts[r]):
            if not out[tours.option[plans.stops[r, k]]]:
                plans.stops[r, kept] = plans.stops[r, k]
                plans.via[r, kept] = plans.via[r, k]
                kept += 1
        if kept < plans.counts[r]:
            plans.via[r, kept] = plans.via[r, plans.counts[r]]
            plans.via[r, kept + 1 :] = -1
            plans.counts[r] = kept
            if not _time_tour(tours, plans, r, timed):
                possible = possible and kept == 0
                plans.driven[r] = nothing.driven[r]
            plans.energy[r] = plans.driven[r]
    return possible


@inner
def _by_distance(tours: Tours) -> IntTable:
    """Return for each task all tasks, the nearest first, by the robot of least energy."""
    n = len(tours.prize)
    distance = np.full((n, n), np.inf)
    for o in range(len(tours.option)):
        for other in range(len(tours.option)):
            t, u = tours.option[o], tours.option[other]
            way = np.inf
            for r in range(len(tours.budget)):
                way = min(way, tours.energy[r, 1 + o, 1 + other])
            distance[t, u] = min(distance[t, u], way)
            distance[u, t] = min(distance[u, t], way)
    near = np.zeros((n, n), np.int64)
    for t in range(n):
        distance[t, t] = -np.inf
        near[t] = np.argsort(distance[t], kind="mergesort")
    return near


@njit
def share(tours: Tours, rounds: int, seed: int, open_to_all: bool) -> tuple[IntTable, Ints]:
    """Give tasks to robots, as options in sequences: a number of rounds of ruin and recreate."""
    robots, n, m = len(tours.budget), len(tours.prize), tours.capacity.shape[1]
    state = np.array([1 + seed])
    for _ in range(10):
        _drawn(state)
    timed = False
    for t in range(n):
        if np.isfinite(tours.window[t, 1]) or tours.window[t, 0] > tours.start_time.min():
            timed = True
    first = np.searchsorted(tours.option, np.arange(n + 1))
    near = _by_distance(tours)
    now, new, best = _no_plans(robots, n), _no_plans(robots, n), _no_plans(robots, n)
    closed = np.zeros(robots, np.bool_)
    for r in range(robots):
        if not _time_tour(tours, now, r, timed):
            now.driven[r] = 0.0  # it cannot even end from its start
        now.energy[r] = now.driven[r]
    nothing = _no_plans(robots, n)
    _copy(nothing, now)
    out = np.ones(n, np.bool_)
    _recreate(tours, now, out, closed, 0, m > 0, timed, first, state)
    cost = _spent(now) + tours.prize[out].sum()
    _copy(best, now)
    best_cost = cost
    typical = max(abs(_spent(now)) / max(n, 1), _EPSILON)
    cooling = (_COLD / _HOT) ** (1.0 / max(rounds, 1))
    heat = _HOT * typical
    where = np.full((n + robots * n, 2), -1, np.int64)
    new_out = out.copy()
    for turn in range(rounds):
        heat *= cooling
        where[:n] = -1
        for r in range(robots):
            for k in range(now.counts[r]):
                task = tours.option[now.stops[r, k]]
                where[task, 0], where[task, 1], where[n + r * n + k, 0] = r, k, task
        _copy(new, now)
        new_out[:] = out
        _ruin(now, where, near, new_out, state)
        if not _take_out(tours, new, new_out, nothing, timed):
            continue  # what is left needs what was taken out
        left_out = bool(np.any(out))
        if robots > 1 and not open_to_all and turn % 8 == 0:
            for r in range(robots):
                closed[r] = _drawn(state) < 0.5
            way = int(_drawn(state) * 4.0)
            _recreate(tours, new, new_out, closed, way, left_out and m > 0, timed, first, state)
            closed[:] = False
        way = int(_drawn(state) * 4.0)
        _recreate(tours, new, new_out, closed, way, left_out and m > 0, timed, first, state)
        then = tours.prize[new_out].sum()
        limit = cost - heat * np.log(_drawn(state))
        for r in range(robots):
            if new.counts[r] > 0:
                then += new.driven[r]
        if not then < limit:
            continue
        possible = True
        for r in range(robots):
            if new.counts[r] > 0 and not _charge(tours, new, r, timed):
                possible = False
        then = _spent(new) + tours.prize[new_out].sum()
        if possible and then < limit:
            _copy(now, new)
            out[:] = new_out
            cost = then
            if cost < best_cost - _EPSILON:
                best_cost = cost
                _copy(best, now)
    return best.stops, best.counts
