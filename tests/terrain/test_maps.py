"""Occupancy grids and footprint collision, held against shapely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from refusals import check_refusal, lines
from scipy import ndimage
from shapely import affinity
from worlds import room

from energyplan import HeightMap, OccupancyGrid, Path, Pose, PowerModel, TreadICR, Vehicle
from energyplan.terrain import Surface
from energyplan.terrain import collision as _collision
from energyplan.terrain.updates import distance_to_blocked

VEHICLE = Vehicle.preset("quadriga")


def random_grid(rng, shape=(60, 80), share=0.01, resolution=0.1, yaw=0.4):
    occupied = rng.random(shape) < share
    return OccupancyGrid(occupied, resolution, Pose(-1.3, 2.1, yaw))


def obstacles_of(grid):
    """Return the blocked cells as one geometry in the world."""
    row, column = np.nonzero(grid.blocked)
    cells = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    return shapely.transform(cells, grid.to_world)


def map_area(grid):
    rows, columns = grid.shape
    return shapely.transform(shapely.box(0, 0, columns, rows), grid.to_world)


def rectangle(vehicle, pose):
    (x0, y0), (x1, y1) = vehicle.footprint
    body = affinity.rotate(shapely.box(x0, y0, x1, y1), pose[2], origin=(0, 0), use_radians=True)
    return affinity.translate(body, pose[0], pose[1])


def random_poses(rng, grid, n):
    rows, columns = grid.shape
    points = grid.to_world(rng.random((n, 2)) * [columns, rows])
    return np.column_stack([points, rng.uniform(-np.pi, np.pi, n)])


def test_poses_agree_with_shapely():
    rng = np.random.default_rng(1)
    grid = random_grid(rng)
    poses = random_poses(rng, grid, 4000)
    # headings along the axes of the grid are a special case of the kernel
    poses[:800, 2] = grid.origin.yaw + rng.integers(-4, 5, 800) * np.pi / 2
    poses[400:800, 2] += 10 ** rng.uniform(-12, -3, 400)
    obstacles, area = obstacles_of(grid), map_area(grid)
    shapely.prepare(obstacles)
    bodies = np.array([rectangle(VEHICLE, pose) for pose in poses])
    truth = ~shapely.intersects(obstacles, bodies) & shapely.covers(area, bodies)
    margin = np.minimum(
        shapely.distance(obstacles.boundary, bodies), shapely.distance(area.boundary, bodies)
    )
    sure = (margin > 1e-6) | ~truth
    found = grid.footprint_free(poses, VEHICLE)
    assert 0.1 < truth.mean() < 0.9
    assert np.array_equal(found[sure], truth[sure])
    assert not np.any(found & ~truth)


def test_motions_agree_with_shapely():
    """No false free, and no false collision where the gap is wider than the tolerance."""
    rng = np.random.default_rng(2)
    grid = random_grid(rng, share=0.006)
    obstacles, area = obstacles_of(grid), map_area(grid)
    shapely.prepare(obstacles)
    shapely.prepare(area)
    n = 600
    starts = random_poses(rng, grid, n)
    ds = rng.uniform(-2, 2, n)
    dtheta = rng.uniform(-2.5, 2.5, n)
    kind = np.arange(n) % 5
    ds[kind == 0] = 0.0
    dtheta[kind == 1] = 0.0
    ds[kind == 2] = 0.47 * dtheta[kind == 2]
    dtheta[kind == 3] *= 1e-7
    longitudinal = np.where(np.arange(n) % 2 == 0, 0.0, 0.15)
    tolerance = _collision.TOLERANCE * grid.resolution
    free = tight = 0
    for k in range(n):
        path = Path(Pose(*starts[k]), ds[k : k + 1], dtheta[k : k + 1], longitudinal[k])
        found = grid.path_free(path, VEHICLE)
        step = 0.05
        bodies = [rectangle(VEHICLE, p) for p in path.poses(step, step)]
        hit = any(obstacles.intersects(b) or not area.covers(b) for b in bodies)
        if found:
            free += 1
            assert not hit, k
        elif not hit:
            # sampled poses are free: only a near miss may count as a collision
            dense = [rectangle(VEHICLE, p) for p in path.poses(0.002, 0.002)]
            to_edge = (area.boundary.distance(b) if area.covers(b) else 0.0 for b in dense)
            gap = min(min(obstacles.distance(b) for b in dense), *to_edge)
            assert gap < tolerance + 0.002, k
            tight += 1
    assert 0.1 < free / n < 0.9
    assert tight < 0.05 * n


def test_swept_corner_is_found_between_free_poses():
    """A spin whose end poses are free but whose corner sweeps through an obstacle."""
    reach = np.hypot(*VEHICLE.footprint[1])
    post = int((reach - 0.011 + 2.0) / 0.02), 100
    grid = room(200, 200, 0.02, post, origin=(-2.0, -2.0, 0.0))
    spin = Path(Pose(0, 0, 0), [0.0], [np.pi])
    assert grid.footprint_free([spin.start, spin.end], VEHICLE).all()
    assert grid.first_collision(spin, VEHICLE) == 0
    assert grid.first_collision(Path(Pose(0, 0, 0), [0.1, 0.0], [0.0, np.pi]), VEHICLE) == 1


def test_clearance_is_exact():
    rng = np.random.default_rng(3)
    blocked = rng.random((41, 57)) < 0.01
    fine = np.zeros((2 * 41 + 1, 2 * 57 + 1), bool)
    for row, column in np.argwhere(blocked):
        fine[2 * row : 2 * row + 3, 2 * column : 2 * column + 3] = True
    fine[[0, -1], :] = fine[:, [0, -1]] = True
    expected = ndimage.distance_transform_edt(~fine)[1::2, 1::2] / 2
    assert np.allclose(distance_to_blocked(blocked), expected, atol=1e-5)
    assert np.allclose(distance_to_blocked(np.zeros((4, 9), bool)).max(), 2.0 - 0.5)


def test_unknown_cells_are_obstacles_unless_asked():
    unknown = np.zeros((40, 40), bool)
    unknown[18:22, 18:22] = True
    grid = OccupancyGrid(np.zeros((40, 40), bool), 0.1, unknown=unknown)
    centre = (2.0, 2.0, 0.0)
    assert not grid.footprint_free(centre, VEHICLE)
    assert grid.with_unknown_free().footprint_free(centre, VEHICLE)


def test_not_a_number_is_never_free():
    grid = room(40, 40, 0.1)
    poses = np.full((4, 3), 2.0)
    poses[[0, 1, 2], [0, 1, 2]] = np.nan
    assert grid.footprint_free(poses, VEHICLE).tolist() == [False, False, False, True]


def test_world_and_cells_are_inverse():
    rng = np.random.default_rng(5)
    grid = random_grid(rng)
    points = rng.normal(size=(50, 2))
    assert np.allclose(grid.to_world(grid.to_cells(points)), points)
    assert np.allclose(grid.to_cells(grid.origin[:2]), 0)
    along = grid.to_world([1.0, 0.0]) - np.array(grid.origin[:2])
    assert np.allclose(np.arctan2(along[1], along[0]), grid.origin.yaw)


def test_polygons_block_every_cell_they_touch():
    triangle = shapely.Polygon([(1, 1), (3, 1.2), (1.5, 2.7)])
    grid = OccupancyGrid.from_polygons([triangle], (0, 0, 4, 4), 0.1)
    outside = triangle.difference(obstacles_of(grid))
    assert outside.area < 1e-12
    assert obstacles_of(grid).difference(triangle.buffer(0.15)).area == 0
    assert not grid.occupied[0].any()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("far", [1e308, -1e308, np.inf, np.nan])
def test_what_lies_beyond_all_numbers_lies_on_no_map(far):
    grid = room(9, 9, 0.1, origin=(1.0, 2.0, 0.4))
    assert not grid.inside((far, far))
    assert not grid.inside((far, -far))
    assert not grid.inside((1.1, far))
    assert grid.inside((1.1, 2.3))


def test_a_mask_of_the_same_frame_keeps_out_of_its_occupied_cells():
    grid, kept, both = (
        room(6, 9, 0.1, *cells, origin=(1, 2, 0.3))
        for cells in ([(1, 2)], [(4, 5)], [(1, 2), (4, 5)])
    )
    mask = replace(kept, unknown=room(6, 9, 0.1, (0, 0)).occupied)
    assert np.array_equal(grid.with_mask(mask).occupied, both.occupied)


@pytest.mark.parametrize("resolution", [0.03, 0.1, 0.37])
def test_a_mask_of_another_frame_blocks_what_it_touches_and_little_more(resolution):
    rng = np.random.default_rng(4)
    grid = room(60, 80, 0.1, origin=(1.0, -2.0, 0.4))
    kept = rng.random((round(3 / resolution), round(4 / resolution))) < 0.02 + 0.2 * resolution
    mask = OccupancyGrid(kept, resolution, (2.0, 1.0, -0.9))
    blocked = grid.with_mask(mask).occupied
    row, column = np.nonzero(kept)
    cells = shapely.box(column, row, column + 1, row + 1)
    squares = [shapely.transform(cell, mask.to_world) for cell in cells]
    touched = grid.with_blocked(squares).occupied
    assert 20 < touched.sum() < 3000
    assert not np.any(touched & ~blocked)
    slack = np.sqrt(2) * max(resolution, 0.1) * 1.01
    near = grid.with_blocked([s.buffer(slack) for s in squares]).occupied
    assert not np.any(blocked & ~near)


FREE = np.zeros((3, 3), bool)
TEN = room(10, 10, 0.1)
BOX = shapely.box(0, 0, 1, 1)
MARBLE = PowerModel.preset("quadriga:empty:marble")
AHEAD = PowerModel.paper(MARBLE.vehicle.with_icr(TreadICR(0.5, 0.5, 0.1)), 90.0, 0.4)
BOW = shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])
RAMP = HeightMap([[0, 1, 2], [0, 1, 2]], 1.0)
REFUSED = r"""
MapError: OccupancyGrid(np.zeros((0, 3), bool), 0.1) | shape
MapError: OccupancyGrid(np.zeros((3, 3)), 0.1) | bool
MapError: OccupancyGrid(FREE, 0.0) | resolution
MapError: OccupancyGrid(FREE, np.nan) | resolution
MapError: OccupancyGrid(FREE, 0.1, (0, 0)) | origin
MapError: OccupancyGrid(FREE, 0.1, unknown=np.zeros((2, 3), bool)) | same
MapError: Site(TEN, clearance=-0.1) | clearance is .*; give 0 to 20 m
MapError: Site(TEN, clearance=np.nan) | clearance is .*; give 0 to 20 m
MapError: Site(TEN, clearance=np.inf) | clearance is .*; give 0 to 20 m
MapError: Site(TEN, clearance=21.0) | clearance is .*; give 0 to 20 m
MapError: TEN.updated(FREE, 8, 0) | does not lie on the map of 10 x 10
MapError: TEN.updated(FREE, 0, -1) | cut it to the map
MapError: TEN.updated(np.zeros((3, 3)), 0, 0) | give rows and columns of bool
MapError: TEN.updated(np.zeros((0, 3), bool), 0, 0) | give rows and columns of bool
MapError: Surface(shapely.LineString([(0, 0), (1, 1)]), MARBLE) | polygon
MapError: Surface(BOW, MARBLE) | Self-intersection
MapError: Surface(shapely.box(0, 0, 1e300, 1), MARBLE) | beyond
MapError: SurfaceMap([], [shapely.Point(0, 0)]) | keep-out area 0
MapError: SurfaceMap([Surface(BOX, AHEAD)]).costs(EnergyCost(MARBLE)) | longitudinal
MapError: RAMP.rise(Path(Pose(0.1, 0.5, 0), [2.5], [0.0])) | off the height map
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, {"Surface": Surface, **globals()})
