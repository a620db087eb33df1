"""Tables over the direction of motion against interpolation, hulls and sums of another library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from energyplan.cost import direction_table
from energyplan.cost.direction_table import (
    SPECIAL,
    DirectionTable,
    octant_directions,
    tabulate,
)

RNG = np.random.default_rng


def smooth(x, y):
    """A homogeneous energy that bends everywhere and is the same in no two octants."""
    size = np.hypot(x, y)
    angle = np.arctan2(y, x)
    return size * (3.0 + np.cos(angle - 0.4) + 0.2 * np.sin(3 * angle + 1.0))


def static(a=2.0, beta=0.7):
    """Straights and pivots of one price each, as a table of one interval."""
    x, y = octant_directions(np.array([0.0, 1.0]))
    return DirectionTable(
        np.array([0.0, 1.0]),
        a * np.maximum(abs(x), abs(y)) + beta * abs(y),
        a * np.abs(SPECIAL).max(axis=1) + beta * abs(SPECIAL[:, 1]),
        0.0,
    )


def test_between_nodes_an_element_costs_what_a_straight_line_says() -> None:
    rng = RNG(5)
    ratio = np.concatenate([[0.0], np.sort(rng.uniform(0.05, 0.95, 6)), [1.0]])
    values, special = rng.uniform(1.0, 9.0, (8, 8)), rng.uniform(1.0, 9.0, 8)
    table = DirectionTable(ratio, values, special, 0.0)
    for octant in range(8):
        place = rng.uniform(0.01, 0.99, 40)
        x, y = (part[octant] for part in octant_directions(place))
        size = rng.uniform(0.1, 20.0, 40)
        expected = size * np.interp(place, ratio, values[octant])
        assert table(size * x, size * y) == pytest.approx(expected, rel=1e-12)
    assert table(2.5 * SPECIAL[:, 0], 2.5 * SPECIAL[:, 1]) == pytest.approx(2.5 * special)
    nodes = table(*table.directions.T)
    assert nodes == pytest.approx(table.values, rel=1e-12)
    # eight octants without their ends, and every special direction once
    assert len(np.unique(table.directions.round(9), axis=0)) == 8 + 8 * 6


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_a_table_makes_the_error_that_it_tells_and_no_finer_intervals_than_needed(
    tolerance: float,
) -> None:
    table = tabulate(smooth, tolerance)
    angle = RNG(1).uniform(-np.pi, np.pi, 4000)
    x, y = np.cos(angle), np.sin(angle)
    off = np.abs(table(x, y) / smooth(x, y) - 1.0).max()
    assert off <= 1.1 * table.error
    assert 0.1 * tolerance < table.error <= tolerance
    assert table.special == pytest.approx(smooth(*SPECIAL.T))
    assert np.all(np.diff(table.ratio) > 0)
    assert (table.ratio[0], table.ratio[-1]) == (0.0, 1.0)


def outside(points, chosen):
    """By how much points lie outside of the hull of the chosen ones, as a fraction."""
    hull = ConvexHull(chosen)
    return float((points @ hull.equations[:, :2].T / -hull.equations[:, 2]).max()) - 1.0


@pytest.mark.parametrize("most", [3, 8, 40])
def test_corners_are_those_of_a_hull_and_leave_out_what_they_say(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(direction_table, "MOST_CORNERS", most)
    table = tabulate(smooth, 1e-5)
    points = table.directions / table.values[:, None]
    corners = table.corners()
    straight = points[:2]
    chosen = np.vstack([corners.left, corners.right, straight])
    assert np.all(corners.left[:, 1] > 0)
    assert np.all(corners.right[:, 1] < 0)
    hull = points[ConvexHull(points).vertices]
    away = np.abs(chosen[:, None] - hull).max(axis=-1).min(axis=1)
    assert away.max() < 1e-9
    assert outside(points, chosen) == pytest.approx(corners.error, rel=1e-3, abs=2e-7)
    for side in (corners.left, corners.right):
        x, y = np.abs(side).T
        special = np.count_nonzero(x < 1e-9) + np.count_nonzero(np.abs(x - y) < 1e-9)
        assert max(3, special) <= len(side) <= max(most, special)


@pytest.mark.parametrize("k", [0, 1, 4, 7])
@pytest.mark.parametrize("change", [0.99, 1.01])
def test_prices_that_differ_from_side_to_side_are_not_static(k: int, change: float) -> None:
    table = static()
    assert table.is_static
    special = table.special.copy()
    special[k] *= change
    assert not replace(table, special=special).is_static


def test_a_table_stays_static_where_a_direction_costs_more_than_a_mixture() -> None:
    table = tabulate(static())
    ratio = np.array([0.0, 0.4, 1.0])
    values = table(*octant_directions(ratio))
    for octant in range(8):
        for change in (0.999, 1.2):
            bent = values.copy()
            bent[octant, 1] *= change
            made = DirectionTable(ratio, bent, table.special, 0.0)
            assert made.is_static == (change > 1)
    assert not static(2.0, -0.1).is_static  # a pivot that is cheaper than a straight
