"""Maps that change in part against maps made anew."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import room

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, Pose, SurfaceMap, plan
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.places import places_for
from energyplan.terrain import Terrain
from energyplan.terrain.updates import Window, tables_of

COST = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)


def boxes(rng: np.random.Generator, shape: tuple[int, int], share: float) -> np.ndarray:
    """Return cells with single blocked ones and boxes."""
    rows, columns = shape
    occupied = rng.random(shape) < share
    for _ in range(int(rng.integers(0, 6))):
        row, column = rng.integers(0, rows), rng.integers(0, columns)
        height, width = rng.integers(1, max(rows // 3, 2)), rng.integers(1, max(columns // 3, 2))
        occupied[row : row + height, column : column + width] = True
    return occupied


def anew(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the same map, of which nothing is known yet."""
    return replace(grid)


def patch_at(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[np.ndarray, int, int]:
    """Return a patch of any size, often at a border, and where it goes."""
    height, width = (int(rng.integers(1, n + 1)) for n in shape)
    if rng.random() < 0.7:
        height, width = min(height, 9), min(width, 9)
    row, column = (
        int(rng.choice([0, n - m, rng.integers(0, n - m + 1)]))
        for n, m in zip(shape, (height, width), strict=True)
    )
    share = float(rng.choice([0.0, 0.05, 1.0]))
    return boxes(rng, (height, width), share), row, column


@pytest.mark.parametrize("seed", range(12))
def test_distances_after_patches_are_those_of_a_new_map(seed):
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(1, 90)), int(rng.integers(1, 90))
    hidden = boxes(rng, shape, 0.01) if rng.random() < 0.5 else None
    grid = OccupancyGrid(
        boxes(rng, shape, float(rng.choice([0.0, 0.001, 0.02]))), 0.07, Pose(1, 2, 0.4), hidden
    )
    assert grid.space.clearance.shape == shape
    for _ in range(4):
        cells, row, column = patch_at(rng, shape)
        unknown = boxes(rng, cells.shape, 0.0) if rng.random() < 0.3 else None
        grid = grid.updated(cells, row, column, unknown)
        new = anew(grid)
        assert np.array_equal(grid.space.clearance, new.space.clearance)
        assert np.array_equal(grid.space.next_blocked, new.space.next_blocked)
        assert np.array_equal(grid.clearance, new.clearance)
        place = slice(row, row + cells.shape[0]), slice(column, column + cells.shape[1])
        assert np.array_equal(grid.occupied[place], cells)


@pytest.mark.parametrize("clearance", [0.0, 0.11])
@pytest.mark.parametrize(("resolution", "size"), [(0.03, (4, 6)), (0.1, (9, 12)), (0.4, (24, 18))])
def test_free_configurations_after_patches_are_those_of_a_new_map(resolution, size, clearance):
    rng = np.random.default_rng(int(1000 * resolution))
    shape = round(size[0] / resolution), round(size[1] / resolution)
    occupied = rng.random(shape) < 0.02 * resolution
    grid = OccupancyGrid(occupied, resolution, Pose(-3, 1, 0.3))
    ends = [Pose(float(x), float(y), 0.0) for x, y in rng.uniform(0, 1, (2, 2))]

    def places(where: OccupancyGrid, enlarged: bool):
        problem = PlanningProblem(where, COST, *ends, clearance=clearance)
        return places_for(_unchecked(problem).setting, enlarged)

    for enlarged in (False, True):
        places(grid, enlarged)
    for step in range(6):
        cells, row, column = patch_at(rng, shape)
        grid = grid.updated(cells, row, column)
        if step % 3 == 1:
            continue  # nobody looks at every map
        for enlarged in (False, True):
            for kept, new in zip(places(grid, enlarged), places(anew(grid), enlarged), strict=True):
                assert np.array_equal(kept, new)


def _unchecked(problem: PlanningProblem) -> CompiledProblem:
    query = object.__new__(CompiledProblem)
    object.__setattr__(query, "problem", problem)
    return query


def test_only_what_is_near_is_made_anew(monkeypatch):
    from energyplan.planning.space import configurations as made

    grid = room(800, 800, 0.05)
    problem = PlanningProblem(grid, COST, (3, 3, 0), (17, 17, 0))
    places_for(CompiledProblem(problem).setting)
    sizes = []
    original = made._masks
    monkeypatch.setattr(made, "_masks", lambda c, *a: sizes.append(c.size) or original(c, *a))
    closed = grid.updated(np.ones((4, 4), bool), 200, 200)
    later = PlanningProblem(closed, COST, (3, 3, 0), (17, 17, 0))
    places_for(CompiledProblem(later).setting)
    assert len(sizes) == 1
    assert sizes[0] < grid.occupied.size / 10


def test_keep_out_areas_stay_kept_out_of():
    grid = room(80, 80, 0.1, origin=(0.3, 0.1, 0.2))
    ground = SurfaceMap((), keep_out=(shapely.box(1.0, 3.0, 3.3, 4.1),))
    before = Terrain.of(grid, ground)
    assert before.obstacles.space.clearance.any()
    cells = np.zeros((40, 30), bool)
    cells[5, 5] = True
    after = before.updated(cells, 20, 10)
    new = Terrain(anew(after.grid), ground)
    assert np.array_equal(after.obstacles.occupied, new.obstacles.occupied)
    assert np.array_equal(after.obstacles.space.clearance, new.obstacles.space.clearance)
    assert after is Terrain.of(after.grid, ground)


def test_a_plan_on_a_map_that_changed_is_that_of_a_new_map():
    grid = room(120, 160, 0.05, np.s_[:70, 80])
    problem = PlanningProblem(grid, COST, (1.5, 2.0, 0), (6.5, 2.0, 0))
    plan(problem, effort=2_000)
    door = grid.updated(np.zeros((60, 1), bool), 5, 80)
    problems = [PlanningProblem(m, COST, problem.start, problem.goal) for m in (door, anew(door))]
    kept, new = (plan(p, effort=2_000) for p in problems)
    assert np.array_equal(kept.path.vertices, new.path.vertices)
    assert kept.lower_bound == new.lower_bound


def test_what_was_is_not_kept_when_maps_follow_each_other():
    grid = room(50, 50, 0.1)
    tables_of(grid.space).get("sum", lambda: grid.blocked.sum())
    for k in range(5):
        grid = grid.updated(np.ones((1, 1), bool), k, k)
    known = tables_of(grid.space)
    gc.collect()
    assert known.current == {}
    assert known.former["sum"].window == Window(0, 5, 0, 5)
    assert known.get("sum", lambda: -1, lambda old, window: old + 5) == 5
    assert known.get("sum", lambda: -1) == 5
