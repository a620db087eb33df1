"""The fit itself: measured power of all logs against a model that may not be linear (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import UnknownNameError
from energyplan.fit import solvers
from energyplan.fit.covariance import (
    autocorrelation,
    local_scale,
    normal_scores,
    sandwich,
    sum_covariance,
)
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.linear import linearise_drive, power_of
from energyplan.fit.icr import ICREstimate
from energyplan.fit.identifiability import is_linear
from energyplan.fit.residuals import pieces_of
from energyplan.fit.solvers import Bounds
from energyplan.path import FloatArray
from energyplan.power import PowerModel

Method = Literal["lad", "simplex", "huber", "windows"]
Loss = Callable[[FloatArray], float]

_IDLE = 0.01
"""Size of a regressor, over its usual one, below which a sample says nothing about it."""


def telling(design: FloatArray) -> NDArray[np.bool_]:
    """Tell which samples say something about the coefficients.

    A robot at rest says nothing about friction, however long it stands: its residual is not that
    of a driving one, and where half of a log is rest, its residual is the whole log's median.
    """
    size = np.abs(design)
    usual = np.sqrt(np.einsum("ij,ij->j", size, size) / np.maximum((size > 0).sum(axis=0), 1))
    found = np.any(size > _IDLE * usual, axis=1)
    return found if np.count_nonzero(found) > design.shape[1] else np.ones(len(design), bool)


def kept_pieces(pieces: Sequence[slice], kept: NDArray[np.bool_]) -> list[slice]:
    """Return stretches without a gap among the kept samples, counted over those alone."""
    number = np.concatenate([[0], np.cumsum(kept)])
    edges = [0]
    for piece in pieces:
        steps = np.flatnonzero(np.diff(kept[piece].astype(int))) + piece.start + 1
        edges += [*number[steps], number[piece.stop]]
    bounds = np.unique(edges).tolist()
    return [slice(a, b) for a, b in pairwise(bounds)]


class PowerRegression:
    """Measured total power and the predictions to fit to it, all drives one below the other."""

    def __init__(self, drives: Sequence[Drive], model: PowerModel) -> None:
        self._start = model
        self._drives = [replace(drive, between=None) for drive in drives]
        self._measured = np.concatenate([drive.power for drive in drives])
        self.pieces = pieces_of(drives)
        self._linear = is_linear(model) and not (
            any(drive.battery for drive in drives) and not is_linear(model.battery_side())
        )

    def powers(self, model: PowerModel) -> list[FloatArray]:
        """Return the predicted power of each drive [W]."""
        return [drive.seen(power_of(model, drive)) for drive in self._drives]

    def residual(self, model: PowerModel) -> FloatArray:
        """Measured minus predicted power [W]."""
        return np.asarray(self._measured - np.concatenate(self.powers(model)))

    def _linearise(self, model: PowerModel) -> tuple[FloatArray, FloatArray]:
        """Target and design of the linear problem at a model's coefficients."""
        parts = [
            linearise_drive(drive, model.vehicle, model.terms, model.coefficients)
            for drive in self._drives
        ]
        jacobian = np.concatenate([part.columns[:, 0] for part in parts])
        power = np.concatenate([part.power[:, 0] for part in parts])
        return self._measured - power + jacobian @ model.coefficients, jacobian

    def solve(self, method: Method, bounds: Bounds) -> PowerModel:
        """Return the model with the coefficients that minimise the method's sum."""
        if method not in ("lad", "simplex", "huber"):
            raise UnknownNameError("method", str(method), ("lad", "simplex", "huber"))
        if method == "simplex":
            rough = self._iterate(solvers.weighted_least_squares, lambda _: _squares, bounds)
            found = self._simplex(rough, bounds)
        elif method == "lad":
            found = self._iterate(solvers.lad, lambda _: _absolute, bounds)
        else:
            found = self._iterate(solvers.huber, _huber_loss, bounds)
        return self._start.with_coefficients(self._snapped(found, bounds))

    def _snapped(self, c: FloatArray, bounds: Bounds) -> FloatArray:
        """Put coefficients that are at a bound but for rounding at the bound."""
        _, design = self._linearise(self._start.with_coefficients(c))
        watt = 1e-9 * float(np.max(np.abs(self._measured), initial=0.0))
        for bound in (bounds.lower, bounds.upper):
            c = np.where(np.abs(c - bound) * solvers.column_scale(design) < watt, bound, c)
        return c

    def _simplex(self, start: FloatArray, bounds: Bounds) -> FloatArray:
        target, design = self._linearise(self._start)

        def linear(c: FloatArray) -> float:
            return float(np.abs(target - design @ c).sum())

        def general(c: FloatArray) -> float:
            return _absolute(self.residual(self._start.with_coefficients(c)))

        return solvers.simplex(linear if self._linear else general, start, bounds)

    def _iterate(
        self,
        fit: Callable[[FloatArray, FloatArray, Bounds], FloatArray],
        merit: Callable[[FloatArray], Loss],
        bounds: Bounds,
    ) -> FloatArray:
        """Solve a sequence of linear problems, each about the solution of the one before it."""
        target, design = self._linearise(self._start)
        if self._linear:
            return fit(design, target, bounds)
        # The losses act on forces: find those first, without losses.
        lossy = np.array([term.kind == "loss" for term in self._start.terms])
        c = np.array(self._start.coefficients)
        free = np.flatnonzero(~lossy)
        c[free] = fit(
            design[:, free],
            target - design[:, lossy] @ c[lossy],
            Bounds(bounds.lower[free], bounds.upper[free]),
        )
        for _ in range(50):
            residual = self.residual(self._start.with_coefficients(c))
            loss = merit(residual)
            value = loss(residual)
            target, design = self._linearise(self._start.with_coefficients(c))
            step = fit(design, target, bounds) - c
            for _ in range(30):
                trial = loss(self.residual(self._start.with_coefficients(c + step)))
                if trial < value:
                    break
                step *= 0.5
            else:
                break
            c = c + step
            if value - trial <= 1e-12 * value:
                break
        return bounds.clip(c)

    def covariance(self, model: PowerModel, method: Method) -> FloatArray:
        """Covariance of the coefficients under autocorrelated, heteroscedastic residuals."""
        target, design = self._linearise(model)
        informative = telling(design)
        target, design = target[informative], design[informative]
        pieces = kept_pieces(self.pieces, informative)
        residual = target - design @ model.coefficients
        noise = autocorrelation(normal_scores(residual), pieces, design)
        sigma = solvers.robust_scale(residual)
        sigma = max(sigma, 1e-9 * float(np.max(np.abs(self._measured), initial=1e-300)))
        if method == "huber":
            edge = solvers.HUBER_TUNING * sigma
            scale = local_scale(np.clip(residual, -edge, edge), noise.repeats)
            rho = noise.rho
            slope = (np.abs(residual) < edge).astype(float)
        else:
            scale = np.ones(len(residual))
            # Signs of jointly normal values are correlated by the arcsine law.
            rho = 2 / np.pi * np.arcsin(np.clip(noise.rho, -1.0, 1.0))
            slope = 2.0 * _density_at_zero(residual, sigma, len(residual) / noise.repeats)
        bread = (design * slope[:, None]).T @ design
        meat = sum_covariance(design, scale, rho, pieces)
        return np.asarray(sandwich(bread, meat) / noise.kept)

    def inherited(self, model: PowerModel, estimate: ICREstimate) -> FloatArray:
        """Covariance that the coefficients take over from the tread ICRs."""
        _, design = self._linearise(model)
        icr = model.vehicle.icr
        power = np.concatenate(self.powers(model))
        shifts = []
        for which in ("left", "right", "longitudinal"):
            step = max(estimate.std_error[which], 1e-6)
            moved = replace(icr, **{which: getattr(icr, which) + step})
            other = replace(model, vehicle=model.vehicle.with_icr(moved))
            turned = [drive.with_icr(moved) for drive in self._drives]
            ahead = np.concatenate([drive.seen(power_of(other, drive)) for drive in turned])
            shifts.append((ahead - power) / step)
        free = Bounds(np.full(len(model.terms), -np.inf), np.full(len(model.terms), np.inf))
        change = [solvers.weighted_least_squares(design, -shift, free) for shift in shifts]
        sensitivity = np.column_stack(change)
        return np.asarray(sensitivity @ estimate.covariance @ sensitivity.T)


def _squares(residual: FloatArray) -> float:
    return float(residual @ residual)


def _absolute(residual: FloatArray) -> float:
    return float(np.abs(residual).sum())


def _huber_loss(present: FloatArray) -> Loss:
    """Huber's loss at the scale of the present residual."""
    size = np.abs(present)
    edge = solvers.HUBER_TUNING * max(
        solvers.robust_scale(present), 1e-9 * float(size.max()), 1e-100
    )

    def loss(residual: FloatArray) -> float:
        inner = np.minimum(np.abs(residual), edge)
        return float((inner * (np.abs(residual) - 0.5 * inner)).sum())

    return loss


def _density_at_zero(residual: FloatArray, sigma: float, independent: float) -> FloatArray:
    """Each residual's share in the kernel estimate of the density at zero (Powell 1991).

    The normal kernel's width is Silverman's for the number of independent samples: correlated ones
    cluster, and a narrow kernel would count the accidents of a cluster.
    """
    width = 1.06 * sigma * max(independent, 2.0) ** -0.2
    z = residual / width
    return np.asarray(np.exp(-0.5 * z * z) / (width * np.sqrt(2 * np.pi)))
