"""Ends that lack the wanted clearance, and starts that the footprint just touches.

Nav2 replans from where the robot is, and localisation is a few millimetres off. A start or a goal
whose footprint is free is never refused for the clearance: it is left, or reached, with what
clearance there is, by the shortest ways found to where the whole clearance is kept, and everything
between is planned with all of it. A start that the footprint touches is moved to the nearest free
pose, no farther than `energyplan.planning.problem.MOVED`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from energyplan.errors import NoPathError
from energyplan.planning.budget import SHARES, Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.problem import KEPT, PlanningProblem, free_beside
from energyplan.planning.search.tight_ends import ways_out
from energyplan.planning.space.compiled import CompiledProblem


class Ends(NamedTuple):
    """A problem whose start was moved if it had to be, and what there is to say of its ends."""

    problem: PlanningProblem
    bare: PlanningProblem  # the same, without the clearance if an end lacks it
    notes: tuple[str, ...]


def checked_ends(problem: PlanningProblem) -> Ends:
    """Move a start that just touches an obstacle; check that both footprints are free."""
    beside = free_beside(problem.terrain.obstacles, problem.without_clearance.robot, problem.start)
    notes = [] if beside is None else [beside.note]
    if beside is not None:
        problem = replace(problem, start=beside.pose)
    if problem.ends_clear:
        return Ends(problem, problem, tuple(notes))
    bare = problem.without_clearance
    bare.check_poses()
    if problem.clearance:
        notes.append(
            f"start or goal has {problem.clearance_at_ends:.3f} m of the clearance of "
            f"{problem.clearance:g} m: it is left or reached with that, and the clearance is kept "
            "elsewhere"
        )
    return Ends(problem, bare, tuple(notes))


def between_clear_ends(
    problem: PlanningProblem,
    budget: Budget,
    solve: Callable[[PlanningProblem, Budget], Candidate],
) -> Candidate:
    """Plan between poses that have the clearance, and join start and goal that lack it to them."""
    if problem.ends_clear:
        return solve(problem, budget)
    error = NoPathError(
        f"no way was found from start and goal to where the clearance of {problem.clearance:g} m "
        "is kept; lower the clearance"
    )
    for share in KEPT:
        kept = replace(problem, clearance=share * problem.clearance_at_ends)
        query = CompiledProblem(kept, wanted=problem.clearance)
        for ends in ways_out(query, budget.part(SHARES.aside), turn=0.0):
            inner = replace(ends.problem, clearance=problem.clearance)
            if not inner.ends_clear:
                continue
            try:
                found = solve(inner, budget.part(1.0 - SHARES.aside))
            except NoPathError as reason:  # another way out may lead to elsewhere
                error = NoPathError(str(reason), resolution=reason.resolution)
                continue
            for path in (ends.refined(found.path, budget), ends.around(found.path)):
                if problem.first_collision(path) is None:
                    return replace(found, path=path, lower_bound=None)
    raise error
