"""Lower bounds on the energy of any motion, from the gauge of its elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost.direction_table import Gauge
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR


@dataclass(frozen=True)
class LowerBound:
    """Coefficients of a lower bound on the energy of any motion.

    Parameters
    ----------
    per_metre : float
        Least energy per metre that a body point travels [J/m].
    per_radian : float
        Least energy per radian of turning, on top of it [J/rad].
    """

    per_metre: float
    per_radian: float

    def energy(self, length: ArrayLike, turn: ArrayLike) -> FloatArray:
        """Return the bound [J] for a length travelled [m] and a turn [rad]."""
        return np.asarray(
            self.per_metre * np.abs(np.asarray(length, float))
            + self.per_radian * np.abs(np.asarray(turn, float))
        )


def lower_bound(gauge: Gauge, icr: TreadICR, point: tuple[float, float]) -> LowerBound:
    """Return the coefficients for the path of a body point.

    Along a cone between two of the gauge's directions the energy is linear and the distance that
    the point travels is convex, so their difference is least at the directions themselves.
    """
    x, y = gauge.directions.T
    energy = gauge.values * (1.0 - 2.0 * gauge.error)
    lx, ly = icr.centre
    turn = y / icr.half_track
    travel = np.hypot(x - (point[1] - ly) * turn, (point[0] - lx) * turn)
    moves, turns = travel > 0, turn != 0
    per_metre = float(np.min(energy[moves] / travel[moves]))
    rest = (energy - per_metre * travel)[turns] / np.abs(turn[turns])
    return LowerBound(per_metre, max(float(rest.min()), 0.0))
