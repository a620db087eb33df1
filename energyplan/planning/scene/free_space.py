"""The free configurations of a rectangle on a map: for each place, the headings it fits in.

A word of 64 bits holds the headings of a place. All words of a map are found at once, row by row
of bits: for one heading, the places where the rectangle would touch a blocked cell are a union of
shifted rows of the map, a run of cells in each row that the rectangle reaches. The runs are those
of the exact collision test, so a bit says what that test says of the pose.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from math import ceil, cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import SingleTable
from energyplan.planning.budget import workers
from energyplan.planning.scene import free_space_kernels as kernels
from energyplan.terrain.collision import Body, Space
from energyplan.terrain.updates import Window

HEADINGS = 64
"""Headings, the first along the map's columns: as many as a word has bits."""

FINENESS, COARSEST = 0.16, 0.3
"""Distance between places, as a part of the body's smaller side, and what it is at most."""

MOST_PLACES = 1_000_000
"""Places beyond which they lie further apart."""

TOUCH = 1e-6
"""What counts as touched beside the rectangle [cells], as in the collision test."""

ALIGNED = 3e-8
"""Sines and cosines below this count as zero, as in the collision test."""

BANDS = 64
"""Bands of rows into which the work is cut."""

Words = NDArray[np.uint64]


class Runs(NamedTuple):
    """The cells that a rectangle touches, row by row, relative to the cell that holds its pose."""

    row: NDArray[np.int64]  # rows, and the first and last column in each
    first: NDArray[np.int64]  # rows, and the first and last column in each
    last: NDArray[np.int64]  # rows, and the first and last column in each
    low: int  # rows and columns that a pose may be in with the rectangle on the map
    high: int  # rows and columns that a pose may be in with the rectangle on the map
    left: int  # rows and columns that a pose may be in with the rectangle on the map
    right: int  # rows and columns that a pose may be in with the rectangle on the map


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Headings in which a body fits, place by place."""

    masks: Words  # (rows, columns)
    spacing: float  # side of a place's square [m]
    enlarged: bool  # see `masks`


def runs_of(
    body: Body, resolution: float, heading: float, x: float, y: float, touch: float
) -> Runs:
    """Return the cells that a body touches at a pose within cell (0, 0)."""
    c, s = cos(heading), sin(heading)
    if abs(s) < ALIGNED:
        c, s = (1.0 if c > 0 else -1.0), 0.0
    elif abs(c) < ALIGNED:
        c, s = 0.0, (1.0 if s > 0 else -1.0)
    half_x = 0.5 * (body.x_max - body.x_min) / resolution
    half_y = 0.5 * (body.y_max - body.y_min) / resolution
    if half_x < 0 or half_y < 0:
        none = np.zeros(0, np.int64)
        return Runs(none, none, none, low=0, high=1, left=0, right=1)
    mid_x = 0.5 * (body.x_min + body.x_max) / resolution
    mid_y = 0.5 * (body.y_min + body.y_max) / resolution
    x += c * mid_x - s * mid_y
    y += s * mid_x + c * mid_y
    reach_x = abs(c) * half_x + abs(s) * half_y
    reach_y = abs(s) * half_x + abs(c) * half_y
    corner = s * half_x * np.sign(c) - c * half_y * np.sign(s)
    rows, firsts, lasts = [], [], []
    for row in range(floor(y - reach_y - touch), floor(y + reach_y + touch) + 1):
        low, high = max(row - y, -reach_y), min(row + 1.0 - y, reach_y)
        at = min(max(corner, low), high)
        right = min(
            (half_x - s * at * np.sign(c)) / abs(c) if c else inf,
            (half_y + c * at * np.sign(s)) / abs(s) if s else inf,
        )
        at = min(max(-corner, low), high)
        left = max(
            (-half_x - s * at * np.sign(c)) / abs(c) if c else -inf,
            (-half_y + c * at * np.sign(s)) / abs(s) if s else -inf,
        )
        first, last = floor(x + left - touch), floor(x + right + touch)
        if first <= last:
            rows.append(row)
            firsts.append(first)
            lasts.append(last)
    slack = -min(touch, 0.0)  # a smaller touch also lets the rectangle lean over the edge
    return Runs(
        np.array(rows, np.int64),
        np.array(firsts, np.int64),
        np.array(lasts, np.int64),
        low=ceil(reach_y - y - slack),
        high=ceil(y + reach_y - slack),
        left=ceil(reach_x - x - slack),
        right=ceil(x + reach_x - slack),
    )


def _grouping(space: Space, body: Body) -> tuple[int, int]:
    """Return how many cells make a place, and how many places a cell, along either axis."""
    side = min(body.x_max - body.x_min, body.y_max - body.y_min)
    wanted = FINENESS * side / space.resolution
    cells = space.clearance.size
    if wanted < 0.75:
        parts = min(int(1.0 / wanted + 0.5), int((MOST_PLACES / cells) ** 0.5))
        if parts > 1:
            return 1, parts
    group = max(int(wanted + 0.5), 1)
    coarsest = COARSEST * side / space.resolution
    while cells > MOST_PLACES * group * group and group + 1 <= coarsest:
        group += 1
    return group, 1


def free_space(
    space: Space,
    body: Body,
    *,
    enlarged: bool = False,
    threads: int | None = None,
    placed_as: Body | None = None,
) -> FreeSpace:
    """Return the free configurations of a body on a map, computed anew."""
    group, parts = _grouping(space, body if placed_as is None else placed_as)
    masks = _masks(space.clearance, space.resolution, body, group, parts, enlarged, threads)
    masks.setflags(write=False)
    return FreeSpace(masks, space.resolution * group / parts, enlarged)


def updated_free_space(
    former: FreeSpace, space: Space, body: Body, window: Window, placed_as: Body | None = None
) -> FreeSpace:
    """Return the free configurations of a body on a map that differs within a window."""
    group, parts = _grouping(space, body if placed_as is None else placed_as)
    reach = ceil(_reach(body) / space.resolution) + 2
    shape = space.clearance.shape
    # whole places whose poses may touch the window, and all cells that these touch
    near = window.grown(reach, shape)
    first = near.first_row // group, near.first_column // group
    end = -(-near.end_row // group), -(-near.end_column // group)
    inner = Window(first[0] * group, end[0] * group, first[1] * group, end[1] * group)
    wide = -(-reach // group) * group
    used = inner.grown(wide, shape)
    part = np.ascontiguousarray(space.clearance[used.slices])
    fresh = _masks(part, space.resolution, body, group, parts, former.enlarged, None)
    masks = former.masks.copy()
    row, column = used.first_row // group * parts, used.first_column // group * parts
    rows, columns = slice(first[0] * parts, end[0] * parts), slice(first[1] * parts, end[1] * parts)
    masks[rows, columns] = fresh[
        rows.start - row : rows.stop - row, columns.start - column : columns.stop - column
    ]
    masks.setflags(write=False)
    return FreeSpace(masks, former.spacing, former.enlarged)


def _reach(body: Body) -> float:
    """Return how far the farthest corner of a body is from its reference point [m]."""
    return hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))


def _masks(
    clearance: SingleTable,
    resolution: float,
    body: Body,
    group: int,
    parts: int,
    enlarged: bool,
    threads: int | None,
) -> Words:
    """Return the words of a map, given its clearances [cells]; see `FreeSpace`."""
    rows, columns = clearance.shape
    turn = 2 * pi / HEADINGS
    centred = body.x_min == -body.x_max and body.y_min == -body.y_max
    # a body that looks the same from behind fits in a heading and its opposite alike
    headings = HEADINGS // 2 if centred else HEADINGS
    masks = np.zeros((-(-rows // group) * parts, -(-columns // group) * parts), np.uint64)
    blocked = clearance == 0
    reach = _reach(body) / resolution
    inscribed = max(min(-body.x_min, body.x_max, -body.y_min, body.y_max), 0.0) / resolution
    pad = ceil((reach + 2.0) / 64) + 1
    levels = max(ceil(2 * reach + 3).bit_length(), 1)
    runs_of_map = kernels.run_levels(kernels.rows_of_bits(blocked, pad), levels)
    bands = np.linspace(0, -(-rows // group), min(BANDS, rows) + 1).astype(int) * group
    count = workers() if threads is None else threads
    with ThreadPoolExecutor(count) as pool:
        for part in range(parts * parts):
            shift_row, shift_column = divmod(part, parts)
            tables = []
            for h in range(headings):
                fitting, touch = body, TOUCH
                if enlarged:
                    fitting = kernels.shrunk(body, resolution / parts, h * turn, 0.5 * turn)
                    touch = -TOUCH
                x, y = (shift_column + 0.5) / parts, (shift_row + 0.5) / parts
                tables.append(runs_of(fitting, resolution, h * turn, x, y, touch))
            first = np.concatenate([t.first for t in tables])
            length = np.concatenate([t.last for t in tables]) - first + 1
            level = np.array([int(n).bit_length() - 1 for n in length], np.int64)
            work = partial(
                kernels.free_rows,
                masks,
                runs_of_map,
                clearance,
                pad,
                group,
                run_start=np.cumsum([0, *(len(t.row) for t in tables)]),
                run_row=np.concatenate([t.row for t in tables]),
                run_level=level,
                run_first=first,
                run_last=first + length - (1 << level),
                limits=np.array([[t.low, t.high, t.left, t.right] for t in tables]),
                # what the enlarged cells may be is not told by a disc in the body
                inner=-1.0 if enlarged else inscribed - 0.75,
                outer=reach + 0.75,
                step=parts,
                shift_row=shift_row,
                shift_column=shift_column,
            )
            ends = np.minimum(bands[1:], rows).tolist()
            list(pool.map(work, bands[:-1].tolist(), ends))
    return masks
