"""Make the maps of this folder: ``python maps/make_maps.py [FOLDER]``.

Each is a map_server YAML with its PNG, and surfaces in GeoJSON. They are drawn so that the
shortest route and the route of least energy differ; ``docs/maps.md`` explains why. The same
script makes the same bytes every time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import shapely
from shapely import box
from shapely.geometry.base import BaseGeometry

from energyplan.io.geojson import write_surfaces
from energyplan.io.maps import write_map
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap

RESOLUTION = 0.05
WALL = 0.15


def walls(*lines: tuple[float, float, float, float]) -> list[BaseGeometry]:
    """Return walls about centre lines (x0, y0, x1, y1)."""
    half = WALL / 2
    return [
        box(min(x0, x1) - half, min(y0, y1) - half, max(x0, x1) + half, max(y0, y1) + half)
        for x0, y0, x1, y1 in lines
    ]


def hull(width: float, height: float) -> list[BaseGeometry]:
    """Return the outer walls of a building with a corner at the origin."""
    return [box(0, 0, width, height).difference(box(WALL, WALL, width - WALL, height - WALL))]


def surface(area: BaseGeometry, name: str, load: str) -> Surface:
    """Return a ground of the paper's Table II."""
    return Surface(area, PowerModel.preset(f"quadriga:{load}:{name}"), name)


def office() -> tuple[OccupancyGrid, SurfaceMap]:
    """Return an office: a marble corridor, and concrete rooms with doors between them."""
    width, height = 20.0, 14.0
    obstacles = hull(width, height)
    low, high = 6.0, 8.2
    # south rooms: 5 m wide, a door to the corridor, doors from room to room, and a shelf in the
    # middle that one must drive around
    for k in range(4):
        left = 5.0 * k
        obstacles += walls((left, low, left + 3.2, low), (left + 4.4, low, left + 5.0, low))
        obstacles += [box(left + 2.3, 0, left + 2.7, 4.0)]
        if k:
            obstacles += walls((left, 0, left, 2.5), (left, 3.7, left, low))
    # north rooms: offices with a desk each, and a meeting room
    for k in range(3):
        left = 4.0 * k
        obstacles += walls((left, high, left + 0.8, high), (left + 2.0, high, left + 4.0, high))
        obstacles += walls((left + 4.0, high, left + 4.0, height))
        obstacles += [box(left + 1.0, 11.4, left + 2.8, 12.2)]
    obstacles += walls((12, high, 15.4, high), (16.8, high, 20, high))
    obstacles += [box(14.0, 10.4, 18.0, 11.6)]
    # a copier and a plant stand in the corridor, leaving it wide enough
    obstacles += [box(10.6, 7.6, 11.6, 8.2), shapely.Point(14.2, 6.4).buffer(0.25)]
    grid = OccupancyGrid.from_polygons(obstacles, (0, 0, width, height), RESOLUTION)
    inside = box(0, 0, width, height)
    corridor = box(0, low, width, high)
    ground = SurfaceMap(
        [
            surface(inside.difference(corridor), "concrete", "empty"),
            surface(corridor, "marble", "empty"),
        ]
    )
    return grid, ground


def warehouse() -> tuple[OccupancyGrid, SurfaceMap]:
    """Return a warehouse: a concrete hall with pallets in blocks, a marble hall with long racks."""
    width, height = 24.0, 16.0
    obstacles = hull(width, height)
    obstacles += walls((12, 0, 12, 1.1), (12, 3.1, 12, 9.4), (12, 11.4, 12, height))
    for i in range(3):
        for j in range(4):
            left, low = 3.4 + 2.7 * i, 3.1 + 2.7 * j
            obstacles.append(box(left, low, left + 1.3, low + 1.3))
    for low in (3.4, 5.6, 7.8, 12.6):
        obstacles.append(box(12.0 if low < 9 else 14.0, low, 18.4, low + 0.8))
    obstacles.append(box(21.4, 4.0, 22.6, 9.0))
    # the office of the foreman in a corner; nobody drives on its mats
    obstacles += walls((0, 14.2, 3.0, 14.2), (3.0, 14.2, 3.0, height))
    grid = OccupancyGrid.from_polygons(obstacles, (0, 0, width, height), RESOLUTION)
    inside_office = grid.with_blocked(box(0.2, 14.4, 2.8, 15.8)).occupied & ~grid.occupied
    grid = OccupancyGrid(grid.occupied, RESOLUTION, grid.origin, unknown=inside_office)
    ground = SurfaceMap(
        [
            surface(box(0, 0, 12, height), "concrete", "full"),
            surface(box(12, 0, width, height), "marble", "full"),
        ],
        keep_out=[box(18.6, 14.4, 22.0, 15.6)],
    )
    return grid, ground


def orchard() -> tuple[OccupancyGrid, SurfaceMap]:
    """Return an orchard, turned by 20 degrees: rows of trees with gaps, and a paved lane."""
    rng = np.random.default_rng(7)
    width, height = 30.0, 20.0
    obstacles: list[BaseGeometry] = [
        box(0, 0, width, height).difference(box(0.1, 0.1, width - 0.1, height - 0.1))
    ]
    for row in range(6):
        y = 3.0 + 2.4 * row
        # where a tree died a robot slips through
        gap = (6, 8, 6, 8, 6, 8)[row]
        for x in range(4, 27):
            if x == gap:
                continue
            at = np.array([x, y]) + rng.normal(0, 0.06, 2)
            obstacles.append(shapely.Point(at).buffer(rng.uniform(0.12, 0.22), quad_segs=4))
    # a fence parts the trees from the paved lane in the west
    obstacles.append(box(3.5, 4.4, 3.6, 16.0))
    shed = box(26.2, 17.6, 29.6, 19.6)
    grid = OccupancyGrid.from_polygons([*obstacles, shed], (0, 0, width, height), RESOLUTION)
    grid = OccupancyGrid(grid.occupied, RESOLUTION, Pose(-5.0, 2.0, np.deg2rad(20)))

    def world(area: BaseGeometry) -> BaseGeometry:
        return shapely.transform(area, lambda points: grid.to_world(points / RESOLUTION))

    lane, field = box(0, 0, 3.55, height), box(3.55, 0, width, height)
    ground = SurfaceMap(
        [surface(world(field), "concrete", "empty"), surface(world(lane), "marble", "empty")],
        keep_out=[world(shapely.Point(20.0, 18.0).buffer(1.1, quad_segs=6))],
    )
    return grid, ground


def yard(folder: Path) -> None:
    """Write a yard of 250 m by 170 m: a paved road round a ploughed field with a hill, and vines.

    From side to side the shortest way crosses the field; that of least energy stays on the road.
    """
    width, height, cell = 250.0, 170.0, 0.5
    fence = box(0, 0, width, height).difference(box(1, 1, width - 1, height - 1))
    rows = [box(60.0 + 4.0 * k, 124.0, 60.8 + 4.0 * k, 160.0) for k in range(12)]
    sheds = [box(2, 44, 8, 66), box(242, 50, 248, 74)]
    grid = OccupancyGrid.from_polygons([fence, *rows, *sheds], (0, 0, width, height), cell)
    road = box(9, 9, 241, 112).difference(box(19, 19, 231, 102))
    field = box(0, 0, width, height).difference(road)
    paved, ploughed = (PowerModel.preset(f"husky_a200:{name}") for name in ("flooring", "ploughed"))
    ground = SurfaceMap([Surface(road, paved, "paved"), Surface(field, ploughed, "field")])
    write_map(grid, folder / "yard.yaml")
    write_surfaces(ground, folder / "yard_surfaces.geojson")
    step = 5.0  # of the heights [m]
    x = np.arange(-step / 2, width + step, step)
    y = np.arange(-step / 2, height + step, step)
    hill = 8.0 * np.exp(-(((x[None] - 125) / 60) ** 2) - ((y[:, None] - 60) / 26) ** 2)
    head = (
        f"ncols {len(x)}", f"nrows {len(y)}", "xllcorner -5", "yllcorner -5", f"cellsize {step:g}"
    )  # fmt: skip
    lines = [" ".join(f"{value:.2f}" for value in row) for row in hill[::-1]]
    (folder / "yard_heights.asc").write_text("\n".join((*head, *lines)) + "\n")


MAPS = {"office": office, "warehouse": warehouse, "orchard": orchard}


def main(folder: Path) -> None:
    """Write every map into a folder."""
    for name, make in MAPS.items():
        grid, ground = make()
        write_map(grid, folder / f"{name}.yaml")
        write_surfaces(ground, folder / f"{name}_surfaces.geojson")
    yard(folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
