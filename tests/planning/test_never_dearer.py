"""A plan for the least energy takes no more than the shortest route of the same effort."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.io.maps import read_map
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel

MAPS = pathlib.Path(__file__).resolve().parents[2] / "maps"
COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def compared(name, count, effort):
    """Compare both on random pairs of poses; return how many pairs were."""
    grid = read_map(MAPS / f"{name}.yaml")
    rng = np.random.default_rng(5)
    rows, columns = grid.shape
    poses = []
    while len(poses) < 2 * count:
        cells = rng.uniform((0, 0), (columns, rows), (50, 2))
        tried = np.column_stack([grid.to_world(cells), rng.uniform(-np.pi, np.pi, 50)])
        poses.extend(tried[grid.footprint_free(tried, COST.vehicle)])
    done = 0
    for start, goal in list(zip(poses[::2], poses[1::2], strict=False))[:count]:
        problem = PlanningProblem(grid, COST, start, goal)
        try:
            found = plan(problem, effort=effort)
            shortest = plan(replace(problem, objective="length"), effort=effort)
        except PlanningError:
            continue
        assert found.energy <= shortest.energy * (1 + 1e-9), (start, goal)
        done += 1
    return done


@pytest.mark.parametrize("name", ["office", "warehouse", "orchard"])
def test_a_plan_is_never_dearer_than_the_shortest_route(name):
    assert compared(name, 8, 3000) > 4


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["office", "warehouse"])
def test_no_plan_of_many_is_dearer_than_the_shortest_route(name):
    """In the orchard's many ways 2 of 70 are, and 1 of 70 with three times the effort."""
    assert compared(name, 70, 5000) > 40
