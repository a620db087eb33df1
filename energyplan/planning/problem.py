"""What planners take: `PlanningProblem`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import (
    GoalInCollisionError,
    InvalidInputError,
    OutsideMapError,
    StartInCollisionError,
)
from energyplan.path import PLACE, FloatArray, Path, Pose, as_pose, wrap_angle
from energyplan.planning.goal import ARRIVED, Goal, as_goals, only_pose
from energyplan.records import check_fields, numbers
from energyplan.terrain import (
    CLEARANCE,
    CostMap,
    HeightMap,
    OccupancyGrid,
    Site,
    SurfaceMap,
    Terrain,
    knows_ground,
    laid_out,
)
from energyplan.vehicle import Vehicle

OBJECTIVES = ("energy", "length", "time")  # quantities that a plan can minimise
TURNING = ("any", "forward")  # ways to turn that have a name; others are a radius
WIDEST = 1e4  # least radius of arcs that may be wanted at most [m]
TIGHTER = 1e-6  # part of the least radius by which an arc may be tighter

KEPT = (0.9, 0.5, 0.0)
"""Shares of the clearance that there is at the ends which leaving them keeps, tried in turn."""

MOVED = 0.05
"""How far a start that touches an obstacle is moved at most [m]: what localisation is off by."""

_RINGS = 0.005  # between the rings of poses that it is moved to [m]
_HALVINGS = 12  # of the clearance, until what there is of it at an end is known well enough
LEAVING = 3.0  # diagonals of the robot within which an end that lacks clearance is left
_ASIDE = 16  # directions in which there may be room beside a pose
_TURN = 0.05  # between two poses of a path that are tested for the clearance [rad]


def objective_weights(objective: str | Mapping[str, float]) -> dict[str, float]:
    """Return an objective as weights of energy [1], length [J/m] and time [J/s]."""
    named = {objective: 1.0} if isinstance(objective, str) else objective
    weights = {name: float(numbers(named[name], f"the weight of {name}")) for name in named}
    if not weights or not set(weights) <= set(OBJECTIVES):
        raise InvalidInputError(
            f"objective {objective!r} is unknown; choose from {', '.join(OBJECTIVES)} "
            "or give a mapping of these to weights"
        )
    values = list(weights.values())
    if not (np.all(np.isfinite(values)) and min(values) >= 0 and max(values) > 0):
        raise InvalidInputError(f"objective weights are {weights}; give numbers >= 0, not all zero")
    return weights


def is_length(problem: PlanningProblem) -> bool:
    """Return whether length is the only objective."""
    return {name for name, weight in problem.weights.items() if weight > 0} == {"length"}


@dataclass(frozen=True)
class PlanningProblem:
    """Start, goal, map and cost of a planning query.

    Parameters
    ----------
    map : OccupancyGrid or Site
        Obstacles; or the site, for what is left out of surfaces, heights, clearance and costmap.
    cost : EnergyCost
        Cost of motions. Its model carries the vehicle and the tread ICRs.
    start : array_like, shape (3,)
        Pose x, y [m], yaw [rad] of the body frame.
    goal : array_like, shape (3,) or (2,), Goal, or a list of these
        The pose to reach; or the place ``(x, y)``, at any heading; or one of several, that which
        costs least. See `Goal` for a pose either way round, and for circles. Where it is no single
        pose, the attribute is one of those that `goals` allows; that of a plan's problem is the one
        that was reached.
    surfaces : SurfaceMap, optional
        Surfaces with power models of their own; the cost's model holds elsewhere.
    objective : {"energy", "length", "time"} or mapping of str to float
        What to minimise. A mapping gives weights: ``{"energy": 1, "time": 50}`` counts a second as
        50 J. Of the shortest routes ``"length"`` selects the one of least energy.
    vehicle : Vehicle, optional
        Whose footprint to use, and whether it may drive backwards; that of the cost's model if
        left out.
    heights : HeightMap, optional
        Heights of the ground where it slopes. All power models need a term that reads the slope,
        such as the grade (`energyplan.power.effects.with_weight`).
        Where surfaces or heights are left out, the ground that the model describes is used,
        such as the tilted plane that a diagnosis found (`energyplan.terrain.laid_out`).
    clearance : float
        Distance that the footprint keeps from obstacles on every side [m]; a path of least energy
        grazes them otherwise. A start or a goal that has less is left, or reached, with what there
        is, and the whole clearance is kept from there on.
    costmap : CostMap, optional
        Soft costs added to the objective, such as those of an inflated costmap.
    costmap_weight : float
        Value of a metre at the cost 1, in the unit of the objective a metre (for energy
        [J/m]); nothing where left out.
    turning : {"any", "forward"} or float
        How the robot may turn: in any way; so that its treads never run against each other; or on
        arcs of this radius at least (10 km at most) [m], of the point midway between its tread
        ICRs.
    goals : tuple of Goal
        What `goal` was given as; empty where that is a single pose.

    Raises
    ------
    InvalidInputError
        If a pose, the objective, the clearance, the weight or the turning is malformed.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> problem.objective
    'energy'
    """

    map: OccupancyGrid
    cost: EnergyCost
    start: Pose
    goal: Pose
    surfaces: SurfaceMap | None = None
    objective: str | Mapping[str, float] = "energy"
    vehicle: Vehicle | None = None
    heights: HeightMap | None = None
    clearance: Annotated[float, CLEARANCE] = 0.0
    costmap: CostMap | None = None
    costmap_weight: float = 0.0
    turning: str | float = "any"
    goals: tuple[Goal, ...] = ()

    def __post_init__(self) -> None:
        place: object = self.map
        if isinstance(place, Site):
            place.fill(self)
        self._tell_goals_apart()
        check_fields(self, InvalidInputError)
        if self.turning not in TURNING and not (
            isinstance(self.turning, (int, float)) and 0.0 < self.turning <= WIDEST
        ):
            raise InvalidInputError(
                f"turning is {self.turning!r}; give {' or '.join(TURNING)}, or the least radius of "
                f"arcs as a number above 0 m, {WIDEST:g} m at most"
            )
        if not 0.0 <= self.costmap_weight < np.inf:
            raise InvalidInputError(
                f"the weight of the costmap is {self.costmap_weight}; give a number of 0 or more"
            )
        object.__setattr__(self, "start", as_pose(self.start, "start"))
        objective_weights(self.objective)
        if knows_ground(self.cost.model):
            corners = self.map.corners
            ground = laid_out(self.cost.model, corners, self.surfaces, self.heights)
            object.__setattr__(self, "cost", replace(self.cost, model=ground.model))
            object.__setattr__(self, "surfaces", ground.surfaces)
            object.__setattr__(self, "heights", ground.heights)

    def _tell_goals_apart(self) -> None:
        """Set `goal` to a pose, and `goals` to what else it may be."""
        goal: object = self.goal
        given, goals = () if isinstance(goal, Pose) else as_goals(goal), self.goals
        pose = only_pose(given) if given else as_pose(self.goal, "goal")
        if pose is None:
            start = as_pose(self.start, "start")
            pose, goals = given[0].nearest(start), given
        elif goals and not any(goal.reached_by(pose) for goal in goals):
            raise InvalidInputError(
                f"the goal {tuple(pose)} is none of those in goals; give goals=() with another goal"
            )
        object.__setattr__(self, "goal", pose)
        object.__setattr__(self, "goals", goals)

    def toward(self, pose: Pose) -> PlanningProblem:
        """Return the same problem with a single pose as its goal."""
        return replace(self, goal=pose, goals=())

    @property
    def least_radius(self) -> float:
        """Least radius of arcs of the point midway between the tread ICRs [m]; zero for any."""
        if isinstance(self.turning, str):
            return self.cost.half_track if self.turning == "forward" else 0.0
        return float(self.turning)

    @cached_property
    def radii(self) -> tuple[float, ...]:
        """Least radius of arcs on the ground of each region [m]; zero for any."""
        known = (0.0,) if self.surfaces is None else self.surfaces.radii
        return tuple(max(self.least_radius, radius) for radius in known)

    def forbidden(self, path: Path) -> str | None:
        """Say which segment of a path robot and ground do not allow, whatever lies in its way."""
        for radius in sorted({*self.radii}):
            tight = self._too_tight(path, radius)
            if tight.any():
                at = np.argmax(tight)
                return f"whose segment {at} turns on an arc of less than {radius:.3g} m"
        back = self._ahead(path) < -PLACE
        if back.any() and not self.robot.reverse:
            return f"whose segment {np.argmax(back)} drives backwards, which the vehicle may not"
        return None

    def _too_tight(self, path: Path, radius: float) -> NDArray[np.bool_]:
        """Return which segments turn on less than a radius, on ground that asks for as much."""
        tight = self._tighter(path, radius)
        if radius > min(self.radii):
            for k in np.flatnonzero(tight):
                start = Pose(*path.vertices[k].tolist())
                one = Path(start, path.ds[k : k + 1], path.dtheta[k : k + 1], path.longitudinal)
                fine = one.subdivide(0.5 * self.map.resolution, _TURN)
                points = 0.5 * (fine.points[1:] + fine.points[:-1])
                there = np.array(self.radii)[self.terrain.region_at(points)] >= radius
                tight[k] = (self._tighter(fine, radius) & there).any()
        return tight

    def _tighter(self, path: Path, radius: float) -> NDArray[np.bool_]:
        """Return which segments turn more tightly than on a radius."""
        ahead = np.abs(self._ahead(path))
        return np.asarray(ahead < radius * (1.0 - TIGHTER) * np.abs(path.dtheta) - PLACE)

    def _ahead(self, path: Path) -> FloatArray:
        """Return how far the point midway between the tread ICRs drives ahead in each segment."""
        return path.ds - self.cost.icr.centre[1] * path.dtheta

    @cached_property
    def terrain(self) -> Terrain:
        """The ground: map, surfaces and heights together."""
        return Terrain.of(self.map, self.surfaces, self.heights)

    @cached_property
    def robot(self) -> Vehicle:
        """The vehicle whose footprint is used, which has grown by the clearance."""
        return self._with(self.clearance)

    def _with(self, clearance: float) -> Vehicle:
        vehicle = self.cost.vehicle if self.vehicle is None else self.vehicle
        if clearance == 0.0:
            return vehicle
        grow = clearance * np.array([[-1.0, -1.0], [1.0, 1.0]])
        return replace(vehicle, footprint=vehicle.footprint + grow)

    @cached_property
    def ends_clear(self) -> bool:
        """Whether start and goal have the whole clearance."""
        ends = [self.start, self.goal]
        return bool(self.terrain.obstacles.footprint_free(ends, self.robot).all())

    @cached_property
    def clearance_at_ends(self) -> float:
        """The clearance that both start and goal have, no more than is wanted [m]."""
        if self.ends_clear:
            return self.clearance
        ends, low, high = [self.start, self.goal], 0.0, self.clearance
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            free = self.terrain.obstacles.footprint_free(ends, self._with(middle)).all()
            low, high = (middle, high) if free else (low, middle)
        return low

    @cached_property
    def without_clearance(self) -> PlanningProblem:
        """The same problem with any clearance allowed: what bounds it bounds this one too."""
        return replace(self, clearance=0.0) if self.clearance else self

    def first_collision(self, path: Path, share: float = 0.0) -> int | None:
        """Return the first segment that is not free; ends need a `share` of what they have."""
        grid = self.terrain.obstacles
        segment = grid.first_collision(path, self.robot)
        if segment is None or self.ends_clear:
            return segment
        fine = path.subdivide(grid.resolution, _TURN)
        clear = np.flatnonzero(grid.footprint_free(fine.vertices, self.robot))
        first, last = (int(clear[0]), int(clear[-1])) if len(clear) else (0, 0)
        middle = Path(
            Pose(*fine.vertices[first].tolist()), fine.ds[first:last], fine.dtheta[first:last],
            fine.longitudinal,
        )  # fmt: skip
        whole = grid.first_collision(path, self._with(share * self.clearance_at_ends))
        return whole if not len(clear) or grid.path_free(middle, self.robot) else segment

    def allows(self, path: Path) -> bool:
        """Return whether a part of a path keeps the clearance, except for what its ends lack."""
        part = replace(self, start=path.start, goal=path.end, goals=())
        return len(path) == 0 or part.first_collision(path) is None

    def fault(self, path: object, share: float = 0.0) -> str | None:
        """Return what is wrong with a path as an answer to the problem, or None."""
        if not isinstance(path, Path):
            return f"a {type(path).__name__} in place of a Path"
        reference = self.cost.icr.longitudinal
        if path.longitudinal != reference:
            return (
                f"a path of the reference point at x = {path.longitudinal:g} m; that of the "
                f"vehicle lies at {reference:g} m"
            )
        elsewhere = missed("starts", path.start, self.start)
        if not any(goal.reached_by(path.end) for goal in self.goals):
            elsewhere = elsewhere or missed("ends", path.end, self.goal)
        if elsewhere:
            return f"a path that {elsewhere}"
        if forbidden := self.forbidden(path):
            return f"a path {forbidden}"
        if (segment := self.first_collision(path, share)) is None:
            return self._grazing(path)
        at = path.vertices[min(segment, len(path.vertices) - 1)]
        return (
            f"a path that is not free of collisions: its segment {segment}, from ({at[0]:.3f}, "
            f"{at[1]:.3f}, {np.degrees(at[2]):.1f} deg), touches an obstacle or leaves the map, "
            f"which covers {self.terrain.obstacles.describe_extent()}"
        )

    def _grazing(self, path: Path) -> str | None:
        """Say where a path, away from its ends, is nearer to obstacles than it has to be."""
        if self.ends_clear:
            return None
        grid = self.terrain.obstacles
        fine = path.subdivide(grid.resolution, _TURN)
        lacking = ~grid.footprint_free(fine.vertices, self.robot)
        # beyond some lengths of the robot, and two arcs that lead aside
        away = LEAVING * float(np.hypot(*np.ptp(self.robot.footprint, axis=0)))
        away += 2.0 * float(np.sqrt(self.least_radius * self.clearance))
        ends = np.array([fine.vertices[0], fine.vertices[-1]])[:, None, :2]
        off = np.hypot(*np.moveaxis(fine.vertices[:, :2] - ends, -1, 0)).min(axis=0)
        far = np.flatnonzero(lacking & (off > away))
        ring = np.linspace(0.0, 2.0 * np.pi, _ASIDE, endpoint=False)
        beside = np.repeat(fine.vertices[far][:, None], _ASIDE, axis=1)
        beside[..., 0] += self.clearance * np.cos(ring)
        beside[..., 1] += self.clearance * np.sin(ring)
        room = grid.footprint_free(beside.reshape(-1, 3), self.robot).reshape(-1, _ASIDE)
        if not room.any():
            return None
        x, y, yaw = fine.vertices[far[int(np.argmax(room.any(axis=1)))]]
        return (
            f"a path that does not keep the clearance of {self.clearance:g} m at ({x:.3f}, "
            f"{y:.3f}, {np.degrees(yaw):.1f} deg), more than {away:.1f} m from its ends, where "
            "there is room for it beside"
        )

    @property
    def softened(self) -> bool:
        """Whether a costmap counts."""
        return self.costmap is not None and self.costmap_weight > 0

    @property
    def shortest(self) -> PlanningProblem:
        """The same problem with the length as its objective, no costmap, and no priced seconds."""
        surfaces = None if self.surfaces is None else self.surfaces.unpriced
        return replace(self, objective="length", costmap=None, surfaces=surfaces)

    @property
    def weights(self) -> dict[str, float]:
        """The objective as weights of energy [1], length [J/m] and time [J/s]."""
        return objective_weights(self.objective)

    def check_poses(self) -> None:
        """Check that start and goal are on the map, free, and out of what must be kept out of.

        Raises
        ------
        OutsideMapError
            If a pose lies outside the map.
        StartInCollisionError, GoalInCollisionError
            If the footprint touches an obstacle. The messages name the nearest free pose found.
        """
        grid = self.terrain.obstacles
        for name, pose, error in (
            ("start", self.start, StartInCollisionError),
            ("goal", self.goal, GoalInCollisionError),
        ):
            # far away `f` would write all digits out, up to 309
            x, y = (f"{v:.3f}" if abs(v) < 1e7 else f"{v:g}" for v in pose[:2])
            place = f"{name} ({x}, {y}, {np.degrees(pose.yaw):.1f} deg)"
            if not grid.inside(pose[:2]):
                rows, columns = grid.shape
                near = grid.to_world(np.clip(grid.to_cells(pose[:2]), 0, (columns, rows)))
                where = where_free(grid, self.robot, Pose(float(near[0]), float(near[1]), pose.yaw))
                raise OutsideMapError(
                    f"the {place} lies outside the map; it covers {grid.describe_extent()}; {where}"
                )
            if not bool(grid.footprint_free(np.array([pose]), self.robot)[0]):
                where = where_free(grid, self.robot, pose)
                within = f", grown by the clearance of {self.clearance:g} m," * (self.clearance > 0)
                raise error(f"the footprint{within} at the {place} touches an obstacle; {where}")


def missed(verb: str, found: Pose, wanted: Pose) -> str | None:
    """Say that a path starts or ends elsewhere than it should; None where it does not."""
    off = np.array(
        [found.x - wanted.x, found.y - wanted.y, float(wrap_angle(found.yaw - wanted.yaw))]
    )
    if np.abs(off).max() <= ARRIVED:
        return None
    here, there = (
        f"({one.x:.3f}, {one.y:.3f}, {np.degrees(one.yaw):.1f} deg)" for one in (found, wanted)
    )
    return f"{verb} at {here} in place of {there}"


def where_free(grid: OccupancyGrid, vehicle: Vehicle, pose: Pose) -> str:
    """Say where the nearest free pose is."""
    near = nearest_free(grid, vehicle, pose)
    if near is None:
        return "no free pose lies within 5 m"
    yaw = np.degrees(near.yaw)
    return f"the nearest free pose found is ({near.x:.2f}, {near.y:.2f}, {yaw:.0f} deg)"


def nearest_free(
    grid: OccupancyGrid,
    vehicle: Vehicle,
    pose: Pose,
    reach: float = 5.0,
    step: float | None = None,
    turns: Sequence[float] = (0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, np.pi / 2),
) -> Pose | None:
    """Return the nearest free pose on rings about a pose, its own heading preferred, if any."""
    step = max(grid.resolution, 0.05) if step is None else step
    for radius in np.arange(0.0, reach + 0.5 * step, step):
        around = np.linspace(0, 2 * np.pi, max(int(2 * np.pi * radius / step), 1), endpoint=False)
        for turn in turns:
            ring: FloatArray = np.column_stack(
                [
                    pose.x + radius * np.cos(around),
                    pose.y + radius * np.sin(around),
                    np.full(len(around), pose.yaw + turn),
                ]
            )
            free = np.flatnonzero(grid.footprint_free(ring, vehicle))
            if len(free):
                return Pose(*(float(v) for v in ring[free[0]]))
    return None


class MovedStart(NamedTuple):
    """A free pose near one that touches an obstacle, and a note that explains it."""

    pose: Pose
    note: str


def free_beside(grid: OccupancyGrid, vehicle: Vehicle, start: Pose) -> MovedStart | None:
    """Return the nearest free pose within `MOVED` of a start that touches an obstacle, if any."""
    if not grid.inside(start[:2]) or bool(grid.footprint_free(start, vehicle)):
        return None
    near = nearest_free(grid, vehicle, start, reach=MOVED, step=_RINGS, turns=(0.0,))
    if near is None:
        return None
    by = float(np.hypot(near.x - start.x, near.y - start.y))
    return MovedStart(
        near,
        f"the footprint touches an obstacle at the start: the plan starts {by:.3f} m beside it, at "
        f"the nearest free pose ({near.x:.3f}, {near.y:.3f}); up to {MOVED:g} m is taken for an "
        "error of localisation",
    )
