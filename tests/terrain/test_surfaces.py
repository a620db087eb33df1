"""Surfaces with models of their own, and heights."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from worlds import COST, room
from worlds import MODEL as CONCRETE

from energyplan import EnergyCost, HeightMap, Path, Pose, PowerModel, SurfaceMap
from energyplan.path import point_ahead
from energyplan.power import effects
from energyplan.terrain import Surface, path_price

MARBLE = PowerModel.preset("quadriga:empty:marble")


def random_surfaces(rng, n=5):
    areas = []
    for _ in range(n):
        centre, radii = rng.uniform(-3, 3, 2), rng.uniform(0.3, 2.5, 9)
        angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
        ring = centre + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        hole = shapely.Point(*centre).buffer(0.2)
        areas.append(shapely.Polygon(ring).buffer(0).difference(hole))
    return SurfaceMap([Surface(area, MARBLE, f"s{k}") for k, area in enumerate(areas)])


def random_path(rng, n=12, longitudinal=0.0):
    ds, dtheta = rng.uniform(-2, 2, n), rng.uniform(-2, 2, n)
    dtheta[::4] = 0.0
    ds[1::4] = 0.0
    ds[2], dtheta[2] = 7.0, 9.0  # more than once round
    dtheta[3] = 1e-8
    return Path(Pose(*rng.uniform(-1, 1, 3)), ds, dtheta, longitudinal)


@pytest.mark.parametrize("longitudinal", [0.0, 0.2])
def test_shares_agree_with_dense_sampling(longitudinal):
    rng = np.random.default_rng(11)
    n = 4000
    for _ in range(6):
        ground, path = random_surfaces(rng), random_path(rng, longitudinal=longitudinal)
        shares = ground.shares(path)
        assert np.allclose(shares.sum(axis=1), 1.0, atol=1e-12)
        vertices = path.vertices
        for k in range(len(path)):
            steps = np.full((2, n), [[path.ds[k] / n], [path.dtheta[k] / n]])
            poses = Path(Pose(*vertices[k]), *steps, longitudinal).vertices
            poses = 0.5 * (poses[1:] + poses[:-1])
            regions = ground.region_at(point_ahead(poses, longitudinal))
            counted = np.bincount(regions, minlength=shares.shape[1]) / n
            # each crossing may misplace one sample
            assert np.abs(counted - shares[k]).max() < 12 / n


def test_lines_are_shared_as_segments_are():
    rng = np.random.default_rng(17)
    ground = random_surfaces(rng)
    starts, ends = rng.uniform(-4, 4, (2, 40, 2))
    shares = ground.line_shares(starts, ends)
    for k in range(40):
        step = ends[k] - starts[k]
        line = Path(Pose(*starts[k], np.arctan2(step[1], step[0])), [np.hypot(*step)], [0.0])
        assert np.allclose(shares[k], ground.shares(line)[0], atol=1e-12)
    assert np.allclose(SurfaceMap([]).line_shares(starts, ends), 1.0)


def test_a_straight_line_is_clipped_exactly():
    ground = SurfaceMap([Surface(shapely.box(1, -1, 3, 1), MARBLE)])
    path = Path(Pose(0, 0, 0), [5.0, 0.0], [0.0, 1.0])
    assert np.allclose(ground.shares(path), [[0.6, 0.4], [1.0, 0.0]], atol=1e-15)
    expected = COST.energy(path) + 2.0 * (2 * 90.0 - 2 * 113.0)
    price = path_price(path, COST, ground)
    assert price.energy == pytest.approx(expected, rel=1e-12)
    assert sum(price.by_term.values()) == pytest.approx(expected, rel=1e-12)


def test_a_turn_is_clipped_exactly():
    """A circle of radius 2 about the origin crosses x = 1 at 60 degrees."""
    ground = SurfaceMap([Surface(shapely.box(1, -9, 9, 9), MARBLE)])
    whole = Path(Pose(0, -2, 0), [4 * np.pi], [2 * np.pi])
    assert np.allclose(ground.shares(whole), [[2 / 3, 1 / 3]], atol=1e-14)
    back = Path(Pose(2, 0, np.pi / 2), [-2 * np.pi], [-np.pi])
    assert np.allclose(ground.shares(back), [[2 / 3, 1 / 3]], atol=1e-14)


def test_energy_of_one_surface_everywhere_is_that_surfaces_energy():
    rng = np.random.default_rng(12)
    path = random_path(rng)
    ground = SurfaceMap([Surface(shapely.box(-99, -99, 99, 99), MARBLE)])
    found = path_price(path, COST, ground).energy
    assert found == pytest.approx(EnergyCost(MARBLE).energy(path), rel=1e-12)
    bare = path_price(path, COST, SurfaceMap([])).by_term
    assert bare == pytest.approx(COST.breakdown(path), rel=1e-12)


def test_the_last_of_overlapping_surfaces_counts():
    box = shapely.box(0, 0, 1, 1)
    ground = SurfaceMap([Surface(box, MARBLE), Surface(box, CONCRETE)])
    assert ground.region_at((0.5, 0.5)) == 2
    assert [cost.model for cost in ground.costs(COST)] == [CONCRETE, MARBLE, CONCRETE]


def test_raster_agrees_with_points():
    grid = room(30, 40, 0.2, origin=(-4, -3, 0.3))
    ground = random_surfaces(np.random.default_rng(13))
    raster = ground.raster(grid)
    row, column = np.indices(grid.shape)
    centres = grid.to_world(np.stack([column + 0.5, row + 0.5], axis=-1))
    assert np.array_equal(raster, ground.region_at(centres))
    assert len(np.unique(raster)) > 3
    assert not SurfaceMap([]).raster(grid).any()
    far = SurfaceMap([Surface(shapely.box(100, 100, 200, 200), MARBLE)])
    assert not far.raster(grid).any()


@pytest.mark.parametrize("seed", range(4))
def test_a_cell_that_surfaces_share_is_of_the_highest_rank_there(seed):
    rng = np.random.default_rng(seed)
    yaw = 0.0 if seed == 3 else 1.3 * seed
    c, s = np.cos(yaw), np.sin(yaw)
    grid = room(24, 20, 0.25, origin=(3.0 * s - 2.5 * c, -2.5 * s - 3.0 * c, yaw))
    ground = random_surfaces(rng)
    if seed == 3:  # edges on those of cells, which then share nothing
        ground = SurfaceMap([Surface(shapely.box(-2.0, -2.0, 1.0, 1.5), MARBLE)] * 2)
    rank = rng.permutation(len(ground.surfaces) + 1)
    # what shows of each surface, and of none
    shown, above = [], shapely.Polygon()
    for surface in reversed(ground.surfaces):
        shown.append(surface.area.difference(above))
        above = above.union(surface.area)
    shown = [shapely.box(-99, -99, 99, 99).difference(above), *reversed(shown)]
    row, column = np.indices(grid.shape)
    corners = np.stack([column, row], -1)[:, :, None] + [(0, 0), (1, 0), (1, 1), (0, 1)]
    cells = shapely.polygons(grid.to_world(corners))
    there = np.array([shapely.area(shapely.intersection(cells, area)) > 1e-6 for area in shown])
    highest = np.where(there, rank[:, None, None], -1).max(axis=0)
    edges = [shapely.intersects(cells, surface.area.boundary) for surface in ground.surfaces]
    found, middle = ground.raster(grid, rank), ground.raster(grid)
    assert np.all(rank[found] >= highest)
    # where several edges meet a surface counts, too, of which none of them leaves anything
    few = np.sum(edges, axis=0) <= 1
    assert np.array_equal(rank[found][few], highest[few])
    assert np.all(few) or few.mean() > 0.5
    if seed == 3:
        assert np.array_equal(found, middle)
    else:
        assert np.count_nonzero(found != middle) > 20


def test_slope_of_a_tilted_plane():
    """Exact on a plane, in every heading and with the raster turned."""
    rng = np.random.default_rng(14)
    yaw, (gx, gy) = 0.7, (0.08, -0.13)
    c, s = np.cos(yaw), np.sin(yaw)
    i, j = np.indices((20, 30)) * 0.5
    x, y = 1 + c * j - s * i, -2 + s * j + c * i
    ground = HeightMap(gx * x + gy * y, 0.5, (1, -2, yaw))
    local = rng.uniform(0.1, 9.0, (50, 2))
    points = np.array([1, -2]) + local @ np.array([[c, s], [-s, c]])
    poses = np.column_stack([points, rng.uniform(-3, 3, 50)])
    along = gx * np.cos(poses[:, 2]) + gy * np.sin(poses[:, 2])
    assert np.allclose(ground.slope(poses), np.arctan(along), atol=1e-12)
    assert np.allclose(ground.height(points), points @ [gx, gy], atol=1e-12)


def test_slope_is_the_derivative_of_height():
    rng = np.random.default_rng(15)
    ground = HeightMap(rng.normal(size=(8, 9)), 0.5)
    points = rng.uniform(0.2, 3.2, (200, 2))
    points += np.where(np.abs(points / 0.5 % 1 - 0.5) > 0.49, 0.02, 0.0)
    step = 1e-6
    for axis, yaw in ((0, 0.0), (1, np.pi / 2)):
        ahead = points.copy()
        ahead[:, axis] += step
        numeric = (ground.height(ahead) - ground.height(points)) / step
        slope = ground.slope(np.column_stack([points, np.full(200, yaw)]))
        assert np.allclose(np.tan(slope), numeric, atol=1e-5)


def test_rise_is_the_difference_of_heights():
    ramp = HeightMap([[0, 1, 2], [0, 1, 2]], 1.0)
    assert np.isclose(ramp.rise(Path(Pose(0.1, 0.5, 0), [1.5], [0.0])), 1.5)


# -- heights ----------------------------------------------------------------------------------


GRADE = CONCRETE.with_term(effects.term("grade"), 83.1)


def test_energy_on_a_ramp():
    """Level cost of the length on the slope plus the weight times the rise, up and down."""
    cost = EnergyCost(GRADE)
    i = np.arange(11.0)
    ramp = HeightMap(np.tile(0.05 * i, (4, 1)), 1.0)
    up = Path(Pose(1, 1.5, 0), [6.0], [0.0])
    level = cost.energy(up) * np.hypot(1.0, 0.05)
    expected = level + 83.1 * 9.81 * 6.0 * 0.05
    assert path_price(up, cost, None, ramp).energy == pytest.approx(expected, rel=1e-9)
    there_and_back = sum(path_price(way, cost, None, ramp).energy for way in (up, up.reversed()))
    assert there_and_back == pytest.approx(2 * level, rel=1e-9)


def test_energy_over_hills_is_the_potential():
    """Without losses the weight's work is that of the height between the ends."""
    rng = np.random.default_rng(16)
    cost = EnergyCost(GRADE)
    i, j = np.indices((60, 60)) * 0.2
    hills = HeightMap(0.2 * np.sin(0.5 * i) * np.cos(0.4 * j), 0.2)
    path = Path(Pose(4, 4, 0.3), rng.uniform(-1, 1.5, 6), rng.uniform(-1, 1, 6))
    heavy, light = (path_price(path, one, None, hills).energy for one in (cost, COST))
    assert heavy - light == pytest.approx(83.1 * 9.81 * hills.rise(path), rel=1e-9, abs=1e-9)
    assert 1.0 < light / COST.energy(path) < 1.02
