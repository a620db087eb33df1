"""Vehicles, power models and projects as YAML files, checked key by key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from energyplan.errors import (
    ConfigError,
    DriveLogError,
    InvalidInputError,
    ModelError,
    UnknownNameError,
)
from energyplan.io.bags import TopicMap
from energyplan.io.documents import Checked, Document, load
from energyplan.io.files import atomic_write, is_file
from energyplan.logs.mapping import Column
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Residual, Term
from energyplan.power.effects import catalogue, term
from energyplan.records import Doubts, Finite, ReadOnly, Within, bounds, checked, doubts
from energyplan.vehicle import Mass, MotorLimits, Size, TreadICR, Vehicle, layout, predict_icr

T = TypeVar("T")


Pair = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Rows = Annotated[list[Pair], Field(min_length=3, max_length=100)]


class _Strict(Checked, BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Parts(Checked, BaseModel):
    """What a vehicle is built from, which its file may hold in addition to the vehicle's values."""

    kind: Literal["vehicle"] = "vehicle"
    preset: str | None = None
    mass: Mass | None = None
    cog: Pair | None = None
    wheelbase: Size | None = None
    track: Size | None = None
    length: Size | None = None
    width: Size | None = None


_SIZES = ("wheelbase", "track", "length", "width")
_ENDLESS = {
    k for one in (MotorLimits, Vehicle) for k, within in bounds(one).items() if within.endless
}


class ProjectFile(_Strict):
    """What a project's file holds; `energyplan.io.config` reads it."""

    kind: Literal["project"]
    name: str = "project"
    log: str | None = None
    vehicle: dict[str, Any]
    columns: dict[str, Column | str] = {}
    topics: dict[str, Any] | None = None
    defaults: dict[str, Any] = {}


class _TermEntry(_Strict):
    name: str
    value: Finite
    std_error: Finite | None = None
    symbol: str | None = None
    unit: str | None = None
    params: dict[str, Finite] = {}


class _Model(_Strict):
    kind: Literal["model"] = "model"
    name: str = "model"
    vehicle: dict[str, Any] | str
    terms: list[_TermEntry]
    covariance: list[list[Finite]] | None = None
    residual: Residual | None = None


@checked(ConfigError)
def read_vehicle(source: str | Path) -> Vehicle:
    """Return a vehicle: a preset's, or the one that a YAML file describes.

    A file gives ``contacts``, ``loads`` (or ``mass`` with ``cog``) and ``footprint``; or
    ``wheelbase``, ``track``, ``length``, ``width`` and ``mass`` of a symmetric vehicle; or
    ``preset`` with whatever differs from it. ``icr``, ``motor``, ``drive_efficiency``,
    ``regen_efficiency``, ``max_yaw_rate``, ``battery_power``, ``battery_return``,
    ``usual_speed``, ``tracking_tolerance`` and ``reverse`` may go with each. SI units. A motor
    without an acceleration limit gets `DEFAULT_ACCELERATION`. A project's file is read for the
    vehicle that it holds.

    Parameters
    ----------
    source : str or Path
        Name of a preset, or a ``.yaml`` file.

    Returns
    -------
    Vehicle
        The vehicle.

    Raises
    ------
    UnknownNameError
        If there is neither such a preset nor such a file.
    ConfigError
        If the file is malformed; the message names file, line and key.

    Examples
    --------
    >>> read_vehicle("husky_a200").name
    'husky_a200'
    """
    if not _is_file(source):
        return Vehicle.preset(str(source))
    document = load(source, ConfigError)
    if document.data.get("kind") == "project":
        document.check(ProjectFile)
        return _vehicle(document, "vehicle")
    _expect(document, "vehicle")
    return _vehicle(document)


@checked(ConfigError)
def read_model(source: str | Path) -> PowerModel:
    """Return a power model: a preset's, or the one that a YAML file holds.

    Parameters
    ----------
    source : str or Path
        Name of a preset, such as ``quadriga:full:marble``, or a ``.yaml`` file that `write_model`
        wrote.

    Returns
    -------
    PowerModel
        The model, with its vehicle, covariance and residual.

    Raises
    ------
    UnknownNameError
        If there is neither such a preset nor such a file.
    ConfigError
        If the file is malformed or names a term that does not exist; the message names file, line
        and key.

    Examples
    --------
    >>> read_model("quadriga:full:concrete").coefficient("traction_resistance")
    118.0
    """
    if not _is_file(source):
        return PowerModel.preset(str(source))
    document = load(source, ConfigError)
    _expect(document, "model")
    spec = document.check(_Model)
    if isinstance(spec.vehicle, str):
        vehicle = _placed(document, ("vehicle",), Vehicle.preset, spec.vehicle)
    else:
        vehicle = _vehicle(document, "vehicle")
    terms = tuple(_placed(document, ("terms", k), _term, item) for k, item in enumerate(spec.terms))
    covariance = None if spec.covariance is None else _square(document, spec.covariance)
    errors = [item.std_error for item in spec.terms if item.std_error is not None]
    if covariance is None and errors:
        if len(errors) < len(spec.terms):
            missing = next(k for k, item in enumerate(spec.terms) if item.std_error is None)
            raise document.fail(
                ("terms", missing), "give every term a std_error (0 where it is exact), or none"
            )
        # Standard errors alone, written by hand, say nothing of correlations.
        covariance = np.diag(np.square(errors))
    values = np.array([item.value for item in spec.terms])
    model = _placed(
        document,
        ("terms",),
        PowerModel,
        vehicle,
        terms,
        values,
        covariance,
        spec.residual,
        spec.name,
    )
    document.warn(_unusual_terms(model))
    return model


def _unusual_terms(model: PowerModel) -> Doubts:
    """Yield the coefficients that are larger than diagnosis would believe.

    A coefficient that is averaged over explanations may be as small as one likes.
    """
    believed = {SLIP.name: (0.0, 2.0), TRACTION.name: (0.0, 1e4)}
    for effect in catalogue().values():
        if len(effect.terms) == 1:
            low, high = effect.limits(model.vehicle)
            believed[effect.terms[0].name] = min(low, 0.0), high
    for k, (one, value) in enumerate(zip(model.terms, model.coefficients, strict=True)):
        typical = believed.get(one.name, (-inf, inf))
        _, text = Within((-inf, inf), typical, one.unit).unusual(value)
        if text:
            yield ("terms", k, "value"), text


def write_vehicle(vehicle: Vehicle, path: str | Path) -> Path:
    """Write a vehicle as YAML, whole or not at all."""
    return _dump({"kind": "vehicle", **plain_vehicle(vehicle)}, path)


@checked()
def write_model(model: PowerModel, path: str | Path) -> Path:
    """Write a power model with its vehicle as YAML, whole or not at all.

    Parameters
    ----------
    model : PowerModel
        The model.
    path : str or Path
        The file, which `read_model` reads.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If a term is not known by its name, so that the file could not be read again.
    InvalidInputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> model = PowerModel.preset("quadriga:full:concrete")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = read_model(write_model(model, Path(folder) / "model.yaml"))
    >>> again.coefficient("slip_friction") == model.coefficient("slip_friction")
    True
    """
    return atomic_write(path, model_text(model))


def model_text(model: PowerModel) -> str:
    """Return what the file of a model holds."""
    terms = []
    for item, value in zip(model.terms, model.coefficients, strict=True):
        try:
            term(item.name)
        except UnknownNameError as problem:
            raise ConfigError(
                f"the model {model.name!r} cannot be written: {problem}; publish the term through "
                "the entry-point group energyplan.power.effects"
            ) from None
        entry: dict[str, Any] = {"name": item.name, "value": float(value)}
        error = model.std_error(item.name)
        entry |= {} if error is None else {"std_error": error}
        entry |= {"symbol": item.symbol, "unit": item.unit}
        entry |= {"params": _plain(item.params)} if item.params else {}
        terms.append(entry)
    data: dict[str, Any] = {
        "kind": "model",
        "name": model.name,
        "terms": terms,
        "vehicle": plain_vehicle(model.vehicle),
    }
    if model.covariance is not None:
        data["covariance"] = model.covariance.tolist()
    if model.residual is not None:
        values = vars(model.residual).items()
        data["residual"] = {k: float(v) for k, v in values if v is not None}
    return _text(data)


def _is_file(source: str | Path) -> bool:
    """Whether a file is meant, rather than a preset."""
    return isinstance(source, Path) or source.endswith((".yaml", ".yml")) or is_file(source)


def _expect(document: Document, kind: str) -> None:
    """Refuse a file of another kind."""
    stated = document.data.get("kind", kind)
    if stated != kind:
        raise document.fail(("kind",), f"this file holds a {stated!r}, where a {kind} is needed")


def _placed(
    document: Document, loc: tuple[int | str, ...], build: Callable[..., T], *args: Any
) -> T:
    """Build something; a complaint gets the place in the file."""
    try:
        return build(*args)
    except InvalidInputError as problem:
        raise document.fail((*loc, *problem.place), str(problem)) from None


def _vehicle(document: Document, *loc: str) -> Vehicle:
    """Build the vehicle that a file describes: of a preset, of dimensions, or wheel by wheel."""
    whole = document.data[loc[0]] if loc else document.data
    given = {key: value for key, value in whole.items() if value is not None or key in _ENDLESS}
    spec, sizes = document.check(_Parts, loc), {*_SIZES} & {*given}
    rows = document.check(Rows, (*loc, "contacts")) if "contacts" in given else []
    clash, need, values = set[str](), set[str](), dict[str, Any]()
    if spec.preset is not None:
        ready = _placed(document, (*loc, "preset"), Vehicle.preset, spec.preset)
        values = {part.name: getattr(ready, part.name) for part in fields(ready)}
        clash = sizes
    elif sizes:
        clash, need = {"contacts", "footprint", "loads"} & {*given}, {"name", "mass", *_SIZES}
    else:
        need = {"name", "contacts", "footprint", "mass" if "mass" in given else "loads"}
        need |= {"icr"} if len(rows) != 4 else set()
    if lacking := sorted(need - {*given}):
        raise document.fail(
            (*loc, lacking[0]),
            "the key is missing; a vehicle is a preset with changes, or contacts, loads (or mass "
            "and cog) and footprint, or mass, wheelbase, track, length and width"
            + document.another_kind(Vehicle),
        )
    if "loads" in given and {"mass", "cog"} & {*given}:
        clash |= {"loads"}
    if clash:
        raise document.fail((*loc, min(clash)), "the key contradicts the others; leave it out")
    if sizes:
        values["contacts"], values["footprint"] = layout(*(getattr(spec, key) for key in _SIZES))
    elif rows:
        values["contacts"] = rows
    contacts = np.asarray(values["contacts"])
    if "icr" not in values and "icr" not in given:
        reach = predict_icr(*np.ptp(contacts, axis=0))
        values["icr"] = _placed(document, loc, TreadICR.symmetric, reach)
    values.setdefault("loads", np.ones(len(contacts)))
    own = {key: _endless(key, value) for key, value in given.items()}
    if isinstance(own.get("motor"), dict):
        own["motor"] = vars(values.get("motor", MotorLimits())) | {
            key: _endless(key, value) for key, value in own["motor"].items()
        }
    values |= {key: value for key, value in own.items() if key not in _Parts.model_fields}
    built = replace(document, data={**document.data, loc[0]: values} if loc else values)
    vehicle = built.check(Vehicle, loc)
    if spec.mass is not None or spec.cog is not None:
        mass = vehicle.mass if spec.mass is None else spec.mass
        vehicle = _placed(document, loc, vehicle.with_mass, mass, spec.cog or (0.0, 0.0))
    document.warn(_unusual(own), loc)
    return vehicle


def _endless(key: str, value: Any) -> Any:
    """Read ``inf`` and ``null`` as no limit, where there may be none."""
    return inf if key in _ENDLESS and (value is None or value == "inf") else value


def _unusual(given: Mapping[str, Any]) -> Doubts:
    """Yield the unusual values of a file's vehicle."""
    yield from doubts(Vehicle.from_geometry, given)
    yield from doubts(Vehicle, given)
    for name, kind in (("motor", MotorLimits), ("icr", TreadICR)):
        for at, text in doubts(kind, given.get(name, {})):
            yield (name, *at), text


def _term(item: _TermEntry) -> Term:
    """Return the catalogue's term with a file's parameters."""
    known = term(item.name)
    if item.unit is not None and item.unit != known.unit:
        raise ModelError(f"the unit of {item.name} is {known.unit!r}, not {item.unit!r}")
    stray = set(item.params) - set(known.params)
    if known.params and stray:
        raise UnknownNameError(f"parameter of {item.name}", sorted(stray)[0], known.params)
    return replace(known, params={**known.params, **item.params})


def _square(document: Document, rows: list[list[float]]) -> FloatArray:
    for k, row in enumerate(rows):
        if len(row) != len(rows):
            raise document.fail(("covariance", k), f"the row has {len(row)} of {len(rows)} values")
    return np.array(rows)


def _plain(value: Any) -> Any:
    """Return a value as YAML knows it; no limit is ``.inf``."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    return value if isinstance(value, str | bool) else float(value)


def plain_vehicle(vehicle: Vehicle) -> dict[str, Any]:
    """Return a vehicle as a YAML file holds it."""
    return dict(_plain(asdict(vehicle)))


def _dump(data: dict[str, Any], path: str | Path) -> Path:
    return atomic_write(path, _text(data))


def _text(data: dict[str, Any]) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)


@dataclass(frozen=True)
class Project(ReadOnly):
    """How a robot's logs are read, and the robot."""

    name: str  # what to call it
    vehicle: Vehicle  # the robot
    columns: Mapping[str, Column] = field(default_factory=lambda: MappingProxyType({}))
    topics: TopicMap | None = None  # which field of a bag serves as which channel
    log: str = ""  # name of the log that the project was created from
    defaults: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def read_project(path: str | Path) -> Project:
    """Read a project."""
    document = load(path, ConfigError)
    if document.data.get("kind") != "project":
        raise document.fail(
            ("kind",),
            "this file holds no project; energyplan start LOG --out FILE.yaml makes one",
        )
    spec = document.check(ProjectFile)
    columns: dict[str, Column] = {}
    for channel, item in spec.columns.items():
        one = Column(field=item) if isinstance(item, str) else item
        try:
            columns[channel] = one.changed(channel=channel)
        except DriveLogError as problem:
            raise document.fail(("columns", channel), str(problem)) from None
    topics = None if spec.topics is None else TopicMap.model_validate(spec.topics)
    return Project(
        spec.name, read_vehicle(Path(path)), columns, topics, spec.log or "", spec.defaults
    )


def read_columns(path: str | Path) -> dict[str, Column]:
    """Read which column serves as which channel from a project's file."""
    project = read_project(path)
    if not project.columns:
        raise ConfigError(f"{path}: the project has no columns: it was made from a bag")
    return dict(project.columns)


def write_project(project: Project, path: str | Path) -> Path:
    """Write a project as YAML, whole or not at all."""
    data = {
        "kind": "project", "name": project.name, "log": project.log,
        "vehicle": plain_vehicle(project.vehicle),
        "columns": {channel: column.described() for channel, column in project.columns.items()},
        "topics": None if project.topics is None else project.topics.described(),
        "defaults": dict(project.defaults),
    }  # fmt: skip
    return _dump({key: value for key, value in data.items() if value}, path)
