"""Paths that race for the time to be refined.

How cheap a path becomes shows only when it is refined, and a path that starts cheaper often ends
dearer. So all of them are refined a little, the better half twice as long, and so on.
"""

from __future__ import annotations

import numpy as np

from energyplan.planners._motion_kernels import Setting
from energyplan.planners._query import Segments
from energyplan.planners.refine import Refiner

HEAT = 400
"""Attempts at each path in the first heat."""


class Race:
    """The best motions known, and those that may still become better.

    Parameters
    ----------
    setting : Setting
        The problem.
    seed : int
        Seed of the random numbers of the refinement.
    """

    def __init__(self, setting: Setting, seed: int) -> None:
        self.setting = setting
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.rounds = 0
        self._seed = seed
        self._entrants: list[Refiner] = []

    def enter(self, motions: Segments) -> None:
        """Enter motions from the start to the goal, free of collisions."""
        entrant = Refiner(self.setting, motions, self._seed)
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, motions
        entrant.shortcut()
        self._offer(entrant)
        self._entrants.append(entrant)

    def _offer(self, entrant: Refiner) -> None:
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, entrant.segments

    def run(self, deadline: float, enough: float) -> None:
        """Refine what was entered since the last race, the best of it to the end.

        Parameters
        ----------
        deadline : float
            Reading of `time.perf_counter` at which to stop.
        enough : float
            Cost at which to stop.
        """
        heat = HEAT
        entrants, self._entrants = self._entrants, []
        while len(entrants) > 1:
            for entrant in entrants:
                entrant.polish(deadline, enough=enough, most=heat)
                self._offer(entrant)
            entrants = sorted(entrants, key=lambda entrant: entrant.cost)
            entrants = entrants[: (len(entrants) + 1) // 2]
            heat *= 2
        for entrant in entrants:
            self._finish(entrant, deadline, enough)

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
