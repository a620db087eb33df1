"""What a start takes: processor time of commands over that of importing what all of them need.

python benchmarks/cold.py                       # about two minutes
python benchmarks/cold.py --demo                # the demo as well

The unit is ``python -c "import numpy, numba, shapely, yaml"``. A cold command finds an empty folder
of compiled kernels, a warm one a full one; Python's bytecode is there. Each run is a process of its
own, with all that it starts. On a machine that does other work besides, ratios say more than
seconds. The last line is the processor time of replanning where the rest of a path is kept.
"""

from __future__ import annotations

import argparse
import compileall
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import energyplan

PACKAGE = Path(energyplan.__file__).parent
UNIT = ["-c", "import numpy, numba, shapely, yaml"]
PLAN = [
    "plan", "--map", str(PACKAGE.parent / "maps" / "warehouse.yaml"),
    "--model", "quadriga:full:concrete", "--start", "2,2,0", "--goal", "20,12,90deg", "--json",
    "--effort", "5000",
]  # fmt: skip
REPLAN = f"""
import time
import energyplan as ep
from energyplan.planning.replanning import replan
place = ep.read_map({PLAN[2]!r})
cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:full:concrete"))
problem = ep.PlanningProblem(place, cost, (2, 2, 0), (20, 12, 1.57))
former = ep.plan(problem, effort=5000)
pose = former.path.poses(0.5)[10]
spent = []
for _ in range(12):
    begun = time.process_time()
    replan(problem, former, start=pose, effort=1000)
    spent.append(time.process_time() - begun)
print(sorted(spent)[6])
"""


def spent(arguments: list[str], folder: str = "") -> float:
    """Return the processor time of a Python process and of its children [s]."""
    kept = {"ENERGYPLAN_CACHE_DIR": folder} if folder else {}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], env={**os.environ, **kept}, check=True, **quiet)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(name: str, arguments: list[str], repeat: int) -> None:
    """Print a table's rows for one command."""
    command, units, cold, warm = ["-m", "energyplan", *arguments], [], [], []
    for _ in range(repeat):
        with tempfile.TemporaryDirectory() as folder:
            units.append(spent(UNIT))
            cold.append(spent(command, folder))
            units.append(spent(UNIT))
            warm += [spent(command, folder) for _ in range(3)]
            units.append(spent(UNIT))
    unit = statistics.median(units)
    for label, runs in (("cold", cold), ("warm", warm)):
        seconds = statistics.median(runs)
        print(f"{name:8}{label:6}{seconds:10.2f}{seconds / unit:10.2f}", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--demo", action="store_true")
    options = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    compileall.compile_dir(PACKAGE, quiet=2)
    print(f"{'command':14}{'CPU [s]':>10}{'ratio':>10}")
    measure("plan", PLAN, options.repeat)
    measure("help", ["--help"], options.repeat)
    if options.demo:
        with tempfile.TemporaryDirectory() as out:
            measure("demo", ["demo", "--out", out], options.repeat)
    kept = subprocess.run(
        [sys.executable, "-c", REPLAN], capture_output=True, text=True, check=True
    )
    print(f"replan that keeps the rest: {1000 * float(kept.stdout):.1f} ms")


if __name__ == "__main__":
    main()
