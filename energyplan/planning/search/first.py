"""The first path: the straight motion, routes that are tracked, narrow passages, in turn.

What none of these finds is proven to be closed, or refused with how near the search got.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from energyplan.compilation import compile_kernels
from energyplan.planning.bound import Bounding
from energyplan.planning.budget import SHARES, Budget
from energyplan.planning.ends import Ends
from energyplan.planning.search.lattice import joined
from energyplan.planning.search.narrow.infeasible import (
    Proof,
    Prover,
    check_configurations,
    check_proof,
    none_found,
    none_in_time,
)
from energyplan.planning.search.narrow.passages import paths_through_passages
from energyplan.planning.search.optimise import Portfolio, Refiner
from energyplan.planning.search.routes import cheapest_routes
from energyplan.planning.search.tracking import Tracked, track_route
from energyplan.planning.settings import ROUTES
from energyplan.planning.space.compiled import CompiledProblem, Segments
from energyplan.planning.space.cost_to_go import CostToGo
from energyplan.planning.space.motions import KernelProblem
from energyplan.planning.space.places import places_for


@dataclass
class Paths:
    """The paths known, and what is known for finding and judging them."""

    ends: Ends  # where searches begin and end
    gap: float  # part of the bound that a path may cost more
    portfolio: Portfolio
    bounding: Bounding  # lower bound of the cost of every path
    entered: list[Segments] = field(default_factory=list)
    stuck: list[Tracked] = field(default_factory=list)  # routes that could not be tracked
    through_passages: bool = False  # whether narrow passages were searched
    stop: float = 0.0  # price of a stop

    @property
    def query(self) -> CompiledProblem:
        """The problem."""
        return self.ends.query

    @property
    def to_go(self) -> CostToGo:
        """The cost-to-go between the ends of searches."""
        return self.ends.to_go

    @property
    def setting(self) -> KernelProblem:
        """The problem between the ends of searches, as the kernels see it."""
        return self.ends.between._replace(stop=self.stop)

    def price_stops(self, stop: float) -> None:
        """Compare and refine paths with a price of every stop from now on."""
        self.stop = stop
        self.portfolio = self.portfolio.priced(stop)

    @property
    def cost(self) -> float:
        """Cost of the best path so far."""
        return self.portfolio.cost + self.ends.cost

    @property
    def enough(self) -> float:
        """Cost at which the gap is closed."""
        return self.bounding.value * (1.0 + self.gap)

    def enter(self, motions: Segments) -> None:
        """Enter motions between the outer ways, free of collisions."""
        self.entered.append(motions)
        self.portfolio.enter(motions)

    def enter_between(self, several: Iterable[Segments]) -> bool:
        """Enter motions between the ends of searches; return whether there are any."""
        found = list(several)
        for motions in found:
            self.enter(self.ends.whole(motions))
        return bool(found)

    def enter_hopeful(self, several: Iterable[Segments]) -> None:
        """Enter those of several motions whose cost is not far above that of the best path."""
        for motions in several:
            cost = Refiner(self.setting, motions).cost
            if cost <= ROUTES.hope * self.cost:
                self.enter_between([motions])


def find_first(paths: Paths, budget: Budget) -> None:
    """Find a first path, by one way after the other, or raise why there is none."""
    if np.isfinite(paths.cost):
        return
    query, setting, to_go = paths.query, paths.setting, paths.to_go
    if not paths.ends.moved:
        check_configurations(query, to_go)
    # where the poses tested do not join start and goal, a search among them is in vain
    tested = to_go.places is places_for(setting)
    proof = None if tested else _proof(query, setting, budget)
    # the exact motion from end to end is straighter than any route
    motions, cost = joined(setting, setting.start, setting.goal)
    direct = paths.enter_between([motions] if cost < np.inf else [])
    if _track_shortest(paths, budget) or direct:
        return
    routing = budget.part(SHARES.stage)
    if paths.enter_between(cheapest_routes(setting, to_go, routing, paths.stuck)):
        return
    if tested:
        found = paths_through_passages(setting, None, budget.part(SHARES.aside))
        paths.through_passages = paths.enter_between(found)
        if found:
            return
    # between ends without room there may be a way where no pose near them is free
    if proof is not None and (paths.ends.moved or query.ends_have_margin):
        check_proof(query, setting, proof)
    near = [(one.x, one.y) for one in paths.stuck]
    if not (routing.over or budget.over):
        raise none_found(query, to_go.places.spacing, near)
    joins = "join start and goal, but motions along them do not yet"
    none = "that were tested do not join start and goal"
    raise none_in_time(query, budget, f"the free poses {joins if tested else none}", near)


def _track_shortest(paths: Paths, budget: Budget) -> bool:
    """Enter the path along the shortest route, if it can be tracked; return whether it can."""
    tracked = track_route(paths.setting, paths.to_go, budget)
    if tracked.motions is None:
        paths.stuck.append(tracked)
        return False
    return paths.enter_between([tracked.motions])


def _proof(query: CompiledProblem, setting: KernelProblem, budget: Budget) -> Proof:
    """Look closer at what the poses tested leave open."""
    budget.beside(lambda: compile_kernels(Proof.__module__))
    found = Prover(setting, budget.part(SHARES.stage)).found()
    if found.proven:
        check_proof(query, setting, found)
    return found
