"""Energy that no order of all tasks undercuts: Held and Karp's bound, for one robot or several.

The ways of an order and a root, where all tours begin, are a tree in which each task is entered
once and left once, towards another task or the end. Without the last two conditions the least such
tree is quickly found; instead of them each task has a price on entering and one on leaving it, and
the prices that make the least tree as large as may be are looked for by steps along what the tree
violates. The bound holds at any prices.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, inner, njit
from energyplan.mission._order_kernel import OrderProblem

_EPSILON = 1e-9
_STEP = 1.0  # part of the distance to the order known that a step begins with
_PATIENCE = 20  # steps without a larger bound until they are halved
_LEAST = 1e-4  # step at which the search ends
_ROUNDS = 2000  # most steps
_SMOOTH = 0.3  # part of the direction of a step that is that of the one before
_CHARGES = 64  # most charges that the bound counts


@inner
def _tree(energy: FloatTable, into: Floats, out: Floats, entered: Ints, left: Ints) -> float:
    """Return the least tree over the root, 0, and all tasks, and how often it enters and leaves."""
    size = len(into)
    entered[:], left[:] = 0, 0
    near, at, backward = np.full(size, np.inf), np.zeros(size, np.int64), np.zeros(size, np.bool_)
    inside = np.zeros(size, np.bool_)
    total, new = 0.0, 0
    inside[0] = True
    for _ in range(size - 1):
        for j in range(1, size):
            if inside[j]:
                continue
            there = energy[new, j] + out[new] + into[j]
            if there < near[j]:
                near[j], at[j], backward[j] = there, new, False
            if new > 0:
                back = energy[j, new] + out[j] + into[new]
                if back < near[j]:
                    near[j], at[j], backward[j] = back, new, True
        least, new = np.inf, -1
        for j in range(1, size):
            if not inside[j] and near[j] < least:
                least, new = near[j], j
        if new < 0:
            return np.inf
        total += least
        inside[new] = True
        here, goal = (new, at[new]) if backward[new] else (at[new], new)
        left[here] += 1
        entered[goal] += 1
    return total


@njit
def tours_at_least(
    energy: FloatTable, finish: Floats, robots: int, known: float, rounds: int
) -> float:
    """Return the energy that tours of all tasks take at least [J].

    Parameters
    ----------
    energy : array, shape (n + 1, n + 1)
        Least energy from the root, 0, and tasks to each other, over all robots and options [J].
    finish : array, shape (n + 1,)
        Least energy to an end [J].
    robots : int
        Most tours that there may be.
    known : float
        Energy of an order that is known [J].
    rounds : int
        Most steps.
    """
    size = len(finish)
    into, out = np.zeros(size), np.zeros(size)
    best_into, best_out = into.copy(), out.copy()
    entered, left = np.zeros(size, np.int64), np.zeros(size, np.int64)
    best, step, idle = -np.inf, _STEP, 0
    slope_in, slope_out = np.zeros(size), np.zeros(size)
    for _ in range(rounds):
        total = _tree(energy, into, out, entered, left)
        if not np.isfinite(total):
            return np.inf
        # a tour ends once for each time that one begins
        ends = finish[1:] + out[1:] - out[0]
        order = np.argsort(ends)
        count = 1
        total += ends[order[0]]
        left[1 + order[0]] += 1
        for k in range(1, min(robots, size - 1)):
            if ends[order[k]] < 0.0:
                total += ends[order[k]]
                left[1 + order[k]] += 1
                count += 1
        total -= into[1:].sum() + out[1:].sum()
        if total > best + _EPSILON * abs(best) or best == -np.inf:
            best, idle = max(best, total), 0
            best_into[:], best_out[:] = into, out
        else:
            idle += 1
            if idle >= _PATIENCE:
                step, idle = 0.5 * step, 0
                into[:], out[:] = best_into, best_out
                slope_in[:], slope_out[:] = 0.0, 0.0
                continue
        for j in range(1, size):
            slope_in[j] = (1.0 - _SMOOTH) * (entered[j] - 1) + _SMOOTH * slope_in[j]
            slope_out[j] = (1.0 - _SMOOTH) * (left[j] - 1) + _SMOOTH * slope_out[j]
        slope_out[0] = (1.0 - _SMOOTH) * (left[0] - count) + _SMOOTH * slope_out[0]
        norm = (slope_in**2).sum() + (slope_out**2).sum()
        if norm < _EPSILON or step < _LEAST:
            break
        length = step * max(known - total, 1e-6 * abs(known)) / norm
        into += length * slope_in
        out += length * slope_out
    return best


def orders_at_least(
    problems: Sequence[OrderProblem], own: Sequence[Sequence[int]], known: float
) -> float:
    """Return the energy that robots take at least to do all tasks, with the charges they need [J].

    `own` are the numbers of each robot's tasks among all, `known` is what some order takes. Where
    energies depend on the payload, those of the smallest count.
    """
    n, m = 1 + max(max(tasks, default=-1) for tasks in own), len(problems[0].capacity)
    size = 1 + n + m
    energy, finish, idle = np.full((size, size), np.inf), np.full(size, np.inf), 0.0
    for one, numbers in zip(problems, own, strict=True):
        task = np.array(numbers, int)[one.option] if len(one.option) else np.zeros(0, int)
        place = np.concatenate([[0], 1 + task, np.arange(1 + n, size)])
        ways = one.energy[0].min(axis=0)
        ways[:, 1 : 1 + len(task)] += one.service
        np.minimum.at(energy, (place[:, None], place[None, :]), ways)
        np.minimum.at(finish, place, one.finish[0])
        idle += min(float(one.finish[0][0]), 0.0)
    for c in range(1 + n, size):  # over chargers
        energy = np.minimum(energy, energy[:, c, None] + energy[c])
    if np.any(np.diag(energy)[1 + n :] < 0):
        return -np.inf  # a charger may be left and come back to with a gain
    finish = np.minimum(finish, (energy[:, 1 + n :] + finish[1 + n :]).min(axis=1, initial=np.inf))
    docks = energy[1 + n :, 1 + n :] + np.where(np.eye(m, dtype=bool), np.inf, 0.0)
    budget = sum(one.budget for one in problems)
    most = max((float(one.capacity.max(initial=0.0)) for one in problems), default=0.0)
    robots, charges, bound = len(problems), 0, -np.inf
    while True:
        # every charge is a visit to a charger, which is a place as a task is
        place = np.concatenate([np.arange(1 + n), np.full(charges, 1 + n)])
        ways, ends = energy[: 2 + n, : 2 + n].copy(), finish[: 2 + n].copy()
        if m:
            ways[1 + n, 1 + n] = docks.min()
            ways[: 1 + n, 1 + n] = energy[: 1 + n, 1 + n :].min(axis=1)
            ways[1 + n, : 1 + n] = energy[1 + n :, : 1 + n].min(axis=0)
            ends[1 + n] = finish[1 + n :].min()
        bound = max(bound, idle + tours_at_least(
            np.ascontiguousarray(ways[np.ix_(place, place)]), np.ascontiguousarray(ends[place]),
            robots, known, _ROUNDS,
        ))  # fmt: skip
        needed = (
            int(np.ceil((bound - budget) / most - _EPSILON)) if most > 0 and bound > budget else 0
        )
        if not charges < needed <= _CHARGES:
            return bound
        charges = needed
