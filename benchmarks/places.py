"""Missions of places without headings: ``python benchmarks/places.py [COUNT] [--out FILE]``.

Each mission has six random places in an empty hall, in a free order, from and back to a pose. A row
compares its energy with the least of all orders and 16 headings a place (brute force over exact
motions), and with that of the same mission with heading 0 at each place.
"""

from __future__ import annotations

import argparse
from itertools import pairwise, permutations
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pages import write

from energyplan import EnergyCost, OccupancyGrid, PowerModel, steering
from energyplan.battery import Battery
from energyplan.mission import Mission, Task, evaluate

MODEL = PowerModel.preset("quadriga:empty:concrete")
START, HALL, PLACES, HEADINGS = (2.0, 2.0, 0.5), (20.0, 12.0), 6, 16


def energy(poses: list[tuple[float, ...]]) -> float:
    """Return what a mission of tasks at some poses or places takes [J]."""
    cells = np.zeros((int(HALL[1] * 10), int(HALL[0] * 10)), bool)
    found = evaluate(
        Mission(
            map=OccupancyGrid(cells, resolution=0.1), model=MODEL,
            battery=Battery.preset("quadriga"), start=START, order="free", return_to="start",
            tasks=tuple(Task(f"t{k}", pose) for k, pose in enumerate(poses)),
            planning_effort=1000, confidence=0.5,
        )
    )  # fmt: skip
    assert found.feasible
    return found.energy


def least(places: ArrayLike) -> float:
    """Return the least energy of all orders and headings [J]."""
    cost = EnergyCost(MODEL, battery=True)
    yaws = np.arange(HEADINGS) * 2 * np.pi / HEADINGS
    poses = [np.array([START])]
    poses += [
        np.column_stack([np.tile(place, (HEADINGS, 1)), yaws]) for place in np.asarray(places)
    ]
    ways = {
        (a, b): steering.energy(poses[a][:, None], poses[b][None], cost)
        for a in range(len(poses)) for b in range(len(poses)) if a != b
    }  # fmt: skip
    best = np.inf
    for order in permutations(range(1, len(poses))):
        total = ways[0, order[0]][0]
        for a, b in pairwise(order):
            total = (total[:, None] + ways[a, b]).min(axis=0)
        best = min(best, float((total + ways[order[-1], 0][:, 0]).min()))
    return best


def main() -> None:
    """Run the missions, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=20)
    parser.add_argument("--out", type=Path, help="page to write the summary into")
    wanted = parser.parse_args()
    print("| mission | free headings [J] | brute force [J] | more than it | below heading 0 |")
    print("|---|---|---|---|---|")
    more, saved = [], []
    for seed in range(1, wanted.count + 1):
        rng = np.random.default_rng(seed)
        low, high = (1.5, 1.5), (HALL[0] - 1.5, HALL[1] - 1.5)
        places = [tuple(one) for one in rng.uniform(low, high, (PLACES, 2)).round(1).tolist()]
        free, fixed = energy(places), energy([(*place, 0.0) for place in places])
        best = least(places)
        more.append(free / best - 1.0)
        saved.append(1.0 - free / fixed)
        print(
            f"| {seed} | {free:.0f} | {best:.0f} | {100 * more[-1]:.2f} % "
            f"| {100 * saved[-1]:.1f} % |",
            flush=True,
        )
    rows = (
        ("missions", f"{wanted.count}"),
        ("more than brute force, mean", f"{100 * np.mean(more):.2f} %"),
        ("more than brute force, largest", f"{100 * max(more):.2f} %"),
        ("below heading 0, mean", f"{100 * np.mean(saved):.1f} %"),
        ("below heading 0, least", f"{100 * min(saved):.1f} %"),
    )
    table = "\n".join(
        ["| figure | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)]
    )
    print(f"\n{table}")
    if wanted.out:
        write(wanted.out, "free places", table)


if __name__ == "__main__":
    main()
