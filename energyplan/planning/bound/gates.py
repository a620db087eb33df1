"""Kernel for the gates at the ends of a line: how wide they are, and what can cross them."""

from __future__ import annotations

from math import floor, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import inner
from energyplan.compilation.arrays import Flags
from energyplan.planning.bound.sight import Outline
from energyplan.terrain.collision import Body, Space, in_cells, pose_free

STEP = 0.02
"""Distance between the places tried on a gate [m]."""

LONG = 3.0
"""Length from which a gate forbids no heading [m]."""

ENDLESS = 10.0
"""Length from which a gate is taken to have no end [m]."""


class Gate(NamedTuple):
    """What is known of a gate.

    Attributes
    ----------
    width : float
        How far from the corner it is crossed at most; infinite for a long one [m].
    barred : bool
        Whether there are headings with which the body cannot cross.
    """

    width: float
    barred: bool


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
) -> Gate:
    """Measure a gate, and mark the headings with which the body cannot cross it.

    A gate is a ray from a corner, up to the next obstacle. Where a place on it lies in the open, or
    where it is long, it forbids no heading.

    Parameters
    ----------
    space, body, outline : Space, Body, Outline
        Obstacles, the body, and the outline for the disc inside it.
    goal_yaw : float
        Heading of node 0.
    x, y, ux, uy : float
        Corner and direction of the ray.
    closed : ndarray of bool, shape (HEADINGS,)
        Filled: whether no pose between the neighbours of a node can cross.

    Returns
    -------
    Gate
        What is known of it.
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
