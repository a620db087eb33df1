"""Why a prediction differs from what was measured, and what to add so that it doesn't.

Residual, effect, extended model, error before and after: effects of the catalogue are added one at
a time, each only if it predicts blocks of driving that it was not fitted to, and the errors that
are reported come from drives that were held out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from energyplan.diagnosis import advice as _advice
from energyplan.diagnosis.fitting import PAPER, Part, Problem
from energyplan.diagnosis.holdout import ErrorInterval, Prediction, interval, predict, score
from energyplan.diagnosis.joint_fit import final_fit, size_error
from energyplan.diagnosis.mass_centre import MassCentre, find_mass_centre
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.result import Diagnosis, Evidence, FoundEffect, Unexplained, Verdict
from energyplan.diagnosis.selection import SIGNIFICANCE, Chosen, Selection, Selector, is_needless
from energyplan.diagnosis.windows import Drive, prepared
from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.fit import fit_icr
from energyplan.logs import DriveLog
from energyplan.power import PowerModel, Residual
from energyplan.power.effects import Effect, catalogue, empirical_term
from energyplan.vehicle import Vehicle

__all__ = [
    "Dependence",
    "Diagnosis",
    "ErrorInterval",
    "Evidence",
    "FoundEffect",
    "Unexplained",
    "diagnose",
]

_TELLING = 0.1
"""Share of the error that a channel must explain to be called a reason."""

_MOSTLY = 0.3
"""Share from which on a channel is asked whether it makes the effects found unnecessary."""

Progress = Callable[[float, str], object]


def diagnose(
    train: DriveLog | Sequence[DriveLog],
    holdout: DriveLog | Sequence[DriveLog],
    vehicle: Vehicle,
    *,
    effects: Sequence[Effect] | None = None,
    choose: bool = True,
    max_effects: int = 6,
    empirical: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:
    """Trace the residual of the paper's model to effects, add them, and report before and after.

    Parameters
    ----------
    train : DriveLog or sequence of DriveLog
        Drives to learn from, 16 s each or longer. Four or more are left out one at a time in
        cross-validation; fewer are cut into blocks of 8 s.
    holdout : DriveLog or sequence of DriveLog
        Drives that only serve to report errors, and to take back an effect that makes them worse.
    vehicle : Vehicle
        The robot. Its tread ICRs are identified from the training drives where those have yaw.
    effects : sequence of Effect, optional
        The catalogue to choose from; `energyplan.power.effects.catalogue` where not given.
    choose : bool
        Choose from `effects`. False puts all of them into the model, whether they help or not, and
        takes none back: for the question what a known effect does to the errors.
    max_effects : int
        Largest number of effects that are chosen.
    empirical : bool
        Add a smooth term of the channel that explains most where no effect does.
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
        If the robot never moves in the training drives, or draws no power.

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
    >>> told = diagnose(train, unseen, truth.vehicle)
    >>> told.verdict, [(effect.name, round(effect.value)) for effect in told.effects]
    ('effect_found', [('hotel_load', 30)])
    """
    report: Progress = progress or (lambda fraction, message: None)
    learned, held_out = _logs(train, "train"), _logs(holdout, "holdout")
    if any(log is other for log in learned for other in held_out):
        raise InvalidInputError("a drive stands in train and in holdout; give it to one of them")
    entries = tuple(catalogue().values()) if effects is None else tuple(effects)
    _answerable(learned)
    report(0.0, "fitting the paper's model")
    vehicle = _with_icr(learned, vehicle)
    case = _Case(learned, held_out, vehicle, entries)
    report(0.1, "choosing effects")
    selector = Selector(
        case.problem, entries, lambda share, text: report(0.1 + 0.7 * share, text), max_effects
    )
    selection = selector.run() if choose else selector.take_all()
    report(0.8, "judging on the hold-out drives")
    return case.conclude(selection, choose, empirical, report)


def _logs(logs: DriveLog | Sequence[DriveLog], name: str) -> list[DriveLog]:
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    if not drives:
        raise InvalidInputError(f"{name} is empty; give at least one drive")
    return drives


def _answerable(logs: Sequence[DriveLog]) -> None:
    """Refuse drives that tell nothing.

    Raises
    ------
    NotIdentifiableError
        If the robot never moves, or never draws any power.
    """
    names = ", ".join(log.name for log in logs[:3])
    if not any(np.any(log.power) for log in logs):
        raise NotIdentifiableError(f"{names}: the measured power is zero throughout; check it")
    if not any(np.any(log.channel(side)) for log in logs for side in ("v_left", "v_right")):
        raise NotIdentifiableError(
            f"{names}: the robot stands still throughout; standstill tells the load at rest and "
            "nothing of friction: add a drive"
        )


def _with_icr(logs: Sequence[DriveLog], vehicle: Vehicle) -> Vehicle:
    """Symmetric tread ICRs about the vehicle's own middle, where the logs tell the slip track."""
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
        self.problem = Problem(prepared(train, vehicle), vehicle)
        self.paper = final_fit(self.problem, ()).model
        self.before = [predict(self.paper, (), Drive.of(log, vehicle)) for log in holdout]
        self.mass_centre = self._mass_centre(vehicle)
        if self.mass_centre is not None:
            cog = (self.mass_centre.forward, self.mass_centre.left)
            vehicle = vehicle.with_mass(vehicle.mass, cog).with_icr(
                fit_icr(train, vehicle.icr, asymmetric=True).icr
            )
            self.problem = Problem(prepared(train, vehicle), vehicle)
        self.held = [Drive.of(log, vehicle) for log in holdout]

    def _mass_centre(self, vehicle: Vehicle) -> MassCentre | None:
        if not any(entry.name == "centre_of_mass" for entry in self.entries):
            return None
        mu = self.paper.coefficient("slip_friction")
        found = find_mass_centre(self.problem.drives, vehicle, mu)
        return found if found is not None and found.found else None

    def conclude(
        self, selection: Selection, choose: bool, empirical: bool, report: Progress
    ) -> Diagnosis:
        """Judge what was selected on the hold-out drives and put it into words."""
        before = self.before
        chosen, withdrawn = list(selection.chosen), list[str]()
        if choose:
            chosen, withdrawn = self._vetted(selection, score(before))
        if "time_offset" in withdrawn:
            selection = replace(selection, problem=self.problem)
        parts = tuple(choice.part for choice in chosen)
        told_before = dependences(self.problem, PAPER, ("power",))
        report(0.9, "testing the residual against every channel")
        told_after = dependences(selection.problem, final_fit(selection.problem, parts).terms)
        left = [
            one for one in told_after
            if one.p_value < SIGNIFICANCE
            and one.explained_variance > max(_TELLING, 2 * one.std_error)
        ]  # fmt: skip
        mimics: list[str] = []
        # What differs from drive to drive hides no channel that says more within each.
        first = next((one for one in left if one.channel != "drive"), None)
        smooth = _smooth_part(first) if first is not None and first.knots else None
        if choose and first and smooth and first.explained_variance > _MOSTLY:
            for choice in list(chosen):
                parts = (*(other.part for other in chosen), smooth)
                if is_needless(selection.problem, parts, choice.part):
                    chosen.remove(choice)
                    mimics.append(choice.part.effect.name)
        parts = tuple(choice.part for choice in chosen)
        if empirical and smooth:
            parts = (*parts, smooth)
        fitted = final_fit(selection.problem, parts)
        after = [predict(fitted.model, parts, drive) for drive in self.held]
        if choose and score(after).rmse > score(before).rmse:
            withdrawn += [choice.part.effect.name for choice in chosen]
            chosen, parts, selection = [], (), replace(selection, problem=self.problem)
            fitted = final_fit(self.problem, parts)
            after = [predict(fitted.model, parts, drive) for drive in self.held]
        found = self._found(chosen, fitted.model, fitted.errors, selection, after)
        unexplained = tuple(
            Unexplained(
                one.channel, one.shape, one.explained_variance, one.p_value,
                empirical and smooth is not None and one is first,
            )
            for one in left
        )  # fmt: skip
        names = [effect.name for effect in found]
        used = [choice.part.effect for choice in chosen]
        advice = [
            *_advice.mimic_advice(left, names, mimics),
            *_advice.drive_advice(told_after, SIGNIFICANCE),
            *_advice.rival_advice(chosen),
            *_advice.mass_advice(fitted.model, names),
            *_advice.log_advice(used),
            *(
                f"{name} helped on the training drives only and was taken back: record more drives"
                for name in withdrawn
            ),
            *_advice.untested_advice(selection.untested, names),
        ]
        verdict: Verdict = "effect_found" if found else "unexplained" if left else "no_effect"
        report(1.0, "done")
        return Diagnosis(
            verdict=verdict,
            effects=found,
            model=_for_planners(fitted.model, used, score(after)),
            before=score(before),
            after=score(after),
            before_interval=interval(before),
            after_interval=interval(after),
            unexplained=unexplained,
            advice=tuple(advice),
            paper=replace(self.paper, residual=score(before)),
            dependences_before=told_before,
            dependences_after=told_after,
            withdrawn=(*withdrawn, *mimics),
            predictions_before=tuple(one.power for one in before),
            predictions_after=tuple(one.power for one in after),
        )

    def _vetted(self, selection: Selection, before: Residual) -> tuple[list[Chosen], list[str]]:
        """Take back effects, the last one first, while the hold-out is worse with than without."""
        chosen, withdrawn = list(selection.chosen), []
        errors = [before.rmse]
        for count in range(1, len(chosen) + 1):
            parts = [choice.part for choice in chosen[:count]]
            model = final_fit(selection.problem, parts).model
            errors.append(score([predict(model, parts, drive) for drive in self.held]).rmse)
        while chosen and errors[-1] > min(errors[:-1]):
            withdrawn.append(chosen.pop().part.effect.name)
            errors.pop()
        return chosen, withdrawn

    def _found(
        self,
        chosen: Sequence[Chosen],
        model: PowerModel,
        errors: Mapping[str, float],
        selection: Selection,
        after: Sequence[Prediction],
    ) -> tuple[FoundEffect, ...]:
        found = []
        if self.mass_centre is not None:
            entry = next(entry for entry in self.entries if entry.name == "centre_of_mass")
            found.append(_mass_effect(entry, self.mass_centre))
        for choice in chosen:
            entry, params = choice.part.effect, dict(choice.part.params)
            details = {**params, **{f"{k}_std_error": v for k, v in errors.items() if k in params}}
            details |= {
                term.name: model.coefficient(term.name)
                for term in entry.terms
                if len(entry.terms) > 1
            }
            if entry.acts == "change":
                for drive in selection.problem.drives:
                    details |= _change_time(drive)
                for one in after:
                    if one.change is not None:
                        details[f"time in {one.drive.name}"] = one.change
            value = entry.value(model) if entry.terms else params["delay"]
            error = size_error(entry, model) if entry.terms else errors["delay"]
            trial = choice.trial
            found.append(
                FoundEffect(
                    entry.name, entry.symbol, value, entry.unit, error,
                    Evidence(trial.gain, trial.gain_error, min(trial.p_value * trial.looks, 1.0)),
                    tuple(rival.part.effect.name for rival in choice.rivals),
                    details, entry.meaning, entry.planner,
                )
            )  # fmt: skip
        return tuple(found)


def _for_planners(model: PowerModel, used: Sequence[Effect], residual: Residual) -> PowerModel:
    """Leave out what belongs to the log; a change happens at time 0, before any plan."""
    logged = {term.name for entry in used if entry.acts == "log" for term in entry.terms}
    keep = [k for k, term in enumerate(model.terms) if term.name not in logged]
    terms = [model.terms[k] for k in keep]
    covariance = None if model.covariance is None else model.covariance[np.ix_(keep, keep)]
    name = "extended" if used else "paper"
    return PowerModel(
        model.vehicle, tuple(terms), model.coefficients[keep], covariance, residual, name
    )


def _change_time(drive: Drive) -> dict[str, float]:
    if "changed" not in drive.motion.channels:
        return {}
    changed = drive.motion.channels["changed"]
    at = np.flatnonzero(np.diff(changed))
    return {f"time in {drive.name}": float(drive.t[at[0] + 1])} if len(at) else {}


def _smooth_part(found: Dependence) -> Part:
    term = empirical_term(f"empirical_{found.carrier}_{found.channel}", found.knots, found.values)
    return Part(Effect.of(term, planner="where it knows the channel"))


def _mass_effect(entry: Effect, found: MassCentre) -> FoundEffect:
    offset = np.array([found.forward, found.left])
    size = float(np.hypot(*offset))
    along = offset / size
    return FoundEffect(
        entry.name, entry.symbol, size, entry.unit,
        float(np.sqrt(along @ found.covariance @ along)),
        Evidence(found.improvement, found.improvement_error, found.p_value),
        (),
        {
            "forward": found.forward, "left": found.left,
            "forward_std_error": float(np.sqrt(found.covariance[0, 0])),
            "left_std_error": float(np.sqrt(found.covariance[1, 1])),
        },
        entry.meaning, entry.planner,
    )  # fmt: skip
