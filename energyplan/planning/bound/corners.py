"""Kernels of the lower bound: a search over the corners of the obstacles (docs/planning.md).

The robot is a disc that drives along its heading, forwards or backwards, and pays for metres and
radians apart. What is kept for each line between two corners is a function of the heading, at
`HEADINGS` nodes around the circle: the least cost at which any way of the disc that is drawn
taut along this line can have got there.
"""

from __future__ import annotations

from math import atan2, cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import Floats, FloatTable
from energyplan.planning.bound.sight import Corners, line_open
from energyplan.planning.scene.field import (
    angle_between,
    longer_floats,
    longer_ints,
    pop,
    push,
)
from energyplan.terrain.collision import Body, Space, in_cells, pose_free

HEADINGS = 256
"""Nodes of the heading."""

SWEEPS = (0.0, pi / 6, pi / 3, pi / 2, 2 * pi / 3, pi)
"""Limits of the classes of ways along a line, by how far their headings spread [rad]."""

STEP = 0.02
"""Distance between the places tried on a gate [m]."""

LONG = 3.0
"""Length from which a gate forbids no heading [m]."""

UNKNOWN, CLOSED, OPEN = -1, -2, -3
"""What is known of a line that is not in use."""


class Rates(NamedTuple):
    """Costs of the relaxed problem.

    Attributes
    ----------
    metre, radian : float
        Cost per metre driven and per radian turned.
    start, goal : float
        Headings.
    direct : float
        Least cost from start to goal without obstacles.
    """

    metre: float
    radian: float
    start: float
    goal: float
    direct: float


@inner
def _side(corners: Corners, k: int, ux: float, uy: float) -> int:
    """Side of a line through a corner on which the obstacle lies: 1 left, -1 right, 0 both."""
    x = corners.point[k, 0]
    y = corners.point[k, 1]
    one = ux * (corners.before[k, 1] - y) - uy * (corners.before[k, 0] - x)
    two = ux * (corners.after[k, 1] - y) - uy * (corners.after[k, 0] - x)
    tiny = 1e-9
    if one >= -tiny and two >= -tiny:
        return 1
    if one <= tiny and two <= tiny:
        return -1
    return 0


@inner
def spread(cost: Floats, turn: float) -> None:
    """Lower each node's cost to that of turning there from another node, at `turn` a node."""
    n = len(cost)
    best = inf
    for k in range(2 * n):
        j = k % n
        best = min(best + turn, cost[j])
        cost[j] = best
    best = inf
    for k in range(2 * n - 1, -1, -1):
        j = k % n
        best = min(best + turn, cost[j])
        cost[j] = best


@inner
def _least(cost: Floats) -> float:
    best = inf
    for j in range(len(cost)):
        best = min(best, cost[j])
    return best


@inner
def along_line(
    cost: Floats,
    direction: float,
    length: float,
    rates: Rates,
    strict_left: bool,
    strict_right: bool,
) -> Floats:
    """Return the least cost of being past a line by heading, given that of being before it.

    A way whose headings all stay away from the line by some angle, its lag, is longer than the
    line: by the cosine of the lag, and where it must end up on the line again, by how much it has
    to go to and fro, the more so the less its headings spread.

    Parameters
    ----------
    cost : ndarray, shape (HEADINGS,)
        Least cost by heading, such that neighbours differ by no more than the turn between them.
        Node 0 is the heading at the goal.
    direction, length : float
        The line [rad], [m].
    rates : Rates
        Costs.
    strict_left, strict_right : bool
        Whether a way whose headings stay to the left, or right, of the line must end up on it.
    """
    n = len(cost)
    spacing = 2.0 * pi / n
    straight = rates.metre * length
    lowest = _least(cost)
    strict = strict_left or strict_right
    sine = np.empty(n)
    cosine = np.empty(n)
    beside = np.empty(n, np.bool_)
    for j in range(n):
        aside = (rates.goal + j * spacing - direction) % pi
        left = aside <= 0.5 * pi
        # a node stands for the headings up to its neighbours
        lag = max((aside if left else pi - aside) - spacing, 0.0)
        sine[j] = sin(lag)
        cosine[j] = max(cos(lag), 1e-6)
        beside[j] = not (strict_left if left else strict_right)
    out = np.empty(n)
    past = np.empty(n)
    for j in range(n):
        out[j] = inf
    for k in range(1 if strict else len(SWEEPS) - 1, len(SWEEPS)):
        wide = cos(0.5 * SWEEPS[k]) / sin(0.5 * SWEEPS[k])
        for j in range(n):
            longer = 1.0 / cosine[j]
            if not beside[j]:
                longer = max(longer, sine[j] * wide + cosine[j])
            past[j] = cost[j] + straight * longer
        spread(past, rates.radian * spacing)
        # ways of this class turn by more than the class before covers
        least = lowest + straight + (rates.radian * SWEEPS[k - 1] if strict else 0.0)
        for j in range(n):
            out[j] = min(out[j], max(past[j], least))
    return out


@inner
def gate(
    space: Space,
    body: Body,
    corners: Corners,
    goal_yaw: float,
    x: float,
    y: float,
    ux: float,
    uy: float,
    cost: Floats,
    turn: float,
) -> None:
    """Raise the cost of the headings with which the body cannot cross a gate.

    A gate is a ray from a corner, up to the next obstacle. Where it leads into the open or is long,
    it forbids nothing.

    Parameters
    ----------
    space, body, corners : Space, Body, Corners
        Obstacles, the body, and the outline for the disc inside it.
    goal_yaw : float
        Heading of node 0.
    x, y, ux, uy : float
        Corner and direction of the ray.
    cost : ndarray, shape (HEADINGS,)
        Least cost by heading; see `along_line`.
    turn : float
        Cost of the turn from one node to the next.
    """
    n = len(cost)
    spacing = 2.0 * pi / n
    res = space.resolution
    rows, columns = space.clearance.shape
    reach = hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))
    length = 0.0
    while True:
        here = in_cells(space, x + length * ux, y + length * uy)
        column = floor(here.column)
        row = floor(here.row)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            break
        off = hypot(here.column - column - 0.5, here.row - row - 0.5) * res
        near = float(space.clearance[row, column]) * res
        if near - off > reach or length > LONG:
            return
        if near + off < corners.inside - 1e-9:
            break
        length += STEP
    # a body that is smaller by what a place and a heading stand for
    less = 0.5 * STEP + 0.5 * spacing * reach
    small = Body(body.x_min + less, body.y_min + less, body.x_max - less, body.y_max - less)
    open_between = np.empty(n, np.bool_)
    for j in range(n):
        open_between[j] = False
    for k in range(int(length / STEP) + 2):
        px = x + k * STEP * ux
        py = y + k * STEP * uy
        for j in range(n):
            if not open_between[j]:
                open_between[j] = pose_free(space, small, px, py, goal_yaw + (j + 0.5) * spacing)
    for j in range(n):
        if not (open_between[j - 1] or open_between[j]):
            cost[j] = inf
    spread(cost, turn)


@inner
def _all_infinite(rows: int) -> FloatTable:
    out = np.empty((rows, HEADINGS))
    for k in range(rows):
        for j in range(HEADINGS):
            out[k, j] = inf
    return out


@njit
def least_over_corners(
    space: Space, body: Body, corners: Corners, rates: Rates, limit: float, effort: float
) -> tuple[float, bool]:
    """Return a lower bound on the cost of going from start to goal, at most `limit`.

    A* over lines between corners, each with its costs by heading. A taut way turns at a corner
    only around the obstacle there.

    Parameters
    ----------
    space : Space
        Obstacles.
    body : Body
        The robot.
    corners : Corners
        Corners, start and goal.
    rates : Rates
        Costs.
    limit : float
        Costs at or above are of no interest.
    effort : float
        Number of steps, of about a nanosecond each, at which to stop with what is known by then.

    Returns
    -------
    tuple of float and bool
        The bound, and whether the search came to its end.
    """
    n = len(corners.point)
    start = n - 2
    goal = n - 1
    point = corners.point
    turn = rates.radian * 2.0 * pi / HEADINGS
    to_goal = np.empty(HEADINGS)
    cost = np.empty(HEADINGS)
    for j in range(HEADINGS):
        heading = rates.goal + j * 2.0 * pi / HEADINGS
        to_goal[j] = rates.radian * angle_between(heading, rates.goal)
        cost[j] = rates.radian * angle_between(heading, rates.start)
    state = np.empty((n, n), np.int32)
    for v in range(n):
        for at in range(n):
            state[v, at] = UNKNOWN
    capacity = 256
    before = _all_infinite(capacity)
    tail = np.empty(capacity, np.int32)
    head = np.empty(capacity, np.int32)
    waiting = np.empty(capacity, np.bool_)
    room = 1 << 16
    heap_f = np.empty(room)
    heap_node = np.empty(room, np.int32)
    count = 0
    size = 0
    work = 0.0
    at = start
    about = 0
    ix = 0.0
    iy = 0.0
    while True:
        lowest = inf
        for j in range(HEADINGS):
            lowest = min(lowest, cost[j] + to_goal[j])
        gx = point[goal, 0]
        gy = point[goal, 1]
        work += 5.0 * n
        for v in range(n if lowest < limit else 0):
            dx = point[v, 0] - point[at, 0]
            dy = point[v, 1] - point[at, 1]
            length = hypot(dx, dy)
            if v == start or state[at, v] == CLOSED or length < 1e-12:
                continue
            rest = length + hypot(gx - point[v, 0], gy - point[v, 1])
            straight_on = at == start and v == goal
            if (rates.direct if straight_on else lowest + rates.metre * rest) >= limit:
                continue
            if at != start and (
                (ix * dy - iy * dx) * about < -1e-9 * length or _side(corners, at, dx, dy) != about
            ):
                continue
            if state[at, v] == UNKNOWN:
                work += 2000.0
                good = (at == start or _side(corners, at, dx, dy) != 0) and (
                    v == goal or _side(corners, v, dx, dy) != 0
                )
                good = good and line_open(
                    space, corners, point[at, 0], point[at, 1], point[v, 0], point[v, 1]
                )
                if not good:
                    state[at, v] = CLOSED
                    state[v, at] = CLOSED
                    continue
                state[at, v] = OPEN
                if state[v, at] == UNKNOWN:
                    state[v, at] = OPEN
            if straight_on:
                limit = rates.direct
                continue
            line = int(state[at, v])
            if line < 0:
                if count == capacity:
                    capacity *= 2
                    fewer = before
                    before = _all_infinite(capacity)
                    for k in range(count):
                        for j in range(HEADINGS):
                            before[k, j] = fewer[k, j]
                    tail = longer_ints(tail)
                    head = longer_ints(head)
                    known = waiting
                    waiting = np.empty(capacity, np.bool_)
                    for k in range(count):
                        waiting[k] = known[k]
                line = count
                count += 1
                state[at, v] = line
                tail[line] = at
                head[line] = v
            better = inf
            for j in range(HEADINGS):
                if cost[j] < before[line, j] - 1e-9:
                    before[line, j] = cost[j]
                    better = min(better, cost[j] + to_goal[j])
            f = better + rates.metre * rest
            if f < limit:
                if size + 1 >= room:
                    room *= 2
                    heap_f = longer_floats(heap_f)
                    heap_node = longer_ints(heap_node)
                waiting[line] = True
                size = push(heap_f, heap_node, size, f, line)
        line = -1
        f = limit
        while size > 0 and line < 0:
            f = heap_f[0]
            if waiting[heap_node[0]]:
                line = int(heap_node[0])
            size = pop(heap_f, heap_node, size)
        if line < 0 or f >= limit:
            return limit, True
        if work > effort:
            return float(f), False
        waiting[line] = False
        u = int(tail[line])
        at = int(head[line])
        ix = point[at, 0] - point[u, 0]
        iy = point[at, 1] - point[u, 1]
        length = hypot(ix, iy)
        behind = 0 if u == start else _side(corners, u, ix, iy)
        about = 0 if at == goal else _side(corners, at, ix, iy)
        for j in range(HEADINGS):
            cost[j] = before[line, j]
        work += 30000.0
        if u != start:
            gate(
                space, body, corners, rates.goal,
                point[u, 0], point[u, 1], behind * iy / length, -behind * ix / length, cost, turn,
            )  # fmt: skip
        cost = along_line(
            cost,
            atan2(iy, ix),
            length,
            rates,
            about != -1 and behind != 1,
            about != 1 and behind != -1,
        )
        if at == goal:
            limit = min(limit, cost[0])
            for j in range(HEADINGS):
                cost[j] = inf
            continue
        gate(
            space, body, corners, rates.goal,
            point[at, 0], point[at, 1], about * iy / length, -about * ix / length, cost, turn,
        )  # fmt: skip
