"""What a mission is built from: tasks, chargers, usual errors of plain numbers, and remedies."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError, MissionError
from energyplan.kinds import check_fields
from energyplan.path import Pose, as_pose
from energyplan.power import USUAL_RUN_SPREAD

RemedyKind = Literal[
    "charge", "capacity", "strings", "reserve", "speed", "cheapest_speed", "window", "drop"
]  # fmt: skip

_SENTENCES: dict[RemedyKind, str] = {
    "charge": "charge to {percent:.0f} % before leaving",
    "capacity": "a battery with {hours:.0f} Wh more",
    "strings": "a battery with {amount:.4g} times the strings in parallel, or cells of so much "
    "more power",
    "reserve": "a reserve of {percent:.3g} %",
    "speed": "drive at up to {amount:.3g} m/s",
    "cheapest_speed": "drive at the speed of least energy",
    "window": "let it begin {amount:.0f} s later",
    "drop": "drop {task!r}",
}


@dataclass(frozen=True)
class Remedy:
    """A change of a mission that makes a task reachable; `Mission.with_remedy` applies it."""

    kind: RemedyKind  # what to change
    amount: float | None = None  # how much, in `unit`
    unit: str = ""  # unit of the amount
    task: str = ""  # the task that is changed or dropped

    def __str__(self) -> str:
        amount = 0.0 if self.amount is None else self.amount
        return _SENTENCES[self.kind].format(
            amount=amount, percent=100 * amount, hours=amount / 3600, task=self.task
        )


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


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of what a mission takes as a number.

    The defaults are round figures for robots that nobody has measured; what is known better is
    better said. A battery that is not a `Battery` has no health and no temperature of its own:
    all its uncertainty counts as that of the capacity.
    """

    soc: float = 0.02
    capacity: float = 0.025  # capacity of the battery, relative
    health: float = 0.05  # health of the battery, absolute
    temperature: float = 3.0  # temperature of the battery [K]
    power: float = 0.1  # power of each tool, relative
    dwell: float = 0.1  # duration of each task, relative
    run: float = USUAL_RUN_SPREAD
    speed: float = 0.05  # time of all driving from run to run, relative
    waiting: float = 1.0  # waiting at each task, relative

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            require(
                np.isfinite(value) and value >= 0,
                f"the spread of {item.name} is {value}; give 0 or more",
                "spreads", item.name,
            )  # fmt: skip

    @classmethod
    def none(cls) -> Spreads:
        """Return spreads for numbers that are exact."""
        return cls(**dict.fromkeys((item.name for item in fields(cls)), 0.0))
