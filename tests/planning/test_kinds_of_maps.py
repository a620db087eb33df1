"""Maps of all kinds: speckled, unknown in part, of tiny or huge cells, small, long, full."""

from __future__ import annotations

import numpy as np
import pytest
from test_closure import robot

from energyplan.errors import (
    GoalInCollisionError,
    NoPathError,
    OutsideMapError,
    PlanningError,
    StartInCollisionError,
)
from energyplan.io.maps import read_map
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.terrain import OccupancyGrid


def answer(grid, start, goal, size=(0.9, 0.6)) -> Plan | PlanningError:
    """Plan with little effort; return the plan, or the error that says why there is none."""
    try:
        return plan(PlanningProblem(grid, robot(*size), start, goal), effort=5000)
    except PlanningError as error:
        return error


def empty(rows: int, columns: int, cell: float) -> OccupancyGrid:
    return OccupancyGrid(np.zeros((rows, columns), bool), cell)


@pytest.mark.parametrize(
    ("grid", "start", "goal"),
    [
        (empty(30, 30, 0.05), (0.7, 0.7, 0), (0.8, 0.8, 1.5)),
        (empty(30, 30, 0.1), (0.7, 0.7, 0), (2.3, 2.3, 1.5)),
        (empty(30, 30, 1.0), (3.0, 3.0, 0), (25.0, 25.0, 1.5)),
        (empty(1, 100, 1.0), (2.0, 0.5, 0), (90.0, 0.5, 0)),
        (empty(24, 1500, 0.05), (1.0, 0.6, 0), (74.0, 0.6, 0)),
        (empty(1500, 24, 0.05), (0.6, 1.0, 1.57), (0.6, 74.0, 1.57)),
        (empty(250, 250, 0.012), (0.8, 0.8, 0), (2.1, 2.1, 1.0)),
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


def test_what_is_unknown_is_closed_unless_said_otherwise(tmp_path):
    image = np.full((120, 160), 254, np.uint8)
    image[:, 80:84] = 205
    image[50:70, 80:84] = 254
    yaml = tmp_path / "map.yaml"
    yaml.write_text(
        "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )

    def known() -> OccupancyGrid:
        (tmp_path / "map.pgm").write_bytes(b"P5\n160 120\n255\n" + image.tobytes())
        return read_map(yaml)

    ends = (1.0, 1.0, 0), (7.0, 1.0, 0)
    assert answer(known(), *ends).length > 7.0
    assert abs(answer(known().with_unknown_free(), *ends).length - 6.0) < 1e-6
    image[50:70, 80:84] = 205
    closed = answer(known(), *ends)
    assert isinstance(closed, NoPathError)
    assert closed.certainty == "proven"
    assert "unknown cells" in str(closed)


def test_full_maps_and_borders_are_told_of():
    full = np.ones((100, 100), bool)
    assert isinstance(
        answer(OccupancyGrid(full, 0.05), (1, 1, 0), (4, 4, 0)), StartInCollisionError
    )
    full[10:40, 10:40] = full[60:90, 60:90] = False
    holes = answer(OccupancyGrid(full, 0.05), (1.25, 1.25, 0), (3.75, 3.75, 0))
    assert isinstance(holes, NoPathError)
    assert holes.certainty == "proven"
    hall = empty(100, 100, 0.05)
    beyond = answer(hall, (0.4, 0.3, 0), (4, 4, 0))
    assert isinstance(beyond, StartInCollisionError)
    assert "nearest free pose" in str(beyond)
    assert isinstance(answer(hall, (4, 4, 0), (0.4, 0.3, 0)), GoalInCollisionError)
    assert isinstance(answer(hall, (-1, 0.3, 0), (4, 4, 0)), OutsideMapError)
    # a millimetre from the border, facing away from it
    away = answer(hall, (0.451, 2.5, 0), (4.0, 1.0, 2.0))
    assert isinstance(away, Plan)
