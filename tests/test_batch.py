"""Batches: every item comes back once, whatever happens to it or to its worker."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from energyplan import batch
from energyplan.battery import Battery
from energyplan.mission import Mission, Task
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid


def square(x: int) -> int:
    return x * x


def picky(x: int) -> int:
    if x % 5 == 3:
        raise ValueError(f"{x} is not to my taste")
    return x


def scaled(x: float, shared: np.ndarray) -> float:
    return float(x * shared.sum())


def deadly(x: int, marker: str) -> int:
    """Kill the worker at item 7 the first time, and at item 11 every time."""
    if x == 11:
        os.kill(os.getpid(), signal.SIGKILL)
    if x == 7 and not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def slow(x: int, shared: str) -> tuple[int, int]:
    time.sleep(0.1)
    return x, os.getpid()


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


@pytest.mark.slow
def test_a_dask_cluster_loses_a_worker_and_no_result():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
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
