"""What a node tells besides paths: diagnostics, and whether a mission can be done."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from energyplan.errors import EnergyPlanError
from energyplan.io.mission import mission_from
from energyplan.mission import evaluate
from energyplan.output import documents
from energyplan.power import PowerModel
from energyplan.ros.messages import Factory
from energyplan.ros.nav2 import Answer


def plan_values(answer: Answer) -> dict[str, str]:
    """Return the values of a plan for diagnostics: energy, bound [J] and the time it took [s]."""
    if not answer.plans:
        return {"error": answer.message}
    return {
        "energy [J]": f"{answer.energy:.6g}",
        "lower bound [J]": f"{answer.lower_bound:.6g}",
        "length [m]": f"{sum(plan.length for plan in answer.plans):.6g}",
        "planning time [s]": f"{answer.planning_time:.3g}",
        **{f"note {k}": note for k, note in enumerate(answer.notes, start=1)},
    }


def model_values(model: PowerModel) -> dict[str, str]:
    """Return the values of a model for diagnostics: each coefficient, with its standard error."""
    values = {}
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        error = model.std_error(term.name)
        told = f"{value:.5g}" + ("" if error is None else f" +- {error:.2g}")
        values[f"{term.name} [{term.unit}]"] = told
    return values


def diagnostics_message(
    name: str, message: str, values: Mapping[str, str], stamp: Any, factory: Factory,
    *, error: bool = False,
) -> Any:  # fmt: skip
    """Return a diagnostic_msgs/DiagnosticArray with one status."""
    status = factory("diagnostic_msgs/msg/DiagnosticStatus")
    pair = factory("diagnostic_msgs/msg/KeyValue")
    level: Any = getattr(status, "ERROR" if error else "OK")
    one = status(
        level=level,
        name=name,
        message=message,
        hardware_id="",
        values=[pair(key=key, value=value) for key, value in values.items()],
    )
    header = factory("std_msgs/msg/Header")(stamp=stamp, frame_id="")
    return factory("diagnostic_msgs/msg/DiagnosticArray")(header=header, status=[one])


def mission_answer(text: str, folder: str | Path) -> str:
    """Tell whether a mission can be done, text in and text out."""
    try:
        return json.dumps(documents.mission(evaluate(mission_from(text, folder))))
    except EnergyPlanError as error:
        return json.dumps({"error": " ".join(str(error).split())})
