"""What ground asks of a plan, against values that a pencil gives."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.optimize import brentq
from worlds import room

import energyplan as ep
from energyplan.power import tread_forces
from energyplan.power.effects import effect
from energyplan.terrain import Surface

HALL = room(240, 400, 0.05)
QUARTER = np.pi / 2
COST = ep.EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)


def corner(first, last):
    """Least energy from (2, 2, 0) to (8, 8, 90 degrees) on two left arcs and a line [J]."""
    apart = np.hypot(6 - last, 6 - first)
    line = np.sqrt(apart**2 - (first - last) ** 2)
    yaw = np.arctan2(6 - first, 6 - last) + np.arcsin((first - last) / apart)
    return 200 * (first * yaw + line + last * (QUARTER - yaw)) + 100 * QUARTER


@pytest.mark.parametrize(
    ("left", "radius", "joules"),
    [(0, 0.0, corner(0.5, 0.5)), (0, 2.0, corner(2.0, 2.0)), (5, 0.9, corner(0.5, 0.9))],
)
def test_a_lawn_on_which_arcs_are_wide(left, radius, joules):
    """On other ground a tread stands still: arcs of 0.5 m."""
    lawn = Surface(shapely.box(left, 0, 12, 12), COST.model, turning_radius=radius)
    ground = ep.SurfaceMap([lawn])
    problem = ep.PlanningProblem(HALL, COST, (2, 2, 0), (8, 8, QUARTER), surfaces=ground)
    found = ep.plan(problem, effort=8000)
    assert found.energy_driven == pytest.approx(joules, rel=1e-4)
    assert found.lower_bound <= joules * (1 + 1e-9)
    spins = ep.Path((2, 2, 0), [0, 6 * np.sqrt(2), 0], [QUARTER / 2, 0, QUARTER / 2])
    fault = problem.fault(spins)
    assert fault is None if radius == 0 else f"arc of less than {radius:g} m" in fault


def past_corners():
    """Least energy from (2, 5, 0) to (18, 5, 0) past the corners (8, 8) and (12, 8) [J].

    An arc of 0.5 m, a line at an angle, and an arc that ends at the corner; then the same back.
    """

    def off(angle):
        return (2 + np.cos(angle)) * np.cos(angle) - (6 - np.sin(angle)) * np.sin(angle)

    angle = brentq(off, 0.1, 1.0)
    line = np.hypot(6 - np.sin(angle), 2 + np.cos(angle))
    return 200 * (2 * (line + angle) + 4) + 100 * 4 * angle


@pytest.mark.parametrize("second", [0.0, 50.0, 110.0, 150.0, 1000.0])
def test_people_for_whom_each_second_has_a_price(second):
    """Straight through 4 m of them at 1 m/s, or past their corners."""
    people = Surface(shapely.box(8, 0, 12, 8), COST.model, second=second)
    ends = (2, 5, 0), (18, 5, 0)
    ground = ep.SurfaceMap([people])
    found = ep.plan(ep.PlanningProblem(HALL, COST, *ends, surfaces=ground), effort=8000)
    through = 16 * 200 + 4 * second
    if through < past_corners():
        assert found.cost == pytest.approx(through, rel=1e-9)
        assert found.energy_driven == pytest.approx(16 * 200, rel=1e-9)
    else:
        assert found.cost == pytest.approx(past_corners(), rel=0.01)
        assert found.soft_cost < 0.01 * through
    assert found.lower_bound <= min(through, past_corners())


@effect(
    "rows_by_hand", symbol="F_c", unit="N", meaning="rows that the wheels climb", channels=("yaw",),
    plausible=(0.0, 500.0), manoeuvre="drive along the rows and across them",
)  # fmt: skip
def rows_by_hand(motion, vehicle):
    across = np.abs(np.sin(motion.channel("yaw")))
    return tread_forces(motion, longitudinal=np.sign(motion.v) * across)


@pytest.mark.parametrize("metres", [(4, 0), (0, 4), (3, 4), (-4, 3)])
def test_crop_rows_of_a_force_of_200_n_across(metres):
    """A metre takes 226 J, and a metre across the rows 200 J more, in whichever direction."""
    model = ep.PowerModel.preset("quadriga:empty:concrete").with_term(rows_by_hand.terms[0], 200.0)
    yaw = np.arctan2(metres[1], metres[0])
    start = (6, 5, yaw)
    problem = ep.PlanningProblem(
        HALL, ep.EnergyCost(model), start, (6 + metres[0], 5 + metres[1], yaw)
    )
    found = ep.plan(problem, effort=1000)
    joules = 226 * np.hypot(*metres) + 200 * abs(metres[1])
    assert found.energy_driven == pytest.approx(joules, rel=1e-9)
    assert found.energy_steady == pytest.approx(joules, rel=1e-9)
    assert ep.check(found.driven.trajectory, model).energy == pytest.approx(joules, rel=1e-9)
    assert (1 - 1e-3) * joules < found.lower_bound <= joules * (1 + 1e-9)
