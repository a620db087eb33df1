"""What no path can cost less than.

Two bounds hold for every path, and the greater one counts (docs/theory, section 5): the least cost
without obstacles, which steering knows exactly, and the least cost of a disc inside the footprint
that pays for metres and radians apart. The second is sought over the corners of the obstacles; why
it is a bound is derived in docs/planning.md.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple
from weakref import WeakKeyDictionary

import contourpy
import numpy as np
import shapely

from energyplan.maps import OccupancyGrid
from energyplan.path import FloatArray
from energyplan.planners._bound_kernels import Corners, Rates, least_over_corners
from energyplan.planners._motion_kernels import Setting, free_energy
from energyplan.planners._query import MARGIN, Query
from energyplan.planners._search import inscribed

LABELS = 200_000
"""Labels at which the search over corners stops with what is known by then."""

SLACK = 0.1
"""Largest distance by which an outline is simplified, in radii of the disc."""


class Outline(NamedTuple):
    """Convex corners of all obstacles grown by a disc, each with its neighbours [m]."""

    point: FloatArray
    before: FloatArray
    after: FloatArray
    blocked_within: float


_outlines: WeakKeyDictionary[OccupancyGrid, tuple[float, Outline]] = WeakKeyDictionary()


def outline(grid: OccupancyGrid, radius: float) -> Outline:
    """Return the convex corners of obstacles that lie within those grown by `radius`.

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
    Outline
        The corners. A point within `blocked_within` of an obstacle lies inside the outline.
    """
    known = _outlines.get(grid)
    if known is not None and known[0] == radius:
        return known[1]
    half = grid.resolution * sqrt(0.5)
    tolerance = SLACK * radius
    level = radius - half - tolerance
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    if level > 0:
        rows, columns = grid.shape
        generator = contourpy.contour_generator(
            np.arange(columns) + 0.5, np.arange(rows) + 0.5, np.asarray(grid.clearance, float)
        )
        for line in generator.lines(level):
            points = np.asarray(line)
            parts.append(_convex(points, bool(np.all(points[0] == points[-1])), grid, tolerance))
    point, before, after = (
        (np.concatenate([p[k] for p in parts]) if parts else np.empty((0, 2))) for k in range(3)
    )
    # a corner of the simplified outline is the level set's own, so this near is always inside
    found = Outline(
        grid.to_world(point),
        grid.to_world(before),
        grid.to_world(after),
        max(level - half - tolerance, 0.0),
    )
    _outlines[grid] = radius, found
    return found


def _convex(
    points: FloatArray, closed: bool, grid: OccupancyGrid, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the convex corners of one outline, in cells, and their neighbours."""
    line = shapely.linestrings(points)
    simple = shapely.get_coordinates(shapely.simplify(line, tolerance / grid.resolution))
    if closed:
        ring = simple[:-1]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    else:
        ring, before, after = simple[1:-1], simple[:-2], simple[2:]
    if len(ring) == 0:
        return ring, before, after
    (x1, y1), (x2, y2) = (ring - before).T, (after - ring).T
    turn = x1 * y2 - y1 * x2
    # the clearance is higher on the outline's left, so an obstacle's convex corner turns right
    convex = turn < 0
    return ring[convex], before[convex], after[convex]


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
    corners = Corners(
        np.concatenate([found.point[near], ends]),
        np.concatenate([found.before[near], ends]),
        np.concatenate([found.after[near], ends]),
    )
    rates = Rates(
        setting.least_metre,
        setting.least_radian,
        setting.start_yaw,
        setting.goal_yaw,
        free,
        found.blocked_within,
    )
    return float(least_over_corners(setting.space, corners, rates, cost, LABELS))
