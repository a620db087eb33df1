"""Footprint collision: time of a test against shapely and a disc, and the distance transform.

``python benchmarks/collision.py`` prints times per test on an office of 400 x 280 cells of 5 cm
with Quadriga's footprint, all measured side by side in one run, and the share of free poses and
motions that each way recognises.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import shapely
from scipy import ndimage
from shapely import affinity

from energyplan.io.files import bundled
from energyplan.io.maps import read_map
from energyplan.path import Path, Pose
from energyplan.terrain import OccupancyGrid
from energyplan.terrain import collision as _collision
from energyplan.terrain.updates import distance_to_blocked
from energyplan.vehicle import Vehicle


def best_of(run: Callable[[], object], repeats: int = 5) -> float:
    """Return the least time of several runs [s]."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        run()
        times.append(time.perf_counter() - begun)
    return min(times)


def obstacles(grid: OccupancyGrid) -> shapely.Geometry:
    """Return the blocked cells as one prepared geometry."""
    row, column = np.nonzero(grid.blocked)
    cells = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    area = shapely.transform(cells, grid.to_world)
    shapely.prepare(area)
    return area


def bodies(vehicle: Vehicle, poses: np.ndarray) -> list[shapely.Geometry]:
    """Return the footprint at each pose."""
    body = shapely.box(*vehicle.footprint.ravel())
    return [
        affinity.translate(affinity.rotate(body, yaw, (0, 0), use_radians=True), x, y)
        for x, y, yaw in poses
    ]


def prepare(blocked: np.ndarray) -> None:
    """Compute what the collision kernels need to know of a map."""
    distance_to_blocked(blocked)
    _collision.next_blocked(blocked)


def main() -> None:
    """Measure and print."""
    grid, vehicle = read_map(bundled("office.yaml")), Vehicle.preset("quadriga")
    rng = np.random.default_rng(1)
    n = 20_000
    poses = np.column_stack([rng.uniform(0, grid.size, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    area = obstacles(grid)
    few = poses[:1000]

    def by_shapely() -> np.ndarray:
        return ~shapely.intersects(area, np.array(bodies(vehicle, few)))

    def by_disc() -> np.ndarray:
        return grid.clearance_at(poses[:, :2]) > np.hypot(*vehicle.footprint[1])

    free = grid.footprint_free(poses, vehicle)
    kernel = best_of(lambda: grid.footprint_free(poses, vehicle)) / n
    plain = best_of(by_shapely, 2) / len(few)
    print("pose, per test               time [us]  share of free poses recognised")
    print(f"  rectangle, this library    {1e6 * kernel:9.3f}  {1.0:.3f}")
    found = by_shapely()[free[:1000]].mean()
    print(f"  rectangle, shapely         {1e6 * plain:9.3f}  {found:.3f}")
    disc = best_of(by_disc) / n
    print(f"  circumscribed disc, NumPy  {1e6 * disc:9.3f}  {by_disc()[free].mean():.3f}")
    print(f"  shapely / this library: {plain / kernel:.0f}")

    starts = poses[free][:4000]
    m = len(starts)
    kinds = {
        "straight, 1 m": (np.full(m, 1.0), np.zeros(m)),
        "pivot, 45 deg": (np.full(m, 0.47 * np.pi / 4), np.full(m, np.pi / 4)),
        "spin, 180 deg": (np.zeros(m), np.full(m, np.pi)),
        "arc, 2 m, 60 deg": (np.full(m, 2.0), np.full(m, np.pi / 3)),
    }
    print("\nmotion, per test             time [us]  free   shapely at 5 mm [us]  ratio")
    for name, (ds, dtheta) in kinds.items():

        def run(ds: np.ndarray = ds, dtheta: np.ndarray = dtheta) -> np.ndarray:
            return grid.motions_free(starts, ds, dtheta, vehicle)

        share = run().mean()
        took = best_of(run) / m
        begun = time.perf_counter()
        for k in range(20):
            path = Path(Pose(*starts[k]), ds[k : k + 1], dtheta[k : k + 1])
            shapely.intersects(area, np.array(bodies(vehicle, path.poses(0.005, 0.01))))
        slow = (time.perf_counter() - begun) / 20
        print(
            f"  {name:<26} {1e6 * took:9.3f}  {share:.3f}  {1e6 * slow:12.0f}  {slow / took:12.0f}"
        )

    print("\nprepare a map, cells         this library [ms]   scipy's EDT [ms]   ratio")
    for size in (512, 1024, 2048, 4096):
        blocked = rng.random((size, size)) < 1e-3
        prepare(blocked[:8])
        repeats = 1 if size > 2000 else 3
        ours = best_of(partial(prepare, blocked), repeats)
        theirs = best_of(partial(ndimage.distance_transform_edt, ~blocked), repeats)
        print(f"  {size:5d}^2 {1e3 * ours:27.0f} {1e3 * theirs:18.0f} {theirs / ours:11.1f}")


if __name__ == "__main__":
    main()
