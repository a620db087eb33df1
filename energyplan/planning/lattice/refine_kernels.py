"""Kernels that make a drivable path cheaper: shortcuts between its poses, and moving them.

A path is held as a `Chain` of poses. Each is joined to the next one by `join`, or, where `kept` is
set, by the single motion that the chain was given, which then stays as it is.
"""

from __future__ import annotations

from math import cos, hypot, inf, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import njit
from energyplan.planning.scene.motions import KernelProblem, join, motion_cost
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy

HOPELESS = 8
"""Poses in a row from which no shortcut is free, after which those before are not tried."""

SMALLEST, LARGEST = 1e-4, 1.0
"""Range of the distance by which poses are moved [m]."""


class Chain(NamedTuple):
    """Poses and what it costs to get from each to the next.

    Attributes
    ----------
    poses : ndarray, shape (capacity, 3)
        Poses of the centre of the tread ICRs.
    cost : ndarray, shape (capacity,)
        Cost from each pose to the next.
    kept : ndarray of bool, shape (capacity,)
        Whether the motion to the next pose is a given one.
    ds, dtheta : ndarray, shape (capacity,)
        That motion.
    step : ndarray, shape (capacity,)
        Distance by which to try moving each pose [m].
    """

    poses: NDArray[np.float64]
    cost: NDArray[np.float64]
    kept: NDArray[np.bool_]
    ds: NDArray[np.float64]
    dtheta: NDArray[np.float64]
    step: NDArray[np.float64]


@njit
def _free(setting: KernelProblem, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return steer_energy(b[0] - a[0], b[1] - a[1], a[2], b[2], setting.steering)


@njit
def shortcut(chain: Chain, setting: KernelProblem, count: int, reach: int) -> int:
    """Keep those poses only by which the chain is cheapest, and return their number.

    Dynamic programming over all pairs of poses at most `reach` apart in the chain; `cost` of the
    motions given must be filled in.
    """
    poses = chain.poses
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    best = np.full(count, inf)
    before = np.full(count, -1)
    joined = np.zeros(count, np.bool_)
    edge = np.zeros(count)
    best[0] = 0.0
    for j in range(1, count):
        best[j] = best[j - 1] + chain.cost[j - 1]
        before[j] = j - 1
        joined[j] = not chain.kept[j - 1]
        edge[j] = chain.cost[j - 1]
        blocked = 0
        for i in range(j - 1, max(0, j - reach) - 1, -1):
            if blocked == HOPELESS:
                break
            limit = best[j] - best[i] - 1e-9
            if limit <= 0:
                continue
            dx = poses[j, 0] - poses[i, 0]
            dy = poses[j, 1] - poses[i, 1]
            if setting.least_metre * hypot(dx, dy) >= limit:
                continue
            if _free(setting, poses[i], poses[j]) >= limit:
                continue
            cost = join(
                setting,
                poses[i, 0],
                poses[i, 1],
                poses[i, 2],
                poses[j, 0],
                poses[j, 1],
                poses[j, 2],
                limit,
                ds,
                dtheta,
            )[0]
            blocked = blocked + 1 if cost == inf else 0
            if cost < limit:
                best[j] = best[i] + cost
                before[j] = i
                joined[j] = True
                edge[j] = cost
    order = np.empty(count, np.int64)
    n = 0
    j = count - 1
    while j >= 0:
        order[n] = j
        n += 1
        j = before[j]
    for k in range(n):
        j = order[n - 1 - k]
        poses[k] = poses[j]
        chain.step[k] = 0.3
        if k > 0:
            chain.cost[k - 1] = edge[j]
            chain.kept[k - 1] = not joined[j]
            if not joined[j]:
                chain.ds[k - 1] = chain.ds[j - 1]
                chain.dtheta[k - 1] = chain.dtheta[j - 1]
    return n


@njit
def _random(state: NDArray[np.uint64]) -> float:
    """Return a random number in [0, 1) (xorshift)."""
    word = state[0]
    word ^= (word << np.uint64(13)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    word ^= word >> np.uint64(7)
    word ^= (word << np.uint64(17)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    state[0] = word
    return float(word >> np.uint64(11)) / 9007199254740992.0


@njit
def _join_poses(
    setting: KernelProblem,
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    limit: float,
    ds: NDArray[np.float64],
    dtheta: NDArray[np.float64],
) -> float:
    return join(setting, a[0], a[1], a[2], b[0], b[1], b[2], limit, ds, dtheta)[0]


@njit
def _remove(chain: Chain, count: int, k: int) -> None:
    for i in range(k, count - 1):
        chain.poses[i] = chain.poses[i + 1]
        chain.cost[i] = chain.cost[i + 1]
        chain.kept[i] = chain.kept[i + 1]
        chain.ds[i] = chain.ds[i + 1]
        chain.dtheta[i] = chain.dtheta[i + 1]
        chain.step[i] = chain.step[i + 1]


@njit
def _try_move(
    chain: Chain,
    setting: KernelProblem,
    k: int,
    pose: NDArray[np.float64],
    ds: NDArray[np.float64],
    dtheta: NDArray[np.float64],
) -> bool:
    """Move pose `k` of the chain if that is cheaper and free."""
    old = chain.cost[k - 1] + chain.cost[k]
    before = chain.poses[k - 1]
    after = chain.poses[k + 1]
    rest = _free(setting, pose, after)
    if _free(setting, before, pose) + rest >= old:
        return False
    first = _join_poses(setting, before, pose, old - rest, ds, dtheta)
    if first == inf:
        return False
    second = _join_poses(setting, pose, after, old - first - 1e-9, ds, dtheta)
    if second == inf:
        return False
    chain.poses[k] = pose
    chain.cost[k - 1] = first
    chain.cost[k] = second
    chain.kept[k - 1] = False
    chain.kept[k] = False
    return True


@njit
def _insert(
    chain: Chain,
    setting: KernelProblem,
    count: int,
    k: int,
    fraction: float,
    ds: NDArray[np.float64],
    dtheta: NDArray[np.float64],
) -> int:
    """Put one more pose onto the motion from pose `k` to the next one; return the new number."""
    a = chain.poses[k]
    b = chain.poses[k + 1]
    _, n = join(setting, a[0], a[1], a[2], b[0], b[1], b[2], inf, ds, dtheta)
    if n == 0:
        return count
    total = 0.0
    for i in range(n):
        total += abs(ds[i]) + setting.half_track * abs(dtheta[i])
    left = fraction * total
    pose = a.copy()
    for i in range(n):
        size = abs(ds[i]) + setting.half_track * abs(dtheta[i])
        part = min(left / size, 1.0) if size > 0 else 1.0
        half = 0.5 * part * dtheta[i]
        chord = part * ds[i] * (sin(half) / half if half != 0.0 else 1.0)
        pose[0] += chord * cos(pose[2] + half)
        pose[1] += chord * sin(pose[2] + half)
        pose[2] += 2.0 * half
        left -= part * size
        if part < 1.0:
            break
    first = _join_poses(setting, a, pose, inf, ds, dtheta)
    second = _join_poses(setting, pose, b, inf, ds, dtheta)
    if first + second > chain.cost[k] * (1.0 + 1e-9) + 1e-9:
        return count
    for i in range(count, k + 1, -1):
        chain.poses[i] = chain.poses[i - 1]
        chain.cost[i] = chain.cost[i - 1]
        chain.kept[i] = chain.kept[i - 1]
        chain.ds[i] = chain.ds[i - 1]
        chain.dtheta[i] = chain.dtheta[i - 1]
        chain.step[i] = chain.step[i - 1]
    chain.poses[k + 1] = pose
    chain.cost[k] = first
    chain.cost[k + 1] = second
    chain.kept[k + 1] = False
    chain.step[k + 1] = 0.3
    return count + 1


@njit
def polish(
    chain: Chain, setting: KernelProblem, count: int, trials: int, state: NDArray[np.uint64]
) -> int:
    """Move, remove and insert poses at random where that is cheaper; return their number.

    Parameters
    ----------
    chain : Chain
        The path; changed in place, never for the worse.
    setting : KernelProblem
        The problem.
    count : int
        Number of poses.
    trials : int
        Number of attempts.
    state : ndarray of uint64, shape (1,)
        State of the random numbers.
    """
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    pose = np.empty(3)
    most = min(len(chain.cost) - 1, count + 4)
    for _ in range(trials):
        what = _random(state)
        if count < 3 or (what < 0.02 and count < most):
            k = int(_random(state) * (count - 1))
            if not chain.kept[k]:
                count = _insert(chain, setting, count, k, _random(state), ds, dtheta)
            if count < 3:
                return count
            continue
        k = 1 + int(_random(state) * (count - 2))
        if what < 0.08:
            old = chain.cost[k - 1] + chain.cost[k]
            cost = _join_poses(
                setting, chain.poses[k - 1], chain.poses[k + 1], old * (1 + 1e-12), ds, dtheta
            )
            if cost < inf:
                _remove(chain, count, k)
                chain.cost[k - 1] = cost
                chain.kept[k - 1] = False
                count -= 1
            continue
        step = chain.step[k]
        pose[:] = chain.poses[k]
        kind = _random(state)
        if kind < 0.7:
            pose[0] += step * (2.0 * _random(state) - 1.0)
            pose[1] += step * (2.0 * _random(state) - 1.0)
        if kind > 0.3:
            pose[2] += step / setting.half_track * (2.0 * _random(state) - 1.0)
        if _try_move(chain, setting, k, pose, ds, dtheta):
            chain.step[k] = min(step * 1.6, LARGEST)
        else:
            chain.step[k] = max(step * 0.96, SMALLEST)
            if chain.step[k] == SMALLEST:
                chain.step[k] = 0.2
    return count


@njit
def fill_costs(chain: Chain, setting: KernelProblem, count: int) -> None:
    """Price the motions given between the poses of a chain."""
    for k in range(count - 1):
        chain.cost[k] = motion_cost(
            setting,
            chain.poses[k, 0],
            chain.poses[k, 1],
            chain.poses[k, 2],
            chain.ds[k],
            chain.dtheta[k],
        )


@njit
def unfold(
    chain: Chain,
    setting: KernelProblem,
    count: int,
    ds: NDArray[np.float64],
    dtheta: NDArray[np.float64],
) -> int:
    """Write the motions of a chain and return how many there are."""
    part_ds = np.empty(MAX_SEGMENTS)
    part_dtheta = np.empty(MAX_SEGMENTS)
    n = 0
    for k in range(count - 1):
        if chain.kept[k]:
            ds[n] = chain.ds[k]
            dtheta[n] = chain.dtheta[k]
            n += 1
            continue
        a = chain.poses[k]
        b = chain.poses[k + 1]
        _, m = join(setting, a[0], a[1], a[2], b[0], b[1], b[2], inf, part_ds, part_dtheta)
        ds[n : n + m] = part_ds[:m]
        dtheta[n : n + m] = part_dtheta[:m]
        n += m
    return n
