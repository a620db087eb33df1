"""Plan over hilly ground: round the hill or over it, and what a planner of level ground would pay.

    python examples/plan_hill.py [--height METRES] [--out FOLDER]

A robot of 147 kg crosses a yard with a heap of spoil and a dip beside it. Its drives lose a quarter
on the way out and brake on a resistor, so nothing of what a steep climb took comes back.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from energyplan import EnergyCost, HeightMap, OccupancyGrid, PowerModel, compare
from energyplan.output import plots
from energyplan.output.plots import png
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.planning.driven import drive_plan
from energyplan.power.effects import with_weight

SIZE = (32.0, 20.0)
START, GOAL = (2.0, 9.0, 0.0), (30.0, 9.0, 0.0)


def yard() -> OccupancyGrid:
    """Return a yard with a few trees and a shed."""
    trees = [(6.5, 12.5), (12.5, 16.5), (19.5, 3.0), (24.5, 13.5), (26.5, 5.5)]
    things = [shapely.Point(place).buffer(0.4) for place in trees]
    return OccupancyGrid.from_polygons(
        [*things, shapely.box(13.0, 0.5, 17.0, 2.0)],
        resolution=0.1,
        bounds=(0.0, 0.0, *SIZE),
    )


def heap(height: float) -> HeightMap:
    """Return the ground: a heap of this height across the way, and a dip half as deep behind it."""
    step = 0.25
    i, j = np.indices((round(SIZE[1] / step) + 1, round(SIZE[0] / step) + 1)) * step
    hill = height * np.exp(-(((j - 14.0) / 3.5) ** 2) - ((i - 9.5) / 4.5) ** 2)
    dip = -0.5 * height * np.exp(-(((j - 22.5) / 3.0) ** 2) - ((i - 8.0) / 3.0) ** 2)
    return HeightMap(hill + dip, step)


def robot() -> EnergyCost:
    """Return the cost at the battery of drives that give nothing back."""
    model = with_weight(PowerModel.preset("quadriga:full:concrete"))
    vehicle = replace(model.vehicle, drive_efficiency=0.75, regen_efficiency=0.0)
    return EnergyCost(replace(model, vehicle=vehicle), battery=True)


def tell(name: str, energy: float, found: Plan, ground: HeightMap) -> None:
    """Print what a route takes, and how far up and down it leads."""
    steps = np.diff(ground.height(found.poses[:, :2]))
    up, down = float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())
    print(
        f"{name:22s} {energy:8.0f} J  {found.length:6.2f} m  "
        f"{np.degrees(found.turning):5.0f} deg  {up:5.2f} m up  {down:5.2f} m down"
    )


def main() -> None:
    """Plan, compare and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--height", type=float, default=2.0, help="height of the heap [m]")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the picture")
    given = parser.parse_args()
    ground, cost = heap(given.height), robot()
    problem = PlanningProblem(yard(), cost, START, GOAL, heights=ground)
    result = compare(problem, effort=100_000)
    blind = plan(replace(problem, heights=None), effort=100_000)
    best = result.energy_optimal
    tell("least energy", best.energy_driven, best, ground)
    tell("shortest", result.shortest.energy_driven, result.shortest, ground)
    tell("planned as if level", drive_plan(problem, blind.path).energy, blind, ground)
    print(
        f"{100 * result.saving:.1f} % saved; no route takes less than {best.lower_bound:.0f} J. "
        f"On level ground the way would take {blind.energy_driven:.0f} J."
    )
    for name, joules in result.by_term.items():
        print(f"  {name.replace('_', ' '):24s} {round(joules):8d} J saved")

    paths = {"least energy": best.path, "shortest": result.shortest.path}
    picture = plots.routes(problem.map, paths, "Over the heap or round it")
    ground.contours(picture.axes[0], 12)
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "plan_hill.png").write_bytes(png(picture))


if __name__ == "__main__":
    main()
