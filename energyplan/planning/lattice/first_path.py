"""The first path: along a guide, through slots, or by searches on lattices ever finer."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from energyplan.compilation import compile_kernels
from energyplan.path import Path
from energyplan.planning.budget import Budget, side_by_side
from energyplan.planning.lattice import search_kernels as kernels
from energyplan.planning.lattice.portfolio import Bounding, Portfolio
from energyplan.planning.lattice.search import Search, lattice_for
from energyplan.planning.lattice.slots import way_through_slots
from energyplan.planning.lattice.tight_ends import Ends, ways_out
from energyplan.planning.lattice.way_along import led_along
from energyplan.planning.scene import closure_kernels
from energyplan.planning.scene.closure import (
    Closure,
    check_closer,
    check_configurations,
    closure,
    none_found,
    none_in_time,
)
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import TURNS, distance_to_go, places_for, reached, regions_for
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem

FIRST_WEIGHT = 2.0
"""Weight of the search for the first path."""

PENALTY = 8.0
"""How much longer a tight place counts for that search."""

WAYS = (PENALTY, 2.0, 1.0)
"""And for the ways along guides."""

FIELD_SHARE = 0.4
"""Part of what is left that a distance to go may take before a first path is known, about."""

MOST_LATTICES = 16
"""Lattices on which a first path is sought, each half as coarse as the one before."""

ESCAPE_SHARE = 0.25
"""Part of the budget that ways out of tight ends may take."""

CLOSURE_SHARE = 0.5
"""Part of the budget that may be taken to find out that there is no way."""

FIRST_TURN = 4000
"""Expansions of the search for a first path before a finer one joins it; then twice as many."""


class Attempt(NamedTuple):
    """A search for a first path: between which ends, and on how fine a lattice."""

    ends: Ends
    scale: float
    search: Search


class FirstPath:
    """The best motions so far, and how the first ones are found."""

    def __init__(self, query: CompiledProblem, budget: Budget, gap: float, seed: int) -> None:
        self.query = query
        self.setting = query.setting
        self.budget = budget
        self.gap = gap
        self.portfolio = Portfolio(self.setting, seed)
        self.found: list[Segments] = []
        self.ends = Ends(query)
        self.fields: dict[float, DistanceToGo] = {}
        self.bounding = Bounding(query)
        self._through_slots = False
        self._led: list[tuple[float, float]] = []

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

    def offer_path(self, path: Path) -> None:
        """Take a path that somebody else made, and that can be driven from start to goal."""
        self.enter(self.query.of_centre(path))

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
        # where the poses tested do not join start and goal, a search among them is in vain
        setting = self.ends.between(self.setting)
        tested = self.field(PENALTY).places is places_for(setting)
        closed = None if tested else self._closed(setting)
        for penalty in WAYS:
            if self._enter_way(penalty):
                return
        if not tested and self._enter_slots():
            return
        # between ends without room there may be a way where no pose beside them is free
        if closed is not None and (self.ends.eased or self.query.ends_roomy):
            check_closer(self.query, setting, closed)
        self._search_first(plain, finest, tested)

    def _search_first(self, plain: Ends, finest: float, tested: bool) -> None:
        """Search lattices for a first path, the coarsest first; finer ones join one by one."""
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
                self.enter(one.ends.whole(one.search.segments()))
            if found:
                if not any(one.ends is self.ends for one in found):
                    self._move_ends(plain)
                return
            if tested and turn == FIRST_TURN and self._enter_slots():
                return
            pairs = zip(open_ones, states, strict=True)
            open_ones = [one for one, state in pairs if state != kernels.EXHAUSTED]
            turn *= 2
        if places := sum(int(one.search.tree.counts[2]) for one in every):
            cell = every[-1].search.lattice.cell
            done = f"{places} places were searched in cells down to {cell:.3g} m"
        elif tested:
            done = "free poses join start and goal, but motions along them do not yet"
        else:
            done = "the free poses that were tested do not join start and goal"
        near = [*self._led, *(one.search.nearest for one in every)]
        raise none_in_time(self.query, self.budget, done, near)

    def _enter(self, way: Segments | None) -> None:
        """Enter a way between the ends, if there is one."""
        if way is not None:
            self.enter(self.ends.whole(way))

    def _enter_way(self, penalty: float) -> bool:
        """Enter the way that a guide knows, if it is one; tell whether it is."""
        led = led_along(self.ends.between(self.setting), self.field(penalty), self.budget)
        self._led.append((led.x, led.y))
        self._enter(led.motions)
        return led.motions is not None

    def _enter_slots(self) -> bool:
        """Enter a way through slots that no pose tested shows; tell whether one is found."""
        setting = self.ends.between(self.setting)
        self.budget.beside(lambda: regions_for(setting, enlarged=True))
        way = way_through_slots(setting, None, np.inf, self.budget.part(ESCAPE_SHARE))
        self._through_slots = way is not None
        self._enter(way)
        return self._through_slots

    def _closed(self, setting: KernelProblem) -> Closure:
        """Look closer at what the poses tested leave open."""
        self.budget.beside(lambda: compile_kernels(closure_kernels.__name__))
        found = closure(setting, self.budget.part(CLOSURE_SHARE))
        if found.proven:
            check_closer(self.query, setting, found)
        return found

    def _move_ends(self, ends: Ends) -> None:
        """Have searches begin and end elsewhere."""
        self.ends = ends
        self.fields.clear()

    def field(self, penalty: float) -> DistanceToGo:
        """Return the distance to go, with tight places counted longer."""
        if penalty not in self.fields:
            most = FIELD_SHARE * self.budget.left
            found = distance_to_go(self.ends.between(self.setting), penalty, most)
            self.budget.spend(found.work / TURNS)
            self.fields[penalty] = found
        return self.fields[penalty]
