"""A stop has its price: a path with fewer of them is taken where driving it takes less."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from by_day import by_day
from worlds import MODEL as PAPER
from worlds import cluttered, free_poses, room

from energyplan import EnergyCost, Path, PlanningProblem, Pose, PowerModel, compare, plan
from energyplan.planning import Budget
from energyplan.planning.driven import drive_path, drive_plan, stops_count
from energyplan.planning.search import planner
from energyplan.planning.search.stops import Answer
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power.effects import term
from energyplan.terrain import SpeedLimit, Surface, SurfaceMap


def rolling(hotel=0.0):
    """A robot that rolls easily: what it has in motion is worth metres, and brakes give none."""
    model = PowerModel.paper(PAPER.vehicle, K=10.0, mu=0.1)
    model = model.with_term(term("linear_inertia"), PAPER.vehicle.mass)
    model = model.with_term(term("angular_inertia"), PAPER.vehicle.yaw_inertia)
    model = model.with_term(term("regeneration_efficiency"), 1.0)
    return model.with_term(term("hotel_load"), hotel) if hotel else model


def slalom():
    """Walls with gaps to either side in turn; above them all a free lane."""
    columns = enumerate(range(60, 190, 25))
    walls = [(slice(0, 36) if k % 2 else slice(28, 106), slice(at, at + 3)) for k, at in columns]
    return room(140, 240, 0.1, *walls)


def problem(model, speed):
    cost = EnergyCost(model, speed=speed)
    return PlanningProblem(slalom(), cost, start=(2.5, 4.0, 0.0), goal=(21.5, 4.0, 0.0))


# what stands still draws is what a stop costs: a path with fewer may be longer, and turn more
@pytest.mark.parametrize("hotel", by_day([0.0, 60.0, 120.0], [60.0]))
def test_a_path_with_fewer_stops_is_taken_where_driving_it_takes_less(hotel, monkeypatch):
    asked = problem(rolling(hotel), 1.2)
    made = plan(asked, effort=40_000)
    assert "driven" in vars(made)
    monkeypatch.setattr(planner, "stops_count", lambda problem: False)
    steady = plan(asked, effort=40_000)
    assert made.energy > steady.energy
    # the drive by which it was chosen is that of the plan
    assert made.energy_driven == drive_plan(asked, made.path).energy
    assert made.energy_driven < 0.9 * drive_plan(asked, steady.path).energy
    assert made.lower_bound <= steady.energy
    assert made.lower_bound <= made.energy_driven


def test_energies_that_are_compared_are_of_one_kind():
    told = compare(problem(rolling(), 1.2), effort=20_000)
    best, shortest = told.energy_optimal, told.shortest
    # at a steady speed the shortest takes less; it stops more often
    assert best.energy > shortest.energy
    assert best.energy_driven < 0.9 * shortest.energy_driven
    assert told.driven
    assert told.saving == pytest.approx(1 - best.energy_driven / shortest.energy_driven)
    assert sum(told.by_term.values()) == pytest.approx(shortest.energy_driven - best.energy_driven)


def test_a_known_path_is_driven_too_where_stops_take_little():
    # stops take a part of the energy that nothing is searched for
    model = PowerModel.paper(PAPER.vehicle, K=200.0, mu=0.6).with_term(term("hotel_load"), 0.1)
    asked = problem(model, 1.2)
    known = plan(asked.shortest, effort=8_000).path
    made = plan(asked, effort=8_000, initial=[known])
    assert made.energy_driven <= drive_plan(asked, known).energy


def test_where_stops_take_nothing_the_path_stays_what_it_is(monkeypatch):
    asked = problem(PowerModel.paper(PAPER.vehicle, K=10.0, mu=0.1), 1.2)
    made = plan(asked, effort=20_000)
    monkeypatch.setattr(planner, "stops_count", lambda problem: False)
    other = plan(asked, effort=20_000)
    assert made.energy == other.energy


def test_where_stops_take_next_to_nothing_the_path_stays_what_it_is(monkeypatch):
    # stops that take a ten-thousandth: below what is given a price
    model = PowerModel.paper(PAPER.vehicle, K=10.0, mu=0.1)
    model = model.with_term(term("linear_inertia"), 1e-4 * PAPER.vehicle.mass)
    asked = problem(model, 1.2)
    assert stops_count(asked)
    made = plan(asked, effort=8_000)
    monkeypatch.setattr(planner, "stops_count", lambda problem: False)
    assert made.energy <= 1.005 * plan(asked, effort=8_000).energy


def test_a_robot_that_cannot_be_timed_is_planned_for_all_the_same():
    weak = replace(PAPER.vehicle.motor, peak_power=20.0, continuous_power=20.0)
    model = replace(rolling(), vehicle=replace(PAPER.vehicle, motor=weak))
    assert plan(problem(model, 1.2), effort=5_000).energy > 0


def test_least_energy_is_that_of_the_best_way_through_corners():
    """With a hotel load, haste through rounded corners takes less than what is slowed for them."""
    vehicle = replace(PAPER.vehicle, tracking_tolerance=0.03)
    model = replace(rolling(120.0), vehicle=vehicle)
    path = Path(Pose(0.0, 0.0, 0.0), [2.0, 0.3, 2.0], [0.0, 0.4, 0.0])
    least = drive_path(path, EnergyCost(model))
    quick = drive_path(path, EnergyCost(model, speed=vehicle.motor.speed))
    stopped = drive_path(path, EnergyCost(model), tolerance=0.0)
    assert least.energy <= min(quick.energy, stopped.energy) * (1 + 1e-6)


def test_of_two_mirrored_ways_the_one_on_cheaper_ground_is_driven():
    model = rolling()
    rough = replace(model, coefficients=3.0 * model.coefficients)
    above = SurfaceMap([Surface(shapely.box(0, 5, 24, 14), rough)])
    asked = replace(
        problem(model, 1.2), map=room(100, 240, 0.1), surfaces=above,
        start=(2.0, 5.0, 0.0), goal=(12.0, 5.0, 0.0),
    )  # fmt: skip
    left = Path(asked.start, [0.0, 5.0, 0.0, 5.0, 0.0], [0.6, 0.0, -1.2, 0.0, 0.6])
    goal = Pose(*left.vertices[-1].tolist())
    query = CompiledProblem(replace(asked, goal=goal))
    right = Path(left.start, left.ds, -left.dtheta)
    for paths in ((left, right), (right, left)):
        answer = Answer(query, driven=True)
        for path in paths:
            answer.weigh(path, Budget())
        assert answer.path == right
        assert answer.driven.energy == drive_plan(query.problem, right).energy


OBJECTIVES = ["time", "energy", "length", {"energy": 1.0, "time": 100.0}]


@pytest.mark.parametrize("objective", OBJECTIVES, ids=str)
@pytest.mark.parametrize("seed", by_day(range(12), [0, 3]))
@pytest.mark.parametrize("hotel", by_day([0.0, 150.0], [150.0]))
def test_more_effort_is_never_worse(objective, seed, hotel):
    grid = cluttered(seed)
    poses = free_poses(grid, 400, seed)
    goal = poses[np.argmax(np.hypot(*(poses[:, :2] - poses[0, :2]).T))]
    cost = EnergyCost(PAPER.with_term(term("hotel_load"), hotel) if hotel else PAPER)
    asked = PlanningProblem(grid, cost, poses[0], goal, objective=objective)
    made = [plan(asked, effort=effort) for effort in (1500, 3000, 5000, 10_000)]
    assert all(more.cost <= less.cost * (1 + 1e-6) for less, more in pairwise(made))
    assert all(one.lower_bound <= one.cost for one in made)


def test_the_least_time_is_that_of_the_drive():
    """Round a slow area, where each stop takes two seconds."""
    zone = SurfaceMap((), speed_limits=[SpeedLimit(shapely.box(8, 2, 12, 8), 0.1)])
    asked = PlanningProblem(
        room(100, 200, 0.1), EnergyCost(PAPER), (2, 5, 0), (18, 5, 0), surfaces=zone,
        objective="time",
    )  # fmt: skip
    made = [plan(asked, effort=effort) for effort in (1500, 5000, 20_000)]
    assert all(one.cost == one.driven.duration < 22.2 for one in made)
    # a known path that is certain to take longer at any speed is no answer
    path = Path(asked.start, [16.0], [0.0])
    known = plan(asked, effort=5000, initial=[path])
    assert known.cost < 25.0 < 0.5 * drive_plan(asked, path).duration
