"""The clearance that a user sets: kept along the whole path, by every planner."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace

import numpy as np
import pytest
from worlds import COST, room

import energyplan as ep
from energyplan.planning.problem import MOVED
from energyplan.planning.replanning import replan
from energyplan.planning.search import planner as lattice

WIDER = np.array([[-1, -1], [1, 1]])
"""What a metre more of room adds to a footprint."""


def hall(door: float) -> ep.OccupancyGrid:
    """Return a hall with a pillar, and a wall with a door."""
    half = round(door / 0.05 / 2)
    walls = np.s_[: 40 - half, 110:112], np.s_[40 + half :, 110:112]
    return room(80, 160, 0.05, np.s_[30:45, 50:60], *walls)


def nearest(grid: ep.OccupancyGrid, path) -> float:
    """Return how near the footprint comes to an obstacle along a path, to a millimetre."""

    def touches(millimetres: int) -> bool:
        wide = COST.vehicle.footprint + 0.001 * millimetres * WIDER
        return not grid.path_free(path, replace(COST.vehicle, footprint=wide))

    return 0.001 * bisect_left(range(400), True, key=touches)


@pytest.mark.parametrize("planner", ["lattice", "rrtstar"])
def test_the_clearance_is_kept(planner):
    problem = ep.PlanningProblem(hall(1.4), COST, (1, 2, 0), (7, 2, 0))
    grazing = ep.plan(problem, effort=10_000)
    kept = ep.plan(replace(problem, clearance=0.15), planner, effort=10_000)
    assert nearest(problem.map, grazing.path) < 0.05
    assert nearest(problem.map, kept.path) >= 0.15
    assert kept.energy > grazing.energy
    if planner == "lattice":  # a known path without the clearance is not used
        kept = ep.plan(replace(problem, clearance=0.15), effort=10_000, initial=[grazing.path])
        assert nearest(problem.map, kept.path) >= 0.15


def test_what_the_clearance_closes_is_said():
    problem = ep.PlanningProblem(hall(0.9), COST, (1, 2, 0), (7, 2, 0))
    assert ep.plan(problem, effort=5_000).energy > 0
    with pytest.raises(ep.errors.NoPathError, match="certainly"):
        ep.plan(replace(problem, clearance=0.3), effort=20_000)
    with pytest.raises(ep.errors.NoPathError):
        ep.plan(replace(problem, start=(0.6, 2, 0), clearance=0.3), effort=20_000)


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
    problem = ep.PlanningProblem(hall(1.4), COST, start, goal, clearance=0.15)
    found = ep.plan(problem, planner, effort=10_000)
    assert nearest(problem.map, found.path) >= 0.5 * there_is
    fine = found.path.subdivide(0.02, 0.02)
    clear = np.flatnonzero(problem.map.footprint_free(fine.vertices, problem.robot))
    # beyond a robot's length from the ends the whole clearance is kept
    along = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    lacking = np.setdiff1d(np.arange(len(along)), clear)
    assert np.all(np.minimum(along, along[-1] - along)[lacking] < 1.0)
    assert f"has {there_is:.3f} m of the clearance of 0.15 m" in found.notes[0]
    # the bound is that of any clearance
    roomier = ep.plan(replace(problem, clearance=0.0), effort=10_000)
    assert found.lower_bound <= roomier.cost * (1 + 1e-9)


@pytest.mark.parametrize("start", [(2.02, 2, 0), (0.5, 2, 0), (2.0895, 2, 0)])
def test_a_planner_is_called_once_between_poses_that_have_clearance_and_margin(start):
    """Also where only the margin lacks: the third start is half a millimetre off the pillar."""
    given = []

    def planner(problem, budget):
        given.append(problem)
        return lattice.plan(problem, budget)

    clearance = 0.0 if start[0] > 2.05 else 0.15
    problem = ep.PlanningProblem(hall(1.4), COST, start, (7, 2, 0), clearance=clearance)
    found = ep.plan(problem, ep.Planner(planner, effort=True, bound=True), effort=5_000)
    (inner,) = given
    assert problem.fault(found.path) is None
    assert inner.start != problem.start and inner.goal == problem.goal
    wide = COST.vehicle.footprint + (clearance + 0.001) * WIDER
    assert problem.map.footprint_free(inner.start, replace(COST.vehicle, footprint=wide))


def test_a_start_that_just_touches_is_moved_and_told():
    room = hall(1.4)
    problem = ep.PlanningProblem(room, COST, (2.11, 2, 0), (7, 2, 0), clearance=0.05)
    assert not room.footprint_free(problem.start, COST.vehicle)
    found = ep.plan(problem, effort=5_000)
    by = np.hypot(found.path.start.x - 2.11, found.path.start.y - 2)
    assert 0.0 < by <= MOVED
    assert f"{by:.3f} m beside" in found.notes[0]
    with pytest.raises(ep.errors.StartInCollisionError, match="nearest free pose"):
        ep.plan(replace(problem, start=(2.2, 2, 0)), effort=5_000)
    with pytest.raises(ep.errors.GoalInCollisionError):
        ep.plan(replace(problem, start=(1, 2, 0), goal=(2.11, 2, 0)), effort=5_000)


def test_a_missions_start_that_just_touches_is_moved_and_told():
    mission = ep.Mission(
        COST.model, hall(1.4), ep.Battery.preset("quadriga"), (2.11, 2, 0),
        (ep.Task("look", (1, 2, 0)),), planning_effort=1000, coefficient_spread=0.05,
    )  # fmt: skip
    assert mission.start == mission.home != (2.11, 2, 0)
    assert "beside it, at the nearest free pose" in ep.evaluate(mission).warnings[0]


def test_a_robot_on_its_route_is_never_refused_for_the_clearance():
    """Nav2 replans from where localisation says that the robot is, a centimetre off the route."""
    problem = ep.PlanningProblem(hall(1.4), COST, (1, 2, 0), (7, 2, 0), clearance=0.15)
    former = ep.plan(problem, effort=5_000)
    rng = np.random.default_rng(1)
    lacking = 0
    for here in former.path.poses(0.1, 0.1)[::3]:
        start = here + rng.normal(0, (0.01, 0.01, 0.01))
        for again in (
            replan(problem, former, start=start, effort=2_000),
            ep.plan(replace(problem, start=start), effort=2_000),
        ):
            there_is = replace(problem, start=start).clearance_at_ends
            assert nearest(problem.map, again.path) >= 0.5 * there_is - 1e-3
            assert bool(again.notes) == (there_is < 0.15)
            lacking += bool(again.notes)
    assert lacking > 3


def test_an_end_beside_a_wall_is_no_excuse_to_follow_the_wall():
    wall = room(120, 200, 0.1, np.s_[:10])
    side = 1.0 - COST.vehicle.footprint[0, 1] + 0.05
    problem = ep.PlanningProblem(wall, COST, (2, side, 0), (17, 6, 0), clearance=0.2)
    along = ep.Path(problem.start, [10, 1.5, 3], [0, 0.5, 0])
    problem = replace(problem, goal=along.end)
    assert wall.path_free(along, COST.vehicle)
    assert "does not keep the clearance of 0.2 m" in problem.fault(along)
    # what leaves the wall soon is an answer, and so is what has no room beside it
    away = ep.Path(problem.start, [0.8, 1.5, 10], [0, 0.5, 0])
    assert replace(problem, goal=away.end).fault(away) is None
    narrow = wall.updated(np.ones((20, 120), bool), row=26, column=0)
    slot = replace(problem, map=narrow, clearance=0.6)
    out = ep.Path(slot.start, [13.0], [0.0])
    assert replace(slot, goal=out.end).fault(out) is None
    assert problem.fault(ep.plan(problem, effort=3000, initial=[along]).path) is None
