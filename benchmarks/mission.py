"""Battery and free orders: ``python benchmarks/mission.py``.

Every row is measured in this run; ratios stand beside what they compare.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from energyplan.battery import Battery
from energyplan.battery._kernel import discharge
from energyplan.mission import Mission, Task, evaluate
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

DAY = 86_400


def battery() -> None:
    """Run a month at 1 Hz, and the compiled kernel against its plain twin on an hour."""
    pack = Battery.preset("quadriga")
    rng = np.random.default_rng(0)
    t = np.arange(30 * DAY, dtype=float)
    power = np.where(t % DAY < 8 * 3600, rng.normal(40, 40, len(t)), -60.0)
    pack.simulate(t[:10], power[:10])
    begun = time.perf_counter()
    run = pack.simulate(t, power)
    month = time.perf_counter() - begun
    print(f"battery: {len(t) / 1e6:.2f} million samples (a month at 1 Hz)  {month:6.2f} s")
    arguments = (pack.soc_points, pack.ocv_points, pack.circuit(), np.empty((5, 3600)))
    times = []
    compiled: Any = discharge
    for kernel in (compiled, compiled.py_func):
        begun = time.perf_counter()
        kernel(t[:3600], power[:3600], 1.0, 0.0, *arguments)
        times.append(time.perf_counter() - begun)
    print(
        f"battery: compiled kernel over plain twin, an hour           {times[1] / times[0]:6.0f} x"
    )
    print(f"         state of charge between {run.soc.min():.2f} and {run.soc.max():.2f}")


def warehouse(count: int, seed: int = 0) -> Mission:
    """Return a mission of many tasks in a hall with racks."""
    blocked = np.zeros((300, 400), bool)
    for column in range(40, 360, 40):
        blocked[40:260, column : column + 8] = True
    grid = OccupancyGrid(blocked, 0.1)
    model = PowerModel.preset("quadriga:empty:concrete")
    rng = np.random.default_rng(seed)
    tasks: list[Task] = []
    while len(tasks) < count:
        pose = Pose(*map(float, rng.uniform((1, 1, -np.pi), (39, 29, np.pi))))
        if grid.footprint_free([pose], model.vehicle)[0]:
            prize = float(rng.integers(1, 5))
            tasks.append(Task(f"task {len(tasks)}", pose, 60.0, 150.0, prize=prize, required=False))
    return Mission(
        model, grid, Battery.preset("quadriga"), Pose(1.0, 1.0, 0.0), tuple(tasks),
        soc=0.5, order="free", coefficient_spread=0.05, planning_time=0.1,
    )  # fmt: skip


def orders() -> None:
    """Find free orders of a few and of many tasks, routes included."""
    for count in (6, 9, 60):
        mission = warehouse(count)
        lines: list[str] = []
        begun = time.perf_counter()
        report = evaluate(mission, progress=lines.append)
        spent = time.perf_counter() - begun
        routes = sum(line.startswith("planning") for line in lines)
        done = sum(task.verdict == "reachable" for task in report.tasks)
        print(
            f"order: {count:3d} tasks, {done:2d} done, {report.energy / 3600:5.1f} Wh, "
            f"{routes:3d} routes planned, "
            f"{'proven' if report.proven else 'searched'}  {spent:6.1f} s"
        )


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["battery", "orders"]
    for name in chosen:
        {"battery": battery, "orders": orders}[name]()
