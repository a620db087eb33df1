"""From names of files to a problem: the one way of the commands, missions, the service and ROS 2.

A door says how a name becomes a file (`Read`); what the files mean is said here, and so are the
notes that every answer has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from energyplan.cost import EnergyCost
from energyplan.cost.speeds import parse_speed
from energyplan.errors import EnergyPlanError, MapError
from energyplan.io.documents import Checked, beside, load
from energyplan.io.files import is_file
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.maps import read_costmap, read_keepout, read_map, read_speed_mask
from energyplan.path import Pose
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel
from energyplan.power.effects import reads_slope, with_weight
from energyplan.power.presets import MODEL_PRESETS
from energyplan.records import Length, checked, warn
from energyplan.terrain import CLEARANCE, Site, knows_ground, with_limits, with_weights
from energyplan.vehicle import Vehicle

if TYPE_CHECKING:
    from energyplan.mission import Mission
    from energyplan.planning import Goal

T = TypeVar("T")


class SiteFile(Checked, BaseModel):
    """What the file of a site may hold: names of files, and a distance."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    map: str  # the map: whatever `read_map` takes
    resolution: Annotated[Length, Field(gt=0)] | None = None  # of a map that is an image alone [m]
    surfaces: str | None = None  # areas of other ground: GeoJSON
    heights: str | None = None  # heights of the ground: whatever `read_heights` takes
    keepout: str | None = None  # a second map: the robot stays out of its occupied cells
    costmap: str | None = None  # a map of soft costs
    speed_mask: str | None = None  # a mask of Nav2's speed filter: see `read_speed_mask`
    clearance: Annotated[Length, CLEARANCE] = 0.0  # [m]


PARTS: dict[str, Callable[[Path], Any]] = {
    "surfaces": read_surfaces, "heights": read_heights, "keepout": read_keepout,
    "costmap": read_costmap, "speed_mask": read_speed_mask,
}  # fmt: skip
"""What reads a part of a site, by its key."""


class Read(Protocol):
    """Reads the file that is named for a part of a site."""

    def __call__(self, key: str, name: str, read: Callable[[Path], T]) -> T:
        """Return what it holds; a complaint leads to the key."""


@checked(MapError)
def read_site(path: str | Path, *, inside: bool = False, resolution: float | None = None) -> Site:
    """Read a site: a YAML file that names its map and what else there is; or a map alone.

    The keys are ``map`` (required), ``surfaces``, ``heights``, ``keepout``, ``costmap`` and
    ``speed_mask``, names of files relative to this one, ``resolution``, the size of a pixel where
    the map is an image alone, and ``clearance``; both are distances such as ``0.2`` or ``20 cm``.
    As a service asks, no file is read that is not `inside` the site's folder. Errors name the
    line.
    """
    file = Path(path)
    document = load(file, MapError) if file.suffix in {".yaml", ".yml"} and is_file(file) else None
    if document is None or "map" not in document.data or {"tasks", "image"} & {*document.data}:
        return Site(read_map(file, resolution=resolution))
    if resolution is not None:
        raise MapError(f"{file} is a site; write its map's resolution there, as in resolution: 0.1")
    spec, place = document.check(SiteFile), document

    def part(key: str, name: str, read: Callable[[Path], T]) -> T:
        try:
            return read(beside(file, key, name) if inside else file.parent / name)
        except EnergyPlanError as problem:
            raise place.fail((key,), str(problem)) from None

    of_map = partial(read_map, resolution=spec.resolution)
    return _with_parts(Site(part("map", spec.map, of_map)), spec, part)


@cache  # one object: readers are compared where files are kept
def _reader(inside: bool, resolution: float | None) -> Callable[[Path], Site]:
    return partial(read_site, inside=inside, resolution=resolution)


def load_site(named: SiteFile, read: Read, inside: bool = False) -> Site:
    """Return the named site or map, with the parts that are named with it."""
    return _with_parts(read("map", named.map, _reader(inside, named.resolution)), named, read)


def _with_parts(site: Site, named: SiteFile, read: Read) -> Site:
    parts = {
        key: read(key, name, reader)
        for key, reader in PARTS.items()
        if (name := getattr(named, key)) is not None
    }
    if limits := parts.pop("speed_mask", ()):
        parts["surfaces"] = with_limits(parts.get("surfaces", site.surfaces), limits)
    if mask := parts.pop("keepout", None):
        parts["keepout"] = mask.closed
        if mask.weights is not None and parts.get("costmap", site.costmap) is not None:
            warn("the weights of the keep-out mask are ignored beside the costmap")
        elif mask.weights is not None:
            parts["costmap"] = mask.weights
    return replace(site, **parts, clearance=named.clearance or site.clearance)


class ModelOnSite(NamedTuple):
    """A model on the ground of a site, if any, and what to know of both."""

    model: PowerModel
    site: Site | None
    notes: tuple[str, ...]

    def cost(self, battery: bool = False, speed: str | None = None) -> EnergyCost:
        """Return what its motions cost."""
        return EnergyCost(self.model, battery, speed=parse_speed(speed, self.model.vehicle))


def on_site(model: PowerModel, site: Site | None) -> ModelOnSite:
    """Return a model for the ground of a site: where the ground slopes, the weight counts."""
    surfaces = site.surfaces if site else None
    notes = of_another_robot(
        "models of the surfaces are", model.vehicle,
        (surface.model.vehicle for surface in (surfaces.surfaces if surfaces else ())),
    )  # fmt: skip
    if knows_ground(model):
        notes += (
            f"{model.name} contains ground: it counts unless a file of surfaces or heights is "
            "given",
        )
    if site is not None and site.heights is not None:
        if not reads_slope(model):
            notes += (
                f"no term of {model.name} depends on slope: the weight of "
                f"{model.vehicle.mass:.4g} kg is added",
            )
        model = with_weight(model)
        site = replace(site, surfaces=with_weights(surfaces) if surfaces else None)
    return ModelOnSite(model, site, (*notes, *(site.notes if site else ())))


class NotedProblem(NamedTuple):
    """A planning problem, and what to know of it."""

    problem: PlanningProblem
    notes: tuple[str, ...]


def problem_from(
    site: Site,
    model: PowerModel,
    ends: tuple[Pose, Pose | tuple[Goal, ...]],
    *,
    battery: bool = False,
    speed: str | None = None,
    reverse: bool | None = None,
    **options: Any,
) -> NotedProblem:
    """Return the planning problem of a model at a site, from one end to the other."""
    ground = on_site(model, site)
    notes = ground.notes
    if site.costmap is not None and not options.get("costmap_weight"):
        notes += ("the costmap of the site does not count: plan takes --costmap-weight",)
    if reverse is not None:
        options["vehicle"] = replace(model.vehicle, reverse=reverse)
    place: Any = ground.site  # of which a problem takes the parts
    start, goal = ends[0], cast(Pose, ends[1])  # a problem takes other goals too
    return NotedProblem(
        PlanningProblem(place, ground.cost(battery, speed), start, goal, **options), notes
    )


def of_another_robot(what: str, vehicle: Vehicle, others: Iterable[Vehicle]) -> tuple[str, ...]:
    """Say where something is of a robot with another footprint than the one that drives has."""
    return tuple(
        f"{what} of another robot, {other.name}, whose footprint is not that of the "
        f"model's {vehicle.name}"
        for other in {other.name: other for other in others}.values()
        if not np.allclose(vehicle.footprint, other.footprint, rtol=0.05)
    )


def models_of(question: PlanningProblem | Mission) -> tuple[PowerModel, ...]:
    """Return the models that a question is answered by, the robot's own first."""
    own = question.cost.model if isinstance(question, PlanningProblem) else question.model
    heavy = {} if isinstance(question, PlanningProblem) else question.payload_models
    return (
        own,
        *(model for known in heavy.values() for model in known.values()),
        *(surface.model for surface in (question.surfaces.surfaces if question.surfaces else ())),
    )


def with_presets(answer: dict[str, Any], models: Iterable[PowerModel | str]) -> dict[str, Any]:
    """Add to an answer which of some models are presets, and so measured on other robots."""
    used = {model if isinstance(model, str) else model.name for model in models}
    presets = [
        {"name": name, "measured": False, "source": preset.source}
        for name, preset in MODEL_PRESETS.items()
        if name in used
    ]
    return {**answer, "preset": presets} if presets else answer
