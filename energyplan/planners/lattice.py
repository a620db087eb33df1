"""The lattice planner: a first plan at once, better ones until time is over.

1. A weighted search over position and heading, whose motions and whose last leg to the goal are
   exact minimum-energy motions, finds a first path; shortcuts make it a first plan.
2. A lower bound on every path's cost is computed.
3. Searches of less weight, then on finer lattices, find further paths, and each is refined until
   little is gained. Planning ends when time is over or the gap to the bound is closed.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

from energyplan.errors import InvalidInputError, NoPathError, TimeLimitError
from energyplan.path import Path
from energyplan.planners import _search_kernels as kernels
from energyplan.planners._bound import lower_bound
from energyplan.planners._problem import Plan, PlanningProblem
from energyplan.planners._query import Query, Segments
from energyplan.planners._search import Search, field_for, lattice_for
from energyplan.planners.refine import Refiner

FIRST_WEIGHT = 2.0
"""Weight of the search for the first path."""

SEARCHES = ((1.0, 1.2), (1.0, 1.0), (0.5, 1.0))
"""Scale of the lattice and weight of the searches that follow."""

SEARCH_SHARE = 0.6
"""Largest part of the time left that one of them may take."""


def plan(
    problem: PlanningProblem,
    time_limit: float = 1.0,
    *,
    gap: float = 1e-3,
    seed: int = 1,
    initial: Iterable[Path] = (),
) -> Plan:
    """Plan on a lattice, and refine with exact steering.

    Parameters
    ----------
    problem : PlanningProblem
        The problem.
    time_limit : float
        Time to plan [s]. The compilation of the kernels at their first use ever comes on top.
    gap : float
        Planning ends early when the plan costs at most this fraction more than the lower bound.
    seed : int
        Seed of the random numbers of the refinement.
    initial : iterable of Path
        Paths from start to goal, already known; the plan costs no more than any of them that is
        free of collisions.

    Returns
    -------
    Plan
        The best plan found.

    Raises
    ------
    StartInCollisionError, GoalInCollisionError, OutsideMapError
        If start or goal cannot be.
    NoPathError
        If no path exists, or none on the finest lattice.
    TimeLimitError
        If time was over before a first plan.
    """
    begun = time.perf_counter()
    if not time_limit > 0:
        raise InvalidInputError(f"time_limit is {time_limit} s; give a positive number")
    deadline = begun + time_limit
    query = Query(problem)
    work = _Improvement(query, deadline, gap, seed)
    for path in initial:
        work.offer_path(path)
    work.first_plan()
    first = time.perf_counter()
    work.improve()
    return query.plan(query.path(work.best), work.bound, begun, first, "lattice")


class _Improvement:
    """The best motions so far, and how to better them."""

    def __init__(self, query: Query, deadline: float, gap: float, seed: int) -> None:
        self.query = query
        self.setting = query.setting
        self.deadline = deadline
        self.gap = gap
        self.seed = seed
        self.field = field_for(self.setting)
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.bound = 0.0

    @property
    def done(self) -> bool:
        """Whether to stop."""
        closed = self.cost <= self.bound * (1.0 + self.gap)
        return closed or time.perf_counter() >= self.deadline

    def offer(self, refiner: Refiner) -> None:
        """Take a refined path if it is the best so far."""
        if refiner.cost < self.cost:
            self.cost, self.best = refiner.cost, refiner.segments

    def offer_path(self, path: Path) -> None:
        """Take a path that somebody else made, if it can be driven from start to goal."""
        problem = self.query.problem
        ends = np.array(path.start), np.array(path.end)
        wanted = np.array(problem.start), np.array(problem.goal)
        for have, want in zip(ends, wanted, strict=True):
            miss = have - want
            miss[2] = np.remainder(miss[2] + np.pi, 2 * np.pi) - np.pi
            if np.abs(miss).max() > 1e-6:
                return
        if path.longitudinal == problem.cost.icr.longitudinal and problem.map.path_free(
            path, problem.robot
        ):
            lateral = problem.cost.icr.centre[1]
            motions = Segments(path.ds - lateral * path.dtheta, path.dtheta)
            refiner = Refiner(self.setting, motions, self.seed)
            self.cost, self.best = refiner.cost, motions
            refiner.shortcut()
            self.offer(refiner)

    def first_plan(self) -> None:
        """Find a first path, on finer lattices where the first one has none."""
        start = Search(self.setting, self.field, lattice_for(self.setting), FIRST_WEIGHT)
        if not np.isfinite(start.tree.h[0]):
            raise NoPathError(self._no_path("a disc inside the footprint cannot get through"))
        if np.isfinite(self.cost):
            return
        for scale in (1.0, 0.5, 0.25):
            search = Search(
                self.setting, self.field, lattice_for(self.setting, scale), FIRST_WEIGHT
            )
            status = search.run(self.deadline, stop_at_first=True)
            if search.found:
                refiner = Refiner(self.setting, search.segments(), self.seed)
                refiner.shortcut()
                self.offer(refiner)
                return
            if status != kernels.EXHAUSTED:
                raise TimeLimitError(
                    f"no path was found in time: {int(search.tree.counts[2])} places were "
                    f"searched in cells of {search.lattice.cell:.3g} m; give more time_limit"
                )
        raise NoPathError(self._no_path(f"none was found in cells of {search.lattice.cell:.3g} m"))

    def _no_path(self, why: str) -> str:
        start, goal = self.query.problem.start, self.query.problem.goal
        return (
            f"no path leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}): "
            f"{why}; check the map for closed doors and unknown cells"
        )

    def improve(self) -> None:
        """Make the path cheaper until time is over or the gap is closed."""
        self.bound = lower_bound(self.query, self.cost)
        for scale, weight in SEARCHES:
            if self.done:
                return
            search = Search(self.setting, self.field, lattice_for(self.setting, scale), weight)
            # what is found must be refined before the deadline
            search.run(self._share(SEARCH_SHARE), stop_at_first=False)
            if search.found:
                self._refined(search.segments(), self.seed, self._share(1.0 - SEARCH_SHARE))
        seed = self.seed
        while not self.done:
            seed += 1
            before = self.cost
            self._refined(self.best, seed, self.deadline)
            if seed > self.seed + 3 and self.cost > before * (1 - 1e-5):
                return

    def _share(self, fraction: float) -> float:
        """Return the moment at which this fraction of the time left will be over."""
        now = time.perf_counter()
        return now + fraction * max(self.deadline - now, 0.0)

    def _refined(self, segments: Segments, seed: int, deadline: float) -> None:
        """Refine motions, and keep them if they are the best so far."""
        refiner = Refiner(self.setting, segments, seed)
        refiner.shortcut()
        enough = self.bound * (1.0 + self.gap)
        refiner.polish(deadline, enough=enough)
        refiner.again()
        refiner.polish(deadline, enough=enough)
        self.offer(refiner)
