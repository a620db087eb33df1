"""From drive logs to a power model: coefficients, tread ICRs, and how well both are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, cast

import numpy as np
from scipy.stats import t as student

from energyplan import html
from energyplan.errors import InvalidInputError, ModelError, NotIdentifiableError, UnknownNameError
from energyplan.fit.adequacy import Adequacy, Beside, adequacy, beside, usual_effects, usual_terms
from energyplan.fit.breakaway import with_breakaway
from energyplan.fit.covariance import autocorrelation
from energyplan.fit.drives.drive import Drive, check_long_enough, prepared
from energyplan.fit.foretold import Foretold, foretold
from energyplan.fit.icr import ICREstimate, fit_icr, icr_from_spin, turned, yaw_channel
from energyplan.fit.identifiability import check_identifiable, linearise, signal_motion
from energyplan.fit.joint import joint_fit
from energyplan.fit.problem import Problem
from energyplan.fit.regression import Method, PowerRegression
from energyplan.fit.residuals import statistics
from energyplan.fit.solvers import Bounds
from energyplan.fit.usual import ends_in_words, open_in_words
from energyplan.kinds import checked
from energyplan.logs import DriveLog
from energyplan.logs.checks import find_lost_sign, refuse_one_side, without_copies
from energyplan.logs.clean import set_aside_by_drive
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Residual, Term
from energyplan.records import ByValue
from energyplan.vehicle import TreadICR, Vehicle

__all__ = ["ICREstimate", "Identification", "fit_icr", "fit_residual", "icr_from_spin", "identify"]

ICRChoice = Literal["auto", "symmetric", "asymmetric", "vehicle"]

_SHORTEST = 1.0
"""Shortest drive worth a look [s]."""

_LARGEST_ICR_ERROR = 0.1
"""Error of an ICR, over half the slip track, beyond which symmetry is the better guess."""

_LEAST_INDEPENDENT = 20.0
"""Effectively independent samples below which a standard error is doubtful."""


@dataclass(frozen=True, eq=False)
class Identification(ByValue, html.Readable):
    """A power model identified from logs.

    Parameters
    ----------
    model : PowerModel
        The model, with covariance, residual, and a vehicle that has the identified tread ICRs.
    method : str
        How the coefficients were found.
    icr_covariance : ndarray, shape (3, 3), optional
        Covariance of the left, right and longitudinal tread ICR [m^2]; None where the vehicle's
        own were kept.
    effective_samples : float
        How many independent samples the autocorrelated residual is worth.
    adequacy : Adequacy
        What is left beside noise once the inertia and the mobilisation of friction that nearly
        every drive shows are allowed for. Where that is more than noise, the model lacks something,
        and coefficients may be off by more than their standard errors.
    foretold : Foretold, optional
        By how much energies are missed that are foretold from the other drives, or from the rest of
        few drives; None where the drives took no energy.
    warnings : tuple of str
        What the logs do not determine, or hardly.
    set_aside : mapping of str to mapping of str to int
        How many samples were left out or mended, by drive and reason.

    Examples
    --------
    >>> import energyplan as ep
    >>> truth = ep.PowerModel.preset("quadriga:empty:marble")
    >>> found = ep.identify(ep.simulate.identification_drive(truth), truth.vehicle)
    >>> round(found.model.coefficient("traction_resistance"), 1)
    90.0
    """

    model: PowerModel
    method: str
    icr_covariance: FloatArray | None
    effective_samples: float
    adequacy: Adequacy
    foretold: Foretold | None
    warnings: tuple[str, ...]
    set_aside: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.model.covariance is None or self.model.residual is None:
            raise ModelError("an identified model needs its covariance and its residual")
        if self.icr_covariance is not None:
            known = np.array(self.icr_covariance, float)
            known.setflags(write=False)
            object.__setattr__(self, "icr_covariance", known)

    def _summaries(self) -> list[html.Summary]:
        rows: list[tuple[object, ...]] = [
            (term.name, term.symbol, float(value), self.std_error[term.name], term.unit)
            for term, value in zip(self.model.terms, self.model.coefficients, strict=True)
        ]
        spread = self.icr_std_error or {}
        rows += [
            (f"tread ICR {side}", "C", getattr(self.icr, side), spread.get(side, "kept"), "m")
            for side in ("left", "right")
        ]
        title = f"{self.model.name}: residual {html.number(self.residual.rmse)} W rms"
        header = ("term", "symbol", "value", "standard error", "unit")
        return [html.Summary(title, header, rows, self.warnings)]

    @property
    def residual(self) -> Residual:
        """Measured minus predicted power on the logs that the model was fitted to."""
        return cast("Residual", self.model.residual)

    @property
    def std_error(self) -> Mapping[str, float]:
        """Standard error of each term's coefficient, by the term's name."""
        spread = np.sqrt(np.diag(cast("FloatArray", self.model.covariance))).tolist()
        names = [term.name for term in self.model.terms]
        return MappingProxyType(dict(zip(names, spread, strict=True)))

    @property
    def icr(self) -> TreadICR:
        """Tread ICRs: identified, or the vehicle's if the logs do not determine them."""
        return self.model.vehicle.icr

    @property
    def icr_std_error(self) -> Mapping[str, float] | None:
        """Standard errors of left, right and longitudinal [m]; None where nothing was measured."""
        if self.icr_covariance is None:
            return None
        return ICREstimate(self.icr, self.icr_covariance, 0.0, "").std_error

    @checked()
    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a term's coefficient.

        Parameters
        ----------
        name : str
            Name of the term.
        level : float
            Probability in (0, 1) that such intervals hold the truth.

        Returns
        -------
        tuple of float
            Lower and upper end, by Student's distribution at `effective_samples`.

        Raises
        ------
        UnknownNameError
            If the model has no such term.
        InvalidInputError
            If the level is no probability.
        """
        if not 0 < level < 1:
            raise InvalidInputError(f"level is {level}; give a probability such as 0.95")
        freedom = max(self.effective_samples - len(self.model.terms), 1.0)
        value = self.model.coefficient(name)
        reach = float(student.ppf(0.5 + level / 2, freedom)) * self.std_error[name]
        return value - reach, value + reach


@checked()
def identify(
    logs: DriveLog | Sequence[DriveLog],
    vehicle: Vehicle,
    *,
    terms: Sequence[Term] = (SLIP, TRACTION),
    method: Method = "lad",
    icr: ICRChoice | TreadICR = "auto",
    name: str = "identified",
) -> Identification:
    """Identify a power model from drive logs.

    Parameters
    ----------
    logs : DriveLog or sequence of DriveLog
        The drives. A log of battery power is compared with what the battery delivers at the
        vehicle's drive and regeneration efficiency.
    vehicle : Vehicle
        The robot: contacts and loads, and the tread ICRs to fall back to.
    terms : sequence of Term
        Terms of the model; also ones that are not linear in their coefficients.
    method : {"lad", "simplex", "huber", "windows"}
        ``lad``: least sum of absolute residuals, exact (Eq. 7 as a linear program). ``simplex``:
        the same sum by the paper's Nelder-Mead search. ``huber``: squares near zero, absolute
        values beyond, for Gaussian noise with outliers. ``windows``: least squares of means over
        0.5, 2 and 8 s, as `energyplan.diagnose` fits; where the power of each side was logged, of
        both sides' difference too. Drives must last 16 s.
    icr : {"auto", "symmetric", "asymmetric", "vehicle"} or TreadICR
        ``auto``: the tread ICRs that the logs determine, the vehicle's for the rest.
        ``symmetric`` and ``asymmetric`` raise if the logs do not determine them. ``vehicle`` or
        given values: not identified.
    name : str
        Name of the model.

    Returns
    -------
    Identification
        The model with its covariance, which allows for autocorrelated residuals and for the error
        of the tread ICRs.

    Raises
    ------
    NotIdentifiableError
        If the logs do not determine a coefficient, or cannot separate two; the message says what
        to drive. If the speed or the power of one side is missing.
    MissingChannelError
        If a term needs a channel that a log lacks.
    InvalidInputError
        If there are no logs or no terms.
    DriveLogError
        If a log is too short for the method ``windows``.

    References
    ----------
    Morales et al. (2010), section III-B; docs/theory, section 6.

    Examples
    --------
    >>> from energyplan import simulate
    >>> truth = PowerModel.preset("quadriga:empty:marble")
    >>> log = simulate.drive(truth, "spiral", power_noise=5.0, seed=1)
    >>> found = identify(log, Vehicle.preset("quadriga:empty"))
    >>> abs(found.model.coefficient("traction_resistance") / 90.0 - 1) < 0.02
    True
    """
    drives, warnings = without_copies(_drives(logs), [])
    refuse_one_side(drives)
    if not terms:
        raise InvalidInputError("no terms to identify; give at least one")
    if sum(log.duration for log in drives) < _SHORTEST:
        raise InvalidInputError(
            f"{drives[0].name}: less than {_SHORTEST:g} s of samples; record a drive"
        )
    if not any(np.any(log.power) for log in drives):
        raise NotIdentifiableError(
            f"{drives[0].name}: the measured power is zero throughout; check its channel"
        )
    if not any(term.kind == "loss" for term in terms):  # which may be that of the sign
        lost = {log.name: find_lost_sign(log.channels) for log in drives}
        warnings += [
            f"{name}: {text}; if so, these terms are wrong" for name, text in lost.items() if text
        ]
    estimate = _find_icr(drives, vehicle, icr, warnings)
    settled = icr if isinstance(icr, TreadICR) else estimate.icr if estimate else vehicle.icr
    vehicle = vehicle.with_icr(settled)
    bounds = Bounds(*np.array([term.bounds for term in terms], float).T)
    start = bounds.clip(np.zeros(len(terms)))
    model = PowerModel(vehicle, tuple(terms), start, name=name)

    turning = turned(drives, settled)
    ready = [Drive.of(log, vehicle) for log in drives]
    clean = [signal_motion(drive, turning) for drive in ready]
    linear = [term for term in terms if term.kind != "loss"]
    if linear:
        first = PowerModel(vehicle, tuple(linear), np.zeros(len(linear)))
        doubts = check_identifiable(first, _stacked(first, clean, ready), turning)
    problem = PowerRegression(ready, model)
    if method == "windows":
        joint = joint_fit(_both_sides(drives, vehicle, terms), terms)
        model = replace(joint.model, name=name)
        warnings += open_in_words(model, joint.assumed)
    else:
        model = problem.solve(method, bounds)
    if len(linear) < len(terms):
        doubts = check_identifiable(model, _stacked(model, clean, ready), turning)
    warnings += doubts

    covariance = problem.covariance(model, method) if model.covariance is None else model.covariance
    if estimate is not None:
        covariance = covariance + problem.inherited(model, estimate)
    powers = problem.powers(model)
    residual = statistics(ready, powers)
    independent = residual.duration / max(2 * residual.correlation_time, 1e-300)
    model = replace(model, covariance=covariance, residual=residual)
    icr_covariance = None if estimate is None else estimate.covariance
    warnings += _doubts(model, independent)
    warnings += _draw_at_rest(ready, powers)
    usual = beside(usual_terms(terms), model, ready)
    quality = adequacy(ready, usual.residuals)
    told = foretold(model, ready, powers)
    warnings += _missing(quality, model, usual, told)
    aside = set_aside_by_drive(drives)
    return Identification(
        model, method, icr_covariance, independent, quality, told, tuple(warnings), aside
    )


def fit_residual(model: PowerModel, logs: DriveLog | Sequence[DriveLog]) -> Residual:
    """Compare a model's power with what logs measured.

    Speeds are freed of their sensors' noise first, as in `identify` and `energyplan.diagnose`; a
    tread slower than 2 mm/s counts as at rest.
    """
    drives = [Drive.of(log, model.vehicle) for log in _drives(logs)]
    return statistics(drives, PowerRegression(drives, model).powers(model))


# -- parts --------------------------------------------------------------------------------------


def _both_sides(drives: Sequence[DriveLog], vehicle: Vehicle, terms: Sequence[Term]) -> Problem:
    """Return drives as diagnosis fits them: each side an equation, where it slides."""
    check_long_enough(drives)
    usual = [
        term for effect in usual_effects() if not effect.grid
        for term in effect.terms if term in terms
    ]  # fmt: skip
    return with_breakaway(Problem(prepared(drives, vehicle), vehicle), usual)


def _missing(
    left: Adequacy, model: PowerModel, usual: Beside, left_out: Foretold | None
) -> list[str]:
    """Warn of a model that lacks something, and of how much: errors know of noise alone."""
    moves = usual.moves(model)
    if moves:
        told = f"inertia and the mobilisation of friction beside it move {' and '.join(moves)}"
    elif not left.adequate:
        told = f"beside inertia it leaves {left.in_words}"
    else:
        return []
    size = "" if left_out is None else f", energies by some {100 * left_out.error:.2g} %"
    return [
        f"the model lacks something: {told}. Coefficients may be off by more than their standard "
        f"errors{size}; 'energyplan diagnose' with the same logs tells what is missing"
    ]


def _draw_at_rest(drives: Sequence[Drive], powers: Sequence[FloatArray]) -> list[str]:
    """Warn of power that the robot draws standing still and no term explains."""
    residual = np.concatenate(
        [(drive.power - power)[drive.rests] for drive, power in zip(drives, powers, strict=True)]
    )
    if len(residual) < _LEAST_INDEPENDENT:
        return []
    mean, error = float(residual.mean()), float(residual.std())
    repeats = autocorrelation(residual, [slice(0, len(residual))]).repeats
    if abs(mean) < 5 * max(error * np.sqrt(repeats / len(residual)), 0.1):
        return []
    return [
        f"at rest the robot draws {mean:.1f} W that no term explains: a constant load, or a "
        "sensor offset; it makes the other coefficients wrong: add hotel_load to the terms "
        "(--terms slip_friction,traction_resistance,hotel_load), or let diagnose find out"
    ]


def _drives(logs: DriveLog | Sequence[DriveLog]) -> list[DriveLog]:
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    if not drives:
        raise InvalidInputError("no logs; give at least one drive")
    return drives


def _stacked(model: PowerModel, motions: Sequence[Motion], drives: Sequence[Drive]) -> FloatArray:
    """Regressors of all drives, one below the other."""
    return np.concatenate(
        [
            linearise(model, motion, drive.battery).columns[:, 0]
            for motion, drive in zip(motions, drives, strict=True)
        ]
    )


def _find_icr(
    drives: Sequence[DriveLog], vehicle: Vehicle, icr: ICRChoice | TreadICR, warnings: list[str]
) -> ICREstimate | None:
    """Identify tread ICRs as asked; None, with a warning, where they are kept."""
    if isinstance(icr, TreadICR) or icr == "vehicle":
        return None
    if icr not in ("auto", "symmetric", "asymmetric"):
        raise UnknownNameError(
            "choice of icr", str(icr), ("auto", "symmetric", "asymmetric", "vehicle")
        )
    if icr != "auto":
        return fit_icr(drives, vehicle.icr, asymmetric=icr == "asymmetric")
    kept = (
        f"the vehicle's tread ICRs were kept (left {vehicle.icr.left:.3f} m, "
        f"right {vehicle.icr.right:.3f} m)"
    )
    if yaw_channel(drives) is None:
        warnings.append(
            f"{kept}: the logs have no yaw or yaw_rate. Coefficients of terms that act on turning "
            "hold for these tread ICRs only"
        )
        return None
    try:
        estimate = fit_icr(drives, vehicle.icr)
    except NotIdentifiableError as reason:
        warnings.append(f"{kept}: {reason}")
        return None
    worst = max(estimate.std_error.values())
    if estimate.source == "pose" and worst > _LARGEST_ICR_ERROR * estimate.icr.half_track:
        warnings.append(
            "the pose is too coarse to separate left, right and longitudinal tread ICR "
            f"(standard error {worst:.2g} m): only their distance was identified"
        )
        return fit_icr(drives, vehicle.icr, asymmetric=False)
    return estimate


def _doubts(model: PowerModel, independent: float) -> list[str]:
    """Warnings about what was found."""
    found = ends_in_words(model)
    for term, value in zip(model.terms, model.coefficients, strict=True):
        error = model.std_error(term.name) or 0.0
        if error > 0.5 * abs(value) and term.bounds[0] < value < term.bounds[1]:
            found.append(
                f"{term.name} ({term.symbol}) is hardly known: {value:.4g} with a standard error "
                f"of {error:.2g}{'' if term.unit == '1' else ' ' + term.unit}; drive more of what "
                "it acts on"
            )
    if independent < _LEAST_INDEPENDENT:
        found.append(
            f"the residual is so correlated that the logs hold about {independent:.0f} independent "
            "samples; the standard errors are rough. Record longer, or look for a missing effect"
        )
    return found
