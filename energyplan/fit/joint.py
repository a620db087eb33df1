"""All coefficients of a sum of terms, fitted together to window means of drives (private).

What `energyplan.diagnose` fits its models by, and `energyplan.identify` with the method
``windows``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from energyplan.fit.drives.design import window_means
from energyplan.fit.drives.readings import reading_covariance
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import Problem
from energyplan.fit.run_spread import RunSpread
from energyplan.fit.usual import with_usual
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term

Further = Callable[[Mapping[str, float]], Sequence[Sequence[FloatArray]]]
"""From coefficients by name to the derivatives of the power by further parameters, on each drive:
shape (n, equations) each."""


@dataclass(frozen=True)
class JointFit:
    """A sum of terms fitted to drives."""

    model: PowerModel  # the model with its covariance
    further: FloatArray  # covariance of further parameters, at whose values the terms were fitted
    run_spread: float | None  # relative standard deviation of the power between runs
    assumed: tuple[str, ...]  # terms of which drives tell less than is known of any robot


def joint_fit(problem: Problem, terms: Sequence[Term], further: Further | None = None) -> JointFit:
    """Fit terms together."""
    errors = problem.reference(problem.design(terms))
    design = problem.design(terms, errors)
    found, count = fit(design, errors), len(terms)
    covariance = found.reported
    usual = partial(
        with_usual, terms=terms, gram=design.grams.sum(axis=(0, 1))[:count, :count],
        vehicle=problem.vehicle,
    )  # fmt: skip
    values, _, assumed = usual(found.values, covariance)  # what was searched does not move with it
    values = _within(problem, terms, errors, values, assumed)
    names = [term.name for term in terms]
    moved = further(dict(zip(names, values.tolist(), strict=True))) if further else ()
    if moved:
        columns = [np.stack(column, axis=-1) for column in zip(*moved, strict=True)]
        design = design.joined(window_means(problem.drives, columns))
        covariance = fit(design, errors).reported
    covariance = covariance + reading_covariance(problem, terms, values, design, errors)
    covariance, rest = covariance[:count, :count], covariance[count:, count:]
    plain = problem.of_totals.with_factors([1.0] * len(problem.drives))
    spread = RunSpread.of(plain.design(terms), values)
    if spread is not None:
        # What all runs share is known no better than the mean of runs that differ.
        level = spread.deviation**2 / len(problem.drives)
        covariance = covariance + level * np.outer(values, values)
    if assumed:
        covariance = usual(values, covariance)[1]
    model = PowerModel(problem.vehicle, tuple(terms), values, 0.5 * (covariance + covariance.T))
    return JointFit(model, rest, None if spread is None else spread.deviation, assumed)


def _within(
    problem: Problem, terms: Sequence[Term], errors: FloatArray, values: FloatArray,
    assumed: Sequence[str],
) -> FloatArray:  # fmt: skip
    """Put coefficients that are beyond an end of their range there, and fit the others again.

    Those that are assumed stay as they are.
    """
    least, most = np.array([term.bounds for term in terms]).T
    fixed = np.array([term.name in assumed for term in terms])
    while np.any(beyond := (values < least) | (values > most)):
        fixed |= beyond
        values = np.clip(values, least, most)
        if not np.all(fixed):
            about = problem.design_about(terms, values)
            values[~fixed] = fit(about.fixed(fixed, values), errors).values
    return values
