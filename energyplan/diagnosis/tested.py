"""A set of effects as a model, and what that leaves of the training drives (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from energyplan.diagnosis.explanations import Found
from energyplan.diagnosis.fitted_sets import WORTHWHILE
from energyplan.diagnosis.joint_fit import FinalFit, final_fit
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import terms_of
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.search import SIGNIFICANCE
from energyplan.diagnosis.stand_ins import Presence, presence
from energyplan.diagnosis.wheel_fight import WheelFight, find_wheel_fight
from energyplan.fit.adequacy import Adequacy, adequacy, left_over
from energyplan.fit.least_squares import Fit, difference, fit
from energyplan.fit.problem import Problem
from energyplan.power import PowerModel
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


_TELLING = 0.1
"""Share of the error that a channel must explain to be called a reason."""

_DOUBTED = 0.5
"""Chance that an effect is there, below which a map of it is worth nothing elsewhere."""


@dataclass(frozen=True)
class Tested:
    """A set of effects as a model, and what that leaves."""

    effects: tuple[Part, ...]  # the effects
    added: Part | None  # A smooth term that the model has beside them
    fitted: FinalFit  # the model
    fight: WheelFight | None
    quality: Adequacy  # what the model leaves, against noise
    dependences: tuple[Dependence, ...]  # how what the effects leave depends on every signal
    left: list[Dependence]  # those that are reasons
    present: Presence  # chances that the effects are there

    @property
    def parts(self) -> tuple[Part, ...]:
        """All that the model has beside the paper's terms."""
        return self.effects if self.added is None else (*self.effects, self.added)

    @property
    def first(self) -> Dependence | None:
        """The reason that explains most; what differs from drive to drive hides no other one."""
        return _first(self.left)

    @property
    def doubtful(self) -> bool:
        """Whether effects may only stand in for a smooth dependence.

        What was looked for at any time or place fits anything. What has a constant that was looked
        for, such as a time constant, fits much: it is doubted where the rest still depends on a
        channel. Other effects of the motion foretell other drives, whatever is behind them.
        """
        kinds = {part.effect.acts for part in self.effects}
        searched = any(p.terms and p.effect.grid and not p.effect.usual for p in self.effects)
        rest = self.first is not None and bool(self.first.knots)
        return bool(kinds & {"change", "place"}) or (searched and rest)

    @property
    def maps(self) -> tuple[Part, ...]:
        """Effects of a place that probably stand in for something else.

        What they follow on the ways of these drives, they do not follow on others.
        """
        return tuple(
            part for part in self.effects
            if part.effect.acts == "place" and self.present.of(part.effect.name) < _DOUBTED
        )  # fmt: skip


def _first(left: list[Dependence]) -> Dependence | None:
    return next((one for one in left if one.channel != "drive"), None)


def tested(
    searched: Found,
    parts: tuple[Part, ...],
    *,
    plain: PowerModel | None,
    fights: bool,
    otherwise: bool,
    smooth: Callable[[Part], bool],
) -> Tested:
    """Fit effects of the best explanation and test what they leave."""
    problem = searched.best.problem
    told = dependences(problem, terms_of(parts))
    left = [
        one for one in told
        if one.p_value < SIGNIFICANCE and one.explained_variance > max(_TELLING, 2 * one.std_error)
    ]  # fmt: skip
    first = _first(left)
    added = smooth_part(first) if first is not None and first.knots else None
    if added is not None and not smooth(added):
        added = None
    fitted = final_fit(problem, parts if added is None else (*parts, added))
    if not parts and added is None and plain is not None:
        fitted = replace(fitted, model=plain, assumed=())
    fight = find_wheel_fight(problem, fitted.model) if fights else None
    if fight is not None:
        fitted = replace(fitted, model=fight.model)
    quality = adequacy(problem.drives, left_over(fitted.model, problem.drives))
    present = presence(searched, parts, quality, left, otherwise or fight is not None)
    return Tested(parts, added, fitted, fight, quality, told, left, present)
