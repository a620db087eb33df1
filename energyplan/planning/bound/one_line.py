"""Kernels for one line of the lower bound: what a way along it costs, and what can cross its ends.

The robot is a disc that drives along its heading, forwards or backwards, and pays for metres and
radians apart (docs/planner.md).
"""

from __future__ import annotations

from math import cos, floor, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, njit
from energyplan.cost.steering import StaticSteering
from energyplan.planning.bound.sight import Outline
from energyplan.terrain.collision import Body, Space, in_cells, pose_free

STEP = 0.02
"""Distance between the places tried on a gate [m]."""

LONG = 3.0
"""Length from which a gate forbids no heading [m]."""

ENDLESS = 10.0
"""Length from which a gate is taken to have no end [m]."""


class Gate(NamedTuple):
    """What is known of a gate."""

    width: float  # how far from the corner it is crossed at most [m]
    barred: bool  # whether there are headings with which the body cannot cross


@njit
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
) -> Gate:
    """Measure a gate, and mark the headings with which the body cannot cross it.

    A gate is a ray from a corner, up to the next obstacle. Where a place on it lies in the open, or
    where it is long, it forbids no heading.
    """
    n = len(closed)
    spacing = 2.0 * pi / n
    res = space.resolution
    rows, columns = space.clearance.shape
    reach = hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))
    for j in range(n):
        closed[j] = False
    length = 0.0
    roomy = False
    while True:
        here = in_cells(space, x + length * ux, y + length * uy)
        column = floor(here.column)
        row = floor(here.row)
        if row < 0 or column < 0 or row >= rows or column >= columns:
            break
        off = hypot(here.column - column - 0.5, here.row - row - 0.5) * res
        near = float(space.clearance[row, column]) * res
        if length > ENDLESS:
            return Gate(inf, False)
        if near + off < outline.inside - 1e-9:
            break
        roomy = roomy or near - off > reach
        length += STEP
    if roomy or length > LONG:
        return Gate(length, False)
    # a body that is smaller by what a place and a heading stand for
    less = 0.5 * STEP + 0.5 * spacing * reach
    small = Body(body.x_min + less, body.y_min + less, body.x_max - less, body.y_max - less)
    open_between = np.empty(n, np.bool_)
    for j in range(n):
        open_between[j] = False
    left = n
    for k in range(int(length / STEP) + 2):
        px = x + k * STEP * ux
        py = y + k * STEP * uy
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
    return Gate(length, any_closed)


HEADINGS = 256
"""Nodes of the heading."""

SWEEPS = (0.0, pi / 6, pi / 3, pi / 2, 2 * pi / 3, pi)
"""Limits of the classes of ways along a line, by how far their headings spread [rad]."""


class Rates(NamedTuple):
    """Costs of the relaxed problem."""

    metre: float  # cost per metre driven and per radian turned
    radian: float  # cost per metre driven and per radian turned
    start: float  # headings
    goal: float  # headings
    direct: float  # least cost from start to goal without obstacles
    steering: StaticSteering  # what no motion costs less than, pivots included


@njit
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


@njit
def _least(cost: Floats) -> float:
    best = inf
    for j in range(len(cost)):
        best = min(best, cost[j])
    return best


@njit
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


@njit
def pass_gate(cost: Floats, closed: Flags, turn: float) -> None:
    """Raise the cost of the headings that a gate does not let through."""
    for j in range(len(cost)):
        if closed[j]:
            cost[j] = inf
    spread(cost, turn)
