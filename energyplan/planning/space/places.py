"""The free configurations as nodes: places, each with its intervals of free headings.

A place is a square of the map. The headings at which the body fits at its middle are the bits of a
word, and each run of them is a node. Two nodes of places near each other are joined if they share a
heading; the tables of steps below say how far and along which headings a step leads.
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, pi
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import (
    READONLY,
    Bytes,
    Floats,
    FloatTable,
    IntTable,
    ShortInts,
    Singles,
    Words,
    WordTable,
    inner,
    lean,
    njit,
)
from energyplan.planning.space.compiled import MARGIN
from energyplan.planning.space.configurations import (
    HEADINGS,
    FreeSpace,
    free_space,
    grown,
    updated_free_space,
)
from energyplan.planning.space.motions import DIRECTIONS, Hills, KernelProblem, height_at
from energyplan.planning.space.queues import STEP_COLUMNS, STEP_ROWS
from energyplan.terrain.collision import Space, in_cells
from energyplan.terrain.updates import Window, tables_of

RIM = 2  # empty rows and columns about the places, so that no neighbour is off the map
STEPS = 16  # neighbours of a place that a route may lead to
NEIGHBOURS = 8  # neighbours of a place, the first of these, that decide what is connected


class Places(NamedTuple):
    """The free configurations as nodes."""

    masks: Words  # ((rows + 4) * (columns + 4),): free headings of each place, with the rim
    first: ShortInts  # (places + 1,): the first node of each place
    arcs: Words  # (nodes,): headings of each node
    home: ShortInts  # (nodes,): place of each node
    room: Singles  # (places,): clearance at the middle of each place [m]
    columns: int  # columns without the rim
    spacing: float  # distance between places [m]


def places_for(kernel: KernelProblem, enlarged: bool = False) -> Places:
    """Return the free configurations of a problem as nodes, kept with a map and a body."""
    space, body = kernel.space, kernel.body
    # without the margin of planning, which enlarged the footprint
    fitting = grown(body, -MARGIN * space.resolution) if enlarged else body

    def make() -> Places:
        found = free_space(space, fitting, enlarged=enlarged, placed_as=body)
        return connect_places(found.masks, space, found.spacing)

    def update(former: Places, window: Window) -> Places:
        shape = len(former.masks) // (former.columns + 2 * RIM), former.columns + 2 * RIM
        masks = former.masks.reshape(shape)[RIM:-RIM, RIM:-RIM]
        known = FreeSpace(masks, former.spacing, enlarged)
        found = updated_free_space(known, space, fitting, window, placed_as=body)
        return connect_places(found.masks, space, found.spacing)

    return tables_of(space).get(("places", body, enlarged), make, update)


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


@lean
def _starts(mask: np.uint64) -> np.uint64:
    """Return the headings of a mask whose lower neighbour is not in it."""
    return mask & ~((mask << np.uint64(1)) | (mask >> np.uint64(63)))


@inner
def _ones(word: np.uint64) -> np.int64:
    """Return how many bits are set."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


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


@lean
def middle_of(places: Places, space: Space, place: int) -> tuple[float, float]:
    """Return the middle of a place in the world [m]."""
    across = places.columns + 2 * RIM
    along = (place % across - RIM + 0.5) * places.spacing
    up = (place // across - RIM + 0.5) * places.spacing
    return (
        space.x + space.cos * along - space.sin * up,
        space.y + space.sin * along + space.cos * up,
    )


@inner
def headings_aside() -> WordTable:
    """Headings at most so many steps from the direction to a neighbour, or from its opposite."""
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


@inner
def to_and_fro() -> Floats:
    """Factor on the length of a step driven to and fro along headings so many steps aside."""
    out = np.empty(HEADINGS // 4 + 1)
    for n in range(len(out)):
        out[n] = 1.0 / cos(2.0 * pi / HEADINGS * max(n - 0.5, 0.0))
    return out


@inner
def halfway(across: int) -> IntTable:
    """Return the two places between which a step passes, relative to it; itself for short steps."""
    out = np.zeros((STEPS, 2), np.int64)
    for k in range(8, STEPS):
        out[k, 0] = floor(0.5 * STEP_ROWS[k]) * across + floor(0.5 * STEP_COLUMNS[k])
        out[k, 1] = ceil(0.5 * STEP_ROWS[k]) * across + ceil(0.5 * STEP_COLUMNS[k])
    return out


class MetrePrices(NamedTuple):
    """What a metre costs over the least price of one, by class of surface, heading and slope."""

    surface: Bytes  # (places,): class of surface; a single one where all are alike
    ratio: FloatTable  # (classes, headings * slopes)
    headings: int  # directions of travel, from 0 round to 2 pi
    yaw: float  # yaw of the map [rad]
    across: int  # places in a row, with the rim
    height: Floats  # (places,): height of their middles; a single one on level ground [m]
    steepest: float  # steepest slope, as rise over run


def ground_of(places: Places, kernel: KernelProblem) -> MetrePrices:
    """Return what a metre costs at each place, driven the cheaper way round."""
    hills, surface = kernel.hills, kernel.surface.ravel()
    straight = kernel.prices.reshape(-1, hills.headings, hills.bins, DIRECTIONS + 1)
    # what is uphill forwards is downhill for one who faces the other way
    facing = np.roll(straight[..., ::-1, DIRECTIONS // 2], hills.headings // 2, axis=1)
    cheapest = np.minimum(straight[..., 0], facing).reshape(len(straight), -1)
    if kernel.surface.size > 1:
        rows, columns = kernel.surface.shape
        row, column = np.divmod(np.arange(len(places.masks)), places.columns + 2 * RIM)
        scale = places.spacing / kernel.space.resolution
        row = ((row - RIM + 0.5) * scale).astype(int).clip(0, rows - 1)
        column = ((column - RIM + 0.5) * scale).astype(int).clip(0, columns - 1)
        surface = kernel.surface[row, column]
    height = heights_of_places(places, hills, kernel.space) if hills.bins > 1 else np.zeros(1)
    return MetrePrices(
        surface, cheapest / kernel.least_metre, hills.headings, kernel.space.yaw,
        places.columns + 2 * RIM, height, hills.steepest,
    )  # fmt: skip


@njit
def heights_of_places(places: Places, hills: Hills, space: Space) -> Floats:
    """Return the height of each place [m]."""
    out = np.empty(len(places.masks))
    for place in range(len(out)):
        x, y = middle_of(places, space, place)
        out[place] = height_at(hills, x, y)
    return out


@lean
def ratio_between(ground: MetrePrices, place: int, to: int, length: float) -> float:
    """Return what a metre from one place to another costs over the least price of one."""
    slopes = ground.ratio.shape[1] // ground.headings
    at = 0
    if ground.headings > 1:
        up = to // ground.across - place // ground.across
        right = to % ground.across - place % ground.across
        way = (atan2(up, right) + ground.yaw) / (2.0 * pi) * ground.headings
        at = slopes * (floor(way + 0.5) % ground.headings)
    if slopes > 1:
        steep = (ground.height[to] - ground.height[place]) / (length * ground.steepest)
        at += int((min(max(steep, -1.0), 1.0) + 1.0) * 0.5 * (slopes - 1) + 0.5)
    if ground.surface.size == 1:
        return float(ground.ratio[0, at])
    kinds = ground.surface
    return 0.5 * float(ground.ratio[kinds[place], at] + ground.ratio[kinds[to], at])
