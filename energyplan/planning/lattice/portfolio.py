"""A portfolio of paths, among which the budget for refinement is divided.

How cheap a path becomes shows only when it is refined, and a path that starts cheaper often ends
dearer. So all of them are refined a little, the better ones more, and the best few to the end.
"""

from __future__ import annotations

import numpy as np

from energyplan.planning.budget import Budget
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.motions import KernelProblem

TURN = 400
"""Attempts at a path before the next one gets its turn."""

KEPT = 4
"""Paths that stay in the portfolio."""

LEADING = 2
"""How many of them get another turn."""

HOPE = 1.03
"""Cost after its turns, in units of the best one, above which a path is given up."""


class Portfolio:
    """The best motions known, and those that may still become better.

    Parameters
    ----------
    setting : KernelProblem
        The problem.
    seed : int
        Seed of the random numbers of the refinement.
    budget : Budget
        What taking paths in may spend.
    """

    def __init__(self, setting: KernelProblem, seed: int, budget: Budget) -> None:
        self.setting = setting
        self._budget = budget
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.rounds = 0
        self._seed = seed
        self._fresh: list[Refiner] = []
        self._kept: list[Refiner] = []

    def enter(self, motions: Segments) -> None:
        """Take in motions from the start to the goal, free of collisions."""
        entrant = Refiner(self.setting, motions, self._seed)
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, motions
        entrant.shortcut(self._budget)
        self._offer(entrant)
        self._fresh.append(entrant)

    def _offer(self, entrant: Refiner) -> None:
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, entrant.segments

    def run(self, budget: Budget, enough: float) -> None:
        """Refine every path entered a little, the better ones more, and keep the best few.

        Parameters
        ----------
        budget : Budget
            What may be spent.
        enough : float
            Cost at which to stop.
        """
        fresh, self._fresh = self._fresh, []
        for entrant in fresh:
            entrant.polish(budget, enough=enough, most=TURN)
        self._kept = sorted(self._kept + fresh, key=lambda entrant: entrant.cost)[:KEPT]
        if fresh:
            for entrant in self._kept[:LEADING]:
                entrant.polish(budget, enough=enough, most=TURN)
        for entrant in self._kept:
            self._offer(entrant)

    def finish(self, budget: Budget, enough: float) -> None:
        """Refine those kept until little is gained, the cheapest first; see `run`."""
        for entrant in sorted(self._kept, key=lambda entrant: entrant.cost):
            if entrant.cost > HOPE * self.cost:
                break
            self._finish(entrant, budget, enough)
        self._kept = []

    def again(self, budget: Budget, enough: float) -> None:
        """Refine the best motions once more, with other random numbers."""
        self.rounds += 1
        entrant = Refiner(self.setting, self.best, self._seed + self.rounds)
        entrant.shortcut(budget)
        self._finish(entrant, budget, enough)

    def _finish(self, entrant: Refiner, budget: Budget, enough: float) -> None:
        entrant.polish(budget, enough=enough)
        if not budget.over:
            entrant.again(budget)
        entrant.polish(budget, enough=enough)
        self._offer(entrant)
