"""What the evaluation of a mission tells, and how it is told from the mission's end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from energyplan import html
from energyplan.errors import UnknownNameError
from energyplan.mission.simulation import State, Walk
from energyplan.mission.tasks import Remedy
from energyplan.mission.types import Mission
from energyplan.path import FloatArray, Path, Pose, Trajectory

Verdict = Literal["reachable", "unreachable"]
_INSTANT = 0.5  # a shorter wait is no line of the timetable [s]

StopKind = Literal["start", "task", "charge", "end"]
Reason = Literal["none", "no_path", "motor", "battery", "blocked_by_earlier", "late", "time_limit"]


@dataclass(frozen=True)
class TaskReport:
    """What comes of one task."""

    name: str  # the task
    verdict: Verdict
    reason: Reason  # why not
    reachable_alone: bool  # whether it would be reachable as the mission's only task
    energy: float  # [J]
    energy_upper: float  # [J]
    soc_after: float  # expected state of charge when it is done
    shortfall: float  # missing energy, including the route to a safe place and the reserve [J]
    remedy: str  # what would make the task reachable
    detail: str = ""  # why not, in one sentence with figures
    start: float = np.nan  # when it begins [s]
    remedies: tuple[Remedy, ...] = ()  # the remedies that a program can apply
    arrival: float = np.nan  # when the robot gets there and leaves [s]
    departure: float = np.nan  # when the robot gets there and leaves [s]
    soc_lower: float = np.nan  # state of charge at the bound when it is done
    start_upper: float = np.nan  # when it begins at the latest, at the confidence asked [s]


@dataclass(frozen=True)
class Stop:
    """A place at which the robot stops, and when."""

    name: str  # the place
    kind: StopKind  # what it stops for
    pose: Pose  # where [m], [rad]
    arrival: float  # when it gets there and leaves [s]
    departure: float  # when it gets there and leaves [s]
    soc: float  # state of charge on leaving, expected and at the bound
    soc_lower: float  # state of charge on leaving, expected and at the bound


@dataclass(frozen=True, eq=False)
class LegReport:
    """A drive from one stop to the next."""

    start: str  # the places
    goal: str  # the places
    departure: float  # when it begins [s]
    energy: float  # energy, as expected [J]
    trajectory: Trajectory  # the drive, from time 0
    soc: FloatArray  # (n,): state of charge at each of its samples, expected and at the bound
    soc_lower: FloatArray  # (n,): state of charge at each of its samples, expected and at the bound


@dataclass(frozen=True)
class Activity:
    """A line of a mission's timetable."""

    start: float  # when it begins and ends [s]
    end: float  # when it begins and ends [s]
    kind: Literal["drive", "wait", "work", "charge"]  # what the robot does
    place: str  # where; of a drive, from where to where
    soc_start: float  # state of charge as expected, before and after
    soc_end: float  # state of charge as expected, before and after


@dataclass(frozen=True)
class ChargerReport:
    """How a charger is used."""

    name: str  # the charger
    visits: int  # how often the robot charges there
    duration: float  # how long in all [s]
    energy: float  # energy that it supplies, as expected [J]


@dataclass(frozen=True)
class Doubt:
    """What one unknown costs."""

    source: str  # what is not known
    energy: float  # standard deviation that it alone gives the energy [J]
    saving: float  # [J]


@dataclass(frozen=True)
class Timeline:
    """The mission over time; arrays of one shape."""

    t: FloatArray  # (n,): time [s]
    x: FloatArray  # (n,): pose [m], [rad]
    y: FloatArray  # (n,): pose [m], [rad]
    yaw: FloatArray  # (n,): pose [m], [rad]
    power: FloatArray  # (n,): power at the battery from each time to the next [W]
    soc: FloatArray  # (n,): state of charge
    soc_lower: FloatArray  # (n,): state of charge
    soc_upper: FloatArray  # (n,): state of charge


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

    @property
    def sentence(self) -> str:
        """The headline, how long what can be done takes, and how much of that is charging."""
        charging = sum(one.duration for one in self.chargers)
        told = f"{self.duration / 60:.0f} min"
        told += f", {charging / 60:.0f} min of which charging" if charging else ""
        subject = "" if self.feasible else " what can be done takes"
        return f"{self.headline};{subject} {told}" if self.duration else self.headline

    @property
    def timetable(self) -> tuple[Activity, ...]:
        """What the robot does from when to when, in the order of time."""
        begins = {task.name: task.start for task in self.tasks}
        spans: list[tuple[float, float, Literal["drive", "wait", "work", "charge"], str]] = [
            (leg.departure, leg.departure + leg.trajectory.duration, "drive",
             f"{leg.start} to {leg.goal}")
            for leg in self.legs
        ]  # fmt: skip
        for stop in self.route[1:-1]:
            begin = stop.arrival if stop.kind == "charge" else begins[stop.name]
            if begin > stop.arrival + _INSTANT:
                spans.append((stop.arrival, begin, "wait", stop.name))
            kind: Literal["work", "charge"] = "charge" if stop.kind == "charge" else "work"
            spans.append((begin, stop.departure, kind, stop.name))
        spans.sort(key=lambda span: span[:2])
        charge = [np.interp(span[:2], self.timeline.t, self.timeline.soc) for span in spans]
        return tuple(
            Activity(*span, *map(float, soc)) for span, soc in zip(spans, charge, strict=True)
        )

    @property
    def tables(self) -> tuple[html.Summary, ...]:
        """The report as titled rows: tasks, timetable, and what is uncertain."""
        tasks = [
            (task.name, task.verdict, task.reason.replace("_", " ").replace("none", "-"),
             *(html.number(joules / 3600) if np.isfinite(joules) else "-"
               for joules in (task.energy, task.energy_upper)),
             f"{100 * task.soc_after:.0f} %" if np.isfinite(task.soc_after) else "-",
             task.remedy or "-")
            for task in map(self.task, self.table["name"])
        ]  # fmt: skip
        times = [
            (_clock(one.start), one.kind, one.place, f"{(one.end - one.start) / 60:.1f}",
             f"{100 * one.soc_start:.0f} %", f"{100 * one.soc_end:.0f} %")
            for one in self.timetable
        ]  # fmt: skip
        unknown = [
            (
                html.words(one.source),
                *(html.number(part / 3600, 2) for part in (one.energy, one.saving)),
            )
            for one in self.uncertainty
        ]
        wh = f"{html.number(self.energy / 3600)} Wh"
        most = f"{html.number(self.energy_upper / 3600)} Wh"
        sure = f"{100 * self.mission.confidence:.0f} %"
        left = f"{100 * self.soc_end:.0f} % of charge at the end"
        found = (
            html.Summary(f"Tasks: {wh}, at {sure} confidence at most {most}; {left}", (
                "task", "verdict", "reason", "energy [Wh]", "at most [Wh]", "charge after", "remedy"
            ), tasks),
            html.Summary("Timetable", (
                "time", "what", "where", "minutes", "charge from", "to"
            ), times),
            html.Summary("Uncertainty of the energy", (
                "source", "1 sigma [Wh]", "margin freed if known [Wh]"
            ), unknown),
        )  # fmt: skip
        return tuple(one for one in found if one.rows)

    def _summaries(self) -> list[html.Summary]:
        title = f"{self.mission.name}: {self.sentence}"
        return [html.Summary(title, (), (), self.warnings), *self.tables]

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


def _clock(seconds: float) -> str:
    """Return a time as hours, minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def leg_reports(walk: Walk, end: State) -> tuple[LegReport, ...]:
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


def charger_reports(walk: Walk, end: State) -> tuple[ChargerReport, ...]:
    """Return how each charger is used."""
    found = []
    for node in walk.legs.chargers:
        visits = [p for p in end.pieces if p.kind == "charge" and p.goal == node]
        duration = sum(float(p.t[-1] - p.t[0]) for p in visits)
        energy = sum(float(-p.power[:-1] @ np.diff(p.t)) for p in visits)
        found.append(ChargerReport(walk.legs.names[node], len(visits), duration, energy))
    return tuple(found)


def timeline(walk: Walk, end: State) -> Timeline:
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


def doubts(walk: Walk, end: State) -> tuple[Doubt, ...]:
    """Tell what each unknown costs between the charges where the most is held back."""
    spent = max((*end.stretches, end.spent), key=lambda stretch: stretch.std)
    whole, quantile = spent.std, walk.quantile
    return tuple(
        Doubt(source, std, quantile * (whole - float(np.sqrt(max(whole**2 - std**2, 0.0)))))
        for source, std in walk.legs.grounds.by_source(spent).items()
    )
