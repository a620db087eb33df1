"""Orders and charges on batteries by name: ``python benchmarks/charges.py [MISSIONS [STEPS]]``.

Both are numbers, 300 and 1000, or parts of what they stand for, as in ``170:300 900:1000``.
Missions are drawn by chance (see tests/mission/battery_missions.py). It is counted how often a
free order is worse than a given one, and how often a better charger, battery, charge or reserve
does fewer tasks.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "mission"))

from battery_missions import done, drawn, worse

from energyplan.battery import Battery
from energyplan.mission import Mission, Routes, evaluate

STEPS = ("power", "capacity", "charge", "reserve")


def better(mission: Mission, what: str, rng: np.random.Generator) -> Mission:
    """Return a mission with more of something that can only help."""
    more = float(rng.uniform(1.01, 1.5))
    if what == "power":
        (dock,) = mission.chargers
        assert isinstance(dock.power, float)
        return replace(mission, chargers=(replace(dock, power=more * dock.power),))
    if what == "capacity":
        assert isinstance(mission.battery, Battery)
        return replace(
            mission, battery=mission.battery.larger((more - 1) * mission.battery.full_energy)
        )
    if what == "charge":
        return replace(mission, soc=min(more * mission.soc, 1.0))
    return replace(mission, reserve=mission.reserve / more)


def part(text: str) -> range:
    """Return the numbers that an argument stands for."""
    first, _, last = text.rpartition(":")
    return range(int(first or 0), int(last))


def main(missions: str = "300", steps: str = "1000") -> None:
    """Count what should not be."""
    begun = time.process_time()
    found = list(worse(part(missions)))
    print(
        f"{len(part(missions))} missions: a given order is better than the free one in", len(found)
    )
    for one in found:
        print("  seed {}: {} tasks, {:.6g} J; given {} tasks, {:.6g} J".format(*one))
    routes, rng, lost = Routes(), np.random.default_rng(0), []
    for step in range(part(steps).stop):
        mission, what = drawn(step // len(STEPS)), STEPS[step % len(STEPS)]
        improved = better(mission, what, rng)
        if step not in part(steps):
            continue
        before, after = (done(evaluate(one, routes=routes)) for one in (mission, improved))
        if after < before:
            lost.append((step // len(STEPS), what, before, after))
    print(f"{len(part(steps))} steps: a task is lost in {len(lost)}", *lost, sep="\n  ")
    print(f"{time.process_time() - begun:.0f} s of CPU")


if __name__ == "__main__":
    main(*sys.argv[1:3])
