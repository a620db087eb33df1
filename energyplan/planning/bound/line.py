"""Kernels for one line of the lower bound: what a way along it costs, and what can cross its ends.

The robot is a disc that drives along its heading, forwards or backwards, and pays for metres and
radians separately (docs/planner.md).
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, FloatTable, inner, lean
from energyplan.cost.steering import StaticSteering
from energyplan.planning.bound.outline import Outline
from energyplan.planning.settings import GATES
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.queues import turning_by
from energyplan.terrain.collision import Body, Space, in_cells, pose_free


@inner
def gate(
    space: Space,
    body: Body,
    outline: Outline,
    goal_yaw: float,
    x: float,
    y: float,
    ux: float,
    uy: float,
    closed: Flags,
) -> tuple[float, bool]:
    """Mark the headings with which the body cannot cross a gate; return how wide it is [m].

    Second comes whether there are any. A gate is a ray from a corner, up to the next obstacle.
    Where a place on it lies in the open, or where it is long, it forbids no heading.
    """
    n = len(closed)
    spacing = 2.0 * pi / n
    res = space.resolution
    rows, columns = space.clearance.shape
    reach = hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))
    for j in range(n):
        closed[j] = False
    length = 0.0
    open_space = False
    while True:
        here = in_cells(space, x + length * ux, y + length * uy)
        column = floor(here.column)
        row = floor(here.row)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            break
        off = hypot(here.column - column - 0.5, here.row - row - 0.5) * res
        near = float(space.clearance[row, column]) * res
        if length > GATES.endless:
            return inf, False
        if near + off < outline.inside - 1e-9:
            break
        open_space = open_space or near - off > reach
        length += GATES.step
    if open_space or length > GATES.long:
        return length, False
    # a body smaller by half a step between places and half a step between headings
    less = 0.5 * GATES.step + 0.5 * spacing * reach
    small = grown(body, -less)
    open_between = np.empty(n, np.bool_)
    for j in range(n):
        open_between[j] = False
    left = n
    for k in range(int(length / GATES.step) + 2):
        px = x + k * GATES.step * ux
        py = y + k * GATES.step * uy
        for j in range(n if left > 0 else 0):
            if not open_between[j] and pose_free(
                space, small, px, py, goal_yaw + (j + 0.5) * spacing
            ):
                open_between[j] = True
                left -= 1
    any_closed = False
    for j in range(n):
        closed[j] = not (open_between[j - 1] or open_between[j])
        any_closed = any_closed or closed[j]
    return length, any_closed


HEADINGS = 256  # nodes of the heading

SWEEPS = (0.0, pi / 6, pi / 3, pi / 2, 2 * pi / 3, pi)
"""Limits of the classes of ways along a line, by how far their headings spread [rad]."""


class Rates(NamedTuple):
    """Costs of the relaxed problem."""

    metre: float  # cost per metre driven
    radian: float  # cost per radian of turning
    start: float  # heading at the start [rad]
    goal: float  # heading at the goal [rad]
    direct: float  # least cost from start to goal without obstacles
    steering: StaticSteering  # what no motion costs less than, pivots included
    any_heading: bool = False  # whether any heading will do at the goal
    around: float = 0.0  # radius of the disc about the goal in which a way may end [m]


@lean
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


@lean
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
    """
    n = len(cost)
    spacing = 2.0 * pi / n
    straight = rates.metre * length
    lowest = _least(cost)
    strict = strict_left or strict_right
    sine = np.empty(n)
    cosine = np.empty(n)
    oblique = np.empty(n, np.bool_)
    for j in range(n):
        aside = (rates.goal + j * spacing - direction) % pi
        left = aside <= 0.5 * pi
        # a node covers the headings up to its neighbours
        lag = max((aside if left else pi - aside) - spacing, 0.0)
        sine[j] = sin(lag)
        cosine[j] = max(cos(lag), 1e-6)
        oblique[j] = not (strict_left if left else strict_right)
    out = np.empty(n)
    past = np.empty(n)
    for j in range(n):
        out[j] = inf
    for k in range(1 if strict else len(SWEEPS) - 1, len(SWEEPS)):
        wide = cos(0.5 * SWEEPS[k]) / sin(0.5 * SWEEPS[k])
        for j in range(n):
            longer = 1.0 / cosine[j]
            if not oblique[j]:
                longer = max(longer, sine[j] * wide + cosine[j])
            past[j] = cost[j] + straight * longer
        spread(past, rates.radian * spacing)
        # ways of this class turn by more than the class before covers
        least = lowest + straight + (rates.radian * SWEEPS[k - 1] if strict else 0.0)
        for j in range(n):
            out[j] = min(out[j], max(past[j], least))
    return out


@lean
def pass_gate(cost: Floats, closed: Flags, turn: float) -> None:
    """Raise the cost of the headings that a gate does not let through."""
    for j in range(len(cost)):
        if closed[j]:
            cost[j] = inf
    spread(cost, turn)


BEYOND = pi / 72  # steps in which headings beyond the two ends of a turn are tried [rad]

NORMALS = 16
"""Directions tried for the force of the dual, over half a circle; even, so one is straight on."""

MOST = 96  # steps of `BEYOND` beyond either end; more than half a turn, beyond which nothing is new


class Section(NamedTuple):
    """Where a gate lies, seen from a pose."""

    x: float  # x of the displacement to the corner that the gate starts from [m]
    y: float  # y of that displacement [m]
    gate_x: float  # x of the unit vector along the gate
    gate_y: float  # y of that vector
    width: float  # length of the gate, which may be infinite [m]


class Reached(NamedTuple):
    """What a gate takes to reach."""

    cost: float  # at least this much
    steps: float  # steps that finding it took


@lean
def _headway(angle: float) -> float:
    """Return the integral of the absolute cosine from zero to an angle."""
    half_turns = floor(angle / pi + 0.5)
    rest = angle - half_turns * pi
    return 2.0 * half_turns + sin(rest)


class Beyond(NamedTuple):
    """Tables by direction of the force and by steps beyond both ends of a turn."""

    low: FloatTable  # (NORMALS, MOST + 1): greatest ``|cos|`` to the force from the low end on
    high: FloatTable  # (NORMALS, MOST + 1): the same from the high end
    below: FloatTable  # (NORMALS, MOST + 1): integral of ``|cos|`` from the low end on
    above: FloatTable  # (NORMALS, MOST + 1): the same from the high end


@inner
def no_tables() -> Beyond:
    """Return tables to be filled."""
    return Beyond(
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
    )


@lean
def _outward(heading: float, step: float, many: int, greatest: Floats, headway: Floats) -> None:
    """Fill in the tables of one force and one end."""
    c = cos(heading)
    s = sin(heading)
    turn_c = cos(step)
    turn_s = sin(step)
    most = abs(c)
    total = 0.0
    greatest[0] = most
    headway[0] = 0.0
    for i in range(1, many + 1):
        cc = c * turn_c - s * turn_s
        ss = s * turn_c + c * turn_s
        # the cosine is at its greatest where the sine passes zero
        most = 1.0 if s * ss <= 0.0 else max(most, abs(cc))
        total += abs(ss - s) if c * cc >= 0.0 else 2.0 - abs(s) - abs(ss)
        greatest[i] = most
        headway[i] = total
        c = cc
        s = ss


@inner
def to_gate(
    section: Section,
    start: float,
    end: float,
    steering: StaticSteering,
    limit: float,
    tables: Beyond,
) -> Reached:
    """Return what a motion from a heading to another costs at least that ends on a segment.

    For a force ``p = a n / M`` every motion costs at least ``p . d`` for its displacement `d`, and
    ``b - C |p . u|`` for each radian that it turns through a heading `u`, if no heading on the way
    has ``|n . u| > M``. For the headings a motion passes, given by how far they reach beyond its
    first and last one, the best force of `NORMALS` counts; of all such ranges, the cheapest. To
    turn to and fro within a range more than once only adds to that.
    """
    x = section.x
    y = section.y
    turn = (end - start) % (2.0 * pi)
    metre = steering.per_metre
    radian = steering.per_radian
    steps = 100.0
    towards = atan2(y, x)
    shift = towards - 0.5 * pi
    # no more than to turn to the corner, to drive there, forwards or backwards, and to turn
    best = min(limit, radian * turning_by(start, towards, end) + metre * hypot(x, y))
    ahead = np.empty(NORMALS)
    once = np.empty(NORMALS)
    inside = np.empty(NORMALS)
    for way in range(4):
        # to the left by less than a turn or by one more, and to the right likewise
        total = turn if way == 0 else 2.0 * pi - turn if way == 1 else turn + 2.0 * pi
        if way == 3:
            total = 4.0 * pi - turn
        left = way % 2 == 0
        if radian * total >= best:
            continue
        low = start if left else start - total
        high = low + total
        many = MOST
        if best - radian * total < (MOST - 2) * 2.0 * radian * BEYOND:
            many = int((best - radian * total) / (2.0 * radian * BEYOND)) + 2
        for k in range(NORMALS):
            angle = shift + k * pi / NORMALS
            nx = cos(angle)
            ny = sin(angle)
            ahead[k] = x * nx + y * ny
            off = section.gate_x * nx + section.gate_y * ny
            if off < 0.0:
                ahead[k] = ahead[k] + section.width * off if section.width < inf else -inf
            passes = ceil((low - angle) / pi) * pi <= high - angle
            inside[k] = 1.0 if passes else 0.0
            once[k] = _headway(high - angle) - _headway(low - angle)
            _outward(low - angle, -BEYOND, many, tables.low[k], tables.below[k])
            _outward(high - angle, BEYOND, many, tables.high[k], tables.above[k])
        steps += NORMALS * (50.0 + 6.0 * many)
        last = NORMALS // 2
        for i in range(many + 1):
            short = max(i - 1, 0)
            if radian * (total + 2.0 * short * BEYOND) >= best:
                break
            for j in range(many + 1):
                less = max(j - 1, 0)
                turning = radian * (total + 2.0 * (short + less) * BEYOND)
                if turning >= best:
                    break
                value = turning
                for m in range(NORMALS):
                    # the force that was the best one before comes first
                    k = (last + m) % NORMALS
                    left_over = ahead[k] - steering.half_track * (
                        once[k] + 2.0 * (tables.below[k, short] + tables.above[k, less])
                    )
                    steps += 2.0
                    if left_over <= 0.0:
                        continue
                    most = max(inside[k], tables.low[k, i], tables.high[k, j])
                    there = turning + metre * left_over / max(most, 1e-9)
                    if there > value:
                        value = there
                        if value >= best:
                            last = k
                            break
                best = min(best, value)
    return Reached(max(best, 0.0), steps)


@lean
def _slack(rates: Rates) -> float:
    """Upper bound of the discretisation error between two heading samples."""
    return (rates.radian + rates.steering.per_radian) * pi / HEADINGS


@inner
def from_start(
    cost: Floats, section: Section, to_goal: Floats, limit: float, rates: Rates, tables: Beyond
) -> float:
    """Raise the cost of being past the first line to what steering takes; return the steps."""
    n = len(cost)
    exact = np.empty(n)
    steps = 0.0
    slack = _slack(rates)
    for j in range(n):
        exact[j] = cost[j]
        most = limit - to_goal[j] + slack
        if cost[j] < most:
            heading = rates.goal + j * 2.0 * pi / n
            found = to_gate(section, rates.start, heading, rates.steering, most, tables)
            exact[j] = max(cost[j], found.cost)
            steps += found.steps
    spread(exact, rates.radian * 2.0 * pi / n)
    for j in range(n):
        cost[j] = max(cost[j], exact[j] - slack)
    return steps


@lean
def to_end(
    cost: Floats, section: Section, to_goal: Floats, limit: float, rates: Rates, tables: Beyond
) -> Reached:
    """Return what steering takes from the last gate to the goal, and to that gate, at least."""
    n = len(cost)
    straight = rates.metre * hypot(section.x, section.y)
    slack = _slack(rates)
    best = limit + slack
    steps = float(n)
    first = 0
    for j in range(n):
        if cost[j] + to_goal[j] < cost[first] + to_goal[first]:
            first = j
    for k in range(n):
        j = (first + k) % n
        if cost[j] + to_goal[j] + straight < best:
            heading = rates.goal + j * 2.0 * pi / n
            found = to_gate(section, heading, rates.goal, rates.steering, best - cost[j], tables)
            best = min(best, cost[j] + found.cost)
            steps += found.steps
    return Reached(best - slack, steps)
