"""The way that a guide knows, as poses: which way the robot faces on it."""

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.planning import PlanningProblem
from energyplan.planning.search.follow import chain_along, poses_along
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.cost_to_go import HEADINGS, cost_to_go
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

LONG = Vehicle.from_geometry(
    "long", mass=120.0, wheelbase=1.2, track=0.42, length=2.0, width=0.5
)  # fmt: skip


def way_of(grid, start, goal):
    """Return the poses along the way to go of a robot for which turning is dear."""
    cost = EnergyCost(PowerModel.paper(LONG, K=20.0, mu=0.5))
    setting = CompiledProblem(PlanningProblem(grid, cost, start, goal)).setting
    to_go = cost_to_go(setting)
    return poses_along(to_go.places, setting, chain_along(to_go, setting))


@pytest.mark.parametrize("turned", [0.0, 1.1, -2.4])
def test_a_way_straight_ahead_keeps_the_heading_of_its_ends(turned):
    # the map lies at any angle to the world
    grid = OccupancyGrid(np.zeros((40, 90), bool), 0.1, (1.0, -2.0, turned))
    (x, y), (to_x, to_y) = grid.to_world([(20.0, 20.0), (70.0, 20.0)])
    poses = way_of(grid, (x, y, turned), (to_x, to_y, turned))
    off = np.remainder(poses[:, 2] - turned + np.pi, 2 * np.pi) - np.pi
    assert len(poses) > 2
    assert np.abs(off).max() < 2 * np.pi / HEADINGS


@pytest.mark.parametrize("yaw", [0.0, np.pi])
def test_through_a_slot_a_robot_faces_as_its_ends_do(yaw):
    # the way is as long forwards and backwards, and the robot cannot turn round within
    occupied = np.zeros((100, 200), bool)
    occupied[:36, 70:130] = occupied[51:, 70:130] = True
    grid = OccupancyGrid(occupied, 0.04)
    poses = way_of(grid, (1.3, 1.0, yaw), (6.7, 2.6, yaw))
    inside = poses[(poses[:, 0] > 3.0) & (poses[:, 0] < 5.0)]
    assert len(inside) > 2
    assert np.cos(inside[:, 2] - yaw) == pytest.approx(1.0)
