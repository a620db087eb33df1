"""What every planner says when there is no plan: which error, where, and what is nearest."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import walled

from energyplan.cost import EnergyCost
from energyplan.errors import (
    GoalInCollisionError,
    NoPathError,
    OutsideMapError,
    StartInCollisionError,
    TimeLimitError,
)
from energyplan.path import Path
from energyplan.planning import PLANNERS, PlanningProblem, plan
from energyplan.planning.search.narrow.infeasible import check_configurations, none_found
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.cost_to_go import cost_to_go
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
USED = sorted(PLANNERS)


OPEN = PlanningProblem(walled(True), COST, (2, 2, 0.3), (8, 2, 0))
SHUT = replace(OPEN, map=walled(False))


def numbers_after(message: str, words: str) -> list[float]:
    """The numbers in the first brackets after some words."""
    found = re.search(re.escape(words) + r"[^(]*\(([^)]*)\)", message)
    assert found, message
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", found[1])]


@pytest.mark.parametrize("name", USED)
@pytest.mark.parametrize(
    ("end", "error"), [("start", StartInCollisionError), ("goal", GoalInCollisionError)]
)
def test_an_end_in_collision(name, end, error):
    problem = replace(OPEN, **{end: (4.6, 2.0, 0.0)})
    with pytest.raises(error) as told:
        plan(problem, name, effort=10_000)
    assert numbers_after(str(told.value), end) == [4.6, 2.0, 0.0]
    x, y, degrees = numbers_after(str(told.value), "nearest free pose")
    assert problem.map.footprint_free([(x, y, np.radians(degrees))], problem.robot)[0]
    assert np.hypot(x - 4.6, y - 2.0) < 0.4


@pytest.mark.parametrize("name", USED)
@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_outside_the_map(name, end):
    problem = replace(OPEN, **{end: (12.0, 2.0, 0.0)})
    with pytest.raises(OutsideMapError, match="x from 0 to 10 m") as told:
        plan(problem, name, effort=10_000)
    assert numbers_after(str(told.value), end) == [12.0, 2.0, 0.0]
    x, y, degrees = numbers_after(str(told.value), "nearest free pose")
    assert problem.map.footprint_free([(x, y, np.radians(degrees))], problem.robot)[0]
    assert np.hypot(x - 10.0, y - 2.0) < 0.5


@pytest.mark.parametrize("name", USED)
@pytest.mark.parametrize("kept_out", [False, True])
def test_no_path(name, kept_out):
    """The wall has no door, or the door is in a keep-out area."""
    closed = SurfaceMap([], keep_out=[shapely.box(4.5, 5.5, 5.5, 8.0)])
    problem = replace(OPEN, surfaces=closed) if kept_out else SHUT
    with pytest.raises(NoPathError, match=r"\(2\.00, 2\.00\) to .*\(8\.00, 2\.00\)") as told:
        plan(problem, name, effort=200_000)
    x, y = numbers_after(str(told.value), "the nearest")[:2]
    assert 0 < x < 4.8
    assert 0 < y < 8


@pytest.mark.parametrize("name", USED)
def test_time_over(name):
    with pytest.raises(TimeLimitError, match="give more time_limit"):
        plan(OPEN, name, time_limit=1e-6)
    with pytest.raises(TimeLimitError, match="give more effort"):
        plan(OPEN, name, effort=1)


def test_the_lattice_planner_says_how_near_it_got():
    with pytest.raises(TimeLimitError, match=r"reached is \(2.00, 2.00\), 6.00 m from it"):
        plan(OPEN, time_limit=1e-6)


def slit(room_left: float) -> PlanningProblem:
    """A wall of 0.2 m with a gap that a robot of 0.5 m by 1.2 m gets through only sideways."""
    robot = Vehicle.from_geometry(
        "wide", mass=80.0, wheelbase=0.3, track=1.0, length=0.5, width=1.2
    )
    occupied = np.zeros((200, 300), bool)
    occupied[:, 145:155] = True
    wide = round((0.5 + room_left) / 0.02)
    occupied[100 - wide // 2 : 100 - wide // 2 + wide, 145:155] = False
    cost = EnergyCost(PowerModel.paper(robot, K=47.0, mu=0.4))
    return PlanningProblem(OccupancyGrid(occupied, 0.02), cost, (1.2, 1.5, 0), (4.8, 2.5, 0))


@pytest.mark.parametrize(
    ("room_left", "done"),
    [(0.04, "free poses join start and goal"), (0.0, "do not join start and goal")],
)
def test_the_lattice_planner_says_what_it_did_before_it_searched(room_left, done):
    """Where motions along free poses take all effort, how far these lead is told."""
    problem = slit(room_left)
    with pytest.raises(TimeLimitError, match=done) as told:
        plan(problem, effort=1000)
    assert "0 places" not in str(told.value)
    x, y = numbers_after(str(told.value), "was reached")
    assert np.hypot(x - 4.8, y - 2.5) < np.hypot(1.2 - 4.8, 1.5 - 2.5)
    assert f"{np.hypot(x - 4.8, y - 2.5):.2f} m from it" in str(told.value)


def test_an_ompl_planner_says_how_near_it_got():
    with pytest.raises(TimeLimitError, match="as near to the goal as") as told:
        plan(OPEN, "rrtstar", effort=100)
    x, y = numbers_after(str(told.value), "as near to the goal as")
    assert OPEN.map.inside((x, y))


# -- how certain it is ------------------------------------------------------------------------


def gap(width: float) -> PlanningProblem:
    """A wall with a gap [m] that leads nowhere else."""
    occupied = np.zeros((160, 200), bool)
    occupied[:, 96:104] = True
    cells = round(width / 0.05)
    occupied[70 : 70 + cells, 96:104] = False
    return replace(OPEN, map=OccupancyGrid(occupied, 0.05))


@pytest.mark.parametrize("width", [0.0, 0.4, 0.5])
def test_no_path_is_proven_where_the_body_cannot_pass(width):
    """Quadriga is 0.65 m wide: its disc does not pass 0.4 m."""
    with pytest.raises(NoPathError, match="certainly") as told:
        plan(gap(width), effort=200_000)
    assert told.value.certainty == "proven"
    again = pickle.loads(pickle.dumps(told.value))
    assert (again.certainty, str(again)) == ("proven", str(told.value))


def test_there_is_a_path_where_the_body_passes():
    assert plan(gap(0.8), effort=200_000).energy > 0


@pytest.mark.parametrize("yaw", np.linspace(0.0, 3.0, 7))
def test_what_is_proven_has_no_path_at_any_width_that_is_driven(yaw):
    """Free straight ways through ever narrower gaps of a turned map are never declared closed."""
    for width in (0.65, 0.70, 0.75):
        problem = gap(width)
        turned = OccupancyGrid(problem.map.occupied, 0.05, (0.0, 0.0, yaw))
        y = 0.05 * 70 + 0.5 * round(width / 0.05) * 0.05
        c, s = np.cos(yaw), np.sin(yaw)
        start, goal = ((c * x - s * y, s * x + c * y, yaw) for x in (2.0, 8.0))
        asked = replace(problem, map=turned, start=start, goal=goal)
        straight = Path(asked.start, [6.0], [0.0])
        if turned.path_free(straight, asked.robot):
            query = CompiledProblem(asked)
            check_configurations(query, cost_to_go(query.setting))
            error = none_found(query, 0.1, (0.0, 0.0))
            assert error.certainty == "at_resolution"
            assert error.resolution == 0.1
            assert "finest" in str(error)


def test_only_a_resolution_is_named_where_a_finer_search_might_find_one():
    """A gap aslant that the body passes by a hair, if at all: no disc tells."""
    angle, size = 0.37, 0.02
    y, x = (np.mgrid[:300, :400] + 0.5) * size - np.array([3.0, 4.0])[:, None, None]
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    grid = OccupancyGrid((np.abs(along) < 0.5) & (np.abs(across) > 0.31), size)

    def told(width):
        robot = Vehicle.from_geometry(
            "thin", mass=40, wheelbase=0.6, track=0.5, length=1.0, width=width
        )
        cost = EnergyCost.from_coefficients(150.0, 60.0, robot.icr)
        problem = PlanningProblem(grid, cost, (1.5, 3, 0), (6.5, 3, 0), vehicle=robot)
        with pytest.raises(NoPathError) as error:
            plan(problem, effort=100_000, finest=1.0)
        return error.value

    # the widest body that is free all along a straight line through the gap is 0.5944 m wide
    assert told(0.6).certainty == "proven"
    hair = told(0.594)
    assert hair.certainty == "at_resolution"
    assert 0.05 <= hair.resolution < 0.5
    assert "none was found in cells of" in str(hair)
