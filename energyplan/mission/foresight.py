"""Which routes a mission will need, before any is planned."""

from __future__ import annotations

from energyplan.mission.given_order import best_course
from energyplan.mission.legs import GuessedLegs
from energyplan.mission.order_refinement import best_stops
from energyplan.mission.simulation import Walk
from energyplan.mission.types import Mission


def routes_wanted(mission: Mission) -> list[tuple[int, int, bool]]:
    """Tell which routes an evaluation will plan, as far as can be told without obstacles.

    Parameters
    ----------
    mission : Mission
        The mission.

    Returns
    -------
    list of tuple
        Start and goal of each, as nodes of its legs, and whether it is for a hurry.
    """
    legs = GuessedLegs(mission)
    walk = Walk(legs)
    if mission.order == "given":
        walk.finish(best_course(walk).state)
    else:
        best_stops(walk)
    return legs.wanted
