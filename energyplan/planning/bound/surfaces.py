"""What expensive surfaces add to a lower bound that prices each metre as on the cheapest one.

Every cost is the sum of two parts: that on the cheapest surface everywhere, and the excess, which
is paid by the metre where the ground is more expensive. The least sum is no less than the sum of
the least parts; the second of them is found here.
"""

from __future__ import annotations

from math import ceil, hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import FlagTable, FloatTable, njit
from energyplan.path import FloatArray
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.prices import remembered
from energyplan.planning.space.queues import no_open, pop, push, with_room
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.terrain.surfaces import NOT_SLOW, SlowAreas

MOST_CELLS = 250_000  # cells above which they are joined to larger ones
CLEARANCE_ERROR = 1e-3  # far above what rounding makes of a clearance [cells]


def least_excess(query: CompiledProblem, radius: float, limit: float, around: float = 0.0) -> float:
    """Return a lower bound on what expensive surfaces add on every path to `around` the goal."""
    surfaces = query.problem.surfaces
    if surfaces is None:
        return 0.0
    excess = query.least_prices.metre_excess()
    return _least_sum(query, surfaces, excess, radius, limit, around)


def least_of_metres(
    query: CompiledProblem, radius: float, limit: float, around: float = 0.0
) -> float:
    """Return a lower bound on what the metres of every path cost, if turning costs nothing.

    A robot that a speed limit slows down turns at no cost in time, so that where radians are paid
    for, an area with a limit may add nothing to them.
    """
    surfaces = query.problem.surfaces
    if surfaces is None or not query.objective.slow.areas:
        return 0.0
    prices, setting = query.least_prices.metre_prices(0.0), query.setting
    straight = hypot(setting.goal.x - setting.start.x, setting.goal.y - setting.start.y)
    straight = max(straight - around, 0.0)
    least = float(prices.min())
    left = limit - least * straight
    excess = _least_sum(query, surfaces, prices - least, radius, left, around)
    return least * straight + excess


def _least_sum(
    query: CompiledProblem, surfaces: SurfaceMap, excess: FloatArray, radius: float, limit: float,
    around: float,
) -> float:  # fmt: skip
    """Return the least sum of an excess of each metre by class of ground."""
    if excess.max() <= 1e-9 * query.least.metre:
        return 0.0
    from scipy import ndimage  # slow to import, and rarely needed

    grid = query.grid
    per_metre = np.append(excess, 0.0)[certain_regions(query, surfaces)]
    # clearance of a cell's centre [m]; a point of the cell has up to half a diagonal more
    clearance = grid.space.clearance * grid.resolution + sqrt(0.5) * grid.resolution
    clear = clearance >= radius
    # the reference point lies within the disc: what its ground would cost at an edge of a surface
    # that runs along a wall, or along the map's edge, is of no matter
    lateral = abs(query.middle[1])
    per_metre[clearance < radius - lateral - CLEARANCE_ERROR * grid.resolution] = np.inf
    factor = max(ceil(sqrt(per_metre.size / MOST_CELLS)), 1)
    per_metre = _blocks(per_metre, factor, np.inf).min(axis=(1, 3))
    passable = np.asarray(_blocks(clear, factor, False).any(axis=(1, 3)))
    size = factor * grid.resolution
    # the ground lies under the reference point, the cells are those of the treads' centre
    reach = 1 + ceil(lateral / size)
    least = ndimage.minimum_filter(per_metre, 2 * reach + 1, mode="nearest")
    setting = query.setting
    ends = [setting.start[:2], setting.goal[:2]]
    columns, rows = (grid.to_cells(ends) / factor).astype(int).T
    return float(
        least_steps(
            size * least, passable, rows[0], columns[0], rows[1], columns[1], limit, around / size
        )
    )


def _blocks(cells: NDArray[np.generic], factor: int, fill: float) -> NDArray[np.generic]:
    """Return cells by blocks of `factor` a side, shape (rows, factor, columns, factor)."""
    rows, columns = (-(-n // factor) for n in cells.shape)
    pads = [(0, rows * factor - cells.shape[0]), (0, columns * factor - cells.shape[1])]
    padded = np.pad(cells, pads, constant_values=fill)
    return padded.reshape(rows, factor, columns, factor)


def certain_regions(query: CompiledProblem, surfaces: SurfaceMap) -> NDArray[np.intp]:
    """Return the class of each cell that lies in one as a whole, -1 for those near an edge."""
    grid = query.grid

    slow = query.objective.slow

    def make() -> NDArray[np.intp]:
        if slow.areas:
            return _certain_regions(surfaces, grid, surfaces.raster(grid, slow=slow), slow)
        region = np.broadcast_to(query.terrain.regions, grid.shape)
        return _certain_regions(surfaces, grid, region)

    return remembered(grid, surfaces, ("certain regions", slow.key), make)


def _certain_regions(
    surfaces: SurfaceMap,
    grid: OccupancyGrid,
    region: NDArray[np.integer],
    slow: SlowAreas = NOT_SLOW,
) -> NDArray[np.intp]:
    crossed = np.zeros(grid.shape, bool)
    for points in surfaces.edge_points(0.4 * grid.resolution, slow):
        at = grid.to_cells(points)
        # all that lies on an edge is within a fifth of a cell of one of these points
        for aside in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
            column, row = np.floor(at + aside).astype(int).T
            inside = (row >= 0) & (column >= 0) & (row < grid.shape[0]) & (column < grid.shape[1])
            crossed[row[inside], column[inside]] = True
    return np.where(crossed, -1, region.astype(np.intp))


@njit
def least_steps(
    step: FloatTable,
    passable: FlagTable,
    row: int,
    column: int,
    goal_row: int,
    goal_column: int,
    limit: float,
    around: float,
) -> float:
    """Return the least sum of steps from a cell to the neighbourhood of a disc about another.

    Follow a way, and mark a place each time that it has gone as far as a cell is wide, along either
    axis, from the last one. From one to the next it stays within the cell of the first and the
    eight around it, and the next lies in one of these. So the marks make a chain over the cells,
    diagonals included, and the way pays at least the width of a cell times the least price in
    this neighbourhood, which is what `step` holds. The radius of the disc is in cells.
    """
    rows, columns = step.shape
    reached = np.empty((rows, columns))
    for r in range(rows):
        for c in range(columns):
            reached[r, c] = np.inf
    queue = no_open(1 << 12)
    reached[row, column] = 0.0
    push(queue, 0.0, row * columns + column)
    while queue.size[0] > 0:
        sum_so_far = queue.f[0]
        node = pop(queue)
        r = node // columns
        c = node % columns
        if sum_so_far >= limit:
            break
        if hypot(max(abs(r - goal_row) - 1, 0), max(abs(c - goal_column) - 1, 0)) <= around:
            return float(sum_so_far)
        if sum_so_far > reached[r, c]:
            continue
        there = sum_so_far + step[r, c]
        for rr in range(max(r - 1, 0), min(r + 2, rows)):
            for cc in range(max(c - 1, 0), min(c + 2, columns)):
                if not passable[rr, cc] or there >= reached[rr, cc]:
                    continue
                reached[rr, cc] = there
                queue = with_room(queue)
                push(queue, there, rr * columns + cc)
    return limit
