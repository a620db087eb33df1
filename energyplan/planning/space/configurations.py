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
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import (
    READONLY,
    Ints,
    IntTable,
    SingleTable,
    States,
    WordBlock,
    Words,
    WordTable,
    inner,
    lean,
    njit,
    processors,
)
from energyplan.planning.settings import FREE
from energyplan.terrain.collision import ALIGNED, TOUCH, Body, Space
from energyplan.terrain.updates import Window


@njit
def grown(body: Body, by: float) -> Body:
    """Return a body that is larger on every side [m], or smaller."""
    return Body(body.x_min - by, body.y_min - by, body.x_max + by, body.y_max + by)


@njit
def shrunk(body: Body, square: float, heading: float, turn: float) -> Body:
    """Return a rectangle that lies in a body at all poses near a pose, in that pose's frame."""
    # the square as seen along either axis of the body, at any of the headings
    off = 0.5 * square * (abs(cos(heading)) + abs(sin(heading)))
    off += 0.5 * square * hypot(1, 1) * 2.0 * sin(0.5 * turn)
    # a point of the rectangle, rotated either way, must stay within the body
    along = max(-body.x_min, body.x_max, 0.0) * (1.0 - cos(turn))
    across = max(-body.y_min, body.y_max, 0.0) * (1.0 - cos(turn))
    aside_x = sin(turn) * max(-body.y_min, body.y_max, 0.0) + along + off
    aside_y = sin(turn) * max(-body.x_min, body.x_max, 0.0) + across + off
    return Body(
        body.x_min + aside_x, body.y_min + aside_y, body.x_max - aside_x, body.y_max - aside_y
    )


@njit
def rows_of_bits(blocked: Annotated[NDArray[np.bool_], 2, READONLY], pad: int) -> WordTable:
    """Pack rows of cells into words, with `pad` empty words on either side of each row."""
    rows, columns = blocked.shape
    words = (columns + 63) // 64
    out = np.empty((rows, words + 2 * pad), np.uint64)
    for row in range(rows):
        for w in range(words + 2 * pad):
            out[row, w] = np.uint64(0)
        for column in range(columns):
            if blocked[row, column]:
                out[row, pad + (column >> 6)] |= np.uint64(1) << np.uint64(column & 63)
    return out


@njit
def run_levels(bits: WordTable, levels: int) -> WordBlock:
    """Return for each `k` the columns from which a run of ``2 ** k`` cells meets a blocked one."""
    rows, words = bits.shape
    out = np.empty((levels, rows, words), np.uint64)
    for row in range(rows):
        for w in range(words):
            out[0, row, w] = bits[row, w]
    for k in range(1, levels):
        shift = 1 << (k - 1)
        for row in range(rows):
            for w in range(words):
                out[k, row, w] = np.uint64(0)
            _merge_shifted(out[k, row], out[k - 1, row], 0, 0, words)
            _merge_shifted(out[k, row], out[k - 1, row], shift, 0, words)
    return out


@lean
def _merge_shifted(into: Words, row: Words, shift: int, start: int, end: int) -> None:
    """Set the bits of a row that lie `shift` columns further on; empty words lie beyond it."""
    skip = shift >> 6
    bit = np.uint64(shift & 63)
    words = len(row)
    first = max(start, -skip)
    last = min(end, words - skip)
    if bit == 0:
        for w in range(first, last):
            into[w] |= row[w + skip]
        return
    back = np.uint64(64) - bit
    if start <= -skip - 1 < end:
        into[-skip - 1] |= row[0] << back
    for w in range(first, min(last, words - skip - 1)):
        into[w] |= (row[w + skip] >> bit) | (row[w + skip + 1] << back)
    if first < last and last == words - skip:
        into[last - 1] |= row[words - 1] >> bit


@lean
def _transpose(a: Words) -> None:
    """Transpose a square of 64 by 64 bits: bit `c` of word `h` becomes bit `h` of word `c`."""
    j = 32
    mask = np.uint64(0x00000000FFFFFFFF)
    while j != 0:
        k = 0
        shift = np.uint64(j)
        while k < 64:
            swap = ((a[k] >> shift) ^ a[k + j]) & mask
            a[k + j] ^= swap
            a[k] ^= swap << shift
            k = (k + j + 1) & ~j
        j >>= 1
        if j > 0:
            mask = mask ^ (mask << np.uint64(j))


@lean
def _keep_columns(row: Words, low: int, high: int, pad: int, columns: int) -> None:
    """Clear the bits of all columns but those from `low` to before `high`."""
    for w in range(len(row)):
        base = (w - pad) * 64
        if base + 64 <= low or base >= high or base >= columns:
            row[w] = np.uint64(0)
            continue
        if low > base:
            row[w] &= ~np.uint64(0) << np.uint64(low - base)
        end = min(high, columns)
        if end < base + 64:
            row[w] &= ~(~np.uint64(0) << np.uint64(end - base))


@inner
def _undecided(
    clearance: SingleTable, row: int, inner: float, outer: float, pad: int, words: int
) -> States:
    """Return for each word of a row: 1 free at all headings, 0 at none, -1 undecided."""
    columns = clearance.shape[1]
    out = np.empty(words, np.int8)
    for w in range(words):
        out[w] = 0
    for w in range((columns + 63) // 64):
        least = np.float32(inf)
        most = np.float32(0.0)
        for column in range(64 * w, min(64 * w + 64, columns)):
            least = min(least, clearance[row, column])
            most = max(most, clearance[row, column])
        if most < inner:
            out[pad + w] = 0
        elif least > outer:
            out[pad + w] = 1
        else:
            out[pad + w] = -1
    return out


@njit
def free_rows(
    masks: WordTable,
    levels: WordBlock,
    clearance: SingleTable,
    pad: int,
    group: int,
    begin: int,
    end: int,
    run_start: Ints,
    run_row: Ints,
    run_level: Ints,
    run_first: Ints,
    run_last: Ints,
    limits: IntTable,
    inner: float,
    outer: float,
    step: int,
    shift_row: int,
    shift_column: int,
) -> None:
    """Set the bits of the places in some rows of `masks`."""
    rows, columns = clearance.shape
    words = levels.shape[2]
    headings = len(run_start) - 1
    planes = np.empty((headings, words), np.uint64)
    touched = np.empty(words, np.uint64)
    square = np.empty(64, np.uint64)
    for first_row in range(begin, end, group):
        for h in range(headings):
            for w in range(words):
                planes[h, w] = np.uint64(0)
        for row in range(first_row, min(first_row + group, end)):
            known = _undecided(clearance, row, inner, outer, pad, words)
            for h in range(headings):
                if row < limits[h, 0] or row > rows - limits[h, 1]:
                    continue
                w = pad
                while w < words - pad:
                    if known[w] >= 0:
                        touched[w] = np.uint64(0) if known[w] == 1 else ~np.uint64(0)
                        w += 1
                        continue
                    after = w
                    while after < words - pad and known[after] < 0:
                        touched[after] = 0
                        after += 1
                    for k in range(run_start[h], run_start[h + 1]):
                        at = row + run_row[k]
                        if at < 0 or at >= rows:
                            continue
                        line = levels[run_level[k], at]
                        _merge_shifted(touched, line, run_first[k], w, after)
                        if run_last[k] != run_first[k]:
                            _merge_shifted(touched, line, run_last[k], w, after)
                    w = after
                for v in range(pad, words - pad):
                    touched[v] = ~touched[v]
                _keep_columns(touched, limits[h, 2], columns - limits[h, 3] + 1, pad, columns)
                for v in range(pad, words - pad):
                    planes[h, v] |= touched[v]
        out_row = (first_row // group) * step + shift_row
        for w in range(pad, words - pad):
            some = np.uint64(0)
            for h in range(headings):
                some |= planes[h, w]
            if some == 0:
                continue
            for h in range(64):
                square[h] = planes[h % headings, w]
            _transpose(square)
            for bit in range(64):
                if square[bit] != 0:
                    column = (w - pad) * 64 + bit
                    masks[out_row, (column // group) * step + shift_column] |= square[bit]


HEADINGS = 64  # headings, the first along the map's columns: as many as a word has bits


class Runs(NamedTuple):
    """The cells that a rectangle touches, row by row, relative to the cell that holds its pose."""

    row: NDArray[np.int64]  # rows that it touches
    first: NDArray[np.int64]  # first column in each
    last: NDArray[np.int64]  # last column in each
    low: int  # first row in which a pose keeps the rectangle on the map
    high: int  # rows that such a pose keeps from the last edge
    left: int  # first column in which a pose keeps the rectangle on the map
    right: int  # columns that such a pose keeps from the last edge


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
    wanted = FREE.fineness * side / space.resolution
    cells = space.clearance.size
    if wanted < 0.75:
        parts = min(int(1.0 / wanted + 0.5), int((FREE.places / cells) ** 0.5))
        if parts > 1:
            return 1, parts
    group = max(int(wanted + 0.5), 1)
    coarsest = FREE.coarsest * side / space.resolution
    while cells > FREE.places * group * group and group + 1 <= coarsest:
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
    runs_of_map = run_levels(rows_of_bits(blocked, pad), levels)
    bands = np.linspace(0, -(-rows // group), min(FREE.bands, rows) + 1).astype(int) * group
    count = processors() if threads is None else threads
    with ThreadPoolExecutor(count) as pool:
        for part in range(parts * parts):
            shift_row, shift_column = divmod(part, parts)
            tables = []
            for h in range(headings):
                fitting, touch = body, TOUCH
                if enlarged:
                    fitting = shrunk(body, resolution / parts, h * turn, 0.5 * turn)
                    touch = -TOUCH
                x, y = (shift_column + 0.5) / parts, (shift_row + 0.5) / parts
                tables.append(runs_of(fitting, resolution, h * turn, x, y, touch))
            first = np.concatenate([t.first for t in tables])
            length = np.concatenate([t.last for t in tables]) - first + 1
            level = np.array([int(n).bit_length() - 1 for n in length], np.int64)
            work = partial(
                free_rows,
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
                # a disc in the body does not bound what the enlarged cells may be
                inner=-1.0 if enlarged else inscribed - 0.75,
                outer=reach + 0.75,
                step=parts,
                shift_row=shift_row,
                shift_column=shift_column,
            )
            ends = np.minimum(bands[1:], rows).tolist()
            list(pool.map(work, bands[:-1].tolist(), ends))
    return masks
