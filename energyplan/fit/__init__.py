"""From drive logs to parameters: what can be identified, solvers, covariance, ICR, online."""

from __future__ import annotations

from energyplan.fit.drive import split_drives
from energyplan.fit.icr import ICREstimate, fit_icr, icr_from_spin
from energyplan.fit.identification import (
    Identification,
    fit_residual,
    identify,
)

__all__ = [
    "ICREstimate",
    "Identification",
    "fit_icr",
    "fit_residual",
    "icr_from_spin",
    "identify",
    "split_drives",
]
