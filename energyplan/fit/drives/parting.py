"""Drives parted into what to learn from and what to judge by."""

from __future__ import annotations

import math
from collections.abc import Sequence

from energyplan.errors import InvalidInputError
from energyplan.fit.drives.drive import check_long_enough
from energyplan.fit.drives.windows import BLOCK
from energyplan.kinds import checked
from energyplan.logs import DriveLog

_JUDGED = 0.4
"""Share of the driving that is judged by."""

_CUT = 2.0 * BLOCK / _JUDGED
"""Length from which a drive is cut [s]: both parts are then long enough by themselves."""


@checked()
def split_drives(drives: Sequence[DriveLog]) -> tuple[list[DriveLog], list[DriveLog]]:
    """Part drives into what to learn from and, two fifths of the time, what to judge by.

    A drive is cut in two where both parts are long enough, or where there is no other one; else it
    goes as a whole to where the share of time comes nearer to that. ``energyplan diagnose`` does so
    where it is given no drives to judge by.
    """
    if not drives:
        raise InvalidInputError("no logs; give at least one drive")
    learned: list[DriveLog] = []
    judged: list[DriveLog] = []
    for drive in drives:
        if drive.duration >= _CUT or len(drives) == 1:
            cut = float(drive.t[0] + (1.0 - _JUDGED) * (drive.t[-1] - drive.t[0]))
            learned.append(drive.segment(float(drive.t[0]), cut))
            judged.append(drive.segment(cut, math.nextafter(float(drive.t[-1]), math.inf)))
        else:
            total = _seconds([*learned, *judged, drive])
            nearer = _seconds(judged) + 0.5 * drive.duration < _JUDGED * total
            (judged if nearer else learned).append(drive)
    check_long_enough(learned, judged)
    return learned, judged


def _seconds(drives: Sequence[DriveLog]) -> float:
    return sum(drive.duration for drive in drives)
