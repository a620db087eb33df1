"""What a state-lattice planner finds on a map: the route of least cost over its primitives.

SmacPlannerLattice searches the same graph with the same costs. Its result differs where it stops
early, smooths, or joins the goal by a curve of its own.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph

from energyplan.errors import NoPathError
from energyplan.export.lattice import ControlSet, Penalties, Primitive
from energyplan.path import FloatArray, Path, Pose, as_pose, point_ahead, wrap_angle
from energyplan.planning.problem import PlanningProblem

Ints = NDArray[np.intp]


class _Motions(NamedTuple):
    """Where a primitive, driven forwards (1) or backwards (-1), is free: from and to what state."""

    primitive: Primitive
    gear: int
    source: Ints
    target: Ints


class Lattice:
    """The state lattice of a map."""

    def __init__(self, problem: PlanningProblem, controls: ControlSet) -> None:
        self.problem, self.controls = problem, controls
        grid, size = problem.terrain.obstacles, controls.resolution
        rows, columns = (max(int(n * grid.resolution / size), 1) for n in grid.shape)
        self.shape = rows, columns, len(controls.headings)
        row, column = np.indices((rows, columns))
        self._middle = grid.to_world((np.stack([column, row], -1) + 0.5) * size / grid.resolution)
        self._yaw = np.array(controls.headings) + grid.origin.yaw
        self._free = np.stack([self._free_at(float(yaw)) for yaw in self._yaw], -1)
        driven = [
            (primitive, gear)
            for primitive in controls.primitives
            for gear in ((1, -1) if primitive.length > 0 else (1,))
        ]
        self._known = {(*self._ends(p, gear), p.column, p.row): (p, gear) for p, gear in driven}
        self._motions = [self._where_free(p, gear) for p, gear in self._known.values()]

    def _poses(self, points: FloatArray, yaw: float) -> FloatArray:
        """Return the poses of the body whose reference point is at some points."""
        poses = np.column_stack([points, np.full(len(points), yaw)])
        poses[:, :2] = point_ahead(poses, -self.problem.cost.icr.longitudinal)
        return poses

    def _free_at(self, yaw: float) -> NDArray[np.bool_]:
        poses = self._poses(self._middle.reshape(-1, 2), yaw)
        free = self.problem.terrain.obstacles.footprint_free(poses, self.problem.robot)
        return np.asarray(free.reshape(self.shape[:2]))

    def _driven(self, primitive: Primitive, gear: int, start: Pose) -> Path:
        """Return a primitive as it is driven from a pose."""
        ds, turn = primitive.motions.T
        return Path(start, gear * ds, turn, self.problem.cost.icr.longitudinal)

    def _ends(self, primitive: Primitive, gear: int) -> tuple[int, int]:
        """Return the robot's headings at both ends of a primitive."""
        # who drives it backwards faces away from where it leads
        turned, count = 0 if gear > 0 else len(self._yaw) // 2, len(self._yaw)
        return (primitive.start + turned) % count, (primitive.end + turned) % count

    def _between(self, here: int, there: int) -> tuple[Primitive, int]:
        """Return the primitive between two states, and its gear."""
        (r, c, a), (rr, cc, b) = (np.unravel_index(state, self.shape) for state in (here, there))
        return self._known[int(a), int(b), int(cc - c), int(rr - r)]

    def _where_free(self, primitive: Primitive, gear: int) -> _Motions:
        start, end = self._ends(primitive, gear)
        rows, columns, _ = self.shape
        row, column = np.nonzero(self._free[..., start])
        to_row, to_column = row + primitive.row, column + primitive.column
        inside = (to_row >= 0) & (to_row < rows) & (to_column >= 0) & (to_column < columns)
        row, column, to_row, to_column = (v[inside] for v in (row, column, to_row, to_column))
        free = self._free[to_row, to_column, end]
        row, column, to_row, to_column = (v[free] for v in (row, column, to_row, to_column))
        yaw = float(self._yaw[start])
        poses = self._poses(self._middle[row, column], yaw)
        path = self._driven(primitive, gear, Pose(0.0, 0.0, yaw))
        free = np.ones(len(poses), bool)
        for ds, turn, at in zip(path.ds, path.dtheta, path.vertices[:-1], strict=True):
            free &= self.problem.terrain.obstacles.motions_free(
                poses + (at - np.array(path.start)),
                np.full(len(poses), ds),
                np.full(len(poses), turn),
                self.problem.robot,
                path.longitudinal,
            )

        def states(row: Ints, column: Ints, heading: int) -> Ints:
            place = (row[free], column[free], np.full(int(free.sum()), heading))
            return np.asarray(np.ravel_multi_index(place, self.shape))

        return _Motions(primitive, gear, states(row, column, start), states(to_row, to_column, end))

    def _graph(self, penalties: Penalties) -> Any:
        """Return what each motion between states costs, in cells of straight driving."""
        costs = []
        for primitive, gear, source, _ in self._motions:
            cost = penalties.rotation
            if primitive.length > 0:
                cost = primitive.length / self.controls.resolution
                cost *= penalties.non_straight if primitive.arc > 0 else 1.0
                cost *= 1.0 if gear > 0 else penalties.reverse
            costs.append(np.full(len(source), cost))
        ends = [np.concatenate([m[k] for m in self._motions]) for k in (2, 3)]
        count = int(np.prod(self.shape))
        found = sparse.coo_array((np.concatenate(costs), tuple(ends)), (count, count))
        return found.tocsr()

    def nearest(self, pose: ArrayLike) -> Pose:
        """Return the pose of the lattice nearest to a pose, free or not."""
        return self._pose(self._state(as_pose(pose, "a pose")))

    def _state(self, pose: Pose) -> int:
        point = point_ahead(pose, self.problem.cost.icr.longitudinal)
        grid = self.problem.terrain.obstacles
        cell = grid.to_cells(point) * grid.resolution / self.controls.resolution
        rows, columns, _ = self.shape
        column, row = (
            int(min(max(v, 0), n - 1)) for v, n in zip(cell, (columns, rows), strict=True)
        )
        heading = int(np.argmin(np.abs(wrap_angle(self._yaw - pose.yaw))))
        return int(np.ravel_multi_index((row, column, heading), self.shape))

    def _pose(self, state: int) -> Pose:
        row, column, heading = np.unravel_index(state, self.shape)
        yaw = float(self._yaw[heading])
        return Pose(*self._poses(self._middle[row, column][None], yaw)[0].tolist())

    def routes(self, start: ArrayLike, goals: ArrayLike, penalties: Penalties) -> list[Path]:
        """Return the routes of least cost from a pose to others, all taken to the lattice's own."""
        graph = self._graph(penalties)
        first = self._state(as_pose(start, "the start"))
        _, all_before = csgraph.dijkstra(graph, indices=[first], return_predecessors=True)
        before = all_before[0]
        chains = []
        for row in np.asarray(goals, float):
            chain = [self._state(as_pose(row, "a goal"))]
            while chain[-1] != first:
                if before[chain[-1]] < 0:
                    x, y = row[:2].tolist()
                    raise NoPathError(f"no route of primitives leads to ({x:.2f}, {y:.2f})")
                chain.append(int(before[chain[-1]]))
            chains.append(chain[::-1])
        found = []
        for chain in chains:
            whole = Path(self._pose(first), np.empty(0), np.empty(0), self._longitudinal)
            for pair in pairwise(chain):
                whole = whole + self._driven(*self._between(*pair), whole.end)
            found.append(whole)
        return found

    @property
    def _longitudinal(self) -> float:
        return self.problem.cost.icr.longitudinal
