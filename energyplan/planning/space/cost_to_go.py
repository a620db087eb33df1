"""The way to the goal through the free configurations, which guides searches."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
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
    IntTable,
    ShortInts,
    Singles,
    Words,
    WordTable,
    inner,
    njit,
)
from energyplan.path import Pose
from energyplan.planning.space.compiled import MARGIN
from energyplan.planning.space.configurations import (
    HEADINGS,
    FreeSpace,
    free_space,
    grown,
    updated_free_space,
)
from energyplan.planning.space.motions import DIRECTIONS, Hills, KernelProblem, height_at
from energyplan.planning.space.queues import (
    STEP_COLUMNS,
    STEP_ROWS,
    longer_ints,
    pop,
    push,
    with_room,
)
from energyplan.terrain.collision import Space, in_cells
from energyplan.terrain.updates import Window, tables_of

RIM = 2
"""Empty rows and columns about the places, so that no neighbour is off the map."""

STEPS = 16
"""Neighbours of a place."""

ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


class Settings(NamedTuple):
    """Constants of the cost-to-go."""

    rounding: float = 1e-3  # distances that differ by less are equal [cells]
    block: int = 8  # cells along either side of a region's block
    ahead: float = 1.5  # how far ahead the direction of the way is looked up [m]
    reach: float = 1.05  # width of the corridor about the shortest way, over its length [1]
    slack: float = 1.0  # extra width of it [body lengths]
    closed: int = 1  # cells about a closed pose that are closed as well


SETTINGS = Settings()


class Places(NamedTuple):
    """The free configurations as nodes."""

    masks: Words  # ((rows + 4): free headings of each place, row after row, with a rim of two
    first: ShortInts  # (places + 1,): the first node of each place
    arcs: Words  # (nodes,): headings of each node
    home: ShortInts  # (nodes,): its place
    room: Singles  # (places,): clearance at the middle of each place [m]
    columns: int  # columns without the rim
    spacing: float  # distance between places [m]


class CostToGo(NamedTuple):
    """Distance to go to the goal, node by node."""

    places: Places  # the nodes
    distance: Singles  # (nodes,): distance to go [m]
    direction: Singles  # (nodes,) [rad]
    after: ShortInts  # (nodes,): the node to which the way to the goal leads next
    far: float  # distance to go beyond which the direction counts [m]
    work: int  # turns of nodes that it took


@inner
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


@inner
def headings_aside() -> WordTable:
    """Headings no further than so many steps from a neighbour's direction or its opposite."""
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
    """How much longer a way is to and fro along headings so many steps aside of it."""
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


@inner
def middle_of(places: Places, space: Space, place: int) -> tuple[float, float]:
    """Return the middle of a place in the world [m]."""
    across = places.columns + 2 * RIM
    along = (place % across - RIM + 0.5) * places.spacing
    up = (place // across - RIM + 0.5) * places.spacing
    return (
        space.x + space.cos * along - space.sin * up,
        space.y + space.sin * along + space.cos * up,
    )


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
def node_at(to_go: CostToGo, space: Space, pose: Pose) -> int:
    """Return the node of a pose, or of the one next to it that is nearest to the goal; or -1."""
    places = to_go.places
    place = place_of(places, space, pose.x, pose.y)
    h = heading_of(space, pose.yaw)
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
    out = np.empty(len(places.masks))
    for place in range(len(out)):
        x, y = middle_of(places, space, place)
        out[place] = height_at(hills, x, y)
    return out


class Ground(NamedTuple):
    """What a metre costs over the least price of one, by class of surface and slope."""

    surface: Bytes  # (places,): class of surface; a single one where all are alike
    ratio: FloatTable  # (classes, slopes)
    height: Floats  # (places,): see `heights_of_places` [m]
    steepest: float  # steepest slope, as rise over run


@inner
def ratio_between(ground: Ground, place: int, to: int, length: float) -> float:
    """Return what a metre from one place to another costs over the least price of one."""
    slopes = ground.ratio.shape[1]
    at = 0
    if slopes > 1:
        steep = (ground.height[to] - ground.height[place]) / (length * ground.steepest)
        at = int((min(max(steep, -1.0), 1.0) + 1.0) * 0.5 * (slopes - 1) + 0.5)
    if ground.surface.size == 1:
        return float(ground.ratio[0, at])
    kinds = ground.surface
    return 0.5 * float(ground.ratio[kinds[place], at] + ground.ratio[kinds[to], at])


@inner
def _node_ahead(node: int, far: int, distance: Singles, parent: ShortInts) -> int:
    """Return the node on the way to which a node's direction points; `far` is that of the next."""
    d = float(distance[node])
    if far < 0:  # lowered meanwhile
        far = int(parent[node])
    if d - distance[far] > 1.25 * SETTINGS.ahead:
        far = node
        while parent[far] >= 0 and d - distance[far] < 0.8 * SETTINGS.ahead:
            far = int(parent[far])
    return far


@njit
def fill_cost_to_go(
    places: Places,
    goals: ShortInts,
    region: ShortInts,
    near: Flags,
    ground: Ground,
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
    beside = halfway(across)
    aside = headings_aside()
    factors = to_and_fro()
    even = ground.ratio.size == 1
    # Buckets of nodes by their distance, as wide as the shortest step, as lists in `nodes` linked
    # by `older`. A node that is lowered after its turn has another one.
    cheapest = inf
    dearest = 0.0
    for r in range(ground.ratio.shape[0]):
        for c in range(ground.ratio.shape[1]):
            cheapest = min(cheapest, ground.ratio[r, c])
            dearest = max(dearest, ground.ratio[r, c])
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
    rounding = SETTINGS.rounding * places.spacing
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
            far = int(target[parent[node]])
            target[node] = _node_ahead(node, far, distance, parent)
            goal = int(places.home[target[node]])
            direction[node] = atan2(goal // across - row, goal % across - column)
        arc = places.arcs[node]
        factor = ground.ratio[0, 0]
        for k in range(STEPS):
            there = place + steps_r[k] * across + steps_c[k]
            common = arc & places.masks[there]
            if common == 0:
                continue
            if k >= 8:
                common &= places.masks[place + beside[k, 0]] | places.masks[place + beside[k, 1]]
            if not even:
                factor = ratio_between(ground, there, place, lengths[k])
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


NEIGHBOURS = 8
"""Neighbours of a place that its nodes may be joined to; further ones are reached through these."""


class Regions(NamedTuple):
    """Regions and what joins them."""

    of_node: ShortInts  # (nodes,): the region of each node of the places
    x: Floats  # (regions,): x of the middle of each region in the frame of the grid [m]
    y: Floats  # (regions,): y of that middle [m]
    home: ShortInts  # (regions,): place of each region with the most room
    head: ShortInts  # (regions,): first of its links, -1 where it has none
    to: ShortInts  # (links,): region that a link leads to
    after: ShortInts  # (links,): next link of the same region, or -1
    aside: Singles  # (links,): how much longer a way is along the nearest free heading [1]


@inner
def _flood(
    places: Places, of_node: ShortInts, node: int, region: int, block: int, stack: ShortInts
) -> ShortInts:
    """Give a region to all nodes that are joined to one within its block; return the stack."""
    across = places.columns + 2 * RIM
    steps_r = STEP_ROWS
    steps_c = STEP_COLUMNS
    of_node[node] = region
    stack[0] = node
    height = 1
    while height > 0:
        height -= 1
        here = int(stack[height])
        place = int(places.home[here])
        for k in range(NEIGHBOURS):
            there = place + steps_r[k] * across + steps_c[k]
            if _block_of(there, across) != block:
                continue
            for other in range(places.first[there], places.first[there + 1]):
                if of_node[other] < 0 and places.arcs[other] & places.arcs[here] != 0:
                    of_node[other] = region
                    if height == len(stack):
                        stack = longer_ints(stack)
                    stack[height] = other
                    height += 1
    return stack


@inner
def _block_of(place: int, across: int) -> int:
    """Return the number of a place's block."""
    return (place // across) // SETTINGS.block * across + (place % across) // SETTINGS.block


@njit
def join_regions(places: Places) -> Regions:
    """Return the regions of free configurations."""
    across = places.columns + 2 * RIM
    steps_r = STEP_ROWS
    steps_c = STEP_COLUMNS
    nodes = len(places.arcs)
    of_node = np.empty(nodes, np.int32)
    for node in range(nodes):
        of_node[node] = -1
    stack = np.empty(1 << 10, np.int32)
    count = 0
    for node in range(nodes):
        if of_node[node] < 0:
            block = _block_of(int(places.home[node]), across)
            stack = _flood(places, of_node, node, count, block, stack)
            count += 1
    x = np.zeros(count)
    y = np.zeros(count)
    room = np.zeros(count)
    size = np.zeros(count)
    roomiest = np.empty(count, np.int32)
    head = np.empty(count, np.int32)
    for region in range(count):
        head[region] = -1
    capacity = 8 * count + 8
    to = np.empty(capacity, np.int32)
    after = np.empty(capacity, np.int32)
    steps = np.empty(capacity, np.int32)
    near = headings_aside()
    links = 0
    for node in range(nodes):
        place = int(places.home[node])
        region = int(of_node[node])
        x[region] += (place % across - RIM + 0.5) * places.spacing
        y[region] += (place // across - RIM + 0.5) * places.spacing
        if size[region] == 0.0 or places.room[place] > room[region]:
            room[region] = places.room[place]
            roomiest[region] = place
        size[region] += 1.0
        block = _block_of(place, across)
        for k in range(NEIGHBOURS):
            there = place + steps_r[k] * across + steps_c[k]
            if _block_of(there, across) == block:
                continue
            for other in range(places.first[there], places.first[there + 1]):
                shared = places.arcs[other] & places.arcs[node]
                if shared == 0:
                    continue
                n = 0
                while shared & near[k, n] == 0:
                    n += 1
                link = int(head[region])
                while link >= 0 and to[link] != of_node[other]:
                    link = int(after[link])
                if link >= 0:
                    steps[link] = min(steps[link], n)
                    continue
                if links == capacity:
                    capacity *= 2
                    to = longer_ints(to)
                    after = longer_ints(after)
                    steps = longer_ints(steps)
                to[links] = of_node[other]
                after[links] = head[region]
                steps[links] = n
                head[region] = links
                links += 1
    for region in range(count):
        x[region] /= size[region]
        y[region] /= size[region]
    factors = to_and_fro()
    aside = np.empty(links, np.float32)
    for link in range(links):
        aside[link] = factors[steps[link]]
    to = to[:links].copy()
    after = after[:links].copy()
    return Regions(of_node, x, y, roomiest, head, to, after, aside)


@njit
def ways_between(
    regions: Regions,
    start: int,
    stop: int,
    margin: float,
    slack: float,
    leaving: bool,
    ground: Ground,
    distance: Singles,
) -> int:
    """Write the distance of every region from one of them, or to it; return the work."""
    count = len(regions.x)
    closed = np.zeros(count, np.bool_)
    for region in range(count):
        distance[region] = inf
    heap_f = np.empty(64)
    heap_node = np.empty(64, np.int32)
    distance[start] = 0.0
    size = push(heap_f, heap_node, 0, 0.0, start)
    limit = inf
    work = 0
    while size > 0 and heap_f[0] <= limit:
        d = heap_f[0]
        region = int(heap_node[0])
        size = pop(heap_f, heap_node, size)
        if closed[region]:
            continue
        closed[region] = True
        if region == stop:
            limit = margin * d + slack
        home = int(regions.home[region])
        link = int(regions.head[region])
        while link >= 0:
            other = int(regions.to[link])
            aside = regions.aside[link]
            link = int(regions.after[link])
            if closed[other]:
                continue
            work += 1
            dx = regions.x[other] - regions.x[region]
            dy = regions.y[other] - regions.y[region]
            length = hypot(dx, dy)
            there = int(regions.home[other])
            first = home if leaving else there
            last = there if leaving else home
            step = length * ratio_between(ground, first, last, max(length, 1e-9)) * aside
            if d + step < distance[other]:
                distance[other] = d + step
                heap_f, heap_node = with_room(heap_f, heap_node, size)
                size = push(heap_f, heap_node, size, d + step, other)
    if size > 0:
        # ended early: what had no turn is further than the limit
        for region in range(count):
            if not closed[region]:
                distance[region] = limit
    return work


@njit
def fill_beside(regions: Regions, near: Flags, back: Singles, distance: Singles) -> None:
    """Write the distances of nodes that did not count: as far as between regions, and no nearer.

    What distances among nodes are longer than those between regions, where both are known, is added
    at its most: so nothing leads a search there as long as there is a way elsewhere.
    """
    least = np.empty(len(near), np.float32)
    for region in range(len(near)):
        least[region] = inf
    for node in range(len(distance)):
        region = int(regions.of_node[node])
        if distance[node] < least[region]:
            least[region] = distance[node]
    more = np.float32(0.0)
    for region in range(len(near)):
        if near[region] and least[region] < inf:
            more = max(more, least[region] - back[region])
    for node in range(len(distance)):
        region = int(regions.of_node[node])
        if not near[region]:
            distance[node] = back[region] + more


def places_for(kernel: KernelProblem, enlarged: bool = False) -> Places:
    """Return the free configurations of a problem as nodes, made once for a map and a body."""
    space, body = kernel.space, kernel.body
    # without the margin of planning, which made the footprint larger
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


def regions_for(kernel: KernelProblem, enlarged: bool = False) -> Regions:
    """Return the regions of these nodes; see `places_for`."""
    places = places_for(kernel, enlarged)
    key = ("regions", kernel.body, enlarged)
    return tables_of(kernel.space).get(key, lambda: join_regions(places))


def inscribed(kernel: KernelProblem) -> float:
    """Radius of the largest disc about the centre of the tread ICRs inside the body [m]."""
    body = kernel.body
    return max(min(-body.x_min, body.x_max, -body.y_min, body.y_max), 0.0)


def cost_to_go(kernel: KernelProblem) -> CostToGo:
    """Return the distance to go to the goal, as far as it is needed."""
    found = _guide(kernel, enlarged=False)
    if reached(found, kernel):
        return found
    return _guide(kernel, enlarged=True)


def no_cost_to_go() -> CostToGo:
    """Return an empty table, for a search without a goal."""
    places = Places(
        np.zeros(1, np.uint64),
        np.zeros(2, np.int32),
        np.zeros(0, np.uint64),
        np.zeros(0, np.int32),
        np.zeros(1, np.float32),
        1,
        1.0,
    )
    none = np.zeros(0, np.float32)
    return CostToGo(places, none, none, np.zeros(0, np.int32), 0.0, 0)


def reached(to_go: CostToGo, kernel: KernelProblem) -> bool:
    """Tell whether the start leads to the goal."""
    return bool(np.isfinite(cost_at_start(to_go, kernel)))


def cost_at_start(to_go: CostToGo, kernel: KernelProblem) -> float:
    """Return the distance to go at the start [m]; infinite where it does not lead to the goal."""
    node = node_at(to_go, kernel.space, kernel.start)
    return float(to_go.distance[node]) if node >= 0 else np.inf


def cost_through_passages(
    kernel: KernelProblem, known: float, closed: Sequence[Pose] = ()
) -> CostToGo:
    """Return the distance to go where the body may be free, between the poses tested as well."""
    places = places_for(kernel, enlarged=True)
    if closed:
        places = _without(places, places_for(kernel), kernel, closed)
    if not closed and not np.isfinite(known):
        known = 0.0
    return _guide(kernel, enlarged=True, places=places, known=known)


def _without(
    places: Places, tested: Places, kernel: KernelProblem, closed: Sequence[Pose]
) -> Places:
    """Return places that are free about some poses only where poses were tested."""
    across = places.columns + 2 * RIM
    masks, arcs = places.masks.copy(), places.arcs.copy()
    for pose in closed:
        middle = place_of(places, kernel.space, pose.x, pose.y)
        for row in range(-SETTINGS.closed, SETTINGS.closed + 1):
            for place in range(
                middle + row * across - SETTINGS.closed, middle + row * across + SETTINGS.closed + 1
            ):
                if 0 <= place < len(masks):
                    masks[place] &= tested.masks[place]
                    arcs[places.first[place] : places.first[place + 1]] &= tested.masks[place]
    return places._replace(masks=masks, arcs=arcs)


def _guide(
    kernel: KernelProblem,
    enlarged: bool,
    places: Places | None = None,
    known: float = 0.0,
) -> CostToGo:
    """Return the distance to go near the shortest way, and on all not longer than `known`."""
    places = places_for(kernel, enlarged) if places is None else places
    hills, space = kernel.hills, kernel.space
    # where it turns for nothing within this distance, reversing can be cheaper
    far = 2.0 * kernel.least_radian / kernel.least_metre
    distance, direction = np.zeros((2, len(places.arcs)), np.float32)
    after = np.full(len(places.arcs), -1, np.int32)
    to_go = CostToGo(places, distance, direction, after, far, 0)
    goal = node_at(to_go, space, kernel.goal)
    start = node_at(to_go, space, kernel.start)
    straight = kernel.prices.reshape(-1, hills.bins, DIRECTIONS + 1)
    # what is uphill forwards is downhill for one who faces the other way
    cheapest = np.minimum(straight[..., 0], straight[:, ::-1, DIRECTIONS // 2])
    ground = Ground(
        _surface(places, kernel),
        cheapest / kernel.least_metre,
        heights_of_places(places, hills, space),
        hills.steepest,
    )
    regions = regions_for(kernel, enlarged)
    near = np.ones(len(regions.x), bool)
    work = 0
    if start >= 0 and goal >= 0:
        ends = int(regions.of_node[goal]), int(regions.of_node[start])
        slack = SETTINGS.slack * 2.0 * kernel.reach
        back, out = (np.empty(len(near), np.float32) for _ in range(2))
        between = partial(ways_between, regions, margin=SETTINGS.reach, slack=slack, ground=ground)
        work += between(start=ends[0], stop=ends[1], leaving=False, distance=back)
        if np.isfinite(back[ends[1]]):
            work += between(start=ends[1], stop=ends[0], leaving=True, distance=out)
            far_off = back + out
            near = far_off <= max(SETTINGS.reach * back[ends[1]] + slack, known)
            distance[:] = np.inf
    goals = np.array([goal] if goal >= 0 else [], np.int32)
    work += fill_cost_to_go(
        places, goals, regions.of_node, near, ground, distance, direction, after
    )
    if not near.all():
        fill_beside(regions, near, back, to_go.distance)
    return to_go._replace(work=work)


def _surface(places: Places, kernel: KernelProblem) -> NDArray[np.uint8]:
    """Return the class of the surface at each place; a single one where all are alike."""
    if kernel.surface.size == 1:
        return kernel.surface.ravel()
    rows, columns = kernel.surface.shape
    across = places.columns + 2 * RIM
    place = np.arange(len(places.masks))
    scale = places.spacing / kernel.space.resolution
    row = ((place // across - RIM + 0.5) * scale).astype(int).clip(0, rows - 1)
    column = ((place % across - RIM + 0.5) * scale).astype(int).clip(0, columns - 1)
    return np.asarray(kernel.surface[row, column])
