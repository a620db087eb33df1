"""Plans to one of several poses: a place at any heading, a pose either way round, the nearest dock.

Routes to each goal say which of them promises the least cost. A plan leads there, and its end is
moved to the pose of the goal that is cheapest along the path. Other goals and headings that promise
as much get a plan of their own, as long as their lower bound lies below the best cost. The rest of
the budget refines the best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import atan2, inf
from typing import NamedTuple

import numpy as np

from energyplan.errors import (
    GoalInCollisionError,
    OutsideMapError,
    PlanningError,
    TimeLimitError,
)
from energyplan.path import FloatArray, Path, Pose, wrap_angle
from energyplan.planning.bound.goals import least_to_goal
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.driven import Candidate
from energyplan.planning.ends import CheckedEnds, checked_ends
from energyplan.planning.goal import Goal
from energyplan.planning.plans import Plan, priced_plan
from energyplan.planning.problem import PlanningProblem, where_free
from energyplan.planning.search.lattice import joined
from energyplan.planning.search.routes import cheapest_route, penalised
from energyplan.planning.settings import ROUTES, SEVERAL
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled, merged
from energyplan.planning.space.cost_to_go import cost_to_go
from energyplan.planning.space.motions import motion_cost
from energyplan.steering.forwards import forward_energies
from energyplan.steering.kernels import steer_energies

Options = dict[str, object]

_GAP = 1e-3  # part of the bound by which a plan may cost more and yet is the best


class Solver(NamedTuple):
    """What plans to a single pose."""

    solve: Callable[[CheckedEnds, Budget, Options], Plan]
    informed: bool  # whether it begins with known paths, and uses a known lower bound


class Aim(NamedTuple):
    """A pose of a goal, and what the way there promises to cost."""

    cost: float
    goal: Goal
    pose: Pose


class Found(NamedTuple):
    """A plan, and the goal that it reaches."""

    plan: Plan
    goal: Goal
    aimed: float  # heading at which it was planned to be reached, before the end was moved [rad]

    @property
    def cost(self) -> float:
        """The objective's value of the plan."""
        return self.plan.cost


def plan_to_several(
    problem: PlanningProblem, solver: Solver, budget: Budget, known: Sequence[Path] = ()
) -> Plan:
    """Return the plan to the pose of the problem's goals that costs least, no more than a path."""
    ranking = budget.part(SEVERAL.ranking)
    aims = [aim for goal in problem.goals for aim in _aims(problem, goal, ranking)]
    if not aims:
        raise none_free(problem)
    aims.sort(key=lambda aim: aim.cost)
    units = SEVERAL.trial * budget.left
    found = [_first(problem, solver, aims, units, budget)]
    lowest = min(_least(problem, aim) for aim in {aim.goal: aim for aim in aims}.values())
    for aim in _others(aims, found[0]):
        if found[0].cost <= lowest * (1.0 + _GAP):
            break
        if aim.goal is not found[0].goal and _least(problem, aim) >= found[0].cost:
            continue
        # what is known now may be as good as the least
        if budget.left < SEVERAL.kept * units:
            break
        with suppress(PlanningError):  # the plans that are known are as good
            found.append(_to_pose(problem, solver, aim, _limited(budget, units)))
            found.sort(key=lambda one: one.cost)
    for path in known:
        for goal in [goal for goal in problem.goals if goal.reached_by(path.end)][:1]:
            aim = Aim(0.0, goal, path.end)
            if problem.toward(path.end).fault(path) is None:
                found.append(_to_pose(problem, solver, aim, _limited(budget, units), [path]))
                aims.append(aim)
    found.sort(key=lambda one: one.cost)
    return _finished(problem, solver, aims, found, budget)


def _limited(budget: Budget, units: float) -> Budget:
    """Return the part of a budget that ends after so many units, or half of what is left."""
    left = budget.left
    return budget.part(min(units / left, SHARES.stage) if left > units else SHARES.stage)


# -- which poses ----------------------------------------------------------------------------------


def _aims(problem: PlanningProblem, goal: Goal, budget: Budget) -> list[Aim]:
    """Return poses of a goal that are free, with what routes to them promise."""
    start = problem.start
    poses = goal.samples(
        SEVERAL.headings, SEVERAL.around, atan2(goal.y - start.y, goal.x - start.x)
    )
    grid = problem.terrain.obstacles
    poses = poses[grid.inside(poses[:, :2])]
    for robot in (problem.robot, problem.without_clearance.robot):
        free = poses[grid.footprint_free(poses, robot)] if len(poses) else poses
        if len(free):
            break
    else:
        return []
    # on a circle the path ends where it first may: its middle is where to go, if that is free
    middle = np.hypot(free[:, 0] - goal.x, free[:, 1] - goal.y) == 0.0
    if middle.any():
        free = free[middle]
    if goal.headings:
        return [_routed(problem, goal, [Pose(*pose)], False, budget)[0] for pose in free.tolist()]
    return [
        aim
        for run in _runs(free)
        for aim in _routed(problem, goal, [Pose(*pose) for pose in run.tolist()], True, budget)
    ]


def _runs(free: FloatArray) -> Iterator[FloatArray]:
    """Return the poses place by place, and those of one place by what their headings leave open."""
    places, place = np.unique(free[:, :2], axis=0, return_inverse=True)
    for k in range(len(places)):
        poses = free[place.ravel() == k]
        poses = poses[np.argsort(poses[:, 2], kind="stable")]
        turns = np.diff(poses[:, 2], append=poses[0, 2] + 2.0 * np.pi)
        closed = np.flatnonzero(turns > 1.5 * 2.0 * np.pi / SEVERAL.headings)
        if len(closed):
            poses = np.roll(poses, -int(closed[-1]) - 1, axis=0)
            gaps = (closed - closed[-1] - 1) % len(poses) + 1
            yield from np.split(poses, np.sort(gaps)[:-1])
        else:
            yield poses


def _routed(
    problem: PlanningProblem, goal: Goal, poses: Sequence[Pose], any_heading: bool, budget: Budget
) -> list[Aim]:
    """Return which of some poses at a place the cheapest routes lead to."""
    middle = poses[len(poses) // 2]
    query = compiled(checked_ends(problem.toward(middle)).bare)
    setting, potential = query.leading.setting, query.potential(middle)
    to_go = cost_to_go(setting)
    budget.spend(to_go.work / UNITS.nodes)
    found: list[Aim] = []
    penalties = np.ones(1)
    for _ in range(SEVERAL.routes if any_heading else 1):
        most = int(min(SHARES.stage * budget.left / UNITS.state, ROUTES.states))
        if most < 1:
            break
        route = cheapest_route(to_go, setting, penalties, most, any_heading)
        budget.spend(UNITS.state * route.looked)
        if len(route.chain) == 0:
            break
        off = np.abs(wrap_angle(np.array([pose.yaw for pose in poses]) - route.heading))
        pose = poses[int(np.argmin(off))]
        found.append(Aim(route.cost + potential, goal, pose))
        if any_heading and setting.gear == 0:  # the same way round may begin or end backwards
            pose = poses[int(np.argmax(off))]
            found.append(Aim(route.cost + potential, goal, pose))
        homes = to_go.places.home[route.chain]
        penalties = penalised(penalties, to_go.places, homes, setting.reach, ROUTES.again)
    return found or [Aim(inf, goal, middle)]


def none_free(problem: PlanningProblem, goals: Sequence[Goal] = ()) -> PlanningError:
    """Return the error that says that the robot can be at no pose of the goals, or of some."""
    grid, goals = problem.terrain.obstacles, goals or problem.goals
    inside = [goal for goal in goals if bool(grid.inside((goal.x, goal.y)))]
    what = " and ".join(goal.describe() for goal in goals)
    if not inside:
        return OutsideMapError(
            f"the goal {what} lies outside the map; it covers {grid.describe_extent()}"
        )
    near = inside[0].nearest(problem.start)
    where = where_free(grid, problem.without_clearance.robot, near)
    return GoalInCollisionError(
        f"the footprint touches an obstacle at every pose of the goal {what}; {where}"
    )


# -- plans to them --------------------------------------------------------------------------------


def _first(
    problem: PlanningProblem, solver: Solver, aims: Sequence[Aim], units: float, budget: Budget
) -> Found:
    """Return a plan to the pose that promises most, or to another where none leads there."""
    failed: list[PlanningError] = []
    tried: dict[Goal, int] = {}
    for aim in aims:
        tried[aim.goal] = tried.get(aim.goal, 0) + 1
        if tried[aim.goal] > SEVERAL.tries:
            continue
        try:
            return _to_pose(problem, solver, aim, _limited(budget, units))
        except PlanningError as error:
            failed.append(error)
        if budget.over:
            break
    if isinstance(failed[0], TimeLimitError) and not budget.over:  # with all that is left, then
        return _to_pose(problem, solver, aims[0], budget.part(1.0))
    raise failed[0]


def _others(aims: Sequence[Aim], found: Found) -> list[Aim]:
    """Return other poses that promise as much: one of each other goal, and other headings."""
    chosen: list[Aim] = []
    seen: dict[Goal, list[float]] = {found.goal: [found.plan.path.end.yaw, found.aimed]}
    base = min(found.plan.potential, 0.0)
    for aim in aims:
        mine = aim.goal is found.goal
        limit = SEVERAL.promising if mine else SEVERAL.possible
        if not aim.cost - base <= limit * (found.cost - base):
            continue
        before = seen.setdefault(aim.goal, [])
        turns = np.abs(wrap_angle(np.array(before) - aim.pose.yaw))
        if (len(before) > SEVERAL.others + 1 or np.any(turns < SEVERAL.span)) if mine else before:
            continue
        before.append(aim.pose.yaw)
        chosen.append(aim)
    return chosen


def _to_pose(
    problem: PlanningProblem,
    solver: Solver,
    aim: Aim,
    budget: Budget,
    known: Sequence[Path] = (),
    least: float | None = None,
) -> Found:
    """Plan to a pose of a goal, and end the path where the goal costs least to reach."""
    ends = checked_ends(problem.toward(aim.pose))
    options: Options = {}
    if solver.informed:
        options["bound"] = _least(problem, aim) if least is None else least
        if known:
            options["initial"] = known
    plan = solver.solve(ends, budget, options)
    path = ended(problem, ends.bare, plan.path, aim.goal, budget)
    if path is None:
        return Found(plan, aim.goal, aim.pose.yaw)
    other = problem.toward(path.end)
    query = compiled(checked_ends(replace(other, start=path.start)).bare)
    if not query.value(path) < compiled(ends.bare).value(plan.path):
        return Found(plan, aim.goal, aim.pose.yaw)
    bound = min(plan.lower_bound_steady, query.least_in_free_space)
    better = priced_plan(
        query, Candidate(path, first_time=plan.first_time), bound, plan.planner, budget,
        problem=replace(other, start=path.start), notes=plan.notes,
    )  # fmt: skip
    return min(
        Found(plan, aim.goal, aim.pose.yaw),
        Found(better, aim.goal, aim.pose.yaw),
        key=lambda one: one.cost,
    )


def _least(problem: PlanningProblem, aim: Aim) -> float:
    """Return what reaching the goal of a pose costs at least, obstacles or not."""
    return least_to_goal(checked_ends(problem.toward(aim.pose)).bare, aim.goal).value


def _finished(
    problem: PlanningProblem, solver: Solver, aims: Sequence[Aim], several: list[Found],
    budget: Budget,
) -> Plan:  # fmt: skip
    """Return the best plan, refined, with what no path to any of the goals costs less than."""
    goals = {aim.goal: aim.pose for aim in aims}
    share = SHARES.aside * budget.left / len(goals)
    bounds = {}
    for goal, pose in goals.items():
        bare = checked_ends(problem.toward(pose)).bare
        least = least_to_goal(bare, goal, several[0].plan.cost_steady, UNITS.steps * share)
        if not least.final:
            budget.spend(share)
        bounds[goal] = least.value
    close = [one for one in several if one.cost <= SEVERAL.close * several[0].cost]
    found = several[0]
    for k, one in enumerate(close[: SEVERAL.finalists] if solver.informed else []):
        if budget.over or found.cost <= min(bounds.values()) * (1.0 + _GAP):
            break
        aim = Aim(one.cost, one.goal, one.plan.path.end)
        own = budget if one is close[-1] or k + 1 == SEVERAL.finalists else budget.part(0.5)
        again = _to_pose(problem, solver, aim, own, [one.plan.path], bounds[one.goal])
        found = min(found, again, key=lambda one: one.cost)
    plan = found.plan
    of = replace(problem, start=plan.path.start, goal=plan.path.end)
    closed = [none_free(problem, [one]) for one in problem.goals if one not in goals]
    notes = (*(f"left out: {one}" for one in closed), *plan.notes, *budget.notes)
    return replace(
        plan, problem=of, lower_bound_steady=min(bounds.values()),
        effort=round(budget.spent), effort_limit=budget.effort, planning_time=budget.elapsed,
        stopped=bool(budget.notes), notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


# -- where a path ends ----------------------------------------------------------------------------


class _End(NamedTuple):
    """A way to end a path."""

    cost: float
    leaves: int  # the place at which it leaves the path; -1 where it does not
    pose: Pose
    motions: Segments  # from there, of the centre


class _Ways(NamedTuple):
    """Poses of a path from which other ends are tried."""

    query: CompiledProblem
    poses: FloatArray  # (n, 3), of the centre
    came: FloatArray  # (n,): what the path costs until there
    budget: Budget

    def cheapest(self, ends: FloatArray, best: _End) -> _End:
        """Return the cheapest free way to one of some poses, if it costs less than the best."""
        query, setting = self.query, self.query.setting
        centres = np.array([query.centre(Pose(*end)) for end in ends.tolist()])
        n, m = len(self.poses), len(ends)
        least = (least_costs(query, self.poses, centres) + self.came[:, None]).ravel()
        self.budget.spend(UNITS.steer * len(least))
        blocked = np.zeros(n, int)
        for k in np.argsort(least, kind="stable").tolist():
            if least[k] >= best.cost:
                break
            begin, end = divmod(k, m)
            if blocked[begin] == SEVERAL.hopeless:
                continue
            motions, cost = joined(setting, Pose(*self.poses[begin]), Pose(*centres[end]))
            self.budget.spend(UNITS.join)
            blocked[begin] += cost == inf
            if self.came[begin] + cost < best.cost * (1.0 - SEVERAL.less):
                cost = float(self.came[begin] + cost)
                best = _End(cost, begin, Pose(*ends[end].tolist()), motions)
        return best


def least_costs(query: CompiledProblem, starts: FloatArray, goals: FloatArray) -> FloatArray:
    """Return the least costs from each pose to each other one, obstacles or not, shape (n, m)."""
    out = np.empty(len(starts) * len(goals))
    solve = steer_energies if query.setting.gear == 0 else forward_energies
    solve(
        np.repeat(starts, len(goals), 0), np.tile(goals, (len(starts), 1)), query.setting.steering,
        out,
    )  # fmt: skip
    return out.reshape(len(starts), len(goals))


class Along(NamedTuple):
    """A path in short segments."""

    path: Path
    poses: list[Pose]  # of the treads' centre, at the ends of the segments
    came: FloatArray  # cost up to each of them


def along(query: CompiledProblem, path: Path, step: float) -> Along:
    """Cut a path into segments of a length at most [m]."""
    setting = query.setting
    fine = path.subdivide(step, step / setting.half_track)
    motions = query.of_centre(fine.ds, fine.dtheta)
    poses = [query.centre(Pose(*at)) for at in fine.vertices.tolist()]
    parts = [
        motion_cost(setting, *motion)
        for motion in zip(poses, motions.ds.tolist(), motions.dtheta.tolist(), strict=False)
    ]
    came = np.concatenate([[0.0], np.cumsum(parts)])
    return Along(fine, poses, came)


def ended(
    problem: PlanningProblem, single: PlanningProblem, path: Path, goal: Goal, budget: Budget
) -> Path | None:
    """Return a path along another as far as is best, and from there to a goal at the least cost.

    `single` is the problem that the path answers. None where its own end is the best.
    """
    query = compiled(single)
    setting = query.setting
    if len(path) == 0:
        return None
    fine, poses, came = along(query, path, SEVERAL.near * setting.reach / SEVERAL.ends)
    driven = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    late = np.flatnonzero(driven >= driven[-1] - SEVERAL.near * setting.reach)
    late = np.unique(late[np.linspace(0, len(late) - 1, SEVERAL.ends).round().astype(int)])
    late = np.union1d([0], late)  # the start too, for the exact motion from there
    ways = _Ways(query, np.array(poses)[late], came[late], budget)
    nothing = Segments(np.empty(0), np.empty(0))
    best = _End(float(came[-1]), -1, path.end, nothing)
    inside = [k for k in range(len(late)) if goal.reached_by(fine.vertices[late[k]])]
    if inside and came[late[inside[0]]] < best.cost * (1.0 - SEVERAL.less):
        pose = Pose(*fine.vertices[late[inside[0]]].tolist())
        best = _End(float(came[late[inside[0]]]), inside[0], pose, nothing)
    ends = goal.samples(SEVERAL.headings, SEVERAL.around, path.end.yaw)
    ends = np.concatenate([ends, goal.first_from(path.start)])
    turn, step = 2.0 * np.pi / SEVERAL.headings, 0.5 * goal.radius
    if goal.headings and goal.radius:  # turning to a heading may take room before the edge
        ends = np.concatenate(
            [ends, replace(goal, radius=step).samples(1, SEVERAL.around, path.end.yaw)]
        )
    for _ in range(SEVERAL.zooms if not goal.headings or goal.radius else 1):
        best = ways.cheapest(ends, best)
        x, y, yaw = best.pose
        if goal.headings:
            step *= 0.5
            ends = Goal(x, y, yaw, radius=step).samples(1, SEVERAL.around)
            ends = ends[np.hypot(ends[:, 0] - goal.x, ends[:, 1] - goal.y) <= goal.radius]
            continue
        turns = turn * (np.arange(2 * SEVERAL.parts + 1) / SEVERAL.parts - 1.0)
        ends = np.column_stack([np.full(len(turns), x), np.full(len(turns), y), yaw + turns])
        turn /= SEVERAL.parts
    if best.leaves < 0:
        return None
    last = int(late[best.leaves])
    ahead = query.reference(*best.motions)
    whole = merged(
        Segments(
            np.concatenate([fine.ds[:last], ahead.ds]),
            np.concatenate([fine.dtheta[:last], ahead.dtheta]),
        )
    )
    found = replace(path, ds=whole.ds, dtheta=whole.dtheta)
    return found if problem.toward(found.end).fault(found) is None else None
