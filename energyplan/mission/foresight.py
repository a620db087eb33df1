"""Routes planned ahead in other processes: which a mission will need, and what they found."""

from __future__ import annotations

from collections.abc import Mapping

from energyplan import steering
from energyplan.mission.choice import best_course, best_stops
from energyplan.mission.legs import PLANNED, Legs, Route
from energyplan.mission.simulation import Walk
from energyplan.mission.types import Mission
from energyplan.path import Pose
from energyplan.terrain import OccupancyGrid


def routes_wanted(mission: Mission) -> list[tuple[int, int, bool]]:
    """Tell which routes an evaluation will plan, as far as can be told without obstacles."""
    legs = GuessedLegs(mission)
    walk = Walk(legs)
    if mission.order == "given":
        walk.finish(best_course(walk).state)
    else:
        best_stops(walk)
    return legs.wanted


class GuessedLegs(Legs):
    """Legs that plan nothing: a route that is not known is guessed without obstacles, and noted."""

    def __init__(self, mission: Mission) -> None:
        super().__init__(mission)
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


RouteKey = tuple[bytes, Pose, Pose, bool]
"""What decides a route on a map, its start, its goal, and whether it is driven in a hurry."""


def known_routes(grid: OccupancyGrid) -> dict[RouteKey, Route]:
    """Return the routes planned on a map in this process, to be learned in another one."""
    return {
        (digest, *pair): route
        for digest, routes in dict(PLANNED.get(grid, {})).items()
        for pair, route in dict(routes).items()
    }


def learn_routes(grid: OccupancyGrid, routes: Mapping[RouteKey, Route]) -> None:
    """Take in routes that were planned elsewhere."""
    known = PLANNED.setdefault(grid, {})
    for (digest, here, there, hurried), route in routes.items():
        known.setdefault(digest, {}).setdefault((here, there, hurried), route)
