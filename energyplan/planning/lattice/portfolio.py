"""A portfolio of paths, among which the budget for refinement is divided, and their lower bound.

How cheap a path becomes shows only when it is refined, and a path that starts cheaper often ends
dearer. So all of them are refined a little, the better ones more, and the best few to the end.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from energyplan.planning.bound import Bound, Spent, lower_bound
from energyplan.planning.budget import Budget, Work, do_together
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.motions import KernelProblem

BOUND_STEPS = 12_000
"""Steps of the search that count as a unit of work."""


class Bounding:
    """The best lower bound so far, less the potential, and how to raise it."""

    def __init__(self, query: CompiledProblem) -> None:
        self._query = query
        free = query.least_in_free_space - query.potential(query.problem.goal)
        self._bound = Bound(free, False)
        self._spent: Spent = {}

    @property
    def value(self) -> float:
        """What every path costs at least."""
        return self._bound.value

    def know(self, value: float) -> None:
        """Take a lower bound that somebody else found; none is sought then."""
        self._bound = Bound(value, True)

    def work(self, cost: float, units: float) -> list[Work]:
        """Return the search for a better bound, where there can be one."""

        def run(own: Budget) -> Bound:
            given = min(units, own.left)
            found = lower_bound(self._query, cost, BOUND_STEPS * given, self._spent)
            if not found.final:
                own.spend(given)
            return found

        def take(found: Bound) -> None:
            self._bound = Bound(max(found.value, self.value), found.final)

        return [] if self._bound.final else [Work(run, units, take)]


TURN = 400
"""Attempts at a path before the next one gets its turn."""

FIRST_UNITS, TURN_UNITS = 500, 200
"""Units of work of a path's first turn, with its shortcuts, and of each that follows."""

SAME = 1e-9
"""Part of the cost by which two paths that are entered differ, or are one: rounding."""

KEPT = 4
"""Paths that stay in the portfolio."""

LEADING = 2
"""How many of them get another turn."""

PATIENCE = 3
"""How often it is refined anew although that may be in vain."""

AGAIN = 2
"""How often the best path is refined anew, each time with other random numbers, at once."""

HOPE = 1.03
"""Cost after its turns, in units of the best one, above which a path is given up."""


class Portfolio:
    """The best motions known, and those that may still become better."""

    def __init__(self, setting: KernelProblem, seed: int) -> None:
        self.setting = setting
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.others: list[Segments] = []
        """What has become of those that stayed to the end."""
        self.rounds = 0
        self.seed = seed
        self._entered: list[float] = []
        self._fresh: list[Refiner] = []
        self._grown = False
        self._kept: list[Refiner] = []

    def enter(self, motions: Segments) -> None:
        """Take in motions from the start to the goal, free of collisions."""
        entrant = Refiner(self.setting, motions, self.seed)
        if any(abs(entrant.cost - cost) <= SAME * cost for cost in self._entered):
            return
        self._entered.append(entrant.cost)
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, motions
        self._fresh.append(entrant)

    def _offer(self, entrant: Refiner) -> None:
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, entrant.segments

    @property
    def waiting(self) -> bool:
        """Whether a path waits for its turn."""
        return bool(self._fresh) or self._grown

    def turns(self, enough: float) -> list[Work]:
        """Return what refines, a little, every path entered since, and the best of those kept."""

        def shorten(entrant: Refiner, own: Budget) -> None:
            entrant.shortcut(own)
            entrant.polish(own, enough=enough, most=TURN)

        def polish(entrant: Refiner, own: Budget) -> None:
            entrant.polish(own, enough=enough, most=TURN)

        fresh, self._fresh = self._fresh, []
        leading = self._kept[:LEADING] if self._grown else []
        self._grown = bool(fresh)
        self._kept = self._kept + fresh
        return [
            *(Work(partial(shorten, one), FIRST_UNITS, self._settle) for one in fresh),
            *(Work(partial(polish, one), TURN_UNITS, self._settle) for one in leading),
        ]

    def _settle(self, _: None) -> None:
        """Keep the best few."""
        self._kept = sorted(self._kept, key=lambda entrant: entrant.cost)[:KEPT]
        for entrant in self._kept:
            self._offer(entrant)

    def run(self, budget: Budget, enough: float) -> None:
        """Refine every path entered a little, the better ones more, and keep the best few."""
        while self.waiting and not budget.over:
            do_together(budget, self.turns(enough))

    def finish(self, budget: Budget, enough: float) -> None:
        """Refine those kept until little is gained, side by side; see `run`."""
        if budget.over or self.cost <= enough:
            return
        hopeful = [entrant for entrant in self._kept if entrant.cost <= HOPE * self.cost]
        self._finish(hopeful, budget, enough)
        self.others = [entrant.segments for entrant in self._kept]
        self._kept = []

    def improve(self, budget: Budget, enough: float) -> None:
        """Refine the best path until the budget is over or that gains nothing any more."""
        gains = True
        while gains and not budget.over and self.cost > enough:
            before = self.cost
            self.again(budget, enough)
            gains = self.rounds <= PATIENCE or self.cost <= before * (1 - 1e-5)

    def again(self, budget: Budget, enough: float) -> None:
        """Refine the best motions once more, with other random numbers; see `finish`."""
        entrants = []
        for _ in range(AGAIN):
            self.rounds += 1
            entrants.append(Refiner(self.setting, self.best, self.seed + self.rounds))
        self._finish(entrants, budget, enough)

    def _finish(self, entrants: list[Refiner], budget: Budget, enough: float) -> None:
        """Refine some paths until little is gained."""

        def run(entrant: Refiner, own: Budget) -> None:
            entrant.shortcut(own)
            entrant.polish(own, enough=enough)
            if not own.over:
                entrant.again(own)
            entrant.polish(own, enough=enough)

        refining = [
            Work(partial(run, entrant), budget.left, lambda _: None) for entrant in entrants
        ]
        do_together(budget, refining)
        for entrant in entrants:
            self._offer(entrant)
