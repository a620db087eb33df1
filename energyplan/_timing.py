"""From ladders to a timed path: rates at the corners, phases of constant acceleration, samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan._ladder import Ladder
from energyplan.path import FloatArray, Path, Trajectory


class Phases(NamedTuple):
    """Phases of constant acceleration in order of time, arrays of one shape.

    Parameters
    ----------
    run : ndarray of int
        The run that the phase belongs to.
    at : ndarray
        Distance from the run's start along its faster tread [m].
    rate, gain : ndarray
        Rate at the start [m/s] and its acceleration [m/s^2].
    time : ndarray
        Duration [s], positive.
    """

    run: NDArray[np.int_]
    at: FloatArray
    rate: FloatArray
    gain: FloatArray
    time: FloatArray

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return float(self.time.sum())


class Sampled(NamedTuple):
    """A trajectory and the run that each of its samples lies on."""

    trajectory: Trajectory
    run: NDArray[np.int_]


@dataclass(frozen=True)
class Course:
    """A path as runs that meet at corners.

    Parameters
    ----------
    path : Path
        The path, one segment per run, none of them empty.
    length : ndarray, shape (n,)
        Length of each run along its faster tread [m].
    corner : ndarray, shape (n + 1,)
        Largest rate at the start, at each corner and at the end [m/s].
    through : ndarray of bool, shape (n - 1,)
        Corners that are part of a smooth curve and driven through although the shares of the
        treads jump.
    """

    path: Path
    length: FloatArray
    corner: FloatArray
    through: NDArray[np.bool_]

    def phases(self, ladder: Ladder, cruise: FloatArray) -> Phases:
        """Drive every run as fast as its ladder and cruising rate allow.

        Parameters
        ----------
        ladder : Ladder
            One ladder per run.
        cruise : ndarray, shape (n,)
            Largest rate on each run [m/s].
        """
        nodes = self._corner_squares(ladder, cruise)
        parts = [
            _run_phases(ladder, k, self.length[k], nodes[k], nodes[k + 1], cruise[k] ** 2)
            for k in range(len(self.length))
        ]
        run = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
        at, rate, gain, time = np.concatenate(parts, axis=1)
        keep = time > 1e-12
        return Phases(run[keep], at[keep], rate[keep], gain[keep], time[keep])

    def _corner_squares(self, ladder: Ladder, cruise: FloatArray) -> FloatArray:
        """Squared rates at the corners: a pass forwards, then one backwards.

        The rates at start and end are given; cruising begins after and ends before them.
        """
        top = ladder.rate[-1]
        cap = np.concatenate([top[:1], np.minimum(cruise[:-1], cruise[1:]), top[-1:]])
        nodes: FloatArray = np.minimum(self.corner, cap) ** 2
        square, climb, descent = ladder.square, ladder.climb, ladder.descent
        for k, length in enumerate(self.length):
            if nodes[k + 1] > 0:
                start = np.interp(nodes[k], square[:, k], climb[:, k])
                reach = np.interp(start + length, climb[:, k], square[:, k])
                nodes[k + 1] = min(nodes[k + 1], reach)
        for k in range(len(self.length) - 1, -1, -1):
            if nodes[k] > 0:
                stop = np.interp(nodes[k + 1], square[:, k], descent[:, k])
                reach = np.interp(stop + self.length[k], descent[:, k], square[:, k])
                nodes[k] = min(nodes[k], reach)
        return nodes

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

    def _windows(self) -> tuple[FloatArray, FloatArray]:
        """Distances from the start and from the end of each run without samples [m]."""
        reach = 0.5 * np.minimum(self.length[:-1], self.length[1:]) * self.through
        return np.append(0.0, reach), np.append(reach, 0.0)

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


def _crowded(t: FloatArray, run: NDArray[np.int_], at: FloatArray) -> NDArray[np.bool_]:
    """Mark samples too close to a neighbour for a meaningful acceleration; never corners."""
    close = np.diff(t) < max(1e-5, 1e-6 * float(t[-1]))
    corner = at <= 0.0
    corner[-1] = True
    near = np.append(close, False) | np.append(False, close)
    return np.asarray(near & ~corner)


def _run_phases(
    ladder: Ladder, k: int, length: float, first: float, last: float, cruise: float
) -> FloatArray:
    """Climb, cruise and descend: rows at, rate, gain, time of one run's phases.

    `first`, `last` and `cruise` are squared rates.
    """
    square, climb, descent = ladder.square[:, k], ladder.climb[:, k], ladder.descent[:, k]
    faster, slower = (square, ladder.up[:, k]), (square, ladder.down[:, k])
    begin = float(np.interp(first, square, climb))
    end = float(np.interp(last, square, descent))
    peak = min(float(np.interp(length + begin + end, climb + descent, square)), cruise)
    before = _steps(*faster, first, peak) if peak >= first else _back(*slower, peak, first)
    after = _back(*slower, last, peak) if peak >= last else _steps(*faster, peak, last)
    if before[2].sum() + after[2].sum() > length * (1 + 1e-9):
        # Too short to slow down to the cruising rate in between.
        peak = max(first, last)
        before, after = _steps(*faster, first, peak), _back(*slower, last, peak)
    rest = max(length - before[2].sum() - after[2].sum(), 0.0)
    fast = np.sqrt(peak)
    level = np.array([[fast], [0.0], [rest], [rest / fast]])
    rows = _merge(np.concatenate([before, level, after], axis=1))
    at = np.concatenate([[0.0], np.cumsum(rows[2])[:-1]])
    return np.array([at, rows[0], rows[1], rows[3]])


def _steps(square: FloatArray, gain: FloatArray, low: float, high: float) -> FloatArray:
    """Rows rate, gain, distance, time of the climb from squared rate `low` to `high`."""
    inner = (square > low) & (square < high)
    knots = np.concatenate([[low], square[inner], [high]])
    rung = np.clip(np.searchsorted(square, 0.5 * (knots[:-1] + knots[1:])) - 1, 0, len(gain) - 1)
    rate = np.sqrt(knots)
    distance = np.diff(knots) / (2 * gain[rung])
    return np.array([rate[:-1], gain[rung], distance, np.diff(rate) / gain[rung]])


def _back(square: FloatArray, gain: FloatArray, low: float, high: float) -> FloatArray:
    """Rows rate, gain, distance, time of the descent from squared rate `high` to `low`."""
    rate, rise, distance, time = _steps(square, gain, low, high)[:, ::-1]
    return np.array([rate + rise * time, -rise, distance, time])


def _merge(rows: FloatArray) -> FloatArray:
    """Join neighbouring phases of equal acceleration."""
    rows = rows[:, rows[3] > 0]
    fresh = np.concatenate([[True], np.abs(np.diff(rows[1])) > 1e-9 * np.abs(rows[1][1:])])
    place = np.flatnonzero(fresh)
    summed = np.add.reduceat(rows[2:], place, axis=1)
    return np.vstack([rows[:2, place], summed])
