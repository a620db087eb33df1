"""Where turning costs much, a longer way with few turns is among the first routes."""

from __future__ import annotations

from math import pi

import numpy as np

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, PowerModel, plan


def town(seed: int) -> OccupancyGrid:
    """Return streets between blocks of random sizes, with a wide road along two sides."""
    rng = np.random.default_rng(seed)
    blocked = np.zeros((300, 450), bool)
    for row in range(0, 300, 50):
        for column in range(0, 450, 50):
            high, wide = rng.integers(15, 38, 2)
            y, x = row + rng.integers(0, 50 - high), column + rng.integers(0, 50 - wide)
            blocked[y : y + high, x : x + wide] = True
    blocked[:25] = blocked[-25:] = blocked[:, :25] = blocked[:, -25:] = False
    blocked[:3] = blocked[-3:] = blocked[:, :3] = blocked[:, -3:] = True
    return OccupancyGrid(blocked, 0.1)


def test_a_third_of_the_default_effort_finds_a_way_with_few_turns():
    """Ten times the effort saves less than the streets with many turns cost."""
    cost = EnergyCost(PowerModel.preset("husky_a200:flooring"))
    problem = PlanningProblem(town(9), cost, (1.3, 1.3, 0), (43, 28, pi / 2))
    found = plan(problem, effort=10_000)
    assert found.cost_steady <= 1.01 * plan(problem, effort=100_000).cost_steady
