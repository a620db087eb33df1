"""All parameters of an extended model fitted together, with their covariance (private)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.diagnosis.part import Part
from energyplan.fit.drives.late import Late
from energyplan.fit.drives.linear import equations_of
from energyplan.fit.drives.windows import Design, window_means
from energyplan.fit.least_squares import PAPER, Fit, Problem, RunSpread, fit
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.power.effects import Effect

_STEP = 0.02  # relative step of a parameter's derivative
_MOMENT = 0.02  # step of a time offset [s]


@dataclass(frozen=True)
class FinalFit:
    """A fitted model.

    Parameters
    ----------
    model : PowerModel
        The model with its covariance.
    errors : mapping of str to float
        Standard errors of the parameters in which the terms are not linear, by name.
    run_spread : float, optional
        Relative standard deviation of the power between runs; None where there were too few.
    """

    model: PowerModel
    errors: Mapping[str, float]
    run_spread: float | None = None

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the model."""
        return self.model.terms


def final_fit(problem: Problem, parts: Sequence[Part]) -> FinalFit:
    """Fit the paper's terms and those of the parts together.

    The covariance is the jackknife's over blocks, by Student's distribution. Where a part has a
    parameter that was searched, such as a time constant, the derivative of its power by it joins
    the columns, so that the standard errors allow for the search.

    Parameters
    ----------
    problem : Problem
        The drives.
    parts : sequence of Part
        The effects.

    Returns
    -------
    FinalFit
        The model with its covariance.
    """
    terms = [*PAPER, *(term for part in parts for term in part.terms)]
    errors = problem.reference(problem.design(terms))
    design = problem.design(terms, errors)
    found = _within(problem, terms, design, errors)
    covariance, searched = found.reported, {}
    moved = _derivatives(
        problem, parts, dict(zip((t.name for t in terms), found.values, strict=True))
    )
    if moved:
        columns = [np.stack(column, axis=-1) for column in zip(*moved.values(), strict=True)]
        wide = fit(design.joined(window_means(problem.drives, columns)), errors)
        count = len(terms)
        covariance = wide.reported[:count, :count]
        deviation = np.sqrt(np.diag(wide.reported)[count:])
        searched = dict(zip(moved, (float(d) for d in deviation), strict=True))
        late = [count + k for k, key in enumerate(moved) if key in Late._fields]
        if late:
            block = wide.reported[np.ix_(late, late)]
            searched["late"] = float(np.sqrt(max(float(block.sum()), 0.0)))
    plain = problem.of_totals.with_factors([1.0] * len(problem.drives))
    spread = RunSpread.of(plain.design(terms), found.values)
    if spread is not None:
        # What all runs share is known no better than the mean of runs that differ.
        level = spread.deviation**2 / len(problem.drives)
        covariance = covariance + level * np.outer(found.values, found.values)
    model = PowerModel(
        problem.vehicle, tuple(terms), found.values, 0.5 * (covariance + covariance.T)
    )
    return FinalFit(model, searched, None if spread is None else spread.deviation)


def _within(problem: Problem, terms: Sequence[Term], design: Design, errors: FloatArray) -> Fit:
    """Fit coefficients none of which is beyond its upper end; one that would be stands there.

    The covariance is that of the fit without ends.
    """
    found = fit(design, errors)
    most = np.array([term.bounds[1] for term in terms])
    values = np.array(found.values)
    ends = values > most
    while np.any(values[ends] > most[ends]):
        values[ends] = most[ends]
        about = Design.of(problem.drives, *problem.tables(terms, values))
        values[~ends] = fit(about.fixed(ends, most), errors).values
        ends |= values > most
    return replace(found, values=values)


def _derivatives(
    problem: Problem, parts: Sequence[Part], values: Mapping[str, float]
) -> dict[str, list[FloatArray]]:
    """Differentiate the power by each searched parameter, on each drive."""
    found = {}
    for part in parts:
        if part.effect.name == "time_offset":
            terms = [*PAPER, *(term for other in parts for term in other.terms)]
            whole = PowerModel(
                problem.vehicle, tuple(terms), np.array([values[term.name] for term in terms])
            )
            late = Late.of(part.params)
            for key, _ in late.params:
                ahead, behind = (
                    problem.delayed(late._replace(**{key: getattr(late, key) + step}))
                    for step in (_MOMENT, -_MOMENT)
                )
                found[key] = [
                    (equations_of(whole, a) - equations_of(whole, b)) / (2 * _MOMENT)
                    for a, b in zip(ahead.drives, behind.drives, strict=True)
                ]
        for key, value in part.params:
            if key not in part.effect.grid or not part.terms:
                continue
            step = _STEP * abs(value)
            ends = []
            for x in (value + step, value - step):
                moved = replace(
                    part, params=tuple((k, x if k == key else v) for k, v in part.params)
                )
                coefficients = np.array([values[term.name] for term in moved.terms])
                model = PowerModel(problem.vehicle, moved.terms, coefficients)
                ends.append([equations_of(model, drive) for drive in problem.drives])
            found[key] = [(a - b) / (2 * step) for a, b in zip(*ends, strict=True)]
    return found


def size_error(effect: Effect, model: PowerModel) -> float:
    """Return the standard error of an effect's size, from the covariance of the coefficients."""
    if model.covariance is None:
        return 0.0
    values = np.array(model.coefficients)
    gradient = np.zeros(len(values))
    for k, value in enumerate(values):
        step = 1e-5 * max(abs(float(value)), 1e-6)
        ends = []
        for x in (value + step, value - step):
            moved = values.copy()
            moved[k] = x
            ends.append(effect.value(replace(model, coefficients=moved)))
        gradient[k] = (ends[0] - ends[1]) / (2 * step)
    return float(np.sqrt(max(float(gradient @ model.covariance @ gradient), 0.0)))
