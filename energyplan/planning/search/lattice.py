"""The lattice search: weighted A* over position and heading, in slices, on growable arrays.

A node keeps its exact pose; only the test for "been here before" rounds positions to cells. The
headings are ``heading0 + k * turn``, so every motion between nodes is an exact minimum-energy one:
straight along the heading, a pivot about either tread's ICR, or a spin.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, floor, hypot, inf, pi, remainder
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import Floats, Ints, ShortInts, njit
from energyplan.path import Pose
from energyplan.planning.budget import Budget
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.cost_to_go import DistanceToGo, node_at
from energyplan.planning.space.motions import (
    KernelProblem,
    connection,
    free_energy,
    join,
    motion_cost,
    price,
)
from energyplan.planning.space.queues import angle_between, pop, push, slot_of
from energyplan.steering.kernels import MAX_SEGMENTS, arc_end
from energyplan.terrain.collision import in_cells, motion_free

RUNNING, FOUND, EXHAUSTED, FULL = 0, 1, 2, 3
"""Why a slice of the search ended."""

MOTIONS = 10

TOLERANCE = 0.15
"""How far the first heading of the way may be off [rad]."""


class Lattice(NamedTuple):
    """Resolution of the search."""

    cell: float  # size of the cells in which two positions count as one [m]
    turn: float  # step of the headings [rad]
    headings: int  # their number
    step: float  # length of a straight motion [m]


class Tree(NamedTuple):
    """What the search remembers, all of it in arrays that can be replaced by larger ones."""

    x: Floats  # position of each node [m]
    y: Floats  # position of each node [m]
    heading: ShortInts  # index of its heading
    g: Floats  # cost so far, and estimate of the cost to go
    h: Floats  # cost so far, and estimate of the cost to go
    parent: ShortInts  # node it was reached from, -1 at the root
    ds: Floats  # motion by which it was reached
    dtheta: Floats  # motion by which it was reached
    key: Ints  # cell and heading as one number
    table: ShortInts  # hash table from key to node, -1 where empty
    heap_f: Floats  # binary heap of open nodes
    heap_node: ShortInts  # binary heap of open nodes
    counts: Ints  # (5,)
    best: Floats  # (1,): cost of the best motion to the goal so far


@njit
def _estimate(setting: KernelProblem, to_go: DistanceToGo, x: float, y: float, yaw: float) -> float:
    """Cost to go: the greater of the guide's way among obstacles and the motion without them."""
    space = setting.space
    node = node_at(to_go, space, x, y, yaw)
    if node < 0 or to_go.distance[node] == inf:
        return inf
    # 16 neighbours overestimate distances by up to 2.8 per cent
    far = 0.973 * float(to_go.distance[node])
    turn = angle_between(yaw, setting.goal_yaw)
    if far > to_go.far:
        # on its way the robot takes the heading of the way, or drives it backwards
        ahead = float(to_go.direction[node]) + space.yaw
        through = inf
        for way in range(2):
            heading = ahead + way * pi
            through = min(
                through, angle_between(yaw, heading) + angle_between(heading, setting.goal_yaw)
            )
        turn = max(turn, through - 2.0 * TOLERANCE)
    round_obstacles = setting.least_metre * far + setting.least_radian * turn
    # turn, drive, turn is never below the least cost: steering is asked only if it can be greater
    dx = setting.goal_x - x
    dy = setting.goal_y - y
    above = round_obstacles - setting.steering.per_metre * hypot(dx, dy)
    if above >= 0.0:
        straight = atan2(dy, dx)
        turning = inf
        for way in range(2):
            heading = straight + way * pi
            turning = min(
                turning, angle_between(yaw, heading) + angle_between(heading, setting.goal_yaw)
            )
        if above >= setting.steering.per_radian * turning:
            return round_obstacles
    return max(round_obstacles, free_energy(setting, x, y, yaw))


@njit
def rehash(tree: Tree, count: int) -> None:
    """Fill an empty hash table; of several nodes with one key the last one counts."""
    for node in range(count):
        tree.table[slot_of(tree.table, tree.key, tree.key[node])] = node


@njit
def _key(space_x: float, space_y: float, lattice: Lattice, x: float, y: float, heading: int) -> int:
    column = floor((x - space_x) / lattice.cell) + (1 << 20)
    row = floor((y - space_y) / lattice.cell) + (1 << 20)
    return (row * (1 << 21) + column) * 1024 + heading


@njit
def grow(
    tree: Tree,
    setting: KernelProblem,
    to_go: DistanceToGo,
    lattice: Lattice,
    weight: float,
    expansions: int,
    stop_at_first: bool,
    limit: float,
) -> int:
    """Expand nodes until a motion to the goal is found, or so many were expanded."""
    space = setting.space
    counts = tree.counts
    half = setting.half_track
    even = setting.surface.size == 1
    capacity = len(tree.x)
    if counts[0] == 0:
        tree.x[0] = setting.start_x
        tree.y[0] = setting.start_y
        tree.heading[0] = 0
        tree.g[0] = 0.0
        if weight > 0:
            tree.h[0] = _estimate(
                setting, to_go, setting.start_x, setting.start_y, setting.start_yaw
            )
        tree.parent[0] = -1
        tree.key[0] = _key(space.x, space.y, lattice, tree.x[0], tree.y[0], 0)
        tree.table[slot_of(tree.table, tree.key, tree.key[0])] = 0
        counts[0] = 1
        counts[1] = push(tree.heap_f, tree.heap_node, 0, weight * tree.h[0], 0)
    for _ in range(expansions):
        if counts[1] == 0:
            return EXHAUSTED
        if (
            counts[0] + 2 * MOTIONS >= capacity
            or counts[1] + 2 * MOTIONS >= len(tree.heap_f)
            or 2 * counts[0] >= len(tree.table)
        ):
            return FULL
        f = tree.heap_f[0]
        node = int(tree.heap_node[0])
        counts[1] = pop(tree.heap_f, tree.heap_node, counts[1])
        g = tree.g[node]
        if f > g + weight * tree.h[node] + 1e-9:
            continue
        if f >= tree.best[0]:
            # what is left costs more, or at least more than best / weight
            return EXHAUSTED
        if g + tree.h[node] >= limit:
            continue
        counts[2] += 1
        counts[4] += 1
        x = tree.x[node]
        y = tree.y[node]
        index = int(tree.heading[node])
        yaw = setting.start_yaw + index * lattice.turn

        # the nearer the goal, the more often the exact motion to it is tried
        if (
            weight > 0
            and counts[4] * setting.half_track * setting.least_metre >= 0.2 * tree.h[node]
        ):
            counts[4] = 0
            through = g + connection(setting, x, y, yaw, tree.best[0] - g)
            if through < tree.best[0]:
                tree.best[0] = through
                counts[3] = node
                if stop_at_first:
                    return FOUND

        here = in_cells(space, x, y)
        room = (
            float(space.clearance[int(here.row), int(here.column)]) * space.resolution
            - setting.reach
        )
        for motion in range(MOTIONS):
            ds = 0.0
            step = 0
            if motion < 2:
                ds = lattice.step if motion == 0 else -lattice.step
            elif motion < 6:
                step = 1 if motion < 4 else -1
                ds = max(half, setting.least_radius) * lattice.turn
                ds *= 1.0 if motion % 2 == 0 else -1.0
            elif motion < 8:
                if setting.least_radius > 0.0:
                    continue
                step = 1 if motion == 6 else -1
            else:
                # across open ground in one stride
                if room < 2.0 * lattice.step:
                    continue
                ds = room if motion == 8 else -room
            dtheta = step * lattice.turn
            heading = (index + step) % lattice.headings
            there = arc_end(Pose(x, y, yaw), ds, dtheta)
            xx = there.x
            yy = there.y
            if even:
                gg = g + price(setting.prices, 0, half, ds, dtheta)
            else:
                gg = g + motion_cost(setting, x, y, yaw, ds, dtheta)
            key = _key(space.x, space.y, lattice, xx, yy, heading)
            slot = slot_of(tree.table, tree.key, key)
            other = int(tree.table[slot])
            if other >= 0:
                # a gain smaller than what lies within a cell is no reason to go through it again
                if gg >= tree.g[other] - 0.2 * lattice.cell * setting.least_metre:
                    continue
                h = tree.h[other]
                if weight > 0 and (tree.x[other] - xx) ** 2 + (tree.y[other] - yy) ** 2 > 1e-12:
                    h = _estimate(setting, to_go, xx, yy, yaw + dtheta)
            else:
                h = _estimate(setting, to_go, xx, yy, yaw + dtheta) if weight > 0 else 0.0
            if gg + h >= min(tree.best[0], limit):
                continue
            if not motion_free(space, setting.body, x, y, yaw, ds, dtheta, 0.0):
                continue
            # the old node stays as it is: its children's motions start from its own pose
            new = int(counts[0])
            counts[0] += 1
            tree.table[slot] = new
            tree.x[new] = xx
            tree.y[new] = yy
            tree.heading[new] = heading
            tree.g[new] = gg
            tree.h[new] = h
            tree.parent[new] = node
            tree.ds[new] = ds
            tree.dtheta[new] = dtheta
            tree.key[new] = key
            if other >= 0:
                # a stale entry of the heap is told by its cost
                tree.g[other] = -inf
            counts[1] = push(tree.heap_f, tree.heap_node, counts[1], gg + weight * h, new)
    return RUNNING


Number = TypeVar("Number", bound=np.generic)

HEADINGS, MOST_HEADINGS = 32, 512
"""Headings of the coarsest lattice, and of the finest one."""

EXPANSION = 0.3
"""Units of work that an expansion counts as."""

SLICE = 500
"""Expansions between two looks at the budget."""


def lattice_for(setting: KernelProblem, scale: float = 1.0) -> Lattice:
    """Return a lattice that suits the map and the body; `scale` below 1 makes it finer."""
    cell = max(setting.space.resolution, 0.2 * setting.reach) * scale
    headings = min(round(HEADINGS / scale), MOST_HEADINGS)
    return Lattice(cell, 2 * np.pi / headings, headings, 1.5 * cell)


def coarse_lattice(setting: KernelProblem) -> Lattice:
    """Return the lattice of the search for many goals."""
    fine = lattice_for(setting)
    turns = HEADINGS * 3 // 4
    return Lattice(1.5 * fine.cell, 2 * np.pi / turns, turns, 1.5 * fine.step)


@dataclass
class Search:
    """One search tree."""

    setting: KernelProblem  # the problem
    to_go: DistanceToGo  # distance to go
    lattice: Lattice  # resolution
    weight: float  # factor on the estimated cost to go
    aligned: bool = False

    def __post_init__(self) -> None:
        here = self.setting
        self.spin = 0.0
        if self.aligned and here.least_radius == 0.0:
            turn = self.lattice.turn
            spin = -remainder(here.start_yaw - here.space.yaw, turn)
            pose = here.start_x, here.start_y, here.start_yaw
            if motion_free(here.space, here.body, *pose, 0.0, spin, 0.0):
                self.spin = spin
                self.setting = here._replace(start_yaw=here.start_yaw + spin)
        nodes = 1 << 14
        self.tree = Tree(
            x=np.zeros(nodes),
            y=np.zeros(nodes),
            heading=np.zeros(nodes, np.int32),
            g=np.zeros(nodes),
            h=np.zeros(nodes),
            parent=np.full(nodes, -1, np.int32),
            ds=np.zeros(nodes),
            dtheta=np.zeros(nodes),
            key=np.zeros(nodes, np.int64),
            table=np.full(4 * nodes, -1, np.int32),
            heap_f=np.zeros(nodes),
            heap_node=np.zeros(nodes, np.int32),
            counts=np.array([0, 0, 0, -1, 1 << 30], np.int64),
            best=np.array([np.inf]),
        )
        self._grow(0, False, np.inf)

    def _enlarge(self) -> None:
        """Double every array, and rebuild the hash table."""

        def double(array: NDArray[Number]) -> NDArray[Number]:
            return np.concatenate([array, np.zeros_like(array)])

        tree = self.tree
        count = int(tree.counts[0])
        larger = tree._replace(
            x=double(tree.x),
            y=double(tree.y),
            heading=double(tree.heading),
            g=double(tree.g),
            h=double(tree.h),
            parent=double(tree.parent),
            ds=double(tree.ds),
            dtheta=double(tree.dtheta),
            key=double(tree.key),
            heap_f=double(tree.heap_f),
            heap_node=double(tree.heap_node),
            table=np.full(2 * len(tree.table), -1, np.int32),
        )
        rehash(larger, count)
        self.tree = larger

    def _grow(self, expansions: int, stop_at_first: bool, limit: float) -> int:
        return grow(
            self.tree,
            self.setting,
            self.to_go,
            self.lattice,
            self.weight,
            expansions,
            stop_at_first,
            limit,
        )

    def run(
        self,
        budget: Budget,
        stop_at_first: bool,
        expansions: int | None = None,
        limit: float = np.inf,
    ) -> int:
        """Search until something is found, nothing is left, or the budget is over."""
        most = np.inf if expansions is None else self.tree.counts[2] + expansions
        while True:
            before = int(self.tree.counts[2])
            slice_ = int(min(SLICE, max(most - before, 1), max(budget.left / EXPANSION, 1)))
            status = self._grow(slice_, stop_at_first, limit)
            budget.spend(EXPANSION * (int(self.tree.counts[2]) - before))
            if status == FULL:
                self._enlarge()
            elif status != RUNNING:
                return status
            if budget.over or self.tree.counts[2] >= most:
                return RUNNING

    @property
    def best(self) -> float:
        """Cost of the best motion to the goal so far; infinite where none is known."""
        return float(self.tree.best[0])

    @property
    def found(self) -> bool:
        """Whether a motion to the goal is known."""
        return int(self.tree.counts[3]) >= 0

    @property
    def frontier(self) -> float:
        """Cost of the cheapest node that is still open; infinite where none is."""
        return float(self.tree.heap_f[0]) if int(self.tree.counts[1]) else np.inf

    @property
    def nearest(self) -> tuple[float, float]:
        """The place reached from which the goal seems to be nearest, x and y [m]."""
        node = int(np.argmin(self.tree.h[: int(self.tree.counts[0])]))
        return float(self.tree.x[node]), float(self.tree.y[node])

    def segments(self, setting: KernelProblem | None = None, node: int | None = None) -> Segments:
        """Return the motions to the goal; by way of `node` to that of `setting`, where given."""
        tree = self.tree
        setting = self.setting if setting is None else setting
        node = int(tree.counts[3]) if node is None else node
        last = (
            float(tree.x[node]),
            float(tree.y[node]),
            self.setting.start_yaw + int(tree.heading[node]) * self.lattice.turn,
        )
        chain = []
        while tree.parent[node] >= 0:
            chain.append((float(tree.ds[node]), float(tree.dtheta[node])))
            node = int(tree.parent[node])
        steps = np.array(chain[::-1]).reshape(-1, 2)
        ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
        _, count = join(
            setting,
            *last,
            setting.goal_x,
            setting.goal_y,
            setting.goal_yaw,
            np.inf,
            ds,
            dtheta,
        )
        return Segments(
            np.concatenate([[0.0], steps[:, 0], ds[:count]]),
            np.concatenate([[self.spin], steps[:, 1], dtheta[:count]]),
        )
