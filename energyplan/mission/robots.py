"""Several robots that share tasks and chargers: who does what, and who charges when.

Tasks are given to robots by insertion with regret (`energyplan.mission.order.shared`), on energies
at their bounds that add up. Each robot's share is then a mission of its own, evaluated as any
other. The robot that reaches a charger first is served first; the others wait until it is free.
What a robot turns out not to be able to do is offered to the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from energyplan.mission.drive import Segment, Simulation
from energyplan.mission.evaluation import REASONS, Evaluation
from energyplan.mission.order import (
    EXACT,
    ORDERING,
    Matrix,
    Order,
    OrderProblem,
    attempt,
    gap_of,
    prizes,
    shared,
    solve,
)
from energyplan.mission.report import MissionReport, TaskReport
from energyplan.mission.routes import Legs, Progress, Routes
from energyplan.mission.types import Mission, Task

_ROUNDS = 12  # most rounds of sharing and planning

_Stays = Mapping[str, Sequence[tuple[float, float]]]
"""When all places of each charger are occupied [s]."""


class Sharing:
    """The tasks of a mission on their way to the robots that do them."""

    def __init__(self, mission: Mission, progress: Progress, routes: Routes | None) -> None:
        self.mission, self.progress = mission, progress
        known = Routes() if routes is None else routes
        self.sims = [Simulation(Legs(part, progress, known)) for part in mission.parts]
        names = [task.name for task in mission.tasks]
        self.own = [[names.index(task.name) for task in part.tasks] for part in mission.parts]
        self.prize = prizes(mission.tasks)
        self._done: dict[tuple[object, ...], MissionReport] = {}

    def report(self) -> MissionReport:
        """Share the tasks until every robot can do its own."""
        able = [list(own) for own in self.own]
        while True:
            given = self._given(able)
            robots = self._scheduled(given)
            lost = False
            for own, numbers, robot in zip(able, given, robots, strict=True):
                for number in numbers:
                    if self.mission.tasks[number].name not in {task.name for task in robot.tasks}:
                        own.remove(number)
                        lost = True
            if not lost:
                break
        done = {task.name: task for robot in robots for task in robot.tasks}
        tasks = [done.get(task.name) or self._left_out(k, task)
                 for k, task in enumerate(self.mission.tasks)]  # fmt: skip
        left = [task for task in self.mission.tasks if task.name not in done]
        energy = sum(robot.energy for robot in robots)
        gap = float(np.nan) if left else self._gap(energy)
        if len(robots) == 1 and robots[0].proven and not left:
            gap = 0.0
        return MissionReport(
            mission=self.mission,
            tasks=tuple(tasks),
            trip=(),
            energy=energy,
            energy_upper=sum(robot.energy_upper for robot in robots),
            feasible=all(one.feasible for one in robots) and not any(t.required for t in left),
            proven=bool(gap <= ORDERING.same),
            gap=gap,
            warnings=tuple(dict.fromkeys(note for one in robots for note in one.warnings)),
            robots=tuple(robots),
        )

    def _gap(self, energy: float) -> float:
        """Return by which fraction of its energy a better way to do all tasks may exist at most."""
        matrices = [
            Matrix(sim, sim.start, range(len(own)), 0.0, ideal=True)
            for sim, own in zip(self.sims, self.own, strict=True)
        ]
        return gap_of(matrices, self.own, energy)

    def _given(self, able: Sequence[Sequence[int]]) -> list[list[int]]:
        """Give the tasks to robots that are able to do them, on routes that are planned."""
        given: list[list[int]] = []
        for turn in range(_ROUNDS):
            matrices = []
            for sim, own, mine in zip(self.sims, self.own, able, strict=True):
                tasks = [own.index(task) for task in mine]
                matrices.append(Matrix(sim, sim.start, tasks, 1.0))
            problems = [one.problem() for one in matrices]
            given, _ = shared(problems, self.prize, able)
            missing = 0
            for matrix, one, mine, tasks in zip(matrices, problems, able, given, strict=True):
                wanted = matrix.missing(_priced(one, [mine.index(task) for task in tasks]))
                missing += len(wanted)
                matrix.plan(wanted)
            if self.progress is not None:
                self.progress(f"assignment {turn + 1}: {missing} routes to plan")
            if not missing:
                break
        return given

    def _scheduled(self, given: Sequence[Sequence[int]]) -> list[MissionReport]:
        """Evaluate all shares; the robot that reaches a charger first is served first."""
        shares = [self._share(r, tasks, {}) for r, tasks in enumerate(given)]
        waiting, charges = set(range(len(shares))), list[Segment]()

        def first(r: int) -> tuple[float, int]:
            return min((one.departure for one in shares[r].charges), default=np.inf), r

        while waiting:
            waiting.remove(r := min(waiting, key=first))
            charges += shares[r].charges
            full = {
                charger.name: _full([one for one in charges if one.goal == charger.name],
                                    charger.places)
                for charger in self.mission.chargers
            }  # fmt: skip
            for other in waiting:
                if shares[other].charges:
                    shares[other] = self._share(other, given[other], full)
        return shares

    def _share(self, r: int, tasks: Sequence[int], full: _Stays) -> MissionReport:
        """Evaluate what one robot does, as a mission of its own."""
        key = r, tuple(tasks), tuple((name, tuple(stays)) for name, stays in sorted(full.items()))
        if key not in self._done:
            sim, own = self.sims[r], self.own[r]
            exact = len(tasks) <= EXACT
            legs = sim.legs.under(replace(sim.mission, order="free" if exact else "given"))
            chargers = zip(legs.chargers, self.mission.chargers, strict=True)
            occupied = {node: full.get(charger.name, ()) for node, charger in chargers}
            numbers = [own.index(task) for task in tasks]
            self._done[key] = Evaluation(
                legs.mission, self.progress, legs, occupied, numbers
            ).report()
        return self._done[key]

    def _left_out(self, number: int, task: Task) -> TaskReport:
        """Say why no robot could do a task, were it the only task."""
        tried = {
            part.name: attempt(sim, sim.start, own.index(number))
            for part, sim, own in zip(self.mission.parts, self.sims, self.own, strict=True)
            if number in own
        }
        reasons = [REASONS.get(one.reason, "blocked_by_earlier") for one in tried.values()]
        alone = "blocked_by_earlier" in reasons or not reasons
        whys = {"none": "alone it could be done, but not with its other tasks"}
        detail = "; ".join(
            f"{name}: {one.detail or whys.get(one.reason, one.reason)}"
            for name, one in tried.items()
        )
        return TaskReport(
            task.name, "unreachable", "blocked_by_earlier" if alone else reasons[0],
            alone and bool(reasons), np.nan, np.nan, np.nan,
            detail=detail or "no robot has the skills", reasons=tuple(reasons),
        )  # fmt: skip


def _priced(problem: OrderProblem, tasks: Sequence[int]) -> Order:
    """Return the order of some of a robot's tasks, with its charges."""
    options = problem.options(tasks)
    found = solve(problem.some(tasks)._replace(given=len(tasks) > EXACT), ORDERING.narrow)
    others = len(problem.option) - len(options)
    stops = (int(options[s - 1]) + 1 if s <= len(options) else s + others for s in found.stops)
    return Order(tuple(stops), found.hurried)


def _full(charges: Sequence[Segment], places: int) -> list[tuple[float, float]]:
    """Return when all places of a charger are occupied [s]."""
    stays = [(one.departure, one.arrival) for one in charges]
    return [
        (begin, end)
        for begin, end in pairwise(sorted({time for stay in stays for time in stay}))
        if sum(one <= begin and end <= other for one, other in stays) >= places
    ]
