"""A mission: tasks to do with one battery, checked where it is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from energyplan import html
from energyplan.battery import BatteryModel
from energyplan.errors import MissionError
from energyplan.kinds import check_fields, checked, described
from energyplan.mission.tasks import Charger, Remedy, Spreads, Task, checked_pose, require
from energyplan.path import Pose
from energyplan.planning.problem import free_beside, nearest_free
from energyplan.power import PowerModel
from energyplan.power.effects import reads_slope
from energyplan.records import ReadOnly
from energyplan.terrain import OccupancyGrid, Site, knows_ground, laid_out, on_laid_ground
from energyplan.vehicle import Vehicle

if TYPE_CHECKING:
    from energyplan.terrain import HeightMap, SurfaceMap

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
        fraction = "give a fraction"
        require(0 <= self.soc <= 1, f"soc is {self.soc}; {fraction} in [0, 1]", "soc")
        require(
            0 <= self.reserve < 1, f"reserve is {self.reserve}; {fraction} in [0, 1)", "reserve"
        )
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
        require(
            0.5 <= self.confidence < 1,
            f"confidence is {self.confidence}; {fraction} in [0.5, 1)",
            "confidence",
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
        require(
            self.objective in ("energy", "length"),
            f"objective is {self.objective!r}: energy or length",
            "objective",
        )
        require(self.order in ("given", "free"), f"order is {self.order!r}: given or free", "order")
        require(
            self.return_to in ("start", "charger", "any"),
            f"return_to is {self.return_to!r}; choose start, charger or any",
            "return_to",
        )
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
