"""Motors that take no power back: arcs that no speed allows are driven as pivots and lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import room

import energyplan as ep
from energyplan.power import HOTEL

HALF = ep.Vehicle.preset("quadriga:empty").icr.half_track
SLIPPING = 2.0
"""Friction coefficient at which an inner side is dragged in any arc."""


def model(hotel: float = 0.0, **limits: float) -> ep.PowerModel:
    vehicle = ep.Vehicle.preset("quadriga:empty")
    motor = replace(ep.MotorLimits(speed=1.0), **limits)
    found = ep.PowerModel.paper(replace(vehicle, motor=motor), K=50.0, mu=SLIPPING)
    return found.with_term(HOTEL, hotel) if hotel else found


@pytest.mark.parametrize("hotel", [0.0, 60.0])
def test_an_arc_costs_and_lasts_as_long_as_the_pivot_and_the_line_that_lead_there(hotel):
    cost = ep.EnergyCost(model(hotel, regeneration=0.0))
    free = ep.EnergyCost(model(hotel))
    radius = np.array([1.5, 3.0, -8.0])
    pivot = np.copysign(HALF, radius), np.ones(3)
    for of in ("segment_energy", "segment_duration"):
        mixed = getattr(free, of)(*pivot) + getattr(free, of)(radius - pivot[0], 0.0)
        assert np.allclose(getattr(cost, of)(radius, 1.0), mixed, rtol=1e-7)
        # a spin, a pivot and a line return nothing
        for ds, turn in ((0.0, 1.0), (HALF, -1.0), (-1.0, 0.0), (0.2, 1.0)):
            assert np.isclose(getattr(cost, of)(ds, turn), getattr(free, of)(ds, turn), rtol=1e-7)
    path = ep.Path(ep.Pose(0, 0, 0), radius, np.ones(3))
    assert np.isclose(cost.energy(path), cost.segment_energy(radius, 1.0).sum(), rtol=1e-6)
    assert np.isclose(sum(cost.breakdown(path).values()), cost.energy(path))
    assert np.isclose(cost.duration(path), cost.segment_duration(radius, 1.0).sum(), rtol=1e-6)
    assert cost.admissible_speed(1.0) == cost.cheapest_speed(1.0) == 0.0


@pytest.mark.parametrize("hotel", [0.0, 60.0])
def test_a_plan_is_driven_without_returning_power(hotel):
    cost = ep.EnergyCost(model(hotel, regeneration=0.0))
    around = room(60, 80, 0.1, np.s_[:35, 38:42])
    task = ep.PlanningProblem(around, cost, (1.5, 1.5, 0.0), (6.5, 1.5, -2.0))
    assert ep.check(ep.plan(task, effort=3000).driven.trajectory, cost.model).feasible
