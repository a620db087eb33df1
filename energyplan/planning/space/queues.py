"""Kernels that searches among obstacles share: steps, a heap, a hash table, arrays that grow."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, Ints, ShortInts, inner, lean

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


class Open(NamedTuple):
    """What a best-first search may expand next: a binary heap, the least key first."""

    f: Floats  # keys
    node: ShortInts  # what they belong to
    size: Ints  # (1,): number of entries


@inner
def no_open(room: int) -> Open:
    """Return an empty heap with room for so many entries."""
    return Open(np.empty(room), np.empty(room, np.int32), np.zeros(1, np.int64))


@inner
def longer(heap: Open) -> Open:
    """Return a heap of the same entries with room for twice as many."""
    return Open(longer_floats(heap.f), longer_ints(heap.node), heap.size)


@inner
def with_room(heap: Open) -> Open:
    """Return a heap with room for one more entry."""
    return heap if heap.size[0] < len(heap.f) else longer(heap)


@lean
def push(heap: Open, f: float, node: int) -> None:
    """Add an entry to a heap that has room for it."""
    k = int(heap.size[0])
    heap.size[0] += 1
    while k > 0:
        up = (k - 1) >> 1
        if heap.f[up] <= f:
            break
        heap.f[k] = heap.f[up]
        heap.node[k] = heap.node[up]
        k = up
    heap.f[k] = f
    heap.node[k] = node


@lean
def pop(heap: Open) -> int:
    """Remove the entry of the least key (read this first), and return its node."""
    least = int(heap.node[0])
    heap.size[0] -= 1
    size = int(heap.size[0])
    f = heap.f[size]
    node = heap.node[size]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= size:
            break
        if child + 1 < size and heap.f[child + 1] < heap.f[child]:
            child += 1
        if heap.f[child] >= f:
            break
        heap.f[k] = heap.f[child]
        heap.node[k] = heap.node[child]
        k = child
    heap.f[k] = f
    heap.node[k] = node
    return least


@inner
def chain_to(parent: ShortInts, node: int) -> Ints:
    """Return the nodes from the root of a search to one of its nodes."""
    total = 0
    at = node
    while at >= 0:
        total += 1
        at = int(parent[at])
    chain = np.empty(total, np.int64)
    at = node
    while at >= 0:
        total -= 1
        chain[total] = at
        at = int(parent[at])
    return chain


@lean
def slot_of(table: ShortInts, keys: Ints, key: int) -> int:
    """Return the slot of a key in a hash table, or the empty one (-1) where it belongs."""
    mask = len(table) - 1
    slot = (key * 0x9E3779B97F4A7C1) >> 17 & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + 1) & mask
    return int(slot)


@lean
def angle_between(a: float, b: float) -> float:
    """Angle between two headings, 0 to pi."""
    turn = abs(a - b) % (2.0 * pi)
    return min(turn, 2.0 * pi - turn)


@lean
def turning_by(a: float, way: float, b: float) -> float:
    """Least turning from one heading to another by way of a direction or the opposite one."""
    ahead = angle_between(a, way) + angle_between(way, b)
    return min(ahead, angle_between(a, way + pi) + angle_between(way + pi, b))
