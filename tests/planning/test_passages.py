"""Passages that only poses close together lead through: gaps taken sideways, crooked ones."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.path import Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.search.narrow.bidirectional import bidirectional_search, follow
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.motions import drive
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

CELL, HEADINGS, TESTS = 0.0125, 128, 20_000


def gap(width: float, thick: float, resolution: float) -> PlanningProblem:
    """Return a problem on either side of a wall with one gap, for a robot wider than long."""
    cells = np.zeros((round(6 / resolution), round(8 / resolution)), bool)
    wall = slice(round(4 / resolution), round(4 / resolution) + max(round(thick / resolution), 1))
    low = round((3 - 0.5 * width) / resolution)
    cells[:, wall] = True
    cells[low : low + round(width / resolution), wall] = False
    robot = Vehicle.from_geometry(
        "robot", mass=40.0, wheelbase=0.36, track=0.64, length=0.6, width=0.8
    )
    cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
    grid = OccupancyGrid(cells, resolution)
    return PlanningProblem(grid, cost, (1.5, 2.0, 0.3), (6.5, 4.0, 1.0), vehicle=robot)


@pytest.mark.parametrize(("width", "thick", "resolution"), [(0.72, 0.1, 0.02), (0.8, 0.3, 0.05)])
def test_a_robot_wider_than_long_goes_through_a_gap_sideways(width, thick, resolution):
    problem = gap(width, thick, resolution)
    found = plan(problem, effort=5_000)
    assert problem.map.path_free(found.path, problem.robot)
    poses = found.path.subdivide(max_ds=0.02, max_dtheta=0.02).vertices
    inside = poses[np.abs(poses[:, 0] - 4.0 - 0.5 * thick) < 0.2]
    # along the wall, or the opposite way, within what the gap leaves
    assert np.all(np.abs(np.sin(inside[:, 2])) > 0.8)


def test_motions_follow_poses_through_a_gap():
    setting = CompiledProblem(gap(0.72, 0.1, 0.02)).setting
    begin, end = Pose(3.2, 3.0, 1.5), Pose(5.0, 3.0, 1.6)  # along the wall, on either side
    wide = grown(setting.body, 0.03)
    found = bidirectional_search(setting, wide, begin, end, CELL, HEADINGS, TESTS)
    assert len(found.poses) and found.tests < TESTS
    assert np.allclose(found.poses[[0, -1]], [begin, end])
    ds, dtheta = np.empty((2, 10_000))
    led = follow(setting, found.poses, 10_000, ds, dtheta)
    assert led.last == len(found.poses) - 1
    assert np.isfinite(drive(setting, begin, ds, dtheta, led.motions, np.inf))
