"""Time and memory of a plan on large maps, beside SciPy's Dijkstra on the same places.

``python benchmarks/large.py`` plans from corner to corner of a town of blocks in cells of 0.1 m,
with the default effort, and measures each map in a process of its own: CPU time from the map in
memory to the plan, and the most memory that the process had. Dijkstra's algorithm runs from the
goal over 8 neighbours of the places that the planner uses, where the robot's inscribed disc is
free; it knows no headings. ``--write PAGE.md`` writes the table into a page.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from math import hypot, pi
from pathlib import Path

import numpy as np
from pages import write
from scipy import sparse
from scipy.sparse import csgraph

import energyplan as ep
from energyplan.errors import PlanningError

CELL = 0.1  # [m]
MIB = 1024.0  # `ru_maxrss` is in KiB


def town(cells: int) -> np.ndarray:
    """Return a square town: blocks of 4 to 9.5 m, one in each square of 12.5 m."""
    rng = np.random.default_rng(0)
    blocked = np.zeros((cells, cells), bool)
    for row in range(20, cells - 120, 125):
        for column in range(20, cells - 120, 125):
            high, wide = rng.integers(40, 95, 2)
            y, x = row + rng.integers(0, 100 - high), column + rng.integers(0, 100 - wide)
            blocked[y : y + high, x : x + wide] = True
    return blocked


def problem(cells: int) -> ep.PlanningProblem:
    """Return the problem from corner to corner."""
    cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
    side = CELL * cells
    grid = ep.OccupancyGrid(town(cells), CELL)
    return ep.PlanningProblem(grid, cost, (1.0, 1.0, 0.0), (side - 1.3, side - 1.3, 0.5 * pi))


def used(begun: float) -> str:
    """Return the CPU time since [s] and the most memory so far [MiB]."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    return f"{time.process_time() - begun:.1f} {most:.0f}"


def planned(cells: int) -> str:
    """Plan once on a small map, for what is compiled, then measure."""
    ep.plan(problem(300))
    asked = problem(cells)
    begun = time.process_time()
    try:
        plan = ep.plan(asked)
    except PlanningError as error:
        raise SystemExit(str(error)) from None
    gap = 100.0 * (plan.cost_steady / plan.lower_bound_steady - 1.0)
    return f"{used(begun)} {plan.length:.0f} {gap:.1f} {plan.effort}"


def shortest(cells: int) -> str:
    """Measure Dijkstra's algorithm over places of two cells by two."""
    asked = problem(cells)
    begun = time.process_time()
    radius = float(np.abs(asked.robot.footprint).min()) / CELL
    free = asked.terrain.obstacles.space.clearance[::2, ::2] > radius
    number = np.full(free.shape, -1, np.int32)
    number[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
    rows, columns, lengths = [], [], []
    for up, along in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = number[: len(number) - up, max(-along, 0) : number.shape[1] - max(along, 0)]
        there = number[up:, max(along, 0) : number.shape[1] - max(-along, 0)]
        both = (here >= 0) & (there >= 0)
        rows.append(here[both])
        columns.append(there[both])
        lengths.append(np.full(len(rows[-1]), 2.0 * CELL * hypot(up, along), np.float32))
    graph = sparse.csr_array(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))),
        shape=(int(number.max()) + 1,) * 2,
    )
    goal, start = (number[int(y / (2 * CELL)), int(x / (2 * CELL))]
                   for x, y in (asked.goal[:2], asked.start[:2]))  # fmt: skip
    away = csgraph.dijkstra(graph, directed=False, indices=int(goal))
    return f"{used(begun)} {float(away[start]):.0f}"


def main() -> None:
    """Measure each size in processes of its own, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 4000, 8000])
    parser.add_argument("--one", choices=("planned", "shortest"), help="measure here, once")
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    given = parser.parse_args()
    if given.one:
        print({"planned": planned, "shortest": shortest}[given.one](given.cells[0]))
        return
    lines = [
        "| cells | route | effort | gap | CPU time, plan | memory | CPU time, Dijkstra | memory |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for cells in given.cells:
        ours, theirs = (
            subprocess.run(
                [sys.executable, __file__, "--one", name, "--cells", str(cells)],
                capture_output=True, text=True, check=True,
            ).stdout.split()
            for name in ("planned", "shortest")
        )  # fmt: skip
        lines.append(
            f"| {cells} x {cells} | {ours[2]} m | {ours[4]} | {ours[3]} % | {ours[0]} s "
            f"| {ours[1]} MiB | {theirs[0]} s | {theirs[1]} MiB |"
        )
        print(lines[-1], flush=True)
    if given.write:
        write(given.write, "large maps", "\n".join(lines))


if __name__ == "__main__":
    main()
