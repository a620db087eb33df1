"""What each robot takes for what, and what comes of sequences of stops that all drive together.

Energies at the bound add up; those between places are of planned routes, and lower bounds where
none is planned yet. Chargers serve those first who come first.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.fleet.types import Fleet
from energyplan.mission.energy import Estimate
from energyplan.mission.simulation import Walk
from energyplan.path import FloatArray

_SLACK = 1e-9


@dataclass(frozen=True)
class RobotProblem:
    """One robot's part. Node 0 is its start, 1 to n the tasks, then the chargers."""

    energy: FloatArray  # (N, N): from node to node [J], [s]
    time: FloatArray  # (N, N): from node to node [J], [s]
    finish: FloatArray  # (N,): to the nearest place where it may end
    finish_time: FloatArray  # (N,): to the nearest place where it may end
    refuge: FloatArray  # (N,): energy to the nearest place of safety, home or a charger [J]
    service: FloatArray  # (n,): what each task takes [J], [s]
    service_time: FloatArray  # (n,): what each task takes [J], [s]
    idle: FloatArray  # (N,): power of standing still [W]
    window: FloatArray  # (n, 2): earliest and latest start of each task [s]
    budget: float  # energy at the start, the reserve taken off [J]
    capacity: FloatArray  # (m,)
    charge_power: FloatArray  # (m,)
    start_time: float = 0.0  # time at the start [s]

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.service)

    @property
    def timed(self) -> bool:
        """Whether windows matter."""
        return bool(
            np.any(self.window[:, 0] > self.start_time) or np.isfinite(self.window).all(1).any()
        )


class Status(NamedTuple):
    """A robot under way."""

    node: int  # where it is
    left: float  # energy left in its battery, and spent in all [J]
    spent: float  # energy left in its battery, and spent in all [J]
    time: float  # time [s]


def begin(problem: RobotProblem) -> Status:
    """Return the status of a robot at its start."""
    return Status(0, problem.budget, 0.0, problem.start_time)


def arrive(problem: RobotProblem, status: Status, goal: int) -> Status:
    """Drive to a node, whatever is left then."""
    energy = float(problem.energy[status.node, goal])
    time = float(problem.time[status.node, goal])
    return Status(goal, status.left - energy, status.spent + energy, status.time + time)


def do_task(problem: RobotProblem, status: Status, task: int) -> Status | None:
    """Drive to a task and do it; None where it is too late or the charge does not suffice."""
    there = arrive(problem, status, task + 1)
    earliest, latest = problem.window[task]
    if there.time > latest:
        return None
    wait = max(float(earliest) - there.time, 0.0)
    taken = float(problem.service[task]) + float(problem.idle[task + 1]) * wait
    left = there.left - taken
    if left < problem.refuge[task + 1] - _SLACK:
        return None
    time = there.time + wait + float(problem.service_time[task])
    return Status(task + 1, left, there.spent + taken, time)


def charge(problem: RobotProblem, status: Status, wait: float = 0.0) -> Status | None:
    """Wait for so long [s] at a charger and charge; None where nothing was left."""
    charger = status.node - 1 - problem.tasks
    taken = float(problem.idle[status.node]) * wait
    left = status.left - taken
    if left < -_SLACK:
        return None
    full = max(float(problem.capacity[charger]), left)
    time = status.time + wait + (full - left) / float(problem.charge_power[charger])
    return Status(status.node, full, status.spent + taken, time)


def end(problem: RobotProblem, status: Status) -> Status | None:
    """Drive to the nearest place where it may end; None where the charge does not suffice."""
    energy = float(problem.finish[status.node])
    if status.left < energy - _SLACK:
        return None
    time = status.time + float(problem.finish_time[status.node])
    return Status(status.node, status.left - energy, status.spent + energy, time)


class Sources:
    """The problems of a fleet, from the routes that are planned so far."""

    def __init__(self, fleet: Fleet, walks: tuple[Walk, ...]) -> None:
        self.fleet, self.walks = fleet, walks
        self.scale = np.ones(len(walks))
        names = [task.name for task in fleet.tasks]
        own = [[task.name for task in robot.mission.tasks] for robot in fleet.robots]
        n, m = len(names), len(fleet.chargers)
        self.nodes: list[dict[int, int]] = []
        for tasks in own:
            first = 1 + len(tasks)
            nodes = {0: 0, **{1 + n + c: first + c for c in range(m)}}
            nodes |= {1 + k: 1 + tasks.index(name) for k, name in enumerate(names) if name in tasks}
            self.nodes.append(dict(sorted(nodes.items())))

    def ends(self, robot: int) -> list[int]:
        """Nodes of a robot's legs where it may end."""
        walk = self.walks[robot]
        rule, legs = walk.mission.return_to, walk.legs
        ends = [] if rule == "charger" else [legs.home]
        return ends if rule == "start" else [*ends, *legs.chargers]

    def problem(self, robot: int) -> RobotProblem:
        """Return a robot's part on what is known now."""
        walk = self.walks[robot]
        legs, mission = walk.legs, walk.mission
        grounds, payload = legs.grounds, mission.payload
        energy = legs.lower_bounds(payload).copy()
        apart = np.linalg.norm(
            np.array(legs.poses)[:, None, :2] - np.array(legs.poses)[None, :, :2], axis=-1
        )
        cost = legs.cost(payload)[0]
        time = apart / float(cost.admissible_speed(0.0))
        for i, j in np.argwhere(np.ones_like(energy)):
            if legs.planned(int(i), int(j)):
                leg = legs.leg(int(i), int(j), payload)
                fine = np.isfinite(leg.energy.mean)
                energy[i, j] = self._upper(robot, leg.energy) if fine else np.inf
                time[i, j] = leg.duration
        fleet, nodes = self.fleet, self.nodes[robot]
        n, m = len(fleet.tasks), len(fleet.chargers)
        size = 1 + n + m
        mine, theirs = np.array(list(nodes)), np.array(list(nodes.values()))

        def spread(values: FloatArray) -> FloatArray:
            whole = np.full((size,) * values.ndim, np.inf)
            whole[np.ix_(*[mine] * values.ndim)] = values[np.ix_(*[theirs] * values.ndim)]
            return whole

        time *= 1.0 + walk.quantile * mission.spreads.speed
        for own in range(len(mission.tasks)):  # lost before a task begins
            wait = np.linalg.norm(grounds.waiting_time(own))
            time[:, 1 + own] += mission.waiting + walk.quantile * float(wait)
        ends = self.ends(robot)
        safe = [legs.home, *legs.chargers]
        nearest = energy[:, ends].argmin(axis=1)
        finish_time = time[np.arange(len(time)), np.array(ends)[nearest]]
        still = [grounds.idle(legs.region(k), 1.0, payload) for k in range(len(energy))]
        idle = np.array([self._upper(robot, one) for one in still])
        service, service_time = np.zeros(n), np.zeros(n)
        for k, task in enumerate(fleet.tasks):
            if 1 + k in nodes:
                own = nodes[1 + k] - 1
                region = legs.region(own + 1)
                done = grounds.waiting(region, own, payload) + grounds.work(region, own, payload)
                service[k] = self._upper(robot, done)
                dwell = np.linalg.norm(grounds.dwell_time(own))
                service_time[k] = task.dwell + walk.quantile * float(dwell)
        reserve, scale = self._stored(robot, mission.reserve), float(self.scale[robot])
        return RobotProblem(
            energy=spread(energy),
            time=spread(time),
            finish=spread(energy[:, ends].min(axis=1)),
            finish_time=spread(finish_time),
            refuge=spread(energy[:, safe].min(axis=1)),
            service=service,
            service_time=service_time,
            idle=np.nan_to_num(spread(idle), posinf=0.0),
            window=np.array([task.window for task in fleet.tasks], float).reshape(n, 2),
            budget=scale * (self._stored(robot, walk.at_least(mission.soc)) - reserve),
            capacity=np.array(
                [
                    scale * (self._stored(robot, walk.at_least(c.until)) - reserve)
                    for c in mission.chargers
                ]
            ),
            charge_power=np.array([c.power for c in mission.chargers])
            * mission.battery.charge_efficiency,
            start_time=mission.time,
        )

    def _upper(self, robot: int, energy: Estimate) -> float:
        """Return an energy at the bound, as the battery feels it [J]."""
        walk = self.walks[robot]
        return walk.legs.grounds.from_battery(energy).upper(walk.quantile)

    def _stored(self, robot: int, soc: float) -> float:
        """Energy that a battery gives up to empty at the power of driving straight on [J]."""
        walk = self.walks[robot]
        power = walk.legs.grounds.driving_power
        return float(walk.mission.battery.usable_energy(power, soc))

    def used(self, robot: int, stops: tuple[int, ...]) -> list[tuple[int, int]]:
        """Routes that a robot's stops use, its way to the end included, as nodes of its legs."""
        walk, nodes = self.walks[robot], self.nodes[robot]
        there = [0, *(nodes[stop] for stop in stops)]
        energy = self._known_row(robot, there[-1])
        ends = self.ends(robot)
        last = ends[int(np.argmin(energy[ends]))]
        pairs = [*itertools.pairwise(there), (there[-1], last)]
        return [(i, j) for i, j in pairs if not walk.legs.planned(i, j)]

    def _known_row(self, robot: int, node: int) -> FloatArray:
        walk = self.walks[robot]
        legs, payload = walk.legs, walk.mission.payload
        row = legs.lower_bounds(payload)[node].copy()
        for j in range(len(row)):
            if legs.planned(node, j):
                energy = legs.leg(node, j, payload).energy
                fine = np.isfinite(energy.mean)
                row[j] = self._upper(robot, energy) if fine else np.inf
        return np.asarray(row)


class Docks:
    """Chargers with so many places each; robots are served in the order of their arrival."""

    def __init__(self, places: Sequence[int]) -> None:
        self._free = [np.full(count, -np.inf) for count in places]

    def wait(self, charger: int, arrival: float) -> float:
        """Return how long a robot that arrives now waits for a place [s]."""
        return max(float(self._free[charger].min()) - arrival, 0.0)

    def occupy(self, charger: int, until: float) -> None:
        """Take the place that is free first until a time [s]."""
        self._free[charger][int(self._free[charger].argmin())] = until


class Outcome(NamedTuple):
    """What comes of sequences of stops."""

    energy: float  # energy of all robots [J]
    waited: float  # time spent waiting for chargers [s]


def run(
    problems: Sequence[RobotProblem], sequences: Sequence[tuple[int, ...]], places: Sequence[int]
) -> Outcome | None:
    """Run sequences of stops together."""
    docks, waited = Docks(places), 0.0
    left = [list(stops) for stops in sequences]
    states: list[Status | None] = [
        _to_charger(problem, begin(problem), stops)
        for problem, stops in zip(problems, left, strict=True)
    ]
    while True:
        if any(state is None for state in states):
            return None
        waiting = [(state.time, r) for r, state in enumerate(states) if state and left[r]]
        if not waiting:
            break
        arrival, r = min(waiting)
        state, problem = states[r], problems[r]
        charger = left[r].pop(0) - 1 - problem.tasks
        wait = docks.wait(charger, arrival)
        waited += wait
        full = None if state is None else charge(problem, state, wait)
        if full is not None:
            docks.occupy(charger, full.time)
            full = _to_charger(problem, full, left[r])
        states[r] = full
    ended = [end(p, s) for p, s in zip(problems, states, strict=True) if s is not None]
    if any(state is None for state in ended):
        return None
    return Outcome(sum(state.spent for state in ended if state is not None), waited)


def _to_charger(problem: RobotProblem, status: Status, stops: list[int]) -> Status | None:
    """Do tasks up to the arrival at the next charger, which stays in the list."""
    here: Status | None = status
    while stops and here is not None:
        if stops[0] > problem.tasks:
            return arrive(problem, here, stops[0])
        here = do_task(problem, here, stops.pop(0) - 1)
    return here
