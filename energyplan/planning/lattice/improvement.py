"""How the best motions so far are bettered: rounds of searches, and refinement."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, partial
from math import log
from typing import NamedTuple

import numpy as np

from energyplan.planning.budget import PACE, Budget, Work, do_together
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.first_path import FIRST_WEIGHT, PENALTY, FirstPath
from energyplan.planning.lattice.portfolio import Bounding, Portfolio
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.search import EXPANSION, Search, lattice_for
from energyplan.planning.lattice.slots import slot_work
from energyplan.planning.lattice.tight_ends import Ends
from energyplan.planning.lattice.turning import Turned, ways_with_turns
from energyplan.planning.lattice.way_along import way_along
from energyplan.planning.problem import is_length
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import TURNS, distance_to_go
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem


class Sought(NamedTuple):
    """A search: its lattice, its weight, and what leads it."""

    scale: float  # scale of the lattice
    weight: float  # factor on the estimated cost to go
    penalty: float  # how much longer tight places count for the guide
    aligned: bool = False  # whether headings are counted from the map's axes
    shortest: bool = False  # whether the shortest way is sought instead


ROUNDS = (
    (Sought(2.0, 1.2, 8.0, True), Sought(1.0, 2.0, 2.0, True)),
    (Sought(2.0, 1.0, 8.0, True), Sought(1.0, 2.0, 8.0, True), Sought(2.0, 1.0, 8.0, False, True)),
    (Sought(1.0, 1.2, 2.0), Sought(2.0, 1.0, 2.0), Sought(1.0, 1.2, 2.0, False, True)),
    (Sought(1.0, 2.0, 1.0, True), Sought(1.0, 2.0, 4.0), Sought(1.0, 1.5, 1.0)),
    (Sought(1.0, 1.5, 2.0, True), Sought(2.0, 1.0, 1.0, True), Sought(1.0, 1.2, 8.0)),
    (Sought(1.0, 1.2, 2.0, True), Sought(1.0, 1.2, 1.0, True), Sought(1.0, 1.0, 1.0)),
    (Sought(1.0, 1.0, 1.0, True), Sought(0.5, 1.0, 1.0), Sought(0.5, 1.0, 1.0, True)),
)
"""Searches that begin, round by round, while those of the rounds before go on.

On a coarse lattice all ways that are not tight are soon compared, down to the weight 1: so that
comes first, by the guide that is known already. Fine lattices find the gaps that it misses. No one
guidance is best: a penalty that spares one problem its blind alleys hides from another the gap it
should have taken.
"""


class Guide(NamedTuple):
    """A distance to go with tight places counted longer, and the way along it, if it is one."""

    penalty: float
    to_go: DistanceToGo
    way: Segments | None


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

GUIDE_SHARE = 0.3
"""Part of what the searches may take up to which new distances to go are worth their work."""

SHORTEST_SHARE = 0.25
"""Part of what is left after the first plan that finding a shortest way may take."""

SHORT_SHARE = 0.33
"""Part of what is left after the searches that making the shortest plan may take; and no more than
was spent before."""

SHORT_ONES = 4
"""Of the paths found as many of the shortest are made shorter."""

SHORTEST_TRIES = ((2.0, 400), (1.0, 4000))
"""Scales of the lattices on which a shortest way is sought; expansions of each search at most."""

SHORTEST_WEIGHT = 2.0
"""Weight of the searches on them."""

SHORTEST_SEARCHING = 0.5
"""Part of the budget that they may take; the way along the guide may have the rest."""

SHORTEST_POLISH = 800
"""Attempts to make the way shorter."""


def _bound_part(budget: Budget) -> float:
    """Return what the bound may take of a budget at a time."""
    return BOUND_SHARE * min(budget.left, MOST_LEFT * PACE)


class Improvement(FirstPath):
    """The best motions so far, and how to better them."""

    def __init__(self, query: CompiledProblem, budget: Budget, gap: float, seed: int) -> None:
        super().__init__(query, budget, gap, seed)
        self.searches: list[Search] = []
        self.begun: set[Sought] = set()
        self.kept = 0.0

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

    @cached_property
    def _shortest(self) -> KernelProblem:
        """The problem with the shortest way as the objective, for the same body."""
        return CompiledProblem(self.query.problem.shortest, self.query.lateral).setting

    def search(self) -> None:
        """Find further paths until the searches' part of the budget is over, or the gap closed."""
        left = self.budget.left
        first = self.budget.part(SEARCH_SHARE)
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


def shortest_way(
    setting: KernelProblem, ends: Ends, to_go: DistanceToGo, budget: Budget
) -> Segments | None:
    """Return motions of little length: a way as a search finds it at first, made shorter a little.

    Of two ways that are refined for their energy the shorter one may stay the dearer, though it is
    cheaper once it is short: so it is made short before it competes.
    """
    way = _shortly_found(ends.between(setting), to_go, budget.part(SHORTEST_SEARCHING))
    if way is None:
        way = way_along(ends.between(setting), to_go, budget)
    if way is None:
        return None
    refiner = Refiner(setting, ends.whole(way))
    refiner.shortcut(budget)
    refiner.polish(budget, most=SHORTEST_POLISH)
    return refiner.segments


def _shortly_found(setting: KernelProblem, to_go: DistanceToGo, budget: Budget) -> Segments | None:
    """Return the first way that a search finds."""
    for scale, most in SHORTEST_TRIES:
        search = Search(setting, to_go, lattice_for(setting, scale), SHORTEST_WEIGHT)
        search.run(budget, stop_at_first=True, expansions=most)
        if search.found:
            return search.segments()
    return None
