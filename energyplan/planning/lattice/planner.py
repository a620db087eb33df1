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
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import numpy as np

from energyplan.errors import PlanningError, TimeLimitError
from energyplan.path import Path
from energyplan.planning.bound import Bound, Spent, lower_bound
from energyplan.planning.budget import PACE, Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.fewer_motions import with_fewer_motions
from energyplan.planning.lattice.portfolio import Portfolio
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.rounds import ROUNDS, Guide
from energyplan.planning.lattice.search import (
    Search,
    lattice_for,
)
from energyplan.planning.lattice.stops import SHARE, least_driven, stops_count
from energyplan.planning.lattice.tight_ends import Ends, ways_out
from energyplan.planning.lattice.way_along import way_along
from energyplan.planning.lattice.wide_arcs import with_wide_arcs
from energyplan.planning.parallel import side_by_side
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import distance_to_go, reached, regions_for
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem
from energyplan.planning.scene.reachability import check_configurations, none_found

logger = logging.getLogger(__name__)

FIRST_WEIGHT = 2.0
"""Weight of the search for the first path."""

PENALTY = 8.0
"""How much longer a tight place counts for that search."""


class Attempt(NamedTuple):
    """A search for a first path: between which ends, and on how fine a lattice."""

    ends: Ends
    scale: float
    search: Search


WAYS = (PENALTY, 2.0, 1.0)
"""And for the ways along guides."""

HASTE = 0.25
"""Time below which the first round is left out [s]."""

MOST = 2000
"""Expansions of each search in the first round; twice as many in each round that follows."""

PATIENCE = 3
"""Refinements of the best path, after the last round, that may be in vain."""

SEARCH_SHARE = 0.6
"""Part of the time left after the first plan that the searches may take."""

BOUND_SHARE = 0.15
"""Part of that time for the bound, and once more where that did not bring it to its end."""

MOST_LEFT = 60.0
"""Time of which that part is taken at most [s]."""

GUIDE_SHARE = 0.3
"""Part of what the searches may take up to which new distances to go are worth their work."""

STEPS = 12_000
"""Steps of that search that count as a unit of work."""

TURNS = 120
"""Turns of nodes, where distances to go are found, that count as a unit of work."""

MOST_LATTICES = 16
"""Lattices on which a first path is sought, each half as coarse as the one before."""

ESCAPE_SHARE = 0.25
"""Part of the budget that ways out of tight ends may take."""

SHORTEST_SHARE = 0.25
"""Part of what is left after the first plan that finding a shortest way may take."""

SHORTEST_POLISH = 800
"""Attempts to make it shorter."""

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
        work.know_bound(bound - query.potential(problem.goal))
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
    # what the tables made of the cost of a known path is not what the models make of it
    path = with_wide_arcs(query, min([path, *known], key=query.value))
    path = with_fewer_motions(query, path)
    if stops:
        path = least_driven(query, path, work.portfolio.others, work.field(1.0), whole)
    return Candidate(path, query.potential(problem.goal) + work.bound, first)


class _Improvement:
    """The best motions so far, and how to better them."""

    def __init__(self, query: CompiledProblem, budget: Budget, gap: float, seed: int) -> None:
        self.query = query
        self.setting = query.setting
        self.budget = budget
        self.gap = gap
        self.portfolio = Portfolio(self.setting, seed, budget)
        self.ends = Ends(query)
        self.fields: dict[float, DistanceToGo] = {}
        self.searches: list[tuple[Search, float]] = []
        self.entered: set[float] = set()
        self._bound = Bound(0.0, False)
        self._spent: Spent = {}

    @property
    def bound(self) -> float:
        """Lower bound on the cost of every path."""
        return self._bound.value

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

    def know_bound(self, value: float) -> None:
        """Take a lower bound that somebody else found, less the potential; none is sought then."""
        self._bound = Bound(value, True)

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
        self.entered.clear()

    def _shortest_way(self, budget: Budget) -> Segments | None:
        """Return the way that a search for the shortest one finds first, made shorter a little.

        Of two ways that are refined for their energy the shorter one may stay the dearer, though it
        is cheaper once it is short: so it is made short before it competes.
        """
        setting = self._shortest
        field = self.field(PENALTY)
        search = Search(self.ends.between(setting), field, lattice_for(setting), FIRST_WEIGHT)
        search.run(budget, stop_at_first=True)
        if not search.found:
            return None
        refiner = Refiner(setting, self.ends.whole(search.segments()))
        refiner.shortcut(budget)
        refiner.polish(budget, most=SHORTEST_POLISH)
        return refiner.segments

    @property
    def _shortest(self) -> KernelProblem:
        """The problem with the shortest way as the objective, for the same body."""
        return CompiledProblem(self.query.problem.shortest).setting

    def improve(self) -> None:
        """Make the path cheaper until the budget is over, the gap closed, or nothing is gained."""
        left = self.budget.left
        # what is found must be refined before the end
        searching = self.budget.part(SEARCH_SHARE)
        kept = BOUND_SHARE * min(left, MOST_LEFT * PACE)
        self.field(PENALTY)

        def bound(own: Budget) -> None:
            self.raise_bound(min(kept, own.left), own)

        # neither needs what the other one finds
        tasks: list[Callable[[Budget], Segments | None]] = [bound]
        if self.query.problem.objective != "length":
            tasks.append(self._shortest_way)
        for found in side_by_side(self.budget, tasks, max(kept, SHORTEST_SHARE * left)):
            if found is not None:
                self.portfolio.enter(found)
        budget = self.budget if self._bound.final else self.budget.less(kept)
        for number, (scale, weight, guides) in enumerate(ROUNDS):
            if number == 0 and left < HASTE * PACE:
                continue
            most = MOST << number
            self.portfolio.run(searching, self.enough)
            penalties = {guide.penalty for guide in guides}
            if self._work_for(penalties) > GUIDE_SHARE * searching.left:
                continue  # refining what is known gains more
            if not searching.over and not self.done:
                self._distances(penalties, searching)
                for penalty in sorted(penalties - self.entered):
                    self._enter_way(penalty)
                fresh = [self._search(scale, weight, guide) for guide in guides]
                self._advance(fresh, searching, most)
        self.portfolio.run(budget, self.enough)
        self.portfolio.finish(budget, self.enough)
        gains = True
        while gains and not budget.over and self.cost > self.enough:
            before = self.cost
            self.portfolio.again(budget, self.enough)
            gains = self.portfolio.rounds <= PATIENCE or self.cost <= before * (1 - 1e-5)
        if not self._bound.final and self.cost > self.enough:
            self.raise_bound(kept, self.budget)

    def raise_bound(self, units: float, budget: Budget) -> None:
        """Search for a better lower bound; what is known of the best cost makes that easier."""
        if self._bound.final:
            return
        value, final = lower_bound(self.query, self.cost, STEPS * units, self._spent)
        if not final:
            budget.spend(units)
        self._bound = Bound(max(value, self.bound), final)

    def _enter_way(self, penalty: float) -> bool:
        """Enter the way that a guide knows, if it is one; tell whether it is."""
        self.entered.add(penalty)
        way = way_along(self.ends.between(self.setting), self.field(penalty), self.budget)
        if way is not None:
            self.portfolio.enter(self.ends.whole(way))
        return way is not None

    def field(self, penalty: float) -> DistanceToGo:
        """Return the distance to go, with tight places counted longer."""
        self._distances({penalty}, self.budget)
        return self.fields[penalty]

    def _distances(self, penalties: set[float], budget: Budget) -> None:
        """Find the distances to go with tight places counted so many times longer."""

        def find(penalty: float, own: Budget) -> DistanceToGo:
            found = distance_to_go(self.ends.between(self.setting), penalty)
            own.spend(found.work / TURNS)
            return found

        missing = sorted(penalties - set(self.fields))
        tasks = [partial(find, penalty) for penalty in missing]
        self.fields.update(zip(missing, side_by_side(budget, tasks, budget.left), strict=True))

    def _work_for(self, penalties: set[float]) -> float:
        """Return about what the distances to go will take, as far as they are not known."""
        known = [found.work for found in self.fields.values()]
        return len(penalties - set(self.fields)) * max(known, default=0) / TURNS

    def _search(self, scale: float, weight: float, guide: Guide) -> Search:
        """Return a search that has yet to begin."""
        field = self.field(guide.penalty)
        setting = self.setting
        if guide.shortest:
            setting = self._shortest
        lattice = lattice_for(setting, scale)
        return Search(self.ends.between(setting), field, lattice, weight, aligned=guide.aligned)

    def _advance(self, fresh: list[Search], budget: Budget, most: int) -> None:
        """Run all searches for a while; take what they find into the portfolio."""
        known = [*self.searches, *((search, np.inf) for search in fresh)]

        def run(search: Search, own: Budget) -> int:
            return search.run(own, search.weight >= FIRST_WEIGHT, most)

        states = side_by_side(budget, [partial(run, search) for search, _ in known], most)
        self.searches = []
        for (search, before), state in zip(known, states, strict=True):
            found = float(search.tree.best[0])
            if found < before:
                self.portfolio.enter(self.ends.whole(search.segments()))
            if state == kernels.RUNNING:
                self.searches.append((search, found))
