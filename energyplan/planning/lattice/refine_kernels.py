"""Kernels that make a drivable path cheaper: shortcuts between its poses, and moving them.

A path is held as a `Chain` of poses. Each is joined to the next one by `join`, or, where `kept` is
set, by the single motion that the chain was given, which then stays as it is.
"""

from __future__ import annotations

from math import hypot, inf
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, FloatTable, Words, njit
from energyplan.path import Pose
from energyplan.planning.scene.motions import KernelProblem, join, motion_cost
from energyplan.steering.kernels import MAX_SEGMENTS, arc_end, steer_energy

HOPELESS = 8
"""Poses in a row from which no shortcut is free, after which those before are not tried."""

SMALLEST, LARGEST = 1e-4, 1.0
"""Range of the distance by which poses are moved [m]."""


class Chain(NamedTuple):
    """Poses and what it costs to get from each to the next."""

    poses: FloatTable  # (capacity, 3): poses of the centre of the tread ICRs
    cost: Floats  # (capacity,): cost from each pose to the next
    kept: Flags  # (capacity,): whether the motion to the next pose is a given one
    ds: Floats  # (capacity,): that motion
    dtheta: Floats  # (capacity,): that motion
    step: Floats  # (capacity,): distance by which to try moving each pose [m]


class Shortened(NamedTuple):
    """What is left of a chain."""

    poses: int  # how many poses
    steered: int
    tested: int


@njit
def shortcut(
    chain: Chain, setting: KernelProblem, count: int, reach: int, stop: float
) -> Shortened:
    """Keep those poses only by which the chain is cheapest.

    Dynamic programming over all pairs of poses at most `reach` apart in the chain; `cost` of the
    motions given must be filled in. Every motion costs `stop` more, except one given that goes on
    as the one given before it; `cost` stays what it is without.
    """
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    best = np.empty(count)
    before = np.empty(count, np.int64)
    joined = np.empty(count, np.bool_)
    edge = np.empty(count)
    steered = 0
    tested = 0
    best[0] = 0.0
    before[0] = -1
    for j in range(1, count):
        best[j] = best[j - 1] + chain.cost[j - 1]
        if not _goes_on(chain, j - 1):
            best[j] += stop
        before[j] = j - 1
        joined[j] = not chain.kept[j - 1]
        edge[j] = chain.cost[j - 1]
        blocked = 0
        for i in range(j - 1, max(0, j - reach) - 1, -1):
            if blocked == HOPELESS:
                break
            limit = best[j] - best[i] - 1e-9 - stop
            if limit <= 0:
                continue
            a = pose_of(chain, i)
            b = pose_of(chain, j)
            dx = b.x - a.x
            dy = b.y - a.y
            if setting.least_metre * hypot(dx, dy) >= limit:
                continue
            steered += 1
            if steer_energy(dx, dy, a.yaw, b.yaw, setting.steering) >= limit:
                continue
            tested += 1
            cost, n = join(setting, a.x, a.y, a.yaw, b.x, b.y, b.yaw, limit, ds, dtheta)
            blocked = blocked + 1 if cost == inf else 0
            if cost + stop * (n - 1) < limit:
                best[j] = best[i] + cost + stop * n
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
        _set_pose(chain, k, pose_of(chain, j))
        chain.step[k] = 0.3
        if k > 0:
            chain.cost[k - 1] = edge[j]
            chain.kept[k - 1] = not joined[j]
            if not joined[j]:
                chain.ds[k - 1] = chain.ds[j - 1]
                chain.dtheta[k - 1] = chain.dtheta[j - 1]
    return Shortened(n, steered, tested)


@njit
def _goes_on(chain: Chain, k: int) -> bool:
    """Whether the motion from pose `k` goes on as the one before it."""
    if k == 0 or not (chain.kept[k] and chain.kept[k - 1]):
        return False
    across = chain.ds[k] * chain.dtheta[k - 1] - chain.ds[k - 1] * chain.dtheta[k]
    along = chain.ds[k] * chain.ds[k - 1] + chain.dtheta[k] * chain.dtheta[k - 1]
    return bool(along > 0.0 and abs(across) <= 1e-9 * along)


@njit
def random_number(state: Words) -> float:
    """Return a random number in [0, 1) (xorshift)."""
    word = state[0]
    word ^= (word << np.uint64(13)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    word ^= word >> np.uint64(7)
    word ^= (word << np.uint64(17)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    state[0] = word
    return float(word >> np.uint64(11)) / 9007199254740992.0


@njit
def pose_of(chain: Chain, k: int) -> Pose:
    """Return a pose of the chain."""
    return Pose(chain.poses[k, 0], chain.poses[k, 1], chain.poses[k, 2])


@njit
def _set_pose(chain: Chain, k: int, pose: Pose) -> None:
    chain.poses[k, 0] = pose.x
    chain.poses[k, 1] = pose.y
    chain.poses[k, 2] = pose.yaw


@njit
def _copy(chain: Chain, k: int, other: int) -> None:
    """Set a place of the chain to what stands at another one."""
    _set_pose(chain, k, pose_of(chain, other))
    chain.cost[k] = chain.cost[other]
    chain.kept[k] = chain.kept[other]
    chain.ds[k] = chain.ds[other]
    chain.dtheta[k] = chain.dtheta[other]
    chain.step[k] = chain.step[other]


@njit
def _try_move(
    chain: Chain, setting: KernelProblem, k: int, pose: Pose, ds: Floats, dtheta: Floats
) -> bool:
    """Move pose `k` of the chain if that is cheaper and free."""
    old = chain.cost[k - 1] + chain.cost[k]
    a = pose_of(chain, k - 1)
    b = pose_of(chain, k + 1)
    steering = setting.steering
    before = steer_energy(pose.x - a.x, pose.y - a.y, a.yaw, pose.yaw, steering)
    rest = steer_energy(b.x - pose.x, b.y - pose.y, pose.yaw, b.yaw, steering)
    if before + rest >= old:
        return False
    # the way there, then the way on
    costs = (inf, inf)
    limit = old - rest
    for part in range(2):
        first = a if part == 0 else pose
        last = pose if part == 0 else b
        cost, _ = join(
            setting, first.x, first.y, first.yaw, last.x, last.y, last.yaw, limit, ds, dtheta
        )
        if cost == inf:
            return False
        costs = (costs[1], cost)
        limit = old - cost - 1e-9
    _set_pose(chain, k, pose)
    chain.cost[k - 1] = costs[0]
    chain.cost[k] = costs[1]
    chain.kept[k - 1] = False
    chain.kept[k] = False
    return True


@njit
def insert_pose(
    chain: Chain,
    setting: KernelProblem,
    count: int,
    k: int,
    fraction: float,
    ds: Floats,
    dtheta: Floats,
) -> int:
    """Put one more pose onto the motion from pose `k` to the next one; return the new number."""
    a = pose_of(chain, k)
    b = pose_of(chain, k + 1)
    pose = a
    costs = (inf, inf)
    # the whole motion, on which the pose is chosen; then the way there, and the way on
    for part in range(3):
        first = pose if part == 2 else a
        last = pose if part == 1 else b
        cost, n = join(
            setting, first.x, first.y, first.yaw, last.x, last.y, last.yaw, inf, ds, dtheta
        )
        if part == 0:
            if n == 0:
                return count
            pose = _along(setting, a, fraction, ds, dtheta, n)
        costs = (costs[1], cost)
    if costs[0] + costs[1] > chain.cost[k] * (1.0 + 1e-9) + 1e-9:
        return count
    for i in range(count, k + 1, -1):
        _copy(chain, i, i - 1)
    _set_pose(chain, k + 1, pose)
    chain.cost[k] = costs[0]
    chain.cost[k + 1] = costs[1]
    chain.kept[k + 1] = False
    chain.step[k + 1] = 0.3
    return count + 1


@njit
def _along(
    setting: KernelProblem, start: Pose, fraction: float, ds: Floats, dtheta: Floats, n: int
) -> Pose:
    """Return the pose after a fraction of a motion, by its length and turning."""
    total = 0.0
    for i in range(n):
        total += abs(ds[i]) + setting.half_track * abs(dtheta[i])
    left = fraction * total
    here = start
    for i in range(n):
        size = abs(ds[i]) + setting.half_track * abs(dtheta[i])
        part = min(left / size, 1.0) if size > 0 else 1.0
        here = arc_end(here, part * ds[i], part * dtheta[i])
        left -= part * size
        if part < 1.0:
            break
    return here


@njit
def polish(chain: Chain, setting: KernelProblem, count: int, trials: int, state: Words) -> int:
    """Move, remove and insert poses at random where that is cheaper; return their number."""
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    most = min(len(chain.cost) - 1, count + 4)
    for _ in range(trials):
        what = random_number(state)
        if count < 3 or (what < 0.02 and count < most):
            k = int(random_number(state) * (count - 1))
            if not chain.kept[k]:
                count = insert_pose(chain, setting, count, k, random_number(state), ds, dtheta)
            if count < 3:
                return count
            continue
        k = 1 + int(random_number(state) * (count - 2))
        if what < 0.08:
            old = chain.cost[k - 1] + chain.cost[k]
            a = pose_of(chain, k - 1)
            b = pose_of(chain, k + 1)
            limit = old * (1 + 1e-12)
            cost, _ = join(setting, a.x, a.y, a.yaw, b.x, b.y, b.yaw, limit, ds, dtheta)
            if cost < inf:
                for i in range(k, count - 1):
                    _copy(chain, i, i + 1)
                chain.cost[k - 1] = cost
                chain.kept[k - 1] = False
                count -= 1
            continue
        step = chain.step[k]
        x = chain.poses[k, 0]
        y = chain.poses[k, 1]
        yaw = chain.poses[k, 2]
        kind = random_number(state)
        if kind < 0.7:
            x += step * (2.0 * random_number(state) - 1.0)
            y += step * (2.0 * random_number(state) - 1.0)
        if kind > 0.3:
            yaw += step / setting.half_track * (2.0 * random_number(state) - 1.0)
        if _try_move(chain, setting, k, Pose(x, y, yaw), ds, dtheta):
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
    ds: Floats,
    dtheta: Floats,
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
        a = pose_of(chain, k)
        b = pose_of(chain, k + 1)
        _, m = join(setting, a.x, a.y, a.yaw, b.x, b.y, b.yaw, inf, part_ds, part_dtheta)
        for i in range(m):
            ds[n + i] = part_ds[i]
            dtheta[n + i] = part_dtheta[i]
        n += m
    return n
