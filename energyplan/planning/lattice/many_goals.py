"""The energies from one pose to many goals, from a single search."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from energyplan.compilation import njit
from energyplan.errors import InvalidInputError, NoPathError, TimeLimitError
from energyplan.kinds import checked
from energyplan.path import FloatArray, as_pose
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.planner import first_motions
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.search import Search, coarse_lattice
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.ready import compiled, prepare
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import no_distance
from energyplan.planning.scene.motions import KernelProblem, connection, free_energy

STRIDE = 30_000
"""Expansions of the search between two attempts to reach the goals."""

POLISH = 800
"""Attempts at each path."""


@checked()
def energies(
    problem: PlanningProblem,
    goals: ArrayLike,
    time_limit: float = 10.0,
    *,
    effort: int | None = None,
    refined: bool = True,
) -> FloatArray:
    """Return the cost from the problem's start to each of many goals, from a single search.

    One search without a goal reaches everything within the cost of the farthest goal, on a lattice
    half as coarse again. Each goal is joined to it exactly, and the path is refined a little. To a
    goal that it does not reach, in its work or through gaps that it is too coarse for, a path is
    sought as `energyplan.plan` seeks its first one, with a budget of its own. The costs are those
    of drivable paths, close to the least and never below it.
    """
    rows = np.asarray(goals, float)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InvalidInputError(f"goals have shape {rows.shape}; give rows of x, y, yaw")
    out = np.full(len(rows), np.inf)
    if len(rows) == 0:
        return out
    query = CompiledProblem(problem)
    settings = []
    for row in rows:
        goal = as_pose(row, "a goal")
        replace(problem, goal=goal).check_poses()
        centre = query.centre(goal)
        settings.append(
            query.setting._replace(goal_x=centre.x, goal_y=centre.y, goal_yaw=centre.yaw)
        )
    compiled(problem, tight=False)
    lattice = coarse_lattice(query.setting)
    search = Search(query.setting, no_distance(), lattice, 0.0, aligned=True)
    budget = Budget(time_limit, effort=effort)
    missing = list(range(len(rows)))
    status = kernels.RUNNING
    while missing and status == kernels.RUNNING and not budget.over:
        status = search.run(budget, stop_at_first=False, expansions=STRIDE)
        ended = status != kernels.RUNNING or budget.over
        reached = search.frontier
        for k in missing.copy():
            cost, node = attach(search.tree, settings[k], lattice, 6.0 * lattice.cell)
            # nothing that is still open can better it by more than the lattice is coarse
            if cost <= reached or (np.isfinite(cost) and ended):
                missing.remove(k)
                out[k] = _cost(settings[k], search.segments(settings[k], node), refined)
    for k in missing:
        asked = replace(problem, goal=as_pose(rows[k], "a goal"))
        compiled(asked)
        prepare(asked)
        with suppress(NoPathError, TimeLimitError):
            motions = first_motions(asked, Budget(time_limit, effort=effort))
            out[k] = _cost(settings[k], motions, refined)
    return out + [query.potential(as_pose(row, "a goal")) for row in rows]


def _cost(setting: KernelProblem, motions: Segments, refined: bool) -> float:
    """Return the cost of some motions, refined a little where asked for."""
    refiner = Refiner(setting, motions)
    if refined:
        refiner.shortcut(UNLIMITED)
        refiner.polish(UNLIMITED, most=POLISH)
    return refiner.cost


@njit
def attach(
    tree: kernels.Tree, setting: KernelProblem, lattice: kernels.Lattice, reach: float
) -> tuple[float, int]:
    """Join the goal to nearby nodes; return the least cost and the node, or inf and -1."""
    best = inf
    node = -1
    for k in range(int(tree.counts[0])):
        g = tree.g[k]
        x = tree.x[k]
        y = tree.y[k]
        if g == -inf or abs(x - setting.goal_x) > reach or abs(y - setting.goal_y) > reach:
            continue
        yaw = setting.start_yaw + int(tree.heading[k]) * lattice.turn
        if g + free_energy(setting, x, y, yaw) >= best:
            continue
        cost = connection(setting, x, y, yaw, best - g)
        if g + cost < best:
            best = g + cost
            node = k
    return best, node
