"""A mission: tasks to do with one battery, checked where it is built."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from math import inf, isfinite, sqrt
from types import MappingProxyType, NoneType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, PlainValidator, ValidationInfo
from pydantic_core import ArgsKwargs

from energyplan import html
from energyplan.battery import PERCENT, Battery, BatteryModel, Temperature
from energyplan.cost.speeds import tread_speed
from energyplan.errors import InvalidInputError, MissionError, PathError
from energyplan.mission._order_kernel import GRAM
from energyplan.path import PLACE, FloatArray, Path, Pose, as_pose, parse_pose, wrap_angle
from energyplan.planning.goal import Goal, as_goals, only_pose
from energyplan.planning.problem import free_beside, where_free
from energyplan.power import USUAL_RUN_SPREAD, PowerModel
from energyplan.power.effects import reads_slope
from energyplan.records import (
    NO_NUMBER,
    Fraction,
    Length,
    Mass,
    Number,
    Power,
    ReadOnly,
    Time,
    Within,
    amount,
    amount_of,
    checked,
    described,
    doubts_of,
    in_words,
    instance_of,
    record,
)
from energyplan.terrain import (
    CLEARANCE,
    HeightMap,
    OccupancyGrid,
    Site,
    SurfaceMap,
    knows_ground,
    laid_out,
    on_laid_ground,
)
from energyplan.vehicle import Vehicle

RemedyKind = Literal["temperature", "charge", "capacity", "reserve", "speed", "window", "drop"]


@dataclass(frozen=True)
class Remedy:
    """A change that makes a task reachable or a mission shorter; see `Mission.with_remedy`."""

    kind: RemedyKind  # what to change
    # how much, in `unit`: of the battery an energy more, or a factor of its strings; None of a
    # speed stands for that of least energy
    amount: float | None = None
    unit: str = ""  # unit of the amount
    task: str = ""  # the task that is changed or dropped
    where: Literal["start", "chargers"] = "start"  # to charge so far

    def __str__(self) -> str:
        amount = 0.0 if self.amount is None else self.amount
        percent = f"{html.number(100 * amount, 3)} %"
        if self.kind == "temperature":
            return f"charge at a battery temperature of {amount:g} degC"
        if self.kind == "charge":
            start = f"charge to {percent} before leaving"
            return start if self.where == "start" else f"leave the chargers at {percent}"
        if self.kind == "capacity":
            more = f"{amount:.4g} times the strings in parallel, or cells of so much more power"
            return f"a battery with {more if self.unit == '1' else f'{amount / 3600:.0f} Wh more'}"
        if self.kind == "reserve":
            return f"a reserve of {percent}"
        if self.kind == "speed":
            least = self.amount is None
            return f"drive at {'the speed of least energy' if least else f'up to {amount:.3g} m/s'}"
        if self.kind == "window":
            return f"let it begin {amount:.0f} s later"
        return f"drop {self.task!r}"


def require(condition: object, message: str, *place: str | int) -> None:
    """Refuse a value that is out of its range; `place` leads to it."""
    if not condition:
        raise MissionError(message, place)


# -- what a file, a request and Python may give ---------------------------------------------------


def uncertain(kind: str, value: Any) -> tuple[float, float | None]:
    """Read a number, ``{mean, std}`` or a uniform ``{low, high}``, as mean and deviation."""
    if not isinstance(value, dict):
        try:
            return float(amount(kind, value)), None
        except (TypeError, OverflowError):
            message = "give a number, {mean: ..., std: ...} or {low: ..., high: ...}"
            raise ValueError(message) from None
    parts = {key: uncertain(kind, part)[0] for key, part in value.items()}
    if parts.keys() == {"mean", "std"}:
        mean, spread = parts["mean"], parts["std"]
    elif parts.keys() == {"low", "high"}:
        low, high = parts["low"], parts["high"]
        mean, spread = 0.5 * (low + high), (high - low) / sqrt(12.0)
    else:
        keys = ", ".join(map(str, value))
        raise ValueError(f"a distribution has mean and std, or low and high, not {keys}")
    if not (isfinite(mean) and isfinite(spread)) or spread < 0:
        raise ValueError(f"the distribution {value} has no mean or a negative spread")
    return mean, spread


def _part(values: dict[str, Any], key: str, kind: str, *place: str) -> float | None:
    """Put the mean of a distribution in its place; return its standard deviation."""
    if not isinstance(values.get(key), dict | list):
        return None
    try:
        values[key], spread = uncertain(kind, values[key])
    except ValueError as problem:
        raise MissionError(f"{key}: {problem}", (*place, key)) from None
    return spread


def _pose(value: Any, info: ValidationInfo) -> Pose:
    """Read a pose: numbers, ``x,y,90deg``, or the name of one of the places of a mission."""
    places: Mapping[str, Any] = (info.context or {}).get("places", {})
    if isinstance(value, str) and "," not in value:
        if value not in places:
            known = ", ".join(sorted(places)) or "none"
            raise ValueError(f"there is no place {value!r}; the places are {known}")
        value, name = places[value], value
        if isinstance(value, Goal):
            raise ValueError(f"the place {name!r} has no yaw; write it as [x, y, yaw]")
    if isinstance(value, str) or (
        isinstance(value, list) and any(isinstance(part, str) for part in value)
    ):
        return parse_pose(value)
    return as_pose(value, "the pose")


Place = Annotated[Pose, PlainValidator(_pose)]


def _named(value: Any, info: ValidationInfo) -> Pose | Goal:
    """Read what a name stands for: a pose, or a place at any heading."""
    try:
        (goal,) = as_goals(value)
    except ValueError:
        return _pose(value, info)
    return goal.pose or goal


NamedPlace = Annotated[Any, PlainValidator(_named)]


def _goals(value: Any, info: ValidationInfo, heading: str, radius: float) -> tuple[Goal, ...]:
    """Read where a task may be done: what `_pose` reads, a place, a `Goal`, or a list of these."""
    places: Mapping[str, Any] = (info.context or {}).get("places", {})

    def placed(one: Any) -> Any:
        return places.get(one, one) if isinstance(one, str) else one

    found = [placed(one) for one in value] if isinstance(value, list) else placed(value)
    return as_goals(found, heading, radius)


_HEADINGS, _AROUND = 16, 8  # poses of a goal that are tried until one is free, on circles more
Row = tuple[float, ...]
"""A point of a path: x, y [m], and where all have one the yaw [rad]."""


def _points(value: Any, info: ValidationInfo) -> tuple[Row, ...]:
    """Read a path: points x, y, or poses, or the names of places."""
    words = "a list of points [x, y], or of poses [x, y, yaw]"
    if isinstance(value, tuple) and not value:
        return ()  # none
    if isinstance(value, str) or not hasattr(value, "__len__"):
        raise ValueError(f"a path is {described(value)}; give {words}")
    rows: list[Row] = []
    for k, one in enumerate(value):
        if isinstance(one, str):
            rows.append(_pose(one, info))
            continue
        if not hasattr(one, "__len__") or len(one) not in (2, 3):
            raise ValueError(f"point {k + 1} is {described(one)}; give {words}")
        try:
            rows.append(as_pose([*one, 0.0], "it")[:2] if len(one) == 2 else _pose(one, info))
        except ValueError as problem:
            raise ValueError(f"point {k + 1}: {problem}") from None
    if len(rows) < 2 or len(rows) > _MOST_POINTS:
        raise ValueError(f"a path of {len(rows)} points; give {words}, 2 to {_MOST_POINTS}")
    if len({len(row) for row in rows}) > 1:
        raise ValueError("some points have a yaw and some have none; give it for all, or for none")
    for k, (one, other) in enumerate(pairwise(rows), 1):
        if one[-1] == other[-1] and np.hypot(one[0] - other[0], one[1] - other[1]) < PLACE:
            raise ValueError(f"points {k} and {k + 1} are the same; leave one out")
    return tuple(rows)


class Option(NamedTuple):
    """One way of doing a task; a search picks one of them."""

    entry: Pose  # where the robot comes to
    exit: Pose  # where it is afterwards
    points: tuple[Row, ...] = ()  # the path that is driven in between; none where it stays

    @classmethod
    def along(cls, points: tuple[Row, ...]) -> Option:
        """Return the option of driving along points or poses."""
        if len(points[0]) == 3:
            return cls(Pose(*points[0]), Pose(*points[-1]), points)
        yaw = _headings(points)
        (x, y), (x_end, y_end) = points[0], points[-1]
        return cls(Pose(x, y, yaw[0]), Pose(x_end, y_end, yaw[-1]), points)

    def path(self, longitudinal: float) -> Path:
        """Return the path that is driven.

        Poses are joined by arcs. Points are joined by straight lines, and at each the robot turns
        on the spot; what follows the lines is the point level with its tread ICRs.
        """
        if len(self.points[0]) == 3:
            return Path.from_poses(self.points, longitudinal)
        yaw = np.unwrap(_headings(self.points))
        ds = np.hypot(*np.diff(np.array(self.points), axis=0).T)
        ds[0] -= longitudinal
        ds[-1] += longitudinal
        moves, turns = np.zeros((2, 2 * len(ds) - 1))
        moves[::2], turns[1::2] = ds, np.diff(yaw)
        return Path(self.entry, moves, turns, longitudinal)


def _headings(points: Sequence[Row]) -> list[float]:
    """Return the headings from each point to the next one [rad]."""
    steps = np.diff(np.array(points)[:, :2], axis=0)
    return [float(yaw) for yaw in np.arctan2(steps[:, 1], steps[:, 0])]


def blocked(grid: OccupancyGrid, vehicle: Vehicle, path: Path) -> str:
    """Return where a robot that drives along a path touches an obstacle; empty where it is free."""
    poses = path.poses(0.5 * grid.resolution, _TURN)
    free = grid.footprint_free(poses, vehicle)
    if np.all(free):
        return ""
    x, y, yaw = poses[int(np.argmin(free))]
    where = f"({x:g}, {y:g}, {np.degrees(yaw):.0f} deg)"
    return f"on its path the robot at {where} touches an obstacle; move the path"


_MOST_POINTS = 10_000  # of a path
_TURN = 0.02  # angle between poses at which a path is tested [rad]
LARGEST = 1e12  # largest instant [s] or prize of a task

Name = Annotated[str, Field(min_length=1)]
Duration = Annotated[Time, Within((0, 1e8), (0, 86400), "s")]
ToolPower = Annotated[Power, Within((0, 1e6), (0, 2e4), "W")]
Speed = Annotated[float, Within((1e-3, 50), (0.05, 15), "m/s")]


def _share(greatest: float, typical: float) -> Within:
    return Within((0, greatest), (0, typical), "", PERCENT)


def _part_goal(values: dict[str, Any], info: ValidationInfo) -> None:
    """Part where a task may be done into one pose of it, and the goals if there is a choice."""
    heading, radius = values.pop("heading", None), values.pop("radius", None)
    if isinstance(values["pose"], Pose) and heading is None and radius is None:
        return  # with the goals that it was chosen from, if any
    try:
        wanted = 0.0 if radius is None else float(amount("length", radius))
        goals = _goals(values["pose"], info, "" if heading is None else str(heading), wanted)
    except (*NO_NUMBER, InvalidInputError):
        if heading is None and radius is None and not isinstance(values["pose"], Goal):
            return  # what is wrong with a pose is said where it is read
        raise
    pose = only_pose(goals)
    if pose is None:
        values["goals"], pose = goals, Pose(goals[0].x, goals[0].y, goals[0].yaw or 0.0)
    values["pose"] = pose


@record(MissionError)
class Task:
    """Something to be done at a place, or along a path.

    Parameters
    ----------
    name : str
        Name, unique in the mission.
    pose : Pose, Goal or a list of these, optional
        Where it is done, as a place ``(x, y)`` at any heading; a task has a pose or a path. Where
        there is a choice, the poses of all tasks are those that cost least together; see `Goal`.
    dwell : float
        How long it takes there [s]; a path takes as long as its drive.
    power : float
        Power of the tool meanwhile [W].
    payload : float
        What is taken on board (positive) or left behind (negative) when it is done [kg].
    prize : float
        Prize for doing it, where not all tasks fit.
    required : bool
        Whether the mission fails without it.
    window : tuple of float
        Earliest and latest time at which it may begin [s].
    power_spread, dwell_spread : float, optional
        Standard deviations of the tool's power [W] and of the duration [s]; those of
        `Mission.spreads` where not given. Tasks with the same power and spread share a tool.
    needs : tuple of str
        Of several robots only those that have all these skills can do it.
    path : sequence of points
        What is driven to do it. Points x, y [m] are joined by straight lines, with a turn on the
        spot at each in between; poses x, y, yaw [m, rad] are joined by arcs.
    direction : {"either", "given"}
        Whether the path may be driven from its last point to its first one, too.
    speed : float, optional
        Tread speed along the path [m/s]; that of the mission where not given.
    payload_per_metre : float
        What each metre of the path takes on board (positive) or leaves behind (negative) [kg/m].
    goals : tuple of Goal
        What `pose` was given as; empty where that is a single pose.

    Raises
    ------
    MissionError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> Task("wash the hall", (4.0, 2.0, 0.0), dwell=600.0, power=300.0).required
    True
    >>> row = Task("first row", path=[(1.0, 2.0), (9.0, 2.0)], power=80.0, payload_per_metre=-0.5)
    >>> row.length, row.change, len(row.options)
    (8.0, -4.0, 2)
    """

    name: Name
    pose: Place | None = None
    dwell: Duration = 0.0
    power: ToolPower = 0.0
    payload: Annotated[Mass, Within((-1e5, 1e5), (-1e3, 1e3), "kg", "not grams")] = 0.0
    prize: Annotated[Number, Within((0, LARGEST), (0, 1e6))] = 1.0
    required: bool = True
    window: tuple[Time, Time] = (0.0, inf)
    power_spread: ToolPower | None = None
    dwell_spread: Duration | None = None
    needs: tuple[str, ...] = ()
    path: Annotated[tuple[Row, ...], PlainValidator(_points)] = ()
    direction: Literal["either", "given"] = "either"
    speed: Speed | None = None
    payload_per_metre: Annotated[
        float, amount_of("mass per length"), Within((-1e4, 1e4), (-100, 100), "kg/m")
    ] = 0.0
    goals: tuple[Goal, ...] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _distributions(cls, given: Any, info: ValidationInfo) -> Any:
        """Part a distribution into mean and standard deviation, and a goal into poses."""
        if not isinstance(given, dict | ArgsKwargs):
            return given  # pydantic refuses it by its kind
        values = dict(given if isinstance(given, dict) else given.kwargs or {})
        if isinstance(given, ArgsKwargs) and len(given.args) > 1:
            named = {"pose": given.args[1], **values}
            _part_goal(named, info)
            given = ArgsKwargs((given.args[0], named.pop("pose"), *given.args[2:]))
            values = named
        elif values.get("pose") is not None:
            _part_goal(values, info)
        for key, kind in (("dwell", "time"), ("power", "power")):
            spread = _part(values, key, kind)
            if spread is not None:
                values[f"{key}_spread"] = spread
        return values if isinstance(given, dict) else ArgsKwargs(given.args, values)

    def __post_init__(self) -> None:
        require(
            0 <= self.window[0] <= self.window[1] and self.window[0] <= LARGEST,
            f"task {self.name!r}: the window {self.window} is empty; give earliest and latest "
            "start [s]",
            "window",
        )
        given = self.pose is not None, bool(self.path)
        both = "both a pose and a path" if all(given) else "neither a pose nor a path"
        require(sum(given) == 1, f"task {self.name!r} has {both}; give one of them", "pose")
        if not self.path:
            for key, unset in (("direction", "either"), ("speed", None), ("payload_per_metre", 0)):
                message = f"task {self.name!r}: {key} is for tasks with a path; leave it out"
                require(getattr(self, key) == unset, message, key)
            return
        require(
            self.dwell == 0 and not self.dwell_spread,
            f"task {self.name!r}: a path takes as long as its drive; leave dwell out",
            "dwell",
        )

    @property
    def options(self) -> tuple[Option, ...]:
        """The ways of doing it, of which one is enough."""
        if self.pose is not None:
            return (Option(self.pose, self.pose),)
        points = self.path[::-1]
        if len(points[0]) == 3:
            points = tuple((x, y, float(wrap_angle(yaw + np.pi))) for x, y, yaw in points)
        ways = (Option.along(self.path), Option.along(points))
        return ways if self.direction == "either" else ways[:1]

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return self.options[0].path(0.0).length if self.path else 0.0

    @property
    def change(self) -> float:
        """What doing it changes the payload by [kg]."""
        return self.payload + self.payload_per_metre * self.length


class _OfCurve(Within):
    """What a power may be, also each of a curve."""

    def _beyond(self, ends: tuple[float, float], value: ArrayLike) -> tuple[tuple[int, ...], str]:
        given = np.asarray(value, float)
        if not given.ndim:
            return super()._beyond(ends, given)
        at, wanted = super()._beyond(ends, given[:, 1])
        return (*at, *(1 for _ in at)), wanted


def _offered(value: Any) -> float | tuple[tuple[float, float], ...]:
    """Read the power of a charger: a number, or pairs of a state of charge and a power."""
    words = "a power (W, kW), or pairs [state of charge, power], as [[0, 400], [0.8, 400], [1, 50]]"
    if isinstance(value, str | int | float | np.number):
        return float(_read("power", value, words))
    if not hasattr(value, "__len__") or hasattr(value, "keys") or len(value) < 2:
        raise ValueError(f"give {words}")
    pairs = []
    for k, pair in enumerate(value):
        if isinstance(pair, str) or not hasattr(pair, "__len__") or len(pair) != 2:
            raise ValueError(f"pair {k + 1} is {described(pair)}; give {words}")
        pairs.append((_read("fraction", pair[0], words), _read("power", pair[1], words)))
    levels = np.array([soc for soc, _ in pairs])
    if not (np.all(np.diff(levels) > 0) and levels[0] >= 0 and levels[-1] <= 1):
        raise ValueError("its states of charge must ascend and lie in [0, 1]; sort them")
    return tuple(pairs)


def _read(kind: str, value: Any, words: str) -> float:
    """Read a number that may carry a unit of a kind."""
    try:
        return float(amount(kind, value))
    except NO_NUMBER:
        raise ValueError(f"give {words}") from None


@record(MissionError)
class Charger:
    """A place where the battery is charged.

    Parameters
    ----------
    name : str
        Name, unique in the mission.
    pose : Pose
        Where the robot docks.
    power : float or sequence of pairs
        Power that it offers at the battery's terminals [W]; or pairs of a state of charge and the
        power there, between which it changes evenly.
    until : float
        State of charge at which the robot leaves, earlier where a window presses. Less saves time
        where the rest of the mission needs less; `MissionReport.remedies` says how much.
    temperature : float, optional
        Temperature of the battery while it charges there [degC]; that on the way where not given.
    places : int
        Of several robots, how many can charge there at a time.
    efficiency : float
        Energy that it gives over the energy that it draws from the mains.
    shared : bool
        Whether those who charge there at a time share its power evenly; else each has all of it.
    enough : bool
        Whether the robot leaves as soon as the rest of the mission needs no more, in steps of 1 %;
        `until` is then the most.

    Raises
    ------
    MissionError
        If a value is not finite or out of its range, or one place is to be shared.

    Examples
    --------
    >>> Charger("dock", (1.0, 2.0, 0.0), power=240.0).until
    0.95
    >>> float(Charger("dock", (1, 2, 0), [(0.0, 400), (0.8, 400), (1.0, 50)]).offers(0.9))
    225.0
    """

    name: Name
    pose: Place
    power: Annotated[
        float | tuple[tuple[float, float], ...],
        PlainValidator(_offered), _OfCurve((0.1, 1e6), (5, 5e4), "W"),
    ]  # fmt: skip
    until: Annotated[Fraction, Within((0.01, 1), (0.3, 1), "", PERCENT)] = 0.95
    temperature: Temperature | None = None
    places: Annotated[int, amount_of("number"), Within((1, 1000), (1, 20))] = 1
    efficiency: Annotated[Fraction, Within((0.01, 1), (0.5, 1), "", PERCENT)] = 1.0
    shared: bool = False
    enough: bool = False

    def __post_init__(self) -> None:
        if self.shared and self.places == 1:
            raise MissionError(
                f"charger {self.name!r} shares its power and has one place; give it 2 places or "
                "more, or leave out shared"
            )

    def offers(self, soc: ArrayLike) -> FloatArray:
        """Return the power that it offers at states of charge [W]."""
        if not isinstance(self.power, tuple):
            return np.full(np.shape(soc), self.power)
        levels, power = np.array(self.power).T
        return np.asarray(np.interp(np.asarray(soc, float), levels, power))


def at_charger(battery: BatteryModel, charger: Charger) -> BatteryModel:
    """Return a battery as it is while it charges."""
    if charger.temperature is None or not isinstance(battery, Battery):
        return battery
    return replace(battery, temperature=charger.temperature)


OWN = (
    "model", "vehicle", "battery", "start", "home", "soc", "reserve", "payload", "payload_models",
    "speed", "return_to", "planning_effort", "planning_time",
)  # fmt: skip
"""Keys of a mission's file that each of several robots may have for itself."""


@record(MissionError)
class Robot(ReadOnly):
    """One of several robots that do a mission.

    Parameters
    ----------
    name : str
        Name, unique in the mission.
    skills : tuple of str
        What it can do: a task is for robots with all skills that it `needs`.
    changes : mapping
        What it has for itself in place of the mission's: ``start``, ``soc``, ``battery``,
        ``model``, ``home``, ``reserve``, ``payload``, ``speed``, ``return_to`` and others.

    Raises
    ------
    MissionError
        If a key is not one that a robot may have for itself.

    Examples
    --------
    >>> Robot("west", changes={"start": (1.0, 2.0, 0.0), "soc": 0.8}).skills
    ()
    """

    name: Name
    skills: tuple[str, ...] = ()
    changes: Annotated[Mapping[str, Any], instance_of(Mapping)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {*OWN, "surfaces", "heights", "time"} - {"vehicle"}
        for key in self.changes:
            keys = ", ".join(sorted(known))
            require(key in known, f"{key}: a robot has no such key; it may have {keys}", "changes")
        object.__setattr__(self, "changes", MappingProxyType(dict(self.changes)))


@dataclass(frozen=True)
class RobotState:
    """Where a robot is at some time."""

    pose: Pose  # its pose
    soc: float  # its state of charge
    done: tuple[str, ...] = ()  # tasks that it has done
    time: float = 0.0  # time [s]


@record(MissionError)
class Spreads:
    """Standard deviations of what a mission takes as a number.

    The defaults are round figures for robots that nobody has measured; what is known better is
    better said. A battery that is not a `Battery` has no health and no temperature of its own:
    all its uncertainty counts as that of the capacity.
    """

    soc: Annotated[Fraction, _share(1, 0.2)] = 0.02
    capacity: Annotated[Fraction, _share(1, 0.4)] = 0.025  # capacity of the battery, relative
    health: Annotated[Fraction, _share(1, 0.4)] = 0.05  # health of the battery, absolute
    temperature: Annotated[Number, Within((0, 100), (0, 20), "K")] = 3.0  # of the battery
    power: Annotated[Fraction, _share(10, 1)] = 0.1  # power of each tool, relative
    dwell: Annotated[Fraction, _share(10, 1)] = 0.1  # duration of each task, relative
    run: Annotated[Fraction, _share(1, 0.5)] = USUAL_RUN_SPREAD
    speed: Annotated[Fraction, _share(10, 0.5)] = 0.05  # time of driving by run, relative
    waiting: Annotated[Fraction, _share(100, 2)] = 1.0  # waiting at each task, relative

    @classmethod
    def none(cls) -> Spreads:
        """Return spreads for numbers that are exact."""
        return cls(**dict.fromkeys((item.name for item in fields(cls)), 0.0))


_BATTERY = pydantic.TypeAdapter(Battery)


def _battery(value: Any, info: ValidationInfo) -> Any:
    """Read a battery in words or by its parts; anything with what a `BatteryModel` has is one."""
    if isinstance(value, str | dict):
        return _BATTERY.validate_python(value, context=info.context)
    if not isinstance(value, Battery | BatteryModel):
        raise MissionError(f"battery is {described(value)}; give a Battery, or words")
    return value


def _reserve(value: Any, info: ValidationInfo) -> Any:
    """Read a reserve as a state of charge; an energy is one of the full battery's."""
    if not isinstance(value, str) or value.strip()[-1:] in {*"%.0123456789"}:
        return amount("fraction", value)  # a number without a unit is a fraction
    try:
        energy = float(amount("energy", value))
    except NO_NUMBER as problem:
        raise ValueError(f"{problem}; give a fraction, a percentage or an energy") from None
    battery = info.data.get("battery")
    whole = np.inf if battery is None else battery.full_energy
    if energy >= whole:
        raise MissionError(
            f"the reserve of {energy / 3600:.0f} Wh is above the battery's capacity of "
            f"{whole / 3600:.0f} Wh"
        )
    return energy / whole


def _speed(value: Any) -> Any:
    try:
        return value if value is None or value == "cheapest" else amount("speed", value)
    except ValueError as problem:
        raise ValueError(f"{problem}, or 'cheapest'") from None


_OPEN = {
    "soc": ("fraction", False, False), "waiting": ("time", True, False),
    "capacity": ("charge", True, True), "health": ("fraction", False, True),
    "temperature": ("temperature", False, True),
}  # fmt: skip
"""What may be a distribution: its kind, whether its spread is relative, and is the battery's."""


@record(MissionError, eq=False)
class Mission(ReadOnly, html.Readable):
    """Tasks to do with one battery.

    Parameters
    ----------
    model : PowerModel
        Power model, with the vehicle, where no surface says otherwise.
    map : OccupancyGrid or Site
        Obstacles; or the site, for what is left out of surfaces, heights and clearance.
    battery : BatteryModel
        The battery: a `Battery`, or any class with what a `BatteryModel` has.
    start : Pose
        Where the robot is.
    tasks : sequence of Task
        What to do.
    chargers : sequence of Charger
        Where it can charge.
    surfaces : SurfaceMap, optional
        Surfaces with power models of their own.
    payload : float
        Payload at the start [kg].
    payload_models : mapping
        Models with a payload on board: name of the model without payload, then payload [kg],
        then model. In between they are interpolated. A model that is not named keeps its
        coefficients; its wheel loads grow in any case.
    soc : float
        State of charge at the start.
    reserve : float
        State of charge that must be left at every safe place.
    confidence : float
        Probability with which every promise must hold, in [0.5, 1).
    coefficient_spread : float
        Relative standard deviation of the models' coefficients from place to place and day to
        day, beyond their covariance.
    spreads : Spreads
        How far off the other numbers may be: charge, capacity, health, temperature, tools,
        durations, runs.
    waiting : float
        Time lost at each task before it begins, as expected [s].
    order : {"given", "free"}
        Whether the tasks are done in the order given.
    return_to : {"start", "charger", "any"}
        Where the mission may end: where it started, at a charger, or at the nearest of these.
    home : Pose, optional
        Where ``"start"`` is, if not at `start`: for missions that are under way.
    time : float
        Time at the start, on the clock of the tasks' windows [s].
    speed : float or str, optional
        Tread speed to drive at [m/s], or ``"cheapest"``; where not given that at which the vehicle
        is usually driven, or else the fastest of its motors.
    objective : {"energy", "length"}
        Whether the routes are those of least energy, or the shortest ones to compare with.
    planner : str
        Planner of the routes.
    planning_time : float, optional
        Time after which the planning of a route stops [s]; then the report depends on the load.
    planning_effort : int, optional
        Units of work for each route; where not given, as many as a plan has where tasks are few
        and less where they are many.
    name : str
        What to call the mission.
    heights : HeightMap, optional
        Heights of the ground where it slopes. All models need a term that reads the slope
        (`energyplan.power.effects.with_weight`); payload adds to the mass of the term grade.
        Where surfaces or heights are left out, the ground that the model knows of stands for them
        (`energyplan.terrain.laid_out`).
    clearance : float
        Distance that the footprint keeps from obstacles on the way [m].
    robots : sequence of Robot
        Robots that share the tasks and chargers; one robot does them all where none is listed.

    Raises
    ------
    MissionError
        If a value is out of its range, names are not unique, there is no task, or the robot
        collides at a pose. ``error.place`` leads to the value.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> mission = ep.Mission(
    ...     model, hall, ep.Battery.preset("quadriga"), (1, 2, 0),
    ...     (ep.Task("look", (4, 2, 0), dwell=60.0, power=20.0),),
    ...     planning_effort=1000, coefficient_spread=0.05,
    ... )
    >>> mission.reserve
    0.2
    """

    model: Annotated[PowerModel, instance_of(PowerModel)]
    map: Annotated[OccupancyGrid, instance_of(OccupancyGrid, Site)]
    battery: Annotated[BatteryModel, PlainValidator(_battery)]
    start: Place
    tasks: Annotated[tuple[Task, ...], Field(max_length=1000)]
    chargers: Annotated[tuple[Charger, ...], Field(max_length=100)] = ()
    surfaces: Annotated[SurfaceMap | None, instance_of(SurfaceMap, NoneType)] = None
    payload: Annotated[Mass, Within((0, 1e5), (0, 1e3), "kg", "not grams")] = 0.0
    payload_models: Annotated[Mapping[str, Mapping[float, PowerModel]], instance_of(Mapping)] = (
        field(default_factory=dict)
    )
    soc: Annotated[Fraction, Within((0, 1), (0.05, 1), "", PERCENT)] = 1.0
    reserve: Annotated[
        float, BeforeValidator(_reserve), Within((0, 0.99), (0, 0.7), "", PERCENT)
    ] = 0.2
    confidence: Annotated[Fraction, Within((0.5, 1 - 1e-9), (0.5, 0.99999), "", PERCENT)] = 0.95
    coefficient_spread: Annotated[Fraction, _share(1, 0.5)] = 0.0
    order: Literal["given", "free"] = "given"
    return_to: Literal["start", "charger", "any"] = "any"
    home: Place | None = None
    time: Annotated[Time, Within((0, LARGEST), (0, LARGEST), "s")] = 0.0
    speed: Annotated[Speed | Literal["cheapest"] | None, BeforeValidator(_speed)] = None
    objective: Literal["energy", "length"] = "energy"
    planner: str = "lattice"
    planning_time: Annotated[Time, Within((1e-3, 86400), (1e-3, 600), "s")] | None = None
    planning_effort: (
        Annotated[int, amount_of("number"), Within((1, 1e9), (1, 5e6), "units")] | None
    ) = None
    name: str = "mission"
    heights: Annotated[HeightMap | None, instance_of(HeightMap, NoneType)] = None
    spreads: Annotated[
        Spreads, BeforeValidator(lambda value: Spreads.none() if value == "none" else value)
    ] = field(default_factory=Spreads)
    waiting: Duration = 0.0
    clearance: Annotated[Length, CLEARANCE] = 0.0
    robots: Annotated[tuple[Robot, ...], Field(max_length=100)] = ()
    notes: tuple[str, ...] = field(default=(), init=False, compare=False)

    also: ClassVar = ("vehicle", "places", "keepout", "costmap", "speed_mask")  # of a file

    @pydantic.model_validator(mode="before")
    @classmethod
    def _distributions(cls, given: Any) -> Any:
        """Part numbers of a file that are distributions into means, and spreads of the mission."""
        if not isinstance(given, dict):
            return given
        given, spreads = dict(given), dict[str, float]()
        battery = given.get("battery")
        if isinstance(battery, dict):
            battery = given["battery"] = dict(battery)
        for key, (kind, relative, inside) in _OPEN.items():
            where, place = (battery, ("battery",)) if inside else (given, ())
            spread = _part(where, key, kind, *place) if isinstance(where, dict) else None
            if spread is None:
                continue
            if relative and where[key] <= 0:
                message = f"a {key} of {where[key]:g} has no spread; give a mean above 0"
                raise MissionError(message, (*place, key))
            spreads[key] = spread / (where[key] if relative else 1.0)
        known = given.get("spreads", {})
        if spreads and (known == "none" or isinstance(known, dict)):
            known = vars(Spreads.none()) if known == "none" else known
            given["spreads"] = {**known, **spreads}
        return given

    @pydantic.model_validator(mode="after")
    def _doubts(self, info: ValidationInfo) -> Mission:
        """Note what is unusual, with its line where a file says so."""
        if self.robots:  # each has its own
            return self
        where = (info.context or {}).get("where", in_words)
        found = [*doubts_of(self), *doubts_of(self.vehicle, ("model", "vehicle"))]
        found += self.unladen
        for k, task in enumerate(self.tasks):
            for name in ("dwell", "power"):
                mean, spread = getattr(task, name), getattr(task, f"{name}_spread")
                if spread is not None and spread > mean:
                    note = f"a standard deviation of {spread:g} is more than the mean of {mean:g}"
                    found.append((("tasks", k, name), note))
        notes = (f"{where(place)}: {text}" for place, text in found)
        known = (info.context or {}).get("notes", ())
        object.__setattr__(self, "notes", (*self.notes, *known, *notes))
        return self

    def __post_init__(self) -> None:
        place: object = self.map
        if isinstance(place, Site):
            place.fill(self)
            if place.costmap is not None:
                note = "the costmap of the site does not count: routes are those of least energy"
                object.__setattr__(self, "notes", (note,))
        if self.robots:
            require(self.tasks, "the mission has no task; list at least one", "tasks")
            self._check_names()
            _ = self.parts
            return
        object.__setattr__(self, "home", self.start if self.home is None else self.home)
        for key, by_payload in self.payload_models.items():
            require(
                isinstance(by_payload, Mapping),
                f"payload_models of {key!r} is {described(by_payload)}; give models by payload",
                "payload_models",
            )
        self._lay_ground()
        models = {key: MappingProxyType(dict(v)) for key, v in self.payload_models.items()}
        object.__setattr__(self, "payload_models", MappingProxyType(models))
        require(self.tasks, "the mission has no task; list at least one", "tasks")
        self._check_names()
        self._check_numbers()
        self._check_models()
        self._move_start()
        self._free_goals()
        self._check_poses()

    def _lay_ground(self) -> None:
        if knows_ground(self.model):
            ground = laid_out(self.model, self.map.corners, self.surfaces, self.heights)
            models = {
                name: {payload: on_laid_ground(model, ground) for payload, model in known.items()}
                for name, known in self.payload_models.items()
            }
            laid = {**ground._asdict(), "payload_models": models}
            for name, value in laid.items():
                object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, object]:
        state = super().__getstate__()
        for name in ("free_map", "parts"):
            state.pop(name, None)
        return state

    @property
    def _stops(self) -> Iterator[tuple[str, str, Pose, tuple[str | int, ...]]]:
        """What each task and charger is, its name, where it is, and its place in the mission."""
        for k, task in enumerate(self.tasks):
            yield "task", task.name, task.options[0].entry, ("tasks", k)
        for k, charger in enumerate(self.chargers):
            yield "charger", charger.name, charger.pose, ("chargers", k)

    def _check_names(self) -> None:
        seen = {"start"}
        for _, name, _, place in self._stops:
            message = f"the name {name!r} stands twice; give each place its own"
            require(name not in seen, message, *place, "name")
            seen.add(name)
        for k, robot in enumerate(self.robots):
            require(
                robot.name not in [other.name for other in self.robots[:k]],
                f"the name {robot.name!r} stands twice; give each robot its own",
                "robots", k, "name",
            )  # fmt: skip

    def _check_numbers(self) -> None:
        require(
            self.reserve < self.soc,
            f"the reserve {self.reserve:g} is not below the state of charge {self.soc:g}; charge "
            "first, or lower the reserve",
            "reserve",
        )
        require(
            self.reserve >= self.battery.cutoff_soc,
            f"the reserve {self.reserve:g} is below {self.battery.cutoff_soc:g}, at which the "
            "battery is cut off",
            "reserve",
        )
        for k, charger in enumerate(self.chargers):
            require(
                charger.until > self.reserve,
                f"charger {charger.name!r} stops at {charger.until:g}, not above the reserve "
                f"{self.reserve:g}",
                "chargers", k, "until",
            )  # fmt: skip
        require(
            self.return_to != "charger" or self.chargers,
            "the mission must end at a charger but has none; list one, or return to the start",
            "return_to",
        )

    def _check_models(self) -> None:
        if self.heights is None:
            return
        surfaces = self.surfaces.surfaces if self.surfaces is not None else ()
        for model in (self.model, *(surface.model for surface in surfaces)):
            require(
                reads_slope(model),
                f"no term of the model {model.name!r} reads the slope; add the weight with "
                "energyplan.power.effects.with_weight(model)",
                "heights",
            )

    def _move_start(self) -> None:
        """Move a start that just touches an obstacle to the nearest free pose."""
        moved = free_beside(self.free_map, self.vehicle, self.start)
        if moved is not None:
            if self.home == self.start:
                object.__setattr__(self, "home", moved.pose)
            object.__setattr__(self, "start", moved.pose)
            object.__setattr__(self, "notes", (*self.notes, moved.note))

    def _free_goals(self) -> None:
        """Give each task with a choice of poses one at which the robot is free, if there is one."""
        tasks, notes = list(self.tasks), list(self.notes)
        for k, task in enumerate(tasks):
            if not task.goals or task.pose is None:
                continue
            several = [goal.samples(_HEADINGS, _AROUND) for goal in task.goals]
            free = [each[self.free_map.footprint_free(each, self.vehicle)] for each in several]
            found = np.concatenate(free)
            if len(found) and not self.free_map.footprint_free(task.pose, self.vehicle):
                tasks[k] = replace(task, pose=Pose(*found[0].tolist()))
            notes += (
                f"task {task.name!r}: {goal.describe()} is left out, for there the robot touches "
                "an obstacle or leaves the map"
                for goal, each in zip(task.goals, free, strict=True)
                if len(found) and not len(each)
            )
        object.__setattr__(self, "tasks", tuple(tasks))
        object.__setattr__(self, "notes", tuple(dict.fromkeys(notes)))

    def _check_poses(self) -> None:
        places: list[tuple[str, Pose, tuple[str | int, ...]]] = [("start", self.start, ("start",))]
        if self.home is not None and self.home != self.start:
            places.append(("home", self.home, ("home",)))
        places += [(f"{kind} {name!r}", pose, (*place, "pose"))
                   for kind, name, pose, place in self._stops]  # fmt: skip
        free = self.free_map.footprint_free([pose for _, pose, _ in places], self.vehicle)
        faults: list[tuple[str, tuple[str | int, ...]]] = []
        for (label, pose, place), good in zip(places, free, strict=True):
            where = f"({pose.x:g}, {pose.y:g}, {np.degrees(pose.yaw):.0f} deg)"
            if not self.map.inside(pose[:2]):
                faults.append((f"{label}: {where} lies outside the map", place))
            elif not good and (place[0] != "tasks" or self.tasks[int(place[1])].required):
                near = where_free(self.free_map, self.vehicle, pose)
                faults.append((f"{label}: the robot at {where} touches an obstacle; {near}", place))
        for k, task in enumerate(self.tasks):
            if not task.path or any(place[:2] == ("tasks", k) for _, place in faults):
                continue
            try:
                path = task.options[0].path(self.vehicle.icr.longitudinal)
            except PathError as problem:
                raise MissionError(f"task {task.name!r}: {problem}", ("tasks", k, "path")) from None
            beyond = [point for point in task.path if not self.map.inside(point[:2])]
            if beyond:
                x, y, *_ = beyond[0]
                fault = f"({x:g}, {y:g}) of its path lies outside the map"
                faults.append((f"task {task.name!r}: {fault}", ("tasks", k, "path")))
            elif task.required and (fault := blocked(self.free_map, self.vehicle, path)):
                faults.append((f"task {task.name!r}: {fault}", ("tasks", k, "path")))
        if faults:
            raise MissionError("; ".join(fault for fault, _ in faults), faults[0][1])

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (task.name, ", ".join(html.number(v) for v in task.options[0].entry), task.dwell,
             task.power, "yes" if task.required else "no")
            for task in self.tasks
        ]  # fmt: skip
        title = (
            f"mission {self.name}: {self.model.vehicle.name}, from {100 * self.soc:.0f} % of "
            f"charge, reserve {100 * self.reserve:.0f} %"
        )
        header = ("task", "x, y [m], yaw [rad]", "dwell [s]", "power [W]", "required")
        return [html.Summary(title, header, rows)]

    @property
    def tread_speed(self) -> float | None:
        """Tread speed to drive at [m/s]; None stands for the cheapest."""
        return tread_speed(self.speed, self.vehicle)

    def at_charger(self, charger: Charger) -> BatteryModel:
        """Return the battery as it is while it charges."""
        return at_charger(self.battery, charger)

    def charging_fault(self, charger: Charger) -> str:
        """Why the battery takes no charge at a charger, and the remedy; empty where it does."""
        battery = self.at_charger(charger)
        return battery.charging_fault if isinstance(battery, Battery) else ""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, without payload."""
        return self.model.vehicle

    @cached_property
    def free_map(self) -> OccupancyGrid:
        """The map with the areas to keep out of occupied."""
        kept = self.surfaces.keep_out if self.surfaces is not None else ()
        return self.map.with_blocked(kept) if kept else self.map

    def changed(self, *notes: str, **changes: Any) -> Mission:
        """Return the mission with other fields and further notes, and with those that it has."""
        mission = replace(self, **changes)
        known = dict.fromkeys((*notes, *self.notes, *mission.notes))
        object.__setattr__(mission, "notes", tuple(known))
        return mission

    @cached_property
    def parts(self) -> tuple[Mission, ...]:
        """The mission of each of several robots, with the tasks that it has the skills for."""
        found = []
        for k, robot in enumerate(self.robots):
            able = [j for j, task in enumerate(self.tasks) if {*task.needs} <= {*robot.skills}]
            message = f"robot {robot.name!r} has the skills for no task; leave it out"
            require(able, message, "robots", k)
            try:
                tasks = tuple(self.tasks[j] for j in able)
                changes: dict[str, Any] = {"order": "free", "name": robot.name, **robot.changes}
                found.append(replace(self, tasks=tasks, robots=(), **changes))
            except MissionError as problem:
                place = list(problem.place)
                if place[:1] == ["tasks"] and len(place) > 1:
                    place[1] = able[int(place[1])]
                elif place and place[0] in robot.changes:
                    place = ["robots", k, *place]
                raise MissionError(f"robot {robot.name!r}: {problem}", place) from None
        return tuple(found)

    @property
    def unladen(self) -> tuple[tuple[tuple[str, int, str], str], ...]:
        """Places of tasks that leave more than any robot can have on board by then, and why."""
        found = []
        for k, task in enumerate(self.tasks):
            if task.change >= -GRAM:
                continue
            loads = []
            for part in self.parts if self.robots else (self,):
                names = [one.name for one in part.tasks]
                if task.name in names:
                    last = names.index(task.name) if part.order == "given" else None
                    taken = (max(one.change, 0.0) for one in part.tasks[:last])
                    loads.append(part.payload + sum(taken))
            most = max(loads, default=0.0)
            if -task.change > most + GRAM:
                note = f"it leaves {-task.change:g} kg, and at most {most:g} kg can be on board"
                key = "payload_per_metre" if task.payload_per_metre else "payload"
                found.append((("tasks", k, key), note))
        return tuple(found)

    @checked(MissionError)
    def resume_robots(self, states: Mapping[str, RobotState], done: Iterable[str] = ()) -> Mission:
        """Return what is left of a mission of several robots for those that are still there.

        Parameters
        ----------
        states : mapping
            Where each robot is that goes on, by its name.
        done : iterable of str
            Names of the tasks that are done, beyond those in `states`.
        """
        unknown = states.keys() - {robot.name for robot in self.robots}
        require(not unknown, f"no robot is called {', '.join(sorted(unknown))}")
        finished = {*done, *(task for state in states.values() for task in state.done)}
        rest = []
        for robot, part in zip(self.robots, self.parts, strict=True):
            if robot.name not in states or not {task.name for task in part.tasks} - finished:
                continue
            state = states[robot.name]
            own = part._carried({*state.done})
            now = {"start": state.pose, "soc": state.soc, "time": state.time, "home": part.home,
                   "payload": own}  # fmt: skip
            rest.append(replace(robot, changes={**robot.changes, **now}))
        require(rest, "no robot is left that can do a task that is left")
        left = tuple(task for task in self.tasks if task.name not in finished)
        return replace(self, tasks=left, robots=tuple(rest))

    @checked(MissionError)
    def resume(
        self,
        pose: ArrayLike,
        soc: float,
        done: Iterable[str] = (),
        *,
        time: float | None = None,
        payload: float | None = None,
        model: PowerModel | None = None,
        rows: Mapping[str, ArrayLike] | None = None,
    ) -> Mission:
        """Return what is left of the mission when it is under way, with `home` where it began.

        Parameters
        ----------
        pose : array_like, shape (3,)
            Where the robot is now: x, y [m], yaw [rad].
        soc : float
            State of charge now.
        done : iterable of str
            Names of the tasks that are done or given up.
        time, payload : float, optional
            Time [s] and payload [kg] now; those at the start, and worked out from the tasks done.
        model : PowerModel, optional
            The model as corrected since the start; models with payload are scaled alike.
        rows : mapping, optional
            Poses along what is left of paths that are driven in part, by task. What each metre of
            them takes on board, or leaves, is on board or gone as far as they are driven.
        """
        require(not self.robots, "the mission has several robots; use resume_robots")
        names, begun = set(done), dict(rows or {})
        paths = {task.name for task in self.tasks if task.path}
        unknown = (names | begun.keys()) - {task.name for task in self.tasks}
        require(not unknown, f"no task is called {', '.join(sorted(unknown))}")
        still = ", ".join(sorted(begun.keys() - paths))
        require(not still, f"rows: {still} has no path to be driven in part")
        left = tuple(
            replace(task, path=np.asarray(begun[task.name], float), direction="given")  # type: ignore[arg-type]
            if task.name in begun else task
            for task in self.tasks if task.name not in names
        )  # fmt: skip
        driven = sum(
            task.payload_per_metre * (task.length - rest.length)
            for task in self.tasks for rest in left
            if task.name == rest.name and rest.name in begun
        )  # fmt: skip
        mission = replace(
            self,
            start=pose,  # type: ignore[arg-type]
            soc=soc,
            tasks=left,
            payload=self._carried(names, driven) if payload is None else payload,
            time=self.time if time is None else time,
        )
        return mission if model is None else _corrected(mission, model)

    def _carried(self, done: set[str], driven: float = 0.0) -> float:
        """Return the payload after some tasks [kg]; they leave no more than was on board.

        `driven` is what parts of paths changed it by [kg].
        """
        change = sum(task.change for task in self.tasks if task.name in done)
        carried = self.payload + driven + change
        require(
            carried >= -GRAM,
            f"the tasks that are done leave {-carried:g} kg more than was ever on board; give as "
            "done only what was, and the payload",
        )
        return max(carried, 0.0)

    @checked(MissionError)
    def with_remedy(self, remedy: Remedy) -> Mission:
        """Return the mission with a remedy of its report applied."""
        names = [task.name for task in self.tasks]
        if remedy.kind in ("drop", "window"):
            require(remedy.task in names, f"no task is called {remedy.task!r}")
        if remedy.kind == "drop":
            return replace(self, tasks=tuple(t for t in self.tasks if t.name != remedy.task))
        if remedy.kind == "speed":
            return replace(self, speed="cheapest" if remedy.amount is None else remedy.amount)
        require(remedy.amount is not None, f"the remedy {remedy.kind!r} has no amount")
        amount = float(remedy.amount or 0.0)
        if remedy.kind == "temperature":
            moved = tuple(
                replace(one, temperature=amount) if self.charging_fault(one) else one
                for one in self.chargers
            )
            return replace(self, chargers=moved)
        if remedy.kind == "charge" and remedy.where == "chargers":
            less = tuple(replace(one, until=min(one.until, amount)) for one in self.chargers)
            return replace(self, chargers=less)
        if remedy.kind == "window":
            k = names.index(remedy.task)
            first, last = self.tasks[k].window
            later = replace(self.tasks[k], window=(first, last + amount))
            return replace(self, tasks=(*self.tasks[:k], later, *self.tasks[k + 1 :]))
        if remedy.kind == "capacity":
            more = (amount - 1.0) * self.battery.full_energy if remedy.unit == "1" else amount
            return replace(self, battery=self.battery.larger(more))
        if remedy.kind == "reserve":
            return replace(self, reserve=amount)
        return replace(self, soc=amount)


def _corrected(mission: Mission, model: PowerModel) -> Mission:
    """Put a corrected model in the place of the mission's, and scale its loaded ones alike."""
    old = mission.model
    same = [t.name for t in old.terms] == [t.name for t in model.terms]
    loaded = dict(mission.payload_models.get(old.name, {}))
    if loaded and not same:
        raise MissionError(
            f"the corrected model has the terms {[t.name for t in model.terms]}, the models with "
            f"payload {[t.name for t in old.terms]}; correct with the same terms"
        )
    base = np.where(old.coefficients == 0, 1.0, old.coefficients)
    ratio = np.where(old.coefficients == 0, 1.0, model.coefficients / base)
    scaled = {
        load: heavy.with_coefficients(
            heavy.coefficients * ratio,
            None if model.covariance is None else model.covariance * np.outer(
                heavy.coefficients / base, heavy.coefficients / base
            ),
        )
        for load, heavy in loaded.items()
    }  # fmt: skip
    models = {key: value for key, value in mission.payload_models.items() if key != old.name}
    renamed = replace(model, name=old.name, residual=model.residual or old.residual)
    return replace(mission, model=renamed, payload_models={**models, old.name: scaled})
