"""Powers that are read more seldom than rows come: what their readings show of the time between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from energyplan.logs.checks import POWERS, held_periods
from energyplan.motion import Motion
from energyplan.path import FloatArray

_TOGETHER = 0.9  # share of the readings that either side takes part in
_DELAYS = 5  # delays up to a period that are tried for either kind of sensor
_EACH = 4.0  # readings for each coefficient that the kinds are compared by


@dataclass(frozen=True)
class Hold:
    """Readings that stand in several rows each."""

    starts: NDArray[np.intp]  # (n,): row in which each row's reading stands first
    rows: int  # rows from one reading to the next
    mean: bool = False

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """Rows in which a reading stands first."""
        return np.unique(self.starts)

    def shown(self, power: FloatArray) -> FloatArray:
        """Return a power, shape (n, ...), as the readings show it."""
        if not self.mean:
            return np.asarray(power[self.starts])
        first = self.first
        total = np.concatenate([0.0 * power[:1], np.cumsum(power, axis=0)])
        last = np.maximum(first, 1)
        low = np.maximum(last - self.rows, 0)
        width = (last - low).reshape(-1, *[1] * (power.ndim - 1))
        means = (total[last] - total[low]) / width
        return np.asarray(means[np.searchsorted(first, self.starts)])

    def some(self, rows: NDArray[np.intp]) -> Hold | None:
        """Return the readings in some of the rows; None where each row is then a reading."""
        step = float(np.median(np.diff(rows)))
        if self.rows <= step:
            return None
        starts = np.searchsorted(rows, self.starts[rows])
        return replace(self, starts=starts, rows=max(round(self.rows / step), 1))


def find_hold(channels: Mapping[str, FloatArray], motion: Motion, power: FloatArray) -> Hold | None:
    """Find the readings of a power that stand in several rows each, and which kind they are.

    Of a sample and of a mean the one is taken that the motion explains better, at whatever delay of
    up to a period it does so best.
    """
    there = [name for name in POWERS if name in channels]
    sides = [name for name in there if name.startswith("p_")]
    used = sides if len(sides) == 2 else [name for name in there if name not in sides][:1]
    if not used or not set(used) <= set(held_periods(channels)):
        return None
    changes = [np.diff(channels[name]) != 0.0 for name in used]
    fresh = np.append(True, np.any(changes, axis=0))
    first = np.flatnonzero(fresh)
    if _TOGETHER * len(first) > min(np.count_nonzero(one) for one in changes):
        return None
    starts = np.maximum.accumulate(np.where(fresh, np.arange(len(power)), 0))
    v = np.abs(motion.v_left) + np.abs(motion.v_right)
    driven = np.logical_and.reduceat(v > 0.0, first)[:-1]
    rows = int(np.median(np.diff(first)[driven] if np.any(driven) else np.diff(first)))
    sampled = Hold(starts, rows)
    turn = np.abs(motion.v_right - motion.v_left)
    X = np.stack([v, turn, motion.channels["accel"] * motion.v, np.ones(len(v))], axis=1)
    if len(first) < _EACH * X.shape[1]:
        return sampled
    kinds = (sampled, replace(sampled, mean=True))
    return min(kinds, key=lambda kind: _unexplained(kind, X, power))


def _unexplained(kind: Hold, X: FloatArray, power: FloatArray) -> float:
    """Return the sum of squares that columns leave of the readings, at the best delay [W^2]."""
    found, first = [], kind.first
    for late in np.unique(np.linspace(0, kind.rows, _DELAYS).astype(int)):
        at = np.maximum(np.arange(len(X)) - late, 0)
        columns = kind.shown(X[at])[first]
        rest = power[first] - columns @ np.linalg.lstsq(columns, power[first], rcond=None)[0]
        found.append(float(rest @ rest))
    return min(found)
