"""A set of effects as a model, and what that leaves of the training drives (private)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from energyplan.diagnosis.explanations import Found
from energyplan.diagnosis.joint_fit import FinalFit, final_fit
from energyplan.diagnosis.mimics import smooth_part
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import terms_of
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.search import SIGNIFICANCE
from energyplan.diagnosis.stand_ins import Presence, presence
from energyplan.diagnosis.wheel_fight import WheelFight, find_wheel_fight
from energyplan.fit.adequacy import Adequacy, adequacy, left_over
from energyplan.power import PowerModel

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
