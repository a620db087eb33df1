"""Kernel for the shortest ways of a disc to the goal, over the corners of the obstacles."""

from __future__ import annotations

from math import hypot, inf
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, njit
from energyplan.planning.bound.sight import Links, Outline, linked, side, sight
from energyplan.planning.scene.field import pop, push, with_room
from energyplan.terrain.collision import Space


class Ends(NamedTuple):
    """Start and goal of the disc's centre [m]."""

    start_x: float
    start_y: float
    goal_x: float
    goal_y: float


class Ways(NamedTuple):
    """Shortest ways to the goal."""

    to_goal: Floats  # (n,): at least how far the goal is from each corner [m]
    from_start: Floats  # (n,) [m]
    at_goal: Floats  # (n,) [m]
    least: float  # at least how far the goal is from the start [m]
    direct: bool  # whether the start sees the goal
    steps: float  # steps taken
    final: bool  # whether the search came to its end
    links: Links  # what is known of the corners now


@njit
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
