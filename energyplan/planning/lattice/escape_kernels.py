"""The way out of a tight place: a search whose steps are as short as the room there is.

A body 1 mm from a wall turns by a thousandth of a radian at most, drives on, has a little more room
then, and so on. A lattice fine enough for the first of these steps would never come to an end. Here
every motion goes as far as it is free, or a part of that, and two poses count as one where they
differ by less than a part of what the body can turn there.
"""

from __future__ import annotations

from math import floor, log2, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, Ints, ShortInts, njit
from energyplan.path import Pose
from energyplan.planning.scene.field import pop, push, slot_of
from energyplan.steering.kernels import arc_end
from energyplan.terrain.collision import Body, Space, motion_free, pose_free

KINDS = 8
"""Straight forwards and backwards, spins both ways, pivots about either tread both ways."""

PARTS = 3
"""Parts of the free motion that are tried: all of it, a half, a fifth."""

HALVINGS = 16
"""How often a motion is halved until it is free."""

CLOSER = 3
"""How often what lies between free and not is halved then."""

SPARE = 0.999
"""What is kept of a free motion, so that no rounding makes it touch."""

WORTH = 4.0
"""Way that twice the room is worth [distances of the furthest corner]."""

FINENESS = 0.25
"""Size of the cells in which two poses count as one, in units of what the corners can move."""


class Escape(NamedTuple):
    """What the search remembers, in arrays of fixed size."""

    x: Floats  # poses [m], [rad]
    y: Floats  # poses [m], [rad]
    yaw: Floats  # poses [m], [rad]
    g: Floats  # way from the end, with turns counted at half the slip track [m]
    room: Floats  # what the body can turn on the spot, both ways together [rad]
    parent: ShortInts  # node it was reached from, -1 at the end itself
    ds: Floats  # motion between the two, as it will be driven
    dtheta: Floats  # motion between the two, as it will be driven
    key: Ints  # place, heading and room as one number
    table: ShortInts  # hash table from key to node, -1 where empty
    heap_f: Floats  # binary heap of open nodes
    heap_node: ShortInts  # binary heap of open nodes
    roomy: ShortInts  # nodes with room, in the order in which they were found
    counts: Ints  # (4,): nodes, heap entries, nodes with room, tests of motions


@njit
def _free(
    space: Space, body: Body, pose: Pose, ds: float, dtheta: float, inwards: bool, counts: Ints
) -> bool:
    """Tell whether a motion is free that starts at a pose, or that ends there."""
    counts[3] += 1
    begin = arc_end(pose, -ds, -dtheta) if inwards else pose
    return bool(motion_free(space, body, begin.x, begin.y, begin.yaw, ds, dtheta, 0.0))


@njit
def _free_part(
    space: Space,
    body: Body,
    pose: Pose,
    ds: float,
    dtheta: float,
    inwards: bool,
    closer: int,
    counts: Ints,
) -> float:
    """Return the part of a motion that is free, 1 at most and zero if it is tiny."""
    part = 1.0
    for _ in range(HALVINGS):
        if _free(space, body, pose, part * ds, part * dtheta, inwards, counts):
            break
        part *= 0.5
    else:
        return 0.0
    if part == 1.0:
        return 1.0
    step = 0.5 * part
    for _ in range(closer):
        if _free(space, body, pose, (part + step) * ds, (part + step) * dtheta, inwards, counts):
            part += step
        step *= 0.5
    return SPARE * part


@njit
def _spin_room(space: Space, body: Body, pose: Pose, turn: float, counts: Ints) -> float:
    """Return what the body can turn on the spot, both ways together, up to `turn` either way."""
    if not pose_free(space, body, pose.x, pose.y, pose.yaw):
        return 0.0
    left = _free_part(space, body, pose, 0.0, turn, False, 2, counts)
    return turn * (left + _free_part(space, body, pose, 0.0, -turn, False, 2, counts))


@njit
def spin_room(space: Space, body: Body, x: float, y: float, yaw: float, turn: float) -> float:
    """Return what a body can turn on the spot at a pose, both ways together."""
    return _spin_room(space, body, Pose(x, y, yaw), turn, np.zeros(4, np.int64))


@njit
def _key(pose: Pose, room: float, reach: float, turn: float) -> int:
    """Return one number for poses that count as one; the cells are as fine as the room is small."""
    octave = floor(log2(max(min(room, turn), 1e-6 * turn) / turn))
    size = FINENESS * turn * reach * 2.0**octave
    column = floor(pose.x / size) & 0xFFFFF
    row = floor(pose.y / size) & 0xFFFFF
    heading = floor(pose.yaw * reach / size) & 0x3FFFF
    return (((row << 20) | column) << 23 | heading << 5 | (-octave & 31)) & 0x7FFFFFFFFFFFFFFF


@njit
def _promise(g: float, room: float, reach: float, turn: float) -> float:
    """Rank of an open node, the least first: a short way, and more room."""
    return g / (WORTH * reach) - log2(max(min(room, turn), 1e-6 * turn) / turn)


@njit
def plant_escape(
    tree: Escape,
    space: Space,
    body: Body,
    x: float,
    y: float,
    yaw: float,
    reach: float,
    turn: float,
) -> None:
    """Put the end itself into an empty tree; see `grow_escape`."""
    pose = Pose(x, y, yaw)
    room = _spin_room(space, body, pose, turn, tree.counts)
    tree.x[0] = x
    tree.y[0] = y
    tree.yaw[0] = yaw
    tree.g[0] = 0.0
    tree.room[0] = room
    tree.parent[0] = -1
    tree.key[0] = _key(pose, room, reach, turn)
    tree.table[slot_of(tree.table, tree.key, tree.key[0])] = 0
    tree.counts[0] = 1
    tree.counts[1] = push(tree.heap_f, tree.heap_node, 0, _promise(0.0, room, reach, turn), 0)


@njit
def grow_escape(
    tree: Escape,
    space: Space,
    body: Body,
    grown: Body,
    half: float,
    spins: bool,
    reach: float,
    turn: float,
    inwards: bool,
    only: float,
    needed: float,
    tests: int,
    wanted: int,
) -> bool:
    """Search until so many poses with room are known, or so many motions were tested."""
    counts = tree.counts
    far = (4.0 if only == 0.0 else 1.0) * reach
    while counts[1] > 0 and counts[3] < tests and counts[2] < wanted:
        if counts[0] + KINDS * PARTS > len(tree.x):
            return False
        node = int(tree.heap_node[0])
        counts[1] = pop(tree.heap_f, tree.heap_node, counts[1])
        pose = Pose(tree.x[node], tree.y[node], tree.yaw[node])
        for kind in range(KINDS):
            sign = 1.0 if kind % 2 == 0 else -1.0
            most_ds = sign * far
            most_turn = 0.0
            if kind >= 2:
                # no further than a quarter turn
                most_turn = sign * 0.5 * pi
                most_ds = 0.0
            if kind >= 4:
                most_ds = half * 0.5 * pi * (1.0 if kind < 6 else -1.0)
            if most_ds * only < 0.0 or (most_ds == 0.0 and not spins):
                continue
            free = _free_part(space, body, pose, most_ds, most_turn, inwards, CLOSER, counts)
            if free == 0.0:
                continue
            for k in range(PARTS):
                part = free * (1.0 if k == 0 else 0.5 if k == 1 else 0.2)
                ds = part * most_ds
                dtheta = part * most_turn
                there = arc_end(pose, -ds, -dtheta) if inwards else arc_end(pose, ds, dtheta)
                # a part of a free motion is free, but for the pieces that it is tested in
                if not _free(space, body, pose, ds, dtheta, inwards, counts):
                    continue
                room = _spin_room(space, body, there, turn, counts)
                key = _key(there, room, reach, turn)
                slot = slot_of(tree.table, tree.key, key)
                if tree.table[slot] >= 0:
                    continue
                new = int(counts[0])
                counts[0] += 1
                tree.table[slot] = new
                tree.x[new] = there.x
                tree.y[new] = there.y
                tree.yaw[new] = there.yaw
                tree.g[new] = tree.g[node] + abs(ds) + half * abs(dtheta)
                tree.room[new] = room
                tree.parent[new] = node
                tree.ds[new] = ds
                tree.dtheta[new] = dtheta
                tree.key[new] = key
                if room >= needed and pose_free(space, grown, there.x, there.y, there.yaw):
                    tree.roomy[counts[2]] = new
                    counts[2] += 1
                    continue
                counts[1] = push(
                    tree.heap_f,
                    tree.heap_node,
                    counts[1],
                    _promise(tree.g[new], room, reach, turn),
                    new,
                )
    return bool(counts[1] > 0)
