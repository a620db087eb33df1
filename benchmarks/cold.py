"""Time of a first plan: with an empty folder of compiled kernels, and with a full one.

python benchmarks/cold.py                       # three times each, about a minute
python benchmarks/cold.py --demo                # the demo as well

Each run is a process of its own, as on the command line. CPU is that of the process and of all
that it started: on a machine that does other work besides, it says more than the time on the wall.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import energyplan

BUNDLE = Path(energyplan.__file__).parents[1] / "maps"
PLAN = [
    "plan", "--map", str(BUNDLE / "warehouse.yaml"), "--model", "quadriga:full:concrete",
    "--start", "2,2,0", "--goal", "20,12,90deg", "--json",
]  # fmt: skip


class Run(NamedTuple):
    """Seconds on the wall and of all processors."""

    wall: float
    cpu: float


def run(arguments: list[str], folder: str) -> Run:
    """Run a command with its kernels in a folder."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "energyplan", *arguments],
        env={**os.environ, "ENERGYPLAN_CACHE_DIR": folder},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return Run(wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def measure(name: str, arguments: list[str], repeat: int) -> None:
    """Print a table's rows for one command."""
    cold, warm = [], []
    for _ in range(repeat):
        with tempfile.TemporaryDirectory() as folder:
            cold.append(run(arguments, folder))
            warm.append(run(arguments, folder))
    for label, runs in (("cold", cold), ("warm", warm)):
        wall, cpu = (statistics.median(column) for column in zip(*runs, strict=True))
        print(f"{name:8}{label:6}{wall:10.1f}{cpu:10.1f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--demo", action="store_true")
    options = parser.parse_args()
    print(f"{'command':8}{'':6}{'wall [s]':>10}{'CPU [s]':>10}   {os.cpu_count()} processors")
    measure("plan", PLAN, options.repeat)
    if options.demo:
        with tempfile.TemporaryDirectory() as out:
            measure("demo", ["demo", "--out", out], options.repeat)


if __name__ == "__main__":
    main()
