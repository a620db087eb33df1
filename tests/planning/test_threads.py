"""Work side by side: the same with effort, however many threads there are."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
from by_day import by_day
from worlds import COST, room

from energyplan import Battery, Mission, OccupancyGrid, PlanningProblem, Task, evaluate, plan
from energyplan.planning import budget as budgets
from energyplan.planning.budget import Budget, side_by_side
from energyplan.terrain import grid
from energyplan.terrain.updates import tables_of


def rooms(door: float) -> OccupancyGrid:
    """Return three rooms in a row with doors of some width, in cells of 5 cm."""
    half = round(door / 0.05 / 2)
    walls = [np.s_[40:80, 110:130]]
    for column, row in ((78, 30), (158, 90)):
        across = slice(column, column + 3)
        walls += [(slice(row - half), across), (slice(row + half, None), across)]
    return room(120, 240, 0.05, *walls)


@pytest.mark.parametrize("effort", by_day([6_000, 25_000], [6_000]))
def test_with_effort_a_plan_does_not_depend_on_the_threads(monkeypatch, effort):
    problem = PlanningProblem(rooms(0.9), COST, (1, 4, 0), (11, 1, 2))
    made = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(budgets, "processors", lambda threads=threads: threads)
        made.append(plan(problem, effort=effort))
    for other in made[1:]:
        assert np.array_equal(other.path.ds, made[0].path.ds)
        assert np.array_equal(other.path.dtheta, made[0].path.dtheta)
        assert other.lower_bound == made[0].lower_bound


def test_tasks_spend_in_their_order_and_no_more_than_there_is():
    budget = Budget(effort=100)

    def task(units):
        def run(own):
            while not own.over:
                own.spend(units)
            return own.spent

        return run

    assert side_by_side(budget, [task(1), task(3), task(5)], 30) == [30, 30, 30]
    assert budget.spent == 90
    assert side_by_side(budget, [task(1), task(1)], 30) == [5, 5]
    assert budget.over
    assert side_by_side(budget, [], 30) == []


def test_what_is_made_once_comes_on_top_of_the_time_only():
    counted = Budget(effort=10)
    assert counted.beside(lambda: 7) == 7
    assert counted.left == 10


def at_once(work: list[Callable[[], object]]) -> list[object]:
    """Return what comes of work that as many threads do at the same time."""
    begin = Barrier(len(work))

    def run(one: Callable[[], object]) -> object:
        begin.wait(60)
        return one()

    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(len(work)) as pool:
            return list(pool.map(run, work))
    finally:
        sys.setswitchinterval(usual)


def test_what_threads_ask_for_at_once_is_the_same_as_alone():
    """A map's tables are made by whoever comes first; none of it may show in a result."""
    pose, goals = (1, 4, 0), [(3, 5, 1), (11, 1, 2)]

    def work(grid: OccupancyGrid) -> list[Callable[[], object]]:
        def route() -> object:
            found = plan(PlanningProblem(grid, COST, pose, goals[0]), effort=300)
            return found.path, found.energy, found.lower_bound

        def mission() -> object:
            tasks = [Task("a", goals[0])]
            asked = Mission(
                model=COST.model, map=grid, battery=Battery.preset("quadriga"), start=pose,
                tasks=tasks, confidence=0.5, planning_effort=100,
            )  # fmt: skip
            return evaluate(asked).timeline.soc.tobytes()

        return [route, mission, route]

    alone = [one() for one in work(rooms(0.9))]
    for _ in range(5):
        assert at_once(work(rooms(0.9))) == alone


def test_threads_share_what_was_made_first(monkeypatch):
    """What is told by its identity is one thing, however many threads make it."""
    both = Barrier(2)

    def slow(make: Callable[..., object] = object) -> Callable[..., object]:
        def made(*given: object) -> object:
            both.wait(60)  # neither is quicker
            return make(*given)

        return made

    hall = rooms(0.9)
    tables = tables_of(hall.space)
    one, other = at_once([lambda: tables.get("table", slow())] * 2)
    assert one is other
    monkeypatch.setattr(grid, "new_space", slow(grid.new_space))
    fresh = OccupancyGrid(hall.occupied, 0.05)
    _ = fresh.blocked
    one, other = at_once([lambda: fresh.space] * 2)
    assert one is other
