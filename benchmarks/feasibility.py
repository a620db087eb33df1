"""Samples per second of processor time that `check` tests against all limits.

Run: ``python benchmarks/feasibility.py [samples]``
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from energyplan.limits.feasibility import check, feasible_region
from energyplan.motion import Motion
from energyplan.path import Trajectory
from energyplan.power import PowerModel
from energyplan.power.effects import term


def winding(count: int, level: float) -> Trajectory:
    """Drive sampled at 100 Hz whose speed reaches `level` [m/s]."""
    t = np.arange(count) * 0.01
    v = level * (0.6 + 0.4 * np.sin(0.05 * t))
    omega = 0.5 * np.sin(0.021 * t)
    yaw = np.cumsum(omega) * 0.01
    x, y = np.cumsum(v * np.cos(yaw)) * 0.01, np.cumsum(v * np.sin(yaw)) * 0.01
    return Trajectory(t, x, y, yaw, v, omega)


def best_of(work: Callable[[], object], repeats: int = 3) -> float:
    """Least processor time of a few runs, after one that compiles [s]."""
    work()
    spans = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        spans.append(time.process_time() - start)
    return min(spans)


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2_000_000
    paper = PowerModel.preset("quadriga:empty:concrete")
    inertia = paper.with_term(term("linear_inertia"), 83.0)
    inertia = inertia.with_term(term("angular_inertia"), 7.5)
    hotel = inertia.with_term(term("hotel_load"), 30.0)
    calm, wild = winding(count, 0.7), winding(count, 1.1)
    few = replace(paper.vehicle, motor=replace(paper.vehicle.motor, continuous_power=np.inf))
    icr = paper.vehicle.icr
    motion = Motion.from_twist(calm.v, calm.omega, icr)
    rows: list[tuple[str, Callable[[], object]]] = [
        ("check, paper's terms, every limit", lambda: check(calm, paper)),
        ("check, the same with violations", lambda: check(wild, paper)),
        ("check, without the thermal window", lambda: check(calm, paper, few)),
        ("check, with inertia", lambda: check(calm, inertia)),
        ("check, with inertia and hotel load", lambda: check(calm, hotel)),
        ("max_speed_scale, closed form", lambda: check(calm, paper).max_speed_scale),
        ("max_speed_scale, searched", lambda: check(calm, inertia).max_speed_scale),
        ("model's shaft power alone, unblocked", lambda: paper.sides(motion)),
    ]
    print(f"{count:,} samples, {len(check(wild, paper).violations):,} violations in the wild drive")
    print(f"{'':38s}{'ns/sample':>10s}{'million/s':>11s}{'ratio':>8s}")
    first = 0.0
    for name, work in rows:
        span = best_of(work) / count
        first = first or span
        print(f"{name:38s}{span * 1e9:10.1f}{1e-6 / span:11.1f}{span / first:8.2f}")
    grid = np.linspace(-4, 4, 201), np.linspace(0, 1.2, 121)
    span = best_of(lambda: feasible_region(paper, *grid))
    print(f"feasible_region, 201 x 121: {span * 1e3:.1f} ms")


if __name__ == "__main__":
    main()
