"""Batches: every item comes back once, whatever happens to it or to its worker."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_items import deadly, picky, scaled, slow, square

from energyplan import batch
from energyplan.battery import Battery
from energyplan.mission import Mission, Task, evaluate
from energyplan.mission.foresight import routes_wanted
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid


def test_every_item_comes_back_once_with_progress():
    told: list[tuple[int, int]] = []
    outcomes = list(
        batch.run(square, range(50), workers=2, progress=lambda *args: told.append(args))
    )
    assert sorted(o.index for o in outcomes) == list(range(50))
    assert all(o.value == o.index**2 for o in outcomes)
    assert told == [(k + 1, 0) for k in range(50)]


def test_a_failed_item_is_reported_and_the_rest_go_on():
    outcomes = {o.index: o for o in batch.run(picky, range(20), workers=2)}
    bad = {k for k, o in outcomes.items() if not o.ok}
    assert bad == {3, 8, 13, 18}
    assert outcomes[3].error == "ValueError: 3 is not to my taste"
    assert "picky" in outcomes[3].trace
    assert outcomes[4].value == 4
    with pytest.raises(batch.BatchError, match="item 3 failed: ValueError"):
        _ = outcomes[3].value


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_will_do_and_stays_open(kind):
    with kind(2) as pool:
        outcomes = list(batch.run(scaled, [1.0, 2.0], shared=np.ones(3), executor=pool))
        assert sorted(o.value for o in outcomes) == [3.0, 6.0]
        assert pool.submit(square, 3).result() == 9


def test_items_are_taken_as_they_are_needed():
    taken: list[int] = []

    def endless() -> Any:
        k = 0
        while True:
            taken.append(k)
            yield k
            k += 1

    with ThreadPoolExecutor(2) as pool:
        outcomes = batch.run(square, endless(), executor=pool)
        for _ in range(10):
            next(outcomes)
        outcomes.close()
    assert len(taken) < 10 + 2 * (os.cpu_count() or 1) + 4


def test_dead_workers_are_survived(tmp_path):
    marker = str(tmp_path / "killed")
    outcomes = list(batch.run(deadly, range(30), shared=marker, workers=2))
    assert sorted(o.index for o in outcomes) == list(range(30))
    # What killed its worker once is done again; what always does is reported.
    assert [o.index for o in outcomes if not o.ok] == [11]
    assert "BrokenProcessPool" in next(o.error for o in outcomes if not o.ok)


def test_variants_of_a_mission():
    hall = OccupancyGrid(np.zeros((60, 100), bool), 0.1)
    base = Mission(
        PowerModel.preset("quadriga:empty:marble"), hall, Battery.preset("quadriga"),
        Pose(1.0, 3.0, 0.0), (Task("far", Pose(8.0, 3.0, 0.0)),), confidence=0.5,
    )  # fmt: skip
    variants = [{"soc": 0.9}, {"soc": 0.1}, {"soc": 0.5}]
    outcomes = {o.index: o for o in batch.evaluate_variants(base, variants, workers=2)}
    assert outcomes[0].value.soc_end > outcomes[2].value.soc_end
    assert outcomes[1].error.startswith("MissionError: the reserve")


def note_routes(folder: str) -> None:
    """Let this process leave a file for every route that it plans."""
    from energyplan.mission import legs

    planned = legs.plan

    def noted(problem, *args, **options):
        name = f"{tuple(problem.start)} to {tuple(problem.goal)}"
        number = len(list(Path(folder).iterdir()))
        (Path(folder) / f"{os.getpid()} {number} {name}").touch()
        return planned(problem, *args, **options)

    legs.plan = noted


def rooms() -> Mission:
    """A mission round two walls, whose routes are no straight lines."""
    cells = np.zeros((60, 100), bool)
    cells[:40, 35:38] = cells[20:, 65:68] = True
    places = {"a": (2.0, 4.0), "b": (5.0, 1.0), "c": (8.5, 5.0), "d": (8.5, 1.5)}
    return Mission(
        PowerModel.preset("quadriga:empty:marble"), OccupancyGrid(cells, 0.1),
        Battery.preset("quadriga"), Pose(1.0, 1.0, 0.0),
        tuple(Task(name, Pose(x, y, 0.0)) for name, (x, y) in places.items()),
        confidence=0.5, planning_effort=2000,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers on this machine; one that dies is replaced."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        yield made


@pytest.mark.nightly
def test_no_route_is_planned_twice_by_the_workers_of_a_cluster(cluster, tmp_path):
    """Two workers plan some of them each, and both know all before the first variant."""
    mission, variants = rooms(), [{"soc": 0.9 - 0.05 * k} for k in range(8)]
    with cluster.get_client() as client:
        client.wait_for_workers(2)
        client.run(note_routes, str(tmp_path))
    outcomes = list(batch.evaluate_variants(mission, variants, scheduler=cluster.scheduler_address))
    assert all(outcome.ok for outcome in outcomes), [outcome.error for outcome in outcomes]
    notes = [file.name.split(" ", 2) for file in tmp_path.iterdir()]
    # a way back is the way there driven backwards, where that costs the same
    routes = ["".join(sorted(route.split(" to "))) for _, _, route in notes]
    assert len(routes) == len(routes_wanted(rooms()))
    assert len(set(routes)) == len(routes)
    assert len({process for process, _, _ in notes}) == 2
    alone = {k: evaluate(replace(mission, **change)) for k, change in enumerate(variants)}
    for outcome in outcomes:
        assert outcome.value.energy == pytest.approx(alone[outcome.index].energy, rel=1e-9)


def test_routes_that_were_learned_are_not_planned_again(monkeypatch):
    from energyplan.mission import foresight, legs

    mission = rooms()
    first = evaluate(mission)
    routes = foresight.known_routes(mission.map)
    other = replace(mission, map=OccupancyGrid(mission.map.occupied, 0.1))
    wanted = routes_wanted(other)
    assert foresight.known_routes(other.map) == {}  # guesses are no routes
    assert len({frozenset(route) for route in wanted}) == len(wanted)
    foresight.learn_routes(other.map, routes)
    assert routes_wanted(other) == []
    monkeypatch.setattr(legs, "plan", None)
    assert evaluate(other).energy == first.energy


@pytest.mark.slow
def test_a_dask_cluster_loses_a_worker_and_no_result(cluster):
    with cluster.get_client() as client:
        client.wait_for_workers(2)
    doomed = next(iter(cluster.workers.values())).process.pid
    outcomes = []
    for outcome in batch.run(slow, range(40), shared="x", scheduler=cluster.scheduler_address):
        outcomes.append(outcome)
        if len(outcomes) == 8:
            os.kill(doomed, signal.SIGKILL)
    assert sorted(o.index for o in outcomes) == list(range(40))
    assert all(o.ok for o in outcomes)
    assert sorted(o.value[0] for o in outcomes) == list(range(40))
    early = {o.value[1] for o in outcomes[:8]}
    assert doomed in early
    assert doomed not in {o.value[1] for o in outcomes[14:]}
