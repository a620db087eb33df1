"""Missions as YAML files; every complaint names the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from energyplan.battery import Battery
from energyplan.errors import EnergyPlanError, MissionError, UnknownNameError
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.documents import Checked, Document, Loc, beside, load, parse
from energyplan.io.files import bundled, is_file
from energyplan.io.geojson import read_lines
from energyplan.io.orders import TaskOrder, read_order
from energyplan.io.sites import PARTS, SiteFile, load_site, on_site
from energyplan.io.tables import read_points
from energyplan.mission import Mission, Robot, Task
from energyplan.mission.types import OWN, Name, NamedPlace
from energyplan.power import PowerModel
from energyplan.records import checked, described, doubts_of
from energyplan.vehicle import Vehicle

T = TypeVar("T")


def _is_yaml(name: str) -> bool:
    """Whether a file is meant, rather than a preset."""
    return name.endswith((".yaml", ".yml"))


@checked(MissionError)
def read_mission(path: str | Path, *, inside: bool = False) -> Mission:
    """Read a mission from YAML.

    Numbers are in SI units, or carry one: ``5 min``, ``60 W``, ``36 Ah``, ``20 %``. A pose is
    ``[x, y, yaw]``, ``"x,y,90deg"`` or the name of one of the `places`; of a task also ``[x, y]``,
    at any heading, or a list of poses, places and names. The `tasks` may be the name of a file, of
    an order of VDA 5050, of waypoints of Nav2 or of lines of GeoJSON. Files are looked for in the
    mission's folder, then among the library's own. docs/missions lists the keys.

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
    """Build a mission from a document, which names files in its folder, or `anywhere`."""
    mission = _build(document, folder, anywhere)
    for place, fault in mission.unladen:
        raise document.fail(place, f"{fault}; take it on board before, or leave less")
    return mission


def _build(document: Document, folder: Path, anywhere: bool) -> Mission:
    """Build a mission, whatever its tasks leave."""

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

    if isinstance(tasks := document.data.get("tasks"), str):
        order = at(("tasks",), lambda name: read_order(file(name)), tasks)
        document = replace(document, data={**document.data, "tasks": order.tasks})
        return _as_ordered(_build(document, folder, anywhere), order)
    if isinstance(tasks, list):
        with_paths = [
            _with_path(task, partial(at, ("tasks", k, "path"), _points, file))
            for k, task in enumerate(tasks)
        ]
        document = replace(document, data={**document.data, "tasks": with_paths})
    if "robots" in document.data:
        return _of_robots(document, folder, anywhere)

    def named(read: Callable[[Path], T], preset: Callable[[str], T]) -> Callable[[str], T]:
        return lambda name: read(file(name)) if _is_yaml(name) else preset(name)

    def part(key: str, name: str, read: Callable[[Path], T]) -> T:
        return at((key,), read, at((key,), file, name))

    data = _checked_names(document)
    places = document.check(dict[str, NamedPlace], ("places",)) if "places" in document.data else {}
    site, notes, known = None, tuple[str, ...](), set[str]()
    if "map" in data:
        of_site = {key: data.pop(key) for key in ("resolution", *PARTS) if key in data}
        names = replace(document, data={"map": data["map"], **of_site}).check(SiteFile)
        data["map"] = site = load_site(names, part, inside=not anywhere)
        known = {one.model.name for one in (site.surfaces.surfaces if site.surfaces else ())}
    read_named = named(read_model, PowerModel.preset)
    if "model" in data:
        model = at(("model",), read_named, data["model"])
        if "vehicle" in data:
            vehicle = at(("vehicle",), named(read_vehicle, Vehicle.preset), data.pop("vehicle"))
            model = replace(model, vehicle=vehicle.with_icr(model.vehicle.icr))
        data["model"], ground, notes = on_site(model, site)
        data |= {} if ground is None else {"map": ground}
        known |= {model.name}
    if isinstance(data.get("battery"), str) and _is_yaml(data["battery"]):
        data["battery"] = at(("battery",), lambda name: read_battery(file(name)), data["battery"])
    if "payload_models" in data:
        loaded = _payload_models(document, known if "map" in data else None)
        data["payload_models"] = {
            name: {
                mass: on_site(at(("payload_models", name), read_named, one), site).model
                for mass, one in models.items()
            }
            for name, models in loaded.items()
        }
    data = {"name": Path(document.source).stem, **data}
    return replace(document, data=data).check(
        Mission, context={"places": places, "where": document.where, "notes": notes}
    )


def _checked_names(document: Document) -> dict[str, Any]:
    """Return what a file says but its places; models and maps are named by text."""
    optional = ("vehicle", *PARTS)
    given = {k: v for k, v in document.data.items() if k != "places"}
    data = {k: v for k, v in given.items() if v is not None or k not in optional}
    for key, value in data.items():
        if key in ("map", "model", *optional) and not isinstance(value, str):
            message = f"{described(value)} is no name of a file or preset; give one"
            raise document.fail((key,), message + document.another_kind(Mission))
    return data


def _payload_models(document: Document, known: set[str] | None) -> _MODELS:
    """Return the names of the models of a robot with payload, by that of the one without."""
    loaded = document.check(_MODELS, ("payload_models",))
    for name in loaded:
        if known is not None and name not in known:
            raise document.fail(
                ("payload_models", name),
                f"the mission has no such model; it has {', '.join(sorted(known))}",
            )
    return loaded


def _with_path(task: Any, read: Callable[[str], Any]) -> Any:
    """Return what a file says of a task, with the points of its path where it names a file."""
    if not (isinstance(task, dict) and isinstance(task.get("path"), str)):
        return task
    return {**task, "path": read(task["path"])}


def _points(file: Callable[[str], Path], name: str) -> list[list[float]]:
    """Return the points of a path from a file of them."""
    path = file(name)
    if path.suffix.lower() != ".geojson":
        return read_points(path)
    lines = read_lines(path)
    if len(lines) > 1:
        raise MissionError(
            f"{name} has {len(lines)} lines; give one, or make each a task: tasks: {name}"
        )
    return lines[0].points


def _as_ordered(mission: Mission, order: TaskOrder) -> Mission:
    """Return a mission with what an order says of it beside its tasks."""
    notes, limit = order.notes, order.speed
    if limit is not None:
        typical = None if mission.robots else mission.tread_speed
        if typical is not None and typical > limit:
            mission = replace(mission, speed=limit)
            notes += (f"the mission is driven at {limit:g} m/s, the least maxSpeed of its edges",)
        elif typical is None:
            notes += (
                f"the order limits the speed to {limit:g} m/s (maxSpeed of its edges), which is "
                f"not used here: give speed: {limit:g}",
            )
    return mission.changed(*notes)


class _Entry(Checked, BaseModel):
    """A robot in a file: its name, its skills, and what it has in place of the mission's."""

    model_config = ConfigDict(extra="allow", frozen=True)
    name: Name
    skills: tuple[str, ...] = ()


_Entries = Annotated[list[_Entry], Field(min_length=1, max_length=100)]


def _of_robots(document: Document, folder: Path, anywhere: bool) -> Mission:
    """Build a mission of several robots: each one's is read as a mission of its own."""
    entries = document.check(_Entries, ("robots",))
    common = {k: v for k, v in document.data.items() if k != "robots"}
    extras = [entry.model_extra or {} for entry in entries]
    places = document.check(dict[str, NamedPlace], ("places",)) if "places" in common else {}
    tasks: tuple[Task, ...] = ()
    if "tasks" in common:
        tasks = document.check(tuple[Task, ...], ("tasks",), {"places": places})
    for j, task in enumerate(tasks):
        if not any({*task.needs} <= {*entry.skills} for entry in entries):
            message = f"no robot has {', '.join(task.needs)}; give it to one"
            raise document.fail(("tasks", j, "needs"), message)
    for k, extra in enumerate(extras):
        for key in extra.keys() - {*OWN}:
            message = f"a robot has no such key; it may have name, skills, {', '.join(OWN)}"
            raise document.fail(("robots", k, key), message)
    own = {"start", *(key for extra in extras for key in extra)} - {"vehicle"}
    if "model" in own or any("vehicle" in extra for extra in extras):
        own |= {"model", "surfaces", "heights"}  # what a model knows of the ground is laid out
    robots: list[Robot] = []
    notes: list[str] = []
    for k, (entry, extra) in enumerate(zip(entries, extras, strict=True)):
        able = [j for j, task in enumerate(tasks) if {*task.needs} <= {*entry.skills}]
        if tasks and not able:
            message = f"robot {entry.name!r} has the skills for no task; leave it out"
            raise document.fail(("robots", k), message)
        data = {"order": "free", **common, **extra, "name": entry.name}
        if tasks:
            data["tasks"] = [common["tasks"][j] for j in able]
        lines = {
            place: line for place, line in document.lines.items()
            if place[:1] not in {("robots",), ("tasks",), *((key,) for key in extra)}
        }  # fmt: skip
        for place, line in document.lines.items():
            if place[:2] == ("robots", k):
                lines[place[2:]] = line
            elif place[:1] == ("tasks",) and place[1:2] and place[1] in able:
                lines["tasks", able.index(int(place[1])), *place[2:]] = line
        mission = _build(Document(document.source, data, lines, MissionError), folder, anywhere)
        changes = {key: getattr(mission, key) for key in own}
        robots.append(Robot(entry.name, entry.skills, changes))
        notes += mission.notes
    whole: dict[str, Any] = {"name": str(common.get("name", Path(document.source).stem)),
                             "home": mission.home if "home" in common else None}  # fmt: skip
    return mission.changed(*notes, tasks=tasks, robots=tuple(robots), **whole)


def read_battery(source: str | Path | dict[str, Any]) -> Battery:
    """Return a battery from words, a preset, the keys of a mission's, or a YAML file of them."""
    if isinstance(source, dict):
        document, name = Document("battery", source, {}, MissionError), "battery"
    elif not _is_yaml(str(source)):
        return Battery.of(str(source))
    else:
        document, name = load(source, MissionError), Path(source).stem
    data = {"name": name, **document.data}
    battery = replace(document, data=data).check(Battery)
    document.warn(doubts_of(battery))
    return battery
