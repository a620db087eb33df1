"""Ends so tight that a lattice does not join them: a way leads out of each to where there is room.

Most searches end a hand's breadth from a goal that they cannot turn into, and one that starts there
does not get away. The way out is found first, by motions as short as the room there is, and the
searches begin and end where it does. It is a way as any other: refinement makes of it what is best.

Best paths touch obstacles, and one that was planned without a margin may be free or not by
rounding. If it is not, planning is done anew between the two poses that have room.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import floor, log2, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, Ints, ShortInts, njit
from energyplan.errors import PlanningError
from energyplan.path import Path, Pose
from energyplan.planning.budget import Budget, side_by_side
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space.compiled import CompiledProblem, Segments
from energyplan.planning.space.motions import KernelProblem, motion_cost, steering_cost
from energyplan.planning.space.queues import pop, push, slot_of
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


TURN = 0.2
"""What the body can turn on the spot where there is room, both ways together [rad]."""

WAYS = 6
"""Ways out of an end, of which the best is taken."""

EFFORT = 3000.0
"""Units of work for each kind of way out of each end, at most."""

TEST = 0.07
"""Units of work that the test of a motion counts as."""

SLICE = 2000
"""Tests between two looks at the budget."""

NODES = 1 << 13
"""Poses that the search for a way out remembers."""

ONLY = (0.0, 1.0, -1.0)
"""Kinds of ways: any, only forwards, only backwards. The first one is to and fro at times."""

NOTHING = Segments(np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Ends:
    """Where searches begin and end, and the motions between there and the problem's own ends."""

    query: CompiledProblem  # the problem
    out: Segments = NOTHING
    back: Segments = NOTHING

    @property
    def eased(self) -> bool:
        """Whether searches begin or end elsewhere than the problem does."""
        return len(self.out.ds) + len(self.back.ds) > 0

    @cached_property
    def problem(self) -> PlanningProblem:
        """The problem between the two poses."""
        problem = self.query.problem
        out, back = (self.query.reference(*part) for part in (self.out, self.back))
        longitudinal = problem.cost.icr.longitudinal
        away = Path(problem.goal, -back.ds[::-1], -back.dtheta[::-1], longitudinal)
        return replace(
            problem,
            start=Path(problem.start, out.ds, out.dtheta, longitudinal).end,
            goal=away.end,
        )

    def between(self, setting: KernelProblem) -> KernelProblem:
        """Return the kernels' problem between the two poses, with the margin where it fits."""
        if not self.eased:
            return setting
        query = self.query
        ends = self.problem.start, self.problem.goal
        start, goal = (query.centre(end) for end in ends)
        return setting._replace(
            body=query.grown if all(query.roomy(end) for end in ends) else setting.body,
            start=start,
            goal=goal,
        )

    def around(self, inner: Path) -> Path:
        """Return the path from the problem's start to its goal by way of one in between."""
        out, back = (self.query.reference(*part) for part in (self.out, self.back))
        return replace(
            inner,
            start=self.query.problem.start,
            ds=np.concatenate([out.ds, inner.ds, back.ds]),
            dtheta=np.concatenate([out.dtheta, inner.dtheta, back.dtheta]),
        )

    def refined(self, inner: Path, budget: Budget) -> Path:
        """Return `around(inner)`, refined with the margin where it fits."""
        query = self.query
        whole = self.around(inner)
        # what is not free with the margin stays as it is
        motions = query.of_centre(whole.ds, whole.dtheta)
        refiner = Refiner(query.setting._replace(body=query.grown), motions)
        refiner.shortcut(budget)
        refiner.polish(budget)
        try:
            return min(whole, query.path(refiner.segments), key=query.value)
        except PlanningError:
            return whole

    def whole(self, inner: Segments) -> Segments:
        """Return the motions from the problem's start to its goal by way of those in between."""
        return Segments(
            np.concatenate([self.out.ds, inner.ds, self.back.ds]),
            np.concatenate([self.out.dtheta, inner.dtheta, self.back.dtheta]),
        )


def tight(query: CompiledProblem, end: Pose, turn: float = TURN) -> bool:
    """Tell whether a start or a goal lacks the margin, or room for a turn up to `TURN` [rad]."""
    if surely_roomy(query, end):
        return False
    room = spin_room(query.grid.space, query.body, *query.centre(end), TURN)
    return not query.roomy(end) or room < turn


def surely_roomy(query: CompiledProblem, end: Pose) -> bool:
    """Tell whether an end has the margin, and room for the whole `TURN` one way or the other."""
    space, body, pose = query.grid.space, query.body, query.centre(end)
    return query.roomy(end) and any(
        motion_free(space, body, *pose, 0.0, way, 0.0) for way in (TURN, -TURN)
    )


class Way(NamedTuple):
    """A way out of an end, or into it."""

    motions: Segments  # its motions, as they are driven
    promise: float  # what it costs, and the motion between where it has room and the other end


def _way_out(
    query: CompiledProblem, goal: bool, only: float, turn: float, budget: Budget
) -> Way | None:
    """Return the way that costs least on the whole with what is left then, if any is known."""
    problem = query.problem
    ends = (problem.goal, problem.start) if goal else (problem.start, problem.goal)
    pose, far = (query.centre(end) for end in ends)
    space, body, setting = query.grid.space, query.body, query.setting
    tree = Escape(
        x=np.zeros(NODES),
        y=np.zeros(NODES),
        yaw=np.zeros(NODES),
        g=np.zeros(NODES),
        room=np.zeros(NODES),
        parent=np.full(NODES, -1, np.int32),
        ds=np.zeros(NODES),
        dtheta=np.zeros(NODES),
        key=np.zeros(NODES, np.int64),
        table=np.full(4 * NODES, -1, np.int32),
        heap_f=np.zeros(NODES),
        heap_node=np.zeros(NODES, np.int32),
        roomy=np.zeros(NODES, np.int32),
        counts=np.zeros(4, np.int64),
    )
    plant_escape(tree, space, body, *pose, setting.reach, TURN)
    more = True
    while more and int(tree.counts[2]) < WAYS and not budget.over:
        before = int(tree.counts[3])
        more = grow_escape(
            tree,
            space,
            body,
            query.grown,
            max(setting.half_track, setting.least_radius),
            setting.least_radius == 0.0,
            setting.reach,
            TURN,
            goal,
            only,
            turn,
            before + min(SLICE, int(budget.left / TEST) + 1),
            WAYS,
        )
        budget.spend(TEST * (int(tree.counts[3]) - before))
    ways = []
    for node in tree.roomy[: int(tree.counts[2])].tolist():
        room = Pose(float(tree.x[node]), float(tree.y[node]), float(tree.yaw[node]))
        chain = []
        while tree.parent[node] >= 0:
            chain.append((float(tree.ds[node]), float(tree.dtheta[node])))
            node = int(tree.parent[node])
        here = room if goal else pose
        begin, end = (far, room) if goal else (room, far)
        rest = steering_cost(setting, begin, end)
        for ds, dtheta in chain if goal else chain[::-1]:
            rest += motion_cost(setting, here, ds, dtheta)
            here = arc_end(here, ds, dtheta)
        ways.append(Way(Segments(*np.array(chain if goal else chain[::-1]).T), rest))
    return min(ways, key=lambda way: way.promise, default=None)


def ways_out(query: CompiledProblem, budget: Budget, turn: float = TURN) -> list[Ends]:
    """Return ends with room, the most promising first."""
    ends = query.problem.start, query.problem.goal
    kinds = [
        (goal, only) for goal in (False, True) if tight(query, ends[goal], turn) for only in ONLY
    ]
    tasks = [partial(_way_out, query, goal, only, turn) for goal, only in kinds]
    found: dict[bool, list[Way]] = {False: [], True: []}
    for (goal, _), way in zip(kinds, side_by_side(budget, tasks, EFFORT), strict=True):
        if way is not None:
            found[goal].append(way)
    outs, backs = (
        [way.motions for way in sorted(found[goal], key=lambda way: way.promise)] or [NOTHING]
        for goal in (False, True)
    )
    several = max(len(outs), len(backs))
    return [Ends(query, outs[k % len(outs)], backs[k % len(backs)]) for k in range(several)]
