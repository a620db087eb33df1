"""The search out of an end so tight that a lattice does not join it, to where there is room.

Most searches end a hand's breadth from a goal that they cannot turn into, and one that starts there
does not get away. So the path out is found first, by motions as short as the room demands.
"""

from __future__ import annotations

from functools import partial
from math import floor, log2, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, ShortInts, inner, lean, njit
from energyplan.path import Pose
from energyplan.planning.budget import UNITS, Budget, side_by_side
from energyplan.planning.settings import ESCAPE
from energyplan.planning.space.compiled import CompiledProblem, Segments
from energyplan.planning.space.motions import (
    KernelProblem,
    allowed,
    least_radius_at,
    motion_cost,
    permitted,
    pose_at,
    put_pose,
    steering_cost,
)
from energyplan.planning.space.queues import Open, no_open, pop, push, slot_of
from energyplan.steering.kernels import arc_end
from energyplan.terrain.collision import Body, Space, motion_free, pose_free

_LEAST = 0.5**ESCAPE.halvings  # part of the longest motion of a kind
KINDS = 8  # straight forwards and backwards, spins both ways, pivots about either tread both ways


class Escape(NamedTuple):
    """What the search found, as a tree of poses."""

    poses: FloatTable  # (n, 3)
    g: Floats  # length from the end, plus half the slip track for each radian [m]; or the cost
    parent: ShortInts  # node it was reached from, -1 at the end itself
    ds: Floats  # motion between the two, as it will be driven
    dtheta: Floats
    key: Ints  # one number for poses that count as one
    table: ShortInts  # hash table from key to node, -1 where empty
    queue: Open  # nodes to go on from
    found: ShortInts  # nodes with room, in the order in which they were found
    counts: Ints  # (3,): motions tested, nodes, nodes with room


class Wanted(NamedTuple):
    """Where a way out leads."""

    grown: Body  # the body that has to fit there
    far: Pose  # the other end of the path
    inwards: bool  # whether the way leads into the goal
    turn: float  # turn on the spot, both ways together, that has to fit there [rad]
    clearing: float  # longer way that gaining the whole clearance makes up for [reaches]


@lean
def _free(
    space: Space, body: Body, pose: Pose, ds: float, dtheta: float, inwards: bool, counts: Ints
) -> bool:
    """Return whether a motion is free that starts at a pose, or that ends there."""
    counts[0] += 1
    begin = arc_end(pose, -ds, -dtheta) if inwards else pose
    return bool(motion_free(space, body, begin.x, begin.y, begin.yaw, ds, dtheta, 0.0))


@lean
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
    for _ in range(ESCAPE.halvings):
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
    return ESCAPE.spare * part


@lean
def _spin_room(space: Space, body: Body, pose: Pose, counts: Ints) -> float:
    """Return what the body can turn on the spot, both ways together."""
    turn = ESCAPE.turn
    if not pose_free(space, body, pose.x, pose.y, pose.yaw):
        return 0.0
    left = _free_part(space, body, pose, 0.0, turn, False, 2, counts)
    return turn * (left + _free_part(space, body, pose, 0.0, -turn, False, 2, counts))


@njit
def spin_room(space: Space, body: Body, pose: Pose) -> float:
    """Return what a body can turn on the spot at a pose, both ways together [rad]."""
    return _spin_room(space, body, pose, np.zeros(1, np.int64))


@lean
def _kept(space: Space, body: Body, grown: Body, pose: Pose) -> float:
    """Return the part of what a body is grown by that a pose has room for."""
    low, high = 0.0, 1.0
    for _ in range(ESCAPE.parts_of_clearance):
        part = 0.5 * (low + high)
        between = Body(
            body.x_min + part * (grown.x_min - body.x_min),
            body.y_min + part * (grown.y_min - body.y_min),
            body.x_max + part * (grown.x_max - body.x_max),
            body.y_max + part * (grown.y_max - body.y_max),
        )
        if pose_free(space, between, pose.x, pose.y, pose.yaw):
            low = part
        else:
            high = part
    return low


@lean
def _octaves(room: float) -> float:
    """Return how often the room is halved against that of a place with room."""
    turn = ESCAPE.turn
    return log2(max(min(room, turn), 1e-6 * turn) / turn)


@lean
def _key(pose: Pose, room: float, reach: float) -> int:
    """Return one number for poses that count as one; the cells are as fine as the room is small."""
    octave = floor(_octaves(room))
    size = ESCAPE.fineness * ESCAPE.turn * reach * 2.0**octave
    column = floor(pose.x / size) & 0xFFFFF
    row = floor(pose.y / size) & 0xFFFFF
    heading = floor(pose.yaw * reach / size) & 0x3FFFF
    return (((row << 20) | column) << 23 | heading << 5 | (-octave & 31)) & 0x7FFFFFFFFFFFFFFF


@inner
def _new_tree() -> Escape:
    """Return a tree without nodes."""
    nodes = ESCAPE.nodes
    return Escape(
        np.empty((nodes, 3)), np.empty(nodes), np.empty(nodes, np.int32), np.empty(nodes),
        np.empty(nodes), np.empty(nodes, np.int64), np.full(4 * nodes, -1, np.int32),
        no_open(nodes), np.empty(nodes, np.int32), np.zeros(3, np.int64),
    )  # fmt: skip


@lean
def _enter(
    tree: Escape, setting: KernelProblem, wanted: Wanted, node: int, ds: float, dtheta: float
) -> None:
    """Enter the pose that a free motion leads to from a node, unless one like it is known."""
    counts = tree.counts
    pose = pose_at(tree.poses, node)
    there = arc_end(pose, -ds, -dtheta) if wanted.inwards else arc_end(pose, ds, dtheta)
    turns = wanted.turn > 0.0
    room = _spin_room(setting.space, setting.body, there, counts) if turns else ESCAPE.turn
    here = _key(there, room, setting.reach)
    slot = slot_of(tree.table, tree.key, here)
    if tree.table[slot] >= 0:
        return
    new = counts[1]
    counts[1] += 1
    tree.table[slot] = new
    put_pose(tree.poses, new, there)
    tree.parent[new] = node
    tree.ds[new] = ds
    tree.dtheta[new] = dtheta
    tree.key[new] = here
    if turns:
        radius = max(setting.half_track, least_radius_at(setting, pose))
        tree.g[new] = tree.g[node] + abs(ds) + radius * abs(dtheta)
        f = tree.g[new] / (ESCAPE.doubling * setting.reach) - _octaves(room)
        if room >= wanted.turn and _fits(setting.space, wanted.grown, there):
            tree.found[counts[2]] = new
            counts[2] += 1
            return
    else:
        begin = there if wanted.inwards else pose
        first = wanted.far if wanted.inwards else there
        last = there if wanted.inwards else wanted.far
        tree.g[new] = tree.g[node] + motion_cost(setting, begin, ds, dtheta)
        cost = tree.g[new] + steering_cost(setting, first, last)
        f = cost / (setting.least_metre * setting.reach)
        f -= wanted.clearing * _kept(setting.space, setting.body, wanted.grown, there)
    push(tree.queue, f, new)


@njit
def escape(setting: KernelProblem, end: Pose, wanted: Wanted, tests: int) -> Escape:
    """Search until enough poses with room are known, or so many motions were tested.

    Where a turn has to fit, short paths and more room to turn come first; where it is clearance
    alone, paths that cost little on the whole, to the other end, and more clearance.
    """
    space, body = setting.space, setting.body
    tree = _new_tree()
    counts = tree.counts
    room = _spin_room(space, body, end, counts) if wanted.turn > 0.0 else ESCAPE.turn
    put_pose(tree.poses, 0, end)
    tree.g[0] = 0.0
    tree.parent[0] = -1
    tree.key[0] = _key(end, room, setting.reach)
    tree.table[slot_of(tree.table, tree.key, tree.key[0])] = 0
    counts[1] = 1
    push(tree.queue, -_octaves(room), 0)
    while tree.queue.size[0] > 0 and counts[0] < tests and counts[2] < ESCAPE.ways:
        if counts[1] + KINDS * len(ESCAPE.parts) > ESCAPE.nodes:
            break
        node = pop(tree.queue)
        pose = pose_at(tree.poses, node)
        if wanted.turn == 0.0 and _fits(space, wanted.grown, pose):
            tree.found[counts[2]] = node
            counts[2] += 1
            continue
        radius = max(setting.half_track, least_radius_at(setting, pose))
        for kind in range(KINDS):
            ds, dtheta = _longest(kind, setting.reach, radius)
            # as a part of any length is
            if not allowed(setting, pose, _LEAST * ds, _LEAST * dtheta):
                continue
            free = _free_part(space, body, pose, ds, dtheta, wanted.inwards, ESCAPE.closer, counts)
            if free == 0.0:
                continue
            for part in ESCAPE.parts:
                # a part of a free motion is free, up to the subdivision of its test
                one, other = free * part * ds, free * part * dtheta
                begin = arc_end(pose, -one, -other) if wanted.inwards else pose
                counts[0] += 1
                if permitted(setting, begin, one, other):
                    _enter(tree, setting, wanted, node, one, other)
    return tree


@lean
def _fits(space: Space, body: Body, pose: Pose) -> bool:
    """Return whether a body is free at a pose."""
    return bool(pose_free(space, body, pose.x, pose.y, pose.yaw))


@lean
def _longest(kind: int, reach: float, radius: float) -> tuple[float, float]:
    """Return the length and the turn of the longest motion of a kind: a quarter turn at most."""
    sign = 1.0 if kind % 2 == 0 else -1.0
    if kind < 2:
        return sign * 4.0 * reach, 0.0
    if kind < 4:
        return 0.0, sign * 0.5 * pi
    return radius * 0.5 * pi * (1.0 if kind < 6 else -1.0), sign * 0.5 * pi


NOTHING = Segments(np.empty(0), np.empty(0))


def tight(query: CompiledProblem, end: Pose, turn: float = ESCAPE.turn) -> bool:
    """Return whether a start or a goal lacks the margin, or room for a turn [rad]."""
    if surely_has_room(query, end):
        return False
    room = spin_room(query.grid.space, query.body, query.centre(end))
    return not query.has_margin(end) or room < turn


def surely_has_room(query: CompiledProblem, end: Pose) -> bool:
    """Return whether an end has the margin, and room for the whole turn one way."""
    space, body, pose = query.grid.space, query.body, query.centre(end)
    return query.has_margin(end) and any(
        motion_free(space, body, *pose, 0.0, way, 0.0) for way in (ESCAPE.turn, -ESCAPE.turn)
    )


def _out_of(query: CompiledProblem, goal: bool, turn: float, budget: Budget) -> list[Segments]:
    """Return the ways out of an end, or into it; the one that costs least on the whole first."""
    problem = query.problem
    ends = (problem.goal, problem.start) if goal else (problem.start, problem.goal)
    pose, far = (query.centre(end) for end in ends)
    setting = query.setting
    ways: list[tuple[float, Segments]] = []
    several = ESCAPE.clearing if turn == 0.0 else ESCAPE.clearing[:1]
    tests = int(budget.left / UNITS.motion / len(several)) + 1
    for clearing in several:
        wanted = Wanted(query.grown, far, goal, turn, clearing)
        tree = escape(setting._replace(body=query.body), pose, wanted, tests)
        budget.spend(UNITS.motion * int(tree.counts[0]))
        for node in tree.found[: tree.counts[2]].tolist():
            room, chain = Pose(*tree.poses[node].tolist()), _chain(tree, node)
            motions = chain if goal else chain[::-1]
            here, ends = (room, (far, room)) if goal else (pose, (room, far))
            cost = steering_cost(setting, *ends)
            for ds, dtheta in motions:
                cost += motion_cost(setting, here, ds, dtheta)
                here = arc_end(here, ds, dtheta)
            ways.append((cost, Segments(*np.array(motions).T)))
    return [way for _, way in sorted(ways, key=lambda way: way[0])]


def _chain(tree: Escape, node: int) -> list[tuple[float, float]]:
    """Return the motions to a node of a tree, the last one first."""
    chain = []
    while tree.parent[node] >= 0:
        chain.append((float(tree.ds[node]), float(tree.dtheta[node])))
        node = int(tree.parent[node])
    return chain


def ways_out(
    query: CompiledProblem, budget: Budget, turn: float = ESCAPE.turn
) -> list[tuple[Segments, Segments]]:
    """Return ways from the start and to the goal, the most promising first; none where not needed.

    They lead to where the margin is kept, and a turn on the spot has room [rad].
    """
    ends = query.problem.start, query.problem.goal
    sides = [goal for goal in (False, True) if tight(query, ends[goal], turn)]
    tasks = [partial(_out_of, query, goal, turn) for goal in sides]
    found = dict(zip(sides, side_by_side(budget, tasks, ESCAPE.effort), strict=True))
    if not any(found.values()):
        return []
    outs, backs = (found.get(goal) or [NOTHING] for goal in (False, True))
    several = max(len(outs), len(backs))
    return [(outs[k % len(outs)], backs[k % len(backs)]) for k in range(several)]
