"""The random effect of a run: by which factor its energy differs from that of its like (private).

Runs of one robot differ as a whole, by loads, temperatures and surfaces that no channel shows.
The prediction for the next run is no surer than that, however well its coefficients are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import fdtrc
from scipy.stats import t as student

from energyplan.fit.drive import Drive
from energyplan.fit.regressors import DesignMatrix, linearise_drive
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Residual

LEVEL = 0.9
"""Probability that the interval of an energy holds it, where nothing else is given."""

_COMPARED = 3  # runs from which on they show how much they differ
_ASSUMED = 2.0  # degrees of freedom of a deviation that is assumed: robots and surfaces differ
_WITHIN = 30.0  # of what is known from within runs
_PRIOR = 4  # runs that the deviation counts for, of a model that lacks nothing
_EXACT = 0.005  # that deviation


class Energy(NamedTuple):
    """A predicted energy and its interval [J]."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class RunEffect:
    """By how much the energy of a run differs from what a model says of it, relative to that."""

    mean: float = 0.0
    deviation: float = USUAL_RUN_SPREAD  # of a run to come
    freedom: float = _ASSUMED  # degrees of freedom that the deviation is known with
    compared: bool = False  # whether runs were compared for it
    density: float = 0.0  # of the residual within runs, by time [W^2 s]
    p_value: float = 1.0  # that runs do not differ
    error: float = 0.0  # relative error of the energy of drives that were held out

    @classmethod
    def known(cls, residual: Residual | None, typical: float = USUAL_RUN_SPREAD) -> RunEffect:
        """Return what a model's residual says of a run to come; `usual` where it does not."""
        if residual is None:
            return cls(deviation=typical)
        density = 2.0 * residual.rmse**2 * residual.correlation_time
        spread = typical if residual.run_spread is None else residual.run_spread
        return cls(deviation=spread, density=density, error=abs(residual.energy_error))

    @classmethod
    def between(cls, design: DesignMatrix, values: FloatArray, length: float) -> RunEffect:
        """Compare runs by their longest windows (Paule's and Mandel's estimate), `length` [s]."""
        # Source: Paule and Mandel (1982), J. Res. NBS 87, 377-385.
        table, owner = design.longest
        count = int(owner.max()) + 1
        predicted, measured = table[:, :-1] @ values, table[:, -1]
        if count < _COMPARED or len(owner) == count:
            return cls(density=float(np.mean((measured - predicted) ** 2)) * length)
        square = np.bincount(owner, predicted**2, count)
        product = np.bincount(owner, predicted * measured, count)
        excess = product / np.maximum(square, 1e-300) - 1.0
        scatter = measured - predicted * (1.0 + excess[owner])
        windows = np.bincount(owner, minlength=count)
        freedom = float(np.sum(np.maximum(windows - 1, 0)))
        noise = float(scatter @ scatter) / freedom
        variances = np.maximum(noise / np.maximum(square, 1e-300), 1e-12)

        def misfit(between: float) -> float:
            weight = 1.0 / (variances + between)
            return float(weight @ (excess - weight @ excess / weight.sum()) ** 2) - (count - 1)

        between = 0.0
        if misfit(0.0) > 0.0:
            most = 2.0 * float(np.var(excess, ddof=1)) + 1e-12
            between = float(brentq(misfit, 0.0, most)) if misfit(most) < 0.0 else most
        chance = fdtrc(count - 1, freedom, misfit(0.0) / (count - 1) + 1.0)
        density = float(np.mean(scatter**2)) * length
        return cls(0.0, float(np.sqrt(between)), count - 1.0, True, density, float(chance))

    @classmethod
    def of(cls, ratios: Sequence[float], residual: Residual | None = None) -> RunEffect:
        """Learn from measured over predicted energies; the prior is that of a right model."""
        count = len(ratios)
        mean = float(np.mean(ratios)) - 1.0 if count else 0.0
        freedom = float(_PRIOR + max(count - 1, 0))
        scatter = float(np.sum(np.square(np.array(ratios) - 1.0 - mean)))
        variance = (_PRIOR * _EXACT**2 + scatter) / freedom * (1.0 + 1.0 / max(count, 1))
        known = cls.known(residual)
        return replace(known, mean=mean, deviation=float(np.sqrt(variance)), freedom=freedom)

    def at_least(self, deviation: float) -> RunEffect:
        """Return the effect with the error of runs that were left out, where that is larger."""
        return replace(self, deviation=max(self.deviation, deviation))

    @classmethod
    def usual_factor(cls, said: FloatArray, measured: FloatArray) -> float:
        """Fit the factor of one run's power, as far from one as runs of robots usually are."""
        square, most = float(said @ said), cls().reach(LEVEL)
        excess = float(said @ measured) / square - 1.0 if square > 0.0 else 0.0
        return 1.0 + float(np.clip(excess, -most, most))

    def reach(self, level: float) -> float:
        """Half width of the interval of the relative effect."""
        return float(student.ppf(0.5 + level / 2, self.freedom)) * self.deviation

    def shared(self, values: FloatArray, runs: int) -> FloatArray:
        """Covariance of coefficients of runs that differ: known no better than their mean."""
        part = self.deviation**2 / runs if self.compared else 0.0
        return np.asarray(part * np.outer(values, values))

    def energy(
        self, model: PowerModel, drive: Drive, level: float = LEVEL, said: float | None = None,
        weights: FloatArray | None = None,
    ) -> Energy:  # fmt: skip
        """Predict the energy of a run to come; `said` [J] and `weights` [s] replace the drive's."""
        alone, weights = replace(drive, between=None), drive.weights if weights is None else weights
        about = linearise_drive(alone, model.vehicle, model.terms, model.coefficients)
        energy = float(weights @ about.power[:, 0]) if said is None else said
        energy *= 1.0 + self.mean
        variance = self.density * float(weights.sum()) + (self.error * energy) ** 2
        if model.covariance is not None:
            gradient = weights @ about.columns[:, 0]
            variance += float(gradient @ model.covariance @ gradient)
        within = student.ppf(0.5 + level / 2, self.freedom if self.compared else _WITHIN)
        half = float(np.hypot(within * np.sqrt(variance), self.reach(level) * energy))
        return Energy(energy, energy - half, energy + half)
