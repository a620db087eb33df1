"""The lattice planner: a first plan at once, better ones until the budget is over.

`plan` calls one function a step, in this order:

1. `between_ends`: an end without room to turn is left by a short way; the rest of the steps search
   between the poses with room.
2. `find_first`: the shortest route through the free configurations is tracked by exact
   minimum-energy motions, and shortened to a first plan; other searches where that fails.
3. `_find_more`: up to four routes, each cheapest by its length and turns and the later ones away
   from the former, are tracked as well, a coarse lattice compares routes through open ground, and
   narrow passages are searched. A lower bound on every path's cost is computed in parallel.
4. `_shorten`: the shortest of all paths found is shortened with a part of what is left. It is
   the answer where length is the objective, and a plan of least energy costs no more.
5. `_refine`: the paths compete for the budget to be refined. Planning ends when the budget is
   over, the gap to the bound is closed, or nothing is gained any more.
6. `_with_fewer_stops`: where stops take energy or time, paths are compared by what driving them
   takes. Where they take much, it comes in place of the step before.

Each path gets wide arcs where the power makes them cheaper, and of paths of one cost it is the
quicker: a single spin replaces pivots back and forth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from energyplan.planning.driven import stops_count
from energyplan.planning.plans import Candidate
from energyplan.planning.problem import PlanningProblem, is_length, objective_weights
from energyplan.planning.search.first import Paths, between_ends, find_first
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.narrow.ends import surely_has_room
from energyplan.planning.search.narrow.passages import passage_work
from energyplan.planning.search.optimise import Portfolio, Refiner
from energyplan.planning.search.routes import cheapest_routes, straight_routes
from energyplan.planning.search.stops import Stops, least_driven, stops_of
from energyplan.planning.settings import LATTICE, REFINING, STOPS
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
    stops = stops_count(base.problem)
    planning = budget.part(1.0 - SHARES.aside) if stops else budget
    paths = between_ends(base, planning, gap, seed)
    known = [path for path in initial if problem.fault(path) is None]
    for path in known:
        paths.enter(base.of_centre(path.ds, path.dtheta))
    if bound is not None and base is query:
        paths.bounding.know(bound - query.potential(problem.goal))
    find_first(paths, planning)
    first = planning.elapsed
    kept = _find_more(paths, planning)
    if base is not query:
        short = _shorten(paths, query, planning, ())
        path = _finished(query, [query.path(short), *known])
        least = Bounding(query)
        if bound is not None:
            least.know(bound - query.potential(problem.goal))
        beyond = query.value(path) - query.potential(problem.goal)
        do_together(planning, least.work(beyond, kept))
        return Candidate(path, query.potential(problem.goal) + least.value, first)
    done = paths.cost <= paths.enough or planning.over
    bounding = [] if done else paths.bounding.work(paths.cost, kept)
    shortest: list[Path] = []
    if is_length(problem) or paths.cost <= paths.bounding.value * (1.0 + REFINING.same):
        do_together(planning, bounding)
    else:
        of = compiled(problem.shortest)
        short = _shorten(paths, of, planning, bounding)
        with suppress(PlanningError):
            shortest = [_finished(of, [of.path(short)])]
            paths.enter(base.motions_of(of, short))
    rivals = [*shortest, *known]
    if not stops:
        _refine(paths, planning)
        drive = Stops(_finished(query, [query.path(paths.portfolio.best), *rivals]))
    else:
        drive = _with_fewer_stops(paths, query, planning, budget, rivals)
    value = query.potential(problem.goal) + paths.bounding.value
    return Candidate(drive.path, value, first, next(iter(shortest), None), drive.driven)


def _find_more(paths: Paths, budget: Budget) -> float:
    """Find further paths for a part of the budget; return the units that are kept for a bound."""
    searching = budget.part(SHARES.stage)
    kept = SHARES.aside * budget.left
    setting, portfolio = paths.setting, paths.portfolio
    routes = partial(cheapest_routes, setting, paths.to_go, stuck=paths.stuck)
    routing = Work(routes, SHARES.stage * searching.left, paths.enter_between)
    aside = 0.5 * SHARES.aside * searching.left
    straight = partial(straight_routes, setting, paths.to_go)
    straightening = Work(straight, aside, paths.enter_hopeful)
    comparing = _compared(paths, aside)
    do_together(searching, [*portfolio.turns(paths.enough), routing, straightening, comparing])
    if searching.over or paths.cost <= paths.enough:
        return kept
    works = paths.bounding.work(paths.cost, kept)
    if not paths.through_passages:
        works += passage_work(setting, paths.to_go, searching, paths.enter_between)
    # in parallel with the next turns of the known paths, each at most half of what the former leave
    every, left = [*portfolio.turns(paths.enough), *works], searching.left
    for k, work in enumerate(every):
        every[k] = work._replace(units=min(work.units, SHARES.stage * left))
        left -= every[k].units
    do_together(searching, every)
    portfolio.run(searching, paths.enough)
    return kept


def _compared(paths: Paths, units: float) -> Work:
    """Return a search of a coarse lattice along the map's axes, which compares open routes."""
    setting = paths.setting
    lattice, start = lattice_for(setting, LATTICE.coarse), setting.start
    spin = -remainder(start.yaw - setting.space.yaw, lattice.turn)
    turned = setting._replace(start=start._replace(yaw=start.yaw + spin))
    if setting.widest > 0.0 or not motion_free(setting.space, setting.body, *start, 0.0, spin, 0.0):
        spin, turned = 0.0, setting
    search, limit = Search(turned, paths.to_go, lattice, 1.0), LATTICE.hope * paths.cost

    def enter(found: Segments | None) -> None:
        if found is not None:
            whole = Segments(np.append(0.0, found.ds), np.append(spin, found.dtheta))
            paths.enter_between([whole])

    return Work(partial(search.cheapest, limit=limit), units, enter)


def _shorten(
    paths: Paths, query: CompiledProblem, budget: Budget, beside: Iterable[Work]
) -> Segments:
    """Return the shortest of the paths found, shortened with a part of the remaining budget."""
    setting, enough = query.setting, Bounding(query).value * (1.0 + paths.gap)
    short = Portfolio(setting, paths.portfolio.seed)
    known = (query.motions_of(paths.query, one) for one in [*paths.entered, paths.portfolio.best])
    every = [Refiner(setting, motions) for motions in known]
    for one in sorted(every, key=lambda one: one.cost)[: REFINING.kept]:
        short.enter(one.segments)

    def run(own: Budget) -> None:
        short.run(own.part(SHARES.stage), enough)
        short.finish(own, enough)
        short.improve(own, enough)

    units = min(SHARES.aside * budget.left, budget.spent)
    do_together(budget, [Work(run, units, lambda _: None), *beside])
    return short.best


def _refine(paths: Paths, budget: Budget) -> None:
    """Refine the paths until the budget is over, the gap closed, or nothing is gained."""
    paths.portfolio.finish(budget, paths.enough)
    paths.portfolio.improve(budget, paths.enough)


def _with_fewer_stops(
    paths: Paths, query: CompiledProblem, planning: Budget, budget: Budget, rivals: Sequence[Path]
) -> Stops:
    """Return the path that takes least when it is driven."""
    portfolio = paths.portfolio
    if len(portfolio.best.ds) > REFINING.apart:
        planning = budget  # a path that was hardly shortened yet takes less by that
    elif budget.left > STOPS.drives * UNITS.drive:
        found = stops_of(query, query.path(portfolio.best), budget)
        if found.share >= 1.0:
            # where stops take much, all that is left is for paths that have few
            return least_driven(query, found, portfolio.known, paths.to_go, budget, rivals)
    _refine(paths, planning)
    path = _finished(query, [query.path(portfolio.best), *rivals])
    found, before = stops_of(query, path, budget), paths.cost
    if found.share < 1.0:
        # what other stops cannot bring is spent as if there were none
        portfolio.improve(budget.part(1.0 - found.share), paths.enough)
        if paths.cost < before:
            path = _finished(query, [found.path, query.path(portfolio.best)])
            found = stops_of(query, path, budget)
    return least_driven(query, found, portfolio.others, paths.to_go, budget, rivals)


def _finished(query: CompiledProblem, paths: list[Path]) -> Path:
    """Return the best of some paths with arcs and spins where these are better."""
    # the cost of a known path by the tables differs from that by the models
    if max(query.problem.radii) > 0:
        return min(paths, key=query.value)
    return _with_fewer_motions(query, _with_wide_arcs(query, min(paths, key=query.value)))


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
