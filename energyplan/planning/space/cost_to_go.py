"""The cost-to-go: how far the goal is from every node of the free configurations.

Dijkstra's algorithm runs from the goal over the nodes of `places`, at the price of each surface and
slope. First a coarser graph, whose nodes are regions, shows in which corridor a short route can
lie: the algorithm visits the nodes of these regions alone.
"""

from __future__ import annotations

from functools import partial
from math import atan2, hypot, inf
from typing import NamedTuple

import numpy as np

from energyplan.compilation import (
    Flags,
    Floats,
    Ints,
    IntTable,
    ShortInts,
    Singles,
    WordTable,
    inner,
    lean,
    njit,
)
from energyplan.path import Pose
from energyplan.planning.settings import TO_GO
from energyplan.planning.space.configurations import HEADINGS
from energyplan.planning.space.motions import KernelProblem
from energyplan.planning.space.places import (
    NEIGHBOURS,
    RIM,
    STEPS,
    MetrePrices,
    Places,
    ground_of,
    halfway,
    heading_of,
    headings_aside,
    place_of,
    places_for,
    ratio_between,
    to_and_fro,
)
from energyplan.planning.space.queues import (
    STEP_COLUMNS,
    STEP_ROWS,
    longer_ints,
    no_open,
    pop,
    push,
    with_room,
)
from energyplan.terrain.collision import Space
from energyplan.terrain.updates import tables_of


class CostToGo(NamedTuple):
    """Distance to go to the goal, node by node."""

    places: Places  # the nodes
    distance: Singles  # (nodes,): distance to go [m]
    direction: Singles  # (nodes,): direction of the route a little further on [rad]
    after: ShortInts  # (nodes,): next node on the route to the goal
    far: float  # distance to go beyond which the direction counts [m]
    work: int  # nodes and links that were expanded


def cost_to_go(kernel: KernelProblem) -> CostToGo:
    """Return the distance to go over the poses tested, or over all that may be free if need be."""
    found = cost_over(kernel, enlarged=False)
    return found if reached(found, kernel) else cost_over(kernel, enlarged=True)


def cost_through_passages(kernel: KernelProblem, known: float) -> CostToGo:
    """Return the distance to go where the body may be free, between the poses tested as well."""
    return cost_over(kernel, enlarged=True, known=known if np.isfinite(known) else 0.0)


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
    """Return whether the start leads to the goal."""
    return bool(np.isfinite(cost_at_start(to_go, kernel)))


def cost_at_start(to_go: CostToGo, kernel: KernelProblem) -> float:
    """Return the distance to go at the start [m]; infinite where it does not lead to the goal."""
    node = node_at(to_go, kernel.space, kernel.start)
    return float(to_go.distance[node]) if node >= 0 else np.inf


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
        bits = ~np.uint64(0)
    return -1


def cost_over(kernel: KernelProblem, enlarged: bool, known: float = 0.0) -> CostToGo:
    """Return the distance to go near the shortest route, and on all not longer than `known`."""
    places, space = places_for(kernel, enlarged), kernel.space
    # where it turns for nothing within this distance, reversing can be cheaper
    far = 2.0 * kernel.least_radian / kernel.least_metre
    distance, direction = np.zeros((2, len(places.arcs)), np.float32)
    after = np.full(len(places.arcs), -1, np.int32)
    to_go = CostToGo(places, distance, direction, after, far, 0)
    goal = node_at(to_go, space, kernel.goal)
    start = node_at(to_go, space, kernel.start)
    ground, regions = ground_of(places, kernel), regions_for(kernel, enlarged)
    near = np.ones(len(regions.x), bool)
    work = 0
    if start >= 0 and goal >= 0:
        ends = int(regions.of_node[goal]), int(regions.of_node[start])
        slack = TO_GO.slack * 2.0 * kernel.reach
        back, out = (np.empty(len(near), np.float32) for _ in range(2))
        between = partial(fill_regions, regions, margin=TO_GO.corridor, slack=slack, ground=ground)
        work += between(start=ends[0], stop=ends[1], leaving=False, distance=back)
        if np.isfinite(back[ends[1]]):
            work += between(start=ends[1], stop=ends[0], leaving=True, distance=out)
            near = back + out <= max(TO_GO.corridor * back[ends[1]] + slack, known)
            distance[:] = np.inf
    goals = np.array([goal] if goal >= 0 else [], np.int32)
    work += fill_cost_to_go(
        places, goals, regions.of_node, near, ground, distance, direction, after
    )
    if not near.all():
        fill_outside(regions, near, back, distance)
    return to_go._replace(work=work)


class Neighbours(NamedTuple):
    """Tables of the steps to the 16 neighbours, with the prices of the ground."""

    lengths: Floats  # (16,): [m]
    between: IntTable  # see `halfway`
    aside: WordTable  # see `headings_aside`
    factors: Floats  # see `to_and_fro`
    ground: MetrePrices
    even: bool  # whether all ground costs the same
    least: float  # least and largest price of a metre over the least of all ground
    most: float


class Tentative(NamedTuple):
    """What is known of the nodes so far."""

    distance: Singles  # distance to go [m]
    parent: ShortInts  # next node towards the goal, or -1
    target: ShortInts  # node that its direction points to; -1 where that is not known, or no longer
    closed: Flags  # whether it was expanded since its distance fell
    region: ShortInts  # region of each node
    near: Flags  # regions whose nodes are visited


class Buckets(NamedTuple):
    """Nodes to expand, by distance: a ring of linked lists, each of nodes about as far away."""

    first: ShortInts  # (ring,): first entry of each list, or -1
    node: ShortInts  # node of each entry
    next: ShortInts  # next entry of its list, or of those that are empty again; or -1
    counts: Ints  # (5,): entries added, used at once, waiting; first empty one; list that is due
    width: float  # range of distances of a list [m]


@inner
def _neighbours(places: Places, ground: MetrePrices) -> Neighbours:
    """Return the tables of the steps to neighbours."""
    lengths = np.empty(STEPS)
    for k in range(STEPS):
        lengths[k] = places.spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k])
    least = inf
    most = 0.0
    for r in range(ground.ratio.shape[0]):
        for c in range(ground.ratio.shape[1]):
            least = min(least, ground.ratio[r, c])
            most = max(most, ground.ratio[r, c])
    return Neighbours(
        lengths, halfway(places.columns + 2 * RIM), headings_aside(), to_and_fro(), ground,
        ground.ratio.size == 1, least, most,
    )  # fmt: skip


@inner
def _buckets(width: float, furthest: float) -> Buckets:
    """Return empty lists for steps of some length at most."""
    ring = int(furthest / width) + 2
    first = np.empty(ring, np.int32)
    for k in range(ring):
        first[k] = -1
    counts = np.zeros(5, np.int64)
    counts[3] = -1
    room = 1 << 14
    return Buckets(first, np.empty(room, np.int32), np.empty(room, np.int32), counts, width)


@inner
def _longer(buckets: Buckets) -> Buckets:
    """Return the same lists with room for twice as many entries."""
    node, after = longer_ints(buckets.node), longer_ints(buckets.next)
    return Buckets(buckets.first, node, after, buckets.counts, buckets.width)


@lean
def _add(buckets: Buckets, node: int, distance: float) -> None:
    """Add an entry to the lists."""
    counts = buckets.counts
    new = int(counts[3])
    if new >= 0:
        counts[3] = buckets.next[new]
    else:
        new = int(counts[1])
        counts[1] += 1
    slot = max(int(distance / buckets.width), counts[4]) % len(buckets.first)
    buckets.node[new] = node
    buckets.next[new] = buckets.first[slot]
    buckets.first[slot] = new
    counts[0] += 1
    counts[2] += 1


@lean
def _remove(buckets: Buckets) -> int:
    """Remove one of the nearest entries, and return its node."""
    counts = buckets.counts
    ring = len(buckets.first)
    while buckets.first[counts[4] % ring] < 0:
        counts[4] += 1
    slot = counts[4] % ring
    entry = int(buckets.first[slot])
    buckets.first[slot] = buckets.next[entry]
    buckets.next[entry] = counts[3]
    counts[3] = entry
    counts[2] -= 1
    return int(buckets.node[entry])


@njit
def fill_cost_to_go(
    places: Places, goals: ShortInts, region: ShortInts, near: Flags, ground: MetrePrices,
    distance: Singles, direction: Singles, parent: ShortInts,
) -> int:  # fmt: skip
    """Write the distance of the nodes from the goal, over 16 neighbours; return the work."""
    steps = _neighbours(places, ground)
    furthest = steps.lengths[STEPS - 1] * steps.most * steps.factors[-1]
    buckets = _buckets(places.spacing * steps.least, furthest)
    total = len(places.arcs)
    known = Tentative(
        distance, parent, np.full(total, -1, np.int32), np.zeros(total, np.bool_), region, near
    )
    for node in range(total):
        parent[node] = -1
        if near[region[node]]:
            distance[node] = inf
    for goal in goals:
        distance[goal] = 0.0
        known.target[goal] = goal
        _add(buckets, int(goal), 0.0)
    while buckets.counts[2] > 0:
        if not _has_room(buckets):
            buckets = _longer(buckets)
        _expand(places, steps, known, buckets, direction)
    return int(buckets.counts[0])


@lean
def _has_room(buckets: Buckets) -> bool:
    """Return whether there is room for all neighbours of a node."""
    return int(buckets.counts[1]) + STEPS * HEADINGS <= len(buckets.node)


@lean
def _expand(
    places: Places, steps: Neighbours, known: Tentative, buckets: Buckets, direction: Singles
) -> None:
    """Expand nodes, the nearest first, as long as there are some and the lists have room."""
    across = places.columns + 2 * RIM
    while buckets.counts[2] > 0 and _has_room(buckets):
        node = _remove(buckets)
        if known.closed[node]:
            continue
        known.closed[node] = True
        if known.target[node] < 0:
            far = int(known.target[known.parent[node]])
            known.target[node] = _node_ahead(node, far, known.distance, known.parent)
            place = int(places.home[node])
            ahead = int(places.home[known.target[node]])
            direction[node] = atan2(
                ahead // across - place // across, ahead % across - place % across
            )
        _relax(places, steps, known, buckets, node)


@lean
def _relax(
    places: Places, steps: Neighbours, known: Tentative, buckets: Buckets, node: int
) -> None:
    """Lower the distances of a node's neighbours, and add those that fell to the lists."""
    across = places.columns + 2 * RIM
    rounding = TO_GO.rounding * places.spacing
    distance = known.distance
    d = float(distance[node])
    place = int(places.home[node])
    factor = steps.ground.ratio[0, 0]
    for k in range(STEPS):
        there = place + STEP_ROWS[k] * across + STEP_COLUMNS[k]
        common = places.arcs[node] & places.masks[there]
        if common == 0:
            continue
        if k >= 8:
            common &= (
                places.masks[place + steps.between[k, 0]]
                | places.masks[place + steps.between[k, 1]]
            )
        if not steps.even:
            factor = ratio_between(steps.ground, there, place, steps.lengths[k])
        step = factor * steps.lengths[k]
        for other in range(places.first[there], places.first[there + 1]):
            if d + step >= distance[other] - rounding or not known.near[known.region[other]]:
                continue
            shared = common & places.arcs[other]
            if shared == 0:
                continue
            n = 0
            while shared & steps.aside[k, n] == 0:
                n += 1
            dd = d + step * steps.factors[n]
            if dd < distance[other] - rounding:
                distance[other] = dd
                known.parent[other] = node
                known.target[other] = -1
                known.closed[other] = False
                _add(buckets, other, dd)


@lean
def _node_ahead(node: int, far: int, distance: Singles, parent: ShortInts) -> int:
    """Return the node on the route that a node's direction points to; `far` is its parent's."""
    d = float(distance[node])
    if far < 0:  # lowered meanwhile
        far = int(parent[node])
    if d - distance[far] > TO_GO.ahead_at_most:
        far = node
        while parent[far] >= 0 and d - distance[far] < TO_GO.ahead:
            far = int(parent[far])
    return far


class Regions(NamedTuple):
    """Connected parts of the nodes within square blocks of places, and what links them."""

    of_node: ShortInts  # (nodes,): the region of each node of the places
    x: Floats  # (regions,): x of the middle of each region in the frame of the grid [m]
    y: Floats  # (regions,): y of that middle [m]
    home: ShortInts  # (regions,): place of each region with the most room
    head: ShortInts  # (regions,): first of its links, -1 where it has none
    to: ShortInts  # (links,): region that a link leads to
    after: ShortInts  # (links,): next link of the same region, or -1
    longer: Singles  # (links,): factor on its length along the nearest heading free on both sides


def regions_for(kernel: KernelProblem, enlarged: bool = False) -> Regions:
    """Return the regions of these nodes; see `places_for`."""
    places = places_for(kernel, enlarged)
    key = ("regions", kernel.body, enlarged)
    return tables_of(kernel.space).get(key, lambda: join_regions(places))


@njit
def join_regions(places: Places) -> Regions:
    """Return the regions of free configurations."""
    across = places.columns + 2 * RIM
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
    widest = np.empty(count, np.int32)
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
            widest[region] = place
        size[region] += 1.0
        block = _block_of(place, across)
        for k in range(NEIGHBOURS):
            there = place + STEP_ROWS[k] * across + STEP_COLUMNS[k]
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
    longer = np.empty(links, np.float32)
    for link in range(links):
        longer[link] = factors[steps[link]]
    to = to[:links].copy()
    after = after[:links].copy()
    return Regions(of_node, x, y, widest, head, to, after, longer)


@inner
def _flood(
    places: Places, of_node: ShortInts, node: int, region: int, block: int, stack: ShortInts
) -> ShortInts:
    """Give a region to all nodes that are joined to one within its block; return the stack."""
    across = places.columns + 2 * RIM
    of_node[node] = region
    stack[0] = node
    height = 1
    while height > 0:
        height -= 1
        here = int(stack[height])
        place = int(places.home[here])
        for k in range(NEIGHBOURS):
            there = place + STEP_ROWS[k] * across + STEP_COLUMNS[k]
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


@lean
def _block_of(place: int, across: int) -> int:
    """Return the number of a place's block."""
    return (place // across) // TO_GO.block * across + (place % across) // TO_GO.block


@njit
def fill_regions(
    regions: Regions,
    start: int,
    stop: int,
    margin: float,
    slack: float,
    leaving: bool,
    ground: MetrePrices,
    distance: Singles,
) -> int:
    """Write the distance of every region from `start`, or to it, until `limit`; return the work."""
    count = len(regions.x)
    closed = np.zeros(count, np.bool_)
    for region in range(count):
        distance[region] = inf
    queue = no_open(64)
    distance[start] = 0.0
    push(queue, 0.0, start)
    limit = inf
    work = 0
    while queue.size[0] > 0 and queue.f[0] <= limit:
        d = queue.f[0]
        region = pop(queue)
        if closed[region]:
            continue
        closed[region] = True
        if region == stop:
            limit = margin * d + slack
        home = int(regions.home[region])
        link = int(regions.head[region])
        while link >= 0:
            other = int(regions.to[link])
            longer = regions.longer[link]
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
            step = length * ratio_between(ground, first, last, max(length, 1e-9)) * longer
            if d + step < distance[other]:
                distance[other] = d + step
                queue = with_room(queue)
                push(queue, d + step, other)
    if queue.size[0] > 0:
        # ended early: regions not expanded lie beyond the limit
        for region in range(count):
            if not closed[region]:
                distance[region] = limit
    return work


@njit
def fill_outside(regions: Regions, near: Flags, back: Singles, distance: Singles) -> None:
    """Write the distances of the nodes outside the corridor, from those between regions.

    Distances among nodes exceed those between regions. The largest excess in the corridor is added,
    so that no search leaves it as long as a route remains inside.
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
