"""What a diagnosis says (private; `energyplan.diagnosis` publishes it)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from energyplan import html
from energyplan.diagnosis.holdout import ErrorInterval
from energyplan.diagnosis.residual import Dependence
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual

Verdict = Literal["effect_found", "no_effect", "unexplained"]


@dataclass(frozen=True)
class Evidence:
    """Why an effect was added.

    Parameters
    ----------
    improvement : float
        Fall of the cross-validated mean square error, as a fraction, mean over means of half a
        second, two and eight seconds.
    improvement_std_error : float
        Its standard error over blocks.
    p_value : float
        Probability of such coefficients by chance, times the number of candidates tried.
    """

    improvement: float
    improvement_std_error: float
    p_value: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was found.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        As in the catalogue.
    value, std_error : float
        Its size.
    evidence : Evidence
        Why it was added.
    rivals : tuple of str
        Effects that these drives cannot tell from it.
    details : mapping of str to float
        Further numbers, such as a time constant or a direction.
    planner : str
        Whether a planner can use it, or what it needs to.
    """

    name: str
    symbol: str
    value: float
    unit: str
    std_error: float
    evidence: Evidence
    rivals: tuple[str, ...] = ()
    details: Mapping[str, float] = field(default_factory=dict)
    meaning: str = ""
    planner: str = "yes"

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))

    def __getstate__(self) -> dict[str, object]:
        return {**vars(self), "details": dict(self.details)}


@dataclass(frozen=True)
class Unexplained:
    """A channel that still explains part of the residual.

    Parameters
    ----------
    channel : str
        The channel or derived signal.
    shape : str
        The dependence in words.
    explained_variance : float
        Share of the cross-validated error of the extended model that it explains.
    p_value : float
        Adjusted for the number of signals tried.
    empirical : bool
        Whether a smooth term of the channel was added to the model.
    """

    channel: str
    shape: str
    explained_variance: float
    p_value: float
    empirical: bool = False


@dataclass(frozen=True)
class Diagnosis:
    """What was found.

    Parameters
    ----------
    verdict : {"effect_found", "no_effect", "unexplained"}
        The answer in a word. ``unexplained``: no entry of the catalogue helps, and a channel still
        explains part of the residual.
    effects : tuple of FoundEffect
        In the order in which they were added.
    model : PowerModel
        The extended model with covariance and hold-out residual, for planners as it is: a change
        counts as having happened, a cold drive as warm, and what belongs to the log is left out.
    before, after : Residual
        Error of the paper's model and of the extended one, both on the hold-out drives.
    before_interval, after_interval : ErrorInterval
        Their 95 % intervals.
    unexplained : tuple of Unexplained
        What no entry of the catalogue explains, the largest share first.
    advice : tuple of str
        What to drive, weigh or mend next.
    paper : PowerModel
        The paper's model, fitted alike.
    dependences_before, dependences_after : tuple of Dependence
        How the residual on the training drives depends on every signal, before and after.
    withdrawn : tuple of str
        Effects that helped on the training drives but not on the hold-out, and were taken back.
    predictions_before, predictions_after : tuple of ndarray
        Predicted power of each hold-out drive [W].
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    model: PowerModel
    before: Residual
    after: Residual
    before_interval: ErrorInterval
    after_interval: ErrorInterval
    unexplained: tuple[Unexplained, ...]
    advice: tuple[str, ...]
    paper: PowerModel
    dependences_before: tuple[Dependence, ...]
    dependences_after: tuple[Dependence, ...]
    withdrawn: tuple[str, ...]
    predictions_before: tuple[FloatArray, ...]
    predictions_after: tuple[FloatArray, ...]

    def _repr_html_(self) -> str:
        """Return the effects and both errors as tables, for notebooks."""
        effects = html.result(
            f"verdict: {self.verdict.replace('_', ' ')}",
            ("effect", "symbol", "value", "standard error", "unit", "cannot be told from"),
            [
                (e.name, e.symbol, e.value, e.std_error, e.unit, ", ".join(e.rivals) or "-")
                for e in self.effects
            ],
        )
        errors = html.result(
            "on the hold-out drives",
            ("model", "rmse [W]", "mae [W]", "bias [W]", "energy error [%]"),
            [
                (name, misfit.rmse, misfit.mae, misfit.bias, 100 * misfit.energy_error)
                for name, misfit in (("before", self.before), ("after", self.after))
            ],
            self.advice,
        )
        return effects + errors
