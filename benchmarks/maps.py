"""Maps measured: what is made once of one, what a changed patch costs, and planning on from there.

    python benchmarks/maps.py                            the office map, and one of 1024 x 1024
    python benchmarks/maps.py MAP.yaml --pairs-file PAIRS.json [--pairs 10] [--sizes 4096]

Every figure is CPU time of all threads unless it is called wall. Replanning: a plan is made from
nothing, map included; the robot drives a quarter of it; then a patch of 1 % of the map's cells
about the middle of the plan changes, with a box on the way. `rest` is planning on where nothing
changed; `replanned` is bringing the map up to date and planning on with a fifth of the effort;
`anew` is planning from there from nothing with the whole effort.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.io.maps import read_map
from energyplan.path import Pose
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.planning.bound import prepare_bound
from energyplan.planning.replanning import replan
from energyplan.planning.search.planner import compile_planning
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.places import places_for
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))

EFFORT = 20_000
"""Units of work of a first plan."""

Made = TypeVar("Made")


class Timed(NamedTuple):
    """CPU and wall time of some work [s]."""

    cpu: float
    wall: float


def timed(work: Callable[[], Made]) -> tuple[Made, Timed]:
    """Do some work and say how long it took."""
    cpu, wall = time.process_time(), time.perf_counter()
    made = work()
    return made, Timed(time.process_time() - cpu, time.perf_counter() - wall)


def unknown_of(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the same map, of which nothing is kept yet."""
    return OccupancyGrid(
        grid.occupied, grid.resolution, grid.origin, grid.unknown, grid.unknown_is_free
    )


def boxes(size: int) -> OccupancyGrid:
    """Return a square map of `size` cells of 5 cm with boxes at random."""
    rng = np.random.default_rng(0)
    occupied = np.zeros((size, size), bool)
    for row, column in rng.integers(0, size, (size * size // 6700, 2)):
        height, width = rng.integers(5, 60, 2)
        occupied[row : row + height, column : column + width] = True
    occupied[:80, :80] = occupied[-80:, -80:] = False
    return OccupancyGrid(occupied, 0.05)


def tables(name: str, grid: OccupancyGrid, start: Pose, goal: Pose) -> None:
    """Print what making the tables of a map takes."""
    grid = unknown_of(grid)
    _, distances = timed(lambda: grid.space)
    query = CompiledProblem(PlanningProblem(grid, COST, start, goal))
    setting = query.setting
    _, places = timed(lambda: places_for(setting))
    _, outlines = timed(lambda: prepare_bound(query))
    rows, columns = grid.shape
    total = [sum(part) for part in zip(distances, places, outlines, strict=True)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"{name}: {columns} x {rows} cells: distances {distances.cpu:.2f}, free configurations "
        f"{places.cpu:.2f}, outlines for the bound {outlines.cpu:.2f}, together {total[0]:.2f} s "
        f"of CPU ({total[1]:.2f} s wall); peak of the process {peak:.2f} GiB",
        flush=True,
    )


def changed(grid: OccupancyGrid, at: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Return a patch of 1 % of the cells about a point with a box of 0.3 m there, and its place."""
    rows, columns = grid.shape
    side = max(int((0.01 * rows * columns) ** 0.5), 1)
    column, row = np.floor(grid.to_cells(at)).astype(int)
    first = min(max(row - side // 2, 0), rows - side)
    left = min(max(column - side // 2, 0), columns - side)
    cells = grid.occupied[first : first + side, left : left + side].copy()
    half = max(round(0.15 / grid.resolution), 1)
    row, column = row - first, column - left
    cells[max(row - half, 0) : row + half, max(column - half, 0) : column + half] = True
    return cells, first, left


def replanning(name: str, grid: OccupancyGrid, pairs: list[tuple[Pose, Pose]]) -> None:
    """Print what planning on takes against the first plan."""
    rests, ratios, excess, worst = [], [], [], 0
    for start, goal in pairs:
        fresh = unknown_of(grid)
        problem = PlanningProblem(fresh, COST, start, goal)
        try:
            former, first = timed(lambda p=problem: plan(p, effort=EFFORT))
            poses = former.path.poses()
            here = poses[len(poses) // 4]
            _, rest = timed(lambda p=problem, f=former, h=here: replan(p, f, start=h))
            patch = changed(fresh, poses[len(poses) // 2, :2])

            def on(p=problem, f=former, h=here, m=fresh, patch=patch) -> Plan:
                unknown = None
                if m.unknown is not None:
                    height, width = patch[0].shape
                    unknown = m.unknown[patch[1] : patch[1] + height, patch[2] : patch[2] + width]
                now = m.updated(*patch, unknown)
                return replan(p, f, start=h, map=now, effort=EFFORT // 5)

            again, spent = timed(on)
            now = unknown_of(fresh.updated(*patch))
            anew = plan(PlanningProblem(now, COST, here, goal), effort=EFFORT)
        except PlanningError as error:
            print(f"  {tuple(start)} to {tuple(goal)}: {type(error).__name__}: {error}"[:150])
            continue
        rests.append(1e3 * rest.cpu)
        ratios.append(spent.cpu / first.cpu)
        excess.append(100 * (again.cost / anew.cost - 1))
        worst = max(worst, spent.cpu)
    if not ratios:
        return
    print(
        f"{name}: {len(ratios)} of {len(pairs)} pairs: rest {np.median(rests):.0f} / "
        f"{max(rests):.0f} ms; replanned {np.median(ratios):.3f} / {max(ratios):.3f} of the first "
        f"plan's CPU time, at most {worst:.2f} s; dearer than anew by {np.median(excess):.2f} / "
        f"{max(excess):.2f} % (median / worst)",
        flush=True,
    )


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", nargs="?", type=Path)
    parser.add_argument("--pairs-file", type=Path, metavar="PAIRS.json")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--sizes", type=int, default=1024, metavar="CELLS")
    given = parser.parse_args()
    own = Path(__file__).parents[1] / "maps" / "office.yaml"
    grid, name = read_map(given.map or own), (given.map or own).stem
    if given.pairs_file:
        known = json.loads(given.pairs_file.read_text())["pairs"]
        pairs = [(Pose(*pair["start"]), Pose(*pair["goal"])) for pair in known]
    else:
        pairs = [(Pose(1, 4.4, 0), Pose(19, 4, -np.pi / 2)), (Pose(19, 4, 0), Pose(1, 4.4, 0))]
    compile_planning(PlanningProblem(grid, COST, *pairs[0]), tight=True)
    tables(name, grid, *pairs[0])
    far = 0.05 * given.sizes - 2.0
    tables("boxes", boxes(given.sizes), Pose(2, 2, 0), Pose(far, far, 0))
    replanning(name, grid, pairs[: given.pairs])


if __name__ == "__main__":
    main()
