"""What a model's prediction leaves of measured drives (private)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from energyplan.fit.covariance import correlation_time
from energyplan.fit.drives.drive import Drive
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual


def pieces_of(drives: Sequence[Drive]) -> list[slice]:
    """Stretches without a gap, all drives one below the other."""
    starts = np.concatenate([[0], np.cumsum([len(drive.t) for drive in drives])[:-1]])
    return [
        slice(int(start) + run.start, int(start) + run.stop)
        for start, drive in zip(starts, drives, strict=True)
        for run in drive.runs
    ]


def energy_error(missing: float, measured: float) -> float:
    """Return the error of a predicted energy, over the measured one."""
    if measured == 0.0:
        return 0.0 if missing == 0.0 else -float(np.copysign(np.inf, missing))
    return -missing / measured


def unfounded(model: PowerModel, confidence: float, spread: float) -> str:
    """Tell why nothing can be said of a model's energies with a probability."""
    if model.residual is not None and not np.isfinite(model.residual.energy_error):
        return (
            f"the model {model.name!r} missed all the energy of the drives that it was judged on, "
            "which measured none; identify it from drives that do"
        )
    stated = confidence == 0.5 or spread > 0.0
    if not stated and model.covariance is None and model.residual is None:
        return (
            f"the model {model.name!r} has neither a covariance nor a hold-out error, so no bound "
            f"holds with confidence {confidence:g}; identify it from a log, state a coefficient "
            "spread, or ask for confidence 0.5"
        )
    return ""


def statistics(drives: Sequence[Drive], powers: Sequence[FloatArray]) -> Residual:
    """Return the statistics of measured minus predicted power."""
    residual = np.concatenate([d.power - p for d, p in zip(drives, powers, strict=True)])
    weights = np.concatenate([drive.weights for drive in drives])
    measured = sum(float(drive.weights @ drive.power) for drive in drives)
    missing = float(weights @ residual)
    duration, pieces = float(weights.sum()), pieces_of(drives)
    period = duration / max(len(residual) - len(pieces), 1)
    return Residual(
        rmse=float(np.sqrt(np.mean(residual**2))),
        mae=float(np.mean(np.abs(residual))),
        bias=float(np.mean(residual)),
        energy_error=energy_error(missing, measured),
        correlation_time=correlation_time(residual, period, pieces),
        duration=duration,
    )
