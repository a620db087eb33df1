"""A path as points between which the speeds of both treads run straight, and its trajectory.

The one degree of freedom along a path is the rate, the speed of the faster tread [m/s]; lengths
are measured along that tread. A run is a stretch of one curvature and one set of channels. Runs
meet at corners, which are stopped at, or driven through while the curvature changes evenly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import InfeasibleMotionError, InvalidInputError
from energyplan.path import ROUNDING, FloatArray, Path, Trajectory
from energyplan.vehicle import TreadICR


class ProfileSettings(NamedTuple):
    """Constants of the speed profiles."""

    cells: float = 200.0  # cells of the way between two stops
    finest: float = 0.002  # least length of such a cell [m]
    rounded: float = 0.15  # longest cell where a corner is rounded [m]
    slowest: float = 0.05  # slowest cruising rate of the least energy, over the top rate
    passing: float = 0.05  # slowest passage of a rounded corner, over the rates that its runs reach
    fitted: float = 0.5  # largest jump of a tread's share at which poses approximate a curve [1]
    time_price: float = 1e6  # highest price of time that the search for a duration tries [W]
    sweeps: int = 40  # how often accelerations within power and force are found anew at most
    rungs: int = 96  # steady rates among which the cheapest is looked for
    rounds: int = 40  # how often warm windows are slowed down
    damping: float = 0.5  # part of a window's warmth that one round takes
    margin: float = 1e-6  # part of the continuous power that is left where all is slowed


SETTINGS = ProfileSettings()


class Points(NamedTuple):
    """Points along a path, n of them; cells lie between them, one of no length at each stop."""

    run: NDArray[np.int_]  # (n,): run that the point lies on
    at: FloatArray  # (n,): distance from the run's start [m]
    forward: FloatArray  # (n,): speed along the heading at unit rate [1]
    turn: FloatArray  # (n,): yaw rate at unit rate [1/m]
    cell: FloatArray  # (n - 1,): lengths of the cells [m]
    bent: NDArray[np.bool_]  # (n - 1,): cells in which the curvature changes
    channels: Mapping[str, FloatArray]  # (n,): further channels


@dataclass(frozen=True)
class Course:
    """A path as runs that meet at corners."""

    path: Path  # one segment per run, none of them empty
    length: FloatArray  # (n,): length of each run along its faster tread [m]
    corner: FloatArray  # (n + 1,): largest rate at the start, at each corner and at the end [m/s]
    reach: FloatArray  # (n - 1,): how far each corner is rounded to either side [m]
    channels: Mapping[str, FloatArray]  # (n,): further channels of each run

    @classmethod
    def of(
        cls,
        path: Path,
        icr: TreadICR,
        channels: Mapping[str, ArrayLike],
        smooth: ArrayLike,
        tolerance: float,
        ends: tuple[float, float],
        acceleration: float,
        top: float,
    ) -> Course:
        """Join neighbours of one curvature and one set of channels, and decide on the corners."""
        count, columns = len(path), {}
        for name, value in channels.items():
            if np.shape(value) not in ((), (count,)):
                raise InvalidInputError(
                    f"channel {name!r} has shape {np.shape(value)}; give one value, or one for "
                    f"each of the path's {count} segments"
                )
            columns[name] = np.broadcast_to(np.asarray(value, float), (count,))
        # What rounding leaves of a turn on a straight, or of the slower tread in a pivot, is none.
        straight = np.abs(path.dtheta) * icr.slip_track < ROUNDING * np.abs(path.ds)
        dtheta = np.where(straight, 0.0, path.dtheta)
        left, right = path.ds - icr.left * dtheta, path.ds + icr.right * dtheta
        length = np.maximum(np.abs(left), np.abs(right))
        moves = length > 1e-12 * length.max()
        share = np.column_stack([left[moves], right[moves]]) / length[moves, None]
        given = np.column_stack([np.zeros(count), *columns.values()])[moves]
        fresh = np.any(np.abs(np.diff(share, axis=0)) > ROUNDING, axis=1)
        fresh |= np.any(given[1:] != given[:-1], axis=1)
        begin = np.flatnonzero(np.append(True, fresh))
        ds, dtheta, length = (
            np.add.reduceat(column[moves], begin) for column in (path.ds, dtheta, length)
        )
        share, given = share[begin], given[begin]
        jump = np.max(np.abs(np.diff(share, axis=0)), axis=1, initial=0.0)
        # The faster tread cannot turn round at a jump of 1 or less.
        largest = np.minimum(smooth, 1.0) if tolerance > 0 else np.zeros(())
        if largest.ndim:
            largest = largest[np.flatnonzero(moves)[begin[1:]] - 1]
        through = (jump > ROUNDING) & (jump <= largest + ROUNDING)
        reach = _rounding(length, dtheta / length, tolerance)
        # Passed slower than that, a corner is none: there a stop takes less.
        reached = SETTINGS.passing * np.sqrt(
            2.0 * acceleration * np.maximum(length[:-1], length[1:])
        )
        slow = np.minimum(SETTINGS.slowest * top, reached)
        through &= 2.0 * reach * acceleration >= slow**2 * jump * (1.0 + 2.0 * jump)
        passed = (jump <= ROUNDING) | through
        corner = np.concatenate([ends[:1], np.where(passed, np.inf, 0.0), ends[1:]])
        known = dict(zip(columns, given.T[1:], strict=True))
        whole = Path(path.start, ds, dtheta, path.longitudinal)
        return cls(whole, length, corner, reach * through, known)

    def points(self, gather: float) -> Points:
        """Return points along the runs with a spacing of at most a cell."""
        head, tail = np.append(0.0, self.reach), np.append(self.reach, 0.0)
        stop = self.corner[:-1] == 0.0
        stop[0] = True
        section = np.cumsum(stop) - 1
        whole = np.bincount(section, self.length)
        step = np.maximum(whole / SETTINGS.cells, SETTINGS.finest)[section]
        least = np.where(np.bincount(section)[section] == 1, 2, 1)  # from a stop to the next one
        shape = np.column_stack([self.path.ds, self.path.dtheta]) / self.length[:, None]
        run: list[NDArray[np.int_]] = []
        at: list[FloatArray] = []
        shapes: list[FloatArray] = []
        cell: list[FloatArray] = []
        bent: list[NDArray[np.bool_]] = []
        for k, length in enumerate(self.length):
            places = _subdivided(head[k], length - tail[k], step[k], int(least[k]))
            if places[-1] > places[0]:
                closer = _closer(places[1] - places[0], gather)
                begins, ends = stop[k], k + 1 == len(stop) or stop[k + 1]
                last = places[-1] - (closer[::-1] if ends else closer[:0])
                places = np.concatenate(
                    [places[:1], places[0] + (closer if begins else closer[:0]), places[1:-1], last,
                     places[-1:]]
                )  # fmt: skip
            if stop[k]:
                cell.append(np.zeros(min(k, 1)))
                bent.append(np.full(min(k, 1), False))
            else:
                gap = tail[k - 1] + head[k]
                # Where no corner is rounded, or by next to nothing, the runs share a point.
                parts = int(np.ceil(gap / SETTINGS.rounded - ROUNDING)) if gap > 0 else 0
                share = np.arange(1, parts) / max(parts, 1)
                place = gap * share - tail[k - 1]
                run.append(np.where(place < 0, k - 1, k))
                at.append(np.where(place < 0, self.length[k - 1] + place, place))
                shapes.append(shape[k - 1] + share[:, None] * (shape[k] - shape[k - 1]))
                cell.append(np.full(parts, gap / max(parts, 1)))
                bent.append(np.full(parts, True))
                if not parts:
                    cell.append(np.diff(places[:2]))
                    bent.append(np.full(len(places[:2]) - 1, False))
                    places = places[1:]
            cell.append(np.diff(places))
            bent.append(np.full(max(len(places) - 1, 0), False))
            run.append(np.full(len(places), k))
            at.append(places)
            shapes.append(np.tile(shape[k], (len(places), 1)))
        runs = np.concatenate(run)
        forward, turn = np.concatenate(shapes).T
        known = {name: value[runs] for name, value in self.channels.items()}
        return Points(
            runs, np.concatenate(at), forward, turn, np.concatenate(cell),
            np.concatenate(bent), known,
        )  # fmt: skip

    def timed(self, points: Points, rate: FloatArray, period: float) -> Sampled:
        """Return the trajectory that passes the points at given rates."""
        time = times(points.cell, rate)
        gain = np.diff(rate) / np.where(time > 0, time, 1.0)
        # Cells of one acceleration on one run are one phase, and no stop has two samples.
        plain = ~points.bent & (points.cell > 0)
        near = np.abs(np.diff(gain)) <= ROUNDING * (np.abs(gain[1:]) + np.abs(gain[:-1])) + 1e-12
        same = plain[1:] & plain[:-1] & near & (points.run[2:] == points.run[:-2])
        keep = np.flatnonzero(np.concatenate([[True], ~same, [True]]))
        clock = np.append(0.0, np.cumsum(time))
        t, rate, run, at = clock[keep], rate[keep], points.run[keep], points.at[keep]
        shape = np.column_stack([points.forward, points.turn])[keep]
        if not t[-1] <= 5e6 * period:
            raise InfeasibleMotionError(f"it takes {t[-1]:.3g} s, too long to sample; drive faster")
        step = np.diff(t)
        pieces = np.where(points.bent[keep[:-1]], 1, np.ceil(step / period - ROUNDING).clip(1))
        pieces = np.where(step > 0, pieces, 0).astype(int)
        k = np.repeat(np.arange(len(step)), pieces)
        part = (np.arange(len(k)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[k]
        # A phase begins on its own run, which is that of the point at its end.
        inside = part > 0
        since = part * step[k]
        first, last = rate[k], rate[k + 1]
        begin = np.where(run[k] == run[k + 1], at[k], 0.0)
        places = np.where(inside, begin + since * (first + 0.5 * part * (last - first)), at[k])
        on = np.where(inside, run[k + 1], run[k])
        rates = first + part * (last - first)
        shapes = np.where(inside[:, None], shape[k + 1], shape[k])
        t = np.append(t[k] + since, t[-1])
        on, places = np.append(on, run[-1]), np.append(places, at[-1])
        v, omega = (np.vstack([shapes, shape[-1:]]) * np.append(rates, rate[-1])[:, None]).T
        poses = self.poses(on, places)
        return Sampled(Trajectory(t, poses[:, 0], poses[:, 1], poses[:, 2], v, omega), on)

    def poses(self, run: NDArray[np.int_], at: FloatArray) -> FloatArray:
        """Exact poses on the arcs, at distances from the starts of runs [m]."""
        path, lever = self.path, self.path.longitudinal
        part = np.clip(at / self.length[run], 0.0, 1.0)
        begin = path.vertices[run]
        turn = part * path.dtheta[run]
        yaw = begin[:, 2] + turn
        chord = part * path.ds[run] * np.sinc(turn / (2 * np.pi))
        mid = begin[:, 2] + 0.5 * turn
        x = begin[:, 0] + lever * (np.cos(begin[:, 2]) - np.cos(yaw)) + chord * np.cos(mid)
        y = begin[:, 1] + lever * (np.sin(begin[:, 2]) - np.sin(yaw)) + chord * np.sin(mid)
        return np.column_stack([x, y, yaw])


class Sampled(NamedTuple):
    """A trajectory and the run that each of its samples lies on."""

    trajectory: Trajectory
    run: NDArray[np.int_]


def times(cell: FloatArray, rate: FloatArray) -> FloatArray:
    """Time that each cell takes at given rates at the points [s]."""
    whole = rate[1:] + rate[:-1]
    return np.divide(2 * cell, whole, out=np.zeros_like(whole), where=cell > 0)


def _rounding(length: FloatArray, bend: FloatArray, tolerance: float) -> FloatArray:
    """Return how far corners may be rounded to either side [m], shape (n - 1,).

    At most half of either run, and not so far that the robot leaves the path by more than
    `tolerance` [m]: while the curvature changes evenly over twice the distance w in place of
    jumping by k, the way is offset by k w^2 / 6.
    """
    half = 0.5 * np.minimum(length[:-1], length[1:])
    jump = np.abs(np.diff(bend))
    wide = np.sqrt(np.divide(6 * tolerance, jump, out=np.full_like(jump, np.inf), where=jump > 0))
    reach = np.minimum(half, wide)
    # What is left of a run is nothing or some of it: rounding would show in the speeds on less.
    left = length - np.append(0.0, reach) - np.append(reach, 0.0)
    narrow = (left > 0) & (left < 1e-3 * length)
    return np.where(narrow[1:] | narrow[:-1], 0.999 * reach, reach)


def _closer(cell: float, gather: float) -> FloatArray:
    """Return distances from a stop within the first cell, each four times the one before [m]."""
    count = int(np.clip(np.ceil(np.log(4.0 * cell / gather) / np.log(4.0)), 0, 12))
    return np.asarray(cell * 0.25 ** np.arange(count, 0, -1.0))


def _subdivided(low: float, high: float, step: float, least: int) -> FloatArray:
    """Return points from `low` to `high`, spaced by at most `step`; one where they are the same."""
    if high - low <= ROUNDING * max(abs(high), ROUNDING):
        return np.array([0.5 * (low + high)])
    parts = max(int(np.ceil((high - low) / step - ROUNDING)), least)
    return np.linspace(low, high, parts + 1)
