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
_UNLIKE = 9.0  # mean square of standard deviations from the usual, beyond which a robot is unlike
_WIDER = 1.5  # factor of the usual variance, in steps, for a robot which is unlike others


class UsualFriction(NamedTuple):
    """Mean and standard deviation of a coefficient over robots and grounds."""

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
    """Return coefficients and their covariance with what is usual, where drives tell less than it.

    A friction that no drive shows is not zero. Of two whose regressors are proportional, any share
    fits, and no block tells another one. Both are taken to be as of robots elsewhere, as far as
    drives leave that open; the other coefficients move with them. A robot that is unlike all of
    them, by what its drives tell, is allowed as much as it differs.
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
    """Say which frictions drives leave open, and what they are taken to be."""
    return [
        f"these drives leave {term.name} open; with what robots elsewhere have it is "
        f"{term.symbol} = {number(model.coefficient(term.name))} +- "
        f"{number(model.std_error(term.name) or 0.0, 2)} {unit(term.unit)}".rstrip()
        for term in model.terms if term.name in names
    ]  # fmt: skip


def ends_in_words(model: PowerModel) -> list[str]:
    """Say which coefficients are at an end of what is possible, or beyond what a robot weighs."""
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
