"""Maps of all kinds: speckled, unknown in part, of tiny or huge cells, small, long, full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_closure import robot
from worlds import room

from energyplan import OccupancyGrid, Plan, PlanningProblem, plan
from energyplan.errors import NoPathError, PlanningError, StartInCollisionError


def answer(grid, start, goal, size=(0.9, 0.6)) -> Plan | PlanningError:
    """Plan with little effort; return the plan, or the error that says why there is none."""
    try:
        return plan(PlanningProblem(grid, robot(*size), start, goal), effort=5000)
    except PlanningError as error:
        return error


@pytest.mark.parametrize(
    ("grid", "start", "goal"),
    [
        (room(30, 30, 0.05), (0.7, 0.7, 0), (0.8, 0.8, 1.5)),
        (room(30, 30, 0.1), (0.7, 0.7, 0), (2.3, 2.3, 1.5)),
        (room(30, 30, 1.0), (3.0, 3.0, 0), (25.0, 25.0, 1.5)),
        (room(1, 100, 1.0), (2.0, 0.5, 0), (90.0, 0.5, 0)),
        (room(24, 1500, 0.05), (1.0, 0.6, 0), (74.0, 0.6, 0)),
        (room(1500, 24, 0.05), (0.6, 1.0, 1.57), (0.6, 74.0, 1.57)),
        (room(250, 250, 0.012), (0.8, 0.8, 0), (2.1, 2.1, 1.0)),
    ],
    ids=["30 cells", "30 of 10 cm", "30 of 1 m", "one row", "long", "high", "12 mm"],
)
def test_empty_maps_of_any_shape_are_crossed_at_least_cost(grid, start, goal):
    found = answer(grid, start, goal)
    assert isinstance(found, Plan)
    assert abs(found.gap) < 1e-6


def speckled(share: float) -> OccupancyGrid:
    occupied = np.random.default_rng(0).random((300, 300)) < share
    occupied[:30, :30] = occupied[-30:, -30:] = False
    return OccupancyGrid(occupied, 0.05)


def test_single_cells_are_passed_where_there_is_room_between_them():
    ends = (0.75, 0.75, 0), (14.25, 14.25, 0)
    some = answer(speckled(0.002), *ends)
    assert isinstance(some, Plan)
    assert some.gap < 0.1
    # one cell in a hundred leaves 0.5 m between them on average: for a robot of 0.2 m alone
    small = answer(speckled(0.01), *ends, size=(0.3, 0.2))
    assert isinstance(small, Plan)
    large = answer(speckled(0.01), *ends)
    assert isinstance(large, NoPathError)
    assert large.certainty == "proven"


def test_what_is_unknown_is_closed_unless_said_otherwise():
    ends, above, below = ((1.0, 1.0, 0), (7.0, 1.0, 0)), np.s_[:50, 80:84], np.s_[70:, 80:84]
    grid = replace(room(120, 160, 0.05), unknown=room(120, 160, 0.05, above, below).occupied)
    assert answer(grid, *ends).length > 7.0
    assert answer(grid.with_unknown_free(), *ends).length == pytest.approx(6.0, abs=1e-6)
    closed = answer(replace(grid, unknown=room(120, 160, 0.05, np.s_[:, 80:84]).occupied), *ends)
    assert isinstance(closed, NoPathError)
    assert closed.certainty == "proven"
    assert "unknown cells" in str(closed)


def test_full_maps_and_borders_are_told_of():
    everything = np.s_[:, :]
    full = answer(room(100, 100, 0.05, everything), (1, 1, 0), (4, 4, 0))
    assert isinstance(full, StartInCollisionError)
    # a millimetre from the border, facing away from it
    assert isinstance(answer(room(100, 100, 0.05), (0.451, 2.5, 0), (4.0, 1.0, 2.0)), Plan)
