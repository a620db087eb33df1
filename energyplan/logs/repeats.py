"""Logs that hold the same samples."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # which imports a module that imports this one
    from energyplan.logs import DriveLog

_ENOUGH = 20  # samples alike that are none by chance


def find_repeats(logs: Sequence[DriveLog]) -> list[str]:
    """Tell which logs hold samples of each other: such samples count twice.

    Parameters
    ----------
    logs : sequence of DriveLog
        The drives.

    Returns
    -------
    list of str
        What is told.

    Examples
    --------
    >>> from energyplan.logs import DriveLog
    >>> t = np.arange(30.0)
    >>> log = DriveLog({"t": t, "v_left": np.sin(t), "v_right": np.cos(t), "power": t})
    >>> len(find_repeats([log, log])), find_repeats([log, log.segment(0.0, 10.0)])
    (1, [])
    """
    told = []
    for one, other in combinations(logs, 2):
        _, mine, theirs = np.intersect1d(one.t, other.t, assume_unique=True, return_indices=True)
        alike = one.power[mine] == other.power[theirs]
        moving = np.zeros(len(mine), bool)
        for name in ("v_left", "v_right"):
            speed = one.channels[name][mine]
            alike &= speed == other.channels[name][theirs]
            moving |= speed != 0.0
        count = np.count_nonzero(alike & moving)
        if count >= _ENOUGH:
            told.append(
                f"{one.name} and {other.name} hold the same {count} samples, which count twice: "
                "standard errors are too small; give each sample once"
            )
    return told
