"""Plans for a robot that is under way, on a map that may have changed.

Planning starts from the rest of the former plan. If it is free, and no cell has become free since
that plan, no route can have become cheaper. Then the rest is the answer, within milliseconds.
Otherwise the planner plans anew, with the rest as a first path where it is free. So it does where
nothing but a path is known, which does not say on which map it was best, or what for: and where the
former plan was made at other costs, for another body, or within other constraints.

No new lower bound is computed among the obstacles, because it would need new outlines. If obstacles
were only added, the former plan's bound less the cost driven so far is still a bound. The least
cost in free space always is one.
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from energyplan import steering
from energyplan.errors import EnergyPlanError, InvalidInputError
from energyplan.path import Path, Pose, as_pose, wrap_angle
from energyplan.planning.budget import plan_budget
from energyplan.planning.driven import Candidate
from energyplan.planning.ends import checked_ends
from energyplan.planning.plans import Plan, plan, priced_plan
from energyplan.planning.problem import KEPT, PlanningProblem, missed
from energyplan.planning.search import planner as lattice
from energyplan.planning.search.planner import compile_planning
from energyplan.planning.settings import REJOINING
from energyplan.planning.space.compiled import Segments, compiled, merged
from energyplan.records import checked
from energyplan.terrain import OccupancyGrid


def remainder(path: Path, pose: ArrayLike, problem: PlanningProblem) -> Path | None:
    """Return what is left of a path for a robot on it or near it."""
    here = as_pose(pose, "the robot's pose")
    fine = _places(path, problem)
    from_here = replace(problem, start=here, goal=path.end, goals=())
    several = [_joined(here, fine, k, problem) for k in _places_ahead(fine, here, problem)]
    joined = [rest for rest in several if rest is not None]
    for share in KEPT if not from_here.ends_clear else (1.0,):
        free = [rest for rest in joined if from_here.fault(rest, share) is None]
        if free:
            return min(free, key=compiled(from_here.without_clearance).value)
    return None


def _places(path: Path, problem: PlanningProblem) -> Path:
    """Return a path cut at the places that are looked at."""
    return path.subdivide(REJOINING.step * problem.cost.half_track, REJOINING.turn)


def _places_ahead(fine: Path, here: Pose, problem: PlanningProblem) -> list[int]:
    """Return the vertices of a path at which a robot may get back to it, the nearest one first."""
    off = fine.vertices - np.array(here)
    rotation = problem.cost.half_track * wrap_angle(off[:, 2])
    away = np.hypot(np.hypot(off[:, 0], off[:, 1]), rotation)
    # of a place that it passes twice the later time counts
    nearest = int(np.flatnonzero(away <= away.min() + REJOINING.alike)[-1])
    along = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    ahead = np.searchsorted(
        along, along[nearest] + problem.cost.half_track * np.array(REJOINING.ahead)
    )
    # the place itself, and the one after it, which the robot may have passed the first part of
    return sorted({nearest, *np.clip([nearest + 1, *ahead], nearest, len(fine)).tolist()})


def _joined(here: Pose, fine: Path, vertex: int, problem: PlanningProblem) -> Path | None:
    """Return the way from a pose to a vertex of a path, and from there on."""
    at = Pose(*(float(v) for v in fine.vertices[vertex]))
    rest = Path(at, fine.ds[vertex:], fine.dtheta[vertex:], fine.longitudinal)
    gap = np.hypot(at.x - here.x, at.y - here.y) + abs(float(wrap_angle(at.yaw - here.yaw)))
    if gap > REJOINING.alike:
        try:
            rest = steering.path(here, at, problem.cost, reverse=problem.robot.reverse) + rest
        except EnergyPlanError:  # a vehicle that steering knows no way for
            return None
    kept = merged(Segments(rest.ds, rest.dtheta))
    return Path(here, kept.ds, kept.dtheta, rest.longitudinal)


def _bound_left(former: Plan, here: Pose) -> float:
    """Return what is left of a plan's lower bound where the robot is, on the map of that plan."""
    problem = former.problem
    if problem is None:
        return -np.inf
    fine = _places(former.path, problem)
    k = _places_ahead(fine, here, problem)[0]
    at = Pose(*(float(v) for v in fine.vertices[k]))
    part = Path(fine.start, fine.ds[:k], fine.dtheta[:k], fine.longitudinal)
    try:
        came = part + steering.path(at, here, problem.cost, reverse=problem.robot.reverse)
    except EnergyPlanError:
        return -np.inf
    # what leads on from here continues a path that the bound holds for, if this one is such a path
    driven = replace(problem, start=former.path.start, goal=here, goals=())
    clear = bool(driven.terrain.obstacles.footprint_free(here, driven.robot))
    if not clear or driven.fault(came) is not None:
        return -np.inf
    return former.lower_bound_steady - compiled(driven.without_clearance).value(came)


@checked()
def replan(
    problem: PlanningProblem,
    former: Plan | Path,
    *,
    start: ArrayLike,
    map: OccupancyGrid | None = None,
    time_limit: float = inf,
    effort: int | None = None,
) -> Plan:
    """Plan on from where the robot is, with the rest of the former plan as a start.

    If the rest of a former plan is free, and no cell became free, it is returned at once. Otherwise
    the planner uses its budget: also where a path alone is given, or where the plan was made at
    another cost or within other constraints than those of `problem`. The new plan never costs more
    than the rest of the former one, if that is free.

    Parameters
    ----------
    problem : PlanningProblem
        What is to be planned: cost, constraints, objective, and the former plan's goal.
    former : Plan or Path
        The former plan, to the goal or to one of several, which knows the problem and the map that
        it was made for; or a path alone.
    start : array_like, shape (3,)
        Where the robot is now: x, y [m], yaw [rad] of the body frame.
    map : OccupancyGrid, optional
        The current map, best from `OccupancyGrid.updated`, which keeps the tables of the former
        one; the problem's if left out.
    time_limit, effort : float, int
        What planning may spend, as for `plan`.

    Returns
    -------
    Plan
        The plan from there. Its lower bound is what is known without a search: what is left of the
        former one where obstacles only were added, or the least cost without obstacles.

    Raises
    ------
    InvalidInputError
        If the former plan leads elsewhere than to the problem's goal.
    StartInCollisionError, GoalInCollisionError, OutsideMapError, NoPathError, TimeLimitError
        As for `plan`.

    Examples
    --------
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.planning import plan
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
    >>> problem = PlanningProblem(hall, cost, start=(2, 5, 0), goal=(8, 5, 0))
    >>> former = plan(problem, effort=1000)
    >>> round(replan(problem, former, start=(4, 5, 0)).energy_driven)
    800
    >>> closed = hall.updated(np.ones((10, 10), bool), row=45, column=55)
    >>> replan(problem, former, start=(4, 5, 0), map=closed, effort=1000).energy_driven > 820
    True
    """
    before = former if isinstance(former, Path) else former.path
    several = any(goal.reached_by(before.end) for goal in problem.goals)
    if not several and (elsewhere := missed("ends", before.end, problem.goal)):
        raise InvalidInputError(
            f"the former plan is a path that {elsewhere}; give the problem that it answers, or "
            "plan again"
        )
    plan_budget(time_limit, effort)  # says at once what is wrong with them
    now = replace(problem, start=as_pose(start, "start"), map=problem.map if map is None else map)
    if several:
        now = replace(now, goal=before.end)
    ends = checked_ends(now)
    now = ends.problem
    compile_planning(ends.bare, tight=True)
    budget = plan_budget(time_limit, effort)
    query = compiled(ends.bare)
    bound = query.least_in_free_space if not now.goals else -inf
    rest, planner = remainder(before, now.start, now), "lattice"
    holds = isinstance(former, Plan) and _still_holds(former, now)
    if isinstance(former, Plan) and holds:
        planner, bound = former.planner, max(bound, _bound_left(former, now.start))
    if rest is not None and holds:
        found = Candidate(rest)
    elif now.goals:
        known = [] if rest is None else [rest]
        return plan(now, time_limit=time_limit, effort=effort, initial=known)
    else:
        known = [] if rest is None else [rest]
        found = lattice.plan(now, budget, initial=known, bound=query.least_in_free_space)
        planner = "lattice"
    return priced_plan(query, found, bound, planner, budget, problem=now, notes=ends.notes)


def _still_holds(former: Plan, now: PlanningProblem) -> bool:
    """Return whether no path can cost less by now than when a plan was made."""
    before = former.problem
    return before is not None and _only_added(before, now) and _same_question(before, now)


def _only_added(before: PlanningProblem, now: PlanningProblem) -> bool:
    """Return whether every cell that is free now was free before."""
    if now.map is before.map:
        return True
    old, new = before.terrain.obstacles, now.terrain.obstacles
    same = old.shape == new.shape and old.resolution == new.resolution and old.origin == new.origin
    return same and not bool(np.any(old.blocked & ~new.blocked))


def _same_question(before: PlanningProblem, now: PlanningProblem) -> bool:
    """Return whether two problems allow the same paths at the same cost, but for map and ends."""
    one, other = (
        (
            *(getattr(problem.cost, part.name) for part in fields(problem.cost)),
            *(problem.robot, problem.clearance, problem.least_radius, problem.weights),
            *(problem.surfaces, problem.heights),
            *((problem.costmap, problem.costmap_weight) if problem.softened else ()),
        )
        for problem in (before, now)
    )
    return one == other
