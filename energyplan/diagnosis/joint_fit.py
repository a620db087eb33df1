"""All parameters of an extended model fitted together, with their covariance (private)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.diagnosis.part import Part
from energyplan.diagnosis.result import Explanation
from energyplan.fit.drives.late import DELAYS, Late
from energyplan.fit.drives.linear import equations_of
from energyplan.fit.joint import joint_fit
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.power.effects import Effect

_STEP = 0.02  # relative step of a parameter's derivative
_MOMENT = 0.02  # step of a time offset [s]

_LOOKED_FOR = float(np.ptp(DELAYS) / np.sqrt(12.0))
"""Standard deviation of a delay anywhere among those looked for [s]: none is known less."""


@dataclass(frozen=True)
class FinalFit:
    """A fitted model."""

    model: PowerModel  # the model with its covariance
    errors: Mapping[str, float]
    run_spread: float | None = None  # relative standard deviation of the power between runs
    run_error: float | None = None
    assumed: tuple[str, ...] = ()  # terms of which the drives tell less than is known of any robot

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the model."""
        return self.model.terms


def final_fit(problem: Problem, parts: Sequence[Part]) -> FinalFit:
    """Fit the paper's terms and those of the parts together.

    The covariance is the jackknife's over blocks, by Student's distribution. Where a part has a
    parameter that was searched, such as a time constant, the derivative of its power by it joins
    the columns, so that the standard errors allow for the search.
    """
    terms = [*PAPER, *(term for part in parts for term in part.terms)]
    moved: dict[str, list[FloatArray]] = {}

    def further(values: Mapping[str, float]) -> Sequence[Sequence[FloatArray]]:
        moved.update(_derivatives(problem, parts, values))
        return list(moved.values())

    found = joint_fit(problem, terms, further)
    names = [*moved]
    variances = dict(zip(names, np.diag(found.further).tolist(), strict=True))
    late = [k for k, name in enumerate(names) if name in Late._fields]
    if late:
        between = _between_samples(problem, moved[names[late[0]]])
        variances["late"] = float(found.further[np.ix_(late, late)].sum()) + between
        variances["delay"] += between
    errors = {name: float(np.sqrt(max(value, 0.0))) for name, value in variances.items()}
    for name in errors.keys() & {"delay", "late"}:
        errors[name] = min(errors[name], _LOOKED_FOR)
    return FinalFit(found.model, errors, found.run_spread, assumed=found.assumed)


def _between_samples(problem: Problem, rise: Sequence[FloatArray]) -> float:
    """Return the variance of a delay that is due to what happens between samples [s^2].

    A change of the power happens at any time between two samples, and is taken for even over it.
    The delay is a mean over all changes, each of which counts by the square of its size.
    """
    square = fourth = 0.0
    for drive, power in zip(problem.drives, rise, strict=True):
        size = power[:, 0] ** 2
        square += float(size.sum())
        fourth += float(np.sum((np.gradient(drive.t) * size) ** 2))
    return fourth / max(12.0 * square**2, 1e-300)


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


def least_known(model: PowerModel, parts: Sequence[Part]) -> Part | None:
    """Return the effect whose size is known least, where the error exceeds the size.

    Where a parameter was searched, the size may be far from zero at the value that was found, and
    be anything at others, which fit as well: so it may be with a time constant, or a delay.
    """
    sized = [part for part in parts if part.terms]
    ratios = [
        size_error(part.effect, model) / max(abs(part.effect.value(model)), 1e-300)
        for part in sized
    ]
    if not ratios or max(ratios) <= 1.0:
        return None
    return sized[int(np.argmax(ratios))]


def size_spread(effect: Effect, size: float, explanations: Sequence[Explanation]) -> float:
    """Return by how much the size of an effect differs among explanations that have it.

    Which of them is right is not known either: of two efficiencies that powers cannot tell apart,
    one divides the sizes of all other effects (docs/theory, section 6).
    """
    some = [one for one in explanations if effect.name in one.effects]
    share = np.array([one.probability for one in some])
    if not effect.terms or effect.acts == "log" or not share.any():
        return 0.0
    apart = np.array([effect.value(one.model) - size for one in some])
    return float(np.sqrt(share @ apart**2 / share.sum()))
