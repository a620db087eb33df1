"""A planning problem made ready for the kernels, and their answers made into plans.

The kernels work in the frame of the point midway between the tread ICRs; `CompiledProblem`
translates.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, ModelError, PlanningError
from energyplan.path import FloatArray, Path, Pose
from energyplan.planning.problem import Plan, PlanningProblem
from energyplan.planning.scene import slopes as _slopes
from energyplan.planning.scene.motions import DIRECTIONS, LEVEL, Hills, KernelProblem
from energyplan.planning.scene.prices import Prices
from energyplan.planning.scene.rates import LeastPrices, Minorant, least_prices
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.terrain.collision import Body, pose_free

SHORT_TRACK = 1e-3
"""Radius of the pivots that stand for spins where pivots are no cheaper than spins [m]."""

MARGIN = 0.04
"""How much the footprint grows on every side while planning [cells].

Optimal paths touch obstacles. The margin keeps them free under another rounding, or cut into other
pieces, and exceeds what the collision kernels' tolerance can make of that.
"""


class Segments(NamedTuple):
    """Motions of the centre of the tread ICRs: arc lengths [m] and turns [rad]."""

    ds: FloatArray
    dtheta: FloatArray


class Ground(NamedTuple):
    """A map with its keep-out areas occupied, and the class of surface in each cell."""

    grid: OccupancyGrid
    surface: NDArray[np.uint8]


_grounds: WeakKeyDictionary[OccupancyGrid, tuple[SurfaceMap, Ground]] = WeakKeyDictionary()


def _ground(problem: PlanningProblem) -> Ground:
    """Return the ground of a problem; that of the last surfaces seen on a map is remembered."""
    grid, surfaces = problem.map, problem.surfaces
    if surfaces is None:
        return Ground(grid, np.zeros((1, 1), np.uint8))
    known = _grounds.get(grid)
    if known is None or known[0] is not surfaces:
        raster = surfaces.raster(grid)
        if raster.max() > 255:
            raise InvalidInputError("there are more than 255 surfaces; merge those of one model")
        kept = grid.with_blocked(surfaces.keep_out) if surfaces.keep_out else grid
        known = surfaces, Ground(kept, raster.astype(np.uint8))
        _grounds[grid] = known
    return known[1]


@dataclass(frozen=True)
class CompiledProblem:
    """A problem, priced and translated for the kernels."""

    problem: PlanningProblem

    def __post_init__(self) -> None:
        self.problem.check_poses(self.grid)

    # -- prices ---------------------------------------------------------------------------------

    @cached_property
    def rays(self) -> FloatArray:
        """Unit vectors of the plane ``(ds, C dtheta)``, shape (DIRECTIONS + 1, 2)."""
        angle = np.arange(DIRECTIONS + 1) * (2 * np.pi / DIRECTIONS)
        rays = np.column_stack([np.cos(angle), np.sin(angle)])
        return np.where(np.abs(rays) < 1e-15, 0.0, rays)

    @cached_property
    def objective(self) -> Prices:
        """What the objective makes of motions."""
        return Prices(self.problem.cost, self.problem.surfaces, self.problem.objective)

    @cached_property
    def costs(self) -> tuple[EnergyCost, ...]:
        """Costs of the classes of surface; the problem's own is the first."""
        return self.objective.costs

    @cached_property
    def steepest(self) -> float:
        """Steepest slope that the robot can be on, as rise over run; zero on level ground."""
        problem = self.problem
        if problem.heights is None:
            return 0.0
        _slopes.check_models(self.costs, problem.surfaces)
        (x_min, y_min), (x_max, y_max) = problem.robot.footprint.tolist()
        ahead = problem.cost.icr.longitudinal
        radius = max(min(ahead - x_min, x_max - ahead, -y_min, y_max), 0.0)
        return _slopes.steepest(self.grid, problem.heights, radius)

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map, with what must be kept out of occupied."""
        return _ground(self.problem).grid

    @cached_property
    def _priced(self) -> _slopes.Priced:
        """Prices of the rays for all classes of surface and all slopes."""
        half = self.problem.cost.half_track
        ds, dtheta = self.reference(self.rays[:, 0], self.rays[:, 1] / half)
        if self.steepest > _slopes.FLAT:
            travel = np.abs(self.rays[:, 0])
            return _slopes.priced(self.objective, ds, dtheta, travel, self.steepest)
        prices = [self.objective.motion(ds, dtheta, k) for k in range(len(self.costs))]
        return _slopes.Priced(np.array(prices), 0.0)

    @property
    def prices(self) -> FloatArray:
        """Price of the rays, shape (classes * slopes, DIRECTIONS + 1)."""
        return self._priced.kept

    def worth(self, pose: Pose) -> float:
        """Return what the height at a pose is worth; only differences mean something."""
        heights, ahead = self.problem.heights, self.problem.cost.icr.longitudinal
        if heights is None:
            return 0.0
        point = pose.x + ahead * np.cos(pose.yaw), pose.y + ahead * np.sin(pose.yaw)
        return self._priced.worth * float(heights.height(point))

    def potential(self, goal: Pose) -> float:
        """Return what the height of a goal above the start adds to the cost of every path."""
        return self.worth(goal) - self.worth(self.problem.start)

    @cached_property
    def least_prices(self) -> LeastPrices:
        """What motions cost at least on any ground and slope."""
        sloping = self.steepest > _slopes.FLAT
        return least_prices(self.objective, self.steepest if sloping else 0.0, self._priced.worth)

    @property
    def least(self) -> Minorant:
        """What motions cost at least, metres and radians apart, less what the rise is worth."""
        return self.least_prices.minorant(0.0)

    @cached_property
    def steering(self) -> Minorant:
        """The static cost that steering solves exactly: the greatest one below all prices."""
        half = self.problem.cost.half_track
        eighth, quarter = DIRECTIONS // 8, DIRECTIONS // 4
        level = self.prices[self.hills.bins // 2]
        pivot, spin, straight = level[eighth] * np.sqrt(2), level[quarter], level[0]
        # where a pivot costs clearly more than a spin, turning and driving are paid apart
        track = half if pivot - spin < 0.5 * straight else SHORT_TRACK
        found = self.least_prices.minorant(track)
        if not found.metre > 0:
            raise ModelError("the objective makes some motion free; give energy or time a weight")
        return found

    @cached_property
    def hills(self) -> Hills:
        """The heights as the kernels see them."""
        heights = self.problem.heights
        if heights is None or not self.steepest > _slopes.FLAT:
            return LEVEL
        cells, several = 0.5 * self.grid.resolution, len(self.costs) > 1
        return Hills(
            heights=heights.heights,
            x=heights.origin.x,
            y=heights.origin.y,
            cos=float(np.cos(heights.origin.yaw)),
            sin=float(np.sin(heights.origin.yaw)),
            resolution=float(heights.resolution),
            lateral=float(self.problem.cost.icr.centre[1]),
            steepest=self.steepest,
            bins=_slopes.BINS,
            piece=cells if several else max(cells, 0.5 * heights.resolution),
        )

    @property
    def grown(self) -> Body:
        """The footprint with the margin of planning, seen from the centre of the tread ICRs."""
        c_x, c_y = self.problem.cost.icr.centre
        (x_min, y_min), (x_max, y_max) = self.problem.robot.footprint.tolist()
        grow = MARGIN * self.grid.resolution
        return Body(x_min - c_x - grow, y_min - c_y - grow, x_max - c_x + grow, y_max - c_y + grow)

    def roomy(self, pose: Pose) -> bool:
        """Tell whether a pose is free with the margin of planning."""
        return bool(pose_free(self.grid.space, self.grown, *self.centre(pose)))

    @cached_property
    def setting(self) -> KernelProblem:
        """The problem as the kernels see it."""
        problem = self.problem
        c_x, c_y = problem.cost.icr.centre
        (x_min, y_min), (x_max, y_max) = problem.robot.footprint.tolist()
        body = Body(x_min - c_x, y_min - c_y, x_max - c_x, y_max - c_y)
        if all(self.roomy(pose) for pose in (problem.start, problem.goal)):
            body = self.grown
        surface = _ground(problem).surface
        if self.hills.bins > 1 and surface.size == 1:
            surface = np.zeros(self.grid.shape, np.uint8)
        static = self.steering
        start, goal = self.centre(problem.start), self.centre(problem.goal)
        return KernelProblem(
            space=self.grid.space,
            body=body,
            prices=self.prices,
            surface=surface,
            hills=self.hills,
            steering=np.array(
                [
                    0.0,
                    static.track,
                    0.0,
                    0.0,
                    static.metre,
                    static.metre * static.track + static.radian,
                ]
            ),
            half_track=problem.cost.half_track,
            reach=float(np.hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))),
            least_metre=self.least.metre,
            least_radian=self.least.radian,
            start_x=start.x,
            start_y=start.y,
            start_yaw=start.yaw,
            goal_x=goal.x,
            goal_y=goal.y,
            goal_yaw=goal.yaw,
        )

    # -- translation ----------------------------------------------------------------------------

    def centre(self, pose: Pose) -> Pose:
        """Return the pose of the centre of the tread ICRs, given that of the body frame."""
        c_x, c_y = self.problem.cost.icr.centre
        c, s = np.cos(pose.yaw), np.sin(pose.yaw)
        return Pose(float(pose.x + c * c_x - s * c_y), float(pose.y + s * c_x + c * c_y), pose.yaw)

    def reference(self, ds: FloatArray, dtheta: FloatArray) -> Segments:
        """Return motions of `Path`'s reference point, given those of the centre."""
        return Segments(ds + self.problem.cost.icr.centre[1] * dtheta, dtheta)

    def path(self, segments: Segments) -> Path:
        """Return the path that starts at the problem's start.

        Raises
        ------
        PlanningError
            If it is not free, which would be an error of the library.
        """
        problem = self.problem
        for motions in (merged(segments), segments):
            moved = self.reference(motions.ds, motions.dtheta)
            path = Path(problem.start, moved.ds, moved.dtheta, problem.cost.icr.longitudinal)
            if self.grid.path_free(path, problem.robot):
                return path
        where = path.vertices[self.grid.first_collision(path, problem.robot) or 0]
        raise PlanningError(
            f"the planned path is not free near {where.round(3).tolist()}; please report this map"
        )

    def drivable(self, paths: Iterable[Path]) -> list[Path]:
        """Return those of some paths that can be driven from start to goal."""
        problem = self.problem
        wanted = np.array([problem.start, problem.goal])
        kept = []
        for path in paths:
            miss = np.array([path.start, path.end]) - wanted
            miss[:, 2] = np.remainder(miss[:, 2] + np.pi, 2 * np.pi) - np.pi
            fits = np.abs(miss).max() <= 1e-6 and path.longitudinal == problem.cost.icr.longitudinal
            if fits and self.grid.path_free(path, problem.robot):
                kept.append(path)
        return kept

    # -- result ---------------------------------------------------------------------------------

    def plan(self, path: Path, bound: float, begun: float, first: float, planner: str) -> Plan:
        """Return a plan, everything in it computed anew from its path.

        Parameters
        ----------
        path : Path
            The path.
        bound : float
            Lower bound on the objective, less what the height of the goal adds to it.
        begun, first : float
            Readings of `time.perf_counter` when planning began and when a first plan was known.
        planner : str
            Name of the planner.

        Returns
        -------
        Plan
            The plan.
        """
        cost, surfaces, heights = (
            self.problem.cost, self.problem.surfaces, self.problem.heights
        )  # fmt: skip
        timed = all(c.speed is not None or np.isfinite(c.vehicle.motor.speed) for c in self.costs)
        if heights is not None:
            pieces = heights.pieces(path, cost, surfaces)
            breakdown = total_by_term(p.cost.breakdown(p.path, p.slope) for p in pieces)
            energy = sum(breakdown.values())
            duration = sum(p.cost.duration(p.path) for p in pieces) if timed else np.nan
        elif surfaces is None:
            energy, breakdown = cost.energy(path), cost.breakdown(path)
            duration = cost.duration(path) if timed else np.nan
        else:
            energy, breakdown = surfaces.energy(path, cost), surfaces.breakdown(path, cost)
            duration = surfaces.duration(path, cost) if timed else np.nan
        value = self.objective.value(energy, path.length, duration)
        potential = self.potential(self.problem.goal)
        excess = value - potential
        bound = min(bound, excess)
        return Plan(
            path=path,
            energy=energy,
            lower_bound=potential + bound,
            gap=excess / bound - 1.0 if bound > 0 else 0.0,
            cost=value,
            length=path.length,
            turning=path.turning,
            duration=duration,
            planning_time=time.perf_counter() - begun,
            first_time=first - begun,
            planner=planner,
            breakdown=breakdown,
            potential=potential,
        )


def total_by_term(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Add up breakdowns."""
    total: dict[str, float] = {}
    for part in parts:
        for name, joules in part.items():
            total[name] = total.get(name, 0.0) + joules
    return total


def merged(segments: Segments) -> Segments:
    """Join neighbouring motions of one curvature and direction, and drop those that are nothing."""
    out_ds: list[float] = []
    out_turn: list[float] = []
    for ds, turn in zip(segments.ds.tolist(), segments.dtheta.tolist(), strict=True):
        if abs(ds) < 1e-12 and abs(turn) < 1e-12:
            continue
        if out_ds:
            last_ds, last_turn = out_ds[-1], out_turn[-1]
            parallel = abs(ds * last_turn - turn * last_ds) <= 1e-12 * (abs(ds) + abs(turn))
            if parallel and ds * last_ds + turn * last_turn > 0:
                out_ds[-1] = last_ds + ds
                out_turn[-1] = last_turn + turn
                continue
        out_ds.append(ds)
        out_turn.append(turn)
    return Segments(np.array(out_ds), np.array(out_turn))
