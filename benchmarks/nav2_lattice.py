"""How far Nav2's lattice planner is from the least energy on this project's maps.

    python benchmarks/nav2_lattice.py [MAP.yaml ...] [--pairs 12] [--cell 0.1]

For each map, pairs of poses of the lattice: the route over its primitives that costs least by its
own penalties, priced by the power model, against the best plan and the lower bound of `plan`. Once
with the control set and penalties made for the robot, once with that set and usual penalties. No
Nav2 runs: the search is exact, where SmacPlannerLattice may stop early, smooth, or join the goal by
a curve of its own.
"""

from __future__ import annotations

import argparse
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from lattice_route import Lattice

from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.export.lattice import USUAL, control_set, penalties
from energyplan.io.maps import read_map
from energyplan.planning import PlanningProblem, plan
from energyplan.power import PowerModel

EFFORT = 30_000
"""Units of work of the plan that counts as the best one."""


def measure(name: str, problem: PlanningProblem, cell: float, count: int) -> None:
    """Print one row."""
    cost = problem.cost
    controls = control_set(cost, cell)
    told = penalties(controls, cost)
    begun = time.process_time()
    lattice = Lattice(problem, controls)
    made = time.process_time() - begun
    grid, rng = problem.map, np.random.default_rng(0)
    rows, columns = grid.shape
    excess: dict[str, list[float]] = {"made for the robot": [], "usual": [], "plan's gap": []}
    tried = 0
    while len(excess["usual"]) < count and tried < 5 * count:
        tried += 1
        cells = rng.uniform((0, 0), (columns, rows), (2, 2))
        poses = np.column_stack([grid.to_world(cells), rng.uniform(-np.pi, np.pi, 2)])
        start, goal = (lattice.nearest(pose) for pose in poses)
        asked = replace(problem, start=start, goal=goal)
        with suppress(PlanningError, ValueError):
            best = plan(asked, effort=EFFORT)
            found = [lattice.routes(start, [goal], how)[0] for how in (told, USUAL)]
            energies = [min(best.energy_steady, *(cost.energy(path) for path in found))]
            energies += [cost.energy(path) for path in found]
            excess["made for the robot"].append(100 * (energies[1] / energies[0] - 1))
            excess["usual"].append(100 * (energies[2] / energies[0] - 1))
            excess["plan's gap"].append(100 * best.gap)
    print(
        f"{name}, cells of {cell:g} m, {len(controls.primitives)} primitives, {made:.1f} s of CPU "
        f"for the lattice; non_straight {told.non_straight:.2f}, reverse {told.reverse:.2f}, "
        f"rotation {told.rotation:.2f} (a primitive's cost misses its energy by "
        f"{100 * told.error:.0f} %); {len(excess['usual'])} pairs, % above the best energy known, "
        "median / nine in ten / worst:"
    )
    for what, values in excess.items():
        if values:
            print(
                f"  {what:20s} {np.median(values):6.1f} {np.quantile(values, 0.9):6.1f} "
                f"{max(values):6.1f}",
                flush=True,
            )


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maps", nargs="*", type=Path)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--cell", type=float, default=0.1, help="size of the lattice's cells [m]")
    parser.add_argument("--model", default="quadriga:empty:concrete")
    given = parser.parse_args()
    own = Path(__file__).parents[1] / "maps"
    cost = EnergyCost(PowerModel.preset(given.model))
    for path in given.maps or sorted(own.glob("*.yaml")):
        problem = PlanningProblem(read_map(path), cost, (0, 0, 0), (0, 0, 0))
        measure(path.stem, problem, given.cell, given.pairs)


if __name__ == "__main__":
    main()
