"""Free orders: ``python benchmarks/orders.py [COUNT]`` and ``... large [SECONDS] [--out FILE]``.

Random problems on the energies and times of a hall. Those of 13 to 15 tasks have 0 to 3 chargers,
every second one has windows; each row says whether the answer is proven, and the CPU time. Large
ones have 16 to 128 tasks, for one robot and for three, with batteries and windows and without; each
row has the gap to the bound, and, where OR-Tools is installed (``pip install ortools``), what its
guided local search finds on the same matrix in some seconds (30) of processor time. Charging takes
no time there, which OR-Tools could not count. ``--out`` writes the rows into a page.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from energyplan.mission._tour_bound import orders_at_least
from energyplan.mission.order import OrderProblem, shared, solve

METRE, SPEED = 250.0, 0.8
"""Energy of a metre [J], and speed [m/s]."""


def problem(seed: int, tasks: int, chargers: int, windows: bool) -> OrderProblem:
    """Return a problem in a hall of 60 x 40 m, whose battery holds a fifth to all of a tour."""
    rng = np.random.default_rng(seed)
    size = 1 + tasks + chargers
    places = rng.uniform((0, 0), (60, 40), (size, 2))
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    detour = rng.uniform(1.0, 1.25, apart.shape)
    length = apart * np.maximum(detour, detour.T)  # ways round racks are as long in both directions
    energy = METRE * length + 300.0 * rng.uniform(0, 1, apart.shape)  # turns
    np.fill_diagonal(energy, 0.0)
    driving = length / SPEED
    service_time = rng.uniform(30, 300, tasks)
    service = service_time * rng.uniform(10, 100, tasks)
    tour = METRE * 0.75 * np.sqrt(tasks * 60 * 40) + service.sum()
    budget = float(tour * rng.uniform(0.2, 1.0))
    window = np.tile([0.0, np.inf], (tasks, 1))
    if windows:
        whole = tour / METRE / SPEED + service_time.sum()
        pressed = rng.random(tasks) < 0.7
        begin = rng.uniform(0, 1.2 * whole, tasks)
        last = begin + rng.uniform(0.05, 0.4, tasks) * whole
        window[pressed] = np.column_stack([begin, last])[pressed]
    prize = rng.integers(1, 6, tasks).astype(float)
    required = rng.random(tasks) < 0.3
    return OrderProblem(
        option=np.arange(tasks),
        loads=np.zeros(1),
        energy=energy[None, None],
        floor=np.zeros((1, 1, size, size)),
        finish=energy[None, :, [0, *range(1 + tasks, size)]].min(axis=-1),
        time=driving[None],
        finish_time=driving[:, 0],
        service=service,
        service_time=service_time,
        idle=np.zeros(tasks),
        prize=prize + (1.0 + prize.sum()) * required,
        change=np.zeros(tasks),
        window=window,
        budget=budget * float(rng.uniform(0.5, 1.0)),
        capacity=np.full(chargers, 0.95 * budget),
        charge_power=rng.uniform(200, 1000, chargers),
    )


def main(count: int) -> None:
    """Solve random problems and print what came of each."""
    solve(problem(0, 3, 1, True))  # compiled
    proven, times = 0, []
    for seed in range(count):
        tasks, chargers, windows = 13 + seed % 3, seed // 3 % 4, bool(seed % 2)
        asked = problem(seed, tasks, chargers, windows)
        begun = time.process_time()
        found = solve(asked)
        spent = time.process_time() - begun
        times.append(spent)
        done = sum(stop <= tasks for stop in found.stops)
        visits = len(found.stops) - done
        proven += found.proven
        told = "proven" if found.proven else f"not below {found.bound / 3600:.2f} Wh"
        print(
            f"{seed:3d}: {tasks} tasks, {chargers} chargers, {'windows' if windows else '       '}"
            f"  {done:2d} done, {visits:2d} charges, {found.energy / 3600:6.2f} Wh  {told}"
            f"  {spent:6.1f} s of CPU",
            flush=True,
        )
    print(f"{proven} of {count} proven, median {np.median(times):.2f} s of CPU")


# -- large orders ------------------------------------------------------------------------------

LARGE = [
    # tasks, robots, chargers, windows, battery as a part of what one robot would take
    (16, 1, 0, False, np.inf), (31, 1, 0, False, np.inf), (61, 1, 0, False, np.inf),
    (128, 1, 0, False, np.inf), (61, 1, 0, True, np.inf), (128, 1, 0, True, np.inf),
    (31, 1, 2, False, 0.5), (61, 1, 2, False, 0.4), (128, 1, 3, False, 0.4),
    (31, 3, 0, False, np.inf), (61, 3, 0, False, np.inf), (128, 3, 0, False, np.inf),
    (61, 3, 0, True, np.inf), (61, 3, 2, True, 0.2), (128, 3, 3, False, 0.15),
]  # fmt: skip
MISSED = 10**9  # what OR-Tools pays for a task left out [J]
MARK = "<!-- large orders: python benchmarks/orders.py large --out docs/missions.md -->"


def large(
    seed: int, tasks: int, robots: int, chargers: int, windows: bool, battery: float
) -> OrderProblem:
    """Return the problem of one of the robots, which are alike."""
    rng = np.random.default_rng(seed)
    one = problem(seed, tasks, chargers, False)
    whole = METRE * 0.75 * np.sqrt(tasks * 60 * 40) + float(one.service.sum())
    window = np.tile([0.0, np.inf], (tasks, 1))
    if windows:
        lasts = (whole / METRE / SPEED + float(one.service_time.sum())) / robots
        pressed = rng.random(tasks) < 0.4
        begin = rng.uniform(0.0, lasts, tasks)
        last = begin + rng.uniform(0.1, 0.4, tasks) * lasts
        window[pressed] = np.column_stack([begin, last])[pressed]
    return one._replace(
        window=window,
        prize=np.ones(tasks),
        budget=battery * whole,
        capacity=np.full(chargers, 0.95 * battery * whole),
        charge_power=np.full(chargers, 1e9),
    )


def found(one: OrderProblem, robots: int) -> tuple[float, int]:
    """Return the energy of the library's order and how many tasks it leaves out."""
    if robots == 1:
        best = solve(one)
        return best.energy, one.tasks - sum(stop <= one.tasks for stop in best.stops)
    given, _ = shared([one] * robots, one.prize)
    orders = [solve(one.some(tasks)._replace(given=len(tasks) > 15)) for tasks in given if tasks]
    done = sum(
        sum(stop <= len(tasks) for stop in order.stops)
        for order, tasks in zip(orders, filter(None, given), strict=True)
    )
    return sum(order.energy for order in orders), one.tasks - done


def of_ortools(one: OrderProblem, robots: int, seconds: float) -> tuple[float, int] | None:
    """Return what OR-Tools finds on the same matrix; None where it is not installed."""
    try:
        from ortools.constraint_solver import (  # type: ignore[import-not-found,unused-ignore]
            pywrapcp,
            routing_enums_pb2,
        )
    except ImportError:
        return None
    n, m = one.tasks, len(one.capacity)
    nodes = [*range(1 + n), *(1 + n + c for c in range(m) for _ in range(3 * robots))]
    manager = pywrapcp.RoutingIndexManager(len(nodes), robots, 0)
    model = pywrapcp.RoutingModel(manager)
    drives = one.energy[0, 0].copy()
    drives[:, 1 : 1 + n] += one.service
    energy = np.rint(drives).astype(int).tolist()
    finish = np.rint(one.finish[0]).astype(int).tolist()
    lasts = one.time[0] + np.concatenate([[0.0], one.service_time, np.zeros(m)])[:, None]
    seconds_of = np.ceil(lasts).astype(int).tolist()

    def places(here: int, there: int) -> tuple[int, int]:
        return nodes[manager.IndexToNode(here)], nodes[manager.IndexToNode(there)]

    def spent(here: int, there: int) -> int:
        i, j = places(here, there)
        return finish[i] if j == 0 else MISSED if i == j else energy[i][j]

    def timed(here: int, there: int) -> int:
        i, j = places(here, there)
        return int(seconds_of[i][j])

    cost = model.RegisterTransitCallback(spent)
    model.SetArcCostEvaluatorOfAllVehicles(cost)
    for node in range(1, len(nodes)):
        missed = MISSED if nodes[node] <= n else 0
        model.AddDisjunction([manager.NodeToIndex(node)], missed)
    if np.isfinite(one.window[:, 1]).any():
        model.AddDimension(model.RegisterTransitCallback(timed), 10**7, 10**7, False, "time")
        clock = model.GetDimensionOrDie("time")
        for k in np.flatnonzero(np.isfinite(one.window[:, 1])):
            earliest, latest = np.ceil(one.window[k, 0]), np.floor(one.window[k, 1])
            clock.CumulVar(manager.NodeToIndex(int(1 + k))).SetRange(int(earliest), int(latest))
    if np.isfinite(one.budget):
        budget = int(one.budget)
        less = model.RegisterTransitCallback(lambda here, there: -spent(here, there))
        model.AddDimension(less, budget, budget, False, "charge")
        charge: Any = model.GetDimensionOrDie("charge")
        for r in range(robots):
            charge.CumulVar(model.Start(r)).SetValue(budget)
        for index in range(model.Size()):
            if nodes[manager.IndexToNode(index)] <= n:
                charge.SlackVar(index).SetValue(0)
    asked = pywrapcp.DefaultRoutingSearchParameters()
    first = routing_enums_pb2.FirstSolutionStrategy
    asked.first_solution_strategy = first.PARALLEL_CHEAPEST_INSERTION
    search = routing_enums_pb2.LocalSearchMetaheuristic
    asked.local_search_metaheuristic = search.GUIDED_LOCAL_SEARCH
    begun = time.process_time()
    late = model.solver().CustomLimit(lambda: time.process_time() - begun > seconds)
    model.AddSearchMonitor(late)
    asked.time_limit.FromSeconds(100 * int(1 + seconds))  # of the wall's clock
    answer = model.SolveWithParameters(asked)
    if answer is None:
        return np.inf, n
    value = int(answer.ObjectiveValue())
    return float(value % MISSED), value // MISSED


def main_large(seconds: float, page: Path | None) -> None:
    """Solve large problems, compare with OR-Tools, and write the rows into a page."""
    rows = [
        "| tasks | robots | chargers | windows | energy [Wh] | left out | gap [%] | CPU [s] "
        "| OR-Tools [Wh] | left out | less than OR-Tools [%] |",
        "|" + "---|" * 11,
    ]
    solve(problem(0, 3, 1, True))
    print("\n".join(rows), flush=True)
    for seed, (tasks, robots, chargers, windows, battery) in enumerate(LARGE):
        one = large(seed, tasks, robots, chargers, windows, battery)
        begun = time.process_time()
        energy, left = found(one, robots)
        spent = time.process_time() - begun
        gap = "-"
        if not left:
            bound = orders_at_least([one] * robots, [range(tasks)] * robots, energy)
            gap = f"{100 * (1 - bound / energy):z.2f}"
        other = of_ortools(one, robots, seconds)
        compared = "not installed | - | -"
        if other is not None:
            less = f"{100 * (1 - energy / other[0]):z.2f}" if left == other[1] else "-"
            compared = f"{other[0] / 3600:.2f} | {other[1]} | {less}"
        rows.append(
            f"| {tasks} | {robots} | {chargers} | {'yes' if windows else 'no'} "
            f"| {energy / 3600:.2f} | {left} | {gap} | {spent:.1f} | {compared} |"
        )
        print(rows[-1], flush=True)
    if page is not None:
        before, _, after = page.read_text(encoding="utf-8").partition(MARK)
        rest = after.lstrip("\n").split("\n\n", 1)[1] if after.lstrip().startswith("|") else after
        page.write_text(
            f"{before}{MARK}\n\n" + "\n".join(rows) + "\n\n" + rest.lstrip("\n"), encoding="utf-8"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="?", default="36", help="number of small problems, or large")
    parser.add_argument("seconds", nargs="?", type=float, default=30.0, help="of OR-Tools for each")
    parser.add_argument("--out", type=Path, help="page that gets the rows")
    arguments = parser.parse_args()
    if arguments.what == "large":
        main_large(arguments.seconds, arguments.out)
    else:
        main(int(arguments.what))
