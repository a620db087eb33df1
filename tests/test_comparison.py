from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_day import by_day

from energyplan import (
    EnergyCost,
    OccupancyGrid,
    PlanningProblem,
    PowerModel,
    compare,
    plan,
    read_map,
)

COST = EnergyCost(PowerModel.preset("quadriga:full:concrete"))


def pillars(seed: int) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    occupied = np.zeros((80, 120), bool)
    for row, column in zip(rng.integers(10, 70, 8), rng.integers(25, 95, 8), strict=True):
        occupied[row : row + 6, column : column + 6] = True
    return OccupancyGrid(occupied, 0.1)


@pytest.mark.parametrize("seed", by_day(range(4), range(2)))
def test_least_energy_never_exceeds_the_shortest_routes(seed):
    told = compare(
        PlanningProblem(pillars(seed), COST, (1.2, 4, 2.0), (10.8, 4, -1.0)), effort=30_000
    )
    assert told.energy_optimal.energy <= told.shortest.energy * (1 + 1e-12)
    assert told.shortest.length <= told.energy_optimal.length * 1.002
    least, most = (plan.energy_driven for plan in (told.energy_optimal, told.shortest))
    assert told.driven
    assert told.saving == pytest.approx(1 - least / most, rel=1e-12)
    assert told.saving >= 0
    assert sum(told.by_term.values()) == pytest.approx(most - least, rel=1e-9, abs=1e-6)


def test_where_the_motors_cannot_drive_a_route_steady_speeds_are_compared():
    weak = replace(COST.vehicle, motor=replace(COST.vehicle.motor, force=1.0))
    cost = EnergyCost(replace(COST.model, vehicle=weak))
    told = compare(PlanningProblem(pillars(0), cost, (1.2, 4, 2.0), (10.8, 4, -1.0)), effort=3_000)
    assert told.shortest.why_not_driven
    assert not told.driven
    assert told.saving == pytest.approx(1 - told.energy_optimal.energy / told.shortest.energy)
    assert "energy at steady speeds [J]" in str(told)
    assert "as driven" not in str(told)


def test_shortest_route_in_the_open_is_turn_drive_turn():
    room = OccupancyGrid(np.zeros((100, 100), bool), 0.1)
    told = compare(PlanningProblem(room, COST, (3, 5, 0.0), (6, 5, np.pi / 2)), effort=25_000)
    # 3 m straight and a quarter turn on the spot, priced by the paper's two terms
    expected = 3 * 2 * 118 + np.pi / 2 * (2 * 118 * 0.47 + 0.647 * COST.vehicle.slip_moment)
    assert told.shortest.energy == pytest.approx(expected, rel=2e-3)
    assert told.shortest.length == pytest.approx(3.0, rel=2e-3)
    assert told.energy_optimal.energy < 0.95 * told.shortest.energy


def test_a_worse_planner_falls_back_on_the_shortest_route():
    problem = PlanningProblem(pillars(1), COST, (1.2, 4, 0.0), (10.8, 4, 0.0))
    told = compare(problem, planner="rrtstar", effort=30_000)
    assert told.energy_optimal.energy <= told.shortest.energy
    assert told.energy_optimal.planner == "rrtstar"
    assert told.energy_optimal.lower_bound <= told.energy_optimal.energy


def test_the_shortest_route_is_made_shorter_than_a_plan_of_least_energy_knows_it():
    place = read_map(Path(__file__).parents[1] / "maps" / "warehouse.yaml")
    problem = PlanningProblem(place, COST, (2, 2, 0), (20, 12, 1.57))
    known = plan(replace(problem, objective="energy"), effort=5_000).shortest
    told = compare(problem, effort=5_000)
    assert told.shortest.length < known.length - 0.02
    assert told.shortest.cost_steady >= told.shortest.lower_bound_steady
    assert problem.shortest.fault(told.shortest.path) is None
