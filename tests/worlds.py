"""Maps with boxes at random or a wall, free poses on them, and a battery of any size."""

import numpy as np

from energyplan.battery import Battery
from energyplan.terrain import OccupancyGrid


def cluttered(seed, count=14):
    """Return a map of 10 m by 8 m with boxes."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((160, 200), bool)
    for row, column in zip(rng.integers(5, 145, count), rng.integers(5, 185, count), strict=True):
        height, width = rng.integers(2, 24, 2)
        occupied[row : row + height, column : column + width] = True
    return OccupancyGrid(occupied, 0.05)


def free_poses(grid, count, seed, vehicle):
    """Return poses at which a vehicle is free."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform((0, 0, -np.pi), (*grid.size, np.pi), (400, 3))
    return poses[grid.footprint_free(poses, vehicle)][:count]


def walled(door):
    """Return a room of 10 m by 8 m with a wall across it, with or without a door at the top."""
    occupied = np.zeros((80, 100), bool)
    occupied[: 60 if door else 80, 48:52] = True
    return OccupancyGrid(occupied, 0.1)


def tiny(energy):
    """Return an ideal battery that holds so much energy [J] at 10 V."""
    flat = np.array([10.0, 10.0])
    return Battery("tiny", energy / 10.0, np.array([0.0, 1.0]), flat, 0.0)
