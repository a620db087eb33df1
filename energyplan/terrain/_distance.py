"""Exact distance from the centres of cells to the nearest blocked cell's area.

The usual distance transform measures to the centres of blocked cells, which is up to 0.7 cells
too far. Here the area counts, so that a disc of that radius is certainly free.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import READONLY, FloatTable, SingleTable


@inner
def _column_distance(blocked: Annotated[NDArray[np.bool_], 2, READONLY]) -> FloatTable:
    """Return the distance along its column from each cell's centre to a blocked cell [cells]."""
    rows, columns = blocked.shape
    out = np.empty((rows, columns))
    for column in range(columns):
        out[0, column] = 0.0 if blocked[0, column] else inf
    for row in range(1, rows):
        for column in range(columns):
            out[row, column] = 0.0 if blocked[row, column] else out[row - 1, column] + 1.0
    for row in range(rows - 2, -1, -1):
        for column in range(columns):
            out[row, column] = min(out[row, column], out[row + 1, column] + 1.0)
    for row in range(rows):
        for column in range(columns):
            out[row, column] = max(out[row, column] - 0.5, 0.0)
    return out


@njit
def clearance(blocked: Annotated[NDArray[np.bool_], 2, READONLY]) -> SingleTable:
    """Return the distance from each cell's centre to a blocked cell or the map's edge [cells].

    Parameters
    ----------
    blocked : ndarray of bool, shape (rows, columns)
        The blocked cells.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        Distances, exact to rounding; 0 in blocked cells.

    References
    ----------
    Felzenszwalb and Huttenlocher (2012), Theory of Computing 8, 415 to 428: the lower envelope
    of parabolas. Here they stand on the sides between columns, because the nearest point of a
    blocked cell in another column lies on the side that faces us.
    """
    rows, columns = blocked.shape
    vertical = _column_distance(blocked)
    out = np.empty((rows, columns), np.float32)
    roots = np.empty(columns + 1, np.int64)
    starts = np.empty(columns + 1)
    heights = np.empty(columns + 1)
    for row in range(rows):
        # the parabola at side k serves the columns k - 1 and k; position of the side: k - 0.5
        for k in range(columns + 1):
            before = vertical[row, k - 1] if k > 0 else inf
            after = vertical[row, k] if k < columns else inf
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
            nearest = min(vertical[row, column], edge)
            if count > 0:
                # the centre of a column lies half a cell beyond its left side
                while at + 1 < count and starts[at + 1] < column + 0.5:
                    at += 1
                offset = column + 0.5 - roots[at]
                nearest = min(nearest, sqrt(offset * offset + heights[roots[at]]))
            out[row, column] = nearest
    return out
