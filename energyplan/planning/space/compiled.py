"""A planning problem translated for the kernels, and their motions translated into paths.

The kernels work in the frame of the point midway between the tread ICRs, or, where length is all
that counts, of the path's reference point; `CompiledProblem` translates.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import ModelError, PlanningError
from energyplan.path import FloatArray, Path, Pose, point_ahead
from energyplan.planning.driven import DrivenPath
from energyplan.planning.problem import PlanningProblem, is_length
from energyplan.planning.space import prices as _prices
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.motions import DIRECTIONS, LEVEL, Hills, KernelProblem, free_energy
from energyplan.planning.space.prices import LeastPrices, Minorant, Prices, least_prices
from energyplan.terrain import OccupancyGrid, Terrain
from energyplan.terrain.collision import Body, pose_free
from energyplan.terrain.terrain import MOST_CLASSES

SHORT_TRACK = 1e-3
"""Radius of the pivots that replace spins where pivots are no cheaper than spins [m]."""

MARGIN = 0.04
"""How much the footprint grows on every side while planning [cells].

Optimal paths touch obstacles. The margin keeps them free under another rounding or
subdivision, and exceeds the effect of the collision kernels' tolerance.
"""

LEVELS = 32  # levels that the costs of a costmap are rounded to while searching, at most


class Segments(NamedTuple):
    """Motions of the centre that the kernels follow: arc lengths [m] and turns [rad]."""

    ds: FloatArray
    dtheta: FloatArray


@dataclass(frozen=True)
class CompiledProblem:
    """A problem, priced and translated for the kernels."""

    problem: PlanningProblem  # the problem, with what clearance its ends have
    whole: PlanningProblem | None = None  # the same with all its clearance, where that is more

    def __post_init__(self) -> None:
        self.problem.check_poses()

    @property
    def strict(self) -> PlanningProblem:
        """The problem with all its clearance, at its ends as well."""
        return self.whole or self.problem

    @cached_property
    def middle(self) -> tuple[float, float]:
        """The point that the kernels follow, in the body frame [m]."""
        icr = self.problem.cost.icr
        problem = self.problem
        limited = max(problem.radii) > 0 or not problem.robot.reverse
        about_treads = not is_length(problem) or limited
        return icr.longitudinal, float(icr.centre[1]) if about_treads else 0.0

    @cached_property
    def leading(self) -> CompiledProblem:
        """The problem of the first plan: that of least energy, even for the shortest path."""
        if not is_length(self.problem):
            return self
        whole = None if self.whole is None else replace(self.whole, objective="energy")
        energy = CompiledProblem(replace(self.problem, objective="energy"), whole)
        try:
            _ = energy.setting
        except ModelError:  # downhill some motion may be free
            return self
        return energy

    @cached_property
    def shortest(self) -> CompiledProblem:
        """The problem of the shortest path."""
        whole = None if self.whole is None else self.whole.shortest
        return CompiledProblem(self.problem.shortest, whole)

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
        _prices.check_models(self.costs, problem.surfaces)
        (x_min, y_min), (x_max, y_max) = problem.robot.footprint.tolist()
        ahead = problem.cost.icr.longitudinal
        radius = max(min(ahead - x_min, x_max - ahead, -y_min, y_max), 0.0)
        return _prices.steepest(self.grid, problem.heights, radius)

    @property
    def terrain(self) -> Terrain:
        """The ground."""
        return self.problem.terrain

    @property
    def grid(self) -> OccupancyGrid:
        """The map, with what must be kept out of occupied."""
        return self.terrain.obstacles

    @cached_property
    def _priced(self) -> _prices.SlopeTable:
        """Prices of the rays for all classes of surface and all slopes."""
        half = self.problem.cost.half_track
        ds, dtheta = self.reference(self.rays[:, 0], self.rays[:, 1] / half)
        if self.steepest > _prices.FLAT:
            travel = np.abs(self.rays[:, 0])
            return _prices.priced(self.objective, ds, dtheta, travel, self.steepest, self.yaws)
        level = np.zeros((1, 1)) if self.yaws is None else 0.0 * self.yaws
        grounds = range(len(self.costs))
        prices = [self.objective.motion(ds, dtheta, k, yaw=self.yaws) + level for k in grounds]
        return _prices.SlopeTable(np.concatenate(prices), 0.0)

    @cached_property
    def yaws(self) -> FloatArray | None:
        """Headings of the price table, shape (headings, 1); None where none matters [rad]."""
        if not any(cost.of_heading for cost in self.costs):
            return None
        sloping = self.steepest > _prices.FLAT
        count = _prices.SLOPING_HEADINGS if sloping else _prices.HEADINGS
        return np.asarray(np.arange(count)[:, None] * (2.0 * np.pi / count))

    @cached_property
    def prices(self) -> FloatArray:
        """Price of the rays, shape (classes * headings * slopes, DIRECTIONS + 1)."""
        kept = self._priced.kept
        if self._levels == 1:
            return kept
        half = self.problem.cost.half_track
        metres = np.abs(self.reference(self.rays[:, 0], self.rays[:, 1] / half).ds)
        soft = np.linspace(0.0, self.problem.costmap_weight, self._levels)[:, None] * metres
        by_class = kept.reshape(len(self.costs), 1, -1, DIRECTIONS + 1)
        return np.ascontiguousarray((by_class + soft[:, None]).reshape(-1, DIRECTIONS + 1))

    @property
    def height_price(self) -> float:
        """What a metre of height adds to the cost of every path."""
        return self._priced.height_price

    def height_potential(self, pose: Pose) -> float:
        """Return the potential of the height at a pose; only differences mean something."""
        if self.terrain.heights is None:
            return 0.0
        point = point_ahead(pose, self.problem.cost.icr.longitudinal)
        return self.height_price * float(self.terrain.height_at(point))

    def potential(self, goal: Pose) -> float:
        """Return what the height of a goal above the start adds to the cost of every path."""
        return self.height_potential(goal) - self.height_potential(self.problem.start)

    @cached_property
    def least_prices(self) -> LeastPrices:
        """What motions cost at least on any ground and slope."""
        steepest = self.steepest if self.steepest > _prices.FLAT else 0.0
        height, radius = self._priced.height_price, self.problem.least_radius
        return least_prices(self.objective, steepest, height, self.middle[1], radius)

    @property
    def least(self) -> Minorant:
        """Least cost of motions, metres and radians separately, less the potential of the rise."""
        return self.least_prices.minorant(0.0)

    @cached_property
    def steering(self) -> Minorant:
        """The static cost that steering solves exactly: the greatest one below all prices."""
        half = self.problem.cost.half_track
        eighth, quarter = DIRECTIONS // 8, DIRECTIONS // 4
        hills = self.hills
        table = self.prices[: hills.headings * hills.bins].reshape(hills.headings, hills.bins, -1)
        level = table[:, hills.bins // 2].mean(axis=0)
        pivot, spin, straight = level[eighth] * np.sqrt(2), level[quarter], level[0]
        # where a pivot costs clearly more than a spin, turning and driving are paid separately
        track = half if pivot - spin < 0.5 * straight else SHORT_TRACK
        track = self.problem.least_radius or track
        found = self.least_prices.minorant(track)
        if not found.metre > 0:
            raise ModelError("the objective makes some motion free; give energy or time a weight")
        return found

    @cached_property
    def hills(self) -> Hills:
        """The heights as the kernels see them."""
        heights, yaws = self.problem.heights, self.yaws
        headings = 1 if yaws is None else len(yaws)
        cells, several = 0.5 * self.grid.resolution, len(self.costs) > 1 or self._levels > 1
        if heights is None or not self.steepest > _prices.FLAT:
            if yaws is None:
                return LEVEL
            return LEVEL._replace(headings=headings, piece=cells if several else np.inf)
        return Hills(
            heights=heights.heights,
            x=heights.origin.x,
            y=heights.origin.y,
            cos=float(np.cos(heights.origin.yaw)),
            sin=float(np.sin(heights.origin.yaw)),
            resolution=float(heights.resolution),
            steepest=self.steepest,
            bins=_prices.BINS,
            headings=headings,
            piece=cells if several else max(cells, 0.5 * heights.resolution),
        )

    @cached_property
    def body(self) -> Body:
        """The footprint, seen from the centre that the kernels follow."""
        c_x, c_y = self.middle
        (x_min, y_min), (x_max, y_max) = self.problem.robot.footprint.tolist()
        return Body(x_min - c_x, y_min - c_y, x_max - c_x, y_max - c_y)

    @property
    def grown(self) -> Body:
        """That footprint with the whole clearance and the margin of planning."""
        more = self.strict.clearance - self.problem.clearance
        return grown(self.body, MARGIN * self.grid.resolution + more)

    def allows(self, path: Path) -> bool:
        """Return whether robot, ground and obstacles allow a path between the problem's ends."""
        return self.strict.forbidden(path) is None and self.strict.first_collision(path) is None

    def has_margin(self, pose: Pose) -> bool:
        """Return whether a pose is free with the whole clearance and the margin of planning."""
        return bool(pose_free(self.grid.space, self.grown, *self.centre(pose)))

    @cached_property
    def ends_have_margin(self) -> bool:
        """Whether start and goal are free with the margin of planning."""
        return all(self.has_margin(pose) for pose in (self.problem.start, self.problem.goal))

    @cached_property
    def _levels(self) -> int:
        """Levels that the costs of a costmap are rounded to; one without a costmap."""
        if not self.problem.softened:
            return 1
        levels = min(LEVELS, (MOST_CLASSES + 1) // len(self.costs))
        if levels < 2:
            raise ModelError(
                f"with {len(self.costs)} kinds of ground no levels of a costmap are left; merge "
                "surfaces of one model, round the speeds of limits, or leave the costmap out"
            )
        return levels

    @cached_property
    def _classes(self) -> NDArray[np.uint8]:
        """Class of surface and level of the costmap of each cell; a single one if all are alike.

        A cell that several surfaces overlap gets the most expensive one; otherwise the search would
        exploit cheap corners that exist only in the raster.
        """
        mean = self._priced.kept.reshape(len(self.costs), -1).mean(axis=1)
        radii = np.resize(np.array(self.problem.radii), len(mean))
        if radii.max() > radii.min():
            mean = mean + radii * (1e6 * np.abs(mean).max())  # first of all it must be permitted
        surface = self.terrain.dearest(mean, self.objective.slow)
        if self._levels > 1 and self.problem.costmap is not None:
            level = np.round(self.problem.costmap.over(self.grid) * (self._levels - 1))
            return np.asarray(surface * np.uint8(self._levels) + level.astype(np.uint8), np.uint8)
        if self.hills.bins * self.hills.headings > 1 and surface.size == 1:
            return np.zeros(self.grid.shape, np.uint8)
        return surface

    def soft_cost(self, path: Path, seconds: float | None = None) -> float:
        """Return what the costmap and priced seconds add to the cost of a path.

        It is in the unit of the objective. The seconds are priced at steady speeds where what they
        add is not given.
        """
        problem, surfaces = self.problem, self.problem.surfaces
        soft = 0.0
        if problem.costmap is not None and problem.softened:
            soft = problem.costmap_weight * problem.costmap.along(path)
        if surfaces is None or not any(surfaces.seconds):
            return soft
        if seconds is None:
            seconds = self.terrain.price(path, problem.cost).seconds
        return soft + seconds

    @cached_property
    def setting(self) -> KernelProblem:
        """The problem as the kernels see it."""
        problem = self.problem
        body = self.grown if self.ends_have_margin else self.body
        return KernelProblem(
            space=self.grid.space,
            body=body,
            prices=self.prices,
            surface=self._classes,
            hills=self.hills,
            steering=_static(self.steering),
            half_track=problem.cost.half_track,
            least_radius=problem.least_radius,
            radii=self._radii,
            widest=float(self._radii.max()),
            wide=self._steering_on(float(self._radii.max())),
            gear=0 if problem.robot.reverse else 1,
            lateral=self.middle[1],
            reach=float(np.hypot(max(-body.x_min, body.x_max), max(-body.y_min, body.y_max))),
            least_metre=self.least.metre,
            least_radian=self.least.radian,
            stop=0.0,
            start=self.centre(problem.start),
            goal=self.centre(problem.goal),
        )

    @cached_property
    def _radii(self) -> FloatArray:
        """Least radius of arcs on each class of surface and level of the costmap [m]."""
        radii = self.problem.radii
        count = len(self.costs)
        return np.repeat(np.resize(np.array(radii), count), self._levels)

    def toward(self, goal: Pose) -> CompiledProblem:
        """Return the same with the centre's goal at another pose, free or not, for bounds."""
        other = copy(self)
        vars(other)["setting"] = self.setting._replace(goal=goal)
        return other

    def _steering_on(self, radius: float) -> StaticSteering:
        """Return the static cost that steering on arcs of a radius at least solves [m]."""
        if not radius > self.problem.least_radius:
            return _static(self.steering)
        return _static(self.least_prices.minorant(radius))

    @property
    def least_in_free_space(self) -> float:
        """What every path costs at least, obstacles or not, in the unit of the objective."""
        setting = self.setting
        free = free_energy(setting, setting.start)
        return float(free) + self.potential(self.problem.goal)

    # -- translation ----------------------------------------------------------------------------

    def centre(self, pose: Pose) -> Pose:
        """Return the pose of the centre that the kernels follow, given that of the body frame."""
        c_x, c_y = self.middle
        c, s = np.cos(pose.yaw), np.sin(pose.yaw)
        return Pose(float(pose.x + c * c_x - s * c_y), float(pose.y + s * c_x + c * c_y), pose.yaw)

    def reference(self, ds: FloatArray, dtheta: FloatArray) -> Segments:
        """Return motions of `Path`'s reference point, given those of the centre."""
        return Segments(ds + self.middle[1] * dtheta, dtheta)

    def of_centre(self, ds: FloatArray, dtheta: FloatArray) -> Segments:
        """Return motions of the centre, given those of the reference point."""
        return Segments(ds - self.middle[1] * dtheta, dtheta)

    def motions_of(self, other: CompiledProblem, motions: Segments) -> Segments:
        """Return motions of the centre, given those of another one's in the same vehicle."""
        shift = (other.middle[1] - self.middle[1]) * motions.dtheta
        return Segments(motions.ds + shift, motions.dtheta)

    def path(self, segments: Segments, start: Pose | None = None) -> Path:
        """Return the path that starts at a pose, the problem's start if none is given."""
        problem = self.strict
        for motions in (merged(segments), segments):
            moved = self.reference(motions.ds, motions.dtheta)
            path = Path(
                start or problem.start, moved.ds, moved.dtheta, problem.cost.icr.longitudinal
            )
            if self.grid.path_free(path, problem.robot):
                return path
        where = path.vertices[self.grid.first_collision(path, problem.robot) or 0]
        raise PlanningError(
            f"the planned path is not free near {where.round(3).tolist()}; please report this map"
        )

    # -- result ---------------------------------------------------------------------------------

    def value(self, path: Path) -> float:
        """Return the objective's value of a path, by the models themselves."""
        cost, duration = self.problem.cost, 0.0
        pieces = self.terrain.pieces(path, cost)
        energy = float(sum(piece.energy for piece in pieces))
        if self.problem.weights.get("time"):
            duration = self.terrain.price(path, cost).duration
        return self.objective.value(energy, path.length, duration) + self.soft_cost(path)

    def driven_value(self, path: Path, driven: DrivenPath) -> float:
        """Return the objective's value of a path as it is driven."""
        value = self.objective.value(driven.energy, path.length, driven.duration)
        return value + self.soft_cost(path, driven.seconds)


def _static(rates: Minorant) -> StaticSteering:
    """Return rates as steering reads them."""
    return StaticSteering(
        half_track=rates.track,
        longitudinal=0.0,
        lateral=0.0,
        per_metre=rates.metre,
        per_radian=rates.metre * rates.track + rates.radian,
    )


def compiled(problem: PlanningProblem) -> CompiledProblem:
    """Return what the kernels know of a problem: checked once, and kept with it."""
    found = vars(problem).get("_compiled")
    if not isinstance(found, CompiledProblem):
        found = CompiledProblem(problem)
        object.__setattr__(problem, "_compiled", found)
    return found


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
