"""Is what a model leaves no more than noise? Prediction intervals of energies (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from energyplan.diagnosis.holdout import Prediction
from energyplan.diagnosis.joint_fit import FinalFit
from energyplan.diagnosis.result import Adequacy, EnergyPrediction
from energyplan.fit.covariance import autocorrelation
from energyplan.fit.drives.denoise import speed_noise
from energyplan.fit.drives.linear import equations_of, is_lossy, power_of
from energyplan.fit.drives.windows import SCALES, Drive
from energyplan.fit.least_squares import Problem
from energyplan.fit.run_spread import RunSpread
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel
from energyplan.power.effect_terms import SLIP_CHANGE, TRACTION_CHANGE, WHEEL_FIGHT

_FLOOR = 0.01
"""What is no more than this fraction of the root mean square power is as good as nothing."""
_CHANCE = 1e-3  # that noise alone is called coloured, over all lengths of means
_RESTING = 20  # samples at rest that tell the noise
_SIGMA = 4.0  # standard deviations that noise does not exceed
_HOLDS = 1.5  # error on other drives, over that on the training drives, that is no surprise
_GROSS = 4.0  # residual over noise from which most of it must be explained
_EXPLAINED = 0.5  # error with what was found, over that without, that counts as most
_LEVEL = 0.9  # of the intervals of energies
_WITHIN = 30  # degrees of freedom of what is known from within runs
_ASSUMED = 2  # of a spread that is assumed: robots and grounds differ much in it


def predicted(model: PowerModel, drive: Drive) -> FloatArray:
    """Power that a drive's log would show by a model [W]."""
    whole = model.battery_side() if drive.battery else model
    return drive.seen(power_of(whole, drive))


def shown_of_contacts(model: PowerModel, drive: Drive) -> FloatArray | None:
    """Return what the powers of a drive show of what contacts hold, beyond a prediction [W].

    None where they show nothing: without losses it costs nothing. Nor where nobody knows when the
    robot changed. With the power of both sides a model may have a term for its mean, which what
    they show replaces.
    """
    changes = any(term.name in (SLIP_CHANGE.name, TRACTION_CHANGE.name) for term in model.terms)
    undated = changes and "changed" not in drive.motion.channels
    if undated or not is_lossy(drive, model.terms):
        return None
    shown = _without_fight(model) if drive.equations > 1 else model
    told = equations_of(shown, replace(drive, fitted=True))[:, 0]
    alone = equations_of(model, replace(drive, between=None, fitted=False))[:, 0]
    return told - alone if np.any(told != alone) else None


def _without_fight(model: PowerModel) -> PowerModel:
    keep = [k for k, term in enumerate(model.terms) if term.name != WHEEL_FIGHT.name]
    return PowerModel(model.vehicle, tuple(model.terms[k] for k in keep), model.coefficients[keep])


def with_contacts(model: PowerModel, one: Prediction) -> Prediction:
    """Return a prediction with what the drive's total shows of what contacts hold.

    That is no prediction any more, but tells whether the model holds.
    """
    shown = shown_of_contacts(model, one.drive)
    return one if shown is None else replace(one, power=one.power + shown)


def adequacy(problem: Problem, fitted: FinalFit) -> Adequacy:
    """Compare what a model leaves of the training drives with their noise.

    The noise of a sample is what neighbouring samples differ by beyond a smooth curve, or the
    scatter at rest where that is larger; how much of it lasts is told by the samples at rest. The
    residual is coloured where its means over half a second, two or eight seconds scatter by more
    than noise would by chance (Fisher's distribution, of as many means as are independent, and of
    as many samples as told the noise), and by more than is as good as nothing. What contacts hold
    on a straight no model foretells: where losses make it cost, what the total shows of it is no
    residual.

    Parameters
    ----------
    problem : Problem
        The drives.
    fitted : FinalFit
        The model.

    Returns
    -------
    Adequacy
        Both, of samples and of means over the time that shows most.
    """
    residuals, rests, whites = [], [], []
    for drive in problem.drives:
        one = Prediction(drive, predicted(fitted.model, drive))
        residual = drive.power - with_contacts(fitted.model, one).power
        residuals.append(residual)
        if len(residual) > 4:
            whites.append(speed_noise(drive.power))
        still = (drive.motion.v_left == 0) & (drive.motion.v_right == 0)
        if np.count_nonzero(still) >= _RESTING:
            rests.append(residual[still] - np.median(residual[still]))
    every = np.concatenate(residuals)
    size = float(np.sqrt(np.mean(np.concatenate([d.power for d in problem.drives]) ** 2)))
    noise, repeats, told = float(np.median(whites)) if whites else 0.0, 1.0, float(len(every))
    if rests:
        rest = np.concatenate(rests)
        # A load that comes and goes at rest is no noise: what most samples scatter by is.
        spread = 1.4826 * float(np.median(np.abs(rest)))
        if spread > 0:
            stops = np.cumsum([len(part) for part in rests]).tolist()
            pieces = [slice(a, b) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
            usual = np.clip(rest, -_SIGMA * spread, _SIGMA * spread)
            repeats = autocorrelation(usual, pieces).repeats if spread > 0.5 * noise else 1.0
            # Noise that lasts is known by as many samples as are independent.
            told = len(rest) / repeats if repeats > 1.0 else told
        noise = max(noise, spread)
    noise = max(noise, _FLOOR * size)
    slow = [
        _means(problem.drives, residuals, k, _Noise(noise, repeats, told), _FLOOR * size)
        for k in range(len(SCALES))
    ]
    most = max(slow, key=lambda one: one.residual / one.limit)
    return Adequacy(
        noise, float(np.sqrt(np.mean(every**2))), most.noise, most.residual,
        bool(most.residual > most.limit), most.time,
        tuple(max(one.residual**2 - one.noise**2, 0.0) for one in slow),
    )  # fmt: skip


@dataclass(frozen=True)
class _Noise:
    """Noise of a sample [W], how many samples repeat each other, and how many told it."""

    deviation: float
    repeats: float
    told: float


@dataclass(frozen=True)
class _Means:
    """Scatter of means of a residual: what noise makes, what there is, what noise may make [W]."""

    time: float
    noise: float
    residual: float
    limit: float


def _means(
    drives: Sequence[Drive],
    residuals: Sequence[FloatArray],
    scale: int,
    noise: _Noise,
    nothing: float,
) -> _Means:
    """Compare means of a residual over one time with those of noise."""
    windows = [drive.windows[scale] for drive in drives]
    means = np.concatenate([w.mean(r) for w, r in zip(windows, residuals, strict=True)])
    number = float(np.median(np.concatenate([w.counts for w in windows])))
    own = noise.deviation * float(np.sqrt(min(noise.repeats / number, 1.0)))
    independent = min(float(len(means)), sum(map(len, residuals)) / noise.repeats)
    by_chance = float(fisher.isf(_CHANCE / len(SCALES), independent, noise.told))
    limit = float(np.sqrt(own**2 * by_chance + nothing**2))
    return _Means(windows[0].length, own, float(np.sqrt(np.mean(means**2))), limit)


def holds(quality: Adequacy, error: float) -> bool:
    """Tell whether what was found on the training drives holds on others.

    Parameters
    ----------
    quality : Adequacy
        What the model leaves of the training drives.
    error : float
        Its root mean square error on drives that took no part [W], what contacts hold known alike.

    Returns
    -------
    bool
        False where that is clearly more than what is left of the training drives and than noise:
        then effects that were looked for at any time or place fitted those drives alone.
    """
    return error <= _HOLDS * max(quality.residual, quality.noise)


def explains(quality: Adequacy, before: float, after: float, stranger: float = 0.0) -> bool:
    """Tell whether what was found explains the error, where more is left than noise.

    Parameters
    ----------
    quality : Adequacy
        What the model leaves of the training drives.
    before, after : float
        Root mean square errors on drives that took no part, of the paper's model and of the model
        with what was found [W].
    stranger : float
        Probability that behind what was found is something else.

    Returns
    -------
    bool
        False where what is left is no noise, and the errors on other drives grew, or far more than
        noise is left, or a stranger is more probable, and they are still more than half: something
        else is there.
    """
    if quality.adequate:
        return True
    gross = quality.residual > _GROSS * quality.noise or stranger > 0.5
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

    Parameters
    ----------
    problem : Problem
        Training drives.
    fitted : FinalFit
        The model.
    predictions : sequence of Prediction
        What it predicts.

    Returns
    -------
    tuple of EnergyPrediction
        One for each drive.
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
