"""Clocks of loggers: counters that overflow, and rows that arrive several at once."""

from __future__ import annotations

import numpy as np

from energyplan.path import FloatArray

_FEWEST = 20  # bursts below which nothing is concluded
_ROWS = 3  # of a burst, at least
_APART = 10.0  # times the usual step, from which on a step is one between bursts
_REGULAR = 0.9  # share of bursts that come with the clock
_CHANGING = 0.6  # share of the steps within bursts in which readings change
_ALIKE = 3.0  # times a change within a burst that one between bursts is at most
_ROUNDS = tuple(2.0**bits * unit for bits in (16, 31, 32) for unit in (1.0, 1e-3, 1e-6))
"""Times after which counters of seconds, their thousandths or millionths overflow [s]."""
_NEAR = 10.0  # usual steps within which a counter that overflowed goes on


def unwrap_clock(t: FloatArray) -> FloatArray | None:
    """Return the times of a counter that overflowed and went on from zero."""
    steps = np.diff(t)
    back = steps < 0.0
    usual = float(np.median(steps))
    for whole in _ROUNDS:
        over = steps[back] + whole
        if np.any(back) and np.all((over > 0.0) & (over <= _NEAR * usual)):
            return np.asarray(t + whole * np.append(0.0, np.cumsum(back)))
    return None


def spread_bursts(t: FloatArray, readings: FloatArray) -> FloatArray | None:
    """Return the times of rows that were buffered, and written several at once.

    Such rows are readings of a steady rate: they change from row to row as they do from burst to
    burst. Bursts of a quick sensor that sleeps in between change far more from one to the next, and
    rows for each message repeat what others brought.
    """
    steps = np.diff(t)
    if len(t) < _ROWS * _FEWEST:
        return None
    between = steps > _APART * float(np.median(steps))
    starts = np.append(0, np.flatnonzero(between) + 1)
    sizes = np.diff(np.append(starts, len(t)))
    if len(starts) < _FEWEST or np.median(sizes) < _ROWS:
        return None
    ends = t[starts + sizes - 1]
    usual = float(np.median(np.diff(ends)))
    waits = np.append(usual, np.diff(ends))
    if np.mean(np.abs(waits - usual) < 0.5 * usual) < _REGULAR:
        return None
    changes = np.abs(np.diff(readings, axis=1))
    if np.mean(np.any(changes[:, ~between] > 0.0, axis=0)) < _CHANGING:
        return None
    sizes_of = [np.sqrt(np.mean(changes[:, some] ** 2)) for some in (between, ~between)]
    if sizes_of[0] > _ALIKE * sizes_of[1]:
        return None
    behind = np.repeat(starts + sizes - 1, sizes) - np.arange(len(t))
    return np.asarray(
        np.repeat(ends, sizes) - behind * np.repeat(np.minimum(waits, 1.5 * usual) / sizes, sizes)
    )
