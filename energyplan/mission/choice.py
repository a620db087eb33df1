"""Which tasks to do, and where to charge: in the order given, or in the best one.

In a free order routes are planned only where the best order may use them. Energies between places
start as lower bounds. The order that is best on them names the routes to plan; with their true
energies the order is solved again, until it uses planned routes only. Since the others are bounds
from below, nothing that was left unplanned can be better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from energyplan.mission.condition import Attempt, Condition, as_good
from energyplan.mission.energy import Estimate
from energyplan.mission.order import EXACT, Order, OrderProblem, solve
from energyplan.mission.simulation import Walk
from energyplan.path import FloatArray
from energyplan.planning.budget import PACE


@dataclass(frozen=True)
class Course:
    """A way through the tasks in the order given."""

    state: Condition  # where it ends
    worth: float = 0.0  # worth of what was done
    steps: tuple[tuple[int, Condition, Attempt], ...] = ()

    @property
    def rank(self) -> tuple[float, tuple[int, ...]]:
        """Sort by worth, then by who comes first in the order given; the best one is least."""
        return -self.worth, tuple(step[0] for step in self.steps)

    def beats(self, other: Course) -> bool:
        """Tell whether nothing speaks for the other one."""
        return self.rank <= other.rank and as_good(self.state, other.state)


def best_course(walk: Walk) -> Course:
    """Do the tasks in the order given; charge before any of them, leave out what is worth less.

    Tasks are done one after the other as long as the battery lasts. Where it does not, all ways
    are followed side by side: with and without a charge before each task, with and without the
    task. Of two at the same place, the one that is worse in every respect is dropped.
    """
    tasks = walk.mission.tasks
    whole = sum(task.prize for task in tasks) + 1.0
    worths = [task.prize + whole * task.required for task in tasks]
    direct = Course(walk.start)
    for k in range(len(tasks)):
        attempt = walk.attempt(direct.state, k)
        if attempt.reason != "none":
            break
        step = (k, direct.state, attempt)
        direct = Course(attempt.after, direct.worth + worths[k], (*direct.steps, step))
    else:
        if walk.finish(direct.state) is not None:
            return direct
    courses = [Course(walk.start)]
    for k in range(len(tasks)):
        grown = list(courses)
        for course in courses:
            ahead = [range(k, last + 1) for last in range(k, len(tasks))]
            for before in (course.state, *walk.charged(course.state, ahead)):
                for hurried in walk.ways:
                    attempt = walk.attempt(before, k, hurried)
                    if attempt.reason == "none":
                        step = (k, course.state, attempt)
                        worth = course.worth + worths[k]
                        grown.append(Course(attempt.after, worth, (*course.steps, step)))
        courses = []
        for course in sorted(grown, key=lambda c: (c.rank, c.state.total.mean)):
            if not any(kept.beats(course) for kept in courses):
                courses.append(course)
    ranked = sorted(courses, key=lambda c: (c.rank, c.state.total.mean))
    return next((c for c in ranked if walk.finish(c.state) is not None), ranked[0])


_ROUNDS = 25
_SEARCH_ROUNDS = 3
_SEARCH_TIME = 2.0
_LEVELS = 3
_MOST_LOADS = 64
_ROUNDING = 1e-6
_CAUTION = 0.5
"""Share of the bounds of single times that is held back first: they seldom all come together."""

_LOSSLESS = 1.0
"""Power so small that a battery loses nothing to its resistance [W]."""


@dataclass(frozen=True)
class Stops:
    """The stops of a free order."""

    stops: tuple[int, ...]  # nodes in the order of their visits
    hurried: tuple[bool, ...]  # whether the way to each is driven as quickly as may be
    proven: bool  # whether no better order exists on the routes known
    gap: float  # by which fraction of its energy a better order may exist at most


def best_stops(walk: Walk, progress: Callable[[str], None] | None = None) -> Stops:
    """Find which tasks to do in which order, and where to charge.

    First the order is sought that would be best if each drive took what is expected and the
    battery lost nothing: no other one can be better than that. If the battery lasts for it, it is
    the answer, and proven. If not, energies are taken at their bounds, and the first order bounds
    how much better another one could be.
    """
    hope = None
    if len(walk.mission.tasks) <= EXACT:
        matrix = _Matrix(walk, hopeful=True)
        hope = matrix.settled(progress)
        if hope.proven and matrix.true and matrix.holds(hope):
            return Stops(hope.stops, _ways(hope), True, 0.0)
        hope = hope if matrix.true else None
    matrix = _Matrix(walk, hopeful=False)
    found = matrix.settled(progress)
    while not matrix.holds(found) and matrix.shrink(found.stops):
        found = matrix.settled(progress)
    gap = np.nan if hope is None else matrix.gap(found, hope)
    return Stops(found.stops, _ways(found), bool(gap <= _ROUNDING), gap)


def _ways(order: Order) -> tuple[bool, ...]:
    return order.hurried or (False,) * len(order.stops)


class _Matrix:
    """Energies between places, known or bounded, and the energy that the battery holds."""

    def __init__(self, walk: Walk, hopeful: bool) -> None:
        self._walk = walk
        self._hopeful = hopeful
        mission = walk.mission
        change = np.array([task.payload for task in mission.tasks])
        low = max(mission.payload + float(change[change < 0].sum()), 0.0)
        high = mission.payload + float(change[change > 0].sum())
        self.exact = len(mission.tasks) <= EXACT
        loads = {mission.payload}
        for step in change[change != 0]:
            loads |= {round(load + step, 6) for load in loads}
        loads = {load for load in loads if load >= 0}
        # few loads are priced each for itself; of many, some are, and the others lie in between
        self._each = self.exact and len(loads) <= _MOST_LOADS
        count = 1 if low == high else _LEVELS
        self._levels = np.linspace(low, high, count)
        self._bounds = np.array([walk.legs.lower_bounds(float(p)) for p in self._levels])
        self._ends = self._end_nodes()
        self._inflation = 1.0
        self._scale = 1.0
        self._caution = 0.0 if hopeful or not walk.timed else _CAUTION
        self._power = walk.legs.grounds.driving_power
        self._cache: dict[tuple[float, bool], FloatArray] = {}

    def _end_nodes(self) -> list[int]:
        legs, rule = self._walk.legs, self._walk.mission.return_to
        ends = [] if rule == "charger" else [legs.home]
        return ends if rule == "start" else [*ends, *legs.chargers]

    @property
    def true(self) -> bool:
        """Whether energies and times of an order are those of its legs at each payload."""
        same = len(self._levels) == 1
        return same or (self._each and not self._walk.timed)

    # -- energies ---------------------------------------------------------------------------------

    def _known(self, payload: float, hurried: bool) -> FloatArray:
        """Energies with one payload: those of the legs where planned, from below where not."""
        if (payload, hurried) not in self._cache:
            legs = self._walk.legs
            if self._each:
                matrix = self._walk.legs.lower_bounds(payload).copy()
            else:
                level = int(np.argmin(np.abs(self._levels - payload)))
                matrix = self._bounds[level] * self._inflation
            for i, j in np.argwhere(np.ones_like(matrix)):
                # a route of least time takes no less than that of least energy
                for quick in (False, True) if hurried else (False,):
                    if legs.planned(int(i), int(j), quick):
                        energy = legs.leg(int(i), int(j), payload, quick).energy
                        matrix[i, j] = self._counted(energy)
            self._cache[payload, hurried] = matrix
        return self._cache[payload, hurried]

    def _counted(self, energy: Estimate) -> float:
        """Return what an energy counts: as expected, or at the bound as the battery feels it."""
        if self._hopeful or not np.isfinite(energy.mean):
            return energy.mean
        walk = self._walk
        return walk.legs.grounds.from_battery(energy).upper(walk.quantile)

    def _energy(self, payload: float, hurried: bool = False) -> FloatArray:
        """Energies with any payload, interpolated between the levels."""
        if self._each:
            return self._known(round(payload, 6), hurried)
        known = self._interpolated(payload, hurried)
        # the search beyond knows no energy that comes back
        return known if self.exact else np.maximum(known, 0.0)

    def _interpolated(self, payload: float, hurried: bool) -> FloatArray:
        levels = self._levels
        if len(levels) == 1:
            return self._known(float(levels[0]), hurried)
        weights = np.ones(len(levels))
        for k, level in enumerate(levels):
            for other in np.delete(levels, k):
                weights[k] *= (payload - other) / (level - other)
        known = [self._known(float(level), hurried) for level in levels]
        blocked = np.any([~np.isfinite(m) for m in known], axis=0)
        total = sum(w * np.where(blocked, 0.0, m) for w, m in zip(weights, known, strict=True))
        return np.where(blocked, np.inf, np.asarray(total))

    def _finish(self, payload: float) -> FloatArray:
        return np.asarray(self._energy(payload)[:, self._ends].min(axis=1))

    def _times(self, hurried: bool = False) -> FloatArray:
        """Tell the times between places: straight on at full speed where no route is planned."""
        legs, payload = self._walk.legs, self._walk.mission.payload
        speed = legs.cost(payload)[0].admissible_speed(0.0)
        poses = np.array(legs.poses)[:, :2]
        apart = np.linalg.norm(poses[:, None] - poses[None], axis=-1)
        times: FloatArray = np.asarray(apart / float(speed), float)
        for i, j in np.argwhere(np.ones_like(times)):
            if legs.planned(int(i), int(j), hurried):
                times[i, j] = legs.leg(int(i), int(j), payload, hurried).duration
        slower = self._walk.quantile * self._walk.mission.spreads.speed
        return np.asarray(times * (1.0 + self._caution * slower))

    # -- the problem ------------------------------------------------------------------------------

    def problem(self) -> OrderProblem:
        """Return the order problem on what is known now."""
        walk, mission = self._walk, self._walk.mission
        tasks, chargers = mission.tasks, mission.chargers
        efficiency = 1.0 if self._hopeful else mission.battery.charge_efficiency
        times = self._times()
        payload = mission.payload
        grounds = walk.legs.grounds
        service = []
        for k in range(len(tasks)):
            region = walk.legs.region(k + 1)
            done = grounds.waiting(region, k, payload) + grounds.work(region, k, payload)
            service.append(self._counted(done))
        reserve = self._stored(mission.reserve)
        hurry = True in walk.ways
        return OrderProblem(
            energy=self._energy,
            finish=self._finish,
            time=times,
            finish_time=times[:, self._ends].min(axis=1),
            service=np.array(service),
            service_time=np.array([self._service_time(k) for k in range(len(tasks))]),
            payload=payload,
            payload_change=np.array([task.payload for task in tasks]),
            prize=np.array([task.prize for task in tasks]),
            required=np.array([task.required for task in tasks]),
            window=np.array([task.window for task in tasks], float),
            budget=self._scale * (self._stored(self._soc(mission.soc)) - reserve),
            capacity=np.array(
                [self._scale * (self._stored(self._soc(c.until)) - reserve) for c in chargers]
            ),
            charge_power=np.array([c.power for c in chargers]) * efficiency,
            start_time=mission.time,
            full=self._scale * (self._stored(1.0) - reserve),
            hurried_energy=partial(self._energy, hurried=True) if hurry else None,
            hurried_time=self._times(hurried=True) if hurry else None,
        )

    def _service_time(self, task: int) -> float:
        """Return the time that a task takes, with part of its bound where windows press [s]."""
        mission, grounds = self._walk.mission, self._walk.legs.grounds
        spread = np.linalg.norm(grounds.waiting_time(task) + grounds.dwell_time(task))
        told = mission.waiting + mission.tasks[task].dwell
        return float(told + self._caution * self._walk.quantile * spread)

    def _stored(self, soc: float) -> float:
        power = _LOSSLESS if self._hopeful else self._power
        return float(self._walk.mission.battery.usable_energy(power, soc))

    def _soc(self, told: float) -> float:
        return told if self._hopeful else self._walk.at_least(told)

    # -- routes -----------------------------------------------------------------------------------

    def _used(self, order: Order) -> list[tuple[int, int, bool]]:
        """Routes that an order uses and whether in a hurry, the way to its end included."""
        nodes = [0, *order.stops]
        finish = self._energy(self._payload_after(order.stops))[nodes[-1], self._ends]
        driven = zip(pairwise(nodes), _ways(order), strict=True)
        return [
            *((i, j, quick) for (i, j), quick in driven),
            (nodes[-1], self._ends[int(finish.argmin())], False),
        ]

    def _payload_after(self, stops: tuple[int, ...]) -> float:
        tasks = self._walk.mission.tasks
        carried = sum(tasks[s - 1].payload for s in stops if s <= len(tasks))
        return float(np.clip(self._walk.mission.payload + carried, *self._levels[[0, -1]]))

    def missing(self, order: Order) -> int:
        """Count the routes of an order that are not planned."""
        return sum(not self._walk.legs.planned(*used) for used in self._used(order))

    def plan(self, order: Order) -> None:
        """Plan the routes of an order."""
        legs = self._walk.legs
        ratios = []
        for i, j, quick in self._used(order):
            if not legs.planned(i, j, quick):
                leg = legs.leg(i, j, float(self._levels[-1]), quick)
                bound = self._bounds[-1][i, j]
                if np.isfinite(leg.energy.mean) and bound > 0:
                    ratios.append(self._counted(leg.energy) / bound)
        if not self.exact and ratios:
            # A search cannot wait for all bounds to become true: let them be typical instead.
            self._inflation = float(np.median(ratios))
        self._cache.clear()

    def settled(self, progress: Callable[[str], None] | None) -> Order:
        """Solve and plan the routes of the answer until it uses planned routes only.

        The answer is proven where that point is reached with an exact order.
        """
        counted = self._walk.mission.planning_effort is not None
        effort = int(_SEARCH_TIME * PACE) if counted else None
        order = Order((), 0.0, 0.0, False)
        for turn in range(_ROUNDS if self.exact else _SEARCH_ROUNDS):
            order = solve(self.problem(), time_limit=_SEARCH_TIME, effort=effort)
            missing = self.missing(order)
            if progress is not None:
                progress(
                    f"order {turn + 1}: {len(order.stops)} stops, {order.energy / 3600:.1f} Wh, "
                    f"{missing} routes to plan"
                )
            if not missing:
                return order
            self.plan(order)
        return replace(order, proven=False)

    def holds(self, order: Order) -> bool:
        """Run the battery over an order; tell whether it lasts."""
        state = self._walk.follow(order.stops, _ways(order))
        return state is not None and self._walk.finish(state) is not None

    def shrink(self, stops: tuple[int, ...]) -> bool:
        """Take times for longer, the battery for smaller; tell whether another try is worth it.

        The order is found on energies that add up; the battery holds less at high power.
        """
        if self._scale < 0.8 or not stops:
            return False
        if self._caution and self._caution < 1.0:
            self._caution = 1.0
            return True
        self._scale *= 0.98
        return True

    def gap(self, found: Order, hope: Order) -> float:
        """Return by which fraction of an order's energy a better one may exist at most."""
        tasks, walk = self._walk.mission.tasks, self._walk
        worth = [sum(self.problem().worth[s - 1] for s in one.stops if s <= len(tasks))
                 for one in (found, hope)]  # fmt: skip
        state = walk.follow(found.stops, _ways(found))
        last = None if state is None else walk.finish(state)
        if last is None or worth[0] < worth[1] - _ROUNDING or last.total.mean <= 0:
            return float(np.nan)
        return max(1.0 - hope.bound / last.total.mean, 0.0)
