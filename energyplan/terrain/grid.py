"""Where the robot goes: occupancy grids, and whether a footprint is free on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from energyplan import html
from energyplan.errors import MapError
from energyplan.path import ROUNDING, FloatArray, Path, Pose, as_pose
from energyplan.records import ByValue, check_fields, checked, instance, numbers
from energyplan.terrain import collision as _collision
from energyplan.terrain.updates import (
    distance_to_blocked,
    new_space,
    place_of_patch,
    updated_space,
    window_of,
)
from energyplan.vehicle import Vehicle

ORIGIN = Pose(0.0, 0.0, 0.0)
"""Where a raster starts unless it says otherwise: the world's origin, unturned."""

FARTHEST = 1e7
"""Largest coordinate of maps and surfaces [m]; beyond it rounding would blur collisions."""


def to_raster(points: ArrayLike, origin: Pose, resolution: float) -> FloatArray:
    """Return world points (..., 2) [m] as (column, row)."""
    at = numbers(points, "points", MapError, last=2, words="x, y [m]")
    c, s = np.cos(origin.yaw), np.sin(origin.yaw)
    with np.errstate(over="ignore"):  # what lies so far away is off any map
        return np.asarray((at - np.array(origin[:2])) @ np.array([[c, -s], [s, c]]) / resolution)


def from_raster(cells: ArrayLike, origin: Pose, resolution: float) -> FloatArray:
    """Return (column, row) coordinates (..., 2) as world points [m]: undoes `to_raster`."""
    at = numbers(cells, "cells", MapError, last=2, words="column, row") * resolution
    c, s = np.cos(origin.yaw), np.sin(origin.yaw)
    return np.asarray(at @ np.array([[c, s], [-s, c]]) + np.array(origin[:2]))


def extent_in_words(width: float, height: float, origin: Pose) -> str:
    """Return where a raster of this size [m] lies."""
    x, y, yaw = origin
    if yaw == 0.0:
        return f"x from {x:g} to {x + width:g} m and y from {y:g} to {y + height:g} m"
    corner = f"{width:g} m by {height:g} m from its corner ({x:g}, {y:g})"
    return f"{corner}, turned by {np.degrees(yaw):.1f} deg"


BoolArray = NDArray[np.bool_]

MAX_CELLS = 2**26  # largest number of cells of a map; more counts as a mistake or an attack
MIN_RESOLUTION, MAX_RESOLUTION = 1e-4, 1e4  # smallest and largest size of a cell [m]


def _frozen_bool(value: ArrayLike, name: str) -> BoolArray:
    array = np.array(value)
    if array.ndim != 2 or array.size == 0 or array.dtype != np.bool_:
        raise MapError(
            f"{name} has shape {array.shape} and type {array.dtype}; give rows and columns of "
            "bool, such as values > 0"
        )
    if array.size > MAX_CELLS:
        raise MapError(f"{name} has {array.size} cells; at most {MAX_CELLS} are possible")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class OccupancyGrid(ByValue, html.Readable):
    """A grid of square cells that are occupied, unknown or free.

    Parameters
    ----------
    occupied : array_like of bool, shape (rows, columns)
        Occupied cells. Row 0 is the lowest, column 0 the leftmost.
    resolution : float
        Size of a cell [m].
    origin : array_like, shape (3,)
        Pose of the outer corner of cell (0, 0) in the world: x, y [m], yaw [rad]. The columns
        count along its x axis, the rows along its y axis.
    unknown : array_like of bool, shape (rows, columns), optional
        Cells of which nothing is known; none if left out.
    unknown_is_free : bool
        Whether the robot may enter unknown cells.

    Raises
    ------
    MapError
        If shapes or numbers are wrong.

    Examples
    --------
    >>> grid = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.05)
    >>> quadriga = Vehicle.preset("quadriga")
    >>> grid.footprint_free([(2.5, 2.5, 0.3), (0.3, 2.5, 0.0)], quadriga)
    array([ True, False])
    """

    occupied: BoolArray
    resolution: float
    origin: Pose = ORIGIN
    unknown: BoolArray | None = None
    unknown_is_free: bool = False

    def __post_init__(self) -> None:
        check_fields(self, MapError)
        object.__setattr__(self, "occupied", _frozen_bool(self.occupied, "occupied"))
        if self.unknown is not None:
            object.__setattr__(self, "unknown", _frozen_bool(self.unknown, "unknown"))
            if self.unknown.shape != self.occupied.shape:
                raise MapError(
                    f"unknown has shape {self.unknown.shape}, occupied {self.occupied.shape}; "
                    "give the same"
                )
        if not MIN_RESOLUTION <= self.resolution <= MAX_RESOLUTION:
            raise MapError(
                f"the resolution is {self.resolution} m; give metres from {MIN_RESOLUTION} to "
                f"{MAX_RESOLUTION}"
            )
        origin = as_pose(self.origin, "the origin", MapError)
        if max(map(abs, origin)) > FARTHEST:
            raise MapError(f"the origin is {tuple(origin)}; give none beyond {FARTHEST:g} m")
        object.__setattr__(self, "origin", origin)

    def _summaries(self) -> list[html.Summary]:
        size = " x ".join(html.number(v) for v in self.size)
        rows = (("size [m]", size), ("occupied [%]", 100 * float(np.mean(self.occupied))))
        return [html.Summary("map", ("", ""), rows)]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.occupied.shape
        return rows, columns

    @property
    def size(self) -> tuple[float, float]:
        """Width (along the rows) and height of the map [m]."""
        rows, columns = self.shape
        return columns * self.resolution, rows * self.resolution

    @property
    def corners(self) -> FloatArray:
        """Corners of the map in the world, shape (4, 2) [m]."""
        rows, columns = self.shape
        return self.to_world([(0, 0), (columns, 0), (columns, rows), (0, rows)])

    @cached_property
    def blocked(self) -> BoolArray:
        """Cells that the robot must not touch, shape (rows, columns)."""
        blocked = self.occupied
        if self.unknown is not None and not self.unknown_is_free:
            blocked = blocked | self.unknown
        blocked.setflags(write=False)
        return blocked

    @cached_property
    def clearance(self) -> NDArray[np.float32]:
        """Distance from each cell's centre to the nearest blocked cell's area or map edge [m].

        Exact to rounding; 0 in blocked cells. A point anywhere in a cell is at most half a
        diagonal, 0.71 cells, nearer or farther than the cell's centre.
        """
        metres = self.space.clearance * np.float32(self.resolution)
        metres.setflags(write=False)
        return metres

    @property
    def space(self) -> _collision.Space:
        """The blocked cells, their distances and the frame; the first ones computed are kept."""
        found = vars(self).get("space") or new_space(self.blocked, self.origin, self.resolution)
        kept: _collision.Space = vars(self).setdefault("space", found)
        return kept

    @checked(MapError)
    def updated(
        self, occupied: ArrayLike, row: int, column: int, unknown: ArrayLike | None = None
    ) -> OccupancyGrid:
        """Return this map with a patch of its cells replaced.

        Tables of this map are kept where nothing changes, and computed again near changes, so that
        a small patch costs little. The result is the same as that of a new map.

        Parameters
        ----------
        occupied : array_like of bool, shape (m, n)
            Occupied cells of the patch.
        row, column : int
            Cell of this map that cell (0, 0) of the patch replaces.
        unknown : array_like of bool, shape (m, n), optional
            Cells of the patch of which nothing is known; none if left out.

        Returns
        -------
        OccupancyGrid
            The map as it is now.

        Raises
        ------
        MapError
            If the patch does not lie on the map, or shapes or types are wrong.

        Examples
        --------
        >>> hall = OccupancyGrid(np.zeros((40, 40), bool), resolution=0.1)
        >>> closed = hall.updated(np.ones((1, 40), bool), row=20, column=0)
        >>> int(closed.occupied.sum()), int(hall.occupied.sum())
        (40, 0)
        """
        patch = _frozen_bool(occupied, "the patch")
        hidden = _frozen_bool(
            np.zeros(patch.shape, bool) if unknown is None else unknown, "unknown"
        )
        if hidden.shape != patch.shape:
            raise MapError(f"unknown has shape {hidden.shape}, the patch {patch.shape}; give one")
        place = place_of_patch(patch.shape, self.shape, row, column)
        cells = self.occupied.copy()
        cells[place] = patch
        known = self.unknown
        if known is not None or hidden.any():
            known = np.zeros(self.shape, bool) if known is None else known.copy()
            known[place] = hidden
        new = replace(self, occupied=cells, unknown=known)
        if "space" in self.__dict__:
            window = window_of(new.blocked[place] != self.blocked[place], row, column)
            new.__dict__["space"] = updated_space(self.space, new.blocked, window)
        return new

    def with_unknown_free(self, free: bool = True) -> OccupancyGrid:
        """Return this map with its unknown cells free to enter, or not."""
        return replace(self, unknown_is_free=free)

    def with_blocked(self, areas: BaseGeometry | Iterable[BaseGeometry]) -> OccupancyGrid:
        """Return this map with every cell that `areas` touch occupied: keep-out areas, for one.

        Parameters
        ----------
        areas : shapely geometry or iterable of them
            Areas in the world [m].

        Returns
        -------
        OccupancyGrid
            The map with more cells occupied.
        """
        return replace(self, occupied=self.occupied | self.touched_by(areas))

    @checked(MapError)
    def with_mask(self, mask: OccupancyGrid) -> OccupancyGrid:
        """Return this map with every cell occupied that a keep-out mask blocks.

        Parameters
        ----------
        mask : OccupancyGrid
            A mask as Nav2 has them, of any frame and resolution; only its occupied cells count.

        Returns
        -------
        OccupancyGrid
            The map with more cells occupied; where the grids do not coincide, to a cell's diagonal.
        """
        if mask.shape == self.shape and mask.resolution == self.resolution:
            offset = np.subtract(mask.origin, self.origin)
            if np.abs(offset[:2]).max() < 1e-6 * self.resolution and abs(offset[2]) < ROUNDING:
                return replace(self, occupied=self.occupied | mask.occupied)
        near = np.sqrt(0.5) * self.resolution / mask.resolution
        # so wide that no clearance counts that is one to the edge
        rim = int(np.ceil(near)) + 2
        far = distance_to_blocked(np.pad(mask.occupied, 2 * rim))
        touched = np.zeros(self.shape, bool)
        for row in range(len(touched)):
            at = mask.to_cells(self.centres(row)) + 2.0 * rim
            cell = np.floor(at).astype(int)
            inside = np.all((cell >= rim) & (cell < np.array(far.shape[::-1]) - rim), axis=1)
            column, line = np.where(inside[:, None], cell, 0).T
            off = np.hypot(*(at - cell - 0.5).T)
            touched[row] = inside & (far[line, column] <= near + off)
        return replace(self, occupied=self.occupied | touched)

    def note_of_mask(self, mask: OccupancyGrid) -> str | None:
        """Say why a keep-out mask closes no cell of this map, if it closes none."""
        if bool(np.any(self.with_mask(mask).blocked & ~self.blocked)):
            return None
        if not mask.occupied.any():
            why = "none of its own is occupied; check its image, mode, negate and thresholds"
        elif replace(self, occupied=np.zeros_like(self.occupied)).with_mask(mask).occupied.any():
            why = "what it closes is blocked already"
        else:
            why = (
                f"it covers {mask.describe_extent()}, the map {self.describe_extent()}; check its "
                "origin and resolution"
            )
        return f"the keep-out mask closes no cell of the map: {why}"

    def touched_by(self, areas: BaseGeometry | Iterable[BaseGeometry]) -> BoolArray:
        """Return the cells that some area in the world [m] touches, shape (rows, columns)."""
        geometries = list(areas) if isinstance(areas, Iterable) else [areas]
        for area in geometries:
            instance(area, BaseGeometry, "an area", MapError)
            if not np.isfinite(shapely.get_coordinates(area)).all():
                raise MapError("an area has a corner that is not finite; correct it")
        touched, (rows, columns) = np.zeros(self.shape, bool), self.shape
        for geometry in (g for g in geometries if not g.is_empty):
            cells = shapely.transform(geometry, self.to_cells)
            left, low, right, high = cells.bounds
            first, last = max(int(left) - 1, 0), min(int(right) + 2, columns)
            bottom, top = max(int(low) - 1, 0), min(int(high) + 2, rows)
            if first >= last or bottom >= top:
                continue
            shapely.prepare(cells)
            x, y = np.meshgrid(np.arange(first, last), np.arange(bottom, top))
            squares = shapely.box(x, y, x + 1, y + 1)
            touched[bottom:top, first:last] |= shapely.intersects(cells, squares)
        return touched

    def to_cells(self, points: ArrayLike) -> FloatArray:
        """Return world points (..., 2) [m] as (column, row): cell (0, 0) is the unit square."""
        return to_raster(points, self.origin, self.resolution)

    def to_world(self, cells: ArrayLike) -> FloatArray:
        """Return (column, row) coordinates (..., 2) as world points [m]: undoes `to_cells`."""
        return from_raster(cells, self.origin, self.resolution)

    def centres(self, row: int) -> FloatArray:
        """Return the centres of the cells of a row as world points [m], shape (columns, 2)."""
        columns = np.arange(self.shape[1]) + 0.5
        return self.to_world(np.column_stack([columns, np.full(len(columns), row + 0.5)]))

    def inside(self, points: ArrayLike) -> BoolArray:
        """Return which world points (..., 2) [m] lie on the map."""
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows lies on no map
            cells = self.to_cells(points)
        return np.asarray(np.all((cells >= 0) & (cells <= self.shape[::-1]), axis=-1))

    def describe_extent(self) -> str:
        """Return where the map lies, in words."""
        return extent_in_words(*self.size, self.origin)

    def clearance_at(self, points: ArrayLike) -> FloatArray:
        """Return the clearance of the cells that hold world points (..., 2) [m]; 0 off the map."""
        return self.values_at(self.clearance, points)

    def values_at(self, table: NDArray[np.floating], points: ArrayLike) -> FloatArray:
        """Return a table's values (rows, columns) at world points (..., 2) [m]; 0 off the map."""
        cells = np.floor(self.to_cells(points)).astype(int)
        on_map = np.all((cells >= 0) & (cells < self.shape[::-1]), axis=-1)
        column, row = np.moveaxis(np.where(on_map[..., None], cells, 0), -1, 0)
        return np.where(on_map, table[row, column], 0.0)

    def footprint_free(self, poses: ArrayLike, vehicle: Vehicle) -> BoolArray:
        """Return at which poses the vehicle's footprint is free.

        Exact for the rectangle in every heading: free means that it lies on the map and touches
        no blocked cell.

        Parameters
        ----------
        poses : array_like, shape (..., 3)
            Poses of the body frame: x, y [m], yaw [rad].
        vehicle : Vehicle
            The vehicle, for its footprint.

        Returns
        -------
        ndarray of bool, shape (...)
            Where it is free.
        """
        rows = numbers(poses, "poses", MapError, last=3, words="x, y [m], yaw [rad]")
        flat = np.ascontiguousarray(rows.reshape(-1, 3))
        free = _collision.poses_free(self.space, footprint(vehicle), flat)
        return np.asarray(free.reshape(rows.shape[:-1]))

    def first_collision(self, path: Path, vehicle: Vehicle) -> int | None:
        """Return the index of the path's first segment that is not free, or None."""
        instance(path, Path, "path")
        body = footprint(vehicle)
        if len(path) == 0:
            return None if _collision.pose_free(self.space, body, *path.start) else 0
        index = _collision.first_collision(
            self.space, body, path.vertices, path.ds, path.dtheta, path.longitudinal
        )
        return None if index < 0 else index

    def path_free(self, path: Path, vehicle: Vehicle) -> bool:
        """Return whether the vehicle's footprint is free along the whole path.

        Exact for straight lines. Where the vehicle turns there is no false free; a path that
        passes an obstacle within a fiftieth of a cell may count as colliding.

        Parameters
        ----------
        path : Path
            The path.
        vehicle : Vehicle
            The vehicle, for its footprint.

        Returns
        -------
        bool
            Whether it is free.
        """
        return self.first_collision(path, vehicle) is None

    def motions_free(
        self,
        starts: ArrayLike,
        ds: ArrayLike,
        dtheta: ArrayLike,
        vehicle: Vehicle,
        longitudinal: float = 0.0,
    ) -> BoolArray:
        """Return along which of many motions, each from its own pose, the footprint is free.

        Arguments as in `Path`, one for each motion; as exact as `path_free`.
        """
        poses = numbers(starts, "starts", MapError, last=3, words="x, y [m], yaw [rad]")
        rows = np.ascontiguousarray(poses.reshape(-1, 3))
        each = [numbers(value, "ds, dtheta", MapError) for value in (ds, dtheta)]
        if any(value.shape not in ((), (1,), (len(rows),)) for value in each):
            shapes = f"ds has shape {each[0].shape}, dtheta {each[1].shape}"
            raise MapError(f"{shapes}; give one of each for {len(rows)} starts")
        way, turn = (np.ascontiguousarray(np.broadcast_to(v, len(rows))) for v in each)
        return _collision.motions_free(
            self.space, footprint(vehicle), rows, way, turn, longitudinal
        )

    @classmethod
    @checked(MapError)
    def from_polygons(
        cls,
        obstacles: BaseGeometry | Iterable[BaseGeometry],
        bounds: tuple[float, float, float, float],
        resolution: float = 0.05,
    ) -> OccupancyGrid:
        """Build a map from the shapes of obstacles; every cell that one touches is occupied.

        Parameters
        ----------
        obstacles : shapely geometry or iterable of them
            Obstacles in the world [m].
        bounds : tuple of float
            x_min, y_min, x_max, y_max of the map [m].
        resolution : float
            Size of a cell [m].

        Returns
        -------
        OccupancyGrid
            The map.

        Raises
        ------
        MapError
            If the bounds are empty or hold too many cells.
        """
        edges = numbers(bounds, "bounds", MapError, last=4, words="x_min, y_min, x_max, y_max [m]")
        left, low, right, high = edges.tolist()
        if not (right > left and high > low and resolution > 0):
            raise MapError(f"bounds {bounds} and resolution {resolution} m make no map")
        size = np.ceil(np.array([right - left, high - low]) / resolution - ROUNDING)
        columns, rows = map(int, size)
        if rows * columns > MAX_CELLS:
            cells = f"{rows * columns} cells, more than {MAX_CELLS}"
            raise MapError(f"bounds {bounds} make {cells}; choose a coarser resolution")
        empty = cls(np.zeros((rows, columns), bool), resolution, Pose(left, low, 0.0))
        return empty.with_blocked(obstacles)


def footprint(vehicle: Vehicle) -> _collision.Body:
    """Return the vehicle's footprint as the collision kernels take it."""
    instance(vehicle, Vehicle, "vehicle")
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    return _collision.Body(x_min, y_min, x_max, y_max)


PIECE = 0.25  # length of the segments of a path that pay for the cell under their middle [cells]


@dataclass(frozen=True, eq=False)
class CostMap(ByValue):
    """Costs of cells from 0 (none) to 1 (the highest)."""

    costs: FloatArray  # (rows, columns): costs
    resolution: float  # size of a cell [m]
    origin: Pose = ORIGIN  # (3,): pose of the outer corner of cell (0, 0) in the world

    def __post_init__(self) -> None:
        costs = np.array(self.costs, float)
        if costs.ndim != 2 or costs.size == 0 or not np.all((costs >= 0) & (costs <= 1)):
            raise MapError(
                f"costs have shape {costs.shape}; give rows and columns of numbers from 0 to 1"
            )
        costs.setflags(write=False)
        object.__setattr__(self, "costs", costs)
        # it lies where a map of the same frame would
        frame = OccupancyGrid(np.zeros(costs.shape, bool), self.resolution, self.origin)
        object.__setattr__(self, "origin", frame.origin)
        object.__setattr__(self, "_frame", frame)

    def at(self, points: ArrayLike) -> FloatArray:
        """Return the cost at world points (..., 2) [m]; 0 outside."""
        frame: OccupancyGrid = self.__dict__["_frame"]
        return frame.values_at(self.costs, points)

    def along(self, path: Path) -> float:
        """Return the costs along a path, times the metres of its reference point [m]."""
        fine = path.subdivide(PIECE * self.resolution)
        points = fine.points
        middle = 0.5 * (points[:-1] + points[1:])
        return float(np.sum(np.abs(fine.ds) * self.at(middle)))

    def over(self, grid: OccupancyGrid) -> FloatArray:
        """Return the costs at the centres of a map's cells, shape (rows, columns)."""
        return np.stack([self.at(grid.centres(row)) for row in range(grid.shape[0])])
