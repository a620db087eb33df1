"""What a robot does on a mission, and where it charges; checks of what a mission is built from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError, MissionError
from energyplan.kinds import check_fields
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


LONGEST = 1e8
"""Longest time that a task may take [s]: three years."""

LARGEST = 1e12
"""Largest instant [s], power [W] or prize of a task."""


@dataclass(frozen=True)
class Task:
    """Something to be done at a place.

    Parameters
    ----------
    name : str
        Name, unique in the mission.
    pose : Pose
        Where it is done.
    dwell : float
        How long it takes there [s].
    power : float
        Power of the tool meanwhile [W].
    payload : float
        What is taken on board (positive) or left behind (negative) when it is done [kg].
    prize : float
        What it is worth, where not all tasks fit.
    required : bool
        Whether the mission fails without it.
    window : tuple of float
        Earliest and latest time at which it may begin [s].
    power_spread, dwell_spread : float, optional
        Standard deviations of the tool's power [W] and of the duration [s]; those of
        `Mission.spreads` where not given. Tasks with the same power and spread share a tool.

    Raises
    ------
    MissionError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> Task("wash the hall", (4.0, 2.0, 0.0), dwell=600.0, power=300.0).required
    True
    """

    name: str
    pose: Pose
    dwell: float = 0.0
    power: float = 0.0
    payload: float = 0.0
    prize: float = 1.0
    required: bool = True
    window: tuple[float, float] = (0.0, np.inf)
    power_spread: float | None = None
    dwell_spread: float | None = None

    def __post_init__(self) -> None:
        label = f"task {self.name!r}"
        require(self.name, "a task has no name; give each its own", "name")
        check_fields(self, MissionError, f"{label}: ")
        object.__setattr__(self, "pose", checked_pose(self.pose, label, "pose"))
        for key in ("dwell", "power", "prize", "power_spread", "dwell_spread"):
            value = getattr(self, key)
            unset = value is None and key.endswith("_spread")
            most = LONGEST if key.startswith("dwell") else LARGEST
            require(
                unset or 0 <= value <= most, f"{label}: {key} is {value}; give 0 to {most:g}", key
            )
        require(np.isfinite(self.payload), f"{label}: payload is {self.payload}", "payload")
        require(
            len(self.window) == 2
            and 0 <= self.window[0] <= self.window[1]
            and self.window[0] <= LARGEST,
            f"{label}: the window {self.window} is empty; give earliest and latest start [s]",
            "window",
        )


@dataclass(frozen=True)
class Charger:
    """A place where the battery is charged.

    Parameters
    ----------
    name : str
        Name, unique in the mission.
    pose : Pose
        Where the robot docks.
    power : float
        Power at the battery's terminals [W].
    until : float
        State of charge at which the robot leaves.

    Raises
    ------
    MissionError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> Charger("dock", (1.0, 2.0, 0.0), power=240.0).until
    0.95
    """

    name: str
    pose: Pose
    power: float
    until: float = 0.95

    def __post_init__(self) -> None:
        label = f"charger {self.name!r}"
        require(self.name, "a charger has no name; give each its own", "name")
        check_fields(self, MissionError, f"{label}: ")
        object.__setattr__(self, "pose", checked_pose(self.pose, label, "pose"))
        require(
            0 < self.power <= LARGEST,
            f"{label}: power is {self.power}; give watts > 0, up to {LARGEST:g}",
            "power",
        )
        require(
            0 < self.until <= 1,
            f"{label}: until is {self.until}; give a state of charge in (0, 1]",
            "until",
        )
