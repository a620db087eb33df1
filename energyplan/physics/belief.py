"""What a model found of the ground, put on the map for planners."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from energyplan.path import FloatArray, Pose
from energyplan.physics.robot import Ground
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel
from energyplan.power.effects import reads_slope, with_weight
from energyplan.terrain import HeightMap, OccupancyGrid, Surface, SurfaceMap, with_weights


@dataclass(frozen=True)
class Belief:
    """A model as planners take it: what belongs to the ground is on the map.

    Parameters
    ----------
    model : PowerModel
        The model without the terms that the ground stands for.
    ground : Ground
        Surfaces and heights.
    asked : PlanningProblem
        The problem.
    """

    model: PowerModel
    ground: Ground
    asked: PlanningProblem

    def planned(self, speed: float) -> PlanningProblem:
        """Return the problem with this model, driven at a tread speed [m/s]."""
        cost = replace(self.asked.cost, model=self.model, battery=True, speed=speed)
        vehicle = self.asked.robot
        return replace(
            self.asked, cost=cost, surfaces=self.ground.surfaces, heights=self.ground.heights,
            vehicle=vehicle,
        )  # fmt: skip


def believed(model: PowerModel, problem: PlanningProblem) -> Belief:
    """Put what a model found of the ground on the map: a tilted plane, another surface.

    Parameters
    ----------
    model : PowerModel
        The model.
    problem : PlanningProblem
        The problem, with the surfaces and heights known before.

    Returns
    -------
    Belief
        Model and ground.
    """
    names = {term.name: k for k, term in enumerate(model.terms)}
    values = dict(zip(names, model.coefficients.tolist(), strict=True))
    off = set(names) & {"tilt_x", "tilt_y", "slip_beyond", "traction_beyond"}
    plain = _without(model, off)
    surfaces, heights = problem.surfaces, problem.heights
    if off & {"tilt_x", "tilt_y"} and heights is None:
        mass = model.vehicle.mass
        sine = np.array([values.get("tilt_x", 0.0), values.get("tilt_y", 0.0)]) / mass
        heights = _plane(problem.map, sine / np.sqrt(max(1.0 - float(sine @ sine), 0.01)))
    if heights is not None and not reads_slope(plain):
        plain = with_weight(plain)
    beyond = off & {"slip_beyond", "traction_beyond"}
    if beyond and surfaces is None:
        params = model.terms[names[next(iter(sorted(beyond)))]].params
        there = plain.with_coefficients(
            plain.coefficients
            + np.array(
                [
                    values.get("slip_beyond", 0.0) * (t.name == "slip_friction")
                    + values.get("traction_beyond", 0.0) * (t.name == "traction_resistance")
                    for t in plain.terms
                ]
            )
        )
        area = _half_plane(problem.map, params["direction"], params["offset"])
        if area is not None:
            surfaces = SurfaceMap((Surface(area, replace(there, name="found beyond a line")),))
    if surfaces is not None and heights is not None:
        surfaces = with_weights(surfaces)
    return Belief(plain, Ground(surfaces, heights), problem)


def _without(model: PowerModel, names: set[str]) -> PowerModel:
    keep = np.array([term.name not in names for term in model.terms])
    covariance = model.covariance
    return replace(
        model,
        terms=tuple(term for term, stays in zip(model.terms, keep, strict=True) if stays),
        coefficients=model.coefficients[keep],
        covariance=None if covariance is None else covariance[np.ix_(keep, keep)],
    )


def _corners(grid: OccupancyGrid) -> FloatArray:
    rows, columns = grid.shape
    cells = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], float)
    return np.asarray(grid.to_world(cells))


def _plane(grid: OccupancyGrid, gradient: FloatArray) -> HeightMap:
    """Heights of a plane over a map, with a margin about it."""
    corners = _corners(grid)
    low, high = corners.min(axis=0) - 2.0, corners.max(axis=0) + 2.0
    size = float(np.max(high - low))
    node = np.array([0.0, 1.0])
    heights = size * (gradient[0] * node[None, :] + gradient[1] * node[:, None])
    return HeightMap(heights, size, Pose(float(low[0]), float(low[1]), 0.0))


def _half_plane(grid: OccupancyGrid, direction: float, offset: float) -> shapely.Polygon | None:
    """Return the part of a map that lies beyond a line; None where there is none."""
    corners = _corners(grid)
    size = 2.0 * float(np.ptp(corners, axis=0).max()) + 10.0
    normal = np.array([np.cos(direction), np.sin(direction)])
    along = np.array([-normal[1], normal[0]])
    middle = corners.mean(axis=0)
    foot = middle + (offset - middle @ normal) * normal
    far = [foot + size * along, foot - size * along]
    area = shapely.Polygon([*far, far[1] + 2 * size * normal, far[0] + 2 * size * normal])
    part = area.intersection(shapely.Polygon(corners).buffer(2.0))
    return part if isinstance(part, shapely.Polygon) and part.area > 0 else None
