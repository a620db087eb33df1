"""Ground that a model knows of: a tilted plane, or another surface beyond a line, put on a map.

A diagnosis finds such ground from a drive. On a map it belongs to the place, not to the robot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike

from energyplan.path import FloatArray, Pose
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
from energyplan.terrain.heights import HeightMap
from energyplan.terrain.surfaces import Surface, SurfaceMap, with_weights

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
