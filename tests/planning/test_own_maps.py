"""The maps of the repository: made by their script, and telling what docs/maps.md says."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import shapely
from worlds import COST, MAPS

from energyplan import EnergyCost, PlanningProblem, PowerModel, plan, read_map, read_surfaces

# that of the table in docs/maps.md
EFFORT = 20_000

# start and goal in the map's own frame, a bar across the way of least energy, and where that is
CASES = {
    "office": ("empty", (1.0, 4.4, 0.0), (19.0, 4.0, -90.0), (0.0, 5.95, 20.0, 6.1), (10, 7)),
    "warehouse": ("full", (2.0, 2.0, 0.0), (20.0, 12.0, 90.0), (13.0, 0.0, 13.2, 3.5), (15, 2.5)),
    "orchard": ("empty", (2.0, 1.5, 90.0), (14.0, 17.0, 0.0), (0.0, 9.0, 3.6, 9.2), (2.5, 9)),
}


def test_the_script_makes_these_files(tmp_path):
    spec = importlib.util.spec_from_file_location("make_maps", MAPS / "make_maps.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.main(tmp_path)
    made = sorted(file.name for file in tmp_path.iterdir())
    ends = (".yaml", ".png", "_surfaces.geojson")
    maps = [f"{name}{end}" for name in (*CASES, "yard") for end in ends]
    assert made == sorted([*maps, "yard_heights.asc"])
    for name in made:
        if name.endswith(".png"):
            # another release of the image library may compress otherwise
            continue
        assert (tmp_path / name).read_bytes() == (MAPS / name).read_bytes(), name
    for name in (*CASES, "yard"):
        one, other = read_map(tmp_path / f"{name}.yaml"), read_map(MAPS / f"{name}.yaml")
        assert np.array_equal(one.occupied, other.occupied)
        assert np.array_equal(one.unknown, other.unknown)


def told(name: str) -> list[list[str]]:
    """Length, turning and energy of both routes on a map, as docs/maps.md states them."""
    _, _, rest = (MAPS.parent / "docs/maps.md").read_text().partition(f"\n| {name}")
    return [[cell.strip() for cell in row.split("|")[-4:-1]] for row in rest.splitlines()[:2]]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_shorter_way_costs_more(name):
    load, start, goal, bar, spot = CASES[name]
    grid = read_map(MAPS / f"{name}.yaml")
    ground = read_surfaces(MAPS / f"{name}_surfaces.geojson")
    cost = EnergyCost(PowerModel.preset(f"quadriga:{load}:concrete"))

    def world(pose):
        x, y = grid.to_world(np.array(pose[:2]) / grid.resolution)
        return x, y, np.deg2rad(pose[2]) + grid.origin.yaw

    def planned(where):
        problem = PlanningProblem(where, cost, world(start), world(goal), surfaces=ground)
        return plan(problem, effort=EFFORT)

    corners = shapely.get_coordinates(shapely.box(*bar)) / grid.resolution
    across = shapely.Polygon(grid.to_world(corners))
    best, other = planned(grid), planned(grid.with_blocked(across))
    places = grid.to_cells(best.poses[:, :2]) * grid.resolution
    assert np.hypot(*(places - spot).T).min() < 1.0
    assert other.length < best.length
    assert other.turning > 2 * best.turning
    assert other.energy > 1.03 * best.energy
    assert told(name) == [
        [f"{one.length:.1f} m", f"{np.degrees(one.turning):.0f} deg", f"{one.energy:.0f} J"]
        for one in (best, other)
    ]


def test_another_route_is_taken_where_motions_do_not_lead_on_along_one():
    grid = read_map(MAPS / "orchard.yaml")
    ends = (9.4423, 14.4485, -0.438), (-0.0498, 22.7499, 2.9284)  # beside trees, and behind them
    problem = PlanningProblem(grid, COST, *ends)
    assert grid.path_free(plan(problem, effort=5_000).path, problem.robot)
