"""Checks of what a mission is built from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from energyplan.errors import MissionError
from energyplan.path import Pose


def require(condition: object, message: str, *place: str | int) -> None:
    """Refuse a value that is out of its range; `place` leads to it."""
    if not condition:
        raise MissionError(message, place)


def checked_pose(value: Iterable[float], whose: str, *place: str | int) -> Pose:
    """Return three finite numbers as a pose."""
    row = np.asarray(list(value), float)
    require(
        row.shape == (3,) and bool(np.all(np.isfinite(row))),
        f"{whose}: the pose is {row.tolist()}; give x, y [m] and yaw [rad], all finite",
        *place,
    )
    return Pose(*(float(v) for v in row))
