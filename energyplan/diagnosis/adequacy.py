"""Does what was found hold on other drives? Prediction intervals of energies (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from energyplan.diagnosis.holdout import Prediction
from energyplan.diagnosis.joint_fit import FinalFit
from energyplan.diagnosis.result import EnergyPrediction
from energyplan.fit.adequacy import Adequacy, shown_of_contacts
from energyplan.fit.drives.drive import Drive
from energyplan.fit.problem import Problem
from energyplan.fit.run_spread import RunSpread
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel

_HOLDS = 1.5  # error on other drives, over that on the training drives, that is no surprise
_GROSS = 4.0  # residual over noise from which most of it must be explained
_EXPLAINED = 0.5  # error with what was found, over that without, that counts as most
_LEVEL = 0.9  # of the intervals of energies
_WITHIN = 30  # degrees of freedom of what is known from within runs
_ASSUMED = 2  # of a spread that is assumed: robots and grounds differ much in it


def with_contacts(model: PowerModel, one: Prediction) -> Prediction:
    """Return a prediction with what the drive's total shows of what contacts hold.

    That is no prediction any more, but tells whether the model holds.
    """
    shown = shown_of_contacts(model, one.drive)
    return one if shown is None else replace(one, power=one.power + shown)


def holds(quality: Adequacy, error: float) -> bool:
    """Tell whether what was found on the training drives holds on others."""
    return error <= _HOLDS * max(quality.residual, quality.noise)


def explains(quality: Adequacy, before: float, after: float, stranger: float = 0.0) -> bool:
    """Tell whether what was found explains the error, where more is left than noise."""
    strange = stranger > 0.5
    if quality.adequate and not strange:
        return True
    gross = strange or quality.residual > _GROSS * quality.noise
    return after <= (_EXPLAINED if gross else 1.0) * before


def energies(
    problem: Problem, fitted: FinalFit, predictions: Sequence[Prediction]
) -> tuple[EnergyPrediction, ...]:
    """Predict the energy of drives that took no part, with intervals.

    Their variance is that of the coefficients, that of what is left within a run, and that of what
    differs from run to run as a whole. Fewer than three training drives do not show the latter: it
    is taken to be that of robots elsewhere, by a distribution that says how little is known of it.
    Where runs were left out, one at a time, an interval is no narrower than what they were missed
    by tells: runs that a model was fitted to differ less from it than others do.
    """
    model = fitted.model
    plain = problem.as_predicted.with_factors([1.0] * len(problem.drives))
    design = plain.design(fitted.terms, None, model_values(model))
    values = np.array(model.coefficients)
    spread = RunSpread.of(design, values)
    table, owner = design.longest
    factor = np.ones(len(problem.drives)) if spread is None else 1.0 + spread.excess
    left = table[:, -1] - (table[:, :-1] @ values) * factor[owner]
    length = problem.drives[0].windows[-1].length
    density = float(np.mean(left**2)) * length  # of the residual's integral, by time [W^2 s]
    count = len(problem.drives)
    told = 0.5 + _LEVEL / 2
    reach = float(student.ppf(told, count - 1 if spread else _WITHIN))
    assumed = 0.0 if spread else USUAL_RUN_SPREAD * float(student.ppf(told, _ASSUMED))
    found = []
    for one in predictions:
        weights = one.drive.weights
        energy = float(weights @ one.power)
        columns = plain_columns(plain, fitted, one.drive)
        gradient = weights @ columns
        variance = density * float(weights.sum())
        if model.covariance is not None:
            variance += float(gradient @ model.covariance @ gradient)
        if spread is not None:
            variance += (spread.deviation * energy) ** 2
        half = float(np.hypot(reach * np.sqrt(variance), assumed * energy))
        if fitted.run_error is not None:
            half = max(half, reach * fitted.run_error * abs(energy))
        found.append(
            EnergyPrediction(
                one.drive.name, energy, (energy - half, energy + half),
                float(weights @ one.drive.power),
            )
        )  # fmt: skip
    return tuple(found)


def model_values(model: PowerModel) -> dict[str, float]:
    """Coefficients by name."""
    return {t.name: float(v) for t, v in zip(model.terms, model.coefficients, strict=True)}


def plain_columns(problem: Problem, fitted: FinalFit, drive: Drive) -> FloatArray:
    """Return the derivatives of a drive's power by the coefficients, shape (n, k)."""
    if any(t.name in ("slip_change", "traction_change") for t in fitted.terms):
        drive = drive.with_channels(
            changed=drive.motion.channels.get("changed", np.ones(len(drive.t)))
        )
    one = Problem([replace(drive, between=None)], problem.vehicle)
    about = one.tables(fitted.terms, np.array(fitted.model.coefficients))
    return about.columns[0][:, 0]
