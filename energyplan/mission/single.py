"""One robot's mission on its way to a report: its drive, its verdicts and its remedies.

A task is reachable only if the robot can do it and still get to where it started or to a charger
with its reserve, at the confidence wanted. Energies carry their uncertainty along (see
`energyplan.mission.energy`); the battery is run twice, with the energy as expected and with the
energy at its bound.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Generator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from energyplan import html
from energyplan.battery import SAGS, Battery
from energyplan.errors import BatteryError
from energyplan.mission.drive import Attempt, Simulation, Status
from energyplan.mission.order import Order, attempt, best_stops, finish
from energyplan.mission.report import (
    Alternative,
    Contribution,
    MissionReport,
    OrderKind,
    Reason,
    TaskReport,
    stops,
)  # fmt: skip
from energyplan.mission.routes import Legs, Progress
from energyplan.mission.types import Mission, Remedy
from energyplan.path import ROUNDING


def contributions(sim: Simulation, end: Status) -> tuple[Contribution, ...]:
    """Return what each unknown costs between the charges where the margin is largest."""
    spent = max((*end.stretches, end.spent), key=lambda stretch: stretch.std)
    whole, quantile = spent.std, sim.quantile
    return tuple(
        Contribution(source, std, quantile * (whole - float(np.sqrt(max(whole**2 - std**2, 0.0)))))
        for source, std in sim.legs.models.by_source(spent).items()
    )


class Remedying(NamedTuple):
    """Constants of the search for remedies."""

    candidates: int = 5  # earlier tasks that are tried as the one to drop
    confirmed: int = 8  # tasks of a free order up to which a remedy is confirmed by solving it anew
    minute: float = 60.0  # least time that a remedy saves [s]
    finer: float = 0.01  # steps in which strings are added, in units of those of the battery
    plans: int = 2  # plans of one of several robots beyond one for each of its tasks
    most: float = 10.0  # batteries beyond so many times the one on board are not proposed


REMEDYING = Remedying()


class _Try(NamedTuple):
    """A task's attempt, the condition before it, and the tasks done until then."""

    before: Status
    attempt: Attempt
    earlier: tuple[int, ...]


class Docking(NamedTuple):
    """A robot that has come to a charger, and what it has before it."""

    state: Status
    stops: tuple[int, ...]
    hurried: tuple[bool, ...]


class Evaluation:
    """One mission on its way to a report."""

    def __init__(
        self, mission: Mission, progress: Progress, legs: Legs,
        tasks: Sequence[int] | None = None,
    ) -> None:  # fmt: skip
        self.mission = mission
        self.shared = tasks is not None
        self.tasks = range(len(mission.tasks)) if tasks is None else tasks
        self.legs = legs
        self.sim = Simulation(self.legs, saves=any(one.enough for one in mission.chargers))
        self.progress = progress
        self.attempts: dict[int, _Try] = {}
        self.before: dict[Remedy, tuple[str, ...]] = {}  # tasks that are done first with a remedy
        self.done: list[int] = []
        self.found = Order()
        self.end = self.sim.start

    def report(self) -> MissionReport:
        """Do the tasks, find the way home, and explain what is left out."""
        self.go()
        return self.written(finish(self.sim, self.end))

    def written(self, last: Status | None) -> MissionReport:
        """Return what comes of the tasks; `last` is where it ends, None where it cannot."""
        self.end = self.end if last is None else last
        alternatives = () if last is None else self._compared(last)
        # a robot's share has no remedies: what it cannot do is offered to the others
        shown = self.done if self.shared else self.tasks
        tasks = tuple(self._task(k) for k in shown)
        required = {task.name for task in self.mission.tasks if task.required}
        missed = [one for one in tasks if one.verdict == "unreachable" and one.name in required]
        end = self.end
        remedies, time_saved = ((), 0.0) if last is None or self.shared else self._less_charge(end)
        return MissionReport(
            mission=self.mission,
            tasks=tasks,
            trip=self.sim.mark(end, "end").trip,
            energy=end.total.mean,
            energy_upper=end.total.upper(self.sim.quantile),
            feasible=last is not None and not missed,
            proven=self.found.proven,
            gap=self.found.gap,
            uncertainty=contributions(self.sim, end),
            warnings=self._warnings(),
            remedies=remedies,
            time_saved=time_saved,
            alternatives=alternatives,
        )

    def _compared(self, end: Status) -> tuple[Alternative, ...]:
        """Return what the same tasks take in the order given, and row after row.

        Where one of these takes less than what the search found, it is the answer.
        """
        rows = [k for k in sorted(self.done) if self.mission.tasks[k].path]
        if self.mission.order == "given" or self.shared or len(rows) < 2:
            return ()
        orders: dict[OrderKind, list[int]] = {"given": sorted(self.done)}
        if len(rows) == len(self.done):
            orders["row after row"] = row_after_row(self.legs, rows)
        energies, best = dict[OrderKind, float](), end.total.mean
        legs = self.legs.under(replace(self.mission, order="given"))
        for name, tasks in orders.items():
            again = Evaluation(legs.mission, self.progress, legs, tasks)
            again.go()
            last = finish(again.sim, again.end)
            energies[name] = np.nan
            if last is None or len(again.done) < len(self.done):
                continue
            energies[name] = last.total.mean
            if last.total.mean < best - ROUNDING * abs(best):
                self.attempts |= again.attempts
                self.done, self.end, best = again.done, last, last.total.mean
                gap = max(1.0 - self.found.bound / best, 0.0) if best > 0 else np.nan
                self.found = replace(again.found, bound=self.found.bound).answer(gap)
        return tuple(Alternative(name, one, 1.0 - best / one) for name, one in energies.items())

    # -- the way ----------------------------------------------------------------------------------

    def go(self) -> None:
        """Do the tasks that can be done."""
        sim, state = self.sim, self.sim.start
        given = self.mission.order == "given"
        found = best_stops(sim, tasks=self.tasks, progress=self.progress)
        self.found = found
        turns = [state] * len(self.mission.tasks)  # where the robot is when a task has its turn
        for at, stop in enumerate(found.stops):
            visit = (
                found.visits[at] if found.visits and not sim.saves
                else sim.visit(state, found.stops[at:], found.hurried[at:])
            )  # fmt: skip
            if visit.attempt is not None:
                task = self.legs.task_at(stop)
                state = self._done(state, task, visit.attempt)
                turns[task + 1 :] = [state] * len(turns[task + 1 :])
            elif visit.after is not None:
                state = visit.after
        for k in self.tasks:
            if k not in self.attempts and given:
                earlier = tuple(d for d in self.done if d < k)
                self.attempts[k] = _Try(turns[k], attempt(sim, turns[k], k), earlier)
            elif k not in self.attempts:
                state = self._done(state, k, sim.nearest(state, k))
        self.end = state

    def among_others(self, found: Order) -> Generator[Docking, Status | None]:
        """Do the tasks of one of several robots, in an order that was found for it alone.

        Where it docks it stands on the clock of all: it is sent its state after the charge, or None
        where it cannot wait. What then does not hold is planned anew from where it is.
        """
        sim, state, left = self.sim, self.sim.start, list(self.tasks)
        self.found = found
        for _ in range(len(left) + REMEDYING.plans):
            before = state
            for at, (stop, quick) in enumerate(zip(found.stops, found.hurried, strict=True)):
                after = None
                if stop in self.legs.chargers:
                    docked = sim.dock(state, stop, quick)
                    if docked is not None:
                        rest = found.stops[at + 1 :], found.hurried[at + 1 :]
                        after = yield Docking(docked, *rest)
                elif (tried := sim.attempt(state, stop, quick)).reason == "none":
                    task, after = self.legs.task_at(stop), tried.after
                    self.attempts[task] = _Try(state, tried, tuple(self.done))
                    self.done.append(task)
                    left.remove(task)
                if after is None:
                    break
                state = after
            self.end = state
            home = not left and sim.arrives(state) is not None
            if home or not found.stops or state is before:
                break
            found = best_stops(sim, state, left, self.progress)

    def _done(self, state: Status, task: int, tried: Attempt) -> Status:
        """Return the state after a task that was tried; if need be after charging or in a hurry."""
        if tried.reason != "none":
            tried = attempt(self.sim, state, task)
        self.attempts[task] = _Try(state, tried, tuple(self.done))
        if tried.reason != "none":
            return state
        self.done.append(task)
        return tried.after

    def _warnings(self) -> tuple[str, ...]:
        battery = self.mission.battery
        notes: tuple[str, ...] = ()
        if isinstance(battery, Battery):
            notes = tuple(filter(None, (battery.temperature_note, *battery.notes)))
        if self.legs.stopped:
            notes += (
                f"planning was stopped by the clock on {len(self.legs.stopped)} routes, so the "
                "report depends on the load; give more planning_time, or leave it out",
            )
        return (*self.mission.notes, *notes, *self._uncharged())

    def _uncharged(self) -> tuple[str, ...]:
        """Return at which chargers the battery takes no charge, and why."""
        found: dict[str, list[str]] = {}
        for charger in self.mission.chargers:
            found.setdefault(self.mission.charging_fault(charger), []).append(repr(charger.name))
        return tuple(
            f"no charge at {', '.join(names)}: {fault}" for fault, names in found.items() if fault
        )

    # -- verdicts ---------------------------------------------------------------------------------

    def _task(self, k: int) -> TaskReport:
        task = self.mission.tasks[k]
        before, tried, earlier = self.attempts[k]
        quantile = self.sim.quantile
        if tried.reason == "none":
            used, after = tried.after.total.since(before.total), tried.after
            found = TaskReport(
                task.name, "reachable", "none", True, used.mean, used.upper(quantile),
                after.expected.soc,
            )  # fmt: skip
            if k in self.done:
                stop = stops(after.trip)[-1]
                return replace(
                    found, start=after.trip[-1].departure, arrival=stop.arrival,
                    departure=after.time, soc_lower=after.worst.soc, start_upper=tried.begin,
                )  # fmt: skip
            # it could be done, but a later one could then not be
            later = [self.mission.tasks[d].name for d in self.done if d not in earlier]
            names = ", ".join(repr(name) for name in later) or "the rest of the route"
            remedies, remedy = self._remedy(k, "blocked_by_earlier", tried)
            detail = f"left out, since with it the battery would not last for {names}"
            return replace(
                found, verdict="unreachable", reason="blocked_by_earlier", remedy=remedy,
                detail=detail, remedies=remedies,
            )  # fmt: skip
        alone = tried if not self.done else attempt(self.sim, self.sim.start, k)
        blocked = alone.reason == "none"
        # What a task leaves another one may have to bring; alone it cannot be judged.
        failed = tried if blocked or alone.reason == "payload" else alone
        reason: Reason = "blocked_by_earlier" if blocked else REASONS[failed.reason]
        lacking = failed.reason == "battery"
        used = failed.after.total.since((before if blocked else self.sim.start).total)
        remedies, remedy = self._remedy(k, reason, failed)
        return TaskReport(
            task.name, "unreachable", reason, blocked,
            energy=used.mean if lacking else np.nan,
            energy_upper=used.upper(quantile) if lacking else np.nan,
            soc_after=failed.after.expected.soc if lacking else np.nan,
            shortfall=self.sim.shortfall(failed.safe) if lacking else 0.0,
            remedy=remedy, detail=failed.detail, remedies=remedies,
        )  # fmt: skip

    def _remedy(self, k: int, reason: Reason, tried: Attempt) -> tuple[tuple[Remedy, ...], str]:
        """Return what makes a task reachable, and the sentence that says so."""
        if reason == "no_path":
            return (), f"clear the route or move the task: {tried.detail}"
        remedies, advice = self._drop(k) if reason in ("blocked_by_earlier", "payload") else [], ""
        if tried.reason == "late":
            remedies += self._sooner(k, tried)
        elif tried.reason == "time":
            advice = "give more planning_time or planning_effort"
        elif tried.reason == "payload":
            advice = "put a task before it that takes the payload on board"
        elif tried.reason == "motor":
            advice = f"take another route or a stronger drive: {tried.detail}"
            if self.mission.payload > 0:
                advice += ", or leave payload behind"
        elif tried.reason == "no_path":
            advice = f"clear the route back: {tried.detail}"
        else:
            earlier = self.attempts[k].earlier if reason == "blocked_by_earlier" else ()
            tasks = (*earlier, k)
            remedies += [
                *self._indoors(tasks), *self._slower(tasks, tried.safe), *self._charge_first(tasks),
                *self._larger_battery(tasks, tried.safe), *self._smaller_reserve(tasks),
            ]  # fmt: skip
        hints = [*self._with_what(remedies), *([advice] if advice else [])]
        return tuple(remedies), ", or ".join(hints) or tried.detail

    def _with_what(self, remedies: Sequence[Remedy]) -> list[str]:
        """Return remedies as sentences, with the tasks that are done before the one in question."""
        sentences = []
        for before, same in groupby(remedies, lambda remedy: self.before.get(remedy, ())):
            *rest, last = map(str, same)
            with_what = f" (with {html.listed([repr(name) for name in before])} done before it)"
            sentences += [*rest, last + (with_what if before else "")]
        return sentences

    def _sooner(self, k: int, tried: Attempt) -> list[Remedy]:
        """Return what brings the robot there in time: speed, or a wider window."""
        task, tasks = self.mission.tasks[k], (*self.attempts[k].earlier, k)
        top = float(self.mission.vehicle.motor.speed)
        now = self.mission.tread_speed
        faster = np.isfinite(top) and (now is None or now < top)
        speeds = [Remedy("speed", top, "m/s")] if faster else []
        in_turn = self.attempts[k].attempt
        times = [self.sim.latest(a.after) for a in (tried, in_turn) if a.reason == "late"]
        late = sorted({float(np.ceil(time - task.window[1])) for time in times})
        windows = [Remedy("window", s, "s", task.name) for s in (*late, 2 * late[-1])]
        return [*self._first(tasks, speeds), *self._first(tasks, windows)]

    def _drop(self, k: int) -> list[Remedy]:
        """Name a task without which this one can be done, the one of least prize first."""
        tasks, (_, tried, earlier) = self.mission.tasks, self.attempts[k]
        others = self.done if tried.reason == "none" else earlier
        ranked = sorted(others, key=lambda d: (tasks[d].required, tasks[d].prize, -d))
        for dropped in ranked[: REMEDYING.candidates]:
            rest = [d for d in earlier if d != dropped]
            remedy = Remedy("drop", task=tasks[dropped].name)
            if tasks[dropped].required and not tasks[k].required:
                continue
            if self._follow(self.sim, [*rest, k]) and self._holds(k, remedy, rest):
                return [remedy]
        return []

    def _follow(self, sim: Simulation, tasks: Sequence[int]) -> bool:
        state = sim.start
        for task in tasks:
            tried = attempt(sim, state, task)
            if tried.reason != "none":
                return False
            state = tried.after
        return True

    def _charge_first(self, tasks: Sequence[int]) -> list[Remedy]:
        """Return the state of charge with which to leave so that the task can be done."""
        levels = np.arange(np.ceil(100 * self.mission.soc) + 1, 101) / 100
        remedies = [Remedy("charge", float(level), "1") for level in levels]
        last = len(remedies) - 1
        if last < 0 or not self._works(tasks, remedies[last]):
            return []
        least = bisect_left(remedies, True, 0, last, key=lambda remedy: self._works(tasks, remedy))
        return [remedies[least]]

    def _larger_battery(self, tasks: Sequence[int], safe: Status) -> list[Remedy]:
        """Return how much more energy [J], or how many strings, the battery needs."""
        full, powerless = self.mission.battery.full_energy, self.sim.lacks_power(safe)
        step = REMEDYING.finer * full if powerless else 3600.0

        def remedy(n: int) -> Remedy:
            strings = Remedy("capacity", 1.0 + REMEDYING.finer * n, "1")
            return strings if powerless else Remedy("capacity", step * n, "J")

        low, high = 0, max(int(np.ceil(self.sim.shortfall(safe) / step)), 1)
        while not self._works(tasks, remedy(high)):
            low, high = high, 2 * high
            if step * high > REMEDYING.most * full:
                return []
        while high - low > max(0.02 * high, 1):
            middle = (low + high) // 2
            low, high = (low, middle) if self._works(tasks, remedy(middle)) else (middle, high)
        return [remedy(high)]

    def _smaller_reserve(self, tasks: Sequence[int]) -> list[Remedy]:
        least, now = self.mission.battery.cutoff_soc, self.mission.reserve
        reserves = [max(round(share * now, 3), least) for share in (0.75, 0.5, 0.25)]
        return self._first(tasks, [Remedy("reserve", r, "1") for r in reserves if r < now])

    def _slower(self, tasks: Sequence[int], safe: Status) -> list[Remedy]:
        """Return another speed that helps, if any: that of least energy, or one of less power."""
        given, top = self.mission.tread_speed, float(self.mission.vehicle.motor.speed)
        remedies = [] if given is None else [Remedy("speed")]
        if safe.worst.failure in SAGS and np.isfinite(top):
            most = min(top, given or top)
            remedies += [Remedy("speed", share * most, "m/s") for share in (0.75, 0.5, 0.25)]
        return self._first(tasks, remedies)

    def _indoors(self, tasks: Sequence[int]) -> list[Remedy]:
        """Return a battery as warm, or as cool, as charging demands, if it helps."""
        closed = [one for one in self.mission.chargers if self.mission.charging_fault(one)]
        battery = self.mission.at_charger(closed[0]) if closed else None
        if not isinstance(battery, Battery):
            return []
        low, high = battery.min_charge_temperature, battery.max_charge_temperature
        degrees = low if battery.temperature < low else high
        return self._first(tasks, [Remedy("temperature", degrees, "degC")])

    def _less_charge(self, end: Status) -> tuple[tuple[Remedy, ...], float]:
        """Return the least charge to leave chargers with, and the time that it saves [s]."""
        found, most = self.found, end.total.mean + ROUNDING * abs(end.total.mean)
        visited = {stop.name for stop in stops(end.trip) if stop.kind == "charge"}
        levels = [
            one.until for one in self.mission.chargers if one.name in visited and not one.enough
        ]
        tasks = [self.legs.task_at(s) for s in found.stops if s in self.legs.options]
        if not levels or self.done != tasks:
            return (), 0.0

        def last(remedy: Remedy) -> Status | None:
            sim = Simulation(self.legs.under(self.mission.with_remedy(remedy)))
            then = sim.arrives(sim.follow(sim.start, found.stops, found.hurried)[0])
            return None if then is None or then.total.mean > most else then

        low, high = int(100 * self.mission.reserve + ROUNDING) + 1, int(100 * max(levels))
        remedies = [
            Remedy("charge", percent / 100, "1", where="chargers")
            for percent in range(low, high + 1)
        ]
        least = bisect_left(remedies, True, key=lambda remedy: last(remedy) is not None)
        for remedy in remedies[least : least + REMEDYING.candidates]:
            then = last(remedy)
            if self._confirms:
                again = self._anew(remedy)
                same = sorted(again.done) == sorted(self.done)
                then = finish(again.sim, again.end) if same else None
            if then is not None and end.time - then.time >= REMEDYING.minute:
                return (remedy,), end.time - then.time
        return (), 0.0

    def _first(self, tasks: Sequence[int], remedies: Sequence[Remedy]) -> list[Remedy]:
        """Return the first of some remedies that works, if any does."""
        return next(([remedy] for remedy in remedies if self._works(tasks, remedy)), [])

    def _works(self, tasks: Sequence[int], remedy: Remedy) -> bool:
        """Return whether the last of some tasks can be done after the others with a remedy."""
        try:
            changed = self.mission.with_remedy(remedy)
        except BatteryError:  # beyond any battery
            return False
        sim = Simulation(self.legs.under(changed))
        return self._follow(sim, tasks) and self._holds(tasks[-1], remedy, tasks[:-1])

    def _holds(self, k: int, remedy: Remedy, earlier: Sequence[int]) -> bool:
        """Return whether a remedy lets the mission do a task; others may take what it gains."""
        if not self._confirms:
            self.before[remedy] = tuple(self.mission.tasks[d].name for d in earlier)
            return True
        again = self._anew(remedy)
        names = [again.mission.tasks[d].name for d in again.done]
        name = self.mission.tasks[k].name
        if name not in names:
            return False
        self.before[remedy] = tuple(names[: names.index(name)])
        return True

    @property
    def _confirms(self) -> bool:
        """Whether a remedy is tried on the whole mission, order included."""
        return self.mission.order == "given" or len(self.mission.tasks) <= REMEDYING.confirmed

    def _anew(self, remedy: Remedy) -> Evaluation:
        """Return the whole mission with a remedy, driven; at another speed routes change."""
        changed = self.mission.with_remedy(remedy)
        anew = remedy.kind in ("drop", "speed")
        again = Evaluation(changed, None, self.legs.under(changed, anew=anew))
        again.go()
        return again


REASONS: dict[str, Reason] = {
    "no_path": "no_path", "motor": "motor", "battery": "battery", "late": "late",
    "time": "time_limit", "payload": "payload",
}  # fmt: skip


def row_after_row(legs: Legs, tasks: Sequence[int]) -> list[int]:
    """Return tasks with paths in the order in which they lie side by side, the nearer side first.

    They are sorted across their common direction.
    """
    options = [legs.mission.tasks[k].options[0] for k in tasks]
    ends = np.array([[one.entry[:2], one.exit[:2]] for one in options])
    along = ends[:, 1] - ends[:, 0]
    double = 2 * np.arctan2(along[:, 1], along[:, 0])  # a row and its reverse have one direction
    size = np.hypot(*along.T)
    angle = 0.5 * np.arctan2(size @ np.sin(double), size @ np.cos(double))
    side = np.argsort(ends.mean(axis=1) @ [-np.sin(angle), np.cos(angle)], kind="stable")
    order = [tasks[k] for k in side]
    bounds = legs.lower_bounds(legs.mission.payload)[0]
    first, last = (min(bounds[node] for node in legs.ways(k)) for k in (order[0], order[-1]))
    return order if first <= last else order[::-1]
