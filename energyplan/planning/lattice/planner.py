"""The lattice planner: a first plan at once, better ones until the budget is over.

1. A weighted search over position and heading, whose motions and whose last leg to the goal are
   exact minimum-energy motions, finds a first path; shortcuts make it a first plan.
2. A lower bound on every path's cost is computed.
3. Rounds of searches, each with a guidance of its own, find further paths, and the paths compete
   for the budget to be refined. Planning ends when the budget is over, the gap to the bound is
   closed, or nothing is gained any more.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from functools import cached_property, partial
from math import log
from typing import NamedTuple

import numpy as np

from energyplan.errors import PlanningError, TimeLimitError
from energyplan.path import Path
from energyplan.planning.budget import PACE, Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.bounding import Bounding
from energyplan.planning.lattice.fewer_motions import with_fewer_motions
from energyplan.planning.lattice.portfolio import Portfolio
from energyplan.planning.lattice.rounds import ROUNDS, Sought
from energyplan.planning.lattice.search import EXPANSION, Search, lattice_for
from energyplan.planning.lattice.shortest import shortest_way
from energyplan.planning.lattice.slots import slot_work, way_through_slots
from energyplan.planning.lattice.stops import SHARE, least_driven, stops_count, stops_of
from energyplan.planning.lattice.tight_ends import Ends, ways_out
from energyplan.planning.lattice.way_along import way_along
from energyplan.planning.lattice.wide_arcs import with_wide_arcs
from energyplan.planning.parallel import Work, do_together, side_by_side
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import TURNS, distance_to_go, places_for, reached, regions_for
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem
from energyplan.planning.scene.reachability import check_configurations, none_found

logger = logging.getLogger(__name__)

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

PATIENCE = 3
"""Refinements of the best path, after the last round, that may be in vain."""

SEARCH_SHARE = 0.6
"""Part of the time left after the first plan that the searches may take."""

BOUND_SHARE = 0.15
"""Part of that time that the bound may take at most at a time."""

MOST_LEFT = 60.0
"""Time of which that part is taken at most [s]."""

GUIDE_SHARE = 0.3
"""Part of what the searches may take up to which new distances to go are worth their work."""

MOST_LATTICES = 16
"""Lattices on which a first path is sought, each half as coarse as the one before."""

ESCAPE_SHARE = 0.25
"""Part of the budget that ways out of tight ends may take."""

SHORTEST_SHARE = 0.25
"""Part of what is left after the first plan that finding a shortest way may take."""

FIRST_TURN = 4000
"""Expansions of the search for a first path before a finer one joins it; then twice as many."""


def plan(
    problem: PlanningProblem,
    budget: Budget,
    *,
    gap: float = 1e-3,
    seed: int = 1,
    initial: Iterable[Path] = (),
    finest: float = 0.0625,
    bound: float | None = None,
) -> Candidate:
    """Plan on a lattice, and refine with exact steering.

    Parameters
    ----------
    problem : PlanningProblem
        The problem.
    budget : Budget
        What planning may spend. What is done once comes on top of a time limit: the map's free
        configurations, and up to half a second for the prices of a cost that depends on speed.
    gap : float
        Planning ends early when the plan costs at most this fraction more than the lower bound.
    seed : int
        Seed of the random numbers of the refinement.
    initial : iterable of Path
        Paths from start to goal, already known; the plan costs no more than any of them that is
        free of collisions.
    finest : float
        Size of the cells of the finest lattice that is searched for a first path, in units of the
        coarsest one, which is searched first. Each is half as coarse as the one before.
    bound : float, optional
        A lower bound that is known, in the unit of the objective: none is sought then.

    Returns
    -------
    Candidate
        The best path found, and a lower bound.

    Raises
    ------
    NoPathError
        If it is proven that there is no path, or if there is none on the finest lattice.
    TimeLimitError
        If the budget was over before a first plan.
    """
    query = CompiledProblem(problem)
    budget.beside(lambda: regions_for(query.setting))
    known = query.drivable(initial)
    # a path between tight ends may prove not to be free: then planning is done anew
    whole, stops = budget, stops_count(query)
    budget = budget.part(1.0 - SHARE) if stops else budget
    work = _Improvement(query, budget if query.ends_roomy else budget.part(0.5), gap, seed)
    if bound is not None:
        work.bounding.know(bound - query.potential(problem.goal))
    for path in known:
        work.offer_path(path)
    work.first_plan(finest)
    first = budget.elapsed
    work.improve()
    try:
        path = query.path(work.portfolio.best)
    except PlanningError:
        ends = ways_out(query, budget, turn=0.0)[0]
        if not ends.eased:
            raise
        between = budget.part(0.5)
        inner = plan(ends.problem, between, gap=gap, seed=seed, finest=finest)
        path = ends.refined(inner.path, budget)
    path = _finished(query, [path, *known])
    found = stops_of(query, path, whole) if stops else None
    if stops and (found is None or found.share < 1.0) and query.ends_roomy:
        # what other stops cannot bring is spent as if there were none
        share = 0.0 if found is None else found.share
        if work.go_on(whole.part(1.0 - share)):
            path = _finished(query, [path, query.path(work.portfolio.best)])
            found = stops_of(query, path, whole) if share > 0.0 else None
    if found is not None and found.share > 0.0:
        path = least_driven(query, path, found, work.portfolio.others, work.field(1.0), whole)
    return Candidate(path, query.potential(problem.goal) + work.bound, first)


def _finished(query: CompiledProblem, paths: list[Path]) -> Path:
    """Return the best of some paths with arcs and spins where these are better."""
    # what the tables made of the cost of a known path is not what the models make of it
    return with_fewer_motions(query, with_wide_arcs(query, min(paths, key=query.value)))


class _Improvement:
    """The best motions so far, and how to better them."""

    def __init__(self, query: CompiledProblem, budget: Budget, gap: float, seed: int) -> None:
        self.query = query
        self.setting = query.setting
        self.budget = budget
        self.gap = gap
        self.portfolio = Portfolio(self.setting, seed)
        self.ends = Ends(query)
        self.fields: dict[float, DistanceToGo] = {}
        self.searches: list[Search] = []
        self.begun: set[Sought] = set()
        self.bounding = Bounding(query)
        self._through_slots = False

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

    def offer_path(self, path: Path) -> None:
        """Take a path that somebody else made, and that can be driven from start to goal."""
        self.portfolio.enter(self.query.of_centre(path))

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
        for penalty in WAYS:
            if self._enter_way(penalty):
                return
        # where the poses tested do not join start and goal, a search among them is in vain
        tested = self.field(PENALTY).places is places_for(self.ends.between(self.setting))
        if not tested and self._enter_slots():
            return
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
                self.portfolio.enter(one.ends.whole(one.search.segments()))
            if found:
                if not any(one.ends is self.ends for one in found):
                    self._move_ends(plain)
                return
            if tested and turn == FIRST_TURN and self._enter_slots():
                return
            pairs = zip(open_ones, states, strict=True)
            open_ones = [one for one, state in pairs if state != kernels.EXHAUSTED]
            turn *= 2
        last = every[-1].search
        (x, y), cell = last.nearest, last.lattice.cell
        places = sum(int(one.search.tree.counts[2]) for one in every)
        raise TimeLimitError(
            f"no path was found in {self.budget.name}: {places} places were searched in cells "
            f"down to {cell:.3g} m, the one nearest to the goal at ({x:.2f}, {y:.2f}); give more "
            f"{self.budget.remedy}"
        )

    def _move_ends(self, ends: Ends) -> None:
        """Have searches begin and end elsewhere."""
        self.ends = ends
        self.fields.clear()

    @cached_property
    def _shortest(self) -> KernelProblem:
        """The problem with the shortest way as the objective, for the same body."""
        return CompiledProblem(self.query.problem.shortest).setting

    def improve(self) -> None:
        """Make the path cheaper until the budget is over, the gap closed, or nothing is gained."""
        left = self.budget.left
        # what is found must be refined before the end
        searching = self.budget.part(SEARCH_SHARE)
        kept = BOUND_SHARE * min(left, MOST_LEFT * PACE)
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
        if not self.done:
            self.portfolio.finish(self.budget, self.enough, *self.bounding.work(self.cost, kept))
        self._refine()

    def go_on(self, budget: Budget) -> bool:
        """Refine the best path with what another budget gives; tell whether that gained."""
        before, self.budget = self.cost, budget
        self._refine()
        return self.cost < before

    def _refine(self) -> None:
        """Refine the best path until that gains nothing any more."""
        gains = True
        while gains and not self.done:
            before = self.cost
            self.portfolio.again(self.budget, self.enough)
            gains = self.portfolio.rounds <= PATIENCE or self.cost <= before * (1 - 1e-5)

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
            self.portfolio.enter(self.ends.whole(way))

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
        if self.query.problem.objective == "length":
            return []
        run = partial(shortest_way, self._shortest, self.ends, self.field(PENALTY))

        def take(found: Segments | None) -> None:
            if found is not None:
                self.portfolio.enter(found)

        return [Work(run, units, take)]

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
        searches = [*self._new_searches(begun), *self.searches]
        self.searches = []

        def take(search: Search, before: float, state: int) -> None:
            if search.best < before:
                self.portfolio.enter(self.ends.whole(search.segments()))
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
        way = way_along(self.ends.between(self.setting), self.field(penalty), self.budget)
        self._enter(way)
        return way is not None

    def field(self, penalty: float) -> DistanceToGo:
        """Return the distance to go, with tight places counted longer."""
        if penalty not in self.fields:
            found = distance_to_go(self.ends.between(self.setting), penalty)
            self.budget.spend(found.work / TURNS)
            self.fields[penalty] = found
        return self.fields[penalty]

    def _new_searches(self, begun: Iterable[Sought]) -> list[Search]:
        """Return searches that have yet to begin, led by the guides known that are most like."""
        searches = []
        for sought in begun:
            if sought.shortest and self.query.problem.objective == "length":
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
