"""Kernels that searches among obstacles share: steps, a heap, a hash table, arrays that grow."""

from __future__ import annotations

from math import pi

import numpy as np

from energyplan.compilation import Floats, Ints, ShortInts, inner

STEP_ROWS = np.array([0, 1, 0, -1, 1, 1, -1, -1, 1, 2, 2, 1, -1, -2, -2, -1])
STEP_COLUMNS = np.array([1, 0, -1, 0, 1, -1, 1, -1, 2, 1, -1, -2, -2, -1, 1, 2])
"""The 16 neighbours; the longest steps, a knight's moves, come last."""


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
def with_room(heap_f: Floats, heap_node: ShortInts, size: int) -> tuple[Floats, ShortInts]:
    """Return the arrays of a binary heap, twice as long where it fills them."""
    if size < len(heap_f):
        return heap_f, heap_node
    return longer_floats(heap_f), longer_ints(heap_node)


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
def slot_of(table: ShortInts, keys: Ints, key: int) -> int:
    """Return the slot of a key in a hash table, or the empty one (-1) where it belongs."""
    mask = len(table) - 1
    slot = (key * 0x9E3779B97F4A7C1) >> 17 & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + 1) & mask
    return int(slot)


@inner
def angle_between(a: float, b: float) -> float:
    """Angle between two headings, 0 to pi."""
    turn = abs(a - b) % (2.0 * pi)
    return min(turn, 2.0 * pi - turn)


@inner
def turning_by(a: float, way: float, b: float) -> float:
    """Least turning from one heading to another by way of a direction or the opposite one."""
    ahead = angle_between(a, way) + angle_between(way, b)
    return min(ahead, angle_between(a, way + pi) + angle_between(way + pi, b))
