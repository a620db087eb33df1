"""The best motions so far, and how to better them: first path, rounds of searches, refinement."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, partial
from math import log
from typing import NamedTuple

import numpy as np

from energyplan.compilation import compile_kernels
from energyplan.path import Path
from energyplan.planning.budget import PACE, Budget, Work, do_together, side_by_side
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.bounding import Bounding
from energyplan.planning.lattice.portfolio import Portfolio
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.rounds import ROUNDS, Sought
from energyplan.planning.lattice.search import EXPANSION, Search, lattice_for
from energyplan.planning.lattice.shortest import shortest_way
from energyplan.planning.lattice.slots import slot_work, way_through_slots
from energyplan.planning.lattice.tight_ends import Ends, ways_out
from energyplan.planning.lattice.turning import Turned, ways_with_turns
from energyplan.planning.lattice.way_along import led_along, way_along
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene import closure_kernels
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

PENALTY = 8.0
"""How much longer a tight place counts for that search."""


class Guide(NamedTuple):
    """A distance to go with tight places counted longer, and the way along it, if it is one."""

    penalty: float
    to_go: DistanceToGo
    way: Segments | None


class Attempt(NamedTuple):
    """A search for a first path: between which ends, and on how fine a lattice."""

    ends: Ends
    scale: float
    search: Search


WAYS = (PENALTY, 2.0, 1.0)
"""And for the ways along guides."""

HOPE = 1.08
"""Estimate, in units of the best cost, at which searches turn away: refinement gains less."""

WAY_UNITS = 1000
"""Units of work that the way along a guide may take."""

MOST = 2000
"""Expansions of each search in the first round; twice as many in each round that follows."""

SEARCH_SHARE = 0.6
"""Part of the time left after the first plan that the searches may take."""

TURNING_SHARE = 0.75
"""Part of what the searches may take that seeking ways by their turns may."""

BOUND_SHARE = 0.15
"""Part of that time that the bound may take at most at a time."""

MOST_LEFT = 60.0
"""Time of which that part is taken at most [s]."""

FIELD_SHARE = 0.4
"""Part of what is left that a distance to go may take before a first path is known, about."""

GUIDE_SHARE = 0.3
"""Part of what the searches may take up to which new distances to go are worth their work."""

MOST_LATTICES = 16
"""Lattices on which a first path is sought, each half as coarse as the one before."""

ESCAPE_SHARE = 0.25
"""Part of the budget that ways out of tight ends may take."""

CLOSURE_SHARE = 0.5
"""Part of the budget that may be taken to find out that there is no way."""

SHORTEST_SHARE = 0.25
"""Part of what is left after the first plan that finding a shortest way may take."""

SHORT_SHARE = 0.33
"""Part of what is left after the searches that making the shortest plan may take; and no more than
was spent before."""

SHORT_ONES = 4
"""Of the paths found as many of the shortest are made shorter."""

FIRST_TURN = 4000
"""Expansions of the search for a first path before a finer one joins it; then twice as many."""


def is_length(problem: PlanningProblem) -> bool:
    """Tell whether length is all that counts."""
    return {name for name, weight in problem.weights.items() if weight > 0} == {"length"}


def _bound_part(budget: Budget) -> float:
    """Return what the bound may take of a budget at a time."""
    return BOUND_SHARE * min(budget.left, MOST_LEFT * PACE)


class Improvement:
    """The best motions so far, and how to better them; by their turns where `turning` says so."""

    def __init__(
        self, query: CompiledProblem, budget: Budget, gap: float, seed: int, turning: bool = True
    ) -> None:
        self.query = query
        self.turning = turning
        self.setting = query.setting
        self.budget = budget
        self.gap = gap
        self.portfolio = Portfolio(self.setting, seed)
        self.found: list[Segments] = []
        self.ends = Ends(query)
        self.fields: dict[float, DistanceToGo] = {}
        self.searches: list[Search] = []
        self.begun: set[Sought] = set()
        self.bounding = Bounding(query)
        self._through_slots = False
        self._led: list[tuple[float, float]] = []
        self.kept = 0.0

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
        self.enter(self.query.of_centre(path))

    def first_plan(self, finest: float = 1.0) -> None:
        """Find a first path; lattices twice as fine join one by one while none is found."""
        plain = Ends(self.query)
        for ends in ways_out(self.query, self.budget.part(ESCAPE_SHARE)):
            self._move_ends(ends)
            if not ends.eased or reached(self.field(PENALTY), ends.between(self.setting)):
                break
        else:
            self._move_ends(plain)
        if np.isfinite(self.cost):
            return
        if not self.ends.eased:
            check_configurations(self.query, self.field(PENALTY))
        # where the poses tested do not join start and goal, a search among them is in vain
        setting = self.ends.between(self.setting)
        tested = self.field(PENALTY).places is places_for(setting)
        closed = None if tested else self._closed(setting)
        for penalty in WAYS:
            if self._enter_way(penalty):
                return
        if not tested and self._enter_slots():
            return
        # between ends without room there may be a way where no pose beside them is free
        if closed is not None and (self.ends.eased or self.query.ends_roomy):
            check_closer(self.query, setting, closed)
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
                to_go = self.field(PENALTY) if own else distance_to_go(setting, PENALTY)
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

    def _closed(self, setting: KernelProblem) -> Closure:
        """Look closer at what the poses tested leave open.

        Raises
        ------
        NoPathError
            If it is proven that there is no way.
        """
        self.budget.beside(lambda: compile_kernels(closure_kernels.__name__))
        found = closure(setting, self.budget.part(CLOSURE_SHARE))
        if found.proven:
            check_closer(self.query, setting, found)
        return found

    def _move_ends(self, ends: Ends) -> None:
        """Have searches begin and end elsewhere."""
        self.ends = ends
        self.fields.clear()

    def shortest(self, query: CompiledProblem, *beside: Work) -> Segments:
        """Return the shortest of the paths found, made shorter in a part of what is left.

        Parameters
        ----------
        query : CompiledProblem
            The problem with the length as its objective.
        *beside : Work
            What else to do at once.
        """
        setting, enough = query.setting, Bounding(query).value * (1.0 + self.gap)
        short = Portfolio(setting, self.portfolio.seed)
        every = [Refiner(setting, motions) for motions in [*self.found, self.portfolio.best]]
        for one in sorted(every, key=lambda one: one.cost)[:SHORT_ONES]:
            short.enter(one.segments)

        def run(own: Budget) -> None:
            short.run(own.part(SEARCH_SHARE), enough)
            short.finish(own, enough)
            short.improve(own, enough)

        units = min(SHORT_SHARE * self.budget.left, self.budget.spent)
        do_together(self.budget, [Work(run, units, lambda _: None), *beside])
        return short.best

    @cached_property
    def _shortest(self) -> KernelProblem:
        """The problem with the shortest way as the objective, for the same body."""
        return CompiledProblem(self.query.problem.shortest).setting

    def search(self) -> None:
        """Find further paths until the searches' part of the budget is over, or the gap closed."""
        left = self.budget.left
        first = self.budget.part(SEARCH_SHARE)
        if self.turning:
            do_together(first, [*self.portfolio.turns(self.enough), *self._turning(first)])
        # what is found must be refined before the end
        searching = self.budget.part(SEARCH_SHARE)
        kept = self.kept = _bound_part(self.budget)
        works = self._shortest_way(SHORTEST_SHARE * left)
        self._together(searching, works + self._guiding(ROUNDS[0], searching))
        for number, begun in enumerate(ROUNDS):
            if searching.over or self.done:
                break
            works = self.bounding.in_round(number, self.cost, kept)
            if number == 1 and not self._through_slots:
                setting = self.ends.between(self.setting)
                works += slot_work(setting, self.fields, self.cost, searching, self._enter)
            for following in ROUNDS[number + 1 : number + 2]:
                works += self._guiding(following, searching)
            works += self._searching(begun, MOST << number)
            self._together(searching, works)
        self.portfolio.run(searching, self.enough)

    def finish(self) -> None:
        """Refine the paths until the budget is over, the gap closed, or nothing is gained."""
        self.portfolio.finish(self.budget, self.enough)
        self.portfolio.improve(self.budget, self.enough)

    def go_on(self, budget: Budget) -> bool:
        """Refine the best path with what another budget gives; tell whether that gained."""
        before, self.budget = self.cost, budget
        self.portfolio.improve(self.budget, self.enough)
        return self.cost < before

    def _enter_slots(self) -> bool:
        """Enter a way through slots that no pose tested shows; tell whether one is found."""
        setting = self.ends.between(self.setting)
        self.budget.beside(lambda: regions_for(setting, enlarged=True))
        way = way_through_slots(setting, None, np.inf, self.budget.part(ESCAPE_SHARE))
        self._through_slots = way is not None
        self._enter(way)
        return self._through_slots

    def _enter(self, way: Segments | None) -> None:
        """Enter a way between the ends, if there is one."""
        if way is not None:
            self.enter(self.ends.whole(way))

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

    def _shortest_way(self, units: float) -> list[Work]:
        """Return the search for the shortest way, where that is not what is sought."""
        if is_length(self.query.problem):
            return []
        run = partial(shortest_way, self._shortest, self.ends, self.field(PENALTY))

        def take(found: Segments | None) -> None:
            if found is not None:
                self.enter(found)

        return [Work(run, units, take)]

    def _turning(self, budget: Budget) -> list[Work]:
        """Return the search for the ways that are cheapest by their length and turns."""
        setting, known = self.ends.between(self.setting), self.fields.get(1.0)

        def run(own: Budget) -> Turned:
            return ways_with_turns(setting, known, own)

        def take(found: Turned) -> None:
            self.fields.setdefault(1.0, found.to_go)
            for way in found.ways:
                self._enter(way)

        return [Work(run, TURNING_SHARE * budget.left, take)]

    def _guiding(self, begun: Iterable[Sought], budget: Budget) -> list[Work]:
        """Return the search for guides of a round that are not known, and for ways along them."""
        missing = sorted({sought.penalty for sought in begun} - set(self.fields))
        most = max((found.work for found in self.fields.values()), default=0) / TURNS
        if len(missing) * most > GUIDE_SHARE * budget.left:
            return []  # refining what is known gains more
        setting = self.ends.between(self.setting)

        def run(penalty: float, own: Budget) -> Guide:
            found = distance_to_go(setting, penalty)
            own.spend(found.work / TURNS)
            return Guide(penalty, found, way_along(setting, found, own))

        def take(guide: Guide) -> None:
            self.fields[guide.penalty] = guide.to_go
            self._enter(guide.way)

        return [Work(partial(run, penalty), most + WAY_UNITS, take) for penalty in missing]

    def _searching(self, begun: Iterable[Sought], most: int) -> list[Work]:
        """Return what goes on with all searches, and begins some."""
        searches = [*self.searches, *self._new_searches(begun)]
        self.searches = []

        def take(search: Search, before: float, state: int) -> None:
            if search.best < before:
                self.enter(self.ends.whole(search.segments()))
            if state == kernels.RUNNING:
                self.searches.append(search)

        works = []
        for search in searches:
            # a guide that counts tight places longer says nothing about what motions cost
            plain = search.to_go is self.fields.get(1.0)
            of_energy = search.setting.prices is self.setting.prices
            run = partial(
                search.run, stop_at_first=search.weight >= FIRST_WEIGHT, expansions=most,
                limit=HOPE * self.cost if plain and of_energy else np.inf,
            )  # fmt: skip
            works.append(Work(run, EXPANSION * most, partial(take, search, search.best)))
        return works

    def _enter_way(self, penalty: float) -> bool:
        """Enter the way that a guide knows, if it is one; tell whether it is."""
        led = led_along(self.ends.between(self.setting), self.field(penalty), self.budget)
        self._led.append((led.x, led.y))
        self._enter(led.motions)
        return led.motions is not None

    def field(self, penalty: float) -> DistanceToGo:
        """Return the distance to go, with tight places counted longer."""
        if penalty not in self.fields:
            most = FIELD_SHARE * self.budget.left
            found = distance_to_go(self.ends.between(self.setting), penalty, most)
            self.budget.spend(found.work / TURNS)
            self.fields[penalty] = found
        return self.fields[penalty]

    def _new_searches(self, begun: Iterable[Sought]) -> list[Search]:
        """Return searches that have yet to begin, led by the guides known that are most like."""
        searches = []
        for sought in begun:
            if sought.shortest and is_length(self.query.problem):
                continue
            setting = self._shortest if sought.shortest else self.setting
            penalty = min(self.fields, key=lambda known: abs(log(known / sought.penalty)))
            search = Search(
                self.ends.between(setting),
                self.fields[penalty],
                lattice_for(setting, sought.scale),
                sought.weight,
                aligned=sought.aligned,
            )
            # headings along the axes are those counted from the start's where it lies along them
            alike = sought._replace(penalty=penalty, aligned=search.spin != 0.0)
            if alike not in self.begun:
                self.begun.add(alike)
                searches.append(search)
        return searches
