"""The frame of a raster: where it lies in the world, and its coordinates.

Column and row are counted in cells from the origin along the raster's own axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import MapError
from energyplan.kinds import numbers
from energyplan.path import FloatArray, Pose

ORIGIN = Pose(0.0, 0.0, 0.0)
"""Where a raster starts unless it says otherwise: the world's origin, unturned."""

FARTHEST = 1e7
"""Largest coordinate of maps and surfaces [m]; beyond it rounding would blur collisions."""


def to_raster(points: ArrayLike, origin: Pose, resolution: float) -> FloatArray:
    """Return world points (..., 2) [m] as (column, row)."""
    at = numbers(points, "points", MapError, last=2, words="x, y [m]")
    c, s = np.cos(origin.yaw), np.sin(origin.yaw)
    turned = (at - np.array(origin[:2])) @ np.array([[c, -s], [s, c]])
    return np.asarray(turned / resolution)


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
