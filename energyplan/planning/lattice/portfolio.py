"""Paths that race for the time to be refined.

How cheap a path becomes shows only when it is refined, and a path that starts cheaper often ends
dearer. So all of them are refined a little, the better ones more, and the best few to the end.
"""

from __future__ import annotations

import numpy as np

from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.motions import KernelProblem

HEAT = 400
"""Attempts at a path in one heat."""

KEPT = 4
"""Paths that stay in the race."""

FAVOURITES = 2
"""How many of them run another heat."""

HOPE = 1.03
"""Cost after the heats, in units of the best one, above which a path is given up."""


class Race:
    """The best motions known, and those that may still become better.

    Parameters
    ----------
    setting : KernelProblem
        The problem.
    seed : int
        Seed of the random numbers of the refinement.
    """

    def __init__(self, setting: KernelProblem, seed: int) -> None:
        self.setting = setting
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.rounds = 0
        self._seed = seed
        self._fresh: list[Refiner] = []
        self._kept: list[Refiner] = []

    def enter(self, motions: Segments) -> None:
        """Enter motions from the start to the goal, free of collisions."""
        entrant = Refiner(self.setting, motions, self._seed)
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, motions
        entrant.shortcut()
        self._offer(entrant)
        self._fresh.append(entrant)

    def _offer(self, entrant: Refiner) -> None:
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, entrant.segments

    def run(self, deadline: float, enough: float) -> None:
        """Refine every path entered a little, the better ones more, and keep the best few.

        Parameters
        ----------
        deadline : float
            Reading of `time.perf_counter` at which to stop.
        enough : float
            Cost at which to stop.
        """
        fresh, self._fresh = self._fresh, []
        for entrant in fresh:
            entrant.polish(deadline, enough=enough, most=HEAT)
        self._kept = sorted(self._kept + fresh, key=lambda entrant: entrant.cost)[:KEPT]
        if fresh:
            for entrant in self._kept[:FAVOURITES]:
                entrant.polish(deadline, enough=enough, most=HEAT)
        for entrant in self._kept:
            self._offer(entrant)

    def finish(self, deadline: float, enough: float) -> None:
        """Refine those kept until little is gained, the cheapest first; see `run`."""
        for entrant in sorted(self._kept, key=lambda entrant: entrant.cost):
            if entrant.cost > HOPE * self.cost:
                break
            self._finish(entrant, deadline, enough)
        self._kept = []

    def again(self, deadline: float, enough: float) -> None:
        """Refine the best motions once more, with other random numbers."""
        self.rounds += 1
        entrant = Refiner(self.setting, self.best, self._seed + self.rounds)
        entrant.shortcut()
        self._finish(entrant, deadline, enough)

    def _finish(self, entrant: Refiner, deadline: float, enough: float) -> None:
        entrant.polish(deadline, enough=enough)
        entrant.again()
        entrant.polish(deadline, enough=enough)
        self._offer(entrant)
