"""What the objective makes of motions: energy, length and time, weighed, on every ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost import EnergyCost
from energyplan.path import FloatArray
from energyplan.planning.problem import objective_weights
from energyplan.terrain import SurfaceMap

TIE_BREAK = 0.01
"""Weight of the energy, as metres of straight driving, in the length objective."""


@dataclass(frozen=True, eq=False)
class Prices:
    """Prices of motions of `Path`'s reference point.

    Parameters
    ----------
    cost : EnergyCost
        Cost of motions.
    surfaces : SurfaceMap, optional
        Grounds with power models of their own.
    objective : str or mapping of str to float
        What to make least, as in `PlanningProblem`.
    """

    cost: EnergyCost
    surfaces: SurfaceMap | None = None
    objective: str | Mapping[str, float] = "energy"

    @cached_property
    def costs(self) -> tuple[EnergyCost, ...]:
        """Costs of the regions; that outside all surfaces is the first."""
        return (self.cost,) if self.surfaces is None else self.surfaces.costs(self.cost)

    @cached_property
    def _weights(self) -> tuple[float, float, float]:
        """Weights of energy, length and time.

        Of the routes of one length the one of least energy is wanted, so length counts energy too.
        """
        given = objective_weights(self.objective)
        length = given.get("length", 0.0)
        tie = TIE_BREAK / float(self.cost.segment_energy(1.0, 0.0))
        return given.get("energy", 0.0) + tie * length, length, given.get("time", 0.0)

    def motion(
        self,
        ds: ArrayLike,
        dtheta: ArrayLike,
        region: int = 0,
        steep: ArrayLike | None = None,
        *,
        exact: bool = False,
    ) -> FloatArray:
        """Return the price of arcs within one region.

        Parameters
        ----------
        ds : array_like, shape (...)
            Signed arc length of the reference point in plan view [m].
        dtheta : array_like, shape (...)
            Signed turn [rad].
        region : int
            Number of the region.
        steep : array_like, shape (...), optional
            Slope along the heading, as rise over run; level where not given.
        exact : bool
            Whether to ask the model itself, speeds included, rather than its tables.

        Returns
        -------
        ndarray, shape (...)
            Prices in the unit of the objective.
        """
        cost = self.costs[region]
        energy, length, time = self._weights
        slope: ArrayLike | None = 0.0 if exact else None
        along = np.asarray(ds, float)
        if steep is not None:
            slope, along = np.arctan(steep), along * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, slope, exact=exact)
        total = total + length * np.abs(ds)
        if time:  # without need a vehicle without a speed limit is not asked for its time
            total = total + time * cost.segment_duration(along, dtheta, exact=exact)
        return np.asarray(total)

    def floor(self, ds: ArrayLike, dtheta: ArrayLike, region: int, steep: ArrayLike) -> FloatArray:
        """Return what arcs on slopes cost at least; arguments as for `motion`.

        Where time is weighed otherwise than the cheapest speed weighs it, durations may jump from
        one direction to the next, so that the fastest admissible speed stands for them.
        """
        cost = self.costs[region]
        energy, length, time = self._weights
        if time <= energy * cost.time_value * (1.0 + 1e-9):
            return self.motion(ds, dtheta, region, steep)
        along = np.asarray(ds, float) * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, np.arctan(steep), exact=False)
        least = cost.segment_duration(along, dtheta, fastest=True)
        return np.asarray(total + length * np.abs(ds) + time * least)

    def value(self, energy: float, length: float, duration: float) -> float:
        """Return the price of a whole path, given its energy [J], length [m] and duration [s]."""
        weights = self._weights
        timed = weights[2] * duration if weights[2] else 0.0
        return weights[0] * energy + weights[1] * length + timed
