"""The route of least energy against the shortest one, both priced by the same model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from energyplan import html
from energyplan.kinds import checked
from energyplan.path import FloatArray, Path
from energyplan.planning import Plan, Planner, PlanningProblem, plan
from energyplan.planning.contract import priced_plan
from energyplan.planning.driven import stops_count
from energyplan.planning.space.compiled import compiled


@dataclass(frozen=True)
class Comparison(html.Readable):
    """Two plans for one problem, and the energy that separates them.

    Attributes
    ----------
    energy_optimal : Plan
        The plan of least energy found.
    shortest : Plan
        The shortest plan found, driven with the least energy that its path allows. Its lower bound
        and gap are those of its length [m].
    saving : float
        Energy saved, as a fraction of the shortest route's; never negative. Where the goal lies
        below the start, a fraction of what the shortest route takes beyond the energy that the
        descent is worth.
    by_term : mapping of str to float
        Joules saved by term of the power model; negative where the route of least energy spends
        more. They add up to the energy saved.
    driven : bool
        Whether both are of the energies that driving takes, with its stops, because these count;
        else they are of those at steady speeds.
    """

    energy_optimal: Plan
    shortest: Plan
    saving: float
    by_term: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False

    @property
    def spent(self) -> tuple[Spent, Spent]:
        """What is compared: what the route of least energy takes, and the shortest one."""
        return _spent(self.energy_optimal, self.driven), _spent(self.shortest, self.driven)

    def _summaries(self) -> list[html.Summary]:
        plans, spent = (self.energy_optimal, self.shortest), self.spent
        rows: list[tuple[object, ...]] = [
            ("energy [J]", *(plan.energy for plan in plans)),
            ("lower bound, of energy [J] and length [m]", *(plan.lower_bound for plan in plans)),
            ("at most above the least possible [%]", *(100 * plan.gap for plan in plans)),
            ("length [m]", *(plan.length for plan in plans)),
            ("turning [deg]", *(float(np.degrees(plan.turning)) for plan in plans)),
            ("duration at a steady speed [s]", *(plan.duration for plan in plans)),
        ]
        if self.energy_optimal.potential:
            rows.insert(2, ("of it for the height [J]", self.energy_optimal.potential, "-"))
        title = f"saving: {100 * self.saving:.1f} % of the shortest route's energy"
        if not any(plan.why_not_driven for plan in plans):
            rows.insert(
                1, ("driven, with its stops: energy [J]", *(plan.driven.energy for plan in plans))
            )
            rows.append(("driven: duration [s]", *(plan.driven.duration for plan in plans)))
        if self.driven:
            title += ", driven with its stops"
        parts = [
            (html.words(name), *(of.by_term.get(name, 0.0) for of in spent), saved)
            for name, saved in self.by_term.items()
        ]
        notes = [note for plan in plans for note in plan.notes]
        return [
            html.Summary(title, ("", "least energy", "shortest"), rows, notes),
            html.Summary(
                "where the energy goes", ("term", "least energy [J]", "shortest [J]", "saved [J]"),
                parts,
            ),
        ]  # fmt: skip


class Spent(NamedTuple):
    """Energy [J], whole and by term of the power model."""

    energy: float
    by_term: Mapping[str, float]


def _spent(made: Plan, driven: bool) -> Spent:
    """Return what a plan takes, driven with its stops or at a steady speed."""
    if driven:
        return Spent(made.driven.energy, made.driven.breakdown)
    return Spent(made.energy, made.breakdown)


@checked()
def compare(
    problem: PlanningProblem,
    planner: str | Planner = "lattice",
    time_limit: float = 1.0,
    *,
    effort: int | None = None,
    **options: Any,
) -> Comparison:
    """Plan the route of least energy and the shortest one.

    Both are those of `energyplan.plan`. A plan of least energy by the lattice planner never takes
    more than the shortest one of the same effort; where one by the clock or by another planner
    does, the shortest one stands for it. Where stops count (the cost has a speed, and stopping
    takes energy) the energies of driving both are compared; where one cannot be driven, and
    wherever stops do not count, those at steady speeds.

    Parameters
    ----------
    problem : PlanningProblem
        The problem; its objective is replaced by energy and by length.
    planner : str or Planner
        Name of the planner of the route of least energy. The shortest route is always planned by
        the lattice planner.
    time_limit : float
        Time for each of the two [s].
    effort : int, optional
        Units of work for each of the two, in place of the time limit; see `energyplan.plan`.
    **options : object
        Further options of the planner.

    Returns
    -------
    Comparison
        Both plans, the fraction of energy saved, and the joules saved by term.

    Raises
    ------
    PlanningError
        As `energyplan.plan`.

    Examples
    --------
    >>> import numpy as np
    >>> from energyplan.cost import EnergyCost
    >>> from energyplan.terrain import OccupancyGrid
    >>> from energyplan.power import PowerModel
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    >>> task = PlanningProblem(hall, cost, start=(2, 5, 0), goal=(5, 5, np.pi / 2))
    >>> told = compare(task, effort=50_000)
    >>> bool(told.energy_optimal.energy < told.shortest.energy), round(told.saving, 2)
    (True, 0.07)
    """
    shortest = plan(replace(problem, objective="length"), "lattice", time_limit, effort=effort)
    cheapest = replace(problem, objective="energy")
    best = plan(cheapest, planner, time_limit, effort=effort, **options)
    driven = stops_count(cheapest) and not (shortest.why_not_driven or best.why_not_driven)
    if _spent(best, driven).energy > _spent(shortest, driven).energy:
        best = priced_plan(
            compiled(cheapest), shortest.path, best.lower_bound, best.planner,
            planning_time=best.planning_time, first_time=best.first_time, effort=best.effort,
        )  # fmt: skip
    least, most = _spent(best, driven), _spent(shortest, driven)
    spent = max(most.energy, most.energy - best.potential)
    return Comparison(
        energy_optimal=best,
        shortest=shortest,
        saving=(most.energy - least.energy) / spent if spent > 0 else 0.0,
        by_term={
            name: most.by_term.get(name, 0.0) - least.by_term.get(name, 0.0)
            for name in {**most.by_term, **least.by_term}
        },
        driven=driven,
    )


class Along(NamedTuple):
    """Distance travelled [m] and energy since the start [J] at places (n, 3) along a path."""

    metres: FloatArray
    joules: FloatArray
    places: FloatArray


def energy_along(path: Path, problem: PlanningProblem) -> Along:
    """Return the energy along a path, on the problem's ground; it ends with the path's own."""
    terrain = problem.terrain
    if terrain.heights is None:
        path = path.subdivide(0.1, 0.1)
    fine = terrain.cut(path)
    each = np.zeros(len(fine))
    for piece in terrain.pieces(path, problem.cost):
        each += piece.cost.segment_energy(piece.path.ds, piece.path.dtheta, piece.slope)
    joules = np.concatenate([[0.0], np.cumsum(each)])
    metres = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    return Along(metres, joules, fine.vertices)
