"""What logs tell about a model's coefficients: linearisation and identifiability (private)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from energyplan.errors import MissingChannelError, NotIdentifiableError
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.linear import Linear, linearise_drive
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.vehicle import GRAVITY, TreadICR

_NO_DATA = 0.01
"""A regressor below this fraction of its size in common manoeuvres counts as zero."""

COLLINEAR = 0.02
"""Smallest singular value of the regressors, each of unit size: below, they are one another's
combination but for what the noise of the speeds adds."""

_NEARLY_COLLINEAR = 0.1
"""Smallest singular value below which it is told that regressors hardly differ."""


_SPIN = "a spin on the spot"
_STRAIGHT = "straight lines at several constant speeds"


def is_linear(model: PowerModel) -> bool:
    """Tell whether the power is linear in the coefficients: no loss depends on the forces."""
    return all(term.kind != "loss" for term in model.terms)


def linearise(model: PowerModel, motion: Motion, battery: bool = False) -> Linear:
    """Linearise a model's total power about its coefficients, instant by instant."""
    drive = Drive.at(replace(motion, icr=model.vehicle.icr), battery)
    return linearise_drive(drive, model.vehicle, model.terms, model.coefficients)


def signal_motion(drive: Drive, turning: bool = True) -> Motion:
    """Return a drive's motion averaged over a second: what its manoeuvres tell.

    Regressors of the motion itself are never quite proportional, for the noise of its speeds.
    """
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
    """Refuse data that cannot tell the coefficients."""
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
