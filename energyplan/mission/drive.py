"""The robot on its way: charge, time and payload after each stop, expected and at the bound."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from energyplan.battery import SAGS, BatteryRun
from energyplan.mission._order_kernel import GRAM
from energyplan.mission.energy import Consumption, Estimate
from energyplan.mission.routes import Leg, Legs
from energyplan.mission.supply import Shares
from energyplan.mission.types import Charger, Mission
from energyplan.path import ROUNDING, FloatArray, Pose, Trajectory

Kind = Literal["start", "drive", "wait", "work", "charge", "end"]


class Stepping(NamedTuple):
    """Constants of the time steps of stays."""

    step: float = 30.0  # time between two samples [s]
    most_steps: int = 10_000  # samples of one stay: three days in such steps, longer ones beyond
    instant: float = 1e-6  # time that is none [s]


STEPPING = Stepping()


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of a mission: a drive, a stay or a charge; an instant at its start and its end."""

    kind: Kind  # what the robot does
    start: str  # place where it begins
    goal: str  # place where it ends
    pose: Pose  # pose at the end
    t: FloatArray  # (n,): time [s]
    power: FloatArray  # (n,): power at the battery from each time to the next [W]
    soc: FloatArray  # (n,): state of charge, as expected
    soc_lower: FloatArray  # (n,): the same at the bound
    leg: Leg | None = None  # the drive; of work along a path, too
    peak_current: float = 0.0  # largest current that the battery delivers, as expected [A]

    @property
    def departure(self) -> float:
        """Time of its begin [s]."""
        return float(self.t[0])

    @property
    def arrival(self) -> float:
        """Time of its end [s]."""
        return float(self.t[-1])

    @property
    def peak_power(self) -> float:
        """Largest power that the battery delivers, as expected [W]."""
        return float(max(self.power.max(), 0.0))

    @property
    def trajectory(self) -> Trajectory:
        """The drive, from time 0."""
        assert self.leg is not None and self.leg.trajectory is not None
        return self.leg.trajectory

    @property
    def energy(self) -> float:
        """Energy at the battery, as expected [J]; negative while charging."""
        spans = np.diff(self.t)
        if self.leg is None:
            return float(self.power[:-1] @ spans)
        refused = self.power[:-1] - self.leg.consumption.power  # by a battery that takes no more
        return self.leg.energy.mean + float(refused @ spans)

    @property
    def poses(self) -> FloatArray:
        """Pose at each time, shape (n, 3)."""
        if self.leg is None:
            return np.tile(self.pose, (len(self.t), 1))
        drive = self.trajectory
        return np.column_stack([drive.x, drive.y, drive.yaw])


class Charge(NamedTuple):
    """The battery at one instant."""

    soc: float  # state of charge
    polarisation: float = 0.0  # voltage of its RC pair [V]
    failure: str = "none"  # why it gave up on the way
    instant: float = np.inf  # when it gave up [s]
    load: float = 0.0  # power under which it gave up [W]


@dataclass(frozen=True)
class Status:
    """Where the robot stands."""

    node: int  # place
    payload: float  # payload [kg]
    time: float  # time as expected [s]
    lateness: FloatArray  # (n,): how the time changes with each shared unknown [s]
    spent: Estimate
    total: Estimate
    origin: tuple[float, float]  # state of charge and time after the last charge
    expected: Charge  # the battery as expected
    worst: Charge  # the battery where the energy is at its bound
    trip: tuple[Segment, ...] = ()  # what it did so far
    stretches: tuple[Estimate, ...] = ()  # energies between one charge and the next, so far

    @property
    def time_spread(self) -> float:
        """Standard deviation of the time [s]."""
        return float(np.linalg.norm(self.lateness))


class Attempt(NamedTuple):
    """What comes of a task."""

    reason: str
    after: Status  # when it is done
    safe: Status  # at the nearest safe place after it
    detail: str = ""  # why not, in one sentence
    begin: float = np.nan  # when it begins at the bound [s]


class Visit(NamedTuple):
    """What comes of one stop."""

    attempt: Attempt | None  # of a task
    after: Status | None  # None where it cannot be done


class Simulation:
    """Steps from state to state."""

    def __init__(self, legs: Legs, saves: bool = False) -> None:
        self.legs = legs
        self.saves = saves  # whether it leaves chargers with `enough` as soon as it may
        self.mission: Mission = legs.mission
        self.quantile = legs.quantile

    @property
    def start(self) -> Status:
        """The condition at the start."""
        mission, nothing = self.mission, self.legs.models.nothing
        full, least = Charge(mission.soc), Charge(self.at_least(mission.soc))
        gauge, origin = self.legs.gauge, (mission.soc, mission.time)
        known = np.zeros(self.legs.models.size)
        return self.mark(
            Status(0, mission.payload, mission.time, known, gauge, nothing, origin, full, least),
            "start",
        )

    def mark(self, state: Status, kind: Kind) -> Status:
        """Add an instant to the trip: its start or end, or a task that takes no time."""
        now = [state.time, 0.0, state.expected.soc, state.worst.soc]
        return self._add(state, kind, np.outer(now, np.ones(2)))

    def _add(
        self,
        state: Status,
        kind: Kind,
        samples: FloatArray,
        leg: Leg | None = None,
        start: int = -1,
        peak_current: float = 0.0,
    ) -> Status:
        """Add a segment that ends at a state's place: rows of time, power, charge and its bound."""
        here, names = state.node, self.legs.names
        begin, pose = names[here if leg is None else start], self.legs.exits[here]
        t, power, soc, soc_lower = samples
        one = Segment(kind, begin, names[here], pose, t, power, soc, soc_lower, leg, peak_current)
        return replace(state, trip=(*state.trip, one))

    def at_least(self, soc: float) -> float:
        """Return the state of charge at the bound when the gauge shows one."""
        return max(soc - self.quantile * self.mission.spreads.soc, 0.0)

    def latest(self, state: Status) -> float:
        """Return the time of a condition at the bound [s]."""
        return state.time + self.quantile * state.time_spread

    def holds(self, state: Status) -> bool:
        """Return whether the reserve is left at the bound."""
        enough = state.worst.soc >= self.mission.reserve - ROUNDING
        return enough and state.worst.failure == "none"

    # -- steps ------------------------------------------------------------------------------------

    def drive(self, state: Status, goal: int, hurried: bool = False) -> Status | None:
        """Drive to a place, quickly if in a hurry; None where the leg cannot be driven."""
        leg = self.legs.leg(state.node, goal, state.payload, hurried)
        if leg.trouble:
            return None
        if leg.trajectory is None:
            return replace(state, node=goal)
        late = state.lateness + self.legs.models.driving_time(leg.duration)
        load, moved = leg.consumption, replace(state, node=goal, lateness=late)
        samples, after, peak = self._draw(moved, leg.trajectory.t, load)
        return self._add(after, "drive", samples, leg, state.node, peak)

    @cached_property
    def stations(self) -> tuple[int, ...]:
        """Nodes of the chargers at which the battery takes charge."""
        chargers = zip(self.legs.chargers, self.mission.chargers, strict=True)
        return tuple(node for node, one in chargers if not self.mission.charging_fault(one))

    def wait_until(self, state: Status, time: float) -> Status:
        """Stand still until a time [s]; arriving before it with certainty resets the lateness."""
        latest = self.latest(state)
        if state.time >= time:
            return state
        late = max(latest - time, 0.0) / max(latest - state.time, STEPPING.instant)
        region, duration = self.legs.region(state.node), time - state.time
        energy = self.legs.models.idle(region, duration, state.payload)
        waited = self._stay(state, "wait", duration, energy)
        return replace(waited, lateness=late * state.lateness)

    def _stay(self, state: Status, kind: Kind, duration: float, energy: Estimate) -> Status:
        """Stand still for so long [s], which takes an energy."""
        if duration <= STEPPING.instant:
            return state if kind == "wait" else self.mark(state, kind)
        t = np.linspace(
            0.0, duration, int(min(max(duration / STEPPING.step, 1), STEPPING.most_steps)) + 1
        )
        flat = np.full(len(t) - 1, energy.mean / duration)
        load = Consumption(flat, np.ones(len(flat)), energy)
        samples, after, peak = self._draw(state, t, load)
        return self._add(after, kind, samples, peak_current=peak)

    def _draw(
        self, state: Status, t: FloatArray, load: Consumption
    ) -> tuple[FloatArray, Status, float]:
        """Draw a load from the battery, as expected and at the bound; the peak of its current."""
        spent = state.spent + self.legs.from_battery(load.energy)
        more = spent.upper(self.quantile) - state.spent.upper(self.quantile)
        # what it may take beyond the expectation is drawn where the power is uncertain
        shares = load.spread if load.spread.any() else np.ones(len(load.spread))
        raised = load.power + (more - load.energy.mean) * shares / float(shares @ np.diff(t))
        clock = state.time + t - t[0]
        expected, run = self._run(state.expected, clock, load.power)
        worst, lower = self._run(state.worst, clock, raised)
        braked = run.braked
        # what the battery did not take back is not in the energy
        total = state.total + load.energy
        total = replace(total, mean=total.mean + float(braked[-1]))
        after = replace(
            state, time=float(clock[-1]), spent=spent, total=total,
            expected=expected, worst=worst,
        )  # fmt: skip
        power = load.power + np.diff(braked) / np.diff(t)
        power = np.append(power, power[-1])
        peak = float(max(run.current.max(), 0.0))
        return np.array([clock, power, run.soc, lower.soc]), after, peak

    def _run(self, charge: Charge, t: FloatArray, power: FloatArray) -> tuple[Charge, BatteryRun]:
        """Return the battery after a load, and its run."""
        run = self.mission.battery.simulate(
            t, np.append(power, 0.0), soc=charge.soc, polarisation=charge.polarisation
        )
        after = charge._replace(soc=run.soc_end, polarisation=run.polarisation)
        if charge.failure == "none" and run.reason != "none":
            load = power[min(int(np.searchsorted(t, run.brown_out, "right")), len(power)) - 1]
            after = after._replace(failure=run.reason, instant=run.brown_out, load=float(load))
        return after, run

    def charge(
        self,
        state: Status,
        leave_by: float = np.inf,
        until: float | None = None,
        shares: Shares = (),
    ) -> Status:
        """Charge at the charger at hand up to a level, its own where none is given.

        It ends earlier when it is time to leave [s]. Of several robots one has shares of the power.
        """
        charger, supply = self.charger(state), self.legs.supply
        level = charger.until if until is None else until
        low = supply.charge(state.worst.soc, self.at_least(level), charger, shares)
        high = supply.charge(state.expected.soc, level, charger, shares)
        gauge = self.legs.gauge
        last = min(max(low.time[-1], high.time[-1]), leave_by - state.time)
        if last <= STEPPING.instant:
            return state
        t = np.unique(np.append(np.concatenate([low.time, high.time]), last))
        t = t[t <= last]
        filled = [np.interp(t, one.time, one.charge) for one in (high, low)]
        given = np.diff(np.interp(t, high.time, high.joules)) / np.diff(t)
        power = np.append(-given, 0.0)
        t = state.time + t
        low_end, high_end = (Charge(float(s[-1])) for s in (filled[1], filled[0]))
        shown = min(low_end.soc + self.quantile * self.mission.spreads.soc, 1.0)  # by the gauge
        state = replace(
            state, time=float(t[-1]), spent=gauge, expected=high_end, worst=low_end,
            origin=(shown, float(t[-1])),
            stretches=(*state.stretches, state.spent),
        )  # fmt: skip
        return self._add(state, "charge", np.array([t, power, *filled]))

    # -- tasks ------------------------------------------------------------------------------------

    def nearest(self, state: Status, task: int, hurried: bool = False) -> Attempt:
        """Try a task without charging before it, with the option that takes least."""
        tried = (self.attempt(state, node, hurried) for node in self.legs.ways(task))
        return min(tried, key=self.missing)

    def attempt(self, state: Status, node: int, hurried: bool = False) -> Attempt:
        """Try an option of a task without charging before it."""
        task = self.legs.task_at(node)
        job = self.mission.tasks[task]
        there = self.drive(state, node, hurried)
        if there is None:
            leg = self.legs.leg(state.node, node, state.payload, hurried)
            return Attempt(leg.trouble, state, state, leg.detail)
        models, region = self.legs.models, self.legs.region(node)
        lost = models.waited(region, task, there.payload)
        there = self._stay(there, "wait", self.mission.waiting, lost)
        there = replace(there, lateness=there.lateness + models.waiting_time(task))
        latest = self.latest(there)
        if latest > job.window[1]:
            expected = f", {there.time:.0f} s as expected" if latest > there.time + 0.5 else ""
            begin = f"it must begin by {job.window[1]:.0f} s"
            detail = f"{begin}, and the robot is there at {latest:.0f} s{expected}"
            return Attempt("late", there, there, detail)
        begun = self.wait_until(there, job.window[0])
        row = self.legs.row(node, begun.payload)
        if row is None:
            work = models.work(region, task, begun.payload)
            done = self._stay(begun, "work", job.dwell, work)
        elif row.trajectory is None:
            return Attempt(row.trouble, begun, begun, row.detail)
        else:
            samples, done, peak = self._draw(begun, row.trajectory.t, row.consumption)
            done = self._add(done, "work", samples, row, node, peak)
        done = replace(done, lateness=done.lateness + self.legs.lasting(node, begun.payload)[1])
        carried = done.payload + job.change
        if carried < -GRAM:
            detail = f"it leaves {-job.change:g} kg, and {done.payload:g} kg are on board"
            return Attempt("payload", done, done, detail)
        done = replace(done, payload=max(carried, 0.0))
        safe, trouble = self.refuge(done)
        if safe is None:
            return Attempt(trouble.trouble, done, done, f"no way back: {trouble.detail}")
        if not self.holds(safe):
            return Attempt("battery", done, safe, self._why_not(safe))
        return Attempt("none", done, safe, begin=max(latest, job.window[0]))

    @property
    def timed(self) -> bool:
        """Whether windows end, so that being late is possible."""
        return any(np.isfinite(task.window[1]) for task in self.mission.tasks)

    @property
    def ways(self) -> tuple[bool, ...]:
        """Whether to hurry: no, or both where windows press and the speed is the cheapest.

        Where no window ends, driving faster for more energy helps nothing: at the speed of least
        energy all that follows can be done with more charge, later.
        """
        return (False, True) if self.timed and self.mission.tread_speed is None else (False,)

    def leave_by(self, state: Status, stops: Sequence[int], hurried: Sequence[bool] = ()) -> float:
        """Return when to leave a place at the latest so that no later window is missed."""
        tasks, models = self.mission.tasks, self.legs.models
        ways = (*hurried, *(False for _ in stops[len(hurried) :]))
        node, payload, spent, late, latest = state.node, state.payload, 0.0, state.lateness, np.inf
        for stop, quick in zip(stops, ways, strict=True):
            leg = self.legs.leg(node, stop, payload, quick)
            if leg.trouble:
                return -np.inf
            spent, late = spent + leg.duration, late + models.driving_time(leg.duration)
            if stop in self.legs.options:
                k = self.legs.task_at(stop)
                task, (seconds, more) = tasks[k], self.legs.lasting(stop, payload)
                spent, late = spent + self.mission.waiting, late + models.waiting_time(k)
                margin = self.quantile * float(np.linalg.norm(late))
                latest = min(latest, task.window[1] - margin - spent)
                spent, late = spent + seconds, late + more
                payload = max(payload + task.change, 0.0)
            node = stop
        return float(latest)

    def visit(self, state: Status, stops: Sequence[int], hurried: Sequence[bool]) -> Visit:
        """Go to the first of some stops; a charge ends in time for the windows of the others."""
        stop, quick = stops[0], hurried[0]
        if stop in self.legs.chargers:
            docked = self.dock(state, stop, quick)
            if docked is None:
                return Visit(None, None)
            return Visit(None, self.charged(docked, stops[1:], hurried[1:]))
        attempt = self.attempt(state, stop, quick)
        return Visit(attempt, attempt.after if attempt.reason == "none" else None)

    def follow(
        self,
        state: Status,
        stops: Sequence[int],
        hurried: Sequence[bool],
        then: int | None = None,
    ) -> tuple[Status | None, tuple[Visit, ...]]:
        """Do tasks and charge in an order of stops, in time for these and one that comes `then`."""
        rest = (*stops, *(() if then is None else (then,)))
        visits: list[Visit] = []
        for k in range(len(stops)):
            visits.append(self.visit(state, rest[k:], hurried[k:]))
            after = visits[-1].after
            if after is None:
                return None, ()
            state = after
        return state, tuple(visits)

    def dock(self, state: Status, charger: int, hurried: bool = False) -> Status | None:
        """Drive to a charger; None where the battery does not last."""
        docked = self.drive(state, charger, hurried)
        return docked if docked is not None and self.holds(docked) else None

    def charged(
        self, docked: Status, stops: Sequence[int], hurried: Sequence[bool], shares: Shares = ()
    ) -> Status:
        """Charge in time for the windows of later stops, and where that is wanted no more."""
        leave_by = self.leave_by(docked, stops, hurried)
        charger = self.charger(docked)
        if not (self.saves and charger.enough):
            return self.charge(docked, leave_by, shares=shares)
        full = Simulation(self.legs)

        def suffices(level: float) -> bool:
            after = full.charge(docked, leave_by, level)
            return full.arrives(full.follow(after, stops, hurried)[0]) is not None

        low, high = (int(np.ceil(100 * soc)) for soc in (docked.expected.soc, charger.until))
        levels = [percent / 100 for percent in range(low, high)]
        least = bisect_left(levels, True, key=suffices)
        level = levels[least] if least < len(levels) else charger.until
        return self.charge(docked, leave_by, level, shares)

    def charger(self, docked: Status) -> Charger:
        """Return the charger at hand."""
        return self.mission.chargers[docked.node - self.legs.chargers[0]]

    def missing(self, attempt: Attempt) -> tuple[bool, float]:
        """Sort what works by energy before what does not by what is missing."""
        if attempt.reason == "none":
            return False, attempt.after.total.mean
        return True, self.shortfall(attempt.safe) if attempt.reason == "battery" else np.inf

    def refuge(self, state: Status) -> tuple[Status | None, Leg]:
        """Drive to the nearest safe place: home or a charger."""
        return self._nearest(state, (self.legs.home, *self.legs.chargers))

    @property
    def ends(self) -> list[int]:
        """Where the mission may end."""
        rule = self.mission.return_to
        ends = [] if rule == "charger" else [self.legs.home]
        return ends if rule == "start" else [*ends, *self.legs.chargers]

    def arrives(self, state: Status | None) -> Status | None:
        """Drive to where the mission may end; None where the battery does not last for it."""
        last = None if state is None else self._nearest(state, tuple(self.ends))[0]
        return last if last is not None and self.holds(last) else None

    def _nearest(self, state: Status, places: tuple[int, ...]) -> tuple[Status | None, Leg]:
        """Drive to the place of least energy; routes that cannot be the least are not planned."""
        bounds = self.legs.lower_bounds(state.payload)[state.node]
        first, *others = sorted(places, key=lambda place: float(bounds[place]))
        goal, best = first, self.legs.leg(state.node, first, state.payload)
        for place in others:
            if best.energy.mean <= bounds[place]:
                break
            leg = self.legs.leg(state.node, place, state.payload)
            if leg.energy.mean < best.energy.mean:
                goal, best = place, leg
        return self.drive(state, goal), best

    # -- shortfall --------------------------------------------------------------------------------

    def shortfall(self, safe: Status) -> float:
        """Energy that is missing to keep the reserve [J]; none where it is the power that lacks."""
        soc, since = safe.origin
        need = safe.spent.upper(self.quantile)
        mean = max(need / max(safe.time - since, 1.0), 1.0)
        levels = [soc, self.mission.reserve, safe.worst.soc]
        stored = self.legs.supply.stored(mean, levels)
        if stored[0] == 0 and safe.worst.failure in SAGS:
            return 0.0
        by_soc = stored[1] - stored[2] if safe.worst.failure == "none" else 0.0
        return float(max(need - (stored[0] - stored[1]), by_soc, 0.0))

    def lacks_power(self, safe: Status) -> bool:
        """Return whether the battery holds the energy, but cannot deliver the power."""
        return safe.worst.failure in SAGS and self.shortfall(safe) == 0

    def _why_not(self, safe: Status) -> str:
        need, missing = safe.spent.upper(self.quantile), self.shortfall(safe)
        worst = safe.worst
        if self.lacks_power(safe):
            return f"{SAGS[worst.failure]} at {worst.instant:.0f} s under {worst.load:.0f} W"
        detail = (
            f"with the way back to {self.legs.names[safe.node]} it may take "
            f"{need / 3600:.0f} Wh, {missing / 3600:.0f} Wh more than there is above the reserve"
        )
        faults = map(self.mission.charging_fault, self.mission.chargers)
        return "; ".join((detail, *dict.fromkeys(filter(None, faults))))
