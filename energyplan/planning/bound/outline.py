"""Outlines of a map's obstacles for a disc, and what is seen along lines between corners."""

from __future__ import annotations

from math import asin, atan2, ceil, cos, floor, hypot, inf, pi, sqrt
from threading import Lock
from typing import Any, NamedTuple

import contourpy
import numpy as np
import shapely
from numpy.typing import NDArray

from energyplan.compilation import Floats, FloatTable, Ints, ShortInts, inner, lean, njit
from energyplan.path import FloatArray
from energyplan.planning.settings import OUTLINES
from energyplan.planning.space.queues import longer_ints, no_open, pop, push, with_room
from energyplan.terrain import OccupancyGrid
from energyplan.terrain.collision import Space, in_cells
from energyplan.terrain.updates import tables_of


class Outline(NamedTuple):
    """Outline of the obstacles, grown by less than the inscribed disc, and its convex corners."""

    point: FloatTable  # (n, 2): the corners
    before: FloatTable  # (n, 2): the corner before each along the outline
    after: FloatTable  # (n, 2): the corner after each along the outline
    edges: FloatTable  # (m, 4): all edges, and lines across gaps that the disc does not pass
    first: ShortInts  # (squares + 1,)
    listed: ShortInts  # edges by square
    inside: float  # clearance below which a place lies within the outline [m]
    outside: float  # clearance above which no edge is near [m]


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


@lean
def _square(place: float, cells: int) -> int:
    """Row or column of the square at a place [cells], the nearest one outside the map."""
    return min(max(floor(place / OUTLINES.bucket), 0), (cells - 1) // OUTLINES.bucket)


def squares_of_edges(grid: OccupancyGrid, edges: FloatArray) -> tuple[ShortInts, ShortInts]:
    """List the edges by the squares that they may touch, a cell's width included; see `Outline`."""
    ends = grid.to_cells(edges.reshape(-1, 2)).reshape(-1, 2, 2)
    squares = (np.array(grid.shape[::-1]) - 1) // OUTLINES.bucket
    low, high = ends.min(axis=1) - 1.0, ends.max(axis=1) + 1.0
    low, high = (
        np.clip(np.floor(at / OUTLINES.bucket).astype(int), 0, squares) for at in (low, high)
    )
    columns, rows = (high - low + 1).T
    count = rows * columns
    edge = np.repeat(np.arange(len(edges)), count)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(place, columns[edge])
    across = squares[0] + 1
    square = (low[edge, 1] + row) * across + low[edge, 0] + column
    order = np.argsort(square, kind="stable")
    first = np.searchsorted(square[order], np.arange((squares[1] + 1) * across + 1))
    return first.astype(np.int32), edge[order].astype(np.int32)


@njit
def gaps(space: Space, radius: float, inside: float) -> FloatTable:
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
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
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
            best = 2.0 * radius / res - OUTLINES.tiny
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


@lean
def side(outline: Outline, k: int, ux: float, uy: float) -> int:
    """Side of a line through a corner on which the obstacle lies: 1 left, -1 right, 0 both."""
    x = outline.point[k, 0]
    y = outline.point[k, 1]
    one = ux * (outline.before[k, 1] - y) - uy * (outline.before[k, 0] - x)
    two = ux * (outline.after[k, 1] - y) - uy * (outline.after[k, 0] - x)
    if one >= -OUTLINES.tiny and two >= -OUTLINES.tiny:
        return 1
    if one <= OUTLINES.tiny and two <= OUTLINES.tiny:
        return -1
    return 0


@lean
def _crosses(
    outline: Outline, k: int, ax: float, ay: float, bx: float, by: float, ux: float, uy: float
) -> bool:
    """Return whether a line from a to b, along the unit vector u, crosses an edge."""
    px = outline.edges[k, 0]
    py = outline.edges[k, 1]
    qx = outline.edges[k, 2]
    qy = outline.edges[k, 3]
    p_side = ux * (py - ay) - uy * (px - ax)
    q_side = ux * (qy - ay) - uy * (qx - ax)
    if not (p_side * q_side < 0.0 and min(abs(p_side), abs(q_side)) > OUTLINES.tiny):
        return False
    a_side = (qx - px) * (ay - py) - (qy - py) * (ax - px)
    b_side = (qx - px) * (by - py) - (qy - py) * (bx - px)
    return bool(a_side * b_side < 0.0 and min(abs(a_side), abs(b_side)) > OUTLINES.tiny)


class Sight(NamedTuple):
    """What is met along a line."""

    steps: int  # steps that looking took
    free: bool  # whether nothing is in the way
    edge: int  # the edge that is crossed
    at: float  # how far along the line looking came [m]
    ball: float  # radius of a disc there that lies within the outline; 0 at an edge [m]


@lean
def sight(space: Space, outline: Outline, ax: float, ay: float, bx: float, by: float) -> Sight:
    """Look along a line, until it crosses an edge of the outline; touching is no crossing."""
    rows, columns = space.clearance.shape
    across = (columns - 1) // OUTLINES.bucket + 1
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


@lean
def _hide(depth: Floats, begin: float, end: float, beyond: float) -> None:
    """Note that nothing is seen beyond a distance in the directions from `begin` to `end` [rad]."""
    n = len(depth)
    low = ceil(begin * n / (2.0 * pi) + 1e-6)
    high = floor(end * n / (2.0 * pi) - 1e-6)
    for k in range(low, high):
        depth[k % n] = min(depth[k % n], beyond)


@lean
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


@inner
def linked(space: Space, outline: Outline, links: Links, k: int) -> Links:
    """Return the links with those of a corner known."""
    if links.first[k] >= 0:
        return links
    seen = links.seen
    used = int(links.used[0])
    n = len(outline.point)
    x = outline.point[k, 0]
    y = outline.point[k, 1]
    depth = np.empty(OUTLINES.directions)
    for j in range(OUTLINES.directions):
        depth[j] = inf
    queue = no_open(256)
    steps = float(n)
    for v in range(n):
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        if side(outline, k, dx, dy) == 0 or side(outline, v, dx, dy) == 0:
            continue
        length = hypot(dx, dy)
        if v == k or length < 1e-12:
            continue
        queue = with_room(queue)
        push(queue, length, v)
    begin = used
    while queue.size[0] > 0:
        length = queue.f[0]
        v = pop(queue)
        steps += 10.0
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        if (
            depth[floor(atan2(dy, dx) * OUTLINES.directions / (2.0 * pi)) % OUTLINES.directions]
            < length
        ):
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


MOST_RUNS = 6000
"""Runs of blocked cells up to which obstacles are grown as polygons, in less than a second."""


class Detail(NamedTuple):
    """How finely obstacles are drawn."""

    arc: int  # chords of a quarter circle
    slack: float  # largest distance by which an outline is simplified, in radii of the disc


DETAILS = (Detail(8, 0.01), Detail(4, 0.03), Detail(4, 0.1), Detail(2, 0.25))
"""The finer an outline, the closer it is to the disc's ways; the coarser, the fewer corners."""


class Lines(NamedTuple):
    """Lines with the obstacle on their right, one after the other [cells]."""

    point: FloatArray  # (n, 2): their points
    first: NDArray[np.int64]  # (lines + 1,): where each begins, and where the last one ends


class Sights:
    """An outline, and what is known of the lines between its corners."""

    def __init__(self, outline: Outline) -> None:
        self.outline = outline
        self.links = no_links(len(outline.point))
        self.lock = Lock()


def sights(grid: OccupancyGrid, radius: float, detail: Detail) -> Sights:
    """Return the outline of a map for a disc, and the links known; kept with the map."""
    key = ("outline", radius, detail)
    return tables_of(grid.space).get(key, lambda: Sights(outline_for(grid, radius, detail)))


def outline_for(grid: OccupancyGrid, radius: float, detail: Detail) -> Outline:
    """Return the outline of a map's obstacles, grown by a little less than a radius."""
    tolerance = detail.slack * radius
    grown = radius - tolerance
    before = np.count_nonzero(grid.blocked[:, 1:] & ~grid.blocked[:, :-1])
    if before + np.count_nonzero(grid.blocked[:, 0]) <= MOST_RUNS:
        low = grown * cos(0.25 * pi / detail.arc)
        lines = _polygons(grid, grown, detail.arc)
    else:
        level = _level(grid, grown)
        low = max(level - sqrt(0.5), 0.0) * grid.resolution
        lines = _level_set(grid, level)
    inside = max(low - tolerance, 0.0)
    lines = _simplified(lines, tolerance / grid.resolution)
    across = np.unique(gaps(grid.space, radius, inside), axis=0)
    return _outline(grid, lines, across, inside, radius)


def _simplified(lines: Lines, tolerance: float) -> Lines:
    """Return the lines moved by at most a tolerance [cells], with fewer points."""
    index = np.repeat(np.arange(len(lines.first) - 1), np.diff(lines.first))
    simpler = shapely.simplify(shapely.linestrings(lines.point, indices=index), tolerance)
    point, of = shapely.get_coordinates(simpler, return_index=True)
    return Lines(point, np.searchsorted(of, np.arange(len(lines.first))))


def _polygons(grid: OccupancyGrid, radius: float, arc: int) -> Lines:
    """Return outlines of the blocked cells grown by `radius`, polygons inside round corners."""
    change = np.diff(np.pad(grid.blocked, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(change == 1)
    _, last = np.nonzero(change == -1)
    boxes = shapely.box(first, row, last, row + 1)
    area = shapely.union_all(shapely.buffer(boxes, radius / grid.resolution, quad_segs=arc))
    rings = [np.empty((0, 2))]
    for polygon in shapely.get_parts(area):
        for k, ring in enumerate(shapely.get_rings(polygon)):
            points = shapely.get_coordinates(ring)
            rings.append(points[::-1] if shapely.is_ccw(ring) == (k == 0) else points)
    ends = np.cumsum([len(ring) for ring in rings])
    return Lines(np.concatenate(rings), ends)


def _level(grid: OccupancyGrid, radius: float) -> float:
    """Return the clearance whose level set lies within the blocked cells grown by `radius` [cells].

    The clearance between the cells' centres is interpolated. That is off by half a cell's diagonal
    at most, since clearance changes by no more than the distance, and the level is lower by that.
    """
    level = radius / grid.resolution - sqrt(0.5)
    while level > 0.0 and abs(float(np.float32(level)) - level) < OUTLINES.difference * level:
        level -= 2.0 * OUTLINES.difference * level
    return level


def _level_set(grid: OccupancyGrid, level: float) -> Lines:
    """Return the lines at a level of the clearance, between the cells' centres."""
    rows, columns = grid.shape
    if level <= 0.0 or min(grid.shape) < 2:
        return Lines(np.empty((0, 2)), np.zeros(1, np.int64))
    band = max(OUTLINES.cells // columns, 1)
    # a few rows at a time, for what contours need of a cell is many times what a map keeps of it
    parts = [
        line
        for first in range(0, rows - 1, band)
        for line in _contours(grid, level, first, min(first + band, rows - 1) + 1)
    ]
    lines = _rejoined(parts, grid.shape) if rows - 1 > band else parts
    if lines is None:
        lines = _contours(grid, level, 0, rows)
    ends = np.cumsum([0, *(len(line) for line in lines)])
    return Lines(np.concatenate([np.empty((0, 2)), *lines]), ends)


def _contours(grid: OccupancyGrid, level: float, first: int, end: int) -> list[FloatArray]:
    """Return the lines at a level of the clearance in some rows."""
    found: Any = contourpy.contour_generator(
        np.arange(grid.shape[1]) + 0.5, np.arange(first, end) + 0.5,
        grid.space.clearance[first:end], line_type=contourpy.LineType.Separate,
    ).lines(level)  # fmt: skip
    return list(found)


def _rejoined(lines: list[FloatArray], shape: tuple[int, int]) -> list[FloatArray] | None:
    """Return lines that end where others begin as one; None if an end within the map is loose."""
    rows, columns = shape
    whole = [line for line in lines if np.array_equal(line[0], line[-1])]
    pieces = {tuple(line[0]): line for line in lines if not np.array_equal(line[0], line[-1])}
    ends = {tuple(line[-1]) for line in pieces.values()}
    loose = [place for place in pieces if place not in ends]
    loose += [place for place in ends if place not in pieces]
    if any(0.5 < x < columns - 0.5 and 0.5 < y < rows - 0.5 for x, y in loose):
        return None
    # those that begin at the map's edge first: what is left then are circles
    for begin in [*(place for place in pieces if place not in ends), *pieces]:
        chain: list[FloatArray] = []
        at = begin
        while (chunk := pieces.pop(at, None)) is not None:
            chain.append(chunk if not chain else chunk[1:])
            at = tuple(chunk[-1])
        if chain:
            whole.append(np.concatenate(chain))
    return whole


def _outline(
    grid: OccupancyGrid, lines: Lines, across: FloatArray, inside: float, outside: float
) -> Outline:
    """Return the outline that some lines make, with lines across gaps."""
    point = lines.point
    first, last = lines.first[:-1], lines.first[1:] - 1
    closed = np.all(point[first] == point[last], axis=1)
    first_closed, last_closed = first[closed], last[closed]
    inner = np.ones(len(point), bool)
    inner[first] = inner[last] = False
    within = np.flatnonzero(inner)
    at = np.concatenate([within, first_closed])
    before = point[np.concatenate([within - 1, last_closed - 1])]
    after = point[np.concatenate([within + 1, first_closed + 1])]
    (x1, y1), (x2, y2) = (point[at] - before).T, (after - point[at]).T
    convex = x1 * y2 - y1 * x2 < 0
    follows = np.ones(len(point), bool)
    follows[last] = False
    edge = np.flatnonzero(follows)

    def world(place: FloatArray) -> FloatArray:
        return np.ascontiguousarray(grid.to_world(place))

    edges = np.hstack([
        world(np.concatenate([point[edge], across[:, :2]])),
        world(np.concatenate([point[edge + 1], across[:, 2:]])),
    ])  # fmt: skip
    by_square = squares_of_edges(grid, edges)
    corner, back, on = (world(of[convex]) for of in (point[at], before, after))
    return Outline(corner, back, on, edges, *by_square, inside, outside)
