"""Random fleets at few chargers: ``python benchmarks/clock.py OUT.jsonl [COUNT [OTHER.jsonl]]``.

Each line of the output is what one fleet does: the prize of its tasks, its energy, its time. With
the lines of another version it is said how many fleets do less, as much, or more. All fleets share
a hall and its places, so that each route is planned once.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from energyplan.battery import Battery
from energyplan.mission import Charger, Mission, Robot, Routes, Task, evaluate
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

HALL = OccupancyGrid(np.zeros((48, 96), bool), 0.25)
MODEL = PowerModel.preset("quadriga:empty:marble")
PLACES = [Pose(2.0 + 4.0 * k, 2.0 + 4.0 * row, 0.0) for k in range(6) for row in range(3)]
PACKS = ("24 V 5 Ah lead-acid", "25.6 V 6 Ah LiFePO4", "7S2P 3 Ah li-ion")


def fleet(seed: int) -> Mission:
    """Return three or four robots with tasks that their charge does not suffice for."""
    rng = np.random.default_rng(seed)
    poses = [PLACES[k] for k in rng.permutation(len(PLACES))]
    count = int(rng.integers(3, 5))
    robots = tuple(
        Robot(f"r{k}", changes={"start": poses.pop(), "soc": float(rng.uniform(0.25, 0.5))})
        for k in range(count)
    )
    docks = tuple(
        Charger(f"c{k}", poses.pop(), float(rng.choice([60.0, 150.0, 600.0])),
                places=1 + int(rng.random() < 0.3))
        for k in range(1 + int(rng.random() < 0.2))
    )  # fmt: skip
    tasks = []
    for k in range(int(rng.integers(5, 9))):
        window = (0.0, float(rng.uniform(1500, 12000))) if rng.random() < 0.3 else (0.0, np.inf)
        tasks.append(
            Task(f"t{k}", poses.pop(), float(rng.uniform(600, 1800)), float(rng.uniform(40, 110)),
                 window=window, required=False, prize=float(rng.integers(1, 4)))
        )  # fmt: skip
    return Mission(
        MODEL, HALL, Battery.of(PACKS[seed % len(PACKS)]), robots[0].changes["start"],
        tuple(tasks), docks, order="free", reserve=0.2, planning_effort=60, robots=robots,
        coefficient_spread=0.05,
        return_to="any",
    )  # fmt: skip


def main(out: str, number: int = 340, other: str = "") -> None:
    """Evaluate fleets, write what comes of each, and compare with another version's."""
    routes, begun, lines = Routes(), time.process_time(), []
    with Path(out).open("w") as file:
        for seed in range(number):
            report = evaluate(fleet(seed), routes=routes)
            done = [task for task in report.tasks if task.verdict == "reachable"]
            prizes = {task.name: task.prize for task in report.mission.tasks}
            lines.append(
                {"seed": seed, "prize": sum(prizes[task.name] for task in done),
                 "energy": report.energy, "duration": report.duration,
                 "feasible": report.feasible, "waiting": sum(r.waiting for r in report.robots)}
            )  # fmt: skip
            print(json.dumps(lines[-1]), file=file, flush=True)
    print(f"{number} fleets in {time.process_time() - begun:.0f} s of CPU")
    if not other:
        return
    former = [json.loads(line) for line in Path(other).read_text().splitlines()]
    for key, better in (("prize", 1.0), ("energy", -1.0), ("duration", -1.0)):
        pairs = [(one, was) for one, was in zip(lines, former, strict=False)
                 if key == "prize" or one["prize"] == was["prize"]]  # fmt: skip
        gain = [better * (one[key] - was[key]) / max(abs(was[key]), 1e-9) for one, was in pairs]
        worse = [was["seed"] for (_, was), one in zip(pairs, gain, strict=True) if one < -1e-3]
        more = sum(one > 1e-3 for one in gain)
        print(f"{key}: better {more}, same {len(gain) - more - len(worse)}, worse {worse}")
        print(f"  sum {sum(one[key] for one, _ in pairs):.6g}, "
              f"before {sum(was[key] for _, was in pairs):.6g}")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if sys.argv[2:] else 340, *sys.argv[3:4])
