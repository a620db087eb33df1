"""Several robots that share tasks and chargers: who does what, and who charges when.

Tasks are given to robots by insertion with regret (`energyplan.mission.order.shared`), on energies
at their bounds that add up. Each robot's share is then a mission of its own, evaluated as any
other. Who comes to a charger first is served first; the others wait until it is free. What a robot
turns out not to be able to do is offered to the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from energyplan import html
from energyplan.errors import MissionError
from energyplan.kinds import checked
from energyplan.mission.evaluation import Evaluation, clock
from energyplan.mission.legs import Legs, Routes, State, Walk
from energyplan.mission.order import EXACT, Matrix, Order, attempt, finish, shared
from energyplan.mission.trip import Stop, stops
from energyplan.mission.types import Charger, Mission, Name, Task
from energyplan.path import Pose
from energyplan.records import ReadOnly, record

_ROUNDS = 4
"""Rounds of sharing and planning."""


@record(MissionError)
class Robot:
    """One of several robots."""

    name: Name
    mission: Mission


@dataclass(frozen=True)
class RobotState:
    """Where a robot stands at some time."""

    pose: Pose  # where it is
    soc: float  # its state of charge
    done: tuple[str, ...] = ()  # tasks that it has done
    time: float = 0.0  # time [s]


@dataclass(frozen=True)
class Fleet(ReadOnly):
    """Robots that share tasks and chargers."""

    robots: tuple[Robot, ...]  # the robots
    places: Mapping[str, int] = field(default_factory=dict)  # robots that a charger takes at a time
    name: str = "fleet"  # what to call the fleet

    def __post_init__(self) -> None:
        object.__setattr__(self, "robots", tuple(self.robots))
        object.__setattr__(self, "places", MappingProxyType(dict(self.places)))
        if not self.robots:
            raise MissionError("the fleet has no robot; list at least one", ("robots",))
        names = [robot.name for robot in self.robots]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise MissionError(
                    f"the name {name!r} stands twice; give each robot its own", ("robots", k)
                )
        known: dict[str, Task] = {}
        for k, robot in enumerate(self.robots):
            for task in robot.mission.tasks:
                if known.setdefault(task.name, task) != task:
                    raise MissionError(
                        f"task {task.name!r} of robot {robot.name!r} differs from that of another "
                        "robot; give both the same",
                        ("robots", k),
                    )
            if robot.mission.chargers != self.chargers:
                raise MissionError(
                    f"robot {robot.name!r} has other chargers than {names[0]!r}; list the same",
                    ("robots", k),
                )
        chargers = {charger.name for charger in self.chargers}
        for name, count in self.places.items():
            if name not in chargers:
                raise MissionError(f"places: there is no charger {name!r}", ("chargers",))
            if count < 1:
                raise MissionError(
                    f"charger {name!r} takes {count} robots; give 1 or more", ("chargers",)
                )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """All tasks, in the order in which the robots list them."""
        known = {task.name: task for robot in self.robots for task in robot.mission.tasks}
        return tuple(known.values())

    @property
    def chargers(self) -> tuple[Charger, ...]:
        """The chargers."""
        return self.robots[0].mission.chargers

    def resume(self, states: Mapping[str, RobotState], done: Iterable[str] = ()) -> Fleet:
        """Return what is left for the robots that are still there."""
        unknown = states.keys() - {robot.name for robot in self.robots}
        if unknown:
            raise MissionError(f"no robot is called {', '.join(sorted(unknown))}")
        finished = {*done, *(task for state in states.values() for task in state.done)}
        rest = []
        for robot in self.robots:
            mine = [task.name for task in robot.mission.tasks]
            if robot.name not in states or not set(mine) - finished:
                continue
            state, mission = states[robot.name], robot.mission
            own = sum(task.payload for task in mission.tasks if task.name in state.done)
            again = mission.resume(
                state.pose,
                state.soc,
                [name for name in mine if name in finished],
                time=state.time,
                payload=mission.payload + own,
            )
            rest.append(replace(robot, mission=again))
        if not rest:
            raise MissionError("no robot is left that can do a task that is left")
        return replace(self, robots=tuple(rest))


@dataclass(frozen=True)
class RobotReport:
    """What one robot does."""

    name: str  # its name
    tasks: tuple[str, ...]  # what it does, in this order
    route: tuple[Stop, ...]  # its timetable
    energy: float  # energy that it takes, as expected [J]
    energy_upper: float  # the same at the confidence asked [J]
    soc_end: float  # state of charge at the end, as expected
    soc_end_lower: float  # the same at the bound
    duration: float  # time from its start to its end [s]
    waiting: float  # time of it spent waiting for chargers [s]
    end: State  # where it ends, with all that it did

    def at(self, time: float) -> RobotState:
        """Return where the robot stands at a time [s]; what it is at by then is ended first."""
        pose, soc, now = self.route[0].pose, self.route[0].soc, time
        for piece in self.end.trip:
            if piece.t[0] > now:
                break
            drive = None if piece.leg is None else piece.leg.trajectory
            sample = -1
            if drive is not None and piece.t[-1] > now:
                sample = int((piece.t <= now).sum()) - 1
            if drive is not None:
                pose = Pose(
                    float(drive.x[sample]), float(drive.y[sample]), float(drive.yaw[sample])
                )
            soc = float(piece.soc[sample])
            if sample >= 0:
                break
            now = max(now, float(piece.t[-1]))
        done = tuple(
            stop.name for stop in self.route if stop.kind == "task" and stop.departure <= now
        )
        return RobotState(pose, soc, done, now)


@dataclass(frozen=True)
class LeftOut:
    """A task that nobody does."""

    name: str  # the task
    required: bool  # whether the fleet fails without it
    reasons: tuple[str, ...]  # for each robot that could do it


@dataclass(frozen=True)
class FleetReport(html.Readable):
    """Who does what and charges when."""

    fleet: Fleet  # the fleet
    robots: tuple[RobotReport, ...]  # what each robot does
    left_out: tuple[LeftOut, ...]  # tasks that nobody does
    energy: float  # energy of all robots, as expected [J]
    energy_upper: float  # sum of their energies at the confidence asked [J]
    proven: bool  # whether no better assignment exists, on the routes as planned
    gap: float
    feasible: bool  # whether all required tasks are done and each robot ends where it must

    @property
    def sentence(self) -> str:
        """How many tasks are done, and whether that can be bettered."""
        count = len(self.fleet.tasks)
        quality = "no better assignment exists" if self.proven else "a better one may exist"
        return (
            f"{count - len(self.left_out)} of {count} tasks are done: "
            f"{'feasible' if self.feasible else 'not feasible'}; {quality}"
        )

    def _summaries(self) -> list[html.Summary]:
        robots = [
            (one.name, len(one.tasks), *(html.number(e / 3600) for e in (one.energy,
             one.energy_upper)), f"{one.duration / 60:.1f}", f"{one.waiting / 60:.1f}",
             f"{100 * one.soc_end:.0f} %", f"{100 * one.soc_end_lower:.0f} %")
            for one in self.robots
        ]  # fmt: skip
        times = [
            (one.name, clock(stop.arrival), stop.kind, stop.name,
             f"{(stop.departure - stop.arrival) / 60:.1f}", f"{100 * stop.soc:.0f} %")
            for one in self.robots
            for stop in one.route[1:]
        ]  # fmt: skip
        left = [(task.name, ", ".join(task.reasons)) for task in self.left_out]
        found = (
            html.Summary("Robots", (
                "robot", "tasks", "energy [Wh]", "at most [Wh]", "minutes", "waiting [min]",
                "charge left", "at least"
            ), robots),
            html.Summary("Timetable", (
                "robot", "time", "what", "where", "minutes", "charge after"
            ), times),
            html.Summary("Not assigned", ("task", "why, for each robot that could do it"), left),
        )  # fmt: skip
        return [html.Summary(self.sentence, (), ()), *(one for one in found if one.rows)]

    def robot(self, name: str) -> RobotReport:
        """Return what a robot does."""
        for robot in self.robots:
            if robot.name == name:
                return robot
        names = ", ".join(robot.name for robot in self.robots)
        raise MissionError(f"no robot is called {name!r}; the robots are {names}")

    def after_failure(self, name: str, time: float) -> Fleet:
        """Return what is left for the others when a robot fails at a time [s].

        What others are at then they end first. What the robot that failed has done stays done.
        """
        failed = self.robot(name)
        done = [
            stop.name for stop in failed.route if stop.kind == "task" and stop.departure <= time
        ]
        states = {robot.name: robot.at(time) for robot in self.robots if robot.name != name}
        return self.fleet.resume(states, done)


@dataclass(frozen=True)
class _Share:
    """What came of a robot's share."""

    report: RobotReport
    lost: frozenset[int]  # numbers of the tasks that it cannot do after all
    charges: tuple[tuple[int, float, float], ...]  # charger, begin and end [s]
    ended: bool  # whether it ends where it must
    proven: bool


@checked(MissionError)
def evaluate_fleet(fleet: Fleet, progress: Callable[[str], None] | None = None) -> FleetReport:
    """Tell who does what and charges when: required tasks first, then prizes, then energy.

    Source: docs/missions.
    """
    return _Sharing(fleet, progress).report()


class _Sharing:
    """The tasks of some robots on their way to who does them."""

    def __init__(self, fleet: Fleet, progress: Callable[[str], None] | None) -> None:
        self.fleet, self.progress, self.routes = fleet, progress, Routes()
        self.walks = [Walk(Legs(robot.mission, progress, self.routes)) for robot in fleet.robots]
        self.names = [task.name for task in fleet.tasks]
        self.own = [
            [self.names.index(task.name) for task in robot.mission.tasks] for robot in fleet.robots
        ]
        prizes = np.array([task.prize for task in fleet.tasks])
        required = np.array([task.required for task in fleet.tasks])
        self.worth = prizes + np.where(required, 1.0 + prizes.sum(), 0.0)
        self._done: dict[tuple[object, ...], _Share] = {}

    def report(self) -> FleetReport:
        """Share the tasks until every robot can do its own."""
        able = [list(own) for own in self.own]
        while True:
            shares = self._scheduled(self._given(able))
            for own, share in zip(able, shares, strict=True):
                own[:] = [task for task in own if task not in share.lost]
            if not any(share.lost for share in shares):
                break
        robots = tuple(share.report for share in shares)
        done = {name for robot in robots for name in robot.tasks}
        left = tuple(
            LeftOut(task.name, task.required, self._why(task.name))
            for task in self.fleet.tasks
            if task.name not in done
        )
        alone = len(robots) == 1 and shares[0].proven and not left
        return FleetReport(
            fleet=self.fleet,
            robots=robots,
            left_out=left,
            energy=sum(robot.energy for robot in robots),
            energy_upper=sum(robot.energy_upper for robot in robots),
            proven=alone,
            gap=0.0 if alone else float(np.nan),
            feasible=all(share.ended for share in shares) and not any(one.required for one in left),
        )

    def _given(self, able: Sequence[Sequence[int]]) -> list[list[int]]:
        """Give the tasks to robots that are able to do them, on routes that are planned."""
        given: list[list[int]] = []
        for turn in range(_ROUNDS):
            matrices = []
            for walk, own, mine in zip(self.walks, self.own, able, strict=True):
                tasks = [own.index(task) for task in mine]
                matrices.append(Matrix(walk, walk.start, tasks, 1.0))
            given, _ = shared([one.problem() for one in matrices], self.worth, able)
            missing = 0
            for matrix, mine, tasks in zip(matrices, able, given, strict=True):
                stops = tuple(1 + mine.index(task) for task in tasks)
                wanted = matrix.missing(Order(stops, (False,) * len(stops)))
                missing += len(wanted)
                matrix.plan(wanted)
            if self.progress is not None:
                self.progress(f"assignment {turn + 1}: {missing} routes to plan")
            if not missing:
                break
        return given

    def _scheduled(self, given: Sequence[Sequence[int]]) -> list[_Share]:
        """Evaluate all shares; who comes to a charger first is served first."""
        shares = [self._share(r, tasks, {}) for r, tasks in enumerate(given)]
        waiting, taken = set(range(len(shares))), dict[int, list[tuple[float, float]]]()
        while waiting:
            r = min(waiting, key=lambda r: (min((b for _, b, _ in shares[r].charges),
                                                default=np.inf), r))  # fmt: skip
            waiting.remove(r)
            for charger, begin, end in shares[r].charges:
                taken.setdefault(charger, []).append((begin, end))
            full = {charger: self._full(charger, stays) for charger, stays in taken.items()}
            for other in waiting:
                if shares[other].charges:
                    shares[other] = self._share(other, given[other], full)
        return shares

    def _full(
        self, charger: int, stays: Sequence[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        """Return when all places of a charger are taken."""
        places = self.fleet.places.get(self.fleet.chargers[charger].name, 1)
        times = sorted({time for stay in stays for time in stay})
        return [
            (begin, end)
            for begin, end in pairwise(times)
            if sum(one <= begin and end <= other for one, other in stays) >= places
        ]

    def _share(
        self, r: int, tasks: Sequence[int], full: Mapping[int, Sequence[tuple[float, float]]]
    ) -> _Share:
        """Evaluate what one robot does, as a mission of its own."""
        key = r, tuple(tasks), tuple((c, tuple(stays)) for c, stays in sorted(full.items()))
        if key not in self._done:
            self._done[key] = self._evaluated(r, tasks, full)
        return self._done[key]

    def _evaluated(
        self, r: int, tasks: Sequence[int], full: Mapping[int, Sequence[tuple[float, float]]]
    ) -> _Share:
        walk, own = self.walks[r], self.own[r]
        legs = walk.legs.under(
            replace(walk.mission, order="free" if len(tasks) <= EXACT else "given")
        )
        taken = {legs.chargers[charger]: stays for charger, stays in full.items()}
        numbers = [own.index(task) for task in tasks]
        found = Evaluation(legs.mission, self.progress, legs, taken, numbers)
        state = found.go()
        last = finish(found.walk, state)
        end = state if last is None else last
        trip = walk.mark(end, "end").trip
        route = stops(trip)
        numbered = {charger.name: k for k, charger in enumerate(self.fleet.chargers)}
        at = [(numbered[s.goal], s) for s in trip if s.goal in numbered]
        report = RobotReport(
            name=self.fleet.robots[r].name,
            tasks=tuple(stop.name for stop in route if stop.kind == "task"),
            route=route,
            energy=end.total.mean,
            energy_upper=end.total.upper(walk.quantile),
            soc_end=end.expected.soc,
            soc_end_lower=end.worst.soc,
            duration=end.time - walk.mission.time,
            waiting=sum(float(s.t[-1] - s.t[0]) for _, s in at if s.kind == "wait"),
            end=end,
        )
        return _Share(
            report,
            frozenset(own[k] for k in numbers if k not in found.done),
            tuple((c, float(s.t[0]), float(s.t[-1])) for c, s in at if s.kind == "charge"),
            last is not None,
            found.proven,
        )

    def _why(self, name: str) -> tuple[str, ...]:
        """Return for each robot that could do a task why it cannot, were there nothing else."""
        number = self.names.index(name)
        return tuple(
            attempt(walk, walk.start, own.index(number)).reason
            for walk, own in zip(self.walks, self.own, strict=True)
            if number in own
        )
