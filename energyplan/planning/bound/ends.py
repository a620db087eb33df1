"""Kernels for the ends of a way: what steering takes between a pose and a gate, at least.

Between a pose and a gate nothing of the obstacles is known but where the gate is. So a section of a
way at either of its ends costs no less than the cheapest motion to any place on the gate, which is
the exact minimum of docs/theory, section 4, for a goal that is a segment instead of a point.
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Floats, FloatTable, njit
from energyplan.cost.steering import StaticSteering
from energyplan.planning.bound.one_line import HEADINGS, Rates, spread
from energyplan.planning.scene.field import angle_between

BEYOND = pi / 72
"""Steps in which headings beyond the two ends of a turn are tried [rad]."""

NORMALS = 16
"""Directions tried for the force of the dual, over half a circle; even, so one is straight on."""

MOST = 96
"""Steps of `BEYOND` beyond either end; more than half a turn, beyond which nothing is new."""


class Section(NamedTuple):
    """Where a gate lies, seen from a pose."""

    x: float  # displacement to the corner that the gate starts from [m]
    y: float  # displacement to the corner that the gate starts from [m]
    gate_x: float  # direction of the gate, and its length, which may be infinite [m]
    gate_y: float  # direction of the gate, and its length, which may be infinite [m]
    width: float  # direction of the gate, and its length, which may be infinite [m]


class Reached(NamedTuple):
    """What a gate takes to reach."""

    cost: float  # at least this much
    steps: float  # steps that finding it took


@njit
def _headway(angle: float) -> float:
    """Return the integral of the absolute cosine from zero to an angle."""
    half_turns = floor(angle / pi + 0.5)
    rest = angle - half_turns * pi
    return 2.0 * half_turns + sin(rest)


class Beyond(NamedTuple):
    """Tables by direction of the force and by steps beyond both ends of a turn."""

    low: FloatTable  # greatest absolute cosine to the force among the headings from the end outward
    high: FloatTable  # (NORMALS, MOST + 1)
    below: FloatTable  # (NORMALS, MOST + 1): integral of the absolute cosine over them
    above: FloatTable  # (NORMALS, MOST + 1): integral of the absolute cosine over them


@njit
def no_tables() -> Beyond:
    """Return tables to be filled."""
    return Beyond(
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
        np.empty((NORMALS, MOST + 1)),
    )


@njit
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


@njit
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
    has ``|n . u| > M``. For the headings a motion passes, told by how far they reach beyond its
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
    best = limit
    for heading in (towards, towards + pi):
        turns = angle_between(heading, start) + angle_between(heading, end)
        best = min(best, radian * turns + metre * hypot(x, y))
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
                turned = radian * (total + 2.0 * (short + less) * BEYOND)
                if turned >= best:
                    break
                value = turned
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
                    there = turned + metre * left_over / max(most, 1e-9)
                    if there > value:
                        value = there
                        if value >= best:
                            last = k
                            break
                best = min(best, value)
    return Reached(max(best, 0.0), steps)


@njit
def _slack(rates: Rates) -> float:
    """Return what a heading between two nodes can take less than the nearer one."""
    return (rates.radian + rates.steering.per_radian) * pi / HEADINGS


@njit
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


@njit
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
