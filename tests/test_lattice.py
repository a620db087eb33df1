import numpy as np
import pytest

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.io.maps import read_map
from energyplan.maps import OccupancyGrid
from energyplan.planners import PlanningProblem, plan
from energyplan.power import PowerModel

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def room(width=10.0, height=10.0, resolution=0.1):
    return OccupancyGrid(
        np.zeros((round(height / resolution), round(width / resolution)), bool), resolution
    )


def test_free_space_plan_is_the_exact_steering_motion():
    rng = np.random.default_rng(3)
    for _ in range(5):
        start, goal = (
            np.array([*rng.uniform(2, 8, 2), rng.uniform(-np.pi, np.pi)]) for _ in range(2)
        )
        found = plan(PlanningProblem(room(), COST, start, goal))
        exact = float(steering.energy(start, goal, COST))
        assert found.energy == pytest.approx(exact, rel=1e-9)
        assert found.lower_bound == pytest.approx(exact, rel=1e-9)
        assert found.gap <= 1e-9


@pytest.mark.shared
def test_depot_reference_query(shared_data):
    grid = read_map(shared_data / "maps" / "depot.yaml")
    problem = PlanningProblem(grid, COST, (2, 2, 0), (28, 13, np.pi / 2))
    found = plan(problem, time_limit=5.0, gap=0.02)
    assert grid.path_free(found.path, problem.robot)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    # RRT* with a disc of 0.4 m is known to reach 6868 J in 30 s
    assert found.lower_bound <= found.energy < 6868
