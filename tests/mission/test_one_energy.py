"""One definition of driving: what a plan says that driving it takes is what a mission counts."""

from dataclasses import replace

import numpy as np
import pytest
from limits.fine_integral import random_case

from energyplan import plan
from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.limits.feasibility import check
from energyplan.mission import Mission, Spreads, Task
from energyplan.mission.routes import Legs
from energyplan.path import Pose
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid


def random_model(seed):
    """A random vehicle with its own way of driving, and the model of it."""
    rng = np.random.default_rng([7, seed])
    case = random_case(rng)
    vehicle = replace(
        case.vehicle,
        usual_speed=float(rng.choice([np.inf, 0.4 * case.vehicle.motor.speed])),
        tracking_tolerance=float(rng.choice([0.0, 0.03])),
    )
    return replace(case.model, vehicle=vehicle)


MODELS = {
    **{f"random {seed}": random_model(seed) for seed in range(6)},
    "quadriga": PowerModel.preset("quadriga:full:marble"),
    "husky": PowerModel.preset("husky_a200:flooring"),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_leg_takes_what_a_plan_of_the_same_pair_says(name):
    model = MODELS[name]
    reach = float(np.abs(model.vehicle.footprint).max())
    start, goal = Pose(4 * reach, 6 * reach, 0.3), Pose(15 * reach, 8 * reach, -1.5)
    cells = np.zeros((120, 200), bool)
    cells[:70, 95:100] = True
    grid = OccupancyGrid(cells, 0.1 * reach)
    speed = model.vehicle.driving_speed
    cost = EnergyCost(model, battery=True, speed=speed if np.isfinite(speed) else None)
    told = plan(PlanningProblem(grid, cost, start, goal), effort=500)
    mission = Mission(
        model=model, map=grid, battery=Battery.preset("quadriga"), start=start,
        tasks=(Task("there", goal),), planning_effort=500, spreads=Spreads.none(),
        confidence=0.5,
    )  # fmt: skip
    leg = Legs(mission).leg(0, 1, 0.0)
    assert leg.trouble == ""
    assert leg.energy.mean == pytest.approx(told.driven.energy, rel=1e-3)
    assert leg.duration == pytest.approx(told.driven.duration, rel=1e-3)
    report = check(leg.trajectory, model.battery_side())
    assert report.feasible
    assert report.energy == pytest.approx(leg.energy.mean, rel=1e-3)
