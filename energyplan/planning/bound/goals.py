"""What no path to any pose of a goal can cost less than.

A goal at any heading has a bound over all of them. One that is reached somewhere in a disc has the
bound of the point of it that is nearest and straightest ahead, without obstacles; among obstacles,
that of its middle, less what going on there takes at most.
"""

from __future__ import annotations

from math import asin, atan2, cos, hypot, inf, pi, remainder, sin

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
from energyplan.planning.space.motions import KernelProblem, free_energy


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
    known = Bound(_least_in_disc(setting, middle, around), False)
    # all of the disc is this near to the pose of the query
    far = around + hypot(setting.goal.x - middle.x, setting.goal.y - middle.y)
    grid = query.grid
    row_column = np.floor(grid.to_cells(setting.goal[:2])).astype(int)[::-1]
    room = grid.space.clearance[tuple(row_column)] * grid.resolution
    if not (cost > known.value and room > inscribed(query) + far + 2.0 * grid.resolution):
        return known
    found = lower_bound(query, cost, effort, any_heading=True)
    # from anywhere in it the disc of the bound turns, and goes on to the query's pose
    on = setting.least_metre * far + setting.least_radian * pi / (2.0 if setting.gear == 0 else 1.0)
    return Bound(max(known.value, found.value - on), found.final)


def _least_in_disc(setting: KernelProblem, middle: Pose, around: float) -> float:
    """Return a lower bound of the least cost without obstacles to any pose in a disc."""
    dx, dy = middle.x - setting.start.x, middle.y - setting.start.y
    away = hypot(dx, dy)
    if away <= around:
        return 0.0
    aside = remainder(atan2(dy, dx) - setting.start.yaw, 2.0 * pi)
    # backwards counts as ahead for a robot that reverses
    facing = 0.0 if setting.gear != 0 or abs(aside) <= 0.5 * pi else pi
    ahead = abs(remainder(aside - facing, 2.0 * pi))
    ahead = max(ahead - asin(around / away), 0.0) + setting.start.yaw
    nearest = Pose(
        setting.start.x + (away - around) * cos(ahead),
        setting.start.y + (away - around) * sin(ahead),
        setting.goal.yaw,
    )
    return least_at_any_heading(setting._replace(goal=nearest))


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
