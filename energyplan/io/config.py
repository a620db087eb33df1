"""Vehicles, power models and projects as YAML files, checked key by key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from energyplan.errors import (
    ConfigError,
    DriveLogError,
    InvalidInputError,
    ModelError,
    UnknownNameError,
    VehicleError,
)
from energyplan.io.bags import TopicMap
from energyplan.io.documents import Checked, Document, load
from energyplan.io.files import atomic_write, is_file
from energyplan.kinds import Doubts, Within, check_sizes, checked, doubts
from energyplan.logs.mapping import Column
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Residual, Term
from energyplan.power.effects import catalogue, term
from energyplan.records import ReadOnly
from energyplan.vehicle import (
    DEFAULT_ACCELERATION,
    MotorLimits,
    TreadICR,
    Vehicle,
    layout,
    predict_icr,
    wheel_loads,
)

T = TypeVar("T")


def _infinite(value: Any) -> Any:
    """Read ``inf`` and ``null`` as no limit."""
    return inf if value is None or value == "inf" else value


Number = Annotated[float, Field(allow_inf_nan=False)]
Limit = Annotated[float, BeforeValidator(_infinite)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]


class _Strict(Checked, BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _ICR(_Strict):
    left: Number
    right: Number
    longitudinal: Number = 0.0


class _Motor(_Strict):
    continuous_power: Limit = inf
    peak_power: Limit = inf
    thermal_time: Limit = 30.0
    force: Limit = inf
    speed: Limit = inf
    acceleration: Limit = DEFAULT_ACCELERATION
    regeneration: Limit = inf


class _Vehicle(_Strict):
    """A vehicle: a preset with changes, wheel by wheel, or symmetric from its dimensions."""

    kind: Literal["vehicle"] = "vehicle"
    preset: str | None = None
    name: str | None = None
    contacts: Annotated[list[Pair], Field(min_length=3, max_length=100)] | None = None
    loads: list[Number] | None = None
    footprint: Annotated[list[Pair], Field(min_length=2, max_length=2)] | None = None
    mass: Number | None = None
    cog: Pair | None = None
    wheelbase: Number | None = None
    track: Number | None = None
    length: Number | None = None
    width: Number | None = None
    icr: _ICR | None = None
    motor: _Motor | None = None
    drive_efficiency: Number | None = None
    regen_efficiency: Number | None = None
    max_yaw_rate: Limit | None = None
    battery_power: Limit | None = None
    battery_return: Limit | None = None
    usual_speed: Limit | None = None
    tracking_tolerance: Number | None = None
    reverse: bool | None = None


class ProjectFile(_Strict):
    """What a project's file holds; `energyplan.io.config` reads it."""

    kind: Literal["project"]
    name: str = "project"
    log: str | None = None
    vehicle: _Vehicle
    columns: dict[str, Column | str] = {}
    topics: dict[str, Any] | None = None
    defaults: dict[str, Any] = {}


class _Term(_Strict):
    name: str
    value: Number
    std_error: Number | None = None
    symbol: str | None = None
    unit: str | None = None
    params: dict[str, Number] = {}


class _Residual(_Strict):
    rmse: Number
    mae: Number
    bias: Number
    energy_error: Annotated[float, Field(ge=-inf)]  # infinite where no energy was measured
    correlation_time: Number = 0.0
    duration: Number = 0.0
    run_spread: Number | None = None


class _Model(_Strict):
    kind: Literal["model"] = "model"
    name: str = "model"
    vehicle: _Vehicle | str
    terms: list[_Term]
    covariance: list[list[Number]] | None = None
    residual: _Residual | None = None


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
        return _vehicle(document.check(ProjectFile).vehicle, document, ("vehicle",))
    _expect(document, "vehicle")
    return _vehicle(document.check(_Vehicle), document, ())


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
        vehicle = _vehicle(spec.vehicle, document, ("vehicle",))
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
    residual = None if spec.residual is None else Residual(**spec.residual.model_dump())
    values = np.array([item.value for item in spec.terms])
    model = _placed(
        document, ("terms",), PowerModel, vehicle, terms, values, covariance, residual, spec.name
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
        usual = believed.get(one.name, (-inf, inf))
        _, text = Within((-inf, inf), usual, one.unit).doubt(value)
        if text:
            yield ("terms", k, "value"), f"{value:.6g} is unusual; {text}"


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
        entry |= {"params": {k: _plain(v) for k, v in item.params.items()}} if item.params else {}
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
        told = vars(model.residual).items()
        data["residual"] = {k: float(v) for k, v in told if v is not None}
    return _text(data)


def _is_file(source: str | Path) -> bool:
    """Whether a file is meant, rather than a preset."""
    return isinstance(source, Path) or source.endswith((".yaml", ".yml")) or is_file(source)


def _expect(document: Document, kind: str) -> None:
    """Refuse a file of another kind."""
    told = document.data.get("kind", kind)
    if told != kind:
        raise document.fail(("kind",), f"this file holds a {told!r}, where a {kind} is needed")


def _placed(
    document: Document, loc: tuple[int | str, ...], build: Callable[..., T], *args: Any
) -> T:
    """Build something; a complaint gets the place in the file."""
    try:
        return build(*args)
    except InvalidInputError as problem:
        raise document.fail((*loc, *problem.place), str(problem)) from None


def _vehicle(spec: _Vehicle, document: Document, loc: tuple[int | str, ...]) -> Vehicle:
    """Build the vehicle that a file describes."""
    given = {key for key, value in spec if value is not None} - {"kind"}
    wheels = {"contacts", "footprint"}
    sizes = {"wheelbase", "track", "length", "width"}
    if spec.preset is not None:
        base = _vehicle_fields(_placed(document, (*loc, "preset"), Vehicle.preset, spec.preset))
        clash = given & sizes
        need: set[str] = set()
    elif given & sizes:
        base, clash, need = {}, given & (wheels | {"loads"}), {"name", "mass", *sizes}
    else:
        weighed = {"loads"} if "mass" not in given else {"mass"}
        base, clash, need = {}, set(), {"name", *wheels, *weighed}
        need |= {"icr"} if len(spec.contacts or ()) != 4 else set()
    if need - given:
        raise document.fail(
            (*loc, sorted(need - given)[0]),
            "the key is missing; a vehicle is a preset with changes, or contacts, loads (or mass "
            "and cog) and footprint, or mass, wheelbase, track, length and width",
        )
    if "loads" in given and given & {"mass", "cog"}:
        clash = clash | {"loads"}
    if clash:
        raise document.fail(
            (*loc, sorted(clash)[0]), "the key contradicts the others; leave it out"
        )
    vehicle = _placed(document, loc, _built, spec, base)
    document.warn(_unusual(spec), loc)
    return vehicle


_DIMENSIONS = Vehicle.from_geometry
"""Its arguments are keys of a vehicle's file."""


def _unusual(spec: _Vehicle) -> Doubts:
    """Yield the unusual values of a file's vehicle."""
    yield from doubts(_DIMENSIONS, vars(spec))
    yield from doubts(Vehicle, vars(spec))
    for name, part, kind in (("motor", spec.motor, MotorLimits), ("icr", spec.icr, TreadICR)):
        if part is not None:
            yield from (((name, *at), text) for at, text in doubts(kind, vars(part)))


_SINGLE = (
    "drive_efficiency", "regen_efficiency", "max_yaw_rate", "battery_power", "battery_return",
    "usual_speed", "tracking_tolerance", "reverse",
)  # fmt: skip
"""Keys of a vehicle that hold one value each."""


def _built(spec: _Vehicle, base: dict[str, Any]) -> Vehicle:
    """Build a vehicle from a file's values upon those of its preset."""
    told: dict[str, Any] = {
        key: getattr(spec, key) for key in ("name", *_SINGLE) if getattr(spec, key) is not None
    }
    check_sizes(_DIMENSIONS, vars(spec), VehicleError)
    if spec.icr is not None:
        told["icr"] = _part("icr", TreadICR, spec.icr.model_dump())
    if spec.motor is not None:
        known = vars(base["motor"]) if "motor" in base else {}
        values = {**known, **spec.motor.model_dump(exclude_unset=True)}
        told["motor"] = _part("motor", MotorLimits, values)
    cog = spec.cog or (0.0, 0.0)
    if spec.wheelbase is not None:
        keys = ("wheelbase", "track", "length", "width")
        told["contacts"], told["footprint"] = layout(*(getattr(spec, key) for key in keys))
    for key in ("contacts", "loads", "footprint"):
        if getattr(spec, key) is not None:
            told[key] = np.array(getattr(spec, key), float)
    values = {**base, **told}
    contacts = np.asarray(values["contacts"])
    if "icr" not in values:
        values["icr"] = TreadICR.symmetric(predict_icr(*np.ptp(contacts, axis=0)))
    if spec.mass is None and spec.cog is None:
        return Vehicle(**values)
    mass = Vehicle(**values).mass if spec.mass is None else spec.mass
    return Vehicle(**{**values, "loads": wheel_loads(contacts, mass, cog)})


def _part(name: str, build: Callable[..., T], values: Mapping[str, Any]) -> T:
    """Build a part of a vehicle; a complaint gets its place in it."""
    try:
        return build(**values)
    except VehicleError as problem:
        raise VehicleError(str(problem), (name, *problem.place)) from None


def _term(item: _Term) -> Term:
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


def _vehicle_fields(vehicle: Vehicle) -> dict[str, Any]:
    return {field.name: getattr(vehicle, field.name) for field in fields(vehicle)}


def _plain(value: Any) -> Any:
    """Return a value as YAML knows it; no limit is ``.inf``."""
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    return value if isinstance(value, str) else float(value)


def plain_vehicle(vehicle: Vehicle) -> dict[str, Any]:
    """Return a vehicle as a YAML file holds it."""
    found = _vehicle_fields(vehicle)
    for key in ("icr", "motor"):
        found[key] = {k: float(v) for k, v in vars(found[key]).items()}
    return {k: v if isinstance(v, dict) else _plain(v) for k, v in found.items()}


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
    log: str = ""  # name of the log that the project was made from
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
