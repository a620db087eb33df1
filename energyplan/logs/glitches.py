"""Readings of a log that stand out for a moment, as nothing that a robot does."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from energyplan.path import FloatArray

_STANDS_OUT = {
    **dict.fromkeys(("v_left", "v_right"), (3.0, 0.0)),
    **dict.fromkeys(("p_left", "p_right", "power", "current"), (8.0, 0.0)),
    "yaw_rate": (8.0, 3.0),  # [rad/s]
}
"""By how much a glitch stands out, and how large it is, by channel.

In units of what the channel holds for three readings. Of some 120 real drives and drives of a
physics engine, also at one reading in two seconds, speeds stood out by 1.6 at most, powers by 3.2.
"""
_FEW = 0.05  # share of readings that glitches may have
_ENOUGH = 20  # readings below which nothing is concluded


def find_glitches(channel: str, values: FloatArray) -> NDArray[np.bool_]:
    """Tell which readings stand out from those around as nothing that lasts does.

    A glitch lasts one reading or two, so a median over five does not show it.
    """
    lost = np.zeros(len(values), bool)
    known = np.flatnonzero(np.isfinite(values))
    if channel not in _STANDS_OUT or len(known) < _ENOUGH:
        return lost
    factor, least = _STANDS_OUT[channel]
    readings = values[known]
    lasting = np.median(sliding_window_view(np.pad(readings, 2, mode="reflect"), 5), axis=-1)
    usual = float(np.quantile(np.abs(lasting), 0.99))
    apart = (np.abs(readings - lasting) > factor * usual) & (np.abs(readings) > least)
    if usual > 0.0 and np.mean(apart) <= _FEW:
        lost[known[apart]] = True
    return lost
