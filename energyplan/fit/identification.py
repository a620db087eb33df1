"""From drive logs to a power model: coefficients, tread ICRs, and how well both are known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from energyplan import html
from energyplan.errors import InvalidInputError, ModelError, NotIdentifiableError, UnknownNameError
from energyplan.fit.doubts import (
    Adequacy,
    Wider,
    adequacy,
    check_identifiable,
    differ,
    ends_in_words,
    linearise,
    open_in_words,
    pieces_of,
    predicted,
    signal_motion,
    statistics,
    usual_effects,
)
from energyplan.fit.drive import BLOCK, Drive, check_long_enough, cut, enough_of
from energyplan.fit.estimate import Fitted, Problem, joint_fit, problem_of, run_effect
from energyplan.fit.icr import ICREstimate, fit_icr, turned, yaw_channel
from energyplan.fit.regressors import is_lossy
from energyplan.fit.run import LEVEL, Energy, RunEffect
from energyplan.fit.solvers import (
    HUBER_TUNING,
    Bounds,
    column_scale,
    huber,
    jackknife,
    lad,
    least_squares,
    robust_scale,
    simplex,
    weighted_least_squares,
)
from energyplan.logs import DriveLog
from energyplan.logs.checks import find_checks, find_lost_sign, refuse_one_side, without_copies
from energyplan.logs.clean import set_aside_by_drive
from energyplan.logs.consistency import correlation, distance_ratio, lasts, yaw_rates
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Residual, Term
from energyplan.records import ByValue, checked
from energyplan.vehicle import TreadICR, Vehicle

# -- the fit itself: measured power of all logs against a model that may not be linear -------------

Method = Literal["lad", "simplex", "huber", "windows"]
Loss = Callable[[FloatArray], float]

_BLOCKS = 16  # of the jackknife, at least: blocks are shorter where a log is short


class PowerRegression:
    """Measured total power and the predictions to fit to it, all drives one below the other."""

    def __init__(self, drives: Sequence[Drive], model: PowerModel) -> None:
        self._start = model
        self._problem = Problem(drives, model.vehicle).of_totals
        self._drives = self._problem.drives
        self._measured = np.concatenate([drive.power for drive in drives])
        self.pieces = pieces_of(drives)
        self._linear = not any(is_lossy(drive, model.terms) for drive in drives)

    @property
    def bounds(self) -> Bounds:
        """Range of each coefficient that vehicle and logs admit."""
        return Bounds(*self._problem.ends(self._start.terms).T)

    def powers(self, model: PowerModel) -> list[FloatArray]:
        """Return the predicted power of each drive [W]."""
        return [predicted(model, drive) for drive in self._drives]

    def residual(self, model: PowerModel) -> FloatArray:
        """Measured minus predicted power [W]."""
        return np.asarray(self._measured - np.concatenate(self.powers(model)))

    def _linearise(self, model: PowerModel) -> tuple[FloatArray, FloatArray]:
        """Target and design of the linear problem at a model's coefficients."""
        about = self._problem.tables(model.terms, model.coefficients)
        target, design = (
            np.concatenate([part[:, 0] for part in parts])
            for parts in (about.targets, about.columns)
        )
        return target, design

    def solve(self, method: Method, bounds: Bounds, near: FloatArray | None = None) -> PowerModel:
        """Return the model with the coefficients that minimise the method's sum; `near` others."""
        if method not in ("lad", "simplex", "huber"):
            raise UnknownNameError("method", str(method), ("lad", "simplex", "huber"))
        if method == "simplex":
            rough = self._iterate(weighted_least_squares, lambda _: _squares, bounds)
            found = simplex(
                lambda c: _absolute(self.residual(self._start.with_coefficients(c))), rough, bounds
            )
        elif method == "lad":
            fit = partial(lad, near=near) if self._linear else lad
            found = self._iterate(fit, lambda _: _absolute, bounds)
        else:
            found = self._iterate(huber, _huber_loss, bounds)
        return self._start.with_coefficients(self._snapped(found, bounds))

    def _snapped(self, c: FloatArray, bounds: Bounds) -> FloatArray:
        """Put coefficients that are at a bound but for rounding at the bound."""
        _, design = self._linearise(self._start.with_coefficients(c))
        watt = 1e-9 * float(np.max(np.abs(self._measured), initial=0.0))
        for bound in (bounds.lower, bounds.upper):
            c = np.where(np.abs(c - bound) * column_scale(design) < watt, bound, c)
        return c

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

    def covariance(self, model: PowerModel, method: Method, independent: float) -> FloatArray:
        """Covariance of the coefficients: a jackknife over blocks of time, by one step each.

        `independent` is the number of independent samples that the residual is equivalent to.
        """
        target, design = self._linearise(model)
        residual = target - design @ model.coefficients
        sigma = robust_scale(residual[residual != 0.0]) if np.any(residual) else 0.0
        sigma = max(sigma, 1e-9 * float(np.max(np.abs(self._measured), initial=1e-300)))
        if method == "huber":
            edge = HUBER_TUNING * sigma
            pull, slope = np.clip(residual, -edge, edge), (np.abs(residual) < edge).astype(float)
        else:
            pull, slope = np.sign(residual), 2.0 * _density_at_zero(residual, sigma, independent)
        time = sum(float(drive.t[-1]) for drive in self._drives)
        length = min(BLOCK, time / _BLOCKS)
        first, block = 0, list[NDArray[np.intp]]()
        for drive in self._drives:
            block.append(first + cut(drive.t, length))
            first = int(block[-1][-1]) + 1
        scale = column_scale(design)
        table = np.column_stack([design / scale, pull])
        bread, score = np.zeros((first, len(scale), len(scale))), np.zeros((first, len(scale)))
        edges = np.flatnonzero(np.diff(np.concatenate(block), prepend=-1))
        for k, part in enumerate(np.split(table, edges[1:])):
            weight = slope[edges[k] : edges[k] + len(part)]
            bread[k] = (part[:, :-1] * weight[:, None]).T @ part[:, :-1]
            score[k] = part[:, -1] @ part[:, :-1]
        whole, kept = bread.sum(axis=0), np.any(score != 0.0, axis=1)
        rest = np.linalg.pinv(whole - bread[kept], rcond=1e-12, hermitian=True)
        moved = np.einsum("bij,bj->bi", rest, score.sum(axis=0) - score[kept]) / scale
        if len(moved) < 2:
            return np.full_like(whole, np.inf)
        # Neighbouring blocks are alike: variance of a mean over one, relative to all of them.
        ratio = 0.5 * time / max(independent, 1.0) / length
        alike = ratio * (1.0 - np.exp(-1.0 / max(ratio, 1e-3)))
        return np.asarray(jackknife(moved) / (1.0 - alike))

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
            turned = (predicted(other, drive.with_icr(moved)) for drive in self._drives)
            ahead = np.concatenate([*turned])
            shifts.append((ahead - power) / step)
        sensitivity = -np.linalg.lstsq(design, np.column_stack(shifts))[0]
        return np.asarray(sensitivity @ estimate.covariance @ sensitivity.T)


def _squares(residual: FloatArray) -> float:
    return float(residual @ residual)


def _absolute(residual: FloatArray) -> float:
    return float(np.abs(residual).sum())


def _huber_loss(present: FloatArray) -> Loss:
    """Huber's loss at the scale of the present residual."""
    size = np.abs(present)
    edge = HUBER_TUNING * max(robust_scale(present), 1e-9 * float(size.max()), 1e-100)

    def loss(residual: FloatArray) -> float:
        inner = np.minimum(np.abs(residual), edge)
        return float((inner * (np.abs(residual) - 0.5 * inner)).sum())

    return loss


def _density_at_zero(residual: FloatArray, sigma: float, independent: float) -> FloatArray:
    """Each residual's share in the kernel estimate of the density at zero (Powell 1991)."""
    width = 1.06 * sigma * max(independent, 2.0) ** -0.2
    z = residual / width
    return np.asarray(np.exp(-0.5 * z * z) / (width * np.sqrt(2 * np.pi)))


# -- how well a model predicts the energy of driving that it was not fitted to ---------------------

_FEWEST = 4  # drives from which on whole ones are left out
_STRETCHES = 5
_LEAST = 0.1  # share of the typical power that what is left out counts as taking at least


@dataclass(frozen=True)
class CrossValidation:
    """Errors of energies, each predicted from all other driving."""

    left_out: Literal["drive", "stretch"]
    count: int  # how many
    duration: float  # their median length [s]
    error: float  # mean size of the relative error of their energies
    largest: float

    @property
    def in_words(self) -> str:
        """What was left out, and how far its energy was missed."""
        what = "drives" if self.left_out == "drive" else "stretches"
        return (
            f"{what} of {self.duration:.3g} s, each predicted from the others, miss their energy "
            f"by {100 * self.error:.2g} %, at most {100 * self.largest:.2g} %"
        )


def without_each(parts: Sequence[Drive], model: PowerModel) -> list[FloatArray]:
    """Return the power of each drive by the model's terms fitted to all the others [W]."""
    found = list[FloatArray]()
    for k, part in enumerate(parts):
        rest = PowerRegression([*parts[:k], *parts[k + 1 :]], model)
        others = rest.solve("lad", rest.bounds, model.coefficients)
        found += PowerRegression([part], others).powers(others)
    return found


def cross_validation(model: PowerModel, drives: Sequence[Drive]) -> CrossValidation | None:
    """Predict each drive, or each stretch of few drives, from the others."""
    parts = list(drives)
    if len(drives) < _FEWEST:
        whole, parts = sum(float(drive.t[-1]) for drive in drives), []
        for drive in drives:
            count = max(round(_STRETCHES * float(drive.t[-1]) / whole), 1)
            number = np.minimum(drive.t / drive.t[-1] * count, count - 1).astype(int)
            stretches = [np.flatnonzero(number == k) for k in range(count)]
            # of a stretch in a gap there is nothing
            parts += [drive.some(stretch) for stretch in stretches if len(stretch) > 2]
    weights = [part.weights for part in parts]
    energy = np.array([float(w @ part.power) for w, part in zip(weights, parts, strict=True)])
    seconds = np.array([float(w.sum()) for w in weights])
    if len(parts) < 2 or energy.sum() <= 0.0:
        return None
    powers = without_each(parts, model)
    missed = energy - [float(w @ power) for w, power in zip(weights, powers, strict=True)]
    typical = energy.sum() / seconds.sum() * seconds
    errors = np.abs(missed) / np.maximum(np.abs(energy), _LEAST * typical)
    what: Literal["drive", "stretch"] = "drive" if len(drives) >= _FEWEST else "stretch"
    return CrossValidation(
        what, len(parts), float(np.median(seconds)), float(errors.mean()), float(errors.max())
    )


# -- friction inside a robot, from drives with its wheels in the air -------------------------------

_SLOWEST = 0.05  # tread speed from which a side turns [m/s]
_BIN = 0.1  # width of the speed classes [m/s]
_STEADY = 0.15  # largest tread acceleration of a steady sample [m/s^2]
_ENOUGH = 20
_TRAVEL = {"x", "y", "yaw", "yaw_rate", "accel_x"}
_TOGETHER = 0.7  # correlation of the turning with the treads' of a robot that drives
_PILED = 0.05  # share of moving readings at the least one, from which it is a dead band


@dataclass(frozen=True)
class SpeedClass:
    """Mean force of a side in a class of speeds."""

    speed: float  # mean tread speed [m/s]
    force: float  # mean force at the tread [N]
    std_error: float  # its standard error [N]
    samples: int  # how many samples


@dataclass(frozen=True)
class InternalFriction:
    """Friction inside one side of the robot, ``F(v) = force + slope * (|v| - speed)``."""

    side: str  # the side
    force: float  # force at the mean speed of the drives [N]
    force_error: float  # standard error of that force [N]
    speed: float  # that mean speed [m/s]
    slope: float  # how the force changes with the tread speed [N s/m]
    slope_error: float  # standard error of that slope [N s/m]
    classes: tuple[SpeedClass, ...]  # the force by speed
    left_out: int  # moving samples in the sensor's dead band, which give only an upper limit

    @property
    def power_without_speed(self) -> bool:
        """Whether the force falls with speed as if the power did not depend on it."""
        steep = self.slope < -0.5 * self.force / self.speed
        return steep and self.slope < -3 * self.slope_error


def hoisted(
    logs: DriveLog | Sequence[DriveLog], motor_constant: float | None = None
) -> tuple[InternalFriction, ...]:
    """Find the friction inside each side from drives with the wheels in the air."""
    # Source: Morales et al. (2010), section IV: 59 N were found so.
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    for log in drives:
        _refuse_driving(log)
    return tuple(_side(drives, side, motor_constant) for side in ("left", "right"))


def _refuse_driving(log: DriveLog) -> None:
    """Refuse a drive on the ground, where slip and rolling resist too."""
    difference = log.channels["v_right"] - log.channels["v_left"]
    rates = yaw_rates(log.channels, log.runs)
    turns = [name for name, rate in rates.items()
             if lasts(rate) and correlation(rate, difference) > _TOGETHER]  # fmt: skip
    goes = np.isfinite(distance_ratio(log.channels, log.runs))
    if turns or goes:
        raise NotIdentifiableError(
            f"{log.name}: {turns[0] if turns else 'the pose'} follows the treads, so the wheels "
            "were on the ground; what resists them there is not the friction inside: leave out "
            "--hoisted, or give drives with the wheels in the air"
        )


def doubts_off_the_ground(log: DriveLog) -> tuple[str, ...]:
    """Return the warnings of a log that hold for a robot whose wheels are in the air."""
    kept = {name: v for name, v in log.channels.items() if name not in _TRAVEL}
    stale = {*map(str, log.checks)} - {*map(str, find_checks(kept, log.power, log.runs))}
    return tuple(warning for warning in log.warnings if warning not in stale)


def _side(drives: Sequence[DriveLog], side: str, constant: float | None) -> InternalFriction:
    """Find one side's friction."""
    channel = f"p_{side}" if constant is None else f"current_{side}"
    speeds: list[FloatArray] = []
    forces: list[FloatArray] = []
    lost = 0
    for log in drives:
        if not log.has(channel):
            raise InvalidInputError(
                f"{log.name}: there is no {channel}, and the friction of each side needs "
                f"both; map a column to it, as in {channel}=NAME"
            )
        speed = np.abs(log.channel(f"v_{side}"))
        reading = np.abs(log.channel(channel))
        change = np.gradient(_smooth(speed), log.t)
        moving = (speed > _SLOWEST) & (np.abs(change) < _STEADY)
        if not np.any(moving):
            continue
        if constant is not None:
            floor = float(reading[moving].min())
            piled = moving & (reading <= floor * 1.01 + 1e-12)
            if np.count_nonzero(piled) > _PILED * np.count_nonzero(moving):
                lost += int(np.count_nonzero(piled))
                # What the sensor does not show lies between nothing and its dead band.
                reading = np.where(piled, 0.5 * floor, reading)
            force = constant * reading
        else:
            force = reading / np.maximum(speed, _SLOWEST)
        speeds.append(speed[moving])
        forces.append(force[moving])
    if not speeds or sum(map(len, speeds)) < _ENOUGH:
        raise NotIdentifiableError(
            f"the {side} side hardly turns at a steady speed: drive it for half a minute at two "
            "speeds or more"
        )
    v, force = np.concatenate(speeds), np.concatenate(forces)
    mean = float(v.mean())
    X = np.stack([np.ones(len(v)), v - mean], axis=1)
    spread = float(np.ptp(v)) > _BIN
    ends = np.cumsum([0, *map(len, speeds)])
    pieces = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    found, covariance, repeats = least_squares(X if spread else X[:, :1], force, pieces)
    errors = np.sqrt(np.diag(covariance))
    return InternalFriction(
        side, float(found[0]), float(errors[0]), mean,
        float(found[1]) if spread else 0.0, float(errors[1]) if spread else np.inf,
        _classes(v, force, repeats), lost,
    )  # fmt: skip


def _classes(speed: FloatArray, force: FloatArray, repeats: float) -> tuple[SpeedClass, ...]:
    number = np.round(speed / _BIN).astype(int)
    made = []
    for k in np.unique(number):
        some = force[number == k]
        if len(some) >= _ENOUGH:
            error = float(some.std() * np.sqrt(min(repeats, len(some)) / len(some)))
            at = float(speed[number == k].mean())
            made.append(SpeedClass(at, float(some.mean()), error, len(some)))
    return tuple(made)


def _smooth(values: FloatArray) -> FloatArray:
    """Return running means over nine samples: encoders beat."""
    padded = np.pad(values, 4, mode="edge")
    return np.convolve(padded, np.full(9, 1 / 9), mode="valid")


# -- from drive logs to a power model: coefficients, tread ICRs, and how well both are known -------

ICRChoice = Literal["auto", "symmetric", "asymmetric", "vehicle"]

_SHORTEST = 1.0  # shortest drive that is identified from [s]

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
        Number of independent samples that the autocorrelated residual is equivalent to.
    adequacy : Adequacy
        Residual, compared with noise, once the inertia and the mobilisation of friction that nearly
        every drive shows are allowed for. Where that is more than noise, the model lacks something,
        and coefficients may be off by more than their standard errors.
    cross_validation : CrossValidation, optional
        Error of energies that are predicted from the other drives, or from the rest of
        few drives; None where the drives took no energy.
    warnings : tuple of str
        What the logs do not determine, or hardly.
    set_aside : mapping of str to mapping of str to int
        How many samples were left out or mended, by drive and reason.
    run : RunEffect
        By how much the energy of a run differs from what the model says of it: compared from three
        drives on, else as of robots elsewhere.

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
    cross_validation: CrossValidation | None
    warnings: tuple[str, ...]
    set_aside: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    run: RunEffect = field(default_factory=RunEffect)

    def __post_init__(self) -> None:
        if self.model.covariance is None or self.model.residual is None:
            raise ModelError("an identified model needs its covariance and its residual")
        if self.icr_covariance is not None:
            known = np.array(self.icr_covariance, float)
            known.setflags(write=False)
            object.__setattr__(self, "icr_covariance", known)

    def _summaries(self) -> list[html.Summary]:
        spread = self.icr_std_error or {}
        rows: list[tuple[object, ...]] = [
            (term.name, term.symbol, float(value), self.std_error[term.name],
             "{} to {}".format(*map(html.number, self.interval(term.name))), term.unit)
            for term, value in zip(self.model.terms, self.model.coefficients, strict=True)
        ]  # fmt: skip
        rows += [
            (f"tread ICR {side}", "C", getattr(self.icr, side), spread.get(side, "kept"), "-", "m")
            for side in ("left", "right")
        ]
        left = self.residual
        title = (
            f"{self.model.name}: residual rmse {html.number(left.rmse)} W, mae "
            f"{html.number(left.mae)} W, bias {html.number(left.bias)} W, energy "
            f"{100 * left.energy_error:+.2f} %"
        )
        header = ("term", "symbol", "value", "standard error", "95 % interval", "unit")
        seen = (
            [f"unseen driving: {self.cross_validation.in_words}"] if self.cross_validation else []
        )
        notes = [*seen, *html.set_aside(self.set_aside), *self.warnings]
        return [html.Summary(title, header, rows, notes)]

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
    def energy(self, log: DriveLog, level: float = LEVEL) -> Energy:
        """Predict the energy of a drive that took no part, with an interval.

        Parameters
        ----------
        log : DriveLog
            The drive: its motion counts, not what it measured.
        level : float
            Probability in (0, 1) that such intervals hold what is measured.

        Returns
        -------
        Energy
            The energy and the ends of its interval [J]: coefficients are not known exactly, runs
            differ as a whole, and within a run the model errs.

        Raises
        ------
        InvalidInputError
            If the level is no probability.
        MissingChannelError
            If a term needs a channel that the log lacks.
        """
        _check_level(level)
        return self.run.energy(self.model, Drive.of(log, self.model.vehicle), level)

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
        _check_level(level)
        freedom = max(self.effective_samples - len(self.model.terms), 1.0)
        value = self.model.coefficient(name)
        reach = float(student.ppf(0.5 + level / 2, freedom)) * self.std_error[name]
        return value - reach, value + reach


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise InvalidInputError(f"level is {level}; give a probability such as 0.95")


_CALENDAR = 1e9, 4e9  # seconds since 1970 that are days of this century: 2001 to 2096


def name_of(vehicle: Vehicle, logs: Sequence[DriveLog]) -> str:
    """Return the name of a model: its robot, and the days of its drives or the first's name."""
    begun = [log.t[0] if log.began is None else log.began for log in logs]
    if all(_CALENDAR[0] < time < _CALENDAR[1] for time in begun):
        days = sorted({f"{datetime.fromtimestamp(time, UTC):%Y-%m-%d}" for time in begun})
        return f"{vehicle.name}, {' to '.join(dict.fromkeys((days[0], days[-1])))}"
    more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
    return f"{vehicle.name}, {Path(logs[0].name).stem}{more}"


@checked()
def identify(
    logs: DriveLog | Sequence[DriveLog],
    vehicle: Vehicle,
    *,
    terms: Sequence[Term] = (SLIP, TRACTION),
    method: Method = "lad",
    icr: ICRChoice | TreadICR = "auto",
    name: str = "",
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
        Name of the model; by default that of the robot and of its drives.

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
    drives, warnings = _usable(logs, terms)
    estimate = _find_icr(drives, vehicle, icr, warnings)
    settled = icr if isinstance(icr, TreadICR) else estimate.icr if estimate else vehicle.icr
    vehicle = vehicle.with_icr(settled)
    bounds = Bounds(*np.array([term.bounds for term in terms], float).T)
    start = bounds.clip(np.zeros(len(terms)))
    name = name or name_of(vehicle, drives)
    model = PowerModel(vehicle, tuple(terms), start, name=name)

    turning = turned(drives, settled)
    ready = [Drive.of(log, vehicle) for log in drives]
    clean = [signal_motion(drive, turning) for drive in ready]
    linear = [term for term in terms if term.kind != "loss"]
    if linear:
        first = PowerModel(vehicle, tuple(linear), np.zeros(len(linear)))
        doubts = check_identifiable(first, _stacked(first, clean, ready), turning)
    problem, few = PowerRegression(ready, model), enough_of(ready)
    known = [one for one in usual_effects() if all(term in terms for term in one.terms)]
    sides = Problem(few, vehicle)
    if method == "windows" or sides.drives[0].equations == 2:
        sides = problem_of(drives, vehicle, known, few)
    of_sides = None
    if method == "windows":
        check_long_enough(drives)
        joint = of_sides = joint_fit(sides, terms)
        if sides is not sides.of_totals:
            alone = joint_fit(sides.of_totals, terms)
            joint = alone if _sides_apart(sides, alone.model, of_sides) else joint
        model = replace(joint.model, name=name)
        warnings += open_in_words(model, joint.assumed)
    else:
        model = problem.solve(method, problem.bounds)
    if len(linear) < len(terms):
        doubts = check_identifiable(model, _stacked(model, clean, ready), turning)
    warnings += doubts

    powers = problem.powers(model)
    residual = statistics(ready, powers)
    independent = residual.duration / max(2 * residual.correlation_time, 1e-300)
    covariance, values = model.covariance, np.array(model.coefficients)
    run = run_effect(Problem(few, vehicle), model.terms, values)
    if run.compared:
        residual = replace(residual, run_spread=run.deviation)
    if covariance is None:
        covariance = problem.covariance(model, method, independent) + run.shared(values, len(few))
    if estimate is not None:
        covariance = covariance + problem.inherited(model, estimate)
    model = replace(model, covariance=covariance, residual=residual)
    warnings += _sides_apart(sides, model, of_sides)
    icr_covariance = None if estimate is None else estimate.covariance
    warnings += _doubts(model, independent)
    warnings += _draw_at_rest(ready, powers)
    wider = Wider.of(model, few)
    quality = adequacy(few, wider.residuals)
    validation = cross_validation(model, few)
    warnings += _missing(quality, wider.moves, validation)
    aside = set_aside_by_drive(drives)
    return Identification(
        model, method, icr_covariance, independent, quality, validation, tuple(warnings), aside, run
    )


def fit_residual(model: PowerModel, logs: DriveLog | Sequence[DriveLog]) -> Residual:
    """Compare a model's power with what logs measured."""
    drives = [Drive.of(log, model.vehicle) for log in _drives(logs)]
    return statistics(drives, PowerRegression(drives, model).powers(model))


# -- parts --------------------------------------------------------------------------------------


def _usable(
    logs: DriveLog | Sequence[DriveLog], terms: Sequence[Term]
) -> tuple[list[DriveLog], list[str]]:
    """Return the drives to identify terms from, each once, and warnings; refuse what shows none."""
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
        lost = {log.name: find_lost_sign(log.channels) for log in drives if log.signed is None}
        warnings += [
            f"{name}: {text}; if so, these terms are wrong" for name, text in lost.items() if text
        ]
    return drives, warnings


def _missing(left: Adequacy, moves: Sequence[str], left_out: CrossValidation | None) -> list[str]:
    """Warn of a model that lacks something, and of how much: errors know of noise alone."""
    if moves:
        what = f"inertia and the mobilisation of friction beside it move {' and '.join(moves)}"
    elif not left.adequate:
        what = f"beside inertia it leaves {left.in_words}"
    else:
        return []
    size = "" if left_out is None else f", energies by some {100 * left_out.error:.2g} %"
    return [
        f"the model lacks something: {what}. Coefficients may be off by more than their standard "
        f"errors{size}; 'energyplan diagnose' with the same logs tells what is missing"
    ]


def _sides_apart(sides: Problem, model: PowerModel, fitted: Fitted | None) -> list[str]:
    """Warn where the difference of both sides' powers shows another friction than their sum."""
    lossy = any(is_lossy(drive, model.terms) for drive in sides.drives)
    seconds = sum(float(drive.t[-1]) for drive in sides.drives)
    if lossy or not model.has(SLIP.name) or sides.drives[0].equations == 1 or seconds < 2 * BLOCK:
        return []
    shown = (fitted or joint_fit(sides, model.terms)).model
    mu, total = (float(one.coefficient(SLIP.name)) for one in (shown, model))
    error, total_error = (one.std_error(SLIP.name) or 0.0 for one in (shown, model))
    if not differ(mu, total, error, total_error):
        return []
    return [
        "the sum of both sides' powers shows mu = "
        f"{html.quantity(total, total_error, '')}, which this model has, their difference "
        f"{html.quantity(mu, error, '')}: turns take {'more' if total > mu else 'less'} than "
        "friction, as where motors heat or return less than they took, or a sensor of a side is "
        "wrong. Other turns may cost otherwise; 'energyplan diagnose' looks for the loss"
    ]


def _draw_at_rest(drives: Sequence[Drive], powers: Sequence[FloatArray]) -> list[str]:
    """Warn of power that the robot draws standing still and no term explains."""
    residual = np.concatenate(
        [(drive.power - power)[drive.rests] for drive, power in zip(drives, powers, strict=True)]
    )
    if len(residual) < _LEAST_INDEPENDENT:
        return []
    ones, whole = np.ones((len(residual), 1)), [slice(0, len(residual))]
    (mean,), variance, _ = least_squares(ones, residual, whole)
    if abs(mean) < 5 * max(float(np.sqrt(variance[0, 0])), 0.1):
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
    """Identify tread ICRs by the choice; None, with a warning, where the vehicle's are kept."""
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
