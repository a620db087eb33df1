"""Slots: walls with an opening a centimetre or two wider than the robot, at any angle."""

from __future__ import annotations

import numpy as np
import pytest
from by_day import by_day
from worlds import box_robot

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, Pose, plan

SIZES = {"small": (0.35, 0.28), "quadriga": (0.82, 0.64), "long": (1.8, 1.2), "wide": (0.6, 0.8)}
"""Length and width [m]."""


def wall(
    size: tuple[float, float], resolution: float, angle: float, spare: float
) -> PlanningProblem:
    """Return a problem on either side of a wall with a slot along `angle`, and a way round it.

    A robot that drives straight along the slot has half of `spare` on either side, beside what
    cells leave free that it does not touch [m].
    """
    length, width = size
    reach = max(size)
    half = 6.0 * reach
    c, s = np.cos(angle), np.sin(angle)
    x = (np.arange(int(2.0 * half / resolution)) + 0.5) * resolution - half
    y = x[:, None]
    along, across = c * x + s * y, c * y - s * x
    # the wall leans, and ends four lengths to the left of the slot
    blocked = (np.abs(along - 0.3 * across) < 0.25 * length) & (across < 4.0 * reach)
    touched = 0.5 * (width + spare) + 0.5 * resolution * (abs(c) + abs(s))
    blocked &= np.abs(across) > touched
    robot = box_robot(length, width)
    cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
    grid = OccupancyGrid(blocked, resolution, Pose(-half, -half, 0.0))
    ends = np.array([[-2.0, 1.0], [2.0, 0.0]]) * reach @ np.array([[c, s], [-s, c]])
    start, goal = (Pose(*end, angle + turn) for end, turn in zip(ends, (0.7, -1.9), strict=True))
    return PlanningProblem(grid, cost, start, goal, vehicle=robot)


def to_the_left(angle: float, poses: np.ndarray) -> float:
    """Return how far to the left of the slot poses are at most [m]."""
    return float((np.cos(angle) * poses[:, 1] - np.sin(angle) * poses[:, 0]).max())


@pytest.mark.parametrize("drawn", by_day([(0.3, 0.05), (1.9, 0.03)], [(0.3, 0.05)]))
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_slot_is_driven_through(size, drawn):
    angle, resolution = drawn
    problem = wall(size, resolution, angle, spare=0.01 + 0.01 * size[1])
    found = plan(problem, effort=20_000)
    assert to_the_left(angle, found.path.vertices) < 2.0 * max(size)


@pytest.mark.parametrize("size", [SIZES["small"], SIZES["quadriga"]])
def test_what_is_too_narrow_is_not_driven_through(size):
    problem = wall(size, 0.02, 0.3, spare=-0.08)
    found = plan(problem, effort=5_000)
    assert to_the_left(0.3, found.path.vertices) > 4.0 * max(size)
