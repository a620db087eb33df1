"""Prices of motions against the cost that a plan reports of the whole path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import COST, MODEL, room

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.budget import Budget
from energyplan.planning.driven import Candidate
from energyplan.planning.plans import priced_plan
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.motions import motion_cost
from energyplan.planning.space.prices import TIE_BREAK, Prices
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap, Surface, SurfaceMap, path_price
from energyplan.vehicle import MotorLimits, TreadICR

LOPSIDED = EnergyCost(replace(MODEL, vehicle=MODEL.vehicle.with_icr(TreadICR(0.40, 0.54, 0.05))))
HUNGRY = EnergyCost(MODEL.with_term(HOTEL, 120.0))
OBJECTIVES = ["energy", "length", "time", {"energy": 1.0, "time": 70.0, "length": 30.0}]


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("cost", [LOPSIDED, HUNGRY])
def test_motions_add_up_to_the_cost_of_the_plan(cost, objective):
    """Far from obstacles, on one ground: element by element, and as a planner reports it."""
    rng = np.random.default_rng(31)
    path = Path(Pose(5, 5, 0), *rng.normal(0, 0.3, (2, 12)), cost.icr.longitudinal)
    problem = PlanningProblem(room(100, 100, 0.1), cost, path.start, path.end, objective=objective)
    query = CompiledProblem(problem)
    found = priced_plan(query, Candidate(path), 0.0, "none", Budget())
    prices = Prices(cost, objective=objective)
    assert prices.motion(path.ds, path.dtheta).sum() == pytest.approx(found.cost_steady, rel=1e-6)
    assert query.value(path) == pytest.approx(found.cost_steady, rel=1e-12)
    weights = {objective: 1.0} if isinstance(objective, str) else objective
    by_hand = (
        weights.get("energy", 0) * cost.energy(path)
        + weights.get("time", 0) * cost.duration(path)
        + weights.get("length", 0)
        * (path.length + TIE_BREAK * cost.energy(path) / float(cost.segment_energy(1.0, 0.0)))
    )
    assert found.cost_steady == pytest.approx(by_hand, rel=1e-12)
    # what the searches pay on their rays is what the plan will be charged
    ds, dtheta = query.reference(query.rays[:, 0], query.rays[:, 1] / cost.half_track)
    for k in range(0, len(ds), 7):
        ray = Path(path.start, ds[k : k + 1], dtheta[k : k + 1], cost.icr.longitudinal)
        assert query.prices[0, k] == pytest.approx(query.value(ray), rel=1e-6)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_each_ground_has_its_own_prices(objective):
    mud = PowerModel.paper(MODEL.vehicle, K=600.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(4, 0, 6, 10), mud)])
    prices = Prices(COST, ground, objective)
    path = Path(Pose(3, 5, 0), [5.0], [0.0])
    price = path_price(path, COST, ground)
    value = prices.value(price.energy, path.length, price.duration)
    parts = prices.motion(3.0, 0.0) + prices.motion(2.0, 0.0, region=1)
    assert value == pytest.approx(float(parts), rel=1e-9)


def test_only_time_asks_for_a_speed_limit():
    free = EnergyCost(replace(MODEL, vehicle=replace(MODEL.vehicle, motor=MotorLimits())))
    assert float(Prices(free).motion(1.0, 0.0)) == pytest.approx(226.0)
    assert float(Prices(free, objective="length").motion(1.0, 0.0)) == pytest.approx(1.01)
    with pytest.raises(InvalidInputError, match="speed limit"):
        Prices(free, objective="time").motion(1.0, 0.0)


@pytest.mark.parametrize("cost", [COST, LOPSIDED])
@pytest.mark.parametrize("heights", [None, HeightMap([0.02 * np.arange(9)] * 9, 2.0, (-1, -1, 0))])
def test_no_search_gains_by_a_corner_of_a_surface_that_only_the_raster_knows(cost, heights):
    """Pieces as searches price them cost no less than by the polygons, but for their middles."""
    rng = np.random.default_rng(3)
    ice = PowerModel.paper(cost.vehicle, K=20.0, mu=0.05, name="ice")
    area = shapely.affinity.rotate(shapely.box(4.03, 3.02, 6.98, 6.91), 12.0)
    if heights is not None:
        cost, ice = EnergyCost(with_weight(cost.model)), with_weight(ice)
    ground, ends = SurfaceMap([Surface(area, ice)]), ((2, 2, 0), (8, 8, 0))
    problem = PlanningProblem(room(40, 40, 0.25), cost, *ends, ground, heights=heights)
    query = CompiledProblem(problem)
    cheaper = 0
    for _ in range(100):
        pose = Pose(*rng.uniform((3, 2, -3), (8, 8, 3)))
        turn = Path(pose, [cost.icr.centre[1]], [1.0], cost.icr.longitudinal).subdivide(1.0, 0.01)
        motions = query.of_centre(turn.ds, turn.dtheta)
        searched, at = 0.0, turn.vertices
        for k in range(len(turn)):
            centre = query.centre(Pose(*at[k]))
            searched += motion_cost(query.setting, centre, motions.ds[k], motions.dtheta[k])
        searched += query.height_potential(turn.end) - query.height_potential(turn.start)
        value = query.value(turn)
        assert searched >= value * (1 - 1e-3)
        cheaper += value < 0.5 * cost.energy(turn)
    assert cheaper > 10


@pytest.mark.parametrize("cost", [COST, LOPSIDED])
def test_a_plan_turns_where_the_ground_is_slippery_and_not_beside_it(cost):
    """By hand: into the first cell of ice alone, around, and back; that before is half ice."""
    ice = PowerModel.paper(cost.vehicle, K=60.0, mu=0.03, name="ice")
    ground = SurfaceMap([Surface(shapely.box(5.07, 0, 10, 10), ice, "ice")])
    ahead = cost.icr.longitudinal
    onto, spin = 5.21 - ahead - 4.5, cost.icr.centre[1] * np.pi
    way = Path(Pose(4.5, 5, 0), [onto, spin, onto], [0, np.pi, 0], ahead)
    problem = PlanningProblem(room(50, 50, 0.2), cost, way.start, way.end, ground)
    by_hand = path_price(way, cost, ground).energy
    for effort in (1500, 4000):
        assert plan(problem, effort=effort).energy <= by_hand * (1 + 1e-3)
