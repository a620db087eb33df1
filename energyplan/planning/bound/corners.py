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
    lean,
    njit,
)
from energyplan.planning.bound.line import (
    HEADINGS,
    Beyond,
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
from energyplan.planning.space.queues import Open, angle_between, no_open, pop, push, with_room
from energyplan.terrain.collision import Body, Space


class DiscEnds(NamedTuple):
    """Start and goal of the disc's centre [m]."""

    start_x: float
    start_y: float
    goal_x: float
    goal_y: float


class Ways(NamedTuple):
    """Shortest ways to the goal: in metres, or in the unit of the forces that measure them."""

    to_goal: Floats  # (n,): at least how far the goal is from each corner
    from_start: Floats  # (n,): from the start to each corner in its sight, else infinite
    at_goal: Floats  # (n,): from the goal to each corner in its sight, else infinite
    least: float  # at least how far the goal is from the start
    direct: bool  # whether the start sees the goal
    steps: float  # steps taken
    final: bool  # whether the search came to its end
    links: Links  # what is known of the corners now


@lean
def extent(forces: FloatTable, dx: float, dy: float) -> float:
    """Return the greatest work of any force along a line, or its length where none is given."""
    if len(forces) == 0:
        return hypot(dx, dy)
    most = 0.0
    for k in range(len(forces)):
        most = max(most, abs(forces[k, 0] * dx + forces[k, 1] * dy))
    return most


@lean
def _seen_from(
    space: Space, outline: Outline, forces: FloatTable, x: float, y: float, other_x: float,
    other_y: float, limit: float, out: Floats,
) -> float:  # fmt: skip
    """Fill in the lengths of the lines from a point to the corners; return the steps it took."""
    steps = float(len(out))
    for v in range(len(out)):
        out[v] = inf
        dx = outline.point[v, 0] - x
        dy = outline.point[v, 1] - y
        length = extent(forces, dx, dy)
        beyond = extent(forces, outline.point[v, 0] - other_x, outline.point[v, 1] - other_y)
        none = hypot(dx, dy) < 1e-12
        if none or length + beyond >= limit or side(outline, v, dx, dy) == 0:
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
    ends: DiscEnds,
    forces: FloatTable,
    limit: float,
    effort: float,
    around: float,
) -> Ways:
    """Return the shortest ways to the goal from all corners that a short way can touch, by A*.

    A string that is drawn taut is shortest of all ways about the same obstacles in every norm, for
    each norm of the plane is a sum of distances along some directions, and the string crosses no
    line twice. So the corners at which it bends are the same, whatever measures its lines. Ways end
    as far from the goal as `around` says, in the measure of the lines.
    """
    n = len(outline.point)
    ux = ends.start_x
    uy = ends.start_y
    from_start = np.empty(n)
    at_goal = np.empty(n)
    to_goal = np.empty(n)
    expanded = np.empty(n, np.bool_)
    most = limit + around
    steps = _seen_from(space, outline, forces, ux, uy, ends.goal_x, ends.goal_y, most, from_start)
    steps += _seen_from(space, outline, forces, ends.goal_x, ends.goal_y, ux, uy, most, at_goal)
    direct = sight(space, outline, ux, uy, ends.goal_x, ends.goal_y).free
    queue = no_open(1 << 12)
    for v in range(n):
        expanded[v] = False
        at_goal[v] = max(at_goal[v] - around, 0.0)
        to_goal[v] = at_goal[v]
        f = to_goal[v] + extent(forces, outline.point[v, 0] - ux, outline.point[v, 1] - uy)
        if f < limit:
            queue = with_room(queue)
            push(queue, f, v)
    least = max(extent(forces, ends.goal_x - ux, ends.goal_y - uy) - around, 0.0)
    least = least if direct else inf
    frontier = limit
    final = True
    while queue.size[0] > 0:
        f = queue.f[0]
        at = pop(queue)
        if expanded[at]:
            continue
        if steps > effort or (len(forces) > 0 and f >= least):
            frontier = f
            final = f >= least
            break
        expanded[at] = True
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
            there = here + extent(forces, dx, dy)
            if expanded[v] or there >= to_goal[v]:
                continue
            to_goal[v] = there
            f = there + extent(forces, outline.point[v, 0] - ux, outline.point[v, 1] - uy)
            if f < limit:
                queue = with_room(queue)
                push(queue, f, v)
    for v in range(n):
        if not expanded[v]:
            away = extent(forces, outline.point[v, 0] - ux, outline.point[v, 1] - uy)
            dx = outline.point[v, 0] - ends.goal_x
            dy = outline.point[v, 1] - ends.goal_y
            straight = extent(forces, dx, dy) - around
            to_goal[v] = max(straight, frontier - away)
    return Ways(to_goal, from_start, at_goal, min(least, frontier), direct, steps, final, links)


class TautLine(NamedTuple):
    """A line between two corners, or from the start, or to the goal."""

    tail: int  # corner at which it begins; `n` for the start
    head: int  # corner at which it ends; ``n + 1`` for the goal
    x: float  # x of its tail [m]
    y: float  # y of its tail [m]
    dx: float  # x of its extent [m]
    dy: float  # y of its extent [m]
    length: float  # [m]
    behind: int  # side of the obstacle at its tail: 1 left, -1 right, 0 at the start
    about: int  # side of the obstacle at its head, 0 at the goal


@lean
def _line(outline: Outline, ends: DiscEnds, tail: int, head: int) -> TautLine:
    """Return the line between two corners."""
    n = len(outline.point)
    x = ends.start_x
    y = ends.start_y
    if tail < n:
        x = outline.point[tail, 0]
        y = outline.point[tail, 1]
    dx = (outline.point[head, 0] if head < n else ends.goal_x) - x
    dy = (outline.point[head, 1] if head < n else ends.goal_y) - y
    behind = side(outline, tail, dx, dy) if tail < n else 0
    about = side(outline, head, dx, dy) if head < n else 0
    return TautLine(tail, head, x, y, dx, dy, hypot(dx, dy), behind, about)


FRESH, FREE, BARRED = 0, 1, 2
"""What is known of the gates of a line: nothing, that all headings pass, that some do not."""


class Searched(NamedTuple):
    """Lines that the search has reached, one a row."""

    before: FloatTable  # (lines, HEADINGS): least cost by heading before each
    tail: ShortInts  # (lines,): corner at which each begins
    head: ShortInts  # (lines,): corner at which each ends
    waiting: Flags  # (lines,): whether each waits to be expanded
    gates: ShortIntTable  # (2, lines): what is known of the first and the second gate of each
    width: FloatTable  # (lines, 2): how far out these are crossed at most [m]
    closed: FlagTable  # (2 * lines, HEADINGS): headings that do not pass, both gates of each line


@inner
def _no_lines(rows: int) -> Searched:
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
    return Searched(
        before, np.empty(rows, np.int32), np.empty(rows, np.int32), waiting, gates, width,
        np.empty((2 * rows, HEADINGS), np.bool_),
    )  # fmt: skip


@inner
def _more_lines(lines: Searched) -> Searched:
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
def _with_line(lines: Searched, row: int, tail: int, head: int) -> Searched:
    """Return the lines with another one."""
    if row == len(lines.tail):
        lines = _more_lines(lines)
    lines.tail[row] = tail
    lines.head[row] = head
    return lines


@lean
def _lower(before: Floats, cost: Floats, to_goal: Floats) -> float:
    """Lower the costs before a line; return the least cost to the goal of those that fell."""
    better = inf
    for j in range(HEADINGS):
        if cost[j] < before[j] - 1e-9:
            before[j] = cost[j]
            better = min(better, cost[j] + to_goal[j])
    return better


@inner
def _long_enough(used: ShortInts, length: int) -> ShortInts:
    """Return numbers of lines, so many at least: -1 where none is, first those in use."""
    if length <= len(used):
        return used
    out = np.empty(length, np.int32)
    for k in range(length):
        out[k] = used[k] if k < len(used) else -1
    return out


@lean
def _ahead(line: TautLine, goal: int, rates: Rates) -> float:
    """Return how far a way goes along a line at least: to the goal, as far as its disc [m]."""
    return max(line.length - rates.around, 0.0) if line.head == goal else line.length


@inner
def _past_line(
    space: Space, body: Body, outline: Outline, ways: Ways, rates: Rates, lines: Searched,
    row: int, line: TautLine, to_goal: Floats, limit: float, steer: bool, tables: Beyond,
) -> tuple[Floats, float]:  # fmt: skip
    """Return the cost by heading past a line and its gates, and the steps that it took."""
    n = len(outline.point)
    turn = rates.radian * 2.0 * pi / HEADINGS
    within = rates.around > 0.0 and line.head == n + 1
    steps = 15000.0
    if lines.gates[0, row] == FRESH:
        steps += 30000.0
        for which in range(2):
            lines.gates[which, row] = FREE
            on = line.behind if which == 0 else line.about
            if on == 0:
                continue
            lines.width[row, which], barred = gate(
                space, body, outline, rates.goal, line.x + which * line.dx,
                line.y + which * line.dy, on * line.dy / line.length, -on * line.dx / line.length,
                lines.closed[2 * row + which],
            )  # fmt: skip
            if barred:
                lines.gates[which, row] = BARRED
    cost = np.empty(HEADINGS)
    for j in range(HEADINGS):
        cost[j] = lines.before[row, j]
    if lines.gates[0, row] == BARRED:
        pass_gate(cost, lines.closed[2 * row], turn)
    # a disc lies on both sides of the line
    past = along_line(
        cost, atan2(line.dy, line.dx), _ahead(line, n + 1, rates), rates,
        line.about != -1 and line.behind != 1 and not within,
        line.about != 1 and line.behind != -1 and not within,
    )  # fmt: skip
    if steer and (line.tail == n or (line.head == n + 1 and not rates.any_heading and not within)):
        on = line.about if line.tail == n else -line.behind
        section = Section(
            line.dx, line.dy, on * line.dy / line.length, -on * line.dx / line.length,
            lines.width[row, 1 if line.tail == n else 0],
        )  # fmt: skip
        if line.tail == n:
            most = limit - rates.metre * ways.to_goal[line.head]
            steps += from_start(past, section, to_goal, most, rates, tables)
        else:
            reached = to_end(cost, section, to_goal, limit, rates, tables)
            steps += reached.steps
            past[0] = max(past[0], reached.cost)
    if lines.gates[1, row] == BARRED:
        pass_gate(past, lines.closed[2 * row + 1], turn)
    return past, steps


class Least(NamedTuple):
    """What the search over corners found."""

    value: float  # the bound
    final: bool  # whether the search came to its end
    links: Links  # what is known of the corners now
    steps: float  # steps that it took


@inner
def _turning(rates: Rates, heading: float) -> Floats:
    """Return the cost of turning between a heading and those at the nodes around the circle."""
    cost = np.empty(HEADINGS)
    for j in range(HEADINGS):
        cost[j] = rates.radian * angle_between(rates.goal + j * 2.0 * pi / HEADINGS, heading)
    return cost


@lean
def _least_sum(cost: Floats, to_goal: Floats) -> float:
    """Return the least sum of two costs by heading."""
    lowest = inf
    for j in range(HEADINGS):
        lowest = min(lowest, cost[j] + to_goal[j])
    return lowest


@lean
def _goes_on(last: TautLine, line: TautLine) -> bool:
    """Return whether a taut path may go on along a line: around the obstacle at its tail alone."""
    bend = (last.dx * line.dy - last.dy * line.dx) * last.about
    return bend >= -1e-9 * line.length and line.behind == last.about


@lean
def _in_sight(ways: Ways, at: int, to: int) -> bool:
    """Return whether a line from the start, or to the goal, is not known to be blocked."""
    n = len(ways.at_goal)
    if at == n:
        return bool(ways.from_start[to] < inf)
    return to <= n or ways.at_goal[at] < inf


@lean
def _pop_waiting(queue: Open, waiting: Flags) -> tuple[int, float]:
    """Return the most promising line that waits, which it does no longer, and its key; or -1."""
    f = inf
    while queue.size[0] > 0:
        f = queue.f[0]
        row = pop(queue)
        if waiting[row]:
            waiting[row] = False
            return row, f
    return -1, f


@njit
def least_over_corners(
    space: Space, body: Body, outline: Outline, paid: Flags, ends: DiscEnds, ways: Ways,
    rates: Rates, limit: float, effort: float, steer: bool,
) -> Least:  # fmt: skip
    """Return a lower bound on the cost of going from start to goal, at most `limit`.

    A* over lines between corners, each with its costs by heading. A taut path turns at a corner
    only around the obstacle there. The rest of the cost is estimated by the shortest path.
    """
    n = len(outline.point)
    start, goal = n, n + 1
    tables = no_tables()
    cost = _turning(rates, rates.start)
    to_goal = np.zeros(HEADINGS) if rates.any_heading else _turning(rates, rates.goal)
    limit = min(limit, rates.direct) if ways.direct else limit
    links = ways.links
    lines = _no_lines(256)
    # row of the line from each corner to the goal, then of the line along each link
    row_of = _long_enough(np.empty(0, np.int32), n + len(links.seen))
    queue = no_open(1 << 12)
    rows = 0
    steps = 0.0
    last = TautLine(start, start, ends.start_x, ends.start_y, 0.0, 0.0, 0.0, 0, 0)
    while True:
        # lower the costs before the lines that go on from the end of the last one
        at = last.head
        lowest = _least_sum(cost, to_goal)
        many = begin = 0
        if at == goal:
            limit = min(limit, lowest if rates.any_heading else cost[0])
        elif lowest < limit and at == start:
            many = n
        elif lowest < limit:
            links = linked(space, outline, links, at)
            if not paid[at]:
                paid[at] = True
                steps += links.steps[at]
            row_of = _long_enough(row_of, n + len(links.seen))
            begin = int(links.first[at])
            many = links.number[at] + 1
        steps += 10.0 * many
        for i in range(many):
            # from a corner the last line leads to the goal; from the start that is known already
            to = i if at == start else goal if i == many - 1 else int(links.seen[begin + i])
            if not _in_sight(ways, at, to):
                continue
            line = _line(outline, ends, at, to)
            beyond = 0.0 if to == goal else ways.to_goal[to]
            rest = rates.metre * (_ahead(line, goal, rates) + beyond)
            if lowest + rest >= limit or (at != start and not _goes_on(last, line)):
                continue
            slot = at if to == goal else n + begin + i
            row = -1 if at == start else int(row_of[slot])
            if row < 0:
                row = rows
                rows += 1
                lines = _with_line(lines, row, at, to)
                if at != start:
                    row_of[slot] = row
            steps += 300.0
            f = _lower(lines.before[row], cost, to_goal) + rest
            if f < limit:
                queue = with_room(queue)
                lines.waiting[row] = True
                push(queue, f, row)
        row, f = _pop_waiting(queue, lines.waiting)
        if row < 0 or f >= limit:
            return Least(limit, True, links, steps)
        if steps > effort:
            return Least(f, False, links, steps)
        last = _line(outline, ends, int(lines.tail[row]), int(lines.head[row]))
        cost, more = _past_line(
            space, body, outline, ways, rates, lines, row, last, to_goal, limit, steer, tables
        )
        steps += more
