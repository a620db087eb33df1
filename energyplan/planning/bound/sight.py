"""The outline of the obstacles as the bound's kernels see it, and what is seen from its corners."""

from __future__ import annotations

from math import asin, atan2, ceil, floor, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, ShortInts, njit
from energyplan.planning.scene.field import longer_ints, pop, push, with_room
from energyplan.terrain.collision import Space, in_cells
from energyplan.terrain.updates import Window

BUCKET = 8
"""Side of the squares by which edges are looked up [cells]."""

DIRECTIONS = 512
"""Directions by which it is noted how far one sees."""

TINY = 1e-9
"""Distance by which a line may miss a corner and still touch it [m]."""


class Outline(NamedTuple):
    """Outline of the obstacles, grown by less than the inscribed disc, and its convex corners."""

    point: FloatTable  # (n, 2): the corners
    before: FloatTable  # (n, 2): neighbouring corners along the outline
    after: FloatTable  # (n, 2): neighbouring corners along the outline
    edges: FloatTable  # (m, 4): all edges, and lines across gaps that the disc does not pass
    first: ShortInts  # (squares + 1,)
    listed: ShortInts  # edges by square
    inside: float  # [m]
    outside: float  # [m]


class Squares(NamedTuple):
    """The edges by square, as in `Outline`."""

    first: ShortInts
    listed: ShortInts


class Links(NamedTuple):
    """Corners that see each other, so that a taut way may bend at both; found when needed."""

    first: ShortInts  # (n,): where the corners that are seen from each begin in `seen`
    number: ShortInts  # (n,): how many there are
    steps: Floats  # (n,): what it takes to find them, in steps
    seen: ShortInts  # corners that are seen
    used: Ints  # (1,): how many are used


def no_links(corners: int) -> Links:
    """Return links of which nothing is known yet."""
    return Links(
        np.full(corners, -1, np.int32),
        np.zeros(corners, np.int32),
        np.zeros(corners),
        np.zeros(1 << 12, np.int32),
        np.zeros(1, np.int64),
    )


@njit
def _square(place: float, cells: int) -> int:
    """Row or column of the square at a place [cells], the nearest one outside the map."""
    return min(max(floor(place / BUCKET), 0), (cells - 1) // BUCKET)


@njit
def squares_of_edges(space: Space, edges: FloatTable) -> Squares:
    """List the edges by the squares that they may touch, a cell's width included."""
    rows, columns = space.clearance.shape
    across = (columns - 1) // BUCKET + 1
    total = ((rows - 1) // BUCKET + 1) * across
    first = np.empty(total + 1, np.int32)
    for k in range(total + 1):
        first[k] = 0
    listed = np.empty(0, np.int32)
    for filling in range(2):
        for k in range(len(edges)):
            a = in_cells(space, edges[k, 0], edges[k, 1])
            b = in_cells(space, edges[k, 2], edges[k, 3])
            low = _square(min(a.row, b.row) - 1.0, rows)
            high = _square(max(a.row, b.row) + 1.0, rows)
            left = _square(min(a.column, b.column) - 1.0, columns)
            right = _square(max(a.column, b.column) + 1.0, columns)
            for row in range(low, high + 1):
                for column in range(left, right + 1):
                    square = row * across + column
                    if filling == 1:
                        listed[first[square]] = k
                    first[square] += 1
        if filling == 0:
            # counts become ends; filling from behind would reverse them, so starts are kept
            begin = 0
            for k in range(total):
                count = int(first[k])
                first[k] = begin
                begin += count
            first[total] = begin
            listed = np.empty(begin, np.int32)
    for k in range(total, 0, -1):
        first[k] = first[k - 1]
    first[0] = 0
    return Squares(first, listed)


@njit
def gaps(space: Space, radius: float, inside: float, window: Window) -> FloatTable:
    """Return lines across the gaps that a disc does not pass, where the outline is open.

    A disc's centre cannot cross a line between two points of obstacles that is shorter than its
    diameter: it would come nearer to one of them than its radius. Which lines are drawn is a matter
    of use only: at each cell on a ridge of the clearance one from the nearest blocked cell to the
    one nearest to it on the other side.
    """
    rows, columns = space.clearance.shape
    res = space.resolution
    low = inside / res - 1.0
    high = radius / res + 0.75
    reach = int(radius / res) + 2
    out = np.empty((64, 4))
    count = 0
    for row in range(max(window.first_row, 1), min(window.end_row, rows - 1)):
        for column in range(max(window.first_column, 1), min(window.end_column, columns - 1)):
            near = space.clearance[row, column]
            if not low < near < high:
                continue
            ridge = False
            for k in range(4):
                r = 1 if k > 0 else 0
                c = 1 if k == 0 else k - 2
                one = space.clearance[row + r, column + c]
                two = space.clearance[row - r, column - c]
                ridge = ridge or (near >= one and near >= two and (near > one or near > two))
            if not ridge:
                continue
            # the nearest blocked cell, then the one nearest to it on the other side
            best = inf
            pr = -1
            pc = -1
            for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
                c = space.next_blocked[r, max(column - reach, 0)]
                while c <= min(column + reach, columns - 1):
                    far = hypot(r - row, c - column)
                    if far < best:
                        best = far
                        pr = r
                        pc = c
                    c = space.next_blocked[r, c + 1]
            if pr < 0:
                continue
            best = 2.0 * radius / res - TINY
            qr = -1
            qc = -1
            for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
                c = space.next_blocked[r, max(column - reach, 0)]
                while c <= min(column + reach, columns - 1):
                    if (r - row) * (pr - row) + (c - column) * (pc - column) < 0:
                        far = hypot(max(abs(r - pr) - 1, 0), max(abs(c - pc) - 1, 0))
                        if far < best:
                            best = far
                            qr = r
                            qc = c
                    c = space.next_blocked[r, c + 1]
            if qr < 0:
                continue
            if count == len(out):
                fewer = out
                out = np.empty((2 * count, 4))
                for k in range(count):
                    for i in range(4):
                        out[k, i] = fewer[k, i]
            # the nearest points of the two cells
            out[count, 0] = pc + 0.5 if pc == qc else (pc + 1.0 if qc > pc else float(pc))
            out[count, 1] = pr + 0.5 if pr == qr else (pr + 1.0 if qr > pr else float(pr))
            out[count, 2] = qc + 0.5 if pc == qc else (float(qc) if qc > pc else qc + 1.0)
            out[count, 3] = qr + 0.5 if pr == qr else (float(qr) if qr > pr else qr + 1.0)
            count += 1
    return out[:count].copy()


@njit
def side(outline: Outline, k: int, ux: float, uy: float) -> int:
    """Side of a line through a corner on which the obstacle lies: 1 left, -1 right, 0 both."""
    x = outline.point[k, 0]
    y = outline.point[k, 1]
    one = ux * (outline.before[k, 1] - y) - uy * (outline.before[k, 0] - x)
    two = ux * (outline.after[k, 1] - y) - uy * (outline.after[k, 0] - x)
    if one >= -TINY and two >= -TINY:
        return 1
    if one <= TINY and two <= TINY:
        return -1
    return 0


@njit
def _crosses(
    outline: Outline, k: int, ax: float, ay: float, bx: float, by: float, ux: float, uy: float
) -> bool:
    """Tell whether a line from a to b, along the unit vector u, crosses an edge."""
    px = outline.edges[k, 0]
    py = outline.edges[k, 1]
    qx = outline.edges[k, 2]
    qy = outline.edges[k, 3]
    p_side = ux * (py - ay) - uy * (px - ax)
    q_side = ux * (qy - ay) - uy * (qx - ax)
    if not (p_side * q_side < 0.0 and min(abs(p_side), abs(q_side)) > TINY):
        return False
    a_side = (qx - px) * (ay - py) - (qy - py) * (ax - px)
    b_side = (qx - px) * (by - py) - (qy - py) * (bx - px)
    return bool(a_side * b_side < 0.0 and min(abs(a_side), abs(b_side)) > TINY)


class Sight(NamedTuple):
    """What is met along a line."""

    steps: int  # steps that looking took
    free: bool  # whether nothing is in the way
    edge: int  # the edge that is crossed
    at: float  # [m]
    ball: float  # [m]


@njit
def sight(space: Space, outline: Outline, ax: float, ay: float, bx: float, by: float) -> Sight:
    """Look along a line, until it crosses an edge of the outline; touching is no crossing.

    Clearance decides most places; where it does not, the edges nearby are tested.
    """
    rows, columns = space.clearance.shape
    across = (columns - 1) // BUCKET + 1
    length = hypot(bx - ax, by - ay)
    res = space.resolution
    steps = 1
    if length == 0.0:
        return Sight(steps, True, -1, 0.0, 0.0)
    ux = (bx - ax) / length
    uy = (by - ay) / length
    at = 0.0
    last = -1
    while at < length:
        here = in_cells(space, ax + at * ux, ay + at * uy)
        column = floor(here.column)
        row = floor(here.row)
        ahead = 0.5 * res
        steps += 1
        sure = False
        if row >= 0 and column >= 0 and row < rows and column < columns:
            off = hypot(here.column - column - 0.5, here.row - row - 0.5) * res
            near = float(space.clearance[row, column]) * res
            if near + off < outline.inside:
                return Sight(steps, False, -1, at, outline.inside - near - off)
            if near - off > outline.outside:
                sure = True
                ahead = max(near - off - outline.outside, ahead)
        if not sure:
            square = _square(here.row, rows) * across + _square(here.column, columns)
            if square != last:
                last = square
                for k in range(outline.first[square], outline.first[square + 1]):
                    steps += 1
                    edge = 0 + outline.listed[k]
                    if _crosses(outline, edge, ax, ay, bx, by, ux, uy):
                        return Sight(steps, False, edge, at, 0.0)
        at += ahead
    return Sight(steps, True, -1, 0.0, 0.0)


@njit
def _hide(depth: Floats, begin: float, end: float, beyond: float) -> None:
    """Note that nothing is seen beyond a distance in the directions from `begin` to `end` [rad]."""
    n = len(depth)
    low = ceil(begin * n / (2.0 * pi) + 1e-6)
    high = floor(end * n / (2.0 * pi) - 1e-6)
    for k in range(low, high):
        depth[k % n] = min(depth[k % n], beyond)


@njit
def _hidden_by(outline: Outline, met: Sight, x: float, y: float, dx: float, dy: float,
               depth: Floats) -> None:  # fmt: skip
    """Note what cannot be seen from a point, after something was met in one direction."""
    if met.edge < 0:
        if met.at > met.ball > 0.0:
            half = asin(met.ball / met.at)
            middle = atan2(dy, dx)
            _hide(depth, middle - half, middle + half, met.at + met.ball)
        return
    px = outline.edges[met.edge, 0] - x
    py = outline.edges[met.edge, 1] - y
    qx = outline.edges[met.edge, 2] - x
    qy = outline.edges[met.edge, 3] - y
    far = max(hypot(px, py), hypot(qx, qy))
    if min(hypot(px, py), hypot(qx, qy)) > 1e-6:
        one = atan2(py, px)
        turn = atan2(px * qy - py * qx, px * qx + py * qy)
        if abs(turn) < 3.0:
            _hide(depth, min(one, one + turn), max(one, one + turn), far)


@njit
def linked(space: Space, outline: Outline, links: Links, k: int) -> Links:
    """Return the links with those of a corner known.

    The nearest corners come first: what hides one of them hides what is further away as well.
    """
    if links.first[k] >= 0:
        return links
    seen = links.seen
    used = int(links.used[0])
    n = len(outline.point)
    x = outline.point[k, 0]
    y = outline.point[k, 1]
    depth = np.empty(DIRECTIONS)
    for j in range(DIRECTIONS):
        depth[j] = inf
    heap_f = np.empty(256)
    heap_node = np.empty(256, np.int32)
    size = 0
    steps = float(n)
    for v in range(n):
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        if side(outline, k, dx, dy) == 0 or side(outline, v, dx, dy) == 0:
            continue
        length = hypot(dx, dy)
        if v == k or length < 1e-12:
            continue
        heap_f, heap_node = with_room(heap_f, heap_node, size)
        size = push(heap_f, heap_node, size, length, v)
    begin = used
    while size > 0:
        length = heap_f[0]
        v = int(heap_node[0])
        size = pop(heap_f, heap_node, size)
        steps += 10.0
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        if depth[floor(atan2(dy, dx) * DIRECTIONS / (2.0 * pi)) % DIRECTIONS] < length:
            continue
        met = sight(space, outline, x, y, outline.point[v, 0], outline.point[v, 1])
        steps += 10.0 * met.steps
        if not met.free:
            _hidden_by(outline, met, x, y, dx, dy, depth)
            continue
        if used == len(seen):
            seen = longer_ints(seen)
        seen[used] = v
        used += 1
    links.first[k] = begin
    links.number[k] = used - begin
    links.steps[k] = steps
    links.used[0] = used
    return Links(links.first, links.number, links.steps, seen, links.used)
