"""With effort in place of time the same query gives the same plan, bit for bit."""

from __future__ import annotations

import hashlib
import importlib
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
import pytest
import shapely
from by_day import by_day
from worlds import COST, MAPS, cluttered, free_poses, room

from energyplan.comparison import compare
from energyplan.errors import TimeLimitError
from energyplan.io.maps import read_map
from energyplan.planning import Budget, Candidate, Plan, Planner, PlanningProblem, plan
from energyplan.planning.budget import EFFORT, PACE, plan_budget
from energyplan.planning.replanning import replan
from energyplan.planning.search.planner import prepare
from energyplan.power import PowerModel
from energyplan.terrain import Surface, SurfaceMap

MARBLE = SurfaceMap([Surface(shapely.box(2, 2, 7, 5), PowerModel.preset("quadriga:empty:marble"))])
ANSWER = """
import sys; sys.path.insert(0, {folder!r})
from test_effort import PROBLEM, digest
from energyplan.planning import plan
print(digest(plan(PROBLEM, effort=6_000)))
"""


def problem(seed=4):
    grid = cluttered(seed)
    start, goal = free_poses(grid, 2, 11, COST.vehicle)
    return PlanningProblem(grid, COST, start, goal, MARBLE)


PROBLEM = problem()


def digest(found: Plan) -> str:
    """Every bit of a plan but the times."""
    numbers = [
        *found.path.start, found.energy, found.lower_bound, found.gap, found.cost, found.length,
        found.turning, found.duration, found.potential, found.effort, *found.breakdown.values(),
    ]  # fmt: skip
    bits = np.concatenate([found.path.ds, found.path.dtheta, np.array(numbers, float)])
    return hashlib.sha256(bits.tobytes()).hexdigest()


def in_a_fresh_process(threads: int) -> str:
    folder = Path(__file__).parent
    paths = [str(folder), str(folder.parent), os.environ.get("PYTHONPATH", "")]
    given = {
        "PYTHONPATH": os.pathsep.join(paths),
        "NUMBA_NUM_THREADS": str(threads),
        "OMP_NUM_THREADS": str(threads),
    }
    done = subprocess.run(
        [sys.executable, "-c", ANSWER.format(folder=str(folder))],
        capture_output=True, text=True, check=True, env={**os.environ, **given},
    )  # fmt: skip
    return done.stdout.strip()


def test_the_same_bits_in_a_fresh_process_with_one_thread_and_under_load():
    told = in_a_fresh_process(1)
    stop = threading.Event()

    def burn() -> None:
        while not stop.is_set():
            np.linalg.svd(np.ones((60, 60)))

    busy = [threading.Thread(target=burn) for _ in range(2)]
    for thread in busy:
        thread.start()
    try:
        # warm caches, a busy machine, other queries before it
        plan(problem(2), effort=1_000)
        assert digest(plan(PROBLEM, effort=6_000)) == told
    finally:
        stop.set()
        for thread in busy:
            thread.join()


def test_nothing_that_decides_reads_the_clock(monkeypatch):
    """With a clock that jumps by an hour at each look the plan is the same."""
    monkeypatch.setattr("energyplan.planning.budget.EFFORT", 6_000)
    told = digest(plan(PROBLEM))
    hours = iter(range(0, 10**9, 3600))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(hours)))
    monkeypatch.setattr(time, "monotonic", lambda: float(next(hours)))
    assert digest(plan(PROBLEM)) == told
    assert digest(plan(PROBLEM, time_limit=1e9)) == told  # a cap that is not reached
    stopped = plan(PROBLEM, time_limit=1.0)  # which ends at the first look at the clock
    assert stopped.effort < 1_000
    assert stopped.stopped
    assert "stopped by the clock" in stopped.notes[0]
    assert f"with {stopped.effort} of 6000 units" in stopped.notes[0]
    assert stopped.notes[0] in str(stopped)


def test_every_way_to_plan_has_the_same_work_where_none_is_asked_for():
    problem = PlanningProblem(room(80, 80, 0.1), COST, (2, 2, 0), (6, 2, 0))
    former = plan(problem)
    told = compare(problem)
    plans = [
        former, told.energy_optimal, told.shortest, replan(problem, former, start=problem.start),
        plan(problem, effort=EFFORT),
    ]  # fmt: skip
    assert {found.effort_limit for found in plans} == {EFFORT}
    assert f"of {EFFORT}" in str(former)


def test_a_search_for_the_quickest_path_ends_with_its_effort():
    """Where the way to the goal is no cheaper than its limit, it is not found for ever."""
    grid = read_map(MAPS / "office.yaml")
    ends = free_poses(grid, 12, 5, COST.vehicle)
    for start, goal in zip(ends[::2], ends[1::2], strict=True):
        asked = PlanningProblem(grid, COST, start, goal, objective="time")
        with suppress(TimeLimitError):
            assert plan(asked, effort=3000).effort < 2 * 3000


def test_a_planner_that_counts_no_work_has_the_time_that_the_work_takes():
    known = plan(PROBLEM, effort=6_000).path
    given = []

    def clocked(problem, budget):
        given.append(budget)
        return Candidate(known)

    planner = Planner(clocked, surfaces=True)
    found = plan(PROBLEM, planner)
    assert found.effort_limit is None
    plan(PROBLEM, planner, time_limit=1e4)
    usual, longer = (budget.left / PACE for budget in given)
    assert usual <= EFFORT / PACE
    assert 0.5e4 < longer < 1e4


@pytest.mark.parametrize("name", by_day(["rrtstar", "bitstar"], ["bitstar"]))
def test_other_planners_too(name, monkeypatch):
    roomy = replace(PROBLEM, map=cluttered(4).with_unknown_free())
    hours = iter(range(0, 10**9, 3600))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(hours)))
    told = []
    for _ in range(2):
        try:
            told.append(digest(plan(roomy, name, effort=6_000)))
        except TimeLimitError as error:
            told.append(str(error))
    assert told[0] == told[1]


def test_what_is_made_once_for_a_map_is_there_before_the_clock_starts(monkeypatch):
    clocks = []
    made = []

    class Clock(Budget):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            clocks.append(len(made))

    def watched(name):
        module, function = name.rsplit(".", 1)
        original = getattr(importlib.import_module(module), function)

        def wrapper(*args, **kwargs):
            made.append(function)
            return original(*args, **kwargs)

        monkeypatch.setattr(name, wrapper)

    fresh = problem()
    told = digest(plan(fresh, effort=2_000))
    monkeypatch.setattr("energyplan.planning.budget.Budget", Clock)
    watched("energyplan.planning.space.places.free_space")
    watched("energyplan.planning.space.places.connect_places")
    watched("energyplan.planning.bound.outline.outline_for")
    watched("energyplan.planning.bound.surfaces._certain_regions")
    monkeypatch.setattr("energyplan.planning.space.prices._remembered", WeakKeyDictionary())
    query = problem()
    assert digest(plan(query, effort=2_000)) == told
    # the first one only checks the numbers
    assert clocks == [0, len(made)]
    assert set(made) == {"free_space", "connect_places", "outline_for", "_certain_regions"}
    made.clear()
    assert digest(plan(query, effort=2_000)) == told
    assert made == []
    # whether they were there makes no difference
    prepare(ready := problem())
    made.clear()
    assert digest(plan(ready, effort=2_000)) == told
    assert made == []


def test_more_effort_is_better_and_effort_is_what_was_spent():
    efforts = (1_000, 12_000, 40_000)
    found = [plan(PROBLEM, effort=effort, gap=0.0) for effort in efforts]
    assert found[0].energy > found[1].energy >= found[2].energy
    for plan_found, effort in zip(found, efforts, strict=True):
        # one step more than asked for at most: a slice of attempts or the shortcuts of a path
        assert 0 < plan_found.effort <= effort + 3_000


def test_parts_of_a_budget_spend_from_the_whole():
    whole = Budget(effort=100)
    half = whole.part(0.5)
    half.spend(20)
    assert (whole.spent, whole.left, half.left) == (20, 80, 30)
    whole.spend(30)
    assert half.over and not whole.over
    beside = whole.apart(30)
    beside.spend(30)
    assert beside.over and whole.left == 50
    with pytest.raises(TimeLimitError, match="effort was over when half was done; give more"):
        half.check("half was done")


def test_a_budget_of_time_ends_with_it(monkeypatch):
    now = [10.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    whole = Budget(2.0)
    half = whole.part(0.5)
    whole.spend(1e9)  # work does not count by the clock
    assert not whole.over
    now[0] = 11.1
    assert half.over and not whole.over
    now[0] = 12.1
    assert whole.over and whole.elapsed == pytest.approx(2.1)
    assert Budget().left == np.inf


def test_the_default_effort_grows_with_what_a_large_map_takes():
    """An effort that is given stays as it is; parts that exist grow as well."""
    default, given = plan_budget(np.inf, None), plan_budget(np.inf, EFFORT)
    half = default.part(0.5)
    for budget in (default, given):
        budget.spend_on_map(0.2 * EFFORT)
    assert default.limit == given.limit == EFFORT
    for budget in (default, given):
        budget.spend_on_map(3.0 * EFFORT)
    assert given.over and given.limit == EFFORT
    assert default.limit == round(3.75 * EFFORT)
    assert default.left == pytest.approx(0.55 * EFFORT)
    assert half.left == 0.0 and default.part(0.5).left == pytest.approx(0.275 * EFFORT)
