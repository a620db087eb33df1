"""From drive logs to parameters: what can be identified, solvers, covariance, ICR, online."""

from __future__ import annotations

from energyplan.fit.drives.parting import split_drives
from energyplan.fit.icr import fit_icr
from energyplan.fit.identification import (
    ICREstimate,
    Identification,
    fit_residual,
    icr_from_spin,
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
