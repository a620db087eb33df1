"""How far it is at least from place to place on a map."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from energyplan.path import FloatArray
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

_CELLS = 30_000
"""Most cells of the coarse grid."""

_OCTILE = np.cos(np.pi / 8)
"""Least distance over way along the eight directions of a grid."""


def shortest_ways(grid: OccupancyGrid, vehicle: Vehicle, points: FloatArray) -> FloatArray:
    """Return how far the robot's origin travels at least from point to point.

    The largest disc about the origin inside the footprint moves over cells that are coarse enough
    for a quick search; a coarse cell is open if the disc fits at any place in it. The way along
    eight directions is at most 1.08 times the shortest; what the cells blur is taken off.

    Parameters
    ----------
    grid : OccupancyGrid
        Obstacles.
    vehicle : Vehicle
        The vehicle, for its footprint.
    points : ndarray, shape (n, 2)
        Points in the world [m].

    Returns
    -------
    ndarray, shape (n, n)
        Lengths [m]; infinite where no disc gets from one to the other.
    """
    rows, columns = grid.shape
    stride = max(int(np.ceil(np.sqrt(rows * columns / _CELLS))), 1)
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    radius = max(min(-x_min, x_max, -y_min, y_max), 0.0)
    slack = 0.71 * grid.resolution
    padded = np.pad(grid.clearance + slack >= radius, ((0, -rows % stride), (0, -columns % stride)))
    shape = (padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    open_cells = np.any(padded.reshape(shape), axis=(1, 3))
    cells = np.floor(grid.to_cells(points) / stride).astype(int)
    index = cells[:, 1] * open_cells.shape[1] + cells[:, 0]
    spacing = stride * grid.resolution
    ways = dijkstra(_graph(open_cells), directed=False, indices=index)[:, index] * spacing
    straight = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return np.asarray(np.maximum(_OCTILE * ways - 2 * np.sqrt(2) * spacing, straight))


def _graph(free: np.ndarray) -> csr_array:
    """Join open cells that touch, corners included; lengths in cells."""
    rows, columns = free.shape
    # older releases of SciPy want 32 bits; there are no more than `_CELLS` cells
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    start, end, length = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(max(-dc, 0), columns - max(dc, 0)))
        b = (slice(dr, rows), slice(max(dc, 0), columns - max(-dc, 0)))
        both = free[a] & free[b]
        start.append(number[a][both])
        end.append(number[b][both])
        length.append(np.full(int(both.sum()), np.hypot(dr, dc)))
    pairs = (np.concatenate(start), np.concatenate(end))
    return csr_array((np.concatenate(length), pairs), shape=(rows * columns,) * 2)
