"""The lattice search: weighted A* over position and heading, in slices, on growable arrays.

A node keeps its exact pose; only the test for "been here before" rounds positions to cells. The
headings are ``heading0 + k * turn``, so every motion between nodes is an exact minimum-energy one:
straight along the heading, a pivot about either tread's ICR, or a spin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, floor, hypot, inf
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, Ints, ShortInts, lean, njit
from energyplan.path import Pose
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.settings import LATTICE
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.cost_to_go import CostToGo, node_at
from energyplan.planning.space.motions import (
    KernelProblem,
    free_energy,
    join,
    least_radius_at,
    motion_cost,
    permitted,
)
from energyplan.planning.space.queues import (
    Open,
    angle_between,
    longer,
    pop,
    push,
    slot_of,
    turning_by,
)
from energyplan.steering.kernels import MAX_SEGMENTS, arc_end
from energyplan.terrain.collision import in_cells

RUNNING, FOUND, EXHAUSTED, FULL = 0, 1, 2, 3  # why a slice of the search ended

MOTIONS = 10


class Lattice(NamedTuple):
    """Resolution of the search."""

    cell: float  # size of the cells in which two positions count as one [m]
    turn: float  # step of the headings [rad]
    headings: int  # their number
    step: float  # length of a straight motion [m]


class Tree(NamedTuple):
    """What the search remembers, all of it in arrays that can be replaced by larger ones."""

    x: Floats  # x of each node [m]
    y: Floats  # y of each node [m]
    heading: ShortInts  # index of its heading
    g: Floats  # cost so far
    h: Floats  # estimate of the cost to go
    parent: ShortInts  # node it was reached from, -1 at the root
    ds: Floats  # length of the motion by which it was reached [m]
    dtheta: Floats  # turn of that motion [rad]
    key: Ints  # cell and heading as one number
    table: ShortInts  # hash table from key to node, -1 where empty
    queue: Open  # nodes to go on from
    counts: Ints  # (4,): nodes, expanded ones, node that leads to the goal, expanded since a join


class Root(NamedTuple):
    """Where a search without a goal begins, at which cost."""

    x: float  # x and y of the place [m]
    y: float
    heading: int  # index of its heading, from that of the problem's start on
    cost: float


@lean
def _estimate(setting: KernelProblem, to_go: CostToGo, pose: Pose) -> float:
    """Cost to go: the greater of the guide's way among obstacles and the motion without them."""
    space = setting.space
    yaw = pose.yaw
    node = node_at(to_go, space, pose)
    if node < 0 or to_go.distance[node] == inf:
        return inf
    # 16 neighbours overestimate distances by up to 2.8 per cent
    far = LATTICE.neighbours * float(to_go.distance[node])
    turn = angle_between(yaw, setting.goal.yaw)
    if far > to_go.far:
        # on its way the robot takes the heading of the way, or drives it backwards
        ahead = float(to_go.direction[node]) + space.yaw
        through = turning_by(yaw, ahead, setting.goal.yaw)
        turn = max(turn, through - 2.0 * LATTICE.tolerance)
    round_obstacles = setting.least_metre * far + setting.least_radian * turn
    # turn, drive, turn is never below the least cost: steering is tried only if it can be greater
    dx = setting.goal.x - pose.x
    dy = setting.goal.y - pose.y
    above = round_obstacles - setting.steering.per_metre * hypot(dx, dy)
    if above >= 0.0:
        turning = turning_by(yaw, atan2(dy, dx), setting.goal.yaw)
        if above >= setting.steering.per_radian * turning:
            return round_obstacles
    return max(round_obstacles, free_energy(setting, pose))


@njit
def rehash(tree: Tree, count: int) -> None:
    """Fill an empty hash table; of several nodes with one key the last one counts."""
    for node in range(count):
        tree.table[slot_of(tree.table, tree.key, tree.key[node])] = node


@lean
def _key(space_x: float, space_y: float, lattice: Lattice, x: float, y: float, heading: int) -> int:
    column = floor((x - space_x) / lattice.cell) + (1 << 20)
    row = floor((y - space_y) / lattice.cell) + (1 << 20)
    return (row * (1 << 21) + column) * 1024 + heading


@lean
def _enter(
    tree: Tree, slot: int, key: int, x: float, y: float, heading: int, g: float, h: float,
    parent: int, ds: float, dtheta: float, f: float,
) -> None:  # fmt: skip
    """Add a node, in place of another of the same key in the hash table."""
    new = int(tree.counts[0])
    tree.counts[0] += 1
    tree.table[slot] = new
    tree.x[new] = x
    tree.y[new] = y
    tree.heading[new] = heading
    tree.g[new] = g
    tree.h[new] = h
    tree.parent[new] = parent
    tree.ds[new] = ds
    tree.dtheta[new] = dtheta
    tree.key[new] = key
    push(tree.queue, f, new)


@njit
def plant(
    tree: Tree, space_x: float, space_y: float, lattice: Lattice, x: float, y: float, heading: int,
    g: float, h: float, f: float,
) -> None:  # fmt: skip
    """Open a node that no other leads to; of several in one cell that of the least cost counts."""
    key = _key(space_x, space_y, lattice, x, y, heading)
    slot = slot_of(tree.table, tree.key, key)
    other = int(tree.table[slot])
    if other >= 0:
        if g >= tree.g[other]:
            return
        tree.g[other] = -inf
    _enter(tree, slot, key, x, y, heading, g, h, -1, 0.0, 0.0, f)


@lean
def _motion(lattice: Lattice, room: float, radius: float, kind: int) -> tuple[float, int]:
    """Return the length and the turn, in headings, of a motion; zero for one without room.

    They lead ahead and back, on pivots or arcs, on the spot, and across open ground in one stride.
    """
    sign = 1.0 if kind % 2 == 0 else -1.0
    if kind >= 8:
        return sign * room if room >= 2.0 * lattice.step else 0.0, 0
    if kind >= 6:
        return 0.0, 1 if kind == 6 else -1
    if kind >= 2:
        return sign * radius * lattice.turn, 1 if kind < 4 else -1
    return sign * lattice.step, 0


@lean
def _relax(
    tree: Tree, setting: KernelProblem, to_go: CostToGo, lattice: Lattice, weight: float,
    limit: float, node: int, here: Pose, ds: float, step: int,
) -> None:  # fmt: skip
    """Enter the node that a motion leads to, if it is permitted and no cheaper way is known."""
    space = setting.space
    dtheta = step * lattice.turn
    heading = (int(tree.heading[node]) + step) % lattice.headings
    there = arc_end(here, ds, dtheta)
    g = tree.g[node] + motion_cost(setting, here, ds, dtheta)
    key = _key(space.x, space.y, lattice, there.x, there.y, heading)
    slot = slot_of(tree.table, tree.key, key)
    other = int(tree.table[slot])
    h = 0.0
    if other >= 0:
        # a gain smaller than what lies within a cell is no reason to go through it again
        if g >= tree.g[other] - LATTICE.alike * lattice.cell * setting.least_metre:
            return
        h = tree.h[other]
        alike = (tree.x[other] - there.x) ** 2 + (tree.y[other] - there.y) ** 2 <= 1e-12
        if weight > 0 and not alike:
            h = _estimate(setting, to_go, there)
    elif weight > 0:
        h = _estimate(setting, to_go, there)
    if g + h >= limit:
        return
    if not permitted(setting, here, ds, dtheta):
        return
    # the old node stays as it is: its children's motions start from its own pose
    if other >= 0:
        # a stale entry of the heap is recognised by its cost
        tree.g[other] = -inf
    _enter(
        tree, slot, key, there.x, there.y, heading, g, h, node, ds, dtheta, g + weight * h
    )  # fmt: skip


@njit
def grow(
    tree: Tree,
    setting: KernelProblem,
    to_go: CostToGo,
    lattice: Lattice,
    weight: float,
    expansions: int,
    limit: float,
) -> int:
    """Expand nodes until a motion to the goal is found, or so many were expanded."""
    space, counts, queue = setting.space, tree.counts, tree.queue
    to_ds = np.empty(MAX_SEGMENTS)
    to_dtheta = np.empty(MAX_SEGMENTS)
    if counts[0] == 0:
        start = setting.start
        h = _estimate(setting, to_go, start) if weight > 0 else 0.0
        plant(tree, space.x, space.y, lattice, start.x, start.y, 0, 0.0, h, weight * h)
    for _ in range(expansions):
        if queue.size[0] == 0:
            return EXHAUSTED
        most = max(counts[0], queue.size[0]) + 2 * MOTIONS
        if most >= len(tree.x) or 2 * counts[0] >= len(tree.table):
            return FULL
        f = queue.f[0]
        node = pop(queue)
        g, h = tree.g[node], tree.h[node]
        if f > g + weight * h + 1e-9 or g + h >= limit:
            continue
        counts[1] += 1
        counts[3] += 1
        here = Pose(
            tree.x[node], tree.y[node], setting.start.yaw + int(tree.heading[node]) * lattice.turn
        )
        # the nearer the goal, the more often the exact motion to it is tried
        done = counts[3] * setting.half_track * setting.least_metre
        if weight > 0 and done >= LATTICE.lead * h:
            counts[3] = 0
            if join(setting, here, setting.goal, limit - g, to_ds, to_dtheta)[0] < inf:
                counts[2] = node
                # who looks for a cheaper one expands this node as well
                push(queue, f, node)
                return FOUND
        at = in_cells(space, here.x, here.y)
        clearance = float(space.clearance[int(at.row), int(at.column)]) * space.resolution
        room = clearance - setting.reach
        radius = max(setting.half_track, least_radius_at(setting, here))
        for kind in range(MOTIONS):
            ds, step = _motion(lattice, room, radius, kind)
            if ds == 0.0 and step == 0:
                continue
            _relax(tree, setting, to_go, lattice, weight, limit, node, here, ds, step)
    return RUNNING


def joined(setting: KernelProblem, pose: Pose, to: Pose) -> tuple[Segments, float]:
    """Return the cheapest free motion known between two poses, and its cost; infinite if none."""
    ds, dtheta = np.empty((2, MAX_SEGMENTS))
    cost, count = join(setting, pose, to, np.inf, ds, dtheta)
    return Segments(ds[:count].copy(), dtheta[:count].copy()), cost


def lattice_for(setting: KernelProblem, scale: float = 1.0) -> Lattice:
    """Return a lattice that suits the map and the body; `scale` below 1 makes it finer."""
    cell = max(setting.space.resolution, LATTICE.cell * setting.reach) * scale
    headings = min(round(LATTICE.headings / scale), LATTICE.most_headings)
    return Lattice(cell, 2 * np.pi / headings, headings, LATTICE.step * cell)


def coarse_lattice(setting: KernelProblem) -> Lattice:
    """Return the lattice of the search for many goals."""
    fine = lattice_for(setting)
    scale, turns = LATTICE.far_scale, LATTICE.far_headings
    return Lattice(scale * fine.cell, 2 * np.pi / turns, turns, scale * fine.step)


@dataclass
class Search:
    """One search tree; with a weight of zero it has no goal."""

    setting: KernelProblem  # the problem
    to_go: CostToGo  # distance to go
    lattice: Lattice  # resolution
    weight: float = LATTICE.weight  # factor on the estimated cost to go
    roots: Sequence[Root] = ()  # where it begins; at the problem's start where there are none

    def __post_init__(self) -> None:
        nodes = 1 << 14
        x, y, g, h, ds, dtheta = np.zeros((6, nodes))
        heading, parent = np.zeros((2, nodes), np.int32)
        key, table = np.zeros(nodes, np.int64), np.full(4 * nodes, -1, np.int32)
        counts = np.array([0, 0, -1, 1 << 30], np.int64)
        queue = Open(np.zeros(nodes), np.zeros(nodes, np.int32), np.zeros(1, np.int64))
        self.tree = Tree(x, y, heading, g, h, parent, ds, dtheta, key, table, queue, counts)
        for root in self.roots:
            if int(self.tree.counts[0]) + 1 >= len(self.tree.x):
                self._enlarge()
            space = self.setting.space
            plant(self.tree, space.x, space.y, self.lattice, *root, 0.0, root.cost)
        self._grow(0, np.inf)

    def _enlarge(self) -> None:
        """Double every array, and rebuild the hash table."""
        tree, kept = self.tree, ("table", "counts", "queue")
        double = {
            name: np.concatenate([array, np.zeros_like(array)])
            for name, array in tree._asdict().items()
            if name not in kept
        }
        queue = longer(tree.queue)
        table = np.full(2 * len(tree.table), -1, np.int32)
        self.tree = tree._replace(**double, queue=queue, table=table)
        rehash(self.tree, int(tree.counts[0]))

    def _grow(self, expansions: int, limit: float) -> int:
        return grow(
            self.tree, self.setting, self.to_go, self.lattice, self.weight, expansions, limit
        )

    def run(self, budget: Budget, expansions: float = np.inf, limit: float = np.inf) -> int:
        """Search until something is found, nothing is left, or the budget is over."""
        most = self.tree.counts[1] + expansions
        while True:
            before = int(self.tree.counts[1])
            slice_ = int(
                min(LATTICE.slice, max(most - before, 1), max(budget.left / UNITS.expansion, 1))
            )
            status = self._grow(slice_, limit)
            budget.spend(UNITS.expansion * (int(self.tree.counts[1]) - before))
            if status == FULL:
                self._enlarge()
            elif status != RUNNING:
                return status
            if budget.over or self.tree.counts[1] >= most:
                return RUNNING

    @property
    def found(self) -> bool:
        """Whether a motion to the goal is known."""
        return int(self.tree.counts[2]) >= 0

    @property
    def frontier(self) -> float:
        """Cost of the cheapest node that is still open; infinite where none is."""
        queue = self.tree.queue
        return float(queue.f[0]) if int(queue.size[0]) else np.inf

    def cheapest(self, budget: Budget, limit: float) -> Segments | None:
        """Return the cheapest motions to the goal, if they cost less than `limit`."""
        best = None
        while not budget.over and self.run(budget, limit=limit) == FOUND:
            best, cost = self._to_goal()
            limit = min((1.0 - LATTICE.less) * cost, limit)
        return best

    def segments(self) -> Segments:
        """Return the motions to the goal."""
        return self._to_goal()[0]

    def _to_goal(self) -> tuple[Segments, float]:
        """Return the motions to the goal, and their cost."""
        tree, chain = self.tree, []
        last = node = int(tree.counts[2])
        while tree.parent[node] >= 0:
            chain.append((tree.ds[node], tree.dtheta[node]))
            node = int(tree.parent[node])
        yaw = self.setting.start.yaw + int(tree.heading[last]) * self.lattice.turn
        pose = Pose(float(tree.x[last]), float(tree.y[last]), yaw)
        rest, cost = joined(self.setting, pose, self.setting.goal)
        steps = np.array(chain[::-1]).reshape(-1, 2).T
        whole = [np.concatenate(parts) for parts in zip(steps, rest, strict=True)]
        return Segments(*whole), float(tree.g[last]) + cost
