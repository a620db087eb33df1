"""Kernels that make blocked motions of a path free: their poses move aside at random."""

from __future__ import annotations

from math import inf

import numpy as np

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import Flags, Floats, Words
from energyplan.planning.lattice.refine_kernels import Chain, insert_pose, pose_of, random_number
from energyplan.planning.scene.motions import KernelProblem, join
from energyplan.steering.kernels import MAX_SEGMENTS
from energyplan.terrain.collision import pose_free

FURTHER = 0.4
"""Probability with which one more pose is moved with others."""


@njit
def reopen(chain: Chain, setting: KernelProblem, count: int) -> int:
    """Join the poses of a chain anew, at an infinite cost where no motion is free.

    Returns how many motions are not.
    """
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    blocked = 0
    for k in range(count - 1):
        blocked += not _rejoin(chain, setting, k, ds, dtheta)
    return blocked


@inner
def _rejoin(chain: Chain, setting: KernelProblem, k: int, ds: Floats, dtheta: Floats) -> bool:
    """Join pose `k` to the next one, and tell whether that is free."""
    a = pose_of(chain, k)
    b = pose_of(chain, k + 1)
    cost, _ = join(setting, a.x, a.y, a.yaw, b.x, b.y, b.yaw, inf, ds, dtheta)
    chain.cost[k] = cost
    chain.kept[k] = False
    return cost < inf


@njit
def unblock(
    chain: Chain, setting: KernelProblem, count: int, trials: int, reach: float, state: Words
) -> int:
    """Move poses at random until all motions between them are free; return how many are not.

    Parameters
    ----------
    chain : Chain
        The path, whose blocked motions have an infinite cost; changed in place.
    setting : KernelProblem
        The problem.
    count : int
        Number of poses.
    trials : int
        Number of attempts.
    reach : float
        How far poses are moved at most in one attempt [m].
    state : ndarray of uint64, shape (1,)
        State of the random numbers.
    """
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    blocked = np.empty(count, np.int64)
    poses = chain.poses.copy()
    cost = chain.cost.copy()
    left = -1
    for _ in range(trials):
        if left < 0:
            left = 0
            for i in range(count - 1):
                if chain.cost[i] == inf:
                    blocked[left] = i
                    left += 1
        if left == 0:
            break
        k = int(blocked[int(random_number(state) * left)])
        # one of its two poses, or both at once and maybe some of those before and after
        what = int(random_number(state) * 3.0)
        first = k if what != 1 else k + 1
        last = k if what == 0 else k + 1
        while what == 2 and first > 1 and random_number(state) < FURTHER:
            first -= 1
        while what == 2 and last < count - 2 and random_number(state) < FURTHER:
            last += 1
        first = max(first, 1)
        last = min(last, count - 2)
        if last < first:
            continue
        step = reach * 10.0 ** (-2.0 * random_number(state))
        dx = step * (2.0 * random_number(state) - 1.0)
        dy = step * (2.0 * random_number(state) - 1.0)
        turn = step / setting.reach * (2.0 * random_number(state) - 1.0)
        x = 0.5 * (poses[first, 0] + poses[last, 0])
        y = 0.5 * (poses[first, 1] + poses[last, 1])
        for i in range(first, last + 1):
            chain.poses[i, 0] += dx - turn * (poses[i, 1] - y)
            chain.poses[i, 1] += dy + turn * (poses[i, 0] - x)
            chain.poses[i, 2] += turn
        before = 0
        for i in range(first - 1, last + 1):
            before += cost[i] == inf
        after = 0
        for i in range(first, last + 1):
            here = pose_of(chain, i)
            if not pose_free(setting.space, setting.body, here.x, here.y, here.yaw):
                after = before
        for i in range(first - 1, last + 1):
            if after == before:
                break
            after += not _rejoin(chain, setting, i, ds, dtheta)
        source_poses = chain.poses if after < before else poses
        source_cost = chain.cost if after < before else cost
        into_poses = poses if after < before else chain.poses
        into_cost = cost if after < before else chain.cost
        for i in range(first, last + 1):
            for c in range(3):
                into_poses[i, c] = source_poses[i, c]
        for i in range(first - 1, last + 1):
            into_cost[i] = source_cost[i]
        if after < before:
            left = -1
    still = 0
    for i in range(count - 1):
        still += chain.cost[i] == inf
    return still


@njit
def halve(chain: Chain, setting: KernelProblem, count: int, marked: Flags) -> int:
    """Put one more pose onto the middle of each motion that is marked; return their number."""
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    for k in range(count - 2, -1, -1):
        if marked[k] and count < len(chain.cost) - 1:
            count = insert_pose(chain, setting, count, k, 0.5, ds, dtheta)
    return count
