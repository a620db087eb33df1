"""What the evaluation of a mission tells, and how it is told from the mission's end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from energyplan import html
from energyplan.errors import UnknownNameError
from energyplan.mission.condition import Condition
from energyplan.mission.simulation import Walk
from energyplan.mission.tasks import Remedy
from energyplan.mission.types import Mission
from energyplan.path import FloatArray, Path, Pose, Trajectory

Verdict = Literal["reachable", "unreachable"]
StopKind = Literal["start", "task", "charge", "end"]
Reason = Literal["none", "no_path", "motor", "battery", "blocked_by_earlier", "late", "time_limit"]


@dataclass(frozen=True)
class TaskReport:
    """What comes of one task.

    Parameters
    ----------
    name : str
        The task.
    verdict : {"reachable", "unreachable"}
        Whether the robot can do it and still get to a safe place with its reserve, at the
        confidence asked.
    reason : {"none", "no_path", "motor", "battery", "blocked_by_earlier", "late", "time_limit"}
        Why not; `late` is a window missed, `time_limit` a route that was not found in the time
        for planning.
    reachable_alone : bool
        Whether it would be reachable as the mission's only task.
    energy, energy_upper : float
        Energy to get there from the stop before and do it, expected and at the bound [J]; nan
        if there is no route.
    soc_after : float
        Expected state of charge when it is done; nan where it cannot be.
    shortfall : float
        Missing energy, including the route to a safe place and the reserve [J].
    remedy : str
        What would make the task reachable; empty if it is.
    detail : str
        Why not, in one sentence with figures.
    start : float
        When it begins [s]; nan where it does not.
    start_upper : float
        When it begins at the latest, at the confidence asked [s]; nan where it does not.
    remedies : tuple of Remedy
        The remedies that a program can apply; each was tried.
    arrival, departure : float
        When the robot gets there and leaves [s]; nan where the task is not done.
    soc_lower : float
        State of charge at the bound when it is done; nan where it cannot be.

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
    >>> [task] = ep.evaluate(mission).tasks
    >>> task.name, task.verdict, task.reason
    ('look', 'reachable', 'none')
    """

    name: str
    verdict: Verdict
    reason: Reason
    reachable_alone: bool
    energy: float
    energy_upper: float
    soc_after: float
    shortfall: float
    remedy: str
    detail: str = ""
    start: float = np.nan
    remedies: tuple[Remedy, ...] = ()
    arrival: float = np.nan
    departure: float = np.nan
    soc_lower: float = np.nan
    start_upper: float = np.nan


@dataclass(frozen=True)
class Stop:
    """A place at which the robot stops, and when.

    Parameters
    ----------
    name : str
        The place: a task, a charger, or where the mission starts or ends.
    kind : {"start", "task", "charge", "end"}
        What it stops for.
    pose : Pose
        Where [m], [rad].
    arrival, departure : float
        When it gets there and leaves [s].
    soc, soc_lower : float
        State of charge on leaving, expected and at the bound.

    Examples
    --------
    >>> from energyplan.path import Pose
    >>> stop = Stop("gate", "task", Pose(3.0, 1.0, 0.0), 95.0, 155.0, soc=0.81, soc_lower=0.79)
    >>> stop.departure - stop.arrival
    60.0
    """

    name: str
    kind: StopKind
    pose: Pose
    arrival: float
    departure: float
    soc: float
    soc_lower: float


@dataclass(frozen=True, eq=False)
class LegReport:
    """A drive from one stop to the next.

    Parameters
    ----------
    start, goal : str
        The places.
    departure : float
        When it begins [s].
    energy : float
        Energy, as expected [J].
    trajectory : Trajectory
        The drive, from time 0.
    soc, soc_lower : ndarray, shape (n,)
        State of charge at each of its samples, expected and at the bound.

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
    >>> leg = ep.evaluate(mission).legs[0]
    >>> leg.goal, leg.trajectory.duration > 0, bool(leg.soc[-1] < leg.soc[0])
    ('look', True, True)
    """

    start: str
    goal: str
    departure: float
    energy: float
    trajectory: Trajectory
    soc: FloatArray
    soc_lower: FloatArray


@dataclass(frozen=True)
class ChargerReport:
    """How a charger is used.

    Parameters
    ----------
    name : str
        The charger.
    visits : int
        How often the robot charges there.
    duration : float
        How long in all [s].
    energy : float
        Energy that it supplies, as expected [J].

    Examples
    --------
    >>> used = ChargerReport("dock", visits=2, duration=1800.0, energy=5.4e5)
    >>> used.energy / used.duration  # mean power [W]
    300.0
    """

    name: str
    visits: int
    duration: float
    energy: float


@dataclass(frozen=True)
class Doubt:
    """What one unknown costs.

    Parameters
    ----------
    source : str
        What is not known.
    energy : float
        Standard deviation that it alone gives the energy [J].
    saving : float
        Energy that need not be held back at the confidence asked once it is measured [J].

    Examples
    --------
    >>> doubts = [Doubt("tools", 900.0, 150.0), Doubt("run to run", 2400.0, 1700.0)]
    >>> max(doubts, key=lambda doubt: doubt.saving).source
    'run to run'
    """

    source: str
    energy: float
    saving: float


@dataclass(frozen=True)
class Timeline:
    """The mission over time; arrays of one shape.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time [s].
    x, y, yaw : ndarray, shape (n,)
        Pose [m], [rad].
    power : ndarray, shape (n,)
        Power at the battery from each time to the next [W]; negative while charging.
    soc, soc_lower, soc_upper : ndarray, shape (n,)
        State of charge: expected, and the band that holds it with the confidence asked on
        either side. The upper edge mirrors the lower one.

    Examples
    --------
    >>> import numpy as np
    >>> t, still, soc = np.array([0.0, 1.0, 2.0]), np.zeros(3), np.array([0.9, 0.8, 0.7])
    >>> over = Timeline(t, still, still, still, np.full(3, 50.0), soc, soc - 0.1, soc + 0.1)
    >>> float(over.power[:-1] @ np.diff(over.t))  # energy [J]
    100.0
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    power: FloatArray
    soc: FloatArray
    soc_lower: FloatArray
    soc_upper: FloatArray


@dataclass(frozen=True)
class MissionReport(html.Readable):
    """Which tasks can be done, in which order, with what energy.

    Parameters
    ----------
    mission : Mission
        The mission.
    tasks : tuple of TaskReport
        One for each task, in the order of the mission.
    order : tuple of str
        Names of the stops in the order of their visits, chargers included.
    energy, energy_upper : float
        Energy of the whole mission, expected and at the bound [J].
    soc_end, soc_end_lower : float
        State of charge at the end, expected and at the bound.
    feasible : bool
        Whether every required task is reachable and the mission ends where it must.
    end : str
        Where it ends.
    duration : float
        How long it takes [s].
    proven : bool
        Whether, for a free order, no better one exists on the routes known.
    gap : float
        Fraction of the energy that a better order could save at most; nan if one might do more
        tasks, or if nothing is known.
    timeline : Timeline
        The mission over time.
    paths : tuple of Path
        The drives.
    trajectories : tuple of Trajectory
        The same, timed, each from time 0; without those in which the robot stays where it is.
    route : tuple of Stop
        The stops with their times, from the start to the end.
    uncertainty : tuple of Doubt
        Standard deviation of the energy by source, the largest first. It is taken between the
        charges where the largest margin is needed; without charges that is the whole mission. The
        squares add up to the variance.
    legs : tuple of LegReport
        The drives from stop to stop with the charge along them.
    chargers : tuple of ChargerReport
        How each charger is used.
    warnings : tuple of str
        What to know before trusting the figures, such as a temperature without data.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> mission = ep.Mission(
    ...     model, hall, ep.Battery.preset("quadriga"), (1, 2, 0),
    ...     (ep.Task("look", (4, 2, 0), dwell=60.0, power=20.0),),
    ...     planning_effort=1000, coefficient_spread=0.05,
    ... )
    >>> report = ep.evaluate(mission)
    >>> report.headline, report.task("look").verdict
    ('the task can be done', 'reachable')
    """

    mission: Mission
    tasks: tuple[TaskReport, ...]
    order: tuple[str, ...]
    energy: float
    energy_upper: float
    soc_end: float
    soc_end_lower: float
    feasible: bool
    end: str
    duration: float
    proven: bool
    timeline: Timeline
    paths: tuple[Path, ...]
    trajectories: tuple[Trajectory, ...] = ()
    route: tuple[Stop, ...] = ()
    uncertainty: tuple[Doubt, ...] = ()
    legs: tuple[LegReport, ...] = ()
    chargers: tuple[ChargerReport, ...] = ()
    gap: float = np.nan
    warnings: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """What comes of the mission, in one sentence that agrees with `feasible`."""
        out = [
            asked.required
            for told, asked in zip(self.tasks, self.mission.tasks, strict=True)
            if told.verdict == "unreachable"
        ]
        count = len(self.tasks)
        tasks = "the only task" if count == 1 else f"{len(out)} of {count} tasks"
        if any(out):
            required = "" if all(out) else f", {sum(out)} of them required"
            return f"not feasible as asked: {tasks} cannot be done{required}"
        left = f"{tasks}, optional, {'is' if len(out) == 1 else 'are'} left out" if out else ""
        if not self.feasible:
            return "; ".join(
                filter(None, ("not feasible as asked: it cannot end where it must", left))
            )
        if not out:
            return "the task can be done" if count == 1 else f"all {count} tasks can be done"
        needed = any(task.required for task in self.mission.tasks)
        return f"all required tasks can be done; {left}" if needed else left

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (task.name, task.verdict, task.reason.replace("_", " "), task.energy / 3600,
             100 * task.soc_after, task.remedy)
            for task in map(self.task, self.table["name"])
        ]  # fmt: skip
        title = (
            f"{self.mission.name}: {self.headline}; "
            f"{html.number(self.energy / 3600)} Wh, ends with {100 * self.soc_end:.0f} % of charge"
        )
        header = ("task", "verdict", "reason", "energy [Wh]", "charge after [%]", "remedy")
        return [html.Summary(title, header, rows)]

    def task(self, name: str) -> TaskReport:
        """Return the report of the named task.

        Raises
        ------
        UnknownNameError
            If the mission has no such task.
        """
        known = {task.name: task for task in self.tasks}
        if name not in known:
            raise UnknownNameError("task", name, known)
        return known[name]

    @property
    def table(self) -> pd.DataFrame:
        """One row for each task, the flagged ones first, then in the order of their visits."""
        rank = {name: k for k, name in enumerate(self.order)}
        rows = sorted(
            self.tasks, key=lambda t: (t.verdict == "reachable", rank.get(t.name, len(rank)))
        )
        columns = (
            "name", "verdict", "reason", "reachable_alone", "energy", "energy_upper", "soc_after",
            "shortfall", "remedy",
        )  # fmt: skip
        return pd.DataFrame([[getattr(t, c) for c in columns] for t in rows], columns=list(columns))


def leg_reports(walk: Walk, end: Condition) -> tuple[LegReport, ...]:
    """Return the drives of a mission."""
    names, node, legs = walk.legs.names, walk.start.node, []
    for piece in end.pieces:
        if piece.leg is not None and piece.leg.trajectory is not None:
            legs.append(
                LegReport(
                    names[node], names[piece.goal], float(piece.t[0]), piece.leg.energy.mean,
                    piece.leg.trajectory, piece.soc, piece.soc_lower,
                )
            )  # fmt: skip
        node = piece.goal
    return tuple(legs)


def charger_reports(walk: Walk, end: Condition) -> tuple[ChargerReport, ...]:
    """Return how each charger is used."""
    found = []
    for node in walk.legs.chargers:
        visits = [p for p in end.pieces if p.kind == "charge" and p.goal == node]
        duration = sum(float(p.t[-1] - p.t[0]) for p in visits)
        energy = sum(float(-p.power[:-1] @ np.diff(p.t)) for p in visits)
        found.append(ChargerReport(walk.legs.names[node], len(visits), duration, energy))
    return tuple(found)


def timeline(walk: Walk, end: Condition) -> Timeline:
    """Return the mission over time."""
    columns: list[list[np.ndarray]] = [[] for _ in range(8)]
    for piece in end.pieces:
        drive = None if piece.leg is None else piece.leg.trajectory
        if drive is None:
            x, y, yaw = (np.full(len(piece.t), value) for value in walk.legs.poses[piece.goal])
        else:
            x, y, yaw = drive.x, drive.y, drive.yaw
        mirror = np.minimum(2 * piece.soc - piece.soc_lower, 1.0)
        parts = (piece.t, x, y, yaw, piece.power, piece.soc, piece.soc_lower, mirror)
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    return Timeline(*(np.concatenate(c) if c else np.zeros(0) for c in columns))


def doubts(walk: Walk, end: Condition) -> tuple[Doubt, ...]:
    """Tell what each unknown costs between the charges where the most is held back."""
    spent = max((*end.stretches, end.spent), key=lambda stretch: stretch.std)
    whole, quantile = spent.std, walk.quantile
    return tuple(
        Doubt(source, std, quantile * (whole - float(np.sqrt(max(whole**2 - std**2, 0.0)))))
        for source, std in walk.legs.grounds.by_source(spent).items()
    )
