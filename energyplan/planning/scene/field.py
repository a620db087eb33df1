"""Kernels for distances among obstacles: a binary heap, and the way of a disc to the goal."""

from __future__ import annotations

from math import atan2, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import (
    ByteTable,
    Floats,
    FloatTable,
    ShortInts,
    SingleTable,
)

STEP_ROWS = np.array([0, 1, 0, -1, 1, 1, -1, -1, 1, 2, 2, 1, -1, -2, -2, -1])
STEP_COLUMNS = np.array([1, 0, -1, 0, 1, -1, 1, -1, 2, 1, -1, -2, -2, -1, 1, 2])
"""The 16 neighbours; the longest steps, a knight's moves, come last."""

ROUNDING = 0.01
"""Distances that differ by less count as equal [cells]; far above single precision's error."""


class Field(NamedTuple):
    """Distance to go for a disc, on a grid of its own.

    Attributes
    ----------
    distance : ndarray of float32, shape (rows, columns)
        Distance to the goal [m]; infinite where it cannot be reached.
    direction : ndarray of float32, shape (rows, columns)
        Direction in which the way to the goal sets out [rad].
    spacing : float
        Distance between its points [m].
    far : float
        Distance to the goal beyond which the direction counts [m].
    """

    distance: SingleTable
    direction: SingleTable
    spacing: float
    far: float


@inner
def longer_ints(values: ShortInts) -> ShortInts:
    """Return an array twice as long that begins with the same values."""
    out = np.empty(2 * len(values), np.int32)
    for k in range(len(values)):
        out[k] = values[k]
    return out


@inner
def longer_floats(values: Floats) -> Floats:
    """Return an array twice as long that begins with the same values."""
    out = np.empty(2 * len(values))
    for k in range(len(values)):
        out[k] = values[k]
    return out


@inner
def push(heap_f: Floats, heap_node: ShortInts, size: int, f: float, node: int) -> int:
    """Add an entry to a binary heap and return its new size."""
    k = size
    while k > 0:
        up = (k - 1) >> 1
        if heap_f[up] <= f:
            break
        heap_f[k] = heap_f[up]
        heap_node[k] = heap_node[up]
        k = up
    heap_f[k] = f
    heap_node[k] = node
    return size + 1


@inner
def pop(heap_f: Floats, heap_node: ShortInts, size: int) -> int:
    """Remove the least entry of a binary heap (read it first) and return the new size."""
    size -= 1
    f = heap_f[size]
    node = heap_node[size]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= size:
            break
        if child + 1 < size and heap_f[child + 1] < heap_f[child]:
            child += 1
        if heap_f[child] >= f:
            break
        heap_f[k] = heap_f[child]
        heap_node[k] = heap_node[child]
        k = child
    heap_f[k] = f
    heap_node[k] = node
    return size


@inner
def angle_between(a: float, b: float) -> float:
    """Angle between two headings, 0 to pi."""
    turn = abs(a - b) % (2.0 * pi)
    return min(turn, 2.0 * pi - turn)


@njit
def distance_field(
    clearance: SingleTable,
    stride: int,
    radius: float,
    row: int,
    column: int,
    stop_row: int,
    stop_column: int,
    margin: float,
    ahead: float,
    room: float,
    penalty: float,
    surface: ByteTable,
    dearness: FloatTable,
    height: FloatTable,
    steepest: float,
) -> tuple[SingleTable, SingleTable]:
    """Return the distance of a disc's centre from one point, over 16 neighbours.

    Parameters
    ----------
    clearance : ndarray, shape (rows, columns)
        Distance to the nearest blocked cell [cells].
    stride : int
        Every how many cells a point of the field lies.
    radius : float
        Radius of the disc [cells]; points with less clearance are blocked.
    row, column : int
        Where the distance is zero, in points of the field.
    stop_row, stop_column : int
        The field need not reach further than `margin` times the distance of this point.
    margin : float
        See above.
    ahead : float
        How far ahead directions look [cells].
    room : float
        Clearance below which a place counts as tight [cells].
    penalty : float
        Factor by which distances count in tight places.
    surface : ndarray, shape (rows, columns) or (1, 1)
        Class of the surface in each cell.
    dearness : ndarray, shape (classes, slopes)
        Factor by which distances count on each class, along slopes from ``-steepest`` to
        ``steepest`` on the way to the goal.
    height : ndarray, shape of the field or (1, 1)
        Height of its points [cells]; a single one on level ground.
    steepest : float
        See above.

    Returns
    -------
    distance : ndarray of float32
        Distance [cells]: a lower limit of it where it was not needed, infinite where no disc gets.
    direction : ndarray of float32
        Direction of the way at its first `ahead` cells, in the frame of the grid [rad].
    """
    rows = (clearance.shape[0] + stride - 1) // stride
    columns = (clearance.shape[1] + stride - 1) // stride
    # Points in one row after another, with a rim that is closed, as is what a disc cannot reach.
    across = columns + 4
    total = (rows + 4) * across
    out = np.empty(total, np.float32)
    parent = np.empty(total, np.int32)
    target = np.empty(total, np.int32)
    closed = np.empty(total, np.bool_)
    reachable = np.empty(total, np.bool_)
    tight = np.empty(total, np.bool_)
    for node in range(total):
        out[node] = inf
        parent[node] = -1
        target[node] = -1
        closed[node] = True
        reachable[node] = False
        tight[node] = False
    direction = np.empty((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            near = clearance[r * stride, c * stride]
            node = (r + 2) * across + c + 2
            closed[node] = near < radius
            reachable[node] = not closed[node]
            tight[node] = near < room
            direction[r, c] = 0.0
    lengths = np.empty(16)
    for k in range(16):
        lengths[k] = stride * hypot(STEP_ROWS[k], STEP_COLUMNS[k])
    varied = surface.size > 1
    slopes = dearness.shape[1]
    even = not varied and slopes == 1
    # Buckets as wide as the shortest step: no node can lower another one of its own bucket, so that
    # their order within it does not matter. They are lists in `nodes`, linked by `older`.
    cheapest = inf
    dearest = 0.0
    for r in range(dearness.shape[0]):
        for c in range(slopes):
            cheapest = min(cheapest, dearness[r, c])
            dearest = max(dearest, dearness[r, c])
    width = stride * cheapest
    ring = int(lengths[15] * dearest * max(penalty, 1.0) / width) + 2
    bucket = np.empty(ring, np.int32)
    for k in range(ring):
        bucket[k] = -1
    capacity = 1 << 14
    nodes = np.empty(capacity, np.int32)
    older = np.empty(capacity, np.int32)
    goal = (row + 2) * across + column + 2
    stop = (stop_row + 2) * across + stop_column + 2
    nodes[0] = goal
    older[0] = -1
    bucket[0] = 0
    count = 1
    waiting = 1
    turn = 0
    closed[goal] = False
    reachable[goal] = True
    out[goal] = 0.0
    target[goal] = goal
    limit = inf
    while waiting > 0 and turn * width <= limit:
        entry = int(bucket[turn % ring])
        if entry < 0:
            turn += 1
            continue
        bucket[turn % ring] = older[entry]
        node = int(nodes[entry])
        waiting -= 1
        if closed[node]:
            continue
        closed[node] = True
        r = node // across - 2
        c = node % across - 2
        d = float(out[node])
        if target[node] < 0:
            far = target[parent[node]]
            if d - out[far] > 1.25 * ahead:
                far = node
                while parent[far] >= 0 and d - out[far] < 0.8 * ahead:
                    far = parent[far]
            target[node] = far
            direction[r, c] = atan2(far // across - 2 - r, far % across - 2 - c)
        if node == stop:
            limit = margin * d + 40.0
        here = surface[r * stride, c * stride] if varied else 0
        factor = dearness[here, 0]
        for k in range(16):
            there = node + STEP_ROWS[k] * across + STEP_COLUMNS[k]
            if closed[there]:
                continue
            if not even:
                rr = r + STEP_ROWS[k]
                cc = c + STEP_COLUMNS[k]
                at = 0
                if slopes > 1:
                    steep = (height[r, c] - height[rr, cc]) / (lengths[k] * steepest)
                    at = int((min(max(steep, -1.0), 1.0) + 1.0) * 0.5 * (slopes - 1) + 0.5)
                factor = dearness[here, at]
                if varied:
                    factor = 0.5 * (factor + dearness[surface[rr * stride, cc * stride], at])
            dd = d + factor * lengths[k] * (penalty if tight[there] else 1.0)
            if dd < out[there] - ROUNDING:
                if k >= 8:
                    # a knight's move must not jump over an obstacle
                    half_r = (2 * r + STEP_ROWS[k]) * stride // 2
                    half_c = (2 * c + STEP_COLUMNS[k]) * stride // 2
                    if clearance[half_r, half_c] < radius:
                        continue
                out[there] = dd
                parent[there] = node
                if count == capacity:
                    capacity *= 2
                    nodes = longer_ints(nodes)
                    older = longer_ints(older)
                place = int(float(out[there]) / width) % ring
                nodes[count] = there
                older[count] = bucket[place]
                bucket[place] = count
                count += 1
                waiting += 1
    distance = np.empty((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            node = (r + 2) * across + c + 2
            distance[r, c] = out[node]
            if waiting > 0 and out[node] > limit and reachable[node]:
                # ended early: what was not reached is further than the last distance that was
                distance[r, c] = limit
    return distance, direction
