"""Steering against bounds, closed forms and an independent optimum."""

from __future__ import annotations

import numpy as np

from energyplan import steering
from energyplan.cost import EnergyCost


def test_path_attains_the_energy_and_the_goal() -> None:
    cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=150.0, icr=0.5)
    rng = np.random.default_rng(2)
    goals = np.column_stack([rng.normal(size=(200, 2)) * 2, rng.uniform(-np.pi, np.pi, 200)])
    energies = steering.energy((0, 0, 0), goals, cost)
    for goal, energy in zip(goals, energies, strict=True):
        route = steering.path((0, 0, 0), goal, cost)
        np.testing.assert_allclose(cost.energy(route), energy, rtol=1e-9)
        np.testing.assert_allclose(route.end[:2], goal[:2], atol=1e-9)
        assert abs(np.sin(0.5 * (route.end.yaw - goal[2]))) < 1e-9
