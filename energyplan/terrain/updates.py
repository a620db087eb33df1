"""Tables of a map's blocked cells, kept where a change of the map leaves them as they are.

The common distance transform measures to the centres of blocked cells, which is up to 0.7 cells
too far. Here the area counts, so that a disc of that radius is certainly free.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import READONLY, SingleTable, inner, njit
from energyplan.errors import MapError
from energyplan.terrain.collision import Space, next_blocked


@inner
def _column_distance(blocked: Annotated[NDArray[np.bool_], 2, READONLY]) -> SingleTable:
    """Return the distance along its column from each cell's centre to a blocked cell [cells]."""
    rows, columns = blocked.shape
    out = np.empty((rows, columns), np.float32)
    for column in range(columns):
        out[0, column] = 0.0 if blocked[0, column] else inf
    for row in range(1, rows):
        for column in range(columns):
            out[row, column] = (
                np.float32(0.0) if blocked[row, column] else out[row - 1, column] + np.float32(1.0)
            )
    for row in range(rows - 2, -1, -1):
        for column in range(columns):
            out[row, column] = min(out[row, column], out[row + 1, column] + np.float32(1.0))
    for row in range(rows):
        for column in range(columns):
            out[row, column] = max(out[row, column] - np.float32(0.5), np.float32(0.0))
    return out


@njit
def distance_to_blocked(blocked: Annotated[NDArray[np.bool_], 2, READONLY]) -> SingleTable:
    """Return the distance from each cell's centre to a blocked cell or the map's edge [cells].

    Source: Felzenszwalb and Huttenlocher (2012), Theory of Computing 8, 415 to 428: the lower
    envelope of parabolas. Here they lie on the sides between columns, because the nearest
    point of a blocked cell in another column lies on the side that faces us.
    """
    rows, columns = blocked.shape
    out = _column_distance(blocked)
    roots = np.empty(columns + 1, np.int64)
    starts = np.empty(columns + 1)
    heights = np.empty(columns + 1)
    for row in range(rows):
        # the parabola at side k serves the columns k - 1 and k; position of the side: k - 0.5
        for k in range(columns + 1):
            before = float(out[row, k - 1]) if k > 0 else inf
            after = float(out[row, k]) if k < columns else inf
            nearer = min(before, after)
            heights[k] = nearer * nearer
        count = 0
        for k in range(columns + 1):
            if heights[k] == inf:
                continue
            start = -inf
            while count > 0:
                root = roots[count - 1]
                start = (heights[k] - heights[root] + (k * k - root * root)) / (2.0 * (k - root))
                if start > starts[count - 1]:
                    break
                count -= 1
                start = -inf
            roots[count] = k
            starts[count] = start
            count += 1
        at = 0
        for column in range(columns):
            edge = min(min(column, columns - 1 - column), min(row, rows - 1 - row)) + 0.5
            nearest = min(float(out[row, column]), edge)
            if count > 0:
                # the centre of a column lies half a cell beyond its left side
                while at + 1 < count and starts[at + 1] < column + 0.5:
                    at += 1
                offset = column + 0.5 - roots[at]
                nearest = min(nearest, sqrt(offset * offset + heights[roots[at]]))
            out[row, column] = nearest
    return out


Value = TypeVar("Value")


class Window(NamedTuple):
    """A rectangle of cells: rows and columns from the first to before the end."""

    first_row: int
    end_row: int
    first_column: int
    end_column: int

    def grown(self, cells: int, shape: tuple[int, ...]) -> Window:
        """Return this window with so many more cells on every side, as far as the map reaches."""
        return Window(
            max(self.first_row - cells, 0),
            min(self.end_row + cells, shape[0]),
            max(self.first_column - cells, 0),
            min(self.end_column + cells, shape[1]),
        )

    def joined(self, other: Window) -> Window:
        """Return the least window that holds this one and another."""
        return Window(
            min(self.first_row, other.first_row),
            max(self.end_row, other.end_row),
            min(self.first_column, other.first_column),
            max(self.end_column, other.end_column),
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns, to index with."""
        return slice(self.first_row, self.end_row), slice(self.first_column, self.end_column)


def window_of(mask: NDArray[np.bool_], row: int = 0, column: int = 0) -> Window | None:
    """Return the least window that holds all cells that are set; None if none is."""
    rows = np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return None
    columns = np.flatnonzero(mask[rows[0] : rows[-1] + 1].any(axis=0))
    return Window(
        row + int(rows[0]), row + int(rows[-1]) + 1,
        column + int(columns[0]), column + int(columns[-1]) + 1,
    )  # fmt: skip


def place_of_patch(
    patch: tuple[int, ...], shape: tuple[int, int], row: int, column: int
) -> tuple[slice, slice]:
    """Return the rows and columns of a map that a patch covers, given the shapes of both."""
    (rows, columns), (height, width) = shape, patch
    if not (0 <= row <= rows - height and 0 <= column <= columns - width):
        raise MapError(
            f"a patch of {height} x {width} cells at row {row}, column {column} does not lie on "
            f"the map of {rows} x {columns} cells; cut it to the map"
        )
    return slice(row, row + height), slice(column, column + width)


class _Former(NamedTuple):
    """A table of an earlier map, and where the map changed since."""

    table: Any
    window: Window


@dataclass(eq=False)
class Tables:
    """Tables computed from a map's blocked cells, and those of the cells before they changed."""

    current: dict[Hashable, Any] = field(default_factory=dict)
    former: dict[Hashable, _Former] = field(default_factory=dict)

    def get(
        self,
        key: Hashable,
        make: Callable[[], Value],
        update: Callable[[Value, Window], Value] | None = None,
    ) -> Value:
        """Return a table: the one that is kept, a former one brought up to date, or a new one."""
        if key not in self.current:
            old = self.former.pop(key, None)
            keep = old is not None and update is not None
            self.current.setdefault(key, update(old.table, old.window) if keep else make())  # type: ignore[misc, union-attr]
        found: Value = self.current[key]
        return found

    def after(self, window: Window | None) -> Tables:
        """Return the tables of a map that differs within a window; None if nowhere."""
        if window is None:
            return Tables(dict(self.current), dict(self.former))
        former = {
            key: _Former(old.table, old.window.joined(window))
            for key, old in dict(self.former).items()
        }
        former.update({key: _Former(table, window) for key, table in dict(self.current).items()})
        return Tables({}, former)


_tables: dict[int, Tables] = {}


def tables_of(space: Space) -> Tables:
    """Return the tables of a map; they live as long as its clearances."""
    return _tables.get(id(space.clearance)) or _kept(space, Tables())


def _kept(space: Space, tables: Tables) -> Tables:
    """Return the tables kept for a map: these, unless others were stored first."""
    name = id(space.clearance)
    kept = _tables.setdefault(name, tables)
    if kept is tables:
        weakref.finalize(space.clearance, _tables.pop, name, None)
    return kept


def new_space(
    blocked: NDArray[np.bool_], origin: tuple[float, float, float], resolution: float
) -> Space:
    """Return the blocked cells, their distances and the frame, as kernels take them."""
    x, y, yaw = origin
    return Space(
        next_blocked(blocked), distance_to_blocked(blocked),
        x, y, yaw, float(np.cos(yaw)), float(np.sin(yaw)), float(resolution),
    )  # fmt: skip


def updated_space(space: Space, blocked: NDArray[np.bool_], window: Window | None) -> Space:
    """Return the space of a map whose blocked cells differ within a window."""
    new = space._replace(next_blocked=next_blocked(blocked), clearance=distance_to_blocked(blocked))
    _kept(new, tables_of(space).after(window))
    return new
