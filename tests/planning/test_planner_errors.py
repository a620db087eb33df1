"""What every planner says when there is no plan: which error, where, and what is nearest."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import COST, box_robot, room, walled

import energyplan as ep
from energyplan.planning import PLANNERS

USED = sorted(PLANNERS)


OPEN = ep.PlanningProblem(walled(True), COST, (2, 2, 0.3), (8, 2, 0))
SHUT = replace(OPEN, map=walled(False))


def numbers_after(message: str, words: str) -> list[float]:
    """The numbers in the first brackets after some words."""
    found = re.search(re.escape(words) + r"[^(]*\(([^)]*)\)", message)
    assert found, message
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", found[1])]


@pytest.mark.parametrize("name", USED)
@pytest.mark.parametrize(
    ("end", "error"),
    [("start", ep.errors.StartInCollisionError), ("goal", ep.errors.GoalInCollisionError)],
)
def test_an_end_in_collision_or_outside_the_map(name, end, error):
    for at, raised, words, near in (
        (4.6, error, "touches an obstacle", 4.6),
        (12.0, ep.errors.OutsideMapError, "x from 0 to 10 m", 9.9),
    ):
        problem = replace(OPEN, **{end: (at, 2.0, 0.0)})
        with pytest.raises(raised, match=words) as told:
            ep.plan(problem, name, effort=10_000)
        assert numbers_after(str(told.value), end) == [at, 2.0, 0.0]
        x, y, degrees = numbers_after(str(told.value), "nearest free pose")
        assert problem.map.footprint_free([(x, y, np.radians(degrees))], problem.robot)[0]
        assert np.hypot(x - near, y - 2.0) < 0.4


@pytest.mark.parametrize("name", USED)
@pytest.mark.parametrize("kept_out", [False, True])
def test_no_path(name, kept_out):
    """The wall has no door, or the door is in a keep-out area."""
    closed = ep.SurfaceMap([], keep_out=[shapely.box(4.5, 5.5, 5.5, 8.0)])
    problem = replace(OPEN, surfaces=closed) if kept_out else SHUT
    with pytest.raises(
        ep.errors.NoPathError, match=r"\(2\.00, 2\.00\) to .*\(8\.00, 2\.00\)"
    ) as told:
        ep.plan(problem, name, effort=200_000)
    x, y = numbers_after(str(told.value), "the nearest")[:2]
    assert 0 < x < 4.8
    assert 0 < y < 8


@pytest.mark.parametrize("name", USED)
def test_time_over(name):
    with pytest.raises(ep.errors.TimeLimitError, match="give more time_limit"):
        ep.plan(OPEN, name, time_limit=1e-6)
    with pytest.raises(ep.errors.TimeLimitError, match="give more effort"):
        ep.plan(OPEN, name, effort=1)
    if name == "lattice":  # says how near it got
        with pytest.raises(
            ep.errors.TimeLimitError, match=r"reached is \(2.00, 2.00\), 6.00 m from it"
        ):
            ep.plan(OPEN, time_limit=1e-6)


def slit(room_left: float) -> ep.PlanningProblem:
    """A wall of 0.2 m with a gap that a robot of 0.5 m by 1.2 m gets through only sideways."""
    robot = ep.Vehicle.from_geometry(
        "wide", mass=80.0, wheelbase=0.3, track=1.0, length=0.5, width=1.2
    )
    wide = round((0.5 + room_left) / 0.02)
    low = 100 - wide // 2
    grid = room(200, 300, 0.02, np.s_[:low, 145:155], np.s_[low + wide :, 145:155])
    cost = ep.EnergyCost(ep.PowerModel.paper(robot, K=47.0, mu=0.4))
    return ep.PlanningProblem(grid, cost, (1.2, 1.5, 0), (4.8, 2.5, 0))


@pytest.mark.parametrize(
    ("room_left", "done"),
    [(0.04, "free poses join start and goal"), (0.0, "do not join start and goal")],
)
def test_the_lattice_planner_says_what_it_did_before_it_searched(room_left, done):
    """Where motions along free poses take all effort, how far these lead is told."""
    problem = slit(room_left)
    with pytest.raises(ep.errors.TimeLimitError, match=done) as told:
        ep.plan(problem, effort=1000)
    assert "0 places" not in str(told.value)
    x, y = numbers_after(str(told.value), "was reached")
    assert np.hypot(x - 4.8, y - 2.5) < np.hypot(1.2 - 4.8, 1.5 - 2.5)
    assert f"{np.hypot(x - 4.8, y - 2.5):.2f} m from it" in str(told.value)


def test_an_ompl_planner_says_how_near_it_got():
    with pytest.raises(ep.errors.TimeLimitError, match="as near to the goal as") as told:
        ep.plan(OPEN, "rrtstar", effort=100)
    x, y = numbers_after(str(told.value), "as near to the goal as")
    assert OPEN.map.inside((x, y))


# -- how certain it is ------------------------------------------------------------------------


def test_only_a_resolution_is_named_where_a_finer_search_might_find_one():
    """A gap aslant that the body passes by a hair, if at all: no disc tells."""
    angle, size = 0.37, 0.02
    y, x = (np.mgrid[:300, :400] + 0.5) * size - np.array([3.0, 4.0])[:, None, None]
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    grid = ep.OccupancyGrid((np.abs(along) < 0.5) & (np.abs(across) > 0.31), size)

    def told(width):
        robot = box_robot(1.0, width)
        cost = ep.EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
        problem = ep.PlanningProblem(grid, cost, (1.5, 3, 0), (6.5, 3, 0), vehicle=robot)
        with pytest.raises(ep.errors.NoPathError) as error:
            ep.plan(problem, effort=100_000)
        return error.value

    # the widest body that is free all along a straight line through the gap is 0.5944 m wide
    assert told(0.6).certainty == "proven"
    hair = told(0.594)
    assert hair.certainty == "at_resolution"
    assert 0.05 <= hair.resolution < 0.5
    assert f"free poses {hair.resolution:.3g} m apart" in str(hair)
