"""Checks of what a mission is built from."""

from __future__ import annotations

from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError, MissionError
from energyplan.path import Pose, as_pose


def require(condition: object, message: str, *place: str | int) -> None:
    """Refuse a value that is out of its range; `place` leads to it."""
    if not condition:
        raise MissionError(message, place)


def checked_pose(value: ArrayLike, whose: str, *place: str | int) -> Pose:
    """Return three finite numbers as a pose; `place` leads to it."""
    try:
        return as_pose(value, f"{whose}: the pose")
    except InvalidInputError as error:
        raise MissionError(str(error), place) from None
