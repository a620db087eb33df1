"""Plans, and what driving a path takes: the path timed within the limits, and all of its energy.

A plan prices its path at steady speeds: geometry. Driving it means starting and stopping, time in
which computers draw power, braking whose energy does not all come back, and speeds below the one
that was asked for. `drive_path` times the path and integrates the power of the whole model.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan import html
from energyplan.cost import EnergyCost
from energyplan.errors import EnergyPlanError, InfeasibleMotionError, InvalidInputError
from energyplan.limits.drive import Drive, Ground
from energyplan.limits.speed import corner_rounding, profile
from energyplan.motion import Motion
from energyplan.path import FloatArray, Path, Trajectory
from energyplan.planning.problem import PlanningProblem
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

SAME = 1e-6
"""Part of the energy by which drives differ of which the quicker is taken."""

NEAR = 0.5
"""How far about a corner the footprint must be free for it to be rounded [m]."""


@dataclass(frozen=True)
class DrivenPath:
    """A path as it is driven."""

    trajectory: Trajectory  # the path, timed within the limits of motors and battery
    energy: float  # what driving it takes [J]
    breakdown: Mapping[str, float]  # the same by term of the power models [J]
    energy_since_start: FloatArray  # at each sample of the trajectory [J]
    speed: float  # tread speed that straight driving was priced at [m/s]

    @property
    def duration(self) -> float:
        """Time that driving takes [s]."""
        return self.trajectory.duration


def drive_path(
    path: Path,
    cost: EnergyCost,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
    *,
    vehicle: Vehicle | None = None,
    tolerance: float | None = None,
    grid: OccupancyGrid | None = None,
    body: Vehicle | None = None,
    period: float = 0.05,
) -> DrivenPath:
    """Time a path as its cost assumes, and integrate what driving it takes."""
    model, surfaces = priced_models(cost, surfaces)
    vehicle = cost.vehicle if vehicle is None else vehicle
    if cost.tread_speed is not None:
        vehicle = vehicle.up_to(cost.tread_speed)
    allowed = vehicle.tracking_tolerance if tolerance is None else tolerance
    smooth, within = corner_rounding(allowed)
    corners: FloatArray = np.full(max(len(path) - 1, 0), smooth)
    if grid is not None:
        corners *= _free_about(path, vehicle if body is None else body, grid, within)

    def driven(objective: Literal["time", "energy"], smooth: FloatArray) -> DrivenPath:
        timed = profile(
            path, model, vehicle=vehicle, objective=objective, smooth=smooth, tolerance=within,
            period=period, channels=cost.channels, surfaces=surfaces, heights=heights,
        )  # fmt: skip
        drive = Drive(timed, Ground(model, surfaces, heights), cost.channels)
        energies = drive.interval_energies()
        return DrivenPath(
            trajectory=timed,
            energy=float(energies.sum()),
            breakdown=drive.breakdown(),
            energy_since_start=np.append(0.0, np.cumsum(energies)),
            speed=float(np.min(np.atleast_1d(cost.cheapest_speed(0.0)))),
        )

    if cost.tread_speed is not None:
        try:
            return driven("time", corners)
        except InfeasibleMotionError:
            if not corners.any():
                raise
            return driven("time", 0.0 * corners)  # a corner that cannot be rounded is stopped at
    # least energy is sought run by run; through rounded corners a stop or haste may take less
    ways = [partial(driven, "energy", 0.0 * corners)]
    if corners.any():
        ways += [partial(driven, "energy", corners), partial(driven, "time", corners)]
    found = []
    for way in ways:
        try:
            found.append(way())
        except InfeasibleMotionError:
            if way is ways[-1] and not found:
                raise
    enough = min(one.energy for one in found)
    enough += SAME * abs(enough)
    return min((one for one in found if one.energy <= enough), key=lambda one: one.duration)


def _free_about(
    path: Path, vehicle: Vehicle, grid: OccupancyGrid, offset: float
) -> NDArray[np.bool_]:
    """Tell about which corners of a path the footprint is free when moved aside by `offset` [m]."""
    c = vehicle.icr.half_track
    fine = path.subdivide(0.05, 0.05)
    along = np.append(0.0, np.cumsum(np.abs(fine.ds) + c * np.abs(fine.dtheta)))
    around = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    moved = np.repeat(fine.vertices[None], len(around), axis=0)
    moved[..., 0] += offset * np.cos(around)[:, None]
    moved[..., 1] += offset * np.sin(around)[:, None]
    free = grid.footprint_free(moved.reshape(-1, 3), vehicle).reshape(len(around), -1).all(axis=0)
    blocked = np.append(0, np.cumsum(~free))
    corner = np.cumsum(np.abs(path.ds) + c * np.abs(path.dtheta))[:-1]
    first = np.searchsorted(along, corner - NEAR)
    last = np.searchsorted(along, corner + NEAR, side="right")
    return np.asarray(blocked[last] == blocked[first])


class PricedModels(NamedTuple):
    """Power models whose power is the energy that a cost counts."""

    model: PowerModel
    surfaces: SurfaceMap | None


def priced_models(cost: EnergyCost, surfaces: SurfaceMap | None = None) -> PricedModels:
    """Return the cost's model and the surfaces; at the battery if the cost counts there."""
    if not cost.battery:
        return PricedModels(cost.model, surfaces)
    if surfaces is not None:
        changed = (replace(s, model=s.model.battery_side()) for s in surfaces.surfaces)
        surfaces = replace(surfaces, surfaces=tuple(changed))
    return PricedModels(cost.model.battery_side(), surfaces)


def drive_plan(problem: PlanningProblem, path: Path) -> DrivenPath:
    """Time a path of a problem, and integrate what driving it takes; see `drive_path`."""
    return drive_path(
        path, problem.cost, problem.surfaces, problem.heights,
        grid=problem.terrain.obstacles, body=problem.robot,
    )  # fmt: skip


def stops_count(problem: PlanningProblem) -> bool:
    """Tell whether what driving takes is the energy by which paths are compared."""
    weights = {name for name, weight in problem.weights.items() if weight > 0}
    speed = float(problem.cost.cheapest_speed(0.0))
    if weights != {"energy"} or problem.softened or not np.isfinite(speed):
        return False
    found = priced_models(problem.cost, problem.surfaces)
    models = [found.model]
    if found.surfaces is not None:
        models += [surface.model for surface in found.surfaces.surfaces]
    return any(_feels_stops(model, speed) for model in models)


def _feels_stops(model: PowerModel, speed: float) -> bool:
    """Tell whether speeding up from a standstill takes other power than driving on."""
    known = dict.fromkeys(("t", "x", "y", "yaw", "slope"), 0.0)
    motion = Motion.from_twist(
        speed * np.array([1.0, 1.0, 0.0]), np.zeros(3), model.vehicle.icr,
        accel=np.array([0.0, 1.0, 0.0]), yaw_accel=np.zeros(3), **known,
    )  # fmt: skip
    steady, faster, still = model.power(motion)
    return bool(abs(faster - steady) > 1e-9 * abs(steady) or still > 0)


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


def spending(*plans: Plan) -> list[Spent]:
    """Return what plans take: as driven where all of them can be, else at steady speeds."""
    if any(plan.why_not_driven for plan in plans):
        return [Spent(one.energy, one.breakdown, one.duration, driven=False) for one in plans]
    drives = [plan.driven for plan in plans]
    return [Spent(one.energy, one.breakdown, one.duration, driven=True) for one in drives]


@dataclass(frozen=True)
class Plan(html.Readable):
    """A path with its cost, and how far from optimal it can be at most.

    Attributes
    ----------
    path : Path
        The path; free of collisions from the start to the goal.
    energy : float
        Its energy, priced by the model itself after planning [J]. Downhill it can be negative.
    lower_bound : float
        What no path can cost less than, in the unit of the objective (for energy [J]).
    gap : float
        Cost over lower bound, minus 1: the plan costs at most this fraction more than the optimum.
        On slopes, both less the `potential`. As computed: rounding may leave it a hair below zero;
        infinite where the bound is zero and the cost is not.
    cost : float
        The objective's value: `energy` itself where energy is the objective, and what a costmap
        adds.
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
        What the costmap adds to the cost, in the unit of the objective; no part of the energy.
    notes : tuple of str
        What was done about a start that touches an obstacle, or an end that lacks the clearance;
        and that the clock stopped the planning, if it did.
    problem : PlanningProblem, optional
        What it answers, which `driven` needs; a plan read from a pickle has been driven instead.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> plan = ep.plan(problem, effort=1000)
    >>> round(plan.energy), plan.lower_bound <= plan.energy, round(plan.length, 2)
    (540, True, 3.0)
    """

    path: Path
    energy: float
    lower_bound: float
    gap: float
    cost: float
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

    def __getstate__(self) -> dict[str, object]:
        # the problem holds the map; the drive itself is small
        with suppress(EnergyPlanError):
            _ = self.driven
        return {**vars(self), "problem": None}

    @cached_property
    def driven(self) -> DrivenPath:
        """The path timed within the limits, and what driving it takes; made when first asked for.

        Raises
        ------
        InfeasibleMotionError
            If the motors cannot drive the path at any speed.
        InvalidInputError
            If nothing limits the speed, or whoever made the plan did not say what it answers.
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

    @property
    def energy_driven(self) -> float:
        """What driving the path takes, from standstill to standstill [J]; see `driven`."""
        return self.driven.energy

    @property
    def speed(self) -> float:
        """Tread speed that straight driving was priced at [m/s]; see `driven`."""
        return self.driven.speed

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
            *([("speed [m/s]", self.driven.speed)] if spent.driven else []),
            ("length [m]", self.length),
            *([("of it in reverse [m]", back)] if back > 0.01 else []),
            ("turning [deg]", float(np.degrees(self.turning))),
            *([(STEADY, self.energy)] if spent.driven else []),
            *self._costs(),
            ("at most above the least possible [%]", html.number(100 * self.gap, whole=100)),
        ]
        title = f"plan by {self.planner} in {self.planning_time:.2f} s, effort {self.effort}"
        if self.effort_limit is not None:
            title += f" of {self.effort_limit}"
        return [html.Summary(title, ("", ""), rows, self.notes)]

    def _costs(self) -> list[tuple[str, float]]:
        """Return rows of the cost, where it is not the energy alone, and of its lower bound."""
        objective = self.problem.objective if self.problem else "energy"
        name = objective if isinstance(objective, str) else "weighted sum"
        unit = {"length": "m", "time": "s"}.get(name, "J")
        rows = [] if self.cost == self.energy else [
            (f"cost: {name}{' and a little energy' * (name == 'length')} [{unit}]", self.cost)
        ]  # fmt: skip
        if self.soft_cost:
            rows.append((f"of it the costmap [{unit}]", self.soft_cost))
        of = "the cost" if rows else "energy at steady speeds"
        rows.append((f"lower bound of {of} [{unit}]", self.lower_bound))
        if self.potential:
            rows.append((f"of it for the height [{unit}]", self.potential))
        return rows

    @property
    def poses(self) -> FloatArray:
        """Poses along the path, 0.1 m and 0.1 rad apart at most, shape (n, 3)."""
        return self.path.poses(0.1, 0.1)
