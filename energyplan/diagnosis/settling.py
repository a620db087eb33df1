"""Parameters that are searched on a grid, moved to where a model fits best (private)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from energyplan.diagnosis.ground import Ground
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import terms_of
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import ROUNDS, Problem
from energyplan.path import FloatArray

_NOWHERE = 1e9  # loss of a line that was not crossed: finite, since a simplex takes differences

Make = Callable[[FloatArray], tuple[list[Part], Problem]]
"""From a part's parameters to the parts and drives with them."""


def settled(part: Part, made: Make, errors: FloatArray) -> FloatArray | None:
    """Move the parameters of a part to where the loss is least.

    While they move, losses are linear about the coefficients found where they start; the outcome is
    taken where the fit with losses as they are finds it better, too.
    """
    start = part.values
    trial, case = made(start)
    ground = Ground(case.drives, case.vehicle) if part.effect.acts == "place" else None
    terms = terms_of(trial)
    found_there = fit(case.design(terms, errors), errors).values.tolist()
    known = dict(zip((term.name for term in terms), found_there, strict=True))
    if ground is not None:
        start = ground.from_middle(start)

    def fitted(values: FloatArray, rounds: int) -> float:
        if ground is not None:
            values = ground.from_origin(values)
            if not ground.crosses(values):
                return _NOWHERE
        trial, case = made(values)
        return fit(case.design(terms_of(trial), errors, known, rounds), errors).loss

    def loss(values: FloatArray) -> float:
        return fitted(values, 1)

    span = _span(part) if ground is None else ground.first_step
    inside = (
        [(0.3 * x, 3.0 * x) for x in start]
        if part.effect.grid and not _is_delay(part)
        else [(x - 2 * s, x + 2 * s) for x, s in zip(start, span, strict=True)]
    )
    found = minimize(
        loss,
        start,
        method="Nelder-Mead",
        bounds=inside,
        options={
            "initial_simplex": start + np.vstack([np.zeros(len(start)), np.diag(span)]),
            "maxfev": 30 * len(start),
            "xatol": 1e-3,
            "fatol": 1e-4,
        },
    )
    better = found.fun < loss(start) and fitted(found.x, ROUNDS) < fitted(start, ROUNDS)
    if not better:
        return None
    return np.asarray(found.x) if ground is None else ground.from_origin(found.x)


def _is_delay(part: Part) -> bool:
    return part.effect.name == "time_offset"


def _span(part: Part) -> FloatArray:
    """First step of each searched parameter: a good part of the grid's."""
    if _is_delay(part):
        return np.array([0.03, 0.05])[: len(part.params)]
    return np.asarray(0.2 * np.abs(part.values))
