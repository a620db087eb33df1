"""Where a plan begins and ends: determined once, before a planner runs.

Nav2 replans from where the robot is, and localisation is a few millimetres off. So a start that the
footprint touches is moved to the nearest free pose, no farther than `MOVED`. An end whose footprint
is free is never refused for the clearance: it is left, or reached, with what clearance there is, by
a short way to where the whole clearance is kept. The planner plans between such poses. So it is
with the margin of planning: a path that touches obstacles may be free or not by rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from energyplan.errors import NoPathError
from energyplan.path import Path
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.plans import Candidate
from energyplan.planning.problem import KEPT, PlanningProblem, free_beside
from energyplan.planning.search.narrow.ends import Ends, ways_out
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.cost_to_go import cost_to_go, reached, regions_for


class CheckedEnds(NamedTuple):
    """A problem whose start was moved if it had to be, and what there is to say of its ends."""

    problem: PlanningProblem
    bare: PlanningProblem  # the same, without the clearance if an end lacks it
    notes: tuple[str, ...]


def checked_ends(problem: PlanningProblem) -> CheckedEnds:
    """Move a start that just touches an obstacle; check that both footprints are free."""
    moved = free_beside(problem.terrain.obstacles, problem.without_clearance.robot, problem.start)
    notes = [] if moved is None else [moved.note]
    if moved is not None:
        problem = replace(problem, start=moved.pose)
    if problem.ends_clear:
        return CheckedEnds(problem, problem, tuple(notes))
    bare = problem.without_clearance
    bare.check_poses()
    if problem.clearance:
        notes.append(
            f"start or goal has {problem.clearance_at_ends:.3f} m of the clearance of "
            f"{problem.clearance:g} m: it is left or reached with that, and the clearance is kept "
            "elsewhere"
        )
    return CheckedEnds(problem, bare, tuple(notes))


class Between(NamedTuple):
    """The problem between poses that have clearance and margin, and the ways to these poses."""

    problem: PlanningProblem  # what a planner is to solve
    ways: Ends | None = None  # from the start and to the goal; None where these have both

    def solved(
        self,
        problem: PlanningProblem,
        budget: Budget,
        solve: Callable[[PlanningProblem, Budget], Candidate],
        known: Sequence[Path],
    ) -> Candidate:
        """Solve it, and return what that gives from start to goal; no known path costs less."""
        if self.ways is None:
            return solve(self.problem, budget)
        found = solve(self.problem, budget.part(SHARES.stage))
        path = self.ways.refined(found.path, budget)
        if problem.fault(path):
            path = self.ways.around(found.path)
        free = [one for one in known if problem.fault(one) is None]
        # other paths that were found begin and end elsewhere
        return Candidate(min([path, *free], key=self.ways.query.value), first_time=found.first_time)


def between_clear_ends(problem: PlanningProblem, budget: Budget) -> Between:
    """Return what to plan between: start and goal, or poses near them with more room."""
    if problem.ends_clear and compiled(problem).ends_have_margin:
        return Between(problem)
    found: list[Between] = []
    for share in (1.0,) if problem.ends_clear else KEPT:
        kept = replace(problem, clearance=share * problem.clearance_at_ends)
        wanted = 0.0 if problem.ends_clear else problem.clearance
        query = CompiledProblem(kept, wanted)
        for ways in ways_out(query, budget.part(SHARES.aside), turn=0.0):
            inner = replace(ways.problem, clearance=problem.clearance)
            if not (ways.moved and inner.ends_clear and all(map(problem.allows, ways.paths))):
                continue
            found.append(Between(inner, ways))
            setting = compiled(inner).leading.setting
            budget.beside(partial(regions_for, setting))
            to_go = cost_to_go(setting)
            budget.spend(to_go.work / UNITS.nodes)
            if reached(to_go, setting):
                return found[-1]
    if found:  # the planner says why they are not joined
        return found[0]
    if problem.ends_clear:
        return Between(problem)
    raise NoPathError(
        f"no way was found from start and goal to where the clearance of {problem.clearance:g} m "
        "is kept; lower the clearance"
    )
