"""The lattice planner: a first plan at once, better ones until the budget is over.

`plan` calls one function a step, in this order:

1. `find_ends`: an end that lacks clearance or room to turn is left by a short way; the rest of the
   steps search between the poses with room.
2. `find_first`: the shortest route through the free configurations is tracked by exact
   minimum-energy motions, and shortened to a first plan; other searches where that fails.
3. `_Stages`: the first path is refined a little, its lower bound is computed, and the shortcuts of
   the shortest path where that is wanted; it is driven where stops take energy or time, so that a
   stop has a price from then on. Then the kinds of work take turns by their shares: routes, each
   cheapest by its length and turns and the later ones away from the former, are tracked, straight
   routes and a coarse lattice compare routes through open ground, a lower bound on every path's
   cost is computed, narrow passages are searched, and the paths are refined. The shortest of all
   paths is shortened: it is the answer where length is the objective, and a plan of least energy
   costs no more. The best path is driven from time to time, and its turns are driven at speed where
   stops take much. Planning ends when the budget is over, the gap to the bound is closed, or
   nothing is gained any more.

Each path gets wide arcs where the power makes them cheaper, and of paths of one cost it is the
quicker: a single spin replaces pivots back and forth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import remainder
from typing import Any, NamedTuple

import numpy as np

from energyplan import steering
from energyplan.compilation import KERNELS, Ints, compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import InvalidInputError, PlanningError
from energyplan.path import FloatArray, Path
from energyplan.planning.bound import Bounding, prepare_bound
from energyplan.planning.budget import SHARES, UNITS, Budget, Work, do_together
from energyplan.planning.driven import Candidate, DrivenPath, stops_count
from energyplan.planning.ends import Ends, find_ends, refined_at_ends
from energyplan.planning.problem import PlanningProblem, is_length, objective_weights
from energyplan.planning.search.first import Paths, find_first
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.moving_turns import TurnSearch
from energyplan.planning.search.narrow.escape import surely_has_room
from energyplan.planning.search.narrow.passages import paths_through_passages, units_for_passages
from energyplan.planning.search.optimise import Portfolio, Refiner
from energyplan.planning.search.routes import Routes, straight_way
from energyplan.planning.search.stops import Answer, Weighed, with_expensive_turns
from energyplan.planning.settings import LATTICE, REFINING, ROUTES, STAGES, STOPS, Lane
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.space.cost_to_go import regions_for
from energyplan.planning.space.motions import permitted
from energyplan.records import checked


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
    ends = find_ends(problem, budget)
    query, base = ends.of, ends.query
    bare = query if problem.ends_clear else compiled(problem.without_clearance)
    portfolio = Portfolio(ends.setting(base), seed)
    paths = Paths(ends, gap, portfolio, Bounding(bare.leading))
    known = [path for path in initial if problem.fault(path) is None]
    for path in known if not ends.lacking else ():
        paths.enter(base.of_centre(path.ds, path.dtheta))
    if bound is not None and base is query:
        paths.bounding.know(bound - query.potential(problem.goal))
    find_first(paths, budget)
    first = budget.elapsed
    own = budget.part(SHARES.stage) if ends.lacking else budget
    stages = _Stages(paths, own, known, length=base is not query)
    stages.run()
    if base is not query:
        path = refined_at_ends(ends, stages.shortest.best(), budget)
        least = Bounding(bare)
        if bound is not None:
            least.know(bound - query.potential(problem.goal))
        beyond = query.value(path) - query.potential(problem.goal)
        do_together(budget, least.work(beyond, SHARES.aside * budget.left))
        value = query.potential(problem.goal) + least.value
        return Candidate(path, value, first, open=stages.over)
    path, driven = stages.answered()
    if ends.lacking:
        stages.answer.weigh(refined_at_ends(ends, path, budget), budget)
        path, driven = stages.answer.best(), stages.answer.driven
    beyond = query.value(path) - query.potential(problem.goal)
    left = min(budget.left, SHARES.aside * (budget.limit or 0))
    do_together(budget, paths.bounding.work(beyond, left) if left > 0 else [])
    value = query.potential(problem.goal) + paths.bounding.value
    shortest = None if stages.exact else stages.shortest.path
    return Candidate(path, value, first, shortest, driven, stages.over)


class _Shortened(NamedTuple):
    """What came of shortening the shortest path."""

    gains: bool  # whether more of it may gain
    motions: Segments | None = None
    length: Weighed | None = None
    answer: Weighed | None = None


class _EffortOverError(Exception):
    """The next step does not fit into the effort that is left."""


class _Stages:
    """The work after the first path: further routes, shortening, a bound and refining in turn.

    What is next depends on the work done alone, and a budget only ends it: a larger one does the
    same and then more. So a plan of more effort is never worse.
    """

    def __init__(
        self, paths: Paths, budget: Budget, known: Sequence[Path], *, length: bool = False
    ) -> None:
        query = paths.query
        self.length = length  # whether the shortest path is the answer
        self.paths, self.budget, self.known = paths, budget, known
        self.answer = Answer(query, stops_count(query.problem))
        self.moving: Weighed | None = None  # the best path with turns at speed
        self.short_query = query.shortest
        self.shortest = Answer(self.short_query, driven=False)
        short = paths.ends.setting(self.short_query)
        self.short = None if is_length(query.problem) else Portfolio(short, 1)
        self.looked = 0  # paths entered of which the shortest is known
        self.lanes: dict[str, Iterator[Work | None]] = {
            "refining": self._refining(),
            "routes": self._routing("routes"),
            "straight": self._straight(),
            "compared": self._comparing(),
            "turning": self._routing("turning"),
            "shortening": self._shortening(),
            "bound": self._bounding(),
            "passages": self._passages(),
            "driving": self._driving(),
            "varying": self._varying(),
            "moving": self._moving(),
        }
        self.spent = dict.fromkeys(self.lanes, 0.0)
        self.cut = dict.fromkeys(self.lanes, False)  # whether the last step needed more
        self.done = 0.0
        self.mark = np.inf  # what the answer cost before the last half of the effort
        self.over = False  # whether the effort ended what might gain yet

    def run(self) -> None:
        """Do all steps that fit, until nothing is left to gain."""
        self._begin()
        half = SHARES.stage * (self.budget.limit or 0)
        try:
            while due := self._due():
                if self.budget.spent < half:
                    self.mark = self.value
                self._do(due)
        except _EffortOverError:
            self.over = True

    def _due(self) -> list[tuple[str, Work]]:
        """Return the steps that are next: one, and another if that is late too."""
        found: list[tuple[str, Work]] = []

        def turn(name: str) -> float:
            lane: Lane = getattr(STAGES, name)
            return lane.begins + self.spent[name] / lane.share

        for name in sorted(self.lanes, key=turn):
            if found and turn(name) > self.done:
                break
            work = next(self.lanes[name], None)
            if work is not None:
                found.append((name, self._measured(name, work)))
            if len(found) == 2:
                break
        return found

    def _measured(self, name: str, work: Work) -> Work:
        """Return some work of a kind, of which is known afterwards what it took."""

        def run(own: Budget) -> Any:
            found = work.run(own)
            self.spent[name] += max(own.spent, _LEAST)
            self.cut[name] = own.left < 1.0
            return found

        return work._replace(run=run)

    def _do(self, due: Sequence[tuple[str, Work]]) -> None:
        """Do some steps at once; the last one that fits alone if they do not fit together."""
        before = self.budget.spent
        units = sum(work.units for _, work in due)
        if units > self.budget.left and self._gains and self.budget.extend():
            self.mark = self.value
        if units <= self.budget.left:
            do_together(self.budget, [work for _, work in due])
            self.done += self.budget.spent - before
            return
        for name, work in due:
            left = self.budget.left
            if not left > 0:
                raise _EffortOverError
            own = self.budget.apart(work.units)
            found = work.run(own)
            self.budget.spend(own.spent)
            over = left < work.units and self.cut[name]
            if not over or (getattr(STAGES, name).divisible and not self.answer.drives):
                work.take(found)
            if over:
                raise _EffortOverError
        self.done += self.budget.spent - before

    @property
    def value(self) -> float:
        """What the answer costs, as the paths are compared."""
        if self.moving is not None and self.moving.value < self.answer.value:
            return self.moving.value
        return self.answer.value if self.answer.drives else self.paths.cost

    @property
    def _gains(self) -> bool:
        """Whether more effort than the default one may pay."""
        gained = self.value < self.mark * (1.0 - STAGES.gain)
        return gained and self.paths.cost > self.paths.bounding.value * (1.0 + STAGES.gap)

    @property
    def closed(self) -> bool:
        """Whether no path is better by more than the gap that is allowed."""
        return self.paths.cost <= self.enough

    @property
    def enough(self) -> float:
        """Cost at which no path is better by more than the gap that is allowed."""
        return self.paths.enough if self.paths.stop == 0.0 else 0.0

    @property
    def exact(self) -> bool:
        """Whether no path is better, so that the shortest one does not matter."""
        paths = self.paths
        least = paths.bounding.value * (1.0 + REFINING.same)
        return not self.length and paths.stop == 0.0 and paths.cost <= least

    def _begin(self) -> None:
        """Refine the first path a little, drive it, and price its stops."""
        # these steps are done whatever is left: so they are the same with any budget
        paths, answer = self.paths, self.answer
        self._refine_first()
        first = _finished(paths.ends, paths.query, paths.portfolio.best)
        answer.weigh(first, self.budget)
        if answer.path is None:  # the motors drive it at no speed
            self.answer = answer = Answer(paths.query, driven=False)
            answer.weigh(first, self.budget)
        self.shortest.weigh(first, self.budget)
        for path in self.known:
            self.shortest.weigh(path, self.budget)
            answer.weigh(path, self.budget)
        if answer.each:
            paths.price_stops(answer.each)
            self._refine_first()
            answer.weigh(_finished(paths.ends, paths.query, paths.portfolio.best), self.budget)
        for work in paths.bounding.work(paths.cost, STAGES.least_bound):
            _at_any_rate(work, self.budget)
        if self.length and self.short is not None and not self.exact:
            # no more than its shortcuts, which take little work
            run = partial(self._shorten, self.short, enough=np.inf)
            units = REFINING.opening + UNITS.drive
            _at_any_rate(Work(run, units, self._take_shorter), self.budget)

    def _refine_first(self) -> None:
        """Refine the paths that are known a little, whatever is left."""
        portfolio = self.paths.portfolio
        while portfolio.fresh and (work := portfolio.work(self.enough - self.paths.ends.cost)):
            _at_any_rate(work, self.budget)

    def _refining(self) -> Iterator[Work | None]:
        """Yield steps of refining, and nothing where none gains at present."""
        while True:
            yield self.paths.portfolio.work(self.enough - self.paths.ends.cost)

    def _routing(self, name: str) -> Iterator[Work | None]:
        """Yield searches for the cheapest routes by length and turns, or by expensive turns."""
        paths, lane = self.paths, getattr(STAGES, name)
        if name == "routes":
            routes = Routes(paths.setting, paths.to_go, paths.stuck)
        else:
            while self.closed or not self._stops_matter or not self.answer.best().turning > 0.0:
                yield None
            per_radian = self.answer.extra / self.answer.best().turning
            routes = Routes(with_expensive_turns(paths.setting, per_radian), paths.to_go)
        units = lane.units

        def enter(way: Segments | None) -> None:
            paths.enter_between([] if way is None else [way])

        def run(own: Budget) -> Segments | None:
            return routes.following(own, int(min(units, own.left) / UNITS.state))

        while routes.open:
            found = routes.found
            yield None if self.closed else Work(run, 2.0 * units, enter)
            if not self.closed and routes.found == found:
                units *= 2.0

    def _straight(self) -> Iterator[Work | None]:
        """Yield searches for routes of long straight steps."""
        paths, units = self.paths, STAGES.straight.units
        known: list[Ints] = []

        def enter(way: Segments | None) -> None:
            paths.enter_hopeful([] if way is None else [way])

        for turns in ROUTES.turns:
            self.cut["straight"] = True
            while self.cut["straight"]:
                if self.closed:
                    yield None
                    continue
                run = partial(straight_way, paths.setting, paths.to_go, turns, known)
                yield Work(run, units, enter)
                if self.cut["straight"]:
                    units *= 2.0

    def _comparing(self) -> Iterator[Work | None]:
        """Yield parts of a search of a coarse lattice along the map's axes, for open routes."""
        paths, setting = self.paths, self.paths.setting
        lattice, start = lattice_for(setting, LATTICE.coarse), setting.start
        spin = -remainder(start.yaw - setting.space.yaw, lattice.turn)
        rotated = setting._replace(start=start._replace(yaw=start.yaw + spin))
        if not permitted(setting, start, 0.0, spin):
            spin, rotated = 0.0, setting
        search = Search(rotated, paths.to_go, lattice, 1.0)

        def enter(found: Segments | None) -> None:
            if found is not None:
                whole = Segments(np.append(0.0, found.ds), np.append(spin, found.dtheta))
                paths.enter_between([whole])

        self.cut["compared"] = True
        while self.cut["compared"]:
            if self.closed:
                yield None
                continue
            limit = LATTICE.hope * paths.cost
            yield Work(partial(search.cheapest, limit=limit), STAGES.compared.units, enter)

    def _bounding(self) -> Iterator[Work | None]:
        """Yield searches for a better lower bound."""
        paths, units = self.paths, STAGES.bound.units
        while True:
            for work in [] if self.closed else paths.bounding.work(paths.cost, units):
                yield work
                units *= 2.0
            yield None

    def _passages(self) -> Iterator[Work | None]:
        """Yield searches for narrow passages."""
        paths, known = self.paths, self.paths.to_go
        units = units_for_passages(known)
        self.cut["passages"] = not paths.through_passages
        while self.cut["passages"]:
            if self.closed:
                yield None
                continue
            run = partial(paths_through_passages, paths.setting, known)
            yield Work(run, units, paths.enter_between)
            units *= 2.0

    def _shortening(self) -> Iterator[Work | None]:
        """Yield steps that make the shortest of the paths found shorter."""
        units, short = STAGES.shortening.units, self.short
        gains = short is not None
        while short is not None and gains:
            if self.exact:
                yield None
                continue
            gains = False  # until it was done

            def take(found: _Shortened) -> None:
                nonlocal gains
                gains = found.gains
                self._take_shorter(found)
                if found.motions is not None:
                    self.paths.enter(self.paths.query.motions_of(self.short_query, found.motions))

            drive = UNITS.drive if self.answer.drives else 0.0
            yield Work(partial(self._shorten, short), units + drive, take)
            units *= 2.0

    def _shorten(self, short: Portfolio, own: Budget, enough: float = 0.0) -> _Shortened:
        """Shorten the shortest of the paths found, until its cost is `enough`."""
        paths, of = self.paths, self.short_query
        entered, self.looked = paths.entered[self.looked :], len(paths.entered)
        known = (of.motions_of(paths.query, one) for one in [*entered, paths.portfolio.best])
        shortest = min((Refiner(short.setting, one) for one in known), key=lambda one: one.cost)
        short.enter(shortest.segments)
        enough = max(enough, Bounding(of).value * (1.0 + paths.gap))
        gains, kept = True, UNITS.drive if self.answer.drives else 0.0
        while gains and own.left > kept and (short.fresh or short.cost > enough):
            work = short.work(enough)
            gains = work is not None
            if work is not None:
                work.take(work.run(own))
        gains = gains and short.cost > enough
        with suppress(PlanningError):
            found = _finished(paths.ends, of, short.best)
            length, answer = self.shortest.weighed(found, own), self._weighed(found, own)
            return _Shortened(gains, short.best, length, answer)
        return _Shortened(gains)

    def _take_shorter(self, found: _Shortened) -> None:
        """Take in the shortest path."""
        self.shortest.take(found.length)
        self.answer.take(found.answer)

    def _driving(self) -> Iterator[Work | None]:
        """Yield drives of the best path."""
        paths = self.paths
        weighed = paths.cost if paths.stop else np.inf
        static = isinstance(paths.query.problem.cost.steering_parameters, StaticSteering)
        while self.answer.drives or not static:  # else one at the end will do
            if not paths.cost < weighed:
                yield None
                continue
            weighed = paths.cost
            yield Work(
                self._weighing(Refiner(paths.setting, paths.portfolio.best)),
                UNITS.drive,
                self.answer.take,
            )

    def _weighing(self, refiner: Refiner, most: int = 0) -> Callable[[Budget], Weighed | None]:
        """Return the work of driving a path, after refining it."""

        def run(own: Budget) -> Weighed | None:
            if most:
                refiner.shortcut(own)
                refiner.polish(own, most=most)
            with suppress(PlanningError):
                return self._weighed(
                    _finished(self.paths.ends, self.paths.query, refiner.segments), own
                )
            return None

        return run

    def _weighed(self, path: Path, own: Budget) -> Weighed | None:
        """Return what driving a path takes; where too little is left for it, nothing is."""
        if self.answer.drives and own.left < UNITS.drive:
            own.spend(own.left)
            return None
        return self.answer.weighed(path, own)

    @property
    def _stops_matter(self) -> bool:
        """Whether stops take so much that other routes are searched for."""
        return self.answer.extra > STOPS.most * abs(self.answer.value)

    def _varying(self) -> Iterator[Work | None]:
        """Yield drives of paths near the best one that are best at other prices of a stop."""
        paths, varied = self.paths, -1.0
        while True:
            if varied == paths.cost or not self._stops_matter:
                yield None
                continue
            varied = paths.cost
            for factor in STOPS.prices:
                setting = paths.portfolio.setting._replace(stop=factor * paths.stop)
                run = self._weighing(Refiner(setting, paths.portfolio.best), STOPS.polish)
                yield Work(run, 2.0 * REFINING.step + UNITS.drive, self.answer.take)

    def _moving(self) -> Iterator[Work | None]:
        """Yield drives of the best path that stops, with turns at speed in place of stops."""
        answer, problem = self.answer, self.paths.query.problem
        reshaped: Path | None = None
        while True:
            if answer.path is reshaped or not self._stops_matter:
                yield None
                continue
            reshaped = answer.best()
            search = TurnSearch(problem, reshaped, answer.value)
            much = STAGES.anew * answer.value
            while not search.over and answer.value > much:
                run = partial(self._reshaped, search)
                yield Work(run, UNITS.reshaped + UNITS.drive, partial(self._take_moving, search))

    def _reshaped(self, search: TurnSearch, own: Budget) -> Weighed | None:
        """Return a drive of a path with other turns, where the search has one."""
        path = search.candidate(own)
        return None if path is None else self._weighed(path, own)

    def _take_moving(self, search: TurnSearch, found: Weighed | None) -> None:
        """Take a path with turns at speed where it is better than those before."""
        if found is not None:
            search.take(found.value)
            if found.value < self.value:
                self.moving = found

    def answered(self) -> tuple[Path, DrivenPath | None]:
        """Return the best path, and its drive where paths were driven."""
        answer, query = self.answer, self.paths.query
        if not answer.drives and isinstance(query.problem.cost.steering_parameters, StaticSteering):
            answer.weigh(_finished(self.paths.ends, query, self.paths.portfolio.best), self.budget)
        answer.take(self.moving)
        return answer.best(), answer.driven


_LEAST = 10.0  # units of work as which a step counts at least


def _at_any_rate(work: Work, budget: Budget) -> None:
    """Do some work, whatever is left."""
    own = Budget(effort=round(work.units))
    work.take(work.run(own))
    budget.spend(own.spent)


def _finished(ends: Ends, query: CompiledProblem, motions: Segments) -> Path:
    """Return the path of some motions, with arcs and spins where these are better."""
    path = ends.path(query, motions)
    if max(query.problem.radii) > 0:
        return path
    return _with_fewer_motions(query, _with_wide_arcs(query, path))


def shortened(query: CompiledProblem, path: Path, budget: Budget) -> Path:
    """Return a path that costs no more, refined until the budget is over or nothing is gained."""
    portfolio, enough = Portfolio(query.setting, 1), Bounding(query).value
    portfolio.enter(query.of_centre(path.ds, path.dtheta))
    # its first step, with the shortcuts, is done whatever is left
    if work := portfolio.work(enough):
        _at_any_rate(work, budget)
    while not budget.over and (work := portfolio.work(enough)):
        work.take(work.run(budget))
    with suppress(PlanningError):
        found = query.path(portfolio.best)
        if not max(query.problem.radii) > 0:
            found = _with_fewer_motions(query, found)
        if query.value(found) < query.value(path) and query.problem.fault(found) is None:
            return found
    return path


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
            if query.allows(fewer) and query.value(fewer) <= query.value(path) * (
                1.0 + REFINING.same
            ):
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
            if query.allows(joined):
                best[j] = totals[i]
                parts.append((joined.ds, joined.dtheta))
                whole[j] = [*whole[i], len(parts) - 1]
                break
    ds, dtheta = (np.concatenate([parts[k][n] for k in whole[-1]]) for n in (0, 1))
    found = Path(path.start, ds, dtheta, path.longitudinal)
    return found if query.allows(found) and query.value(found) < query.value(path) else path


PLANNING = tuple(f"energyplan.{of}." for of in ("planning", "terrain", "cost", "steering.kernels",
                                                "limits"))  # fmt: skip
"""What the names of the kernels begin with that planning and driving a plan may call."""

EXACT = ("energyplan.steering.polygon",)
SURFACES = ("energyplan.planning.bound.surfaces", "energyplan.terrain.surfaces")
TIGHT = ("energyplan.planning.search.narrow.escape",)
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
