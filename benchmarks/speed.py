"""Speed profiles against a linear program, dynamic programming and toppra, side by side.

Run: ``python benchmarks/speed.py [paths]``. The references are those of ``tests/test_speed.py``;
the comparison with toppra is skipped where it is not installed.
"""

from __future__ import annotations

import importlib.util
import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path as FilePath

import numpy as np

from energyplan.limits.feasibility import check
from energyplan.limits.speed import profile
from energyplan.path import Path

REFERENCE = runpy.run_path(str(FilePath(__file__).parents[1] / "tests" / "test_speed.py"))
PAPER, LOSSY = REFERENCE["PAPER"], REFERENCE["LOSSY"]


def timed(work: Callable[[], object]) -> tuple[object, float]:
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


def against_toppra() -> None:
    """Least time along a smooth curve, the two treads as the joints of a robot."""
    if importlib.util.find_spec("toppra") is None:
        print("smooth curve: toppra is not installed, comparison skipped")
        return
    import toppra
    from toppra import algorithm, constraint

    icr, motor = PAPER.vehicle.icr, PAPER.vehicle.motor
    print("least time along a smooth curve, against toppra (1001 grid points)")
    for step in (0.1, 0.05, 0.025):
        path = Path.from_poses(REFERENCE["wave"](step))
        treads = np.column_stack(
            [path.ds - icr.left * path.dtheta, path.ds + icr.right * path.dtheta]
        )
        along = np.append(0.0, np.cumsum(np.abs(treads).max(axis=1)))
        joints = toppra.SplineInterpolator(
            along, np.vstack([np.zeros((1, 2)), np.cumsum(treads, axis=0)])
        )
        limits = [
            constraint.JointVelocityConstraint(np.array([[-motor.speed, motor.speed]] * 2)),
            constraint.JointAccelerationConstraint(
                np.array([[-motor.acceleration, motor.acceleration]] * 2)
            ),
        ]

        def optimum(joints: object = joints, limits: object = limits, end: float = along[-1]):
            solver = algorithm.TOPPRA(
                limits,
                joints,
                gridpoints=np.linspace(0, end, 1001),
                parametrizer="ParametrizeConstAccel",
            )
            return solver.compute_trajectory(0, 0)

        best, longer = timed(optimum)
        found, span = timed(lambda p=path: profile(p, PAPER, smooth=0.2))
        print(
            f"  arcs of {step:5.3f} m: {found.duration:.3f} s against {best.duration:.3f} s "
            f"({found.duration / best.duration - 1:+.2%}), {span * 1e3:.1f} ms against "
            f"{longer * 1e3:.1f} ms"
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
    against_linear_program(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
    against_dynamic_program()
    against_toppra()
    long_path()
