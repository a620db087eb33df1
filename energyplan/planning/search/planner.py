"""The lattice planner: a first plan at once, better ones until the budget is over.

1. The shortest route through the free configurations is followed by exact minimum-energy motions:
   a first path, and with shortcuts a first plan.
2. Up to four routes, each cheapest by its length and turns and the later ones away from the former,
   are followed as well, and a coarse lattice compares ways through open ground. A lower bound on
   every path's cost is computed.
3. The paths compete for the budget to be refined. Planning ends when the budget is over, the gap to
   the bound is closed, or nothing is gained any more.
4. The shortest of all that was found is made shorter in a part of what is left. It is the answer
   where length is asked for, and a plan of least energy takes no more: the work is the same. Where
   stops count, that is so of what driving both takes.
5. The path gets wide arcs where the power makes them cheaper, and of paths of one cost it is the
   quicker: a single spin stands for pivots to and fro.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import remainder

import numpy as np

from energyplan import steering
from energyplan.compilation import KERNELS, compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import InvalidInputError, PlanningError
from energyplan.path import FloatArray, Path
from energyplan.planning.bound import Bounding, prepare_bound
from energyplan.planning.budget import SHARES, UNITS, Budget, Work, do_together
from energyplan.planning.contract import Candidate
from energyplan.planning.driven import stops_count
from energyplan.planning.problem import PlanningProblem, is_length, objective_weights
from energyplan.planning.search.follow import Tracked, follow_route
from energyplan.planning.search.lattice import EXHAUSTED, WEIGHT, Search, joined, lattice_for
from energyplan.planning.search.lattice import SETTINGS as LATTICE
from energyplan.planning.search.narrow.ends import Ends, surely_has_room, ways_out
from energyplan.planning.search.narrow.infeasible import (
    Proof,
    Prover,
    check_configurations,
    check_proof,
    none_found,
    none_in_time,
)
from energyplan.planning.search.narrow.shrunken import passage_work, path_through_passages
from energyplan.planning.search.optimise import SAME, Portfolio, Refiner
from energyplan.planning.search.optimise import SETTINGS as PORTFOLIO
from energyplan.planning.search.routes import cheapest_routes
from energyplan.planning.search.stops import least_driven, stops_of
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.space.cost_to_go import (
    CostToGo,
    cost_to_go,
    places_for,
    reached,
    regions_for,
)
from energyplan.planning.space.motions import KernelProblem
from energyplan.records import checked
from energyplan.terrain.collision import motion_free


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
        self._to_go: CostToGo | None = None
        self.bounding = Bounding(query)
        self._through_passages = False
        self.kept = 0.0
        self._stuck: list[Tracked] = []

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

    def first_plan(self, finest: float = 1.0) -> None:
        """Find a first path; lattices twice as fine join one by one while none is found."""
        plain = Ends(self.query)
        for ends in ways_out(self.query, self.budget.part(SHARES.aside)):
            self._move_ends(ends)
            if not ends.moved or reached(self.to_go, ends.between(self.setting)):
                break
        else:
            self._move_ends(plain)
        if np.isfinite(self.cost):
            return
        if not self.ends.moved:
            check_configurations(self.query, self.to_go)
        # where the poses tested do not join start and goal, a search among them is in vain
        setting = self.ends.between(self.setting)
        tested = self.to_go.places is places_for(setting)
        proof = None if tested else self._prove(setting)
        # the exact motion from end to end is straighter than any route
        motions, cost = joined(setting, setting.start, setting.goal)
        direct = self._enter_all([motions] if cost < np.inf else [])
        if self._enter_way() or direct:
            return
        routes = cheapest_routes(setting, self.to_go, self.budget.part(SHARES.stage), self._stuck)
        if self._enter_all(routes) or self._enter_passages():
            return
        # between ends without room there may be a way where no pose beside them is free
        if proof is not None and (self.ends.moved or self.query.ends_have_margin):
            check_proof(self.query, setting, proof)
        self._search_first(plain, finest, tested)

    def _search_first(self, plain: Ends, finest: float, tested: bool) -> None:
        """Search lattices for a first path, each twice as fine as the one before."""
        searched: list[Search] = []
        scale, complete = 1.0, True
        while scale >= finest and not self.budget.over:
            # where no way between the poses with room is found, one between the ends may be
            for ends in [self.ends, plain] if self.ends.moved else [self.ends]:
                setting = ends.between(self.setting)
                to_go = self.to_go if ends is self.ends else cost_to_go(setting)
                search = Search(setting, to_go, lattice_for(self.setting, scale), WEIGHT)
                state = search.run(self.budget.part(SHARES.stage))
                searched.append(search)
                if search.found:
                    if ends is not self.ends:
                        self._move_ends(ends)
                    self._enter(search.segments())
                    return
                complete = complete and state == EXHAUSTED
            scale *= 0.5
        if complete and scale < finest:
            raise none_found(self.query, searched[-1].lattice.cell, searched[-1].nearest)
        if searched:
            places = sum(int(one.tree.counts[2]) for one in searched)
            cell = searched[-1].lattice.cell
            done = f"{places} places were searched in cells down to {cell:.3g} m"
        elif tested:
            done = "free poses join start and goal, but motions along them do not yet"
        else:
            done = "the free poses that were tested do not join start and goal"
        near = [*((one.x, one.y) for one in self._stuck), *(one.nearest for one in searched)]
        raise none_in_time(self.query, self.budget, done, near)

    def _enter(self, way: Segments | None) -> bool:
        """Enter a way between the ends, if there is one; tell whether there is."""
        if way is not None:
            self.enter(self.ends.whole(way))
        return way is not None

    def _enter_all(self, ways: Iterable[Segments]) -> bool:
        """Enter ways between the ends; tell whether there are any."""
        entered = [self._enter(way) for way in ways]
        return any(entered)

    def _enter_way(self) -> bool:
        """Enter the path along the shortest route, if it can be followed; tell whether it can."""
        tracked = follow_route(self.ends.between(self.setting), self.to_go, self.budget)
        if tracked.motions is None:
            self._stuck.append(tracked)
        return self._enter(tracked.motions)

    def _enter_passages(self) -> bool:
        """Enter a way through narrow passages, if one is found; tell whether there is."""
        setting = self.ends.between(self.setting)
        self.budget.beside(lambda: regions_for(setting, enlarged=True))
        way = path_through_passages(setting, None, np.inf, self.budget.part(SHARES.aside))
        self._through_passages = self._enter(way)
        return self._through_passages

    def _prove(self, setting: KernelProblem) -> Proof:
        """Look closer at what the poses tested leave open."""
        self.budget.beside(lambda: compile_kernels(Proof.__module__))
        found = Prover(setting, self.budget.part(SHARES.stage)).found()
        if found.proven:
            check_proof(self.query, setting, found)
        return found

    def _move_ends(self, ends: Ends) -> None:
        """Have searches begin and end elsewhere."""
        self.ends = ends
        self._to_go = None

    @property
    def to_go(self) -> CostToGo:
        """The distance to go."""
        if self._to_go is None:
            self._to_go = cost_to_go(self.ends.between(self.setting))
            self.budget.spend(self._to_go.work / UNITS.nodes)
        return self._to_go

    # -- further paths --------------------------------------------------------------------------

    def search(self) -> None:
        """Find further paths until the searches' part of the budget is over, or the gap closed."""
        searching = self.budget.part(SHARES.stage)
        self.kept = SHARES.aside * self.budget.left
        setting = self.ends.between(self.setting)
        routes = partial(cheapest_routes, setting, self.to_go, stuck=self._stuck)
        routing = Work(routes, SHARES.stage * searching.left, self._enter_all)
        comparing = self._compared(SHARES.aside * searching.left)
        do_together(searching, [*self.portfolio.turns(self.enough), routing, comparing])
        if searching.over or self.done:
            return
        works = self.bounding.work(self.cost, self.kept)
        if not self._through_passages:
            works += passage_work(setting, self.to_go, self.cost, searching, self._enter)
        self._together(searching, works)
        self.portfolio.run(searching, self.enough)

    def _compared(self, units: float) -> Work:
        """Return a search of a coarse lattice along the map's axes, which compares open ways."""
        setting = self.ends.between(self.setting)
        lattice, start = lattice_for(setting, LATTICE.coarse), setting.start
        spin = -remainder(start.yaw - setting.space.yaw, lattice.turn)
        turned = setting._replace(start=start._replace(yaw=start.yaw + spin))
        if setting.least_radius > 0.0 or not motion_free(
            setting.space, setting.body, *start, 0.0, spin, 0.0
        ):
            spin, turned = 0.0, setting
        search, limit = Search(turned, self.to_go, lattice, 1.0), LATTICE.hope * self.cost

        def take(way: Segments | None) -> None:
            if way is not None:
                self._enter(Segments(np.append(0.0, way.ds), np.append(spin, way.dtheta)))

        return Work(partial(search.cheapest, limit=limit), units, take)

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
        """Do some work beside the next turns of the paths known."""
        every = [*self.portfolio.turns(self.enough), *works]
        left = budget.left
        for k, work in enumerate(every):
            every[k] = work._replace(units=min(work.units, SHARES.stage * left))
            left -= every[k].units
        do_together(budget, every)

    def shortest(self, query: CompiledProblem, *beside: Work) -> Segments:
        """Return the shortest of the paths found, made shorter in a part of what is left."""
        setting, enough = query.setting, Bounding(query).value * (1.0 + self.gap)
        short = Portfolio(setting, self.portfolio.seed)
        known = (query.motions_of(self.query, one) for one in [*self.found, self.portfolio.best])
        every = [Refiner(setting, motions) for motions in known]
        for one in sorted(every, key=lambda one: one.cost)[: PORTFOLIO.kept]:
            short.enter(one.segments)

        def run(own: Budget) -> None:
            short.run(own.part(SHARES.stage), enough)
            short.finish(own, enough)
            short.improve(own, enough)

        units = min(SHARES.aside * self.budget.left, self.budget.spent)
        do_together(self.budget, [Work(run, units, lambda _: None), *beside])
        return short.best


FINEST = 0.0625
"""Size of the cells of the finest lattice that is searched, in units of the coarsest one."""


@checked()
def plan(
    problem: PlanningProblem,
    budget: Budget,
    *,
    gap: float = 1e-3,
    seed: int = 1,
    initial: Iterable[Path] = (),
    finest: float = FINEST,
    bound: float | None = None,
) -> Candidate:
    """Plan on a lattice, and refine with exact steering."""
    if not (gap >= 0 and 0 < finest <= 1):
        raise InvalidInputError(
            f"gap is {gap} and finest is {finest}; give a gap of 0 or more, and a part of the "
            "coarsest cells in (0, 1]"
        )
    query = compiled(problem)
    base = query.leading
    budget.beside(lambda: regions_for(base.setting))
    known = query.drivable(initial)
    # what stops may save is kept, and what planning anew takes if tight ends prove not to be free
    whole, stops = budget, stops_count(base.problem)
    budget = whole.part(1.0 - SHARES.aside) if stops else whole
    searching = budget if base.ends_have_margin else budget.part(SHARES.stage)
    work = Paths(base, searching, gap, seed)
    if bound is not None and base is query:
        work.bounding.know(bound - query.potential(problem.goal))
    for path in known:
        work.enter(base.of_centre(path.ds, path.dtheta))
    work.first_plan(finest)
    first = budget.elapsed

    def path_of(of: CompiledProblem, motions: Segments, own: Budget) -> Path:
        """Return the path of some motions."""
        try:
            return of.path(motions)
        except PlanningError:
            ends = ways_out(of, own, turn=0.0)[0]
            if not ends.moved:
                raise
            inner = plan(ends.problem, own.part(SHARES.stage), gap=gap, seed=seed, finest=finest)
            return ends.refined(inner.path, own)

    def shortest_path(*beside: Work) -> Path:
        """Return the shortest path; what that takes does not depend on what is done beside."""
        of = compiled(problem.shortest) if base is query else query
        motions = work.shortest(of, *beside)
        own = budget.apart(work.kept)
        try:
            path = path_of(of, motions, own)
            work.enter(base.motions_of(of, motions))
        finally:
            budget.spend(own.spent)
        return _finished(of, [path])

    work.search()
    shortest: list[Path] = []
    if base is not query:
        with suppress(PlanningError):
            shortest = [shortest_path()]
        shortest = shortest or [path_of(base, work.portfolio.best, budget)]
        others = [_finished(query, known)] if known else []
        path = min([*shortest, *others], key=query.value)
        if bound is not None:
            return Candidate(path, bound, first)
        least = Bounding(query)
        potential = query.potential(problem.goal)
        do_together(budget, least.work(query.value(path) - potential, work.kept))
        return Candidate(path, potential + least.value, first)
    bounding = [] if work.done else work.bounding.work(work.cost, work.kept)
    if is_length(problem) or work.cost <= work.bound * (1.0 + SAME):
        do_together(budget, bounding)
    else:
        with suppress(PlanningError):
            shortest = [shortest_path(*bounding)]
    work.finish()
    path = _finished(query, [path_of(base, work.portfolio.best, budget), *shortest, *known])
    if stops:
        found = stops_of(query, path, whole)
        if (
            found.share < 1.0
            and query.ends_have_margin
            and work.go_on(whole.part(1.0 - found.share))
        ):
            # what other stops cannot bring is spent as if there were none
            path = _finished(query, [path, query.path(work.portfolio.best)])
            found = stops_of(query, path, whole)
        path = least_driven(
            query, path, found, work.portfolio.others, work.to_go, whole, [*shortest, *known]
        )
    return Candidate(path, query.potential(problem.goal) + work.bound, first)


def _finished(query: CompiledProblem, paths: list[Path]) -> Path:
    """Return the best of some paths with arcs and spins where these are better."""
    # what the tables made of the cost of a known path is not what the models make of it
    if query.problem.least_radius > 0:
        return min(paths, key=query.value)
    return _with_fewer_motions(query, _with_wide_arcs(query, min(paths, key=query.value)))


def _with_fewer_motions(query: CompiledProblem, path: Path) -> Path:
    """Return a path of the same cost in which a single spin stands for pivots that end in place."""
    ahead, lateral = query.middle
    ds, dtheta = path.ds, path.dtheta
    first = 0
    while first < len(ds):
        x, y, yaw = path.vertices.T
        centre = np.column_stack([
            x + ahead * np.cos(yaw) - lateral * np.sin(yaw),
            y + ahead * np.sin(yaw) + lateral * np.cos(yaw),
        ])  # fmt: skip
        away = np.hypot(*(centre[first + 2 :] - centre[first]).T)
        for last in (np.flatnonzero(away <= SAME) + first + 2)[::-1]:
            turn = float(dtheta[first:last].sum())
            # turning back and forth is not what a spin does
            if np.abs(dtheta[first:last]).sum() > abs(turn) + SAME:
                continue
            fewer = Path(
                path.start,
                np.concatenate([ds[:first], [lateral * turn], ds[last:]]),
                np.concatenate([dtheta[:first], [turn], dtheta[last:]]),
                path.longitudinal,
            )
            free = query.grid.path_free(fewer, query.problem.robot)
            if free and query.value(fewer) <= query.value(path) * (1.0 + SAME):
                path, ds, dtheta = fewer, fewer.ds, fewer.dtheta
                break
        first += 1
    return path


_MOST_POSES = 20
"""Poses of the path that are joined, any two of them."""


def _with_wide_arcs(query: CompiledProblem, path: Path) -> Path:
    """Return a path that costs no more, with arcs where these are cheaper.

    The kernels join poses by straight lines and pivots, which are best where the power is piecewise
    linear. Where wide arcs cost less, exact steering for the model itself joins some poses of the
    finished path once more.
    """
    problem = query.problem
    cost = problem.cost
    even = problem.surfaces is None and problem.heights is None
    if not even or set(objective_weights(problem.objective)) != {"energy"} or len(path) == 0:
        return path
    if isinstance(cost.steering_parameters, StaticSteering):
        return path
    chosen = np.unique(np.linspace(0, len(path), _MOST_POSES).round().astype(int))
    poses = path.vertices[chosen]
    spent = np.concatenate([[0.0], np.cumsum(cost.segment_energy(path.ds, path.dtheta, 0.0))])
    least = steering.energy(poses[:, None], poses[None, :], cost)
    best = np.full(len(poses), np.inf)
    best[0] = 0.0
    parts: list[tuple[FloatArray, FloatArray]] = []
    whole: list[list[int]] = [[]]
    for j in range(1, len(poses)):
        kept = slice(chosen[j - 1], chosen[j])
        best[j] = best[j - 1] + spent[chosen[j]] - spent[chosen[j - 1]]
        parts.append((path.ds[kept], path.dtheta[kept]))
        whole.append([*whole[j - 1], len(parts) - 1])
        totals = best[:j] + least[:j, j]
        for i in np.argsort(totals, kind="stable"):
            if totals[i] >= best[j] * (1.0 - 1e-6):
                break
            joined = steering.path(poses[i], poses[j], cost)
            if problem.reversing(joined) is not None:
                continue
            if problem.terrain.obstacles.path_free(joined, problem.robot):
                best[j] = totals[i]
                parts.append((joined.ds, joined.dtheta))
                whole[j] = [*whole[i], len(parts) - 1]
                break
    ds, dtheta = (np.concatenate([parts[k][n] for k in whole[-1]]) for n in (0, 1))
    found = Path(path.start, ds, dtheta, path.longitudinal)
    free = problem.terrain.obstacles.path_free(found, problem.robot)
    return found if free and query.value(found) < query.value(path) else path


PLANNING = tuple(f"energyplan.{of}." for of in ("planning", "terrain", "cost", "steering.kernels",
                                                "limits"))  # fmt: skip
"""What the names of the kernels begin with that planning and driving a plan may call."""

EXACT = ("energyplan.steering.polygon",)
SURFACES = ("energyplan.planning.bound.surfaces", "energyplan.terrain.surfaces")
TIGHT = ("energyplan.planning.search.narrow.ends",)
CLOSED = ("energyplan.planning.search.narrow.infeasible",)
"""Where the kernels are that are needed for costs that are not static, for surfaces, for ends
without room, and for ends that nothing seems to join."""


def kernels(
    cost: EnergyCost | None = None, *, surfaces: bool = False, tight: bool = False
) -> tuple[str, ...]:
    """Return the modules whose kernels planning may call."""
    import_module("energyplan.planning.driven")
    static = cost is None or isinstance(cost.steering_parameters, StaticSteering)
    left_out = CLOSED + (() if surfaces else SURFACES) + (() if tight else TIGHT)
    found = {name.rpartition(".")[0] for name in KERNELS if name.startswith(PLANNING)}
    return (*sorted(found.difference(left_out)), *(() if static else EXACT))


def compile_planning(
    problem: PlanningProblem, *, tight: bool | None = None, load: bool = True
) -> None:
    """Compile the kernels of planning, and load them, so that no time limit pays for it."""
    surfaces = problem.surfaces is not None
    compile_kernels(*kernels(problem.cost, surfaces=surfaces, tight=bool(tight)), load=load)
    ends = problem.start, problem.goal
    if tight is None and not all(surely_has_room(compiled(problem), end) for end in ends):
        compile_kernels(*kernels(problem.cost, surfaces=surfaces, tight=True), load=load)


def prepare(problem: PlanningProblem, *, guided: bool = True) -> None:
    """Make what is made once for a map, so that no time limit pays for it.

    These are the distances to obstacles, the surface in each cell, the free configurations of the
    footprint and how they join, and the outlines for the lower bound. All are kept with the map.
    """
    query = compiled(problem)
    if guided:
        regions_for(query.leading.setting)
    prepare_bound(query)
