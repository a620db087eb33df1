"""Exact assignment, orders and charges of a few robots, with a certificate.

For each robot a dynamic programme over subsets of tasks tells the least energy that it does each of
them with, as if the chargers were its own. Assignments are looked at in the order of the sum of
these, which no schedule can undercut. Where robots get into each other's way at a charger, further
orders of the same assignment follow, in the order of their energy, until what is left to look at
cannot be better than what was found.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np

from energyplan.fleet.problem import RobotProblem, Status, arrive, begin, charge, do_task, end, run
from energyplan.path import FloatArray

MOST_ASSIGNMENTS = 300_000
"""Most ways to give tasks to robots that are looked at one by one."""

MOST_TASKS = 10
"""Most tasks of an exact answer."""

_MOST_SCHEDULES = 20_000
_EQUAL = 1e-6


@dataclass(frozen=True)
class Solution:
    """Who does what, in which order."""

    sequences: tuple[tuple[int, ...], ...]  # each robot's stops
    worth: float  # worth of the tasks done
    energy: float  # energy of all robots [J]
    bound: float  # energy that no solution of this worth undercuts [J]
    proven: bool  # whether no better one exists


def is_small(robots: int, tasks: int) -> bool:
    """Tell whether an exact answer is to be had."""
    return tasks <= MOST_TASKS and (robots + 1) ** tasks <= MOST_ASSIGNMENTS


class _Label(NamedTuple):
    status: Status
    stops: tuple[int, ...]


def solve(problems: Sequence[RobotProblem], worth: FloatArray, places: Sequence[int]) -> Solution:
    """Find the assignment of greatest worth, and of least energy among those."""
    robots, n = len(problems), len(worth)
    best = [_subsets(problem) for problem in problems]
    least = np.full((robots, 2**n), np.inf)
    for r, found in enumerate(best):
        for mask, label in found.items():
            least[r, mask] = label.status.spent
    digits = np.arange((robots + 1) ** n)[:, None] // (robots + 1) ** np.arange(n) % (robots + 1)
    bits = 1 << np.arange(n)
    masks = np.stack([((digits == r) * bits).sum(axis=1) for r in range(robots)])
    total = sum(least[r, masks[r]] for r in range(robots))
    values = (digits < robots) @ worth
    possible = np.flatnonzero(np.isfinite(total))
    order = possible[np.lexsort((total[possible], -values[possible]))]
    if not len(order):  # not even standing still is possible
        return Solution(((),) * robots, 0.0, np.inf, np.inf, True)
    return _Search(problems, places, best, masks, np.asarray(total), values).run(order)


def best_tour(problem: RobotProblem, tasks: Collection[int]) -> tuple[float, tuple[int, ...]]:
    """Return the way of least energy of one robot through some tasks, all of them."""
    mine = np.array(sorted(tasks), int)
    nodes = np.array([0, *(mine + 1), *range(1 + problem.tasks, len(problem.energy))])
    part = replace(
        problem,
        energy=problem.energy[np.ix_(nodes, nodes)],
        time=problem.time[np.ix_(nodes, nodes)],
        finish=problem.finish[nodes],
        finish_time=problem.finish_time[nodes],
        refuge=problem.refuge[nodes],
        service=problem.service[mine],
        service_time=problem.service_time[mine],
        idle=problem.idle[nodes],
        window=problem.window[mine],
    )
    label = _subsets(part).get(2 ** len(mine) - 1)
    if label is None:
        return np.inf, ()
    return label.status.spent, tuple(int(nodes[stop]) for stop in label.stops)


class _Search:
    """Looks at assignments, and at the orders of each, from the cheapest on."""

    def __init__(
        self,
        problems: Sequence[RobotProblem],
        places: Sequence[int],
        best: list[dict[int, _Label]],
        masks: FloatArray,
        total: FloatArray,
        values: FloatArray,
    ) -> None:
        self._problems, self._places, self._best = problems, places, best
        self._masks, self._total, self._values = masks, total, values
        self._known: dict[tuple[int, int], _Sequences] = {}

    def run(self, order: np.ndarray) -> Solution:
        robots = len(self._problems)
        found: Solution | None = None
        # what is left to look at, by worth and by an energy that it cannot undercut
        pending: list[tuple[float, float, int, int, tuple[int, ...]]] = []
        seen: set[tuple[int, tuple[int, ...]]] = set()
        number, fresh, runs = count(), iter(order.tolist()), 0
        ahead = next(fresh, None)
        while True:
            if ahead is not None:
                key = (-float(self._values[ahead]), float(self._total[ahead]))
                if not pending or key < pending[0][:2]:
                    heapq.heappush(pending, (*key, next(number), ahead, (0,) * robots))
                    ahead = next(fresh, None)
                    continue
            if not pending:
                break
            less, bound, _, assignment, ranks = heapq.heappop(pending)
            if found is not None and (less, bound) >= (-found.worth, found.energy - _EQUAL):
                return found
            if runs >= _MOST_SCHEDULES:
                if found is not None:
                    bound = bound if -less == found.worth else 0.0
                    return Solution(found.sequences, found.worth, found.energy, bound, False)
                break
            runs += 1
            sequences = self._sequences(assignment, ranks)
            outcome = run(self._problems, sequences, self._places)
            if outcome is not None and (
                found is None or (less, outcome.energy) < (-found.worth, found.energy)
            ):
                found = Solution(sequences, -less, outcome.energy, outcome.energy, True)
                if outcome.energy <= bound + _EQUAL:
                    return found
            for r in range(robots):
                after = tuple(rank + (k == r) for k, rank in enumerate(ranks))
                if (assignment, after) in seen:
                    continue
                seen.add((assignment, after))
                energies = [self._energy(assignment, k, rank) for k, rank in enumerate(after)]
                if all(energy is not None for energy in energies):
                    grown = sum(energy for energy in energies if energy is not None)
                    heapq.heappush(pending, (less, grown, next(number), assignment, after))
        if found is not None:
            return found
        return Solution(((),) * robots, 0.0, np.inf, 0.0, False)

    def _one(self, assignment: int, robot: int) -> _Sequences:
        key = robot, int(self._masks[robot, assignment])
        if key not in self._known:
            self._known[key] = _Sequences(self._problems[robot], key[1], self._best[robot][key[1]])
        return self._known[key]

    def _energy(self, assignment: int, robot: int, rank: int) -> float | None:
        label = self._one(assignment, robot).at(rank)
        return None if label is None else label.status.spent

    def _sequences(self, assignment: int, ranks: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
        labels = [self._one(assignment, robot).at(rank) for robot, rank in enumerate(ranks)]
        return tuple(label.stops for label in labels if label is not None)


# -- one robot -----------------------------------------------------------------------------------


def _subsets(problem: RobotProblem) -> dict[int, _Label]:
    """Return the way of least energy through each subset of tasks, the chargers being its own."""
    n = problem.tasks
    layers: dict[int, dict[int, list[_Label]]] = {0: {0: [_Label(begin(problem), ())]}}
    best: dict[int, _Label] = {}
    for mask in sorted(range(2**n), key=lambda m: (m.bit_count(), m)):
        here = layers.pop(mask, None)
        if here is None:
            continue
        pending = [label for labels in here.values() for label in labels]
        while pending:
            label = pending.pop()
            new = [one for one in _charged(problem, label) if _keep(problem, here, one)]
            pending.extend(new)
        for labels in here.values():
            for label in labels:
                ended = end(problem, label.status)
                if ended is not None and (mask not in best or _precedes(ended, best[mask].status)):
                    best[mask] = _Label(ended, label.stops)
                for task in range(n):
                    if mask >> task & 1:
                        continue
                    done = do_task(problem, label.status, task)
                    if done is not None:
                        grown = layers.setdefault(mask | 1 << task, {})
                        _keep(problem, grown, _Label(done, (*label.stops, task + 1)))
    return best


def _precedes(one: Status, other: Status) -> bool:
    """Tell whether one takes less energy than another, or the same in less time."""
    if one.spent < other.spent - _EQUAL:
        return True
    return one.spent <= other.spent + _EQUAL and one.time < other.time


def _charged(problem: RobotProblem, label: _Label) -> Iterator[_Label]:
    """Yield the ways to charge next, each charger once between two tasks."""
    first = 1 + problem.tasks
    since: list[int] = []
    for stop in reversed(label.stops):
        if stop < first:
            break
        since.append(stop)
    for charger in range(first, first + len(problem.capacity)):
        if charger not in since:
            docked = arrive(problem, label.status, charger)
            full = charge(problem, docked) if np.isfinite(docked.spent) else None
            if full is not None:
                yield _Label(full, (*label.stops, charger))


def _keep(problem: RobotProblem, labels: dict[int, list[_Label]], new: _Label) -> bool:
    """Keep a label at its node unless another one is as good; drop those that it is better than."""
    there = labels.setdefault(new.status.node, [])
    if any(_as_good(problem, old.status, new.status) for old in there):
        return False
    there[:] = [old for old in there if not _as_good(problem, new.status, old.status)]
    there.append(new)
    return True


def _as_good(problem: RobotProblem, one: Status, other: Status) -> bool:
    """Tell whether a status is as good as another at the same node, whatever comes."""
    if not problem.timed:
        return one.spent <= other.spent and one.left >= other.left
    early = other.time - one.time
    if early < 0:
        return False
    # who is early may have to wait for a window, which takes energy
    waiting = float(problem.idle.max(initial=0.0)) * early
    return one.spent + waiting <= other.spent and one.left - waiting >= other.left


class _Sequences:
    """All ways of one robot through a set of tasks, from the one of least energy on."""

    def __init__(self, problem: RobotProblem, mask: int, best: _Label) -> None:
        self._problem, self._mask, self._first = problem, mask, best
        self._found: list[_Label] = []
        self._more: Iterator[_Label] | None = None

    def at(self, rank: int) -> _Label | None:
        """Return the way of a rank; None where there are fewer."""
        if rank == 0:
            return self._first
        if self._more is None:
            self._more = self._enumerated()
        while len(self._found) < rank:
            label = next(self._more, None)
            if label is None:
                return None
            if label.stops != self._first.stops:
                self._found.append(label)
        return self._found[rank - 1]

    def _enumerated(self) -> Iterator[_Label]:
        """Yield ways by a best-first search that drops none."""
        problem, number = self._problem, count()
        rest = self._remaining()
        start = _Label(begin(problem), ())
        queue = [(rest[self._mask, 0], next(number), False, self._mask, start)]
        while queue:
            _, _, ended, mask, label = heapq.heappop(queue)
            if ended:
                yield label
                continue
            ways: list[tuple[bool, int, _Label]] = [
                (False, mask, charged) for charged in _charged(problem, label)
            ]
            for task in range(problem.tasks):
                done = do_task(problem, label.status, task) if mask >> task & 1 else None
                if done is not None:
                    ways.append(
                        (False, mask & ~(1 << task), _Label(done, (*label.stops, task + 1)))
                    )
            last = end(problem, label.status) if not mask else None
            if last is not None:
                ways.append((True, 0, _Label(last, label.stops)))
            for over, left, way in ways:
                more = 0.0 if over else rest[left, way.status.node]
                item = (way.status.spent + more, next(number), over, left, way)
                heapq.heappush(queue, item)

    def _remaining(self) -> FloatArray:
        """Return the energy that the tasks of a mask take at least from each node on."""
        problem, n = self._problem, self._problem.tasks
        ways = problem.energy.copy()
        for c in range(1 + n, len(ways)):  # chargers may lie on the way
            ways = np.minimum(ways, ways[:, c : c + 1] + ways[c : c + 1, :])
        finish = (ways + problem.finish[None, :]).min(axis=1)
        finish = np.minimum(finish, problem.finish)
        rest = np.full((2**n, len(ways)), np.inf)
        rest[0] = finish
        for mask in range(1, 2**n):
            for task in range(n):
                if mask >> task & 1:
                    after = rest[mask & ~(1 << task), task + 1] + problem.service[task]
                    rest[mask] = np.minimum(rest[mask], ways[:, task + 1] + after)
        return rest
