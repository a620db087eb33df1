"""Height of the ground from a raster: slope along a heading, and rise along a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import MapError
from energyplan.path import ROUNDING, STILL, FloatArray, Path, Pose, as_pose
from energyplan.records import ByValue, check_fields, checked, numbers
from energyplan.terrain.grid import ORIGIN, extent_in_words, from_raster, to_raster

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class HeightMap(ByValue):
    """Heights at the nodes of a square grid, bilinear in between.

    Parameters
    ----------
    heights : array_like, shape (rows, columns)
        Height of the ground at the nodes [m]; row 0 is the lowest in y.
    resolution : float
        Distance between nodes [m].
    origin : array_like, shape (3,)
        Pose of node (0, 0) in the world: x, y [m], yaw [rad].

    Raises
    ------
    MapError
        If shapes or numbers are wrong.

    Examples
    --------
    >>> ramp = HeightMap([[0.0, 0.1, 0.2], [0.0, 0.1, 0.2]], resolution=1.0)
    >>> ramp.slope([(0.5, 0.5, 0.0), (0.5, 0.5, np.pi)]).round(4)
    array([ 0.0997, -0.0997])
    """

    heights: FloatArray
    resolution: float
    origin: Pose = ORIGIN

    def __post_init__(self) -> None:
        check_fields(self, MapError)
        heights = np.array(self.heights, float, order="C")
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.all(np.isfinite(heights)):
            raise MapError(
                f"heights have shape {heights.shape}; give two rows and columns or more of finite "
                "metres, with holes filled"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise MapError(f"the resolution is {self.resolution} m; give a positive number")
        object.__setattr__(self, "origin", as_pose(self.origin, "the origin", MapError))

    def _locate(self, points: ArrayLike) -> tuple[NDArray[np.int_], FloatArray]:
        """Return the node below and to the left of each point, and the place in its square."""
        place = to_raster(points, self.origin, self.resolution)
        last = np.array(self.heights.shape[::-1]) - 1
        if not np.all((place >= -ROUNDING) & (place <= last + ROUNDING)):
            off = ~np.all((place >= -ROUNDING) & (place <= last + ROUNDING), axis=-1)  # NaN too
            x, y = np.asarray(points, float)[off][0]
            raise MapError(
                f"({x:.2f}, {y:.2f}) lies off the height map, which covers "
                f"{self.describe_extent()}; give a larger raster"
            )
        node = np.clip(np.floor(place), 0, last - 1).astype(int)
        return np.moveaxis(node, -1, 0), np.moveaxis(place - node, -1, 0)

    def describe_extent(self) -> str:
        """Return where heights are known, in words."""
        height, width = (np.array(self.heights.shape) - 1) * self.resolution
        return extent_in_words(width, height, self.origin)

    def height(self, points: ArrayLike) -> FloatArray:
        """Return the height at world points (..., 2) [m]."""
        (j, i), (x, y) = self._locate(points)
        h = self.heights
        low = h[i, j] * (1 - x) + h[i, j + 1] * x
        high = h[i + 1, j] * (1 - x) + h[i + 1, j + 1] * x
        return np.asarray(low * (1 - y) + high * y)

    def gradient(self, points: ArrayLike) -> FloatArray:
        """Return the gradient of the height at world points, shape (..., 2)."""
        (j, i), (x, y) = self._locate(points)
        h = self.heights
        along = (h[i, j + 1] - h[i, j]) * (1 - y) + (h[i + 1, j + 1] - h[i + 1, j]) * y
        across = (h[i + 1, j] - h[i, j]) * (1 - x) + (h[i + 1, j + 1] - h[i, j + 1]) * x
        c, s = np.cos(self.origin.yaw), np.sin(self.origin.yaw)
        rotated = np.stack([along, across], axis=-1) @ np.array([[c, s], [-s, c]])
        return np.asarray(rotated / self.resolution)

    def slope(self, poses: ArrayLike) -> FloatArray:
        """Return the slope along the heading, positive uphill ahead."""
        rows = numbers(poses, "poses", MapError, last=3, words="x, y [m], yaw [rad]")
        steep = self.gradient(rows[..., :2])
        yaw = rows[..., 2]
        return np.asarray(np.arctan(steep[..., 0] * np.cos(yaw) + steep[..., 1] * np.sin(yaw)))

    @checked(MapError)
    def rise(self, path: Path) -> float:
        """Return how much higher a path ends than it starts [m]."""
        ends = np.array([path.start[:2], path.end[:2]])
        low, high = self.height(ends)
        return float(high - low)

    def slopes(self, path: Path) -> FloatArray:
        """Return the mean slope along the heading in each segment of a path [rad], shape (n,)."""
        yaw = path.vertices[:, 2]
        point = path.points
        rise = np.diff(self.height(point))
        moves = np.abs(path.ds) > STILL
        middle = np.column_stack([0.5 * (point[1:] + point[:-1]), 0.5 * (yaw[1:] + yaw[:-1])])
        on_the_spot = self.slope(middle)
        return np.where(moves, np.arctan(rise / np.where(moves, path.ds, 1.0)), on_the_spot)

    def cut(self, path: Path) -> Path:
        """Return a path cut into segments of at most half the raster's resolution and 0.1 rad."""
        return path.subdivide(0.5 * self.resolution, 0.1)

    def contours(self, ax: Axes, levels: int = 8) -> Axes:
        """Draw lines of equal height [m] on matplotlib's axes, beneath everything else."""
        rows, columns = np.indices(self.heights.shape)
        at = from_raster(np.stack([columns, rows], axis=-1), self.origin, self.resolution)
        x, y = np.moveaxis(at, -1, 0)
        lines = ax.contour(x, y, self.heights, levels, colors="0.6", linewidths=0.7, zorder=1)
        # on a steep slope names of all lines would lie on each other
        ax.clabel(lines, list(lines.levels)[::2], fontsize="x-small", fmt="%g m")
        return ax
