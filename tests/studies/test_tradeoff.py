"""Energy against time: against closed forms, against each other, and above the lower bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from by_day import by_day
from matplotlib.axes import Axes

import energyplan
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.output import plots
from energyplan.planning import PlanningProblem, plan
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import VISCOUS_LOSS
from energyplan.studies.pareto import pareto
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap, path_price
from energyplan.vehicle import MotorLimits

MODEL = PowerModel.preset("quadriga:empty:concrete")
VISCOUS, IDLE, TOP = 150.0, 30.0, 1.2
STIFF = EnergyCost(MODEL.with_term(VISCOUS_LOSS, VISCOUS).with_term(HOTEL, IDLE))
OPEN = OccupancyGrid(np.zeros((100, 120), bool), 0.1)
AHEAD = PlanningProblem(OPEN, STIFF, (2, 5, 0), (10, 5, 0))


def walled():
    boxes = [shapely.box(4, 0, 4.5, 5), shapely.box(7.5, 3, 8, 8)]
    return OccupancyGrid.from_polygons(boxes, (0, 0, 12, 8), 0.1)


VALUES = [0.0, 60.0, 1000.0]
"""None, one between, and one for which the top speed is too slow."""


@pytest.fixture(scope="module")
def ahead():
    return energyplan.pareto(AHEAD, VALUES, effort=3_000)


def test_the_front_of_a_straight_drive_is_the_closed_form(ahead):
    """At speed v: 8 m of ``2 K + 2 B v + P / v``; the best v for w is ``((P + w) / 2 B)^(1/2)``."""
    speed = np.minimum(np.sqrt((IDLE + np.array(VALUES)) / (2 * VISCOUS)), TOP)
    assert ahead.duration == pytest.approx(8 / speed, rel=1e-4)
    assert ahead.energy == pytest.approx(8 * (226 + 2 * VISCOUS * speed + IDLE / speed), rel=1e-4)
    # and no drive straight ahead, at any speed, comes below the bounds
    every = np.linspace(0.1, TOP, 200)
    energy = 8 * (226 + 2 * VISCOUS * every + IDLE / every)
    assert np.all(ahead.least_energy(8 / every) <= energy * (1 + 1e-6))
    assert ahead.least_energy(ahead.duration) == pytest.approx(ahead.energy, rel=1e-4)


@pytest.mark.parametrize(
    "values", [[0.0, 20.0, 60.0, 200.0], pytest.param(None, marks=pytest.mark.nightly)]
)
def test_no_drive_beats_another_and_none_is_below_its_bound(values):
    problem = PlanningProblem(walled(), STIFF, (1.5, 2, 0), (10.5, 6, 2.0))
    front = pareto(problem, values, effort=2_000)
    assert len(front.points) >= 4
    assert np.all(np.diff(front.energy) > 0)
    assert np.all(np.diff(front.duration) < 0)
    assert np.all(front.least_energy(front.duration) <= front.energy)
    for point in front.points:
        cost = replace(STIFF, time_value=point.time_value)
        assert point.plan.energy == pytest.approx(cost.energy(point.plan.path), rel=1e-12)
        assert point.plan.duration == pytest.approx(cost.duration(point.plan.path), rel=1e-12)
        total = point.plan.energy + point.time_value * point.plan.duration
        assert point.plan.cost == pytest.approx(total, rel=1e-12)
        assert point.plan.lower_bound <= total
        # best at its own value of a second
        others = front.energy + point.time_value * front.duration
        assert total <= others.min() * (1 + 1e-9)
        assert problem.map.path_free(point.plan.path, problem.robot)
    # the usual plan is its end of least energy
    alone = plan(problem, effort=2_000)
    assert front.energy[0] <= alone.energy * 1.01


def test_without_a_price_of_speed_only_routes_can_differ():
    """In the open, where the straight way is best at both, one drive is left of all values'."""
    front = pareto(replace(AHEAD, cost=EnergyCost(MODEL)), effort=15_000)
    assert len(front.points) == 1
    assert front.duration[0] == pytest.approx(8 / TOP)


def test_grounds_trade_routes_against_time():
    """A short cut through mud costs energy and saves time, if a second is worth enough."""
    mud = PowerModel.paper(MODEL.vehicle, K=400.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(4, 3, 8, 9), mud)])
    ground.raster(OPEN)  # compile first
    cost = EnergyCost(MODEL)
    problem = PlanningProblem(OPEN, cost, (2, 5, 0), (10, 5, 0), surfaces=ground)
    front = pareto(problem, [0.0, 2000.0], effort=8_000)
    assert len(front.points) == 2
    around, through = (point.plan for point in front.points)
    assert through.length == pytest.approx(8, rel=0.01)
    assert around.length > 9
    assert around.energy == pytest.approx(path_price(around.path, cost, ground).energy, rel=1e-12)


@pytest.mark.parametrize("planner", by_day(["roadmap", "bitstar"], ["roadmap"]))
def test_other_planners_trade_as_well(planner):
    problem = PlanningProblem(walled(), STIFF, (1.5, 2, 0), (10.5, 6, 2.0))
    front = pareto(problem, [0.0, 200.0], planner, effort=4_000)
    assert len(front.points) == 2
    assert front.points[0].plan.planner == planner
    assert np.all(front.least_energy(front.duration) <= front.energy)


def test_what_cannot_be_traded_is_refused():
    with pytest.raises(InvalidInputError, match="time_values is empty"):
        pareto(AHEAD, [], effort=15_000)
    with pytest.raises(InvalidInputError, match="time_value"):
        pareto(AHEAD, [-1.0], effort=15_000)
    free = replace(MODEL, vehicle=replace(MODEL.vehicle, motor=MotorLimits()))
    with pytest.raises(InvalidInputError, match="speed limit"):
        pareto(replace(AHEAD, cost=EnergyCost(free)), effort=10_000)


def test_picture_of_a_front(ahead):
    ax = plots.figure().axes[0]
    assert plots.pareto(ax, ahead) is ax
    assert isinstance(ax, Axes)
    drawn = ax.get_lines()[0]
    assert drawn.get_xdata() == pytest.approx(ahead.duration)
    assert drawn.get_ydata() == pytest.approx(ahead.energy / 1e3)
    assert ax.get_xlabel() == "time [s]"
    assert ax.get_ylabel() == "energy [kJ]"
    assert [note.get_text() for note in ax.texts] == ["0 J/s", "60 J/s", "1000 J/s"]
    assert "1000" in ahead._repr_html_()
