"""Many variants of a mission over one and two workers of a Dask cluster, in one run.

python benchmarks/batch.py                      # 12 variants of the warehouse's mission

Workers are there, and have imported the library, before the clock starts, as in a cluster that
serves many batches. Both counts of workers start without knowing a route.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import distributed

import energyplan as ep
from energyplan import batch

FILE = Path(__file__).parents[1] / "examples" / "mission_warehouse.yaml"


def _ready(effort: int) -> float:
    """Evaluate another mission, so that kernels are loaded."""
    mission = replace(ep.read_mission(FILE), planning_effort=effort, soc=0.5)
    return ep.evaluate(mission).energy


def seconds(workers: int, count: int, effort: int) -> float:
    """Return the time that the variants take [s]."""
    mission = replace(ep.read_mission(FILE), planning_effort=effort)
    variants = [{"soc": 0.95 - 0.3 * k / count} for k in range(count)]
    with distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        with distributed.Client(cluster) as client:
            client.run(_ready, 1000)
        begun = time.perf_counter()
        made = list(batch.evaluate_variants(mission, variants, scheduler=cluster.scheduler_address))
        taken = time.perf_counter() - begun
    assert all(outcome.ok for outcome in made)
    return taken


def main(argv: Sequence[str] | None = None) -> None:
    """Print the times and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=12, help="variants")
    parser.add_argument("--effort", type=int, default=20_000, help="work on each route")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args(argv)
    ratios = []
    for _ in range(options.repeat):
        one, two = (seconds(n, options.count, options.effort) for n in (1, 2))
        ratios.append(one / two)
        print(f"one worker {one:.1f} s, two {two:.1f} s, ratio {one / two:.2f}", flush=True)
    print(f"median ratio {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
