"""A grid search through a narrow passage, from both of its ends.

Where exact motions from pose to pose of a route are not free, free poses that lie close together
are searched for from both ends of the passage at once. Motions as long as are free then lead along
them, so that a robot gets sideways through a gap, by driving back and forth.
"""

from __future__ import annotations

from math import cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, FloatTable, Ints, ShortInts, inner, lean, njit
from energyplan.path import Pose
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.settings import PASSAGE
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import HEADINGS, grown
from energyplan.planning.space.motions import KernelProblem, join, pose_at, put_pose
from energyplan.planning.space.queues import (
    Open,
    angle_between,
    chain_to,
    no_open,
    pop,
    push,
    slot_of,
)
from energyplan.steering.kernels import MAX_SEGMENTS
from energyplan.terrain.collision import Body, pose_free

BLOCKED = 2
"""What is known of a pose that is not free; else the end from which it was reached, 0 or 1."""

BITS = 20  # bits of a place's number along either axis
NEIGHBOURS = 10  # neighbours of a pose: eight places, and two headings

STEP_I = np.array([1, 1, 0, -1, -1, -1, 0, 1, 0, 0])
STEP_J = np.array([0, 1, 1, 1, 0, -1, -1, -1, 0, 0])
STEP_H = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1, -1])  # steps to them


def through_passage(
    setting: KernelProblem, begin: Pose, end: Pose, spacing: float, budget: Budget
) -> Segments | None:
    """Return motions along free poses that lie close together, if there are such."""
    cell = PASSAGE.cell * spacing
    for part in PASSAGE.spare:
        most = int(min(PASSAGE.most, budget.left / UNITS.pose))
        spare, wide = (grown(setting.body, much * cell) for much in (part, PASSAGE.wide))
        tested = setting._replace(body=spare)
        found = bidirectional_search(tested, wide, begin, end, cell, 2 * HEADINGS, most)
        budget.spend(UNITS.pose * found.tests)
        if len(found.poses):
            ds, dtheta = np.empty((2, PASSAGE.most))
            limit = int(min(budget.left / UNITS.follow, PASSAGE.most))
            followed = follow(setting, found.poses, limit, ds, dtheta)
            budget.spend(UNITS.follow * followed.tried)
            if followed.last == len(found.poses) - 1:
                return Segments(ds[: followed.motions], dtheta[: followed.motions])
    return None


class Passage(NamedTuple):
    """Poses through a passage."""

    poses: FloatTable  # (n, 3): from one end to the other
    tests: int  # poses that were tested


class GridFrame(NamedTuple):
    """The grid of poses: it begins at one end of the passage."""

    begin: Pose
    end: Pose
    cell: float  # [m]
    headings: int
    turn: float  # between two of them [rad]


class Tested(NamedTuple):
    """The poses of the grid that were tested, and how they were reached from either end."""

    key: Ints  # place and heading as one number
    side: Ints  # the end that it was reached from, 0 or 1, or `BLOCKED`
    parent: ShortInts  # pose it was reached from, -1 at an end
    done: Flags  # whether it was expanded
    narrow: Flags  # whether the larger body is not free there
    g: Floats  # cost from its end [m]
    table: ShortInts  # hash table from key to pose, -1 where empty
    used: Ints  # (1,): number of poses


@inner
def _tested(most: int) -> Tested:
    """Return no poses, with room for so many."""
    size = 16
    while size < 4 * most:
        size *= 2
    return Tested(
        np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int32),
        np.zeros(most, np.bool_), np.zeros(most, np.bool_), np.empty(most),
        np.full(size, -1, np.int32), np.zeros(1, np.int64),
    )  # fmt: skip


@lean
def _key_of(i: int, j: int, h: int, headings: int) -> int:
    """Return a place of the grid and a heading as one number."""
    half = 1 << (BITS - 1)
    return ((i + half) << BITS | (j + half)) * headings + h


@lean
def _pose_of(frame: GridFrame, key: int) -> Pose:
    """Return the pose of a key."""
    half = 1 << (BITS - 1)
    place = key // frame.headings
    x = frame.begin.x + ((place >> BITS) - half) * frame.cell
    y = frame.begin.y + ((place & ((1 << BITS) - 1)) - half) * frame.cell
    return Pose(x, y, frame.begin.yaw + (key % frame.headings) * frame.turn)


@lean
def _enter(tested: Tested, slot: int, key: int, side: int, narrow: bool, g: float) -> int:
    """Add a pose that nothing leads to, and return its number."""
    new = int(tested.used[0])
    tested.used[0] += 1
    tested.table[slot] = new
    tested.key[new] = key
    tested.side[new] = side
    tested.parent[new] = -1
    tested.narrow[new] = narrow
    tested.g[new] = g
    return new


@njit
def bidirectional_search(
    setting: KernelProblem,
    wide: Body,
    begin: Pose,
    end: Pose,
    cell: float,
    headings: int,
    most: int,
) -> Passage:
    """Return free poses that lead from one pose to another, step by step on a grid."""
    turn = 2.0 * pi / headings
    frame = GridFrame(begin, end, cell, headings, turn)
    tested = _tested(most + 2)
    queues = (no_open(NEIGHBOURS * (most + 2)), no_open(NEIGHBOURS * (most + 2)))
    for who in range(2):
        i = floor((end.x - begin.x) / cell + 0.5) if who == 1 else 0
        j = floor((end.y - begin.y) / cell + 0.5) if who == 1 else 0
        h = floor((end.yaw - begin.yaw) / turn + 0.5) % headings if who == 1 else 0
        key = _key_of(i, j, h, headings)
        slot = slot_of(tested.table, tested.key, key)
        if tested.table[slot] >= 0:
            # both ends are one place of the grid
            tested.parent[1] = -1
            tested.key[1] = key
            return Passage(_poses_between(frame, tested, 0, 1), 0)
        push(queues[who], 0.0, _enter(tested, slot, key, who, True, 0.0))
    who = 1
    while True:
        who = 1 - who
        queue = queues[who]
        while queue.size[0] > 0 and tested.done[queue.node[0]]:
            pop(queue)
        if queue.size[0] == 0:
            return Passage(np.empty((0, 3)), tested.used[0] - 2)
        node = pop(queue)
        tested.done[node] = True
        here = _pose_of(frame, int(tested.key[node]))
        for k in range(NEIGHBOURS):
            other = _reach(setting, wide, frame, tested, queue, here, who, node, k)
            if other == len(tested.g):
                return Passage(np.empty((0, 3)), most)
            if other >= 0:
                first, second = (node, other) if who == 0 else (other, node)
                poses = _poses_between(frame, tested, first, second)
                return Passage(poses, tested.used[0] - 2)


@lean
def _reach(
    setting: KernelProblem, wide: Body, frame: GridFrame, tested: Tested, queue: Open, here: Pose,
    who: int, node: int, k: int,
) -> int:  # fmt: skip
    """Reach a neighbour; return it if the other end has, else -1; `len(tested.g)` if full."""
    key = int(tested.key[node])
    along, across = cos(here.yaw), sin(here.yaw)
    forward = along * STEP_I[k] + across * STEP_J[k]
    if setting.gear != 0 and forward * (1 - 2 * who) < -1e-9:
        return -1
    headings = frame.headings
    h = key % headings
    to_key = key - h + (STEP_I[k] * (1 << BITS) + STEP_J[k]) * headings
    to_key += (h + STEP_H[k]) % headings
    slot = slot_of(tested.table, tested.key, to_key)
    other = int(tested.table[slot])
    if other >= 0 and tested.side[other] == 1 - who:
        return other
    if other >= 0 and (tested.side[other] == BLOCKED or tested.done[other]):
        return -1
    there = _pose_of(frame, to_key)
    if other < 0:
        if tested.used[0] == len(tested.g):
            return len(tested.g)
        other = _enter(tested, slot, to_key, BLOCKED, False, inf)
        if not pose_free(setting.space, setting.body, there.x, there.y, there.yaw):
            return -1
        tested.side[other] = who
        tested.narrow[other] = not pose_free(setting.space, wide, there.x, there.y, there.yaw)
    step = setting.reach * frame.turn
    if STEP_H[k] == 0:
        aside = abs(along * STEP_J[k] - across * STEP_I[k])
        step = frame.cell * (abs(forward) + PASSAGE.aside * aside)
    if tested.narrow[other]:
        step *= PASSAGE.tight
    g = tested.g[node] + step
    if g < tested.g[other]:
        tested.g[other] = g
        tested.parent[other] = node
        goal = frame.end if who == 0 else frame.begin
        left = 2.0 * PASSAGE.aside * hypot(goal.x - there.x, goal.y - there.y)
        left += 2.0 * setting.reach * angle_between(goal.yaw, there.yaw)
        push(queue, g + left, other)
    return -1


@inner
def _poses_between(frame: GridFrame, tested: Tested, first: int, second: int) -> FloatTable:
    """Return the poses from one end to a pose, and from another pose to the other end."""
    before = chain_to(tested.parent, first)
    after = chain_to(tested.parent, second)
    count = len(before) + len(after)
    poses = np.empty((count, 3))
    for k in range(len(before)):
        put_pose(poses, k, _pose_of(frame, int(tested.key[before[k]])))
    for k in range(len(after)):
        put_pose(poses, count - 1 - k, _pose_of(frame, int(tested.key[after[k]])))
    put_pose(poses, count - 1, frame.end)
    return poses


class Followed(NamedTuple):
    """How far motions along poses lead."""

    last: int  # the furthest pose that is reached
    motions: int  # number of motions to it
    tried: int  # pairs of poses that were tried


@njit
def follow(
    setting: KernelProblem, poses: FloatTable, limit: int, ds: Floats, dtheta: Floats
) -> Followed:
    """Write motions along poses, each as far along them as one is free."""
    part_ds = np.empty(MAX_SEGMENTS)
    part_dtheta = np.empty(MAX_SEGMENTS)
    last = len(poses) - 1
    at = 0
    written = 0
    tried = 0
    here = pose_at(poses, 0)
    far = PASSAGE.longest
    while at < last and tried < limit and written + MAX_SEGMENTS <= len(ds):
        # so many poses further, or that part of the way to the next one
        far = min(4 * far, PASSAGE.longest)
        part = 1.0
        moved = False
        while not moved and part > 0.5**PASSAGE.halvings and tried < limit:
            to = min(at + far, last)
            turn = pi - (pi - (poses[to, 2] - here.yaw)) % (2.0 * pi)
            there = Pose(
                here.x + part * (poses[to, 0] - here.x),
                here.y + part * (poses[to, 1] - here.y),
                here.yaw + part * turn,
            )
            tried += 1
            cost, n = join(setting, here, there, inf, part_ds, part_dtheta)
            if cost < inf:
                moved = True
                for s in range(n):
                    ds[written + s] = part_ds[s]
                    dtheta[written + s] = part_dtheta[s]
                written += n
                here = there
                if part == 1.0:
                    at = to
            elif far > 1:
                far //= 2
            else:
                part *= 0.5
        if not moved:
            break
    return Followed(at, written, tried)
