"""Kernels for regions: places joined within blocks, and the ways between them.

The free configurations of a floor are many, those that a way may pass are few. Which these are is
told by a graph a hundred times smaller, made once for a map: a region is what is joined within a
block of places, and regions are joined where their nodes are. So it knows the same doors.
"""

from __future__ import annotations

from math import hypot, inf
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Bytes, Flags, Floats, FloatTable, ShortInts, Singles, njit
from energyplan.planning.scene.field import (
    STEP_COLUMNS,
    STEP_ROWS,
    longer_ints,
    pop,
    push,
    with_room,
)
from energyplan.planning.scene.guide_kernels import RIM, Places, headings_aside, to_and_fro

BLOCK = 8
"""Places along either side of a block."""

NEIGHBOURS = 8
"""Neighbours of a place that its nodes may be joined to; further ones are reached through these."""


class Regions(NamedTuple):
    """Regions and what joins them."""

    of_node: ShortInts  # (nodes,): the region of each node of the places
    x: Floats  # (regions,): middle of each region in the frame of the grid [m]
    y: Floats  # (regions,): middle of each region in the frame of the grid [m]
    home: ShortInts  # (regions,): that place
    head: ShortInts  # (regions,): first of its links, -1 where it has none
    to: ShortInts  # region that a link leads to, and the next link of the same region, or -1
    after: ShortInts  # region that a link leads to, and the next link of the same region, or -1
    aside: Singles  # (links,)


@njit
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


@njit
def _block_of(place: int, across: int) -> int:
    """Return the number of a place's block."""
    return (place // across) // BLOCK * across + (place % across) // BLOCK


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
    surface: Bytes,
    dearness: FloatTable,
    height: Floats,
    steepest: float,
    distance: Singles,
) -> int:
    """Write the distance of every region from one of them, or to it; return the work."""
    count = len(regions.x)
    varied = surface.size > 1
    slopes = dearness.shape[1]
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
            kind = int(surface[home]) if varied else 0
            at = 0
            if slopes > 1:
                rise = height[there] - height[home]
                steep = (rise if leaving else -rise) / (max(length, 1e-9) * steepest)
                at = int((min(max(steep, -1.0), 1.0) + 1.0) * 0.5 * (slopes - 1) + 0.5)
            dear = dearness[kind, at]
            if varied:
                dear = 0.5 * (dear + dearness[surface[there], at])
            step = length * dear * aside
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
