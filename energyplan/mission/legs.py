"""From place to place: planned once, timed within the limits, priced for the payload on board.

The robot on its way is the other half: charge, time and payload after each stop, expected and at
the bound.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import InfeasibleMotionError, PlanningError, TimeLimitError
from energyplan.mission.energy import Estimate, Grounds
from energyplan.mission.types import Charger, Mission, Task
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

_TOGETHER = 8
"""Most places whose ways to all others are found in one call."""

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

    A route is told apart by the map, the costs and the planner that decide it.
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
        places: list[Task | Charger] = [*mission.tasks, *mission.chargers]
        self.poses: list[Pose] = [mission.start, *(place.pose for place in places)]
        self.names = ["start", *(place.name for place in places)]
        self.home = 0
        if home != mission.start:
            self.home = len(self.poses)
            self.poses.append(home)
            self.names.append("home")
        self._legs: dict[tuple[int, int, float, bool], Leg] = {}
        self._bounds: dict[float, FloatArray] = {}
        self._costs: dict[tuple[float, bool], tuple[EnergyCost, SurfaceMap | None]] = {}
        self._routes = self.routes.of(self.digest)

    def under(self, mission: Mission) -> Legs:
        """Return these legs for a mission that differs in battery, charge, reserve or speed."""
        other = copy(self)
        other.mission = mission
        other.grounds = self.grounds.under(mission)
        if mission.speed != self.mission.speed:
            # The routes stay; times and energies change.
            other._legs, other._costs = {}, {}
        return other

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
            speed, surfaces = self.mission.tread_speed, self.mission.surfaces

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
        height = np.array([query.height_potential(pose) for pose in self.poses])
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
            self.mission.tread_speed, mission.objective, mission.planner, self.planning_time,
            mission.planning_effort, mission.clearance,
        )  # fmt: skip
        return hashlib.sha256(repr(asked).encode()).digest()

    def _planned(self, start: int, goal: int, hurried: bool) -> Route:
        mission = self.mission
        here, there = self.poses[start], self.poses[goal]
        cost, surfaces = self.cost(mission.payload)
        still = Path(here, np.zeros(0), np.zeros(0), cost.icr.longitudinal)
        if here == there:
            return Route(still)
        if self._symmetric and there < here:
            # one plan serves both ways; which one it is depends on the poses alone, so that a
            # mission is the same whatever was planned on its map before
            back = self._route(goal, start, hurried)
            way = still if back.trouble else back.path.reversed()
            return Route(way, back.trouble, back.detail)
        if self._progress is not None:
            quickly = ", in a hurry" if hurried else ""
            self._progress(f"planning from {self.names[start]} to {self.names[goal]}{quickly}")
        problem = PlanningProblem(
            mission.map, cost, here, there, surfaces=surfaces, heights=mission.heights,
            objective="time" if hurried else mission.objective, clearance=mission.clearance,
        )  # fmt: skip
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
        path, trouble, detail = route.path, route.trouble, route.detail
        if not trouble and len(path):
            try:
                trajectory = self._timed(route, payload, hurried)
                return Leg(path, trajectory, *self.grounds.priced(trajectory, payload))
            except InfeasibleMotionError as error:
                trouble, detail = "motor", str(error)
        energy = replace(self.grounds.nothing, mean=np.inf if trouble else 0.0)
        return Leg(path, None, np.zeros(0), np.zeros(0), energy, trouble, detail)

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
    graph = _graph(open_cells)
    few = range(0, len(index), _TOGETHER)  # SciPy holds Python's lock all the while
    found = [
        dijkstra(graph, directed=False, indices=index[k : k + _TOGETHER])[:, index] for k in few
    ]
    ways = np.concatenate(found) * spacing
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


_STEP = 30.0
_MOST_STEPS = 10_000  # of one stay: three days in steps of that length, and longer ones beyond
_PARTS = 300
_HOURS = 48
_ROUNDING = 1e-9
_GRAM = 1e-3
_INSTANT = 1e-6


class Charge(NamedTuple):
    """The battery at one instant."""

    soc: float  # state of charge
    polarisation: float = 0.0  # voltage of its RC pair [V]
    failure: str = "none"  # why it gave up on the way
    instant: float = np.inf  # when it gave up [s]
    load: float = 0.0  # power under which it gave up [W]


@dataclass(frozen=True)
class Segment:
    """A stretch of the mission: a drive, a stay or a charge."""

    kind: str  # what the robot does
    goal: int  # node at its end
    t: FloatArray  # (n,): time [s]
    power: FloatArray  # (n,): power from each time to the next [W]
    soc: FloatArray  # (n,): state of charge as expected
    soc_lower: FloatArray  # (n,): state of charge where the energy is at its bound
    leg: Leg | None = None  # the drive


@dataclass(frozen=True)
class State:
    """Where the robot stands."""

    node: int  # place
    payload: float  # payload [kg]
    time: float  # time as expected [s]
    lateness: FloatArray  # (n,): how the time changes with each shared unknown [s]
    spent: Estimate
    total: Estimate
    origin: tuple[float, float]  # state of charge and time after the last charge
    expected: Charge  # the battery as expected
    worst: Charge  # the battery where the energy is at its bound
    pieces: tuple[Segment, ...] = ()  # what it did so far
    stretches: tuple[Estimate, ...] = ()  # what was spent between one charge and the next, so far

    @property
    def time_spread(self) -> float:
        """Standard deviation of the time [s]."""
        return float(np.linalg.norm(self.lateness))


class Attempt(NamedTuple):
    """What comes of a task."""

    reason: str
    after: State  # when it is done
    safe: State  # at the nearest safe place after it
    detail: str = ""  # why not, in one sentence
    begin: float = np.nan  # when it begins at the bound [s]


class Walk:
    """Steps from state to state."""

    def __init__(
        self, legs: Legs, taken: Mapping[int, Sequence[tuple[float, float]]] | None = None
    ) -> None:
        self.legs = legs
        self.taken = dict(taken or {})  # when chargers are taken by others [s], ascending
        self.mission: Mission = legs.mission
        self.quantile = NormalDist().inv_cdf(self.mission.confidence)

    @property
    def start(self) -> State:
        """The condition at the start."""
        mission, nothing = self.mission, self.legs.grounds.nothing
        told, least = Charge(mission.soc), Charge(self.at_least(mission.soc))
        gauge, origin = self.legs.grounds.gauge, (mission.soc, mission.time)
        known = np.zeros(self.legs.grounds.size)
        return State(0, mission.payload, mission.time, known, gauge, nothing, origin, told, least)

    def at_least(self, soc: float) -> float:
        """Return the state of charge at the bound when the gauge tells one."""
        return max(soc - self.quantile * self.mission.spreads.soc, 0.0)

    def _told(self, soc: float) -> float:
        """Return what the gauge tells when the state of charge is at the bound."""
        return min(soc + self.quantile * self.mission.spreads.soc, 1.0)

    def latest(self, state: State) -> float:
        """Return the time of a condition at the bound [s]."""
        return state.time + self.quantile * state.time_spread

    def holds(self, state: State) -> bool:
        """Tell whether the reserve is left at the bound."""
        enough = state.worst.soc >= self.mission.reserve - _ROUNDING
        return enough and state.worst.failure == "none"

    # -- steps ------------------------------------------------------------------------------------

    def drive(self, state: State, goal: int, hurried: bool = False) -> State | None:
        """Drive to a place, quickly if in a hurry; None where the leg cannot be driven."""
        leg = self.legs.leg(state.node, goal, state.payload, hurried)
        if leg.trouble:
            return None
        if leg.trajectory is None:
            return replace(state, node=goal)
        moved = self._draw(
            state, "drive", goal, leg.trajectory.t, leg.power, leg.spread, leg.energy, leg
        )
        late = state.lateness + self.legs.grounds.driving_time(leg.duration)
        return replace(moved, node=goal, lateness=late)

    @cached_property
    def stations(self) -> tuple[int, ...]:
        """Nodes of the chargers at which the battery takes charge."""
        told = zip(self.legs.chargers, self.mission.chargers, strict=True)
        return tuple(node for node, one in told if not self.mission.charging_fault(one))

    def wait(self, state: State, duration: float) -> State:
        """Stand still for so long [s]."""
        region = self.legs.region(state.node)
        energy = self.legs.grounds.idle(region, duration, state.payload)
        return self._stay(state, "wait", duration, energy)

    def wait_until(self, state: State, time: float) -> State:
        """Stand still until a time [s]; who is there before it in any case is no longer late."""
        latest = self.latest(state)
        if state.time >= time:
            return state
        late = max(latest - time, 0.0) / max(latest - state.time, _INSTANT)
        return replace(self.wait(state, time - state.time), lateness=late * state.lateness)

    def _stay(self, state: State, kind: str, duration: float, energy: Estimate) -> State:
        """Stand still for so long [s], which takes an energy."""
        if duration <= _INSTANT:
            return state
        t = np.linspace(0.0, duration, int(min(max(duration / _STEP, 1), _MOST_STEPS)) + 1)
        flat = np.full(len(t) - 1, energy.mean / duration)
        return self._draw(state, kind, state.node, t, flat, np.ones(len(flat)), energy)

    def _draw(
        self,
        state: State,
        kind: str,
        goal: int,
        t: FloatArray,
        power: FloatArray,
        spread: FloatArray,
        energy: Estimate,
        leg: Leg | None = None,
    ) -> State:
        spent = state.spent + self.legs.grounds.from_battery(energy)
        more = spent.upper(self.quantile) - state.spent.upper(self.quantile)
        # what it may take beyond the expectation is drawn where the power is uncertain
        shares = spread if spread.any() else np.ones(len(spread))
        raised = power + (more - energy.mean) * shares / float(shares @ np.diff(t))
        clock = state.time + t - t[0]
        expected, soc = self._run(state.expected, clock, power)
        worst, soc_lower = self._run(state.worst, clock, raised)
        piece = Segment(kind, goal, clock, np.append(power, power[-1]), soc, soc_lower, leg)
        return replace(
            state,
            time=float(clock[-1]),
            spent=spent,
            total=state.total + energy,
            expected=expected,
            worst=worst,
            pieces=(*state.pieces, piece),
        )

    def _run(self, charge: Charge, t: FloatArray, power: FloatArray) -> tuple[Charge, FloatArray]:
        run = self.mission.battery.simulate(
            t, np.append(power, 0.0), soc=charge.soc, polarisation=charge.polarisation
        )
        after = charge._replace(soc=run.soc_end, polarisation=run.polarisation)
        if charge.failure == "none" and run.reason != "none":
            load = power[min(int(np.searchsorted(t, run.brown_out, "right")), len(power)) - 1]
            after = after._replace(failure=run.reason, instant=run.brown_out, load=float(load))
        return after, run.soc

    def charge(self, state: State, leave_by: float = np.inf) -> State:
        """Charge at the charger at hand until it suffices, or until it is time to leave [s]."""
        charger = self.mission.chargers[state.node - self.legs.chargers[0]]
        low = self._charge(state.worst, charger, self.at_least(charger.until))
        high = self._charge(state.expected, charger, charger.until)
        gauge = self.legs.grounds.gauge
        enough = high[0][-1]
        last = min(max(low[0][-1], enough), leave_by - state.time)
        if last <= _INSTANT:
            return state
        t = np.unique(np.append(np.concatenate([low[0], high[0]]), last))
        t = t[t <= last]
        filled = [np.interp(t, *one) for one in (high, low)]
        power = np.where(t < min(enough, t[-1]), -charger.power, 0.0)
        t = state.time + t
        piece = Segment("charge", state.node, t, power, filled[0], filled[1])
        low_end, high_end = (Charge(float(s[-1])) for s in (filled[1], filled[0]))
        return replace(
            state,
            time=float(t[-1]),
            spent=gauge,
            origin=(self._told(low_end.soc), float(t[-1])),
            stretches=(*state.stretches, state.spent),
            expected=high_end,
            worst=low_end,
            pieces=(*state.pieces, piece),
        )

    def _charge(
        self, charge: Charge, charger: Charger, until: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return times since charging began and charges, until it suffices or rises no more."""
        battery, power = self.mission.at_charger(charger), charger.power
        t, soc = [0.0], [charge.soc]
        steps = _STEP * np.arange(int(3600 / _STEP) + 1)
        for _ in range(_HOURS):
            begun = soc[-1]
            if begun >= until:
                break
            run = battery.simulate(steps, np.full(len(steps), -power), soc=begun)
            reached = np.flatnonzero(run.soc >= until)
            stop = int(reached[0]) if len(reached) else len(steps)
            hour = t[-1]
            t.extend(hour + steps[1:stop])
            soc.extend(run.soc[1:stop])
            if len(reached):
                # the last step ends when it suffices
                short = np.linspace(0.0, _STEP, _PARTS + 1)
                run = battery.simulate(
                    short, np.full(len(short), -power), soc=float(run.soc[stop - 1])
                )
                # the shorter steps need not get there by the last bit
                enough = np.flatnonzero(run.soc >= until)
                end = int(enough[0]) if len(enough) else _PARTS
                t.append(hour + steps[stop - 1] + short[end])
                soc.append(until)
            elif run.soc_end - begun < 1e-3:
                break
        return np.array(t), np.array(soc)

    # -- tasks ------------------------------------------------------------------------------------

    def attempt(self, state: State, task: int, hurried: bool = False) -> Attempt:
        """Try a task without charging before it."""
        asked, node = self.mission.tasks[task], task + 1
        there = self.drive(state, node, hurried)
        if there is None:
            leg = self.legs.leg(state.node, node, state.payload, hurried)
            return Attempt(leg.trouble, state, state, leg.detail)
        grounds, region = self.legs.grounds, self.legs.region(node)
        lost = grounds.waiting(region, task, there.payload)
        there = self._stay(there, "wait", self.mission.waiting, lost)
        there = replace(there, lateness=there.lateness + grounds.waiting_time(task))
        latest = self.latest(there)
        if latest > asked.window[1]:
            expected = f", {there.time:.0f} s as expected" if latest > there.time + 0.5 else ""
            return Attempt(
                "late",
                there,
                there,
                f"it must begin by {asked.window[1]:.0f} s, and the robot is there at "
                f"{latest:.0f} s{expected}",
            )
        begun = self.wait_until(there, asked.window[0])
        work = grounds.work(region, task, begun.payload)
        done = self._stay(begun, "work", asked.dwell, work)
        done = replace(done, lateness=done.lateness + grounds.dwell_time(task))
        carried = done.payload + asked.payload
        if carried < -_GRAM:
            return Attempt(
                "payload",
                done,
                done,
                f"it leaves {-asked.payload:g} kg, and {done.payload:g} kg are on board",
            )
        done = replace(done, payload=max(carried, 0.0))
        safe, trouble = self.refuge(done)
        if safe is None:
            return Attempt(trouble.trouble, done, done, f"no way back: {trouble.detail}")
        if not self.holds(safe):
            return Attempt("battery", done, safe, self._why_not(safe))
        return Attempt("none", done, safe, begin=max(latest, asked.window[0]))

    @property
    def timed(self) -> bool:
        """Whether windows end, so that being late is possible."""
        return any(np.isfinite(task.window[1]) for task in self.mission.tasks)

    @property
    def ways(self) -> tuple[bool, ...]:
        """Whether to hurry: no, or both where windows press.

        Where no window ends a quicker way that takes more helps nothing: with the way of least
        energy in its place all that follows can be done with more charge, later.
        """
        return (False, True) if self.timed else (False,)

    def leave_by(self, state: State, stops: Sequence[int], hurried: Sequence[bool] = ()) -> float:
        """Return when to leave a place at the latest so that no later window is missed."""
        tasks, grounds = self.mission.tasks, self.legs.grounds
        ways = (*hurried, *(False for _ in stops[len(hurried) :]))
        node, payload, spent, late, latest = state.node, state.payload, 0.0, state.lateness, np.inf
        for stop, quick in zip(stops, ways, strict=True):
            leg = self.legs.leg(node, stop, payload, quick)
            if leg.trouble:
                return -np.inf
            spent, late = spent + leg.duration, late + grounds.driving_time(leg.duration)
            if stop <= len(tasks):
                task = tasks[stop - 1]
                spent, late = spent + self.mission.waiting, late + grounds.waiting_time(stop - 1)
                margin = self.quantile * float(np.linalg.norm(late))
                latest = min(latest, task.window[1] - margin - spent)
                spent, late = spent + task.dwell, late + grounds.dwell_time(stop - 1)
                payload = max(payload + task.payload, 0.0)
            node = stop
        return float(latest)

    def follow(
        self, state: State, stops: Sequence[int], hurried: Sequence[bool], then: int | None = None
    ) -> State | None:
        """Do tasks and charge in the order of some stops; None where that cannot be done.

        Charges end in time for the windows of the stops and of one that comes `then`.
        """
        rest = (*stops, *(() if then is None else (then,)))
        for k, (stop, quick) in enumerate(zip(stops, hurried, strict=True)):
            if stop in self.legs.chargers:
                docked = self.dock(state, stop, quick)
                if docked is None:
                    return None
                leave = self.leave_by(docked, rest[k + 1 :], hurried[k + 1 :])
                state = self.charge(docked, leave)
            else:
                attempt = self.attempt(state, stop - 1, quick)
                if attempt.reason != "none":
                    return None
                state = attempt.after
        return state

    def dock(self, state: State, charger: int, hurried: bool = False) -> State | None:
        """Drive to a charger and wait until it is free; None where the battery does not last."""
        docked = self.drive(state, charger, hurried)
        if docked is None or not self.holds(docked):
            return None
        for begin, end in self.taken.get(charger, ()):
            if begin < self.charge(docked).time and docked.time < end:
                docked = self.wait_until(docked, end)
        return docked if self.holds(docked) else None

    def missing(self, attempt: Attempt) -> tuple[bool, float]:
        """Sort what works by energy before what does not by what is missing."""
        if attempt.reason == "none":
            return False, attempt.after.total.mean
        return True, self.shortfall(attempt.safe) if attempt.reason == "battery" else np.inf

    def refuge(self, state: State) -> tuple[State | None, Leg]:
        """Drive to the nearest safe place: home or a charger."""
        return self._nearest(state, (self.legs.home, *self.legs.chargers))

    @property
    def ends(self) -> list[int]:
        """Where the mission may end."""
        rule = self.mission.return_to
        ends = [] if rule == "charger" else [self.legs.home]
        return ends if rule == "start" else [*ends, *self.legs.chargers]

    def arrives(self, state: State | None) -> State | None:
        """Drive to where the mission may end; None where the battery does not last for it."""
        last = None if state is None else self._nearest(state, tuple(self.ends))[0]
        return last if last is not None and self.holds(last) else None

    def _nearest(self, state: State, places: tuple[int, ...]) -> tuple[State | None, Leg]:
        """Drive to the place of least energy; routes that cannot be the least are not planned."""
        bounds = self.legs.lower_bounds(state.payload)[state.node]
        first, *others = sorted(places, key=lambda place: float(bounds[place]))
        goal, best = first, self.legs.leg(state.node, first, state.payload)
        for place in others:
            if best.energy.mean <= bounds[place]:
                break
            leg = self.legs.leg(state.node, place, state.payload)
            if leg.energy.mean < best.energy.mean:
                goal, best = place, leg
        return self.drive(state, goal), best

    # -- shortfall --------------------------------------------------------------------------------

    def shortfall(self, safe: State) -> float:
        """Energy that is missing at a safe place to keep the reserve [J].

        Nothing is missing where the battery holds the energy but not the power.
        """
        soc, since = safe.origin
        need = safe.spent.upper(self.quantile)
        mean = max(need / max(safe.time - since, 1.0), 1.0)
        levels = [soc, self.mission.reserve, safe.worst.soc]
        stored = self.mission.battery.usable_energy(mean, levels)
        if stored[0] == 0 and safe.worst.failure in SAGS:
            return 0.0
        by_soc = stored[1] - stored[2] if safe.worst.failure == "none" else 0.0
        return float(max(need - (stored[0] - stored[1]), by_soc, 0.0))

    def lacks_power(self, safe: State) -> bool:
        """Tell whether the battery holds the energy, and what it cannot deliver is the power."""
        return safe.worst.failure in SAGS and self.shortfall(safe) == 0

    def _why_not(self, safe: State) -> str:
        need, missing = safe.spent.upper(self.quantile), self.shortfall(safe)
        worst = safe.worst
        if self.lacks_power(safe):
            return f"{SAGS[worst.failure]} at {worst.instant:.0f} s under {worst.load:.0f} W"
        told = (
            f"with the way back to {self.legs.names[safe.node]} it may take "
            f"{need / 3600:.0f} Wh, {missing / 3600:.0f} Wh more than there is above the reserve"
        )
        faults = map(self.mission.charging_fault, self.mission.chargers)
        return "; ".join((told, *dict.fromkeys(filter(None, faults))))


SAGS = {
    "voltage": "the voltage sags below cut-off",
    "current": "the battery would have to deliver more current than it may",
}
