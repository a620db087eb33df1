"""Soft costs of places, such as an inflated costmap: what a metre there is worth avoiding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import MapError
from energyplan.path import FloatArray, Path, Pose
from energyplan.records import ReadOnly
from energyplan.terrain.frame import ORIGIN
from energyplan.terrain.grid import OccupancyGrid

PIECE = 0.25
"""Length of the pieces of a path that pay for the cell under their middle [cells]."""


@dataclass(frozen=True, eq=False)
class CostMap(ReadOnly):
    """Costs of cells from 0 (none) to 1 (the highest)."""

    costs: FloatArray  # (rows, columns): costs
    resolution: float  # size of a cell [m]
    origin: Pose = ORIGIN  # (3,): pose of the outer corner of cell (0, 0) in the world

    def __post_init__(self) -> None:
        costs = np.array(self.costs, float)
        if costs.ndim != 2 or costs.size == 0 or not np.all((costs >= 0) & (costs <= 1)):
            raise MapError(
                f"costs have shape {costs.shape}; give rows and columns of numbers from 0 to 1"
            )
        costs.setflags(write=False)
        object.__setattr__(self, "costs", costs)
        # it lies where a map of the same frame would
        frame = OccupancyGrid(np.zeros(costs.shape, bool), self.resolution, self.origin)
        object.__setattr__(self, "origin", frame.origin)
        object.__setattr__(self, "_frame", frame)

    def at(self, points: ArrayLike) -> FloatArray:
        """Return the cost at world points (..., 2) [m]; 0 outside."""
        frame: OccupancyGrid = self.__dict__["_frame"]
        return frame.values_at(self.costs, points)

    def along(self, path: Path) -> float:
        """Return the costs along a path, times the metres of its reference point [m].

        Pieces of a quarter of a cell pay for the cell under their middle; turns on the spot pay
        nothing.
        """
        fine = path.subdivide(PIECE * self.resolution)
        points = fine.points
        middle = 0.5 * (points[:-1] + points[1:])
        return float(np.sum(np.abs(fine.ds) * self.at(middle)))

    def over(self, grid: OccupancyGrid) -> FloatArray:
        """Return the costs at the centres of a map's cells, shape (rows, columns)."""
        return np.stack([self.at(grid.centres(row)) for row in range(grid.shape[0])])
