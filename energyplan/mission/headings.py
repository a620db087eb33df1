"""At which pose each task of a mission is done, where there is a choice.

A place at any heading, a pose either way round, or one of several poses has candidates: headings
all round, and each pose that is listed. What it costs to get from one to another is that of a path
between the places whose ends are steered anew. The candidates that cost least together are those of
the order that costs least, or of the one that is given; then the mission has poses alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from energyplan.errors import PlanningError
from energyplan.mission.routes import Legs, Scene
from energyplan.mission.types import Mission, Option, Task
from energyplan.path import FloatArray, Path, Pose
from energyplan.planning import Goal, PlanningProblem, plan
from energyplan.planning.search.lattice import joined
from energyplan.planning.several import along, least_costs
from energyplan.planning.space.compiled import CompiledProblem, compiled


class Choosing(NamedTuple):
    """Constants of the choice of poses."""

    headings: int = 16  # of those that are all allowed
    around: int = 8  # places on the edge of a circle
    exact: int = 8  # tasks up to which orders and poses are chosen together
    near: int = 6  # other places of a task whose ways are planned, where there are more
    effort: int = 1000  # units of work for the path between two places
    patience: tuple[int, ...] = (1, 10)  # times that, where it is not enough
    poses: int = 24  # of a path at each end, from which it is steered anew
    reach: float = 6.0  # distance from its ends in which they lie [reaches of the body]
    tries: int = 12  # of these that are tried for each pose at the end


CHOOSING = Choosing()


def choices(mission: Mission, task: Task) -> Sequence[Option]:
    """Return the ways of doing a task at which the robot is free."""
    if not task.goals:
        return task.options
    poses = np.concatenate(
        [goal.samples(CHOOSING.headings, CHOOSING.around) for goal in task.goals]
    )
    free = mission.free_map.footprint_free(poses, mission.vehicle)
    found = [Pose(*pose) for pose in poses[free].tolist()]
    return [Option(pose, pose) for pose in found] or task.options


def with_poses(mission: Mission, legs: Legs, order: Sequence[int] = ()) -> Mission:
    """Return a mission whose tasks have the poses that cost least together, in some order."""
    if not any(task.goals for task in mission.tasks):
        return mission
    ways = _Ways(mission, legs.planned_in)
    if not order and mission.order == "given":
        order = range(len(mission.tasks))
    if order:
        chosen = _along(ways, order)
    elif len(mission.tasks) <= CHOOSING.exact:
        chosen = _together(ways)
    else:
        chosen = _along(ways, _nearest_first(ways))
    tasks = tuple(
        replace(task, pose=ways.entries[k + 1][chosen[k]]) if task.goals and k in chosen else task
        for k, task in enumerate(mission.tasks)
    )
    return mission.changed(tasks=tasks)


class _Ways:
    """What it costs at least from each pose of a place to each pose of another one."""

    def __init__(self, mission: Mission, scene: Scene) -> None:
        self.mission, self.scene = mission, scene
        ends = [] if mission.return_to == "charger" else [mission.home or mission.start]
        if mission.return_to != "start":
            ends += [charger.pose for charger in mission.chargers]
        # the start, the tasks, and where the mission may end
        ways = [choices(mission, task) for task in mission.tasks]
        self.entries = [[mission.start], *([one.entry for one in each] for each in ways), ends]
        self.exits = [[mission.start], *([one.exit for one in each] for each in ways), ends]
        self._known: dict[tuple[int, int], FloatArray] = {}

    @property
    def end(self) -> int:
        """Number of where the mission may end."""
        return len(self.entries) - 1

    def between(self, a: int, b: int) -> FloatArray:
        """Return the costs from the poses of a place to those of another, shape (n, m)."""
        if (a, b) not in self._known:
            stays = self.entries[a] == self.exits[a] and self.entries[b] == self.exits[b]
            if (b, a) in self._known and self.scene.symmetric and stays:
                self._known[a, b] = self._known[b, a].T
            else:
                goals = self.mission.tasks[b - 1].goals if b < self.end else ()
                goals = goals or tuple(Goal(*pose) for pose in self.entries[b])
                self._known[a, b] = self._found(self.exits[a], self.entries[b], goals)
        return self._known[a, b]

    def _found(
        self, starts: Sequence[Pose], ends: Sequence[Pose], goals: tuple[Goal, ...]
    ) -> FloatArray:
        scene = self.scene
        best = np.full((len(starts), len(ends)), inf)
        problem = PlanningProblem(
            scene.map, scene.cost, starts[0], goals[0].nearest(ends[0]), goals=goals,
            surfaces=scene.surfaces, heights=scene.heights, objective=scene.objective,
        )  # fmt: skip
        for patience in CHOOSING.patience:
            try:
                found = plan(problem, effort=patience * CHOOSING.effort * min(len(goals), 4))
                break
            except PlanningError:
                continue
        else:
            return best
        query = compiled(problem.toward(found.path.end))
        paths = [found.path]
        if scene.symmetric:
            opposite = Pose(found.path.start.x, found.path.start.y, found.path.start.yaw + np.pi)
            paths.append(Path(opposite, -found.path.ds, found.path.dtheta, found.path.longitudinal))
        begin, end = (np.array([query.centre(pose) for pose in each]) for each in (starts, ends))
        for path in paths:
            best = np.minimum(best, _steered(query, path, begin, end))
        return _direct(query, begin, end, best)


def _direct(
    query: CompiledProblem, starts: FloatArray, goals: FloatArray, best: FloatArray
) -> FloatArray:
    """Return costs, lowered where an exact motion is free."""
    least = least_costs(query, starts, goals)
    for i, j in zip(*np.nonzero(least < best * (1.0 - 1e-6)), strict=True):
        _, cost = joined(query.setting, Pose(*starts[i].tolist()), Pose(*goals[j].tolist()))
        best[i, j] = min(best[i, j], cost)
    return best


def _steered(
    query: CompiledProblem, path: Path, starts: FloatArray, goals: FloatArray
) -> FloatArray:
    """Return what a path costs from other poses at its start to other poses at its end."""
    setting = query.setting
    _, poses, came = along(query, path, CHOOSING.reach * setting.reach / CHOOSING.poses)
    half = (len(poses) + 1) // 2
    few = np.arange(min(CHOOSING.poses, half))
    last = len(poses) - 1 - few
    at = np.array(poses)
    out = _ends(least_costs(query, starts, at[few]) + (came[-1] - came[few]), starts, at[few],
                lambda a, b: joined(setting, a, b)[1], came[-1] - came[few])  # fmt: skip
    back = _ends((least_costs(query, at[last], goals) + came[last][:, None]).T, goals, at[last],
                 lambda a, b: joined(setting, b, a)[1], came[last])  # fmt: skip
    return np.asarray(out[:, None] + back[None, :] - came[-1])


def _ends(
    least: FloatArray, ends: FloatArray, at: FloatArray, cost: Callable[[Pose, Pose], float],
    rest: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return for each end the cost of the cheapest free way by some pose of a path."""
    found = np.full(len(ends), inf)
    for i in range(len(ends)):
        for k in np.argsort(least[i], kind="stable")[: CHOOSING.tries].tolist():
            if least[i, k] >= found[i]:
                break
            way = cost(Pose(*ends[i].tolist()), Pose(*at[k].tolist()))
            found[i] = min(found[i], way + rest[k])
    return found


def _along(ways: _Ways, order: Sequence[int]) -> dict[int, int]:
    """Return which pose each task of an order has where they cost least together."""
    places = [0, *(task + 1 for task in order), ways.end]
    cost, before = np.zeros(1), []
    for a, b in pairwise(places):
        totals = cost[:, None] + ways.between(a, b)
        before.append(totals.argmin(axis=0))
        cost = totals.min(axis=0)
    if not np.isfinite(cost.min()):
        return {}
    at, chosen = int(cost.argmin()), {}
    for place, came in zip(places[:0:-1], before[::-1], strict=True):
        if place != ways.end:
            chosen[place - 1] = at
        at = int(came[at])
    return chosen


def _together(ways: _Ways) -> dict[int, int]:
    """Return the poses of the order that costs least: dynamic programming over sets of tasks."""
    n = ways.end - 1
    best: list[dict[int, FloatArray]] = [{} for _ in range(1 << n)]
    before: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}
    for k in range(n):
        best[1 << k][k] = ways.between(0, k + 1)[0]
    for done in range(1, 1 << n):
        for k, cost in best[done].items():
            for j in range(n):
                if done & (1 << j):
                    continue
                totals = cost[:, None] + ways.between(k + 1, j + 1)
                both, low = done | (1 << j), totals.min(axis=0)
                known = best[both].get(j, np.full(len(low), inf))
                task, at = before.get((both, j), (np.full(len(low), -1), np.full(len(low), -1)))
                better = low < known
                best[both][j] = np.where(better, low, known)
                before[both, j] = (
                    np.where(better, k, task),
                    np.where(better, totals.argmin(axis=0), at),
                )
    done = (1 << n) - 1
    ends = {k: cost + ways.between(k + 1, ways.end).min(axis=1) for k, cost in best[done].items()}
    last = min(ends, key=lambda k: float(ends[k].min()))
    if not np.isfinite(ends[last].min()):
        return {}
    at, chosen = int(ends[last].argmin()), {}
    while True:
        chosen[last] = at
        if done == 1 << last:
            return chosen
        task, pose = before[done, last]
        done, last, at = done & ~(1 << last), int(task[at]), int(pose[at])


def _nearest_first(ways: _Ways) -> list[int]:
    """Return an order of many tasks: each time the nearest of those that are left."""
    left, here, order = set(range(ways.end - 1)), ways.exits[0][0], []
    while left:
        away = {
            k: float(np.hypot(ways.entries[k + 1][0].x - here.x, ways.entries[k + 1][0].y - here.y))
            for k in left
        }
        k = min(left, key=lambda k: (away[k], k))
        order.append(k)
        left.remove(k)
        here = ways.entries[k + 1][0]
    return order
