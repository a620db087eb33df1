"""Where a plan begins and ends: determined once, before a planner runs.

Nav2 replans from where the robot is, and localisation is a few millimetres off. So a start that the
footprint touches is moved to the nearest free pose, no farther than `MOVED`. An end whose footprint
is free is never refused for the clearance: it is left, or reached, with what clearance there is, by
a short way to where the whole clearance is kept. The planner plans between such poses. So it is
with the margin of planning: a path that touches obstacles may be free or not by rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from energyplan.errors import InvalidPathError, NoPathError
from energyplan.path import Path, Pose
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.driven import Candidate
from energyplan.planning.problem import KEPT, LEAVING, PlanningProblem, free_beside
from energyplan.planning.search.narrow.escape import NOTHING, ways_out
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled, merged
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.cost_to_go import (
    CostToGo,
    cost_at_start,
    cost_to_go,
    reached,
    regions_for,
)
from energyplan.planning.space.motions import KernelProblem, steering_cost
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


@dataclass(frozen=True, eq=False)
class Ends:
    """Where searches begin and end, and the motions between there and the problem's own ends.

    The outer ways lead to where the whole clearance is kept, and the margin; the inner ones on to
    where there is room to turn. The outer ones are free as they are, not if cut elsewhere.
    """

    of: CompiledProblem  # the problem
    out: Segments = NOTHING  # outer way from the start
    back: Segments = NOTHING  # outer way to the goal
    inner: tuple[Segments, Segments] = (NOTHING, NOTHING)

    @property
    def query(self) -> CompiledProblem:
        """The problem that searches solve: of least energy, even for the shortest path."""
        return self.of.leading

    @property
    def lacking(self) -> bool:
        """Whether there are outer ways."""
        return len(self.out.ds) + len(self.back.ds) > 0

    @property
    def moved(self) -> bool:
        """Whether searches begin or end elsewhere than the problem does."""
        return self.lacking or sum(len(way.ds) for way in self.inner) > 0

    @cached_property
    def paths(self) -> tuple[Path, Path]:
        """The outer ways, as paths."""
        return self._paths(self.of.problem, self.out, self.back)

    def _paths(self, problem: PlanningProblem, *ways: Segments) -> tuple[Path, Path]:
        """Return the path from a problem's start, and the one into its goal."""
        out, back = (self.query.reference(*way) for way in ways)
        longitudinal = problem.cost.icr.longitudinal
        away = Path(problem.goal, -back.ds[::-1], -back.dtheta[::-1], longitudinal)
        return (
            Path(problem.start, out.ds, out.dtheta, longitudinal),
            Path(away.end, back.ds, back.dtheta, longitudinal),
        )

    @cached_property
    def problem(self) -> PlanningProblem:
        """The problem between the outer ways."""
        out, back = self.paths
        return replace(self.of.strict, start=out.end, goal=back.start)

    def setting(self, query: CompiledProblem) -> KernelProblem:
        """Return the kernels' problem between the outer ways, with the margin where it fits."""
        return _between(query, self.problem.start, self.problem.goal)

    @cached_property
    def between(self) -> KernelProblem:
        """The kernels' problem between the inner ways, with the margin where it fits."""
        out, back = self._paths(self.problem, *self.inner)
        return _between(self.query, out.end, back.start)

    @cached_property
    def to_go(self) -> CostToGo:
        """The cost-to-go between the inner ways."""
        return cost_to_go(self.between)

    @cached_property
    def cost(self) -> float:
        """Cost of the outer ways, less the potential."""
        query, total = self.query, 0.0
        for path, way in zip(self.paths, (self.out, self.back), strict=True):
            start, goal = query.centre(path.start), query.centre(path.end)
            if len(path):
                total += Refiner(query.setting._replace(start=start, goal=goal), way).cost
        return total

    def whole(self, found: Segments) -> Segments:
        """Return motions between the inner ways with these."""
        return chained(self.inner[0], found, self.inner[1])

    def path(self, query: CompiledProblem, found: Segments) -> Path:
        """Return the path from start to goal by motions between the outer ways."""
        return self.around(query.path(found, self.problem.start))

    def solved(
        self, solve: Callable[[PlanningProblem, Budget], Candidate], budget: Budget
    ) -> Candidate:
        """Return what a planner gives between these ends, with the ways there."""
        problem = self.of.strict
        if not self.lacking:
            return solve(problem, budget)
        found = solve(self.problem, budget.part(SHARES.stage))
        path = refined_at_ends(self, self.around(found.path), budget)
        if fault := problem.fault(path):
            raise InvalidPathError(f"with its ways from the start and to the goal this is {fault}")
        return Candidate(path, first_time=found.first_time)

    def around(self, inner: Path) -> Path:
        """Return the path from the problem's start to its goal by one between the outer ways."""
        out, back = self.paths
        ds, dtheta = chained(out, inner, back)
        return replace(inner, start=out.start, ds=ds, dtheta=dtheta)


def _between(query: CompiledProblem, start: Pose, goal: Pose) -> KernelProblem:
    """Return the kernels' problem between two poses, with the margin where both have it."""
    body = query.grown if query.has_margin(start) and query.has_margin(goal) else query.body
    return query.setting._replace(body=body, start=query.centre(start), goal=query.centre(goal))


def chained(*parts: Segments | Path) -> Segments:
    """Return several motions, one after the other."""
    ds, dtheta = zip(*((part.ds, part.dtheta) for part in parts), strict=True)
    return Segments(np.concatenate(ds), np.concatenate(dtheta))


def find_ends(problem: PlanningProblem, budget: Budget, *, turning: bool = True) -> Ends:
    """Return where to search between: at start and goal, or near them where there is more room.

    There is the whole clearance, and the margin, and room to turn as well if that matters.
    """
    found = _with_clearance(problem, budget)
    if not turning:
        return found
    inner = compiled(found.problem) if found.lacking else found.of
    for ways in ways_out(inner.leading, budget.part(SHARES.aside)):
        more = replace(found, inner=ways)
        if _reached(more, budget):
            return more
    if not found.lacking:
        _reached(found, budget)
    return found


def _with_clearance(problem: PlanningProblem, budget: Budget) -> Ends:
    """Return ends that have the whole clearance, and the margin if there is any room for it."""
    if problem.ends_clear:
        ends = Ends(compiled(problem))
        return ends if ends.of.ends_have_margin else _best_ways(problem, ends.of, budget) or ends
    there_is = problem.clearance_at_ends
    # as near to obstacles as the ends are, but for what turning takes; nearer where that is in vain
    for clearance in dict.fromkeys([max(there_is - _SWING, 0.0), 0.0]):
        query = CompiledProblem(replace(problem, clearance=clearance), problem)
        if found := _best_ways(problem, query, budget):
            return found
    raise NoPathError(
        f"no way was found from start and goal to where the clearance of {problem.clearance:g} m "
        "is kept; lower the clearance"
    )


def _reached(ends: Ends, budget: Budget) -> bool:
    """Return whether the poses tested join two ends; what that takes depends on the map."""
    budget.beside(lambda: regions_for(ends.between))
    budget.spend_on_map(ends.to_go.work / UNITS.nodes)
    return reached(ends.to_go, ends.between)


def _best_ways(problem: PlanningProblem, of: CompiledProblem, budget: Budget) -> Ends | None:
    """Return the ways that promise the least cost on the whole, of those from one end or both."""
    size = float(np.hypot(*np.ptp(problem.robot.footprint, axis=0)))
    found: list[tuple[bool, bool, float, Ends]] = []
    # ways of little cost; where none is found, short ones to where there is room to turn
    tried = ways_out(of.leading, budget.part(SHARES.aside), turn=0.0)
    tried = tried or ways_out(of.leading, budget.part(SHARES.aside))
    for ways in tried:
        ends = Ends(of, *ways)
        inner, setting = ends.problem, ends.between
        if not (inner.ends_clear and all(map(problem.allows, ends.paths))):
            continue
        far = np.inf if not _reached(ends, budget) else cost_at_start(ends.to_go, setting)
        far *= setting.least_metre
        least = steering_cost(setting, setting.start, setting.goal)
        cost = sum(ends.query.value(path) for path in ends.paths) + max(far, least)
        soon = all(np.hypot(*np.subtract(*ends)) <= LEAVING * size for ends in (
            (inner.start[:2], problem.start[:2]), (inner.goal[:2], problem.goal[:2])
        ))  # fmt: skip
        found.append((far == np.inf, not soon, cost, ends))
    # if none of them is joined, the planner says why
    return min(found, key=lambda one: one[:3])[-1] if found else None


def refined_at_ends(ends: Ends, path: Path, budget: Budget) -> Path:
    """Refine a path where it leaves or reaches an end that lacks clearance, by what room it has."""
    query, best = ends.of, path
    problem = query.strict
    if problem.ends_clear and query.ends_have_margin:
        return path
    spare = problem.clearance_at_ends - query.problem.clearance
    room = dict.fromkeys(grown(query.body, share * spare) for share in KEPT)
    size = float(np.hypot(*np.ptp(problem.robot.footprint, axis=0)))
    for _ in range(_ROUNDS):
        before = query.value(best)
        for goal, way in enumerate((ends.out, ends.back)):
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
