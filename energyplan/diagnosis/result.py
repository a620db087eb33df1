"""What a diagnosis says, and what to do next in sentences (private)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from types import MappingProxyType
from typing import Literal

from energyplan import html
from energyplan.diagnosis.residual import Dependence
from energyplan.fit.doubts import Adequacy
from energyplan.fit.run import LEVEL, RunEffect
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual
from energyplan.power.effects import Effect
from energyplan.records import ReadOnly

# -- what a diagnosis says (private; `energyplan.diagnosis` publishes it) --------------------------

Verdict = Literal["effect_found", "no_effect", "unexplained"]
Option = Literal["border", "change"]


@dataclass(frozen=True)
class ErrorInterval:
    """95 % intervals of an error on the hold-out drives, from resampled blocks."""

    rmse: tuple[float, float]  # lower and upper end of the root mean square error [W]
    mae: tuple[float, float]  # lower and upper end of the mean absolute error [W]
    bias: tuple[float, float]  # lower and upper end of the mean error [W]
    energy_error: tuple[float, float]  # lower and upper end of the relative error of the energy [1]


@dataclass(frozen=True)
class Evidence:
    """Why an effect was added."""

    improvement: float  # fall of the cross-validated mean square error, as a fraction
    improvement_std_error: float  # its standard error over blocks
    p_value: float


@dataclass(frozen=True)
class FoundEffect(ReadOnly):
    """An effect that was found."""

    name: str  # name in the catalogue
    symbol: str  # symbol in the catalogue
    value: float  # its size
    unit: str  # unit of the value, as in the catalogue
    std_error: float  # standard error of the value, in its unit
    evidence: Evidence  # why it was added
    probability: float = 1.0  # that it is there, over all explanations; see `Explanation`
    rivals: tuple[str, ...] = ()  # effects that these drives cannot separate from it
    details: Mapping[str, float] = field(default_factory=dict)
    meaning: str = ""  # what the catalogue says it is
    planner: str = "yes"  # whether a planner can use it, or what it needs to

    def __post_init__(self) -> None:
        object.__setattr__(self, "details", MappingProxyType(dict(self.details)))


BEST_KNOWN = "best of those known"
"""What is shown in place of a probability that nothing supports."""


@dataclass(frozen=True)
class Explanation:
    """A set of effects that may be the reason, as a whole."""

    effects: tuple[str, ...]  # their names, the one that explains most first
    probability: float  # that it is the right one, of those that the catalogue has
    model: PowerModel  # the model with these effects, fitted to the training drives


@dataclass(frozen=True)
class EnergyPrediction:
    """Energy of a drive that took no part."""

    drive: str  # name of the drive
    energy: float  # predicted energy [J]
    energy_interval: tuple[float, float]  # ends of its 90 % interval [J]
    measured: float  # measured energy [J]


@dataclass(frozen=True)
class Average:
    """Contents of the model for future runs: an explanation, two terms, and extensions."""

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
    predictions_before, predictions_after : tuple of ndarray
        Predicted power of each hold-out drive [W].
    explanations : tuple of Explanation
        The sets of effects that these drives leave possible, the most probable one first.
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
    holds : bool
        Whether the extended model errs on the hold-out drives about as on the training drives, each
        run's own factor taken out.
    explains : bool
        Whether it leaves no more than noise on the training drives, or its effects, other than
        those that nearly every robot has, lower the error on the hold-out drives enough.
    after_undated : Residual or None
        Error of the extended model where the time of a change within a hold-out drive is not taken
        from that drive: the prediction in the narrow sense. None where there is no such time.
    average : Average or None
        What `model` averages, besides the explanation; None where it is the explanation alone.
    suspects : tuple of str
        Options of `diagnose` that were not given, and look for what the residual looks like:
        ``"border"``, ``"change"``.

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
    predictions_before: tuple[FloatArray, ...]
    predictions_after: tuple[FloatArray, ...]
    explanations: tuple[Explanation, ...]
    adequacy: Adequacy
    predictions: tuple[EnergyPrediction, ...]
    training: tuple[str, ...]
    judging: tuple[str, ...]
    choosing: tuple[str, ...]
    set_aside: Mapping[str, Mapping[str, int]]
    holds: bool
    explains: bool
    after_undated: Residual | None = None
    average: Average | None = None
    suspects: tuple[Option, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The answer in a word: ``effect_found``, ``no_effect`` or ``unexplained``.

        ``no_effect``: the paper's model leaves no more than noise. ``unexplained``: it leaves more,
        and no entry of the catalogue explains it, or what was found does not hold on the hold-out
        drives, or it leaves more than noise that a signal explains in part.
        """
        sound = self.effects and self.adequacy.adequate
        if not (self.holds and self.explains) or (self.unexplained and not sound):
            return "unexplained"
        return "effect_found" if self.effects else "no_effect"

    @property
    def no_probability(self) -> str | None:
        """Why no explanation has a probability; None where each has.

        Probabilities compare what the catalogue has. Where more than noise is left, the cause may
        be something else, and nothing says how probable that is.
        """
        if self.adequacy.adequate:
            return None
        return (
            "more than noise is left, so that the cause may be none of those known: "
            "explanations are in order, and none has a probability"
        )

    def chance(self, probability: float) -> str:
        """Return the probability of an explanation or an effect as it is shown."""
        return html.chance(probability) if self.no_probability is None else BEST_KNOWN

    def _summaries(self) -> list[html.Summary]:
        errors = [
            (name, *(_spanned(error, interval, key) for key in ("rmse", "mae", "bias")),
             _spanned(error, interval, "energy_error", 100.0))
            for name, error, interval in (("before", self.before, self.before_interval),
                                          ("after", self.after, self.after_interval))
        ]  # fmt: skip
        quality = self.adequacy
        notes = [
            f"residual on the training drives: {html.number(quality.residual)} W; noise: "
            f"{html.number(quality.noise)} W"
            + ("; the residual lasts longer than noise does" if quality.coloured else ""),
            *html.set_aside(self.set_aside),
            *([] if self.no_probability is None else [self.no_probability]),
            *(f"unexplained: {found.channel} ({found.shape}), "
              f"{100 * found.explained_variance:.0f} % of the residual's variance"
              for found in self.unexplained),
            *(f"advice: {one}" for one in self.advice),
        ]  # fmt: skip
        found = [
            html.Summary(
                f"verdict: {html.words(self.verdict)}",
                ("effect", "symbol", "value", "standard error", "unit", "probability",
                 "cannot be separated from"),
                [(e.name, e.symbol, e.value, e.std_error, e.unit, self.chance(e.probability),
                  ", ".join(map(html.words, e.rivals)) or "-") for e in self.effects],
            ),
            html.Summary(
                "possible explanations", ("effects", "probability"),
                [(" and ".join(map(html.words, one.effects)) or "none",
                  self.chance(one.probability) if k == 0 or self.no_probability is None else "-")
                 for k, one in enumerate(self.explanations)],
            ),
            html.Summary(
                "error on the hold-out drives, with 95 % intervals from resampled blocks",
                ("model", "rmse [W]", "mae [W]", "bias [W]", "energy error [%]"), errors, notes,
            ),
            html.Summary(
                "energy of the hold-out drives",
                ("drive", "predicted [J]", "90 % interval [J]", "measured [J]"),
                [(one.drive, one.energy, "{} to {}".format(*map(html.number, one.energy_interval)),
                  one.measured) for one in self.predictions],
            ),
        ]  # fmt: skip
        return [one for one in found if one.rows or one is found[0]]


def _spanned(error: Residual, interval: ErrorInterval, key: str, scale: float = 1.0) -> str:
    """Return an error with its interval."""
    return html.spanned(*(scale * one for one in (getattr(error, key), *getattr(interval, key))))


# -- what to do next, in sentences -----------------------------------------------------------------

_MEAN_OF_NORMAL = (2 / pi) ** 0.5  # mean size of a normal variable over its standard deviation

_NO_DIFFERENCE_KNOWN = 2  # training drives that do not show how much runs differ


def advice_of_model(
    found: Sequence[FoundEffect],
    entries: Mapping[str, Effect],
    used: Sequence[Effect],
    dropped: Sequence[tuple[Effect, str]],
    model: PowerModel,
    quality: Adequacy,
    left: Sequence[Dependence],
    dependences: Sequence[Dependence],
    significance: float,
) -> Iterator[str]:
    """Yield what a model leaves of the training drives, and what would show more of its effects."""
    names = _listed(effect.name for effect in found)
    first = next((one for one in left if one.channel != "drive"), None)
    if first is not None and found:
        yield (
            f"the residual still depends on {first.channel} ({first.shape}): {names} may stand in "
            "for something that the catalogue does not have"
        )
    elif first is not None:
        yield (
            f"no effect of the catalogue fits; look at what changes with {first.channel}: "
            f"{first.shape}"
        )
    for entry, why in dropped:
        low, high = entry.limits(model.vehicle)
        reasons = {
            "missing": "with it, the model still lacks more than half as much, so that it probably "
            "stands for something else, and would mislead elsewhere. Drive the same places at "
            "another time, by other ways",
            "size": "its size is less than two standard errors, so that another one, or none, fits "
            f"these drives about as well; to tell it: {entry.manoeuvre}",
            "range": f"its size would be beyond {low:.3g} to {high:.3g} {entry.unit}, the range "
            "that is possible for this vehicle",
        }
        yield f"{html.words(entry.name)} was dropped: {reasons[why]}"
    if not quality.adequate:
        unknown = "" if left else ", and no recorded channel explains it"
        yield (
            f"the model leaves, on the training drives, {quality.in_words}, so something is "
            f"missing{unknown}"
        )
    for one in dependences:
        if one.channel == "drive" and one.p_value < significance:
            yield (
                f"{one.shape}, by more than the scatter within them explains (p = "
                f"{one.p_value:.1g}): the ground, the load or a temperature differed, and no "
                "channel of the logs recorded it. A model identified on some drives misses the "
                f"energy of another one by at least {100 * _MEAN_OF_NORMAL * one.values[0]:.1f} % "
                "on average: log what differed, or identify again where the robot drives"
            )
    for effect in found:
        if effect.rivals:
            ways = [entries[name].manoeuvre for name in (effect.name, *effect.rivals)]
            yield (
                f"these drives cannot separate {html.words(effect.name)} from "
                f"{' or '.join(map(html.words, effect.rivals))}; to separate them: "
                f"{'; '.join(dict.fromkeys(way for way in ways if way))}"
            )
    yield from _advice_of_body(used, model)


def _advice_of_body(used: Sequence[Effect], model: PowerModel) -> Iterator[str]:
    """Yield which mass is not the vehicle's, and which effects are of a sensor."""
    own = model.vehicle.mass
    for entry in used:
        if entry.of_mass is None or len(entry.terms) != 1:
            continue
        value, error = model.coefficient(entry.name), model.std_error(entry.name) or 0.0
        # Wheels and gears turn as well: the mass that speeds up is larger than what scales show.
        most = 1.25 if entry.usual else 1.0
        if value > most * own + max(3 * error, 0.1 * own) or value < 0.9 * own - 3 * error:
            yield (
                f"{html.words(entry.name)} gives {value:.0f} +- {error:.0f} kg, the vehicle has "
                f"{own:.0f} kg: weigh it, or check the gain of the power sensor, which is off by "
                "the same factor"
            )
    for entry in used:
        if entry.acts == "log":
            yield (
                f"{html.words(entry.name)} belongs to the log, not to the robot: mend the sensor "
                "or its driver; a planner must not use it"
            )


OPTIONS: Mapping[str, Option] = {"place": "border", "change": "change"}
"""Which option looks for effects that are searched on demand, by how they act."""

_LOOKED_FOR = {
    "border": ("beyond a line on the ground", "another surface there"),
    "change": ("from some time on", "a payload or a surface that changed"),
}


def advice_of_search(suspects: Sequence[Option]) -> Iterator[str]:
    """Yield which option looks for what the residual shows from some place or time on."""
    for option in suspects:
        where, what = _LOOKED_FOR[option]
        yield (
            f"the residual differs {where}: --{option} (Python: {option}=True) looks for {what}; "
            "it may be something else that the catalogue does not have"
        )


def advice_of_predictions(
    effects: Sequence[str],
    before: Residual,
    after: Residual,
    known: Residual,
    explained: Residual,
    quality: Adequacy,
    held: bool,
    undated: Residual | None,
    untested: Sequence[tuple[str, str]],
    average: Average | None,
) -> Iterator[str]:
    """Describe what the hold-out drives show about a model, and what could not be tested."""
    names = _listed(effects)
    if effects and after.rmse > before.rmse:
        line = (
            f"the hold-out drives are predicted worse with {names} (rmse {after.rmse:.3g} W) than "
            f"without ({before.rmse:.3g} W): "
        )
        if known.rmse < before.rmse:
            yield (
                f"{line}near straight driving their contacts hold a moment that costs power, which "
                "no prediction knows; with what their own power shows of it the rmse is "
                f"{known.rmse:.3g} W. Log yaw_rate, and the power of both sides"
            )
        else:
            yield f"{line}they differ from the training drives; record more of both"
    if not held:
        better = average is not None and average.explanation_error < average.cautious_error
        yield (
            f"{names or 'resistance and friction alone'} fit the training drives (rmse "
            f"{quality.residual:.3g} W) and not the hold-out drives ({explained.rmse:.3g} W): "
            f"{'' if better else 'do not believe them; '}something else, or another state of robot "
            "or ground, is behind it. Give both kinds of drives to learn from"
        )
    if undated is not None:
        yield (
            "the time of the change was found in the hold-out drive itself, so it is no "
            f"prediction; without it the rmse is {undated.rmse:.3g} W and the energy is off by "
            f"{100 * undated.energy_error:+.1f} %"
        )
    by_reason: dict[str, list[str]] = {}
    for name, reason in untested:
        if name not in effects:
            by_reason.setdefault(reason, []).append(name)
    for reason, some in by_reason.items():
        yield f"not tested, as {reason}: {_listed(some)}"


def few_drives(count: int) -> Iterator[str]:
    """Describe what the intervals of energies allow for where too few drives were compared."""
    if count <= _NO_DIFFERENCE_KNOWN:
        yield (
            "fewer than three training drives do not show how much runs differ as a whole: the "
            f"{100 * LEVEL:.0f} % intervals of energies allow {100 * RunEffect().reach(LEVEL):.0f} "
            "% for that, as robots elsewhere differ; record more"
        )


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(html.words, names))
