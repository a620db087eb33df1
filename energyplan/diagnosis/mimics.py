"""Effects that only stand in for what the catalogue does not have (private)."""

from __future__ import annotations

from collections.abc import Sequence

from energyplan.diagnosis.fitted_sets import WORTHWHILE
from energyplan.diagnosis.joint_fit import final_fit
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import terms_of
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.search import SIGNIFICANCE
from energyplan.fit.adequacy import adequacy, left_over
from energyplan.fit.least_squares import Fit, difference, fit
from energyplan.fit.problem import Problem
from energyplan.power.effects import Effect, empirical_term

_MOSTLY = 0.3
"""Share of the error from which on a channel is asked whether it makes effects unnecessary."""


def smooth_part(found: Dependence) -> Part:
    """Return the smooth term of a dependence as an effect."""
    term = empirical_term(f"empirical_{found.carrier}_{found.channel}", found.knots, found.values)
    return Part(Effect.of(term, planner="where it knows the channel"))


def without_mimics(problem: Problem, parts: tuple[Part, ...]) -> tuple[tuple[Part, ...], list[str]]:
    """Take out effects that only stand in for what the catalogue does not have.

    A smooth term of the channel that explains most without them is what they may stand in for.
    """
    usual = [part for part in parts if part.effect.usual or not part.terms]
    if not any(part.terms and not part.effect.usual for part in parts):
        return parts, []
    shapes = dependences(problem, terms_of(usual))
    best = next((one for one in shapes if one.knots), None)
    if best is None or best.explained_variance < _MOSTLY or best.p_value > SIGNIFICANCE:
        return parts, []
    smooth = smooth_part(best)
    others = [part for part in parts if part not in usual]
    errors = problem.reference(problem.design(terms_of(parts)))

    def loss(some: Sequence[Part]) -> Fit:
        return fit(problem.design(terms_of(some), errors), errors)

    gap, error = difference(loss(parts).losses, loss([*usual, smooth]).losses)
    model = final_fit(problem, parts).model
    adequate = adequacy(problem.drives, left_over(model, problem.drives)).adequate
    if gap <= (max(error, WORTHWHILE * len(errors)) if adequate else -error):
        return parts, []
    kept, gone = list(parts), list[str]()
    for part in [*others, *(part for part in usual if part.terms)]:
        rest = [other for other in kept if other is not part]
        gap, error = difference(loss([*rest, smooth]).losses, loss([*kept, smooth]).losses)
        if gap <= max(error, WORTHWHILE * len(errors)):
            kept = rest
            gone.append(part.effect.name)
    return tuple(kept), gone
