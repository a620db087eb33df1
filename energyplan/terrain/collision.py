"""Kernels that test a rectangular footprint against an occupancy grid, at rest and in motion.

All of them work on a `Space` and a `Body`. A rectangle is free when it lies inside the map and
touches no blocked cell. It is tested row by row: a rectangle covers one interval of columns in
each row of cells, and `Space.next_blocked` shows in one look-up whether a blocked cell lies in an
interval, so that a test costs one step per row whatever the obstacles.

A straight motion sweeps a longer rectangle, so its test is as exact as that of a pose. Any other
motion turns the body about a fixed point; it is halved until the bounding box of each part's
sweep, in the frame of its middle pose, is free, or until a middle pose is not. Parts whose
points move less than `TOLERANCE` and that still cannot be shown free count as collisions: that
is the only pessimism, and there is no false free.
"""

from __future__ import annotations

from math import ceil, cos, floor, hypot, inf, sin
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import (
    READONLY,
    AnyTable,
    Column,
    Flags,
    ShortIntTable,
    SingleTable,
    inner,
    lean,
    njit,
)

TOLERANCE = 0.02
"""Motion of the body's fastest point below which a part of a motion is not halved [cells]."""

TOUCH = 1e-6
"""Cells nearer than this count as touched [cells]; far above rounding, far below a cell."""

ALIGNED = 3e-8  # sines and cosines below this count as zero, so that no rounding error is blown up
STRAIGHT = 1e-6  # turns below this are swept as straight lines, slightly widened [rad]


class Space(NamedTuple):
    """An occupancy grid as the kernels see it."""

    next_blocked: ShortIntTable  # column of the first blocked cell at or after each column
    clearance: SingleTable  # (rows, columns): to the nearest blocked cell or edge [cells]
    x: float  # x of the corner of cell (0, 0) in the world [m]
    y: float  # y of the corner of cell (0, 0) in the world [m]
    yaw: float  # yaw of the grid in the world [rad]
    cos: float  # cosine of `yaw`
    sin: float  # sine of `yaw`
    resolution: float  # size of a cell [m]


class Body(NamedTuple):
    """A rectangle in the body frame [m]: the footprint."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float


class InCells(NamedTuple):
    """A place in the frame of a raster, in units of its cells."""

    row: float
    column: float


@lean
def in_cells(space: Space, x: float, y: float) -> InCells:
    """Return where a point of the world lies in the grid: cell (i, j) from (i, j) to (i+1, j+1)."""
    dx = x - space.x
    dy = y - space.y
    return InCells(
        (space.cos * dy - space.sin * dx) / space.resolution,
        (space.cos * dx + space.sin * dy) / space.resolution,
    )


@njit
def next_blocked(blocked: Annotated[NDArray[np.bool_], 2, READONLY]) -> ShortIntTable:
    """Return the column of the first blocked cell at or after each column."""
    rows, columns = blocked.shape
    out = np.empty((rows, columns + 1), np.int32)
    for row in range(rows):
        nearest = columns
        out[row, columns] = columns
        for column in range(columns - 1, -1, -1):
            if blocked[row, column]:
                nearest = column
            out[row, column] = nearest
    return out


@inner
def _rectangle_free(
    space: Space, x: float, y: float, c: float, s: float, half_x: float, half_y: float
) -> bool:
    """Return whether a rectangle about (x, y) [cells] whose first axis is along (c, s) is free."""
    rows, columns = space.clearance.shape
    if abs(s) < ALIGNED:
        s = 0.0
        c = 1.0
    elif abs(c) < ALIGNED:
        c = 0.0
        s = 1.0
    reach_x = abs(c) * half_x + abs(s) * half_y
    reach_y = abs(s) * half_x + abs(c) * half_y
    # written so that a NaN is outside too
    if not (x - reach_x >= 0 and x + reach_x <= columns):
        return False
    if not (y - reach_y >= 0 and y + reach_y <= rows):
        return False

    column = min(int(x), columns - 1)
    row = min(int(y), rows - 1)
    off_centre = hypot(x - column - 0.5, y - row - 0.5)
    near = float(space.clearance[row, column])
    if near - off_centre > hypot(half_x, half_y) + TOUCH + 1e-6 * near:
        return True
    if near + off_centre < min(half_x, half_y):
        return False

    # the corner that is furthest right; the one furthest left is opposite
    corner_y = s * half_x * np.sign(c) - c * half_y * np.sign(s)
    bottom = max(floor(y - reach_y - TOUCH), 0)
    top = min(floor(y + reach_y + TOUCH), rows - 1)
    for row in range(bottom, top + 1):
        # the part of this row that the rectangle reaches, relative to the centre
        low = max(row - y, -reach_y)
        high = min(row + 1.0 - y, reach_y)
        # the right side bulges most at the corner, or else where the row comes nearest to it
        at = min(max(corner_y, low), high)
        right = min(
            (half_x - s * at * np.sign(c)) / abs(c) if c != 0.0 else inf,
            (half_y + c * at * np.sign(s)) / abs(s) if s != 0.0 else inf,
        )
        at = min(max(-corner_y, low), high)
        left = max(
            (-half_x - s * at * np.sign(c)) / abs(c) if c != 0.0 else -inf,
            (-half_y + c * at * np.sign(s)) / abs(s) if s != 0.0 else -inf,
        )
        first = min(max(floor(x + left - TOUCH), 0), columns)
        last = x + right + TOUCH
        if space.next_blocked[row, first] <= min(last, columns - 1.0):
            return False
    return True


@lean
def _box_free(space: Space, box: Body, x: float, y: float, yaw: float) -> bool:
    """Return whether a box in the frame of a pose in the world is free."""
    scale = 1.0 / space.resolution
    turn = yaw - space.yaw
    c = cos(turn)
    s = sin(turn)
    here = in_cells(space, x, y)
    mid_x = 0.5 * (box.x_min + box.x_max)
    mid_y = 0.5 * (box.y_min + box.y_max)
    return _rectangle_free(
        space, here.column + (c * mid_x - s * mid_y) * scale,
        here.row + (s * mid_x + c * mid_y) * scale, c, s, 0.5 * (box.x_max - box.x_min) * scale,
        0.5 * (box.y_max - box.y_min) * scale,
    )  # fmt: skip


@njit
def pose_free(space: Space, body: Body, x: float, y: float, yaw: float) -> bool:
    """Return whether the body is free at a pose in the world [m], [rad]. Exact."""
    return _box_free(space, body, x, y, yaw)


@njit
def poses_free(space: Space, body: Body, poses: AnyTable) -> Flags:
    """Return for each row (x, y, yaw) whether the body is free there."""
    out = np.empty(len(poses), np.bool_)
    for k in range(len(poses)):
        out[k] = _box_free(space, body, poses[k, 0], poses[k, 1], poses[k, 2])
    return out


@lean
def _swept_box(body: Body, centre_x: float, centre_y: float, half: float) -> Body:
    """Return the bounding box of a body that turns by up to `half` either way about a centre."""
    x_min = inf
    y_min = inf
    x_max = -inf
    y_max = -inf
    c = cos(half)
    s = sin(half)
    for k in range(4):
        px = (body.x_min if k < 2 else body.x_max) - centre_x
        py = (body.y_min if k % 2 == 0 else body.y_max) - centre_y
        # the corner at both ends of its arc, which runs counter-clockwise from (ax, ay)
        ax = c * px + s * py
        ay = c * py - s * px
        bx = c * px - s * py
        by = c * py + s * px
        x_min = min(x_min, ax, bx)
        x_max = max(x_max, ax, bx)
        y_min = min(y_min, ay, by)
        y_max = max(y_max, ay, by)
        # where it passes an axis it reaches as far out as it can
        radius = hypot(px, py)
        if ay <= 0.0 <= by:
            x_max = max(x_max, radius)
        elif by <= 0.0 <= ay:
            x_min = min(x_min, -radius)
        if bx <= 0.0 <= ax:
            y_max = max(y_max, radius)
        elif ax <= 0.0 <= bx:
            y_min = min(y_min, -radius)
    return Body(x_min + centre_x, y_min + centre_y, x_max + centre_x, y_max + centre_y)


@njit
def motion_free(
    space: Space, body: Body, x: float, y: float, yaw: float, ds: float, dtheta: float,
    longitudinal: float,
) -> bool:  # fmt: skip
    """Return whether the body stays free along a motion of constant curvature."""
    if abs(dtheta) <= STRAIGHT:
        # swept as a straight line at the mean heading; no point strays further than this from it
        size = hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))
        stray = 0.5 * abs(dtheta) * (abs(ds) + size + abs(longitudinal))
        swept = Body(
            body.x_min + min(ds, 0.0) - stray,
            body.y_min - stray,
            body.x_max + max(ds, 0.0) + stray,
            body.y_max + stray,
        )
        return _box_free(space, swept, x, y, yaw + 0.5 * dtheta)

    # the body turns about this fixed point of its own frame
    lateral = ds / dtheta
    reach = max(
        hypot(body.x_min - longitudinal, max(abs(body.y_min - lateral), abs(body.y_max - lateral))),
        hypot(body.x_max - longitudinal, max(abs(body.y_min - lateral), abs(body.y_max - lateral))),
    )
    limit = TOLERANCE * space.resolution
    c = cos(yaw)
    s = sin(yaw)
    fixed_x = x + c * longitudinal - s * lateral
    fixed_y = y + s * longitudinal + c * lateral

    pieces = ceil(abs(dtheta) / 0.7)
    width = dtheta / pieces
    level = 0
    index = 0
    while index < pieces << level:
        turn = width / (1 << level)
        middle = yaw + (index + 0.5) * turn
        half = 0.5 * abs(turn)
        c = cos(middle)
        s = sin(middle)
        at_x = fixed_x - c * longitudinal + s * lateral
        at_y = fixed_y - s * longitudinal - c * lateral
        box = _swept_box(body, longitudinal, lateral, half)
        if _box_free(space, box, at_x, at_y, middle):
            # done with this part: on to the next one, as wide as the halving allows
            index += 1
            while level > 0 and index % 2 == 0:
                index >>= 1
                level -= 1
        elif 2 * reach * sin(0.5 * half) < limit or not _box_free(space, body, at_x, at_y, middle):
            return False
        else:
            level += 1
            index <<= 1
    return True


@njit
def first_collision(
    space: Space, body: Body, vertices: AnyTable, ds: Column, dtheta: Column, longitudinal: float,
) -> int:  # fmt: skip
    """Return the index of the first segment along which the body is not free, or -1."""
    for k in range(len(ds)):
        if not motion_free(
            space,
            body,
            vertices[k, 0],
            vertices[k, 1],
            vertices[k, 2],
            ds[k],
            dtheta[k],
            longitudinal,
        ):
            return k
    return -1


@njit
def motions_free(
    space: Space, body: Body, starts: AnyTable, ds: Column, dtheta: Column, longitudinal: float,
) -> Flags:  # fmt: skip
    """Return which of many motions, each from its own pose (x, y, yaw), are free."""
    out = np.empty(len(starts), np.bool_)
    for k in range(len(starts)):
        out[k] = motion_free(
            space, body, starts[k, 0], starts[k, 1], starts[k, 2], ds[k], dtheta[k], longitudinal,
        )  # fmt: skip
    return out
