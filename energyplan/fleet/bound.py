"""What the tasks of a fleet take at least: a linear programme with cutting planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array, vstack
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from energyplan.fleet.problem import RobotProblem
from energyplan.path import FloatArray

_CUTS = 40
"""Rounds of cutting planes."""

_UNITS = 1e6
"""Whole units that a flow of 1 is counted in."""

_ROUNDING = 1e-9


def least_energy(
    problems: Sequence[RobotProblem], tasks: np.ndarray, best: float = np.inf
) -> float:
    """Bound the energy that tasks take from below.

    Robots that take the same from place to place are a class. Each task is come to and left once,
    by one class, at its own price; what a class takes is no more than its batteries hold at the
    start and its visits to chargers add; no group of places is a round trip of its own. Windows
    are left out, and each robot's battery beyond the sum over its class.
    """
    idle = sum(float(problem.finish[0]) for problem in problems)  # of robots that do nothing
    if not len(tasks):
        return min(idle, best)
    programme = _Programme(problems, np.asarray(tasks))
    return min(idle + programme.least(best - idle), best)


@dataclass(frozen=True)
class _Arcs:
    """Ways of one class; node -1 stands for all starts and ends."""

    tail: np.ndarray  # nodes
    head: np.ndarray  # nodes
    cost: FloatArray  # energy that counts [J]
    drawn: FloatArray  # [J]
    robot: np.ndarray  # the robot that starts, else -1


def _classes(problems: Sequence[RobotProblem]) -> list[list[int]]:
    """Return robots by what they take from place to place."""
    found: dict[bytes, list[int]] = {}
    for r, p in enumerate(problems):
        parts = (p.energy[1:, 1:], p.service, p.capacity)
        key = b"".join(np.round(np.nan_to_num(part, posinf=-1.0), 6).tobytes() for part in parts)
        found.setdefault(key, []).append(r)
    return list(found.values())


def _arcs(problems: Sequence[RobotProblem], members: list[int], tasks: np.ndarray) -> _Arcs:
    one, n = problems[members[0]], problems[members[0]].tasks
    count, m = len(tasks), len(one.capacity)
    places = np.concatenate([tasks + 1, np.arange(1 + n, 1 + n + m)])
    service = np.concatenate([one.service[tasks], np.zeros(m)])
    gain = np.concatenate([np.zeros(count), np.maximum(one.capacity, 0.0)])
    between = one.energy[np.ix_(places, places)] + service[None, :]
    np.fill_diagonal(between, np.inf)
    starts = np.array([problems[r].energy[0, places] + service for r in members])
    safe = np.min([problems[r].refuge[places] for r in members], axis=0)
    finish = np.min([problems[r].finish[places] for r in members], axis=0)
    budgets = np.array([problems[r].budget for r in members])
    # no battery lasts for a way that leaves too little to get to a place of safety
    ways = between.copy()
    np.fill_diagonal(ways, 0.0)
    for k in range(len(ways)):
        ways = np.minimum(ways, ways[:, k : k + 1] + ways[k : k + 1, :])
    reached = (starts[:, :, None] + ways[None]).min(axis=1)
    left = (budgets[:, None] - reached).max(axis=0)
    if m and not np.any(np.diag(ways) < 0):
        left = np.maximum(left, (gain[count:, None] - ways[count:]).max(axis=0))
    elif np.any(np.diag(ways) < 0):
        left = np.full(len(places), np.inf)
    room = _ROUNDING * np.where(np.isfinite(left), np.maximum(np.abs(left), 1.0), 0.0)
    between = np.where(between + safe[None, :] > (left + room)[:, None], np.inf, between)
    starts = np.where(starts + safe[None, :] > (budgets * (1 + _ROUNDING))[:, None], np.inf, starts)
    spared = np.array([problems[r].finish[0] for r in members])
    pieces = []
    tail, head = np.nonzero(np.isfinite(between))
    cost = between[tail, head]
    pieces.append((tail, head, cost, cost - gain[head], np.full(len(tail), -1)))
    who, head = np.nonzero(np.isfinite(starts))
    cost = starts[who, head]
    outside = np.full(len(head), -1)
    pieces.append(
        (outside, head, cost - spared[who], cost - budgets[who] - gain[head],
         np.array(members)[who])
    )  # fmt: skip
    tail = np.flatnonzero(np.isfinite(finish))
    outside = np.full(len(tail), -1)
    pieces.append((tail, outside, finish[tail], finish[tail], outside))
    return _Arcs(*(np.concatenate(part) for part in zip(*pieces, strict=True)))


class _Programme:
    """The linear programme: how often each class takes each way."""

    def __init__(self, problems: Sequence[RobotProblem], tasks: np.ndarray) -> None:
        classes = [_arcs(problems, members, tasks) for members in _classes(problems)]
        self._count = len(tasks)
        self._size = len(tasks) + len(problems[0].capacity)
        self._cost = np.concatenate([arcs.cost for arcs in classes])
        self._tail = np.concatenate([arcs.tail for arcs in classes])
        self._head = np.concatenate([arcs.head for arcs in classes])
        robot = np.concatenate([arcs.robot for arcs in classes])
        kind = np.repeat(np.arange(len(classes)), [len(arcs.cost) for arcs in classes])
        drawn = np.concatenate([arcs.drawn for arcs in classes])
        edges = np.arange(len(self._cost))
        ways = self._size

        def rows(row: np.ndarray, which: np.ndarray, value: FloatArray, count: int) -> csr_array:
            return csr_array(coo_array((value, (row, edges[which])), shape=(count, len(edges))))

        visits = (self._head >= 0) & (self._head < self._count)
        into, out = self._head >= 0, self._tail >= 0
        one = np.ones(len(edges))
        total = len(classes) * ways
        self._equal = vstack([
            rows(self._head[visits], visits, one[visits], self._count),
            rows((kind * ways + self._head)[into], into, one[into], total)
            - rows((kind * ways + self._tail)[out], out, one[out], total),
        ], format="csr")  # fmt: skip
        self._wanted = np.concatenate([np.ones(self._count), np.zeros(total)])
        starts = robot >= 0
        unit = float(np.abs(drawn).max(initial=1.0))
        self._most = vstack([
            rows(robot[starts], starts, one[starts], len(problems)),
            rows(kind, one > 0, drawn / unit, len(classes)),
        ], format="csr")  # fmt: skip
        self._limit = np.concatenate([np.ones(len(problems)), np.zeros(len(classes))])
        # a way to a task is taken once at most; chargers are visited again and again
        single = visits | ((self._tail >= 0) & (self._tail < self._count)) | starts
        self._upper = np.where(single, 1.0, np.inf)

    def least(self, best: float) -> float:
        """Solve it with cuts, and without ways that cannot be part of less than `best`."""
        keep = np.arange(len(self._cost))
        cuts: list[np.ndarray] = []
        least = -np.inf
        solver: Any = linprog
        for _ in range(_CUTS):
            grown = [csr_array(-self._enters(group, keep).astype(float)[None, :]) for group in cuts]
            solved: Any = solver(
                self._cost[keep],
                vstack([self._most[:, keep], *grown], format="csr"),
                np.concatenate([self._limit, -np.ones(len(cuts))]),
                self._equal[:, keep],
                self._wanted,
                np.column_stack([np.zeros(len(keep)), self._upper[keep]]),
                method="highs",
            )
            if solved.status == 2:  # nothing does it with less than what is known
                return best if np.isfinite(best) else least
            if solved.status != 0:
                break
            least = float(solved.fun)
            found = self._violated(keep, solved.x)
            if not found:
                break
            cuts += found
            if np.isfinite(best):
                spare = best - least + 1e-6 * max(abs(best), 1.0)
                keep = keep[solved.lower.marginals <= spare]
        return least

    def _enters(self, group: np.ndarray, keep: np.ndarray) -> np.ndarray:
        inside = np.zeros(self._size + 1, bool)  # the last one is the outside, -1
        inside[group] = True
        return np.asarray(~inside[self._tail[keep]] & inside[self._head[keep]])

    def _violated(self, keep: np.ndarray, flow: FloatArray) -> list[np.ndarray]:
        """Return groups of places with tasks that less than one robot comes to."""
        source = self._size
        tail, head = self._tail[keep], self._head[keep]
        used = (flow > 1.0 / _UNITS) & (head >= 0)
        units = np.round(np.minimum(flow[used], 1e3) * _UNITS).astype(np.int32)
        ends = np.where(tail[used] < 0, source, tail[used]), head[used]
        net = csr_array(coo_array((units, ends), shape=(source + 1, source + 1)))
        net.sum_duplicates()
        groups: dict[bytes, np.ndarray] = {}
        for task in range(self._count):
            told = maximum_flow(net, source, task)
            if told.flow_value >= 0.999 * _UNITS:
                continue
            left: Any = csr_array(net - told.flow)
            left.data[left.data < 0] = 0
            left.eliminate_zeros()
            # the largest group and the smallest one that the flow cannot fill
            reached = breadth_first_order(left, source, return_predecessors=False)
            reaching = breadth_first_order(csr_array(left.T), task, return_predecessors=False)
            for group in (np.setdiff1d(np.arange(self._size), reached), np.sort(reaching)):
                groups[group.tobytes()] = group
        return list(groups.values())
