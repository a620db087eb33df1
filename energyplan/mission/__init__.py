"""Battery budget missions: what can be done, with what certainty, and why not.

A task is reachable only if the robot can do it and still get to where it started or to a charger
with its reserve, at the confidence asked. Energies carry their uncertainty along (see
`energyplan.mission.energy`); the battery is run twice, with the energy as expected and with the
energy at its bound.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.kinds import checked
from energyplan.mission.choice import Course, best_course, best_stops
from energyplan.mission.condition import Attempt, Condition
from energyplan.mission.energy import Estimate
from energyplan.mission.legs import Legs, Routes
from energyplan.mission.many import Evaluated, evaluate_many
from energyplan.mission.report import (
    ChargerReport,
    Doubt,
    LegReport,
    MissionReport,
    Reason,
    Stop,
    TaskReport,
    Timeline,
    charger_reports,
    doubts,
    leg_reports,
    timeline,
)
from energyplan.mission.simulation import SAGS, Walk
from energyplan.mission.tasks import Charger, Remedy, Spreads, Task
from energyplan.mission.types import Mission

__all__ = [
    "Charger", "ChargerReport", "Doubt", "Evaluated", "LegReport", "Mission", "MissionReport",
    "Remedy", "Routes", "Spreads", "Stop", "Task", "TaskReport", "Timeline", "evaluate",
    "evaluate_many",
]  # fmt: skip

_CANDIDATES = 5
"""How many earlier tasks are tried as the one to drop."""

_CONFIRMED = 8
"""Remedies of a free order of so many tasks are confirmed by solving it anew."""

_FINER = 0.01
"""Steps in which strings are added, in units of those that the battery has."""

_MOST = 10.0
"""Batteries beyond so many times the one on board are not proposed."""


@checked(MissionError)
def evaluate(
    mission: Mission, progress: Callable[[str], None] | None = None, *, routes: Routes | None = None
) -> MissionReport:
    """Find which tasks of a mission can be done, and the energy that they take.

    Parameters
    ----------
    mission : Mission
        The mission. For one that is under way, `Mission.resume` gives the rest.
    progress : callable, optional
        Called with one line of text whenever a route is planned or an order is found.
    routes : Routes, optional
        Routes planned before; those that are planned now are added.

    Returns
    -------
    MissionReport
        A verdict with its reason and remedy for each task, and the mission as a whole.

    Raises
    ------
    MissionError
        If a bound is asked of models without a known uncertainty, or a payload leaves the range
        of its models.
    MissingDependencyError
        If a free order of many tasks is asked and OR-Tools is not installed.

    References
    ----------
    docs/missions.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from energyplan.io.mission import read_mission
    >>> from energyplan.io.files import bundled
    >>> mission = replace(read_mission(bundled("mission_warehouse.yaml")), planning_effort=250)
    >>> evaluate(mission).feasible
    True
    """
    return _Evaluation(mission, progress, Legs(mission, progress, routes)).report()


class _Try(NamedTuple):
    """A task's attempt, the condition before it, and the tasks done until then."""

    before: Condition
    attempt: Attempt
    earlier: tuple[int, ...]


class _Evaluation:
    """One mission on its way to a report."""

    def __init__(
        self,
        mission: Mission,
        progress: Callable[[str], None] | None,
        legs: Legs,
    ) -> None:
        self.mission = mission
        self.legs = legs
        self.walk = Walk(self.legs)
        self.progress = progress
        self.attempts: dict[int, _Try] = {}
        self.done: list[int] = []
        self.proven = mission.order == "given"
        self.gap = 0.0 if self.proven else float(np.nan)

    def report(self) -> MissionReport:
        """Do the tasks, find the way home, and explain what is left out."""
        state = self.go()
        last = self.walk.finish(state)
        tasks = tuple(self._task(k) for k in range(len(self.mission.tasks)))
        missed = [
            told.name
            for told, task in zip(tasks, self.mission.tasks, strict=True)
            if task.required and told.verdict == "unreachable"
        ]
        end = state if last is None else last
        drives = [piece.leg.path for piece in end.pieces if piece.leg is not None]
        return MissionReport(
            mission=self.mission,
            tasks=tasks,
            order=self._order(end),
            energy=end.total.mean,
            energy_upper=end.total.upper(self.walk.quantile),
            soc_end=end.expected.soc,
            soc_end_lower=end.worst.soc,
            feasible=last is not None and not missed,
            end=self.legs.names[end.node],
            duration=end.time - self.mission.time,
            proven=self.proven,
            gap=self.gap,
            timeline=timeline(self.walk, end),
            paths=tuple(drives),
            trajectories=tuple(
                piece.leg.trajectory
                for piece in end.pieces
                if piece.leg is not None and piece.leg.trajectory is not None
            ),
            route=self._route(end),
            uncertainty=doubts(self.walk, end),
            legs=leg_reports(self.walk, end),
            chargers=charger_reports(self.walk, end),
            warnings=self._warnings(),
        )

    # -- the way ----------------------------------------------------------------------------------

    def go(self) -> Condition:
        """Do the tasks that can be done."""
        return self._given() if self.mission.order == "given" else self._free()

    def _given(self) -> Condition:
        course = best_course(self.walk)
        for task, before, attempt in course.steps:
            self.attempts[task] = _Try(before, attempt, tuple(self.done))
            self.done.append(task)
        for k in range(len(self.mission.tasks)):
            if k not in self.attempts:
                before, done = self._before(course, k)
                self.attempts[k] = _Try(before, self.walk.attempt_charged(before, k), done)
        return course.state

    def _before(self, course: Course, task: int) -> tuple[Condition, tuple[int, ...]]:
        """Return where the robot stands when a task that was left out would have its turn."""
        earlier = [step for step in course.steps if step[0] < task]
        state = earlier[-1][2].after if earlier else self.walk.start
        return state, tuple(step[0] for step in earlier)

    def _free(self) -> Condition:
        found = best_stops(self.walk, self.progress)
        self.proven, self.gap = found.proven, found.gap
        state = self.walk.start
        for at, (stop, hurried) in enumerate(zip(found.stops, found.hurried, strict=True)):
            if stop in self.legs.chargers:
                docked = self.walk.drive(state, stop, hurried)
                if docked is not None and self.walk.holds(docked):
                    rest = found.stops[at + 1 :], found.hurried[at + 1 :]
                    leave = self.walk.leave_by(docked, *rest)
                    state = self.walk.charge(docked, leave)
            else:
                state = self._do(state, stop - 1, hurried)
        for k in range(len(self.mission.tasks)):
            if k not in self.attempts:
                state = self._do(state, k)
        return state

    def _do(self, state: Condition, task: int, hurried: bool = False) -> Condition:
        attempt = self.walk.attempt(state, task, hurried)
        if attempt.reason != "none":
            attempt = self.walk.attempt_charged(state, task)
        self.attempts[task] = _Try(state, attempt, tuple(self.done))
        if attempt.reason != "none":
            return state
        self.done.append(task)
        return attempt.after

    def _order(self, end: Condition) -> tuple[str, ...]:
        stops: list[int] = []
        places = {*range(1, 1 + len(self.mission.tasks)), *self.legs.chargers}
        done = {task + 1 for task in self.done}
        nodes = [piece.goal for piece in end.pieces if piece.kind in ("drive", "work", "charge")]
        order = [node for node in nodes if node in places]
        for node in order:
            if not stops or stops[-1] != node:
                stops.append(node)
        still = [node for node in done if node not in stops]
        return tuple(self.legs.names[node] for node in (*still, *stops))

    def _arrival(self, task: int) -> float:
        """Return when the robot got to a task that is done [s]."""
        after = self.attempts[task].attempt.after
        arrival = after.time
        for piece in reversed(after.pieces):
            if piece.goal != task + 1 or piece.kind not in ("wait", "work"):
                break
            arrival = float(piece.t[0])
        return arrival

    def _route(self, end: Condition) -> tuple[Stop, ...]:
        """Return the stops: the start, tasks and charges in the order of their times, the end."""
        names, poses, start = self.legs.names, self.legs.poses, self.walk.start
        stops = []
        for k in self.done:
            after = self.attempts[k].attempt.after
            charge = after.expected.soc, after.worst.soc
            times = self._arrival(k), after.time
            stops.append(Stop(names[k + 1], "task", poses[k + 1], *times, *charge))
        for piece in end.pieces:
            if piece.kind == "charge":
                times, charge = piece.t[[0, -1]].tolist(), (piece.soc[-1], piece.soc_lower[-1])
                node = piece.goal
                stops.append(Stop(names[node], "charge", poses[node], *times, *map(float, charge)))
        stops.sort(key=lambda stop: stop.arrival)
        first = Stop(names[0], "start", poses[0], start.time, start.time, *[start.expected.soc] * 2)
        charge = end.expected.soc, end.worst.soc
        last = Stop(names[end.node], "end", poses[end.node], end.time, end.time, *charge)
        return (first, *stops, last)

    def _warnings(self) -> tuple[str, ...]:
        battery = self.mission.battery
        notes: tuple[str, ...] = ()
        if isinstance(battery, Battery):
            notes = tuple(filter(None, (battery.temperature_note, *battery.notes)))
        return (*self.mission.notes, *notes)

    # -- verdicts ---------------------------------------------------------------------------------

    def _task(self, k: int) -> TaskReport:
        task = self.mission.tasks[k]
        before, attempt, earlier = self.attempts[k]
        if attempt.reason == "none" and k not in self.done:
            return self._left_out(k, attempt, earlier)
        if attempt.reason == "none":
            used = _between(before, attempt.after)
            return TaskReport(
                task.name, "reachable", "none", True, used.mean, used.upper(self.walk.quantile),
                attempt.after.expected.soc, 0.0, "", "", attempt.after.time - task.dwell,
                arrival=self._arrival(k), departure=attempt.after.time,
                soc_lower=attempt.after.worst.soc, start_upper=attempt.begin,
            )  # fmt: skip
        alone = attempt if not self.done else self.walk.attempt_charged(self.walk.start, k)
        blocked = alone.reason == "none"
        # What a task leaves another one may have to bring; alone it cannot be judged.
        told = attempt if blocked or alone.reason == "payload" else alone
        reason: Reason = "blocked_by_earlier" if blocked else _REASONS[told.reason]
        lacking = told.reason == "battery"
        used = _between(before if blocked else self.walk.start, told.after)
        remedies, remedy = self._remedy(k, reason, told)
        return TaskReport(
            name=task.name,
            verdict="unreachable",
            reason=reason,
            reachable_alone=blocked,
            energy=used.mean if lacking else np.nan,
            energy_upper=used.upper(self.walk.quantile) if lacking else np.nan,
            soc_after=told.after.expected.soc if lacking else np.nan,
            shortfall=self.walk.shortfall(told.safe) if lacking else 0.0,
            remedy=remedy,
            detail=told.detail,
            remedies=remedies,
        )

    def _left_out(self, k: int, attempt: Attempt, earlier: tuple[int, ...]) -> TaskReport:
        """Report a task that could be done, but for which a later one could then not be."""
        task = self.mission.tasks[k]
        used = _between(self.attempts[k].before, attempt.after)
        later = [self.mission.tasks[d].name for d in self.done if d not in earlier]
        names = ", ".join(repr(name) for name in later) or "the rest of the route"
        remedies, remedy = self._remedy(k, "blocked_by_earlier", attempt)
        return TaskReport(
            task.name, "unreachable", "blocked_by_earlier", True, used.mean,
            used.upper(self.walk.quantile), attempt.after.expected.soc, 0.0, remedy,
            f"left out, since with it the battery would not last for {names}", remedies=remedies,
        )  # fmt: skip

    def _remedy(self, k: int, reason: Reason, told: Attempt) -> tuple[tuple[Remedy, ...], str]:
        """Return what makes a task reachable, and the sentence that says so."""
        if reason == "no_path":
            return (), f"clear the route or move the task: {told.detail}"
        remedies, advice = self._drop(k) if reason == "blocked_by_earlier" else [], ""
        if told.reason == "late":
            remedies += self._sooner(k, told)
        elif told.reason == "time":
            advice = "give more planning_time or planning_effort"
        elif told.reason == "payload":
            advice = "put a task before it that takes the payload on board"
        elif told.reason == "motor":
            advice = f"take another route or a stronger drive: {told.detail}"
            if self.mission.payload > 0:
                advice += ", or leave payload behind"
        elif told.reason == "no_path":
            advice = f"clear the route back: {told.detail}"
        else:
            earlier = self.attempts[k].earlier if reason == "blocked_by_earlier" else ()
            tasks = (*earlier, k)
            remedies += [
                *self._slower(tasks, told.safe),
                *self._charge_first(tasks),
                *self._larger_battery(tasks, told.safe),
                *self._smaller_reserve(tasks),
            ]
        hints = [*map(str, remedies), *([advice] if advice else [])]
        return tuple(remedies), ", or ".join(hints) or told.detail

    def _sooner(self, k: int, told: Attempt) -> list[Remedy]:
        """Tell what brings the robot there in time: speed, or a wider window."""
        task, tasks = self.mission.tasks[k], (*self.attempts[k].earlier, k)
        top = float(self.mission.vehicle.motor.speed)
        now = self.mission.tread_speed
        faster = np.isfinite(top) and (now is None or now < top)
        speeds = [Remedy("speed", top, "m/s")] if faster else []
        in_turn = self.attempts[k].attempt
        times = [self.walk.latest(a.after) for a in (told, in_turn) if a.reason == "late"]
        late = sorted({float(np.ceil(time - task.window[1])) for time in times})
        windows = [Remedy("window", s, "s", task.name) for s in (*late, 2 * late[-1])]
        return [*self._first(tasks, speeds), *self._first(tasks, windows)]

    def _drop(self, k: int) -> list[Remedy]:
        """Name a task without which this one can be done, the least worth first."""
        tasks, (_, attempt, earlier) = self.mission.tasks, self.attempts[k]
        others = self.done if attempt.reason == "none" else earlier
        ranked = sorted(others, key=lambda d: (tasks[d].required, tasks[d].prize, -d))
        for dropped in ranked[:_CANDIDATES]:
            rest = [d for d in earlier if d != dropped]
            remedy = Remedy("drop", task=tasks[dropped].name)
            if tasks[dropped].required and not tasks[k].required:
                continue
            if self._follow(self.walk, [*rest, k]) and self._holds(k, remedy):
                return [remedy]
        return []

    def _follow(self, walk: Walk, tasks: Sequence[int]) -> bool:
        state = walk.start
        for task in tasks:
            attempt = walk.attempt_charged(state, task)
            if attempt.reason != "none":
                return False
            state = attempt.after
        return True

    def _charge_first(self, tasks: Sequence[int]) -> list[Remedy]:
        """Tell the state of charge with which to leave so that the task can be done."""
        if self.mission.soc >= 1:
            return []
        levels = np.arange(np.ceil(100 * self.mission.soc) + 1, 101) / 100
        remedies = [Remedy("charge", float(level), "1") for level in levels]
        low, high = 0, len(levels) - 1
        if high < 0 or not self._works(tasks, remedies[high]):
            return []
        while low < high:
            middle = (low + high) // 2
            low, high = (
                (low, middle) if self._works(tasks, remedies[middle]) else (middle + 1, high)
            )
        return [remedies[high]]

    def _larger_battery(self, tasks: Sequence[int], safe: Condition) -> list[Remedy]:
        """Tell how much more the battery has to hold, in whole watt-hours, or to deliver.

        It has to hold more than is missing: part of it is reserve, and the load draws charge too.
        Where no energy is missing, what limits is its power: that of its strings.
        """
        full, powerless = self.mission.battery.full_energy, self.walk.lacks_power(safe)
        step = _FINER * full if powerless else 3600.0

        def remedy(n: int) -> Remedy:
            strings = Remedy("strings", 1.0 + _FINER * n, "1")
            return strings if powerless else Remedy("capacity", step * n, "J")

        low, high = 0, max(int(np.ceil(self.walk.shortfall(safe) / step)), 1)
        while not self._works(tasks, remedy(high)):
            low, high = high, 2 * high
            if step * high > _MOST * full:
                return []
        while high - low > max(0.02 * high, 1):
            middle = (low + high) // 2
            low, high = (low, middle) if self._works(tasks, remedy(middle)) else (middle, high)
        return [remedy(high)]

    def _smaller_reserve(self, tasks: Sequence[int]) -> list[Remedy]:
        least, now = self.mission.battery.cutoff_soc, self.mission.reserve
        reserves = [max(round(share * now, 3), least) for share in (0.75, 0.5, 0.25)]
        return self._first(tasks, [Remedy("reserve", r, "1") for r in reserves if r < now])

    def _slower(self, tasks: Sequence[int], safe: Condition) -> list[Remedy]:
        """Tell whether another speed helps: that of least energy, or one of less power."""
        given, top = self.mission.tread_speed, float(self.mission.vehicle.motor.speed)
        remedies = [] if given is None else [Remedy("cheapest_speed")]
        if safe.worst.failure in SAGS and np.isfinite(top):
            most = min(top, given or top)
            remedies += [Remedy("speed", share * most, "m/s") for share in (0.75, 0.5, 0.25)]
        return self._first(tasks, remedies)

    def _first(self, tasks: Sequence[int], remedies: Sequence[Remedy]) -> list[Remedy]:
        """Return the first of some remedies that works, if any does."""
        return next(([remedy] for remedy in remedies if self._works(tasks, remedy)), [])

    def _works(self, tasks: Sequence[int], remedy: Remedy) -> bool:
        """Tell whether the last of some tasks can be done after the others with a remedy."""
        walk = Walk(self.legs.under(self.mission.with_remedy(remedy)))
        return self._follow(walk, tasks) and self._holds(tasks[-1], remedy)

    def _holds(self, k: int, remedy: Remedy) -> bool:
        """Tell whether the whole mission with a remedy does the task.

        Others that it makes possible must not take what it gains; at another speed routes change.
        """
        if self.mission.order == "free" and len(self.mission.tasks) > _CONFIRMED:
            return True
        changed = self.mission.with_remedy(remedy)
        anew = remedy.kind in ("drop", "speed", "cheapest_speed")
        legs = Legs(changed, None, self.legs.routes) if anew else self.legs.under(changed)
        again = _Evaluation(changed, None, legs)
        again.go()
        name = self.mission.tasks[k].name
        return any(changed.tasks[d].name == name for d in again.done)


_REASONS: dict[str, Reason] = {
    "no_path": "no_path",
    "motor": "motor",
    "battery": "battery",
    "late": "late",
    "time": "time_limit",
    "payload": "blocked_by_earlier",
}


def _between(before: Condition, after: Condition) -> Estimate:
    """Return the energy from one condition to a later one."""
    return Estimate(
        after.total.mean - before.total.mean,
        after.total.sensitivity - before.total.sensitivity,
        after.total.noise - before.total.noise,
    )
