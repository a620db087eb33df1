"""Missions as YAML files; every complaint names the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from energyplan.battery import Battery
from energyplan.errors import EnergyPlanError, MissionError, UnknownNameError
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.documents import Document, Loc, beside, load, parse
from energyplan.io.files import bundled, is_file
from energyplan.io.maps import PARTS, read_site
from energyplan.kinds import checked, described, doubts_of
from energyplan.mission import Mission
from energyplan.mission.types import Place
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import with_weights
from energyplan.vehicle import Vehicle

T = TypeVar("T")


def _is_yaml(name: str) -> bool:
    """Whether a file is meant, rather than a preset."""
    return name.endswith((".yaml", ".yml"))


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
    return build(load(path, MissionError), Path(path).parent, anywhere=not inside)


def mission_from(values: Mapping[str, Any] | str, folder: str | Path | None = None) -> Mission:
    """Build a mission from what a mission's file would hold."""
    if isinstance(values, str):
        given = parse(values.encode(), "mission", MissionError)
    else:
        given = Document("mission", dict(values), {}, MissionError)
    return build(given, Path(folder or ""), anywhere=folder is None)


_MODELS = dict[str, dict[float, str]]


def build(document: Document, folder: Path, anywhere: bool = True) -> Mission:
    """Build a mission from a document, which names files beside it, or `anywhere`."""

    def at(loc: Loc, read: Callable[..., T], *given: Any) -> T:
        try:
            return read(*given)
        except EnergyPlanError as problem:
            raise document.fail(loc, str(problem)) from None

    def file(name: str) -> Path:
        inside = folder / document.source
        path = folder / name if anywhere else beside(inside, "name of a file", name)
        try:
            return path if is_file(path) else bundled(name)
        except UnknownNameError:
            raise MissionError(
                f"there is no file {name!r} beside the mission, nor does the library bring one"
            ) from None

    def named(read: Callable[[Path], T], preset: Callable[[str], T]) -> Callable[[str], T]:
        return lambda name: read(file(name)) if _is_yaml(name) else preset(name)

    def weighed(model: PowerModel) -> PowerModel:
        # a model from level ground says nothing about slopes; the wheel loads tell the weight
        return with_weight(model) if hills else model

    optional = ("vehicle", *PARTS)
    given = {k: v for k, v in document.data.items() if k != "places"}
    data = {k: v for k, v in given.items() if v is not None or k not in optional}
    for key, value in data.items():
        if key in ("map", "model", *optional) and not isinstance(value, str):
            told = f"{described(value)} is no name of a file or preset; give one"
            raise document.fail((key,), told + document.another_kind(Mission))
    places = document.check(dict[str, Place], ("places",)) if "places" in document.data else {}
    hills, known = False, set[str]()
    if "map" in data:
        found = at(("map",), lambda name: read_site(file(name), inside=not anywhere), data["map"])
        parts = {
            key: at((key,), lambda key: PARTS[key](file(data.pop(key))), key)
            for key in PARTS
            if key in data
        }
        site = replace(found, **parts)
        hills = site.heights is not None
        if hills and site.surfaces is not None:
            site = replace(site, surfaces=with_weights(site.surfaces))
        data["map"] = site
        known = {one.model.name for one in (site.surfaces.surfaces if site.surfaces else ())}
    read_named = named(read_model, PowerModel.preset)
    if "model" in data:
        model = at(("model",), read_named, data["model"])
        if "vehicle" in data:
            vehicle = at(("vehicle",), named(read_vehicle, Vehicle.preset), data.pop("vehicle"))
            model = replace(model, vehicle=vehicle.with_icr(model.vehicle.icr))
        data["model"] = weighed(model)
        known |= {data["model"].name}
    if isinstance(data.get("battery"), str) and _is_yaml(data["battery"]):
        data["battery"] = at(("battery",), lambda name: read_battery(file(name)), data["battery"])
    heavy: dict[str, dict[float, PowerModel]] = {}
    if "payload_models" in data:
        for name, models in document.check(_MODELS, ("payload_models",)).items():
            loc = "payload_models", name
            heavy[name] = {mass: weighed(at(loc, read_named, one)) for mass, one in models.items()}
            if "map" in data and name not in known:
                raise document.fail(
                    loc, f"the mission has no such model; it has {', '.join(sorted(known))}"
                )
    data = {"name": Path(document.source).stem, **data, "payload_models": heavy}
    return replace(document, data=data).check(
        Mission, context={"places": places, "where": document.where}
    )


def read_battery(source: str | Path) -> Battery:
    """Return a battery from words, a preset, or a YAML file with the keys of a mission's."""
    if not _is_yaml(str(source)):
        return Battery.of(str(source))
    document = load(source, MissionError)
    data = {"name": Path(source).stem, **document.data}
    battery = replace(document, data=data).check(Battery)
    document.warn(doubts_of(battery))
    return battery
