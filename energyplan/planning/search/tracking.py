"""Route tracking: a route over cells and heading intervals becomes collision-free motions.

Dynamic programming chooses the headings along the route by what turning costs, then the exact joins
between poses of the route. Where the body has little room every cell gives a pose, where it has
much a few do. So gaps are passed that a lattice meets by chance only.
"""

from __future__ import annotations

from math import atan2, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, Ints, inner, lean, njit
from energyplan.path import FloatArray, Pose
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.narrow.bidirectional import Followed, through_passage
from energyplan.planning.settings import TRACKING
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import HEADINGS
from energyplan.planning.space.cost_to_go import CostToGo, node_at
from energyplan.planning.space.motions import (
    KernelProblem,
    join,
    pose_at,
    put_pose,
    surface_at,
    turn_prices,
)
from energyplan.planning.space.places import RIM, Places, heading_of, middle_of, to_and_fro
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy
from energyplan.terrain.collision import pose_free, poses_free


class Tracked(NamedTuple):
    """How far motions along a route lead."""

    motions: Segments | None  # the motions, free of collisions
    x: float  # x of the place that they lead to [m]
    y: float  # y of that place [m]


def track_route(
    setting: KernelProblem, to_go: CostToGo, budget: Budget, chain: Ints | None = None
) -> Tracked:
    """Find motions along a route, the shortest one unless its nodes are given."""
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
        free = poses_free(setting.space, setting.body, poses[at + 1 :])
        for beyond in TRACKING.beyond if at < end else ():
            # the next free pose from there on, the goal if none is
            ahead = min(at + beyond, end)
            ahead += int(np.argmax(np.append(free[ahead - at - 1 : -1], True)))
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
    for scale, most in TRACKING.across:
        search = Search(part, to_go, lattice_for(setting, scale))
        search.run(budget, most)
        if search.found:
            return search.segments()
    return through_passage(setting, part.start, part.goal, to_go.places.spacing, budget)


@njit
def chain_along(to_go: CostToGo, setting: KernelProblem) -> Ints:
    """Return the nodes from the start to the goal; none where the way is not known."""
    start = node_at(to_go, setting.space, setting.start)
    return chain_from(to_go, start if start >= 0 and to_go.distance[start] < inf else -1)


@inner
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
                bins = abs(h - way) % HEADINGS
                bins = min(bins, HEADINGS - bins)
                aslant = min(bins, HEADINGS // 2 - bins)
                backwards = bins > HEADINGS // 4 and setting.gear != 0
                cost[h] += inf if backwards else length * aside[int(aslant + 0.5)]
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
    put_pose(poses, 0, setting.goal)
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
        if before != heading or room < setting.reach or gone >= TRACKING.stride * room or k == 0:
            for part in range(1 if before == heading else 2):
                yaw = space.yaw + (heading if part == 0 else before) * turn
                pose = _free_in(setting, along, up, yaw, places.spacing)
                poses[kept, 0] = pose.x
                poses[kept, 1] = pose.y
                poses[kept, 2] = yaw
                kept += 1
            gone = 0.0
        heading = before
    put_pose(poses, kept, setting.start)
    return poses[: kept + 1][::-1].copy()


@lean
def either_way(places: Places, node: int) -> np.uint64:
    """Return the free headings of a node and those opposite: the way is as long facing either."""
    arc = places.arcs[node]
    half = np.uint64(HEADINGS // 2)
    return np.uint64(places.masks[places.home[node]] & (arc | arc << half | arc >> half))


@lean
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
        for back in TRACKING.back:
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
