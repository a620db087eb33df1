"""Soft costs beside the objective: what they add, what they move, and a bound that stays one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from PIL import Image
from worlds import COST, room

from energyplan import Path, PlanningProblem, Pose, PowerModel, SurfaceMap, plan
from energyplan.io.maps import read_costmap
from energyplan.terrain import CostMap
from energyplan.terrain.surfaces import Surface


def puddle(cost: float = 1.0) -> CostMap:
    """Return costs within a disc of 1 m about (4, 2.5)."""
    y, x = (np.indices((100, 160)) + 0.5) * 0.05
    return CostMap(np.where(np.hypot(x - 4.0, y - 2.5) < 1.0, cost, 0.0), 0.05)


def problem(weight: float, **more) -> PlanningProblem:
    hall, more = room(100, 160, 0.05), {"costmap": puddle(), "costmap_weight": weight, **more}
    return PlanningProblem(hall, COST, (1.5, 2.4, 0), (6.5, 2.4, 0), **more)


def test_what_a_path_pays_is_the_length_of_its_chord():
    for y in (2.5, 3.0, 3.4):
        path = Path(Pose(1, y, 0), ds=[6.0], dtheta=[0.0])
        chord = 2.0 * np.sqrt(1.0 - (y - 2.5) ** 2)
        # cells are drawn whole: a cell more or less at either end
        assert puddle().along(path) == pytest.approx(chord, abs=0.15)
        assert puddle(0.5).along(path) == pytest.approx(0.5 * puddle().along(path), rel=1e-12)
    assert puddle().along(Path(Pose(4, 2.5, 0), ds=[0.0], dtheta=[3.0])) == 0.0
    # the reference point pays, which may lie ahead
    assert puddle().along(Path(Pose(4, 2.5, 0), ds=[0.5], dtheta=[0.0], longitudinal=2.0)) == 0.0


def test_without_a_weight_nothing_changes():
    asked = problem(0.0)
    with_layer, without = (plan(one, effort=1000) for one in (asked, replace(asked, costmap=None)))
    assert np.array_equal(with_layer.path.vertices, without.path.vertices)
    assert with_layer.soft_cost == 0.0
    assert with_layer.cost == with_layer.energy


@pytest.mark.parametrize("weight", [50.0, 300.0, 2000.0])
def test_cost_is_energy_and_what_the_costmap_adds(weight):
    asked = problem(weight)
    found = plan(asked, effort=6000)
    straight = plan(replace(asked, costmap=None), effort=1000)
    soft = weight * puddle().along(found.path)
    assert found.soft_cost == pytest.approx(soft, rel=1e-12)
    assert found.cost == pytest.approx(found.energy + soft, rel=1e-12)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    # no worse than going straight on but for a cell's border on either side, where the search pays
    # for pieces of half a cell; never below the least energy
    ahead = straight.energy + weight * puddle().along(straight.path)
    assert found.cost <= ahead + weight * 2 * 0.025
    assert found.lower_bound <= straight.energy * (1 + 1e-9)


def test_a_high_weight_goes_around():
    light, heavy = plan(problem(1.0), effort=3000), plan(problem(2000.0), effort=20_000)
    assert puddle().along(light.path) > 1.5
    assert puddle().along(heavy.path) < 0.1
    assert heavy.energy > light.energy


def test_surfaces_and_costs_go_together():
    marble = PowerModel.preset("quadriga:empty:marble")
    ground = SurfaceMap((Surface(shapely.box(0, 0, 8, 2.0), marble, "marble"),))
    asked = problem(400.0, surfaces=ground)
    found = plan(asked, effort=8000)
    assert found.cost == pytest.approx(found.energy_driven + found.soft_cost, rel=1e-12)
    # the marble lies on the side to go around by
    assert found.path.vertices[:, 1].min() < 1.7


def test_other_frames_and_sizes_are_looked_up_where_they_lie():
    grid = room(40, 60, 0.1, origin=(1.0, -2.0, 0.6))
    layer = CostMap(np.linspace(0, 1, 35 * 20).reshape(35, 20), 0.2, Pose(-1.0, -1.0, -0.3))
    over = layer.over(grid)
    row, column = 17, 42
    assert over[row, column] == layer.at(grid.to_world((column + 0.5, row + 0.5)))


def written(tmp_path, pixels, mode, **more):
    Image.fromarray(np.array(pixels, np.uint8)).save(tmp_path / "costs.pgm")
    lines = {"image": "costs.pgm", "mode": mode, "resolution": 0.5, "origin": "[1.0, 2.0, 0.0]"}
    told = "\n".join(f"{key}: {value}" for key, value in {**lines, **more}.items())
    (tmp_path / "costs.yaml").write_text(told + "\n")
    return read_costmap(tmp_path / "costs.yaml")


def test_images_of_costs_are_read(tmp_path):
    scale = written(tmp_path, [[0, 255], [128, 230]], "scale", occupied_thresh=0.9, free_thresh=0.1)
    dark = 1 - np.array([[128, 230], [0, 255]]) / 255
    assert scale.costs == pytest.approx(np.round(np.clip((dark - 0.1) / 0.8, 0, 1), 2))
    assert scale.origin == Pose(1.0, 2.0, 0.0)
    costs = written(tmp_path, [[0, 254], [127, 255]], "raw")
    assert costs.costs == pytest.approx(np.array([[0.5, 0.0], [0.0, 1.0]]))
    percent = written(tmp_path, [[0, 100], [50, 255]], "raw")
    assert percent.costs == pytest.approx(np.array([[0.5, 0.0], [0.0, 1.0]]))
    common = {"occupied_thresh": 0.65, "free_thresh": 0.196}
    trinary = written(tmp_path, [[0, 254], [205, 255]], "trinary", **common)
    assert trinary.costs == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0]]))
