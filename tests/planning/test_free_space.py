"""Free configurations against the collision test, pose by pose."""

from __future__ import annotations

import numpy as np
import pytest
from by_day import by_day

from energyplan import OccupancyGrid, Pose
from energyplan.planning.space.configurations import HEADINGS, free_space
from energyplan.terrain.collision import Body, poses_free

# sides that are no multiples of a part of a cell: rounding decides no touch
BODIES = {
    "long": Body(-0.9037, -0.2511, 0.9041, 0.2519),
    "off centre": Body(-0.2013, -0.3307, 0.7117, 0.2129),
    "ahead of its reference point": Body(0.1039, -0.2017, 0.6011, 0.2023),
    "square": Body(-0.1409, -0.1409, 0.1409, 0.1409),
}


def salted(resolution: float, size: tuple[float, float], seed: int) -> OccupancyGrid:
    """Return a map of walls, boxes and single blocked cells, turned in the world."""
    rng = np.random.default_rng(seed)
    rows, columns = (round(length / resolution) for length in size)
    occupied = rng.random((rows, columns)) < 0.02 * resolution
    for _ in range(8):
        row, column = rng.integers(0, rows), rng.integers(0, columns)
        height, width = rng.integers(1, max(rows // 4, 2)), rng.integers(1, max(columns // 4, 2))
        occupied[row : row + height, column : column + width] = True
    return OccupancyGrid(occupied, resolution, Pose(3.0, -2.0, 0.7))


def bits(masks: np.ndarray) -> np.ndarray:
    """Return the bits of words, shape (..., headings)."""
    return (masks[..., None] >> np.arange(HEADINGS, dtype=np.uint64)) & np.uint64(1) == 1


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("resolution", by_day([0.025, 0.05, 0.1, 0.2], [0.025, 0.2]))
def test_a_bit_says_what_the_collision_test_says(body, resolution):
    grid = salted(resolution, (4.0, 9.0), seed=3)
    space = grid.space
    found = free_space(space, body)
    rows, columns = found.masks.shape
    heading = np.arange(HEADINGS) * 2 * np.pi / HEADINGS + grid.origin.yaw
    # poses tested lie at the centres of the finer of cells and places
    parts = max(round(found.spacing / resolution), 1)
    free = np.zeros((rows, columns, HEADINGS), bool)
    row, column = np.indices((rows, columns))
    for i, j in np.ndindex(parts, parts):
        place = np.stack([column + (j + 0.5) / parts, row + (i + 0.5) / parts], -1) * found.spacing
        inside = np.all(place < np.array(grid.size), axis=-1)
        poses = np.empty((rows, columns, HEADINGS, 3))
        poses[..., :2] = grid.to_world(place / resolution)[:, :, None]
        poses[..., 2] = heading
        tested = poses_free(space, body, poses.reshape(-1, 3)).reshape(free.shape)
        free |= tested & inside[..., None]
    assert 0.02 < free.mean() < 0.98
    assert np.array_equal(bits(found.masks), free)


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("resolution", [0.025, 0.1, 0.2])
def test_every_free_pose_lies_in_an_enlarged_cell(body, resolution):
    grid = salted(resolution, (4.0, 9.0), seed=5)
    found = free_space(grid.space, body, enlarged=True)
    rng = np.random.default_rng(0)
    count = 200_000
    place = rng.uniform(0, grid.size, (count, 2))
    # many of them where the body touches a wall or the edge: shrink until free is rare
    yaw = rng.uniform(-np.pi, np.pi, count)
    poses = np.column_stack([grid.to_world(place / resolution), yaw + grid.origin.yaw])
    free = poses_free(grid.space, body, poses)
    column, row = np.floor(place / found.spacing).astype(int).T
    heading = np.round(yaw / (2 * np.pi / HEADINGS)).astype(int) % HEADINGS
    may = bits(found.masks)[row, column, heading]
    assert free.sum() > 1000
    assert not np.any(free & ~may)
    # and it is no empty promise: little more than what is free is said to be
    assert may.mean() < free.mean() + 0.35
