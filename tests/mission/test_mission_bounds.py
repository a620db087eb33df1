"""Lower bounds of missions: shortest ways on a map against geometry, energies against drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from corridors import corridor

from energyplan.mission.routes import Legs, shortest_ways
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.power.effects import term
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

ROBOT = Vehicle.preset("quadriga")


def hall(*walls: shapely.Polygon, yaw: float = 0.0) -> OccupancyGrid:
    empty = OccupancyGrid(np.zeros((200, 300), bool), 0.05, Pose(-1.0, 2.0, yaw))
    return OccupancyGrid(
        OccupancyGrid(empty.occupied, 0.05).with_blocked(walls).occupied, 0.05, empty.origin
    )


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_open_ground_is_the_straight_line(yaw):
    grid = hall(yaw=yaw)
    points = grid.to_world(np.array([(40, 40), (260, 160), (150, 30)], float))
    straight = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.testing.assert_allclose(shortest_ways(grid, ROBOT, points), straight)


def test_way_round_a_wall_is_bounded_from_below_and_closely():
    # A wall from the lower edge to 7 m: the disc of 0.32 m rounds its corners.
    grid = hall(shapely.box(7.0, 0.0, 7.2, 7.0))
    cells = np.array([(60, 40), (240, 40)], float)
    ways = shortest_ways(grid, ROBOT, grid.to_world(cells))
    start, goal = cells * 0.05
    corner = shapely.box(7.0, 0.0, 7.2, 7.0).buffer(0.32)
    hull = shapely.MultiPoint([start, goal]).union(corner).convex_hull
    ring = np.array(hull.exterior.coords)
    # The upper part of the hull's boundary is the way over the top.
    over = [p for p in ring if p[1] > 2.0 + 1e-6]
    over.sort(key=lambda p: p[0])
    true_length = shapely.LineString([start, *over, goal]).length
    assert ways[0, 1] <= true_length
    assert ways[0, 1] >= 0.85 * true_length


def test_no_way_is_infinite():
    grid = hall(shapely.box(7.0, 0.0, 7.2, 10.0))
    ways = shortest_ways(grid, ROBOT, grid.to_world(np.array([(60.0, 40.0), (240.0, 40.0)])))
    assert np.isinf(ways[0, 1])


def test_a_gap_too_narrow_for_the_disc_is_closed():
    for width, open_way in ((0.5, False), (0.9, True)):
        grid = hall(shapely.box(7.0, 0.0, 7.2, 5.0), shapely.box(7.0, 5.0 + width, 7.2, 10.0))
        ways = shortest_ways(grid, ROBOT, grid.to_world(np.array([(60.0, 40.0), (240.0, 40.0)])))
        assert np.isfinite(ways[0, 1]) == open_way


@pytest.mark.parametrize("speed", [None, 0.8])
def test_a_drive_that_is_slower_where_that_takes_less_is_bounded_too(speed: float | None) -> None:
    """Over so few metres a robot with viscous losses hardly comes up to its speed."""
    model = PowerModel.preset("quadriga:empty:marble").with_term(term("viscous_loss"), 100.0)
    motor = replace(model.vehicle.motor, acceleration=0.05)
    model = replace(model, vehicle=replace(model.vehicle, motor=motor))
    legs = Legs(corridor(1e6, {"a": 8.0}, 5.0, model=model, speed=speed))
    steady = legs.scene(0.0).cost.segment_energy(3.0, 0.0)
    driven = legs.leg(0, 1, 0.0).energy.mean
    assert driven < 0.8 * steady
    assert legs.lower_bounds(0.0)[0, 1] <= driven
