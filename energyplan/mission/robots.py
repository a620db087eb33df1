"""Several robots that share tasks and chargers: who does what, and who charges when.

Tasks are given to robots by insertion with regret (`energyplan.mission.order.shared`), on energies
at their bounds that add up. For each robot's share an order is found as for a mission of its own.
Then all robots do theirs on one clock, on which they meet at chargers. What a robot turns out not
to be able to do is offered to the others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import replace
from heapq import heappop, heappush
from itertools import count

import numpy as np

from energyplan.mission._order_kernel import OrderProblem
from energyplan.mission.drive import Simulation, Status
from energyplan.mission.order import (
    EXACT,
    ORDERING,
    Matrix,
    Order,
    attempt,
    best_stops,
    gap_of,
    prizes,
    shared,
    solve,
)
from energyplan.mission.report import MissionReport, TaskReport
from energyplan.mission.routes import Legs, Progress, Routes
from energyplan.mission.single import REASONS, Docking, Evaluation
from energyplan.mission.types import Charger, Mission, Task

_ROUNDS = 12  # most rounds of sharing and planning


class Sharing:
    """The tasks of a mission on their way to the robots that do them."""

    def __init__(self, mission: Mission, progress: Progress, routes: Routes | None) -> None:
        self.mission, self.progress = mission, progress
        known = Routes() if routes is None else routes
        self.sims = [Simulation(Legs(part, progress, known)) for part in mission.parts]
        names = [task.name for task in mission.tasks]
        self.own = [[names.index(task.name) for task in part.tasks] for part in mission.parts]
        self.prize = prizes(mission.tasks)
        self._found: dict[tuple[int, tuple[int, ...]], Order] = {}

    def report(self) -> MissionReport:
        """Share the tasks until every robot can do its own; the best round is the answer."""
        able = [list(own) for own in self.own]
        prize = {task.name: float(one) for task, one in zip(self.mission.tasks, self.prize,
                                                            strict=True)}  # fmt: skip
        rounds = list[list[MissionReport]]()
        while True:
            given = self._given(able)
            rounds.append(self._driven(given))
            lost = False
            for own, numbers, robot in zip(able, given, rounds[-1], strict=True):
                for number in numbers:
                    if self.mission.tasks[number].name not in {task.name for task in robot.tasks}:
                        own.remove(number)
                        lost = True
            if not lost:
                break

        def rank(found: list[MissionReport]) -> tuple[bool, float, float]:
            gained = sum(prize[task.name] for one in found for task in one.tasks)
            energy = sum(one.energy for one in found)
            return not all(one.feasible for one in found), -round(gained, 6), energy

        robots = min(rounds, key=rank)
        done = {task.name: task for robot in robots for task in robot.tasks}
        tasks = [done.get(task.name) or self._left_out(k, task)
                 for k, task in enumerate(self.mission.tasks)]  # fmt: skip
        left = [task for task in self.mission.tasks if task.name not in done]
        energy = sum(robot.energy for robot in robots)
        gap = float(np.nan) if left else self._gap(energy)
        if len(robots) == 1 and robots[0].proven and not left:
            gap = 0.0
        known = (note for one in robots for note in one.warnings)
        return MissionReport(
            mission=self.mission,
            tasks=tuple(tasks),
            trip=(),
            energy=energy,
            energy_upper=sum(robot.energy_upper for robot in robots),
            feasible=all(one.feasible for one in robots) and not any(t.required for t in left),
            proven=bool(gap <= ORDERING.same),
            gap=gap,
            warnings=tuple(dict.fromkeys((*self.mission.notes, *known))),
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
                wanted = matrix.missing(one, _priced(one, [mine.index(task) for task in tasks]))
                missing += len(wanted)
                matrix.plan(wanted)
            if self.progress is not None:
                self.progress(f"assignment {turn + 1}: {missing} routes to plan")
            if not missing:
                break
        return given

    def _driven(self, given: Sequence[Sequence[int]]) -> list[MissionReport]:
        """Have all robots do their shares on one clock."""
        shares = []
        for r, (sim, own, tasks) in enumerate(zip(self.sims, self.own, given, strict=True)):
            exact = len(tasks) <= EXACT
            legs = sim.legs.under(replace(sim.mission, order="free" if exact else "given"))
            numbers = [own.index(task) for task in tasks]
            one = Evaluation(legs.mission, self.progress, legs, numbers)
            if (key := (r, tuple(tasks))) not in self._found:
                self._found[key] = best_stops(one.sim, tasks=numbers, progress=self.progress)
            shares.append((one, one.among_others(self._found[key])))
        Clock(shares).run()
        return [one.written(one.sim.arrives(one.end)) for one, _ in shares]

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


class Stay:
    """A robot at a charger."""

    def __init__(self, robot: int, docking: Docking) -> None:
        self.robot, self.docking = robot, docking
        self.shares: list[tuple[float, float]] = []  # see `Shares`
        self.after = docking.state  # when it leaves, as long as nobody comes or leaves


class Clock:
    """Robots as events in the order of time: one comes to a charger, or leaves it.

    Who comes first is served first; the others wait until a place is free. Where a charger shares
    its power, each arrival and departure changes what the others get.
    """

    def __init__(
        self, robots: Sequence[tuple[Evaluation, Generator[Docking, Status | None]]]
    ) -> None:
        self.robots = robots
        # time, whether one comes, a number for each, robot, and what to do there or how it was
        self.events: list[tuple[float, bool, int, int, Docking | Stay]] = []
        self.numbers = count()
        self.waiting = defaultdict[str, list[tuple[int, Docking]]](list)  # by charger
        self.stays = defaultdict[str, list[Stay]](list)  # by charger

    def run(self) -> None:
        """Have all robots come to their ends."""
        for r, (_, steps) in enumerate(self.robots):
            self._come(r, next(steps, None))
        while self.events:
            time, _, _, r, event = heappop(self.events)
            docking = event if isinstance(event, Docking) else event.docking
            charger = self._charger(r, docking)
            if isinstance(event, Docking):
                self.waiting[charger.name].append((r, event))
            elif event not in self.stays[charger.name] or event.after.time > time:
                continue  # somebody came or left meanwhile: it leaves at another time
            else:
                self.stays[charger.name].remove(event)
                self._onward(r, event.after)
            self._serve(charger, time)

    def _come(self, r: int, docking: Docking | None) -> None:
        """Note when a robot comes to its next charger, if it does."""
        if docking is not None:
            heappush(self.events, (docking.state.time, True, next(self.numbers), r, docking))

    def _onward(self, r: int, after: Status | None) -> None:
        """Have a robot go on from a charger."""
        with suppress(StopIteration):
            self._come(r, self.robots[r][1].send(after))

    def _serve(self, charger: Charger, time: float) -> None:
        """Give free places to who waits, and to each its part of the power."""
        stays, waiting = self.stays[charger.name], self.waiting[charger.name]
        while waiting and len(stays) < charger.places:
            r, docking = waiting.pop(0)
            sim = self.robots[r][0].sim
            state = sim.wait_until(docking.state, time)
            if sim.holds(state):
                stays.append(Stay(r, docking._replace(state=state)))
            else:
                self._onward(r, None)
        part = 1.0 / len(stays) if charger.shared and stays else 1.0
        for stay in stays:
            if stay.shares and stay.shares[-1][1] == part:
                continue
            state, stops, hurried = stay.docking
            stay.shares.append((time - state.time if stay.shares else 0.0, part))
            stay.after = self.robots[stay.robot][0].sim.charged(state, stops, hurried, stay.shares)
            leaves = (stay.after.time, False, next(self.numbers), stay.robot, stay)
            heappush(self.events, leaves)

    def _charger(self, r: int, docking: Docking) -> Charger:
        return self.robots[r][0].sim.charger(docking.state)
