"""Kernels on rows of bits: where a rectangle touches the blocked cells of a map."""

from __future__ import annotations

from math import cos, hypot, inf, sin
from typing import Annotated

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
    njit,
)
from energyplan.terrain.collision import Body


@njit
def shrunk(body: Body, square: float, heading: float, turn: float) -> Body:
    """Return a rectangle that lies in a body at all poses near a pose, in that pose's frame."""
    # the square as seen along either axis of the body, at any of the headings
    off = 0.5 * square * (abs(cos(heading)) + abs(sin(heading)))
    off += 0.5 * square * hypot(1, 1) * 2.0 * sin(0.5 * turn)
    # a point of the rectangle turned either way must stay within the body
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


@njit
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


@njit
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


@njit
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


@njit
def _undecided(
    clearance: SingleTable, row: int, inner: float, outer: float, pad: int, words: int
) -> States:
    """Tell of each word of a row: 1 free at all headings, 0 at none, -1 undecided.

    The discs lie about the poses: the `inner` one within the body, the body in the `outer` one.
    """
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
