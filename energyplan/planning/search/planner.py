"""The lattice planner: a first plan at once, better ones until the budget is over.

`plan` calls one function a step, in this order:

1. `between_ends`: an end without room to turn is left by a short way; the rest of the steps search
   between the poses with room.
2. `find_first`: the shortest route through the free configurations is tracked by exact
   minimum-energy motions, and shortened to a first plan; other searches where that fails.
3. `_Stages`: the first path is refined a little and driven, where stops take energy or time, so
   that a stop has a price from then on. Then come stages of growing work: routes, each cheapest by
   its length and turns and the later ones away from the former, are tracked, a coarse lattice
   compares routes through open ground, a lower bound on every path's cost is computed, and narrow
   passages are searched. The shortest of all paths is shortened: it is the answer where
   length is the objective, and a plan of least energy costs no more. The best paths are refined,
   and driven from time to time. Planning ends when the budget is over, the gap to the bound is
   closed, or nothing is gained any more.

Each path gets wide arcs where the power makes them cheaper, and of paths of one cost it is the
quicker: a single spin replaces pivots back and forth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import remainder
from typing import Any

import numpy as np

from energyplan import steering
from energyplan.compilation import KERNELS, compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import InvalidInputError, PlanningError
from energyplan.path import FloatArray, Path
from energyplan.planning.bound import Bounding, prepare_bound
from energyplan.planning.budget import SHARES, UNITS, Budget, Work, do_together
from energyplan.planning.driven import DrivenPath, stops_count
from energyplan.planning.plans import Candidate
from energyplan.planning.problem import PlanningProblem, is_length, objective_weights
from energyplan.planning.search.first import Paths, between_ends, find_first
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.narrow.ends import surely_has_room
from energyplan.planning.search.narrow.passages import passage_work
from energyplan.planning.search.optimise import Portfolio, Refiner
from energyplan.planning.search.routes import cheapest_routes, straight_routes
from energyplan.planning.search.stops import Answer, with_expensive_turns
from energyplan.planning.settings import LATTICE, REFINING, STAGES, STOPS
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.space.cost_to_go import regions_for
from energyplan.records import checked
from energyplan.terrain.collision import motion_free


@checked()
def plan(
    problem: PlanningProblem,
    budget: Budget,
    *,
    gap: float = 1e-3,
    seed: int = 1,
    initial: Iterable[Path] = (),
    bound: float | None = None,
) -> Candidate:
    """Plan on a lattice, and refine with exact steering."""
    if not gap >= 0:
        raise InvalidInputError(f"gap is {gap}; give 0 or more")
    query = compiled(problem)
    base = query.leading  # of least energy, also where the shortest path is wanted
    budget.beside(lambda: regions_for(base.setting))
    paths = between_ends(base, budget, gap, seed)
    known = [path for path in initial if problem.fault(path) is None]
    for path in known:
        paths.enter(base.of_centre(path.ds, path.dtheta))
    if bound is not None and base is query:
        paths.bounding.know(bound - query.potential(problem.goal))
    find_first(paths, budget)
    first = budget.elapsed
    stages = _Stages(paths, budget, known, length=base is not query)
    stages.run()
    if base is not query:
        path = stages.shortest.best()
        least = Bounding(query)
        if bound is not None:
            least.know(bound - query.potential(problem.goal))
        beyond = query.value(path) - query.potential(problem.goal)
        do_together(budget, least.work(beyond, SHARES.aside * budget.left))
        return Candidate(path, query.potential(problem.goal) + least.value, first)
    path, driven = stages.answered()
    beyond = query.value(path) - query.potential(problem.goal)
    left = min(budget.left, SHARES.aside * (budget.limit or 0))
    do_together(budget, paths.bounding.work(beyond, left) if left > 0 else [])
    value = query.potential(problem.goal) + paths.bounding.value
    return Candidate(path, value, first, None if stages.exact else stages.shortest.path, driven)


class _EffortOverError(Exception):
    """The next step does not fit into the effort that is left."""


class _Stages:
    """The stages after the first path: routes, shortening and refining, each with more work.

    No step depends on the budget but by whether it fits: a larger budget does the same and then
    more. So a plan of more effort is never worse.
    """

    def __init__(
        self, paths: Paths, budget: Budget, known: Sequence[Path], *, length: bool = False
    ) -> None:
        query = paths.query
        self.length = length  # whether the shortest path is the answer
        self.paths, self.budget, self.known = paths, budget, known
        self.begun = budget.spent
        self.answer = Answer(query, stops_count(query.problem))
        self.short_query = compiled(query.problem.shortest)
        self.shortest = Answer(self.short_query, driven=False)
        self.short = None if is_length(query.problem) else Portfolio(self.short_query.setting, 1)
        self.short_open = self.short is not None
        self.open = {"routes", "straight", "compared", "turning", "passages"}
        self.varied = -1.0
        self.driven_at = 0.0

    def run(self) -> None:
        """Do all steps that fit, until nothing is left to gain."""
        with suppress(_EffortOverError):
            self._begin()
            size = STAGES.first
            while True:
                self._search(size)
                self._weigh()
                gains = self._improve(size)
                size *= 2.0
                if not (gains or self.open or self.shortening):
                    break

    @property
    def done(self) -> float:
        """Units of work done since the first path was known."""
        return self.budget.spent - self.begun

    @property
    def closed(self) -> bool:
        """Whether no path is better by more than the gap that is allowed."""
        paths = self.paths
        return paths.stop == 0.0 and paths.cost <= paths.enough

    def _need(self, units: float) -> None:
        """End the stages if so many units of work are not left."""
        if self.budget.left < units:
            raise _EffortOverError

    def _do(self, works: Sequence[Work]) -> None:
        """Do some work at once, if it fits."""
        self._need(sum(work.units for work in works))
        do_together(self.budget, works)

    def _weigh(self) -> None:
        """Take the best path that is known, if driving it takes less than the answer."""
        query = self.paths.query
        if self.answer.drives:
            self._need(UNITS.drive)
        elif isinstance(query.problem.cost.steering_parameters, StaticSteering):
            return  # one at the end will do
        self.answer.weigh(_finished(query, self.paths.portfolio.best), self.budget)
        self.driven_at = self.done

    def _begin(self) -> None:
        """Refine the first path a little, drive it, and price its stops."""
        # these steps are done whatever is left: so they are the same with any budget
        paths, answer = self.paths, self.answer
        self._refine_first()
        first = _finished(paths.query, paths.portfolio.best)
        answer.weigh(first, self.budget)
        if answer.path is None:  # the motors drive it at no speed
            self.answer = answer = Answer(paths.query, driven=False)
            answer.weigh(first, self.budget)
        self.shortest.weigh(first, self.budget)
        for path in self.known:
            self.shortest.weigh(path, self.budget)
            answer.weigh(path, self.budget)
        own = Budget(effort=round(STAGES.least_bound))
        do_together(own, paths.bounding.work(paths.cost, STAGES.least_bound))
        self.budget.spend(own.spent)
        if answer.each:
            paths.price_stops(answer.each)
            self._refine_first()
            answer.weigh(_finished(paths.query, paths.portfolio.best), self.budget)
            self.driven_at = self.done

    def _refine_first(self) -> None:
        """Refine the paths that are known a little, whatever is left."""
        works = self.paths.portfolio.turns(self.paths.enough)
        own = Budget(effort=1 + round(sum(work.units for work in works)))
        do_together(own, works)
        self.budget.spend(own.spent)

    def _turns(self) -> None:
        """Refine, a little, every path that was entered."""
        portfolio = self.paths.portfolio
        while portfolio.waiting:
            works = portfolio.turns(self.paths.enough)
            for k in range(0, len(works), 2):
                self._do(works[k : k + 2])

    def _search(self, size: float) -> None:
        """Search further paths, shorten the shortest one, and search a better bound."""
        if self.closed:
            self.open.clear()
        if not self.open:
            self._shorten(size)
            return
        paths, setting = self.paths, self.paths.setting
        works = {
            "routes": Work(
                partial(cheapest_routes, setting, paths.to_go, stuck=paths.stuck),
                STAGES.routes * size, paths.enter_between,
            ),
            "straight": Work(
                partial(straight_routes, setting, paths.to_go),
                STAGES.aside * size, paths.enter_hopeful,
            ),
            "compared": _compared(paths, STAGES.aside * size),
        }  # fmt: skip
        turning = self.answer.path.turning if self.answer.path else 0.0
        if self.answer.extra > STOPS.most * abs(self.answer.value) and turning > 0.0:
            expensive = with_expensive_turns(setting, self.answer.extra / turning)
            works["turning"] = works["routes"]._replace(
                run=partial(cheapest_routes, expensive, paths.to_go)
            )
        for name, work in works.items():
            if name in self.open:
                self._do([self._whole(name, work)])
                self._turns()
            if name == "routes":
                self._shorten(size)
        self._do(paths.bounding.work(paths.cost, STAGES.bound * size))
        if "passages" in self.open and not paths.through_passages:
            units = STAGES.passages * size
            several = passage_work(setting, paths.to_go, units, paths.enter_between)
            self._do([self._whole("passages", work) for work in several])
            self._turns()

    def _whole(self, name: str, work: Work) -> Work:
        """Return some work that is not done again once it did not need all of its units."""

        def run(own: Budget) -> Any:
            found = work.run(own)
            if own.spent <= STAGES.enough * work.units:
                self.open.discard(name)
            return found

        return work._replace(run=run)

    @property
    def shortening(self) -> bool:
        """Whether the shortest path may become shorter yet."""
        return self.short is not None and self.short_open and not self.exact

    @property
    def exact(self) -> bool:
        """Whether no path is better, so that the shortest one does not matter."""
        paths = self.paths
        least = paths.bounding.value * (1.0 + REFINING.same)
        return not self.length and paths.stop == 0.0 and paths.cost <= least

    def _shorten(self, size: float) -> None:
        """Shorten the shortest of the paths found a little more."""
        if self.short is not None and not self.exact:
            self._need(STAGES.short * size + (UNITS.drive if self.answer.drives else 0.0))
            self._shorten_by(STAGES.short * size)

    def _shorten_by(self, units: float) -> None:
        """Shorten the shortest of the paths found by so many units of work, whatever is left."""
        paths, short = self.paths, self.short
        if short is None or self.exact:
            return
        base, of = paths.query, self.short_query
        known = (of.motions_of(base, one) for one in [*paths.entered, paths.portfolio.best])
        every = [Refiner(of.setting, one) for one in known]
        short.enter(min(every, key=lambda one: one.cost).segments)
        enough = Bounding(of).value * (1.0 + paths.gap)
        own = Budget(effort=round(units))
        while short.waiting and not own.over:
            do_together(own, short.turns(enough))
        while self.short_open and not own.over and short.cost > enough:
            self.short_open = short.improve(own)
        self.short_open = self.short_open and short.cost > enough
        self.budget.spend(own.spent)
        with suppress(PlanningError):
            found = _finished(of, short.best)
            self.shortest.weigh(found, self.budget)
            self.answer.weigh(found, self.budget)
            paths.enter(base.motions_of(of, short.best))

    def _improve(self, size: float) -> bool:
        """Refine the best path until the next stage is due; return whether it still gains."""
        portfolio, more = self.paths.portfolio, bool(self.open) or self.shortening
        while not self.closed:
            if more and self.done >= 2.0 * size:
                return True
            self._need(STAGES.step)
            if not portfolio.improve(self.budget):
                break
            due = max(STAGES.drive_least, STAGES.drive * self.done)
            if self.done >= self.driven_at + due:
                self._weigh()
        self._weigh()
        self._vary()
        return False

    def _vary(self) -> None:
        """Drive paths near the best one that are best at other prices of a stop."""
        paths, answer = self.paths, self.answer
        if self.varied == paths.cost or not answer.extra > STOPS.most * abs(answer.value):
            return
        self.varied = paths.cost
        for factor in STOPS.prices:
            self._need(2.0 * STAGES.step + UNITS.drive)
            setting = paths.query.setting._replace(stop=factor * paths.stop)
            refiner = Refiner(setting, paths.portfolio.best)
            refiner.shortcut(self.budget)
            refiner.polish(self.budget, most=STOPS.polish)
            with suppress(PlanningError):
                answer.weigh(_finished(paths.query, refiner.segments), self.budget)

    def answered(self) -> tuple[Path, DrivenPath | None]:
        """Return the best path, and its drive where paths were driven."""
        answer, query = self.answer, self.paths.query
        if not answer.drives and isinstance(query.problem.cost.steering_parameters, StaticSteering):
            answer.weigh(_finished(query, self.paths.portfolio.best), self.budget)
        return answer.best(), answer.driven


def _compared(paths: Paths, units: float) -> Work:
    """Return a search of a coarse lattice along the map's axes, which compares open routes."""
    setting = paths.setting
    lattice, start = lattice_for(setting, LATTICE.coarse), setting.start
    spin = -remainder(start.yaw - setting.space.yaw, lattice.turn)
    rotated = setting._replace(start=start._replace(yaw=start.yaw + spin))
    if setting.widest > 0.0 or not motion_free(setting.space, setting.body, *start, 0.0, spin, 0.0):
        spin, rotated = 0.0, setting
    search, limit = Search(rotated, paths.to_go, lattice, 1.0), LATTICE.hope * paths.cost

    def enter(found: Segments | None) -> None:
        if found is not None:
            whole = Segments(np.append(0.0, found.ds), np.append(spin, found.dtheta))
            paths.enter_between([whole])

    return Work(partial(search.cheapest, limit=limit), units, enter)


def _finished(query: CompiledProblem, motions: Segments) -> Path:
    """Return the path of some motions, with arcs and spins where these are better."""
    path = query.path(motions)
    if max(query.problem.radii) > 0:
        return path
    return _with_fewer_motions(query, _with_wide_arcs(query, path))


def _with_fewer_motions(query: CompiledProblem, path: Path) -> Path:
    """Return a path of the same cost in which a single spin replaces pivots that end in place."""
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
        for last in (np.flatnonzero(away <= REFINING.same) + first + 2)[::-1]:
            turn = float(dtheta[first:last].sum())
            # turning back and forth is not what a spin does
            if np.abs(dtheta[first:last]).sum() > abs(turn) + REFINING.same:
                continue
            fewer = Path(
                path.start,
                np.concatenate([ds[:first], [lateral * turn], ds[last:]]),
                np.concatenate([dtheta[:first], [turn], dtheta[last:]]),
                path.longitudinal,
            )
            free = query.grid.path_free(fewer, query.problem.robot)
            if free and query.value(fewer) <= query.value(path) * (1.0 + REFINING.same):
                path, ds, dtheta = fewer, fewer.ds, fewer.dtheta
                break
        first += 1
    return path


_MOST_POSES = 20  # poses of the path that are joined, any two of them


def _with_wide_arcs(query: CompiledProblem, path: Path) -> Path:
    """Return a path that costs no more, with arcs where these are cheaper.

    The kernels join poses by straight lines and pivots, which are best where the power is piecewise
    linear. Where wide arcs cost less, exact steering for the model itself joins some poses of the
    finished path once more.
    """
    problem = query.problem
    cost = problem.cost
    even = problem.surfaces is None and problem.heights is None
    if (
        not even
        or cost.of_heading
        or set(objective_weights(problem.objective)) != {"energy"}
        or len(path) == 0
    ):
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
NARROW = ("energyplan.planning.search.narrow.bidirectional",)
"""Where the kernels are that are needed for costs that are not static, for surfaces, for ends
without room, for ends that nothing seems to join, and for routes that cannot be tracked. The last
two are compiled when they are called; the very last ahead of that if a clock is about to start."""


def kernels(
    cost: EnergyCost | None = None,
    *,
    surfaces: bool = False,
    tight: bool = False,
    narrow: bool = True,
) -> tuple[str, ...]:
    """Return the modules whose kernels planning may call."""
    import_module("energyplan.planning.driven")
    static = cost is None or isinstance(cost.steering_parameters, StaticSteering)
    needed = ((surfaces, SURFACES), (tight, TIGHT), (narrow, NARROW), (False, CLOSED))
    left_out = {module for wanted, modules in needed if not wanted for module in modules}
    found = {name.rpartition(".")[0] for name in KERNELS if name.startswith(PLANNING)}
    return (*sorted(found.difference(left_out)), *(() if static else EXACT))


def compile_planning(
    problem: PlanningProblem, *, tight: bool | None = None, load: bool = True
) -> None:
    """Compile the kernels of planning, and load them, so that no time limit pays for it."""
    wanted = partial(kernels, problem.cost, surfaces=problem.surfaces is not None, narrow=load)
    compile_kernels(*wanted(tight=bool(tight)), load=load)
    ends = problem.start, problem.goal
    if tight is None and not all(surely_has_room(compiled(problem), end) for end in ends):
        compile_kernels(*wanted(tight=True), load=load)


def prepare(problem: PlanningProblem, *, guided: bool = True) -> None:
    """Compute once what all plans on a map share, so that no time limit pays for it.

    These are the distances to obstacles, the surface in each cell, the free configurations of the
    footprint and how they join, and the outlines for the lower bound. All are kept with the map.
    """
    query = compiled(problem)
    if guided:
        regions_for(query.leading.setting)
    prepare_bound(query)
