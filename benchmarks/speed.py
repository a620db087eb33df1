"""Speed profiles against a linear program, dynamic programming and toppra, side by side.

Run: ``python benchmarks/speed.py [paths]``. The references are those of ``tests/limits``; the
comparison with toppra is skipped where it is not installed.
"""

from __future__ import annotations

import importlib.util
import logging
import runpy
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from typing import TypeVar

import numpy as np

from energyplan.limits.feasibility import check
from energyplan.limits.speed import profile
from energyplan.path import Path
from energyplan.vehicle import MotorLimits

TESTS = FilePath(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))
REFERENCE = runpy.run_path(str(TESTS / "limits" / "test_speed.py"))
THERMAL = runpy.run_path(str(TESTS / "limits" / "test_thermal.py"))
CHAIN = runpy.run_path(str(TESTS / "limits" / "test_chain.py"))
PAPER, LOSSY = REFERENCE["PAPER"], REFERENCE["LOSSY"]


Result = TypeVar("Result")


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """Return the result and the time of a call [s]."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def against_linear_program(count: int) -> None:
    """Least time on random paths."""
    rng = np.random.default_rng(0)
    excess, ours, theirs, feasible = [], 0.0, 0.0, 0
    profile(REFERENCE["random_path"](rng), PAPER)
    for _ in range(count):
        path = REFERENCE["random_path"](rng)
        lateral = float(rng.uniform(0.05, 0.6))
        found, span = timed(lambda p=path, a=lateral: profile(p, PAPER, lateral_acceleration=a))
        # The program knows kinematic limits only; at these speeds the motors have power to spare.
        vehicle = REFERENCE["with_motor"]()
        bound, longer = timed(
            lambda p=path, a=lateral, v=vehicle: REFERENCE["shortest_time_lp"](p, v, a)
        )
        ours, theirs = ours + span, theirs + longer
        excess.append(found.duration / bound - 1)
        feasible += check(found, PAPER, lateral_acceleration=lateral).feasible
    print(f"least time, {count} random paths, linear program with 150 cells per segment")
    print(f"  duration over the program's, minus 1: {min(excess):.1e} to {max(excess):.1e}")
    print(f"  feasible: {feasible} of {count}")
    print(f"  time per path: {ours / count * 1e3:.1f} ms against {theirs / count * 1e3:.1f} ms,")
    print(f"  ratio {theirs / ours:.0f}")


def against_dynamic_program() -> None:
    """Least energy on single arcs, with hotel load, viscous loss, inertia and lossy drives."""
    print("least energy on one arc, dynamic program with 100 cells and 400 speeds")
    print("  ds [m]  dtheta [rad]  energy [J]  over the program's, minus 1   ms against ms")
    for ds, dtheta in ((0.5, 0.0), (2.0, 0.0), (6.0, 0.0), (0.0, 2.0), (2.0, 1.0), (-1.0, 0.8)):
        path = Path(REFERENCE["START"], [ds], [dtheta])
        found, span = timed(lambda p=path: profile(p, LOSSY, objective="energy", period=0.005))
        energy = check(found, LOSSY).energy
        bound, longer = timed(lambda a=ds, b=dtheta: REFERENCE["least_cost_dp"](LOSSY, a, b))
        print(
            f"  {ds:6.1f}  {dtheta:12.1f}  {energy:10.2f}  {energy / bound - 1:27.1e}   "
            f"{span * 1e3:5.1f} {longer * 1e3:7.1f}"
        )


def against_toppra(count: int) -> None:
    """Least time along smooth curves in 5 cm arcs, the two treads as the joints of a robot."""
    if importlib.util.find_spec("toppra") is None:
        print("smooth curves: toppra is not installed, comparison skipped")
        return
    logging.disable(logging.WARNING)
    motor = MotorLimits(speed=1.2, acceleration=1.0)
    vehicle = replace(PAPER.vehicle, motor=motor)
    rng = np.random.default_rng(0)
    excess, spans, feasible = [], [], 0
    for _ in range(count):
        path = CHAIN["smooth_curve"](rng)
        found, span = timed(lambda p=path: profile(p, PAPER, vehicle=vehicle, smooth=0.5))
        least = CHAIN["toppra_duration_along"](found, vehicle.icr, motor.speed, motor.acceleration)
        excess.append(found.duration / least - 1)
        spans.append(span)
        feasible += check(found, PAPER, vehicle).feasible
    print(f"least time along {count} smooth curves in 5 cm arcs, toppra on the driven curve")
    print(
        f"  duration over toppra's, minus 1: median {np.median(excess):+.2%}, "
        f"{min(excess):+.2%} to {max(excess):+.2%}; feasible: {feasible} of {count}; "
        f"{1e3 * np.median(spans):.1f} ms each"
    )


def within_the_thermal_limit(count: int) -> None:
    """Least time within the continuous power, on paths with stops and on smooth curves."""
    print("least time within the continuous power, linear program without accelerations")
    for name, smooth in (("paths with stops", 0.0), ("smooth curves", 0.5)):
        rng = np.random.default_rng(3)
        excess, spans, feasible, warm = [], [], 0, 0
        for _ in range(count):
            path, vehicle = THERMAL["warm_path"](rng, smooth > 0), THERMAL["warm_vehicle"](rng)
            least = THERMAL["shortest_time"](path, vehicle, smooth)
            start = time.process_time()
            found = profile(path, PAPER, vehicle=vehicle, smooth=smooth)
            spans.append(time.process_time() - start)
            excess.append(found.duration / least - 1)
            feasible += check(found, PAPER, vehicle).feasible
            motor = replace(vehicle.motor, continuous_power=vehicle.motor.peak_power)
            free = profile(path, PAPER, vehicle=replace(vehicle, motor=motor), smooth=smooth)
            warm += found.duration > free.duration * 1.001
        over = np.count_nonzero(np.array(excess) > 0.03)
        print(
            f"  {count} {name}, {warm} of them slowed down: duration over the program's, minus 1: "
            f"median {np.median(excess):+.2%}, {min(excess):+.2%} to {max(excess):+.2%}, "
            f"{over} above 3 %; feasible: {feasible} of {count}; "
            f"CPU {np.median(spans):.2f} s each, {max(spans):.2f} s at most"
        )


def long_path() -> None:
    """Time of one profile over the number of segments."""
    rng = np.random.default_rng(1)
    print("time of one profile [ms]")
    print("  segments  least time  least energy  duration")
    for count in (10, 100, 1000):
        path = REFERENCE["random_path"](rng, count)
        fastest, a = timed(lambda p=path: profile(p, LOSSY))
        _, b = timed(lambda p=path: profile(p, LOSSY, objective="energy"))
        _, c = timed(lambda p=path, t=fastest.duration: profile(p, LOSSY, duration=1.3 * t))
        print(f"  {count:8d}  {a * 1e3:10.0f}  {b * 1e3:12.0f}  {c * 1e3:8.0f}")


if __name__ == "__main__":
    paths = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    against_linear_program(paths)
    against_dynamic_program()
    against_toppra(paths)
    within_the_thermal_limit(paths)
    long_path()
