"""The lattice planner: a first plan at once, better ones until the budget is over.

1. The shortest route through the free configurations is followed by exact minimum-energy motions:
   a first path, and with shortcuts a first plan.
2. Up to four routes, each cheapest by its length and turns and the later ones away from the former,
   are followed as well. A lower bound on every path's cost is computed.
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

import numpy as np

from energyplan import steering
from energyplan.cost.steering import StaticSteering
from energyplan.errors import InvalidInputError, PlanningError
from energyplan.kinds import checked
from energyplan.path import FloatArray, Path
from energyplan.planning.bound import Bounding
from energyplan.planning.budget import Budget, Work, do_together
from energyplan.planning.contract import Candidate
from energyplan.planning.driven import stops_count
from energyplan.planning.lattice.paths import Paths
from energyplan.planning.lattice.refine import SAME
from energyplan.planning.lattice.stops import SHARE, least_driven, stops_of
from energyplan.planning.lattice.tight_ends import ways_out
from energyplan.planning.problem import PlanningProblem, is_length, objective_weights
from energyplan.planning.scene.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.scene.guide import regions_for

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
    led = query.leading
    budget.beside(lambda: regions_for(led.setting))
    known = query.drivable(initial)
    # a path between tight ends may prove not to be free: then planning is done anew
    whole, stops = budget, stops_count(led.problem)
    budget = _without_stops(led, whole)
    work = Paths(led, _searching(led, budget), gap, seed)
    if bound is not None and led is query:
        work.bounding.know(bound - query.potential(problem.goal))
    for path in known:
        work.offer_path(path)
    work.first_plan(finest)
    first = budget.elapsed

    def path_of(of: CompiledProblem, motions: Segments, own: Budget) -> Path:
        """Return the path of some motions."""
        try:
            return of.path(motions)
        except PlanningError:
            ends = ways_out(of, own, turn=0.0)[0]
            if not ends.eased:
                raise
            inner = plan(ends.problem, own.part(0.5), gap=gap, seed=seed, finest=finest)
            return ends.refined(inner.path, own)

    def shortest_path(*beside: Work) -> Path:
        """Return the shortest path; what that takes does not depend on what is done beside."""
        of = compiled(problem.shortest) if led is query else query
        motions = work.shortest(of, *beside)
        own = budget.apart(work.kept)
        try:
            path = path_of(of, motions, own)
            work.enter(led.motions_of(of, motions))
        finally:
            budget.spend(own.spent)
        return _finished(of, [path])

    work.search()
    shortest: list[Path] = []
    if led is not query:
        with suppress(PlanningError):
            shortest = [shortest_path()]
        shortest = shortest or [path_of(led, work.portfolio.best, budget)]
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
    path = _finished(query, [path_of(led, work.portfolio.best, budget), *shortest, *known])
    if stops:
        found = stops_of(query, path, whole)
        if found.share < 1.0 and query.ends_roomy and work.go_on(whole.part(1.0 - found.share)):
            # what other stops cannot bring is spent as if there were none
            path = _finished(query, [path, query.path(work.portfolio.best)])
            found = stops_of(query, path, whole)
        path = least_driven(
            query, path, found, work.portfolio.others, work.to_go, whole, [*shortest, *known]
        )
    return Candidate(path, query.potential(problem.goal) + work.bound, first)


def _without_stops(led: CompiledProblem, budget: Budget) -> Budget:
    """Return a budget without what is kept for stops, where they count."""
    return budget.part(1.0 - SHARE) if stops_count(led.problem) else budget


def _searching(led: CompiledProblem, budget: Budget) -> Budget:
    """Return a budget without what is kept for planning anew between tight ends."""
    return budget if led.ends_roomy else budget.part(0.5)


def _finished(query: CompiledProblem, paths: list[Path]) -> Path:
    """Return the best of some paths with arcs and spins where these are better."""
    # what the tables made of the cost of a known path is not what the models make of it
    if query.problem.least_radius > 0:
        return min(paths, key=query.value)
    return _with_fewer_motions(query, _with_wide_arcs(query, min(paths, key=query.value)))


_ROUNDING = 1e-9
"""Distance [m] or angle [rad] up to which two count as one."""


def _with_fewer_motions(query: CompiledProblem, path: Path) -> Path:
    """Return a path of the same cost in which a single spin stands for pivots that end in place.

    A spin and pivots of the same turning cost the same where only the turning counts. The spin is
    driven at once; each pivot begins and ends with a stop.
    """
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
        for last in (np.flatnonzero(away <= _ROUNDING) + first + 2)[::-1]:
            turn = float(dtheta[first:last].sum())
            # turning back and forth is not what a spin does
            if np.abs(dtheta[first:last]).sum() > abs(turn) + _ROUNDING:
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
            if problem.terrain.obstacles.path_free(joined, problem.robot):
                best[j] = totals[i]
                parts.append((joined.ds, joined.dtheta))
                whole[j] = [*whole[i], len(parts) - 1]
                break
    ds, dtheta = (np.concatenate([parts[k][n] for k in whole[-1]]) for n in (0, 1))
    found = Path(path.start, ds, dtheta, path.longitudinal)
    free = problem.terrain.obstacles.path_free(found, problem.robot)
    return found if free and query.value(found) < query.value(path) else path
