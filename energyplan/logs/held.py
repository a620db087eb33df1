"""Powers that are read more seldom than the rows of a log come, and held in between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from energyplan.path import FloatArray

POWERS = ("p_left", "p_right", "power", "current")
"""Channels of what is drawn."""
_READINGS = 8  # in driving, below which nothing is concluded
_ROWS = 3  # that a reading is held for at least
_REGULAR = 0.9  # share of readings that come with the clock
_CHANGING = 0.1  # share of the rows in driving in which speeds change


def held_periods(channels: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return the powers that are held, and the time after which they are read again [s].

    Held readings change with a clock. Those that are steady, or have few digits, do not.
    """
    t, effort = channels["t"], np.abs(channels["v_left"]) + np.abs(channels["v_right"])
    moving = effort > 0.15 * float(np.quantile(effort, 0.95))
    changing = np.append(False, np.diff(effort) != 0.0)
    found = {}
    for name in (name for name in POWERS if name in channels):
        starts = np.flatnonzero(np.append(True, np.diff(channels[name]) != 0.0))
        drives = np.logical_and.reduceat(moving, starts)
        counts, driving = np.diff(starts), drives[:-1] & drives[1:]
        if np.count_nonzero(driving) < _READINGS:
            continue
        usual = float(np.median(counts[driving]))
        rows = np.flatnonzero(np.repeat(driving, counts))
        if usual < _ROWS or np.mean(changing[rows]) < _CHANGING:
            continue
        # A reading that is the one before by chance makes two of one; and one may be a row late.
        times = counts[driving] / usual
        regular = np.abs(times - np.clip(np.round(times), 1, 3)) * usual <= 1.0
        if np.mean(regular) > _REGULAR:
            found[name] = float(np.median(np.diff(t[starts])[driving]))
    return found
