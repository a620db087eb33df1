"""Several robots and many tasks: ``python benchmarks/fleet.py [ROBOTS TASKS]``.

First as sums of energies in a hall, alike robots and unlike ones, without a map; then with their
routes planned. CPU time and wall time stand side by side.

``python benchmarks/fleet.py --random COUNT [FIRST]`` draws small fleets by chance and compares
their answers with every share in every order (see tests/mission/random_fleets.py).
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from energyplan.battery import Battery
from energyplan.mission import Charger, Mission, Robot, Task, evaluate
from energyplan.mission.order import OrderProblem, shared, solve
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid


def problems(robots: int, tasks: int, unlike: bool, seed: int = 0) -> list[OrderProblem]:
    """Return robots in a hall with two chargers; unlike ones differ up to threefold."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((0, 0), (60, 40), (tasks + 2, 2))
    work, made = rng.uniform(500, 3000, tasks), []
    for _ in range(robots):
        thirst = float(rng.uniform(0.6, 1.8)) if unlike else 1.0
        nodes = np.vstack([rng.uniform((0, 0), (60, 40), (1, 2)), places])
        apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=-1)
        energy = 300.0 * thirst * apart
        safe = energy[:, [0, 1 + tasks, 2 + tasks]].min(axis=1)
        made.append(
            OrderProblem(
                np.arange(tasks), np.zeros(1), energy[None, None], safe[None],
                floor=np.zeros_like(energy)[None, None], time=apart[None] / 0.8,
                finish_time=apart[:, 0] / 0.8, service=work, service_time=np.full(tasks, 60.0),
                window=np.tile([0.0, np.inf], (tasks, 1)), idle=np.zeros(tasks),
                prize=np.full(tasks, 2.0 + tasks), change=np.zeros(tasks),
                budget=40e3, capacity=np.full(2, 50e3), charge_power=np.full(2, 500.0), full=50e3,
            )
        )  # fmt: skip
    return made


def sums(robots: int, tasks: int) -> None:
    """Share tasks without a map, then solve each robot's own with its charges."""
    for unlike in (False, True):
        drawn = problems(robots, tasks, unlike)
        begun, wall = time.process_time(), time.perf_counter()
        own, _ = shared(drawn, np.ones(tasks))
        energy, done = 0.0, 0
        for one, mine in zip(drawn, own, strict=True):
            part = one.some(mine)._replace(given=len(mine) > 15)
            found = solve(part)
            energy += found.energy
            done += sum(stop <= len(mine) for stop in found.stops)
        print(
            f"{robots} {'unlike' if unlike else 'alike'} robots, {done} of {tasks} done:"
            f" {energy / 3600:.1f} Wh; {time.process_time() - begun:.1f} s of CPU,"
            f" {time.perf_counter() - wall:.1f} s",
            flush=True,
        )


def planned(robots: int, tasks: int) -> None:
    """Plan the routes of all robots, some of them with heavier models."""
    blocked = np.zeros((300, 400), bool)
    for column in range(40, 360, 40):
        blocked[40:260, column : column + 8] = True
    grid = OccupancyGrid(blocked, 0.1)
    models = [PowerModel.preset(f"quadriga:{load}:concrete") for load in ("empty", "full")]
    rng = np.random.default_rng(0)

    def free(count: int) -> list[Pose]:
        poses: list[Pose] = []
        while len(poses) < count:
            pose = Pose(*map(float, rng.uniform((1, 1, -np.pi), (39, 29, np.pi))))
            if grid.footprint_free([pose], models[1].vehicle)[0]:
                poses.append(pose)
        return poses

    work = tuple(Task(f"t{k}", pose, 60.0, 100.0) for k, pose in enumerate(free(tasks)))
    docks = tuple(Charger(f"c{k}", pose, 400.0) for k, pose in enumerate(free(2)))
    first = Mission(
        models[0], grid, Battery.preset("quadriga"), Pose(1.0, 1.0, 0.0), work, docks, soc=0.6,
        coefficient_spread=0.05, order="free", planning_effort=2500,
    )  # fmt: skip
    members = tuple(
        Robot(f"r{k}", changes={"start": pose, "model": models[k % 2]})
        for k, pose in enumerate(free(robots))
    )
    begun, wall = time.process_time(), time.perf_counter()
    report = evaluate(replace(first, robots=members))
    print(
        f"{robots} robots, {tasks} tasks with routes: {tasks - len(report.left_out)} done,"
        f" {report.energy / 3600:.0f} Wh,"
        f" {time.process_time() - begun:.1f} s of CPU, {time.perf_counter() - wall:.1f} s"
    )


def by_chance(fleets: int, first: int) -> None:
    """Compare small fleets with the best that is possible."""
    sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / part) for part in ("", "mission")]
    from random_fleets import compared

    found = [compared(seed) for seed in range(first, first + fleets)]
    for one in found:
        if one.excess > 1e-6 or one.lost or one.booked or not one.bound_holds:
            print(one)
    excess = np.array([one.excess for one in found if not np.isnan(one.excess)])
    print(
        f"{fleets} fleets by chance: {np.mean(excess):.3%} above the best on average,"
        f" {np.max(excess):.2%} at worst; in {sum(one.lost > 0 for one in found)} a task is lost,"
        f" in {sum(bool(one.booked) for one in found)} a charger is double booked;"
        f" {sum(one.charges for one in found)} charges,"
        f" {sum(one.waiting > 0 for one in found)} fleets wait for a charger"
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--random"]:
        by_chance(int(sys.argv[2]), int([*sys.argv, "0"][3]))
        sys.exit()
    size = [int(word) for word in sys.argv[1:3]] or [10, 60]
    sums(*size)
    planned(*size)
