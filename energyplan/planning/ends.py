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
from math import inf
from typing import NamedTuple

import numpy as np

from energyplan.errors import InvalidPathError, NoPathError
from energyplan.path import Path, Pose
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.driven import Candidate
from energyplan.planning.problem import KEPT, LEAVING, PlanningProblem, free_beside
from energyplan.planning.search.narrow.ends import Ends, ways_out
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled, merged
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.cost_to_go import cost_at_start, cost_to_go, regions_for
from energyplan.planning.space.motions import steering_cost
from energyplan.terrain.collision import Body

_FAR = (1.0, 2.0, 4.0, 8.0)  # how far from an end paths are refined for what room is there [sizes]
_SWING = 0.02  # clearance that an end has and leaving it need not keep, for corners swing out [m]
_PIECE = 0.05  # segments at whose ends that may begin or end [sizes], [rad]
_ROUNDS = 3  # of refining at the ends and in between, at most
_GAIN = 1e-3  # least part of the cost by which another round, or less room, has to pay


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
        path = whole = self.ways.around(found.path)
        if not problem.ends_clear:
            path = _refined_at_ends(problem, self.ways, whole, budget)
        elif problem.fault(path := self.ways.refined(found.path, budget)):
            path = whole
        free = [one for one in known if problem.fault(one) is None]
        # other paths that were found begin and end elsewhere
        best = min([path, *free], key=self.ways.query.value)
        if fault := problem.fault(best):
            raise InvalidPathError(f"with its ways from the start and to the goal this is {fault}")
        return Candidate(best, first_time=found.first_time)


def between_clear_ends(problem: PlanningProblem, budget: Budget) -> Between:
    """Return what to plan between: start and goal, or poses near them with more room."""
    if problem.ends_clear and compiled(problem).ends_have_margin:
        return Between(problem)
    if problem.ends_clear:
        found = _joined_ways(problem, CompiledProblem(problem), budget)
        return found or Between(problem)
    there_is = problem.clearance_at_ends
    # as near to obstacles as the ends are, but for what turning takes; nearer where that is in vain
    for clearance in dict.fromkeys([max(there_is - _SWING, 0.0), 0.0]):
        query = CompiledProblem(replace(problem, clearance=clearance), problem.clearance)
        if found := _joined_ways(problem, query, budget):
            return found
    raise NoPathError(
        f"no way was found from start and goal to where the clearance of {problem.clearance:g} m "
        "is kept; lower the clearance"
    )


def _joined_ways(
    problem: PlanningProblem, query: CompiledProblem, budget: Budget
) -> Between | None:
    """Return the ways that promise the least cost on the whole, of those from one end or both."""
    size = float(np.hypot(*np.ptp(problem.robot.footprint, axis=0)))
    found: list[tuple[bool, bool, float, Between]] = []
    for ways in ways_out(query, budget.part(SHARES.aside), turn=0.0):
        inner = replace(ways.problem, clearance=problem.clearance)
        if not (ways.moved and inner.ends_clear and all(map(problem.allows, ways.paths))):
            continue
        setting = compiled(inner).leading.setting
        if not found:
            budget.beside(partial(regions_for, setting))
        to_go = cost_to_go(setting)
        budget.spend_on_map(to_go.work / UNITS.nodes)
        far = cost_at_start(to_go, setting) * setting.least_metre
        least = steering_cost(setting, setting.start, setting.goal)
        cost = sum(query.value(path) for path in ways.paths) + max(far, least)
        soon = all(np.hypot(*np.subtract(*ends)) <= LEAVING * size for ends in (
            (inner.start[:2], problem.start[:2]), (inner.goal[:2], problem.goal[:2])
        ))  # fmt: skip
        found.append((far == inf, not soon, cost, Between(inner, ways)))
    # if none of them is joined, the planner says why
    return min(found, key=lambda one: one[:3])[-1] if found else None


def _refined_at_ends(problem: PlanningProblem, ways: Ends, path: Path, budget: Budget) -> Path:
    """Refine a path where it leaves or reaches an end that lacks clearance, by what room it has."""
    query, best = ways.query, path
    spare = problem.clearance_at_ends - query.problem.clearance
    room = [grown(query.body, share * spare) for share in KEPT]
    size = float(np.hypot(*np.ptp(problem.robot.footprint, axis=0)))
    for _ in range(_ROUNDS):
        before = query.value(best)
        for goal, way in enumerate((ways.out, ways.back)):
            for far in _FAR if len(way.ds) else ():
                fine = best.subdivide(_PIECE * size, _PIECE)
                along = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
                at = along[-1] - far * size if goal else far * size
                cut = min(int(np.searchsorted(along, at)), len(fine))
                part = (cut, len(fine)) if goal else (0, cut)
                for body in room:
                    found = _refined_part(query, body, fine, part, budget)
                    # less room is used where that saves something
                    if _saves(query, found, best) and problem.fault(found) is None:
                        best = found
        found = _refined_part(query, query.grown, best, (0, len(best)), budget)
        if query.value(found) < query.value(best) and problem.fault(found) is None:
            best = found
        if not query.value(best) < before * (1.0 - _GAIN):
            break
    fewer = merged(Segments(best.ds, best.dtheta))
    found = replace(best, ds=fewer.ds, dtheta=fewer.dtheta)
    return best if problem.fault(found) else found


def _saves(query: CompiledProblem, path: Path, other: Path) -> bool:
    """Return whether a path costs clearly less than another."""
    return query.value(path) < query.value(other) * (1.0 - _GAIN)


def _refined_part(
    query: CompiledProblem, body: Body, path: Path, part: tuple[int, int], budget: Budget
) -> Path:
    """Return a path some segments of which were refined for a body; it may not be free."""
    begin, end = part
    if begin >= end or budget.over:
        return path
    ds, dtheta = path.ds, path.dtheta
    start, goal = (query.centre(Pose(*path.vertices[k].tolist())) for k in part)
    refiner = Refiner(
        query.setting._replace(body=body, start=start, goal=goal),
        query.of_centre(ds[begin:end], dtheta[begin:end]),
    )
    refiner.shortcut(budget)
    refiner.polish(budget)
    new = query.reference(*refiner.segments)
    return replace(
        path,
        ds=np.concatenate([ds[:begin], new.ds, ds[end:]]),
        dtheta=np.concatenate([dtheta[:begin], new.dtheta, dtheta[end:]]),
    )
