"""What no path to any pose of a goal can cost less than.

A goal at any heading has a bound over all of them. One that is reached somewhere in a disc has the
least bound of its sectors, without obstacles; among obstacles, the least of discs that cover it.
"""

from __future__ import annotations

from heapq import heappop, heappush
from itertools import pairwise
from math import asin, atan2, cos, hypot, inf, pi, remainder, sin, sqrt
from typing import NamedTuple

import numpy as np

from energyplan.errors import GoalInCollisionError, OutsideMapError
from energyplan.path import Pose
from energyplan.planning.bound import (
    EFFORT,
    Bound,
    Disc,
    inscribed,
    least_at_any_heading,
    least_without_obstacles,
    lower_bound,
)
from energyplan.planning.bound.surfaces import CLEARANCE_ERROR
from energyplan.planning.goal import Goal
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.settings import BOUND
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.motions import KernelProblem, free_energy

_SECTORS = 48  # parts of a disc, by the direction from the start, whose least cost is found alone

_PLACE = Disc(any_heading=True)

_PARTS = tuple(
    (0.5 * length * cos(k * pi / 3.0), 0.5 * length * sin(k * pi / 3.0))
    for length, k in ((0.0, 0), *((sqrt(3.0), k) for k in range(6)))
)
"""Middles of seven discs of half the radius that cover a disc, over its radius."""


def least_to_goal(
    problem: PlanningProblem, goal: Goal, cost: float = 0.0, effort: float = EFFORT
) -> Bound:
    """Return a lower bound of the cost of every path to any pose of a goal, with the potential.

    The goal of `problem` is one of these poses. Obstacles are looked at where a path of some cost
    is known.
    """
    query = compiled(problem)
    values, final = [inf], True
    for yaw in goal.headings or (None,):
        # the middle of the treads is reached this far from where it is looked for, at most
        around = goal.radius + (hypot(*query.middle) if yaw is None else 0.0)
        if around > 0.0:
            found = _to_disc(query, goal, yaw, around, cost, effort)
        elif yaw is None:
            found = _to_place(query, cost, effort)
        else:
            found = _to_pose(problem, Pose(goal.x, goal.y, yaw), cost, effort)
        values.append(found.value)
        final = final and found.final
    return Bound(min(values) + _least_potential(query, goal), final)


def _to_pose(problem: PlanningProblem, pose: Pose, cost: float, effort: float) -> Bound:
    """Return the bound to a single pose; infinite where the robot cannot be."""
    try:
        query = compiled(problem.toward(pose))
    except (GoalInCollisionError, OutsideMapError):
        return Bound(inf, True)
    known = Bound(float(free_energy(query.setting, query.setting.start)), False)
    return lower_bound(query, cost, effort) if cost > known.value else known


def _to_place(query: CompiledProblem, cost: float, effort: float) -> Bound:
    """Return the bound to the place of the query's goal at any heading."""
    known = Bound(least_at_any_heading(query.setting), False)
    return lower_bound(query, cost, effort, target=_PLACE) if cost > known.value else known


class _Region(NamedTuple):
    """A disc of the places that a path may end at."""

    value: float  # what every path to it costs at least
    number: int
    x: float
    y: float
    around: float  # [m]
    bounded: bool  # whether obstacles were looked at


def _to_disc(
    query: CompiledProblem, goal: Goal, yaw: float | None, around: float, cost: float, effort: float
) -> Bound:
    """Return the bound to the points of a disc about a goal.

    The disc is divided into smaller ones where that may raise the bound: the ones of least cost
    first, until the search over corners takes too long.
    """
    middle = Pose(goal.x, goal.y, 0.0 if yaw is None else yaw)
    if yaw is not None:
        middle = query.centre(middle)
    least = _least_in_disc(query.setting, middle, around, any_heading=yaw is None)
    if not cost > least:
        return Bound(least, False)
    limit, spent = BOUND.beyond * cost, 0.0
    heap, count = [_Region(least, 0, middle.x, middle.y, around, False)], 1
    while heap:
        region = heappop(heap)
        if region.value >= limit:
            return Bound(region.value, True)
        if spent > effort or count > BOUND.regions:
            return Bound(region.value, False)
        if not region.bounded:
            found = _to_region(query, region, yaw, cost, effort - spent)
            spent += found.steps
            if found.value < inf:
                value = max(region.value, found.value)
                heappush(heap, region._replace(value=value, bounded=True))
            continue
        for x, y in _PARTS:
            part = region._replace(
                x=region.x + region.around * x, y=region.y + region.around * y,
                around=0.5 * region.around, bounded=False, number=count,
            )  # fmt: skip
            if hypot(part.x - middle.x, part.y - middle.y) >= part.around + around:
                continue
            target = Disc(part.around, yaw is None)
            setting = query.setting._replace(goal=Pose(part.x, part.y, middle.yaw))
            value = max(region.value, least_without_obstacles(setting, target))
            heappush(heap, part._replace(value=value))
            count += 1
    return Bound(inf, True)


def _to_region(
    query: CompiledProblem, region: _Region, yaw: float | None, cost: float, effort: float
) -> Bound:
    """Return the bound to a disc about whose places obstacles lie; infinite where none is free."""
    grid, radius = query.grid, inscribed(query)
    at = grid.to_cells((region.x, region.y))
    column, row = np.floor(at).astype(int)
    rows, columns = grid.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return Bound(region.value, True)
    off = float(np.hypot(*(at - (column, row) - 0.5))) + CLEARANCE_ERROR
    clearance = float(grid.space.clearance[row, column])
    if (clearance + off) * grid.resolution + region.around < radius:
        return Bound(inf, True)
    room = (clearance - off) * grid.resolution - region.around
    radius = radius if room >= radius else BOUND.smaller * radius
    if not room >= radius > 0.0:
        return Bound(region.value, True)
    target = Disc(region.around, yaw is None, region.value, radius)
    middle = Pose(region.x, region.y, 0.0 if yaw is None else yaw)
    return lower_bound(query.toward(middle), cost, effort, target=target)


def _least_in_disc(
    setting: KernelProblem, middle: Pose, around: float, *, any_heading: bool
) -> float:
    """Return a lower bound of the least cost without obstacles to any pose in a disc.

    At any heading a place costs the more the further away it is, and the further from straight
    ahead. So the points of a sector cost no less than one as near as the nearest of them that is as
    far ahead as any of them. The middle has the goal's heading, if that matters.
    """
    dx, dy = middle.x - setting.start.x, middle.y - setting.start.y
    away = hypot(dx, dy)
    turn = 0.0 if any_heading else abs(remainder(middle.yaw - setting.start.yaw, 2.0 * pi))
    if away <= around:
        return setting.steering.per_radian * turn
    ahead = atan2(dy, dx) - setting.start.yaw
    wide = asin(around / away)

    def aside(angle: float) -> float:
        """Return how far a direction is from straight ahead, or back for a robot that reverses."""
        off = abs(remainder(angle, 2.0 * pi))
        return min(off, pi - off) if setting.gear == 0 else off

    limits = np.linspace(-wide, wide, _SECTORS + 1).tolist()
    least = inf
    for low, high in pairwise(limits):
        nearest = max(low, -high, 0.0)
        distance = away * cos(nearest) - sqrt(max(around**2 - (away * sin(nearest)) ** 2, 0.0))
        off = min(aside(ahead + low), aside(ahead + high))
        if aside(ahead + 0.5 * (low + high)) < off:  # straight ahead lies within
            off = 0.0
        place = setting.start.yaw + off
        at = Pose(
            setting.start.x + distance * cos(place),
            setting.start.y + distance * sin(place),
            setting.goal.yaw,
        )
        least = min(least, least_at_any_heading(setting._replace(goal=at)))
    if any_heading:
        return least
    return max(least, setting.least_metre * (away - around) + setting.least_radian * turn)


def _least_potential(query: CompiledProblem, goal: Goal) -> float:
    """Return the least potential of the height of the poses of a goal."""
    if query.terrain.heights is None:
        return 0.0
    poses = [Pose(goal.x, goal.y, yaw) for yaw in goal.headings or (query.problem.goal.yaw,)]
    least = min(query.potential(pose) for pose in poses)
    around = goal.radius
    if not goal.headings:
        around += 2.0 * abs(query.problem.cost.icr.longitudinal)
    if around == 0.0:
        return least
    heights = query.terrain.heights
    # along either axis a bilinear patch is no steeper than its edges
    edges = (float(np.abs(np.diff(heights.heights, axis=axis)).max()) for axis in (0, 1))
    return least - abs(query.height_price) * hypot(*edges) / heights.resolution * around
