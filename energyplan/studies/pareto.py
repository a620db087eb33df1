"""Energy against time: what a faster drive costs, for each value of time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from energyplan import html
from energyplan.errors import InvalidInputError
from energyplan.kinds import checked
from energyplan.path import FloatArray
from energyplan.planning import Plan, Planner, PlanningProblem, plan
from energyplan.planning.contract import priced_plan
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.records import ByValue

SHARES = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Values of a second that are tried, in units of the power of the drive of least energy."""


@dataclass(frozen=True)
class ParetoPoint:
    """A drive that no other known drive beats in both energy and time.

    Parameters
    ----------
    time_value : float
        What a second was worth when it was planned [J/s].
    plan : Plan
        The plan. Its cost is its energy plus the value of its time [J], and its lower bound and
        gap are those of that sum.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> point = ParetoPoint(time_value=5.0, plan=ep.plan(problem, effort=1000))
    >>> point.time_value
    5.0
    """

    time_value: float
    plan: Plan


@dataclass(frozen=True, eq=False)
class ParetoFront(ByValue, html.Readable):
    """Drives for one problem, from the one of least energy to the fastest.

    Parameters
    ----------
    points : tuple of ParetoPoint
        The drives; each is faster than the one before, and takes more energy.
    bounds : ndarray, shape (n, 2)
        Values of a second [J/s], each with a lower bound of any drive's energy plus the value of
        its time [J].

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> front = ep.pareto(problem, time_values=(0.0, 9.0), effort=1000)
    >>> bool(front.energy[0] <= front.energy[-1])
    True
    """

    points: tuple[ParetoPoint, ...]
    bounds: FloatArray

    @property
    def energy(self) -> FloatArray:
        """Energy of each drive [J], shape (m,)."""
        return np.array([point.plan.energy for point in self.points])

    @property
    def duration(self) -> FloatArray:
        """Time that each drive takes [s], shape (m,)."""
        return np.array([point.plan.duration for point in self.points])

    def least_energy(self, duration: ArrayLike) -> FloatArray:
        """Return what no drive takes less energy than.

        Parameters
        ----------
        duration : array_like, shape (...)
            Time that the drive takes [s].

        Returns
        -------
        ndarray, shape (...)
            Lower bound on its energy [J]: each value of a second bounds it by a straight line.
        """
        value, least = self.bounds.T
        lines = least - value * np.asarray(duration, float)[..., None]
        return np.asarray(np.max(lines, axis=-1))

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (f"{point.time_value:.0f}", point.plan.duration, point.plan.energy, point.plan.length)
            for point in self.points
        ]
        heads = ("a second is worth [J]", "duration [s]", "energy [J]", "length [m]")
        return [html.Summary("energy against time", heads, rows)]


@checked()
def pareto(
    problem: PlanningProblem,
    time_values: Iterable[float] | None = None,
    planner: str | Planner = "lattice",
    time_limit: float = 1.0,
    *,
    effort: int | None = None,
    **options: Any,
) -> ParetoFront:
    """Plan drives that trade energy against time.

    For each value of a second, the energy plus the value of the time is minimised over routes and
    speeds. So the front contains the drives that are best for some value of a second. Every route
    found is tried at every value.

    How much there is to trade depends on the model. If energy does not depend on speed, every
    drive is as fast as the limits allow, and only the routes differ. If resistance grows with
    speed, fast drives take more energy. With a hotel load, slow drives do.

    Parameters
    ----------
    problem : PlanningProblem
        The problem; its objective is replaced, and so is the `time_value` of its cost. A `speed`
        of its cost is kept, and the routes alone then differ.
    time_values : iterable of float, optional
        What a second is worth [J/s], each >= 0. Where not given: nothing, then 0.1 to 10 times
        the mean power of the drive of least energy.
    planner : str or Planner
        Name of the planner.
    time_limit : float
        Time to plan for each value [s].
    effort : int, optional
        Units of work for each value, in place of the time limit; see `energyplan.plan`.
    **options : object
        Further options of the planner.

    Returns
    -------
    ParetoFront
        The drives that no other one beats in both energy and time, and the lower bounds.

    Raises
    ------
    InvalidInputError
        If there are no values, one is negative or not finite, or the vehicle has no speed limit.
    PlanningError
        As `energyplan.plan`.

    Examples
    --------
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.power.effects import VISCOUS_LOSS
    >>> from energyplan.terrain import OccupancyGrid
    >>> from energyplan.power import PowerModel
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> stiff = PowerModel.preset("quadriga:empty:concrete").with_term(VISCOUS_LOSS, 100.0)
    >>> task = PlanningProblem(hall, EnergyCost(stiff), start=(1, 5, 0), goal=(9, 5, 0))
    >>> front = pareto(task, time_values=[50.0, 150.0], effort=50_000)
    >>> [(round(p.plan.duration, 1), round(p.plan.energy)) for p in front.points]
    [(16.0, 2608), (9.2, 3194)]
    """
    found: list[tuple[PlanningProblem, Plan]] = []
    given = tuple(options.get("initial", ()))

    def solve(value: float) -> None:
        task = replace(
            problem,
            cost=replace(problem.cost, time_value=value),
            objective={"energy": 1.0, "time": value},
        )
        if planner == "lattice":
            options["initial"] = [*given, *(drive.path for _, drive in found)]
        found.append((task, plan(task, planner, time_limit, effort=effort, **options)))

    if time_values is None:
        solve(0.0)
        first = found[0][1]
        if not np.isfinite(first.duration):
            raise InvalidInputError(
                f"the vehicle {problem.cost.vehicle.name!r} has no speed limit, so drives take no "
                "time; set its motor speed"
            )
        spent = max(first.energy, first.energy - first.potential)
        values = [share * spent / first.duration for share in SHARES[1:]]
    else:
        values = sorted({float(value) for value in time_values})
        if not values:
            raise InvalidInputError("time_values is empty; give what a second is worth [J/s]")
    for value in values:
        solve(value)

    points = []
    for task, own in found:
        # the bound on the plan for this value holds for every other drive as well
        drives = [own, *(_driven(task, drive, own) for _, drive in found if drive is not own)]
        best = min(drives, key=lambda drive: drive.cost)
        points.append(ParetoPoint(task.cost.time_value, best))
    bounds = np.array([(point.time_value, point.plan.lower_bound) for point in points])
    return ParetoFront(_undominated(points), bounds)


def _driven(task: PlanningProblem, known: Plan, own: Plan) -> Plan:
    """Return the plan of a known path, driven at the speeds of another problem."""
    return priced_plan(
        CompiledProblem(task),
        known.path,
        own.lower_bound,
        known.planner,
        planning_time=known.planning_time,
        first_time=known.first_time,
        effort=known.effort,
    )


def _undominated(points: list[ParetoPoint]) -> tuple[ParetoPoint, ...]:
    """Return those that none beats in energy and time, the cheapest first; equal ones once."""
    kept: list[ParetoPoint] = []
    for point in sorted(points, key=lambda p: (p.plan.energy, p.plan.duration)):
        if not kept or point.plan.duration < kept[-1].plan.duration * (1.0 - 1e-9):
            kept.append(point)
    return tuple(kept)
