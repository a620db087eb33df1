"""The outline of the obstacles as the bound's kernels see it, and what is seen from its corners."""

from __future__ import annotations

from math import floor, hypot
from typing import NamedTuple

from energyplan.compilation import inner
from energyplan.compilation.arrays import FloatTable
from energyplan.terrain.collision import Space, in_cells


class Corners(NamedTuple):
    """Convex corners of the obstacles, grown by less than the inscribed disc.

    Attributes
    ----------
    point : ndarray, shape (n, 2)
        The corners; the last two are start and goal.
    before, after : ndarray, shape (n, 2)
        Neighbouring corners along the outline; for start and goal their own place.
    edges : ndarray, shape (m, 4)
        All edges of the outline: both ends.
    inside, outside : float
        Nearer to an obstacle than `inside` a point lies within the outline for certain, further
        than `outside` it lies outside for certain [m].
    """

    point: FloatTable
    before: FloatTable
    after: FloatTable
    edges: FloatTable
    inside: float
    outside: float


@inner
def line_open(space: Space, corners: Corners, ax: float, ay: float, bx: float, by: float) -> bool:
    """Tell whether a line between corners crosses no edge of the outline.

    Clearance decides most lines; the others are tested against the edges. Touching is no crossing.
    """
    rows, columns = space.clearance.shape
    length = hypot(bx - ax, by - ay)
    res = space.resolution
    if length == 0.0:
        return True
    ux = (bx - ax) / length
    uy = (by - ay) / length
    at = 0.0
    sure = True
    while at < length:
        here = in_cells(space, ax + at * ux, ay + at * uy)
        column = floor(here.column)
        row = floor(here.row)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            sure = False
            at += 0.5 * res
            continue
        off = hypot(here.column - column - 0.5, here.row - row - 0.5) * res
        near = float(space.clearance[row, column]) * res
        if near + off < corners.inside:
            return False
        if near - off <= corners.outside:
            sure = False
        at += max(near - off - corners.outside, 0.5 * res)
    if sure:
        return True
    left = min(ax, bx)
    right = max(ax, bx)
    low = min(ay, by)
    high = max(ay, by)
    for k in range(len(corners.edges)):
        px = corners.edges[k, 0]
        py = corners.edges[k, 1]
        qx = corners.edges[k, 2]
        qy = corners.edges[k, 3]
        if max(px, qx) < left or min(px, qx) > right or max(py, qy) < low or min(py, qy) > high:
            continue
        p_side = ux * (py - ay) - uy * (px - ax)
        q_side = ux * (qy - ay) - uy * (qx - ax)
        if not (p_side * q_side < 0.0 and min(abs(p_side), abs(q_side)) > 1e-9):
            continue
        a_side = (qx - px) * (ay - py) - (qy - py) * (ax - px)
        b_side = (qx - px) * (by - py) - (qy - py) * (bx - px)
        if a_side * b_side < 0.0 and min(abs(a_side), abs(b_side)) > 1e-9:
            return False
    return True
