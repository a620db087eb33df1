"""Errors on drives that were held out, with intervals (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.diagnosis.change_points import settle_change
from energyplan.diagnosis.part import Part
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.late import Late
from energyplan.fit.drives.linear import power_of
from energyplan.fit.drives.windows import BLOCK
from energyplan.fit.residuals import statistics
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual

_RESAMPLES = 400


@dataclass(frozen=True)
class ErrorInterval:
    """95 % intervals of an error on the hold-out drives, from resampled blocks."""

    rmse: tuple[float, float]  # lower and upper end [W]
    mae: tuple[float, float]  # lower and upper end [W]
    bias: tuple[float, float]  # lower and upper end [W]
    energy_error: tuple[float, float]


@dataclass(frozen=True)
class Prediction:
    """Predicted power of a drive."""

    drive: Drive  # the drive, its power freed of delay
    power: FloatArray  # (n,): predicted power [W]
    change: float | None = None  # when it changed state [s]


def predict(
    model: PowerModel, parts: Sequence[Part], drive: Drive, *, dated: bool = True
) -> Prediction:
    """Predict a drive; when it changed state is found on the drive itself."""
    for part in parts:
        if part.effect.name == "time_offset":
            drive = replace(drive, late=Late.of(part.params))
    whole = model.battery_side() if drive.battery else model
    steps = [
        k for k, term in enumerate(whole.terms) if term.name in ("slip_change", "traction_change")
    ]
    if not steps:
        return Prediction(drive, drive.seen(power_of(whole, drive)))
    if not dated:
        after = drive.with_channels(changed=np.ones(len(drive.t)))
        return Prediction(after, after.seen(power_of(whole, after)))
    still = drive.with_channels(changed=np.zeros(len(drive.t)))
    settled = settle_change(
        drive,
        drive.seen(power_of(whole, still)),
        [whole.terms[k] for k in steps],
        whole.coefficients[steps],
        whole.vehicle,
    )
    changed = settled.motion.channels["changed"]
    at = np.flatnonzero(np.diff(changed))
    time = float(drive.t[at[0] + 1]) if len(at) else None
    return Prediction(drive, drive.seen(power_of(whole, settled)), time)


def score(predictions: Sequence[Prediction]) -> Residual:
    """Return the statistics of measured minus predicted power."""
    return statistics([one.drive for one in predictions], [one.power for one in predictions])


def interval(predictions: Sequence[Prediction], seed: int = 0) -> ErrorInterval:
    """Return 95 % intervals of the statistics by resampling blocks of driving."""
    rows = []
    for one in predictions:
        t = one.drive.t
        block = np.minimum((t / BLOCK).astype(int), max(int(t[-1] / BLOCK + 0.5), 1) - 1)
        r = one.drive.power - one.power
        dt = one.drive.weights
        values = np.column_stack(
            [np.ones(len(r)), r**2, np.abs(r), r, one.drive.power * dt, one.power * dt]
        )
        sums = np.zeros((int(block.max()) + 1, values.shape[1]))
        np.add.at(sums, block, values)
        rows.append(sums[sums[:, 0] > 0])  # none of a gap
    table = np.concatenate(rows)
    draws = np.random.default_rng(seed).integers(0, len(table), (_RESAMPLES, len(table)))
    n, square, absolute, plain, measured, predicted = table[draws].sum(axis=1).T
    with_energy = np.where(measured != 0, measured, 1.0)
    samples = (np.sqrt(square / n), absolute / n, plain / n, predicted / with_energy - 1.0)
    ends = [np.quantile(values, [0.025, 0.975]) for values in samples]
    return ErrorInterval(*((float(low), float(high)) for low, high in ends))
