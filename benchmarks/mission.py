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
from energyplan.io.files import bundled
from energyplan.io.maps import read_map
from energyplan.mission import Mission, Task, evaluate
from energyplan.path import Pose
from energyplan.power import PowerModel

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


def drawn(count: int, name: str = "warehouse.yaml", seed: int = 0) -> Mission:
    """Return a mission of many tasks at free poses of a bundled map; the battery lasts for all."""
    grid = read_map(bundled(name))
    model = PowerModel.preset("quadriga:empty:concrete")
    rng = np.random.default_rng(seed)
    low, high = grid.corners.min(axis=0), grid.corners.max(axis=0)
    poses: list[Pose] = []
    while len(poses) < count + 1:
        pose = Pose(*map(float, rng.uniform((*low, -np.pi), (*high, np.pi))))
        if grid.footprint_free([pose], model.vehicle)[0]:
            poses.append(pose)
    tasks = tuple(Task(f"task {k}", pose, 60.0, 150.0) for k, pose in enumerate(poses[1:]))
    return Mission(
        model, grid, Battery.preset("quadriga").larger(count * 5e4), poses[0], tasks,
        order="free", coefficient_spread=0.05,
    )  # fmt: skip


def orders() -> None:
    """Find free orders of a few and of many tasks, routes included."""
    evaluate(drawn(3))  # compiles the kernels
    for count in (9, 32, 128):
        lines: list[str] = []
        begun = time.process_time()
        report = evaluate(drawn(count), progress=lines.append)
        spent = time.process_time() - begun
        routes = sum(line.startswith("planning") for line in lines)
        print(
            f"order: {count:3d} tasks, {count - len(report.left_out):3d} done, "
            f"{report.energy / 3600:5.1f} Wh, {routes:3d} routes planned, "
            f"gap {100 * report.gap:.1f} %  {spent:6.1f} s of CPU",
            flush=True,
        )


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["battery", "orders"]
    for name in chosen:
        {"battery": battery, "orders": orders}[name]()
