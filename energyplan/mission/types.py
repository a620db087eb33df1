"""A mission: tasks to do with one battery, checked where it is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial, wraps
from math import inf, isfinite, sqrt
from types import MappingProxyType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    dataclass_transform,
)  # fmt: skip

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, ConfigDict, PlainValidator, ValidationError, ValidationInfo
from pydantic_core import ArgsKwargs

from energyplan import html
from energyplan.battery import BatteryModel
from energyplan.errors import InvalidInputError, MissionError
from energyplan.kinds import amount, check_fields, checked, described
from energyplan.path import Pose, as_pose
from energyplan.planning.problem import free_beside, nearest_free
from energyplan.power import USUAL_RUN_SPREAD, PowerModel
from energyplan.power.effects import reads_slope
from energyplan.records import ReadOnly
from energyplan.terrain import OccupancyGrid, Site, knows_ground, laid_out, on_laid_ground
from energyplan.vehicle import Vehicle

if TYPE_CHECKING:
    from energyplan.terrain import HeightMap, SurfaceMap

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


OrderRule = Literal["given", "free"]
ReturnRule = Literal["start", "charger", "any"]


@dataclass(frozen=True, eq=False)
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
        Grounds with power models of their own.
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
        Time for each route [s]; where not given, a second where tasks are few and less where they
        are many.
    planning_effort : int, optional
        Units of work for each route, in place of the time: the same report under any load; see
        `energyplan.Budget`.
    name : str
        What to call the mission.
    heights : HeightMap, optional
        Heights of the ground where it slopes. All models need a term that reads the slope
        (`energyplan.power.effects.with_weight`); payload adds to the mass of the term grade.
        Where surfaces or heights are left out, the ground that the model knows of stands for them
        (`energyplan.terrain.laid_out`).
    clearance : float
        Distance that the footprint keeps from obstacles on the way [m].

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

    model: PowerModel
    map: OccupancyGrid
    battery: BatteryModel
    start: Pose
    tasks: tuple[Task, ...]
    chargers: tuple[Charger, ...] = ()
    surfaces: SurfaceMap | None = None
    payload: float = 0.0
    payload_models: Mapping[str, Mapping[float, PowerModel]] = field(default_factory=dict)
    soc: float = 1.0
    reserve: float = 0.2
    confidence: float = 0.95
    coefficient_spread: float = 0.0
    order: OrderRule = "given"
    return_to: ReturnRule = "any"
    home: Pose | None = None
    time: float = 0.0
    speed: float | Literal["cheapest"] | None = None
    objective: Literal["energy", "length"] = "energy"
    planner: str = "lattice"
    planning_time: float | None = None
    planning_effort: int | None = None
    name: str = "mission"
    heights: HeightMap | None = None
    spreads: Spreads = field(default_factory=Spreads)
    waiting: float = 0.0
    clearance: float = 0.0
    notes: tuple[str, ...] = field(default=(), init=False, compare=False)

    def __post_init__(self) -> None:
        place: object = self.map
        if isinstance(place, Site):
            place.fill(self)
            if place.costmap is not None:
                told = "the costmap of the site does not count: routes are those of least energy"
                object.__setattr__(self, "notes", (told,))
        check_fields(self, MissionError)
        object.__setattr__(self, "tasks", tuple(self.tasks))
        object.__setattr__(self, "chargers", tuple(self.chargers))
        object.__setattr__(self, "start", checked_pose(self.start, "start", "start"))
        home = self.start if self.home is None else checked_pose(self.home, "home", "home")
        object.__setattr__(self, "home", home)
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
        self._check_poses()

    def _lay_ground(self) -> None:
        if knows_ground(self.model):
            ground = laid_out(self.model, self.map.corners, self.surfaces, self.heights)
            models = {
                name: {payload: on_laid_ground(model, ground) for payload, model in known.items()}
                for name, known in self.payload_models.items()
            }
            told = {**ground._asdict(), "payload_models": models}
            for name, value in told.items():
                object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, object]:
        state = super().__getstate__()
        state.pop("free_map", None)
        return state

    def _check_names(self) -> None:
        seen = {"start"}
        named = [("tasks", k, task.name) for k, task in enumerate(self.tasks)]
        named += [("chargers", k, charger.name) for k, charger in enumerate(self.chargers)]
        for kind, k, name in named:
            require(
                name not in seen, f"the name {name!r} stands twice; give each place its own",
                kind, k, "name",
            )  # fmt: skip
            seen.add(name)

    def _check_numbers(self) -> None:
        for key, low, high, end in (("soc", 0, 1, "]"), ("reserve", 0, 1, ")"),
                                    ("confidence", 0.5, 1, ")")):  # fmt: skip
            value = getattr(self, key)
            require(
                low <= value < high or (value == high and end == "]"),
                f"{key} is {value}; give a fraction in [{low}, {high}{end}", key,
            )  # fmt: skip
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
        for key in ("coefficient_spread", "payload", "time", "waiting", "clearance"):
            value = getattr(self, key)
            require(np.isfinite(value) and value >= 0, f"{key} is {value}; give 0 or more", key)
        for key in ("planning_time", "planning_effort", "speed"):
            value = getattr(self, key)
            if key == "speed" and value == "cheapest":
                continue
            require(value is None or value > 0, f"{key} is {value}; give more than 0", key)
        for key, kinds in (("objective", ("energy", "length")), ("order", ("given", "free")),
                           ("return_to", ("start", "charger", "any"))):  # fmt: skip
            value = getattr(self, key)
            require(value in kinds, f"{key} is {value!r}; choose {', '.join(kinds)}", key)
        require(
            self.return_to != "charger" or self.chargers,
            "the mission must end at a charger but has none; list one, or return to the start",
            "return_to",
        )

    def _check_models(self) -> None:
        if self.heights is None:
            return
        grounds = self.surfaces.surfaces if self.surfaces is not None else ()
        for model in (self.model, *(surface.model for surface in grounds)):
            require(
                reads_slope(model),
                f"no term of the model {model.name!r} reads the slope; add the weight with "
                "energyplan.power.effects.with_weight(model)",
                "heights",
            )

    def _move_start(self) -> None:
        """Move a start that just touches an obstacle to the nearest free pose."""
        beside = free_beside(self.free_map, self.vehicle, self.start)
        if beside is not None:
            if self.home == self.start:
                object.__setattr__(self, "home", beside.pose)
            object.__setattr__(self, "start", beside.pose)
            object.__setattr__(self, "notes", (*self.notes, beside.note))

    def _check_poses(self) -> None:
        places: list[tuple[str, Pose, tuple[str | int, ...]]] = [("start", self.start, ("start",))]
        if self.home is not None and self.home != self.start:
            places.append(("home", self.home, ("home",)))
        places += [
            (f"task {t.name!r}", t.pose, ("tasks", k, "pose")) for k, t in enumerate(self.tasks)
        ]
        places += [
            (f"charger {c.name!r}", c.pose, ("chargers", k, "pose"))
            for k, c in enumerate(self.chargers)
        ]
        free = self.free_map.footprint_free([pose for _, pose, _ in places], self.vehicle)
        faults: list[tuple[str, tuple[str | int, ...]]] = []
        for (label, pose, place), good in zip(places, free, strict=True):
            where = f"({pose.x:g}, {pose.y:g}, {np.degrees(pose.yaw):.0f} deg)"
            if not self.map.inside(pose[:2]):
                faults.append((f"{label}: {where} lies outside the map", place))
            elif not good and not self._may_fail(place):
                near = nearest_free(self.free_map, self.vehicle, pose)
                hint = "" if near is None else (
                    f"; the nearest free pose found is ({near.x:.2f}, {near.y:.2f}, "
                    f"{np.degrees(near.yaw):.0f} deg)"
                )  # fmt: skip
                told = f"{label}: the robot at {where} touches an obstacle{hint}"
                faults.append((told, place))
        if faults:
            raise MissionError("; ".join(told for told, _ in faults), faults[0][1])

    def _may_fail(self, place: tuple[str | int, ...]) -> bool:
        """Tell whether a pose is that of an optional task, which is then unreachable."""
        return place[0] == "tasks" and not self.tasks[int(place[1])].required

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (task.name, ", ".join(html.number(v) for v in task.pose), task.dwell, task.power,
             "yes" if task.required else "no")
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
        if self.speed == "cheapest":
            return None
        usual = self.vehicle.driving_speed
        return self.speed or (usual if np.isfinite(usual) else None)

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, without payload."""
        return self.model.vehicle

    @cached_property
    def free_map(self) -> OccupancyGrid:
        """The map with the areas to keep out of occupied."""
        kept = self.surfaces.keep_out if self.surfaces is not None else ()
        return self.map.with_blocked(kept) if kept else self.map

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
    ) -> Mission:
        """Return what is left of the mission when it is under way.

        Parameters
        ----------
        pose : array_like, shape (3,)
            Where the robot is now: x, y [m], yaw [rad].
        soc : float
            State of charge now.
        done : iterable of str
            Names of the tasks that are done or given up.
        time : float, optional
            Time now [s]; that of the start where not given.
        payload : float, optional
            Payload now [kg]; worked out from the tasks done where not given.
        model : PowerModel, optional
            The model as corrected since the start (by `OnlineIdentifier`, for one). It takes the
            place of the mission's own, and the models with payload are scaled alike.

        Returns
        -------
        Mission
            The rest, with `home` where this mission began.

        Raises
        ------
        MissionError
            If a task is unknown, or all are done.
        """
        names = set(done)
        unknown = names - {task.name for task in self.tasks}
        require(not unknown, f"no task is called {', '.join(sorted(unknown))}")
        left = tuple(task for task in self.tasks if task.name not in names)
        carried = self.payload + sum(t.payload for t in self.tasks if t.name in names)
        mission = replace(
            self,
            start=checked_pose(pose, "pose"),
            soc=soc,
            tasks=left,
            payload=carried if payload is None else payload,
            time=self.time if time is None else time,
        )
        return mission if model is None else _corrected(mission, model)

    @checked(MissionError)
    def with_remedy(self, remedy: Remedy) -> Mission:
        """Return the mission with a remedy of its report applied."""
        names = [task.name for task in self.tasks]
        if remedy.kind in ("drop", "window"):
            require(remedy.task in names, f"no task is called {remedy.task!r}")
        if remedy.kind == "drop":
            return replace(self, tasks=tuple(t for t in self.tasks if t.name != remedy.task))
        if remedy.kind == "cheapest_speed":
            return replace(self, speed="cheapest")
        require(remedy.amount is not None, f"the remedy {remedy.kind!r} has no amount")
        amount = float(remedy.amount or 0.0)
        if remedy.kind == "window":
            k = names.index(remedy.task)
            first, last = self.tasks[k].window
            later = replace(self.tasks[k], window=(first, last + amount))
            return replace(self, tasks=(*self.tasks[:k], later, *self.tasks[k + 1 :]))
        if remedy.kind == "strings":
            amount = (amount - 1.0) * self.battery.full_energy
        if remedy.kind in ("capacity", "strings"):
            return replace(self, battery=self.battery.larger(amount))
        key = {"charge": "soc"}.get(remedy.kind, remedy.kind)
        changes: dict[str, Any] = {key: amount}
        return replace(self, **changes)


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
