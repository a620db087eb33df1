"""The way that a guide knows, driven: its places become poses, and exact steering joins these.

A guide leads from place to place, at each with the headings that are free there. What it costs to
turn decides which of them are taken. Where the body has little room every place is a pose, where it
has much a few are; of those within reach of each other the cheapest free motions are taken. So
gaps are passed that a lattice meets by chance only.
"""

from __future__ import annotations

from math import atan2, cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import Floats, FloatTable, Ints, ShortInts, njit
from energyplan.path import FloatArray, Pose
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.search.lattice import WEIGHT, Search, lattice_for
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.cost_to_go import (
    HEADINGS,
    RIM,
    CostToGo,
    Places,
    heading_of,
    middle_of,
    node_at,
    to_and_fro,
)
from energyplan.planning.space.motions import KernelProblem, join, pose_at, surface_at, turn_prices
from energyplan.planning.space.queues import angle_between, pop, push, slot_of
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy
from energyplan.terrain.collision import Body, pose_free

BLOCKED = 2
"""What is known of a pose that is not free; else the end from which it was reached, 0 or 1."""

BITS = 20
"""Bits of a place's number along either axis."""

NEIGHBOURS = 10
"""Neighbours of a pose: eight places, and two headings."""

STEP_I = np.array([1, 1, 0, -1, -1, -1, 0, 1, 0, 0])
STEP_J = np.array([0, 1, 1, 1, 0, -1, -1, -1, 0, 0])
STEP_H = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1, -1])
"""Steps to them."""


class Settings(NamedTuple):
    """Constants of following a route."""

    back: tuple[int, ...] = (1, 2, 3, 5, 8, 13, 21)  # how many poses back a pose is joined to
    stride: float = 0.5  # distance between poses over the room at them [1]
    beyond: tuple[int, ...] = (8, 20)  # poses that a short search leads further
    # its lattices' scales, expansions
    across: tuple[tuple[float, int], ...] = ((1.0, 600), (0.25, 1500))
    cell: float = 0.125  # cells of the bidirectional search over those of the route [1]
    spare: tuple[float, ...] = (0.5, 0.0)  # how much larger the body is in it [cells]
    wide: float = 3.0  # how much larger it is where it has room [its cells]
    most: int = 20_000  # poses tested at most, and motions along them
    aside: float = 4.0  # factor on the length of a step to the side [1]
    tight: float = 3.0  # factor on the length of a step where the body has no room [1]
    longest: int = 64  # poses that a motion along them leads further at most
    halvings: int = 8  # how often the way between two poses is halved until it is free


SETTINGS = Settings()


class Passage(NamedTuple):
    """Poses through a passage."""

    poses: FloatTable  # (n, 3): from one end to the other
    tests: int  # poses that were tested


@njit
def bidirectional_search(
    setting: KernelProblem,
    wide: Body,
    begin: Pose,
    end: Pose,
    cell: float,
    headings: int,
    most: int,
) -> Passage:
    """Return free poses that lead from one pose to another, step by step on a grid."""
    turn = 2.0 * pi / headings
    size = 16
    while size < 4 * most:
        size *= 2
    table = np.empty(size, np.int32)
    for k in range(size):
        table[k] = -1
    # the two ends, and those tested
    capacity = most + 2
    key = np.empty(capacity, np.int64)
    side = np.empty(capacity, np.int64)
    parent = np.empty(capacity, np.int32)
    done = np.empty(capacity, np.bool_)
    narrow = np.empty(capacity, np.bool_)
    g = np.empty(capacity)
    heap_f = np.empty((2, NEIGHBOURS * capacity))
    heap_node = np.empty((2, NEIGHBOURS * capacity), np.int32)
    sizes = np.zeros(2, np.int64)
    half = 1 << (BITS - 1)
    steps_i = STEP_I
    steps_j = STEP_J
    steps_h = STEP_H
    for who in range(2):
        i = floor((end.x - begin.x) / cell + 0.5) if who == 1 else 0
        j = floor((end.y - begin.y) / cell + 0.5) if who == 1 else 0
        h = floor((end.yaw - begin.yaw) / turn + 0.5) % headings if who == 1 else 0
        key[who] = ((i + half) << BITS | (j + half)) * headings + h
        side[who] = who
        parent[who] = -1
        done[who] = False
        narrow[who] = True
        g[who] = 0.0
        slot = slot_of(table, key, key[who])
        if table[slot] >= 0:
            # both ends are one place of the grid
            return Passage(_chain(parent, key, 0, 1, begin, end, cell, headings), 0)
        table[slot] = who
        sizes[who] = push(heap_f[who], heap_node[who], 0, 0.0, who)
    count = 2
    who = 1
    while True:
        who = 1 - who
        while sizes[who] > 0 and done[heap_node[who, 0]]:
            sizes[who] = pop(heap_f[who], heap_node[who], sizes[who])
        if sizes[who] == 0:
            return Passage(np.empty((0, 3)), count - 2)
        node = int(heap_node[who, 0])
        sizes[who] = pop(heap_f[who], heap_node[who], sizes[who])
        done[node] = True
        h = int(key[node] % headings)
        j = int(key[node] // headings & ((1 << BITS) - 1))
        i = int(key[node] // headings >> BITS)
        along = cos(begin.yaw + h * turn)
        across = sin(begin.yaw + h * turn)
        for k in range(NEIGHBOURS):
            to_h = (h + steps_h[k]) % headings
            to_key = ((i + steps_i[k]) << BITS | (j + steps_j[k])) * headings + to_h
            slot = slot_of(table, key, to_key)
            other = int(table[slot])
            if other >= 0 and side[other] == 1 - who:
                first = node if who == 0 else other
                second = other if who == 0 else node
                found = _chain(parent, key, first, second, begin, end, cell, headings)
                return Passage(found, count - 2)
            if other >= 0 and (side[other] == BLOCKED or done[other]):
                continue
            x = begin.x + (i + steps_i[k] - half) * cell
            y = begin.y + (j + steps_j[k] - half) * cell
            yaw = begin.yaw + to_h * turn
            if other < 0:
                if count == capacity:
                    return Passage(np.empty((0, 3)), most)
                other = count
                count += 1
                table[slot] = other
                key[other] = to_key
                done[other] = False
                g[other] = inf
                side[other] = BLOCKED
                if not pose_free(setting.space, setting.body, x, y, yaw):
                    continue
                side[other] = who
                narrow[other] = not pose_free(setting.space, wide, x, y, yaw)
            step = setting.reach * turn
            if steps_h[k] == 0:
                ahead = abs(along * steps_i[k] + across * steps_j[k])
                aside = abs(along * steps_j[k] - across * steps_i[k])
                step = cell * (ahead + SETTINGS.aside * aside)
            if narrow[other]:
                step *= SETTINGS.tight
            if g[node] + step < g[other]:
                g[other] = g[node] + step
                parent[other] = node
                goal = end if who == 0 else begin
                left = 2.0 * SETTINGS.aside * hypot(goal.x - x, goal.y - y)
                left += 2.0 * setting.reach * angle_between(goal.yaw, yaw)
                sizes[who] = push(heap_f[who], heap_node[who], sizes[who], g[other] + left, other)


@njit
def _chain(
    parent: ShortInts,
    key: Ints,
    first: int,
    second: int,
    begin: Pose,
    end: Pose,
    cell: float,
    headings: int,
) -> FloatTable:
    """Return the poses from the begin to a node, and from another one to the end."""
    before = 0
    node = first
    while node >= 0:
        before += 1
        node = int(parent[node])
    count = before
    node = second
    while node >= 0:
        count += 1
        node = int(parent[node])
    half = 1 << (BITS - 1)
    poses = np.empty((count, 3))
    node = first
    for k in range(count):
        if k == before:
            node = second
        at = before - 1 - k if k < before else k
        cells = key[node] // headings
        poses[at, 0] = begin.x + ((cells >> BITS) - half) * cell
        poses[at, 1] = begin.y + ((cells & ((1 << BITS) - 1)) - half) * cell
        poses[at, 2] = begin.yaw + (key[node] % headings) * (2.0 * pi / headings)
        node = int(parent[node])
    poses[count - 1, :] = end
    return poses


class Followed(NamedTuple):
    """How far motions along poses lead."""

    last: int  # the furthest pose that is reached
    motions: int  # number of motions to it
    tried: int  # pairs of poses that were tried


@njit
def follow(
    setting: KernelProblem, poses: FloatTable, limit: int, ds: Floats, dtheta: Floats
) -> Followed:
    """Write motions along poses, each as far along them as one is free."""
    part_ds = np.empty(MAX_SEGMENTS)
    part_dtheta = np.empty(MAX_SEGMENTS)
    last = len(poses) - 1
    at = 0
    written = 0
    tried = 0
    here = pose_at(poses, 0)
    far = SETTINGS.longest
    while at < last and tried < limit and written + MAX_SEGMENTS <= len(ds):
        # so many poses further, or that part of the way to the next one
        far = min(4 * far, SETTINGS.longest)
        part = 1.0
        moved = False
        while not moved and part > 0.5**SETTINGS.halvings and tried < limit:
            to = min(at + far, last)
            turn = pi - (pi - (poses[to, 2] - here.yaw)) % (2.0 * pi)
            there = Pose(
                here.x + part * (poses[to, 0] - here.x),
                here.y + part * (poses[to, 1] - here.y),
                here.yaw + part * turn,
            )
            tried += 1
            cost, n = join(setting, here, there, inf, part_ds, part_dtheta)
            if cost < inf:
                moved = True
                for s in range(n):
                    ds[written + s] = part_ds[s]
                    dtheta[written + s] = part_dtheta[s]
                written += n
                here = there
                if part == 1.0:
                    at = to
            elif far > 1:
                far //= 2
            else:
                part *= 0.5
        if not moved:
            break
    return Followed(at, written, tried)


class Tracked(NamedTuple):
    """How far motions along the way to go lead."""

    motions: Segments | None  # the motions, free of collisions
    x: float  # the place that they lead to [m]
    y: float  # the place that they lead to [m]


def motions_along(
    setting: KernelProblem,
    to_go: CostToGo,
    budget: Budget,
    chain: NDArray[np.int64] | None = None,
) -> Segments | None:
    """Return motions along a route; None where they do not lead to the goal."""
    return follow_route(setting, to_go, budget, chain).motions


def follow_route(
    setting: KernelProblem,
    to_go: CostToGo,
    budget: Budget,
    chain: NDArray[np.int64] | None = None,
) -> Tracked:
    """Find motions along the way to go."""
    chain = chain_along(to_go, setting) if chain is None else chain
    poses = poses_along(to_go.places, setting, chain)
    parts: list[Segments] = []
    at, end = 0, len(poses) - 1
    while at < end and not budget.over:
        ds, dtheta = np.empty((2, (end - at) * MAX_SEGMENTS))
        limit = int(min(budget.left / UNITS.join, 1 << 40))
        found = join_poses(setting, poses[at:], limit, ds, dtheta)
        budget.spend(UNITS.join * found.tried)
        parts.append(Segments(ds[: found.motions], dtheta[: found.motions]))
        at += found.last
        for beyond in SETTINGS.beyond if at < end else ():
            ahead = min(at + beyond, end)
            crossing = _across(setting, to_go, poses[at], poses[ahead], budget)
            if crossing is not None:
                parts.append(crossing)
                at = ahead
                break
        else:
            break
    x, y = poses[at, :2].tolist() if len(poses) else setting.start[:2]
    if at < end or not parts:
        return Tracked(None, x, y)
    return Tracked(Segments(*(np.concatenate([part[n] for part in parts]) for n in range(2))), x, y)


def _across(
    setting: KernelProblem, to_go: CostToGo, begin: FloatArray, end: FloatArray, budget: Budget
) -> Segments | None:
    """Return the motions that short searches find from one pose to another, if they find any."""
    part = setting._replace(start=Pose(*begin.tolist()), goal=Pose(*end.tolist()))
    for scale, most in SETTINGS.across:
        search = Search(part, to_go, lattice_for(setting, scale), WEIGHT)
        search.run(budget, most)
        if search.found:
            return search.segments()
    cell = to_go.places.spacing * SETTINGS.cell
    return _threaded(setting, part.start, part.goal, cell, budget)


def _threaded(
    setting: KernelProblem, begin: Pose, end: Pose, cell: float, budget: Budget
) -> Segments | None:
    """Return motions along free poses that lie close together, if there are such."""
    for part in SETTINGS.spare:
        most = int(min(SETTINGS.most, budget.left / UNITS.pose))
        spare, wide = (grown(setting.body, much * cell) for much in (part, SETTINGS.wide))
        tested = setting._replace(body=spare)
        found = bidirectional_search(tested, wide, begin, end, cell, 2 * HEADINGS, most)
        budget.spend(UNITS.pose * found.tests)
        if len(found.poses):
            ds, dtheta = np.empty((2, SETTINGS.most))
            limit = int(min(budget.left / UNITS.follow, SETTINGS.most))
            led = follow(setting, found.poses, limit, ds, dtheta)
            budget.spend(UNITS.follow * led.tried)
            if led.last == len(found.poses) - 1:
                return Segments(ds[: led.motions], dtheta[: led.motions])
    return None


@njit
def chain_along(to_go: CostToGo, setting: KernelProblem) -> Ints:
    """Return the nodes from the start to the goal; none where the way is not known."""
    start = node_at(to_go, setting.space, setting.start)
    return chain_from(to_go, start if start >= 0 and to_go.distance[start] < inf else -1)


@njit
def chain_from(to_go: CostToGo, node: int) -> Ints:
    """Return a node and those after it, up to the goal; none for -1."""
    first = node
    count = 0
    while node >= 0:
        count += 1
        node = int(to_go.after[node])
    chain = np.empty(count, np.int64)
    node = first
    for k in range(count):
        chain[k] = node
        node = int(to_go.after[node])
    return chain


@njit
def poses_along(places: Places, setting: KernelProblem, chain: Ints) -> FloatTable:
    """Return poses along a way, from the start to the goal; none where it has no nodes."""
    space = setting.space
    count = len(chain)
    if count == 0:
        return np.empty((0, 3))
    across = places.columns + 2 * RIM
    turn = 2.0 * pi / HEADINGS
    turning = turn_prices(setting)
    even = setting.surface.size == 1
    per_turn = turning[0] * turn
    aside = to_and_fro()
    # cost of being at a place with a heading, before and after the turn there
    cost = np.empty(HEADINGS)
    came = np.empty((count, HEADINGS), np.int64)
    first = heading_of(space, setting.start.yaw)
    last = heading_of(space, setting.goal.yaw)
    if not even:
        kind = surface_at(setting, setting.start)
        per_turn = turning[kind] * turn
    for h in range(HEADINGS):
        off = abs(h - first)
        cost[h] = per_turn * min(off, HEADINGS - off)
    free = np.uint64(0)
    for k in range(count):
        free_before = free
        free = either_way(places, int(chain[k]))
        if not even:
            x, y = middle_of(places, space, int(places.home[chain[k]]))
            per_turn = turning[surface_at(setting, Pose(x, y, setting.start.yaw))] * turn
        if k > 0:
            row = places.home[chain[k]] // across - places.home[chain[k - 1]] // across
            column = places.home[chain[k]] % across - places.home[chain[k - 1]] % across
            length = setting.least_metre * places.spacing * hypot(row, column)
            way = atan2(row, column) / turn
            shared = free & free_before
            for h in range(HEADINGS):
                if shared & (np.uint64(1) << np.uint64(h)) == 0:
                    cost[h] = inf
                    continue
                aslant = abs(h - way) % (HEADINGS // 2)
                aslant = min(aslant, HEADINGS // 2 - aslant)
                cost[h] += length * aside[int(aslant + 0.5)]
        for h in range(HEADINGS):
            came[k, h] = h
            if free & (np.uint64(1) << np.uint64(h)) == 0 and k > 0:
                cost[h] = inf
        for way in range(2):
            for n in range(2 * HEADINGS):
                h = n % HEADINGS if way == 0 else HEADINGS - 1 - n % HEADINGS
                g = (h + 1) % HEADINGS if way == 0 else (h + HEADINGS - 1) % HEADINGS
                turns = free & (np.uint64(1) << np.uint64(g)) != 0
                if turns and cost[h] + per_turn < cost[g]:
                    cost[g] = cost[h] + per_turn
                    came[k, g] = came[k, h]
    best = inf
    heading = last
    for h in range(HEADINGS):
        off = abs(h - last)
        total = cost[h] + per_turn * min(off, HEADINGS - off)
        if total < best:
            best = total
            heading = h
    # what is kept of these, from the goal back
    poses = np.empty((2 * count + 2, 3))
    kept = 1
    poses[0, :] = setting.goal
    gone = 0.0
    for k in range(count - 1, -1, -1):
        place = int(places.home[chain[k]])
        along = (place % across - RIM + 0.5) * places.spacing
        up = (place // across - RIM + 0.5) * places.spacing
        before = int(came[k, heading])
        if k < count - 1:
            other = int(places.home[chain[k + 1]])
            gone += places.spacing * hypot(
                place // across - other // across, place % across - other % across
            )
        room = float(places.room[place])
        if before != heading or room < setting.reach or gone >= SETTINGS.stride * room or k == 0:
            for part in range(1 if before == heading else 2):
                yaw = space.yaw + (heading if part == 0 else before) * turn
                pose = _free_in(setting, along, up, yaw, places.spacing)
                poses[kept, 0] = pose.x
                poses[kept, 1] = pose.y
                poses[kept, 2] = yaw
                kept += 1
            gone = 0.0
        heading = before
    poses[kept, :] = setting.start
    return poses[: kept + 1][::-1].copy()


@njit
def either_way(places: Places, node: int) -> np.uint64:
    """Return the free headings of a node and those opposite: the way is as long facing either."""
    arc = places.arcs[node]
    half = np.uint64(HEADINGS // 2)
    return np.uint64(places.masks[places.home[node]] & (arc | arc << half | arc >> half))


@njit
def _free_in(setting: KernelProblem, along: float, up: float, yaw: float, spacing: float) -> Pose:
    """Return the free pose of a place that is nearest to its middle; its middle where none is."""
    space = setting.space
    several = max(int(spacing / space.resolution + 0.5), 1)
    best = Pose(
        space.x + space.cos * along - space.sin * up,
        space.y + space.sin * along + space.cos * up,
        yaw,
    )
    if several == 1 or pose_free(space, setting.body, best.x, best.y, yaw):
        return best
    nearest = inf
    for row in range(several):
        for column in range(several):
            dx = ((column + 0.5) / several - 0.5) * spacing
            dy = ((row + 0.5) / several - 0.5) * spacing
            if hypot(dx, dy) >= nearest:
                continue
            x = space.x + space.cos * (along + dx) - space.sin * (up + dy)
            y = space.y + space.sin * (along + dx) + space.cos * (up + dy)
            if pose_free(space, setting.body, x, y, yaw):
                nearest = hypot(dx, dy)
                best = Pose(x, y, yaw)
    return best


@njit
def join_poses(
    setting: KernelProblem, poses: FloatTable, limit: int, ds: Floats, dtheta: Floats
) -> Followed:
    """Write the cheapest motions from the first pose to the furthest one that is reached."""
    count = len(poses)
    part_ds = np.empty(MAX_SEGMENTS)
    part_dtheta = np.empty(MAX_SEGMENTS)
    best = np.empty(count)
    before = np.empty(count, np.int64)
    best[0] = 0.0
    before[0] = -1
    tried = 0
    for j in range(1, count):
        best[j] = inf
        before[j] = -1
        for back in SETTINGS.back:
            i = j - back
            if i < 0 or tried >= limit:
                break
            left = best[j] - best[i]
            if not left > 0.0:
                continue
            dx = poses[j, 0] - poses[i, 0]
            dy = poses[j, 1] - poses[i, 1]
            if steer_energy(dx, dy, poses[i, 2], poses[j, 2], setting.steering) >= left:
                continue
            tried += 1
            cost, _ = join(
                setting, pose_at(poses, i), pose_at(poses, j), left, part_ds, part_dtheta
            )
            if cost < left:
                best[j] = best[i] + cost
                before[j] = i
    last = count - 1
    while best[last] == inf:
        last -= 1
    order = np.empty(count, np.int64)
    n = 0
    j = last
    while j >= 0:
        order[n] = j
        n += 1
        j = before[j]
    written = 0
    for k in range(n - 1, 0, -1):
        i = order[k]
        j = order[k - 1]
        _, m = join(setting, pose_at(poses, i), pose_at(poses, j), inf, part_ds, part_dtheta)
        for s in range(m):
            ds[written + s] = part_ds[s]
            dtheta[written + s] = part_dtheta[s]
        written += m
    return Followed(last, written, tried)
