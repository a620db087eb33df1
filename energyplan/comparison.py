"""The route of least energy against the shortest one, both priced by the same model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from energyplan import html
from energyplan.path import Path
from energyplan.planning import Plan, Planner, PlanningProblem, plan
from energyplan.planning.bound import Bounding
from energyplan.planning.budget import SHARES, Budget, do_together, plan_budget
from energyplan.planning.driven import Candidate
from energyplan.planning.plans import STEADY, Spent, priced_plan, spending
from energyplan.planning.search.planner import shortened
from energyplan.planning.space.compiled import compiled
from energyplan.records import checked


@dataclass(frozen=True)
class Comparison(html.Readable):
    """Two plans for one problem, and the energy that separates them.

    Attributes
    ----------
    energy_optimal : Plan
        The plan of least energy found.
    shortest : Plan
        The shortest plan found, driven with the least energy that its path allows. Its lower bound
        and gap are those of its `cost`, a length [m].
    saving : float
        Energy saved, as a fraction of the shortest route's; never negative. Both are those of
        `spent`. Where the goal lies below the start, a fraction of what the shortest route takes
        beyond the potential energy of the descent.
    by_term : mapping of str to float
        Joules saved by term of the power model; negative where the route of least energy spends
        more. They add up to the energy saved.
    driven : bool
        Whether the energies are those of driving both routes, with their stops; they are those at
        steady speeds where the motors cannot drive one of them.
    """

    energy_optimal: Plan
    shortest: Plan
    saving: float
    by_term: Mapping[str, float] = field(default_factory=dict)
    driven: bool = False

    @property
    def spent(self) -> tuple[Spent, Spent]:
        """What is compared: what the route of least energy takes, and the shortest one."""
        least, most = spending(self.energy_optimal, self.shortest)
        return least, most

    @property
    def sentence(self) -> str:
        """The saving, and of what it is a fraction."""
        more = " beyond what the descent is worth" * (self.energy_optimal.potential < 0)
        return f"{100 * self.saving:.1f} % of the shortest route's energy{more}"

    def _summaries(self) -> list[html.Summary]:
        plans, spent = (self.energy_optimal, self.shortest), self.spent
        best, whole = self.energy_optimal, spent[1].energy
        back = [plan.path.reverse_length for plan in plans]
        rows: list[tuple[object, ...]] = [
            (spent[0].label, *(one.energy for one in spent)),
            ("duration [s]", *(one.duration for one in spent)),
            ("length [m]", *(plan.length for plan in plans)),
            *([("of it in reverse [m]", *back)] if max(back) > 0.01 else []),
            ("turning [deg]", *(float(np.degrees(plan.turning)) for plan in plans)),
            *([(STEADY, *(plan.energy_steady for plan in plans))] if self.driven else []),
            (best.bound_label, "-" if best.lower_bound is None else best.lower_bound, "-"),
            *([("of it for the height [J]", best.potential, "-")] if best.potential else []),
            ("at most above the least possible [%]", best.gap_percent, "-"),
        ]
        title = f"saving: {self.sentence}"
        parts = [
            (
                html.words(name),
                *(html.number(of.by_term.get(name, 0.0), whole=whole) for of in spent),
                html.number(saved, whole=whole),
            )
            for name, saved in self.by_term.items()
        ]
        notes = [note for plan in plans for note in plan.all_notes]
        return [
            html.Summary(title, ("", "least energy", "shortest"), rows, notes),
            html.Summary(
                "where the energy goes", ("term", "least energy [J]", "shortest [J]", "saved [J]"),
                parts,
            ),
        ]  # fmt: skip


@checked()
def compare(
    problem: PlanningProblem,
    planner: str | Planner = "lattice",
    time_limit: float = inf,
    *,
    effort: int | None = None,
    **options: Any,
) -> Comparison:
    """Plan the route of least energy and the shortest one.

    The lattice planner finds both in one plan, so that the least energy never exceeds the shortest
    route's. Another planner is compared with the lattice planner's shortest route, which stands for
    its own where that takes more. The energies of driving both are compared, with their stops;
    where the motors cannot drive one of them, those at steady speeds.

    Parameters
    ----------
    problem : PlanningProblem
        The problem; its objective is replaced by energy and by length.
    planner : str or Planner
        Name of the planner of the route of least energy. The shortest route is always planned by
        the lattice planner.
    time_limit : float
        Time after which planning stops [s].
    effort : int, optional
        Units of work, as of `energyplan.plan`. On top a quarter of each is for shortening the
        shortest route, and a quarter of the rest for its lower bound; or the whole for that
        route, where the plan does not know it.
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
    >>> bool(told.energy_optimal.energy_driven < told.shortest.energy_driven), round(told.saving, 2)
    (True, 0.07)
    """
    best = plan(replace(problem, objective="energy"), planner, time_limit, effort=effort, **options)
    # where there is a choice of poses the shortest route may lead to another one
    if best.shortest is not None and best.problem is not None and not problem.goals:
        budget = plan_budget(time_limit, effort)
        shortest = _shortest(best, best.shortest, best.problem.shortest, budget)
    else:
        shortest = plan(problem.shortest, "lattice", time_limit, effort=effort)
    least, most = spending(best, shortest)
    if least.energy > most.energy and best.problem is not None:
        of = replace(best.problem, goal=shortest.path.end)
        priced = priced_plan(
            compiled(of.without_clearance), Candidate(shortest.path), best.lower_bound_steady,
            best.planner, Budget(), problem=of, notes=best.notes,
        )  # fmt: skip
        kept = ("planning_time", "first_time", "effort", "effort_limit")
        best = replace(priced, **{name: getattr(best, name) for name in kept})
        least, most = spending(best, shortest)
    spent = max(most.energy, most.energy - best.potential)
    return Comparison(
        energy_optimal=best,
        shortest=shortest,
        saving=(most.energy - least.energy) / spent if spent > 0 else 0.0,
        by_term={
            name: most.by_term.get(name, 0.0) - least.by_term.get(name, 0.0)
            for name in {**most.by_term, **least.by_term}
        },
        driven=least.driven,
    )


def _shortest(best: Plan, path: Path, problem: PlanningProblem, budget: Budget) -> Plan:
    """Return the plan of the shortest route, from that which another plan knows, with a bound."""
    query = compiled(problem)
    path = shortened(query, path, budget.part(SHARES.aside))
    potential, bounding = query.potential(problem.goal), Bounding(query)
    work = bounding.work(query.value(path) - potential, SHARES.aside * budget.left)
    do_together(budget, work)
    bound = potential + bounding.value
    return priced_plan(query, Candidate(path), bound, best.planner, budget, notes=best.notes)
