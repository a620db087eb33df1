"""The clearance that a user sets: kept along the whole path, by every planner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.errors import (
    GoalInCollisionError,
    InvalidInputError,
    NoPathError,
    StartInCollisionError,
)
from energyplan.mission import Mission, Task, evaluate
from energyplan.planning import Planner, PlanningProblem, plan
from energyplan.planning.problem import MOVED
from energyplan.planning.replanning import replan
from energyplan.planning.search import planner as lattice
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
    with pytest.raises(NoPathError):
        plan(replace(problem, start=(0.6, 2, 0), clearance=0.3), effort=20_000)
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(InvalidInputError, match="clearance"):
            replace(problem, clearance=wrong)


@pytest.mark.parametrize(
    ("planner", "start", "goal", "there_is"),
    [
        ("rrtstar", (2.02, 2, 0), (7, 2, 0), 0.07),  # in front of the pillar
        ("lattice", (0.5, 2, 0), (7.54, 2, 0), 0.05),  # both ends, at the edges of the map
        # beside the pillar, where it cannot turn on the spot
        ("lattice", (2.7, 1.14, 0), (7, 2, 0), 0.04),
    ],
)
def test_ends_that_lack_the_clearance_are_left_and_reached_with_what_there_is(
    planner, start, goal, there_is
):
    problem = PlanningProblem(hall(1.4), COST, start, goal, clearance=0.15)
    found = plan(problem, planner, effort=10_000)
    assert nearest(problem.map, found.path) >= 0.5 * there_is
    fine = found.path.subdivide(0.02, 0.02)
    clear = np.flatnonzero(problem.map.footprint_free(fine.vertices, problem.robot))
    # beyond a robot's length from the ends the whole clearance is kept
    along = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    lacking = np.setdiff1d(np.arange(len(along)), clear)
    assert np.all(np.minimum(along, along[-1] - along)[lacking] < 1.0)
    assert f"has {there_is:.3f} m of the clearance of 0.15 m" in found.notes[0]
    # the bound is that of any clearance
    roomier = plan(replace(problem, clearance=0.0), effort=10_000)
    assert found.lower_bound <= roomier.cost * (1 + 1e-9)


@pytest.mark.parametrize("start", [(2.02, 2, 0), (0.5, 2, 0), (2.0895, 2, 0)])
def test_a_planner_is_called_once_between_poses_that_have_clearance_and_margin(start):
    """Also where only the margin lacks: the third start is half a millimetre off the pillar."""
    given = []

    def planner(problem, budget):
        given.append(problem)
        return lattice.plan(problem, budget)

    clearance = 0.0 if start[0] > 2.05 else 0.15
    problem = PlanningProblem(hall(1.4), COST, start, (7, 2, 0), clearance=clearance)
    found = plan(problem, Planner(planner, effort=True, bound=True), effort=5_000)
    (inner,) = given
    assert problem.fault(found.path) is None
    assert inner.start != problem.start and inner.goal == problem.goal
    wide = COST.vehicle.footprint + (clearance + 0.001) * np.array([[-1, -1], [1, 1]])
    assert problem.map.footprint_free(inner.start, replace(COST.vehicle, footprint=wide))


def test_a_start_that_just_touches_is_moved_and_told():
    room = hall(1.4)
    problem = PlanningProblem(room, COST, (2.11, 2, 0), (7, 2, 0), clearance=0.05)
    assert not room.footprint_free(problem.start, COST.vehicle)
    found = plan(problem, effort=5_000)
    by = np.hypot(found.path.start.x - 2.11, found.path.start.y - 2)
    assert 0.0 < by <= MOVED
    assert f"{by:.3f} m beside" in found.notes[0]
    with pytest.raises(StartInCollisionError, match="nearest free pose"):
        plan(replace(problem, start=(2.2, 2, 0)), effort=5_000)
    with pytest.raises(GoalInCollisionError):
        plan(replace(problem, start=(1, 2, 0), goal=(2.11, 2, 0)), effort=5_000)


def test_a_missions_start_that_just_touches_is_moved_and_told():
    mission = Mission(
        COST.model, hall(1.4), Battery.preset("quadriga"), (2.11, 2, 0),
        (Task("look", (1, 2, 0)),), planning_effort=1000, coefficient_spread=0.05,
    )  # fmt: skip
    assert mission.start == mission.home != (2.11, 2, 0)
    assert "beside it, at the nearest free pose" in evaluate(mission).warnings[0]


def test_a_robot_on_its_route_is_never_refused_for_the_clearance():
    """Nav2 replans from where localisation says that the robot is, a centimetre off the route."""
    problem = PlanningProblem(hall(1.4), COST, (1, 2, 0), (7, 2, 0), clearance=0.15)
    former = plan(problem, effort=5_000)
    rng = np.random.default_rng(1)
    lacking = 0
    for here in former.path.poses(0.1, 0.1)[::3]:
        start = here + rng.normal(0, (0.01, 0.01, 0.01))
        for again in (
            replan(problem, former, start=start, effort=2_000),
            plan(replace(problem, start=start), effort=2_000),
        ):
            there_is = replace(problem, start=start).clearance_at_ends
            assert nearest(problem.map, again.path) >= 0.5 * there_is - 1e-3
            assert bool(again.notes) == (there_is < 0.15)
            lacking += bool(again.notes)
    assert lacking > 3
