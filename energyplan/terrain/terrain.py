"""The ground as a whole: obstacles, surfaces and heights, and what a path costs on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, MapError
from energyplan.path import FloatArray, Path, Pose
from energyplan.power import PowerModel
from energyplan.power.effects import (
    SLIP_BEYOND,
    TILT_X,
    TILT_Y,
    TRACTION_BEYOND,
    knows_ground,
    reads_slope,
    with_weight,
    without_ground,
)
from energyplan.records import Within, check_fields, checked
from energyplan.terrain.grid import CostMap, OccupancyGrid
from energyplan.terrain.heights import HeightMap
from energyplan.terrain.surfaces import NOT_SLOW, SlowAreas, Surface, SurfaceMap, with_weights

_KEPT = 4  # number of `Terrain` objects that a map keeps: those requested last
MOST_CLASSES = 255  # a cell's class of surface is kept in one byte
CLEARANCE = Within((0, 20), (0, 2), "m")  # distances that a footprint may keep from obstacles
FLAT = SurfaceMap(())  # no surfaces: the cost at hand applies everywhere


@dataclass(frozen=True, eq=False)
class Site:
    """A place where robots drive: `PlanningProblem` and `Mission` take one in place of a map.

    Parameters
    ----------
    map : OccupancyGrid
        Obstacles.
    surfaces : SurfaceMap, optional
        Surfaces with power models of their own, and areas to keep out of.
    heights : HeightMap, optional
        Heights of the ground where it slopes.
    keepout : OccupancyGrid, optional
        A mask as Nav2 has them: the robot stays out of its occupied cells.
    costmap : CostMap, optional
        Soft costs, such as those of an inflated costmap.
    clearance : float
        Distance that the footprint keeps from obstacles [m].

    Examples
    --------
    >>> import energyplan as ep
    >>> hall = ep.Site(OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1), clearance=0.1)
    >>> cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:marble"))
    >>> ep.PlanningProblem(hall, cost, (1, 2, 0), (4, 2, 0)).clearance
    0.1
    """

    map: OccupancyGrid
    surfaces: SurfaceMap | None = None
    heights: HeightMap | None = None
    keepout: OccupancyGrid | None = None
    costmap: CostMap | None = None
    clearance: Annotated[float, CLEARANCE] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, MapError)

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map, with what the mask closes occupied."""
        return self.map if self.keepout is None else self.map.with_mask(self.keepout)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which parts do not lie on the map, or close nothing of it."""
        off = () if self.surfaces is None else self.surfaces.notes_on(self.map)
        closing = None if self.keepout is None else self.map.note_of_mask(self.keepout)
        return (*off, *([closing] if closing else []))

    def fill(self, record: Any) -> None:
        """Give a dataclass that was built with this site for its map the parts that it left out."""
        parts = {"surfaces": self.surfaces, "heights": self.heights, "costmap": self.costmap,
                 "clearance": self.clearance}  # fmt: skip
        for part in fields(record):
            if part.name in parts and getattr(record, part.name) == part.default:
                object.__setattr__(record, part.name, parts[part.name])
        object.__setattr__(record, "map", self.grid)


class Piece(NamedTuple):
    """What is driven at one cost."""

    cost: EnergyCost  # the cost
    path: Path  # segments at their length on the slope
    slope: FloatArray  # (n,): slope along the heading of each segment [rad]
    yaw: FloatArray  # (n,): heading in the middle of each segment [rad]
    second: float = 0.0  # price of a second there, in the unit of the objective

    @property
    def energy(self) -> float:
        """Energy [J]."""
        return self.cost.energy(self.path, self.slope, self.yaw)


class PathPrice(NamedTuple):
    """What a path costs."""

    energy: float  # energy, priced by the models themselves [J]
    by_term: Mapping[str, float]  # the same by term of the power models [J]
    duration: float  # time at the speeds of the costs [s]
    seconds: float = 0.0  # what seconds on priced ground add, in the unit of the objective


def path_pieces(
    path: Path,
    cost: EnergyCost,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
) -> tuple[Piece, ...]:
    """Return what a path consists of, surface by surface and slope by slope."""
    costs = (cost,) if surfaces is None else surfaces.costs(cost)
    cut = path if heights is None else heights.cut(path)
    for one in costs:
        if one.of_heading:
            cut = one.cut_turns(cut)
            break
    slope = np.zeros(len(cut)) if heights is None else heights.slopes(cut)
    yaw = 0.5 * (cut.vertices[1:, 2] + cut.vertices[:-1, 2])
    driven = replace(cut, ds=cut.ds / np.cos(slope))
    slow = NOT_SLOW if surfaces is None else surfaces.slow_areas(cost)
    if surfaces is None or not (surfaces.surfaces or slow.areas):
        return (Piece(cost, driven, slope, yaw),)
    return tuple(
        Piece(
            c,
            replace(driven, ds=driven.ds * share, dtheta=driven.dtheta * share),
            slope,
            yaw,
            surfaces.seconds[k % len(surfaces.seconds)],
        )
        for k, (c, share) in enumerate(zip(costs, surfaces.shares(cut, slow).T, strict=True))
        if np.any(share > 0)
    )


def path_price(
    path: Path,
    cost: EnergyCost,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
) -> PathPrice:
    """Return what a path costs on surfaces and slopes."""
    pieces = path_pieces(path, cost, surfaces, heights)
    by_term: dict[str, float] = {}
    for piece in pieces:
        for name, joules in piece.cost.breakdown(piece.path, piece.slope, piece.yaw).items():
            by_term[name] = by_term.get(name, 0.0) + joules
    return PathPrice(
        energy=float(sum(p.energy for p in pieces)),
        by_term=by_term,
        duration=_duration(pieces),
        seconds=float(sum(p.second * p.cost.duration(p.path) for p in pieces if p.second)),
    )


def _duration(pieces: Sequence[Piece]) -> float:
    """Return the time that pieces take at steady speeds [s]; NaN where nothing limits the speed."""
    try:
        return float(sum(piece.cost.duration(piece.path) for piece in pieces))
    except InvalidInputError:
        return np.nan


@dataclass(frozen=True, eq=False)
class Terrain:
    """Obstacles, surfaces and heights of one place.

    Parameters
    ----------
    grid : OccupancyGrid
        Obstacles.
    surfaces : SurfaceMap, optional
        Surfaces with power models of their own, and areas to keep out of.
    heights : HeightMap, optional
        Heights of the ground where it slopes.

    Raises
    ------
    MapError
        If there are more surfaces than a raster can hold.

    Examples
    --------
    >>> from energyplan.path import Pose
    >>> hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
    >>> straight = Path(Pose(1, 1, 0), ds=[5.0], dtheta=[0.0])
    >>> Terrain(hall).price(straight, cost).energy
    1000.0
    """

    grid: OccupancyGrid
    surfaces: SurfaceMap | None = None
    heights: HeightMap | None = None

    def __post_init__(self) -> None:
        check_fields(self, MapError)
        if len(self.ground.surfaces) > MOST_CLASSES:
            raise MapError(
                f"there are {len(self.ground.surfaces)} surfaces, more than {MOST_CLASSES}; "
                "merge those of one model"
            )

    @classmethod
    def of(
        cls,
        grid: OccupancyGrid,
        surfaces: SurfaceMap | None = None,
        heights: HeightMap | None = None,
    ) -> Terrain:
        """Return the ground of these; the map remembers those last seen."""
        known: list[Terrain] = grid.__dict__.setdefault("_terrains", [])
        same = (g for g in tuple(known) if g.surfaces is surfaces and g.heights is heights)
        ground = next(same, None) or cls(grid, surfaces, heights)
        known[:] = [*(g for g in known if g is not ground), ground][-_KEPT:]
        return ground

    def updated(
        self, occupied: ArrayLike, row: int, column: int, unknown: ArrayLike | None = None
    ) -> Terrain:
        """Return this ground with a patch of its map replaced; see `OccupancyGrid.updated`."""
        new = Terrain.of(
            self.grid.updated(occupied, row, column, unknown), self.surfaces, self.heights
        )
        if "regions" in self.__dict__:
            new.__dict__["regions"] = self.regions
        new.__dict__["_dearest"] = self._dearest
        if self.ground.keep_out:
            height, width = np.shape(occupied)
            kept_out = self._kept_out[row : row + height, column : column + width]
            new.__dict__["_kept_out"] = self._kept_out
            new.__dict__["obstacles"] = self.obstacles.updated(
                np.asarray(occupied) | kept_out, row, column, unknown
            )
        return new

    # -- what lies where --------------------------------------------------------------------------

    @property
    def ground(self) -> SurfaceMap:
        """The surfaces; where there are none, an empty map of them."""
        return FLAT if self.surfaces is None else self.surfaces

    @cached_property
    def obstacles(self) -> OccupancyGrid:
        """The grid, with what must be kept out of occupied."""
        if not self.ground.keep_out:
            return self.grid
        return replace(self.grid, occupied=self.grid.occupied | self._kept_out)

    @cached_property
    def _kept_out(self) -> NDArray[np.bool_]:
        """The cells that an area to keep out of touches, shape (rows, columns)."""
        return self.grid.touched_by(self.ground.keep_out)

    @cached_property
    def regions(self) -> NDArray[np.uint8]:
        """Region at the centre of each cell, shape (rows, columns) or (1, 1) if there is one."""
        if not self.ground.surfaces:
            return np.zeros((1, 1), np.uint8)
        return self.ground.raster(self.grid).astype(np.uint8)

    @cached_property
    def _dearest(self) -> dict[tuple[object, ...], NDArray[np.uint8]]:
        return {}

    def dearest(self, prices: ArrayLike, slow: SlowAreas = NOT_SLOW) -> NDArray[np.uint8]:
        """Return one class per cell: of those that share it, the most expensive."""
        if not (self.ground.surfaces or slow.areas):
            return self.regions
        if (count := np.size(prices)) > MOST_CLASSES:
            raise MapError(
                f"{len(self.ground.surfaces)} surfaces under speed limits of {len(slow.speeds)} "
                f"speeds make {count} kinds of ground, more than {MOST_CLASSES}; round the speeds, "
                "or merge surfaces of one model"
            )
        regions = np.asarray(prices)[: len(self.ground.surfaces) + 1]
        rank = np.argsort(np.argsort(regions, kind="stable"))
        key = slow.key, *rank.tolist()
        found = self._dearest.get(key)
        if found is None:
            found = self.ground.raster(self.grid, rank, slow).astype(np.uint8)
            found = self._dearest.setdefault(key, found)
        return found

    def region_at(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return the region of each world point (..., 2) [m]; see `SurfaceMap`."""
        return self.ground.region_at(points)

    def height_at(self, points: ArrayLike) -> FloatArray:
        """Return the height at world points (..., 2) [m]; 0 on level ground."""
        if self.heights is None:
            return np.zeros(np.shape(np.asarray(points, float))[:-1])
        return self.heights.height(points)

    def slopes(self, path: Path) -> FloatArray:
        """Return the slope along the heading in each segment of a path [rad], shape (n,)."""
        return np.zeros(len(path)) if self.heights is None else self.heights.slopes(path)

    # -- what it costs ----------------------------------------------------------------------------

    def costs(self, cost: EnergyCost) -> tuple[EnergyCost, ...]:
        """Return the cost of every class of ground; see `SurfaceMap.costs`."""
        return self.ground.costs(cost)

    def cut(self, path: Path) -> Path:
        """Return a path cut where its slope may change: the segments that `pieces` prices."""
        return path if self.heights is None else self.heights.cut(path)

    def pieces(self, path: Path, cost: EnergyCost) -> tuple[Piece, ...]:
        """Return the parts of a path on this ground; see `path_pieces`."""
        return path_pieces(path, cost, self.surfaces, self.heights)

    @checked()
    def price(self, path: Path, cost: EnergyCost) -> PathPrice:
        """Return what a path costs on this ground; see `path_price`."""
        return path_price(path, cost, self.surfaces, self.heights)


_TILTS, _BEYOND = (TILT_X.name, TILT_Y.name), (SLIP_BEYOND.name, TRACTION_BEYOND.name)


class LaidGround(NamedTuple):
    """A model without the terms of the ground, and the ground with what they said."""

    model: PowerModel  # the model where no surface says otherwise
    surfaces: SurfaceMap | None  # surfaces with models of their own
    heights: HeightMap | None  # heights of the ground


def laid_out(
    model: PowerModel,
    points: ArrayLike,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
) -> LaidGround:
    """Take the ground that a model knows of out of the model, as surfaces and heights."""
    if not knows_ground(model):
        return LaidGround(model, surfaces, heights)
    corners = np.asarray(points, float)
    values = dict(zip((t.name for t in model.terms), model.coefficients.tolist(), strict=True))
    plain = without_ground(model)
    if heights is None and set(values) & set(_TILTS):
        sine = np.array([values.get(name, 0.0) for name in _TILTS]) / model.vehicle.mass
        heights = _plane(corners, sine / np.sqrt(max(1.0 - float(sine @ sine), 0.01)))
    if heights is not None and not reads_slope(plain):
        plain = with_weight(plain)
    beyond = [term for term in model.terms if term.name in _BEYOND]
    if beyond and (surfaces is None or not surfaces.surfaces):
        more = {
            "slip_friction": values.get(SLIP_BEYOND.name, 0.0),
            "traction_resistance": values.get(TRACTION_BEYOND.name, 0.0),
        }
        there = plain.with_coefficients(
            plain.coefficients + np.array([more.get(t.name, 0.0) for t in plain.terms])
        )
        area = _half_plane(corners, beyond[0].params["direction"], beyond[0].params["offset"])
        if area is not None:
            found = Surface(area, replace(there, name="found beyond a line"))
            surfaces = replace(surfaces or SurfaceMap(()), surfaces=(found,))
    if surfaces is not None and heights is not None:
        surfaces = with_weights(surfaces)
    return LaidGround(plain, surfaces, heights)


def on_laid_ground(model: PowerModel, ground: LaidGround) -> PowerModel:
    """Return another model of the robot, such as one with a payload, for the same ground."""
    plain = without_ground(model)
    return plain if ground.heights is None else with_weight(plain)


def _plane(corners: FloatArray, gradient: FloatArray) -> HeightMap:
    """Heights of a plane about some points."""
    low, high = corners.min(axis=0) - 2.0, corners.max(axis=0) + 2.0
    size = float(np.max(high - low))
    node = np.array([0.0, 1.0])
    heights = size * (gradient[0] * node[None, :] + gradient[1] * node[:, None])
    return HeightMap(heights, size, Pose(float(low[0]), float(low[1]), 0.0))


def _half_plane(corners: FloatArray, direction: float, offset: float) -> shapely.Polygon | None:
    """Return what lies beyond a line, of the rectangle about some points; None if nothing does."""
    low, high = corners.min(axis=0) - 2.0, corners.max(axis=0) + 2.0
    size = 2.0 * float(np.max(high - low)) + 10.0
    normal = np.array([np.cos(direction), np.sin(direction)])
    along = np.array([-normal[1], normal[0]])
    middle = 0.5 * (low + high)
    foot = middle + (offset - middle @ normal) * normal
    far = [foot + size * along, foot - size * along]
    area = shapely.Polygon([*far, far[1] + 2 * size * normal, far[0] + 2 * size * normal])
    part = area.intersection(shapely.box(*low, *high))
    return part if isinstance(part, shapely.Polygon) and part.area > 0 else None
