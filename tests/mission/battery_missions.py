"""Missions by chance on batteries by name: chargers weak and strong, deadlines, power limits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np
from corridors import at, corridor

from energyplan.battery import Battery
from energyplan.mission import Charger, Mission, MissionReport, evaluate
from energyplan.mission.routes import Routes
from energyplan.path import Pose

PACKS = (
    "24 V 20 Ah lead-acid",
    "25.6 V 20 Ah LiFePO4",
    "24 V 15 Ah lead-acid",
    "7S6P 2.5 Ah li-ion",
)


def drawn(seed: int) -> Mission:
    """Return a mission of two or three tasks along a corridor with a charger, in any order."""
    rng = np.random.default_rng(seed)
    pack = Battery.of(str(rng.choice(PACKS)))
    hard = 0.9 * pack.max_discharge_current * float(pack.ocv(0.3))  # a power near the pack's limit
    count = int(rng.integers(2, 4))
    heavy = int(rng.integers(0, 3 * count))  # a third of the missions have a task near it
    tasks = []
    for k in range(count):
        near = k == heavy
        last = float(rng.uniform(1500, 9000)) if rng.random() < 0.5 else np.inf
        tasks.append(
            at(
                f"t{k}", float(rng.choice([6, 12, 20, 28])), window=(0.0, last),
                dwell=float(rng.choice([20.0, 60.0])) if near else float(rng.uniform(300, 2400)),
                power=hard * float(rng.uniform(0.85, 1.2)) if near else float(rng.uniform(50, 250)),
            )
        )  # fmt: skip
    dock = Charger(
        "dock", Pose(float(rng.choice([3, 16, 30])), 1.5, 0.0),
        float(rng.choice([80, 150, 300, 600])),
        until=float(rng.choice([0.8, 0.95])),
    )  # fmt: skip
    return corridor(
        1.0, tuple(tasks), 3.0, battery=pack, soc=float(rng.uniform(0.4, 0.9)), order="free",
        reserve=float(rng.choice([0.1, 0.2])), chargers=(dock,),
        confidence=float(rng.choice([0.5, 0.9])), coefficient_spread=0.05,
    )  # fmt: skip


def done(report: MissionReport) -> int:
    """Return how many tasks are done."""
    return len(report.tasks) - len(report.left_out)


def worse(seeds: Iterable[int]) -> Iterator[tuple[int, int, float, int, float]]:
    """Yield the missions whose free order is worse than a given one: tasks done and energies."""
    routes = Routes()
    for seed in seeds:
        free = drawn(seed)
        found = evaluate(free, routes=routes)
        mine = done(found)
        for tasks in permutations(free.tasks):
            given = evaluate(replace(free, tasks=tasks, order="given"), routes=routes)
            better = done(given) > mine or (
                done(given) == mine and given.energy < found.energy * (1 - 1e-5) - 1e-6
            )
            if better:
                yield seed, mine, found.energy, done(given), given.energy
                break
