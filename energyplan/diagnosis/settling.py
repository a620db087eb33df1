"""Parameters that are searched on a grid, moved to where a model fits best (private)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from energyplan.diagnosis.change_points import crosses
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

    Parameters
    ----------
    part : Part
        The part, its parameters as a grid has them.
    made : callable
        From parameters to the parts and drives with them.
    errors : ndarray, shape (scales,)
        Reference mean square errors [W^2].

    Returns
    -------
    ndarray or None
        The parameters; None where those of the grid are as good.
    """
    trial, case = made(np.array([value for _, value in part.params]))
    terms = terms_of(trial)
    found_there = fit(case.design(terms, errors), errors).values.tolist()
    known = dict(zip((term.name for term in terms), found_there, strict=True))

    def fitted(values: FloatArray, rounds: int) -> float:
        trial, case = made(values)
        if part.effect.acts == "place":
            named = zip((key for key, _ in part.params), values.tolist(), strict=True)
            if not crosses(dict(named), case.drives, case.vehicle):
                return _NOWHERE
        return fit(case.design(terms_of(trial), errors, known, rounds), errors).loss

    def loss(values: FloatArray) -> float:
        return fitted(values, 1)

    start, span = np.array([value for _, value in part.params]), _span(part)
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
    return np.asarray(found.x) if better else None


def _is_delay(part: Part) -> bool:
    return part.effect.name == "time_offset"


def _span(part: Part) -> FloatArray:
    """First step of each searched parameter: a good part of the grid's."""
    if part.effect.acts == "place":
        return np.array([np.pi / 16, 0.3])
    if _is_delay(part):
        return np.array([0.03, 0.05])[: len(part.params)]
    return np.array([0.2 * abs(value) for _, value in part.params])
