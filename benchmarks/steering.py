"""Steering: time per pose pair, and joules, beside OMPL's Reeds-Shepp; accuracy on many pairs.

python benchmarks/steering.py                        # about half a minute
python benchmarks/steering.py --accuracy 10000       # two algorithms on as many pose pairs
python benchmarks/steering.py --program 100          # against a linear program, 0.5 s a pair
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
from ompl import base

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.cost.steering import polygon_steering
from energyplan.power import HOTEL, PowerModel
from energyplan.steering.polygon import polygon_energies

SAMPLES = 100  # poses along a Reeds-Shepp path, from which its turning is added up


def pairs(n: int, reach: tuple[float, float], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Random pose pairs at log-uniform distances."""
    rng = np.random.default_rng(seed)
    r, bearing = np.exp(rng.uniform(*np.log(reach), n)), rng.uniform(-np.pi, np.pi, n)
    starts = np.column_stack([np.zeros((n, 2)), rng.uniform(-np.pi, np.pi, n)])
    goals = np.column_stack(
        [r * np.cos(bearing), r * np.sin(bearing), rng.uniform(-np.pi, np.pi, n)]
    )
    return starts, goals


def seconds(work: Callable[[], object], repeat: int = 3) -> float:
    """Least time of a few runs."""
    best = np.inf
    for _ in range(repeat):
        begun = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begun)
    return best


def reeds_shepp(starts: np.ndarray, goals: np.ndarray, radius: float) -> list[tuple[Any, Any, Any]]:
    """States of OMPL's Reeds-Shepp space."""
    space = base.ReedsSheppStateSpace(radius)
    states = []
    for rows in (starts, goals):
        column = []
        for x, y, yaw in rows:
            state = space.allocState()
            state.setX(float(x))
            state.setY(float(y))
            state.setYaw(float(yaw))
            column.append(state)
        states.append(column)
    return [(space, *pair) for pair in zip(*states, strict=True)]


def reeds_shepp_energy(space: Any, start: Any, goal: Any, cost: EnergyCost) -> float:
    """Joules of the shortest Reeds-Shepp word, driven as it is: its length and its turning."""
    state = space.allocState()
    yaws = []
    for k in range(SAMPLES + 1):
        space.interpolate(start, goal, k / SAMPLES, state)
        yaws.append(state.getYaw())
    turning = np.abs((np.diff(yaws) + np.pi) % (2 * np.pi) - np.pi).sum()
    bound = cost.lower_bound()
    return bound.per_metre * space.distance(start, goal) + bound.per_radian * turning


def speed(n: int) -> None:
    """Print the time per pose pair."""
    model = PowerModel.preset("quadriga:empty:concrete")
    static = EnergyCost(model)
    hotel = EnergyCost(model.with_term(HOTEL, 60.0))
    starts, goals = pairs(n, (0.1, 50.0))
    steering.energy(starts[:2], goals[:2], static)
    steering.energy(starts[:2], goals[:2], hotel)
    steering.path(starts[0], goals[0], static)
    few = n // 100
    rows = [
        ("steering.energy, a batch", seconds(lambda: steering.energy(starts, goals, static)) / n)
    ]
    single = range(2000)
    rows.append(
        (
            "steering.energy, one call",
            seconds(lambda: [steering.energy(starts[i], goals[i], static) for i in single]) / 2000,
        )
    )
    rows.append(
        (
            "steering.path, one call",
            seconds(lambda: [steering.path(starts[i], goals[i], static) for i in single]) / 2000,
        )
    )
    rows.append(
        (
            "steering.energy with hotel load, a batch",
            seconds(lambda: steering.energy(starts[:few], goals[:few], hotel), 1) / few,
        )
    )
    states = reeds_shepp(starts[:2000], goals[:2000], static.half_track)
    rows.append(
        (
            "OMPL ReedsSheppStateSpace.distance, one call",
            seconds(lambda: [space.distance(a, b) for space, a, b in states]) / 2000,
        )
    )
    reference = rows[-1][1]
    print(f"{n} pose pairs, 0.1 m to 50 m apart\n")
    print(f"{'':46}{'us/pair':>9}{'ratio':>8}")
    for name, value in rows:
        print(f"{name:46}{1e6 * value:9.2f}{value / reference:8.2f}")


def joules() -> None:
    """Print what the shortest Reeds-Shepp word costs more than the minimum."""
    cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    C = cost.half_track
    print(f"\nenergy of the shortest Reeds-Shepp word (radius C = {C} m) over the minimum\n")
    print(f"{'distance / C':>14}{'mean':>9}{'worst':>9}")
    for ratio in (0.3, 1.0, 3.0, 10.0, 30.0):
        starts, goals = pairs(200, (ratio * C * 0.999, ratio * C * 1.001), seed=int(10 * ratio))
        least = steering.energy(starts, goals, cost)
        words = np.array(
            [reeds_shepp_energy(*state, cost) for state in reeds_shepp(starts, goals, C)]
        )
        excess = words / least - 1
        print(f"{ratio:14.1f}{excess.mean():9.1%}{excess.max():9.1%}")


def accuracy(n: int) -> None:
    """Print how far the closed form is from the search over dual vectors."""
    worst, below, off, each = 0.0, 0.0, 0, max(n // 5, 1)
    for c in (0.2, 0.5, 1.0, 2.0, 4.0):
        cost = EnergyCost.from_coefficients(per_metre=1.0, per_radian=c, icr=1.0)
        starts, goals = pairs(each, (0.05, 100.0), seed=int(100 * c))
        words = steering.energy(starts, goals, cost)
        dual = np.empty(each)
        corners = polygon_steering(cost.gauge, cost.gauge.corners(), cost.icr)
        polygon_energies(starts, goals, corners, dual)
        ratio = words / dual - 1
        worst, below = max(worst, ratio.max()), min(below, ratio.min())
        off += int(np.sum(np.abs(ratio) > 1e-6))
    print(f"\n{5 * each} pairs, c 0.2 to 4, 0.05 C to 100 C: closed form over the dual search")
    print(f"largest excess {worst:.1e}, largest deficit {-below:.1e}, {off} differ by over 1e-6")


def program(n: int) -> None:
    """Print how far the closed form is from a linear program over discretised headings."""
    sys.path.insert(0, str(File(__file__).resolve().parents[1] / "tests"))
    from steering_optimum import Corners, optimum

    rng = np.random.default_rng(5)
    ratios = []
    for _ in range(n):
        c = np.exp(rng.uniform(*np.log((0.2, 4.0))))
        r, (bearing, turn) = (
            np.exp(rng.uniform(*np.log((0.05, 100)))),
            rng.uniform(-np.pi, np.pi, 2),
        )
        d = r * np.array([np.cos(bearing), np.sin(bearing)])
        corners = ((-1.0, 1.0 + c), (1.0, 1.0 + c))
        cost = EnergyCost.from_coefficients(per_metre=1.0, per_radian=c, icr=1.0)
        found = float(steering.energy((0, 0, 0), (*d, turn), cost))
        ratios.append(found / optimum(d, turn, Corners(corners, corners, 1.0, 1.0)) - 1)
    print(f"\n{n} pairs: closed form over the linear program (which is itself from above)")
    print(f"largest excess {max(ratios):.1e}, largest deficit {-min(ratios):.1e}")


def main() -> None:
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=200_000)
    parser.add_argument("--accuracy", type=int, default=2000, metavar="PAIRS")
    parser.add_argument("--program", type=int, default=10, metavar="PAIRS")
    options = parser.parse_args()
    speed(options.pairs)
    joules()
    accuracy(options.accuracy)
    program(options.program)


if __name__ == "__main__":
    main()
