"""What steering reads of a cost: two numbers of a static one, or a polygon's corners."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import FloatTable
from energyplan.cost.direction_table import Corners, DirectionTable
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR


class StaticSteering(NamedTuple):
    """A cost that two numbers describe: ``a max(|ds|, C |dtheta|) + beta |dtheta|``."""

    half_track: float  # half the slip track ``C`` [m]
    longitudinal: float  # x of the point midway between the tread ICRs, in the body frame [m]
    lateral: float  # y of that point [m]
    per_metre: float  # cost of straight driving, ``a`` [J/m]
    per_radian: float  # cost of turning within the slip track, ``a C + beta`` [J/rad]


class PolygonSteering(NamedTuple):
    """A cost whose cheapest elements are mixtures of the corners of a polygon."""

    half_track: float  # half the slip track [m]
    longitudinal: float  # x of the point midway between the tread ICRs, in the body frame [m]
    lateral: float  # y of that point [m]
    ahead: float  # cost of driving straight forwards by half the slip track [J]
    behind: float  # cost of driving straight backwards by half the slip track [J]
    left: FloatTable  # (3, m): corners that turn left: ``ds/dtheta``, J/rad, slope to the next
    right: FloatTable  # (3, m): corners that turn right, likewise


def polygon_steering(table: DirectionTable, corners: Corners, icr: TreadICR) -> PolygonSteering:
    """Return a cost as the kernels of the polygon read it; a static one is such a cost too."""
    C, x, y = map(float, (icr.half_track, *icr.centre))
    ahead, behind = float(table.special[0]) * C, float(table.special[1]) * C
    return PolygonSteering(
        half_track=C, longitudinal=x, lateral=y, ahead=ahead, behind=behind,
        left=_turn_table(corners.left, C, ahead),
        right=_turn_table(corners.right * [1.0, -1.0], C, ahead),
    )  # fmt: skip


Steering = StaticSteering | PolygonSteering


def steering_of(table: DirectionTable, corners: Corners, icr: TreadICR) -> Steering:
    """Return a cost as steering reads it: in two numbers where these describe it."""
    if not table.is_static:
        return polygon_steering(table, corners, icr)
    C, x, y = map(float, (icr.half_track, *icr.centre))
    return StaticSteering(C, x, y, float(table.special[0]), float(table.special[4]) * C)


def _turn_table(corners: FloatArray, half_track: float, straight: float) -> FloatArray:
    """Rows ``m``, ``g``, and the slopes to the next corner, of one turning direction's corners."""
    order = np.argsort(corners[:, 0] / corners[:, 1])
    x, y = corners[order].T
    m, g = x / y, half_track / y
    slope = np.diff(g) / np.diff(m)
    flat = np.flatnonzero(np.abs(slope) < 1e-7 * straight)
    if len(flat):
        # Along a flat edge every mixture costs the same and the dual says nothing about which to
        # take. A corner in its middle, cheaper by a rounding error, makes up its mind.
        k = int(flat[0]) + 1
        m, g = np.insert(m, k, 0.5 * (m[k - 1] + m[k])), np.insert(g, k, g[k - 1 : k + 1].min())
        g[k] *= 1.0 - 1e-8
        slope = np.diff(g) / np.diff(m)
    return np.vstack([m, g, np.append(slope, np.inf)])
