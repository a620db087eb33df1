"""Which effects drives can tell from friction at all, whatever their sizes are (private).

A robot that keeps its speeds draws one power, whatever it is made of. Regressors differ by the
noise of the speeds alone then. A fit of that noise has no friction and a constant load instead,
with next to no error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import terms_of
from energyplan.fit.problem import PAPER, Problem
from energyplan.fit.solvers import column_scale
from energyplan.fit.usual import usual_friction
from energyplan.path import FloatArray

_NOISE = 0.05
"""Singular value of regressors, each of unit size in means over two seconds, that the noise of
speeds makes: up to 0.042 where they are read in steps as large as a third of them. Drives of many
motions show 0.11 and more."""

_WEIGHT = 0.1
"""Weight of an effect in a combination of regressors that is noise: had it more, it would change by
more than a tenth of the power with how friction is shared between mu and K."""

_TURNING = np.array([1.0, -1.0])
"""Deviations of mu and K from the usual at which turning takes most of the power."""


def separable(problem: Problem, parts: Sequence[Part]) -> NDArray[np.bool_]:
    """Tell which effects drives tell from the paper's two terms."""
    usual = _friction(problem)
    means = [_means(problem, parts, usual[0] + by * usual[1]) for by in (0.0, _TURNING)]
    owner = np.repeat(np.arange(len(parts)), np.array([len(part.terms) for part in parts], int))
    told = np.bincount(owner, np.any([_tells(one) for one in means], axis=0), len(parts)) > 0
    acts = np.bincount(owner, means[0][:, len(PAPER) :].any(axis=0), len(parts)) > 0
    return np.asarray(told | ~acts)


def _tells(means: FloatArray) -> NDArray[np.bool_]:
    """Tell which regressors after the paper's are in no combination that is noise, nor zero."""
    table, count = means / column_scale(means), len(PAPER)
    gram = table.T @ table / len(table)
    tells = np.diagonal(gram)[count:] > 0.0
    for new in np.flatnonzero(tells):
        which = [*range(count), count + new]
        square, axes = np.linalg.eigh(gram[np.ix_(which, which)])
        tells[new] = np.linalg.norm(axes[-1, square < _NOISE**2]) < _WEIGHT
    return tells


def varies(problem: Problem) -> bool:
    """Tell whether the power of drives changes by more than noise: only then it can be late."""
    friction = _friction(problem)[0]
    power = _means(problem, (), friction) @ friction
    return bool(np.std(power) > _NOISE * np.sqrt(np.mean(power**2)))


def _friction(problem: Problem) -> FloatArray:
    """Coefficients of the paper's terms that are usual for the robot, and their deviations."""
    return np.array([usual_friction(term, problem.vehicle) for term in PAPER]).T


def _means(problem: Problem, parts: Sequence[Part], friction: FloatArray) -> FloatArray:
    """Return means over two seconds of the regressors, losses about a friction."""
    terms = terms_of(parts)
    values = np.append(friction, np.zeros(len(terms) - len(PAPER)))
    return problem.as_predicted.design_about(terms, values).rows[1][:, :-1]
