"""Free order: routes are planned only where the best order may use them.

Energies between places start as lower bounds. The order that is best on them names the routes to
plan; with their true energies the order is solved again, until it uses planned routes only. Since
the others are bounds from below, nothing that was left unplanned can be better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from energyplan.mission.order import Order, OrderProblem, exact_size, solve
from energyplan.mission.simulation import Condition, Walk
from energyplan.path import FloatArray
from energyplan.planning.budget import PACE

_ROUNDS = 25
_SEARCH_ROUNDS = 3
_SEARCH_TIME = 2.0
_LEVELS = 3
_MOST_LOADS = 64


@dataclass(frozen=True)
class Stops:
    """The stops of a free order.

    Parameters
    ----------
    stops : tuple of int
        Nodes in the order of their visits.
    proven : bool
        Whether no better order exists on the energies known.
    """

    stops: tuple[int, ...]
    proven: bool


def best_stops(walk: Walk, progress: Callable[[str], None] | None = None) -> Stops:
    """Find which tasks to do in which order, and where to charge.

    Parameters
    ----------
    walk : Walk
        The mission.
    progress : callable, optional
        Called with one line of text whenever an order is found.

    Returns
    -------
    Stops
        The stops.
    """
    matrix = _Matrix(walk)
    exact = matrix.exact
    counted = walk.mission.planning_effort is not None
    effort = int(_SEARCH_TIME * PACE) if counted else None
    order = Order((), 0.0, 0.0, False)
    settled = False
    for turn in range(_ROUNDS if exact else _SEARCH_ROUNDS):
        order = solve(matrix.problem(), time_limit=_SEARCH_TIME, effort=effort)
        if progress is not None:
            progress(
                f"order {turn + 1}: {len(order.stops)} stops, {order.energy / 3600:.1f} Wh, "
                f"{matrix.missing(order.stops)} routes to plan"
            )
        if not matrix.missing(order.stops):
            settled = not matrix.calibrate(order.stops)
            if settled:
                break
            continue
        matrix.plan(order.stops)
    return Stops(order.stops, settled and order.proven and matrix.true)


class _Matrix:
    """Energies between places, known or bounded, and the energy that the battery holds."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        mission = walk.mission
        change = np.array([task.payload for task in mission.tasks])
        low = max(mission.payload + float(change[change < 0].sum()), 0.0)
        high = mission.payload + float(change[change > 0].sum())
        timed = any(task.window != (0.0, np.inf) for task in mission.tasks)
        self.exact = len(mission.tasks) <= exact_size(timed or bool(mission.chargers))
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
        self._power = walk.legs.grounds.driving_power
        self._cache: dict[float, FloatArray] = {}

    def _end_nodes(self) -> list[int]:
        legs, rule = self._walk.legs, self._walk.mission.return_to
        ends = [] if rule == "charger" else [legs.home]
        return ends if rule == "start" else [*ends, *legs.chargers]

    @property
    def true(self) -> bool:
        """Whether the energies of an order are those of its legs at each payload."""
        return self._each or len(self._levels) == 1

    # -- energies ---------------------------------------------------------------------------------

    def _known(self, payload: float) -> FloatArray:
        """Energies with one payload: at the bound where planned, from below where not."""
        if payload not in self._cache:
            walk, legs = self._walk, self._walk.legs
            if self._each:
                matrix = self._walk.legs.lower_bounds(payload).copy()
            else:
                level = int(np.argmin(np.abs(self._levels - payload)))
                matrix = self._bounds[level] * self._inflation
            for i, j in np.argwhere(np.ones_like(matrix)):
                if legs.planned(int(i), int(j)):
                    energy = legs.leg(int(i), int(j), payload).energy
                    finite = np.isfinite(energy.mean)
                    energy = legs.grounds.from_battery(energy) if finite else energy
                    matrix[i, j] = energy.upper(walk.quantile) if finite else np.inf
            self._cache[payload] = matrix
        return self._cache[payload]

    def _energy(self, payload: float) -> FloatArray:
        """Energies with any payload, interpolated between the levels."""
        if self._each:
            return self._known(round(payload, 6))
        known = self._interpolated(payload)
        # the search beyond knows no energy that comes back
        return known if self.exact else np.maximum(known, 0.0)

    def _interpolated(self, payload: float) -> FloatArray:
        levels = self._levels
        if len(levels) == 1:
            return self._known(float(levels[0]))
        weights = np.ones(len(levels))
        for k, level in enumerate(levels):
            for other in np.delete(levels, k):
                weights[k] *= (payload - other) / (level - other)
        known = [self._known(float(level)) for level in levels]
        blocked = np.any([~np.isfinite(m) for m in known], axis=0)
        total = sum(w * np.where(blocked, 0.0, m) for w, m in zip(weights, known, strict=True))
        return np.where(blocked, np.inf, np.asarray(total))

    def _finish(self, payload: float) -> FloatArray:
        return np.asarray(self._energy(payload)[:, self._ends].min(axis=1))

    def _times(self) -> FloatArray:
        """Tell the times between places: straight on at full speed where no route is planned."""
        legs, payload = self._walk.legs, self._walk.mission.payload
        speed = legs.cost(payload)[0].admissible_speed(0.0)
        poses = np.array(legs.poses)[:, :2]
        apart = np.linalg.norm(poses[:, None] - poses[None], axis=-1)
        times: FloatArray = np.asarray(apart / float(speed), float)
        for i, j in np.argwhere(np.ones_like(times)):
            if legs.planned(int(i), int(j)):
                times[i, j] = legs.leg(int(i), int(j), payload).duration
        return times

    # -- the problem ------------------------------------------------------------------------------

    def problem(self) -> OrderProblem:
        """Return the order problem on what is known now."""
        walk, mission = self._walk, self._walk.mission
        tasks, battery = mission.tasks, mission.battery
        times = self._times()
        payload = mission.payload
        grounds = walk.legs.grounds
        service = []
        for k in range(len(tasks)):
            region = walk.legs.region(k + 1)
            done = grounds.waiting(region, k, payload) + grounds.work(region, k, payload)
            service.append(grounds.from_battery(done).upper(walk.quantile))
        reserve = self._stored(mission.reserve)
        return OrderProblem(
            energy=self._energy,
            finish=self._finish,
            time=times,
            finish_time=times[:, self._ends].min(axis=1),
            service=np.array(service),
            service_time=np.array([mission.waiting + task.dwell for task in tasks]),
            payload=payload,
            payload_change=np.array([task.payload for task in tasks]),
            prize=np.array([task.prize for task in tasks]),
            required=np.array([task.required for task in tasks]),
            window=np.array([task.window for task in tasks], float),
            budget=self._scale * (self._stored(walk.at_least(mission.soc)) - reserve),
            capacity=np.array(
                [
                    self._scale * (self._stored(walk.at_least(c.until)) - reserve)
                    for c in mission.chargers
                ]
            ),
            charge_power=np.array([c.power for c in mission.chargers]) * battery.charge_efficiency,
            start_time=mission.time,
        )

    def _stored(self, soc: float) -> float:
        return float(self._walk.mission.battery.usable_energy(self._power, soc))

    # -- routes -----------------------------------------------------------------------------------

    def _used(self, stops: tuple[int, ...]) -> list[tuple[int, int]]:
        """Routes that an order uses, the way to its end included."""
        nodes = [0, *stops]
        finish = self._energy(self._payload_after(stops))[nodes[-1], self._ends]
        return [
            *pairwise(nodes),
            (nodes[-1], self._ends[int(finish.argmin())]),
        ]

    def _payload_after(self, stops: tuple[int, ...]) -> float:
        tasks = self._walk.mission.tasks
        carried = sum(tasks[s - 1].payload for s in stops if s <= len(tasks))
        return float(np.clip(self._walk.mission.payload + carried, *self._levels[[0, -1]]))

    def missing(self, stops: tuple[int, ...]) -> int:
        """Count the routes of an order that are not planned."""
        return sum(not self._walk.legs.planned(i, j) for i, j in self._used(stops))

    def plan(self, stops: tuple[int, ...]) -> None:
        """Plan the routes of an order."""
        legs = self._walk.legs
        ratios = []
        for i, j in self._used(stops):
            if not legs.planned(i, j):
                leg = legs.leg(i, j, float(self._levels[-1]))
                bound = self._bounds[-1][i, j]
                if np.isfinite(leg.energy.mean) and bound > 0:
                    ratios.append(leg.energy.upper(self._walk.quantile) / bound)
        if not self.exact and ratios:
            # A search cannot wait for all bounds to become true: let them be typical instead.
            self._inflation = float(np.median(ratios))
        self._cache.clear()

    def calibrate(self, stops: tuple[int, ...]) -> bool:
        """Run the battery over an order; tell whether its capacity had to be corrected.

        The order is found on energies that add up; the battery holds less at high power, and the
        uncertainties of legs add up to a little less than their sum.
        """
        walk = self._walk
        state: Condition | None = walk.start
        for stop in stops:
            if state is None:
                break
            if stop in walk.legs.chargers:
                docked = walk.drive(state, stop)
                state = None
                if docked is not None and walk.holds(docked):
                    state = walk.charge(docked)
            else:
                attempt = walk.attempt(state, stop - 1)
                state = attempt.after if attempt.reason == "none" else None
        if state is not None and walk.finish(state) is not None:
            return False
        if self._scale < 0.8 or not stops:
            return False
        self._scale *= 0.98
        return True
