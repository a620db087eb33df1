"""Missions as YAML files; every complaint names the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator

from energyplan.battery import EXAMPLE, Battery
from energyplan.errors import EnergyPlanError, MissionError, UnknownNameError
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.documents import Checked, Document, Loc, beside, load, parse
from energyplan.io.files import bundled, is_file
from energyplan.io.maps import PARTS, SiteFile, read_site
from energyplan.kinds import amount, checked
from energyplan.mission import Charger, Mission, Spreads, Task
from energyplan.mission.types import Fraction, Mass, Place, Time, Uncertain, amount_of, uncertain
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import Site, with_weights
from energyplan.vehicle import Vehicle

T = TypeVar("T")

Amps = Annotated[float, amount_of("charge")]
Speed = Annotated[
    float | Literal["cheapest"],
    BeforeValidator(lambda value: value if value == "cheapest" else amount("speed", value)),
]
Ohms = Annotated[float, amount_of("resistance")]
Volts = Annotated[float, amount_of("voltage")]
Current = Annotated[float, amount_of("current")]


def _open(kind: str) -> PlainValidator:
    return PlainValidator(partial(uncertain, kind))


OpenTime = Annotated[Uncertain, _open("time")]
OpenCharge = Annotated[Uncertain, _open("charge")]
OpenFraction = Annotated[Uncertain, _open("fraction")]
OpenTemperature = Annotated[Uncertain, _open("temperature")]


def _is_yaml(name: str) -> bool:
    """Whether a file is meant, rather than a preset."""
    return name.endswith((".yaml", ".yml"))


class _Strict(Checked, BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Battery(_Strict):
    """A preset or words, or a pack of units, with whatever differs from it."""

    preset: str | None = None
    chemistry: str | None = None
    series: int | None = None
    parallel: int | None = None
    unit_capacity: Amps | None = None
    unit_resistance: Ohms | None = None
    capacity: OpenCharge | None = None
    resistance: Ohms | None = None
    pair_resistance: Ohms | None = None
    pair_time: Time | None = None
    peukert: float | None = None
    rated_current: Current | None = None
    charge_efficiency: Fraction | None = None
    cutoff_voltage: Volts | None = None
    cutoff_soc: Fraction | None = None
    usable: Fraction | None = None
    max_voltage: Volts | None = None
    max_discharge_current: Current | None = None
    max_charge_current: Current | None = None
    temperature: OpenTemperature | None = None
    health: OpenFraction | None = None


class _Mission(SiteFile, _Strict):
    name: str = ""
    vehicle: str | None = None
    model: str
    payload_models: dict[str, dict[float, str]] = {}
    battery: str | _Battery
    soc: OpenFraction = Uncertain(1.0)
    start: Place
    home: Place | None = None
    places: dict[str, Place] = {}
    tasks: Annotated[list[Task], Field(min_length=1, max_length=1000)]
    chargers: Annotated[list[Charger], Field(max_length=100)] = []
    payload: Mass = 0.0
    reserve: float | str = 0.2
    confidence: Fraction = 0.95
    coefficient_spread: Fraction = 0.0
    spreads: Spreads | Literal["none"] = Spreads()
    waiting: OpenTime = Uncertain(0.0)
    order: Literal["given", "free"] = "given"
    return_to: Literal["start", "charger", "any"] = "any"
    time: Time = 0.0
    speed: Speed | None = None
    objective: Literal["energy", "length"] = "energy"
    planner: str = "lattice"
    planning_time: Time | None = None
    planning_effort: Annotated[int, Field(ge=1)] | None = None


@checked(MissionError)
def read_mission(path: str | Path, *, inside: bool = False) -> Mission:
    """Read a mission from YAML.

    Numbers are in SI units, or carry one: ``5 min``, ``60 W``, ``36 Ah``, ``20 %``. A pose is
    ``[x, y, yaw]``, ``"x,y,90deg"`` or the name of one of the `places`. Files are looked for
    beside the mission, then among those that come with the library. docs/missions lists the keys.

    Parameters
    ----------
    path : str or Path
        The file.
    inside : bool
        Accept only files in the mission's folder and below, as a service does.

    Returns
    -------
    Mission
        The mission.

    Raises
    ------
    MissionError
        If the file is malformed, or the mission makes no sense; the message names file, line and
        key.

    Examples
    --------
    >>> from energyplan.io.files import bundled
    >>> read_mission(bundled("mission_warehouse.yaml")).name
    'warehouse cleaning'
    """
    return MissionReader(load(path, MissionError), Path(path).parent, not inside).mission()


def mission_from(values: Mapping[str, Any] | str, folder: str | Path | None = None) -> Mission:
    """Build a mission from what a mission's file would hold."""
    if isinstance(values, str):
        given = parse(values.encode(), "mission", MissionError)
    else:
        given = Document("mission", dict(values), {}, MissionError)
    return MissionReader(given, Path(folder or ""), anywhere=folder is None).mission()


class MissionReader:
    """Builds a mission from a document; whatever goes wrong gets its place in the file."""

    def __init__(self, document: Document, folder: Path, anywhere: bool = False) -> None:
        self._document = document
        self._folder = folder
        self._anywhere = anywhere  # a file may name what lies beside it, a person whatever he likes
        places = document.data.get("places")
        self._spec = document.check(
            _Mission, context={"places": places if isinstance(places, dict) else {}}
        )
        self._name = self._spec.name or Path(document.source).stem

    def mission(self) -> Mission:
        """Return the mission."""
        spec = self._spec
        model = self._placed(("model",), self._model, spec.model)
        if spec.vehicle is not None:
            vehicle = self._placed(("vehicle",), self._vehicle, spec.vehicle)
            model = replace(model, vehicle=vehicle.with_icr(model.vehicle.icr))
        battery = self._battery()
        loaded = {
            name: {
                payload: self._placed(("payload_models", name), self._model, source)
                for payload, source in models.items()
            }
            for name, models in spec.payload_models.items()
        }
        site = self._site()
        surfaces = site.surfaces
        if site.heights is not None:
            # models from level ground say nothing about slopes; the wheel loads tell the weight
            model = with_weight(model)
            surfaces = None if surfaces is None else with_weights(surfaces)
            loaded = {
                name: {payload: with_weight(heavy) for payload, heavy in models.items()}
                for name, models in loaded.items()
            }
        names = {model.name, *(s.model.name for s in (surfaces.surfaces if surfaces else ()))}
        for name in loaded:
            if name not in names:
                known = ", ".join(sorted(names))
                raise self._document.fail(
                    ("payload_models", name), f"the mission has no such model; it has {known}"
                )
        return self._placed(
            (), Mission,
            model=model, battery=battery, tasks=tuple(spec.tasks), chargers=tuple(spec.chargers),
            map=replace(site, surfaces=surfaces), payload_models=loaded, payload=spec.payload,
            start=spec.start,
            soc=spec.soc.value, waiting=spec.waiting.value,
            spreads=self._placed((), self._spreads),
            reserve=self._reserve(battery),
            confidence=spec.confidence, coefficient_spread=spec.coefficient_spread,
            order=spec.order, return_to=spec.return_to,
            home=spec.home,
            time=spec.time, speed=spec.speed, objective=spec.objective, planner=spec.planner,
            planning_time=spec.planning_time, planning_effort=spec.planning_effort,
            name=self._name,
        )  # fmt: skip

    def _placed(self, loc: Loc, build: Callable[..., T], *args: Any, **values: Any) -> T:
        try:
            return build(*args, **values)
        except MissionError as problem:
            if str(problem).startswith(self._document.source):
                raise
            raise self._document.fail((*loc, *problem.place), str(problem)) from None
        except EnergyPlanError as problem:
            raise self._document.fail(loc, str(problem)) from None

    # -- parts ------------------------------------------------------------------------------------

    def _file(self, name: str) -> Path:
        if self._anywhere:
            file = self._folder / name
        else:
            file = beside(self._folder / self._document.source, "name of a file", name)
        if is_file(file):
            return file
        try:
            return bundled(name)
        except UnknownNameError:
            raise MissionError(
                f"there is no file {name!r} beside the mission, nor does the library bring one"
            ) from None

    def _vehicle(self, name: str) -> Vehicle:
        return read_vehicle(self._file(name)) if _is_yaml(name) else Vehicle.preset(name)

    def _read(self, read: Callable[[Path], T], name: str) -> T:
        return read(self._file(name))

    def _site(self) -> Site:
        """Return the site that ``map`` names, with what stands beside that key in place of it."""
        read = partial(read_site, inside=not self._anywhere)
        site: Site = self._placed(("map",), self._read, read, self._spec.map)
        given = {key: getattr(self._spec, key) for key in PARTS}
        parts = {
            key: self._placed((key,), self._read, PARTS[key], name)
            for key, name in given.items()
            if name is not None
        }
        return replace(site, **parts, clearance=self._spec.clearance or site.clearance)

    def _model(self, name: str) -> PowerModel:
        return read_model(self._file(name)) if _is_yaml(name) else PowerModel.preset(name)

    def _spreads(self) -> Spreads:
        """Return the spreads: those of the distributions, of ``spreads``, or the usual ones."""
        spec = self._spec
        given: dict[str, float] = {}
        battery = spec.battery if isinstance(spec.battery, _Battery) else _Battery()
        relative = {"capacity": battery.capacity, "waiting": spec.waiting}
        absolute = {
            "soc": spec.soc, "health": battery.health, "temperature": battery.temperature,
        }  # fmt: skip
        for key, told in {**relative, **absolute}.items():
            if told is None or told.spread is None:
                continue
            if key in relative and told.value <= 0:
                raise self._document.fail(
                    (key,), f"a {key} of {told.value:g} has no spread; give a mean above 0"
                )
            given[key] = told.spread / (told.value if key in relative else 1.0)
        return replace(Spreads.none() if spec.spreads == "none" else spec.spreads, **given)

    def _reserve(self, battery: Battery) -> float:
        """Return the reserve as a state of charge; an energy is one of the full battery's."""
        value = self._spec.reserve
        if not isinstance(value, str):
            return value
        try:
            if value.strip()[-1:] in {*"%.0123456789"}:  # a number without a unit is a fraction
                return float(amount("fraction", value))
            energy = float(amount("energy", value))
        except ValueError as problem:
            raise self._document.fail(
                ("reserve",), f"{problem}; give a fraction, a percentage or an energy"
            ) from None
        grid = np.linspace(0.0, 1.0, 101)
        whole = battery.available_capacity * float(np.trapezoid(battery.ocv(grid), grid))
        if energy >= whole:
            raise self._document.fail(
                ("reserve",),
                f"the reserve of {energy / 3600:.0f} Wh is above the battery's capacity of "
                f"{whole / 3600:.0f} Wh",
            )
        return energy / whole

    def _battery(self) -> Battery:
        spec = self._spec.battery
        if isinstance(spec, str):
            source = self._file(spec) if _is_yaml(spec) else spec
            return self._placed(("battery",), read_battery, source)
        return _built(spec, self._name, self._document, ("battery",))


def _built(spec: _Battery, name: str, document: Document, at: Loc) -> Battery:
    """Return the battery that a mapping describes."""
    given: dict[str, Any] = {
        key: value.value if isinstance(value, Uncertain) else value
        for key, value in spec
        if value is not None
    }
    if "usable" in given:
        given["cutoff_soc"] = 1.0 - given.pop("usable")
    units: dict[str, Any] = {
        key: given.pop(key)
        for key in ("chemistry", "series", "parallel", "unit_capacity", "unit_resistance")
        if key in given
    }
    if ("preset" in given) == bool(units):
        raise document.fail(
            at, f"give a preset or words, as in {EXAMPLE!r}, or chemistry, series, parallel and "
            "unit_capacity"
        )  # fmt: skip
    missing = [k for k in ("chemistry", "series", "parallel", "unit_capacity") if k not in units]
    if units and missing:
        raise document.fail(
            at, f"the pack lacks {', '.join(missing)}; or say it in words, as in {EXAMPLE!r}"
        )
    try:
        base = Battery.from_units(name, **units) if units else Battery.of(given.pop("preset"))
        notes = base.notes if not {"resistance", "unit_resistance"} & given.keys() else ()
        return replace(base, **given, notes=notes)
    except EnergyPlanError as problem:
        raise document.fail(at, str(problem)) from None


def read_battery(source: str | Path) -> Battery:
    """Return a battery from words, a preset, or a YAML file with the keys of a mission's."""
    if not _is_yaml(str(source)):
        return Battery.of(str(source))
    document = load(source, MissionError)
    return _built(document.check(_Battery), Path(source).stem, document, ())
