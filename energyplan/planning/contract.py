"""What planners are, what they hand back, and what becomes of it.

A planner returns a path, and a lower bound if it has one. Nobody believes it: `energyplan.plan`
alone checks the path, prices it with the power models, and makes the `Plan`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from energyplan.errors import (
    InvalidInputError,
    InvalidPathError,
    LowerBoundError,
    MissingDependencyError,
)
from energyplan.path import Path, wrap_angle
from energyplan.planning.budget import Budget
from energyplan.planning.driven import Plan
from energyplan.planning.problem import OBJECTIVES, PlanningProblem
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.records import check_fields

ARRIVED = 1e-6
"""How far from start and goal a path may begin and end [m], [rad]: rounding."""

ROUNDING = 1e-9
"""By what fraction a lower bound may lie above the cost of a path: rounding."""


@dataclass(frozen=True)
class Candidate:
    """What a planner returns: a path, with a lower bound if it has one.

    Parameters
    ----------
    path : Path
        The path, from the problem's start to its goal.
    lower_bound : float, optional
        What no path costs less than, in the unit of the objective; the library computes one where
        it is left out.
    first_time : float, optional
        `Budget.elapsed` when a first path was known [s]; the end where left out.
    """

    path: Path
    lower_bound: float | None = None
    first_time: float | None = None


@dataclass(frozen=True)
class Planner:
    """A planner, and what it can do.

    Parameters
    ----------
    run : callable or str
        A function ``(problem, budget, **options) -> Candidate``; as ``"module:function"`` it is
        imported when it is used.
    surfaces : bool
        Whether it can be used where there are surfaces with power models of their own.
    heights : bool
        Whether it can be used where the ground slopes.
    objectives : tuple of str
        What it can make least, alone or weighed: of ``"energy"``, ``"length"``, ``"time"``.
    effort : bool
        Whether it spends the budget by what it does, so that it can be limited by effort. One that
        cannot reads the clock.
    costmap : bool
        Whether it can be used where a costmap counts beside the objective.
    turning : bool
        Whether it keeps a least radius of arcs.
    forwards : bool
        Whether it can be used where the vehicle may not drive backwards.
    bound : bool
        Whether it returns a lower bound. For one that does not, a tenth of the budget is kept for
        computing one.

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
        """Return what a problem asks for and this planner cannot do, in words.

        Parameters
        ----------
        problem : PlanningProblem
            The problem.
        counted : bool
            Whether the budget is one of effort.
        """
        wanted = [name for name, weight in problem.weights.items() if weight > 0]
        missing = {
            "surfaces": problem.terrain.ground.surfaces and not self.surfaces,
            "heights": problem.heights is not None and not self.heights,
            "a costmap": problem.softened and not self.costmap,
            "a least turning radius": problem.least_radius > 0 and not self.turning,
            "a vehicle that does not reverse": not (problem.robot.reverse or self.forwards),
            **{f"the objective {name}": name not in self.objectives for name in wanted},
            "effort instead of a time limit": counted and not self.effort,
        }
        return [name for name, lacking in missing.items() if lacking]


def check_path(problem: PlanningProblem, path: Path, planner: str) -> None:
    """Check that a path answers a problem."""

    def refuse(what: str) -> InvalidPathError:
        return InvalidPathError(f"the planner {planner!r} returned {what}; correct the planner")

    if not isinstance(path, Path):
        raise refuse(f"a {type(path).__name__} in place of a Path")
    reference = problem.cost.icr.longitudinal
    if path.longitudinal != reference:
        raise refuse(
            f"a path of the reference point at x = {path.longitudinal:g} m; that of the vehicle "
            f"lies at {reference:g} m"
        )
    for name, found, wanted in (
        ("starts", path.start, problem.start),
        ("ends", path.end, problem.goal),
    ):
        miss = np.subtract(found, wanted)
        miss[2] = wrap_angle(miss[2])
        if not np.abs(miss).max() <= ARRIVED:
            raise refuse(
                f"a path that {name} at ({found.x:.3f}, {found.y:.3f}, "
                f"{np.degrees(found.yaw):.1f} deg) in place of ({wanted.x:.3f}, {wanted.y:.3f}, "
                f"{np.degrees(wanted.yaw):.1f} deg)"
            )
    segment = problem.tightest(path)
    if segment is not None:
        raise refuse(
            f"a path whose segment {segment} turns on an arc of less than "
            f"{problem.least_radius:.3g} m"
        )
    segment = problem.reversing(path)
    if segment is not None:
        raise refuse(f"a path whose segment {segment} drives backwards, which the vehicle may not")
    grid = problem.terrain.obstacles
    segment = problem.first_collision(path)
    if segment is not None:
        at = path.vertices[min(segment, len(path.vertices) - 1)]
        raise refuse(
            f"a path that is not free of collisions: its segment {segment}, from ({at[0]:.3f}, "
            f"{at[1]:.3f}, {np.degrees(at[2]):.1f} deg), touches an obstacle or leaves the map, "
            f"which covers {grid.describe_extent()}"
        )


def priced_plan(
    compiled: CompiledProblem,
    path: Path,
    bound: float,
    planner: str,
    budget: Budget,
    *,
    first_time: float | None = None,
    asked: PlanningProblem | None = None,
    notes: tuple[str, ...] = (),
) -> Plan:
    """Return the plan of a path that was checked, all but what the budget says computed from it.

    `asked` is the problem where the compiled one lacks its clearance, for ends that have less.
    """
    problem = compiled.problem
    price = problem.terrain.price(path, problem.cost)
    soft = compiled.soft_cost(path)
    cost = compiled.objective.value(price.energy, path.length, price.duration) + soft
    potential = compiled.potential(problem.goal)
    scale = max(abs(cost), abs(potential), abs(cost - potential))
    if not bound <= cost + ROUNDING * scale:
        raise LowerBoundError(
            f"the lower bound {bound!r} of the planner {planner!r} lies above the cost {cost!r} of "
            f"a path from {tuple(problem.start)} to {tuple(problem.goal)}, so it is no bound; "
            "please report the map and the model to whoever made the planner"
        )
    excess, least, elapsed = cost - potential, bound - potential, budget.elapsed
    return Plan(
        path=path,
        energy=price.energy,
        lower_bound=bound,
        gap=excess / least - 1.0 if least > 0 else (np.inf if excess > 0 else 0.0),
        cost=cost,
        length=path.length,
        turning=path.turning,
        duration=price.duration,
        planning_time=elapsed,
        first_time=elapsed if first_time is None else first_time,
        planner=planner,
        problem=asked or problem,
        breakdown=price.by_term,
        potential=potential,
        effort=round(budget.spent),
        effort_limit=budget.effort,
        stopped=bool(budget.notes),
        soft_cost=soft,
        notes=(*notes, *budget.notes),
    )
