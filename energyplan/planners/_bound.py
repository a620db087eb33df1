"""What no path can cost less than.

Two bounds hold for every path, and the greater one counts (docs/theory, section 5): the least cost
without obstacles, which steering knows exactly, and the least cost of a disc inside the footprint
that pays for metres and radians apart. The second is sought over the corners of the obstacles; why
it is a bound is derived in docs/planning.md.
"""

from __future__ import annotations

from math import sqrt
from weakref import WeakKeyDictionary

import contourpy
import numpy as np
import shapely

from energyplan import _distance
from energyplan.maps import OccupancyGrid
from energyplan.path import FloatArray
from energyplan.planners._bound_kernels import Corners, Rates, least_over_corners
from energyplan.planners._motion_kernels import Setting, free_energy
from energyplan.planners._query import MARGIN, Query
from energyplan.planners._search import inscribed

LABELS = 200_000
"""Labels at which the search over corners stops with what is known by then."""

FINE_CELLS = 1e6
"""Smaller maps are divided more finely before outlines are drawn."""

SLACK = 0.05
"""Largest distance by which an outline is simplified, in radii of the disc."""


_outlines: WeakKeyDictionary[OccupancyGrid, tuple[float, Corners]] = WeakKeyDictionary()


def outline(grid: OccupancyGrid, radius: float) -> Corners:
    """Return an outline that lies within the obstacles grown by `radius`, and its convex corners.

    The level set of the interpolated clearance lies within the grown obstacles when the level is
    lower than `radius` by the interpolation's error, at most half a cell's diagonal since
    clearance changes by no more than the distance. Simplifying it moves it by at most the
    tolerance, so that comes off the level as well.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    radius : float
        Radius of the disc [m].

    Returns
    -------
    Corners
        The corners and edges, in the world.
    """
    known = _outlines.get(grid)
    if known is not None and known[0] == radius:
        return known[1]
    rows, columns = grid.shape
    factor = max(min(int(sqrt(FINE_CELLS / (rows * columns))), 4), 1)
    cell = grid.resolution / factor
    clearance = grid.clearance
    if factor > 1:
        fine = np.repeat(np.repeat(grid.blocked, factor, axis=0), factor, axis=1)
        clearance = _distance.clearance(fine) * np.float32(cell)
    half = cell * sqrt(0.5)
    tolerance = SLACK * radius
    level = radius - half - tolerance
    point, before, after = [np.empty((0, 2))], [np.empty((0, 2))], [np.empty((0, 2))]
    first, last = [np.empty((0, 2))], [np.empty((0, 2))]
    if level > 0:
        x, y = (np.arange(n * factor) + 0.5 for n in (columns, rows))
        for line in contourpy.contour_generator(x, y, clearance).lines(level):
            simple = shapely.simplify(shapely.LineString(np.asarray(line)), tolerance / cell)
            corner = shapely.get_coordinates(simple)
            first.append(corner[:-1])
            last.append(corner[1:])
            if np.all(corner[0] == corner[-1]):
                corner = np.concatenate([corner[-2:-1], corner])
            (x1, y1), (x2, y2) = np.diff(corner[:-1], axis=0).T, np.diff(corner[1:], axis=0).T
            # the clearance is higher on the outline's left, so obstacles' convex corners turn right
            convex = x1 * y2 - y1 * x2 < 0
            point.append(corner[1:-1][convex])
            before.append(corner[:-2][convex])
            after.append(corner[2:][convex])

    def world(parts: list[FloatArray]) -> FloatArray:
        return grid.to_world(np.concatenate(parts) / factor)

    found = Corners(
        world(point),
        world(before),
        world(after),
        np.hstack([world(first), world(last)]),
        max(level - half - tolerance, 0.0),
        level + half + tolerance,
    )
    _outlines[grid] = radius, found
    return found


def lower_bound(query: Query, cost: float) -> float:
    """Return a lower bound on the cost of every path from start to goal.

    Parameters
    ----------
    query : Query
        The problem.
    cost : float
        Cost of a path that is known: the bound need not be better.

    Returns
    -------
    float
        The bound.
    """
    setting = query.setting
    free = free_energy(setting, setting.start_x, setting.start_y, setting.start_yaw)
    if free >= cost:
        return float(free)
    return max(float(free), _among_obstacles(query.grid, setting, float(free), cost))


def _among_obstacles(grid: OccupancyGrid, setting: Setting, free: float, cost: float) -> float:
    radius = inscribed(setting) - MARGIN * grid.resolution
    if radius <= 0:
        return 0.0
    found = outline(grid, radius)
    ends = np.array([(setting.start_x, setting.start_y), (setting.goal_x, setting.goal_y)])
    # corners by which the way alone costs more than the path that is known
    way = sum(np.hypot(*(found.point - end).T) for end in ends)
    near = setting.least_metre * way < cost
    corners = found._replace(
        point=np.concatenate([found.point[near], ends]),
        before=np.concatenate([found.before[near], ends]),
        after=np.concatenate([found.after[near], ends]),
    )
    rates = Rates(
        setting.least_metre, setting.least_radian, setting.start_yaw, setting.goal_yaw, free
    )
    return float(least_over_corners(setting.space, corners, rates, cost, LABELS))
