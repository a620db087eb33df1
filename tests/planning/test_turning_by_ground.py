"""Ground on which the robot may not turn tightly, such as a lawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import COST, MODEL, room

import energyplan as ep
from energyplan.errors import MapError
from energyplan.io.geojson import write_surfaces
from energyplan.planning.plans import Planner
from energyplan.terrain import Surface

HALL = room(120, 120, 0.1)
LAWN = shapely.box(4, 0, 12, 12)


def on_a_lawn(radius, start=(2, 6, 0), goal=(8, 6, 2.0)):
    ground = ep.SurfaceMap([Surface(LAWN, MODEL, "lawn", turning_radius=radius)])
    return ep.PlanningProblem(HALL, COST, start, goal, surfaces=ground)


def tightest(path, area):
    """Least radius of arcs inside an area, of many small parts of a path [m]."""
    fine = path.subdivide(0.003, 0.003)
    middle = 0.5 * (fine.points[1:] + fine.points[:-1])
    turns = (np.abs(fine.dtheta) > 1e-9) & shapely.intersects_xy(area.buffer(-0.01), *middle.T)
    return np.min(np.abs(fine.ds[turns]) / np.abs(fine.dtheta[turns]), initial=np.inf)


@pytest.mark.parametrize("goal", [(8, 6, 2.0), (8, 9, np.pi), (2, 9, np.pi), (6, 4, -1.0)])
def test_arcs_on_the_ground_are_as_wide_as_it_says(goal):
    free, narrow, wide = (ep.plan(on_a_lawn(r, goal=goal), effort=4000) for r in (0, 0.9, 2.0))
    assert free.energy_driven <= narrow.energy_driven * (1 + 1e-9)
    assert narrow.energy_driven <= wide.energy_driven * (1 + 1e-3)
    for radius, found in ((0.9, narrow), (2.0, wide)):
        assert tightest(found.path, LAWN) >= radius * (1 - 1e-6)
        assert on_a_lawn(radius, goal=goal).fault(found.path) is None
        assert found.lower_bound <= found.energy_driven * (1 + 1e-9)
    # within the lawn alone it is the turning radius of the whole problem
    inside = on_a_lawn(0.9, (6, 6, 0), (9, 8, 1.0))
    everywhere = replace(inside, surfaces=None, turning=0.9)
    both = [ep.plan(problem, effort=4000).energy_driven for problem in (inside, everywhere)]
    assert both[0] == pytest.approx(both[1], rel=0.01)


def test_a_path_that_turns_on_the_spot_is_refused_on_the_ground_alone():
    tight = "whose segment 0 turns on an arc of less than 0.9 m"
    for x, fault in ((2.0, None), (7.0, tight)):
        spin = ep.Path((x, 6, 0), [0.0], [1.0])
        found = on_a_lawn(0.9, spin.start, spin.end).fault(spin)
        assert found is None if fault is None else fault in found
    spin = ep.plan(on_a_lawn(0.9, (2, 6, 0), (2, 6, 1.0)), effort=500)
    assert spin.energy_driven == pytest.approx(COST.energy(ep.Path((2, 6, 0), [0.0], [1.0])))
    planner = Planner(lambda problem, budget: None, surfaces=True)
    assert planner.lacks(on_a_lawn(0.9), counted=False) == ["a least turning radius"]


def test_files_hold_the_turning_radius(tmp_path):
    named = replace(MODEL, name="quadriga:empty:concrete")
    ground = ep.SurfaceMap([Surface(LAWN, named, turning_radius=0.9)])
    write_surfaces(ground, tmp_path / "ground.geojson")
    assert ep.read_surfaces(tmp_path / "ground.geojson").radii == (0.0, 0.9)
    with pytest.raises(MapError, match="turning_radius is -1"):
        Surface(LAWN, MODEL, turning_radius=-1.0)
