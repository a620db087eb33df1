"""Rows of a field in the order of least energy: against row after row, and its processor time.

    python benchmarks/rows.py [ROWS...] [--effort UNITS] [--seed SEED] [--trees | --map MAP]

Rows are parallel, 2 m apart, and differ in length and place; each may be driven either way. With
trees a line of them stands between each two rows, so that the robot turns beyond its ends. On a map
they are lines of 2 to 6 m by chance, along its walls, wherever the robot is free.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from energyplan.battery import Battery
from energyplan.io.files import bundled
from energyplan.io.maps import read_map
from energyplan.mission import Mission, Spreads, Task, evaluate
from energyplan.mission.routes import Routes
from energyplan.mission.types import blocked
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid


def field(rows: int, seed: int, effort: int, trees: bool = False) -> Mission:
    """Return a field of rows and a robot at its corner."""
    rng = np.random.default_rng(seed)
    model = replace(PowerModel.preset("quadriga:empty:marble"), covariance=None, residual=None)
    begin, end = rng.uniform(5.0, 10.0, rows), rng.uniform(24.0, 34.0, rows)
    tasks = tuple(
        Task(f"row {k + 1}", path=[(begin[k], 4.0 + 2.0 * k), (end[k], 4.0 + 2.0 * k)], power=80.0)
        for k in range(rows)
    )
    occupied = np.zeros((10 * rows + 40, 200), bool)
    if trees:
        occupied[25 : 15 + 10 * rows : 10, 50:120:5] = True
    grid = OccupancyGrid(occupied, 0.2)
    return Mission(
        model, grid, Battery.preset("quadriga"), (2.0, 2.0, 0.0), tasks, order="free",
        return_to="start", confidence=0.5, spreads=Spreads.none(), planning_effort=effort,
    )  # fmt: skip


def on_map(rows: int, seed: int, effort: int, name: str) -> Mission:
    """Return rows on a map, half of them across the others."""
    rng, grid = np.random.default_rng(seed), read_map(bundled(name))
    whole = field(1, seed, effort)
    low, high = grid.corners.min(axis=0), grid.corners.max(axis=0)
    tasks: list[Task] = []
    while len(tasks) < rows:
        begin, length = rng.uniform(low, high), float(rng.uniform(2.0, 6.0))
        end = begin + length * np.array([(1.0, 0.0), (0.0, 1.0)][len(tasks) % 2])
        row = Task(f"row {len(tasks) + 1}", path=[tuple(begin), tuple(end)], power=80.0)
        path = row.options[0].path(whole.vehicle.icr.longitudinal)
        if grid.inside(end) and not blocked(grid, whole.vehicle, path):
            tasks.append(row)
    return replace(whole, map=grid, tasks=tuple(tasks))


def main(counts: list[int], seed: int, effort: int, trees: bool, name: str | None) -> None:
    """Print a line for each number of rows."""
    evaluate(field(3, seed, effort))  # compiles the kernels
    for count in counts:
        asked = on_map(count, seed, effort, name) if name else field(count, seed, effort, trees)
        routes = Routes()
        begun = time.process_time()
        found = evaluate(asked, routes=routes)
        spent = time.process_time() - begun
        given = evaluate(replace(asked, order="given"), routes=routes)
        drives = [sum(leg.energy for leg in one.legs if leg.start != leg.goal)
                  for one in (found, given)]  # fmt: skip
        print(
            f"{count} rows: {found.energy / 3600:.2f} Wh, between rows {drives[0] / 3600:.2f} Wh; "
            f"row after row {given.energy / 3600:.2f} and {drives[1] / 3600:.2f} Wh; "
            f"gap {100 * found.gap:.1f} %; {spent:.1f} CPU s, {len(routes)} routes",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", type=int, default=[8, 24, 60])
    parser.add_argument("--effort", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trees", action="store_true")
    parser.add_argument("--map", help="a bundled map, such as warehouse.yaml")
    given = parser.parse_args()
    main(given.rows, given.seed, given.effort, given.trees, given.map)
