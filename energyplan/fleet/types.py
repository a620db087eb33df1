"""Robots that share tasks and chargers, checked where they are built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from energyplan.errors import MissionError
from energyplan.mission import Charger, Mission, Task
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
