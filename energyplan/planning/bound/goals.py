"""What no path to any pose of a goal can cost less than.

A goal at any heading has a bound over all of them. One that is reached somewhere in a disc has the
least bound of its sectors, without obstacles; among obstacles, that of its middle, less what going
on there takes at most.
"""

from __future__ import annotations

from itertools import pairwise
from math import asin, atan2, cos, hypot, inf, pi, remainder, sin, sqrt

import numpy as np

from energyplan.errors import GoalInCollisionError, OutsideMapError
from energyplan.path import Pose
from energyplan.planning.bound import (
    EFFORT,
    Bound,
    inscribed,
    least_at_any_heading,
    lower_bound,
)
from energyplan.planning.goal import Goal
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.motions import DIRECTIONS, KernelProblem, free_energy

_SECTORS = 48  # parts of a disc, by the direction from the start, whose least cost is found alone


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
    return lower_bound(query, cost, effort, any_heading=True) if cost > known.value else known


def _to_disc(
    query: CompiledProblem, goal: Goal, yaw: float | None, around: float, cost: float, effort: float
) -> Bound:
    """Return the bound to the points of a disc about a goal."""
    setting = query.setting
    middle = Pose(goal.x, goal.y, 0.0 if yaw is None else yaw)
    if yaw is not None:
        middle = query.centre(middle)
    known = Bound(_least_in_disc(setting, middle, around, any_heading=yaw is None), False)
    grid = query.grid
    column, row = np.floor(grid.to_cells(middle[:2])).astype(int)
    rows, columns = grid.shape
    if not (cost > known.value and 0 <= row < rows and 0 <= column < columns):
        return known
    room = float(grid.space.clearance[row, column]) * grid.resolution
    if not room > inscribed(query) + around + 2.0 * grid.resolution:
        return known
    # from anywhere in it the disc of the bound turns, and goes on to the middle
    on = around * float(query.prices[:, :: DIRECTIONS // 2].max())
    on += setting.least_radian * pi / (2.0 if setting.gear == 0 else 1.0)
    found = lower_bound(query.toward(middle), cost + on, effort, any_heading=True)
    return Bound(max(known.value, found.value - on), found.final)


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
    if away <= around:
        return 0.0
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
    turn = abs(remainder(middle.yaw - setting.start.yaw, 2.0 * pi))
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
