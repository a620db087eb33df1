"""The guide: regions join what is joined, its distances are right, and its way can be driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from worlds import box_robot, free_poses, room

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, Pose, PowerModel, Vehicle, plan
from energyplan.errors import PlanningError
from energyplan.planning import Budget
from energyplan.planning.search.tracking import chain_along, poses_along, track_route
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.configurations import HEADINGS
from energyplan.planning.space.cost_to_go import cost_over, cost_to_go, reached, regions_for
from energyplan.planning.space.places import RIM, places_for

ROBOTS = {
    "small": (0.3, 0.25, 0.0),
    "long": (3.0, 0.7, 0.0),
    "wide": (0.5, 1.2, 0.0),
    "ahead": (1.0, 0.6, 0.35),
}
"""Length, width, and how far the footprint lies ahead of the robot's centre [m]."""


def robot(kind: str) -> Vehicle:
    """Return a robot of a kind."""
    length, width, ahead = ROBOTS[kind]
    corners = [[ahead - length / 2, -width / 2], [ahead + length / 2, width / 2]]
    made = box_robot(length, width, wheelbase=0.5)
    wheels = made.contacts + np.array((0.3 * ahead, 0.0))  # within the footprint
    return replace(made, contacts=wheels, footprint=np.array(corners))


def floor(kind: str, seed: int, resolution: float, scale: float) -> OccupancyGrid:
    """Return a floor for robots about `scale` long: rooms, clutter, or aslant corridors."""
    rng = np.random.default_rng(seed)
    cells = round(14.0 * scale / resolution)
    occupied = np.zeros((cells, cells), bool)
    unit = cells / 14.0
    if kind == "rooms":
        for k in (4.5, 9.0):
            wall = slice(int(k * unit), int(k * unit) + max(int(0.15 * unit), 1))
            occupied[wall, :] = occupied[:, wall] = True
        for k in (4.5, 9.0):
            wall = slice(int(k * unit) - 1, int((k + 0.2) * unit) + 2)
            for room in range(3):
                at = (4.5 * room + rng.uniform(0.5, 2.0)) * unit
                door = slice(int(at), int(at + rng.uniform(1.0, 1.7) * unit))
                occupied[wall, door] = False
                occupied[door, wall] = rng.random() < 0.3
    elif kind == "clutter":
        for _ in range(40):
            row, column = rng.uniform(0, 14, 2) * unit
            height, width = rng.uniform(0.1, 0.9, 2) * unit
            occupied[int(row) : int(row + height) + 1, int(column) : int(column + width) + 1] = True
    else:
        y, x = (np.mgrid[:cells, :cells] + 0.5) / unit - 7.0
        angle = rng.uniform(0.1, 0.7)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        width = rng.uniform(0.9, 1.5, 4)
        occupied[:] = np.abs(along) > 5.0
        for k, wall in enumerate((-4.5, -1.5, 1.5, 4.5)):
            gap = np.abs(along - rng.uniform(-4, 4)) < 0.5 * width[k]
            occupied |= (np.abs(across - wall) < 0.4) & ~gap
    return OccupancyGrid(occupied, resolution, Pose(-1.0, 2.0, 0.2))


def problems(kind: str, made: str, seed: int, resolution: float, count: int):
    """Return problems between random free poses of a floor."""
    vehicle = robot(made)
    grid = floor(kind, seed, resolution, 0.8 * max(ROBOTS[made][:2]))
    cost = EnergyCost.from_coefficients(150.0, 60.0, vehicle.icr)
    poses = free_poses(grid, 2 * count, seed, vehicle, draws=4000)
    pairs = zip(poses[::2], poses[1::2], strict=True)
    return [PlanningProblem(grid, cost, *pair, vehicle=vehicle) for pair in pairs]


def joined_nodes(places) -> np.ndarray:
    """Return the connected part that each node is of: neighbouring places share a heading."""
    across = places.columns + 2 * RIM
    one, two = [], []
    for step in (1, across - 1, across, across + 1):
        for node, place in enumerate(places.home.tolist()):
            for other in range(places.first[place + step], places.first[place + step + 1]):
                if places.arcs[node] & places.arcs[other]:
                    one.append(node)
                    two.append(other)
    count = len(places.arcs)
    graph = coo_matrix((np.ones(len(one)), (one, two)), (count, count))
    return connected_components(graph, directed=False)[1]


@pytest.mark.parametrize("made", ROBOTS)
def test_regions_join_what_is_joined(made):
    for kind in ("rooms", "aslant"):
        kernel = CompiledProblem(problems(kind, made, 1, 0.05, 1)[0]).setting
        places, regions = places_for(kernel), regions_for(kernel)
        links = np.zeros(len(regions.to), int)
        for region, first in enumerate(regions.head.tolist()):
            link = first
            while link >= 0:
                links[link] = region
                link = int(regions.after[link])
        count = len(regions.x)
        graph = coo_matrix((np.ones(len(links)), (links, regions.to)), (count, count))
        parts = connected_components(graph, directed=False)[1][regions.of_node]
        # the same parts, whatever their numbers
        pairs = np.unique(np.column_stack([parts, joined_nodes(places)]), axis=0)
        assert len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == len(pairs)


@pytest.mark.parametrize("kind", ["rooms", "clutter", "aslant"])
@pytest.mark.parametrize(("made", "resolution"), [("small", 0.01), ("long", 0.2), ("ahead", 0.05)])
def test_a_plan_of_little_effort_is_found_where_free_configurations_are_joined(
    kind, made, resolution
):
    ways = joined = 0
    for problem in problems(kind, made, 0, resolution, 4):
        query = CompiledProblem(problem)
        kernel = query.setting
        to_go = cost_over(kernel, enlarged=False)
        if not reached(to_go, kernel):
            try:  # poses between those that were tested may join them
                plan(problem, effort=2_500, gap=10.0)
            except PlanningError as error:
                assert error.certainty == "proven" or "effort" in str(error)
            continue
        joined += 1
        way = track_route(kernel, to_go, Budget()).motions
        if way is not None:
            ways += 1
            query.path(way)  # which must be free
        assert plan(problem, effort=2_500, gap=10.0).energy > 0
    assert ways >= joined - 1


# -- which way the robot faces on it ---------------------------------------------------------------


def way_of(grid, start, goal):
    """Return the poses along the way to go of a robot for which turning is dear."""
    long = Vehicle.from_geometry("long", mass=120.0, wheelbase=1.2, track=0.42, length=2, width=0.5)
    cost = EnergyCost(PowerModel.paper(long, K=20.0, mu=0.5))
    setting = CompiledProblem(PlanningProblem(grid, cost, start, goal)).setting
    to_go = cost_to_go(setting)
    return poses_along(to_go.places, setting, chain_along(to_go, setting))


@pytest.mark.parametrize("turned", [0.0, 1.1, -2.4])
def test_a_way_straight_ahead_keeps_the_heading_of_its_ends(turned):
    # the map lies at any angle to the world
    grid = room(40, 90, 0.1, origin=(1.0, -2.0, turned))
    (x, y), (to_x, to_y) = grid.to_world([(20.0, 20.0), (70.0, 20.0)])
    poses = way_of(grid, (x, y, turned), (to_x, to_y, turned))
    off = np.remainder(poses[:, 2] - turned + np.pi, 2 * np.pi) - np.pi
    assert len(poses) > 2
    assert np.abs(off).max() < 2 * np.pi / HEADINGS


@pytest.mark.parametrize("yaw", [0.0, np.pi])
def test_through_a_slot_a_robot_faces_as_its_ends_do(yaw):
    # the way is as long forwards and backwards, and the robot cannot turn round within
    grid = room(100, 200, 0.04, np.s_[:36, 70:130], np.s_[51:, 70:130])
    poses = way_of(grid, (1.3, 1.0, yaw), (6.7, 2.6, yaw))
    inside = poses[(poses[:, 0] > 3.0) & (poses[:, 0] < 5.0)]
    assert len(inside) > 2
    assert np.cos(inside[:, 2] - yaw) == pytest.approx(1.0)
