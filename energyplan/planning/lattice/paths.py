"""The paths from start to goal: how the first is found, further ones, and how all get better.

1. The shortest route through the free configurations is followed by exact motions. Where that fails
   other routes are, then ways through slots, and last of all lattices are searched, ever finer.
2. Routes that are cheapest by their length and turns follow, up to four, and the bound beside them.
3. All paths compete for the budget to be refined.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from energyplan.compilation import compile_kernels
from energyplan.path import Path
from energyplan.planning.bound import Bounding
from energyplan.planning.budget import PACE, Budget, Work, do_together, side_by_side
from energyplan.planning.lattice import search as kernels
from energyplan.planning.lattice.refine import Portfolio, Refiner
from energyplan.planning.lattice.search import Search, lattice_for
from energyplan.planning.lattice.slots import slot_work, way_through_slots
from energyplan.planning.lattice.tight_ends import Ends, ways_out
from energyplan.planning.lattice.turning import ways_with_turns
from energyplan.planning.lattice.way_along import led_along
from energyplan.planning.scene.closure import (
    Closure,
    check_closer,
    check_configurations,
    closure,
    none_found,
    none_in_time,
)
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import TURNS, distance_to_go, places_for, reached, regions_for
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem

FIRST_WEIGHT = 2.0
"""Weight of the search for the first path."""

FIELD_SHARE = 0.4
"""Part of what is left that a distance to go may take before a first path is known, about."""

MOST_LATTICES = 16
"""Lattices on which a first path is sought, each half as coarse as the one before."""

ESCAPE_SHARE = 0.25
"""Part of the budget that ways out of tight ends may take."""

CLOSURE_SHARE = 0.5
"""Part of the budget that may be taken to find out that there is no way."""

SEARCH_SHARE = 0.6
"""Part of what is left after the first path that finding others may take."""

ROUTES_SHARE = 0.5
"""Part of that for routes."""

COARSE = 2.0
"""Scale of the lattice on which all ways that are not tight are compared."""

COARSE_SHARE = 0.3
"""Part of what searches have left that this may take."""

HOPE = 1.08
"""Estimate, in units of the best cost, at which that search turns away: refinement gains less."""

BOUND_SHARE = 0.15
"""Part of what is left that the bound may take at a time: twice."""

MOST_LEFT = 60.0
"""Time of which that part is taken at most [s]."""

SHORT_SHARE = 0.33
"""Part of what is left after the searches that making the shortest plan may take; and no more than
was spent before."""

SHORT_ONES = 4
"""Of the paths found as many of the shortest are made shorter."""

FIRST_TURN = 4000
"""Expansions of the search for a first path before a finer one joins it; then twice as many."""


class Attempt(NamedTuple):
    """A search for a first path: between which ends, and on how fine a lattice."""

    ends: Ends
    scale: float
    search: Search


class Paths:
    """The best motions so far, and how they are found and get better."""

    def __init__(self, query: CompiledProblem, budget: Budget, gap: float, seed: int) -> None:
        self.query = query
        self.setting = query.setting
        self.budget = budget
        self.gap = gap
        self.portfolio = Portfolio(self.setting, seed)
        self.found: list[Segments] = []
        self.ends = Ends(query)
        self._to_go: DistanceToGo | None = None
        self.bounding = Bounding(query)
        self._through_slots = False
        self.kept = 0.0
        self._led: list[tuple[float, float]] = []

    @property
    def bound(self) -> float:
        """Lower bound on the cost of every path."""
        return self.bounding.value

    @property
    def cost(self) -> float:
        """Cost of the best path so far."""
        return self.portfolio.cost

    @property
    def done(self) -> bool:
        """Whether to stop."""
        return self.cost <= self.enough or self.budget.over

    @property
    def enough(self) -> float:
        """Cost at which the gap is closed."""
        return self.bound * (1.0 + self.gap)

    def enter(self, motions: Segments) -> None:
        """Take in motions from the start to the goal, free of collisions."""
        self.found.append(motions)
        self.portfolio.enter(motions)

    def offer_path(self, path: Path) -> None:
        """Take a path that somebody else made, and that can be driven from start to goal."""
        self.enter(self.query.of_centre(path.ds, path.dtheta))

    def first_plan(self, finest: float = 1.0) -> None:
        """Find a first path; lattices twice as fine join one by one while none is found."""
        plain = Ends(self.query)
        for ends in ways_out(self.query, self.budget.part(ESCAPE_SHARE)):
            self._move_ends(ends)
            if not ends.eased or reached(self.to_go, ends.between(self.setting)):
                break
        else:
            self._move_ends(plain)
        if np.isfinite(self.cost):
            return
        if not self.ends.eased:
            check_configurations(self.query, self.to_go)
        # where the poses tested do not join start and goal, a search among them is in vain
        setting = self.ends.between(self.setting)
        tested = self.to_go.places is places_for(setting)
        closed = None if tested else self._closed(setting)
        if self._enter_way() or self._enter_routes():
            return
        if not tested and self._enter_slots():
            return
        # between ends without room there may be a way where no pose beside them is free
        if closed is not None and (self.ends.eased or self.query.ends_roomy):
            check_closer(self.query, setting, closed)
        self._search_first(plain, finest, tested)

    def _search_first(self, plain: Ends, finest: float, tested: bool) -> None:
        """Search lattices for a first path, the coarsest first; finer ones join one by one."""
        turn = FIRST_TURN
        waiting = [(self.ends, 2.0**-k) for k in range(MOST_LATTICES) if 2.0**-k >= finest]
        if self.ends.eased:
            # where no way between the poses with room is found soon, one to the ends may be
            waiting = [(ends, scale) for _, scale in waiting for ends in (self.ends, plain)]
        every: list[Attempt] = []
        open_ones: list[Attempt] = []
        while True:
            if waiting:
                ends, scale = waiting.pop(0)
                setting = ends.between(self.setting)
                own = ends is self.ends
                to_go = self.to_go if own else distance_to_go(setting)
                lattice = lattice_for(self.setting, scale)
                every.append(Attempt(ends, scale, Search(setting, to_go, lattice, FIRST_WEIGHT)))
                open_ones.append(every[-1])
            elif not open_ones:
                last = every[-1].search
                raise none_found(self.query, last.lattice.cell, last.nearest)
            if self.budget.over:
                break
            # a finer lattice has shorter turns, since most paths are found on the first
            tasks = [
                partial(
                    Search.run, one.search, stop_at_first=True, expansions=int(turn * one.scale)
                )
                for one in open_ones
            ]
            states = side_by_side(self.budget, tasks, turn)
            found = [one for one in open_ones if one.search.found]
            for one in found:
                self.enter(one.ends.whole(one.search.segments()))
            if found:
                if not any(one.ends is self.ends for one in found):
                    self._move_ends(plain)
                return
            if tested and turn == FIRST_TURN and self._enter_slots():
                return
            pairs = zip(open_ones, states, strict=True)
            open_ones = [one for one, state in pairs if state != kernels.EXHAUSTED]
            turn *= 2
        if places := sum(int(one.search.tree.counts[2]) for one in every):
            cell = every[-1].search.lattice.cell
            done = f"{places} places were searched in cells down to {cell:.3g} m"
        elif tested:
            done = "free poses join start and goal, but motions along them do not yet"
        else:
            done = "the free poses that were tested do not join start and goal"
        near = [*self._led, *(one.search.nearest for one in every)]
        raise none_in_time(self.query, self.budget, done, near)

    def _enter(self, way: Segments | None) -> None:
        """Enter a way between the ends, if there is one."""
        if way is not None:
            self.enter(self.ends.whole(way))

    def _enter_way(self) -> bool:
        """Enter the path along the shortest route, if it can be followed; tell whether it can."""
        led = led_along(self.ends.between(self.setting), self.to_go, self.budget)
        self._led.append((led.x, led.y))
        self._enter(led.motions)
        return led.motions is not None

    def _enter_routes(self) -> bool:
        """Enter the paths along other routes; tell whether one can be followed."""
        setting = self.ends.between(self.setting)
        ways = ways_with_turns(setting, self.to_go, self.budget.part(FIELD_SHARE))
        for way in ways:
            self._enter(way)
        return bool(ways)

    def _enter_slots(self) -> bool:
        """Enter a way through slots that no pose tested shows; tell whether one is found."""
        setting = self.ends.between(self.setting)
        self.budget.beside(lambda: regions_for(setting, enlarged=True))
        way = way_through_slots(setting, None, np.inf, self.budget.part(ESCAPE_SHARE))
        self._through_slots = way is not None
        self._enter(way)
        return self._through_slots

    def _closed(self, setting: KernelProblem) -> Closure:
        """Look closer at what the poses tested leave open."""
        self.budget.beside(lambda: compile_kernels(Closure.__module__))
        found = closure(setting, self.budget.part(CLOSURE_SHARE))
        if found.proven:
            check_closer(self.query, setting, found)
        return found

    def _move_ends(self, ends: Ends) -> None:
        """Have searches begin and end elsewhere."""
        self.ends = ends
        self._to_go = None

    @property
    def to_go(self) -> DistanceToGo:
        """The distance to go."""
        if self._to_go is None:
            most = FIELD_SHARE * self.budget.left
            self._to_go = distance_to_go(self.ends.between(self.setting), most)
            self.budget.spend(self._to_go.work / TURNS)
        return self._to_go

    # -- further paths --------------------------------------------------------------------------

    def search(self) -> None:
        """Find further paths until the searches' part of the budget is over, or the gap closed."""
        searching = self.budget.part(SEARCH_SHARE)
        self.kept = BOUND_SHARE * min(self.budget.left, MOST_LEFT * PACE)
        setting, to_go = self.ends.between(self.setting), self.to_go

        def routes(own: Budget) -> list[Segments]:
            return ways_with_turns(setting, to_go, own)

        def take(found: list[Segments]) -> None:
            for way in found:
                self._enter(way)

        routing = Work(routes, ROUTES_SHARE * searching.left, take)
        works = [routing, self._compared(searching)]
        do_together(searching, [*self.portfolio.turns(self.enough), *works])
        if searching.over or self.done:
            return
        works = self.bounding.work(self.cost, self.kept)
        if not self._through_slots:
            works += slot_work(setting, self.to_go, self.cost, searching, self._enter)
        self._together(searching, works)
        self.portfolio.run(searching, self.enough)

    def _compared(self, budget: Budget) -> Work:
        """Return a search of a coarse lattice: it compares all ways that are not tight."""
        setting = self.ends.between(self.setting)
        lattice = lattice_for(setting, COARSE)
        search = Search(setting, self.to_go, lattice, 1.0, aligned=True)
        limit = HOPE * self.cost

        def run(own: Budget) -> None:
            search.run(own, stop_at_first=False, limit=limit)

        def take(_: None) -> None:
            self._enter(search.segments() if search.found else None)

        return Work(run, COARSE_SHARE * budget.left, take)

    def finish(self) -> None:
        """Refine the paths until the budget is over, the gap closed, or nothing is gained."""
        self.portfolio.finish(self.budget, self.enough)
        self.portfolio.improve(self.budget, self.enough)

    def go_on(self, budget: Budget) -> bool:
        """Refine the best path with what another budget gives; tell whether that gained."""
        before, self.budget = self.cost, budget
        self.portfolio.improve(self.budget, self.enough)
        return self.cost < before

    def _together(self, budget: Budget, works: list[Work]) -> None:
        """Do some work beside the next turns of the paths known.

        None may spend more than half of what those before it leave: where little is left the first
        ones get it, and where one is hopeless the others still have their part.
        """
        every = [*self.portfolio.turns(self.enough), *works]
        left = budget.left
        for k, work in enumerate(every):
            every[k] = work._replace(units=min(work.units, 0.5 * left))
            left -= every[k].units
        do_together(budget, every)

    def shortest(self, query: CompiledProblem, *beside: Work) -> Segments:
        """Return the shortest of the paths found, made shorter in a part of what is left."""
        setting, enough = query.setting, Bounding(query).value * (1.0 + self.gap)
        short = Portfolio(setting, self.portfolio.seed)
        known = (query.motions_of(self.query, one) for one in [*self.found, self.portfolio.best])
        every = [Refiner(setting, motions) for motions in known]
        for one in sorted(every, key=lambda one: one.cost)[:SHORT_ONES]:
            short.enter(one.segments)

        def run(own: Budget) -> None:
            short.run(own.part(SEARCH_SHARE), enough)
            short.finish(own, enough)
            short.improve(own, enough)

        units = min(SHORT_SHARE * self.budget.left, self.budget.spent)
        do_together(self.budget, [Work(run, units, lambda _: None), *beside])
        return short.best
