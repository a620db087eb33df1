"""What is known of a wheeled robot's friction before it drives (private)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from energyplan.fit.identifiability import COLLINEAR, gap
from energyplan.html import number, unit
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.vehicle import GRAVITY, Vehicle

USUAL = {"slip_friction": (0.6, 0.3), "traction_resistance": (0.1, 0.05)}
"""Mean and standard deviation: of mu, and of K over the robot's weight. They are those of the
presets: from ice to asphalt, from 17 to 470 kg."""

_UNTOLD = 1e3  # standard deviations of the usual, by which what drives do not tell is unknown


class UsualFriction(NamedTuple):
    """Mean and standard deviation of a coefficient over robots and grounds."""

    mean: float
    deviation: float


def usual_friction(term: Term, vehicle: Vehicle) -> UsualFriction:
    """Return what a coefficient of the paper usually is for a robot: mu, or K [N]."""
    scale = vehicle.mass * GRAVITY if term.name == "traction_resistance" else 1.0
    mean, deviation = USUAL[term.name]
    return UsualFriction(scale * mean, scale * deviation)


def with_usual(
    values: FloatArray, covariance: FloatArray, terms: Sequence[Term], gram: FloatArray,
    vehicle: Vehicle,
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:  # fmt: skip
    """Return coefficients and their covariance with what is usual, where drives tell less than it.

    A friction that no drive shows is not zero. Of two whose regressors are proportional, any share
    fits, and no block tells another one. Both are taken to be as of robots elsewhere, as far as
    drives leave that open; the other coefficients move with them.

    Parameters
    ----------
    values : ndarray, shape (k,)
        Fitted coefficients.
    covariance : ndarray, shape (k, k)
        Their covariance.
    terms : sequence of Term
        The k terms.
    gram : ndarray, shape (k, k)
        Products of their regressors in the drives.
    vehicle : Vehicle
        The robot.

    Returns
    -------
    tuple
        Both, combined with the usual values as with a measurement, and the names of the terms of
        which those were taken.
    """
    which = [k for k, term in enumerate(terms) if term.name in USUAL]
    known = [usual_friction(terms[k], vehicle) for k in which]
    mean, error = np.array(known).reshape(-1, 2).T
    values, covariance = np.array(values), np.array(covariance)
    size = np.sqrt(np.diagonal(gram)[which])
    for k, (place, shown) in enumerate(zip(which, size > 0.0, strict=True)):
        if not shown:
            covariance[place, place] += (_UNTOLD * error[k]) ** 2
    if len(which) == 2 and np.all(size > 0.0):
        least, along = gap(gram[np.ix_(which, which)] / np.outer(size, size))
        if least < COLLINEAR:
            along = along / size
            along *= _UNTOLD / np.max(np.abs(along) / error)
            covariance[np.ix_(which, which)] += np.outer(along, along)
    loose = np.diagonal(covariance)[which] > error**2
    taken = [place for place, one in zip(which, loose, strict=True) if one]
    if taken:
        total = covariance[np.ix_(taken, taken)] + np.diag(error[loose] ** 2)
        gain = np.linalg.solve(total, covariance[taken]).T
        values = values + gain @ (mean[loose] - values[taken])
        covariance = covariance - gain @ covariance[taken]
    names = tuple(terms[k].name for k in taken)
    return values, covariance, names


def open_in_words(model: PowerModel, names: Sequence[str]) -> list[str]:
    """Say which frictions drives leave open, and what they are taken to be.

    Parameters
    ----------
    model : PowerModel
        The model, with their usual values in it.
    names : sequence of str
        Names of their terms.

    Returns
    -------
    list of str
        One sentence for each.
    """
    return [
        f"these drives leave {term.name} open; as of robots elsewhere it is taken to be "
        f"{term.symbol} = {number(model.coefficient(term.name))} +- "
        f"{number(model.std_error(term.name) or 0.0, 2)} {unit(term.unit)}".rstrip()
        for term in model.terms if term.name in names
    ]  # fmt: skip


def ends_in_words(model: PowerModel) -> list[str]:
    """Say which coefficients are at an end of what is possible.

    Parameters
    ----------
    model : PowerModel
        The model.

    Returns
    -------
    list of str
        One sentence for each.
    """
    return [
        f"{term.name} ({term.symbol}) is at the end {value:g} of its possible range: "
        "nothing of it shows in these logs, a sign is wrong, or a term is missing"
        for term, value in zip(model.terms, model.coefficients, strict=True)
        if not term.bounds[0] < value < term.bounds[1]
    ]
