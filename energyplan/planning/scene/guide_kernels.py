"""Kernels for the way to the goal through the free configurations.

A node is a place and an arc: headings next to each other, all of them free there, among which the
robot turns on the spot. From an arc the robot gets to an arc of a neighbouring place if they have a
heading in common. It may lie aside of the way between the places, which then is one to and fro.
So what is known are doors, and where the robot can turn around and where it has to reverse.
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, hypot, inf, pi
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import (
    READONLY,
    Bytes,
    Flags,
    Floats,
    FloatTable,
    ShortInts,
    Singles,
    Words,
    WordTable,
    njit,
)
from energyplan.planning.scene.field import STEP_COLUMNS, STEP_ROWS, longer_ints
from energyplan.planning.scene.motions import Hills, height_at
from energyplan.terrain.collision import Space, in_cells

HEADINGS = 64
"""Headings of a place: as many as a word has bits."""

ROUNDING = 1e-3
"""Distances that differ by less count as equal [distances between places]."""

RIM = 2
"""Empty rows and columns about the places, so that no neighbour is off the map."""

STEPS = 16
"""Neighbours of a place."""

ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


class Places(NamedTuple):
    """The free configurations as nodes."""

    masks: Words  # ((rows + 4): free headings of each place, row after row, with a rim of two
    first: ShortInts  # (places + 1,): the first node of each place
    arcs: Words  # (nodes,): headings of each node
    home: ShortInts  # (nodes,): its place
    room: Singles  # (places,): clearance at the middle of each place [m]
    columns: int  # columns without the rim
    spacing: float  # distance between places [m]


class DistanceToGo(NamedTuple):
    """Distance to go to the goal, node by node."""

    places: Places  # the nodes
    distance: Singles  # (nodes,): distance to go [m]
    direction: Singles  # (nodes,) [rad]
    after: ShortInts  # (nodes,): the node to which the way to the goal leads next
    far: float  # distance to go beyond which the direction counts [m]
    work: int  # turns of nodes that it took


@njit
def _starts(mask: np.uint64) -> np.uint64:
    """Return the headings of a mask whose lower neighbour is not in it."""
    return mask & ~((mask << np.uint64(1)) | (mask >> np.uint64(63)))


@njit
def _ones(word: np.uint64) -> np.int64:
    """Return how many bits are set."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit
def headings_aside() -> WordTable:
    """Headings no further than so many steps from a neighbour's direction or its opposite.

    One row for each neighbour, one column for each number of steps up to a quarter turn.
    """
    quarter = HEADINGS // 4
    turn = 2.0 * pi / HEADINGS
    out = np.empty((STEPS, quarter + 1), np.uint64)
    for n in range(quarter + 1):
        for k in range(STEPS):
            out[k, n] = np.uint64(0)
            for h in range(HEADINGS):
                off = (h * turn - atan2(STEP_ROWS[k], STEP_COLUMNS[k])) % pi
                if min(off, pi - off) <= turn * (n + 0.5) + 1e-9:
                    out[k, n] |= np.uint64(1) << np.uint64(h)
    return out


@njit
def to_and_fro() -> Floats:
    """How much longer a way is to and fro along headings so many steps aside of it."""
    out = np.empty(HEADINGS // 4 + 1)
    for n in range(len(out)):
        out[n] = 1.0 / cos(2.0 * pi / HEADINGS * max(n - 0.5, 0.0))
    return out


@njit
def connect_places(
    masks: Annotated[NDArray[np.uint64], 2, READONLY], space: Space, spacing: float
) -> Places:
    """Return the nodes of free configurations."""
    rows, columns = masks.shape
    across = columns + 2 * RIM
    count = (rows + 2 * RIM) * across
    flat = np.empty(count, np.uint64)
    first = np.empty(count + 1, np.int32)
    room = np.empty(count, np.float32)
    nodes = 0
    for row in range(rows):
        for column in range(columns):
            mask = masks[row, column]
            if mask != 0:
                nodes += max(int(_ones(_starts(mask))), 1)
    arcs = np.empty(nodes, np.uint64)
    home = np.empty(nodes, np.int32)
    scale = spacing / space.resolution
    nodes = 0
    for place in range(count):
        first[place] = nodes
        flat[place] = np.uint64(0)
        room[place] = 0.0
        row = place // across - RIM
        column = place % across - RIM
        if row < 0 or row >= rows or column < 0 or column >= columns:
            continue
        mask = masks[row, column]
        if mask == 0:
            continue
        flat[place] = mask
        cell_row = min(int((row + 0.5) * scale), space.clearance.shape[0] - 1)
        cell_column = min(int((column + 0.5) * scale), space.clearance.shape[1] - 1)
        room[place] = space.clearance[cell_row, cell_column] * space.resolution
        starts = _starts(mask)
        if starts == 0:
            arcs[nodes] = mask
            home[nodes] = place
            nodes += 1
        while starts != 0:
            # grow the lowest start upwards, around the circle
            arc = starts & (~starts + np.uint64(1))
            starts &= ~arc
            while True:
                grown = (arc | (arc << np.uint64(1)) | (arc >> np.uint64(63))) & mask
                if grown == arc:
                    break
                arc = grown
            arcs[nodes] = arc
            home[nodes] = place
            nodes += 1
    first[count] = nodes
    return Places(flat, first, arcs, home, room, columns, spacing)


@njit
def place_of(places: Places, space: Space, x: float, y: float) -> int:
    """Return the place that a point of the world lies in, the nearest one outside the map."""
    here = in_cells(space, x, y)
    across = places.columns + 2 * RIM
    rows = len(places.masks) // across - 2 * RIM
    column = floor(here.column * space.resolution / places.spacing)
    row = floor(here.row * space.resolution / places.spacing)
    row = min(max(row, 0), rows - 1)
    column = min(max(column, 0), places.columns - 1)
    return (row + RIM) * across + column + RIM


@njit
def heading_of(space: Space, yaw: float) -> int:
    """Return the heading of a place that is nearest to a yaw, from 0 to `HEADINGS` - 1."""
    return floor((yaw - space.yaw) * (HEADINGS / (2.0 * pi)) + 0.5) % HEADINGS


@njit
def node_at(to_go: DistanceToGo, space: Space, x: float, y: float, yaw: float) -> int:
    """Return the node of a pose, or of the one next to it that is nearest to the goal; or -1.

    The poses that were tested may all be blocked although this one is not.
    """
    places = to_go.places
    place = place_of(places, space, x, y)
    h = heading_of(space, yaw)
    bit = np.uint64(1) << np.uint64(h)
    if places.masks[place] & bit != 0:
        for node in range(places.first[place], places.first[place + 1]):
            if places.arcs[node] & bit != 0:
                return node
    bits = bit | (np.uint64(1) << np.uint64((h + 1) % HEADINGS))
    bits |= np.uint64(1) << np.uint64((h + HEADINGS - 1) % HEADINGS)
    across = places.columns + 2 * RIM
    for _ in range(2):
        best = np.float32(inf)
        found = -1
        for r in range(-1, 2):
            for c in range(-1, 2):
                there = place + r * across + c
                for node in range(places.first[there], places.first[there + 1]):
                    if places.arcs[node] & bits != 0 and to_go.distance[node] < best:
                        best = to_go.distance[node]
                        found = node
        if found >= 0:
            return found
        bits = ALL
    return -1


@njit
def heights_of_places(places: Places, hills: Hills, space: Space) -> Floats:
    """Return the height of each place [m]; a single one on level ground."""
    if hills.bins == 1:
        level = np.empty(1)
        level[0] = 0.0
        return level
    across = places.columns + 2 * RIM
    out = np.empty(len(places.masks))
    for place in range(len(out)):
        along = (place % across - RIM + 0.5) * places.spacing
        up = (place // across - RIM + 0.5) * places.spacing
        x = space.x + space.cos * along - space.sin * up
        y = space.y + space.sin * along + space.cos * up
        out[place] = height_at(hills, x, y)
    return out


@njit
def way_to_go(
    places: Places,
    goals: ShortInts,
    region: ShortInts,
    near: Flags,
    ahead: float,
    surface: Bytes,
    dearness: FloatTable,
    height: Floats,
    steepest: float,
    distance: Singles,
    direction: Singles,
    parent: ShortInts,
) -> int:
    """Write the distance of the nodes from the goal, over 16 neighbours; return the work."""
    across = places.columns + 2 * RIM
    steps_r = STEP_ROWS
    steps_c = STEP_COLUMNS
    lengths = np.empty(STEPS)
    for k in range(STEPS):
        lengths[k] = places.spacing * hypot(steps_r[k], steps_c[k])
    # a knight's move passes between two places
    beside = np.empty((STEPS, 2), np.int64)
    for k in range(8, STEPS):
        for side in range(2):
            half_r = floor(0.5 * steps_r[k]) if side == 0 else ceil(0.5 * steps_r[k])
            half_c = floor(0.5 * steps_c[k]) if side == 0 else ceil(0.5 * steps_c[k])
            beside[k, side] = half_r * across + half_c
    aside = headings_aside()
    factors = to_and_fro()
    varied = surface.size > 1
    slopes = dearness.shape[1]
    even = not varied and slopes == 1
    # Buckets of nodes by their distance, as wide as the shortest step, as lists in `nodes` linked
    # by `older`. A node that is lowered after its turn has another one.
    cheapest = inf
    dearest = 0.0
    for r in range(dearness.shape[0]):
        for c in range(slopes):
            cheapest = min(cheapest, dearness[r, c])
            dearest = max(dearest, dearness[r, c])
    width = places.spacing * cheapest
    most = lengths[STEPS - 1] * dearest * factors[-1]
    ring = int(most / width) + 2
    bucket = np.empty(ring, np.int32)
    for k in range(ring):
        bucket[k] = -1
    capacity = 1 << 14
    nodes = np.empty(capacity, np.int32)
    older = np.empty(capacity, np.int32)
    total = len(places.arcs)
    target = np.empty(total, np.int32)
    closed = np.empty(total, np.bool_)
    for node in range(total):
        parent[node] = -1
        target[node] = -1
        closed[node] = False
        if near[region[node]]:
            distance[node] = inf
    rounding = ROUNDING * places.spacing
    count = 0
    waiting = 0
    for k in range(len(goals)):
        distance[goals[k]] = 0.0
        target[goals[k]] = goals[k]
        nodes[count] = goals[k]
        older[count] = bucket[0]
        bucket[0] = count
        count += 1
        waiting += 1
    at_bucket = 0
    while waiting > 0:
        entry = int(bucket[at_bucket % ring])
        if entry < 0:
            at_bucket += 1
            continue
        bucket[at_bucket % ring] = older[entry]
        node = int(nodes[entry])
        waiting -= 1
        if closed[node]:
            continue
        closed[node] = True
        d = float(distance[node])
        place = int(places.home[node])
        row = place // across
        column = place % across
        if target[node] < 0:
            far = target[parent[node]]
            if far < 0:  # lowered meanwhile
                far = parent[node]
            if d - distance[far] > 1.25 * ahead:
                far = node
                while parent[far] >= 0 and d - distance[far] < 0.8 * ahead:
                    far = parent[far]
            target[node] = far
            goal = int(places.home[far])
            direction[node] = atan2(goal // across - row, goal % across - column)
        arc = places.arcs[node]
        here = int(surface[place]) if varied else 0
        factor = dearness[here, 0]
        for k in range(STEPS):
            there = place + steps_r[k] * across + steps_c[k]
            common = arc & places.masks[there]
            if common == 0:
                continue
            if k >= 8:
                common &= places.masks[place + beside[k, 0]] | places.masks[place + beside[k, 1]]
            if not even:
                at = 0
                if slopes > 1:
                    steep = (height[place] - height[there]) / (lengths[k] * steepest)
                    at = int((min(max(steep, -1.0), 1.0) + 1.0) * 0.5 * (slopes - 1) + 0.5)
                factor = dearness[here, at]
                if varied:
                    factor = 0.5 * (factor + dearness[surface[there], at])
            step = factor * lengths[k]
            for other in range(places.first[there], places.first[there + 1]):
                if d + step >= distance[other] - rounding or not near[region[other]]:
                    continue
                shared = common & places.arcs[other]
                if shared == 0:
                    continue
                n = 0
                while shared & aside[k, n] == 0:
                    n += 1
                dd = d + step * factors[n]
                if dd < distance[other] - rounding:
                    distance[other] = dd
                    parent[other] = node
                    target[other] = -1
                    closed[other] = False
                    if count == capacity:
                        capacity *= 2
                        nodes = longer_ints(nodes)
                        older = longer_ints(older)
                    slot = max(int(dd / width), at_bucket) % ring
                    nodes[count] = other
                    older[count] = bucket[slot]
                    bucket[slot] = count
                    count += 1
                    waiting += 1
    return count
