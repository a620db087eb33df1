"""A portfolio of paths, among which the budget for refinement is divided.

How cheap a path becomes shows only when it is refined, and a path that starts cheaper often ends
dearer. So all of them are refined a little, the better ones more, and the best few to the end.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from energyplan.planning.budget import Budget
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.parallel import side_by_side
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.motions import KernelProblem

TURN = 400
"""Attempts at a path before the next one gets its turn."""

KEPT = 4
"""Paths that stay in the portfolio."""

LEADING = 2
"""How many of them get another turn."""

AGAIN = 2
"""How often the best path is refined anew, each time with other random numbers, at once."""

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
        self.others: list[Segments] = []
        """What has become of those that stayed to the end."""
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
        self._turn(fresh, budget, enough)
        self._kept = sorted(self._kept + fresh, key=lambda entrant: entrant.cost)[:KEPT]
        if fresh:
            self._turn(self._kept[:LEADING], budget, enough)
        for entrant in self._kept:
            self._offer(entrant)

    def _turn(self, entrants: list[Refiner], budget: Budget, enough: float) -> None:
        """Refine some paths a little, side by side."""

        def polish(entrant: Refiner, own: Budget) -> None:
            entrant.polish(own, enough=enough, most=TURN)

        side_by_side(budget, [partial(polish, entrant) for entrant in entrants], TURN)

    def finish(self, budget: Budget, enough: float) -> None:
        """Refine those kept until little is gained; see `run`."""
        hopeful = [entrant for entrant in self._kept if entrant.cost <= HOPE * self.cost]
        self._finish(hopeful, budget, enough)
        self.others = [entrant.segments for entrant in self._kept]
        self._kept = []

    def again(self, budget: Budget, enough: float) -> None:
        """Refine the best motions once more, with other random numbers."""
        entrants = []
        for _ in range(AGAIN):
            self.rounds += 1
            entrants.append(Refiner(self.setting, self.best, self._seed + self.rounds))
        self._finish(entrants, budget, enough, cut=True)

    def _finish(
        self, entrants: list[Refiner], budget: Budget, enough: float, cut: bool = False
    ) -> None:
        """Refine some paths until little is gained, side by side."""

        def run(entrant: Refiner, own: Budget) -> None:
            if cut:
                entrant.shortcut(own)
            entrant.polish(own, enough=enough)
            if not own.over:
                entrant.again(own)
            entrant.polish(own, enough=enough)

        side_by_side(budget, [partial(run, entrant) for entrant in entrants], budget.left)
        for entrant in entrants:
            self._offer(entrant)
