"""Why a prediction differs from what was measured, and what to add so that it doesn't.

Residual, effects, extended model, error before and after: sets of effects of the catalogue are
compared by how they predict parts of the training drives that they were not fitted to, and the
errors that are reported come from drives that took part in neither.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.diagnosis.averaging import averaged, note_of
from energyplan.diagnosis.candidates import Part, change_time
from energyplan.diagnosis.judge import (
    Judged,
    MassCentre,
    Prediction,
    energies,
    explains,
    final_fit,
    find_mass_centre,
    holds,
    interval,
    judged,
    predict,
    score,
    size_error,
    with_contacts,
)
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.result import (
    OPTIONS,
    Average,
    Diagnosis,
    EnergyPrediction,
    ErrorInterval,
    Evidence,
    Explanation,
    FoundEffect,
    Option,
    Unexplained,
    advice_of_model,
    advice_of_predictions,
    advice_of_search,
    few_drives,
)
from energyplan.diagnosis.search import SIGNIFICANCE, EffectSearch, SearchResult
from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.fit import fit_icr, identify
from energyplan.fit.doubts import Adequacy, ends_in_words, leaves_open, open_in_words
from energyplan.fit.drive import Drive, Late, check_long_enough
from energyplan.fit.estimate import PAPER, Fitted, problem_of, with_signs
from energyplan.fit.identification import name_of
from energyplan.logs import DriveLog
from energyplan.logs.checks import refuse_one_side, without_copies, yaw_rate_offset
from energyplan.logs.clean import set_aside_by_drive
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Residual, Term
from energyplan.power.effects import UNSIGNED_POWER, Effect, catalogue
from energyplan.records import checked
from energyplan.vehicle import Vehicle

__all__ = [
    "Adequacy",
    "Average",
    "Dependence",
    "Diagnosis",
    "EnergyPrediction",
    "ErrorInterval",
    "Evidence",
    "Explanation",
    "FoundEffect",
    "Unexplained",
    "diagnose",
]

_SHOWN = 8  # most explanations that are reported

_POSSIBLE = 1e-3
"""Probability over that of the best explanation, from which on another one is reported."""

Progress = Callable[[float, str], object]


@checked()
def diagnose(
    train: DriveLog | Sequence[DriveLog],
    holdout: DriveLog | Sequence[DriveLog],
    vehicle: Vehicle,
    *,
    effects: Sequence[Effect] | None = None,
    choose: bool = True,
    max_effects: int = 6,
    empirical: bool = False,
    border: bool = False,
    change: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:
    """Trace the residual of the paper's model to effects, add them, and report before and after.

    Parameters
    ----------
    train : DriveLog or sequence of DriveLog
        Drives to learn from, 16 s each or longer. Four or more are left out one at a time in
        cross-validation; fewer are cut into blocks of 8 s.
    holdout : DriveLog or sequence of DriveLog
        Drives that only serve to report errors: they choose nothing.
    vehicle : Vehicle
        The robot. Its tread ICRs are identified from the training drives where those have yaw.
    effects : sequence of Effect, optional
        The effects to choose from. Where not given, those of `energyplan.power.effects.catalogue`
        but for the effects that `border` and `change` are about.
    choose : bool
        Choose from `effects`. False puts all of them into the model, whether they help or not: for
        the question what a known effect does to the errors.
    max_effects : int
        Largest number of effects that are chosen.
    empirical : bool
        Add a smooth term of the channel that explains most where no effect does.
    border : bool
        Also look for another surface beyond a line on the ground. That is slow, and a line fits
        many a residual that has another reason; `Diagnosis.advice` says where it is promising.
    change : bool
        Also look for a payload or a surface that changed at some time; as for `border`.
    progress : callable, optional
        Called as ``progress(fraction, message)``.

    Returns
    -------
    Diagnosis
        Verdict, effects, extended model, and errors before and after.

    Raises
    ------
    InvalidInputError
        If there are no drives, or a drive is both learned from and held out.
    DriveLogError
        If a drive is shorter than 16 s.
    NotIdentifiableError
        If the robot never moves in training, or draws no power, or a drive lacks a side's.

    References
    ----------
    docs/theory, section 7; docs/diagnosis.

    Examples
    --------
    >>> from energyplan import simulate
    >>> from energyplan.power import HOTEL
    >>> truth = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
    >>> train = simulate.identification_drive(truth, power_noise=5.0, seed=1)
    >>> unseen = simulate.validation_drive(truth, power_noise=5.0, seed=2)
    >>> found = diagnose(train, unseen, truth.vehicle)
    >>> found.verdict, [(effect.name, round(effect.value)) for effect in found.effects]
    ('effect_found', [('hotel_load', 30)])
    """
    report: Progress = progress or (lambda fraction, message: None)
    learned, held_out = _logs(train, "train"), _logs(holdout, "holdout")
    learned, copies = without_copies(learned, held_out)
    entries, suspects = _searched(effects, border=border, change=change)
    _answerable(learned)
    refuse_one_side([*learned, *held_out])
    check_long_enough(learned, held_out)
    report(0.0, "fitting the paper's model")
    vehicle = _with_icr(learned, vehicle)
    signed = with_signs([*learned, *held_out], vehicle, entries)
    learned, held_out = signed[: len(learned)], signed[len(learned) :]
    if all(log.signed for log in learned):
        entries = tuple(entry for entry in entries if UNSIGNED_POWER not in entry.terms)
    case = _Case(learned, held_out, vehicle, entries)
    case.limits[:0] = copies
    report(0.1, "choosing effects")
    search = EffectSearch(
        case.problem, entries, lambda share, text: report(0.1 + 0.7 * share, text), max_effects,
        case.held, suspects,
    )  # fmt: skip
    found = search.run() if choose else search.take_all()
    report(0.8, "judging on the hold-out drives")
    return case.conclude(found, choose, empirical, report)


def _logs(logs: DriveLog | Sequence[DriveLog], name: str) -> list[DriveLog]:
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    if not drives:
        raise InvalidInputError(f"{name} is empty; give at least one drive")
    return drives


def _searched(
    effects: Sequence[Effect] | None, *, border: bool, change: bool
) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Return the effects to search for, and those that the advice may say to search for."""
    known = tuple(catalogue().values())
    given = {"border": border, "change": change}
    wanted = [one for one in known if one.on_demand and given[OPTIONS[one.acts]]]
    if effects is not None:
        return (*effects, *(one for one in wanted if one not in effects)), ()
    chosen = [one for one in known if not one.on_demand or one in wanted]
    return tuple(chosen), tuple(one for one in known if one not in chosen)


def _options(searched: SearchResult) -> tuple[Option, ...]:
    return tuple(dict.fromkeys(OPTIONS[one.acts] for one in searched.suspects))


def _answerable(logs: Sequence[DriveLog]) -> None:
    """Refuse drives that show nothing."""
    names = ", ".join(log.name for log in logs[:3])
    if not any(np.any(log.power) for log in logs):
        raise NotIdentifiableError(f"{names}: the measured power is zero throughout; check it")
    if not any(np.any(log.channel(side)) for log in logs for side in ("v_left", "v_right")):
        raise NotIdentifiableError(
            f"{names}: the robot stands still throughout; standstill shows the load at rest, but "
            "no friction: add a drive"
        )


def _with_icr(logs: Sequence[DriveLog], vehicle: Vehicle) -> Vehicle:
    """Symmetric tread ICRs about the vehicle's own middle, where the logs show the slip track."""
    try:
        return vehicle.with_icr(fit_icr(logs, vehicle.icr, asymmetric=False).icr)
    except NotIdentifiableError:
        return vehicle


class _Case:
    """Drives, vehicle and catalogue of one diagnosis, and the paper's model on them."""

    def __init__(
        self,
        train: Sequence[DriveLog],
        holdout: Sequence[DriveLog],
        vehicle: Vehicle,
        entries: Sequence[Effect],
    ) -> None:
        self.entries = tuple(entries)
        self.logs = (tuple(train), tuple(holdout))
        self.name = name_of(vehicle, self.logs[0])
        self.notes: list[str] = []
        self.limits: list[str] = []  # of what these drives can show: said before anything else
        train, holdout = (self._in_step(logs) for logs in self.logs)
        self.problem = problem_of(train, vehicle, self.entries)
        self.paper, self.identified = self._identified(train, vehicle)
        self.before = [
            predict(self.paper, (), Drive.of(log, self.paper.vehicle)) for log in holdout
        ]
        self.mass_centre = self._mass_centre(vehicle)
        if self.mass_centre is not None:
            cog = (self.mass_centre.forward, self.mass_centre.left)
            vehicle = vehicle.with_mass(vehicle.mass, cog).with_icr(
                fit_icr(train, vehicle.icr, asymmetric=True).icr
            )
            self.problem = problem_of(train, vehicle, self.entries)
        breakaway = self.problem.drives[0].breakaway
        self.held = [replace(Drive.of(log, vehicle), breakaway=breakaway) for log in holdout]
        self.starts = [float(log.t[0]) for log in holdout]

    def _in_step(self, logs: Sequence[DriveLog]) -> list[DriveLog]:
        """Shift `accel_x` to the wheels' clock by the gyroscope's offset, where that is certain."""
        moved = []
        for log in logs:
            offset = yaw_rate_offset(log) if {"yaw_rate", "accel_x"} <= set(log.channels) else None
            if offset is not None and offset.certain:
                by = -offset.seconds
                self.notes.append(
                    f"{log.name}: yaw_rate is {abs(by):.2f} s {'ahead of' if by > 0 else 'behind'} "
                    "the wheels; it and accel_x, which shares its clock, were moved by as much"
                )
                log = log.shifted(yaw_rate=by, accel_x=by)
            moved.append(log)
        return moved

    def _on_given_samples(self, made: Sequence[Prediction]) -> tuple[FloatArray, ...]:
        """Return powers at the hold-out drives' own samples: moving a channel set some aside."""
        return tuple(
            np.interp(log.t, start + one.drive.t, one.power)
            for log, start, one in zip(self.logs[1], self.starts, made, strict=True)
        )

    def _identified(self, train: Sequence[DriveLog], vehicle: Vehicle) -> tuple[PowerModel, bool]:
        """Return the paper's model, and whether drives show more of it than is known of others."""
        try:
            model = identify(train, vehicle).model
            return model, not leaves_open(model)
        except NotIdentifiableError as reason:
            self.limits.append(str(reason))
            return final_fit(self.problem, ()).model, False

    def _mass_centre(self, vehicle: Vehicle) -> MassCentre | None:
        if not any(entry.acts == "kinematics" for entry in self.entries):
            return None
        mu = self.paper.coefficient("slip_friction")
        found = find_mass_centre(self.problem.drives, vehicle, mu)
        return found if found is not None and found.found else None

    def conclude(
        self, searched: SearchResult, choose: bool, empirical: bool, report: Progress
    ) -> Diagnosis:
        """Judge the most probable explanation on the hold-out drives and put it into words."""
        dependences_before = dependences(self.problem, PAPER, ("power",))
        report(0.9, "testing the residual against every channel")
        keep = self.identified and self.mass_centre is None
        fighting = next((one for one in self.entries if one.acts == "hold"), None)
        outcome = judged(
            searched.best, choose=choose, plain=self.paper if keep else None,
            heats=fighting is not None, smooth=lambda part: empirical and self._carry(part),
        )  # fmt: skip
        parts, quality, heat = outcome.parts, outcome.model.quality, outcome.model.heat
        weighed = (
            averaged(searched.best.problem, outcome.model.fitted, parts, self._common(parts))
            if choose else None
        )  # fmt: skip
        fitted = outcome.model.fitted if weighed is None else weighed.fitted
        average = None if weighed is None else weighed.average
        on = _HeldOut.of(self, fitted, parts)
        found = self._found(outcome.effects, outcome.model.fitted, searched, on.after)
        if heat is not None and fighting is not None:
            found = (*found, heat.effect(fighting))
        names = [effect.name for effect in found]
        usual = {entry.name for entry in self.entries if entry.usual}.issuperset(names)
        # Averages weigh whole runs' energies: what of the power within them they miss was found.
        own = (
            on.known if weighed is None
            else _HeldOut.of(self, outcome.model.fitted, parts).known
        )  # fmt: skip
        held = holds(quality, own)
        advice = self._advice(outcome, found, fitted, average, on, score(own), held, searched)
        used = [part.effect for part in outcome.effects]
        report(1.0, "done")
        return Diagnosis(
            effects=found,
            model=_for_planners(
                fitted.model, used, replace(on.errors[1], run_spread=fitted.run_spread), self.name
            ),
            before=on.errors[0],
            after=on.errors[1],
            before_interval=interval(on.before),
            after_interval=interval(on.after),
            unexplained=outcome.unexplained,
            advice=tuple(advice),
            paper=replace(self.paper, residual=on.errors[0]),
            dependences_before=dependences_before,
            dependences_after=outcome.dependences,
            predictions_before=self._on_given_samples(on.before),
            predictions_after=self._on_given_samples(on.after),
            explanations=self._explanations(searched),
            adequacy=quality,
            predictions=energies(fitted, on.ahead),
            training=tuple(log.name for log in self.logs[0]),
            judging=tuple(log.name for log in self.logs[1]),
            choosing=self._choosing(),
            set_aside=set_aside_by_drive([*self.logs[0], *self.logs[1]]),
            holds=held,
            explains=explains(quality, usual, on.errors[0].rmse, score(own).rmse),
            after_undated=on.undated,
            average=average,
            suspects=_options(searched),
        )

    def _advice(
        self, outcome: Judged, found: Sequence[FoundEffect], fitted: Fitted,
        average: Average | None, on: _HeldOut, own: Residual, held: bool, searched: SearchResult,
    ) -> Iterator[str]:  # fmt: skip
        """Yield what to drive, weigh or mend next, the most important first."""
        quality, heat = outcome.model.quality, outcome.model.heat
        names = [one.name for one in found]
        yield from self.limits
        yield from open_in_words(fitted.model, fitted.assumed)
        yield from ends_in_words(fitted.model)
        if heat is not None:
            yield heat.in_words
        yield from self._of_totals(outcome.effects)
        yield from advice_of_search(_options(searched))
        yield from advice_of_model(
            found, {entry.name: entry for entry in self.entries},
            [part.effect for part in outcome.effects], outcome.dropped, outcome.model.fitted.model,
            quality, outcome.left, outcome.dependences, SIGNIFICANCE,
        )  # fmt: skip
        yield from advice_of_predictions(
            names, *on.errors, score(on.known), own, quality, held, on.undated,
            searched.untested, average,
        )  # fmt: skip
        if average is not None:
            yield note_of(average, names)
        yield from few_drives(len(self.logs[0]))
        yield from self.notes

    def _of_totals(self, parts: Sequence[Part]) -> list[str]:
        """Describe what totals do not show of losses."""
        if self.problem.drives[0].equations == 2 or not any(part.lossy for part in parts):
            return []
        return [
            "of losses, the total power shows those in arcs alone, and not the heat of sides that "
            "push against each other on straights: log the power of both sides, with its sign"
        ]

    def _common(self, parts: Sequence[Part]) -> list[Term]:
        """Terms that many robots have; of one that was found, with what was found."""
        found = {term.name: term for part in parts for term in part.terms}
        terms = (term for entry in self.entries if entry.common for term in entry.terms)
        return [found.get(term.name, term) for term in terms]

    def _carry(self, part: Part) -> bool:
        """Return whether all drives that are to be predicted have the channels of a part."""
        needed = {name for term in part.terms for name in term.channels}
        return all(needed <= set(drive.motion.channels) for drive in self.held)

    def _choosing(self) -> tuple[str, ...]:
        """Name what chose: whole training drives, or blocks of them, each left out in turn."""
        names = [log.name for log in self.logs[0]]
        return tuple(names if len(names) >= 4 else (f"blocks of {name}" for name in names))

    def _explanations(self, searched: SearchResult) -> tuple[Explanation, ...]:
        moved = tuple(e.name for e in self.entries if e.acts == "kinematics" and self.mass_centre)
        return tuple(
            Explanation(
                (*moved, *one.names), one.probability,
                _for_planners(final_fit(one.problem, one.parts).model,
                              [part.effect for part in one.parts], None, self.name),
            )
            for one in searched.explanations[:_SHOWN]
            if one.probability >= _POSSIBLE * searched.best.probability
        )  # fmt: skip

    def _found(
        self,
        parts: Sequence[Part],
        fitted: Fitted,
        searched: SearchResult,
        after: Sequence[Prediction],
    ) -> tuple[FoundEffect, ...]:
        model, errors = fitted.model, fitted.errors
        found = []
        if self.mass_centre is not None:
            entry = next(entry for entry in self.entries if entry.acts == "kinematics")
            found.append(self.mass_centre.effect(entry))
        for part in parts:
            entry, params = part.effect, dict(part.params)
            details = {**params, **{f"{k}_std_error": v for k, v in errors.items() if k in params}}
            details |= {
                term.name: model.coefficient(term.name)
                for term in entry.terms
                if len(entry.terms) > 1
            }
            if entry.acts == "change":
                for drive in searched.best.problem.drives:
                    details |= change_time(drive)
                for one in after:
                    if one.change is not None:
                        details[f"time in {one.drive.name}"] = one.change
            value = entry.value(model) if entry.terms else Late.of(part.params).mean
            error = size_error(entry, model) if entry.terms else errors["late"]
            gain = searched.best.gains[searched.best.parts.index(part)]
            found.append(
                FoundEffect(
                    entry.name, entry.symbol, value, entry.unit, error,
                    Evidence(gain.improvement, gain.error, gain.p_value),
                    searched.probability(entry.name),
                    searched.rivals(entry.name),
                    details, entry.meaning, entry.planner,
                )
            )  # fmt: skip
        return tuple(found)


@dataclass(frozen=True)
class _HeldOut:
    """What the paper's model and the one that is handed on say of the hold-out drives."""

    before: list[Prediction]
    after: list[Prediction]
    ahead: list[Prediction]  # with a change of state not dated on these drives
    known: list[Prediction]  # `after`, with what their own power shows of contacts that hold
    errors: tuple[Residual, Residual]  # before and after
    undated: Residual | None  # of `ahead`, where that is not `after`

    @classmethod
    def of(cls, case: _Case, fitted: Fitted, parts: Sequence[Part]) -> _HeldOut:
        """Predict the hold-out drives of a case."""
        before = case.before
        after = [predict(fitted.model, parts, drive) for drive in case.held]
        if fitted.model is case.paper:
            after = list(before)
        ahead, undated = after, None
        if any(part.effect.acts == "change" for part in parts):
            ahead = [predict(fitted.model, parts, drive, dated=False) for drive in case.held]
            undated = score(ahead)
        known = [with_contacts(fitted.model, one) for one in after]
        return cls(before, after, ahead, known, (score(before), score(after)), undated)


def _for_planners(
    model: PowerModel, used: Sequence[Effect], residual: Residual | None, name: str
) -> PowerModel:
    """Leave out what belongs to the log; a change happens at time 0, before any plan."""
    logged = {term.name for entry in used if entry.acts == "log" for term in entry.terms}
    keep = [k for k, term in enumerate(model.terms) if term.name not in logged]
    terms = [model.terms[k] for k in keep]
    covariance = None if model.covariance is None else model.covariance[np.ix_(keep, keep)]
    return PowerModel(
        model.vehicle, tuple(terms), model.coefficients[keep], covariance, residual, name
    )
