"""From ladders to a timed path: rates at the corners, phases of constant acceleration, samples.

The kernels take all rates squared, so that they are piecewise linear in distance. A table has one
column per run and one row per rung of its ladder.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import AnyTable, Column, Floats, FloatTable, Ints, njit
from energyplan.limits.acceleration_table import Ladder
from energyplan.limits.curve import subdivided
from energyplan.path import FloatArray, Path, Pose, Trajectory


@njit
def interpolate(x: float, known: Column, value: Column) -> float:
    """Value at `x` of the piecewise linear function through the non-decreasing `known`."""
    low, high = 0, len(known) - 1
    if x <= known[low]:
        return float(value[low])
    if x >= known[high]:
        return float(value[high])
    while high - low > 1:
        middle = (low + high) // 2
        if known[middle] <= x:
            low = middle
        else:
            high = middle
    part = (x - known[low]) / (known[high] - known[low])
    return float(value[low] + part * (value[high] - value[low]))


@njit
def limit_corners(
    square: AnyTable,
    climb: AnyTable,
    descent: AnyTable,
    length: Column,
    nodes: Floats,
) -> None:
    """Lower the rates at the corners to what can be reached: a pass forwards, one backwards."""
    for k in range(len(length)):
        if nodes[k + 1] > 0.0:
            start = interpolate(nodes[k], square[:, k], climb[:, k])
            reach = interpolate(start + length[k], climb[:, k], square[:, k])
            nodes[k + 1] = min(nodes[k + 1], reach)
    for k in range(len(length) - 1, -1, -1):
        if nodes[k] > 0.0:
            stop = interpolate(nodes[k + 1], square[:, k], descent[:, k])
            reach = interpolate(stop + length[k], descent[:, k], square[:, k])
            nodes[k] = min(nodes[k], reach)


@njit
def ramp(
    square: Column, gain: Column, first: float, last: float, out: FloatTable, count: int
) -> int:
    """Append the phases from rate `first` to `last`; columns distance, rate, gain, time.

    Rising rates use `gain` as it is, falling ones its negative. Neighbouring rungs of equal
    acceleration are one phase. Returns the new count.
    """
    rungs = len(gain)
    falling = last < first
    x = first
    for step in range(rungs):
        j = rungs - 1 - step if falling else step
        if falling:
            goal = max(square[j], last)
            if goal >= x:
                continue
        else:
            goal = min(square[j + 1], last)
            if goal <= x:
                continue
        a = -gain[j] if falling else gain[j]
        before, after = np.sqrt(x), np.sqrt(goal)
        distance, time = (goal - x) / (2.0 * a), (after - before) / a
        x = goal
        if count > 0 and abs(out[2, count - 1] - a) <= 1e-9 * abs(a):
            out[0, count - 1] += distance
            out[3, count - 1] += time
        else:
            out[0, count], out[1, count] = distance, before
            out[2, count], out[3, count] = a, time
            count += 1
    return count


@njit
def lay_run(
    square: Column,
    up: Column,
    down: Column,
    climb: Column,
    descent: Column,
    length: float,
    first: float,
    last: float,
    cruise: float,
    out: FloatTable,
) -> int:
    """Lay one run from rate `first` over `cruise` to `last`; returns the number of phases."""
    begin = interpolate(first, square, climb)
    end = interpolate(last, square, descent)
    peak = min(interpolate(length + begin + end, climb + descent, square), cruise)
    count = 0
    for _ in range(2):
        middle = ramp(square, up if peak >= first else down, first, peak, out, 0)
        used = out[0, :middle].sum()
        out[0, middle], out[1, middle] = 0.0, np.sqrt(peak)
        out[2, middle], out[3, middle] = 0.0, 0.0
        count = ramp(square, down if peak >= last else up, peak, last, out, middle + 1)
        used += out[0, middle + 1 : count].sum()
        if used <= length * (1.0 + 1e-9):
            break
        # Too short to slow down to the cruising rate in between.
        peak = max(first, last)
    rest = max(length - used, 0.0)
    if rest > 0.0:
        out[0, middle], out[3, middle] = rest, rest / np.sqrt(peak)
    return count


@njit
def lay_phases(
    square: AnyTable,
    up: AnyTable,
    down: AnyTable,
    climb: AnyTable,
    descent: AnyTable,
    length: Column,
    nodes: Column,
    cruise: Column,
) -> tuple[Ints, FloatTable]:
    """Run, and rows at, rate, gain and time, of every phase of every run."""
    runs, most = len(length), 2 * up.shape[0] + 1
    run = np.empty(runs * most, np.int64)
    rows = np.empty((4, runs * most))
    buffer = np.empty((4, most))
    total = 0
    for k in range(runs):
        count = lay_run(
            square[:, k], up[:, k], down[:, k], climb[:, k], descent[:, k],
            length[k], nodes[k], nodes[k + 1], cruise[k], buffer,
        )  # fmt: skip
        at = 0.0
        for i in range(count):
            if buffer[3, i] > 1e-12:
                run[total] = k
                rows[0, total] = at
                rows[1:, total] = buffer[1:, i]
                total += 1
            at += buffer[0, i]
    return run[:total].copy(), rows[:, :total].copy()


ROUNDED = 0.15
"""Longest cell where a corner is rounded [m]."""


class Phases(NamedTuple):
    """Phases of constant acceleration in order of time, arrays of one shape."""

    run: NDArray[np.int_]  # the run that the phase belongs to
    at: FloatArray  # distance from the run's start along its faster tread [m]
    rate: FloatArray  # rate at the start [m/s] and its acceleration [m/s^2]
    gain: FloatArray  # rate at the start [m/s] and its acceleration [m/s^2]
    time: FloatArray  # duration [s], positive

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return float(self.time.sum())


class Sampled(NamedTuple):
    """A trajectory and the run that each of its samples lies on."""

    trajectory: Trajectory
    run: NDArray[np.int_]


class Grid(NamedTuple):
    """Points along a course, and the cells between them."""

    run: NDArray[np.int_]  # (n,): run that the point lies on
    at: FloatArray  # (n,): distance from the run's start [m]
    shape: FloatArray  # (n, 2): speed along the heading [1] and yaw rate [1/m] at unit rate
    cell: FloatArray  # (n - 1,): lengths of the cells [m]


@dataclass(frozen=True)
class Course:
    """A path as runs that meet at corners."""

    path: Path  # the path, one segment per run, none of them empty
    length: FloatArray  # (n,): length of each run along its faster tread [m]
    corner: FloatArray  # (n + 1,): largest rate at the start, at each corner and at the end [m/s]
    through: NDArray[np.bool_]  # (n - 1,)
    tolerance: float  # how far the robot may leave the path there [m]

    def phases(self, ladder: Ladder, cruise: FloatArray) -> Phases:
        """Drive every run as fast as its ladder and cruising rate allow."""
        top = ladder.rate[-1]
        # The rates at start and end are given; cruising begins after and ends before them.
        cap = np.concatenate([top[:1], np.minimum(cruise[:-1], cruise[1:]), top[-1:]])
        nodes = np.minimum(self.corner, cap) ** 2
        square, climb, descent = ladder.square, ladder.climb, ladder.descent
        limit_corners(square, climb, descent, self.length, nodes)
        run, rows = lay_phases(
            square, ladder.up, ladder.down, climb, descent, self.length, nodes, cruise**2
        )
        return Phases(run, *rows)

    def sample(self, phases: Phases, period: float) -> Sampled:
        """Sample the motion at the ends of the phases and at least every `period` [s].

        Around a corner that is driven through there is no sample for half the shorter run on
        either side: straight interpolation between the samples is the smooth curve there.
        """
        phases = self._cut(phases)
        pieces = np.maximum(np.ceil(phases.time / period - 1e-9).astype(int), 1)
        k = np.repeat(np.arange(len(pieces)), pieces)
        within = np.arange(len(k)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        since = phases.time[k] * within / pieces[k]
        start = np.cumsum(phases.time) - phases.time
        run = np.append(phases.run[k], len(self.length) - 1)
        t = np.append(start[k] + since, phases.duration)
        at = phases.at[k] + since * (phases.rate[k] + 0.5 * phases.gain[k] * since)
        at = np.append(at, self.length[-1])
        rate = phases.rate[k] + phases.gain[k] * since
        rate = np.append(rate, phases.rate[-1] + phases.gain[-1] * phases.time[-1])
        rate[np.abs(rate) < 1e-9] = 0.0
        for unwanted in (self._hidden, _crowded):
            keep = ~unwanted(t, run, at)
            t, run, at, rate = t[keep], run[keep], at[keep], rate[keep]
        poses = self._poses(run, np.clip(at / self.length[run], 0.0, 1.0))
        unit = rate / self.length[run]
        v, omega = self.path.ds[run] * unit, self.path.dtheta[run] * unit
        return Sampled(Trajectory(t, poses[:, 0], poses[:, 1], poses[:, 2], v, omega), run)

    @property
    def shape(self) -> FloatArray:
        """Speed along the heading [1] and yaw rate [1/m] of each run at unit rate, (n, 2)."""
        return np.column_stack([self.path.ds, self.path.dtheta]) / self.length[:, None]

    @property
    def reach(self) -> FloatArray:
        """How far a corner that is driven through is rounded to either side [m], shape (n - 1,)."""
        return rounding(self.length, self.shape, self.tolerance) * self.through

    def _windows(self) -> tuple[FloatArray, FloatArray]:
        """Distances from the start and from the end of each run without samples [m]."""
        reach = self.reach
        return np.append(0.0, reach), np.append(reach, 0.0)

    def sections(self) -> list[Course]:
        """Return the parts between the stops."""
        stops = np.flatnonzero(self.corner[1:-1] == 0.0) + 1
        first, vertices = 0, self.path.vertices
        parts = []
        for last in (*stops, len(self.length)):
            part = slice(first, last)
            path = Path(
                Pose(*vertices[first]), self.path.ds[part], self.path.dtheta[part],
                self.path.longitudinal,
            )  # fmt: skip
            parts.append(
                Course(
                    path, self.length[part], self.corner[first : last + 1],
                    self.through[first : last - 1], self.tolerance,
                )
            )  # fmt: skip
            first = int(last)
        return parts

    def grid(self, step: float) -> Grid:
        """Return points along the course, at most `step` apart on arcs, `ROUNDED` at corners."""
        head, tail = self._windows()
        shape = self.shape
        run: list[int] = []
        at: list[float] = []
        bent: list[FloatArray] = []
        cell: list[float] = []
        for k, length in enumerate(self.length):
            places = subdivided(float(head[k]), float(length - tail[k]), step)
            if k:
                gap = float(tail[k - 1] + head[k])
                # Where no corner is rounded, or by next to nothing, the runs share a point.
                parts = int(np.ceil(gap / ROUNDED - 1e-9)) if gap > 0 else 0
                for i in range(1, parts):
                    share = i / parts
                    place = gap * share - float(tail[k - 1])
                    run.append(k - 1 if place < 0 else k)
                    at.append(float(self.length[k - 1]) + place if place < 0 else place)
                    bent.append((1 - share) * shape[k - 1] + share * shape[k])
                if parts:
                    cell += [gap / parts] * parts
                else:
                    cell += [places[1] - places[0]] if len(places) > 1 else []
                    places = places[1:]
            cell += list(np.diff(places))
            run += [k] * len(places)
            at += list(places)
            bent += [shape[k]] * len(places)
        return Grid(np.array(run), np.array(at), np.array(bent), np.array(cell))

    def at_points(self, grid: Grid, rate: FloatArray) -> Sampled:
        """Return the trajectory through the points of a grid at given rates."""
        run = grid.run
        t = np.append(0.0, np.cumsum(2 * grid.cell / (rate[1:] + rate[:-1])))
        poses = self._poses(run, np.clip(grid.at / self.length[run], 0.0, 1.0))
        v, omega = (grid.shape * rate[:, None]).T
        made = Trajectory(t, poses[:, 0], poses[:, 1], poses[:, 2], v, omega)
        return Sampled(made, run)

    def _hidden(self, t: FloatArray, run: NDArray[np.int_], at: FloatArray) -> NDArray[np.bool_]:
        head, tail = self._windows()
        slack = 1e-9 * self.length[run]
        left = self.length[run] - at
        return np.asarray((at < head[run] - slack) | (left < tail[run] - slack))

    def _cut(self, phases: Phases) -> Phases:
        """Split the phases where the windows without samples begin and end."""
        head, tail = self._windows()
        for place in (head, self.length - tail):
            goal = place[phases.run]
            into = goal - phases.at
            final = phases.rate + phases.gain * phases.time
            whole = 0.5 * (phases.rate + final) * phases.time
            split = (into > 1e-9 * whole) & (into < whole * (1 - 1e-9)) & (goal > 0)
            if not split.any():
                continue
            k = np.flatnonzero(split)
            rate = np.sqrt(phases.rate[k] ** 2 + 2 * phases.gain[k] * into[k])
            first = 2 * into[k] / (phases.rate[k] + rate)
            time = phases.time.copy()
            time[k] = first
            rest = phases.time[k] - first
            columns = zip(
                (phases.run, phases.at, phases.rate, phases.gain, time),
                (phases.run[k], goal[k], rate, phases.gain[k], rest),
                strict=True,
            )
            phases = Phases(*(np.insert(old, k + 1, new) for old, new in columns))
        return phases

    def _poses(self, run: NDArray[np.int_], part: FloatArray) -> FloatArray:
        """Exact poses on the arcs, a fraction `part` of the way through each."""
        path, lever = self.path, self.path.longitudinal
        begin = path.vertices[run]
        turn = part * path.dtheta[run]
        yaw = begin[:, 2] + turn
        chord = part * path.ds[run] * np.sinc(turn / (2 * np.pi))
        mid = begin[:, 2] + 0.5 * turn
        x = begin[:, 0] + lever * (np.cos(begin[:, 2]) - np.cos(yaw)) + chord * np.cos(mid)
        y = begin[:, 1] + lever * (np.sin(begin[:, 2]) - np.sin(yaw)) + chord * np.sin(mid)
        return np.column_stack([x, y, yaw])


def rounding(length: FloatArray, shape: FloatArray, tolerance: float) -> FloatArray:
    """Return how far corners may be rounded to either side [m], shape (n - 1,).

    At most half of either run, and not so far that the robot leaves the path by more than
    `tolerance` [m]: while the curvature changes evenly over twice the distance w in place of
    jumping by k, the way is offset by k w^2 / 6.
    """
    half = 0.5 * np.minimum(length[:-1], length[1:])
    bend = np.abs(np.diff(shape[:, 1]))
    wide = np.sqrt(np.divide(6 * tolerance, bend, out=np.full_like(bend, np.inf), where=bend > 0))
    return np.minimum(half, wide)


def worth_rounding(
    length: FloatArray, reach: FloatArray, jump: FloatArray, most: float, slow: float
) -> NDArray[np.bool_]:
    """Tell which corners are passed not much slower than what is beside them, shape (n - 1,).

    Beside a run of next to no length there is no room: the corner is passed at a crawl, at which a
    stop takes less. `most` is the largest acceleration [m/s^2]. Passed slower than at the rate
    `slow` [m/s], or at less than a twentieth of what a run beside them leads to, corners are none.
    """
    led = 0.05 * np.sqrt(2.0 * most * np.maximum(length[:-1], length[1:]))
    return np.asarray(2.0 * reach * most >= np.minimum(slow, led) ** 2 * jump * (1.0 + 2.0 * jump))


def joined(parts: list[Sampled], first_run: list[int]) -> Sampled:
    """Return trajectories that follow upon each other as one."""
    t, columns, runs, since = [], [], [], 0.0
    for k, (part, first) in enumerate(zip(parts, first_run, strict=True)):
        made, skip = part.trajectory, 1 if k else 0
        t.append(since + made.t[skip:])
        since += made.duration
        columns.append(np.column_stack([made.poses, made.v, made.omega])[skip:])
        runs.append(first + part.run[skip:])
    x, y, yaw, v, omega = np.concatenate(columns).T
    return Sampled(Trajectory(np.concatenate(t), x, y, yaw, v, omega), np.concatenate(runs))


def _crowded(t: FloatArray, run: NDArray[np.int_], at: FloatArray) -> NDArray[np.bool_]:
    """Mark samples too close to a neighbour for a meaningful acceleration; never corners."""
    close = np.diff(t) < max(1e-5, 1e-6 * float(t[-1]))
    corner = at <= 0.0
    corner[-1] = True
    near = np.append(close, False) | np.append(False, close)
    return np.asarray(near & ~corner)
