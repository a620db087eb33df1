"""From where, and which way, a heading counts, by a pose of east and north."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.logs.align import Series, align, integral, usable
from energyplan.path import FloatArray

CHANCE = 4.0  # standard errors beyond which an effect is none by chance
_WINDOWS = 400  # stretches that are compared, at most
_BLOCKS = 20  # parts of the drive that are taken for independent of each other
_STEPS = 3  # readings of the slowest sensor in a stretch, at least


class Recorded(NamedTuple):
    """What shows how a robot moves, each on a clock of its own."""

    left: Series  # speeds, in any unit
    right: Series
    east: Series
    north: Series
    yaw: Series  # heading [rad], unwrapped


def counts_from_north(motion: Recorded) -> bool | None:
    """Return whether a heading counts clockwise from the north; None where nothing shows it.

    The robot goes where it heads: dead reckoning by the wheels' speed and the heading, read in
    both ways, is compared with the pose over stretches of time. One of them must explain the pose
    better than the other by more than `CHANCE` standard errors, which hold the noise of the drive
    itself. Which side of the robot is which does not matter to this. Where the robot goes hardly
    anywhere, or along one line, the turning of the wheels decides, by the same bound.
    """
    left, right, east, north, yaw = map(usable, motion)
    if min(map(len, (left.t, right.t, east.t, north.t, yaw.t))) < _BLOCKS:
        return None
    t = left.t
    other, angle = (align(one, t).values for one in (right, yaw))
    known = np.isfinite(other) & np.isfinite(angle)
    start = max(one.t[0] for one in (left, right, east, north, yaw))
    end = min(one.t[-1] for one in (left, right, east, north, yaw))
    step = max(float(np.median(np.diff(one.t))) for one in (left, right, east, north, yaw))
    count = int(min(_WINDOWS, (end - start) / (_STEPS * step)))
    if count < 2 * _BLOCKS:
        return None
    edges = np.linspace(start, end, count + 1)
    block = np.arange(count) * _BLOCKS // count
    lost = np.diff(np.interp(edges, t, integral(t, np.where(known, 0.0, 1.0))))
    whole = lost < 0.5 * (edges[1] - edges[0])

    def over(rate: FloatArray) -> FloatArray:
        gone = np.interp(edges, t, integral(t, np.where(known, rate, 0.0)))
        return np.asarray(np.diff(gone)[whole])

    moved = np.concatenate([np.diff(np.interp(edges, *one))[whole] for one in (east, north)])
    twice = np.tile(block[whole], 2)
    fits = []
    for speed in (left.values + other, left.values - other):  # a motor may sit in the mirror
        along, across = over(speed * np.cos(angle)), over(speed * np.sin(angle))
        ways = np.concatenate([along, across]), np.concatenate([across, along])
        fits.append(_fit(np.stack(ways, axis=1), moved, twice))
    best = min(fits, key=lambda one: one.rest)
    by_pose = best.apart(np.array([-1.0, 1.0]) * np.sign(best.values))
    if abs(by_pose) > CHANCE:
        return by_pose > 0.0
    rotation = np.diff(np.interp(edges, *yaw))[whole]
    treads = _fit(over(other - left.values)[:, None], rotation, block[whole])
    by_turning = treads.apart(np.ones(1))
    return by_turning < 0.0 if abs(by_turning) > CHANCE else None


class _LeastSquares(NamedTuple):
    values: FloatArray  # (k,): factors of the columns
    covariance: FloatArray  # (k, k): theirs, of blocks that are independent
    rest: float  # sum of the squares that are left

    def apart(self, weights: FloatArray) -> float:
        """Return how far a sum of the factors is from 0, in its standard errors."""
        error = float(np.sqrt(max(float(weights @ self.covariance @ weights), 0.0)))
        value = float(weights @ self.values)
        return value / error if error > 0.0 else 0.0


def _fit(columns: FloatArray, y: FloatArray, block: NDArray[np.intp]) -> _LeastSquares:
    """Fit columns to readings by least squares; whole blocks of readings may share an error."""
    size = columns.shape[1]
    gram = columns.T @ columns
    if not np.all(np.diag(gram) > 0.0) or np.linalg.cond(gram) > 1e10:
        return _LeastSquares(np.zeros(size), np.zeros((size, size)), float(y @ y))
    inverse = np.linalg.inv(gram)
    values = inverse @ (columns.T @ y)
    rest = y - columns @ values
    scores = np.stack([
        np.bincount(block, column * rest, _BLOCKS) for column in columns.T
    ])  # fmt: skip
    covariance = inverse @ (scores @ scores.T) @ inverse * _BLOCKS / (_BLOCKS - 1)
    # Readings without any noise are exact to rounding.
    floor = (1e-12 * float(y @ y) / len(y)) * inverse
    return _LeastSquares(values, covariance + floor, float(rest @ rest))
