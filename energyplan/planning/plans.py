"""From a problem to a plan: what planners are, what they return, and what becomes of it.

A planner is a function ``(problem, budget, **options) -> Candidate``, declared as a `Planner` with
what it can do. Those of the library are in `PLANNERS`; other packages add theirs through the
entry-point group ``energyplan.planning``, whose objects are such declarations. `plan` alone checks
the path that a planner returns, prices it with the power models, and makes the `Plan`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from inspect import signature
from math import ceil, inf
from pathlib import Path as File
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from energyplan import html
from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    InfeasibleMotionError,
    InvalidInputError,
    InvalidPathError,
    LowerBoundError,
    MissingDependencyError,
    PlannerError,
    PlanningError,
    UnknownNameError,
    UnsupportedPlannerError,
)
from energyplan.limits.drive import drawn
from energyplan.path import ROUNDING, FloatArray, Path, Pose, wrap_angle
from energyplan.planning.budget import SHARES, Budget, plan_budget
from energyplan.planning.driven import Candidate, DrivenPath, drive_plan, driven_bound
from energyplan.planning.problem import OBJECTIVES, PlanningProblem
from energyplan.planning.settings import STAGES
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.prices import Prices
from energyplan.records import check_fields, checked

if TYPE_CHECKING:
    from energyplan.battery import BatteryModel, BatteryRun
    from energyplan.planning.ends import CheckedEnds


@dataclass(frozen=True)
class Planner:
    """A planner, and what it can do.

    Parameters
    ----------
    run : callable or str
        A function ``(problem, budget, **options) -> Candidate``; as ``"module:function"`` it is
        imported when it is used.
    surfaces : bool
        Whether it can be used where there are surfaces with power models of their own, or speed
        limits that change a price.
    heights : bool
        Whether it can be used where the ground slopes.
    objectives : tuple of str
        What it can make least, alone or weighed: of ``"energy"``, ``"length"``, ``"time"``.
    effort : bool
        Whether it spends the budget by what it does, so that it can be limited by effort. One that
        cannot reads the clock.
    costmap : bool
        Whether it can be used where a costmap adds to the objective.
    turning : bool
        Whether it keeps a least radius of arcs.
    forwards : bool
        Whether it can be used where the vehicle may not drive backwards.
    bound : bool
        Whether it returns a lower bound. For one that does not, a tenth of the budget is kept for
        computing one.
    ends : bool
        Whether it leaves and reaches ends that lack clearance. One that does not plans between
        poses near them that have it.

    Raises
    ------
    InvalidInputError
        If the objectives are none of these.
    """

    run: Callable[..., Candidate] | str
    surfaces: bool = False
    heights: bool = False
    objectives: tuple[str, ...] = ("energy",)
    effort: bool = False
    bound: bool = False
    costmap: bool = False
    turning: bool = False
    forwards: bool = False
    ends: bool = False

    def __post_init__(self) -> None:
        check_fields(self, InvalidInputError)
        if isinstance(self.run, str) and ":" not in self.run:
            raise InvalidInputError(
                f"run is {self.run!r}; give a function, or 'module:function'. A planner of the "
                "library is asked for by its name alone, without Planner"
            )
        object.__setattr__(self, "objectives", tuple(self.objectives))
        if not self.objectives or not set(self.objectives) <= set(OBJECTIVES):
            raise InvalidInputError(
                f"objectives are {self.objectives!r}; give one or more of {', '.join(OBJECTIVES)}"
            )

    @property
    def name(self) -> str:
        """Name of the function that plans."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    @property
    def function(self) -> Callable[..., Candidate]:
        """The function that plans."""
        if not isinstance(self.run, str):
            return self.run
        module, _, name = self.run.partition(":")
        try:
            found: Callable[..., Candidate] = getattr(import_module(module), name)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.startswith("energyplan"):
                raise
            raise MissingDependencyError(
                f"the planner {name!r} needs the package {error.name}; install it with pip install "
                f"{error.name.partition('.')[0]}, or use 'lattice'"
            ) from None
        return found

    def lacks(self, problem: PlanningProblem, counted: bool) -> list[str]:
        """Return what a problem requires and this planner cannot do, in words.

        Parameters
        ----------
        problem : PlanningProblem
            The problem.
        counted : bool
            Whether the budget is one of effort.
        """
        wanted = [name for name, weight in problem.weights.items() if weight > 0]
        limits = Prices(problem.cost, problem.surfaces, problem.objective).slow.areas
        missing = {
            "surfaces": problem.terrain.ground.surfaces and not self.surfaces,
            "speed limits": limits and not self.surfaces,
            "heights": problem.heights is not None and not self.heights,
            "a costmap": problem.softened and not self.costmap,
            "a least turning radius": max(problem.radii) > 0 and not self.turning,
            "a vehicle that does not reverse": not (problem.robot.reverse or self.forwards),
            **{f"the objective {name}": name not in self.objectives for name in wanted},
            "effort instead of a time limit": counted and not self.effort,
        }
        return [name for name, lacking in missing.items() if lacking]


STEADY = "energy at steady speeds [J]"


class Spent(NamedTuple):
    """What a plan takes, as driven or at steady speeds."""

    energy: float  # [J]
    by_term: Mapping[str, float]  # the same by term of the power models [J]
    duration: float  # [s]
    driven: bool  # whether with its stops

    @property
    def label(self) -> str:
        """What the energy is, with its unit."""
        return "energy as driven, with its stops [J]" if self.driven else STEADY


class _Rated(NamedTuple):
    """The objective's value of a plan, and what no path has less of."""

    cost: float
    lower_bound: float | None
    driven: bool  # whether both are of drives


_NO_GAP = (
    "no gap: no lower bound is known of the energy as driven, as this model changes with time, "
    "depends on speed on slopes, or nothing limits the speed of the treads; that at steady speeds "
    "is lower_bound_steady"
)


def spending(*plans: Plan) -> list[Spent]:
    """Return what plans take: as driven where all of them can be, else at steady speeds."""
    if any(plan.why_not_driven for plan in plans):
        return [
            Spent(one.energy_steady, one.breakdown, one.duration, driven=False) for one in plans
        ]
    drives = [plan.driven for plan in plans]
    return [Spent(one.energy, one.breakdown, one.duration, driven=True) for one in drives]


@dataclass(frozen=True)
class Plan(html.Readable):
    """A path with its cost, and how far from optimal it can be at most.

    Attributes
    ----------
    path : Path
        The path; free of collisions from the start to the goal.
    energy_steady : float
        Its energy at steady speeds, priced by the model itself after planning [J]: what the search
        makes least. Downhill it can be negative. What driving takes is `energy_driven`.
    lower_bound_steady : float
        What no path costs less than at steady speeds, in the unit of the objective (for energy
        [J]); see `lower_bound`.
    cost_steady : float
        The objective's value at steady speeds: `energy_steady` where energy is the objective, and
        what a costmap adds; see `cost`.
    length, turning : float
        Distance travelled [m] and total turning [rad].
    duration : float
        Time at the speed the cost assumes, without starts and stops [s]; `driven` knows them.
    planning_time : float
        Time that planning took [s].
    first_time : float
        Time until the first plan was known [s].
    planner : str
        Name of the planner.
    breakdown : mapping of str to float
        Energy by term of the power model [J].
    potential : float
        What the difference in height between start and goal makes of the cost and its lower
        bound, whichever way is taken; zero on level ground.
    effort : int
        Units of work that were spent.
    effort_limit : int, optional
        Units of work that could be spent; None of a planner that does not count them.
    stopped : bool
        Whether the clock stopped the planning before: then the plan depends on the load.
    soft_cost : float
        What the costmap, and seconds on priced ground, add to the cost at steady speeds, in the
        unit of the objective; no part of the energy.
    notes : tuple of str
        What was done about a start that touches an obstacle, or an end that lacks the clearance,
        and that the clock stopped the planning, if it did.
    problem : PlanningProblem, optional
        What it answers, which `driven` needs; a plan read from a pickle has been driven instead.
    shortest : Path, optional
        The shortest path that the planner found on the way, where it is known.
    open : bool
        Whether the effort ended what might gain yet; see `advice`.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> plan = ep.plan(problem, effort=1000)
    >>> round(plan.energy_driven), plan.lower_bound <= plan.cost, round(plan.length, 2)
    (540, True, 3.0)
    """

    path: Path
    energy_steady: float
    lower_bound_steady: float
    cost_steady: float
    length: float
    turning: float
    duration: float
    planning_time: float
    first_time: float
    planner: str
    breakdown: Mapping[str, float] = field(default_factory=dict)
    potential: float = 0.0
    effort: int = 0
    effort_limit: int | None = None
    stopped: bool = False
    soft_cost: float = 0.0
    notes: tuple[str, ...] = ()
    problem: PlanningProblem | None = field(default=None, repr=False, compare=False)
    shortest: Path | None = field(default=None, repr=False, compare=False)
    open: bool = False

    def __getstate__(self) -> dict[str, object]:
        # the problem holds the map; the drive itself is small
        with suppress(EnergyPlanError):
            _ = self.driven
        _ = self._rated
        return {**vars(self), "problem": None}

    @cached_property
    def driven(self) -> DrivenPath:
        """The path timed within the limits, and what driving it takes; computed on first access.

        Raises
        ------
        InfeasibleMotionError
            If the motors cannot drive the path at any speed.
        InvalidInputError
            If nothing limits the speed, or the plan was created without its problem.
        """
        if self.problem is None:
            raise InvalidInputError(
                "this plan was made without the problem that it answers; use drive_plan of "
                "energyplan.planning.driven"
            )
        return drive_plan(self.problem, self.path)

    @cached_property
    def why_not_driven(self) -> str:
        """Why the path cannot be driven; empty where it can."""
        try:
            _ = self.driven
        except (InfeasibleMotionError, InvalidInputError) as error:
            return str(error)
        return ""

    def drawn(self, battery: BatteryModel, soc: float = 1.0) -> BatteryRun | None:
        """Return what driving the path does to a battery; None where the motors cannot drive it.

        Parameters
        ----------
        battery : BatteryModel
            The battery, such as a `Battery`.
        soc : float
            Its state of charge at the start.

        Raises
        ------
        InvalidInputError
            If the energy of the plan is not counted at the battery.
        """
        if self.problem is not None and not self.problem.cost.battery:
            raise InvalidInputError(
                "the energy of this plan is not counted at the battery; plan with "
                "EnergyCost(model, battery=True)"
            )
        if self.why_not_driven:
            return None
        drive = self.driven
        return drawn(battery, drive.trajectory.t, np.diff(drive.energy_since_start), soc)

    @property
    def energy_driven(self) -> float:
        """What driving the path takes, from standstill to standstill [J]; see `driven`."""
        return self.driven.energy

    @property
    def energy(self) -> float:
        """Deprecated name of `energy_steady` [J]; for what driving takes, use `energy_driven`."""
        return self.energy_steady

    @property
    def speed(self) -> float:
        """Largest tread speed of the drive [m/s]; see `driven`."""
        return self.driven.speed

    @property
    def cost(self) -> float:
        """The objective's value of the drive, with its stops.

        At steady speeds where the path cannot be driven, and for the objective length.
        """
        return self._rated.cost

    @property
    def lower_bound(self) -> float | None:
        """What no path can cost less than, in the unit of the objective (for energy [J]).

        It bounds `cost`: drives, if it is that of a drive. None where no such bound is known.
        """
        return self._rated.lower_bound

    @property
    def gap(self) -> float | None:
        """Cost over lower bound, minus 1: the plan costs at most this fraction above the optimum.

        On slopes, both less the `potential`. As computed: rounding may leave it a hair below zero;
        infinite where the bound is zero and the cost is not; None where no bound is known.
        """
        rated = self._rated
        if rated.lower_bound is None:
            return None
        excess, least = rated.cost - self.potential, rated.lower_bound - self.potential
        return excess / least - 1.0 if least > 0 else (np.inf if excess > 0 else 0.0)

    @property
    def gap_of(self) -> str:
        """What `cost`, `lower_bound` and `gap` are of: ``"driven"`` or ``"steady"``."""
        return "driven" if self._rated.driven else "steady"

    @cached_property
    def _rated(self) -> _Rated:
        """The cost as driven, and its lower bound; at steady speeds where that is the same."""
        steady = _Rated(self.cost_steady, self.lower_bound_steady, driven=False)
        problem = self.problem
        if problem is None or self.why_not_driven or problem.weights.get("length"):
            return steady
        drive, query = self.driven, compiled(problem.without_clearance)
        cost = query.driven_value(self.path, drive)
        scale = max(abs(cost), abs(self.potential), abs(cost - self.potential))
        if abs(cost - self.cost_steady) <= ROUNDING * scale:  # stops and speeds cost nothing
            return steady._replace(driven=True)
        bound = driven_bound(problem, self.lower_bound_steady - self.potential)
        return _Rated(cost, None if bound is None else self.potential + bound, driven=True)

    @property
    def goal_reached(self) -> Pose:
        """The pose at which the path ends, with the yaw in (-pi, pi]."""
        x, y, yaw = self.path.end
        return Pose(x, y, float(wrap_angle(yaw)))

    def _summaries(self) -> list[html.Summary]:
        (spent,) = spending(self)
        back = self.path.reverse_length
        rows: list[tuple[str, object]] = [
            (spent.label, spent.energy),
            *(
                (f"of it {html.words(name)} [J]", html.number(part, whole=spent.energy))
                for name, part in spent.by_term.items()
            ),
            ("duration [s]", spent.duration),
            *([("largest tread speed [m/s]", self.driven.speed)] if spent.driven else []),
            ("length [m]", self.length),
            *([("of it in reverse [m]", back)] if back > 0.01 else []),
            ("turning [deg]", float(np.degrees(self.turning))),
            *([(STEADY, self.energy_steady)] if spent.driven else []),
            *self._costs(),
            ("at most above the least possible [%]", self.gap_percent),
            *self._goal(),
        ]
        title = f"plan by {self.planner} in {self.planning_time:.2f} s, effort {self.effort}"
        if self.effort_limit is not None:
            title += f" of {self.effort_limit}"
        return [html.Summary(title, ("", ""), rows, self.all_notes)]

    def _goal(self) -> list[tuple[str, object]]:
        """Return the row that says which pose was reached, where there was a choice."""
        if self.problem is None or not self.problem.goals:
            return []
        x, y, yaw = self.goal_reached
        return [("goal reached: x, y [m], yaw [deg]", f"{x:.2f}, {y:.2f}, {np.degrees(yaw):.1f}")]

    @property
    def bound_label(self) -> str:
        """What the lower bound is of, with its unit."""
        objective = self.problem.objective if self.problem else "energy"
        unit = {"length": "m", "time": "s"}.get(str(objective), "J")
        if objective != "energy" or self.soft_cost:
            return f"lower bound of the cost [{unit}]"
        return (
            f"lower bound of energy {'as driven' if self._rated.driven else 'at steady speeds'} [J]"
        )

    @property
    def gap_percent(self) -> str:
        """The gap as people read it [%]."""
        return "-" if self.gap is None else html.number(100 * self.gap, whole=100)

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The notes, why there is no gap where there is none, and what more effort may save."""
        advice = [self.advice] if self.advice else []
        return (*self.notes, *([] if self.gap is not None else [_NO_GAP]), *advice)

    @property
    def advice(self) -> str:
        """What more effort may save, where effort ended a plan whose gap exceeds 3 %; else empty.

        No path takes less than the lower bound, so this is the most that can be saved.
        """
        limit, gap = self.effort_limit, self.gap
        if not self.open or limit is None or gap is None or not STAGES.gap < gap < np.inf:
            return ""
        return f"effort {2 * limit} may save up to {ceil(1000.0 * gap / (1.0 + gap)) / 10.0} %"

    def _costs(self) -> list[tuple[str, object]]:
        """Return rows of the cost, where it is not the energy alone, and of its lower bound."""
        problem = self.problem
        objective = problem.objective if problem else "energy"
        name = objective if isinstance(objective, str) else "weighted sum"
        unit = {"length": "m", "time": "s"}.get(name, "J")
        alone = name == "energy" and not self.soft_cost
        rows: list[tuple[str, object]] = [] if alone else [
            (f"cost: {name}{' and a little energy' * (name == 'length')} [{unit}]", self.cost)
        ]  # fmt: skip
        if self.soft_cost:
            part = "the costmap" if problem is None or problem.softened else "priced seconds"
            rows.append((f"of it {part} [{unit}]", self.soft_cost))
        rows.append((self.bound_label, "-" if self.lower_bound is None else self.lower_bound))
        if self.potential:
            rows.append((f"of it for the height [{unit}]", self.potential))
        return rows

    @property
    def poses(self) -> FloatArray:
        """Poses along the path with a spacing of at most 0.1 m and 0.1 rad, shape (n, 3)."""
        return self.path.poses(0.1, 0.1)


_OMPL = "energyplan.planning.ompl"

PLANNERS = {
    "lattice": Planner(
        "energyplan.planning.search.planner:plan",
        surfaces=True, heights=True, objectives=OBJECTIVES, effort=True, bound=True,
        costmap=True, turning=True, forwards=True, ends=True,
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
    """Report a failure of a planner in one line, with the place in the planner's own code."""
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


def _check_call(
    name: str, planner: Planner, problem: PlanningProblem, counted: bool, options: dict[str, Any]
) -> None:
    """Check that a planner can be used with a problem, and that it has the options."""
    if lacking := planner.lacks(problem, counted):
        able = [k for k, other in PLANNERS.items() if not other.lacks(problem, counted)]
        raise UnsupportedPlannerError(
            f"the planner {name!r} cannot be used with {' and '.join(lacking)}; use one of "
            f"{', '.join(able)}"
        )
    try:
        known = signature(planner.function)
    except (TypeError, ValueError):  # a function that does not say what it takes
        return
    try:
        known.bind(None, None, **options)
    except TypeError as error:
        raise InvalidInputError(
            f"the planner {name!r} cannot be called with a problem, a budget and the options "
            f"{sorted(options)}: {error}; it takes {', '.join(known.parameters)}"
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
        Work done once per map is not included: the first plan on a map takes longer.
    effort : int, optional
        Units of work to plan with, 30 000 where left out, and more on a map so large that the
        distances to the goal alone take a quarter of it: the same plan comes of it on any machine
        and under any load. 50 000 take about a second; see `Budget`. Planning ends earlier if the
        planner knows that nothing is left to gain.
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
        If the planner cannot do what the problem requires; the message says which can.
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
        If a lower bound lies above the cost of the path, which is a fault of the bound's code.

    Examples
    --------
    >>> import numpy as np
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.terrain import OccupancyGrid
    >>> from energyplan.power import PowerModel
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    >>> found = plan(PlanningProblem(hall, cost, start=(1, 5, 0), goal=(9, 5, 0)), effort=50_000)
    >>> round(found.energy_driven), abs(found.gap) < 1e-6
    (1808, True)
    """
    from energyplan.planning.ends import checked_ends
    from energyplan.planning.search.planner import compile_planning, prepare
    from energyplan.planning.several import Solver, plan_to_several

    declared = find(planner) if isinstance(planner, str) else planner
    name = planner if isinstance(planner, str) else planner.name
    plan_budget(time_limit, effort)  # says at once what is wrong with them
    _check_call(name, declared, problem, effort is not None, options)
    if known := list(options.get("initial", ())):
        options["initial"] = known  # what can be read but once

    def prepared(ends: CheckedEnds) -> None:
        compile_planning(ends.bare, load=effort is None)
        prepare(ends.bare, guided=declared.bound)

    def solve(ends: CheckedEnds, budget: Budget, more: dict[str, Any]) -> Plan:
        budget.beside(lambda: prepared(ends))
        return _planned(ends, name, declared, budget, {**options, **more})

    if not problem.goals:
        ends = checked_ends(problem)
        prepared(ends)
        budget = plan_budget(time_limit, effort, declared.effort)
        return _planned(ends, name, declared, budget, options)
    solver = Solver(solve, informed=declared is PLANNERS["lattice"])
    budget = plan_budget(time_limit, effort, declared.effort)
    return plan_to_several(problem, solver, budget, options.pop("initial", ()))


def _planned(
    ends: CheckedEnds, name: str, declared: Planner, budget: Budget, options: dict[str, Any]
) -> Plan:
    """Plan between two poses within a budget, and check and price what comes of it."""
    from energyplan.planning.bound import lower_bound
    from energyplan.planning.ends import find_ends

    problem = ends.problem
    given = budget if declared.bound else budget.part(1.0 - SHARES.aside)

    def solve(inner: PlanningProblem, own: Budget) -> Candidate:
        with _blaming(name):
            found = declared.function(inner, own, **options)
        if not isinstance(found, Candidate):
            raise PlanningError(
                f"the planner {name!r} returned a {type(found).__name__}; correct it to return an "
                "energyplan.Candidate"
            )
        for path in [found.path] if found.shortest is None else [found.path, found.shortest]:
            if fault := inner.fault(path):
                raise InvalidPathError(
                    f"the planner {name!r} returned {fault}; correct the planner"
                )
        check_fields(found, PlanningError, f"the planner {name!r} returned a candidate whose ")
        # nobody believes it of others
        return found if declared in PLANNERS.values() else replace(found, driven=None)

    if declared.ends:
        found = solve(problem, given)
    else:
        found = find_ends(problem, given, turning=False).solved(solve, given)
    query = compiled(ends.bare)
    bound = found.lower_bound
    if bound is None:
        value = lower_bound(query, query.value(found.path)).value
        bound = query.potential(problem.goal) + value
    return priced_plan(query, found, bound, name, budget, problem=problem, notes=ends.notes)


def priced_plan(
    query: CompiledProblem,
    found: Candidate,
    bound: float,
    planner: str,
    budget: Budget,
    *,
    problem: PlanningProblem | None = None,
    notes: tuple[str, ...] = (),
) -> Plan:
    """Return the plan of a path that was checked, all but what the budget says computed from it."""
    path, of = found.path, query.problem
    price = of.terrain.price(path, of.cost)
    soft = query.soft_cost(path)
    cost = query.objective.value(price.energy, path.length, price.duration) + soft
    potential = query.potential(of.goal)
    scale = max(abs(cost), abs(potential), abs(cost - potential))
    if not bound <= cost + ROUNDING * scale:
        raise LowerBoundError(
            f"the lower bound {bound!r} of the planner {planner!r} lies above the cost {cost!r} of "
            f"a path from {tuple(of.start)} to {tuple(of.goal)}, so it is no bound; "
            "please report the map and the model to whoever made the planner"
        )
    elapsed = budget.elapsed
    plan = Plan(
        path=path,
        energy_steady=price.energy,
        lower_bound_steady=bound,
        cost_steady=cost,
        length=path.length,
        turning=path.turning,
        duration=price.duration,
        planning_time=elapsed,
        first_time=elapsed if found.first_time is None else found.first_time,
        planner=planner,
        problem=problem or of,
        breakdown=price.by_term,
        potential=potential,
        effort=round(budget.spent),
        effort_limit=budget.limit,
        stopped=bool(budget.notes),
        soft_cost=soft,
        notes=(*notes, *budget.notes),
        shortest=found.shortest,
        open=found.open,
    )
    if found.driven is not None:
        vars(plan)["driven"] = found.driven
    return plan
