"""What comes of a fleet."""

from __future__ import annotations

from dataclasses import dataclass

from energyplan.errors import MissionError
from energyplan.fleet.types import Fleet, RobotState
from energyplan.mission import Stop
from energyplan.mission.condition import Condition
from energyplan.path import Pose


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
