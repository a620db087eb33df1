"""Many missions over an executor: the routes that they need are planned first, in parallel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from energyplan import steering
from energyplan.errors import EnergyPlanError
from energyplan.mission.choice import best_course, best_stops
from energyplan.mission.legs import Legs, Route, Routes
from energyplan.mission.simulation import Walk
from energyplan.mission.types import Mission
from energyplan.path import Pose

if TYPE_CHECKING:
    from energyplan.mission.report import MissionReport


@dataclass(frozen=True)
class Evaluated:
    """What comes of one of many missions: a report, or the error in its place."""

    index: int  # place of the mission among all
    report: MissionReport | None
    error: BaseException | None = None


def evaluate_many(
    missions: Iterable[Mission], executor: Executor | Any, routes: Routes | None = None
) -> Iterator[Evaluated]:
    """Evaluate many missions over an executor; yield each result when it is ready.

    The routes that they will need are planned first, each by one worker, and handed to all. A
    mission that fails, or whose worker died, is told with its error, and the others go on. Dask
    moves the missions of a worker that died to the others by itself.

    Parameters
    ----------
    missions : iterable of Mission
        The missions; variants of one, made by ``dataclasses.replace``, share their routes.
    executor : concurrent.futures.Executor or dask.distributed.Client
        Where they are evaluated.
    routes : Routes, optional
        Routes planned before; those that are planned first are added.

    Yields
    ------
    Evaluated
        ``index``, ``report`` and ``error`` of each mission.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from dataclasses import replace
    >>> import energyplan as ep
    >>> from energyplan.io.files import bundled
    >>> from energyplan.mission import evaluate_many
    >>> mission = ep.read_mission(bundled("mission_warehouse.yaml"))
    >>> variants = [replace(mission, planning_effort=250, soc=soc) for soc in (0.6, 0.9)]
    >>> with ThreadPoolExecutor(2) as pool:
    ...     found = {one.index: one.report for one in evaluate_many(variants, pool)}
    >>> found[0].soc_end < found[1].soc_end
    True
    """
    missions, routes = tuple(missions), Routes() if routes is None else routes
    pool: Executor = executor
    if hasattr(executor, "get_executor"):  # a client of dask.distributed
        pool = executor.get_executor(pure=False)
    ahead, kinds = [], set()
    for mission in missions:
        with suppress(EnergyPlanError):  # its evaluation says what is wrong
            digest = Legs(mission).digest
            if digest not in kinds:
                wanted = routes_wanted(mission, routes)
                ahead += [(digest, pool.submit(_route, mission, *ends)) for ends in wanted]
            kinds.add(digest)
    for digest, future in ahead:
        if future.exception() is None:
            key, route = future.result()
            routes.of(digest).setdefault(key, route)
    flying = {pool.submit(_evaluated, mission, routes): k for k, mission in enumerate(missions)}
    for done in as_completed(flying):
        error = done.exception()
        yield Evaluated(flying[done], None if error else done.result(), error)


def _route(
    mission: Mission, start: int, goal: int, hurried: bool
) -> tuple[tuple[Pose, Pose, bool], Route]:
    """Plan and time one route in a worker."""
    legs = Legs(mission)
    legs.leg(start, goal, mission.payload, hurried)
    key = legs.poses[start], legs.poses[goal], hurried
    return key, legs.routes.of(legs.digest)[key]


def _evaluated(mission: Mission, routes: Routes) -> MissionReport:
    from energyplan.mission import evaluate

    return evaluate(mission, routes=routes)


def routes_wanted(mission: Mission, routes: Routes) -> list[tuple[int, int, bool]]:
    """Tell which routes an evaluation will plan, as far as can be told without obstacles."""
    legs = GuessedLegs(mission, None, routes)
    walk = Walk(legs)
    if mission.order == "given":
        walk.finish(best_course(walk).state)
    else:
        best_stops(walk)
    return legs.wanted


class GuessedLegs(Legs):
    """Legs that plan nothing: a route that is not known is guessed without obstacles, and noted."""

    def __init__(self, mission: Mission, progress: None, routes: Routes) -> None:
        super().__init__(mission, progress, routes)
        self._guessed: dict[tuple[Pose, Pose, bool], Route] = {}
        self.wanted: list[tuple[int, int, bool]] = []

    def planned(self, start: int, goal: int, hurried: bool = False) -> bool:
        """Tell whether the route from node to node is known or guessed."""
        guess = self.poses[start], self.poses[goal], hurried
        return guess in self._guessed or super().planned(start, goal, hurried)

    def _route(self, start: int, goal: int, hurried: bool) -> Route:
        here, there = self.poses[start], self.poses[goal]
        first, last = self._plan_between(start, goal)
        way, back = (here, there, hurried), (there, here, hurried)
        planned = self.poses[first], self.poses[last], hurried
        if here == there or way in self._routes or planned in self._routes:
            return super()._route(start, goal, hurried)
        if way not in self._guessed:
            cost, _ = self.cost(self.mission.payload)
            if not (self._symmetric and back in self._guessed):
                self.wanted.append((first, last, hurried))
            self._guessed[way] = Route(steering.path(here, there, cost))
        return self._guessed[way]
