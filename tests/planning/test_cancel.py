"""Planning ends as soon as nobody wants its result."""

from __future__ import annotations

import threading

import pytest
from worlds import COST, MAPS, cluttered, free_poses

import energyplan as ep
from energyplan.errors import CancelledError
from energyplan.planning import cancellable, planners

MISSION = MAPS.parent / "examples" / "mission_warehouse.yaml"


class Unwanted:
    """Says so from the n-th question on, and counts the questions that follow, by thread."""

    def __init__(self, after: int) -> None:
        self.left = after
        self.asked_again: dict[int, int] = {}

    def __call__(self) -> bool:
        self.left -= 1
        if self.left > 0:
            return False
        thread = threading.get_ident()
        self.asked_again[thread] = self.asked_again.get(thread, 0) + 1
        return True


def problem():
    grid = cluttered(4)
    start, goal = free_poses(grid, 2, 11, COST.vehicle)
    return ep.PlanningProblem(grid, COST, start, goal)


@pytest.mark.parametrize("after", [1, 2, 9, 60])
def test_a_plan_ends_wherever_it_is(after):
    unwanted = Unwanted(after)
    hall = ep.read_map(MAPS / "warehouse.yaml")
    aisles = ep.PlanningProblem(hall, COST, (2, 2, 0), (20, 12, 1.5))
    with pytest.raises(CancelledError, match="cancelled"), cancellable(unwanted):
        ep.plan(aisles, effort=500_000)
    assert sum(unwanted.asked_again.values()) <= 16  # those that ran side by side


@pytest.mark.parametrize("name", planners())
def test_every_planner_can_be_cancelled(name):
    with pytest.raises(CancelledError), cancellable(Unwanted(2)):
        ep.plan(problem(), name, effort=100_000)


def test_a_plan_that_is_wanted_is_the_same():
    plain = ep.plan(problem(), effort=5_000)
    with cancellable(lambda: False):
        again = ep.plan(problem(), effort=5_000)
    assert (again.path.ds.tolist(), again.energy) == (plain.path.ds.tolist(), plain.energy)


def test_what_plans_inside_ends_too():
    mission = ep.read_mission(MISSION)
    for work in (
        lambda: ep.evaluate(mission),
        lambda: ep.compare(problem(), effort=5_000),
        lambda: ep.energy_map(problem()),
    ):
        with pytest.raises(CancelledError), cancellable(Unwanted(3)):
            work()
    assert ep.plan(problem(), effort=3_000).energy > 0  # nothing is left behind
