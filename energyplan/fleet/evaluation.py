"""From a fleet to its report: assign, plan the routes in use, run all batteries together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from energyplan.errors import MissionError
from energyplan.fleet.bound import least_energy
from energyplan.fleet.exact import Solution, is_small, solve
from energyplan.fleet.problem import Docks, Sources
from energyplan.fleet.search import solve_by_search
from energyplan.fleet.types import Fleet, FleetReport, LeftOut, RobotReport
from energyplan.kinds import checked
from energyplan.mission import Stop
from energyplan.mission.condition import Condition
from energyplan.mission.legs import Legs, Routes
from energyplan.mission.report import StopKind
from energyplan.mission.simulation import Walk

_ROUNDS, _SEARCH_ROUNDS = 60, 3
"""Rounds of assigning and planning: of exact answers, and of searches."""

_SEARCH_TIME = 3.0
"""Time of each search [s]."""

_SEARCH_EFFORT = 300
"""Orders that each search may accept, where work is counted in effort."""

_LEAST_SCALE = 0.8
"""Part of its energy that a battery is trusted to hold at least."""


@checked(MissionError)
def evaluate_fleet(fleet: Fleet, progress: Callable[[str], None] | None = None) -> FleetReport:
    """Tell who does what and charges when: required tasks first, then prizes, then energy.

    Source: docs/fleets.
    """
    routes = Routes()
    walks = tuple(Walk(Legs(robot.mission, progress, routes)) for robot in fleet.robots)
    sources = Sources(fleet, walks)
    tasks = fleet.tasks
    prizes = np.array([task.prize for task in tasks])
    worth = prizes + np.where([task.required for task in tasks], 1.0 + prizes.sum(), 0.0)
    places = [fleet.places.get(charger.name, 1) for charger in fleet.chargers]
    exact = is_small(len(walks), len(tasks))
    counted = all(walk.mission.planning_effort is not None for walk in walks)
    settled = False
    for turn in range(_ROUNDS if exact else _SEARCH_ROUNDS):
        problems = [sources.problem(r) for r in range(len(walks))]
        if exact:
            found = solve(problems, worth, places)
        else:
            found = solve_by_search(
                problems, worth, places, time_limit=_SEARCH_TIME,
                effort=_SEARCH_EFFORT if counted else None,
            )  # fmt: skip
        wanted = [
            (r, *pair) for r, stops in enumerate(found.sequences) for pair in sources.used(r, stops)
        ]
        if progress is not None:
            progress(f"assignment {turn + 1}: {len(wanted)} routes to plan")
        for r, i, j in wanted:
            walks[r].legs.leg(i, j, walks[r].mission.payload)
        if wanted:
            continue
        driven = _Drive(fleet, sources, places).run(found.sequences)
        weak = [r for r in driven.weak if sources.scale[r] >= _LEAST_SCALE]
        if not weak:
            settled = True
            break
        sources.scale[weak] *= 0.98
    driven = _Drive(fleet, sources, places).run(found.sequences)
    if not exact:
        number = {task.name: k for k, task in enumerate(tasks)}
        done = sorted(number[name] for names in driven.done for name in names)
        bound = least_energy(problems, np.array(done, int), found.energy)
        found = replace(found, bound=bound)
    return _report(fleet, walks, driven, found, settled)


@dataclass
class _Drive:
    """All robots on their way, in the batteries and not only in sums."""

    fleet: Fleet
    sources: Sources
    places: list[int]
    states: list[Condition] = field(default_factory=list)
    stops: list[list[Stop]] = field(default_factory=list)
    done: list[list[str]] = field(default_factory=list)
    waited: list[float] = field(default_factory=list)
    weak: list[int] = field(default_factory=list)
    ended: list[bool] = field(default_factory=list)

    def run(self, sequences: tuple[tuple[int, ...], ...]) -> _Drive:
        """Drive all sequences together; what cannot be done is passed over."""
        walks = self.sources.walks
        docks = Docks(self.places)
        self.states = [walk.start for walk in walks]
        self.waited = [0.0] * len(walks)
        self.done = [[] for _ in walks]
        self.stops = [[self._stop(r, "start", walk.start.time)] for r, walk in enumerate(walks)]
        left = [list(stops) for stops in sequences]
        for r in range(len(walks)):
            self._to_charger(r, left[r])
        while any(left):
            arrival, r = min((self.states[r].time, r) for r in range(len(walks)) if left[r])
            charger = left[r].pop(0) - 1 - len(self.fleet.tasks)
            wait = docks.wait(charger, arrival)
            self.waited[r] += wait
            waiting = walks[r].wait(self.states[r], wait)
            self.states[r] = walks[r].charge(waiting)
            docks.occupy(charger, self.states[r].time)
            self.stops[r].append(self._stop(r, "charge", arrival))
            self._to_charger(r, left[r])
        self.ended = []
        for r, walk in enumerate(walks):
            last = walk.finish(self.states[r])
            self.ended.append(last is not None)
            if last is None:
                self._weakened(r)
            else:
                self.states[r] = last
            self.stops[r].append(self._stop(r, "end", self.states[r].time))
        return self

    def _to_charger(self, r: int, left: list[int]) -> None:
        """Do tasks up to the arrival at the next charger, which stays in the list."""
        walk, n = self.sources.walks[r], len(self.fleet.tasks)
        while left:
            node = self.sources.nodes[r][left[0]]
            if left[0] > n:
                there = walk.drive(self.states[r], node)
                if there is not None and walk.holds(there):
                    self.states[r] = there
                    return
                self._weakened(r)
                left.pop(0)
                continue
            arrival = walk.drive(self.states[r], node)
            attempt = walk.attempt(self.states[r], node - 1)
            left.pop(0)
            if attempt.reason != "none" or arrival is None:
                self._weakened(r)
                continue
            self.states[r] = attempt.after
            self.done[r].append(walk.mission.tasks[node - 1].name)
            self.stops[r].append(self._stop(r, "task", arrival.time))

    def _weakened(self, r: int) -> None:
        if r not in self.weak:
            self.weak.append(r)

    def _stop(self, r: int, kind: StopKind, arrival: float) -> Stop:
        walk, state = self.sources.walks[r], self.states[r]
        legs = walk.legs
        charge = state.expected.soc, state.worst.soc
        return Stop(
            legs.names[state.node], kind, legs.poses[state.node], arrival, state.time, *charge
        )


def _report(
    fleet: Fleet, walks: tuple[Walk, ...], driven: _Drive, found: Solution, settled: bool
) -> FleetReport:
    robots = []
    for r, (robot, walk) in enumerate(zip(fleet.robots, walks, strict=True)):
        end = driven.states[r]
        robots.append(
            RobotReport(
                name=robot.name,
                tasks=tuple(driven.done[r]),
                route=tuple(driven.stops[r]),
                energy=end.total.mean,
                energy_upper=end.total.upper(walk.quantile),
                soc_end=end.expected.soc,
                soc_end_lower=end.worst.soc,
                duration=end.time - robot.mission.time,
                waiting=driven.waited[r],
                end=end,
            )
        )
    done = {name for robot in robots for name in robot.tasks}
    left_out = tuple(
        LeftOut(task.name, task.required, _why(walks, task.name))
        for task in fleet.tasks
        if task.name not in done
    )
    payload = any(task.payload for task in fleet.tasks)
    whole = settled and not driven.weak
    gap = np.nan
    if np.isfinite(found.energy):
        gap = 0.0 if found.energy == found.bound else 1.0 - found.bound / found.energy
    return FleetReport(
        fleet=fleet,
        robots=tuple(robots),
        left_out=left_out,
        energy=sum(robot.energy for robot in robots),
        energy_upper=sum(robot.energy_upper for robot in robots),
        proven=found.proven and whole and not payload,
        gap=gap,
        feasible=all(driven.ended) and not any(task.required for task in left_out),
    )


def _why(walks: tuple[Walk, ...], name: str) -> tuple[str, ...]:
    """Return for each robot that could do a task why it cannot, were there nothing else to do."""
    reasons = []
    for walk in walks:
        names = [task.name for task in walk.mission.tasks]
        if name in names:
            reasons.append(walk.attempt_charged(walk.start, names.index(name)).reason)
    if not reasons:
        raise MissionError(f"no robot lists the task {name!r}")
    return tuple(reasons)
