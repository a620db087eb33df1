"""The lattice search as an object: grows its arrays, keeps to its budget, hands back motions."""

from __future__ import annotations

from dataclasses import dataclass
from math import remainder
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from energyplan.planning.budget import Budget
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem, join
from energyplan.steering.kernels import MAX_SEGMENTS
from energyplan.terrain.collision import motion_free

Number = TypeVar("Number", bound=np.generic)

HEADINGS, MOST_HEADINGS = 32, 512
"""Headings of the coarsest lattice, and of the finest one."""

EXPANSION = 0.3
"""Units of work that an expansion counts as."""

SLICE = 500
"""Expansions between two looks at the budget."""


def lattice_for(setting: KernelProblem, scale: float = 1.0) -> kernels.Lattice:
    """Return a lattice that suits the map and the body; `scale` below 1 makes it finer."""
    cell = max(setting.space.resolution, 0.2 * setting.reach) * scale
    headings = min(round(HEADINGS / scale), MOST_HEADINGS)
    return kernels.Lattice(cell, 2 * np.pi / headings, headings, 1.5 * cell)


def coarse_lattice(setting: KernelProblem) -> kernels.Lattice:
    """Return the lattice of the search for many goals."""
    fine = lattice_for(setting)
    turns = HEADINGS * 3 // 4
    return kernels.Lattice(1.5 * fine.cell, 2 * np.pi / turns, turns, 1.5 * fine.step)


@dataclass
class Search:
    """One search tree."""

    setting: KernelProblem  # the problem
    to_go: DistanceToGo  # distance to go
    lattice: kernels.Lattice  # resolution
    weight: float  # factor on the estimated cost to go
    aligned: bool = False

    def __post_init__(self) -> None:
        here = self.setting
        self.spin = 0.0
        if self.aligned:
            turn = self.lattice.turn
            spin = -remainder(here.start_yaw - here.space.yaw, turn)
            pose = here.start_x, here.start_y, here.start_yaw
            if motion_free(here.space, here.body, *pose, 0.0, spin, 0.0):
                self.spin = spin
                self.setting = here._replace(start_yaw=here.start_yaw + spin)
        nodes = 1 << 14
        self.tree = kernels.Tree(
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
        kernels.rehash(larger, count)
        self.tree = larger

    def _grow(self, expansions: int, stop_at_first: bool, limit: float) -> int:
        return kernels.grow(
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
            if status == kernels.FULL:
                self._enlarge()
            elif status != kernels.RUNNING:
                return status
            if budget.over or self.tree.counts[2] >= most:
                return kernels.RUNNING

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
