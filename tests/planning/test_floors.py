"""Tight places: maps carved along a drivable path, so that one is known to exist in each."""

from __future__ import annotations

import numpy as np
import pytest
from by_day import by_day
from worlds import box_robot

from energyplan import EnergyCost, OccupancyGrid, Path, PlanningProblem, Pose
from energyplan.planning import Budget
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.cost_to_go import cost_to_go, node_at, reached

EXPANSIONS = 100_000
"""Within which a first path must be found."""

SIZES = {"small": (0.28, 0.28), "quadriga": (0.82, 0.64), "long": (1.6, 0.6), "wide": (0.7, 1.1)}
"""Length and width [m]."""


def carved(path: Path, length: float, width: float, resolution: float, room: float):
    """Return a map that is blocked but for what a body sweeps along a path, and some room [m]."""
    poses = path.subdivide(max_ds=0.25 * resolution, max_dtheta=0.25 * resolution / length).vertices
    low = poses[:, :2].min(axis=0) - length - width - 0.5
    columns, rows = np.ceil((poses[:, :2].max(axis=0) + length + width + 0.5 - low) / resolution)
    free = np.zeros((int(rows), int(columns)), bool)
    reach = int(np.hypot(length, width) / 2 / resolution + room / resolution) + 2
    window = np.arange(-reach, reach + 1)
    # a cell whose centre lies this far off does not touch the body
    off = room + np.sqrt(0.5) * resolution
    for x, y, yaw in poses:
        column, row = ((np.array([x, y]) - low) / resolution).astype(int)
        u = low[0] + (column + window + 0.5) * resolution - x
        v = (low[1] + (row + window + 0.5) * resolution - y)[:, None]
        along, across = u * np.cos(yaw) + v * np.sin(yaw), v * np.cos(yaw) - u * np.sin(yaw)
        inside = (np.abs(along) <= length / 2 + off) & (np.abs(across) <= width / 2 + off)
        free[row - reach : row + reach + 1, column - reach : column + reach + 1] |= inside
    return OccupancyGrid(~free, resolution, Pose(*low, 0.0))


def wander(seed: int, length: float, motions: int = 6) -> Path:
    """Return a random path of straight lines, spins and arcs, forwards and backwards."""
    rng = np.random.default_rng(seed)
    ds, dtheta = [0.0], [0.0]
    for _ in range(motions):
        ds += [rng.choice([-1, 1], p=[0.3, 0.7]) * rng.uniform(1.0, 4.0) * length, 0.0]
        dtheta += [0.0, rng.uniform(-1.8, 1.8)]
        if rng.random() < 0.5:
            ds[-1] = rng.uniform(-1, 1) * 2.0 * length
    start = Pose(0.0, 0.0, rng.uniform(-np.pi, np.pi))
    return Path(start, np.array(ds), np.array(dtheta))


def problem_along(path: Path, size: tuple[float, float], resolution: float, room: float):
    """Return the problem from one end of a path to the other, with nowhere else to go."""
    robot = box_robot(*size)
    cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
    grid = carved(path, *size, resolution, room)
    assert grid.path_free(path, robot)
    return PlanningProblem(grid, cost, path.start, path.end, vehicle=robot)


def first_path(problem: PlanningProblem) -> tuple[CompiledProblem, Search]:
    """Return the search for a first path, on finer lattices where the first one has none."""
    asked = CompiledProblem(problem)
    to_go = cost_to_go(asked.setting)
    for scale in (1.0, 0.5, 0.25, 0.125, 0.0625):
        search = Search(asked.setting, to_go, lattice_for(asked.setting, scale), 2.0)
        search.run(Budget(), EXPANSIONS)
        if search.found:
            break
    return asked, search


@pytest.mark.parametrize("seed", by_day(range(3), [0]))
@pytest.mark.parametrize("resolution", [0.025, 0.1])
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_path_is_found_where_one_was_carved(size, resolution, seed):
    path = wander(seed, max(size))
    problem = problem_along(path, size, resolution, room=0.04)
    asked, search = first_path(problem)
    assert search.found
    found = asked.path(search.segments())
    assert problem.map.path_free(found, problem.robot)


@pytest.mark.parametrize("seed", by_day(range(4), range(2)))
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_no_way_is_said_to_be_closed_that_is_open(size, seed):
    problem = problem_along(wander(seed, max(size)), size, 0.05, room=0.005)
    setting = CompiledProblem(problem).setting
    assert reached(cost_to_go(setting), setting)


def test_the_way_to_go_knows_what_the_body_cannot_pass():
    # a straight way with a bend too sharp for the body, though not for the disc inside it, and a
    # long way round
    free = np.zeros((130, 200), bool)
    free[20:60, 5:45] = free[20:60, 150:195] = True
    free[36:46, 45:95] = free[36:46, 105:150] = True
    free[36:56, 85:95] = free[46:56, 85:115] = free[36:56, 105:115] = True
    free[60:110, 10:30] = free[90:110, 10:190] = free[60:110, 165:185] = True
    grid = OccupancyGrid(~free, 0.1)
    robot = box_robot(2.0, 0.8)
    cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
    problem = PlanningProblem(grid, cost, (2.5, 4.0, 0), (17.0, 4.0, 0), vehicle=robot)
    asked, search = first_path(problem)
    assert search.found
    assert max(asked.path(search.segments()).vertices[:, 1]) > 9.0
    to_go = cost_to_go(asked.setting)
    node = node_at(to_go, grid.space, Pose(2.5, 4.0, 0.0))
    # up, across and down again: no less than this, and little more
    assert 22.0 < to_go.distance[node] < 28.0
