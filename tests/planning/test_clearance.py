"""The clearance that a user sets: kept along the whole path, by every planner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError, StartInCollisionError
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def hall(door: float) -> OccupancyGrid:
    """Return a hall with a pillar, and a wall with a door."""
    occupied = np.zeros((80, 160), bool)
    occupied[30:45, 50:60] = occupied[:, 110:112] = True
    half = round(door / 0.05 / 2)
    occupied[40 - half : 40 + half, 110:112] = False
    return OccupancyGrid(occupied, 0.05)


def nearest(grid: OccupancyGrid, path) -> float:
    """Return how near the footprint comes to an obstacle along a path, to a millimetre."""
    for grow in np.arange(0.0, 0.4, 0.001):
        wide = replace(
            COST.vehicle, footprint=COST.vehicle.footprint + grow * np.array([[-1, -1], [1, 1]])
        )
        if not grid.path_free(path, wide):
            return float(grow)
    return 0.4


@pytest.mark.parametrize("planner", ["lattice", "rrtstar"])
def test_the_clearance_is_kept(planner):
    problem = PlanningProblem(hall(1.4), COST, (1, 2, 0), (7, 2, 0))
    grazing = plan(problem, effort=10_000)
    kept = plan(replace(problem, clearance=0.15), planner, effort=10_000)
    assert nearest(problem.map, grazing.path) < 0.05
    assert nearest(problem.map, kept.path) >= 0.15
    assert kept.energy > grazing.energy
    assert kept.lower_bound <= kept.cost


def test_a_known_path_without_the_clearance_is_not_taken():
    problem = PlanningProblem(hall(1.4), COST, (1, 2, 0), (7, 2, 0))
    known = plan(problem, effort=10_000).path
    kept = plan(replace(problem, clearance=0.15), effort=10_000, initial=[known])
    assert nearest(problem.map, kept.path) >= 0.15


def test_what_the_clearance_closes_is_said():
    problem = PlanningProblem(hall(0.9), COST, (1, 2, 0), (7, 2, 0))
    assert plan(problem, effort=5_000).energy > 0
    with pytest.raises(NoPathError, match="certainly"):
        plan(replace(problem, clearance=0.3), effort=20_000)
    with pytest.raises(StartInCollisionError, match=r"grown by the clearance of 0\.3 m"):
        plan(replace(problem, start=(0.6, 2, 0), clearance=0.3), effort=5_000)
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(InvalidInputError, match="clearance"):
            replace(problem, clearance=wrong)
