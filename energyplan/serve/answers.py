"""What answers hold, for those who write clients: taken from the types of the results."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache, cached_property
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, create_model
from typing_extensions import TypedDict

from energyplan.battery import BatteryRun
from energyplan.diagnosis import Diagnosis
from energyplan.fit import Identification
from energyplan.limits.feasibility import FeasibilityReport
from energyplan.logs.consistency import Check
from energyplan.mission import Charger, MissionReport, Segment, Task, TaskReport
from energyplan.output.documents import SHOWN, TOGETHER, shown
from energyplan.planning import Plan
from energyplan.reach import EnergyMap
from energyplan.serve.store import KINDS
from energyplan.vehicle import TreadICR

Number = float | None
"""A number; null where there is none."""


class Coefficient(TypedDict):
    """A term of a power model, with its coefficient."""

    name: str
    symbol: str
    value: float
    unit: str
    std_error: Number


class Preset(TypedDict):
    """A preset model, which was not measured on the robot."""

    name: str
    measured: bool
    source: str


def _hint(kind: type, key: str) -> Any:
    """Return the type of a field or a property."""
    member = getattr(kind, key, None)
    if isinstance(member, property):
        holder, name = member.fget, "return"
    elif isinstance(member, cached_property):
        holder, name = member.func, "return"
    else:
        holder, name = next(one for one in kind.__mro__ if key in vars(one)["__annotations__"]), key
    found = holder.__annotations__[name]
    names = vars(sys.modules[holder.__module__])
    try:
        return eval(found, names) if isinstance(found, str) else found
    except NameError:  # of a module that is imported for type checking alone
        return Any


def _plain(hint: Any) -> Any:
    """Return the type of what `energyplan.output.documents.plain` makes of a value of a type."""
    kind: Any = get_origin(hint) or hint
    parts = get_args(hint)
    if kind is Annotated:
        return _plain(parts[0])
    if hint is float:
        return Number
    if hint in (int, str, bool, NoneType) or kind is Literal:
        return hint
    if kind in (Union, UnionType):
        return Union[tuple(map(_plain, parts))]  # noqa: UP007
    if not isinstance(kind, type):
        return Any
    if issubclass(kind, Mapping):
        return GenericAlias(dict, (str, _plain(parts[1]))) if parts else dict[str, Any]
    if issubclass(kind, np.ndarray | tuple | list):
        return _list(_plain(parts[0])) if parts[1:] == (...,) else list[Any]
    seen: Any = kind
    return shape(seen) if kind.__name__ in SHOWN or is_dataclass(kind) else Any


def _list(kind: Any) -> Any:
    return GenericAlias(list, (kind,))


@cache
def shape(kind: Any) -> Any:
    """Return what is shown of a type."""
    return _record(kind.__name__, **{key: _plain(_hint(kind, key)) for key in shown(kind)})


def _record(title: str, base: Any = BaseModel, /, **keys: Any) -> Any:
    """Return a type with more keys than its base; they are required unless a default is given."""
    fields: Any = {key: one if isinstance(one, tuple) else (one, ...) for key, one in keys.items()}
    return create_model(title, __base__=base, **fields)


_PRESET: dict[str, Any] = {"preset": (list[Preset], [])}
_BESIDE: dict[str, Any] = {**_PRESET, "notes": (list[str], [])}
_Terms = {"terms": list[Coefficient], "model_file": str}
_Areas = dict[str, Any]  # GeoJSON
_ICR = _record("ICR", shape(TreadICR), std_error=dict[str, Number] | None)
_NoPath = _record("NoPath", path=None, reason=str, certainty=str, resolution=Number, **_BESIDE)
_Battery: Any = shape(BatteryRun) | None
_Plan = _record(
    "Plan", shape(Plan), reverse_length=float, path=list[list[float]], energy_driven=Number,
    duration=Number, speed=Number, speed_priced=Number, deprecated=dict[str, str],
    breakdown_driven=dict[str, float] | None, battery=_Battery, **_PRESET,
)  # fmt: skip
_Leg = _record("Leg", shape(Segment), duration=float, trajectory=dict[str, list[Number]])
_trip = {"legs": _list(_Leg), "timeline": dict[str, list[Number]]}
_task = _record("TaskReport", shape(TaskReport), pose=list[float], path=list[list[float]])
_robot = _record(
    "Robot", shape(MissionReport), name=str, waiting=float, tasks=_list(_task), **_trip
)
_together = {key: _plain(_hint(MissionReport, key)) for key in TOGETHER.split()}
_left_out = _record("LeftOut", name=str, required=bool, reasons=list[str], detail=str)

PLAN = _Plan | _NoPath
COMPARISON = _record(
    "Comparison", energy_optimal=_Plan, shortest=_Plan, saving=float, saving_of=str, **_BESIDE
) | _NoPath  # fmt: skip
RANGE = _record(
    "EnergyMap", shape(EnergyMap), area=float, areas=_Areas,
    contours=_list(_record("Level", energy=float, area=float)), **_BESIDE,
)  # fmt: skip
CHECK = _record("FeasibilityReport", shape(FeasibilityReport), battery=_Battery, **_BESIDE)
MISSION = _record(
    "Mission", shape(MissionReport), tasks=_list(_task), **_trip, **_PRESET
) | _record(
    "MissionOfRobots", **_together, tasks=_list(_task), robots=_list(_robot),
    left_out=_list(_left_out), **_PRESET,
)  # fmt: skip
IDENTIFICATION = _record("Identification", shape(Identification), icr=_ICR, **_Terms)
DIAGNOSIS = _record("Diagnosis", shape(Diagnosis), **_Terms)
START = _record(
    "Start", columns=dict[str, str], units=dict[str, str], topics=dict[str, Any] | None,
    vehicle=dict[str, Any], defaults=dict[str, Any], checks=_list(shape(Check)), notes=list[str],
    sound=bool,
)  # fmt: skip
MAP = _record("Map", rows=int, columns=int, resolution=float, origin=list[float], image=str)
PREPARED = _record(
    "Prepared", document=dict[str, Any], start=list[float], soc=float, reserve=float,
    coefficient_spread=Number, tasks=_list(shape(Task)), chargers=_list(shape(Charger)),
    robots=_list(_record("RobotStart", name=str, start=list[float])), map=MAP, areas=_Areas,
)  # fmt: skip
FILES = _record(
    "Files",
    **dict.fromkeys(KINDS, list[str]),
    unreadable=dict[str, str],
    presets=dict[str, list[str]],
    planners=list[str],
)
HEALTH = _record("Health", version=str, workers=int, load=int)
SAVED = _record("Saved", name=str, bytes=int)
PROBLEM = _record("Problem", type=str, title=str, status=int, detail=str)
