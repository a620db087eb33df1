"""Height of the ground from a raster: slope along a heading, and rise along a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost import EnergyCost
from energyplan.errors import MapError
from energyplan.path import FloatArray, Path, Pose

ORIGIN = Pose(0.0, 0.0, 0.0)
"""Where a raster starts unless it says otherwise: the world's origin, unturned."""


@dataclass(frozen=True, eq=False)
class HeightMap:
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
        heights = np.array(self.heights, float)
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.all(np.isfinite(heights)):
            raise MapError(
                f"heights have shape {heights.shape}; give two rows and columns or more of finite "
                "metres, with holes filled"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise MapError(f"the resolution is {self.resolution} m; give a positive number")
        origin = np.asarray(self.origin, float)
        if origin.shape != (3,) or not np.all(np.isfinite(origin)):
            raise MapError(f"the origin is {origin.tolist()}; give x, y [m] and yaw [rad]")
        object.__setattr__(self, "origin", Pose(*(float(v) for v in origin)))

    def _locate(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the node below and to the left of each point, and the place in its square."""
        offset = np.asarray(points, float) - np.array(self.origin[:2])
        c, s = np.cos(self.origin.yaw), np.sin(self.origin.yaw)
        place = offset @ np.array([[c, -s], [s, c]]) / self.resolution
        last = np.array(self.heights.shape[::-1]) - 1
        if not np.all((place >= -1e-9) & (place <= last + 1e-9)):
            raise MapError("a point lies off the height map; give a larger raster")
        node = np.clip(np.floor(place), 0, last - 1)
        return node, place - node

    def height(self, points: ArrayLike) -> FloatArray:
        """Return the height at world points (..., 2) [m].

        Raises
        ------
        MapError
            If a point lies off the raster.
        """
        node, part = self._locate(points)
        i, j = node[..., 1].astype(int), node[..., 0].astype(int)
        x, y = part[..., 0], part[..., 1]
        h = self.heights
        low = h[i, j] * (1 - x) + h[i, j + 1] * x
        high = h[i + 1, j] * (1 - x) + h[i + 1, j + 1] * x
        return np.asarray(low * (1 - y) + high * y)

    def gradient(self, points: ArrayLike) -> FloatArray:
        """Return the gradient of the height at world points, shape (..., 2).

        Raises
        ------
        MapError
            If a point lies off the raster.
        """
        node, part = self._locate(points)
        i, j = node[..., 1].astype(int), node[..., 0].astype(int)
        x, y = part[..., 0], part[..., 1]
        h = self.heights
        along = (h[i, j + 1] - h[i, j]) * (1 - y) + (h[i + 1, j + 1] - h[i + 1, j]) * y
        across = (h[i + 1, j] - h[i, j]) * (1 - x) + (h[i + 1, j + 1] - h[i, j + 1]) * x
        c, s = np.cos(self.origin.yaw), np.sin(self.origin.yaw)
        turned = np.stack([along, across], axis=-1) @ np.array([[c, s], [-s, c]])
        return np.asarray(turned / self.resolution)

    def slope(self, poses: ArrayLike) -> FloatArray:
        """Return the slope along the heading, positive uphill ahead.

        Parameters
        ----------
        poses : array_like, shape (..., 3)
            Poses x, y [m], yaw [rad].

        Returns
        -------
        ndarray, shape (...)
            Slope [rad].

        Raises
        ------
        MapError
            If a pose lies off the raster.
        """
        rows = np.asarray(poses, float)
        steep = self.gradient(rows[..., :2])
        yaw = rows[..., 2]
        return np.asarray(np.arctan(steep[..., 0] * np.cos(yaw) + steep[..., 1] * np.sin(yaw)))

    def rise(self, path: Path) -> float:
        """Return how much higher a path ends than it starts [m]."""
        ends = np.array([path.start[:2], path.end[:2]])
        low, high = self.height(ends)
        return float(high - low)

    def energy(self, path: Path, cost: EnergyCost) -> float:
        """Return the energy of a path on the slopes of this ground [J].

        The path is cut into pieces of half the raster's resolution and 0.1 rad at most, each
        priced at the slope of its middle; halving them changes the energy by a quarter as much
        each time. Lengths are taken in plan view, which misses half a percent at 6 degrees.

        Parameters
        ----------
        path : Path
            The path.
        cost : EnergyCost
            Cost of motions. Its model needs a term that reads the slope, such as the grade, for
            the slope to matter.

        Returns
        -------
        float
            Energy.

        Raises
        ------
        MapError
            If the path leaves the raster.
        """
        fine = path.subdivide(0.5 * self.resolution, 0.1)
        vertices = fine.vertices
        yaw = 0.5 * (vertices[1:, 2] + vertices[:-1, 2])
        heading = np.column_stack([np.cos(vertices[:, 2]), np.sin(vertices[:, 2])])
        point = vertices[:, :2] + path.longitudinal * heading
        middle = np.column_stack([0.5 * (point[1:] + point[:-1]), yaw])
        return float(cost.segment_energy(fine.ds, fine.dtheta, self.slope(middle)).sum())
