"""Planners measured: time to the first plan, gap to the lower bound, rivals, map size.

    python benchmarks/planners.py                       every table, small: less than two minutes
    python benchmarks/planners.py MAP.yaml --pairs 100  first plan, gap, shortest route
    python benchmarks/planners.py --pairs-file PAIRS.json  the same on pairs of poses from a file
    python benchmarks/planners.py --pairs-file PAIRS.json --effort 5000 50000   by effort
    python benchmarks/planners.py [MAP.yaml] --floors 6 --effort 5000 50000   floors of floors.py
    python benchmarks/planners.py MAP.yaml --rivals 10  0.1 s of ours against 10 s of OMPL's
    python benchmarks/planners.py --sizes 4096 [--plot sizes.png]
    python benchmarks/planners.py --turns 12            least time in an empty hall, over the bound
    python benchmarks/planners.py --write docs/planning.md  by effort, into the table of that page

A file of pairs names its `map`, a file beside it or a floor, and the `model`; of its `pairs` each
has `start`, `goal` and the least energy known, `best_known_energy` [J]. Excess is over the best of
that and of all plans of the run, so that a long run judges a short one. Floors are those on which
no threshold was chosen, and the maps given turned by 17 degrees and mirrored. Without maps, those
of the project are used. All times are wall time on this machine, kernels compiled beforehand.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import floors
import numpy as np
from pages import write

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.io.maps import read_map
from energyplan.output import plots
from energyplan.output.plots import png
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.planning.budget import EFFORT
from energyplan.planning.driven import drive_plan
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
ENDLESS = 10**9
"""Units of work that no time limit here lets a planner do: the clock alone counts."""
RIVALS = ("rrtstar", "informed_rrtstar", "bitstar")


def problems(grid: OccupancyGrid, count: int, seed: int = 0) -> list[PlanningProblem]:
    """Return problems between random free poses."""
    rng = np.random.default_rng(seed)
    rows, columns = grid.shape
    poses: list[np.ndarray] = []
    while len(poses) < 2 * count:
        cells = rng.uniform((0, 0), (columns, rows), (50, 2))
        tried = np.column_stack([grid.to_world(cells), rng.uniform(-np.pi, np.pi, 50)])
        poses.extend(tried[grid.footprint_free(tried, COST.vehicle)])
    pairs = zip(poses[::2], poses[1::2], strict=False)
    return [PlanningProblem(grid, COST, a, b) for a, b in list(pairs)[:count]]


class Run(NamedTuple):
    """A plan, and what it took: CPU time of all threads [s]."""

    plan: Plan
    work: float


def known_pairs(path: Path, efforts: list[int]) -> None:
    """Print a table of the pairs in a file: first plan, excess over the best known, gap, work."""
    given = json.loads(path.read_text())
    floor = floors.FLOORS.get(given["map"])
    grid = floor() if floor else read_map(path.parent / given["map"])
    cost = EnergyCost(PowerModel.preset(given["model"]))
    todo = [PlanningProblem(grid, cost, pair["start"], pair["goal"]) for pair in given["pairs"]]
    known = [pair.get("best_known_energy", np.inf) for pair in given["pairs"]]
    by_spending(path.stem, todo, known, efforts)


def by_spending(
    name: str, todo: list[PlanningProblem], known: list[float], efforts: list[int]
) -> None:
    """Print what problems are solved to by effort, or in 0.1 and 1 s; the best of all runs counts.

    What is known of a pair's least energy is an upper limit; a plan of this run may be below it.
    """
    spendings: list[dict[str, Any]] = [
        {"time_limit": limit, "effort": ENDLESS} for limit in (0.1, 1.0)
    ]
    if efforts:
        spendings = [{"effort": effort} for effort in efforts]
    with suppress(PlanningError):
        plan(todo[0], **spendings[0])  # what is kept with the map
    runs: list[dict[int, Run]] = []
    best = dict(enumerate(known))
    for spending in spendings:
        runs.append({})
        for k, problem in enumerate(todo):
            begun = time.process_time()
            with suppress(PlanningError):
                found = plan(problem, **spending)
                runs[-1][k] = Run(found, time.process_time() - begun)
                best[k] = min(best[k], found.energy_steady)
    beaten = [100 * (1 - best[k] / known[k]) for k in best if best[k] < known[k] < np.inf]
    if beaten:
        print(f"{name}: {len(beaten)} best known were beaten, by {max(beaten):.1f} % at most")
    for spending, made in zip(spendings, runs, strict=True):
        what, much = next(iter(spending.items()))
        print(f"{name}, {what} {much:g}: {len(made)} of {len(todo)} found; ", end="")
        first = [1e3 * one.plan.first_time for one in made.values()]
        gap = [100 * one.plan.gap for one in made.values()]
        excess = [100 * (one.plan.energy_steady / best[k] - 1) for k, one in made.items()]
        work = [one.work for one in made.values()]
        print(
            f"first {np.median(first):.0f} / {max(first):.0f} ms (median / worst); "
            f"excess over the best {np.median(excess):.2f} (mean {np.mean(excess):.2f}) / "
            f"{max(excess):.2f} %; "
            f"gap {np.median(gap):.2f} / {np.quantile(gap, 0.9):.2f} / {max(gap):.2f} % (median / "
            f"nine in ten / worst); CPU time {np.median(work):.2f} / {max(work):.2f} s",
            flush=True,
        )


def warm_up() -> None:
    """Compile every kernel that is timed."""
    occupied = np.zeros((100, 100), bool)
    occupied[40:60, 30:60] = True
    grid = OccupancyGrid(occupied, 0.1)
    problem = PlanningProblem(grid, COST, (1, 5, 0), (9, 5, 1))
    plan(problem, time_limit=0.5, gap=0.0)


def measure(name: str, grid: OccupancyGrid, count: int, limit: float) -> None:
    """Print one row: first plan, gap, and energy against the shortest route."""
    first, gap, excess, failed = [], [], [], 0
    todo = problems(grid, count)
    plan(replace(todo[0]), time_limit=limit, effort=ENDLESS)  # what is kept with the map
    for problem in todo:
        try:
            found = plan(problem, time_limit=limit, effort=ENDLESS)
            shortest = replace(problem, objective="length")
            short = plan(shortest, time_limit=min(limit, 0.5), effort=ENDLESS)
        except PlanningError as error:
            failed += type(error).__name__ != "NoPathError"
            continue
        first.append(1e3 * found.first_time)
        gap.append(100 * found.gap)
        excess.append(found.energy_steady / short.energy_steady - 1)
    rows, columns = grid.shape
    print(
        f"{name:22s} {columns:5d} x {rows:<5d} {len(gap):4d} {failed:3d}  "
        f"{np.median(first):7.0f} {max(first):7.0f}   {np.median(gap):6.2f} "
        f"{np.quantile(gap, 0.9):6.2f} {max(gap):6.2f}   {int(np.sum(np.array(excess) > 1e-9)):4d}",
        flush=True,
    )


def rivals(name: str, grid: OccupancyGrid, count: int, limit: float) -> None:
    """Print one row: on how many pairs 0.1 s of the lattice beats each rival's full time."""
    todo = problems(grid, count)
    plan(todo[0], time_limit=1.0)
    won = dict.fromkeys(RIVALS, 0)
    ratio: dict[str, list[float]] = {rival: [] for rival in RIVALS}
    total = 0

    def row() -> str:
        return f"{name:22s} 0.1 s against {limit:g} s:  " + "   ".join(
            f"{rival} {won[rival]}/{total} (median x{np.median(ratio[rival] or [np.nan]):.3f})"
            for rival in RIVALS
        )

    for problem in todo:
        try:
            ours = plan(problem, time_limit=0.1, effort=ENDLESS).energy_steady
        except PlanningError:
            ours = np.inf
        total += 1
        for rival in RIVALS:
            try:
                theirs = plan(problem, rival, limit, effort=ENDLESS).energy_steady
            except PlanningError:
                theirs = np.inf
            won[rival] += ours <= theirs * (1 + 1e-9)
            if np.isfinite(ours) and np.isfinite(theirs):
                ratio[rival].append(theirs / ours)
        if total % 10 == 0:
            print(row(), file=sys.stderr, flush=True)
    print(row(), flush=True)


def row_of(name: str, grid: OccupancyGrid, count: int, effort: int) -> str:
    """Return a row of the table: pairs solved, gaps, and plans worse than the shortest."""
    gaps, solved, dearer, spent = [], 0, 0, 0.0
    todo = problems(grid, count)
    for problem in todo:
        begun = time.process_time()
        with suppress(PlanningError):
            found = plan(problem, effort=effort)
            spent += time.process_time() - begun
            solved += 1
            gaps.append(100 * found.gap)
            short = plan(replace(problem, objective="length"), effort=effort)
            dearer += found.energy_steady > short.energy_steady * (1 + 1e-9)
    return (
        f"| {name} | {effort} | {solved} of {len(todo)} | {np.median(gaps):.1f} / "
        f"{np.quantile(gaps, 0.9):.1f} % | {dearer} | {spent / max(solved, 1):.2f} s |"
    )


def write_table(page: Path, grids: dict[str, OccupancyGrid], count: int) -> None:
    """Write the table of plans by effort between the marks of a page."""
    rows = [row_of(*item, count, EFFORT) for item in grids.items()]
    head = [
        "| map | effort | solved | gap, median / 90 % | more energy than the shortest | CPU time |",
        "|---|---|---|---|---|---|",
    ]
    write(page, "measured plans", "\n".join([*head, *rows]))


def yard(size: int, seed: int = 0) -> OccupancyGrid:
    """Return a square map of `size` cells of 5 cm, one box in every 4 m by 4 m."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((size, size), bool)
    for row in range(80, size - 80, 80):
        for column in range(80, size - 80, 80):
            height, width = rng.integers(10, 40, 2)
            occupied[row : row + height, column : column + width] = True
    return OccupancyGrid(occupied, 0.05)


def sizes(largest: int, plot: str | None) -> None:
    """Print time and memory against the size of the map, and the slope on log-log axes."""
    print("seconds of CPU time, all threads together")
    print("cells a side   map kept [s]   first plan [s]   then [s]    gap [%]   peak memory [MB]")
    table = []
    for size in (size for size in (256, 512, 1024, 2048, 4096) if size <= largest):
        grid = yard(size)
        far = 0.05 * size - 1.5
        problem = PlanningProblem(grid, COST, (1.5, 1.5, 0.7), (far, far, 0.7))
        begun = time.process_time()
        grid.footprint_free([problem.start], COST.vehicle)
        kept = time.process_time() - begun
        begun = time.process_time()
        plan(problem, effort=100_000, gap=100.0)  # any plan will do
        first = time.process_time() - begun
        begun = time.process_time()
        found = plan(problem, effort=100_000, gap=0.03)
        spent = time.process_time() - begun
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        table.append((size, kept, first, spent, memory))
        print(
            f"{size:12d} {kept:14.3f} {first:16.3f} {spent:10.3f} "
            f"{100 * found.gap:10.2f} {memory:18.0f}",
            flush=True,
        )
    rows = np.array(table)
    area = rows[:, 0] ** 2
    slope = np.polyfit(np.log(area[1:]), np.log((rows[:, 1] + rows[:, 2])[1:]), 1)[0]
    print(f"map and first plan grow with the power {slope:.2f} of the area")
    if plot:
        figure = plots.figure(2, 1, size=(plots.WIDTH, 6.4))
        seconds, megabytes = figure.axes
        lines = (
            (1, "map", plots.GREEN, "^-"), (2, "first plan", plots.BLUE, "o-"),
            (3, "then within 3 % of the bound", plots.RED, "s--"),
        )  # fmt: skip
        for column, label, color, look in lines:
            seconds.loglog(area, rows[:, column], look, ms=5, color=color, label=label)
        seconds.loglog(area, rows[-1, 2] * area / area[-1], "k:", label="linear in the area")
        seconds.set_ylabel("CPU time [s]")
        peak = {"color": plots.PURPLE, "label": "peak of the process"}
        megabytes.loglog(area, rows[:, 4], "o-", ms=5, **peak)
        megabytes.loglog(area, rows[-1, 4] * area / area[-1], "k:", label="linear in the area")
        megabytes.set_ylim(bottom=100.0)
        megabytes.set_ylabel("memory [MB]")
        for axes in (seconds, megabytes):
            axes.set_xlabel("cells of the map [1]")
            plots.legend(axes, above=True)
        Path(plot).write_bytes(png(figure))


def turns_at_speed(count: int) -> None:
    """Print how far plans of least time, and straight lines with stops, lie above the bound."""
    hall = OccupancyGrid(np.zeros((200, 200), bool), resolution=0.1)
    plans, stopping = [], []
    for problem in problems(hall, count):
        found = plan(replace(problem, objective="time"))
        assert found.lower_bound is not None
        line = drive_plan(problem, steering.path(problem.start, problem.goal, COST))
        plans.append(found.cost / found.lower_bound - 1.0)
        stopping.append(line.duration / found.lower_bound - 1.0)
        print(f"{100 * plans[-1]:6.1f} %   with stops {100 * stopping[-1]:6.1f} %")
    mean, least = 100 * np.mean(plans), 100 * np.mean(stopping)
    print(f"mean {mean:.1f} %   with stops {least:.1f} %")


def main() -> None:
    """Run what the command line asks for; a little of everything where it asks for nothing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maps", nargs="*", type=Path)
    parser.add_argument("--pairs", type=int, default=None, help="pairs of poses on each map")
    parser.add_argument("--pairs-file", type=Path, nargs="+", metavar="PAIRS.json")
    parser.add_argument(
        "--effort", type=int, nargs="*", default=[], help="work for the pairs of a file, not time"
    )
    parser.add_argument("--floors", type=int, default=0, metavar="PAIRS")
    parser.add_argument("--time", type=float, default=1.0, help="time for each plan [s]")
    parser.add_argument("--rivals", type=int, default=0, metavar="PAIRS")
    parser.add_argument("--rival-time", type=float, default=10.0)
    parser.add_argument("--sizes", type=int, default=0, metavar="CELLS")
    parser.add_argument("--turns", type=int, default=0, metavar="PAIRS")
    parser.add_argument("--plot")
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    given = parser.parse_args()
    own = sorted((Path(__file__).parents[1] / "maps").glob("*.yaml"))
    grids = {path.stem: read_map(path) for path in (given.maps or own)}
    chosen = given.rivals or given.sizes or given.pairs
    if given.pairs and not given.maps:
        grids["yard"] = yard(2000)
    warm_up()
    if given.write:
        write_table(given.write, grids, given.pairs or 20)
        return
    if given.turns:
        turns_at_speed(given.turns)
        return
    if given.pairs_file:
        for file in given.pairs_file:
            known_pairs(file, given.effort)
        return
    if given.floors:
        made = {name: make() for name, make in floors.FLOORS.items()}
        made |= {f"{path.stem} turned": floors.turned(grids[path.stem]) for path in given.maps}
        for name, grid in made.items():
            todo = problems(grid, given.floors)
            by_spending(name, todo, [np.inf] * len(todo), given.effort)
        return
    if (given.pairs and not given.rivals) or not chosen:
        count = given.pairs or 6
        print(f"{count} random pairs, {given.time:g} s each")
        print(
            "map                     columns x rows  plans lost   first [ms] med max   "
            "gap [%] med 90 max   more than shortest  "
        )
        for name, grid in grids.items():
            measure(name, grid, count, given.time)
    if given.rivals or not chosen:
        for name, grid in list(grids.items())[: None if chosen else 1]:
            rivals(name, grid, given.rivals or 3, given.rival_time if chosen else 2.0)
    if given.sizes or not chosen:
        sizes(given.sizes or 1024, given.plot)


if __name__ == "__main__":
    main()
