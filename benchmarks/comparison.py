"""Planners, steering and power models of others beside this library's, measured in one run.

    python benchmarks/comparison.py                           maps and the open
    python benchmarks/comparison.py --data FOLDER             recorded drives too
    python benchmarks/comparison.py --out docs/comparison.md  into the tables of that page

FOLDER is that of docs/model_card.md. All of it takes about five minutes of CPU.

What others offer is run where it can be installed (OMPL, networkx), and otherwise built here from
what was published about it: a state lattice with Nav2's penalties, the paths of Effati et al.
(2020), the power models of Mei et al. (2004) and of Open-RMF. Neither Nav2 nor SBPL runs here. All
energies are those of the power model for the path as it is driven, whoever found it. CPU time is
that of all threads, with kernels compiled and what belongs to a map made beforehand.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path as File
from typing import NamedTuple

import card
import networkx as nx
import numpy as np
import steering as words
from lattice_route import Lattice
from pages import write

import energyplan as ep
from energyplan.errors import EnergyPlanError, PlanningError
from energyplan.export.lattice import USUAL, Penalties, control_set, penalties
from energyplan.path import Path, Pose, wrap_angle
from energyplan.planning import PlanningProblem, plan

COST = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
CELL = 0.1
"""Cells of the lattice and of the grid [m]."""

LADDER = tuple(250 * 2**k for k in range(8))
"""Efforts that are tried one after the other until a first plan comes of one."""


class Found(NamedTuple):
    """What came of a planner: the path, and CPU times [s] of a first plan and of the whole."""

    path: Path
    first: float = np.nan
    whole: float = np.nan


Planner = Callable[[PlanningProblem], Found]


class Scene:
    """What is made once for a map."""

    def __init__(self, grid: ep.OccupancyGrid) -> None:
        self.problem = PlanningProblem(grid, COST, (0, 0, 0), (0, 0, 0))
        self.controls = control_set(COST, CELL)
        self.lattice = Lattice(self.problem, self.controls)
        (x_min, y_min), (x_max, y_max) = COST.vehicle.footprint.tolist()
        ahead = COST.icr.longitudinal
        inner = min(x_max - ahead, ahead - x_min, y_max, -y_min)
        outer = float(np.hypot(max(x_max - ahead, ahead - x_min), max(y_max, -y_min)))
        self.discs = [_disc_graph(grid, radius) for radius in (outer, inner)]

    def pairs(self, count: int, seed: int) -> Iterator[PlanningProblem]:
        """Yield problems between random free poses of the lattice."""
        grid, rng = self.problem.map, np.random.default_rng(seed)
        rows, columns = grid.shape
        while count:
            cells = rng.uniform((0, 0), (columns, rows), (2, 2))
            poses = np.column_stack([grid.to_world(cells), rng.uniform(-np.pi, np.pi, 2)])
            ends = np.array([self.lattice.nearest(pose) for pose in poses])
            if grid.footprint_free(ends, COST.vehicle).all():
                count -= 1
                yield replace(self.problem, start=ends[0], goal=ends[1])


class Disc(NamedTuple):
    """A disc's ways on a grid."""

    grid: ep.OccupancyGrid
    radius: float
    graph: nx.Graph

    def sees(self, a: tuple[float, float], b: tuple[float, float]) -> bool:
        """Tell whether the disc passes from one point straight to another."""
        count = 2 + int(np.hypot(b[0] - a[0], b[1] - a[1]) / (0.5 * self.grid.resolution))
        return bool((self.grid.clearance_at(np.linspace(a, b, count)) >= self.radius).all())


def _disc_graph(grid: ep.OccupancyGrid, radius: float) -> Disc:
    """Return the grid of eight neighbours on which a disc is free."""
    width, height = grid.size
    steps = [np.arange(0.5 * CELL, length, CELL) for length in (width, height)]
    cells = np.stack(np.meshgrid(*steps, indexing="ij"), -1) / grid.resolution
    points = grid.to_world(cells)
    free = grid.clearance_at(points) >= radius
    graph = nx.Graph()
    for (dx, dy), long in {(1, 0): 1, (0, 1): 1, (1, 1): 2**0.5, (1, -1): 2**0.5}.items():
        for i, j in zip(*np.nonzero(free), strict=True):
            a, b = i + dx, j + dy
            if 0 <= a < free.shape[0] and 0 <= b < free.shape[1] and free[a, b]:
                ends = tuple(tuple(points[k].tolist()) for k in ((i, j), (a, b)))
                graph.add_edge(*ends, weight=long * CELL)
    return Disc(grid, radius, graph)


def turn_and_drive(start: Pose, goal: Pose, points: Iterable[tuple[float, float]]) -> Path:
    """Return the path that turns on the spot at each point and drives straight to the next."""
    ahead, ds, turns, yaw = COST.icr.longitudinal, [], [], start.yaw
    for (x, y), (to_x, to_y) in pairwise(points):
        heading = float(np.arctan2(to_y - y, to_x - x))
        turns += [float(wrap_angle(heading - yaw)), 0.0]
        ds += [0.0, float(np.hypot(to_x - x, to_y - y))]
        yaw = heading
    turns.append(float(wrap_angle(goal.yaw - yaw)))
    ds.append(0.0)
    return Path(start, np.array(ds), np.array(turns), ahead)


def reference(pose: Pose) -> tuple[float, float]:
    """Return the point midway between the tread ICRs."""
    ahead = COST.icr.longitudinal
    return pose.x + ahead * np.cos(pose.yaw), pose.y + ahead * np.sin(pose.yaw)


def grid_path(scene: Scene, problem: PlanningProblem) -> Found:
    """Find the shortest way of a disc by A* (networkx), pull it straight, turn at its corners.

    First the disc around the footprint; where that finds none, the one inside it.
    """
    begun = time.process_time()
    start, goal = Pose(*problem.start), Pose(*problem.goal)
    ends = [reference(pose) for pose in (start, goal)]
    for disc in scene.discs:
        if not all(disc.grid.clearance_at(end) >= disc.radius for end in ends):
            continue
        nodes = np.array(disc.graph.nodes)
        near = [tuple(nodes[np.argmin(np.hypot(*(nodes - end).T))].tolist()) for end in ends]
        with suppress(nx.NetworkXNoPath):
            way = nx.astar_path(disc.graph, *near, lambda a, b: float(np.hypot(*np.subtract(a, b))))
            points, left = [ends[0]], [*way, ends[1]]
            while left:
                seen = [k for k, point in enumerate(left) if disc.sees(points[-1], point)]
                last = seen[-1] if seen else 0
                points.append(left[last])
                left = left[last + 1 :]
            path = turn_and_drive(start, goal, points)
            if problem.map.path_free(path, COST.vehicle):
                spent = time.process_time() - begun
                return Found(path, spent, spent)
    raise PlanningError("no way of a disc that the footprint can drive")


def counted(name: str, effort: int, objective: str = "energy") -> Planner:
    """Return one of `plan`'s planners with an effort."""

    def find(problem: PlanningProblem) -> Found:
        asked, first = replace(problem, objective=objective), np.nan
        for rung in LADDER:
            begun = time.process_time()
            with suppress(PlanningError):
                plan(asked, name, effort=rung)
                first = time.process_time() - begun
                break
        begun = time.process_time()
        found = plan(asked, name, effort=effort)
        return Found(found.path, first, time.process_time() - begun)

    return find


def on_lattice(scene: Scene, told: Penalties) -> Planner:
    """Return the exact search over a state lattice."""
    return lambda problem: Found(scene.lattice.routes(problem.start, [problem.goal], told)[0])


def planners(scene: Scene, effort: int) -> dict[str, Planner]:
    """Return who is compared on a map, by name."""
    return {
        "energyplan, `lattice`": counted("lattice", effort),
        "energyplan, shortest route": counted("lattice", effort, "length"),
        "OMPL RRT*, energy": counted("rrtstar", effort),
        "OMPL RRT*, length": counted("rrtstar", effort, "length"),
        "OMPL Informed RRT*, energy": counted("informed_rrtstar", effort),
        "OMPL BIT*, energy": counted("bitstar", effort),
        "OMPL FMT*, energy": counted("fmt", effort),
        "state lattice, usual penalties of Nav2": on_lattice(scene, USUAL),
        "state lattice, penalties by `penalties`": on_lattice(
            scene, penalties(scene.controls, COST)
        ),
        "grid A* (networkx), turn and drive": lambda problem: grid_path(scene, problem),
    }


def on_maps(maps: list[File], count: int, effort: int, seed: int) -> str:
    """Return the table of planners on maps."""
    cells: dict[str, list[str]] = {}
    times: dict[str, list[tuple[float, float]]] = {}
    for path in maps:
        scene = Scene(ep.read_map(path))
        asked = list(scene.pairs(count, seed))
        plan(asked[0], effort=LADDER[-1])  # what is kept with the map
        found = {
            name: [_try(planner, problem) for problem in asked]
            for name, planner in planners(scene, effort).items()
        }
        energies = {
            name: np.array([COST.energy(one.path) if one else np.nan for one in answers])
            for name, answers in found.items()
        }
        best = np.nanmin(list(energies.values()), axis=0)
        for name, answers in found.items():
            excess = 100 * (energies[name] / best - 1)
            there = excess[np.isfinite(excess)]
            told = f"{np.median(there):.1f} / {there.max():.1f} %" if len(there) else "-"
            whole = f"{len(there)} of {np.isfinite(best).sum()}"
            cells.setdefault(name, []).append(f"{whole}: {told}")
            times.setdefault(name, []).extend(one[1:] for one in answers if one)
    lines = [
        f"| planner | {' | '.join(path.stem for path in maps)} | CPU, first plan / whole |",
        f"|{'---|' * (len(maps) + 2)}",
    ]
    for name, row in cells.items():
        known = [t for t in times[name] if np.isfinite(t).all()]
        spent = " / ".join(f"{v:.2f} s" for v in np.median(known, axis=0)) if known else "-"
        lines.append(f"| {name} | {' | '.join(row)} | {spent} |")
    return "\n".join(lines)


def _try(planner: Planner, problem: PlanningProblem) -> Found | None:
    try:
        return planner(problem)
    except PlanningError:
        return None


def arc_line_arc(start: np.ndarray, goal: np.ndarray, radius: float) -> float:
    """Return the least energy of arc, line and arc of one radius, each driven to either side.

    With the radius 0 that is point turn, line, point turn. Effati, Fiset and Skonieczny (2020).
    """
    bound, best = COST.lower_bound(), np.inf
    (x, y), first, last = goal[:2] - start[:2], start[2], goal[2]
    for one, other, gear in product((1, -1), repeat=3):  # centres on the left or right; gear
        dx = x - radius * (other * np.sin(last) - one * np.sin(first))
        dy = y + radius * (other * np.cos(last) - one * np.cos(first))
        across, apart = radius * (other - one), float(np.hypot(dx, dy))
        if apart < abs(across):
            continue
        line = float(np.sqrt(apart**2 - across**2))
        heading = np.arctan2(dy, dx) - np.arctan2(across, gear * line)
        turns = float(np.abs(wrap_angle([heading - first, last - heading])).sum())
        energy = bound.per_metre * (line + COST.half_track * turns) + bound.per_radian * turns
        best = min(best, energy)
    return best


def in_the_open(count: int) -> str:
    """Return the table of paths without obstacles."""
    C = COST.half_track
    lines = [
        "| distance | exact steering (energyplan) | arc, line, arc of radius `R'` "
        "| point turn, line, point turn | shortest Reeds-Shepp path of radius `R'` (OMPL) |",
        "|---|---|---|---|---|",
    ]
    for ratio in (1.0, 3.0, 10.0, 30.0):
        starts, goals = words.pairs(count, (ratio * C * 0.999, ratio * C * 1.001), int(10 * ratio))
        least = ep.steering.energy(starts, goals, COST)
        others = [
            [arc_line_arc(*pair, C) for pair in zip(starts, goals, strict=True)],
            [arc_line_arc(*pair, 0.0) for pair in zip(starts, goals, strict=True)],
            [words.reeds_shepp_energy(*s, COST) for s in words.reeds_shepp(starts, goals, C)],
        ]
        cells = []
        for energies in others:
            excess = 100 * (np.array(energies) / least - 1)
            cells.append(f"{np.mean(excess):.1f} / {np.max(excess):.1f} %")
        lines.append(f"| {ratio * C:.2f} m | 0 | {' | '.join(cells)} |")
    return "\n".join(lines)


def rolling(log: ep.DriveLog, vehicle: ep.Vehicle) -> np.ndarray:
    """Return the regressors of Open-RMF's `SimpleMotionPowerSink` at steady speed.

    Rolling friction times weight and speed, and a constant load.
    """
    speed = 0.5 * (log.channel("v_left") + log.channel("v_right"))
    return np.column_stack([vehicle.mass * 9.81 * np.abs(speed), np.ones(len(log))])


def polynomial(log: ep.DriveLog, vehicle: ep.Vehicle) -> np.ndarray:
    """Return those of Mei et al. (2004): a polynomial of degree six in each motor's speed."""
    sides = [np.abs(log.channel(name)) for name in ("v_left", "v_right")]
    return np.column_stack([sum(side**k for side in sides) for k in range(7)])


def judged(ground: card.Ground) -> tuple[list[ep.DriveLog], list[ep.DriveLog]]:
    """Return the moving runs of a ground to learn from, and every third one, which judges."""
    runs = list(ground.judged())
    return [run for k, run in enumerate(runs) if k % 3], runs[::3]


def on_drives(folder: File) -> str:
    """Return the table of power models on recorded drives that they were not fitted to."""
    names = ["rolling friction (Open-RMF)", "polynomial of the motors' speeds (Mei et al. 2004)",
             "slip and traction (Morales et al. 2010)", "energyplan, with diagnosis"]  # fmt: skip
    lines = [
        f"| robot, ground | drives judged | {' | '.join(names)} |",
        f"|{'---|' * (len(names) + 2)}",
    ]
    for ground in card.grounds(folder, []):
        train, judge = judged(ground)
        name = f"{ground.vehicle.name}, {ground.name.lower().replace('_', ' ')}"
        try:
            diagnosed = ep.diagnose(train, holdout=judge, vehicle=ground.vehicle)
        except EnergyPlanError as error:
            print(f"{name}: {error}")
            continue
        predicted = []
        for build in (rolling, polynomial):
            fitted = np.vstack([build(log, ground.vehicle) for log in train])
            scale = np.abs(fitted).max(axis=0)
            power = np.concatenate([log.power for log in train])
            size = np.linalg.lstsq(fitted / scale, power, rcond=None)[0] / scale
            predicted.append([log.weights @ (build(log, ground.vehicle) @ size) for log in judge])
        predicted += [
            [log.weights @ power for log, power in zip(judge, powers, strict=True)]
            for powers in (diagnosed.predictions_before, diagnosed.predictions_after)
        ]
        measured = np.array([log.energy for log in judge])
        errors = np.abs(np.array(predicted) / measured - 1) * 100
        cells = [f"{np.median(row):.1f} / {row.max():.1f} %" for row in errors]
        lines.append(f"| {name} | {len(measured)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Make the tables; print them or write them into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=6, help="pairs of poses on each map")
    parser.add_argument("--effort", type=int, default=20_000, help="for each plan")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=File, help="folder of recorded drives")
    parser.add_argument("--out", type=File, help="page whose tables are made anew")
    asked = parser.parse_args()
    maps = sorted((File(__file__).parents[1] / "maps").glob("*.yaml"))
    tables = {
        "planners": on_maps(maps, asked.pairs, asked.effort, asked.seed),
        "the open": in_the_open(200),
    }
    if asked.data:
        tables["drives"] = on_drives(asked.data)
    for name, text in tables.items():
        if asked.out is None:
            print(f"{name}\n{text}\n")
            continue
        write(asked.out, name, text)


if __name__ == "__main__":
    main()
