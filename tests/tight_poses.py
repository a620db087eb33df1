"""Poses with hardly any room, each made by driving there, so that a way out is known to exist."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import TreadICR, Vehicle

TURNS = (2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Turns that are tried [rad]."""

STEPS = 24
"""Motions in which a pose must have become tight."""


def any_robot(rng: np.random.Generator) -> Vehicle:
    """Return a robot of any size, with its tread ICRs and its footprint off its middle."""
    length, width = rng.uniform(0.5, 1.5), rng.uniform(0.4, 0.9)
    robot = Vehicle.from_geometry(
        "robot", mass=60.0, wheelbase=0.5 * length, track=0.7 * width, length=length, width=width
    )
    half = rng.uniform(0.5, 0.8) * width
    lean = rng.uniform(-0.2, 0.2) * half
    shift = rng.uniform(-0.1, 0.1, 2) * (length, 0.3 * width)
    return replace(
        robot.with_icr(TreadICR(half + lean, half - lean, rng.uniform(-0.1, 0.1) * length)),
        footprint=robot.footprint + shift,
    )


def any_floor(rng: np.random.Generator, robot: Vehicle, resolution: float) -> OccupancyGrid:
    """Return a floor with boxes, racks hardly further apart than the robot is wide, and niches."""
    (x_min, y_min), (x_max, y_max) = robot.footprint
    length, width = (round(size / resolution) for size in (x_max - x_min, y_max - y_min))
    rows, columns = round(9.0 / resolution), round(12.0 / resolution)
    occupied = np.zeros((rows, columns), bool)
    # racks along one side: aisles with a cell or so on either side of the robot, closed at the end
    column, deep = 0, int(rng.uniform(1.2, 2.5) * length)
    while column < columns // 2:
        column += int(rng.integers(2, 2 * width))
        occupied[:deep, column : column + 4] = True
        column += 4 + width + int(rng.integers(2, 6))
        occupied[:deep, column : column + 4] = True
    # niches in the wall opposite, and boxes anywhere
    for at in rng.integers(0, columns - length - 8, 3):
        high = rows - int(width * rng.uniform(1.1, 1.6))
        wide = length + int(rng.integers(2, 12))
        occupied[high:, at : at + 3] = occupied[high:, at + 3 + wide : at + 6 + wide] = True
    for _ in range(8):
        row, left = rng.integers(deep, rows), rng.integers(0, columns)
        high, wide = rng.uniform(0.2, 1.5, 2) / resolution
        occupied[row : row + int(high), left : left + int(wide)] = True
    return OccupancyGrid(occupied, resolution, Pose(-2.0, 1.0, rng.uniform(-np.pi, np.pi)))


def _driven(
    rng: np.random.Generator, grid: OccupancyGrid, robot: Vehicle, pose: Pose
) -> Path | None:
    """Return a random motion that ends 1 mm to 10 cm before what it would touch."""
    sign = rng.choice([-1.0, 1.0])
    kind = rng.integers(4)
    ds = sign * rng.uniform(0.3, 3.0) if kind != 1 else 0.0
    dtheta = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 2.0) if kind in (1, 2) else 0.0

    def part(size: float) -> Path:
        longitudinal = robot.icr.longitudinal
        return Path(pose, np.array([size * ds]), np.array([size * dtheta]), longitudinal)

    low, high = 0.0, 1.0
    if grid.path_free(part(1.0), robot):
        return part(1.0)
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if grid.path_free(part(middle), robot) else (low, middle)
    sweep = abs(ds) + float(np.abs(robot.footprint).max()) * abs(dtheta)
    kept = low - 10.0 ** rng.uniform(-3, -1) / sweep
    return part(kept) if kept > 0 and grid.path_free(part(kept), robot) else None


def tight_pose(
    rng: np.random.Generator, grid: OccupancyGrid, robot: Vehicle, origin: Pose, room: float
) -> Path | None:
    """Return a way from a place to a pose where the body can turn by less than `room` [rad]."""
    ds: list[float] = []
    dtheta: list[float] = []
    pose = origin
    for _ in range(STEPS):
        tried = [_driven(rng, grid, robot, pose) for _ in range(4)]
        motions = [motion for motion in tried if motion is not None]
        if not motions:
            continue
        # the tightest of some, so that ways lead into corners and aisles
        motion = min(motions, key=lambda one: turning_room(grid, robot, one.end))
        ds += motion.ds.tolist()
        dtheta += motion.dtheta.tolist()
        pose = motion.end
        if len(ds) > 3 and turning_room(grid, robot, pose) < room:
            way = Path(origin, np.array(ds), np.array(dtheta), robot.icr.longitudinal)
            return way if grid.path_free(way, robot) else None
    return None


def turning_room(grid: OccupancyGrid, robot: Vehicle, pose: Pose) -> float:
    """Return about how far a robot can turn on the spot, both ways together [rad]."""
    total = 0.0
    for sign in (1.0, -1.0):
        for turn in TURNS:
            spin = Path(pose, np.zeros(1), np.array([sign * turn]), robot.icr.longitudinal)
            if grid.path_free(spin, robot):
                total += turn
                break
    return total


@cache
def tight_problem(seed: int) -> tuple[PlanningProblem, Path]:
    """Return a problem whose start or goal, or both, have hardly any room, and a path.

    Parameters
    ----------
    seed : int
        Which one.
    """
    rng = np.random.default_rng(seed)
    while True:
        robot = any_robot(rng)
        grid = any_floor(rng, robot, rng.choice([0.02, 0.05, 0.1]))
        cost = EnergyCost.from_coefficients(150.0, rng.uniform(10.0, 200.0), robot.icr)
        cells = rng.uniform((0, 0), grid.shape[::-1], (200, 2))
        poses = np.column_stack([grid.to_world(cells), rng.uniform(-np.pi, np.pi, 200)])
        free = poses[grid.footprint_free(poses, robot)]
        roomy = [pose for pose in free.tolist() if turning_room(grid, robot, Pose(*pose)) > 3.0]
        if len(roomy) < 2:
            continue
        far = int(np.argmax(np.hypot(*(np.array(roomy) - roomy[0])[:, :2].T)))
        between = PlanningProblem(grid, cost, roomy[0], roomy[far], vehicle=robot)
        ways = [
            tight_pose(rng, grid, robot, end, 10.0 ** rng.uniform(-2.5, -1))
            for end in (between.start, between.goal)
        ]
        if ways[1] is None or (ways[0] is None and seed % 3):
            continue
        try:
            middle = plan(between, effort=2000).path
        except PlanningError:
            continue
        back = ways[0] if ways[0] is not None and seed % 3 else replace(middle, ds=[], dtheta=[])
        known = Path(
            back.end,
            np.concatenate([-back.ds[::-1], middle.ds, ways[1].ds]),
            np.concatenate([-back.dtheta[::-1], middle.dtheta, ways[1].dtheta]),
            robot.icr.longitudinal,
        )
        if seed % 6 >= 3:
            known = Path(known.end, -known.ds[::-1], -known.dtheta[::-1], known.longitudinal)
        if grid.path_free(known, robot):
            return PlanningProblem(grid, cost, known.start, known.end, vehicle=robot), known
