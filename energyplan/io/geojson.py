"""GeoJSON: surfaces, polygons that name a power model each, and obstacles."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from energyplan.errors import EnergyPlanError, MapError
from energyplan.io.documents import beside, read_features, unused, warn_of_unused
from energyplan.io.files import atomic_write
from energyplan.power import PowerModel
from energyplan.records import NO_NUMBER, checked, doubts_of, warn
from energyplan.terrain import OccupancyGrid, SpeedLimit, Surface, SurfaceMap
from energyplan.terrain.grid import FARTHEST

KEEP_OUT = ("keep_out", "keep-out", "keepout")
"""Names of a surface that the robot must not enter."""

GROUND = ("second", "turning_radius")
"""Properties of a surface that are numbers."""

DRAWN = frozenset(
    {"id", "fid", "gid", "ogc_fid", "description", "title", "layer", "color", "colour", "style",
     "stroke", "stroke-width", "stroke-opacity", "fill", "fill-opacity", "marker-color",
     "marker-size", "marker-symbol"}
)  # fmt: skip
"""Properties by which an editor numbers, names and draws a shape: they change no answer."""
_OF_SURFACES = {"model", "surface", "name", "speed", *GROUND}
_OF_OBSTACLES = {"kind", "name"}

AREAS = ("Polygon", "MultiPolygon")
LINES = ("LineString", "MultiLineString")
"""Kinds of geometry that are taken for areas, and for walls."""

MAX_COORDINATES = 1_000_000
"""Most coordinates that a file of surfaces may hold."""

SMALLEST = 0.1
"""Extent of all shapes of a file [m] below which they are in another unit: ten kilometres are a
tenth of a degree."""


@checked(MapError)
def read_surfaces(path: str | Path, models: Mapping[str, PowerModel] | None = None) -> SurfaceMap:
    """Read a GeoJSON FeatureCollection of polygons.

    Each feature is a Polygon or MultiPolygon in the map's frame [m]. Its property ``model``, or
    ``surface`` where there is no ``model``, names a power model: a preset, a YAML file in the
    GeoJSON's folder, or a key of `models`; ``keep_out`` stands for an area that the robot
    must not enter. ``surface`` or ``name`` labels it. Where surfaces overlap, the last one counts.
    ``speed`` limits the robot's speed there, in m/s or as ``"50 %"`` of its top speed; a feature
    with a speed needs no model. ``second`` is a price of each second on the surface, in the unit of
    the objective (for energy [J/s]), ``turning_radius`` the least radius of arcs on it [m].

    Parameters
    ----------
    path : str or Path
        The file.
    models : mapping of str to PowerModel, optional
        Models by name; they come before presets and files.

    Returns
    -------
    SurfaceMap
        The surfaces.

    Raises
    ------
    MapError
        If the file is missing or malformed, or a model is not known; the message names the
        feature.

    Examples
    --------
    >>> from energyplan.io.files import bundled
    >>> [surface.name for surface in read_surfaces(bundled("office_surfaces.geojson")).surfaces]
    ['concrete', 'marble']
    """
    file = Path(path)
    _, features = read_features(file)
    known = dict(models or {})
    if not features:
        raise MapError(f"{file}: no features; draw a polygon for each ground, or leave it out")
    surfaces: list[Surface] = []
    keep_out: list[BaseGeometry] = []
    limits: list[SpeedLimit] = []
    total = 0
    for k, feature in enumerate(features):
        place = f"{file}: feature {k}"
        area = _shape(feature["geometry"], place, AREAS)
        total += int(shapely.get_num_coordinates(area))
        if total > MAX_COORDINATES:
            raise MapError(f"{place}: more than {MAX_COORDINATES} coordinates; simplify the areas")
        properties = feature["properties"]
        name = properties.get("model", properties.get("surface"))
        if properties.get("speed") is not None:
            limits.append(_speed_limit(area, properties["speed"], place))
            for at, text in doubts_of(limits[-1]):
                warn(f"{place}: {at[0]}: {text}", stacklevel=3)
            if name is None:
                continue
        if not isinstance(name, str) or not name:
            raise MapError(
                f"{place}: no property 'model' or 'surface'; name a power model, or 'keep_out'"
            )
        if name in KEEP_OUT:
            keep_out.append(area)
            continue
        if name not in known:
            known[name] = _model(file, k, name)
        label = properties.get("surface", properties.get("name", name))
        ground = _numbers(properties, GROUND, place)
        try:
            surfaces.append(Surface(area, known[name], str(label), **ground))
        except MapError as error:
            raise MapError(f"{place}: {error}") from None
    _name_unused(file, features, _OF_SURFACES)
    areas = [surface.area for surface in surfaces] + [limit.area for limit in limits]
    check_metres(file, areas + keep_out)
    return SurfaceMap(tuple(surfaces), tuple(keep_out), tuple(limits))


def read_obstacles(path: str | Path, resolution: float = 0.05) -> OccupancyGrid:
    """Read a map from the shapes of its obstacles.

    Each feature of the GeoJSON FeatureCollection is a Polygon, MultiPolygon, LineString or
    MultiLineString in the world [m]. Polygons whose property ``kind`` is ``boundary`` are where
    the robot may be, with all beyond them occupied; the other features are obstacles, and every
    cell that one touches is occupied. The map is as large as all of them together.
    """
    file = Path(path)
    _, features = read_features(file)
    obstacles: list[BaseGeometry] = []
    inside: list[BaseGeometry] = []
    for k, feature in enumerate(features):
        place = f"{file}: feature {k}"
        if feature["properties"].get("kind") == "boundary":
            inside.append(_shape(feature["geometry"], place, AREAS))
        else:
            obstacles.append(_shape(feature["geometry"], place, (*AREAS, *LINES)))
    if not features:
        raise MapError(f"{file}: no features; draw a boundary and the obstacles within")
    drawn = [feature["properties"] for feature in features]
    if all("model" in one or one.get("surface") in KEEP_OUT for one in drawn):
        raise MapError(
            f"{file}: every shape names a power model, so these are surfaces and no obstacles; "
            "give them beside a map"
        )
    _name_unused(file, features, _OF_OBSTACLES)
    check_metres(file, [*obstacles, *inside])
    bounds = shapely.total_bounds(np.array([*obstacles, *inside], object))
    left, low, right, high = (float(v) for v in bounds)
    try:
        if inside:
            beyond = shapely.box(*bounds).buffer(resolution).difference(shapely.union_all(inside))
            obstacles.append(beyond)
        return OccupancyGrid.from_polygons(obstacles, (left, low, right, high), resolution)
    except MapError as error:
        raise MapError(f"{file}: {error}") from None


def _name_unused(file: Path, features: Sequence[Mapping[str, Any]], used: Collection[str]) -> None:
    """Name the properties of features that are not used."""
    given = (key for one in features for key, value in one["properties"].items()
             if value is not None)  # fmt: skip
    warn_of_unused(str(file), unused(given, used, DRAWN))


class LineFeature(NamedTuple):
    """A line of a file of shapes."""

    points: list[list[float]]  # x, y [m]
    properties: dict[str, Any]


def read_lines(path: str | Path) -> list[LineFeature]:
    """Return the lines of a GeoJSON FeatureCollection; the parts of a MultiLineString one by one.

    Each is a LineString or MultiLineString in the map's frame [m].
    """
    file, found = Path(path), list[LineFeature]()
    _, features = read_features(file)
    shapes = [_shape(one["geometry"], f"{file}: feature {k}", LINES)
              for k, one in enumerate(features)]  # fmt: skip
    if not shapes:
        raise MapError(f"{file}: no features; draw a line for each row")
    check_metres(file, shapes)
    for shape, feature in zip(shapes, features, strict=True):
        for part in shapely.get_parts(shape):
            points = shapely.get_coordinates(part).tolist()
            found.append(LineFeature(points, feature["properties"]))
    return found


def check_metres(file: Path, shapes: Sequence[BaseGeometry]) -> None:
    """Refuse shapes that reach over so little that they count in degrees."""
    left, low, right, high = shapely.total_bounds(np.array(shapes, object))
    extent = max(right - left, high - low)
    if extent < SMALLEST:
        raise MapError(
            f"{file}: all shapes together reach over {extent:.2g}, as degrees of longitude and "
            "latitude do; give metres in the map's frame"
        )


def _speed_limit(area: BaseGeometry, value: object, place: str) -> SpeedLimit:
    """Return the speed limit of a feature: metres a second, or a text such as ``"50 %"``."""
    percent = isinstance(value, str) and value.strip().endswith("%")
    text = str(value).strip().removesuffix("%") if percent else value
    try:
        if isinstance(text, bool) or not isinstance(text, (int, float, str)):
            raise TypeError
        return SpeedLimit(area, float(text) / (100 if percent else 1), percent)
    except MapError as error:
        raise MapError(f"{place}: {error}") from None
    except NO_NUMBER:
        raise MapError(f"{place}: speed is {value!r}; give m/s, such as 0.4, or '50 %'") from None


def _numbers(properties: Mapping[str, Any], names: Sequence[str], place: str) -> dict[str, float]:
    """Return those of the named properties that a feature has, as numbers."""
    found = {name: properties[name] for name in names if properties.get(name) is not None}
    for name, value in found.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise MapError(f"{place}: {name} is {value!r}; give a number, such as 20")
    return {name: float(value) for name, value in found.items()}


def _shape(geometry: Mapping[str, Any], place: str, kinds: Sequence[str]) -> BaseGeometry:
    """Return a geometry of one of these kinds, checked."""
    kind = geometry.get("type")
    if kind not in kinds:
        raise MapError(f"{place}: a {str(kind)[:40]}; give one of {', '.join(kinds)}")
    try:
        area = shapely.from_geojson(json.dumps(geometry))
    except (shapely.errors.GEOSException, ValueError, TypeError, RecursionError) as error:
        open_ring = "; repeat the first corner at the end" if "closed" in str(error) else ""
        raise MapError(f"{place}: malformed coordinates: {error}{open_ring}") from None
    if area is None or area.is_empty:
        raise MapError(f"{place}: no coordinates; remove the feature or draw it")
    if not area.is_valid:
        raise MapError(f"{place}: {shapely.is_valid_reason(area)}; correct the shape")
    if not max(abs(v) for v in area.bounds) <= FARTHEST:
        raise MapError(f"{place}: reaches beyond {FARTHEST:g} m; give metres in the map's frame")
    return area


def _model(file: Path, feature: int, name: str) -> PowerModel:
    """Return the model of a preset or of a YAML file in the GeoJSON's folder."""
    try:
        if not name.endswith((".yaml", ".yml")):
            return PowerModel.preset(name)
        target = beside(file, f"feature {feature}: model", name)
        from energyplan.io.config import read_model

        return read_model(target)
    except EnergyPlanError as error:
        raise MapError(f"{file}: feature {feature}: model: {error}") from None


def write_surfaces(surfaces: SurfaceMap, path: str | Path) -> None:
    """Write surfaces as GeoJSON; each model is named, not written."""
    features = []
    for one in surfaces.surfaces:
        ground = {name: value for name in GROUND if (value := getattr(one, name))}
        features.append(
            _feature(one.area, {"model": one.model.name, "surface": one.name, **ground})
        )
    features += [_feature(area, {"surface": KEEP_OUT[0]}) for area in surfaces.keep_out]
    features += [
        _feature(one.area, {"speed": f"{100 * one.speed!r} %" if one.relative else one.speed})
        for one in surfaces.speed_limits
    ]
    document = {"type": "FeatureCollection", "features": features}
    atomic_write(Path(path), json.dumps(document, indent=1) + "\n")


def _feature(area: BaseGeometry, properties: Mapping[str, str | float]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": shapely.geometry.mapping(area),
    }
