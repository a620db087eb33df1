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
    """Why an effect was added.

    Parameters
    ----------
    improvement : float
        Fall of the cross-validated mean square error, as a fraction; averaged over the errors of
        means of half a second, two and eight seconds.
    improvement_std_error : float
        Its standard error over blocks.
    p_value : float
        Probability of such coefficients by chance, times the number of candidates tried.

    Examples
    --------
    >>> evidence = Evidence(improvement=0.42, improvement_std_error=0.06, p_value=1e-8)
    >>> evidence.improvement > 3 * evidence.improvement_std_error
    True
    """

    improvement: float
    improvement_std_error: float
    p_value: float


@dataclass(frozen=True)
class FoundEffect(ReadOnly):
    """An effect that was found.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        As in the catalogue.
    value, std_error : float
        Its size.
    evidence : Evidence
        Why it was added.
    probability : float
        That it is there, over all explanations; the lower, the more may be missing that it may
        stand in for.
    rivals : tuple of str
        Effects that these drives cannot separate from it.
    details : mapping of str to float
        Further numbers, such as a time constant or a direction.
    planner : str
        Whether a planner can use it, or what it needs to.

    Examples
    --------
    >>> found = FoundEffect(
    ...     name="hotel_load", symbol="P_0", value=40.2, unit="W", std_error=0.6,
    ...     evidence=Evidence(0.42, 0.06, 1e-8), probability=0.98, rivals=(), details={},
    ...     meaning="a load that is always on", planner="counted",
    ... )
    >>> f"{found.name} = {found.value} +- {found.std_error} {found.unit}"
    'hotel_load = 40.2 +- 0.6 W'
    """

    name: str
    symbol: str
    value: float
    unit: str
    std_error: float
    evidence: Evidence
    probability: float = 1.0
    rivals: tuple[str, ...] = ()
    details: Mapping[str, float] = field(default_factory=dict)
    meaning: str = ""
    planner: str = "yes"

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))


@dataclass(frozen=True)
class Explanation:
    """A set of effects that may be the reason, as a whole.

    Parameters
    ----------
    effects : tuple of str
        Their names, the one that explains most first; none where the paper's model may do.
    probability : float
        That it is the right one. With `Diagnosis.none_of_these` and `Diagnosis.further_effects`
        they sum to one.
    model : PowerModel
        The model with these effects, fitted to the training drives.
    alike : tuple of tuple of str
        Effects of the explanations that the drives cannot separate from this one. Each, fitted to
        the predictions of the other, follows them so closely that odds of 20 to 1 are not to be
        expected. The most usual one is named first; their probabilities add up.

    Examples
    --------
    >>> from energyplan.power import HOTEL, PowerModel
    >>> model = PowerModel.preset("quadriga:full:marble").with_term(HOTEL, 40.0)
    >>> told = Explanation(("hotel_load",), probability=0.97, model=model)
    >>> told.model.coefficient("hotel_load")
    40.0
    """

    effects: tuple[str, ...]
    probability: float
    model: PowerModel
    alike: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class EnergyPrediction:
    """Energy of a drive that took no part.

    Parameters
    ----------
    drive : str
        Name of the drive.
    energy : float
        Predicted energy [J].
    energy_interval : tuple of float
        Ends of its 90 % interval: coefficients, noise, and by how much runs differ as a whole [J].
    measured : float
        Measured energy [J].

    Examples
    --------
    >>> told = EnergyPrediction("b.csv", 980.0, energy_interval=(930.0, 1030.0), measured=1010.0)
    >>> low, high = told.energy_interval
    >>> low <= told.measured <= high
    True
    """

    drive: str
    energy: float
    energy_interval: tuple[float, float]
    measured: float


@dataclass(frozen=True)
class Average:
    """What the model for runs to come is made of: an explanation and the paper's two terms.

    Each counts by how it predicts energies of what it was not fitted to.

    Parameters
    ----------
    weight : float
        Weight of the explanation, in [0, 1]; the rest is that of the paper's terms, fitted by least
        absolute errors.
    left_out : {"run", "kind of motion", "part of the ground"}
        What was left out, one after the other: whole runs, or with fewer than four of them kinds of
        motion, and parts of the ground where an effect has a place there, whichever the
        explanation foretells worst.
    explanation_error, cautious_error : float
        Mean size of the relative error of its energy, by each alone.

    Examples
    --------
    A drag that was seen in left turns alone is no guide to right turns:

    >>> told = Average(0.02, "kind of motion", explanation_error=0.19, cautious_error=0.09)
    >>> told.weight < 0.5
    True
    """

    weight: float
    left_out: str
    explanation_error: float
    cautious_error: float


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

    Examples
    --------
    >>> left = Unexplained("temperature", "falls with temperature", 0.12, 0.003, empirical=False)
    >>> f"{left.channel} explains {left.explained_variance:.0%} of what is left"
    'temperature explains 12% of what is left'
    """

    channel: str
    shape: str
    explained_variance: float
    p_value: float
    empirical: bool = False


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
