"""Surfaces with power models of their own: which one lies where, and what a path costs on them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil, floor
from typing import Annotated, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from energyplan.compilation import Column, FloatTable, IntTable, njit
from energyplan.cost import EnergyCost
from energyplan.cost.speeds import CHEAPEST
from energyplan.errors import MapError
from energyplan.path import FloatArray, Path
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.records import Within, check_fields, described
from energyplan.terrain.collision import STRAIGHT
from energyplan.terrain.grid import FARTHEST, OccupancyGrid
from energyplan.vehicle import Vehicle


def _area(geometry: BaseGeometry, name: str) -> BaseGeometry:
    if not isinstance(geometry, BaseGeometry):
        raise MapError(f"{name} is {described(geometry)}; give a shapely Polygon")
    if geometry.geom_type not in {"Polygon", "MultiPolygon"} or geometry.is_empty:
        raise MapError(f"{name} is a {geometry.geom_type}; give a polygon that is not empty")
    if not np.all(np.abs(geometry.bounds) <= FARTHEST):
        raise MapError(f"{name} reaches beyond {FARTHEST:g} m; give it in the map's frame")
    if not geometry.is_valid:
        raise MapError(f"{name}: {shapely.is_valid_reason(geometry)}; correct the polygon")
    return geometry


@dataclass(frozen=True)
class Surface:
    """A ground: where it lies and what driving on it costs."""

    area: BaseGeometry  # where it lies, in the world [m]
    model: PowerModel  # power of driving there
    name: str = ""  # what to call it
    # price of each second on it, in the unit of the objective a second (for energy [J/s]); it is
    # added to the objective and no part of the energy
    second: Annotated[float, Within((0, 1e9), (0, 1e5), "of the objective a second")] = 0.0
    # least radius of arcs on it, of the point midway between the tread ICRs [m]; 0 for any turn
    turning_radius: Annotated[float, Within((0, 1e4), (0, 20), "m")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, MapError, f"surface {self.name!r}: ")
        _area(self.area, f"the area of surface {self.name!r}")
        if not self.name:
            object.__setattr__(self, "name", self.model.name)


@dataclass(frozen=True)
class SpeedLimit:
    """An area in which the robot's reference point moves no faster than a speed."""

    area: BaseGeometry  # where the limit holds, its border included, in the world [m]
    # largest speed [m/s], or share of the robot's top speed [1]
    speed: Annotated[float, Within((1e-3, 50), (0.02, 15), "m/s")]
    relative: bool = False  # whether `speed` is a share

    def __post_init__(self) -> None:
        check_fields(self, MapError, "speed limit: ")
        _area(self.area, "the area of a speed limit")
        if self.relative and self.speed > 1:
            raise MapError(
                f"a speed limit is {100 * self.speed:g} %; give at most 100 % of the top speed"
            )

    def of(self, vehicle: Vehicle) -> float:
        """Return the limit for a vehicle [m/s]."""
        if not self.relative:
            return self.speed
        if not np.isfinite(vehicle.motor.speed):
            raise MapError(
                f"a speed limit is {100 * self.speed:g} % of the top speed, which vehicle "
                f"{vehicle.name!r} does not state; give its motor a speed, or the limit in m/s"
            )
        return self.speed * vehicle.motor.speed


class SlowAreas(NamedTuple):
    """Speed limits that slow a robot down.

    With ``n`` regions, class ``region + n level`` of ground is a region under one of the limits.
    """

    speeds: tuple[float, ...] = ()  # limit of each level from 1 on, the highest first [m/s]
    areas: tuple[tuple[int, BaseGeometry], ...] = ()  # level and place, in the order of the levels

    @property
    def key(self) -> tuple[tuple[int, int], ...]:
        """What distinguishes it from others of the same map."""
        return tuple((level, id(area)) for level, area in self.areas)


NOT_SLOW = SlowAreas()


@dataclass(frozen=True)
class SurfaceMap:
    """Surfaces, each with a power model, areas to keep out of, and speed limits.

    Where surfaces overlap, the last one counts. Outside all of them the cost at hand applies:
    region 0. Region ``k`` is ``surfaces[k - 1]``. The robot is on the surface that lies under its
    reference point (see `Path`). Where speed limits overlap, the lowest counts.

    Parameters
    ----------
    surfaces : sequence of Surface
        The surfaces.
    keep_out : sequence of shapely Polygon or MultiPolygon
        Areas that the robot must not enter.
    speed_limits : sequence of SpeedLimit
        Where the robot drives slowly.

    Raises
    ------
    MapError
        If a keep-out area is not a valid polygon.

    Examples
    --------
    >>> marble = PowerModel.preset("quadriga:empty:marble")
    >>> ground = SurfaceMap([Surface(shapely.box(0, 0, 4, 4), marble)])
    >>> ground.region_at([(1, 1), (5, 1)])
    array([1, 0])
    """

    surfaces: tuple[Surface, ...]
    keep_out: tuple[BaseGeometry, ...] = ()
    speed_limits: tuple[SpeedLimit, ...] = ()
    _last: list[tuple[EnergyCost, ...]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_fields(self, MapError)
        object.__setattr__(self, "surfaces", tuple(self.surfaces))
        keep_out = tuple(_area(a, f"keep-out area {k}") for k, a in enumerate(self.keep_out))
        object.__setattr__(self, "keep_out", keep_out)
        object.__setattr__(self, "speed_limits", tuple(self.speed_limits))
        limits = (limit.area for limit in self.speed_limits)
        for area in (*(s.area for s in self.surfaces), *keep_out, *limits):
            shapely.prepare(area)

    @cached_property
    def seconds(self) -> tuple[float, ...]:
        """Price of a second in each region, in the unit of the objective."""
        return (0.0, *(surface.second for surface in self.surfaces))

    @cached_property
    def radii(self) -> tuple[float, ...]:
        """Least radius of arcs in each region [m]; 0 where any turn is allowed."""
        return (0.0, *(surface.turning_radius for surface in self.surfaces))

    @cached_property
    def unpriced(self) -> SurfaceMap:
        """The same map where no second has a price."""
        if not any(self.seconds):
            return self
        return replace(self, surfaces=tuple(replace(s, second=0.0) for s in self.surfaces))

    @property
    def polygons(self) -> tuple[tuple[str, BaseGeometry], ...]:
        """Name and area of each surface, then of each keep-out area: what a picture shows."""
        return (
            *((surface.name, surface.area) for surface in self.surfaces),
            *(("keep-out", area) for area in self.keep_out),
        )

    def notes_on(self, grid: OccupancyGrid) -> tuple[str, ...]:
        """Say of which kind of area none lies on a map."""
        extent = shapely.Polygon(grid.corners)
        kinds = {
            "surfaces": [s.area for s in self.surfaces],
            "keep-out areas": [*self.keep_out],
            "speed limits": [s.area for s in self.speed_limits],
        }
        return tuple(
            f"none of the {kind} lies on the map, which covers {grid.describe_extent()}; give them "
            "in the map's frame"
            for kind, areas in kinds.items()
            if areas and not any(area.intersects(extent) for area in areas)
        )

    def slow_areas(self, cost: EnergyCost) -> SlowAreas:
        """Return the speed limits that are below the speeds of a cost."""
        motors = [cost.vehicle.motor, *(one.model.vehicle.motor for one in self.surfaces)]
        top = min(max(motor.speed for motor in motors), cost.tread_speed or np.inf)
        # the reference point may move faster than both treads only outside of them
        top *= max(1.0, abs(cost.icr.centre[1]) / cost.half_track)
        known = [(limit.of(cost.vehicle), limit.area) for limit in self.speed_limits]
        speeds = tuple(sorted({speed for speed, _ in known if speed < top}, reverse=True))
        areas = [(speeds.index(speed) + 1, area) for speed, area in known if speed < top]
        return SlowAreas(speeds, tuple(sorted(areas, key=lambda one: one[0])))

    def costs(self, cost: EnergyCost) -> tuple[EnergyCost, ...]:
        """Return the cost of every class of ground: the regions, then these under each limit."""
        if self._last and self._last[0][0] is cost:
            return self._last[0]
        for surface in self.surfaces:
            if surface.model.vehicle.icr.longitudinal != cost.icr.longitudinal:
                raise MapError(
                    f"surface {surface.name!r} has tread ICRs at x = "
                    f"{surface.model.vehicle.icr.longitudinal} m, the robot at "
                    f"{cost.icr.longitudinal} m; identify both with the same longitudinal ICR"
                )
        known = {id(cost.model): cost}
        for surface in self.surfaces:
            if id(surface.model) not in known:
                known[id(surface.model)] = replace(
                    cost, model=surface.model, speed=cost.tread_speed or CHEAPEST
                )
        found = (cost, *(known[id(surface.model)] for surface in self.surfaces))
        for speed in self.slow_areas(cost).speeds:
            slow = {id(one): replace(one, speed_limit=speed) for one in known.values()}
            found += tuple(slow[id(one)] for one in found[: len(self.surfaces) + 1])
        self._last[:] = [found]
        return found

    def region_at(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return the region of each world point (..., 2) [m]."""
        rows = np.asarray(points, float)
        region = np.zeros(rows.shape[:-1], np.intp)
        for k, surface in enumerate(self.surfaces, start=1):
            region[shapely.intersects_xy(surface.area, rows[..., 0], rows[..., 1])] = k
        return region

    def class_at(self, points: ArrayLike, slow: SlowAreas) -> NDArray[np.intp]:
        """Return the class of ground at each world point (..., 2) [m]."""
        rows = np.asarray(points, float)
        level = np.zeros(rows.shape[:-1], np.intp)
        for k, area in slow.areas:
            level[shapely.intersects_xy(area, rows[..., 0], rows[..., 1])] = k
        return np.asarray(self.region_at(rows) + (len(self.surfaces) + 1) * level)

    def raster(
        self, grid: OccupancyGrid, rank: ArrayLike | None = None, slow: SlowAreas = NOT_SLOW
    ) -> NDArray[np.intp]:
        """Return the class of ground at the centre of each cell of a map, shape (rows, columns).

        With a rank of the regions, it is the one of highest rank in the cell, and the lowest limit.
        """
        ordered = None if rank is None else np.asarray(rank, float)
        regions = _raster(grid, enumerate((s.area for s in self.surfaces), start=1), ordered)
        if not slow.areas:
            return regions
        ordered, areas = None, slow.areas
        if rank is not None:
            ordered = np.arange(len(slow.speeds) + 1.0)
            # searches price a motion at the middle of parts of half a cell; a part may clip a
            # corner of an area, where a metre may take ten times as long, from this far away
            aside = 0.25 * grid.resolution
            areas = tuple((k, area.buffer(aside, join_style="mitre")) for k, area in areas)
        return regions + (len(self.surfaces) + 1) * _raster(grid, areas, ordered)

    def _edges(self, slow: SlowAreas) -> tuple[FloatArray, FloatArray]:
        return self._all_edges if slow.areas else self._region_edges

    @cached_property
    def _all_edges(self) -> tuple[FloatArray, FloatArray]:
        starts, along = zip(self._region_edges, self._limit_edges, strict=True)
        return np.concatenate(starts), np.concatenate(along)

    @cached_property
    def _region_edges(self) -> tuple[FloatArray, FloatArray]:
        return _edges(surface.area for surface in self.surfaces)

    @cached_property
    def _limit_edges(self) -> tuple[FloatArray, FloatArray]:
        return _edges(limit.area for limit in self.speed_limits)

    def top_speed(self, points: ArrayLike, vehicle: Vehicle) -> FloatArray:
        """Return the lowest speed limit at world points (..., 2) [m/s]; infinite where none is."""
        rows = np.asarray(points, float)
        top = np.full(rows.shape[:-1], np.inf)
        for limit in self.speed_limits:
            here = shapely.intersects_xy(limit.area, rows[..., 0], rows[..., 1])
            top[here] = np.minimum(top[here], limit.of(vehicle))
        return top

    def cut_at_limits(self, path: Path) -> Path:
        """Return a path cut where its reference point crosses the border of a speed limit."""
        parts = [np.diff(cuts) for _, cuts in _cuts(path, *self._limit_edges)]
        count = [len(part) for part in parts]
        share = np.concatenate([np.empty(0), *parts])
        ds, dtheta = (np.repeat(column, count) * share for column in (path.ds, path.dtheta))
        return Path(path.start, ds, dtheta, path.longitudinal)

    def edge_points(self, spacing: float, slow: SlowAreas = NOT_SLOW) -> Iterable[FloatArray]:
        """Yield points along each edge of the ground, spaced by at most `spacing` [m], (n, 2)."""
        for a, e in zip(*self._edges(slow), strict=True):
            count = int(np.hypot(*e) / spacing) + 2
            yield a + np.linspace(0.0, 1.0, count)[:, None] * e

    def _classes(self, slow: SlowAreas) -> int:
        return (len(self.surfaces) + 1) * (len(slow.speeds) + 1)

    def shares(self, path: Path, slow: SlowAreas = NOT_SLOW) -> FloatArray:
        """Return how each segment of a path divides over the classes of ground."""
        out = np.zeros((len(path), self._classes(slow)))
        for k, (arc, cuts) in enumerate(_cuts(path, *self._edges(slow))):
            classes = self.class_at(arc.points(0.5 * (cuts[:-1] + cuts[1:])), slow)
            np.add.at(out[k], classes, np.diff(cuts))
        return out

    def line_shares(
        self, starts: ArrayLike, ends: ArrayLike, slow: SlowAreas = NOT_SLOW
    ) -> FloatArray:
        """Return how straight lines divide over the classes, as `shares` does for segments."""
        p = np.asarray(starts, float)
        d = np.asarray(ends, float) - p
        out = np.zeros((len(p), self._classes(slow)))
        crossed = np.nan_to_num(_crossings(p, d, *self._edges(slow)), nan=1.0)
        both = np.broadcast_to([0.0, 1.0], (len(p), 2))
        cuts = np.sort(np.concatenate([both, crossed], axis=1), axis=1)
        line, place = np.nonzero(np.diff(cuts, axis=1) > 0)
        middle = 0.5 * (cuts[line, place] + cuts[line, place + 1])
        kind = self.class_at(p[line] + middle[:, None] * d[line], slow)
        np.add.at(out, (line, kind), cuts[line, place + 1] - cuts[line, place])
        return out


def _raster(
    grid: OccupancyGrid, areas: Iterable[tuple[int, BaseGeometry]], rank: FloatArray | None
) -> NDArray[np.intp]:
    """Return the number of the last area at the centre of each cell, 0 where there is none."""
    raster = np.zeros(grid.shape, np.int64)
    for k, area in areas:
        a, e = _rim(shapely.transform(area, grid.to_cells))
        before = None if rank is None else raster.copy()
        _fill(raster, a, a + e, k)
        if before is not None and rank is not None:
            _share(raster, before, a, a + e, k, rank)
    return raster


def with_limits(surfaces: SurfaceMap | None, limits: Sequence[SpeedLimit]) -> SurfaceMap | None:
    """Return surfaces with further speed limits."""
    if not limits:
        return surfaces
    known = SurfaceMap(()) if surfaces is None else surfaces
    return replace(known, speed_limits=(*known.speed_limits, *limits))


def with_weights(surfaces: SurfaceMap) -> SurfaceMap:
    """Return surfaces whose models hold their vehicle's weight; see `effects.with_weight`."""
    heavy = (replace(s, model=with_weight(s.model)) for s in surfaces.surfaces)
    return replace(surfaces, surfaces=tuple(heavy))


def _rim(area: BaseGeometry) -> tuple[FloatArray, FloatArray]:
    """Return starts and directions of the edges of an area, each of shape (n, 2)."""
    rings = [
        shapely.get_coordinates(ring)
        for part in shapely.get_parts(area)
        for ring in shapely.get_rings(part)
    ]
    starts = np.concatenate([ring[:-1] for ring in rings])
    return starts, np.concatenate([np.diff(ring, axis=0) for ring in rings])


def _edges(areas: Iterable[BaseGeometry]) -> tuple[FloatArray, FloatArray]:
    """Return starts and directions of the edges of all areas, each of shape (n, 2)."""
    rims = [(np.empty((0, 2)), np.empty((0, 2))), *(_rim(area) for area in areas)]
    return np.concatenate([a for a, _ in rims]), np.concatenate([e for _, e in rims])


def _crossings(p: FloatArray, d: FloatArray, a: FloatArray, e: FloatArray) -> FloatArray:
    """Return where lines ``p + t d`` cross edges ``a + s e``, shape (lines, edges): t or NaN."""
    offset, d = a - p[:, None], d[:, None]
    cross = d[..., 0] * e[:, 1] - d[..., 1] * e[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset[..., 0] * e[:, 1] - offset[..., 1] * e[:, 0]) / cross
        s = (offset[..., 0] * d[..., 1] - offset[..., 1] * d[..., 0]) / cross
    return np.where((t > 0) & (t < 1) & (s >= 0) & (s <= 1), t, np.nan)


def _cuts(path: Path, a: FloatArray, e: FloatArray) -> Iterator[tuple[_Arc, FloatArray]]:
    """Yield each segment with the parameters at which it begins, crosses an edge, and ends."""
    for point, yaw, ds, dtheta in zip(
        path.points[:-1], path.vertices[:-1, 2], path.ds, path.dtheta, strict=True
    ):
        arc = _Arc(point, float(yaw), float(ds), float(dtheta))
        yield arc, np.unique(np.concatenate([[0.0, 1.0], arc.crossings(a, e)]))


@njit
def _fill(raster: IntTable, a: FloatTable, b: FloatTable, value: int) -> None:
    """Set the cells whose centres lie within a rim of edges from `a` to `b`, in cells."""
    rows, columns = raster.shape
    crossed = np.empty(columns + 1, np.bool_)
    for row in range(rows):
        y = row + 0.5
        for column in range(columns + 1):
            crossed[column] = False
        for k in range(len(a)):
            if (a[k, 1] <= y) != (b[k, 1] <= y):
                x = a[k, 0] + (y - a[k, 1]) / (b[k, 1] - a[k, 1]) * (b[k, 0] - a[k, 0])
                beyond = int(min(max(ceil(x - 0.5), 0), columns))
                crossed[beyond] = not crossed[beyond]
        inside = False
        for column in range(columns):
            inside = inside != crossed[column]
            if inside:
                raster[row, column] = value


_INSIDE = 1e-6  # how far an edge must reach into a cell to share it [cells]: rounding


@njit
def _share(
    raster: IntTable, before: IntTable, a: FloatTable, b: FloatTable, value: int, rank: Column
) -> None:
    """Set the cells that edges from `a` to `b` pass through to the higher rank next to them."""
    rows, columns = raster.shape
    for k in range(len(a)):
        left, right = (a[k], b[k]) if a[k, 0] <= b[k, 0] else (b[k], a[k])
        width = right[0] - left[0]
        first = int(max(floor(left[0] + _INSIDE), 0.0))
        for column in range(first, int(min(ceil(right[0] - _INSIDE), columns))):
            y0 = left[1]
            y1 = right[1]
            if width > 0.0:
                steep = (right[1] - left[1]) / width
                y0 = left[1] + steep * max(column - left[0], 0.0)
                y1 = right[1] - steep * max(right[0] - column - 1.0, 0.0)
            bottom = int(max(floor(min(y0, y1) + _INSIDE), 0.0))
            for row in range(bottom, int(min(ceil(max(y0, y1) - _INSIDE), rows))):
                old = before[row, column]
                raster[row, column] = value if rank[value] >= rank[old] else old


@dataclass(frozen=True)
class _Arc:
    """A segment of a path as its reference point drives it, at the parameters 0 to 1."""

    start: FloatArray
    yaw: float
    ds: float
    dtheta: float

    def points(self, t: FloatArray) -> FloatArray:
        """Return the points at parameters `t`, shape (n, 2)."""
        half = 0.5 * self.dtheta * t
        chord = self.ds * t * np.sinc(half / np.pi)
        heading = np.column_stack([np.cos(self.yaw + half), np.sin(self.yaw + half)])
        return np.asarray(self.start + chord[:, None] * heading)

    def crossings(self, a: FloatArray, e: FloatArray) -> FloatArray:
        """Return the parameters within (0, 1) at which the arc crosses edges ``a + s e``."""
        if self.ds == 0.0 or len(a) == 0:
            return np.empty(0)
        if abs(self.dtheta) < STRAIGHT:
            middle = self.yaw + 0.5 * self.dtheta
            d = self.ds * np.array([[np.cos(middle), np.sin(middle)]])
            t = _crossings(self.start[None], d, a, e)
            return t[np.isfinite(t)]
        radius = self.ds / self.dtheta
        centre = self.start + radius * np.array([-np.sin(self.yaw), np.cos(self.yaw)])
        # |a + s e - centre|^2 = radius^2
        offset = a - centre
        A = np.einsum("ij,ij->i", e, e)
        B = np.einsum("ij,ij->i", offset, e)
        C = np.einsum("ij,ij->i", offset, offset) - radius * radius
        disc = B * B - A * C
        hit = (disc >= 0) & (A > 0)
        root = np.sqrt(disc[hit])
        s = np.concatenate([(-B[hit] - root) / A[hit], (-B[hit] + root) / A[hit]])
        on_edge = (s >= 0) & (s <= 1)
        point = (np.tile(offset[hit], (2, 1)) + s[:, None] * np.tile(e[hit], (2, 1)))[on_edge]
        # heading of the robot where it passes each point, and the turn until there
        passed = np.arctan2(point[:, 1], point[:, 0]) + np.copysign(0.5 * np.pi, radius)
        turn = np.mod((passed - self.yaw) * np.sign(self.dtheta), 2 * np.pi)
        rounds = 2 * np.pi * np.arange(int(abs(self.dtheta) / (2 * np.pi)) + 1)
        t = (turn[:, None] + rounds).ravel() / abs(self.dtheta)
        return np.asarray(t[(t > 0) & (t < 1)])
