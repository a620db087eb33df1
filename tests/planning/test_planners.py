from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import walled

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import (
    InvalidInputError,
    UnknownNameError,
)
from energyplan.path import Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap, path_price
from energyplan.vehicle import TreadICR

MODEL = PowerModel.preset("quadriga:empty:concrete")
COST = EnergyCost(MODEL)


def problem(**changes):
    given = {"map": walled(True), "cost": COST, "start": (2, 2, 0), "goal": (8, 2, 0)}
    return PlanningProblem(**{**given, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"start": (0, 0)},
        {"goal": (1, 2, np.nan)},
        {"objective": "beauty"},
        {"objective": {"energy": -1.0}},
        {"objective": {}},
    ],
)
def test_malformed_problems_are_refused(changes):
    with pytest.raises(InvalidInputError):
        problem(**changes)


def test_unknown_planner_names_those_there_are():
    with pytest.raises(UnknownNameError, match="lattice"):
        plan(problem(), "nonsense", effort=10_000)


def test_plan_reports_what_the_model_says_of_its_path():
    found = plan(problem(), effort=10_000)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    assert found.cost == found.energy
    assert sum(found.breakdown.values()) == pytest.approx(found.energy, rel=1e-9)
    assert set(found.breakdown) == {term.name for term in MODEL.terms}
    assert found.length == found.path.length
    assert found.duration == pytest.approx(COST.duration(found.path), rel=1e-12)
    assert found.gap == pytest.approx(found.energy / found.lower_bound - 1)
    assert walled(True).path_free(found.path, COST.vehicle)
    np.testing.assert_allclose(np.array(found.path.end), (8, 2, 0), atol=1e-6)


def test_each_objective_is_best_at_its_own():
    plans = {
        name: plan(problem(objective=name), effort=10_000) for name in ("energy", "length", "time")
    }
    slack = 1.003
    assert plans["energy"].energy <= slack * min(p.energy for p in plans.values())
    assert plans["length"].length <= slack * min(p.length for p in plans.values())
    assert plans["time"].duration <= slack * min(p.duration for p in plans.values())
    for found in plans.values():
        assert found.lower_bound <= found.cost


def test_weights_trace_a_pareto_front():
    plans = [
        plan(problem(goal=(8, 2, 2.0), objective={"energy": 1.0, "time": weight}), effort=10_000)
        for weight in (0.0, 100.0, 1e4)
    ]
    energy, duration = [p.energy for p in plans], [p.duration for p in plans]
    assert energy[0] <= 1.003 * energy[1] <= 1.003**2 * energy[2]
    assert duration[2] <= 1.003 * duration[1] <= 1.003**2 * duration[0]
    assert duration[2] < 0.995 * duration[0]
    for found, weight in zip(plans, (0.0, 100.0, 1e4), strict=True):
        assert found.cost == pytest.approx(found.energy + weight * found.duration, rel=1e-9)


def test_surfaces_bend_the_route_around_costly_ground():
    room = OccupancyGrid(np.zeros((80, 120), bool), 0.1)
    mud = PowerModel.paper(MODEL.vehicle, K=600.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(4, 2.5, 8, 5.5), mud)])
    task = PlanningProblem(room, COST, (2, 4, 0), (10, 4, 0), surfaces=ground)
    found = plan(task, effort=12_000)
    straight = plan(replace(task, objective="length"), effort=12_000)
    assert straight.energy == pytest.approx(
        path_price(straight.path, COST, ground).energy, rel=1e-12
    )
    # through the mud: 4 m at 226 J/m and 4 m at 1200 J/m
    assert straight.energy == pytest.approx(4 * 226 + 4 * 1200, rel=0.01)
    assert found.energy < 0.6 * straight.energy
    assert ground.shares(found.path)[:, 1].sum() < 0.2 * len(found.path)
    # ground as everywhere else bends nothing
    same = SurfaceMap([Surface(shapely.box(4, 2.5, 8, 5.5), MODEL)])
    level = plan(replace(task, surfaces=same), effort=12_000)
    assert level.energy == pytest.approx(8 * 226, rel=1e-6)


UNEVEN = EnergyCost(replace(MODEL, vehicle=MODEL.vehicle.with_icr(TreadICR(0.40, 0.54, 0.05))))


@pytest.mark.parametrize(("start", "goal"), [((2, 2, 0), (8, 2, 0)), ((2, 2, 0.9), (8, 2, -2.2))])
def test_asymmetric_tread_icrs_plan_in_the_robots_own_frame(start, goal):
    found = plan(problem(cost=UNEVEN, start=start, goal=goal), effort=12_000)
    assert walled(True).path_free(found.path, UNEVEN.vehicle)
    assert found.energy == pytest.approx(UNEVEN.energy(found.path), rel=1e-12)
    np.testing.assert_allclose(np.array(found.path.end)[:2], goal[:2], atol=1e-6)
    assert np.cos(found.path.end.yaw - goal[2]) == pytest.approx(1.0, abs=1e-9)
    assert found.lower_bound <= found.energy
    # the map and the robot seen in a mirror: left is right
    vehicle = MODEL.vehicle.with_icr(TreadICR(0.54, 0.40, 0.05))
    (x0, y0, yaw0), (x1, y1, yaw1) = start, goal
    mirrored = problem(
        map=OccupancyGrid(walled(True).occupied[::-1], 0.1),
        cost=EnergyCost(replace(MODEL, vehicle=vehicle)),
        start=(x0, 8 - y0, -yaw0),
        goal=(x1, 8 - y1, -yaw1),
    )
    other = plan(mirrored, effort=12_000)
    assert other.energy == pytest.approx(found.energy, rel=0.02)  # of a search
    assert other.lower_bound == pytest.approx(found.lower_bound, rel=1e-3)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.5, -1.8])
def test_without_obstacles_asymmetric_tread_icrs_plan_the_exact_motion(turn):
    room = OccupancyGrid(np.zeros((120, 120), bool), 0.1)
    start = Pose(4.0, 6.0, turn)
    goal = Pose(4.0 + 3.0 * np.cos(turn + 0.8), 6.0 + 3.0 * np.sin(turn + 0.8), turn + 2.0)
    found = plan(PlanningProblem(room, UNEVEN, start, goal), effort=5_000)
    assert found.energy == pytest.approx(float(steering.energy(start, goal, UNEVEN)), rel=1e-3)


def test_map_with_turned_origin_gives_the_same_plan():
    turn = 0.6
    c, s = np.cos(turn), np.sin(turn)

    def moved(pose):
        x, y, yaw = pose
        return (3 + c * x - s * y, -1 + s * x + c * y, yaw + turn)

    here = plan(problem(), effort=10_000)
    there = plan(
        problem(
            map=OccupancyGrid(walled(True).occupied, 0.1, (3, -1, turn)),
            start=moved((2, 2, 0)),
            goal=moved((8, 2, 0)),
        ),
        effort=10_000,
    )
    assert there.energy == pytest.approx(here.energy, rel=2e-3)
    assert there.lower_bound == pytest.approx(here.lower_bound, rel=1e-3)
