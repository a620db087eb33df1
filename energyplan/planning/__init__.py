"""Planners: one `PlanningProblem` in, one `Plan` out.

A planner is a function ``(problem, budget, **options) -> Candidate``, declared as a `Planner` with
what it can do. Those of the library are in `PLANNERS`; other packages add theirs through the
entry-point group ``energyplan.planning``, whose objects are such declarations. `plan` alone checks
and prices what a planner returns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from inspect import signature
from math import inf
from pathlib import Path as File
from traceback import extract_tb
from typing import Any

from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    InvalidInputError,
    PlannerError,
    PlanningError,
    UnknownNameError,
    UnsupportedPlannerError,
)
from energyplan.planning.budget import SHARES, Budget, cancellable, plan_budget
from energyplan.planning.contract import Candidate, Planner, check_path, priced_plan
from energyplan.planning.driven import Plan
from energyplan.planning.problem import OBJECTIVES, PlanningProblem
from energyplan.planning.space.compiled import compiled
from energyplan.records import check_fields, checked

__all__ = [
    "PLANNERS",
    "Budget",
    "Candidate",
    "Plan",
    "Planner",
    "PlanningProblem",
    "cancellable",
    "plan",
    "planners",
]

_OMPL = "energyplan.planning.ompl"

PLANNERS = {
    "lattice": Planner(
        "energyplan.planning.search.planner:plan",
        surfaces=True, heights=True, objectives=OBJECTIVES, effort=True, bound=True,
        costmap=True, turning=True, forwards=True,
    ),
    **{
        name: Planner(
            f"{_OMPL}:{name}", surfaces=True, heights=True, objectives=OBJECTIVES, effort=True,
            turning=True,
        )
        for name in ("rrtstar", "informed_rrtstar", "bitstar", "fmt")
    },
}  # fmt: skip
"""The library's own planners; they are imported when they are used."""


def planners() -> tuple[str, ...]:
    """Return the names of all planners: the library's own, then those of other packages."""
    plugins = {entry.name for entry in entry_points(group="energyplan.planning")}
    return (*PLANNERS, *sorted(plugins - set(PLANNERS)))


def find(name: str) -> Planner:
    """Return a planner with what it can do."""
    if name in PLANNERS:
        return PLANNERS[name]
    for entry in entry_points(group="energyplan.planning"):
        if entry.name == name:
            with _blaming(name):
                plugin = entry.load()
            if not isinstance(plugin, Planner):
                raise PlanningError(
                    f"the entry point {name!r} of energyplan.planning is a "
                    f"{type(plugin).__name__}; make it an energyplan.Planner"
                )
            return plugin
    raise UnknownNameError("planner", name, planners())


@contextmanager
def _blaming(name: str) -> Iterator[None]:
    """Tell what goes wrong in a planner in one line, with the place in the planner's own code.

    What a planner says on purpose is passed on: that there is no path, and what it raises itself of
    the library's errors.
    """
    try:
        yield
    except (PlanningError, CancelledError):
        raise
    except Exception as error:
        frames = [
            frame
            for frame in extract_tb(error.__traceback__)
            if frame.filename != __file__ and "importlib" not in frame.filename
        ]
        home = File(frames[0].filename).parent if frames else None
        if home and File(__file__).parents[1] in (home, *home.parents):
            raise  # a planner of the library
        own = [frame for frame in frames if home in File(frame.filename).parents]
        if own and isinstance(error, EnergyPlanError) and own[-1] is frames[-1]:
            raise
        place = f"{own[-1].filename}, line {own[-1].lineno}: " if own else ""
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise PlannerError(f"{place}the planner {name!r} failed with {what}; correct it") from error


def _check_capable(name: str, planner: Planner, problem: PlanningProblem, counted: bool) -> None:
    lacking = planner.lacks(problem, counted)
    if lacking:
        able = [k for k, other in PLANNERS.items() if not other.lacks(problem, counted)]
        raise UnsupportedPlannerError(
            f"the planner {name!r} cannot be used with {' and '.join(lacking)}; use one of "
            f"{', '.join(able)}"
        )


def _check_call(name: str, solve: Callable[..., Candidate], options: dict[str, Any]) -> None:
    try:
        taken = signature(solve)
    except (TypeError, ValueError):  # a function that does not say what it takes
        return
    try:
        taken.bind(None, None, **options)
    except TypeError as error:
        raise InvalidInputError(
            f"the planner {name!r} cannot be called with a problem, a budget and the options "
            f"{sorted(options)}: {error}; it takes {', '.join(taken.parameters)}"
        ) from None


@checked()
def plan(
    problem: PlanningProblem,
    planner: str | Planner = "lattice",
    time_limit: float = inf,
    *,
    effort: int | None = None,
    **options: Any,
) -> Plan:
    """Plan a path.

    Parameters
    ----------
    problem : PlanningProblem
        From where to where, among which obstacles, at what cost.
    planner : str or Planner
        Name of the planner, see `planners`; or a planner of one's own.
    time_limit : float
        Time after which planning stops even if effort is left [s]; the plan's notes say so then.
        What is made once for a map is no part of it: its first plan takes longer.
    effort : int, optional
        Units of work to plan with, 30 000 where left out: the same plan comes of it on any
        machine and under any load. 50 000 take about a second; see `Budget`. Planning ends
        earlier if the planner knows that nothing is left to gain.
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
        If the planner cannot do what the problem asks for; the message says which can.
    StartInCollisionError, GoalInCollisionError, OutsideMapError
        If start or goal cannot be.
    NoPathError
        If there is no path, or none was found at the resolution of the search; its ``certainty``
        says which.
    TimeLimitError
        If time or effort was over before a first plan.
    InvalidPathError
        If a planner returned what is no answer to the problem.
    PlannerError
        If something went wrong in the code of another package's planner, with its cause.
    LowerBoundError
        If a lower bound lies above the cost of the path, which is a fault of whoever made it.

    Examples
    --------
    >>> import numpy as np
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.terrain import OccupancyGrid
    >>> from energyplan.power import PowerModel
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    >>> found = plan(PlanningProblem(hall, cost, start=(1, 5, 0), goal=(9, 5, 0)), effort=50_000)
    >>> round(found.energy), abs(found.gap) < 1e-6
    (1808, True)
    """
    from energyplan.planning.bound import lower_bound
    from energyplan.planning.search.narrow.ends import between_clear_ends, checked_ends
    from energyplan.planning.search.planner import compile_planning, prepare

    declared = find(planner) if isinstance(planner, str) else planner
    name = planner if isinstance(planner, str) else planner.name
    plan_budget(time_limit, effort)  # says at once what is wrong with them
    _check_capable(name, declared, problem, effort is not None)
    problem, bare, notes = checked_ends(problem)
    function = declared.function
    _check_call(name, function, options)
    compile_planning(bare, load=effort is None)
    prepare(bare, guided=declared.bound)

    def solve(asked: PlanningProblem, budget: Budget) -> Candidate:
        if asked is not problem:
            budget.beside(lambda: prepare(asked, guided=declared.bound))
        with _blaming(name):
            found = function(asked, budget, **options)
        if not isinstance(found, Candidate):
            raise PlanningError(
                f"the planner {name!r} returned a {type(found).__name__}; correct it to return an "
                "energyplan.Candidate"
            )
        check_path(asked, found.path, name)
        check_fields(found, PlanningError, f"the planner {name!r} returned a candidate whose ")
        return found

    budget = plan_budget(time_limit, effort, declared.effort)
    given = budget if declared.bound else budget.part(1.0 - SHARES.aside)
    found = between_clear_ends(problem, given, solve)
    query = compiled(bare)
    bound = found.lower_bound
    if bound is None:
        value, _ = lower_bound(query, query.value(found.path))
        bound = query.potential(problem.goal) + value
    return priced_plan(
        query,
        found.path,
        bound,
        name,
        budget,
        first_time=found.first_time,
        asked=problem,
        notes=notes,
    )
