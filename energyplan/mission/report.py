"""The answer to a mission: what comes of each task, the trip, and what is not certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Literal

import numpy as np

from energyplan import html
from energyplan.errors import MissionError, UnknownNameError
from energyplan.mission.drive import Kind, Segment
from energyplan.mission.types import Mission, Remedy, RobotState
from energyplan.path import FloatArray, Path, Pose

StopKind = Literal["start", "task", "charge", "end"]
OrderKind = Literal["given", "row after row"]
Verdict = Literal["reachable", "unreachable"]
Reason = Literal[
    "none", "no_path", "motor", "battery", "blocked_by_earlier", "late", "time_limit", "payload"
]

_INSTANT = 0.5  # shortest wait that the timetable lists [s]


@dataclass(frozen=True)
class Stop:
    """A place at which the robot stops, and when."""

    name: str  # the place
    kind: StopKind  # purpose of the stop
    pose: Pose  # where [m], [rad]
    arrival: float  # when it gets there [s]
    departure: float  # when it leaves [s]
    soc: float  # state of charge on leaving, as expected
    soc_lower: float  # the same at the bound


@dataclass(frozen=True)
class Activity:
    """A line of a mission's timetable."""

    start: float  # when it begins [s]
    end: float  # when it ends [s]
    kind: Kind  # what the robot does
    place: str  # where; of a drive, from where to where
    soc_start: float  # state of charge before it, as expected
    soc_end: float  # state of charge after it, as expected
    peak_power: float  # largest power that the battery delivers, as expected [W]
    peak_current: float  # largest current that it delivers, as expected [A]


@dataclass(frozen=True)
class ChargerReport:
    """How a charger is used."""

    name: str  # the charger
    visits: int  # how often the robot charges there
    duration: float  # how long in all [s]
    energy: float  # energy that the battery takes there, at its terminals, as expected [J]
    energy_mains: float  # energy that the charger draws for it from the mains [J]


@dataclass(frozen=True)
class Timeline:
    """The mission over time; arrays of one shape."""

    t: FloatArray  # (n,): time [s]
    x: FloatArray  # (n,): x of the pose [m]
    y: FloatArray  # (n,): y of the pose [m]
    yaw: FloatArray  # (n,): heading of the pose [rad]
    power: FloatArray  # (n,): power at the battery from each time to the next [W]
    soc: FloatArray  # (n,): state of charge, as expected
    soc_lower: FloatArray  # (n,): the same at the bound

    @property
    def soc_upper(self) -> FloatArray:
        """As far above the expected state of charge as the bound is below."""
        return np.minimum(2 * self.soc - self.soc_lower, 1.0)


@dataclass(frozen=True)
class TaskReport:
    """What comes of one task."""

    name: str  # the task
    verdict: Verdict
    reason: Reason  # why not
    reachable_alone: bool  # whether it would be reachable as the mission's only task
    energy: float  # energy that it takes with the way there, as expected [J]
    energy_upper: float  # the same at the bound [J]
    soc_after: float  # expected state of charge when it is done
    shortfall: float = 0.0  # missing energy, with the route to a safe place and the reserve [J]
    remedy: str = ""  # what would make the task reachable
    detail: str = ""  # why not, in one sentence with figures
    start: float = np.nan  # when it begins [s]
    remedies: tuple[Remedy, ...] = ()  # the remedies that a program can apply
    arrival: float = np.nan  # when the robot gets there [s]
    departure: float = np.nan  # when it leaves [s]
    soc_lower: float = np.nan  # state of charge at the bound when it is done
    start_upper: float = np.nan  # when it begins at the latest, at the confidence wanted [s]
    reasons: tuple[str, ...] = ()  # of several robots, why each that has the skills cannot do it


@dataclass(frozen=True)
class Contribution:
    """What one unknown costs."""

    source: str  # what is not known
    energy: float  # standard deviation that it alone gives the energy [J]
    saving: float  # margin that would be freed if it were known [J]


@dataclass(frozen=True)
class Alternative:
    """The same tasks in another order, to compare with."""

    order: OrderKind
    energy: float  # energy that it takes, expected [J]; nan where not all can be done in it
    saving: float  # fraction of this energy that the order found saves


@dataclass(frozen=True, eq=False)
class MissionReport(html.Readable):
    """Which tasks can be done, in which order, with what energy."""

    mission: Mission
    tasks: tuple[TaskReport, ...]  # one for each task, in the order of the mission
    trip: tuple[Segment, ...]  # what the robot does, from its start to its end
    energy: float  # energy of the whole mission, expected [J]
    energy_upper: float  # the same at the bound [J]
    feasible: bool  # whether every required task is reachable and it ends where it must
    proven: bool  # whether, for a free order, no better one exists on the routes known
    gap: float = np.nan  # fraction of the energy that a better order could save; nan: not known
    # Largest first, between the charges where the largest margin is needed; without charges
    # that is the whole mission. The squares add up to the variance.
    uncertainty: tuple[Contribution, ...] = ()
    warnings: tuple[str, ...] = ()  # what to know before trusting the figures
    remedies: tuple[Remedy, ...] = ()  # changes with which the same is done in less time
    time_saved: float = 0.0  # by the remedies [s]
    alternatives: tuple[Alternative, ...] = ()  # of a free order with rows
    # Of several robots, what each does; its tasks are those that it does, in this order. The whole
    # has no trip of its own.
    robots: tuple[MissionReport, ...] = ()

    @cached_property
    def route(self) -> tuple[Stop, ...]:
        """The stops with their times, from the start to the end."""
        self._alone("route")
        return stops(self.trip)

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the stops in the order of their visits, chargers included."""
        self._alone("order")
        names = [stop.name for stop in self.route]
        chargers = {charger.name for charger in self.mission.chargers}
        last = [name for name in names[-1:] if name in chargers - {names[-2]}]
        return (*names[1:-1], *last)

    def _alone(self, what: str) -> None:
        """Refuse what a report of several robots has for each of them only."""
        if self.robots:
            names = ", ".join(repr(one.mission.name) for one in self.robots)
            raise MissionError(
                f"the report of several robots has no {what} of its own; use "
                f"report.robot(NAME).{what}, where NAME is one of {names}"
            )

    @property
    def _last(self) -> Stop:
        self._alone("end")
        return self.route[-1]

    @property
    def end(self) -> str:
        """Where the mission ends."""
        return self._last.name

    @property
    def duration(self) -> float:
        """From the beginning to the end, of several robots to the last one's [s]."""
        ends = [robot._last.arrival for robot in self.robots] or [self._last.arrival]
        return max(ends) - min(one.time for one in self.mission.parts or (self.mission,))

    @property
    def soc_end(self) -> float:
        """State of charge at the end, expected."""
        return self._last.soc

    @property
    def soc_end_lower(self) -> float:
        """State of charge at the end, at the bound."""
        return self._last.soc_lower

    def _parts(self, *kinds: str) -> tuple[Segment, ...]:
        trips = [robot.trip for robot in self.robots] or [self.trip]
        return tuple(part for trip in trips for part in trip if part.kind in kinds)

    @property
    def legs(self) -> tuple[Segment, ...]:
        """The drives from stop to stop, and along the paths of tasks."""
        return tuple(part for part in self._parts("drive", "work") if part.leg is not None)

    @property
    def charges(self) -> tuple[Segment, ...]:
        """The charges."""
        return self._parts("charge")

    @property
    def rows(self) -> dict[str, Path]:
        """The paths of tasks that are driven, in the direction of the drive, by task."""
        return {one.goal: one.leg.path for one in self._parts("work") if one.leg is not None}

    @property
    def paths(self) -> tuple[Path, ...]:
        """The paths of the drives."""
        return tuple(part.leg.path for part in self.legs if part.leg is not None)

    @property
    def chargers(self) -> tuple[ChargerReport, ...]:
        """How each charger is used."""
        return tuple(
            ChargerReport(
                one.name, len(here), sum(part.arrival - part.departure for part in here),
                energy, energy / one.efficiency,
            )
            for one in self.mission.chargers
            for here in [[part for part in self.charges if part.goal == one.name]]
            for energy in [-sum(part.energy for part in here)]
        )  # fmt: skip

    @property
    def waiting(self) -> float:
        """Time spent waiting for chargers [s]."""
        names = {charger.name for charger in self.mission.chargers}
        waits = (part for part in self._parts("wait") if part.goal in names)
        return sum(part.arrival - part.departure for part in waits)

    @property
    def left_out(self) -> tuple[TaskReport, ...]:
        """The tasks that are not done."""
        return tuple(task for task in self.tasks if task.verdict == "unreachable")

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Why each task that is left out cannot be done, in a sentence each."""
        return tuple(
            f"{one.name} is out of reach: {one.detail or one.reason.replace('_', ' ')}"
            for one in self.left_out
        )

    @property
    def timetable(self) -> tuple[Activity, ...]:
        """What the robot does from when to when, in the order of time."""
        self._alone("timetable")
        found = []
        for kind, group in groupby(self.trip, lambda part: part.kind):
            parts = list(group)
            waited = parts[-1].arrival - parts[0].departure
            if kind in ("start", "end") or (kind == "wait" and waited <= _INSTANT):
                continue
            spans = [(parts[0], parts[-1])] if kind == "wait" else [(part, part) for part in parts]
            for first, last in spans:
                place = f"{first.start} to {first.goal}" if kind == "drive" else first.goal
                soc = float(first.soc[0]), float(last.soc[-1])
                within = parts if kind == "wait" else [first]
                peaks = (max(getattr(part, name) for part in within)
                         for name in ("peak_power", "peak_current"))  # fmt: skip
                found.append(Activity(first.departure, last.arrival, kind, place, *soc, *peaks))
        return tuple(found)

    @cached_property
    def timeline(self) -> Timeline:
        """The mission over time."""
        self._alone("timeline")
        x, y, yaw = np.concatenate([part.poses for part in self.trip]).T
        t, power, soc, low = (
            np.concatenate([getattr(part, name) for part in self.trip])
            for name in ("t", "power", "soc", "soc_lower")
        )
        return Timeline(t, x, y, yaw, power, soc, low)

    @property
    def headline(self) -> str:
        """What comes of the mission, in one sentence that agrees with `feasible`."""
        needed = {task.name for task in self.mission.tasks if task.required}
        out = [task.name in needed for task in self.left_out]
        count = len(self.tasks)
        if not count:
            return "it has nothing to do"
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
        return f"all required tasks can be done; {left}" if needed else left

    @property
    def sentence(self) -> str:
        """The headline, how long what can be done takes, and what would make it shorter."""
        charging = sum(one.duration for one in self.chargers)
        text = f"{self.duration / 60:.0f} min"
        text += f", {charging / 60:.0f} min of which charging" if charging else ""
        for remedy in self.remedies:
            text += f"; {remedy}: {self.time_saved / 60:.0f} min less"
        subject = "" if self.feasible else " what can be done takes"
        return f"{self.headline};{subject} {text}" if self.duration else self.headline

    @property
    def doubt(self) -> str:
        """How much a better order could save; empty where none can, or none was looked for."""
        if self.proven or (self.mission.order == "given" and not self.robots):
            return ""
        if np.isnan(self.gap):
            return "how much a better order could save is not known"
        return f"a better order could save at most {100 * self.gap:.1f} % of the energy"

    @property
    def compared(self) -> str:
        """How the order found compares with others; empty where none was looked at."""
        names = {"given": "in the order given", "row after row": "row after row"}
        parts = []
        for one in self.alternatives:
            if np.isnan(one.energy):
                parts.append(f"{names[one.order]} not all of it can be done")
                continue
            percent = f"{100 * one.saving:.1f} % less than"
            parts.append(f"{'as much as' if one.saving < 5e-4 else percent} {names[one.order]}")
        return f"energy of the order found: {'; '.join(parts)}" if parts else ""

    @property
    def tables(self) -> tuple[html.Summary, ...]:
        """The report as titled rows: tasks, timetable, and what is uncertain."""
        if self.robots:
            return self._of_robots()
        tasks = [
            (task.name, task.verdict, task.reason.replace("_", " ").replace("none", "-"),
             *(html.number(joules / 3600) if np.isfinite(joules) else "-"
               for joules in (task.energy, task.energy_upper)),
             f"{100 * task.soc_after:.0f} %" if np.isfinite(task.soc_after) else "-",
             task.remedy or "-")
            for task in self._ranked
        ]  # fmt: skip
        times = [
            (html.clock(one.start), one.kind, one.place, f"{(one.end - one.start) / 60:.1f}",
             f"{100 * one.soc_start:.0f} %", f"{100 * one.soc_end:.0f} %",
             *(html.number(peak, 3) if peak else "-"
               for peak in (one.peak_power, one.peak_current)))
            for one in self.timetable
        ]  # fmt: skip
        sources = [html.words(one.source) for one in self.uncertainty]
        shares = zip(sources, *(
            html.column([getattr(one, kind) / 3600 for one in self.uncertainty])
            for kind in ("energy", "saving")
        ), strict=True)  # fmt: skip
        unknown = [row for row in shares if any(float(size) for size in row[1:])]
        wh = f"{html.number(self.energy / 3600)} Wh"
        most = f"{html.number(self.energy_upper / 3600)} Wh"
        sure = f"{100 * self.mission.confidence:.0f} %"
        left = f"{100 * self.soc_end:.0f} % of charge at the end, "
        left += f"at least {100 * self.soc_end_lower:.0f} %"
        found = (
            html.Summary(f"Tasks: {wh}, at {sure} confidence at most {most}; {left}", (
                "task", "verdict", "reason", "energy [Wh]", "at most [Wh]", "charge after", "remedy"
            ), tasks),
            html.Summary("Timetable", (
                "time", "what", "where", "minutes", "charge from", "to", "peak [W]", "peak [A]"
            ), times),
            self._of_chargers,
            html.Summary("Uncertainty of the energy", (
                "source", "1 sigma [Wh]", "margin freed if known [Wh]"
            ), unknown),
        )  # fmt: skip
        return tuple(one for one in found if one.rows)

    @property
    def _of_chargers(self) -> html.Summary:
        """The chargers that are used, as rows."""
        rows = [
            (one.name, one.visits, f"{one.duration / 60:.1f}", html.number(one.energy / 3600),
             html.number(one.energy_mains / 3600))
            for one in self.chargers
            if one.visits
        ]  # fmt: skip
        return html.Summary("Chargers", (
            "charger", "visits", "minutes", "into the battery [Wh]", "from the mains [Wh]"
        ), rows)  # fmt: skip

    def _of_robots(self) -> tuple[html.Summary, ...]:
        robots = [
            (one.mission.name, len(one.tasks), *(html.number(e / 3600) for e in (one.energy,
             one.energy_upper)), html.clock(one.mission.time), html.clock(one._last.arrival),
             f"{one.waiting / 60:.1f}",
             f"{100 * one.soc_end:.0f} %", f"{100 * one.soc_end_lower:.0f} %")
            for one in self.robots
        ]  # fmt: skip
        times = [
            (one.mission.name, html.clock(stop.arrival), stop.kind, stop.name,
             f"{(stop.departure - stop.arrival) / 60:.1f}", f"{100 * stop.soc:.0f} %")
            for one in self.robots
            for stop in one.route[1:]
        ]  # fmt: skip
        found = (
            html.Summary("Robots", (
                "robot", "tasks", "energy [Wh]", "at most [Wh]", "from", "to", "waiting [min]",
                "charge left", "at least"
            ), robots),
            html.Summary("Timetable", (
                "robot", "time", "what", "where", "minutes", "charge after"
            ), times),
            self._of_chargers,
            html.Summary("Not assigned", (
                "task", "why"
            ), [(task.name, task.detail) for task in self.left_out]),
        )  # fmt: skip
        return tuple(one for one in found if one.rows)

    def _summaries(self) -> list[html.Summary]:
        title = f"{self.mission.name}: {self.sentence}"
        notes = () if self.robots else (*filter(None, (self.compared,)), *self.obstacles)
        return [html.Summary(title, (), (), (*notes, *self.warnings)), *self.tables]

    def task(self, name: str) -> TaskReport:
        """Return the report of the named task."""
        known = {task.name: task for task in self.tasks}
        if name not in known:
            raise UnknownNameError("task", name, known)
        return known[name]

    def robot(self, name: str) -> MissionReport:
        """Return what one of several robots does."""
        known = {robot.mission.name: robot for robot in self.robots}
        if name not in known:
            names = ", ".join(known) or "none"
            raise MissionError(f"no robot is called {name!r}; the robots are {names}")
        return known[name]

    def share(self, name: str) -> Mission:
        """Return the mission of one of several robots: the tasks that it does, and no others."""
        robot = self.robot(name)
        own = {task.name for task in robot.tasks}
        tasks = tuple(task for task in robot.mission.tasks if task.name in own)
        return replace(robot.mission, tasks=tasks)

    def at(self, time: float) -> RobotState:
        """Return where the robot is at a time [s]; a stay under way by then is completed."""
        self._alone("at")
        here, now = self.trip[0], time
        pose, soc = here.pose, float(here.soc[0])
        for part in self.trip:
            if part.departure > now:
                break
            sample = -1
            if part.leg is not None and part.arrival > now:
                sample = int((part.t <= now).sum()) - 1
            pose, soc = Pose(*map(float, part.poses[sample])), float(part.soc[sample])
            if sample >= 0:
                break
            now = max(now, part.arrival)
        return RobotState(pose, soc, self.done_by(now), now)

    def done_by(self, time: float) -> tuple[str, ...]:
        """Return the tasks that are done by a time [s]."""
        self._alone("done_by")
        return tuple(s.name for s in self.route if s.kind == "task" and s.departure <= time)

    def after_failure(self, name: str, time: float) -> Mission:
        """Return what is left for the other robots when one fails at a time [s].

        They complete what they do then. What the robot that failed has done stays done.
        """
        failed = self.robot(name)
        states = {
            robot.mission.name: robot.at(time) for robot in self.robots if robot is not failed
        }
        return self.mission.resume_robots(states, failed.done_by(time))

    @property
    def _ranked(self) -> list[TaskReport]:
        """The tasks, the flagged ones first, then in the order of their visits."""
        rank = {name: k for k, name in enumerate(self.order)}
        return sorted(
            self.tasks, key=lambda t: (t.verdict == "reachable", rank.get(t.name, len(rank)))
        )


def stops(trip: Sequence[Segment]) -> tuple[Stop, ...]:
    """Return the start, the tasks and charges in the order of their times, and the end."""
    kinds: dict[Kind, StopKind] = {
        "start": "start", "work": "task", "charge": "charge", "end": "end"
    }  # fmt: skip
    found = []
    for _, parts in groupby(trip, lambda part: (part.goal, part.kind in ("start", "end"))):
        stays = [part for part in parts if part.kind != "drive"]
        for part in stays:
            if kind := kinds.get(part.kind):
                begin = stays[0].departure if kind == "task" else part.departure
                soc = float(part.soc[-1]), float(part.soc_lower[-1])
                found.append(Stop(part.goal, kind, part.pose, begin, part.arrival, *soc))
    return tuple(found)
