"""Missions evaluated: of one robot or of several, one mission or many over an executor."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass

from energyplan.errors import EnergyPlanError, MissionError
from energyplan.mission.headings import with_poses
from energyplan.mission.report import MissionReport
from energyplan.mission.robots import Sharing
from energyplan.mission.routes import Legs, Progress, Routes, Scene
from energyplan.mission.single import Evaluation
from energyplan.mission.types import Mission
from energyplan.records import checked

_AGAIN = 2  # rounds of choosing poses for the order that was found


@checked(MissionError)
def evaluate(
    mission: Mission, progress: Progress = None, *, routes: Routes | None = None
) -> MissionReport:
    """Find which tasks of a mission can be done, and the energy that they take.

    Parameters
    ----------
    mission : Mission
        The mission. For one that is under way, `Mission.resume` gives the rest.
    progress : callable, optional
        Called with one line of text whenever a route is planned or an order is found.
    routes : Routes, optional
        Routes planned before; those that are planned now are added.

    Returns
    -------
    MissionReport
        A verdict with its reason and remedy for each task, and the mission as a whole.

    Raises
    ------
    MissionError
        If a bound is wanted of models without a known uncertainty, or a payload leaves the range
        of its models.

    References
    ----------
    docs/missions.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from energyplan.io.mission import read_mission
    >>> from energyplan.io.files import bundled
    >>> mission = replace(read_mission(bundled("mission_warehouse.yaml")), planning_effort=250)
    >>> evaluate(mission).feasible
    True
    """
    if mission.robots:
        first = mission.parts[0]  # the poses suit this robot, whoever comes there
        known = {task.name: task for task in with_poses(first, Legs(first)).tasks}
        tasks = tuple(known.get(task.name, task) for task in mission.tasks)
        if any(task.goals for task in tasks):
            mission = mission.changed(tasks=tasks)
        return Sharing(mission, progress, routes).report()
    legs = Legs(mission, progress, routes)
    chosen = with_poses(mission, legs)
    if chosen is mission:
        return Evaluation(mission, progress, legs).report()
    return _with_chosen_poses(chosen, progress, legs.routes)


def _with_chosen_poses(mission: Mission, progress: Progress, routes: Routes) -> MissionReport:
    """Evaluate a mission, and anew with the poses that are best for the order that was found."""
    best = Evaluation(mission, progress, Legs(mission, progress, routes)).report()
    for _ in range(_AGAIN):
        names = [task.name for task in mission.tasks]
        order = [names.index(name) for name in best.order if name in names]
        again = with_poses(mission, Legs(mission, progress, routes), order)
        if [task.pose for task in again.tasks] == [task.pose for task in best.mission.tasks]:
            break
        other = Evaluation(again, progress, Legs(again, progress, routes)).report()
        if (not other.feasible, other.energy) >= (not best.feasible, best.energy):
            break
        best = other
    return best


# -- many missions -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Evaluated:
    """What comes of one of many missions: a report, or the error in its place."""

    index: int  # place of the mission among all
    report: MissionReport | None
    error: BaseException | None = None


def evaluate_many(
    missions: Iterable[Mission], executor: Executor, routes: Routes | None = None
) -> Iterator[Evaluated]:
    """Evaluate many missions over an executor; yield each result when it is ready.

    Of missions that share their map, costs and planner one is evaluated first, and the routes that
    it needed are handed to the others. A mission that fails yields its error.

    Parameters
    ----------
    missions : iterable of Mission
        The missions.
    executor : concurrent.futures.Executor
        Who works, such as a pool of processes, or a cluster by `energyplan.io.many.cluster`.
    routes : Routes, optional
        Routes that are known already; those that are planned are added.
    """
    known = Routes() if routes is None else routes
    first: dict[int, tuple[Scene, Mission]] = {}
    rest: dict[int, tuple[Scene, Mission]] = {}
    for k, mission in enumerate(missions):
        try:
            kind = Legs(mission).planned_in
        except EnergyPlanError as failed:
            yield Evaluated(k, None, failed)
            continue
        (rest if kind in {one for one, _ in first.values()} else first)[k] = kind, mission
    for turn in (first, rest):
        flying = {
            executor.submit(_evaluated, mission, known): k for k, (_, mission) in turn.items()
        }
        for done in as_completed(flying):
            error, report, k = done.exception(), None, flying[done]
            if error is None:
                report, planned = done.result()
                known.update(planned)
            yield Evaluated(k, report, error)


def _evaluated(mission: Mission, routes: Routes) -> tuple[MissionReport, Routes]:
    return evaluate(mission, routes=routes), routes
