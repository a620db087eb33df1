import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.path import Path, wrap_angle
from energyplan.planning import Budget, PlanningProblem, plan
from energyplan.planning.lattice import search as kernels
from energyplan.planning.lattice.portfolio import Portfolio
from energyplan.planning.lattice.search import Search, lattice_for
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.guide import distance_to_go
from energyplan.planning.scene.motions import free_energy
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def walls(gap=0.7):
    """Two walls across a hall of 10 m by 6 m, each with a gap that the body barely passes."""
    occupied = np.zeros((120, 200), bool)
    cells = round(gap / 0.05)
    for column, row in ((60, 30), (130, 70)):
        occupied[:, column : column + 16] = True
        occupied[row : row + cells, column : column + 16] = False
    return OccupancyGrid(occupied, 0.05)


def query(grid, start=(1.2, 3.1, 0.1), goal=(8.6, 2.0, -0.7)):
    return CompiledProblem(PlanningProblem(grid, COST, start, goal))


def searched(asked, aligned, weight=1.5):
    setting = asked.setting
    search = Search(setting, distance_to_go(setting), lattice_for(setting), weight, aligned=aligned)
    search.run(Budget(), stop_at_first=True, expansions=40_000)
    return search


def test_aligned_search_turns_to_the_maps_axes_and_returns_the_whole_path():
    asked = query(walls(0.9))
    search = searched(asked, aligned=True)
    lattice = search.lattice
    steps = (search.setting.start_yaw - asked.grid.origin.yaw) / lattice.turn
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert 0 < abs(search.spin) <= 0.5 * lattice.turn
    path = asked.path(search.segments())
    problem = asked.problem
    np.testing.assert_allclose(path.end[:2], problem.goal[:2], atol=1e-6)
    assert wrap_angle(path.end.yaw - problem.goal.yaw) == pytest.approx(0, abs=1e-6)
    spin = float(COST.segment_energy(0.0, search.spin))
    assert COST.energy(path) == pytest.approx(float(search.tree.best[0]) + spin, rel=1e-9)


def test_headings_along_the_axes_find_gaps_that_others_miss():
    asked = query(walls())
    assert searched(asked, aligned=True).found
    assert not searched(asked, aligned=False).found


def test_plan_passes_the_gaps():
    asked = query(walls())
    found = plan(asked.problem, effort=50_000)
    assert asked.grid.path_free(found.path, COST.vehicle)
    assert found.energy < 2.0 * found.lower_bound


def test_estimate_is_never_below_free_space():
    asked = query(walls(1.2))
    setting = asked.setting
    field = distance_to_go(setting)
    rng = np.random.default_rng(5)
    shortcuts = 0
    for x, y, yaw in rng.uniform((0.5, 0.5, -np.pi), (9.5, 5.5, np.pi), (400, 3)):
        estimate = kernels._estimate(setting, field, x, y, yaw)
        free = free_energy(setting, x, y, yaw)
        assert estimate >= free * (1 - 1e-12)
        shortcuts += bool(estimate > free * (1 + 1e-9))
    assert shortcuts > 20


def test_portfolio_keeps_the_best_and_never_makes_it_worse():
    grid = OccupancyGrid(np.zeros((80, 120), bool), 0.1)
    asked = query(grid, (2, 4, 0), (10, 4, 0))
    detours = []
    for angle in (1.2, 0.9, 0.6, 0.3):
        leg = 4.0 / np.cos(angle)
        detours.append(Segments(np.array([0, leg, 0, leg, 0]), angle * np.array([1, 0, -2, 0, 1])))
    costs = [COST.energy(Path((2, 4, 0), *motions)) for motions in detours]
    portfolio = Portfolio(asked.setting, seed=1)
    seen = []
    for motions, cost in zip(detours, costs, strict=True):
        portfolio.enter(motions)
        assert portfolio.cost <= cost * (1 + 1e-12)
        seen.append(portfolio.cost)
    portfolio.run(Budget(), 0.0)
    seen.append(portfolio.cost)
    portfolio.finish(Budget(), 0.0)
    seen.append(portfolio.cost)
    portfolio.again(Budget(), 0.0)
    seen.append(portfolio.cost)
    assert np.all(np.diff(seen) <= 1e-9)
    # shortcuts find the straight line between the ends, which is the best there is
    assert portfolio.cost == pytest.approx(float(COST.segment_energy(8.0, 0.0)), rel=1e-9)
    assert COST.energy(asked.path(portfolio.best)) == pytest.approx(portfolio.cost, rel=1e-9)
