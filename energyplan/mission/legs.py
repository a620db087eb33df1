"""From place to place: planned once, timed within the limits, priced for the payload on board."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import InfeasibleMotionError, PlanningError, TimeLimitError
from energyplan.mission.energy import Estimate, Grounds
from energyplan.mission.types import Mission
from energyplan.path import FloatArray, Path, Pose, Trajectory, wrap_angle
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.driven import drive_path
from energyplan.planning.space.compiled import compiled
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

_PERIOD = 0.1
"""Largest time between two samples of a leg [s]."""

_PLANNING = 20.0
"""Time for all routes of a mission, where it does not say otherwise [s]."""

_CELLS = 30_000
"""Most cells of the coarse grid."""

_OCTILE = np.cos(np.pi / 8)
"""Least distance over way along the eight directions of a grid."""


@dataclass(frozen=True)
class Leg:
    """A drive from one place to another."""

    path: Path  # where it leads
    trajectory: Trajectory | None  # when the robot is where
    power: FloatArray  # (n,): mean power of each interval of the trajectory [W]
    spread: FloatArray  # (n,): standard deviation of the power of each interval [W]
    energy: Estimate  # its energy
    trouble: str = ""
    detail: str = ""  # what the trouble is

    @property
    def duration(self) -> float:
        """Time that it takes [s]."""
        return 0.0 if self.trajectory is None else self.trajectory.duration


@dataclass(frozen=True)
class Route:
    """A way that was planned, and how it is timed by each model that was asked."""

    path: Path
    trouble: str = ""
    detail: str = ""
    timed: dict[Hashable, Trajectory] = field(default_factory=dict)


_REMEMBERED = 32
"""Most sets of routes, one for each map and cost, that are kept at a time."""


class Routes:
    """Routes planned so far; evaluations that are handed the same one share them.

    A route is told apart by the map, the costs and the planner that decide it, so that missions
    of any kind can share one.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import energyplan as ep
    >>> from energyplan.io.files import bundled
    >>> from energyplan.mission import Routes
    >>> mission = ep.read_mission(bundled("mission_warehouse.yaml"))
    >>> mission, routes = replace(mission, planning_effort=250), Routes()
    >>> first = ep.evaluate(mission, routes=routes)
    >>> planned = len(routes)
    >>> again = ep.evaluate(replace(mission, soc=1.0), routes=routes)
    >>> len(routes) == planned > 0
    True
    """

    def __init__(self) -> None:
        self._sets: dict[bytes, dict[tuple[Pose, Pose, bool], Route]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._sets.values()))

    def of(self, digest: bytes) -> dict[tuple[Pose, Pose, bool], Route]:
        """Return the routes that one map, cost and planner decide."""
        found = self._sets.pop(digest, {})
        self._sets[digest] = found
        for oldest in list(self._sets)[:-_REMEMBERED]:
            self._sets.pop(oldest, None)  # another thread may have been quicker
        return found


class Legs:
    """All legs of a mission, each planned when it is first asked for.

    Node 0 is the start; tasks, chargers and home follow.
    """

    def __init__(
        self,
        mission: Mission,
        progress: Callable[[str], None] | None = None,
        routes: Routes | None = None,
    ) -> None:
        self.mission = mission
        self.routes = Routes() if routes is None else routes
        self.grounds = Grounds(mission)
        self._progress = progress
        home = mission.start if mission.home is None else mission.home
        self.poses: list[Pose] = [
            mission.start,
            *(task.pose for task in mission.tasks),
            *(charger.pose for charger in mission.chargers),
        ]
        self.names = [
            "start",
            *(t.name for t in mission.tasks),
            *(c.name for c in mission.chargers),
        ]
        self.home = 0
        if home != mission.start:
            self.home = len(self.poses)
            self.poses.append(home)
            self.names.append("home")
        self._legs: dict[tuple[int, int, float, bool], Leg] = {}
        self._bounds: dict[float, FloatArray] = {}
        self._costs: dict[tuple[float, bool], tuple[EnergyCost, SurfaceMap | None]] = {}
        self._routes = self._known_routes()

    def under(self, mission: Mission) -> Legs:
        """Return these legs for a mission that differs in battery, charge, reserve or speed."""
        other = copy(self)
        other.mission = mission
        other.grounds = self.grounds.under(mission)
        if mission.speed != self.mission.speed:
            # The routes stay; times and energies change.
            other._legs, other._costs = {}, {}
        return other

    @property
    def _speed(self) -> float | None:
        """Tread speed to drive at [m/s]: the mission's, the vehicle's usual, or the cheapest."""
        return self.mission.tread_speed

    # -- places -----------------------------------------------------------------------------------

    @property
    def chargers(self) -> range:
        """Nodes of the chargers."""
        first = 1 + len(self.mission.tasks)
        return range(first, first + len(self.mission.chargers))

    def region(self, node: int) -> int:
        """Return the surface under a place."""
        surfaces = self.mission.surfaces
        return 0 if surfaces is None else int(surfaces.region_at(self.poses[node][:2]))

    # -- bounds -----------------------------------------------------------------------------------

    def cost(self, payload: float, slower: bool = False) -> tuple[EnergyCost, SurfaceMap | None]:
        """Return the cost and the surfaces with a payload [kg] on board.

        A drive is slower where it speeds up, turns or stops, and may take less there: what bounds
        its energy is the cost of driving at any speed up to the one asked, or `slower`.
        """
        key = payload, slower
        if key not in self._costs:
            speed, surfaces = self._speed, self.mission.surfaces

            def model(region: int) -> PowerModel:
                found = self.grounds.model(region, payload)
                if not slower or speed is None:
                    return found
                return replace(found, vehicle=found.vehicle.up_to(speed))

            if surfaces is not None:
                laden = [
                    replace(surface, model=model(k))
                    for k, surface in enumerate(surfaces.surfaces, start=1)
                ]
                surfaces = replace(surfaces, surfaces=tuple(laden))
            cost = EnergyCost(model(0), battery=True, speed=None if slower else speed)
            self._costs[key] = cost, surfaces
        return self._costs[key]

    def lower_bounds(self, payload: float) -> FloatArray:
        """Return what it takes at least from node to node [J], shape (n, n).

        The greater of the least energy without obstacles and that of the shortest way round them;
        infinite where there is no way.
        """
        if payload not in self._bounds:
            if self.mission.heights is not None:
                self._bounds[payload] = self._bounds_on_slopes(payload)
                return self._bounds[payload]
            cost, surfaces = self.cost(payload, slower=True)
            costs = (cost,) if surfaces is None else surfaces.costs(cost)
            poses = np.array(self.poses)
            turn = wrap_angle(poses[:, None, 2] - poses[None, :, 2])
            bounds = [
                np.maximum(
                    steering.energy(poses[:, None], poses[None, :], c),
                    c.lower_bound().energy(self._ways, turn),
                )
                for c in costs
            ]
            self._bounds[payload] = np.asarray(np.min(bounds, axis=0))
        return self._bounds[payload]

    def _bounds_on_slopes(self, payload: float) -> FloatArray:
        """Bound energies by the least prices on any slope, and by what the height is worth."""
        mission, (cost, surfaces) = self.mission, self.cost(payload, slower=True)
        here = self.poses[0]
        problem = PlanningProblem(
            mission.map, cost, here, here, surfaces=surfaces, heights=mission.heights
        )
        query = compiled(problem)
        poses = np.array(self.poses)
        turn = np.abs(wrap_angle(poses[:, None, 2] - poses[None, :, 2]))
        # the prices hold for the centre of the tread ICRs, the ways for the vehicle's origin
        ways = np.maximum(self._ways - 2.0 * np.hypot(*cost.icr.centre), 0.0)
        height = np.array([query.worth(pose) for pose in self.poses])
        return np.asarray(
            query.least.metre * ways + query.least.radian * turn + height[None, :] - height[:, None]
        )

    @cached_property
    def _ways(self) -> FloatArray:
        mission = self.mission
        points = np.array(self.poses)[:, :2]
        return shortest_ways(mission.free_map, mission.vehicle, points)

    def planned(self, start: int, goal: int, hurried: bool = False) -> bool:
        """Tell whether the route from node to node is known."""
        here, there = self.poses[start], self.poses[goal]
        known = (here, there, hurried) in self._routes
        return known or (self._symmetric and (there, here, hurried) in self._routes)

    def problem(self, start: int, goal: int, hurried: bool = False) -> PlanningProblem:
        """Return the problem of the route from node to node."""
        mission = self.mission
        cost, surfaces = self.cost(mission.payload)
        return PlanningProblem(
            mission.map, cost, self.poses[start], self.poses[goal], surfaces=surfaces,
            heights=mission.heights, objective="time" if hurried else mission.objective,
            clearance=mission.clearance,
        )  # fmt: skip

    # -- legs -------------------------------------------------------------------------------------

    def leg(self, start: int, goal: int, payload: float, hurried: bool = False) -> Leg:
        """Return the leg from node to node with a payload [kg] on board.

        It is that of least energy; in a hurry that of least time.
        """
        key = (start, goal, payload, hurried)
        if key not in self._legs:
            self._legs[key] = self._priced(self._route(start, goal, hurried), payload, hurried)
        return self._legs[key]

    def _route(self, start: int, goal: int, hurried: bool) -> Route:
        """Plan from node to node, for the payload at the start of the mission."""
        key = self.poses[start], self.poses[goal], hurried
        if key not in self._routes:
            self._routes[key] = self._planned(start, goal, hurried)
        return self._routes[key]

    def _known_routes(self) -> dict[tuple[Pose, Pose, bool], Route]:
        """Return the routes that were planned before with the same map, costs and planner."""
        return self.routes.of(self.digest)

    @property
    def digest(self) -> bytes:
        """Digest of all that decides a route but its ends."""
        mission, grid = self.mission, self.mission.map
        cost, surfaces = self.cost(mission.payload)
        grounds = () if surfaces is None else surfaces.surfaces
        areas = () if surfaces is None else surfaces.keep_out
        asked = (
            hashlib.sha256(np.packbits(grid.occupied).tobytes()).digest(),
            grid.shape, grid.resolution, tuple(grid.origin),
            _told(cost.model),
            *((shapely.to_wkb(ground.area), _told(ground.model)) for ground in grounds),
            *(shapely.to_wkb(area) for area in areas),
            _shaped(mission.heights),
            self._speed, mission.objective, mission.planner, self.planning_time,
            mission.planning_effort, mission.clearance,
        )  # fmt: skip
        return hashlib.sha256(repr(asked).encode()).digest()

    def _plan_between(self, start: int, goal: int) -> tuple[int, int]:
        """Return the nodes from and to which a route is planned.

        Where costs are symmetric, one plan serves both ways. Which one it is depends on the poses
        alone, so that a mission is the same whatever was planned on its map before.
        """
        turned = self._symmetric and self.poses[goal] < self.poses[start]
        return (goal, start) if turned else (start, goal)

    def _planned(self, start: int, goal: int, hurried: bool) -> Route:
        mission = self.mission
        here, there = self.poses[start], self.poses[goal]
        cost, _ = self.cost(mission.payload)
        still = Path(here, np.zeros(0), np.zeros(0), cost.icr.longitudinal)
        if here == there:
            return Route(still)
        if self._plan_between(start, goal) != (start, goal):
            back = self._route(goal, start, hurried)
            way = still if back.trouble else back.path.reversed()
            return Route(way, back.trouble, back.detail)
        if self._progress is not None:
            quickly = ", in a hurry" if hurried else ""
            self._progress(f"planning from {self.names[start]} to {self.names[goal]}{quickly}")
        problem = self.problem(start, goal, hurried)
        for patience in (1, 10):
            try:
                limit, effort = patience * self.planning_time, mission.planning_effort
                effort = None if effort is None else patience * effort
                return Route(plan(problem, mission.planner, limit, effort=effort).path)
            except TimeLimitError as error:
                last = str(error)
            except PlanningError as error:
                return Route(still, "no_path", str(error))
        return Route(still, "time", last)

    @property
    def planning_time(self) -> float:
        """Time for each route [s]: a free order takes about four routes a task."""
        mission = self.mission
        if mission.planning_time is not None:
            return mission.planning_time
        routes, most = (4, 0.5) if mission.order == "free" else (2, 1.0)
        return float(np.clip(_PLANNING / (routes * len(mission.tasks)), 0.1, most))

    @cached_property
    def _symmetric(self) -> bool:
        """Whether a way costs the same driven backwards, so that one plan serves both."""
        if self.mission.heights is not None:
            return False
        cost, surfaces = self.cost(self.mission.payload)
        angle = np.linspace(0.0, np.pi, 65)
        ds, turn = np.cos(angle), np.sin(angle)
        return all(
            np.allclose(c.segment_energy(ds, turn), c.segment_energy(-ds, -turn), rtol=1e-6)
            for c in ((cost,) if surfaces is None else surfaces.costs(cost))
        )

    def _priced(self, route: Route, payload: float, hurried: bool) -> Leg:
        grounds, path = self.grounds, route.path
        nothing = grounds.nothing
        if route.trouble:
            return _stuck(path, nothing, route.trouble, route.detail)
        if not len(path):
            return Leg(path, None, np.zeros(0), np.zeros(0), nothing)
        try:
            trajectory = self._timed(route, payload, hurried)
        except InfeasibleMotionError as error:
            return _stuck(path, nothing, "motor", str(error))
        return Leg(
            path,
            trajectory,
            grounds.power(trajectory, payload),
            grounds.spread(trajectory, payload),
            grounds.estimate(trajectory, payload),
        )

    def _timed(self, route: Route, payload: float, hurried: bool) -> Trajectory:
        """Return the route's trajectory, as a plan of the same route is driven."""
        mission = self.mission
        cost, surfaces = self.cost(payload)
        if hurried and cost.speed is None:
            cost = replace(cost, speed=cost.vehicle.motor.speed)
        others = () if surfaces is None else tuple(_told(s.model) for s in surfaces.surfaces)
        key = cost.speed, _told(cost.model), others
        if key not in route.timed:
            route.timed[key] = drive_path(
                route.path, cost, surfaces, mission.heights, grid=mission.free_map, period=_PERIOD
            ).trajectory
        return route.timed[key]


def _shaped(heights: HeightMap | None) -> object:
    """Return what decides a route of a height map."""
    if heights is None:
        return None
    return hashlib.sha256(heights.heights.tobytes()).digest(), heights.resolution, heights.origin


def _told(model: PowerModel) -> tuple[object, ...]:
    """Return everything about a model that decides a route."""
    values = [getattr(model.vehicle, item.name) for item in fields(model.vehicle)]
    vehicle = [v.tobytes() if isinstance(v, np.ndarray) else v for v in values]
    terms = tuple((term.name, tuple(term.params.items())) for term in model.terms)
    return terms, model.coefficients.tobytes(), tuple(vehicle)


def _stuck(path: Path, nothing: Estimate, trouble: str, detail: str) -> Leg:
    return Leg(path, None, np.zeros(0), np.zeros(0), replace(nothing, mean=np.inf), trouble, detail)


def shortest_ways(grid: OccupancyGrid, vehicle: Vehicle, points: FloatArray) -> FloatArray:
    """Return how far the robot's origin travels at least from point to point.

    The largest disc about the origin inside the footprint moves over cells that are coarse enough
    for a quick search; a coarse cell is open if the disc fits at any place in it. The way along
    eight directions is at most 1.08 times the shortest; what the cells blur is taken off.
    """
    rows, columns = grid.shape
    stride = max(int(np.ceil(np.sqrt(rows * columns / _CELLS))), 1)
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    radius = max(min(-x_min, x_max, -y_min, y_max), 0.0)
    slack = 0.71 * grid.resolution
    padded = np.pad(grid.clearance + slack >= radius, ((0, -rows % stride), (0, -columns % stride)))
    shape = (padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    open_cells = np.any(padded.reshape(shape), axis=(1, 3))
    cells = np.floor(grid.to_cells(points) / stride).astype(int)
    index = cells[:, 1] * open_cells.shape[1] + cells[:, 0]
    spacing = stride * grid.resolution
    ways = dijkstra(_graph(open_cells), directed=False, indices=index)[:, index] * spacing
    straight = np.linalg.norm(points[:, None] - points[None], axis=-1)
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
