"""Plans turn at speed where stops take time, or energy that counts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize

import energyplan as ep
from energyplan.limits.feasibility import check
from energyplan.planning.driven import drive_plan
from energyplan.power.effects import term

MODEL = ep.PowerModel.preset("quadriga:empty:concrete")
COST = ep.EnergyCost(MODEL)
HALL = ep.OccupancyGrid(np.zeros((120, 120), bool), resolution=0.1)


def standstills(plan):
    timed = plan.driven.trajectory
    return int(np.count_nonzero((timed.v == 0.0) & (timed.omega == 0.0)))


def least_time(start, goal, vehicle, count=24, fine=4):
    """Least time between two poses by optimal control: tread accelerations by interval [s]."""
    most, top = vehicle.motor.acceleration, vehicle.motor.speed
    track = vehicle.icr.slip_track

    def driven(given):
        step = given[-1] / count
        accelerations = given[:-1].reshape(2, count)
        ends = np.column_stack([np.zeros(2), np.cumsum(accelerations, axis=1) * step])
        part = np.linspace(0.0, 1.0, fine + 1)
        speed = ends[:, :-1, None] + part * np.diff(ends, axis=1)[..., None]
        middle = 0.5 * (speed[..., 1:] + speed[..., :-1]).reshape(2, -1)
        omega = (middle[1] - middle[0]) / track
        way = middle.mean(axis=0) * step / fine
        turn = omega * step / fine
        yaw = start[2] + np.cumsum(turn) - 0.5 * turn
        end = start + np.array([way @ np.cos(yaw), way @ np.sin(yaw), turn.sum()])
        return ends, end

    def error(given):
        ends, end = driven(given)
        return np.concatenate([end - goal, ends[:, -1]])

    def spare(given):
        ends, _ = driven(given)
        return np.concatenate([top - ends.ravel(), top + ends.ravel()])

    ahead = np.repeat([1.0, 0.0, -1.0], count // 3)
    guess = np.concatenate([0.5 * ahead, 0.5 * ahead, [10.0]])
    found = minimize(
        lambda given: given[-1],
        guess,
        method="SLSQP",
        bounds=[(-most, most)] * (2 * count) + [(1.0, 60.0)],
        constraints=[{"type": "eq", "fun": error}, {"type": "ineq", "fun": spare}],
        options={"maxiter": 200},
    )
    assert found.success
    return found.fun


def test_a_right_angle_in_open_ground_takes_little_more_than_by_optimal_control():
    """The computation knows the pose, the speeds and the accelerations of the treads alone."""
    start, goal = np.array([2.0, 2.0, 0.0]), np.array([7.0, 7.0, np.pi / 2])
    problem = ep.PlanningProblem(HALL, COST, start, goal, objective="time")
    plan = ep.plan(problem)
    least = least_time(start, goal, MODEL.vehicle)
    assert plan.lower_bound <= least * (1 + 1e-6)
    assert 0.999 * least <= plan.driven.duration <= 1.06 * least
    assert standstills(plan) == 2
    checked = check(plan.driven.trajectory, MODEL)
    assert checked.feasible


def test_a_corner_with_an_obstacle_at_its_inner_side_is_driven_at_speed():
    blocked = np.zeros((120, 120), bool)
    blocked[30:, 45:] = True  # all but an aisle along x and one along y
    grid = ep.OccupancyGrid(blocked, resolution=0.1)
    problem = ep.PlanningProblem(
        grid, COST, (10.0, 1.5, np.pi), (2.0, 10.0, np.pi / 2), objective="time"
    )
    plan = ep.plan(problem)
    assert grid.path_free(plan.path, MODEL.vehicle)
    assert standstills(plan) == 2
    stopping = ep.Path(
        ep.Pose(10.0, 1.5, np.pi), [7.5, 0.0, 8.5], [0.0, -np.pi / 2, 0.0]
    )  # up to 2.5, 1.5, and on to 2.5, 10
    assert plan.driven.duration < 0.93 * drive_plan(problem, stopping).duration


@pytest.mark.parametrize("objective", ["time", {"energy": 1, "time": 100}])
def test_more_effort_never_takes_more(objective):
    blocked = np.zeros((120, 120), bool)
    blocked[50:70, 30:90] = True
    grid = ep.OccupancyGrid(blocked, resolution=0.1)
    problem = ep.PlanningProblem(
        grid, COST, (6.0, 2.0, 1.0), (5.0, 10.0, -2.0), objective=objective
    )
    costs = [ep.plan(problem, effort=effort).cost for effort in (1000, 2000, 4000, 8000, 16000)]
    assert all(after <= before for before, after in pairwise(costs))
    assert costs[-1] < 0.95 * costs[0]


def test_the_least_energy_of_a_heavy_robot_with_computers_has_turns_at_speed():
    heavy = MODEL.with_term(term("linear_inertia"), 300.0).with_term(term("hotel_load"), 100.0)
    heavy = replace(heavy, vehicle=replace(heavy.vehicle, regen_efficiency=0.3))
    problem = ep.PlanningProblem(HALL, ep.EnergyCost(heavy), (2, 2, 0), (9, 9, np.pi / 2))
    plan = ep.plan(problem)
    turn = np.pi / 4
    stopping = ep.Path(ep.Pose(2, 2, 0), [0.0, 7.0 * 2**0.5, 0.0], [turn, 0.0, turn])
    assert plan.energy_driven < drive_plan(problem, stopping).energy
    assert len(plan.path) > 3


def test_where_stops_take_nothing_no_turn_is_changed():
    problem = ep.PlanningProblem(HALL, COST, (2, 2, 0), (9, 9, np.pi / 2))
    plan = ep.plan(problem)
    assert len(plan.path) == 3  # a turn, a straight line, a turn


@pytest.mark.parametrize("radius", [0.8, 2.0])
def test_turns_at_speed_keep_the_least_radius(radius):
    problem = ep.PlanningProblem(
        HALL, COST, (2, 2, 0), (9, 9, np.pi / 2), objective="time", turning=radius
    )
    plan = ep.plan(problem)
    turning = plan.path.dtheta != 0.0
    bend = np.abs(plan.path.ds[turning]) / np.abs(plan.path.dtheta[turning])
    assert bend.min() >= radius * (1 - 1e-6)
