"""Robots that share tasks and chargers, checked where they are built, and what comes of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from energyplan.errors import MissionError
from energyplan.mission import Charger, Mission, Stop, Task
from energyplan.mission.condition import Condition
from energyplan.path import Pose
from energyplan.records import ReadOnly


@dataclass(frozen=True)
class Robot:
    """One of several robots."""

    name: str  # its name
    mission: Mission

    def __post_init__(self) -> None:
        if not self.name:
            raise MissionError("a robot has no name; give each its own", ("name",))


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
    energy: float  # energy that it takes, expected and at the confidence asked [J]
    energy_upper: float  # energy that it takes, expected and at the confidence asked [J]
    soc_end: float  # state of charge at the end, expected and at the bound
    soc_end_lower: float  # state of charge at the end, expected and at the bound
    duration: float  # time from its start to its end [s]
    waiting: float  # time of it spent waiting for chargers [s]
    end: Condition  # where it ends, with all that it did

    def at(self, time: float) -> RobotState:
        """Return where the robot stands at a time [s]; what it is at by then is ended first."""
        pose, soc, now = self.route[0].pose, self.route[0].soc, time
        for piece in self.end.pieces:
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
class FleetReport:
    """Who does what and charges when."""

    fleet: Fleet  # the fleet
    robots: tuple[RobotReport, ...]  # what each robot does
    left_out: tuple[LeftOut, ...]  # tasks that nobody does
    energy: float  # energy of all robots [J]
    energy_upper: float  # energy of all robots [J]
    proven: bool  # whether no better assignment exists, on the routes as planned
    gap: float
    feasible: bool  # whether all required tasks are done and each robot ends where it must

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
