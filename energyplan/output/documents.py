"""What the commands print with ``--json``: results as plain dictionaries with fixed keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from energyplan.io.config import plain_vehicle
from energyplan.logs.mapping import UNITS

if TYPE_CHECKING:
    from energyplan.battery import BatteryRun
    from energyplan.comparison import Comparison
    from energyplan.diagnosis import Diagnosis
    from energyplan.diagnosis.design import Design
    from energyplan.errors import NoPathError
    from energyplan.fit import ICREstimate, Identification
    from energyplan.fit.tasks import TaskFit
    from energyplan.io.start import Start
    from energyplan.limits.feasibility import FeasibilityReport
    from energyplan.live import Event
    from energyplan.mission import MissionReport, Segment
    from energyplan.path import FloatArray
    from energyplan.physics import Driven, Loop
    from energyplan.planning import Plan
    from energyplan.power import PowerModel
    from energyplan.reach import Contour, EnergyMap
    from energyplan.terrain import OccupancyGrid
    from energyplan.vehicle import TreadICR

Document = dict[str, Any]

SHOWN = {
    "BatteryRun": "peak_power peak_current soc_end reason brown_out",
    "Adequacy": "noise residual slow_noise slow_residual coloured time missing adequate",
    "Check": "what value expected ok remedy",
    "Design": "separates manoeuvres sentence",
    "Diagnosis": "verdict effects training choosing judging predictions average set_aside "
    "unexplained advice explanations no_probability before after after_undated adequacy",
    "Driven": "energy_predicted energy_measured error arrived tracking_error heading_error "
    "final_error",
    "EnergyMap": "complete_to confidence",
    "Explanation": "effects probability",
    "FeasibilityReport": "feasible max_speed_scale energy duration reason violations",
    "ICREstimate": "turning source",
    "Identification": "residual adequacy cross_validation set_aside warnings",
    "MissionReport": "headline order route energy energy_upper soc_end soc_end_lower end duration "
    "feasible chargers timetable proven gap warnings remedies time_saved uncertainty alternatives",
    "NoPathError": "certainty resolution",
    "Plan": "energy energy_steady length turning lower_bound gap gap_of lower_bound_steady "
    "planning_time planner potential effort "
    "effort_limit cost soft_cost breakdown notes goal_reached",
    "Residual": "rmse mae bias energy_error",
    "Round": "energy_predicted energy_interval energy_measured error overhead effects length note",
    "Segment": "start goal departure energy peak_power peak_current",
    "TaskReport": "name verdict reason reachable_alone energy energy_upper soc_after shortfall "
    "detail remedy remedies arrival departure soc_lower start start_upper",
    "TreadICR": "left right longitudinal",
}
"""What is shown of a type, where that is not all of its fields."""
DEPRECATED = {"energy": "energy at steady speeds; use energy_driven, or energy_steady for this one"}
"""Keys of a plan that go with the next release, and what to use instead."""
TOGETHER = "headline energy energy_upper duration feasible chargers proven gap warnings"
"""What is shown of a mission of several robots as a whole."""


def shown(kind: type) -> list[str]:
    """Return the names of what is shown of a type."""
    names = SHOWN.get(kind.__name__)
    return [item.name for item in fields(kind)] if names is None else names.split()


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
    kind = type(value)
    if kind.__name__ in SHOWN or is_dataclass(kind):
        return {name: plain(getattr(value, name)) for name in shown(kind)}
    return value


def terms(model: PowerModel) -> list[Document]:
    """Return the terms of a model with their coefficients and standard errors."""
    return [
        {"name": term.name, "symbol": term.symbol, "value": plain(float(value)),
         "unit": term.unit, "std_error": plain(model.std_error(term.name))}
        for term, value in zip(model.terms, model.coefficients, strict=True)
    ]  # fmt: skip


def _icr(found: TreadICR, spread: Mapping[str, float] | None) -> Document:
    return {**plain(found), "std_error": plain(spread)}


def identification(found: Identification) -> Document:
    """Return what ``energyplan identify --json`` prints."""
    icr = _icr(found.icr, found.icr_std_error)
    return {"terms": terms(found.model), "icr": icr, **plain(found)}


def tasks(found: TaskFit, history: Mapping[str, FloatArray]) -> Document:
    """Return what ``energyplan identify --json`` prints of a history of tasks."""
    whole = float(np.nansum(history["energy"]))
    return {
        "terms": terms(found.model),
        "icr": _icr(found.model.vehicle.icr, None),
        "tasks": len(found.energies),
        "residual": {"relative": found.spread, "energy_error": plain(
            float(found.energies.sum()) / whole - 1.0)},
        "warnings": list(found.warnings),
    }  # fmt: skip


def icr(found: ICREstimate) -> Document:
    """Return what ``energyplan identify --spin --json`` prints."""
    return {"icr": _icr(found.icr, found.std_error), **plain(found)}


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
        "checks": plain(result.checks),
        "notes": list(result.notes),
    }


def occupancy(grid: OccupancyGrid) -> Document:
    """Return what ``energyplan start --json`` prints of the image of a map."""
    unknown = np.zeros_like(grid.occupied) if grid.unknown is None else grid.unknown
    shares = {
        "free": ~(grid.occupied | unknown), "occupied": grid.occupied,
        "unknown": unknown & ~grid.occupied,
    }  # fmt: skip
    return {
        "rows": grid.shape[0], "columns": grid.shape[1], "resolution": grid.resolution,
        "size": plain(grid.size), **{name: float(cells.mean()) for name, cells in shares.items()},
    }  # fmt: skip


def diagnosis(report: Diagnosis) -> Document:
    """Return what ``energyplan diagnose --json`` prints."""
    if report.no_probability is not None:
        report = replace(
            report,
            effects=tuple(replace(one, probability=math.nan) for one in report.effects),
            explanations=tuple(replace(one, probability=math.nan) for one in report.explanations),
        )
    return {**plain(report), "terms": terms(report.model)}


def plan(result: Plan, run: BatteryRun | None = None) -> Document:
    """Return what ``energyplan plan --json`` prints; `run` is what it does to a battery."""
    drive = None if result.why_not_driven else result.driven
    driven = {"energy_driven": "energy", "duration": "duration", "speed": "speed",
              "speed_priced": "speed_priced", "breakdown_driven": "breakdown"}  # fmt: skip
    return {
        **plain(result),
        "reverse_length": plain(result.path.reverse_length),
        "path": plain(result.path.poses()),
        **{key: plain(getattr(drive, name, None)) for key, name in driven.items()},
        "battery": plain(run),
        "notes": list(result.all_notes),
        "deprecated": DEPRECATED,
    }


def no_path(error: NoPathError) -> Document:
    """Return what ``energyplan plan --json`` prints where there is no path."""
    return {"path": None, "reason": str(error), **plain(error)}


def comparison(
    result: Comparison, least: BatteryRun | None = None, shortest: BatteryRun | None = None
) -> Document:
    """Return what ``energyplan compare --json`` prints; with what both plans do to a battery."""
    return {
        "energy_optimal": plan(result.energy_optimal, least),
        "shortest": plan(result.shortest, shortest),
        "saving": plain(result.saving),
        "saving_of": "energy_driven" if result.driven else "energy_steady",
    }


def energy_map(found: EnergyMap, areas: Sequence[Contour]) -> Document:
    """Return what ``energyplan range --json`` prints."""
    return {
        "area": plain(found.reachable(float(np.finfo(float).max))),
        **plain(found),
        "contours": [{"energy": plain(a.energy), "area": plain(a.area.area)} for a in areas],
    }


def feasibility(report: FeasibilityReport, run: BatteryRun | None = None) -> Document:
    """Return what ``energyplan check --json`` prints; `run` is what it does to a battery."""
    return {**plain(report), "battery": plain(run)}


def mission(report: MissionReport, trajectories: bool = False) -> Document:
    """Return what ``energyplan mission --json`` prints; with the legs' trajectories if wanted.

    Of several robots each has the same keys, but for its own name.
    """
    places, rows = {task.name: task.options[0] for task in report.mission.tasks}, report.rows

    def where(name: str) -> Document:
        row = rows.get(name)
        if row is None:
            return {"pose": plain(places[name].entry), "path": plain(places[name].points)}
        return {"pose": plain(row.start), "path": plain(row.vertices)}

    found = {
        "tasks": [{**plain(task), **where(task.name)} for task in report.tasks],
        **(_of_robots(report, trajectories) if report.robots else plain(report)),
    }
    if not report.robots:
        found["legs"] = [_leg(leg, trajectories) for leg in report.legs]
    return found


def _of_robots(report: MissionReport, trajectories: bool) -> Document:
    """Return what several robots have together, and what each does."""
    required = {task.name: task.required for task in report.mission.tasks}
    return {
        **{name: plain(getattr(report, name)) for name in TOGETHER.split()},
        "robots": [
            {"name": one.mission.name, **mission(one, trajectories), "waiting": plain(one.waiting)}
            for one in report.robots
        ],
        "left_out": [
            {
                "name": task.name,
                "required": required[task.name],
                "reasons": list(task.reasons),
                "detail": task.detail,
            }
            for task in report.left_out
        ],
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
    """Return a leg, with its trajectory as columns over its time if wanted."""
    drive = leg.trajectory
    report = {**plain(leg), "duration": plain(drive.duration)}
    if trajectory:
        columns = {name: getattr(drive, name) for name in ("t", "x", "y", "yaw", "v", "omega")}
        columns |= {"soc": leg.soc, "soc_lower": leg.soc_lower}
        report["trajectory"] = {k: np.round(values, 6).tolist() for k, values in columns.items()}
    return report


def driven(result: Driven, secret: bool = False) -> Document:
    """Return what ``energyplan drive --json`` prints; what was taken not by term if `secret`."""
    return {
        **plain(result),
        "duration": plain(result.trajectory.duration),
        "terms": [
            {"name": name, "told": report} | ({} if secret else {"taken": taken})
            for name, report, taken in result.terms
            if report or not secret
        ],
    }


def loop(result: Loop) -> Document:
    """Return what ``energyplan close-the-loop --json`` prints."""
    return {
        "rounds": [
            {
                **plain(now),
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
        **plain(result),
        "probabilities_expected": [
            {"explanation": label, "if_true": plain(value)}
            for label, value in result.probabilities_expected
        ],
        "duration": plain(result.trajectory.duration),
    }
