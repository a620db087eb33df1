"""What no path can cost less than.

Two bounds hold for every path, and the greater one counts (docs/theory, section 5): the least cost
without obstacles, which steering knows exactly, and the least cost of a disc inside the footprint
that pays for metres and radians apart. The second is sought over the corners of the obstacles; why
it is a bound is derived in docs/planning.md.
"""

from __future__ import annotations

from math import cos, pi, sqrt
from typing import NamedTuple
from weakref import WeakKeyDictionary

import contourpy
import numpy as np
import shapely

from energyplan.path import FloatArray
from energyplan.planning.bound.corners import Rates, least_over_corners
from energyplan.planning.bound.sight import Corners
from energyplan.planning.bound.surface_excess import least_excess
from energyplan.planning.scene.compiled import MARGIN, CompiledProblem
from energyplan.planning.scene.guide import inscribed
from energyplan.planning.scene.motions import KernelProblem, free_energy
from energyplan.terrain import OccupancyGrid
from energyplan.terrain.collision import Body

MOST_RUNS = 6000
"""Runs of blocked cells up to which obstacles are grown as polygons, in less than a second."""

EFFORT = 5e7
"""Steps of the search over corners after which what is known by then is taken: below 0.1 s."""

MOST_CORNERS = 4000
"""Corners near the way above which a coarser outline is taken, or only the bound in the open."""


class Detail(NamedTuple):
    """How finely obstacles are drawn.

    Attributes
    ----------
    arc : int
        Chords of a quarter circle.
    slack : float
        Largest distance by which an outline is simplified, in radii of the disc.
    """

    arc: int
    slack: float


DETAILS = (Detail(8, 0.01), Detail(4, 0.03))
"""The finer outline closes gaps that the disc does not pass, the coarser one has fewer corners."""


_outlines: WeakKeyDictionary[OccupancyGrid, dict[tuple[float, Detail], Corners]]
_outlines = WeakKeyDictionary()


class _Rings(NamedTuple):
    """Closed outlines in cells, with the obstacle on their right.

    `low` and `high` bound the distance from the obstacles at which they run [m].
    """

    rings: list[FloatArray]
    low: float
    high: float


def _grown(grid: OccupancyGrid, radius: float, arc: int) -> _Rings | None:
    """Return the outlines of the blocked cells grown by `radius`; None where there are too many.

    Round corners are drawn as polygons inside them.
    """
    change = np.diff(np.pad(grid.blocked, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    if len(row) > MOST_RUNS:
        return None
    boxes = shapely.box(first, row, last, row + 1)
    area = shapely.union_all(shapely.buffer(boxes, radius / grid.resolution, quad_segs=arc))
    rings = []
    for polygon in shapely.get_parts(area):
        for k, ring in enumerate(shapely.get_rings(polygon)):
            points = shapely.get_coordinates(ring)
            rings.append(points[::-1] if shapely.is_ccw(ring) == (k == 0) else points)
    return _Rings(rings, radius * cos(0.25 * pi / arc), radius)


def _level_set(grid: OccupancyGrid, radius: float) -> _Rings:
    """Return a level set of the clearance that lies within the blocked cells grown by `radius`.

    The clearance between the cells' centres is interpolated. That is off by half a cell's diagonal
    at most, since clearance changes by no more than the distance, and the level is lower by that.
    """
    rows, columns = grid.shape
    error = grid.resolution * sqrt(0.5)
    if radius <= error:
        return _Rings([], 0.0, 0.0)
    x, y = (np.arange(n) + 0.5 for n in (columns, rows))
    lines = contourpy.contour_generator(x, y, grid.clearance).lines(radius - error)
    return _Rings([np.asarray(line) for line in lines], radius - 2.0 * error, radius)


def outline(grid: OccupancyGrid, radius: float, detail: Detail = DETAILS[0]) -> Corners:
    """Return an outline that lies within the obstacles grown by `radius`, and its convex corners.

    It is simplified, which moves it by at most a tolerance, so the obstacles grow by that less.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    radius : float
        Radius of the disc [m].
    detail : Detail
        How finely to draw it.

    Returns
    -------
    Corners
        The corners and edges, in the world.
    """
    known = _outlines.setdefault(grid, {})
    if (radius, detail) in known:
        return known[radius, detail]
    tolerance = detail.slack * radius
    drawn = _grown(grid, radius - tolerance, detail.arc) or _level_set(grid, radius - tolerance)
    point, before, after = [np.empty((0, 2))], [np.empty((0, 2))], [np.empty((0, 2))]
    first, last = [np.empty((0, 2))], [np.empty((0, 2))]
    for ring in drawn.rings:
        simple = shapely.simplify(shapely.LineString(ring), tolerance / grid.resolution)
        corner = shapely.get_coordinates(simple)
        first.append(corner[:-1])
        last.append(corner[1:])
        if np.all(corner[0] == corner[-1]):
            corner = np.concatenate([corner[-2:-1], corner])
        (x1, y1), (x2, y2) = np.diff(corner[:-1], axis=0).T, np.diff(corner[1:], axis=0).T
        convex = x1 * y2 - y1 * x2 < 0
        point.append(corner[1:-1][convex])
        before.append(corner[:-2][convex])
        after.append(corner[2:][convex])

    def world(parts: list[FloatArray]) -> FloatArray:
        return grid.to_world(np.concatenate(parts))

    found = Corners(
        world(point),
        world(before),
        world(after),
        np.hstack([world(first), world(last)]),
        max(drawn.low - tolerance, 0.0),
        drawn.high + tolerance,
    )
    known[radius, detail] = found
    return found


class Bound(NamedTuple):
    """What a path costs at least, and whether more effort or a better path cannot raise it."""

    value: float
    final: bool


def lower_bound(query: CompiledProblem, cost: float, effort: float = EFFORT) -> Bound:
    """Return a lower bound on the cost of every path from start to goal.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    cost : float
        Cost of a path that is known: the bound need not be better.
    effort : float
        Steps, of about 2 ns each, after which to take what is known by then.

    Returns
    -------
    Bound
        The bound.
    """
    setting = query.setting
    free = float(free_energy(setting, setting.start_x, setting.start_y, setting.start_yaw))
    radius = inscribed(setting) - MARGIN * query.grid.resolution
    if free >= cost or radius <= 0:
        return Bound(free, True)
    excess = least_excess(query, radius, cost)
    if free >= cost - excess:
        return Bound(max(free, cost), True)
    among, final = _among_obstacles(query.grid, setting, radius, free, cost - excess, effort)
    return Bound(max(free, among + excess), final)


def _among_obstacles(
    grid: OccupancyGrid,
    setting: KernelProblem,
    radius: float,
    free: float,
    cost: float,
    effort: float,
) -> Bound:
    ends = np.array([(setting.start_x, setting.start_y), (setting.goal_x, setting.goal_y)])
    for detail in DETAILS:
        found = outline(grid, radius, detail)
        # corners by which the way alone costs more than the path that is known
        way = sum(np.hypot(*(found.point - end).T) for end in ends)
        near = setting.least_metre * way < cost
        if near.sum() <= MOST_CORNERS:
            break
    else:
        return Bound(free, False)
    corners = found._replace(
        point=np.concatenate([found.point[near], ends]),
        before=np.concatenate([found.before[near], ends]),
        after=np.concatenate([found.after[near], ends]),
    )
    rates = Rates(
        setting.least_metre, setting.least_radian, setting.start_yaw, setting.goal_yaw, free
    )
    body, margin = setting.body, MARGIN * grid.resolution
    true_body = Body(
        body.x_min + margin, body.y_min + margin, body.x_max - margin, body.y_max - margin
    )
    value, final = least_over_corners(setting.space, true_body, corners, rates, cost, effort)
    return Bound(float(value), bool(final))
