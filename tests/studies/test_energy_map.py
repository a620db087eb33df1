"""Energies of all places: against exact steering, single plans, and each other."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, MapError, StartInCollisionError
from energyplan.io.energy_map import write_contours, write_energies
from energyplan.path import Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.studies import energy_map
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def hall(origin=(0.0, 0.0, 0.0)) -> OccupancyGrid:
    occupied = np.zeros((90, 120), bool)
    occupied[30:90, 58:62] = True
    return OccupancyGrid(occupied, 0.1, origin)


@pytest.fixture(scope="module")
def found():
    return energy_map(PlanningProblem(hall(), COST, (3, 6, 1.0), (3, 6, 1.0)))


def test_energies_are_never_below_the_least_without_obstacles(found):
    rows, columns = found.energy.shape
    place = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    reached = np.isfinite(found.energy).ravel()
    headings = np.linspace(-np.pi, np.pi, 25)
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5)])
    least = np.full(len(place), np.inf)
    for corner in corners:
        xy = (place + corner) * found.resolution
        poses = np.concatenate(
            [np.repeat(xy, 25, axis=0), np.tile(headings, len(xy))[:, None]], axis=1
        )
        free = steering.energy(np.array([3, 6, 1.0]), poses, COST).reshape(-1, 25).min(axis=1)
        least = np.minimum(least, free)
    # from a pose between those tried one of them is half a place away, at worst sideways, and half
    # a step of heading
    aside = (0.0, 0.5 * found.resolution, 0.0)
    slack = steering.energy((0.0, 0.0, 0.0), aside, COST) + COST.segment_energy(0.0, 0.14)
    assert reached.sum() > 800
    assert np.all(found.energy.ravel()[reached] >= least[reached] - slack)


@pytest.mark.parametrize("goal", [(10.5, 7.5), (8.0, 1.0), (2.0, 1.5)])
def test_energies_are_close_to_those_of_single_plans(found, goal):
    problem = PlanningProblem(hall(), COST, (3, 6, 1.0), (*goal, 0.0))
    single = min(
        plan(replace(problem, goal=Pose(*goal, yaw)), effort=1_000_000, gap=0.1).energy
        for yaw in np.arange(4) * np.pi / 2
    )
    slack = float(COST.segment_energy(np.sqrt(0.5) * found.resolution, 0.0))
    assert single * 0.91 - slack < found.energy_at(goal) < single * 1.1 + slack


def test_there_and_back_takes_more_and_a_limit_cuts_off(found):
    problem = PlanningProblem(hall(), COST, (3, 6, 1.0), (3, 6, 1.0))
    both = energy_map(problem, back=(3, 6, 1.0))
    reached = np.isfinite(both.energy) & np.isfinite(found.energy)
    assert reached.sum() > 800
    assert np.all(both.energy[reached] >= found.energy[reached])
    # a way can be driven back along itself, at the same price for this model
    assert np.median(both.energy[reached] / np.maximum(found.energy[reached], 1.0)) < 2.2
    near = energy_map(problem, energy=1500.0)
    assert np.array_equal(np.isfinite(near.energy), found.energy <= 1500.0)
    assert near.complete_to == 1500.0
    assert near.reachable(1500.0) == found.reachable(1500.0) < found.reachable(3000.0)


def test_driving_backwards_counts_where_it_costs_more():
    model = PowerModel.preset("quadriga:empty:concrete")
    problem = PlanningProblem(hall(), EnergyCost(model), (3, 6, 0.0), (3, 6, 0.0))
    home = energy_map(problem, back=(3, 2, 0.0))
    away = energy_map(problem)
    # from a place on the way home there is not much to add
    assert home.energy_at((3, 4)) < away.energy_at((3, 2)) * 1.25 + 300.0


def test_contours_hold_one_another_and_their_places():
    turned = hall((2.0, -1.0, 0.5))
    x, y = turned.to_world(np.array([30.0, 60.0]))
    start = Pose(float(x), float(y), 1.5)
    made = energy_map(PlanningProblem(turned, COST, start, start))
    areas = made.contours([3000.0, 1000.0, 2000.0])
    assert [a.energy for a in areas] == [1000.0, 2000.0, 3000.0]
    for small, large in pairwise(areas):
        assert large.area.buffer(1e-6).contains(small.area)
    assert areas[0].area.buffer(made.resolution).contains(shapely.Point(start[:2]))
    # interpolated between places, so about as large as these
    assert areas[2].area.area == pytest.approx(made.reachable(3000.0), rel=0.15)


def test_files(found, tmp_path):
    write_energies(found, tmp_path / "map.asc")
    text = (tmp_path / "map.asc").read_text().splitlines()
    assert text[0] == f"ncols {found.energy.shape[1]}"
    table = np.array([line.split() for line in text[6:]], float)[::-1]
    reached = np.isfinite(found.energy)
    assert np.allclose(table[reached], found.energy[reached], rtol=1e-5)
    assert np.all(table[~reached] == -9999)
    write_contours(found.contours([2000.0]), tmp_path / "map.geojson")
    (feature,) = json.loads((tmp_path / "map.geojson").read_text())["features"]
    area = shapely.geometry.shape(feature["geometry"]).area
    assert feature["properties"] == {"energy": 2000.0, "area": pytest.approx(area)}
    with pytest.raises(MapError, match="contours"):
        write_energies(replace(found, origin=Pose(0.0, 0.0, 0.3)), tmp_path / "no.asc")


def test_what_cannot_be_is_refused():
    problem = PlanningProblem(hall(), COST, (3, 6, 1.0), (3, 6, 1.0))
    with pytest.raises(InvalidInputError, match="positive"):
        energy_map(problem, energy=0.0)
    with pytest.raises(InvalidInputError, match="objective"):
        energy_map(replace(problem, objective="time"))
    with pytest.raises(StartInCollisionError):
        energy_map(replace(problem, start=(6.0, 6.0, 0.0)))
