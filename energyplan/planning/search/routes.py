"""The way to go whose turns are counted, among the free configurations.

The distance to go leads along the shortest way, however much that turns; and where turning is dear
a longer way round may be much the cheaper one. So a search among the same nodes, that also knows
which way the robot faces, finds the way that is cheapest by its length and its turns. Where there
is room it takes long steps.
"""

from __future__ import annotations

from math import atan2, ceil, floor, hypot, inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import Flags, Ints, njit
from energyplan.path import Pose
from energyplan.planning.budget import Budget
from energyplan.planning.search.follow import chain_from, way_along
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.cost_to_go import (
    HEADINGS,
    RIM,
    STEPS,
    DistanceToGo,
    Places,
    headings_aside,
    node_at,
    to_and_fro,
)
from energyplan.planning.space.motions import (
    KernelProblem,
    motion_cost,
    price,
    surface_at,
    turn_prices,
)
from energyplan.planning.space.queues import (
    STEP_COLUMNS,
    STEP_ROWS,
    angle_between,
    pop,
    push,
    slot_of,
)

FACINGS = 16
"""Sectors of headings that the search tells apart."""

EXPANDED = 0.05
"""Units of work that looking at one of its states counts as."""

NEAR = 12.0
"""Distance from the goal within which the distance to go leads on, in distances between places."""

LEADING = 1.1
"""Factor on the distance to go by which it leads: a little above 1 the search is soon through."""

AGAIN = 1.4
"""Factor on the price of a step where a way found before passes."""

WAYS = 4
"""Ways that are sought, at most."""

OTHERS = 0.2
"""Part of what is left up to which another search is worth its work."""

SHARE = 0.8
"""Part of what is left that a search may take."""

SPARE = 1024
"""Room for the states that one leads to."""

MOST = 100_000
"""States that are looked at, at most."""


class Counted(NamedTuple):
    """A way whose turns are counted."""

    chain: Ints  # its nodes, from the start to the goal
    cost: float  # price of its length and turns
    looked: int  # states that were looked at


def passed_by(places: Places, chain: Ints, within: float) -> NDArray[np.bool_]:
    """Return the places within a distance of a way."""
    across = places.columns + 2 * RIM
    passed = np.zeros(len(places.masks), bool)
    far = ceil(within / places.spacing)
    aside = np.arange(-far, far + 1)
    near = np.hypot(aside[:, None], aside) * places.spacing <= within
    steps = (aside[:, None] * across + aside)[near]
    homes = np.unique(places.home[chain])
    about = (homes[:, None] + steps).ravel()
    passed[about[(about >= 0) & (about < len(passed))]] = True
    return passed


def ways_with_turns(setting: KernelProblem, to_go: DistanceToGo, budget: Budget) -> list[Segments]:
    """Return motions along the ways that are cheapest by their length and turns."""
    ways: list[Segments] = []
    passed = np.zeros(1, bool)
    for _ in range(WAYS):
        most = int(min(SHARE * budget.left / EXPANDED, MOST))
        if most < 1:
            break
        found = cheapest_chain(to_go, setting, passed, most)
        budget.spend(EXPANDED * found.looked)
        way = way_along(setting, to_go, budget, found.chain)
        if way is None:
            break
        ways.append(way)
        if EXPANDED * found.looked > OTHERS * budget.left:
            break
        passed = passed | passed_by(to_go.places, found.chain, setting.reach)
    return ways


@njit
def cheapest_chain(
    to_go: DistanceToGo, setting: KernelProblem, passed: Flags, most: int
) -> Counted:
    """Return the nodes along the way that is cheapest by its length and its turns.

    A* over nodes and facings, led by the distance to go.
    """
    places = to_go.places
    space = setting.space
    across = places.columns + 2 * RIM
    rows = len(places.masks) // across
    spacing = places.spacing
    sector = HEADINGS // FACINGS
    turn = 2.0 * pi / FACINGS
    per_metre = setting.least_metre
    turning = turn_prices(setting)
    per_turn = turning.min()
    here_turn = turning[0]
    even = setting.surface.size == 1
    forwards = price(setting.prices, 0, setting.half_track, 1.0, 0.0)
    backwards = price(setting.prices, 0, setting.half_track, -1.0, 0.0)
    aside = headings_aside()
    factors = to_and_fro()
    bits = np.empty(FACINGS, np.uint64)
    for b in range(FACINGS):
        bits[b] = np.uint64(0)
        for heading in range(b * sector - sector // 2, b * sector + sector // 2 + 1):
            bits[b] |= np.uint64(1) << np.uint64(heading % HEADINGS)
    beside = np.empty((STEPS, 2), np.int64)
    for k in range(STEPS):
        for side in range(2):
            half_r = floor(0.5 * STEP_ROWS[k]) if side == 0 else ceil(0.5 * STEP_ROWS[k])
            half_c = floor(0.5 * STEP_COLUMNS[k]) if side == 0 else ceil(0.5 * STEP_COLUMNS[k])
            beside[k, side] = half_r * across + half_c if k >= 8 else 0
    # steps along a facing: its direction is no further aside than a sector
    along = np.empty((FACINGS, STEPS), np.int64)
    many = np.zeros(FACINGS, np.int64)
    for b in range(FACINGS):
        for k in range(STEPS):
            off = angle_between(atan2(STEP_ROWS[k], STEP_COLUMNS[k]), b * turn)
            if min(off, pi - off) <= 1.01 * turn:
                along[b, many[b]] = k if off < 0.5 * pi else -k - 1
                many[b] += 1
    room = 4 * most + 2 * SPARE
    node_of = np.empty(room, np.int32)
    facing = np.empty(room, np.int8)
    parent = np.empty(room, np.int32)
    g = np.empty(room)
    h = np.empty(room)
    key = np.empty(room, np.int64)
    slots = 1 << 12
    while slots < 2 * room:
        slots *= 2
    table = np.full(slots, -1, np.int32)
    heap_f = np.empty(room)
    heap_state = np.empty(room, np.int32)
    none = np.empty(0, np.int64)
    start = node_at(to_go, space, setting.start)
    if start < 0 or to_go.distance[start] == inf:
        return Counted(none, inf, 0)
    count = 0
    size = 0
    yaw = setting.start.yaw - space.yaw
    goal_yaw = setting.goal.yaw - space.yaw
    best = -1
    least = inf
    for b in range(FACINGS):
        if places.arcs[start] & bits[b] != 0:
            node_of[count] = start
            facing[count] = b
            parent[count] = -1
            off = max(angle_between(b * turn, yaw) - 0.5 * turn, 0.0)
            if not even:
                here_turn = turning[surface_at(setting, setting.start)]
            g[count] = here_turn * off
            h[count] = _rest(to_go, start, b * turn, goal_yaw, per_metre, per_turn)
            key[count] = _key(places, setting, start, b)
            table[slot_of(table, key, key[count])] = count
            size = push(heap_f, heap_state, size, g[count] + h[count], count)
            count += 1
    looked = 0
    while size > 0 and looked < most and count + SPARE < room:
        f = heap_f[0]
        state = int(heap_state[0])
        size = pop(heap_f, heap_state, size)
        if f >= least:
            break
        if f > g[state] + h[state] + 1e-9:
            continue
        looked += 1
        node = int(node_of[state])
        b = int(facing[state])
        place = int(places.home[node])
        arc = places.arcs[node]
        row = place // across
        column = place % across
        along_x = (column - RIM + 0.5) * spacing
        along_y = (row - RIM + 0.5) * spacing
        x = space.x + space.cos * along_x - space.sin * along_y
        y = space.y + space.sin * along_x + space.cos * along_y
        if not even:
            here_turn = turning[surface_at(setting, Pose(x, y, space.yaw + b * turn))]
        if to_go.distance[node] <= NEAR * spacing:
            through = (
                g[state] + per_metre * float(to_go.distance[node])
                + here_turn * max(angle_between(b * turn, goal_yaw) - 0.5 * turn, 0.0)
            )  # fmt: skip
            if through < least:
                least = through
                best = state
        # a step is as long as there is room for
        stride = 1 << _level(places, setting, place)
        for n in range(many[b] + 2):
            there = place
            bb = b
            gg = g[state]
            common = arc
            if n < 2:
                bb = (b + 1) % FACINGS if n == 0 else (b + FACINGS - 1) % FACINGS
                gg += here_turn * turn
                common &= bits[bb]
                if common == 0:
                    continue
            else:
                k = int(along[b, n - 2])
                ahead = k >= 0
                k = k if ahead else -k - 1
                step = int(STEP_ROWS[k]) * across + int(STEP_COLUMNS[k])
                if stride == 4:
                    # nothing is in the way within the room there is
                    there += stride * step
                    r = row + stride * int(STEP_ROWS[k])
                    c = column + stride * int(STEP_COLUMNS[k])
                    if r < 0 or r >= rows or c < 0 or c >= across:
                        continue
                    common &= places.masks[there]
                for _ in range(stride if stride < 4 else 0):
                    if common == 0:
                        break
                    if k >= 8:
                        common &= (
                            places.masks[there + beside[k, 0]] | places.masks[there + beside[k, 1]]
                        )
                    there += step
                    common &= places.masks[there]
                if common & bits[b] == 0:
                    continue
                m = 0
                while common & bits[b] & aside[k, m] == 0:
                    m += 1
                length = stride * spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k]) * factors[m]
                if even:
                    paid = length * (forwards if ahead else backwards)
                else:
                    toward = atan2(STEP_ROWS[k], STEP_COLUMNS[k]) + space.yaw
                    pose = Pose(x, y, toward if ahead else toward + pi)
                    paid = motion_cost(setting, pose, length if ahead else -length, 0.0)
                if passed.size > 1 and passed[there]:
                    paid *= AGAIN
                gg += paid
            if gg >= least:
                continue
            for other in range(places.first[there], places.first[there + 1]):
                if there == place and other != node:
                    continue
                if common & bits[bb] & places.arcs[other] == 0:
                    continue
                kk = _key(places, setting, other, bb)
                slot = slot_of(table, key, kk)
                known = int(table[slot])
                if known >= 0 and gg >= g[known] - 1e-9:
                    continue
                hh = _rest(to_go, other, bb * turn, goal_yaw, per_metre, per_turn)
                if gg + hh >= least:
                    continue
                if known >= 0:
                    g[known] = -inf
                node_of[count] = other
                facing[count] = bb
                parent[count] = state
                g[count] = gg
                h[count] = hh
                key[count] = kk
                table[slot] = count
                size = push(heap_f, heap_state, size, gg + hh, count)
                count += 1
    if best < 0:
        return Counted(none, inf, looked)
    total = 0
    state = best
    while state >= 0:
        total += 1
        state = int(parent[state])
    rest = chain_from(to_go, int(to_go.after[node_of[best]]))
    chain = np.empty(total + len(rest), np.int64)
    at = 0
    state = best
    while state >= 0:
        node = int(node_of[state])
        if at == 0 or chain[at - 1] != node:
            chain[at] = node
            at += 1
        state = int(parent[state])
    for n in range(at // 2):
        node = int(chain[n])
        chain[n] = chain[at - 1 - n]
        chain[at - 1 - n] = node
    chain[at : at + len(rest)] = rest
    return Counted(chain[: at + len(rest)].copy(), least, looked)


@njit
def _level(places: Places, setting: KernelProblem, place: int) -> int:
    """Return how coarse the search is at a place: steps are of one place, two, or four."""
    spare = float(places.room[place]) - setting.reach
    return 2 if spare >= 9.0 * places.spacing else 1 if spare >= 0.0 else 0


@njit
def _key(places: Places, setting: KernelProblem, node: int, facing: int) -> int:
    """Return the cell of a state, larger where there is room, and its facing, as one number."""
    across = places.columns + 2 * RIM
    place = int(places.home[node])
    row = place // across
    column = place % across
    level = _level(places, setting, place)
    arc = node if level == 0 else (row >> level) * (across >> level) + (column >> level)
    return (arc * 4 + level) * FACINGS + facing


@njit
def _rest(
    to_go: DistanceToGo, node: int, yaw: float, goal_yaw: float, per_metre: float, per_turn: float
) -> float:
    """Estimate the price of the rest of the way."""
    far = float(to_go.distance[node])
    if far == inf:
        return inf
    turn = angle_between(yaw, goal_yaw)
    if far > to_go.far:
        ahead = float(to_go.direction[node])
        through = inf
        for way in range(2):
            heading = ahead + way * pi
            through = min(through, angle_between(yaw, heading) + angle_between(heading, goal_yaw))
        turn = max(turn, through)
    return LEADING * per_metre * far + per_turn * max(turn - pi / FACINGS, 0.0)
