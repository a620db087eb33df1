"""What every planner says when there is no plan: which error, where, and what is nearest."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely

from energyplan.cost import EnergyCost
from energyplan.errors import (
    GoalInCollisionError,
    NoPathError,
    OutsideMapError,
    StartInCollisionError,
    TimeLimitError,
)
from energyplan.planning import PLANNERS, PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, SurfaceMap

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
USED = sorted(PLANNERS)


def room(door: bool) -> OccupancyGrid:
    """10 m by 8 m with a wall across it, with or without a door of 2 m at the top."""
    occupied = np.zeros((80, 100), bool)
    occupied[: 60 if door else 80, 48:52] = True
    return OccupancyGrid(occupied, 0.1)


OPEN = PlanningProblem(room(True), COST, (2, 2, 0.3), (8, 2, 0))
SHUT = replace(OPEN, map=room(False))


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
    with pytest.raises(TimeLimitError, match=r"nearest to the goal at \(2.00, 2.00\)"):
        plan(OPEN, time_limit=1e-6)


def test_an_ompl_planner_says_how_near_it_got():
    """A gap that a disc inside the footprint passes and the robot does not."""
    occupied = room(True).occupied.copy()
    occupied[67:, 48:52] = True
    narrow = replace(OPEN, map=OccupancyGrid(occupied, 0.1))
    with pytest.raises(TimeLimitError, match="as near to the goal as") as told:
        plan(narrow, "rrtstar", effort=5000)
    x, y = numbers_after(str(told.value), "as near to the goal as")
    assert narrow.map.inside((x, y))
