"""Energies of all places: against exact steering, single plans, and each other."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest
import shapely
from corridors import CORRIDOR, corridor
from refusals import check_refusal, lines
from worlds import COST, room, tiny

from energyplan import EnergyCost, Goal, PlanningProblem, Pose, energy_map, plan, steering
from energyplan.battery import Battery
from energyplan.errors import MapError, PlanningError
from energyplan.io.tables import write_contours, write_energies
from energyplan.mission import Task, evaluate
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Residual
from energyplan.power.effects import with_weight
from energyplan.reach import UsableCharge, upper_prices
from energyplan.terrain import HeightMap

HALL = room(90, 120, 0.1, np.s_[30:90, 58:62])


def problem(cost=COST, goal=(3, 6, 1.0), start=(3, 6, 1.0), **more) -> PlanningProblem:
    return PlanningProblem(HALL, cost, start, goal, **more)


@pytest.fixture(scope="module")
def found():
    return energy_map(problem())


def test_energies_are_never_below_the_least_without_obstacles(found):
    place = np.indices(found.energy.shape)[::-1].reshape(2, -1).T
    reached = np.isfinite(found.energy).ravel()
    headings = np.linspace(-np.pi, np.pi, 25)
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5)])
    least = np.full(len(place), np.inf)
    for corner in corners:
        xy = (place + corner) * found.resolution
        poses = np.column_stack([np.repeat(xy, 25, axis=0), np.tile(headings, len(xy))])
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
    single = min(
        plan(problem(goal=(*goal, yaw)), effort=1_000_000, gap=0.1).energy
        for yaw in np.arange(4) * np.pi / 2
    )
    slack = float(COST.segment_energy(np.sqrt(0.5) * found.resolution, 0.0))
    assert single * 0.91 - slack < found.energy_at(goal) < single * 1.1 + slack


def test_there_and_back_takes_more_and_a_limit_cuts_off(found):
    both = energy_map(problem(), back=(3, 6, 1.0))
    reached = np.isfinite(both.energy) & np.isfinite(found.energy)
    assert reached.sum() > 800
    assert np.all(both.energy[reached] >= found.energy[reached])
    # a way can be driven back along itself, at the same price for this model
    assert np.median(both.energy[reached] / np.maximum(found.energy[reached], 1.0)) < 2.2
    near = energy_map(problem(), energy=1500.0)
    assert np.array_equal(np.isfinite(near.energy), found.energy <= 1500.0)
    assert near.complete_to == 1500.0
    assert near.reachable(1500.0) == found.reachable(1500.0) < found.reachable(3000.0)


NEAR, FAR = (3, 6, 1.0), (10, 7, -0.4)


def ways_back(back, **more):
    """Return what each place takes, there and back to some goals."""
    return energy_map(problem(**more), back=back).energy


def check_alike(found, expected):
    """Check that places take the same, but for what a lattice that is laid otherwise does.

    A few beside walls are reached on one of the lattices alone.
    """
    both = np.isfinite(found) & np.isfinite(expected) & (expected > 0.0)
    assert np.sum(np.isfinite(found) ^ np.isfinite(expected)) < 0.02 * both.sum()
    ratio = found[both] / expected[both]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)
    assert np.quantile(ratio, [0.02, 0.98]) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(
    ("words", "soc", "reserve"),
    [
        ("24 V 20 Ah lead-acid", 0.206, 0.2),
        ("24 V 20 Ah lead-acid, -10 degC", 0.507, 0.5),
        ("7S6P 2.5 Ah li-ion", 0.107, 0.1),
    ],
)
def test_a_mission_does_what_is_within_reach_and_no_more(words, soc, reserve):
    """A drive along a corridor and back, on one battery with a reserve."""
    pack = Battery.of(words)
    cost = EnergyCost(PowerModel.preset("quadriga:empty:marble"), battery=True)
    charge = UsableCharge(cost, pack, soc, reserve)
    setting = PlanningProblem(CORRIDOR, cost, (3, 1.5, 0), (3, 1.5, 0))
    within = energy_map(setting, energy=charge, back=(3, 1.5, 0))
    x = np.arange(3.1, 34.0, 0.2)
    reached = within.energy_at(np.column_stack([x, np.full(len(x), 1.5)])) <= charge.energy
    farthest = float(x[reached].max())
    assert 10.0 < farthest < 33.0

    def done(metres):
        tasks = (Task("A", Pose(3.0 + metres, 1.5, 0.0)),)
        return evaluate(corridor(1.0, tasks, 3.0, battery=pack, soc=soc, reserve=reserve)).feasible

    assert done(farthest - 0.1 - 3.0)
    assert not done(1.02 * (farthest + 0.1 - 3.0))


def test_motions_of_high_power_count_more_where_a_battery_loses_by_it():
    """Turns are what a lossless battery gives them, and more from one that loses by current."""
    cost = EnergyCost(PowerModel.preset("quadriga:empty:marble"), battery=True)
    charge = UsableCharge(cost, Battery.of("24 V 20 Ah lead-acid"), 0.21, 0.2)
    setting = problem(cost)
    plain, counted = (energy_map(setting, energy=e).energy for e in (charge.energy, charge))
    both = np.isfinite(plain) & np.isfinite(counted)
    most = float(charge.factor(np.array(600.0)))
    ratio = counted[both & (plain > 0)] / plain[both & (plain > 0)]
    assert 1.1 < most < 1.4
    assert 1.001 < np.median(ratio) < np.quantile(ratio, 0.95) < most
    even = UsableCharge(cost, tiny(1e6), 0.01)
    assert np.array_equal(energy_map(setting, energy=even).energy,
                          energy_map(setting, energy=even.energy).energy)  # fmt: skip


def test_of_several_docks_the_one_that_costs_least_counts():
    """What a place takes is the least of what it takes with either dock."""
    either = np.minimum(ways_back(NEAR), ways_back(FAR))
    found = energy_map(problem(), back=[NEAR, FAR])
    np.testing.assert_allclose(found.energy, either, rtol=1e-9)
    assert [goal.pose for goal in found.goals] == [NEAR, FAR]
    assert found.back == NEAR
    alike = np.minimum(ways_back(NEAR), ways_back((10, 7, 1.0)))  # headings of one lattice
    check_alike(ways_back([NEAR, (10, 7, 1.0)]), alike)


def test_a_free_heading_takes_what_the_best_heading_does():
    """A place at any heading, and a pose either way round, against single poses."""
    turned = [(3, 6, 1.0 + k * np.pi / 12) for k in range(24)]
    single = [ways_back(pose) for pose in turned[::6]]
    free, both = ways_back((3, 6)), ways_back(Goal(3, 6, 1.0, "either"))
    reached = np.isfinite(free) & np.all(np.isfinite(single), axis=0)
    assert reached.sum() > 800
    slack = float(COST.segment_energy(0.0, np.pi / 12))
    more = free[reached] - np.min(single, axis=0)[reached]
    assert np.quantile(more, 0.98) <= slack
    check_alike(both, np.minimum(single[0], single[2]))
    reached &= np.isfinite(both)
    assert free[reached].sum() < 0.985 * both[reached].sum()


def test_a_circle_is_reached_anywhere_in_it():
    """Who is within it need not drive back; who is not saves about its radius of the way."""
    there = energy_map(problem(start=(3, 2, 0.5)))
    ring = energy_map(problem(start=(3, 2, 0.5)), back=Goal(3, 6, radius=1.5))
    inside = [(3, 6), (3.5, 6.5), (2.2, 5.5), (3, 7.2)]
    step = float(COST.segment_energy(0.5, 0.0))
    np.testing.assert_array_less(ring.energy_at(inside), there.energy_at(inside) + step)
    place = energy_map(problem(start=(3, 2, 0.5)), back=(3, 6))
    saved = place.energy_at((10, 2)) - ring.energy_at((10, 2))
    assert saved == pytest.approx(float(COST.segment_energy(1.5, 0.0)), rel=0.25)


def test_docks_at_different_heights_are_compared_with_the_climb():
    """The climb to each dock counts, as in single maps."""
    rise = np.tile(0.02 * np.arange(0.0, 12.5, 0.5), (19, 1))
    climbing = replace(COST, model=with_weight(COST.model))
    hilly = {"cost": climbing, "heights": HeightMap(rise, 0.5)}
    either = np.minimum(ways_back(NEAR, **hilly), ways_back((10, 7, 1.0), **hilly))
    check_alike(ways_back([NEAR, (10, 7, 1.0)], **hilly), either)


def test_contours_hold_one_another_and_their_places():
    turned = replace(HALL, origin=Pose(2.0, -1.0, 0.5))
    start = Pose(*turned.to_world([30.0, 60.0]), 1.5)
    made = energy_map(replace(problem(), map=turned, start=start, goal=start))
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


def doubtful(covariance: np.ndarray, residual: Residual | None = None) -> EnergyCost:
    """Return a cost whose model has a covariance."""
    return EnergyCost(replace(COST.model, covariance=covariance, residual=residual))


def test_one_unknown_scales_all_prices():
    error = 0.1 * COST.model.coefficients
    cost = doubtful(np.outer(error, error))
    query = CompiledProblem(problem(cost))
    upper = upper_prices(query, 0.95, 0.0)
    share = np.hypot(0.1, USUAL_RUN_SPREAD) * NormalDist().inv_cdf(0.95)
    assert upper.extra == pytest.approx(share * query.prices, rel=1e-6)
    sure = energy_map(problem(cost), back=(10, 5, 0), confidence=0.95)
    expected = energy_map(problem(cost), back=(10, 5, 0))
    # prices in proportion are rounded otherwise: of two motions that cost the same another is taken
    places = [(10, 7), (8, 1), (2, 4)]
    ratio = sure.energy_at(places) / expected.energy_at(places)
    assert ratio == pytest.approx(1 + share, rel=0.03)
    assert sure.confidence == 0.95


@pytest.mark.parametrize("goal", [(10.5, 7.5), (8.0, 1.0)])
def test_told_with_confidence_is_what_so_many_robots_take_at_most(goal):
    rng = np.random.default_rng(5)
    root = np.array([[0.08, 0.0], [5.0, 9.0]])
    missed = Residual(20.0, 15.0, 0.0, 0.03, 0.8, duration=300.0, run_spread=0.04)
    cost = doubtful(root @ root.T, missed)
    sure = float(energy_map(problem(cost), confidence=0.95).energy_at(goal))
    expected = float(energy_map(problem(cost)).energy_at(goal))
    # the path of least expected energy to some heading there, as each robot pays for it
    found = []
    for yaw in np.arange(4) * np.pi / 2:
        with suppress(PlanningError):
            found.append(plan(problem(cost, (*goal, yaw)), effort=3000))
    near = min(found, key=lambda one: one.energy)
    by_term = np.array([near.breakdown[t.name] for t in cost.model.terms])
    drawn = cost.model.coefficients + rng.normal(size=(4000, 2)) @ root.T
    energies = drawn / cost.model.coefficients @ by_term
    energies *= 1 + 0.03 * rng.normal(size=4000) + 0.04 * rng.normal(size=4000)
    energies += np.sqrt(2 * 20.0**2 * 0.8 * near.duration) * rng.normal(size=4000)
    share = np.quantile(energies, 0.95) / near.energy
    # never below that quantile, and above it by what adding deviations up one by one costs
    assert share <= 1.005 * sure / expected
    assert sure / expected <= 1.25 * share


def test_a_coefficient_spread_stands_for_what_is_not_known_of_a_model(found):
    spread = energy_map(problem(), confidence=0.95, coefficient_spread=0.1)
    assert spread.energy_at((8, 1)) > found.energy_at((8, 1))


LOST = Residual(20.0, 15.0, 0.0, energy_error=-np.inf)
REFUSED = r"""
InvalidInputError: energy_map(problem(), energy=0.0) | positive
GoalInCollisionError: energy_map(problem(), back=(6.0, 6.0)) | every pose of the goal
OutsideMapError: energy_map(problem(), back=[(60.0, 6.0), (-9, 1, 0)]) | outside the map
InvalidInputError: energy_map(problem(), back="home") | is neither X,Y,YAW nor X,Y
InvalidInputError: energy_map(problem(objective="time")) | objective
StartInCollisionError: energy_map(problem(start=(6.0, 6.0, 0.0))) | start
InvalidInputError: energy_map(problem(doubtful(np.eye(2), LOST)), confidence=0.95) | measured none
InvalidInputError: energy_map(problem(), confidence=0.95) | state a coefficient spread
InvalidInputError: energy_map(problem(), confidence=95, coefficient_spread=0.1) | 0\.5 to below 1
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, globals())
