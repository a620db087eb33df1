"""Plans on random hills: how soon, how good, and what a planner of level ground pays there.

    python benchmarks/slopes.py [--pairs N]

Hills of 0.6 m (standard deviation 2 m) in a yard of 40 m by 30 m with trees, and a robot whose
drives give nothing back. Every pair of poses is planned with the usual effort and with seven
times as much, as well as with the usual one as if the ground were level; that route is then priced
on the hills.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import shapely

from energyplan.cost import EnergyCost
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.budget import EFFORT
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap, OccupancyGrid, path_price

SIZE = (40.0, 30.0)


def yard(rng: np.random.Generator) -> OccupancyGrid:
    """Return a yard with forty trees."""
    trees = shapely.points(rng.uniform((1, 1), (39, 29), (40, 2)))
    return OccupancyGrid.from_polygons(shapely.buffer(trees, 0.35), (0.0, 0.0, *SIZE), 0.1)


def hills(rng: np.random.Generator) -> HeightMap:
    """Return smooth hills and dips."""
    i, j = np.indices((61, 81)) * 0.5
    total = np.zeros(i.shape)
    for x, y, height in zip(
        rng.uniform(0, 40, 60), rng.uniform(0, 30, 60), 0.6 * rng.normal(size=60), strict=True
    ):
        total += height * np.exp(-0.5 * ((j - x) ** 2 + (i - y) ** 2) / 2.0**2)
    return HeightMap(total, 0.5)


def main() -> None:
    """Plan and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=12)
    pairs = parser.parse_args().pairs
    rng = np.random.default_rng(1)
    grid, ground = yard(rng), hills(rng)
    model = with_weight(PowerModel.preset("quadriga:full:concrete"))
    vehicle = replace(model.vehicle, drive_efficiency=0.8, regen_efficiency=0.0)
    cost = EnergyCost(replace(model, vehicle=vehicle), battery=True)
    poses = rng.uniform((1.5, 1.5, -np.pi), (38.5, 28.5, np.pi), (400, 3))
    poses = poses[grid.footprint_free(poses, vehicle)]
    first, level_first, saved, excess, gaps = [], [], [], [], []
    for start, goal in zip(poses[: 2 * pairs : 2], poses[1 : 2 * pairs : 2], strict=True):
        problem = PlanningProblem(grid, cost, start, goal, heights=ground)
        short, long = plan(problem, effort=EFFORT), plan(problem, effort=7 * EFFORT)
        level = plan(replace(problem, heights=None), effort=EFFORT)
        paid = path_price(level.path, cost, None, ground).energy
        reduced = long.energy_steady - long.potential
        first.append(1e3 * short.first_time)
        level_first.append(1e3 * level.first_time)
        saved.append(100 * (paid - short.energy_steady) / max(paid, paid - short.potential))
        excess.append(100 * (short.energy_steady - long.energy_steady) / reduced)
        gaps.append(100 * short.gap)
    print(f"{pairs} pairs in {SIZE[0]:g} m by {SIZE[1]:g} m")
    print(f"{'':44s} {'median':>8s} {'least':>8s} {'greatest':>8s}")
    for name, values in (
        ("first plan [ms]", first),
        ("first plan on level ground [ms]", level_first),
        ("saved against planning as if level [%]", saved),
        ("usual effort above seven times as much [%]", excess),
        ("gap to the lower bound [%]", gaps),
    ):
        print(f"{name:44s} {np.median(values):8.1f} {min(values):8.1f} {max(values):8.1f}")


if __name__ == "__main__":
    main()
