"""Outlines of a map's obstacles for a disc, drawn square by square.

A line that leads from one square into the next is cut between them. What is drawn of a square
depends on the cells in it and near it alone. So where a map changes in part the squares nearby are
drawn anew, and all others are kept; the outline is the one that a new map has.
"""

from __future__ import annotations

from math import ceil, cos, pi, sqrt
from threading import Lock
from typing import Any, NamedTuple

import contourpy
import numpy as np
import shapely
from numpy.typing import NDArray

from energyplan.path import FloatArray
from energyplan.planning.bound.sight import Outline, gaps, no_links, squares_of_edges
from energyplan.terrain import OccupancyGrid
from energyplan.terrain.updates import Window, tables_of

MOST_RUNS = 6000
"""Runs of blocked cells up to which obstacles are grown as polygons, in less than a second."""

SQUARE = 256
"""Side of the squares in which level sets are drawn [cells]."""

APART = 1e-8
"""How far a level differs from each clearance at least, as a part of it: then no line of it passes
through a cell's centre, and each crosses between two centres once."""

BESIDE = 5
"""Further cells than those under the disc that may matter to what is drawn of a place."""


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


class Drawn(NamedTuple):
    """What is drawn of a map, or of one of its squares."""

    lines: Lines  # the outline
    across: FloatArray  # (k, 4): lines across gaps that the disc does not pass


Squares = dict[tuple[int, int], Drawn]
"""What is drawn of each square, by its row and column."""


class Sights:
    """An outline, and what is known of the lines between its corners."""

    def __init__(self, outline: Outline, squares: Squares | None = None) -> None:
        self.outline = outline
        self.squares = squares
        self.links = no_links(len(outline.point))
        self.lock = Lock()


def sights(grid: OccupancyGrid, radius: float, detail: Detail) -> Sights:
    """Return the outline of a map for a disc, with what is known of its corners.

    It is made once, and in part only where the map is one that changed in part.
    """

    def update(former: Sights, window: Window) -> Sights:
        return _sights(grid, radius, detail, former.squares, window)

    key = ("outline", radius, detail)
    return tables_of(grid.space).get(key, lambda: _sights(grid, radius, detail), update)


def _sights(
    grid: OccupancyGrid,
    radius: float,
    detail: Detail,
    former: Squares | None = None,
    window: Window | None = None,
) -> Sights:
    """Return the outline anew, or from the squares before the map changed within a window."""
    tolerance = detail.slack * radius
    grown = radius - tolerance
    before = np.count_nonzero(grid.blocked[:, 1:] & ~grid.blocked[:, :-1])
    if before + np.count_nonzero(grid.blocked[:, 0]) <= MOST_RUNS:
        low = grown * cos(0.25 * pi / detail.arc)
        inside = max(low - tolerance, 0.0)
        lines = _polygons(grid, grown, detail.arc, tolerance)
        window = Window(0, grid.shape[0], 0, grid.shape[1])
        drawn = [Drawn(lines, _gaps(grid, radius, inside, window))]
        return Sights(_joined(grid, drawn, inside, radius))
    level = _Level(grid, grown)
    inside = max(level.low - tolerance, 0.0)
    squares: Squares = {}
    for place, square in _squares(grid.shape).items():
        reach = ceil(radius / grid.resolution) + BESIDE
        changed = window is None or square.grown(reach, grid.shape).meets(window)
        if former is not None and not changed:
            squares[place] = former[place]
        else:
            lines = level.lines(square, tolerance)
            squares[place] = Drawn(lines, _gaps(grid, radius, inside, square))
    return Sights(_joined(grid, list(squares.values()), inside, radius), squares)


def _squares(shape: tuple[int, int]) -> dict[tuple[int, int], Window]:
    """Return the squares of a map, row by row."""
    rows, columns = shape
    return {
        (row // SQUARE, column // SQUARE): Window(
            row, min(row + SQUARE, rows), column, min(column + SQUARE, columns)
        )
        for row in range(0, rows, SQUARE)
        for column in range(0, columns, SQUARE)
    }


def _gaps(grid: OccupancyGrid, radius: float, inside: float, window: Window) -> FloatArray:
    """Return the lines across gaps about a window's cells, each once."""
    return np.unique(gaps(grid.space, radius, inside, window), axis=0)


def _simplified(lines: Lines, tolerance: float) -> Lines:
    """Return the lines moved by at most a tolerance [cells], with fewer points; ends are kept."""
    index = np.repeat(np.arange(len(lines.first) - 1), np.diff(lines.first))
    drawn = shapely.simplify(shapely.linestrings(lines.point, indices=index), tolerance)
    point, of = shapely.get_coordinates(drawn, return_index=True)
    return Lines(point, np.searchsorted(of, np.arange(len(lines.first))))


def _polygons(grid: OccupancyGrid, radius: float, arc: int, tolerance: float) -> Lines:
    """Return the outlines of the blocked cells grown by `radius`.

    Round corners are drawn as polygons inside them.
    """
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
    return _simplified(Lines(np.concatenate(rings), ends), tolerance / grid.resolution)


class _Level:
    """A level set of a map's clearance that lies within the blocked cells grown by `radius`.

    The clearance between the cells' centres is interpolated. That is off by half a cell's diagonal
    at most, since clearance changes by no more than the distance, and the level is lower by that.
    """

    def __init__(self, grid: OccupancyGrid, radius: float) -> None:
        level = radius / grid.resolution - sqrt(0.5)
        while level > 0.0 and abs(float(np.float32(level)) - level) < APART * level:
            level -= 2.0 * APART * level
        self._grid = grid
        self._level = level
        self.low = max(level - sqrt(0.5), 0.0) * grid.resolution

    def lines(self, square: Window, tolerance: float) -> Lines:
        """Return the simplified lines in a square, between its cells' centres and the next."""
        none = Lines(np.empty((0, 2)), np.zeros(1, np.int64))
        rows, columns = self._grid.shape
        row = slice(square.first_row, min(square.end_row + 1, rows))
        column = slice(square.first_column, min(square.end_column + 1, columns))
        near = self._grid.space.clearance[row, column]
        if self._level <= 0.0 or min(near.shape) < 2 or near.max() < self._level:
            return none
        if near.min() > self._level:
            return none
        x, y = (np.arange(part.start, part.stop) + 0.5 for part in (column, row))
        drawn: Any = contourpy.contour_generator(
            x, y, near, line_type=contourpy.LineType.ChunkCombinedOffset
        ).lines(self._level)
        (point,), (first,) = drawn
        if point is None or first is None:
            return none
        lines = Lines(point, first.astype(np.int64))
        return _simplified(lines, tolerance / self._grid.resolution)


def _between(point: FloatArray, columns: int) -> NDArray[np.int64]:
    """Return numbers of the pairs of neighbouring cells between whose centres points lie."""
    place = point - 0.5
    near = np.rint(place)
    off = np.abs(place - near)
    # one of both is that of the centres, but for rounding
    upright = off[:, 0] < off[:, 1]
    column = np.where(upright, near[:, 0], np.floor(place[:, 0])).astype(np.int64)
    row = np.where(upright, np.floor(place[:, 1]), near[:, 1]).astype(np.int64)
    return np.asarray(2 * (row * (columns + 1) + column) + upright)


def _joined(grid: OccupancyGrid, drawn: list[Drawn], inside: float, outside: float) -> Outline:
    """Return the outline that is drawn in parts, with the ends of its lines joined."""
    point = np.concatenate([part.lines.point for part in drawn])
    count = np.concatenate([np.diff(part.lines.first) for part in drawn])
    end = np.cumsum(count)
    first, last = end - count, end - 1
    closed = np.all(point[first] == point[last], axis=1)
    begins, ends = first[~closed], last[~closed]
    left, entered = (_between(point[of], grid.shape[1]) for of in (ends, begins))
    _, one, two = np.intersect1d(left, entered, return_indices=True)
    begins, ends = begins[two], ends[one]
    point[begins] = point[ends]
    inner = np.ones(len(point), bool)
    inner[first] = inner[last] = False
    within = np.flatnonzero(inner)
    at = np.concatenate([within, first[closed], ends])
    before = point[np.concatenate([within - 1, last[closed] - 1, ends - 1])]
    after = point[np.concatenate([within + 1, first[closed] + 1, begins + 1])]
    (x1, y1), (x2, y2) = (point[at] - before).T, (after - point[at]).T
    convex = x1 * y2 - y1 * x2 < 0
    follows = np.ones(len(point), bool)
    follows[last] = False
    edge = np.flatnonzero(follows)
    across = np.concatenate([part.across for part in drawn])

    def world(place: FloatArray) -> FloatArray:
        return np.ascontiguousarray(grid.to_world(place))

    edges = np.hstack([
        world(np.concatenate([point[edge], across[:, :2]])),
        world(np.concatenate([point[edge + 1], across[:, 2:]])),
    ])  # fmt: skip
    squares = squares_of_edges(grid.space, edges)
    corner, back, on = (world(of[convex]) for of in (point[at], before, after))
    return Outline(corner, back, on, edges, squares.first, squares.listed, inside, outside)
