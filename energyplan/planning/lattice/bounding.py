"""The search for a lower bound, a step at a time, beside the searches for paths."""

from __future__ import annotations

from energyplan.planning.bound import Bound, Spent, lower_bound
from energyplan.planning.budget import Budget, Work
from energyplan.planning.scene.compiled import CompiledProblem

FIRST = 250
"""Units of work for it in the first round; four times as many in every other one since."""

WORTH = 1e-3
"""Part by which a step must raise the bound for one in the next rounds to be worth its work."""

FAIR = 1000
"""Units of work below which a step is not judged by that."""

STEPS = 12_000
"""Steps of the search that count as a unit of work."""


class Bounding:
    """The best lower bound so far, less the potential, and how to raise it.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    """

    def __init__(self, query: CompiledProblem) -> None:
        self._query = query
        free = query.least_in_free_space - query.potential(query.problem.goal)
        self._bound = Bound(free, False)
        self._spent: Spent = {}
        self._hopeful = True

    @property
    def value(self) -> float:
        """What every path costs at least."""
        return self._bound.value

    def know(self, value: float) -> None:
        """Take a lower bound that somebody else found; none is sought then."""
        self._bound = Bound(value, True)

    def in_round(self, number: int, cost: float, most: float) -> list[Work]:
        """Return the step of a round of searches, if it has one; see `work`."""
        wanted = self._hopeful and number % 2 == 0
        return self.work(cost, min(FIRST << number, most)) if wanted else []

    def work(self, cost: float, units: float) -> list[Work]:
        """Return the search for a better bound, where there can be one.

        Parameters
        ----------
        cost : float
            Cost of the best path, which makes the search easier.
        units : float
            Units of work that it may take.
        """

        def run(own: Budget) -> Bound:
            given = min(units, own.left)
            found = lower_bound(self._query, cost, STEPS * given, self._spent)
            if not found.final:
                own.spend(given)
            return found

        def take(found: Bound) -> None:
            before = self.value
            self._bound = Bound(max(found.value, before), found.final)
            self._hopeful = units < FAIR or self.value > before * (1.0 + WORTH)

        return [] if self._bound.final else [Work(run, units, take)]
