"""Upper bounds of the energy of motions, with a given probability, for an uncertain model.

A model's coefficients are uncertain together: with `w` the change of a path's energy per standard
deviation of each independent unknown, its energy has the standard deviation ``|w|``. A norm of a
sum is at most the sum of the norms. So motions priced at their mean and `z` deviations of their own
add up to no less than the mean and `z` deviations of the whole path, and a search can use that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.fit.residuals import unfounded
from energyplan.path import FloatArray
from energyplan.planning.scene import slopes
from energyplan.planning.scene.compiled import CompiledProblem

STEP = 0.01
"""Part of a standard deviation by which coefficients are changed to see what that does."""


@dataclass(frozen=True, eq=False)
class UpperPrices:
    """Prices that motions exceed with a small probability only."""

    extra: FloatArray  # (classes * slopes, rays): what is added to the mean price of each ray
    noise: float  # [J]
    quantile: float  # standard deviations that are added

    def whole(self, priced: FloatArray) -> FloatArray:
        """Return what whole paths take at most, given the sum of their prices [J]."""
        if self.noise == 0.0:
            return priced
        return np.asarray(priced + self.quantile * np.sqrt(self.noise * priced))


def upper_prices(query: CompiledProblem, confidence: float, spread: float) -> UpperPrices:
    """Return prices that bound the energy of paths with a probability."""
    if not 0.5 <= confidence < 1.0:
        raise InvalidInputError(f"the confidence is {confidence}; give a part from 0.5 to below 1")
    if not 0.0 <= spread < 1.0:
        raise InvalidInputError(
            f"the coefficient spread is {spread}; give a part from 0 to below 1"
        )
    quantile = NormalDist().inv_cdf(confidence)
    half = query.problem.cost.half_track
    ds, dtheta = query.reference(query.rays[:, 0], query.rays[:, 1] / half)
    steep = np.zeros((1, 1))
    if query.steepest > slopes.FLAT:
        steep = np.linspace(-query.steepest, query.steepest, slopes.BINS)[:, None]
    along, slope = ds * np.hypot(1.0, steep), np.arctan(steep)
    extra, noise = [], 0.0
    for cost in query.costs:
        if reason := unfounded(cost.model, confidence, spread):
            raise InvalidInputError(reason)
        mean = cost.segment_energy(along, dtheta, slope)
        residual = cost.model.residual
        error = 0.0 if residual is None else abs(residual.energy_error)
        square = (error * mean) ** 2
        for step in _directions(cost, spread).T:
            more, less = (
                replace(
                    cost,
                    model=cost.model.with_coefficients(
                        cost.model.coefficients + sign * STEP * step
                    ),
                ).segment_energy(along, dtheta, slope)
                for sign in (1.0, -1.0)
            )
            square = square + (0.5 * (more - less) / STEP) ** 2
        extra.append(quantile * np.sqrt(square))
        if residual is not None and residual.rmse > 0:
            watts = 2.0 * residual.rmse**2 * residual.correlation_time
            level = cost.segment_energy(ds, dtheta)
            noise = max(noise, float(np.max(watts * cost.segment_duration(ds, dtheta) / level)))
    return UpperPrices(np.concatenate(extra).reshape(-1, len(ds)), noise, quantile)


def energy_of_charge(cost: EnergyCost, battery: Battery, soc: float = 1.0) -> float:
    """Return what a charge delivers at the power of the most expensive motion [J]."""
    return float(battery.usable_energy(most_power(cost), soc))


def most_power(cost: EnergyCost) -> float:
    """Return the largest power that steady motion on level ground takes [W]."""
    angle = np.linspace(0.0, 2.0 * np.pi, 65)
    ds, dtheta = np.cos(angle), np.sin(angle) / cost.half_track
    return float(np.max(cost.segment_energy(ds, dtheta) / cost.segment_duration(ds, dtheta)))


def _directions(cost: EnergyCost, spread: float) -> FloatArray:
    """Return the changes of the coefficients per independent unknown, shape (terms, unknowns)."""
    model = cost.model
    columns = [np.diag(spread * model.coefficients)] if spread > 0 else []
    if model.covariance is not None:
        value, vector = np.linalg.eigh(model.covariance)
        keep = value > 1e-12 * max(float(value.max()), 1e-300)
        columns.append(vector[:, keep] * np.sqrt(value[keep]))
    return np.column_stack(columns) if columns else np.zeros((len(model.terms), 0))
