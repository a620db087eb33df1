"""Rates against the models themselves, on motions of every curvature, for models of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from by_day import by_day
from random_models import SIZES, random_model

from energyplan import EnergyCost, PowerModel, SurfaceMap
from energyplan.cost.bounds import SLACK, Infimum
from energyplan.planning.space.prices import Prices, least_prices
from energyplan.power.effects import catalogue, term, with_weight
from energyplan.terrain import Surface

MODEL = PowerModel.preset("quadriga:empty:concrete")


def random_motions(count, half_track, seed):
    """Return motions of every direction; many are close to straight, spin or pivot."""
    rng = np.random.default_rng(seed)
    ratio = np.where(rng.random(count) < 0.5, rng.random(count), 10.0 ** rng.uniform(-6, 0, count))
    ratio = np.where(rng.random(count) < 0.3, 1.0 - ratio, ratio)
    x, y = np.where(rng.random(count) < 0.5, [ratio, np.ones(count)], [np.ones(count), ratio])
    sign = rng.choice([-1.0, 1.0], (2, count))
    x, y = np.concatenate([sign * [x, y], [[1, -1, 0, 0], [0, 0, 1, -1]]], axis=1)
    return x, y / half_track


def test_every_effect_of_level_ground_is_tried():
    """A new effect of the catalogue must be priced by the bound as well."""
    flat = {
        made.name
        for entry in catalogue().values()
        for made in entry.terms
        if entry.acts == "motion" and not set(made.channels) and entry.planner != "no"
    }
    steady = {"specific_force", "tilt_x", "tilt_y", "warm_up"}  # nothing on level ground
    vehicles = {"drive_efficiency", "regeneration_efficiency"}  # its own stand for them
    assert flat - steady - vehicles == set(SIZES)


BY_DAY = (1, 3, 5, 8, 9, 11, 12, 16)
"""Empirical terms of every kind, at the battery and not, and those that a coarse search missed."""


@pytest.mark.parametrize("seed", by_day(range(24), BY_DAY))
def test_no_motion_costs_less_than_the_rates(seed):
    cost = random_model(seed)
    if cost is None:
        pytest.skip("no model: some motion would cost nothing")
    ds, dtheta = random_motions(4000, cost.half_track, seed)
    travel = np.abs(ds - cost.icr.centre[1] * dtheta)
    turn = np.abs(dtheta)
    energy = cost.segment_energy(ds, dtheta, slope=0.0)
    prices = least_prices(Prices(cost))
    for track in (0.0, 0.3 * cost.half_track, cost.half_track):
        least = prices.minorant(track)
        bound = least.metre * np.maximum(travel, track * turn) + least.radian * turn
        assert np.all(bound <= energy * (1 + 1e-12))
        assert least.radian >= 0 and least.metre > 0
        # no better rates would hold: some motion pays just that
        assert np.min(energy / np.maximum(bound, 1e-300)) < 1.02
    whole = cost.lower_bound()
    along = np.hypot(ds, cost.icr.longitudinal * dtheta)
    assert np.all(whole.energy(along, dtheta) <= energy * (1 + 1e-12))


@pytest.mark.parametrize("seed", BY_DAY)
def test_no_least_radius_leaves_metres_free(seed):
    cost = random_model(seed)
    ds, dtheta = random_motions(2000, cost.half_track, seed)
    turn = np.abs(dtheta)
    for wide in (3.0, 9.0, 11.0, 50.0, 1000.0):
        radius = wide * cost.half_track
        travel = np.maximum(np.abs(ds - cost.icr.centre[1] * dtheta), radius * turn)
        kept = np.where(ds < cost.icr.centre[1] * dtheta, -travel, travel)
        energy = cost.segment_energy(kept + cost.icr.centre[1] * dtheta, dtheta, slope=0.0)
        prices = least_prices(Prices(cost), radius=radius)
        for track in (0.0, radius):
            least = prices.minorant(track)
            length = np.maximum(np.abs(ds - cost.icr.centre[1] * dtheta), track * turn)
            assert np.all(least.metre * length + least.radian * turn <= energy * (1 + 1e-12))
            assert least.metre > 0.5 * least_prices(Prices(cost)).minorant(0.0).metre


def test_the_rates_of_wide_arcs_that_cost_little():
    """``a + beta r k^2 / (1 + r k)`` per metre: the bound must be its tangent, not its chord."""
    radius, a = 10.0, 226.0
    mobilised = replace(term("friction_mobilisation"), params={"radius": radius})
    model = MODEL.with_term(mobilised, MODEL.coefficient("slip_friction"))
    cost = EnergyCost(model)
    beta = MODEL.coefficient("slip_friction") * MODEL.vehicle.slip_moment
    curvature = np.geomspace(1e-6, 1.9, 400_000)
    per_metre = a + beta * radius * curvature**2 / (1 + radius * curvature)
    np.testing.assert_allclose(cost.segment_energy(1.0, curvature), per_metre, rtol=1e-6)
    least = least_prices(Prices(cost)).minorant(0.0)
    slack = (per_metre - least.metre - least.radian * curvature).min()
    assert 0 <= slack < 3e-6 * a
    # the arc that the table of 128 rays did not know
    assert 218 < least.metre < a and least.radian > 0.8 * beta
    for unit in (1e-6, 1e6):  # nothing hangs on what a joule is
        other = EnergyCost(replace(model, coefficients=unit * model.coefficients))
        scaled = least_prices(Prices(other)).minorant(0.0)
        assert scaled.metre == pytest.approx(unit * least.metre, rel=1e-6)
        assert scaled.radian == pytest.approx(unit * least.radian, rel=1e-6)


def test_a_dip_beside_the_scan_is_found():
    def price(x, y):
        size = np.hypot(x, y)
        angle = np.arctan2(y, x)
        return size * (100.0 - 20.0 * np.exp(-(((angle - 0.0371) / 0.004) ** 2)))

    infimum = Infimum(price)
    assert infimum.slack == SLACK
    assert infimum.rates(1.0, 1.0).per_metre == pytest.approx(80.0 / np.cos(0.0371), rel=1e-5)


@pytest.mark.parametrize("seed", (0, 2, 5, 7))
def test_no_motion_on_surfaces_and_slopes_costs_less(seed):
    cost = random_model(seed)
    if cost is None:
        pytest.skip("no model: some motion would cost nothing")
    rng = np.random.default_rng(seed)
    icr = replace(cost.icr, left=cost.icr.left * 1.3)
    wider = replace(cost.vehicle, icr=icr)
    other = PowerModel.paper(wider, K=rng.uniform(60, 200), mu=rng.uniform(0.3, 0.9))
    cost = replace(cost, model=with_weight(cost.model))
    ground = SurfaceMap((Surface(shapely.box(0, 0, 1, 1), with_weight(other)),))
    objective = Prices(cost, ground, {"energy": 1.0, "time": [0.0, 70.0][seed % 2]})
    steepest, worth = 0.15, 0.9 * 9.81 * cost.vehicle.mass
    prices = least_prices(objective, steepest, worth)
    least = prices.minorant(0.0)
    excess = prices.metre_excess()
    assert excess.min() < 1e-5 * least.metre + 1e-9
    ds, dtheta = random_motions(2000, cost.half_track, seed)
    steep = rng.uniform(-steepest, steepest, len(ds))
    travel, turn = np.abs(ds - cost.icr.centre[1] * dtheta), np.abs(dtheta)
    for region, beyond in enumerate(excess):
        paid = objective.motion(ds, dtheta, region, steep, exact=True) - worth * steep * ds
        bound = (least.metre + beyond) * travel + least.radian * turn
        assert np.all(bound <= paid + 1e-9 * np.abs(paid))
