"""What a mission is built from: tasks, chargers, usual errors of plain numbers, and remedies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial, wraps
from math import inf, isfinite, sqrt
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, dataclass_transform

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, ConfigDict, PlainValidator, ValidationError, ValidationInfo
from pydantic_core import ArgsKwargs

from energyplan.errors import InvalidInputError, MissionError
from energyplan.kinds import amount, described
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


# -- what a file, a request and Python may give ---------------------------------------------------

Record = TypeVar("Record")


def amount_of(kind: str) -> BeforeValidator:
    """Read a number that may carry a unit of a kind."""
    return BeforeValidator(partial(amount, kind))


Number = Annotated[float, amount_of("number")]
Time = Annotated[float, amount_of("time")]
Power = Annotated[float, amount_of("power")]
Mass = Annotated[float, amount_of("mass")]
Fraction = Annotated[float, amount_of("fraction")]


class Uncertain(NamedTuple):
    """A number, and its standard deviation if it has one."""

    value: float
    spread: float | None = None


def uncertain(kind: str, value: Any) -> Uncertain:
    """Read a number, or a distribution: ``{mean, std}``, or ``{low, high}`` for a uniform one."""
    if not isinstance(value, dict):
        number = amount(kind, value)
        if not isinstance(number, int | float):
            raise ValueError("give a number, {mean: ..., std: ...} or {low: ..., high: ...}")
        return Uncertain(float(number))
    parts = {key: uncertain(kind, part).value for key, part in value.items()}
    if parts.keys() == {"mean", "std"}:
        found = Uncertain(parts["mean"], parts["std"])
    elif parts.keys() == {"low", "high"}:
        low, high = parts["low"], parts["high"]
        found = Uncertain(0.5 * (low + high), (high - low) / sqrt(12.0))
    else:
        keys = ", ".join(map(str, value))
        raise ValueError(f"a distribution has mean and std, or low and high, not {keys}")
    if not (isfinite(found.value) and isfinite(found.spread or 0.0)) or (found.spread or 0.0) < 0:
        raise ValueError(f"the distribution {value} has no mean or a negative spread")
    return found


def _pose(value: Any, info: ValidationInfo) -> Pose:
    """Read a pose: numbers, ``x,y,90deg``, or the name of one of the places of a mission."""
    places: Mapping[str, Any] = (info.context or {}).get("places", {})
    if isinstance(value, str) and "," not in value:
        if value not in places:
            known = ", ".join(sorted(places)) or "none"
            raise ValueError(f"there is no place {value!r}; the places are {known}")
        value = places[value]
    if isinstance(value, str):
        value = value.split(",")
    if isinstance(value, list) and any(isinstance(part, str) for part in value):
        try:
            if len(value) != 3:
                raise ValueError(f"{len(value)} numbers")
            value = float(value[0]), float(value[1]), float(amount("angle", value[2]))
        except ValueError as problem:
            raise ValueError(
                f"{value} is no pose ({problem}); give x, y [m] and yaw [rad] or as 90deg"
            ) from None
    return as_pose(value, "the pose")


Place = Annotated[Pose, PlainValidator(_pose)]


@dataclass_transform(frozen_default=True)
def record(cls: type[Record]) -> type[Record]:
    """Make a class a frozen dataclass that is checked alike from a file, a request and Python."""
    made: Any = pydantic.dataclasses.dataclass(frozen=True, config=ConfigDict(extra="forbid"))(cls)
    build = made.__init__

    @wraps(build)
    def checked(self: Any, *values: Any, **named: Any) -> None:
        try:
            build(self, *values, **named)
        except ValidationError as problem:
            first = problem.errors(include_url=False)[0]
            if isinstance(own := first.get("ctx", {}).get("error"), MissionError):
                raise own from None
            names = [one.name for one in fields(made)]
            place = tuple(names[part] if isinstance(part, int) else part for part in first["loc"])
            message = first["msg"].removeprefix("Value error, ")
            value = ".".join(map(str, place))
            if first["type"] != "missing":
                value += f" is {described(first['input'])}"
            raise MissionError(f"{cls.__name__.lower()}: {value}: {message}", place) from None

    made.__init__ = checked
    return made  # type: ignore[no-any-return]


LONGEST = 1e8
"""Longest time that a task may take [s]: three years."""

LARGEST = 1e12
"""Largest instant [s], power [W] or prize of a task."""


@record
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
    pose: Place
    dwell: Time = 0.0
    power: Power = 0.0
    payload: Mass = 0.0
    prize: Number = 1.0
    required: bool = True
    window: tuple[Time, Time] = (0.0, inf)
    power_spread: Power | None = None
    dwell_spread: Time | None = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _distributions(cls, given: Any) -> Any:
        """Part what is given as a distribution into its mean and its standard deviation."""
        if not isinstance(given, dict | ArgsKwargs):
            return given  # pydantic refuses it by its kind
        values = given if isinstance(given, dict) else dict(given.kwargs or {})
        for key, kind in (("dwell", "time"), ("power", "power")):
            if isinstance(values.get(key), dict | list):
                try:
                    value, spread = uncertain(kind, values[key])
                except ValueError as problem:
                    raise MissionError(f"{key}: {problem}", (key,)) from None
                values = {**values, key: value, f"{key}_spread": spread}
        return values if isinstance(given, dict) else ArgsKwargs(given.args, values)

    def __post_init__(self) -> None:
        label = f"task {self.name!r}"
        require(self.name, "a task has no name; give each its own", "name")
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


@record
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
    pose: Place
    power: Power
    until: Fraction = 0.95

    def __post_init__(self) -> None:
        label = f"charger {self.name!r}"
        require(self.name, "a charger has no name; give each its own", "name")
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


@record
class Spreads:
    """Standard deviations of what a mission takes as a number.

    The defaults are round figures for robots that nobody has measured; what is known better is
    better said. A battery that is not a `Battery` has no health and no temperature of its own:
    all its uncertainty counts as that of the capacity.
    """

    soc: Fraction = 0.02
    capacity: Fraction = 0.025  # capacity of the battery, relative
    health: Fraction = 0.05  # health of the battery, absolute
    temperature: Number = 3.0  # temperature of the battery [K]
    power: Fraction = 0.1  # power of each tool, relative
    dwell: Fraction = 0.1  # duration of each task, relative
    run: Fraction = USUAL_RUN_SPREAD
    speed: Fraction = 0.05  # time of all driving from run to run, relative
    waiting: Fraction = 1.0  # waiting at each task, relative

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
