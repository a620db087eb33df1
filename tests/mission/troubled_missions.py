"""Missions by chance in which something cannot be done, for trying remedies on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from corridors import at, charger, corridor

from energyplan.battery import Battery
from energyplan.mission import Mission, Remedy, Spreads, evaluate
from energyplan.power import HOTEL, PowerModel


class Trial(NamedTuple):
    """A remedy that was applied, and whether its task could then be done."""

    seed: int
    task: str
    remedy: Remedy
    holds: bool


def troubled(seed: int) -> Mission:
    """Return a mission along a corridor: a small real battery, everything uncertain, windows."""
    rng = np.random.default_rng(seed)
    model = PowerModel.preset("quadriga:empty:marble")
    if rng.random() < 0.5:
        model = model.with_term(HOTEL, float(rng.uniform(5, 40)))
    pack = Battery.preset(str(rng.choice(["quadriga", "jackal"])))
    pack = pack.larger(3600.0 * float(rng.uniform(25, 90)) - pack.full_energy)
    pack = replace(
        pack, health=float(rng.uniform(0.7, 1.0)), temperature=float(rng.uniform(-5, 30))
    )
    tasks = []
    for k in range(int(rng.integers(1, 5))):
        window = (0.0, np.inf)
        if rng.random() < 0.3:
            window = (0.0, float(rng.uniform(20, 1000)))
        tasks.append(
            at(
                f"t{k}", float(rng.uniform(4, 31)), prize=float(rng.integers(1, 5)),
                dwell=float(rng.choice([0.0, 200.0, 600.0])),
                power=float(rng.choice([0.0, 60.0, 150.0])),
                required=bool(rng.random() < 0.5), window=window,
            )
        )  # fmt: skip
    docks = (charger(float(rng.uniform(4, 31)), "dock"),) if rng.random() < 0.3 else ()
    return corridor(
        1e4, tuple(tasks), 15.0, soc=float(rng.uniform(0.5, 1.0)), confidence=0.9,
        reserve=float(rng.choice([0.0, 0.1, 0.2])), order=str(rng.choice(["given", "free"])),
        chargers=docks, speed=float(rng.choice([0.3, 0.6])) if rng.random() < 0.5 else None,
        model=model, battery=pack, coefficient_spread=0.05, spreads=Spreads(),
    )  # fmt: skip


def trials(seeds: Iterable[int]) -> Iterator[Trial]:
    """Apply each remedy of each task that cannot be done, and tell whether it then can."""
    for seed in seeds:
        asked = troubled(seed)
        for task in evaluate(asked).tasks:
            for remedy in task.remedies:
                again = evaluate(asked.with_remedy(remedy)).task(task.name)
                yield Trial(seed, task.name, remedy, again.verdict == "reachable")
