"""The cheapest motion that never drives backwards, against a linear program over its headings."""

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from energyplan import EnergyCost, TreadICR, steering

STEP = 2.0 * math.pi / 36


def sampled_optimum(start, goal, a: float, beta: float, half: float) -> float:
    """Least energy over schedules of headings that a grid holds.

    A schedule sweeps from one heading to the other, with an excursion beyond either end. While it
    turns by a step, the robot moves ahead by any part of half the slip track times that step. The
    program chooses these parts, and the lengths of straight lines at the headings on the way.
    """
    per_radian, best = a * half + beta, math.inf
    move = np.subtract(goal, start)[:2]
    for turns in (-1, 0, 1):
        net = (goal[2] - start[2]) % (2.0 * math.pi) + 2.0 * math.pi * turns
        low, high = min(0.0, net), max(0.0, net)
        for below, above in np.ndindex(36, 36):
            first, last = low - below * STEP, high + above * STEP
            turned = per_radian * (high - low + 2.0 * (below + above) * STEP)
            if turned >= best or last - first > 2.0 * math.pi + 1.0:
                continue
            headings, widths = [], []
            for begin, end, passes in ((first, low, 2), (low, high, 1), (high, last, 2)):
                pieces = math.ceil((end - begin) / STEP - 1e-9)
                edges = np.linspace(begin, end, pieces + 1)
                headings += list(0.5 * (edges[1:] + edges[:-1]))
                widths += list(passes * np.diff(edges))
            lines = np.linspace(first, last, max(int((last - first) / STEP) + 1, 2))
            every = start[2] + np.append(headings, lines)
            found = linprog(
                np.append(np.zeros(len(headings)), np.full(len(lines), a)),
                A_eq=np.vstack([np.cos(every), np.sin(every)]), b_eq=move,
                bounds=[(0, half * w) for w in widths] + [(0, None)] * len(lines),
            )  # fmt: skip
            if found.status == 0:
                best = min(best, turned + found.fun)
    return best


@pytest.mark.parametrize("seed", range(10))
def test_no_schedule_of_headings_forwards_is_cheaper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half, beta = 0.47, float(rng.choice([0.1, 0.5, 1.5]))
    cost = EnergyCost.from_coefficients(per_metre=1.0, per_radian=beta, icr=half)
    start = np.array([0.0, 0.0, rng.uniform(-3, 3)])
    goal = np.append(rng.choice([0.3, 1.0, 3.0]) * rng.normal(size=2), rng.uniform(-3, 3))
    least = float(steering.energy(start, goal, cost, reverse=False))
    # a piece of a sweep leads as far as its arc is long, which is a little too far
    assert least <= sampled_optimum(start, goal, 1.0, beta, half) * (1.0 + STEP**2 / 24)


@pytest.mark.parametrize("scale", [0.01, 0.3, 1.0, 10.0, 1e4])
def test_the_motion_arrives_forwards_for_the_energy_that_is_said(scale: float) -> None:
    rng = np.random.default_rng(4)
    icr = TreadICR(left=0.5, right=0.3, longitudinal=0.1)
    for beta in (0.0, 1.0, 300.0):
        cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=beta, icr=icr)
        for _ in range(60):
            start, goal = (np.append(scale * rng.normal(size=2), rng.uniform(-9, 9)) for _ in "ab")
            least = float(steering.energy(start, goal, cost, reverse=False))
            path = steering.path(start, goal, cost, reverse=False)
            miss = np.subtract(path.end, goal)
            miss[2] = math.remainder(miss[2], 2.0 * math.pi)
            assert np.abs(miss).max() < 1e-8 * max(scale, 1.0)
            assert (path.ds - icr.centre[1] * path.dtheta).min() > -1e-9
            assert cost.energy(path) == pytest.approx(least, rel=1e-8)
            assert least >= steering.energy(start, goal, cost) * (1.0 - 1e-9)


def test_what_leads_forwards_anyway_takes_no_more() -> None:
    cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
    goals = [(3, 0, 0), (0, 0, 1), (4, 3, 1.2)]
    with_it = steering.energy((0, 0, 0), goals, cost)
    assert steering.energy((0, 0, 0), goals, cost, reverse=False) == pytest.approx(with_it)
    # straight behind: two half turns
    assert float(steering.energy((0, 0, 0), (-1, 0, 0), cost, reverse=False)) > 600.0
