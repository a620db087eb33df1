"""A grid search through a narrow passage, from both of its ends.

Where exact motions from pose to pose of a route are not free, free poses that lie close together
are searched for from both ends of the passage at once. Motions as long as are free then lead along
them, so that a robot gets sideways through a gap, by driving back and forth.
"""

from __future__ import annotations

from math import cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, ShortInts, inner, njit
from energyplan.path import Pose
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.settings import PASSAGE
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import HEADINGS, grown
from energyplan.planning.space.motions import KernelProblem, join, pose_at, put_pose
from energyplan.planning.space.queues import angle_between, pop, push, slot_of
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
    size = 16
    while size < 4 * most:
        size *= 2
    table = np.empty(size, np.int32)
    for k in range(size):
        table[k] = -1
    # the two ends, and those tested
    capacity = most + 2
    key = np.empty(capacity, np.int64)
    side = np.empty(capacity, np.int64)
    parent = np.empty(capacity, np.int32)
    done = np.empty(capacity, np.bool_)
    narrow = np.empty(capacity, np.bool_)
    g = np.empty(capacity)
    heap_f = np.empty((2, NEIGHBOURS * capacity))
    heap_node = np.empty((2, NEIGHBOURS * capacity), np.int32)
    sizes = np.zeros(2, np.int64)
    half = 1 << (BITS - 1)
    for who in range(2):
        i = floor((end.x - begin.x) / cell + 0.5) if who == 1 else 0
        j = floor((end.y - begin.y) / cell + 0.5) if who == 1 else 0
        h = floor((end.yaw - begin.yaw) / turn + 0.5) % headings if who == 1 else 0
        key[who] = ((i + half) << BITS | (j + half)) * headings + h
        side[who] = who
        parent[who] = -1
        done[who] = False
        narrow[who] = True
        g[who] = 0.0
        slot = slot_of(table, key, key[who])
        if table[slot] >= 0:
            # both ends are one place of the grid
            return Passage(_chain(parent, key, 0, 1, begin, end, cell, headings), 0)
        table[slot] = who
        sizes[who] = push(heap_f[who], heap_node[who], 0, 0.0, who)
    count = 2
    who = 1
    while True:
        who = 1 - who
        while sizes[who] > 0 and done[heap_node[who, 0]]:
            sizes[who] = pop(heap_f[who], heap_node[who], sizes[who])
        if sizes[who] == 0:
            return Passage(np.empty((0, 3)), count - 2)
        node = int(heap_node[who, 0])
        sizes[who] = pop(heap_f[who], heap_node[who], sizes[who])
        done[node] = True
        h = int(key[node] % headings)
        j = int(key[node] // headings & ((1 << BITS) - 1))
        i = int(key[node] // headings >> BITS)
        along = cos(begin.yaw + h * turn)
        across = sin(begin.yaw + h * turn)
        for k in range(NEIGHBOURS):
            forward = along * STEP_I[k] + across * STEP_J[k]
            if setting.gear != 0 and forward * (1 - 2 * who) < -1e-9:
                continue
            to_h = (h + STEP_H[k]) % headings
            to_key = ((i + STEP_I[k]) << BITS | (j + STEP_J[k])) * headings + to_h
            slot = slot_of(table, key, to_key)
            other = int(table[slot])
            if other >= 0 and side[other] == 1 - who:
                first = node if who == 0 else other
                second = other if who == 0 else node
                found = _chain(parent, key, first, second, begin, end, cell, headings)
                return Passage(found, count - 2)
            if other >= 0 and (side[other] == BLOCKED or done[other]):
                continue
            x = begin.x + (i + STEP_I[k] - half) * cell
            y = begin.y + (j + STEP_J[k] - half) * cell
            yaw = begin.yaw + to_h * turn
            if other < 0:
                if count == capacity:
                    return Passage(np.empty((0, 3)), most)
                other = count
                count += 1
                table[slot] = other
                key[other] = to_key
                done[other] = False
                g[other] = inf
                side[other] = BLOCKED
                if not pose_free(setting.space, setting.body, x, y, yaw):
                    continue
                side[other] = who
                narrow[other] = not pose_free(setting.space, wide, x, y, yaw)
            step = setting.reach * turn
            if STEP_H[k] == 0:
                ahead = abs(forward)
                aside = abs(along * STEP_J[k] - across * STEP_I[k])
                step = cell * (ahead + PASSAGE.aside * aside)
            if narrow[other]:
                step *= PASSAGE.tight
            if g[node] + step < g[other]:
                g[other] = g[node] + step
                parent[other] = node
                goal = end if who == 0 else begin
                left = 2.0 * PASSAGE.aside * hypot(goal.x - x, goal.y - y)
                left += 2.0 * setting.reach * angle_between(goal.yaw, yaw)
                sizes[who] = push(heap_f[who], heap_node[who], sizes[who], g[other] + left, other)


@inner
def _chain(
    parent: ShortInts,
    key: Ints,
    first: int,
    second: int,
    begin: Pose,
    end: Pose,
    cell: float,
    headings: int,
) -> FloatTable:
    """Return the poses from the begin to a node, and from another one to the end."""
    before = 0
    node = first
    while node >= 0:
        before += 1
        node = int(parent[node])
    count = before
    node = second
    while node >= 0:
        count += 1
        node = int(parent[node])
    half = 1 << (BITS - 1)
    poses = np.empty((count, 3))
    node = first
    for k in range(count):
        if k == before:
            node = second
        at = before - 1 - k if k < before else k
        cells = key[node] // headings
        poses[at, 0] = begin.x + ((cells >> BITS) - half) * cell
        poses[at, 1] = begin.y + ((cells & ((1 << BITS) - 1)) - half) * cell
        poses[at, 2] = begin.yaw + (key[node] % headings) * (2.0 * pi / headings)
        node = int(parent[node])
    put_pose(poses, count - 1, end)
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
