"""From place to place: planned once, timed within the limits, priced for the payload on board."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from statistics import NormalDist
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.cost.speeds import CHEAPEST
from energyplan.errors import InfeasibleMotionError, MissionError, PlanningError, TimeLimitError
from energyplan.mission.energy import Consumption, Estimate, Models
from energyplan.mission.supply import Gauge, Supply
from energyplan.mission.types import Mission, Option, blocked
from energyplan.path import ROUNDING, FloatArray, Path, Pose, Trajectory, wrap_angle
from energyplan.planning import PlanningProblem, find, plan
from energyplan.planning.budget import EFFORT
from energyplan.planning.driven import drive_path
from energyplan.planning.space.compiled import compiled
from energyplan.power import PowerModel
from energyplan.records import ByValue
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

Value = TypeVar("Value")
Progress = Callable[[str], None] | None  # called with a line of text

_PERIOD = 0.1  # largest time between two samples of a leg [s]
_PLANNING = 1_000_000  # units of work for all routes of a mission, where it does not say otherwise
_LEAST = 5000  # units of work for a route that are not halved any more
_CELLS = 30_000  # most cells of the coarse grid
_TOGETHER = 8  # most places whose ways to all others are found in one call
_OCTILE = np.cos(np.pi / 8)  # least distance over way along the eight directions of a grid


@dataclass(frozen=True)
class Leg:
    """A drive from one place to another."""

    path: Path  # its route
    trajectory: Trajectory | None  # when the robot is where
    consumption: Consumption  # what it takes
    trouble: str = ""
    detail: str = ""  # what the trouble is

    @property
    def energy(self) -> Estimate:
        """Its energy."""
        return self.consumption.energy

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return 0.0 if self.trajectory is None else self.trajectory.duration


@dataclass(frozen=True)
class PlannedRoute:
    """A way that was planned."""

    path: Path
    trouble: str = ""
    detail: str = ""
    stopped: bool = False  # whether by the clock


@dataclass(frozen=True, eq=False)
class Scene(ByValue):
    """All that decides how the robot drives with one payload: no method looks at anything else."""

    map: OccupancyGrid  # obstacles, with what must be kept out of occupied
    model: PowerModel  # power outside all surfaces, with the payload on board
    surfaces: SurfaceMap | None  # models with models of their own, and speed limits
    heights: HeightMap | None
    speed: float | None  # tread speed [m/s]; None stands for the cheapest
    objective: str
    clearance: float  # kept from obstacles on the way [m]
    planner: str
    planning_time: float  # after which the planning of a route stops [s]
    planning_effort: int | None  # units of work for each route; None of a planner that counts none

    @cached_property
    def cost(self) -> EnergyCost:
        """The cost of motions outside all surfaces."""
        return EnergyCost(self.model, battery=True, speed=self.speed or CHEAPEST)

    @cached_property
    def slower(self) -> tuple[EnergyCost, SurfaceMap | None]:
        """The cost and the surfaces of driving at any speed up to the one wanted."""

        def up_to(model: PowerModel) -> PowerModel:
            if self.speed is None:
                return model
            return replace(model, vehicle=model.vehicle.up_to(self.speed))

        surfaces = self.surfaces
        if surfaces is not None:
            slow = (replace(one, model=up_to(one.model)) for one in surfaces.surfaces)
            surfaces = replace(surfaces, surfaces=tuple(slow))
        return EnergyCost(up_to(self.model), battery=True, speed=CHEAPEST), surfaces

    @cached_property
    def symmetric(self) -> bool:
        """Whether a way costs the same driven backwards, so that one plan serves both."""
        if self.heights is not None or not self.model.vehicle.reverse:
            return False
        angle = np.linspace(0.0, np.pi, 65)
        ds, turn = np.cos(angle), np.sin(angle)
        costs = (self.cost,) if self.surfaces is None else self.surfaces.costs(self.cost)
        yaw = np.linspace(-np.pi, np.pi, 65)[:, None]

        def alike(one: EnergyCost) -> bool:
            there, back = (
                one.segment_energy(way * ds, way * turn, yaw=yaw if one.of_heading else None)
                for way in (1.0, -1.0)
            )
            return np.allclose(there, back, rtol=1e-6)

        return all(map(alike, costs))

    def plan(self, start: Pose, goal: Pose) -> PlannedRoute:
        """Plan the route of least energy from pose to pose."""
        still = Path(start, np.zeros(0), np.zeros(0), self.cost.icr.longitudinal)
        if start == goal:
            return PlannedRoute(still)
        problem = PlanningProblem(
            self.map, self.cost, start, goal, surfaces=self.surfaces, heights=self.heights,
            objective=self.objective, clearance=self.clearance,
        )  # fmt: skip
        for patience in (1, 10):
            effort = None if self.planning_effort is None else patience * self.planning_effort
            limit = patience * self.planning_time
            try:
                found = plan(problem, self.planner, limit, effort=effort)
                return PlannedRoute(found.path, stopped=found.stopped)
            except TimeLimitError as error:
                last = str(error)
            except PlanningError as error:
                return PlannedRoute(still, "no_path", str(error))
        return PlannedRoute(still, "time", last)

    def drive(self, path: Path, hurried: bool) -> Trajectory:
        """Return a path's trajectory, as a plan of it is driven; in a hurry as the motors can."""
        cost = self.cost
        if hurried and cost.tread_speed is None:
            cost = replace(cost, speed=cost.vehicle.motor.speed)
        return drive_path(
            path, cost, self.surfaces, self.heights, grid=self.map, period=_PERIOD
        ).trajectory

    def lower_bounds(
        self, starts: Sequence[Pose], goals: Sequence[Pose], ways: FloatArray
    ) -> FloatArray:
        """Return what it takes at least from poses to poses [J], shape (n, n).

        The greater of the least energy without obstacles and that of the shortest way round them;
        infinite where there is no way. On slopes that is the least price on any slope, and what
        the height costs.
        """
        cost, surfaces = self.slower
        here, there = np.array(starts), np.array(goals)
        turn = wrap_angle(here[:, None, 2] - there[None, :, 2])
        if self.heights is None:
            costs = (cost,) if surfaces is None else surfaces.costs(cost)
            bounds = [
                np.maximum(
                    steering.energy(here[:, None], there[None, :], c),
                    c.lower_bound().energy(ways, turn),
                )
                for c in costs
            ]
            return np.asarray(np.min(bounds, axis=0))
        query = compiled(
            PlanningProblem(
                self.map, cost, starts[0], starts[0], surfaces=surfaces, heights=self.heights
            )
        )
        # the prices hold for the centre of the tread ICRs, the ways for the vehicle's origin
        ways = np.maximum(ways - 2.0 * np.hypot(*cost.icr.centre), 0.0)
        low, high = (
            np.array([query.height_potential(pose) for pose in poses]) for poses in (starts, goals)
        )
        least, turns = query.least, np.abs(turn)
        return np.asarray(least.metre * ways + least.radian * turns + high[None, :] - low[:, None])


_SHARED = 2**25
"""Most memory of all routes and trajectories that are shared [B]: about 1,000 of 60 m."""

_SCENES = 32  # most scenes whose routes are shared


class Routes:
    """Routes planned so far and how they are driven; who is handed the same one shares them.

    They are found by the value of all that decides them. Beyond 32 MB, or 32 scenes, what was used
    longest ago goes first: of the scenes, then of the routes in it.
    """

    def __init__(self) -> None:
        self._scenes: OrderedDict[Scene, OrderedDict[Hashable, Any]] = OrderedDict()
        self.size = 0  # memory that they take, about [B]
        self._lock = Lock()

    def __len__(self) -> int:
        return sum(map(len, self._scenes.values()))

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            scenes = OrderedDict((scene, known.copy()) for scene, known in self._scenes.items())
            return {"_scenes": scenes, "size": self.size}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=Lock())

    def get(self, scene: Scene, key: Hashable) -> Any:
        """Return what is known of a route in a scene, or None."""
        with self._lock:
            known = self._scenes.get(scene)
            if known is None or key not in known:
                return None
            self._scenes.move_to_end(scene)
            known.move_to_end(key)
            return known[key]

    def put(self, scene: Scene, key: Hashable, found: Any) -> None:
        """Keep what is known of a route in a scene."""
        with self._lock:
            if scene not in self._scenes:
                self._scenes[scene.bare()] = OrderedDict()
            known = self._scenes[scene]
            self._scenes.move_to_end(scene)
            if key not in known:
                self.size += _memory(found)
                known[key] = found
            while self.size > _SHARED or len(self._scenes) > _SCENES:
                oldest, known = next(iter(self._scenes.items()))
                if known:
                    self.size -= _memory(known.popitem(last=False)[1])
                if not known:
                    del self._scenes[oldest]

    def update(self, other: Routes) -> None:
        """Take over what another one knows."""
        if other is not self:
            for scene, known in other._scenes.items():
                for key, found in known.items():
                    self.put(scene, key, found)


def _memory(found: Any) -> int:
    """Return about how much memory a route or a trajectory takes [B]."""
    if isinstance(found, PlannedRoute):
        found = found.path
    return 1000 + sum(v.nbytes for v in vars(found).values() if isinstance(v, np.ndarray))


class Legs:
    """All legs of a mission: from start, tasks and chargers to home, planned when needed."""

    def __init__(
        self, mission: Mission, progress: Progress = None, routes: Routes | None = None,
        former: Legs | None = None,
    ) -> None:  # fmt: skip
        self.mission = mission
        self.routes = Routes() if routes is None else routes
        self.stopped: set[frozenset[int]] = set()
        """Pairs of nodes between which the clock stopped the planning."""
        # what was worked out, by the value of all that decides it
        self._cache: dict[Hashable, Any] = {} if former is None else former._cache
        models = Models.of(mission)
        self.models: Models = self._cache.setdefault(models, models)
        self._progress = progress
        home = mission.start if mission.home is None else mission.home
        found = [(k, option) for k, task in enumerate(mission.tasks) for option in task.options]
        self._options = found  # task and option of each node after the start
        first = np.searchsorted([k for k, _ in found], np.arange(len(mission.tasks) + 1)) + 1
        self._ways = [range(a, b) for a, b in pairwise(first.tolist())]
        places = [Option(one.pose, one.pose) for one in mission.chargers]
        self.names = ["start", *(mission.tasks[k].name for k, _ in found),
                      *(one.name for one in mission.chargers)]  # fmt: skip
        self.home = 0
        if home != mission.start:
            self.home = 1 + len(found) + len(places)
            places.append(Option(home, home))
            self.names.append("home")
        nodes = [Option(mission.start, mission.start), *(one for _, one in found), *places]
        self.poses: list[Pose] = [one.entry for one in nodes]
        """Where the robot comes to at each node."""
        self.exits: list[Pose] = [one.exit for one in nodes]
        """Where it leaves each node from."""
        self._legs: dict[tuple[int, int, float, bool], Leg] = {}
        self._rows: dict[tuple[int, float], Leg] = {}
        self._bounds: dict[float, FloatArray] = {}
        self._scenes: dict[float, Scene] = {}
        self.planned_in = self.scene(mission.payload)  # decides the routes

    def under(self, mission: Mission, anew: bool = False) -> Legs:
        """Return these legs for another mission; unless planned anew, their routes stay."""
        other = Legs(mission, self._progress, self.routes, self)
        if not anew:
            other.planned_in = self.planned_in
        return other

    # -- places -----------------------------------------------------------------------------------

    @property
    def chargers(self) -> range:
        """Nodes of the chargers."""
        first = 1 + len(self._options)
        return range(first, first + len(self.mission.chargers))

    @property
    def options(self) -> range:
        """Nodes of the options of all tasks."""
        return range(1, 1 + len(self._options))

    def ways(self, task: int) -> range:
        """Return the nodes of a task's options."""
        return self._ways[task]

    def task_at(self, node: int) -> int:
        """Return the task that is done at a node of an option."""
        return self._options[node - 1][0]

    def region(self, node: int) -> int:
        """Return the surface under a place."""
        surfaces = self.mission.surfaces
        return 0 if surfaces is None else int(surfaces.region_at(self.poses[node][:2]))

    # -- battery ----------------------------------------------------------------------------------

    @cached_property
    def driving_power(self) -> float:
        """Power of driving straight on, at the speed wanted or a typical one [W]."""
        return self.models.driving_power(self.mission.payload, self.mission.tread_speed)

    @cached_property
    def quantile(self) -> float:
        """How many standard deviations a bound is beyond what is expected."""
        return NormalDist().inv_cdf(self.mission.confidence)

    @cached_property
    def supply(self) -> Supply:
        """The battery, with what is not certain about it."""
        return Supply(self.mission.battery, self.mission.spreads, self.quantile)

    @cached_property
    def _gauge(self) -> Gauge:
        return self.supply.drain(self.driving_power)

    @property
    def gauge(self) -> Estimate:
        """What is open about the charge after it was read off the gauge, as an energy."""
        return self.models.after_reading(self._gauge)

    def from_battery(self, energy: Estimate) -> Estimate:
        """Return an energy as the battery's charge feels it."""
        return self.models.from_battery(energy, self._gauge)

    # -- legs -------------------------------------------------------------------------------------

    def scene(self, payload: float) -> Scene:
        """Return what decides drives with a payload [kg] on board."""
        if payload not in self._scenes:
            mission, models = self.mission, self.models
            scene = Scene(
                map=mission.free_map,
                model=models.model_of(0, payload),
                surfaces=models.laden(payload),
                heights=mission.heights,
                speed=mission.tread_speed,
                objective=mission.objective,
                clearance=mission.clearance,
                planner=mission.planner,
                planning_time=mission.planning_time or np.inf,
                planning_effort=self._planning_effort,
            )
            self._scenes[payload] = self._cache.setdefault(scene, scene)
        return self._scenes[payload]

    @property
    def _planning_effort(self) -> int | None:
        """Units of work for each route, halved where many routes share them."""
        mission = self.mission
        if mission.planning_effort is not None or not find(mission.planner).effort:
            return mission.planning_effort
        routes = (4 if mission.order == "free" else 2) * len(mission.tasks)
        effort = EFFORT
        while effort > _LEAST and effort * routes > _PLANNING:
            effort //= 2
        return effort

    def lower_bounds(self, payload: float) -> FloatArray:
        """Return what it takes at least from node to node [J], shape (n, n)."""
        if payload not in self._bounds:
            scene, poses, exits = self.scene(payload), tuple(self.poses), tuple(self.exits)
            vehicle = self.mission.vehicle
            ends = (np.array(exits)[:, :2], np.array(poses)[:, :2])
            ways = self._once(
                (scene.map, vehicle, exits, poses),
                lambda: shortest_ways(scene.map, vehicle, *ends),
            )
            self._bounds[payload] = self._once(
                (scene, exits, poses), lambda: scene.lower_bounds(exits, poses, ways)
            )
        return self._bounds[payload]

    def planned(self, start: int, goal: int) -> bool:
        """Return whether the route from node to node is known."""
        scene, here, there = self.planned_in, self.exits[start], self.poses[goal]
        known = (scene, here, there) in self._cache
        return known or (scene.symmetric and (scene, there, here) in self._cache)

    def leg(self, start: int, goal: int, payload: float, hurried: bool = False) -> Leg:
        """Return the leg of least energy with a payload [kg]; in a hurry driven faster."""
        key = (start, goal, payload, hurried)
        if key not in self._legs:
            self._legs[key] = self._priced(self._route(start, goal), payload, hurried)
        return self._legs[key]

    def _once(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return what is computed once for all that decides it."""
        if key not in self._cache:
            self._cache[key] = make()
        value: Value = self._cache[key]
        return value

    def _shared(self, scene: Scene, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        """Return what is computed once in a scene, by this mission or another one."""

        def found() -> Value:
            known: Value | None = self.routes.get(scene, key)
            if known is None:
                self.routes.put(scene, key, known := make())
            return known

        return self._once((scene, *key), found)

    def _route(self, start: int, goal: int) -> PlannedRoute:
        """Plan from node to node, for the payload at the start of the mission."""
        names = self.names[start], self.names[goal]
        route = self._between(self.exits[start], self.poses[goal], names)
        if route.stopped:
            self.stopped.add(frozenset((start, goal)))
        return route

    def _between(self, here: Pose, there: Pose, names: tuple[str, str]) -> PlannedRoute:
        """Plan from pose to pose."""
        scene = self.planned_in

        def planned() -> PlannedRoute:
            if here != there and scene.symmetric and there < here:
                # one plan serves both ways; which one it is depends on the poses alone, so that a
                # mission is the same whatever was planned on its map before
                back = self._between(there, here, names[::-1])
                return replace(back, path=back.path.reversed())
            if self._progress is not None and here != there:
                self._progress(f"planning from {names[0]} to {names[1]}")
            return scene.plan(here, there)

        return self._shared(scene, (here, there), planned)

    def row(self, node: int, payload: float) -> Leg | None:
        """Return the drive along a path at a node, its tool running, begun with a payload [kg].

        None where the task is done standing still.
        """
        task, option = self._options[node - 1]
        if not option.points:
            return None
        key = (node, payload)
        if key not in self._rows:
            self._rows[key] = self._along(task, option, payload)
        return self._rows[key]

    def _along(self, task: int, option: Option, payload: float) -> Leg:
        job, left = self.mission.tasks[task], payload
        left += job.payload_per_metre * job.length
        # the drive is timed once, for the larger load
        scene = self.scene(max(payload, left, 0.0))
        scene = scene if job.speed is None else replace(scene, speed=job.speed)
        path = option.path(self.planned_in.cost.icr.longitudinal)
        trouble, detail = "no_path", blocked(self.mission.free_map, self.mission.vehicle, path)
        if not detail:
            try:
                trajectory = self._shared(scene, (path, False), lambda: scene.drive(path, False))
                driven = self.models.priced(trajectory, payload, max(left, 0.0))
                return Leg(path, trajectory, self.models.with_tool(driven, trajectory.t, task))
            except InfeasibleMotionError as error:
                trouble, detail = "motor", str(error)
        return _no_drive(path, trouble, detail, self.models)

    def lasting(self, node: int, payload: float) -> tuple[float, FloatArray]:
        """Return how long an option lasts once begun [s], and how that changes with each unknown.

        The payload is that at its beginning [kg].
        """
        task, row = self.task_at(node), self.row(node, payload)
        if row is None:
            return self.mission.tasks[task].dwell, self.models.dwell_time(task)
        return row.duration, self.models.driving_time(row.duration)

    def _priced(self, route: PlannedRoute, payload: float, hurried: bool) -> Leg:
        path, trouble, detail = route.path, route.trouble, route.detail
        scene, key = self.scene(payload), (path, hurried)
        if not trouble and len(path):
            try:
                trajectory = self._timed(path, payload, hurried)
                priced = self._once(
                    (self.models, payload, scene, *key),
                    lambda: self.models.priced(trajectory, payload),
                )
                return Leg(path, trajectory, priced)
            except InfeasibleMotionError as error:
                trouble, detail = "motor", str(error)
        return _no_drive(path, trouble, detail, self.models)

    def _timed(self, path: Path, payload: float, hurried: bool) -> Trajectory:
        """Return how a path is driven with a payload [kg]."""
        low, high = self._range
        if low < payload < high:
            trajectory = self._once((path, hurried, low, high), lambda: self._alike(path, hurried))
            if trajectory is not None:
                return trajectory
        scene = self.scene(payload)
        return self._shared(scene, (path, hurried), lambda: scene.drive(path, hurried))

    def _alike(self, path: Path, hurried: bool) -> Trajectory | None:
        """Return the one drive of a path with all payloads; None where it may depend on them.

        What the wanted speed and the acceleration limit with the least and the greatest payload,
        they limit with those between.
        """
        try:
            least, most = (self._timed(path, payload, hurried) for payload in self._range)
        except (InfeasibleMotionError, MissionError):
            return None
        same = len(least) == len(most) and np.allclose(least.t, most.t, rtol=ROUNDING, atol=0.0)
        return most if same else None

    @cached_property
    def _range(self) -> tuple[float, float]:
        """The least and the greatest payload that there may be [kg]."""
        payload, change = self.mission.payload, [task.change for task in self.mission.tasks]
        low, high = (payload + sum(part) for part in (np.minimum(change, 0), np.maximum(change, 0)))
        return max(float(low), 0.0), float(high)


def _no_drive(path: Path, trouble: str, detail: str, models: Models) -> Leg:
    """Return a leg that is not driven: one of no length, or one with a trouble."""
    energy = replace(models.nothing, mean=np.inf if trouble else 0.0)
    nothing = Consumption(np.zeros(0), np.zeros(0), energy)
    return Leg(path, None, nothing, trouble, detail)


def shortest_ways(
    grid: OccupancyGrid, vehicle: Vehicle, starts: FloatArray, goals: FloatArray | None = None
) -> FloatArray:
    """Return how far the robot's origin travels at least from points to points, or to each other.

    The largest disc about the origin inside the footprint moves over cells that are coarse enough
    for a quick search; a coarse cell is open if the disc fits at any place in it. The way along
    eight directions is at most 1.08 times the shortest; what the cells blur is taken off.
    """
    goals = starts if goals is None else goals
    rows, columns = grid.shape
    stride = max(int(np.ceil(np.sqrt(rows * columns / _CELLS))), 1)
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    radius = max(min(-x_min, x_max, -y_min, y_max), 0.0)
    slack = 0.71 * grid.resolution
    padded = np.pad(grid.clearance + slack >= radius, ((0, -rows % stride), (0, -columns % stride)))
    shape = (padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    open_cells = np.any(padded.reshape(shape), axis=(1, 3))
    at = (np.floor(grid.to_cells(points) / stride).astype(int) for points in (starts, goals))
    index, ends = (cells[:, 1] * open_cells.shape[1] + cells[:, 0] for cells in at)
    spacing = stride * grid.resolution
    graph = _graph(open_cells)
    few = range(0, len(index), _TOGETHER)  # SciPy holds Python's lock all the while
    found = [
        dijkstra(graph, directed=False, indices=index[k : k + _TOGETHER])[:, ends] for k in few
    ]
    ways = np.concatenate(found) * spacing
    straight = np.linalg.norm(starts[:, None] - goals[None], axis=-1)
    return np.asarray(np.maximum(_OCTILE * ways - 2 * np.sqrt(2) * spacing, straight))


def _graph(free: np.ndarray) -> csr_array:
    """Join open cells that touch, corners included; lengths in cells."""
    rows, columns = free.shape
    # older releases of SciPy want 32 bits; there are no more than `_CELLS` cells
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    start, end, length = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(max(-dc, 0), columns - max(dc, 0)))
        b = (slice(dr, rows), slice(max(dc, 0), columns - max(-dc, 0)))
        both = free[a] & free[b]
        start.append(number[a][both])
        end.append(number[b][both])
        length.append(np.full(int(both.sum()), np.hypot(dr, dc)))
    pairs = (np.concatenate(start), np.concatenate(end))
    return csr_array((np.concatenate(length), pairs), shape=(rows * columns,) * 2)
