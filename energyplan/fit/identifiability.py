"""What logs tell about a model's coefficients: linearisation and identifiability (private)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from energyplan.errors import MissingChannelError, NotIdentifiableError
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Sides, Term
from energyplan.vehicle import GRAVITY, TreadICR

_NO_DATA = 0.01
"""A regressor below this fraction of its size in common manoeuvres counts as zero."""

_COLLINEAR = 0.02
_NEARLY_COLLINEAR = 0.1
"""Smallest singular value of the regressors, each of unit size: below, they are one another's
combination but for what the noise of the speeds adds."""

_CLEAR = 4.0
"""Standard deviations of its noise beyond which a speed is no noise."""


# -- linearisation ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linearisation:
    """Predicted power and its derivatives by the coefficients.

    Parameters
    ----------
    power : ndarray, shape (n,)
        Predicted power [W].
    jacobian : ndarray, shape (n, p)
        Its derivative by each coefficient [W per unit].
    """

    power: FloatArray
    jacobian: FloatArray


def is_linear(model: PowerModel) -> bool:
    """Tell whether the power is linear in the coefficients: no loss depends on the forces."""
    return all(term.kind != "loss" for term in model.terms)


def linearise(model: PowerModel, motion: Motion, battery: bool = False) -> Linearisation:
    """Linearise a model's power about its coefficients.

    Parameters
    ----------
    model : PowerModel
        The model.
    motion : Motion, shape (n,)
        The motion.
    battery : bool
        Linearise what the battery delivers: the vehicle's known efficiencies are in the power but
        are no coefficients.

    Returns
    -------
    Linearisation
        Power and derivatives, one column for each term of `model`.
    """
    count = len(model.terms)
    whole = model.battery_side() if battery else model
    columns = [c.total if isinstance(c, Sides) else c for c in whole.regressors(motion)]
    design = np.column_stack([np.broadcast_to(c, motion.shape) for c in columns])
    power = design @ whole.coefficients
    jacobian = design[:, :count]
    if not is_linear(whole):
        # A force changes the losses too. Central differences are exact where those are linear or
        # quadratic in the forces.
        for k, term in enumerate(model.terms):
            if term.kind == "force":
                value = float(whole.coefficients[k])
                step = 1e-4 * max(abs(value), 1e-2)
                ahead, behind = (_moved(whole, k, value + h).power(motion) for h in (step, -step))
                jacobian[:, k] = (ahead - behind) / (2 * step)
    return Linearisation(power, np.ascontiguousarray(jacobian))


def _moved(model: PowerModel, k: int, value: float) -> PowerModel:
    coefficients = np.array(model.coefficients)
    coefficients[k] = value
    return model.with_coefficients(coefficients)


# -- what is signal in a log --------------------------------------------------------------------


def _noise(speed: FloatArray) -> float:
    """Return a speed's sample-to-sample noise, from its second differences [m/s]."""
    moving = speed[speed != 0]
    if len(moving) < 5:
        return 0.0
    second = np.abs(moving[2:] - 2 * moving[1:-1] + moving[:-2])
    return float(1.4826 * np.median(second) / np.sqrt(6))


@dataclass(frozen=True)
class _Signal:
    """Tread speeds averaged over a second, and zero where they may be noise."""

    left: FloatArray
    right: FloatArray


def _signal(log: DriveLog) -> _Signal:
    """Average the speeds; a speed, or difference of speeds, within four deviations of 0 is 0."""
    v_left, v_right = log.channel("v_left"), log.channel("v_right")
    window = max(1, min(round(1.0 / float(np.median(np.diff(log.t)))), len(log) // 2))
    left, right = np.empty_like(v_left), np.empty_like(v_right)
    for run in log.runs:
        left[run] = uniform_filter1d(v_left[run], window, mode="nearest")
        right[run] = uniform_filter1d(v_right[run], window, mode="nearest")
    level = _CLEAR * np.hypot(_noise(v_left), _noise(v_right)) / np.sqrt(window)
    mean, straight = 0.5 * (left + right), np.abs(right - left) < level
    left, right = (np.where(straight, mean, v) for v in (left, right))
    left, right = (np.where(np.abs(v) < level, 0.0, v) for v in (left, right))
    return _Signal(left, right)


def settled_motion(log: DriveLog, icr: TreadICR) -> Motion:
    """Return a log's motion, straight and at rest where it was but for noise of the speeds.

    Forces change sign with the speeds. Noise that makes them flip would make losses appear that
    were never there, and friction at rest.

    Parameters
    ----------
    log : DriveLog
        The log.
    icr : TreadICR
        Tread ICRs.

    Returns
    -------
    Motion
        The motion: measured speeds but for those stretches.
    """
    motion, signal = log.motion(icr), _signal(log)
    mean = 0.5 * (motion.v_left + motion.v_right)
    straight = signal.left == signal.right
    left = np.where(straight, mean, motion.v_left)
    right = np.where(straight, mean, motion.v_right)
    left = np.where(signal.left == 0.0, 0.0, left)
    right = np.where(signal.right == 0.0, 0.0, right)
    return Motion(left, right, icr, motion.channels)


def signal_motion(log: DriveLog, icr: TreadICR, turning: bool = True) -> Motion:
    """Return a log's motion without what may be noise of its speeds.

    Regressors of this motion show what the manoeuvres tell; those of the measured one are never
    quite zero and never quite proportional.

    Parameters
    ----------
    log : DriveLog
        The log.
    icr : TreadICR
        Tread ICRs.
    turning : bool
        False for a robot whose yaw shows that it did not turn, whatever the treads did.

    Returns
    -------
    Motion
        Speeds averaged over a second, zero where they may be noise, and their accelerations.
    """
    signal = _signal(log)
    left, right = signal.left, signal.right
    if not turning:
        left = right = 0.5 * (left + right)
    clean = Motion(left, right, icr, log.motion(icr).channels)
    return clean.with_channels(
        accel=np.gradient(clean.v, log.t), yaw_accel=np.gradient(clean.omega, log.t)
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
        "a spin on the spot": motion(-speeds, speeds),
        "straight lines at several constant speeds": motion(speeds, speeds),
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
        return linearise(model, motion).jacobian
    except MissingChannelError:
        return None


def _named(terms: list[Term]) -> str:
    return " and ".join(f"{term.name} ({term.symbol})" for term in terms)


def _gap(scaled: FloatArray) -> tuple[float, FloatArray]:
    """Smallest singular value of scaled regressors, and its direction."""
    value, vector = np.linalg.eigh(scaled.T @ scaled)
    return float(np.sqrt(max(value[0], 0.0))), np.asarray(vector[:, 0])


def _best(values: dict[str, float]) -> str:
    """Name with the largest value; the first of those within a percent of it."""
    most = max(values.values())
    return next(name for name, value in values.items() if value >= 0.99 * most)


def check_identifiable(model: PowerModel, jacobian: FloatArray) -> tuple[str, ...]:
    """Refuse data that cannot tell the coefficients.

    Parameters
    ----------
    model : PowerModel
        The model.
    jacobian : ndarray, shape (n, p)
        Its regressors on cleaned motion (`signal_motion`).

    Returns
    -------
    tuple of str
        Warnings about coefficients that the data can hardly tell apart.

    Raises
    ------
    NotIdentifiableError
        If a regressor is zero throughout, or regressors are collinear; the message names the terms
        and the manoeuvre that would tell.
    """
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
            raise NotIdentifiableError(
                f"{_named([term])} cannot be identified: what it multiplies is zero throughout "
                f"these logs; add {remedy}, or leave the term out"
            )
    scaled = jacobian / (size * np.sqrt(len(jacobian)))
    gap, direction = _gap(scaled)
    if len(model.terms) < 2 or gap >= _NEARLY_COLLINEAR:
        return ()
    weight = np.abs(direction)
    chosen = [term for term, w in zip(model.terms, weight, strict=True) if w > 0.2 * weight.max()]
    gains = {
        name: _gap(np.vstack([scaled, c / (size * np.sqrt(len(c)))]))[0]
        for name, c in tests.items()
    }
    remedy = _best(gains) if gains else "drives in which they vary apart"
    if gap < _COLLINEAR and gains and gains[remedy] < 2 * gap:
        raise NotIdentifiableError(
            f"{_named(chosen)} cannot be separated, and no common manoeuvre would separate them: "
            "leave one of the terms out, or measure it by other means"
        )
    if gap < _COLLINEAR:
        raise NotIdentifiableError(
            f"{_named(chosen)} cannot be separated: what they multiply is proportional throughout "
            f"these logs; add {remedy}, or leave one of the terms out"
        )
    return (
        f"{_named(chosen)} can hardly be separated by these logs (what they multiply differs by "
        f"{100 * gap:.0f} %); {remedy} would separate them",
    )
