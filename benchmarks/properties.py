"""Properties that every plan has, on random maps: ``python benchmarks/properties.py [COUNT]``.

Robots of presets with tread ICRs of their own, or with random effects, among boxes, every third on
two grounds. Of each problem:

- no energy lies below the bound, and it is the sum over the arcs of the path and over the terms;
- the path ends at the goal, and no place of the footprint lies in an obstacle or off the map;
- planned again, the answer has the same bits;
- translated, rotated (about the origin, and by whole cells), mirrored and with its ends swapped,
  each energy lies above the bound of the other;
- wider obstacles never lower the bound;
- `check` accepts what `profile` made, at its energy, and half as fast; not 30 % faster than its
  report allows.

Where the ends lie in one region in which the robot can turn about, there is a path. `--first` is
the seed of the first problem. Names each problem that lacks a property.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import cos, inf, pi, sin
from pathlib import Path as FilePath

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label
from shapely.affinity import affine_transform

sys.path.insert(0, str(FilePath(__file__).parents[1] / "tests"))

from random_models import random_model

from energyplan import (
    EnergyCost,
    OccupancyGrid,
    Plan,
    PlanningProblem,
    Pose,
    PowerModel,
    SurfaceMap,
    TreadICR,
    Vehicle,
    check,
    plan,
)
from energyplan.errors import NoPathError, TimeLimitError
from energyplan.planning.driven import priced_models
from energyplan.power.presets import MODEL_PRESETS
from energyplan.terrain import Surface

EFFORT = 4000
CELL = 0.1
"""Size of a cell of the maps [m]."""
ROUNDING = 1e-9
"""Differences that rounding makes, as a part of the value."""


@dataclass(frozen=True)
class Image:
    """Where a rigid motion, or a mirror, puts the plane."""

    angle: float = 0.0  # of the rotation [rad]
    shift: tuple[float, float] = (0.0, 0.0)  # after it [m]
    side: int = 1  # -1: y is turned over first

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Return the image of a point [m]."""
        a, b, d, e, left, up = self.matrix()
        return a * x + b * y + left, d * x + e * y + up

    def pose(self, pose: Pose) -> Pose:
        """Return the image of a pose."""
        return Pose(*self.point(pose.x, pose.y), self.side * pose.yaw + self.angle)

    def matrix(self) -> tuple[float, ...]:
        """Return the numbers that shapely takes."""
        c, s = cos(self.angle), sin(self.angle)
        return c, -s * self.side, s, c * self.side, *self.shift

    def vehicle(self, vehicle: Vehicle) -> Vehicle:
        """Return the image of a vehicle."""
        if self.side > 0:
            return vehicle
        (low, right), (high, left) = vehicle.footprint
        icr = vehicle.icr
        return replace(
            vehicle,
            contacts=vehicle.contacts * [1, -1],
            footprint=np.array([[low, -left], [high, -right]]),
            icr=TreadICR(icr.right, icr.left, icr.longitudinal),
        )

    def of(self, problem: PlanningProblem, grid: OccupancyGrid) -> PlanningProblem:
        """Return the image of a problem, on a map that is the image of its own."""

        def seen(model: PowerModel) -> PowerModel:
            return replace(model, vehicle=self.vehicle(model.vehicle))

        ground = problem.surfaces and SurfaceMap(
            [
                Surface(affine_transform(one.area, self.matrix()), seen(one.model))
                for one in problem.surfaces.surfaces
            ]
        )
        return replace(
            problem,
            map=grid,
            cost=replace(problem.cost, model=seen(problem.cost.model)),
            start=self.pose(problem.start),
            goal=self.pose(problem.goal),
            surfaces=ground,
        )


def images(problem: PlanningProblem) -> Iterator[tuple[str, PlanningProblem]]:
    """Yield what a problem is in other frames."""
    cells, height = np.array(problem.map.occupied), problem.map.size[1]
    for name, motion in (
        ("translated", Image(shift=(1000.0, -700.0))),
        ("rotated", Image(angle=0.7)),
    ):
        origin = motion.pose(Pose(0.0, 0.0, 0.0))
        yield name, motion.of(problem, OccupancyGrid(cells, CELL, origin))
    quarter = Image(angle=pi / 2, shift=(height, 0.0))
    yield "rotated by cells", quarter.of(problem, OccupancyGrid(cells.T[:, ::-1], CELL))


def reflections(problem: PlanningProblem) -> Iterator[tuple[str, PlanningProblem]]:
    """Yield what a problem is in a mirror, and backwards: the same to a model without sides."""
    cells, height = np.array(problem.map.occupied), problem.map.size[1]
    mirror = Image(shift=(0.0, height), side=-1)
    yield "mirrored", mirror.of(problem, OccupancyGrid(cells[::-1], CELL))
    yield "ends swapped", replace(problem, start=problem.goal, goal=problem.start)


@dataclass(frozen=True)
class Drawn:
    """A random problem, and the same with wider obstacles."""

    problem: PlanningProblem
    wide: OccupancyGrid
    sided: bool  # whether the model tells left from right, or ahead from back
    solvable: bool  # whether there is a path for certain


def regions(grid: OccupancyGrid, radius: float, poses: NDArray[np.float64]) -> NDArray[np.int_]:
    """Return in which region of places with a clearance poses lie; 0 for none."""
    column, row = (poses[:, :2] / CELL).astype(int).T
    found, _ = label(np.array(grid.clearance) > radius + CELL)
    return np.asarray(found)[row, column]


def drawn(seed: int) -> Drawn:
    """Draw a problem whose ends are free, among wider obstacles as well."""
    rng = np.random.default_rng(seed)
    sided = bool(rng.random() < 0.3)
    cost = None
    while cost is None:
        cost = random_model(int(rng.integers(1 << 30))) if sided else _preset(rng)
    body = cost.vehicle.footprint
    while True:
        cells = np.zeros(rng.integers(70, 130, 2), bool)
        for _ in range(rng.integers(2, 14)):
            row, column = rng.integers((0, 0), cells.shape)
            rows, columns = rng.integers(2, 25, 2)
            cells[row : row + rows, column : column + columns] = True
        grid = OccupancyGrid(cells, CELL)
        wide = OccupancyGrid(binary_dilation(cells), CELL)
        poses = rng.uniform((0, 0, -pi), (*grid.size, pi), (400, 3))
        poses = poses[wide.footprint_free(poses, cost.vehicle)]
        near = regions(wide, float(np.abs(body).min()) - 2 * CELL, poses)
        poses = poses[near == near[0]] if near.size and near[0] else poses[:0]
        if len(poses) > 1:
            break
    wholly = regions(wide, float(np.hypot(*np.abs(body).max(axis=0))), poses[:2])
    ground = None
    if seed % 3 == 0 and not sided:
        area = shapely.box(*poses[:2, :2].min(axis=0), *poses[:2, :2].max(axis=0))
        model = PowerModel.paper(
            cost.vehicle,
            K=cost.model.coefficient("traction_resistance") * float(rng.uniform(0.4, 2.5)),
            mu=cost.model.coefficient("slip_friction") * float(rng.uniform(0.4, 2.5)),
            name="another ground",
        )
        ground = SurfaceMap([Surface(area, model)])
    problem = PlanningProblem(grid, cost, *poses[:2], surfaces=ground)
    return Drawn(problem, wide, sided, bool(wholly[0] == wholly[1] > 0))


def _preset(rng: np.random.Generator) -> EnergyCost:
    """Return the cost of a preset on tread ICRs of its own."""
    model = PowerModel.preset(str(rng.choice(sorted(MODEL_PRESETS))))
    icr = model.vehicle.icr
    left, right = rng.uniform(0.7, 1.3, 2) * (icr.left, icr.right)
    vehicle = replace(
        model.vehicle,
        icr=TreadICR(float(left), float(right), icr.longitudinal + float(rng.uniform(-0.05, 0.05))),
        drive_efficiency=float(rng.uniform(0.6, 1.0)),
        regen_efficiency=float(rng.uniform(0.0, 1.0)),
    )
    return EnergyCost(replace(model, vehicle=vehicle), battery=bool(rng.random() < 0.5))


def bits(found: Plan) -> tuple[object, ...]:
    """Return what has to be the same when a problem is planned again."""
    path = found.path
    return (
        path.ds.tobytes(),
        path.dtheta.tobytes(),
        found.energy_steady,
        found.lower_bound_steady,
        found.effort,
    )


def below(low: float, high: float) -> bool:
    """Return whether a number lies below another by more than rounding."""
    return low < high - ROUNDING * abs(high)


def apart(one: float, other: float) -> bool:
    """Return whether two numbers differ by more than rounding."""
    return below(one, other) or below(other, one)


def touched(problem: PlanningProblem, found: Plan) -> bool:
    """Return whether the footprint meets an obstacle or leaves the map, computed by shapely."""
    (low, right), (high, left) = problem.robot.footprint
    corners = np.array([[low, right], [high, right], [high, left], [low, left]])
    middle = corners.mean(axis=0)
    corners = middle + (corners - middle) * (1 - 1e-6)  # what grazes is free
    poses = found.path.poses(0.02, 0.02)
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = poses[:, 0, None], poses[:, 1, None]
    placed = np.stack(
        [x + c * corners[:, 0] - s * corners[:, 1], y + s * corners[:, 0] + c * corners[:, 1]], -1
    )
    bodies = shapely.polygons(placed)
    row, column = np.nonzero(problem.map.occupied)
    cells = shapely.box(CELL * column, CELL * row, CELL * (column + 1), CELL * (row + 1))
    met = shapely.STRtree(cells).query(bodies, predicate="intersects")
    inside = shapely.covers(shapely.box(0, 0, *problem.map.size).buffer(1e-9), bodies)
    return bool(met.size) or not bool(inside.all())


def faults(case: Drawn, found: Plan, answer: Callable[[PlanningProblem], Plan]) -> Iterator[str]:
    """Yield the properties that the answer to a problem lacks."""
    problem = case.problem
    if below(found.energy_steady, found.lower_bound_steady):
        yield (
            f"the energy {found.energy_steady} J lies below the bound {found.lower_bound_steady} J"
        )
    if apart(sum(found.breakdown.values()), found.energy_steady):
        yield f"the terms add up to {sum(found.breakdown.values())} J, not {found.energy_steady} J"
    if problem.surfaces is None:
        path = found.path
        arcs = float(np.sum(problem.cost.segment_energy(path.ds, path.dtheta)))
        if apart(arcs, found.energy_steady) or apart(
            problem.cost.energy(path), found.energy_steady
        ):
            yield f"the arcs add up to {arcs} J, not {found.energy_steady} J"
    missed = np.subtract(found.path.end, problem.goal)
    missed[2] = (missed[2] + pi) % (2 * pi) - pi
    if np.abs(missed).max() > 1e-9:
        yield f"the path misses the goal by {missed.tolist()}"
    if touched(problem, found):
        yield "the path is not free"
    if bits(answer(problem)) != bits(found):
        yield "planned again, the answer is another"
    others = [*images(problem), *([] if case.sided else reflections(problem))]
    for name, image in others:
        try:
            other = answer(image)
        except (NoPathError, TimeLimitError) as error:
            yield f"{name}: {error}"
            continue
        if below(other.energy_steady, found.lower_bound_steady) or below(
            found.energy_steady, other.lower_bound_steady
        ):
            yield (
                f"{name}: energy {other.energy_steady} J and bound {other.lower_bound_steady} J, "
                f"as it was {found.energy_steady} J and {found.lower_bound_steady} J"
            )
    try:
        wide = answer(replace(problem, map=case.wide)).lower_bound_steady
    except (NoPathError, TimeLimitError):
        wide = inf
    if below(wide, found.lower_bound_steady):
        yield f"wider obstacles lower the bound from {found.lower_bound_steady} J to {wide} J"
    yield from _undriven(problem, found)


def _undriven(problem: PlanningProblem, found: Plan) -> Iterator[str]:
    """Yield where `check` and `profile` disagree."""
    if found.why_not_driven:
        return
    drive, priced = found.driven, priced_models(problem.cost, problem.surfaces)
    report = check(drive.trajectory, priced.model, surfaces=priced.surfaces)
    if not report.feasible:
        yield f"check refuses what profile made: {report.violations[0]}"
    if apart(report.energy, drive.energy) or apart(sum(drive.breakdown.values()), drive.energy):
        yield f"check finds {report.energy} J, profile {drive.energy} J"
    for factor, allowed in ((0.5, True), (1.3 * report.max_speed_scale, False)):
        if np.isfinite(factor):
            scaled = check(drive.trajectory.scaled(factor), priced.model, surfaces=priced.surfaces)
            if scaled.feasible is not allowed:
                yield f"{factor:g} times as fast, feasible is {scaled.feasible}"


def answered(problem: PlanningProblem) -> Plan:
    """Plan by effort alone."""
    return plan(problem, effort=EFFORT)


def main() -> None:
    """Print what each problem lacks, and how many lack nothing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=60)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    sound = solved = driven = 0
    for seed in range(given.first, given.first + given.count):
        case, lacking = drawn(seed), []
        try:
            found = answered(case.problem)
        except (NoPathError, TimeLimitError) as error:
            lacking = [f"there is a path, but {error}"] if case.solvable else []
        else:
            lacking = list(faults(case, found, answered))
            solved, driven = solved + 1, driven + (not found.why_not_driven)
        for words in lacking:
            print(f"problem {seed}: {words}", flush=True)
        sound += not lacking
    print(f"{sound} of {given.count} problems lack nothing; {solved} have a path, {driven} of them")
    print("can be driven by their motors")


if __name__ == "__main__":
    main()
