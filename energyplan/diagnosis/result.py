"""What a diagnosis says (private; `energyplan.diagnosis` publishes it)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from energyplan import html
from energyplan.diagnosis.holdout import ErrorInterval
from energyplan.diagnosis.residual import Dependence
from energyplan.fit.adequacy import Adequacy
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual
from energyplan.records import ReadOnly

Verdict = Literal["effect_found", "no_effect", "unexplained"]


@dataclass(frozen=True)
class Evidence:
    """Why an effect was added."""

    improvement: float  # fall of the cross-validated mean square error, as a fraction
    improvement_std_error: float  # its standard error over blocks
    p_value: float


@dataclass(frozen=True)
class FoundEffect(ReadOnly):
    """An effect that was found."""

    name: str  # as in the catalogue
    symbol: str  # as in the catalogue
    value: float  # its size
    unit: str  # as in the catalogue
    std_error: float  # its size
    evidence: Evidence  # why it was added
    probability: float = 1.0  # that it is there, over all explanations
    rivals: tuple[str, ...] = ()  # effects that these drives cannot separate from it
    details: Mapping[str, float] = field(default_factory=dict)
    meaning: str = ""  # as in the catalogue
    planner: str = "yes"  # whether a planner can use it, or what it needs to

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))


@dataclass(frozen=True)
class Explanation:
    """A set of effects that may be the reason, as a whole."""

    effects: tuple[str, ...]  # their names, the one that explains most first
    probability: float  # that it is the right one
    model: PowerModel  # the model with these effects, fitted to the training drives
    alike: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class EnergyPrediction:
    """Energy of a drive that took no part."""

    drive: str  # name of the drive
    energy: float  # predicted energy [J]
    energy_interval: tuple[float, float]  # ends of its 90 % interval [J]
    measured: float  # measured energy [J]


@dataclass(frozen=True)
class Average:
    """What the model for runs to come is made of: an explanation, two terms, and extensions.

    Each counts by how it predicts energies of what it was not fitted to.
    """

    weight: float  # weight of the explanation, in [0, 1]
    left_out: str  # what was left out, one after the other
    explanation_error: float  # mean relative error of its energy by the explanation, or the average
    cautious_error: float  # that by two terms alone
    extensions: Mapping[str, float] = field(default_factory=dict)  # weights of two terms with more


@dataclass(frozen=True)
class Unexplained:
    """A channel that still explains part of the residual."""

    channel: str  # the channel or derived signal
    shape: str  # the dependence in words
    explained_variance: float
    p_value: float  # adjusted for the number of signals tried
    empirical: bool = False  # whether a smooth term of the channel was added to the model


@dataclass(frozen=True)
class Diagnosis(html.Readable):
    """The effects that explain the residual of the paper's model.

    Parameters
    ----------
    verdict : {"effect_found", "no_effect", "unexplained"}
        The answer in a word. ``no_effect``: the paper's model leaves no more than noise.
        ``unexplained``: it leaves more, and no entry of the catalogue helps, or behind what was
        found is more probably something else, or it does not hold on the hold-out drives.
    effects : tuple of FoundEffect
        Those of the most probable explanation: the one that explains most first, last what nearly
        every robot has.
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
        Effects that helped only as long as an unexplained channel was left out, and maps that
        probably stand in for something else.
    predictions_before, predictions_after : tuple of ndarray
        Predicted power of each hold-out drive [W].
    explanations : tuple of Explanation
        The sets of effects that these drives leave possible, the most probable one first.
    none_of_these : float
        Probability that none of them is right: that behind a name is something else, which the
        catalogue lacks. Zero where no more than noise is left, which depends on nothing.
    further_effects : float
        Probability that there are effects of the catalogue beside those of the first explanation,
        which are too small or too improbable to be named. It belongs to the probability of each
        effect, not to that of the explanation.
    adequacy : Adequacy
        What is left, against noise.
    predictions : tuple of EnergyPrediction
        Energy of each hold-out drive by the extended model.
    training, judging : tuple of str
        Names of the drives that were learned from, and of those that only judged.
    choosing : tuple of str
        What chose among explanations: parts of the training drives, each predicted from the others.
    set_aside : mapping of str to mapping of str to int
        For each drive, how many samples were left out or mended, by reason.
    after_undated : Residual or None
        Error of the extended model where the time of a change within a hold-out drive is not taken
        from that drive: the prediction in the narrow sense. None where there is no such time.
    average : Average or None
        What `model` averages, beside the explanation; None where it is the explanation alone.

    Examples
    --------
    >>> import energyplan as ep
    >>> from energyplan.power import HOTEL
    >>> truth = ep.PowerModel.preset("quadriga:empty:marble")
    >>> truth = truth.with_term(HOTEL, 40.0)
    >>> drives = [ep.simulate.identification_drive(truth, power_noise=5.0, seed=1)]
    >>> judged = [ep.simulate.validation_drive(truth, power_noise=5.0, seed=2)]
    >>> found = ep.diagnose(drives, holdout=judged, vehicle=truth.vehicle)
    >>> found.verdict, [effect.name for effect in found.effects]
    ('effect_found', ['hotel_load'])
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
    explanations: tuple[Explanation, ...]
    adequacy: Adequacy
    predictions: tuple[EnergyPrediction, ...]
    training: tuple[str, ...]
    judging: tuple[str, ...]
    choosing: tuple[str, ...]
    set_aside: Mapping[str, Mapping[str, int]]
    after_undated: Residual | None = None
    average: Average | None = None
    none_of_these: float = 0.0
    further_effects: float = 0.0

    def _summaries(self) -> list[html.Summary]:
        effects = html.Summary(
            f"verdict: {self.verdict.replace('_', ' ')}",
            ("effect", "symbol", "value", "standard error", "unit", "cannot be separated from"),
            [
                (e.name, e.symbol, e.value, e.std_error, e.unit, ", ".join(e.rivals) or "-")
                for e in self.effects
            ],
        )
        errors = html.Summary(
            "on the hold-out drives",
            ("model", "rmse [W]", "mae [W]", "bias [W]", "energy error [%]"),
            [
                (name, misfit.rmse, misfit.mae, misfit.bias, 100 * misfit.energy_error)
                for name, misfit in (("before", self.before), ("after", self.after))
            ],
            self.advice,
        )
        return [effects, errors]
