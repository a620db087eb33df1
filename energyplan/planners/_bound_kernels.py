"""Kernels of the lower bound: a search over the corners of the obstacles (docs/planning.md)."""

from __future__ import annotations

from math import atan2, floor, hypot, inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan._numba import njit
from energyplan.maps._collision import Space
from energyplan.planners._field_kernels import angle_between, pop, push


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

    point: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    edges: NDArray[np.float64]
    inside: float
    outside: float


class Rates(NamedTuple):
    """Costs of the relaxed problem.

    Attributes
    ----------
    metre, radian : float
        Cost per metre driven and per radian turned.
    start, goal : float
        Headings.
    direct : float
        Least cost from start to goal without obstacles.
    """

    metre: float
    radian: float
    start: float
    goal: float
    direct: float


@njit
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
        dx = ax + at * ux - space.x
        dy = ay + at * uy - space.y
        across = (space.cos * dx + space.sin * dy) / res
        along = (-space.sin * dx + space.cos * dy) / res
        column = floor(across)
        row = floor(along)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            sure = False
            at += 0.5 * res
            continue
        off = hypot(across - column - 0.5, along - row - 0.5) * res
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


@njit
def _side(corners: Corners, k: int, ux: float, uy: float) -> int:
    """Side of a line through a corner on which the obstacle lies: 1 left, -1 right, 0 both."""
    x = corners.point[k, 0]
    y = corners.point[k, 1]
    one = ux * (corners.before[k, 1] - y) - uy * (corners.before[k, 0] - x)
    two = ux * (corners.after[k, 1] - y) - uy * (corners.after[k, 0] - x)
    tiny = 1e-9
    if one >= -tiny and two >= -tiny:
        return 1
    if one <= tiny and two <= tiny:
        return -1
    return 0


@njit
def least_over_corners(
    space: Space, corners: Corners, rates: Rates, limit: float, most: int, effort: float
) -> float:
    """Return a lower bound on the cost of going from corner to corner, at most `limit`.

    A* over labels (corner, line it was reached by, heading of the last long line). A way turns at
    a corner only around the obstacle there. A line shorter than twice ``radian / metre`` is
    charged for its length alone: on so short a line it can pay to avoid its heading by reversing.

    Parameters
    ----------
    space : Space
        Obstacles.
    corners : Corners
        Corners, start and goal.
    rates : Rates
        Costs.
    limit : float
        Costs at or above are of no interest.
    most : int
        Number of labels at which to stop with what is known by then.
    effort : float
        Number of steps, of tens of nanoseconds each, at which to stop likewise.
    """
    n = len(corners.point)
    start = n - 2
    goal = n - 1
    gx = corners.point[goal, 0]
    gy = corners.point[goal, 1]
    short = 2.0 * rates.radian / rates.metre
    seen = np.zeros((n, n), np.uint8)
    capacity = most + 2 * n + 8
    at = np.empty(capacity, np.int32)
    heading = np.empty(capacity)
    cost = np.empty(capacity)
    older = np.empty(capacity, np.int32)
    side = np.zeros(capacity, np.int8)
    way_x = np.zeros(capacity)
    way_y = np.zeros(capacity)
    newest = np.full(n, -1, np.int32)
    heap_f = np.empty(capacity)
    heap_node = np.empty(capacity, np.int32)
    at[0] = start
    heading[0] = rates.start
    cost[0] = 0.0
    older[0] = -1
    newest[start] = 0
    count = 1
    work = 0
    first = rates.metre * hypot(gx - corners.point[start, 0], gy - corners.point[start, 1])
    size = push(heap_f, heap_node, 0, first, 0)
    while size > 0:
        f = heap_f[0]
        label = int(heap_node[0])
        size = pop(heap_f, heap_node, size)
        if f >= limit:
            return limit
        u = int(at[label])
        if u == goal or count >= most or work > effort:
            return float(f)
        if cost[label] == inf:
            continue
        g = cost[label]
        h = heading[label]
        work += n
        for v in range(n):
            if v == start:
                continue
            dx = corners.point[v, 0] - corners.point[u, 0]
            dy = corners.point[v, 1] - corners.point[u, 1]
            length = hypot(dx, dy)
            if length < 1e-12:  # the corner itself, too
                continue
            rest = hypot(gx - corners.point[v, 0], gy - corners.point[v, 1])
            if g + rates.metre * (length + rest) >= limit or seen[u, v] == 2:
                continue
            if seen[u, v] == 0:
                good = (
                    (u == start or _side(corners, u, dx, dy) != 0)
                    and (v == goal or _side(corners, v, dx, dy) != 0)
                    and line_open(
                        space,
                        corners,
                        corners.point[u, 0],
                        corners.point[u, 1],
                        corners.point[v, 0],
                        corners.point[v, 1],
                    )
                )
                work += 20 + len(corners.edges) // 8
                seen[u, v] = 1 if good else 2
                seen[v, u] = seen[u, v]
                if not good:
                    continue
            ux = dx / length
            uy = dy / length
            if u != start:
                about = int(side[label])
                turned = way_x[label] * uy - way_y[label] * ux
                if _side(corners, u, dx, dy) != about or turned * about < -1e-9:
                    continue
            there = 0 if v == goal else _side(corners, v, dx, dy)
            psi = atan2(dy, dx)
            for way in range(1 if length < short else 2):
                then = h if length < short else psi + way * pi
                gg = g + rates.metre * length + rates.radian * angle_between(h, then)
                ff = gg + rates.metre * rest + rates.radian * angle_between(then, rates.goal)
                if v == goal:
                    if u == start:
                        ff = rates.direct
                    gg = ff
                if ff >= limit:
                    continue
                worse = False
                other = newest[v]
                while other >= 0:
                    gap = rates.radian * angle_between(heading[other], then)
                    # positive where this line is turned further around the obstacle
                    turned = (way_x[other] * uy - way_y[other] * ux) * there
                    if v == goal:
                        gap = 0.0
                    if v == goal or side[other] == there:
                        if cost[other] + gap <= gg + 1e-9 and turned >= -1e-9:
                            worse = True
                            break
                        if gg + gap <= cost[other] and turned <= 1e-9:
                            cost[other] = inf
                    other = older[other]
                if worse:
                    continue
                if count >= capacity - 2 or size >= capacity - 2:
                    return float(f)
                at[count] = v
                heading[count] = then
                cost[count] = gg
                side[count] = there
                way_x[count] = ux
                way_y[count] = uy
                older[count] = newest[v]
                newest[v] = count
                size = push(heap_f, heap_node, size, max(ff, f), count)
                count += 1
    return limit
