"""Missions a minute on a cluster: ``python benchmarks/many.py``.

The bundled mission of a warehouse from different charges, with routes of little work, on one worker
of this machine and on two, after one mission on each. It needs the extra ``cluster``.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path

import yaml
from distributed import Client

from energyplan.cli.routes import evaluated_mission
from energyplan.io.files import bundled
from energyplan.io.many import answers

COUNT = 5
"""Missions for each worker."""


def measured(workers: int, files: list[Path]) -> str:
    """Return the row of some workers."""
    work = partial(evaluated_mission, effort=500, reverse=None)
    with Client(n_workers=workers, threads_per_worker=1, dashboard_address=None) as client:
        client.run(work, files[0])  # kernels are compiled or read
        spent = -sum(client.run(time.process_time).values())
        begun = time.perf_counter()
        found = list(answers(work, files, client.get_executor(pure=False)))
        wall = time.perf_counter() - begun
        spent += sum(client.run(time.process_time).values())
    assert len(found) == len(files) and not any("error" in line for line in found)
    pace = 60 * len(files) / wall / workers
    return f"| {workers} | {len(files)} | {wall:.0f} s | {pace:.0f} | {spent / len(files):.2f} s |"


def main() -> None:
    """Print the table."""
    mission = yaml.safe_load(bundled("mission_warehouse.yaml").read_text())
    rows = [
        "| workers | missions | time | missions a minute of time and worker | CPU time of one |",
        "|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for k in range(2 * COUNT):
            files.append(Path(folder) / f"{k:02d}.yaml")
            files[-1].write_text(yaml.safe_dump({**mission, "soc": 1.0 - 0.02 * k}))
        rows += [measured(workers, files[: COUNT * workers]) for workers in (1, 2)]
    print("\n".join(rows))


if __name__ == "__main__":
    main()
