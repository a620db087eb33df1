"""What planners return, and what driving it takes: a path in time within the limits, its energy.

A plan prices its path at steady speeds: geometry. Driving it means starting and stopping, time in
which computers draw power, braking whose energy does not all come back, and speeds below the one
that was requested. `drive_path` times the path and integrates the power of the whole model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.cost import DrivenRates, EnergyCost
from energyplan.errors import InfeasibleMotionError
from energyplan.limits.drive import Ground, Traversal
from energyplan.limits.speed import corner_rounding, profile
from energyplan.motion import Motion
from energyplan.path import FloatArray, Path, Trajectory
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.space.prices import Prices, remembered
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

SAME = 1e-6  # part of the energy by which drives differ of which the quicker is taken
NEAR = 0.5  # how far about a corner the footprint must be free for it to be rounded [m]


@dataclass(frozen=True)
class DrivenPath:
    """A path as it is driven."""

    trajectory: Trajectory  # the path, timed within the limits of motors and battery
    energy: float  # what driving it takes [J]
    breakdown: Mapping[str, float]  # the same by term of the power models [J]
    energy_since_start: FloatArray  # at each sample of the trajectory [J]
    speed: float  # largest tread speed of the drive [m/s]
    speed_priced: float  # tread speed that straight driving was priced at [m/s]
    seconds: float = 0.0  # what seconds on priced ground add, in the unit of the objective

    @property
    def duration(self) -> float:
        """Time that driving takes [s]."""
        return self.trajectory.duration


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
    shortest : Path, optional
        The shortest path found on the way; for the least energy it costs no less than `path`.
    driven : DrivenPath, optional
        What driving the path takes, from the planners of the library; it is computed for others.
    open : bool
        Whether the effort ended what might gain yet.
    """

    path: Path
    lower_bound: float | None = None
    first_time: float | None = None
    shortest: Path | None = None
    driven: DrivenPath | None = None
    open: bool = False


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
            path, model, vehicle=vehicle, objective=objective, time_value=cost.time_value,
            smooth=smooth, tolerance=within, period=period, channels=cost.channels,
            surfaces=surfaces, heights=heights,
        )  # fmt: skip
        drive = Traversal(timed, Ground(model, surfaces, heights), cost.channels)
        energies = drive.interval_energies()
        return DrivenPath(
            trajectory=timed,
            energy=float(energies.sum()),
            breakdown=drive.breakdown(),
            energy_since_start=np.append(0.0, np.cumsum(energies)),
            speed=drive.largest_speed(),
            speed_priced=float(np.min(np.atleast_1d(cost.cheapest_speed(0.0)))),
            seconds=_price_of_seconds(drive, surfaces),
        )

    if cost.tread_speed is not None:
        try:
            return driven("time", corners)
        except InfeasibleMotionError:
            if not corners.any():
                raise
            return driven("time", 0.0 * corners)  # a corner that cannot be rounded is stopped at
    # energy is minimised run by run; through rounded corners a stop or more speed may take less
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
    values = [one.energy + cost.time_value * one.duration for one in found]
    enough = min(values)
    enough += SAME * abs(enough)
    good = (one for one, value in zip(found, values, strict=True) if value <= enough)
    return min(good, key=lambda one: one.duration)


def corners_free(
    path: Path, cost: EnergyCost, body: Vehicle, grid: OccupancyGrid
) -> NDArray[np.bool_]:
    """Return whether there is room to drive through each corner between segments."""
    return _free_about(path, body, grid, corner_rounding(cost.vehicle.tracking_tolerance).tolerance)


def _price_of_seconds(drive: Traversal, surfaces: SurfaceMap | None) -> float:
    """Return what the seconds of a drive on priced ground add, in the unit of the objective."""
    if surfaces is None or not any(surfaces.seconds):
        return 0.0
    return float(np.dot(surfaces.seconds, drive.time_by_region()))


def _free_about(
    path: Path, vehicle: Vehicle, grid: OccupancyGrid, offset: float
) -> NDArray[np.bool_]:
    """Return whether the footprint, moved aside by `offset` [m], is free around each corner."""
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
    """Time a path on the ground of a problem, and integrate what driving it takes.

    Parameters
    ----------
    problem : PlanningProblem
        Whose cost, surfaces, heights and obstacles hold; its start and goal do not matter.
    path : Path
        The path, such as one that was planned for other ground.

    Returns
    -------
    DrivenPath
        Energy [J], duration [s], largest tread speed [m/s], and the timed trajectory.

    Raises
    ------
    InfeasibleMotionError
        If the motors cannot drive the path at any speed.
    InvalidInputError
        If nothing limits the speed.
    """
    return drive_path(
        path, problem.cost, problem.surfaces, problem.heights,
        grid=problem.terrain.obstacles, body=problem.robot,
    )  # fmt: skip


def stops_count(problem: PlanningProblem) -> bool:
    """Return whether paths are compared by what driving them takes."""
    weights = {name for name, weight in problem.weights.items() if weight > 0}
    speed = float(problem.cost.cheapest_speed(0.0))
    if "length" in weights or not np.isfinite(speed):
        return False
    if "time" in weights or (problem.surfaces is not None and any(problem.surfaces.seconds)):
        return True
    found = priced_models(problem.cost, problem.surfaces)
    models = [found.model]
    if found.surfaces is not None:
        models += [surface.model for surface in found.surfaces.surfaces]
    return any(_feels_stops(model, speed) for model in models)


def driven_share(problem: PlanningProblem) -> float | None:
    """Return the part of the bound at steady speeds that bounds drives; None where none is known.

    A drive's price is the integral of its power, and of what time costs, over its time. At every
    instant it moves in some direction at some speed up to the largest, so without accelerations it
    takes at least the `share` of `EnergyCost.driven_rates` of the steady price of what it covers.
    What a change of speed adds is the rate of the kinetic energy where power is linear in the
    accelerations: nothing from standstill to standstill. Losses of accelerating treads do not
    cancel so: where they depend on the accelerations they are left out, as power without them is
    less. Nor does the kinetic energy where its mass or the slope changes: no bound is given there.
    On slopes power has to be in proportion to speed, as then every speed takes the same.

    A rounded corner leaves the path by the vehicle's tracking tolerance, which a controller makes
    up for; the drive that is bounded is the one that arrives.
    """
    rates = _driven_rates(problem)
    return None if rates is None else rates.share


def driven_bound(problem: PlanningProblem, least: float) -> float | None:
    """Return what no drive takes less than, given that of steady speeds; both less the potential.

    A drive begins and ends at a standstill. The faster tread gains speed at no more than the
    motor's acceleration, so after a time ``t``, and as long before the end, what is covered in a
    second has a steady price of at most ``quickest t``. While that is below what a second takes at
    any speed, the second is paid for all the same: the difference adds to the share of `least`.
    """
    rates = _driven_rates(problem)
    if rates is None or not (rates.share > 0.0 or least == 0.0):
        return None
    bound = rates.share * least
    if problem.heights is not None or problem.softened or not rates.still > 0.0:
        return bound
    slope = rates.share * rates.quickest
    shortest = 2.0 * np.sqrt(max(least, 0.0) / rates.quickest)  # time that the drive takes
    ramps = min(shortest, 2.0 * rates.still / slope)
    return float(bound + rates.still * ramps - 0.25 * slope * ramps**2)


def _driven_rates(problem: PlanningProblem) -> DrivenRates | None:
    """Return the rates of the bound on drives over all ground; None where none is known."""
    weights = problem.weights
    energy, time = weights.get("energy", 0.0), weights.get("time", 0.0)
    prices = Prices(problem.cost, problem.surfaces, problem.objective)
    costs = prices.costs
    if energy:
        masses = [cost.kinetic_masses() for cost in costs]
        known = [one for one in masses if one is not None]
        if len(known) < len(masses) or not np.allclose(known, known[0], rtol=1e-9, atol=0.0):
            return None
        if problem.heights is not None and (
            time or np.any(known[0]) or not all(cost.same_at_any_speed for cost in costs)
        ):
            return None
    rates = []
    for k, cost in enumerate(costs):
        weighed = energy, prices.of_time(k)
        make = partial(cost.driven_rates, *weighed)
        found = remembered(cost, None, ("drives", *weighed), make)
        if found is None:
            return None
        rates.append(found)
    share, still, quickest = zip(*rates, strict=True)
    return DrivenRates(min(share), min(still), max(quickest))


def _feels_stops(model: PowerModel, speed: float) -> bool:
    """Return whether accelerating from a standstill takes a different power than steady driving."""
    known = dict.fromkeys(("t", "x", "y", "yaw", "slope"), 0.0)
    motion = Motion.from_twist(
        speed * np.array([1.0, 1.0, 0.0]), np.zeros(3), model.vehicle.icr,
        accel=np.array([0.0, 1.0, 0.0]), yaw_accel=np.zeros(3), **known,
    )  # fmt: skip
    steady, faster, still = model.power(motion)
    return bool(abs(faster - steady) > 1e-9 * abs(steady) or still > 0)
