"""Prices of motions against the cost that a plan reports of the whole path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem
from energyplan.planning.contract import priced_plan
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.planning.scene.prices import TIE_BREAK, Prices
from energyplan.power import HOTEL, PowerModel
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap, path_price
from energyplan.vehicle import MotorLimits, TreadICR

MODEL = PowerModel.preset("quadriga:empty:concrete")
LOPSIDED = EnergyCost(replace(MODEL, vehicle=MODEL.vehicle.with_icr(TreadICR(0.40, 0.54, 0.05))))
HUNGRY = EnergyCost(MODEL.with_term(HOTEL, 120.0))
OBJECTIVES = ["energy", "length", "time", {"energy": 1.0, "time": 70.0, "length": 30.0}]


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("cost", [LOPSIDED, HUNGRY])
def test_motions_add_up_to_the_cost_of_the_plan(cost, objective):
    """Far from obstacles, on one ground: element by element, and as a planner reports it."""
    rng = np.random.default_rng(31)
    path = Path(Pose(5, 5, 0), *rng.normal(0, 0.3, (2, 12)), cost.icr.longitudinal)
    room = OccupancyGrid(np.zeros((100, 100), bool), 0.1)
    query = CompiledProblem(PlanningProblem(room, cost, path.start, path.end, objective=objective))
    found = priced_plan(query, path, 0.0, "none", planning_time=0.0)
    prices = Prices(cost, objective=objective)
    assert prices.motion(path.ds, path.dtheta).sum() == pytest.approx(found.cost, rel=1e-6)
    assert query.value(path) == pytest.approx(found.cost, rel=1e-12)
    weights = {objective: 1.0} if isinstance(objective, str) else objective
    by_hand = (
        weights.get("energy", 0) * cost.energy(path)
        + weights.get("time", 0) * cost.duration(path)
        + weights.get("length", 0)
        * (path.length + TIE_BREAK * cost.energy(path) / float(cost.segment_energy(1.0, 0.0)))
    )
    assert found.cost == pytest.approx(by_hand, rel=1e-12)
    # what the searches pay on their rays is what the plan will be charged
    ds, dtheta = query.reference(query.rays[:, 0], query.rays[:, 1] / cost.half_track)
    for k in range(0, len(ds), 7):
        ray = Path(path.start, ds[k : k + 1], dtheta[k : k + 1], cost.icr.longitudinal)
        assert query.prices[0, k] == pytest.approx(query.value(ray), rel=1e-6)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_each_ground_has_its_own_prices(objective):
    mud = PowerModel.paper(MODEL.vehicle, K=600.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(4, 0, 6, 10), mud)])
    cost = EnergyCost(MODEL)
    prices = Prices(cost, ground, objective)
    path = Path(Pose(3, 5, 0), [5.0], [0.0])
    price = path_price(path, cost, ground)
    value = prices.value(price.energy, path.length, price.duration)
    parts = prices.motion(3.0, 0.0) + prices.motion(2.0, 0.0, region=1)
    assert value == pytest.approx(float(parts), rel=1e-9)


def test_only_time_asks_for_a_speed_limit():
    free = EnergyCost(replace(MODEL, vehicle=replace(MODEL.vehicle, motor=MotorLimits())))
    assert float(Prices(free).motion(1.0, 0.0)) == pytest.approx(226.0)
    assert float(Prices(free, objective="length").motion(1.0, 0.0)) == pytest.approx(1.01)
    with pytest.raises(InvalidInputError, match="speed limit"):
        Prices(free, objective="time").motion(1.0, 0.0)
