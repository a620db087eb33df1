from dataclasses import replace

import numpy as np
import pytest
import shapely
from refusals import check_refusal, lines
from worlds import COST, MODEL, room, walled

from energyplan.cost import EnergyCost
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.terrain import CostMap, OccupancyGrid, Surface, SurfaceMap
from energyplan.vehicle import TreadICR


def problem(**changes):
    given = {"map": walled(True), "cost": COST, "start": (2, 2, 0), "goal": (8, 2, 0)}
    return PlanningProblem(**{**given, **changes})


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
    assert plans["time"].driven.duration <= slack * plans["length"].driven.duration


@pytest.mark.parametrize("effort", [3000, 10_000, 30_000])
def test_least_time_is_less_than_that_of_least_energy(effort):
    quick, frugal = (plan(problem(objective=of), effort=effort) for of in ("time", "energy"))
    assert quick.driven.duration < frugal.driven.duration


def test_each_weight_of_time_is_best_at_its_own():
    weights = (0.0, 100.0, 1e4)
    plans = [
        plan(problem(goal=(8, 2, 2.0), objective={"energy": 1.0, "time": weight}), effort=10_000)
        for weight in weights
    ]
    for found, weight in zip(plans, weights, strict=True):
        others = [one.driven.energy + weight * one.driven.duration for one in plans]
        assert found.cost <= 1.01 * min(others)
        assert found.cost_steady == pytest.approx(
            found.energy_steady + weight * found.duration, rel=1e-9
        )


def test_surfaces_bend_the_route_around_costly_ground():
    mud = PowerModel.paper(MODEL.vehicle, K=600.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(4, 2.5, 8, 5.5), mud)])
    task = PlanningProblem(room(80, 120, 0.1), COST, (2, 4, 0), (10, 4, 0), surfaces=ground)
    found = plan(task, effort=12_000)
    straight = plan(replace(task, objective="length"), effort=12_000)
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


def test_map_with_turned_origin_gives_the_same_plan():
    turn = 0.6
    c, s = np.cos(turn), np.sin(turn)

    def moved(pose):
        x, y, yaw = pose
        return (3 + c * x - s * y, -1 + s * x + c * y, yaw + turn)

    here = problem()
    turned = replace(here.map, origin=(3, -1, turn))
    there = replace(here, map=turned, start=moved(here.start), goal=moved(here.goal))
    here, there = (plan(one, effort=10_000) for one in (here, there))
    assert there.energy == pytest.approx(here.energy, rel=2e-3)
    assert there.lower_bound == pytest.approx(here.lower_bound, rel=1e-3)


REFUSED = r"""
InvalidInputError: problem(start=(0, 0)) | start
InvalidInputError: problem(goal=(1, 2, np.nan)) | goal
InvalidInputError: problem(objective="beauty") | beauty
InvalidInputError: problem(objective={"energy": -1.0}) | energy
InvalidInputError: problem(objective={}) | objective
InvalidInputError: problem(clearance=-0.1) | clearance
InvalidInputError: problem(clearance=np.nan) | clearance
InvalidInputError: problem(clearance=np.inf) | clearance
InvalidInputError: problem(turning="sideways") | turning
InvalidInputError: problem(turning=0.0) | turning
InvalidInputError: problem(turning=-1.0) | turning
InvalidInputError: problem(turning=np.nan) | turning
InvalidInputError: problem(turning=1e308) | turning is 1e\+308; give .* 10000 m at most
InvalidInputError: problem(costmap_weight=-1.0) | weight of the costmap
InvalidInputError: problem(costmap_weight=np.inf) | weight of the costmap
InvalidInputError: problem(costmap_weight=np.nan) | weight of the costmap
MapError: CostMap([[0.0, 1.2]], 0.1) | numbers from 0 to 1
MapError: CostMap([[np.nan]], 0.1) | numbers from 0 to 1
MapError: CostMap([0.0, 1.0], 0.1) | numbers from 0 to 1
MapError: CostMap(np.zeros((0, 3)), 0.1) | numbers from 0 to 1
InvalidInputError: plan(problem(), effort=0) | effort is 0; give a (whole )?number
InvalidInputError: plan(problem(), effort=-5) | effort is -5; give a (whole )?number
InvalidInputError: plan(problem(), effort=np.nan) | effort is nan; give a (whole )?number
UnknownNameError: plan(problem(), "nonsense", effort=10_000) | lattice
UnknownNameError: plan(problem(), "rrtstar", effort=5000, no_such=1) | GoalBias
UnsupportedPlannerError: plan(problem(costmap=DRY, costmap_weight=9.0), "rrtstar") | a costmap
"""
DRY = CostMap(np.zeros((80, 100)), 0.1)


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, globals())
