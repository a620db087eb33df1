"""Maps with boxes at random or a wall, free poses on them, a robot and a battery of any size."""

from pathlib import Path

import numpy as np

from energyplan import Battery, EnergyCost, OccupancyGrid, PowerModel, Vehicle

MODEL = PowerModel.preset("quadriga:empty:concrete")
COST = EnergyCost(MODEL)
MAPS = Path(__file__).resolve().parents[1] / "maps"


def room(rows, columns, resolution, *boxes, origin=(0.0, 0.0, 0.0)):
    """Return a map of so many cells, free but for boxes: slices of rows and of columns."""
    occupied = np.zeros((rows, columns), bool)
    for box in boxes:
        occupied[box] = True
    return OccupancyGrid(occupied, resolution, origin)


def cluttered(seed, count=14):
    """Return a map of 10 m by 8 m with boxes."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((160, 200), bool)
    for row, column in zip(rng.integers(5, 145, count), rng.integers(5, 185, count), strict=True):
        height, width = rng.integers(2, 24, 2)
        occupied[row : row + height, column : column + width] = True
    return OccupancyGrid(occupied, 0.05)


def free_poses(grid, count, seed, vehicle=COST.vehicle, draws=400):
    """Return poses at which a vehicle is free."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform((0, 0, -np.pi), (*grid.size, np.pi), (draws, 3))
    poses[:, :2] = grid.to_world(poses[:, :2] / grid.resolution)
    return poses[grid.footprint_free(poses, vehicle)][:count]


def walled(door):
    """Return a room of 10 m by 8 m with a wall across it, with or without a door at the top."""
    return room(80, 100, 0.1, np.s_[: 60 if door else 80, 48:52])


def box_robot(length, width, wheelbase=0.6, track=0.8):
    """Return a robot of some length and width [m], which its wheels take up to some part."""
    return Vehicle.from_geometry(
        "robot", mass=40.0, wheelbase=wheelbase * length, track=track * width, length=length,
        width=width,
    )  # fmt: skip


def tiny(energy):
    """Return an ideal battery that holds so much energy [J] at 10 V."""
    flat = np.array([10.0, 10.0])
    return Battery("tiny", energy / 10.0, np.array([0.0, 1.0]), flat, 0.0)
