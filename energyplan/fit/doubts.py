"""What drives leave open of a model, and what is known of robots elsewhere (private)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import f as fisher

from energyplan.errors import MissingChannelError, NotIdentifiableError
from energyplan.fit.drive import SCALES, Drive, speed_noise
from energyplan.fit.regressors import Linear, equations_of, is_lossy, linearise_drive, power_of
from energyplan.fit.run import RunEffect
from energyplan.fit.solvers import (
    NORMAL_MAD,
    SensorNoise,
    correlation_time,
    least_squares,
    repeats_of,
)
from energyplan.html import number, unit
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual, Term
from energyplan.power.effects import SLIP_CHANGE, TRACTION_CHANGE, WHEEL_FIGHT, Effect, catalogue
from energyplan.vehicle import GRAVITY, TreadICR, Vehicle

# -- what a model's prediction leaves of measured drives -------------------------------------------


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
    """Return why nothing can be said of a model's energies with a probability."""
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


# -- what logs show about a model's coefficients: linearisation and identifiability ----------------

_NO_DATA = 0.01  # A regressor below this fraction of its size in common manoeuvres counts as zero

COLLINEAR = 0.02
"""Smallest singular value of the regressors, each of unit size: below, they are one another's
combination but for what the noise of the speeds adds."""

_NEARLY_COLLINEAR = 0.1
"""Smallest singular value below which a warning says that regressors hardly differ."""


_SPIN = "a spin on the spot"
_STRAIGHT = "straight lines at several constant speeds"


def is_linear(model: PowerModel) -> bool:
    """Return whether the power is linear in the coefficients: no loss depends on the forces."""
    return all(term.kind != "loss" for term in model.terms)


def linearise(model: PowerModel, motion: Motion, battery: bool = False) -> Linear:
    """Linearise a model's total power about its coefficients, instant by instant."""
    drive = Drive.at(replace(motion, icr=model.vehicle.icr), battery)
    return linearise_drive(drive, model.vehicle, model.terms, model.coefficients)


def signal_motion(drive: Drive, turning: bool = True) -> Motion:
    """Return a drive's motion averaged over a second: what its manoeuvres show."""
    motion, window = drive.motion, min(drive.samples_in(1.0), max(len(drive.t) // 2, 1))
    left, right = np.empty(len(drive.t)), np.empty(len(drive.t))
    for run in drive.runs:
        left[run] = uniform_filter1d(motion.v_left[run], window, mode="nearest")
        right[run] = uniform_filter1d(motion.v_right[run], window, mode="nearest")
    if not turning:
        left = right = 0.5 * (left + right)
    clean = replace(motion, v_left=left, v_right=right)
    return clean.with_channels(
        accel=np.gradient(clean.v, drive.t), yaw_accel=np.gradient(clean.omega, drive.t)
    )


# -- identifiability ----------------------------------------------------------------------------


def _manoeuvres(icr: TreadICR) -> dict[str, Motion]:
    """Manoeuvres that a test drive can add, each as a few instants."""
    half = icr.half_track

    def motion(left: object, right: object, **channels: object) -> Motion:
        arrays = np.broadcast_arrays(np.asarray(left, float), np.asarray(right, float))
        level = dict.fromkeys(("slope", "accel", "yaw_accel", "yaw"), 0.0)
        given = {**level, "t": np.linspace(60.0, 120.0, arrays[0].size), **channels}
        known = {name: np.asarray(value, float) for name, value in given.items()}
        known["accel_x"] = known["accel"] + GRAVITY * np.sin(known["slope"])
        return Motion(arrays[0], arrays[1], icr, known)

    speeds, forth = np.array([0.25, 0.5, 0.75, 1.0]), np.array([0.5, -0.5, 0.8, -0.8])
    ramp, change = np.array([0.3, 0.6, 0.6, 0.3]), np.array([0.5, 0.5, -0.5, -0.5])
    return {
        _SPIN: motion(-speeds, speeds),
        _STRAIGHT: motion(speeds, speeds),
        "a stop of some seconds with the drives on": motion(np.zeros(4), np.zeros(4)),
        "arcs of several radii to both sides": motion([0.2, 0.4, 0.6, 0.8], [0.8, 0.6, 0.4, 0.2]),
        "spins to both sides": motion(-forth, forth),
        "straight lines forwards and backwards": motion(forth, forth),
        "speeding up and braking on a straight line": motion(ramp, ramp, accel=change),
        "spins that speed up and brake": motion(-ramp, ramp, yaw_accel=change / half),
        "a slope driven up and down": motion(np.full(4, 0.5), np.full(4, 0.5), slope=0.2 * change),
        "a straight line driven in four headings": motion(
            np.full(4, 0.5), np.full(4, 0.5), yaw=0.5 * np.pi * np.arange(4)
        ),
    }


def _columns(model: PowerModel, motion: Motion) -> FloatArray | None:
    """Regressors on a manoeuvre; None where a term needs a channel that no manoeuvre sets."""
    try:
        return linearise(model, motion).columns[:, 0]
    except MissingChannelError:
        return None


def _named(terms: list[Term]) -> str:
    return " and ".join(f"{term.name} ({term.symbol})" for term in terms)


def gap(gram: FloatArray) -> tuple[float, FloatArray]:
    """Return the smallest singular value of regressors, by their Gram matrix, and its direction."""
    value, vector = np.linalg.eigh(gram)
    return float(np.sqrt(max(value[0], 0.0))), np.asarray(vector[:, 0])


def _best(values: dict[str, float]) -> str:
    """Name with the largest value; the first of those within a percent of it."""
    most = max(values.values())
    return next(name for name, value in values.items() if value >= 0.99 * most)


def check_identifiable(
    model: PowerModel, jacobian: FloatArray, turning: bool = True
) -> tuple[str, ...]:
    """Refuse data that cannot determine the coefficients."""
    tests = {
        name: columns
        for name, motion in _manoeuvres(model.vehicle.icr).items()
        if (columns := _columns(model, motion)) is not None
    }
    size = np.sqrt(np.mean(jacobian**2, axis=0))
    for k, term in enumerate(model.terms):
        common = {name: float(np.sqrt(np.mean(c[:, k] ** 2))) for name, c in tests.items()}
        if size[k] <= _NO_DATA * max(common.values(), default=0.0) or size[k] == 0:
            varied = f"drives in which {' and '.join(term.channels) or 'it acts'} vary"
            remedy = _best(common) if any(common.values()) else varied
            if not turning and not common.get(_STRAIGHT) and common.get(_SPIN):
                raise NotIdentifiableError(
                    f"{_named([term])} cannot be identified: by its yaw the robot did not turn "
                    "where its treads did; if the wheels were off the ground, identify with "
                    "--hoisted; if the yaw is dead, leave that channel out"
                )
            raise NotIdentifiableError(
                f"{_named([term])} cannot be identified: what it multiplies is zero throughout "
                f"these logs; add {remedy}, or leave the term out"
            )
    scaled = jacobian / (size * np.sqrt(len(jacobian)))
    least, direction = gap(scaled.T @ scaled)
    if len(model.terms) < 2 or least >= _NEARLY_COLLINEAR:
        return ()
    weight = np.abs(direction)
    chosen = [term for term, w in zip(model.terms, weight, strict=True) if w > 0.2 * weight.max()]
    gains = {
        name: gap(rows.T @ rows)[0]
        for name, c in tests.items()
        for rows in [np.vstack([scaled, c / (size * np.sqrt(len(c)))])]
    }
    remedy = _best(gains) if gains else "drives in which they vary apart"
    if least < COLLINEAR and gains and gains[remedy] < 2 * least:
        raise NotIdentifiableError(
            f"{_named(chosen)} cannot be separated, and no common manoeuvre would separate them: "
            "leave one of the terms out, or measure it by other means"
        )
    if least < COLLINEAR:
        raise NotIdentifiableError(
            f"{_named(chosen)} cannot be separated: what they multiply is proportional throughout "
            f"these logs; add {remedy}, or leave one of the terms out"
        )
    return (
        f"{_named(chosen)} can hardly be separated by these logs (what they multiply differs by "
        f"{100 * least:.0f} %); {remedy} would separate them",
    )


# -- what is known of a wheeled robot's friction before it drives ----------------------------------

USUAL = {"slip_friction": (0.6, 0.3), "traction_resistance": (0.1, 0.05)}
"""Mean and standard deviation: of mu, and of K over the robot's weight. They are those of the
presets: from ice to asphalt, from 17 to 470 kg."""

_NOT_SHOWN = 1e3  # typical standard deviations, as the error of what drives do not show
_UNLIKE = 9.0  # mean square of standard deviations from the typical, beyond which it is atypical
_WIDER = 1.5  # factor of the typical variance, in steps, for a robot that is atypical


class UsualFriction(NamedTuple):
    """Mean and standard deviation of a coefficient over robots and surfaces."""

    mean: float
    deviation: float


def usual_friction(term: Term, vehicle: Vehicle) -> UsualFriction:
    """Return what a coefficient of the paper usually is for a robot: mu, or K [N]."""
    scale = vehicle.mass * GRAVITY if term.name == "traction_resistance" else 1.0
    mean, deviation = USUAL[term.name]
    return UsualFriction(scale * mean, scale * deviation)


def leaves_open(model: PowerModel) -> bool:
    """Whether a model's own errors of a friction are larger than robots elsewhere differ."""
    return any(
        (model.std_error(term.name) or 0.0) > usual_friction(term, model.vehicle).deviation
        for term in model.terms if term.name in USUAL
    )  # fmt: skip


def with_usual(
    values: FloatArray, covariance: FloatArray, terms: Sequence[Term], gram: FloatArray,
    vehicle: Vehicle,
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:  # fmt: skip
    """Return coefficients and covariance with typical ones as a prior, where drives show less."""
    which = [k for k, term in enumerate(terms) if term.name in USUAL]
    known = [usual_friction(terms[k], vehicle) for k in which]
    mean, error = np.array(known).reshape(-1, 2).T
    values, covariance = np.array(values), np.array(covariance)
    size = np.sqrt(np.diagonal(gram)[which])
    for k, (place, shown) in enumerate(zip(which, size > 0.0, strict=True)):
        if not shown:
            covariance[place, place] += (_NOT_SHOWN * error[k]) ** 2
    if len(which) == 2 and np.all(size > 0.0):
        least, along = gap(gram[np.ix_(which, which)] / np.outer(size, size))
        if least < COLLINEAR:
            along = along / size
            along *= _NOT_SHOWN / np.max(np.abs(along) / error)
            covariance[np.ix_(which, which)] += np.outer(along, along)
    loose = np.diagonal(covariance)[which] > error**2
    taken = [place for place, one in zip(which, loose, strict=True) if one]
    if taken:
        away, total = mean[loose] - values[taken], covariance[np.ix_(taken, taken)]
        usual = np.diag(error[loose] ** 2)
        if _unlike(away, total + usual) > _UNLIKE:
            while _unlike(away, total + usual) > 1.0:
                usual *= _WIDER
        gain = np.linalg.solve(total + usual, covariance[taken]).T
        values = values + gain @ away
        covariance = covariance - gain @ covariance[taken]
    names = tuple(terms[k].name for k in taken)
    return values, covariance, names


def _unlike(away: FloatArray, covariance: FloatArray) -> float:
    """Return the mean square of deviations, in units of their standard ones."""
    return float(away @ np.linalg.solve(covariance, away)) / len(away)


def open_in_words(model: PowerModel, names: Sequence[str]) -> list[str]:
    """Describe which frictions drives leave open, and what they are taken to be."""
    return [
        f"these drives leave {term.name} open; with what robots elsewhere have it is "
        f"{term.symbol} = {number(model.coefficient(term.name))} +- "
        f"{number(model.std_error(term.name) or 0.0, 2)} {unit(term.unit)}".rstrip()
        for term in model.terms if term.name in names
    ]  # fmt: skip


def ends_in_words(model: PowerModel) -> list[str]:
    """Describe which coefficients are at an end of what is possible, or too large for the robot."""
    found, weight = [], model.vehicle.mass * GRAVITY
    for term, value in zip(model.terms, model.coefficients, strict=True):
        if term.name == "traction_resistance" and 2.0 * value > weight:
            found.append(
                f"the traction resistance of both sides is {number(2.0 * value)} N, more than the "
                f"robot weighs, {number(weight)} N: the vehicle's mass, or a unit of speeds or "
                "powers, is wrong"
            )
        if term.bounds[0] < value < term.bounds[1]:
            continue
        shown = (
            "more of it shows in these logs than is possible: the vehicle's mass or a unit"
            if 0.0 < value >= term.bounds[1]
            else "nothing of it shows in these logs, a sign"
        )
        found.append(
            f"{term.name} ({term.symbol}) is at the end {value:g} of its possible range: "
            f"{shown} is wrong, or a term is missing"
        )
    return found


# -- whether what a model leaves of the drives that it was fitted to is no more than noise ---------

_FLOOR = 0.01
"""What is no more than this fraction of the root mean square power is as good as nothing."""
_CHANCE = 1e-3  # that noise alone is called coloured, over all lengths of means
_RESTING = 20  # samples at rest from which the noise may be estimated
_TELLING = 30  # independent ones that do
_LIKE = 0.25  # variance at rest, over that of white noise while driving, from which they do
_STEADY = 3.0  # standard errors by which coefficients move where a model lacks nothing
_MOVED = 0.01  # part of a coefficient by which it may move all the same
_SIGMA = 4.0  # standard deviations that noise does not exceed


@dataclass(frozen=True)
class Adequacy:
    """Residual on the drives of a fit, compared with the noise that no model can explain."""

    noise: float  # of a sample [W]; no more than the residual, which it is a part of
    residual: float  # root mean square residual of the model [W]
    slow_noise: float  # noise of means over `time` [W]
    slow_residual: float  # root mean square of the residual's means over `time` [W]
    coloured: bool  # whether the residual lasts longer than noise would, by more than chance
    time: float  # [s]
    missing: tuple[float, ...] = (0.0, 0.0, 0.0)  # [W^2]
    negligible: float = 0.0  # residual that is as good as nothing, be it noise or not [W]

    @property
    def usual(self) -> float:
        """Residual that is nothing to look into [W]."""
        return max(self.noise, self.negligible)

    @property
    def adequate(self) -> bool:
        """Whether the model leaves no more than noise: less than twice its size, and no colour."""
        return self.residual <= 2.0 * self.usual and not self.coloured

    @property
    def in_words(self) -> str:
        """What is left, what noise makes, and how one differs from the other."""
        what = "lasts longer than noise would" if self.coloured else "is larger than noise"
        return (
            f"{self.residual:.3g} W, where noise makes {self.noise:.3g} W, and in means over "
            f"{self.time:.2g} s {self.slow_residual:.3g} W, where noise makes "
            f"{self.slow_noise:.3g} W: what is left {'is noise' if self.adequate else what}"
        )


def predicted(model: PowerModel, drive: Drive) -> FloatArray:
    """Power that a drive's log would show by a model [W]."""
    return drive.seen(power_of(model, drive))


def shown_of_contacts(model: PowerModel, drive: Drive) -> FloatArray | None:
    """Return what the powers of a drive show of what contacts hold, beyond a prediction [W]."""
    changes = any(term.name in (SLIP_CHANGE.name, TRACTION_CHANGE.name) for term in model.terms)
    undated = changes and "changed" not in drive.motion.channels
    if undated or drive.between is None or not is_lossy(drive, model.terms):
        return None
    keep = [k for k, term in enumerate(model.terms) if term.name != WHEEL_FIGHT.name]
    some = PowerModel(model.vehicle, tuple(model.terms[k] for k in keep), model.coefficients[keep])
    both = equations_of(some, drive)[:, 0]
    alone = equations_of(model, replace(drive, between=None))[:, 0]
    return both - alone if np.any(both != alone) else None


def left_over(model: PowerModel, drives: Sequence[Drive]) -> list[FloatArray]:
    """Return what a model leaves of each drive's power, what contacts hold taken out [W].

    While they change from holding to sliding or back, no model says what they do. Of several
    drives, the factor by which each differs as a whole is taken out too: no term makes up for it.
    """
    left = []
    for drive in drives:
        said, shown = predicted(model, drive), shown_of_contacts(model, drive)
        clear = np.ones(len(said)) if shown is None else drive.settled
        said = (said if shown is None else said + shown) * clear
        measured = drive.power * clear
        factor = RunEffect.usual_factor(said, measured) if len(drives) > 1 else 1.0
        left.append(measured - factor * said)
    return left


def usual_effects(entries: Iterable[Effect] | None = None) -> list[Effect]:
    """Return what of some effects, or of all known ones, nearly every drive shows."""
    every = catalogue().values() if entries is None else entries
    return [effect for effect in every if effect.usual and not effect.channels]


def differ(one: float, other: float, error: float, others: float) -> bool:
    """Return whether two estimates of a coefficient differ by more than errors, and matter."""
    difference = abs(other - one)
    return bool(difference > _MOVED * abs(one) and difference > _STEADY * np.hypot(error, others))


@dataclass(frozen=True)
class Wider:
    """What a model leaves together with the effects that nearly every drive shows."""

    residuals: list[FloatArray]  # (n,): what is left of each drive [W]
    moves: list[str]  # coefficients of the model that move by more than their errors, in words

    @classmethod
    def of(cls, model: PowerModel, drives: Sequence[Drive]) -> Wider:
        """Fit effects that nearly every drive shows in addition to the terms of a model."""
        names, own = {term.name for term in model.terms}, len(model.terms)
        every = [*model.terms] + [
            replace(term, params={**term.params, **dict(zip(effect.grid, values, strict=True))})
            for effect in usual_effects()
            for values in product(*effect.grid.values())
            for term in effect.terms if term.name not in names
        ]  # fmt: skip
        about = np.append(model.coefficients, np.zeros(len(every) - own))
        tables = [linearise_drive(d, model.vehicle, every, about).columns[:, 0] for d in drives]
        left = left_over(model, drives)
        step, covariance, _ = least_squares(
            np.concatenate(tables), np.concatenate(left), pieces_of(drives)
        )
        residuals = [r - table @ step for r, table in zip(left, tables, strict=True)]
        moves = [
            f"{term.symbol} from {value:.4g} to {value + by:.4g}"
            for term, value, by, variance in zip(
                model.terms, model.coefficients, step[:own], np.diag(covariance)[:own], strict=True
            )
            if differ(value, value + by, np.sqrt(variance), model.std_error(term.name) or 0.0)
        ]
        return cls(residuals, moves)


def _noises(drives: Sequence[Drive], residuals: Sequence[FloatArray]) -> list[SensorNoise]:
    """Return what noise the power may have, from standstill if possible, else from its spectrum."""
    own = [(d, r) for d, r in zip(drives, residuals, strict=True) if d.hold is None and len(r) > 4]
    residual = np.concatenate([r for _, r in own]) if own else np.zeros(0)
    white = float(np.median([speed_noise(d.power) for d, _ in own])) ** 2 if own else 0.0
    found = [SensorNoise(float(len(residual)), white)] if own else []
    rests = [
        r[d.rests] for d, r in zip(drives, residuals, strict=True)
        if np.count_nonzero(d.rests) >= _RESTING
    ]  # fmt: skip
    if rests:
        rest = np.concatenate([some - np.median(some) for some in rests])
        # A load that comes and goes at rest is no noise: what most samples scatter by is.
        spread = NORMAL_MAD * float(np.median(np.abs(rest)))
        stops = np.cumsum([len(part) for part in rests]).tolist()
        pieces = [slice(a, b) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
        usual = np.clip(rest, -_SIGMA * spread, _SIGMA * spread)
        repeats = repeats_of(usual, pieces)
        found.append(SensorNoise.of_repeats(float(len(rest)), spread**2, repeats))
        if spread**2 > _LIKE * white and len(rest) > _TELLING * repeats:
            return found
    if own:
        period = float(np.median([drive.clock.period for drive, _ in own]))
        spectral = SensorNoise.of(residual, period)
        return [*found, spectral] if spectral is not None else found
    if not found:  # between readings that are held the power really changes
        held = [speed_noise(d.power[d.hold.first]) for d in drives if d.hold is not None]
        white = float(np.median(held or [0.0])) ** 2
        found.append(SensorNoise(float(sum(map(len, residuals))), white))
    return found


def adequacy(drives: Sequence[Drive], residuals: Sequence[FloatArray]) -> Adequacy:
    """Compare what a model leaves of the drives that it was fitted to with their noise."""
    every = np.concatenate(residuals)
    size = float(np.sqrt(np.mean(np.concatenate([d.power for d in drives]) ** 2)))
    floor, known = (_FLOOR * size) ** 2, _noises(drives, residuals)
    rows = max([1.0, *(float(drive.hold.rows) for drive in drives if drive.hold)])
    slow = []
    for k in range(len(SCALES)):
        windows = [drive.windows[k] for drive in drives]
        means = np.concatenate([w.mean(r) for w, r in zip(windows, residuals, strict=True)])
        number = float(np.median(np.concatenate([w.counts for w in windows])))
        noise = max(known, key=lambda one: one.of_means(number))
        same = max(noise.variance, floor) * min(rows / number, 1.0)  # which rows of one reading are
        own = float(np.sqrt(max(noise.of_means(number), same)))
        repeats = max(noise.repeats, rows)
        independent = min(float(len(means)), len(every) / repeats)
        by_chance = float(fisher.isf(_CHANCE / len(SCALES), independent, noise.count / repeats))
        limit = float(np.hypot(own * np.sqrt(by_chance), np.sqrt(floor)))
        shown = float(np.sqrt(np.mean(means**2)))
        slow.append((shown / limit, own, shown, windows[0].length))
    beyond, slow_noise, slow_residual, time = max(slow, key=lambda one: one[0])
    missing = tuple(max(shown**2 - own**2, 0.0) for _, own, shown, _ in slow)
    left = float(np.mean(every**2))
    variance = min(max(one.variance for one in known), left)
    return Adequacy(
        float(np.sqrt(variance)), float(np.sqrt(left)), slow_noise, slow_residual,
        beyond > 1.0, time, missing, float(np.sqrt(floor)),
    )  # fmt: skip
