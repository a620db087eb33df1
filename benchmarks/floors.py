"""Floors on which no threshold of the planner was chosen, as `planners.py --floors` takes them.

Each is drawn by a random generator of its own: rooms as a robot has mapped them, with ragged walls
and speckles, cubicles in cells of 3 cm, a car park in cells of 10 cm; `turned` makes another one of
a map that is given.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from energyplan.terrain import OccupancyGrid


def turned(grid: OccupancyGrid, degrees: float = 17.0) -> OccupancyGrid:
    """Return a map turned within its axes and mirrored; what was outside of it is blocked."""
    free = ndimage.rotate((~grid.blocked).astype(np.uint8), degrees, order=0, cval=0)
    return OccupancyGrid(free[:, ::-1] == 0, grid.resolution)


def mapped_rooms(seed: int = 0) -> OccupancyGrid:
    """Return rooms of 5 cm as a robot maps them: walls a little aslant and ragged, and speckles."""
    rng = np.random.default_rng(seed)
    blocked = np.ones((480, 640), bool)
    for row in range(4):
        for column in range(5):
            top, left = 8 + 118 * row, 8 + 126 * column
            blocked[top : top + 112, left : left + 120] = False
            for _ in range(rng.integers(1, 4)):
                high, wide = rng.integers(8, 34, 2)
                y, x = top + rng.integers(0, 112 - high), left + rng.integers(0, 120 - wide)
                blocked[y : y + high, x : x + wide] = True
            door = top + rng.integers(14, 76)
            if column < 4:
                blocked[door : door + rng.integers(18, 30), left + 119 : left + 127] = False
            door = left + rng.integers(14, 84)
            if row < 3 and rng.random() < 0.7:
                blocked[top + 111 : top + 119, door : door + rng.integers(18, 30)] = False
    rows, columns = np.indices(blocked.shape)
    # the drift of a robot that maps bends its walls
    bent = ndimage.map_coordinates(
        blocked.astype(np.uint8),
        [rows + 5 * np.sin(columns / 130) + 0.05 * columns, columns + 6 * np.sin(rows / 90)],
        order=0, cval=1,
    )  # fmt: skip
    ragged = ndimage.gaussian_filter(bent + rng.normal(0, 0.55, bent.shape), 1.2) > 0.5
    return OccupancyGrid(ragged | (rng.random(bent.shape) < 2e-4), 0.05)


def cubicles(seed: int = 1) -> OccupancyGrid:
    """Return an office of cubicles with a desk and a chair each, in cells of 3 cm."""
    rng = np.random.default_rng(seed)
    size = 0.03
    blocked = np.zeros((round(19.0 / size), round(26.0 / size)), bool)
    blocked[:4] = blocked[-4:] = blocked[:, :4] = blocked[:, -4:] = True

    def box(x: float, y: float, width: float, height: float) -> None:
        blocked[round(y / size) : round((y + height) / size),
                round(x / size) : round((x + width) / size)] = True  # fmt: skip

    for row in range(3):
        for side in range(2):
            y = 1.5 + 6.0 * row + 2.3 * side
            for k in range(8):
                x = 1.6 + 2.9 * k
                box(x, y, 0.05, 2.3)
                box(x + 2.85, y, 0.05, 2.3)
                box(x, y if side else y + 2.25, 2.9, 0.05)
                opening = rng.uniform(0.85, 1.3)
                begin = rng.uniform(0.1, 2.8 - opening)
                front = y + 2.25 if side else y
                box(x, front, begin, 0.05)
                box(x + begin + opening, front, 2.9 - begin - opening, 0.05)
                box(x + 0.1, y + 0.1 if side else y + 1.55, 2.7, 0.65)
                left, low = rng.uniform((x + 0.3, y + 0.9), (x + 2.2, y + 1.1))
                box(left, low, 0.4, 0.4)
    return OccupancyGrid(blocked, size)


def car_park(seed: int = 2) -> OccupancyGrid:
    """Return an underground car park: pillars, ramp walls, cars in most bays; cells of 10 cm."""
    rng = np.random.default_rng(seed)
    blocked = np.zeros((480, 620), bool)
    blocked[:3] = blocked[-3:] = blocked[:, :3] = blocked[:, -3:] = True
    for lane in range(3):
        for side in range(2):
            top = 5 + 160 * lane + 110 * side
            for k in range(23):
                left = 20 + 25 * k
                if k % 3 == 0:
                    blocked[top + 20 : top + 25, left - 3 : left + 2] = True
                if rng.random() < 0.75:
                    long, wide = rng.integers(38, 49), rng.integers(17, 20)
                    y, x = top + rng.integers(0, 49 - long), left + rng.integers(2, 25 - wide)
                    blocked[y : y + long, x : x + wide] = True
    blocked[60:420, 300:303] = True
    blocked[200:260, 300:303] = False
    blocked[360:363, 60:280] = True
    return OccupancyGrid(blocked, 0.1)


FLOORS = {"mapped rooms": mapped_rooms, "cubicles": cubicles, "car park": car_park}
"""What makes each floor."""
