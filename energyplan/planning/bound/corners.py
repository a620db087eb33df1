"""Kernels of the lower bound: a search over the corners of the obstacles (docs/planner.md).

What is kept for each line between two corners is a function of the heading, at `HEADINGS` nodes
around the circle: the least cost at which any way of the disc that is drawn taut along this line
can have got there.
"""

from __future__ import annotations

from math import atan2, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import (
    Flags,
    FlagTable,
    Floats,
    FloatTable,
    ShortInts,
    ShortIntTable,
    inner,
    njit,
)
from energyplan.planning.bound.line import (
    HEADINGS,
    Rates,
    Section,
    along_line,
    from_start,
    gate,
    no_tables,
    pass_gate,
    to_end,
)
from energyplan.planning.bound.outline import Links, Outline, linked, side, sight
from energyplan.planning.space.queues import (
    angle_between,
    pop,
    push,
    with_room,
)
from energyplan.terrain.collision import Body, Space


class Ends(NamedTuple):
    """Start and goal of the disc's centre [m]."""

    start_x: float
    start_y: float
    goal_x: float
    goal_y: float


class Ways(NamedTuple):
    """Shortest ways to the goal."""

    to_goal: Floats  # (n,): at least how far the goal is from each corner [m]
    from_start: Floats  # (n,): from the start to each corner in its sight, else infinite [m]
    at_goal: Floats  # (n,): from the goal to each corner in its sight, else infinite [m]
    least: float  # at least how far the goal is from the start [m]
    direct: bool  # whether the start sees the goal
    steps: float  # steps taken
    final: bool  # whether the search came to its end
    links: Links  # what is known of the corners now


@inner
def _seen_from(
    space: Space, outline: Outline, x: float, y: float, other_x: float, other_y: float,
    limit: float, out: Floats,
) -> float:  # fmt: skip
    """Fill in the lengths of the lines from a point to the corners; return the steps it took."""
    steps = float(len(out))
    for v in range(len(out)):
        out[v] = inf
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        length = hypot(dx, dy)
        beyond = hypot(outline.point[v, 0] - other_x, outline.point[v, 1] - other_y)
        if length < 1e-12 or length + beyond >= limit or side(outline, v, dx, dy) == 0:
            continue
        met = sight(space, outline, x, y, outline.point[v, 0], outline.point[v, 1])
        steps += 10.0 * met.steps
        if met.free:
            out[v] = length
    return steps


@njit
def ways_to_goal(
    space: Space,
    outline: Outline,
    links: Links,
    paid: Flags,
    ends: Ends,
    limit: float,
    effort: float,
) -> Ways:
    """Return the shortest ways to the goal from all corners that a short way can touch.

    A* from the goal, over lines that touch the outline at both ends: shortest ways are made of
    these.
    """
    n = len(outline.point)
    ux = ends.start_x
    uy = ends.start_y
    from_start = np.empty(n)
    at_goal = np.empty(n)
    to_goal = np.empty(n)
    settled = np.empty(n, np.bool_)
    steps = _seen_from(space, outline, ux, uy, ends.goal_x, ends.goal_y, limit, from_start)
    steps += _seen_from(space, outline, ends.goal_x, ends.goal_y, ux, uy, limit, at_goal)
    direct = sight(space, outline, ux, uy, ends.goal_x, ends.goal_y).free
    heap_f = np.empty(1 << 12)
    heap_node = np.empty(1 << 12, np.int32)
    size = 0
    for v in range(n):
        settled[v] = False
        to_goal[v] = at_goal[v]
        f = at_goal[v] + hypot(outline.point[v, 0] - ux, outline.point[v, 1] - uy)
        if f < limit:
            heap_f, heap_node = with_room(heap_f, heap_node, size)
            size = push(heap_f, heap_node, size, f, v)
    least = hypot(ends.goal_x - ux, ends.goal_y - uy) if direct else inf
    frontier = limit
    final = True
    while size > 0:
        f = heap_f[0]
        at = int(heap_node[0])
        size = pop(heap_f, heap_node, size)
        if settled[at]:
            continue
        if steps > effort:
            frontier = f
            final = False
            break
        settled[at] = True
        here = to_goal[at]
        least = min(least, here + from_start[at])
        links = linked(space, outline, links, at)
        if not paid[at]:
            paid[at] = True
            steps += links.steps[at]
        begin = int(links.first[at])
        for i in range(begin, begin + links.number[at]):
            v = int(links.seen[i])
            dx = outline.point[v, 0] - outline.point[at, 0]
            dy = outline.point[v, 1] - outline.point[at, 1]
            there = here + hypot(dx, dy)
            if settled[v] or there >= to_goal[v]:
                continue
            to_goal[v] = there
            f = there + hypot(outline.point[v, 0] - ux, outline.point[v, 1] - uy)
            if f < limit:
                heap_f, heap_node = with_room(heap_f, heap_node, size)
                size = push(heap_f, heap_node, size, f, v)
    for v in range(n):
        if not settled[v]:
            away = hypot(outline.point[v, 0] - ux, outline.point[v, 1] - uy)
            straight = hypot(outline.point[v, 0] - ends.goal_x, outline.point[v, 1] - ends.goal_y)
            to_goal[v] = max(straight, frontier - away)
    return Ways(to_goal, from_start, at_goal, min(least, frontier), direct, steps, final, links)


FRESH, FREE, BARRED = 0, 1, 2
"""What is known of the gates of a line: nothing, that all headings pass, that some do not."""


class Lines(NamedTuple):
    """Lines between corners in use, one a row."""

    before: FloatTable  # (lines, HEADINGS): least cost by heading before each
    tail: ShortInts  # (lines,): corner at which each begins; `n` for the start
    head: ShortInts  # (lines,): corner at which each ends; ``n + 1`` for the goal
    waiting: Flags  # (lines,): whether each is to be looked at
    gates: ShortIntTable  # (2, lines): what is known of the first and the second gate of each
    width: FloatTable  # (lines, 2): how far out these are crossed at most [m]
    closed: FlagTable  # headings that these do not let through, those of one line after the other


@inner
def _no_lines(rows: int) -> Lines:
    before = np.empty((rows, HEADINGS))
    gates = np.empty((2, rows), np.int32)
    width = np.empty((rows, 2))
    waiting = np.empty(rows, np.bool_)
    for k in range(rows):
        gates[0, k] = FRESH
        gates[1, k] = FRESH
        waiting[k] = False
        for j in range(HEADINGS):
            before[k, j] = inf
    return Lines(
        before, np.empty(rows, np.int32), np.empty(rows, np.int32), waiting, gates, width,
        np.empty((2 * rows, HEADINGS), np.bool_),
    )  # fmt: skip


@inner
def _more_lines(lines: Lines) -> Lines:
    rows = len(lines.tail)
    more = _no_lines(2 * rows)
    for k in range(rows):
        more.tail[k] = lines.tail[k]
        more.head[k] = lines.head[k]
        more.waiting[k] = lines.waiting[k]
        for which in range(2):
            more.gates[which, k] = lines.gates[which, k]
            more.width[k, which] = lines.width[k, which]
        for j in range(HEADINGS):
            more.before[k, j] = lines.before[k, j]
            more.closed[2 * k, j] = lines.closed[2 * k, j]
            more.closed[2 * k + 1, j] = lines.closed[2 * k + 1, j]
    return more


@inner
def _measure_gates(
    space: Space, body: Body, outline: Outline, goal_yaw: float, lines: Lines, line: int,
    ux: float, uy: float, x: float, y: float, behind: int, about: int,
) -> None:  # fmt: skip
    """Measure the gates at both ends of a line from (ux, uy), where no start or goal is there."""
    ix = x - ux
    iy = y - uy
    length = hypot(ix, iy)
    for which in range(2):
        lines.gates[which, line] = FREE
        on = behind if which == 0 else about
        if on == 0:
            continue
        width, barred = gate(
            space, body, outline, goal_yaw,
            ux if which == 0 else x, uy if which == 0 else y,
            on * iy / length, -on * ix / length, lines.closed[2 * line + which],
        )  # fmt: skip
        lines.width[line, which] = width
        if barred:
            lines.gates[which, line] = BARRED


@inner
def _lower(before: Floats, cost: Floats, to_goal: Floats) -> float:
    """Lower the costs before a line; return the least cost to the goal of those that fell."""
    better = inf
    for j in range(HEADINGS):
        if cost[j] < before[j] - 1e-9:
            before[j] = cost[j]
            better = min(better, cost[j] + to_goal[j])
    return better


@inner
def _unused(count: int, used: ShortInts) -> ShortInts:
    """Return numbers of lines, -1 where none is: first those in use."""
    out = np.empty(count, np.int32)
    for k in range(count):
        out[k] = used[k] if k < len(used) else -1
    return out


class Least(NamedTuple):
    """What the search over corners found."""

    value: float  # the bound
    final: bool  # whether the search came to its end
    links: Links  # what is known of the corners now
    steps: float  # steps taken


@njit
def least_over_corners(
    space: Space,
    body: Body,
    outline: Outline,
    paid: Flags,
    ends: Ends,
    ways: Ways,
    rates: Rates,
    limit: float,
    effort: float,
    steer: bool,
) -> Least:
    """Return a lower bound on the cost of going from start to goal, at most `limit`.

    A* over lines between corners, each with its costs by heading. A taut way turns at a corner
    only around the obstacle there. What is left to go is estimated by the shortest way.
    """
    n = len(outline.point)
    start = n
    goal = n + 1
    turn = rates.radian * 2.0 * pi / HEADINGS
    tables = no_tables()
    to_goal = np.empty(HEADINGS)
    cost = np.empty(HEADINGS)
    for j in range(HEADINGS):
        heading = rates.goal + j * 2.0 * pi / HEADINGS
        to_goal[j] = rates.radian * angle_between(heading, rates.goal)
        cost[j] = rates.radian * angle_between(heading, rates.start)
    if ways.direct:
        limit = min(limit, rates.direct)
    links = ways.links
    lines = _no_lines(256)
    none = np.empty(0, np.int32)
    of_link = _unused(len(links.seen), none)
    of_start = _unused(n, none)
    of_goal = _unused(n, none)
    heap_f = np.empty(1 << 12)
    heap_node = np.empty(1 << 12, np.int32)
    count = 0
    size = 0
    steps = 0.0
    at = start
    about = 0
    ix = 0.0
    iy = 0.0
    while True:
        lowest = inf
        for j in range(HEADINGS):
            lowest = min(lowest, cost[j] + to_goal[j])
        many = 0
        begin = 0
        if lowest < limit:
            if at == start:
                many = n
            else:
                links = linked(space, outline, links, at)
                if not paid[at]:
                    paid[at] = True
                    steps += links.steps[at]
                if len(of_link) < len(links.seen):
                    of_link = _unused(len(links.seen), of_link)
                begin = int(links.first[at])
                many = links.number[at] + 1
        # at the goal there is nothing to look at
        x = ends.start_x if at == start else outline.point[min(at, n - 1), 0]
        y = ends.start_y if at == start else outline.point[min(at, n - 1), 1]
        steps += 10.0 * many
        for i in range(many):
            # the last one is the goal, except from the start, where it is known already
            v = i if at == start else goal if i == many - 1 else int(links.seen[begin + i])
            if v == goal:
                if ways.at_goal[at] == inf:
                    continue
                dx = ends.goal_x - x
                dy = ends.goal_y - y
                rest = ways.at_goal[at]
            else:
                if at == start and ways.from_start[v] == inf:
                    continue
                dx = outline.point[v, 0] - x
                dy = outline.point[v, 1] - y
                rest = hypot(dx, dy) + ways.to_goal[v]
            length = hypot(dx, dy)
            if lowest + rates.metre * rest >= limit:
                continue
            if at != start and (
                (ix * dy - iy * dx) * about < -1e-9 * length or side(outline, at, dx, dy) != about
            ):
                continue
            line = int(
                of_start[v] if at == start else of_goal[at] if v == goal else of_link[begin + i]
            )
            if line < 0:
                if count == len(lines.tail):
                    lines = _more_lines(lines)
                line = count
                count += 1
                if at == start:
                    of_start[v] = line
                elif v == goal:
                    of_goal[at] = line
                else:
                    of_link[begin + i] = line
                lines.tail[line] = at
                lines.head[line] = v
            steps += 300.0
            f = _lower(lines.before[line], cost, to_goal) + rates.metre * rest
            if f < limit:
                heap_f, heap_node = with_room(heap_f, heap_node, size)
                lines.waiting[line] = True
                size = push(heap_f, heap_node, size, f, line)
        line = -1
        f = limit
        while size > 0 and line < 0:
            f = heap_f[0]
            if lines.waiting[heap_node[0]]:
                line = int(heap_node[0])
            size = pop(heap_f, heap_node, size)
        if line < 0 or f >= limit:
            return Least(limit, True, links, steps)
        if steps > effort:
            return Least(f, False, links, steps)
        lines.waiting[line] = False
        u = int(lines.tail[line])
        at = int(lines.head[line])
        ux = ends.start_x if u == start else outline.point[u, 0]
        uy = ends.start_y if u == start else outline.point[u, 1]
        x = ends.goal_x if at == goal else outline.point[at, 0]
        y = ends.goal_y if at == goal else outline.point[at, 1]
        ix = x - ux
        iy = y - uy
        length = hypot(ix, iy)
        behind = 0 if u == start else side(outline, u, ix, iy)
        about = 0 if at == goal else side(outline, at, ix, iy)
        for j in range(HEADINGS):
            cost[j] = lines.before[line, j]
        steps += 15000.0
        if lines.gates[0, line] == FRESH:
            steps += 30000.0
            _measure_gates(
                space, body, outline, rates.goal, lines, line, ux, uy, x, y, behind, about
            )
        if lines.gates[0, line] == BARRED:
            pass_gate(cost, lines.closed[2 * line], turn)
        past = along_line(
            cost,
            atan2(iy, ix),
            length,
            rates,
            about != -1 and behind != 1,
            about != 1 and behind != -1,
        )
        if steer and u == start:
            section = Section(
                ix, iy, about * iy / length, -about * ix / length, lines.width[line, 1]
            )
            rest = rates.metre * ways.to_goal[at]
            steps += from_start(past, section, to_goal, limit - rest, rates, tables)
        elif steer and at == goal:
            section = Section(
                ix, iy, -behind * iy / length, behind * ix / length, lines.width[line, 0]
            )
            reached = to_end(cost, section, to_goal, limit, rates, tables)
            steps += reached.steps
            past[0] = max(past[0], reached.cost)
        cost = past
        if at == goal:
            limit = min(limit, cost[0])
            for j in range(HEADINGS):
                cost[j] = inf
            continue
        if lines.gates[1, line] == BARRED:
            pass_gate(cost, lines.closed[2 * line + 1], turn)
