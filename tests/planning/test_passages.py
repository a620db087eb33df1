"""Passages that only poses close together lead through: gaps taken sideways, crooked ones."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import box_robot, room

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, Pose, plan
from energyplan.planning.search.narrow.bidirectional import bidirectional_search, follow
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.motions import drive

CELL, HEADINGS, TESTS = 0.0125, 128, 20_000


def gap(width: float, thick: float, resolution: float) -> PlanningProblem:
    """Return a problem on either side of a wall with one gap, for a robot wider than long."""
    wall = slice(round(4 / resolution), round(4 / resolution) + max(round(thick / resolution), 1))
    low = round((3 - 0.5 * width) / resolution)
    high = low + round(width / resolution)
    sides = (slice(low), wall), (slice(high, None), wall)
    grid = room(round(6 / resolution), round(8 / resolution), resolution, *sides)
    robot = box_robot(0.6, 0.8)
    cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
    return PlanningProblem(grid, cost, (1.5, 2.0, 0.3), (6.5, 4.0, 1.0), vehicle=robot)


@pytest.mark.parametrize(("width", "thick", "resolution"), [(0.72, 0.1, 0.02), (0.8, 0.3, 0.05)])
def test_a_robot_wider_than_long_goes_through_a_gap_sideways(width, thick, resolution):
    problem = gap(width, thick, resolution)
    found = plan(problem, effort=5_000)
    assert found.effort <= 1.1 * 5_000
    poses = found.path.subdivide(max_ds=0.02, max_dtheta=0.02).vertices
    inside = poses[np.abs(poses[:, 0] - 4.0 - 0.5 * thick) < 0.2]
    # along the wall, or the opposite way, within what the gap leaves
    assert np.all(np.abs(np.sin(inside[:, 2])) > 0.8)


def test_a_path_of_very_many_poses_is_shortened_within_the_effort():
    """Two gaps behind one another, with hardly the robot's width between their walls."""
    grid = np.zeros((300, 400), bool)
    grid[:, 190:200] = grid[:, 229:234] = True
    grid[100:148, 190:200] = grid[176:224, 229:234] = False
    robot = box_robot(0.9, 0.5)
    cost = EnergyCost.from_coefficients(200.0, 60.0, robot.icr)
    ends = (1.5, 2.5, 0.0), (6.5, 4.0, 0.0)
    problem = PlanningProblem(OccupancyGrid(grid, 0.02), cost, *ends, vehicle=robot)
    found, more = (plan(problem, effort=effort) for effort in (5_000, 20_000))
    assert found.effort <= 1.1 * 5_000
    assert more.effort <= 1.1 * 20_000
    assert more.energy < found.energy


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
