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
    """One of several robots.

    Parameters
    ----------
    name : str
        Its name.
    mission : Mission
        What it is, where it is, what its battery holds, and all tasks that it could do.

    Examples
    --------
    >>> import energyplan as ep
    >>> from energyplan.io.bundled import bundled
    >>> fleet = ep.read_fleet(bundled("fleet_warehouse.yaml"))
    >>> robot = fleet.robots[0]
    >>> robot.name, len(robot.mission.tasks) > 0
    ('alpha', True)
    """

    name: str
    mission: Mission

    def __post_init__(self) -> None:
        if not self.name:
            raise MissionError("a robot has no name; give each its own", ("name",))


@dataclass(frozen=True)
class RobotState:
    """Where a robot stands at some time.

    Parameters
    ----------
    pose : Pose
        Where it is.
    soc : float
        Its state of charge.
    done : tuple of str
        Tasks that it has done.
    time : float
        Time [s].

    Examples
    --------
    >>> from energyplan.path import Pose
    >>> RobotState(Pose(18.0, 2.0, 0.0), soc=0.34, done=("gate",), time=100.0).soc
    0.34
    """

    pose: Pose
    soc: float
    done: tuple[str, ...] = ()
    time: float = 0.0


@dataclass(frozen=True)
class Fleet(ReadOnly):
    """Robots that share tasks and chargers.

    Parameters
    ----------
    robots : sequence of Robot
        The robots. Each one's mission lists the tasks that this robot could do; each task is done
        by one of those that list it. All missions list the same chargers.
    places : mapping of str to int
        Robots that a charger takes at a time; one where not given. Who comes first is served
        first.
    name : str
        What to call the fleet.

    Raises
    ------
    MissionError
        If there is no robot, names are not unique, or what they share differs.

    Examples
    --------
    >>> import energyplan as ep
    >>> from energyplan.io.bundled import bundled
    >>> fleet = ep.read_fleet(bundled("fleet_warehouse.yaml"))
    >>> [robot.name for robot in fleet.robots]
    ['alpha', 'beta', 'gamma']
    """

    robots: tuple[Robot, ...]
    places: Mapping[str, int] = field(default_factory=dict)
    name: str = "fleet"

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
        """Return what is left for the robots that are still there.

        Parameters
        ----------
        states : mapping of str to RobotState
            Where each robot stands; one that is not named has failed.
        done : iterable of str
            Tasks done by others, such as those that have failed.

        Returns
        -------
        Fleet
            The rest, without robots that can do none of it.

        Raises
        ------
        MissionError
            If a robot is unknown, or nobody is left who can do what is left.
        """
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
    """What one robot does.

    Parameters
    ----------
    name : str
        Its name.
    tasks : tuple of str
        What it does, in this order.
    route : tuple of Stop
        Its timetable: start, tasks, charges, end.
    energy, energy_upper : float
        Energy that it takes, expected and at the confidence asked [J].
    soc_end, soc_end_lower : float
        State of charge at the end, expected and at the bound.
    duration : float
        Time from its start to its end [s].
    waiting : float
        Time of it spent waiting for chargers [s].
    end : Condition
        Where it ends, with all that it did.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> mission = ep.Mission(
    ...     ep.PowerModel.preset("quadriga:empty:marble"), hall, ep.Battery.preset("quadriga"),
    ...     start=(1, 2, 0), tasks=[ep.Task("look", (5, 2, 0), dwell=60.0)], confidence=0.5,
    ...     planning_effort=5000,
    ... )
    >>> from energyplan.fleet import Fleet, Robot, evaluate_fleet
    >>> report = evaluate_fleet(Fleet((Robot("alpha", mission),)))
    >>> [robot] = report.robots
    >>> robot.name, robot.tasks, [stop.kind for stop in robot.route]
    ('alpha', ('look',), ['start', 'task', 'end'])
    """

    name: str
    tasks: tuple[str, ...]
    route: tuple[Stop, ...]
    energy: float
    energy_upper: float
    soc_end: float
    soc_end_lower: float
    duration: float
    waiting: float
    end: Condition

    def at(self, time: float) -> RobotState:
        """Return where the robot stands at a time [s]; what it is at by then is ended first.

        Parameters
        ----------
        time : float
            Time [s].

        Returns
        -------
        RobotState
            On a drive, where it is then; at a task, a wait or a charge, where that has ended.
        """
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
    """A task that nobody does.

    Parameters
    ----------
    name : str
        The task.
    required : bool
        Whether the fleet fails without it.
    reasons : tuple of str
        For each robot that could do it: why not, were it alone in the world; ``"none"`` where it
        could, but not beside what it does.

    Examples
    --------
    >>> task = LeftOut("hedge", required=False, reasons=("battery", "no_path"))
    >>> all(reason != "none" for reason in task.reasons)  # no robot could do it
    True
    """

    name: str
    required: bool
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class FleetReport:
    """Who does what and charges when.

    Parameters
    ----------
    fleet : Fleet
        The fleet.
    robots : tuple of RobotReport
        What each robot does.
    left_out : tuple of LeftOut
        Tasks that nobody does.
    energy, energy_upper : float
        Energy of all robots [J]: expected, and the sum of their bounds.
    proven : bool
        Whether no better assignment exists, on the routes as planned.
    gap : float
        Part of the energy at the bound that the best assignment of the same tasks may save; NaN
        where robots get into each other's way so that their energies do not add up.
    feasible : bool
        Whether all required tasks are done and each robot ends where it must.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> mission = ep.Mission(
    ...     ep.PowerModel.preset("quadriga:empty:marble"), hall, ep.Battery.preset("quadriga"),
    ...     start=(1, 2, 0), tasks=[ep.Task("look", (5, 2, 0), dwell=60.0)], confidence=0.5,
    ...     planning_effort=5000,
    ... )
    >>> from energyplan.fleet import Fleet, Robot, evaluate_fleet
    >>> report = evaluate_fleet(Fleet((Robot("alpha", mission),)))
    >>> report.feasible, report.proven, report.left_out
    (True, True, ())
    """

    fleet: Fleet
    robots: tuple[RobotReport, ...]
    left_out: tuple[LeftOut, ...]
    energy: float
    energy_upper: float
    proven: bool
    gap: float
    feasible: bool

    def robot(self, name: str) -> RobotReport:
        """Return what a robot does.

        Raises
        ------
        MissionError
            If no robot bears the name.
        """
        for robot in self.robots:
            if robot.name == name:
                return robot
        names = ", ".join(robot.name for robot in self.robots)
        raise MissionError(f"no robot is called {name!r}; the robots are {names}")

    def after_failure(self, name: str, time: float) -> Fleet:
        """Return what is left for the others when a robot fails at a time [s].

        What others are at then they end first. What the robot that failed has done stays done.

        Parameters
        ----------
        name : str
            The robot that fails.
        time : float
            When [s].

        Returns
        -------
        Fleet
            The rest, to be evaluated anew.

        Raises
        ------
        MissionError
            If no robot bears the name, or nobody is left who can do what is left.
        """
        failed = self.robot(name)
        done = [
            stop.name for stop in failed.route if stop.kind == "task" and stop.departure <= time
        ]
        states = {robot.name: robot.at(time) for robot in self.robots if robot.name != name}
        return self.fleet.resume(states, done)
