"""Planners: one `PlanningProblem` in, one `Plan` out.

Every planner is a function ``plan(problem, time_limit, **options) -> Plan``. Those of the library
are in `PLANNERS`; other packages add theirs through the entry-point group ``energyplan.planning``,
whose objects are such functions.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, cast

from energyplan.errors import PlanningError, UnknownNameError, UnsupportedPlannerError
from energyplan.planning.problem import Plan, PlanningProblem

__all__ = ["PLANNERS", "Plan", "PlanningProblem", "plan", "planners"]

Planner = Callable[..., Plan]

PLANNERS = {
    "lattice": "energyplan.planning.lattice.planner:plan",
    "roadmap": "energyplan.planning.roadmap:plan",
    "rrtstar": "energyplan.planning.ompl:rrtstar",
    "informed_rrtstar": "energyplan.planning.ompl:informed_rrtstar",
    "bitstar": "energyplan.planning.ompl:bitstar",
    "fmt": "energyplan.planning.ompl:fmt",
    "control_rrt": "energyplan.planning.ompl.control:control_rrt",
    "sst": "energyplan.planning.ompl.control:sst",
    "prm": "energyplan.planning.ompl:prm",
    "prmstar": "energyplan.planning.ompl:prmstar",
    "aorrtc": "energyplan.planning.ompl:aorrtc",
}
"""Where the library's own planners are; they are imported when they are used."""

LEVEL_ONLY = ("roadmap", "control_rrt")
"""Those that know level ground only."""


def planners() -> tuple[str, ...]:
    """Return the names of all planners: the library's own, then those of other packages."""
    plugins = {entry.name for entry in entry_points(group="energyplan.planning")}
    return (*PLANNERS, *sorted(plugins - set(PLANNERS)))


def _planner(name: str) -> Planner:
    if name in PLANNERS:
        module, _, function = PLANNERS[name].partition(":")
        found: Planner = getattr(import_module(module), function)
        return found
    for entry in entry_points(group="energyplan.planning"):
        if entry.name == name:
            plugin = entry.load()
            if not callable(plugin):
                raise PlanningError(f"entry point {name!r} of energyplan.planning is no function")
            return cast("Planner", plugin)
    raise UnknownNameError("planner", name, planners())


def plan(
    problem: PlanningProblem, planner: str = "lattice", time_limit: float = 1.0, **options: Any
) -> Plan:
    """Plan a path.

    Parameters
    ----------
    problem : PlanningProblem
        From where to where, among which obstacles, at what cost.
    planner : str
        Name of the planner; see `planners`.
    time_limit : float
        Time to plan [s]. Planning ends earlier where the planner can tell that nothing is left
        to gain.
    **options : object
        Further options of the planner.

    Returns
    -------
    Plan
        The best path found, with its energy and a lower bound.

    Raises
    ------
    UnknownNameError
        If there is no such planner.
    UnsupportedPlannerError
        If the planner cannot be used with this problem; the message says which can.
    StartInCollisionError, GoalInCollisionError, OutsideMapError
        If start or goal cannot be.
    NoPathError
        If there is no path.
    TimeLimitError
        If time was over before a first plan.

    Examples
    --------
    >>> import numpy as np
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.terrain import OccupancyGrid
    >>> from energyplan.power import PowerModel
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    >>> found = plan(PlanningProblem(hall, cost, start=(1, 5, 0), goal=(9, 5, 0)))
    >>> round(found.energy), round(found.gap, 6)
    (1808, 0.0)
    """
    if problem.heights is not None and planner in LEVEL_ONLY:
        raise UnsupportedPlannerError(
            f"the planner {planner!r} knows level ground only; use 'lattice', or leave the heights "
            "out"
        )
    return _planner(planner)(problem, time_limit, **options)
