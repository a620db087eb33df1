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
    from energyplan.fit.tasks import TaskFit
    from energyplan.io.start import Start
    from energyplan.limits.feasibility import FeasibilityReport
    from energyplan.live import Event
    from energyplan.mission import MissionReport, Segment
    from energyplan.path import FloatArray
    from energyplan.physics import Driven, Loop
    from energyplan.physics.design import Design
    from energyplan.planning import Plan
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


def picked(value: Any, names: str) -> Document:
    """Return some attributes of a result."""
    return {name: plain(getattr(value, name)) for name in names.split()}


def residual(found: Residual) -> Document:
    """Return the errors of a prediction [W], and of its energy [fraction]."""
    return picked(found, "rmse mae bias energy_error")


def terms(model: PowerModel) -> list[Document]:
    """Return the terms of a model with their coefficients and standard errors."""
    return [
        {"name": term.name, "symbol": term.symbol, "value": plain(float(value)),
         "unit": term.unit, "std_error": plain(model.std_error(term.name))}
        for term, value in zip(model.terms, model.coefficients, strict=True)
    ]  # fmt: skip


def identification(found: Identification) -> Document:
    """Return what ``energyplan identify --json`` prints."""
    spread = plain(found.icr_std_error)
    return {
        "terms": terms(found.model),
        "icr": {**picked(found.icr, "left right longitudinal"), "std_error": spread},
        "residual": residual(found.residual),
        "adequacy": adequacy(found.adequacy),
        **picked(found, "foretold set_aside warnings"),
    }


def tasks(found: TaskFit, history: Mapping[str, FloatArray]) -> Document:
    """Return what ``energyplan identify --json`` prints of a history of tasks."""
    whole = float(np.nansum(history["energy"]))
    return {
        "terms": terms(found.model),
        "icr": {**picked(found.model.vehicle.icr, "left right longitudinal"), "std_error": None},
        "tasks": len(found.energies),
        "residual": {"relative": found.spread, "energy_error": plain(
            float(found.energies.sum()) / whole - 1.0)},
        "warnings": list(found.warnings),
    }  # fmt: skip


def adequacy(left: Adequacy) -> Document:
    """Return what a model leaves beside the noise."""
    return {**plain(left), "adequate": left.adequate}


def icr(found: ICREstimate) -> Document:
    """Return what ``energyplan identify --spin --json`` prints."""
    values = picked(found.icr, "left right longitudinal")
    spread = plain(found.std_error)
    return {"icr": {**values, "std_error": spread}, **picked(found, "turning source")}


def start(result: Start) -> Document:
    """Return what ``energyplan start --json`` prints."""
    project = result.project
    return {
        "columns": {channel: one.written for channel, one in project.columns.items()},
        "units": {
            channel: one.unit or next(iter(UNITS.get(channel, {"": 1.0})))
            for channel, one in project.columns.items()
        },
        "topics": None if project.topics is None else project.topics.model_dump(),
        "vehicle": plain(plain_vehicle(project.vehicle)),
        "defaults": plain(project.defaults),
        "checks": [picked(check, "what value expected ok remedy") for check in result.checks],
        "notes": list(result.notes),
    }


def diagnosis(report: Diagnosis) -> Document:
    """Return what ``energyplan diagnose --json`` prints."""
    return {
        **picked(
            report, "verdict effects training choosing judging predictions average set_aside "
            "unexplained advice",
        ),
        "explanations": [picked(one, "effects probability") for one in report.explanations],
        "before": residual(report.before),
        "after": residual(report.after),
        "after_undated": None if report.after_undated is None else residual(report.after_undated),
        "adequacy": adequacy(report.adequacy),
        "terms": terms(report.model),
    }  # fmt: skip


def plan(result: Plan) -> Document:
    """Return what ``energyplan plan --json`` prints; null for what only driving it tells."""
    keys = (
        "energy length turning lower_bound gap planning_time planner potential effort effort_limit "
        "cost soft_cost breakdown notes"
    )
    drive = None if result.why_not_driven else result.driven
    driven = {"energy_driven": "energy", "duration": "duration", "speed": "speed",
              "breakdown_driven": "breakdown"}  # fmt: skip
    return {
        **picked(result, keys),
        "reverse_length": plain(result.path.reverse_length),
        "path": plain(result.path.poses()),
        **{key: plain(getattr(drive, name, None)) for key, name in driven.items()},
    }


def no_path(error: NoPathError) -> Document:
    """Return what ``energyplan plan --json`` prints where there is no path."""
    return {"path": None, "reason": str(error), **picked(error, "certainty resolution")}


def comparison(result: Comparison) -> Document:
    """Return what ``energyplan compare --json`` prints."""
    return {
        "energy_optimal": plan(result.energy_optimal),
        "shortest": plan(result.shortest),
        "saving": plain(result.saving),
        "saving_of": "energy_driven" if result.driven else "energy",
    }


def energy_map(found: EnergyMap, areas: Sequence[Contour]) -> Document:
    """Return what ``energyplan range --json`` prints."""
    return {
        "area": plain(found.reachable(float(np.finfo(float).max))),
        **picked(found, "complete_to confidence"),
        "contours": [{"energy": plain(a.energy), "area": plain(a.area.area)} for a in areas],
    }


def feasibility(report: FeasibilityReport) -> Document:
    """Return what ``energyplan check --json`` prints."""
    keys = "kind side start end peak limit"
    return {
        **picked(report, "feasible max_speed_scale energy duration reason"),
        "violations": [picked(violation, keys) for violation in report.violations],
    }


def mission(report: MissionReport, trajectories: bool = False) -> Document:
    """Return what ``energyplan mission --json`` prints; with the legs' trajectories if asked."""
    if report.robots:
        return _of_robots(report, trajectories)
    keys = (
        "name verdict reason reachable_alone energy energy_upper soc_after shortfall remedy "
        "remedies arrival departure soc_lower start start_upper"
    )
    whole = (
        "headline order route energy energy_upper soc_end soc_end_lower end duration feasible "
        "chargers timetable proven gap warnings"
    )
    return {
        "tasks": [
            {**picked(task, keys), "pose": plain(asked.pose)}
            for task, asked in zip(report.tasks, report.mission.tasks, strict=True)
        ],
        **picked(report, whole),
        "uncertainty": [picked(doubt, "source energy saving") for doubt in report.uncertainty],
        "legs": [_leg(leg, trajectories) for leg in report.legs],
    }


def _of_robots(report: MissionReport, trajectories: bool) -> Document:
    """Return the answer for several robots; the legs only with their trajectories."""
    keys = "route energy energy_upper soc_end soc_end_lower duration waiting"
    required = {task.name: task.required for task in report.mission.tasks}
    return {
        "robots": [
            {
                "name": one.mission.name,
                "tasks": [task.name for task in one.tasks],
                **picked(one, keys),
                **({"legs": [_leg(leg, True) for leg in one.legs]} if trajectories else {}),
            }
            for one in report.robots
        ],
        "left_out": [
            {"name": task.name, "required": required[task.name], "reasons": list(task.reasons)}
            for task in report.left_out
        ],
        **picked(report, "energy energy_upper proven gap feasible"),
    }


def event(report: Event) -> Document:
    """Return an event of ``energyplan watch --json``."""
    named: Document = {"event": type(report).__name__.lower()}
    for item in fields(report):
        value = getattr(report, item.name)
        if item.name in ("model", "before"):
            named |= {"terms": terms(value)}
        elif item.name == "models":
            named["models"] = [{"name": one.name, "terms": terms(one)} for one in value]
        elif item.name == "report":
            named["mission"] = None if value is None else mission(value)
        else:
            named[item.name] = plain(value)
    return named


def _leg(leg: Segment, trajectory: bool) -> Document:
    """Return a leg, with its trajectory as columns over its time if asked."""
    drive = leg.trajectory
    report = {**picked(leg, "start goal departure energy"), "duration": plain(drive.duration)}
    if trajectory:
        columns = {name: getattr(drive, name) for name in ("t", "x", "y", "yaw", "v", "omega")}
        columns |= {"soc": leg.soc, "soc_lower": leg.soc_lower}
        report["trajectory"] = {k: np.round(values, 6).tolist() for k, values in columns.items()}
    return report


def driven(result: Driven, secret: bool = False) -> Document:
    """Return what ``energyplan drive --json`` prints; what was taken not by term if `secret`."""
    keys = "energy_predicted energy_measured error arrived tracking_error heading_error final_error"
    return {
        **picked(result, keys),
        "duration": plain(result.trajectory.duration),
        "terms": [
            {"name": name, "told": report} | ({} if secret else {"taken": taken})
            for name, report, taken in result.terms
            if report or not secret
        ],
    }


def loop(result: Loop) -> Document:
    """Return what ``energyplan close-the-loop --json`` prints."""
    keys = "energy_predicted energy_interval energy_measured error overhead effects length note"
    return {
        "rounds": [
            picked(now, keys)
            | {
                "arrived": plain(now.driven.arrived) if now.driven else None,
                "survey": plain(now.survey.trajectory.duration) if now.survey else None,
            }
            for now in result.rounds
        ],
        "closed": result.closed,
        "terms": terms(result.model),
    }


def design(result: Design) -> Document:
    """Return what ``energyplan design --json`` prints."""
    return {
        "separates": [picked(pair, "true other log_odds") for pair in result.separates],
        "probabilities_expected": [
            {"explanation": label, "if_true": plain(value)}
            for label, value in result.probabilities_expected
        ],
        "duration": plain(result.trajectory.duration),
        **picked(result, "manoeuvres sentence"),
    }
