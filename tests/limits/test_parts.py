"""Parts of speed profiles, each against an integral or a derivative by hand."""

from __future__ import annotations

import numpy as np
import pytest
from limits.test_speed import HOTEL, INERTIA, PAPER
from numpy.testing import assert_allclose

from energyplan.limits._windows import Basis, Fine, Window, Windows
from energyplan.limits.acceleration_table import Ladder, Runs, drift_about
from energyplan.limits.economy import Economy
from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.motor import largest_within
from energyplan.limits.speed import profile
from energyplan.path import FloatArray, Path, Pose
from energyplan.power.effects import term
from energyplan.terrain import HeightMap
from energyplan.vehicle import GRAVITY

RNG = np.random.default_rng(6)


@pytest.mark.parametrize("forward", [True, False])
def test_a_window_ends_where_its_energy_is_drawn(forward: bool) -> None:
    """Between places the squared rate runs straight over the way, and energy with the way."""
    rate = np.array([0.4, 0.9, 0.3, 0.6, 0.5])
    way = np.array([0.5, 0.8, 0.6, 0.7])
    time = np.concatenate([[0.0], np.cumsum(2.0 * way / (rate[:-1] + rate[1:]))])
    each = np.array([30.0, 80.0, 10.0, 50.0])
    drawn = np.concatenate([[0.0], np.cumsum(each)])
    fine = Fine(rate, time, np.stack([drawn, drawn]), np.arange(5), np.zeros(5))
    found = Windows.found(fine, Window(power=10.0, time=7.0), 0, forward)
    # by small steps of the way
    s = np.linspace(0.0, way.sum(), 200_001)
    ends = np.concatenate([[0.0], np.cumsum(way)])
    speed = np.sqrt(np.interp(s, ends, rate**2))
    clock = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (speed[1:] + speed[:-1]))])
    energy = np.interp(s, ends, drawn)
    assert len(found.point) >= 2
    for point, lasts in zip(found.point, found.lasts, strict=True):
        goal = drawn[point] + (70.0 if forward else -70.0)
        there = np.interp(goal, energy, clock)
        assert lasts == pytest.approx(abs(there - time[point]), rel=1e-4)
    assert found.least == 7.0


def test_accelerations_of_a_tread_are_those_of_its_share_times_the_rate() -> None:
    n = 9
    knots = np.arange(0, n, 2)
    behind = np.minimum(np.arange(n) // 2, len(knots) - 1)
    hats = np.maximum(1.0 - np.abs(np.arange(n)[:, None] / 2.0 - np.arange(len(knots))), 0.0)
    basis = Basis(knots, behind, hats)
    side, rate = RNG.uniform(0.5, 1.0, n), RNG.uniform(0.3, 0.8, n)
    length = RNG.uniform(0.1, 0.3, n - 1)
    matrix = basis.accelerations(side, rate, length)
    # v = s r: its rate of change is r (s r)' = s' r^2 + s (r^2)' / 2, as means over a cell
    for factors in (np.ones(len(knots)), RNG.uniform(0.7, 1.3, len(knots))):
        square = (hats @ factors) * rate**2
        turn, mean = np.diff(side) / length, 0.5 * (side[1:] + side[:-1])
        by_hand = turn * 0.5 * (square[1:] + square[:-1]) + mean * np.diff(square) / length / 2.0
        told = matrix @ factors
        assert all(np.min(np.abs(by_hand - one)) < 1e-12 for one in told)
        if np.all(factors == 1.0):
            assert told.max() == pytest.approx(by_hand.max())
            assert told.min() == pytest.approx(by_hand.min())


def test_a_shape_changes_over_twice_the_reach_of_a_jump() -> None:
    shape = np.array([[1.0, 0.0], [1.0, 0.5], [0.8, 0.5]])
    found = drift_about(np.array([0.25, 0.4]), shape, np.array([0.1, 0.0]))
    assert_allclose(found[1, :2], [0.0, 0.5 * 1.2 / 0.5])
    assert_allclose(found[0, 2:], found[1, :2])
    # without a jump nothing changes, and nothing does before the first run or after the last
    assert_allclose(found[[0, 1, 2], [0, 2, 2]], 0.0)
    assert_allclose(found[2], 0.0)


def test_a_climb_and_a_descent_take_the_way_of_their_accelerations() -> None:
    runs = Runs(np.ones(2), np.array([0.0, 0.5]), np.zeros((4, 2)), HOTEL, {})
    rates = np.linspace(0.0, 1.0, 6)[:, None] * np.ones(2)
    bound = np.full((5, 2), 2.0)
    economy = Economy(runs, Ladder(rates, bound, bound), 0.1)
    up, down = RNG.uniform(0.3, 2.0, (2, 5, 2))
    kind, rung = np.array([0, 1]), np.array([3, 4])
    told = economy._distance(kind, rung, up, down)
    for k in range(2):
        part = slice(0, int(rung[k]) + 1)
        rise = np.diff(rates[:, kind[k]] ** 2)[part] / 2.0
        assert told[k] == pytest.approx(np.sum(rise / up[part, k] + rise / down[part, k]))


def test_a_steady_speed_is_held_back_by_no_inertia() -> None:
    curvature, speed = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 1.5, 16)
    still, heavy = (feasible_region(model, curvature, speed) for model in (PAPER, INERTIA))
    assert 0 < still.sustained.sum() < still.sustained.size
    assert np.array_equal(still.sustained, heavy.sustained)
    assert_allclose(still.use, heavy.use)
    assert_allclose(still.max_speed, heavy.max_speed)


def test_energy_up_a_slope_is_that_of_the_longer_way_and_the_climb() -> None:
    """Resistance acts along the ground, which is longer than the plan, and gravity up it."""
    model = PAPER.with_term(term("grade"), 50.0)
    rise = 0.3
    ground = HeightMap(rise * np.arange(12.0) * np.ones((4, 1)), 1.0)
    trajectory = profile(Path(Pose(2.0, 2.0, 0.0), [6.0], [0.0]), model, heights=ground)
    found = check(trajectory, model, heights=ground).energy
    resistance = 2.0 * model.coefficient("traction_resistance") * 6.0 * np.hypot(1.0, rise)
    assert found == pytest.approx(resistance + 50.0 * GRAVITY * rise * 6.0, rel=1e-3)


def test_values_are_sought_only_where_some_are_within_and_some_are_not() -> None:
    """Of five elements one ends within, one is beyond at once, and three are within throughout."""
    first = np.array([0.3, 0.0, 2.0, np.inf, 1.0])
    tried = []

    def use(values: FloatArray) -> FloatArray:
        tried.append(values.shape)
        return np.where(values > first, 2.0, 0.5)

    top = np.array([1.0, 1.0, 1.0, 3.0, 1.0])
    assert_allclose(largest_within(use, top), [0.3, 0.0, 1.0, 3.0, 1.0], rtol=1e-12)
    tried.clear()
    first = np.array([1.0, 0.0])
    assert largest_within(use, np.ones(2)).tolist() == [1.0, 0.0]
    assert len(tried) == 1
