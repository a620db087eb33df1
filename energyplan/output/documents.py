"""What the commands print with ``--json``: results as plain dictionaries with fixed keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from energyplan.io.config import plain_vehicle
from energyplan.logs.mapping import UNITS

if TYPE_CHECKING:
    from energyplan.comparison import Comparison
    from energyplan.diagnosis import Diagnosis
    from energyplan.errors import NoPathError
    from energyplan.fit import ICREstimate, Identification
    from energyplan.fit.doubts import Adequacy
    from energyplan.io.start import Start
    from energyplan.limits.feasibility import FeasibilityReport
    from energyplan.live import Event
    from energyplan.mission import FleetReport, LegReport, MissionReport
    from energyplan.physics import Driven, Loop
    from energyplan.physics.design import Design
    from energyplan.planning import Plan
    from energyplan.planning.driven import DrivenPath
    from energyplan.power import PowerModel, Residual
    from energyplan.reach import Contour, EnergyMap

Document = dict[str, Any]


def plain(value: Any) -> Any:
    """Return a value as JSON knows it; numbers that JSON lacks (NaN, infinity) become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    return value


def residual(found: Residual) -> Document:
    """Return the errors of a prediction [W], and of its energy [fraction]."""
    keys = ("rmse", "mae", "bias", "energy_error")
    return {key: plain(getattr(found, key)) for key in keys}


def terms(model: PowerModel) -> list[Document]:
    """Return the terms of a model with their coefficients and standard errors."""
    return [
        {
            "name": term.name,
            "symbol": term.symbol,
            "value": plain(float(value)),
            "unit": term.unit,
            "std_error": plain(model.std_error(term.name)),
        }
        for term, value in zip(model.terms, model.coefficients, strict=True)
    ]


def identification(found: Identification) -> Document:
    """Return what ``energyplan identify --json`` prints."""
    icr = {key: getattr(found.icr, key) for key in ("left", "right", "longitudinal")}
    return {
        "terms": terms(found.model),
        "icr": {**icr, "std_error": plain(found.icr_std_error)},
        "residual": residual(found.residual),
        "adequacy": adequacy(found.adequacy),
        "foretold": None if found.foretold is None else plain(found.foretold),
        "set_aside": plain(found.set_aside),
        "warnings": list(found.warnings),
    }


def adequacy(left: Adequacy) -> Document:
    """Return what a model leaves beside the noise."""
    return {**plain(left), "adequate": left.adequate}


def icr(found: ICREstimate) -> Document:
    """Return what ``energyplan identify --spin --json`` prints."""
    values = {key: getattr(found.icr, key) for key in ("left", "right", "longitudinal")}
    return {
        "icr": {**values, "std_error": plain(found.std_error)},
        "turning": plain(found.turning),
        "source": found.source,
    }


def start(made: Start) -> Document:
    """Return what ``energyplan start --json`` prints."""
    project = made.project
    keys = ("what", "value", "expected", "ok", "remedy")
    return {
        "columns": {channel: one.written for channel, one in project.columns.items()},
        "units": {
            channel: one.unit or next(iter(UNITS.get(channel, {"": 1.0})))
            for channel, one in project.columns.items()
        },
        "topics": None if project.topics is None else project.topics.model_dump(),
        "vehicle": plain(plain_vehicle(project.vehicle)),
        "defaults": plain(project.defaults),
        "checks": [{key: plain(getattr(check, key)) for key in keys} for check in made.checks],
        "notes": list(made.notes),
    }


def diagnosis(told: Diagnosis) -> Document:
    """Return what ``energyplan diagnose --json`` prints."""
    return {
        "verdict": told.verdict,
        "effects": [plain(effect) for effect in told.effects],
        "explanations": [
            {"effects": list(one.effects), "probability": plain(one.probability)}
            for one in told.explanations
        ],
        "before": residual(told.before),
        "after": residual(told.after),
        "after_undated": None if told.after_undated is None else residual(told.after_undated),
        "training": list(told.training),
        "choosing": list(told.choosing),
        "judging": list(told.judging),
        "adequacy": adequacy(told.adequacy),
        "predictions": [plain(one) for one in told.predictions],
        "average": None if told.average is None else plain(told.average),
        "set_aside": plain(told.set_aside),
        "unexplained": [plain(found) for found in told.unexplained],
        "advice": list(told.advice),
        "terms": terms(told.model),
    }


def driven_path(told: DrivenPath | None) -> Document:
    """Return what driving a plan takes; null where the motors cannot."""
    if told is None:
        return dict.fromkeys(("energy_driven", "duration", "speed", "breakdown_driven"))
    return {
        "energy_driven": plain(told.energy),
        "duration": plain(told.duration),
        "speed": plain(told.speed),
        "breakdown_driven": plain(told.breakdown),
    }


def plan(made: Plan) -> Document:
    """Return what ``energyplan plan --json`` prints."""
    keys = (
        "energy", "length", "turning", "lower_bound", "gap", "planning_time", "planner",
        "potential", "effort", "cost", "soft_cost",
    )  # fmt: skip
    document = {key: plain(getattr(made, key)) for key in keys}
    told = {"breakdown": plain(made.breakdown), "notes": list(made.notes)}
    return {**document, **told, "path": plain(made.path.poses())}


def no_path(error: NoPathError) -> Document:
    """Return what ``energyplan plan --json`` prints where there is no path."""
    return {
        "path": None,
        "reason": str(error),
        "certainty": error.certainty,
        "resolution": plain(error.resolution),
    }


def comparison(made: Comparison) -> Document:
    """Return what ``energyplan compare --json`` prints."""
    return {
        "energy_optimal": plan(made.energy_optimal),
        "shortest": plan(made.shortest),
        "saving": plain(made.saving),
        "saving_of": "energy_driven" if made.driven else "energy",
    }


def energy_map(found: EnergyMap, areas: Sequence[Contour]) -> Document:
    """Return what ``energyplan range --json`` prints."""
    return {
        "area": plain(found.reachable(float(np.finfo(float).max))),
        "complete_to": plain(found.complete_to),
        "confidence": plain(found.confidence),
        "contours": [{"energy": plain(a.energy), "area": plain(a.area.area)} for a in areas],
    }


def feasibility(report: FeasibilityReport) -> Document:
    """Return what ``energyplan check --json`` prints."""
    keys = ("kind", "side", "start", "end", "peak", "limit")
    return {
        "feasible": report.feasible,
        "violations": [
            {key: plain(getattr(violation, key)) for key in keys} for violation in report.violations
        ],
        "max_speed_scale": plain(report.max_speed_scale),
        "energy": plain(report.energy),
        "reason": report.reason,
    }


def mission(report: MissionReport, trajectories: bool = False) -> Document:
    """Return what ``energyplan mission --json`` prints; with the legs' trajectories if asked."""
    keys = (
        "name", "verdict", "reason", "reachable_alone", "energy", "energy_upper", "soc_after",
"shortfall", "remedy", "remedies", "arrival", "departure", "soc_lower", "start", "start_upper",
    )  # fmt: skip
    whole = (
        "headline", "order", "route", "energy", "energy_upper", "soc_end", "soc_end_lower", "end",
        "duration", "feasible", "chargers", "timetable",
        "proven", "gap", "warnings",
    )  # fmt: skip
    return {
        "tasks": [
            {**{key: plain(getattr(task, key)) for key in keys}, "pose": plain(asked.pose)}
            for task, asked in zip(report.tasks, report.mission.tasks, strict=True)
        ],
        **{key: plain(getattr(report, key)) for key in whole},
        "uncertainty": [
            {key: plain(getattr(doubt, key)) for key in ("source", "energy", "saving")}
            for doubt in report.uncertainty
        ],
        "legs": [_leg(leg, trajectories) for leg in report.legs],
    }


def fleet(report: FleetReport) -> Document:
    """Return what ``energyplan mission --json`` prints of several robots."""
    keys = (
        "name", "tasks", "route", "energy", "energy_upper", "soc_end", "soc_end_lower", "duration",
        "waiting",
    )  # fmt: skip
    whole = ("left_out", "energy", "energy_upper", "proven", "gap", "feasible")
    return {
        "robots": [{key: plain(getattr(one, key)) for key in keys} for one in report.robots],
        **{key: plain(getattr(report, key)) for key in whole},
    }


def event(told: Event) -> Document:
    """Return an event of ``energyplan watch --json``."""
    named: Document = {"event": type(told).__name__.lower()}
    for item in fields(told):
        value = getattr(told, item.name)
        if item.name in ("model", "before"):
            named |= {"terms": terms(value)}
        elif item.name == "models":
            named["models"] = [{"name": one.name, "terms": terms(one)} for one in value]
        elif item.name == "report":
            named["mission"] = None if value is None else mission(value)
        else:
            named[item.name] = plain(value)
    return named


def _leg(leg: LegReport, trajectory: bool) -> Document:
    """Return a leg, with its trajectory as columns over its time if asked."""
    drive = leg.trajectory
    columns = {
        "t": drive.t, "x": drive.x, "y": drive.y, "yaw": drive.yaw, "v": drive.v,
        "omega": drive.omega, "soc": leg.soc, "soc_lower": leg.soc_lower,
    }  # fmt: skip
    told = {key: plain(getattr(leg, key)) for key in ("start", "goal", "departure", "energy")}
    told["duration"] = plain(drive.duration)
    if trajectory:
        told["trajectory"] = {k: np.round(values, 6).tolist() for k, values in columns.items()}
    return told


def driven(made: Driven, secret: bool = False) -> Document:
    """Return what ``energyplan drive --json`` prints; what was taken not by term if `secret`."""
    keys = (
        "energy_told", "energy_taken", "error", "arrived", "tracking_error", "heading_error",
        "final_error",
    )  # fmt: skip
    return {
        **{key: plain(getattr(made, key)) for key in keys},
        "duration": plain(made.trajectory.duration),
        "terms": [
            {"name": name, "told": told} | ({} if secret else {"taken": taken})
            for name, told, taken in made.terms
            if told or not secret
        ],
    }


def loop(made: Loop) -> Document:
    """Return what ``energyplan close-the-loop --json`` prints."""
    keys = (
        "energy_told", "energy_interval", "energy_taken", "error", "overhead", "effects", "length",
        "note",
    )  # fmt: skip
    return {
        "rounds": [
            {key: plain(getattr(now, key)) for key in keys}
            | {
                "arrived": plain(now.driven.arrived) if now.driven else None,
                "survey": plain(now.survey.trajectory.duration) if now.survey else None,
            }
            for now in made.rounds
        ],
        "closed": made.closed,
        "terms": terms(made.model),
    }


def design(made: Design) -> Document:
    """Return what ``energyplan design --json`` prints."""
    return {
        "separates": [
            {"true": pair.true, "other": pair.other, "log_odds": plain(pair.log_odds)}
            for pair in made.separates
        ],
        "probabilities_expected": [
            {"explanation": label, "if_true": plain(value)}
            for label, value in made.probabilities_expected
        ],
        "manoeuvres": list(made.manoeuvres),
        "duration": plain(made.trajectory.duration),
        "sentence": made.sentence,
    }
