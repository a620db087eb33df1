"""Free orders of 13 to 15 tasks: ``python benchmarks/orders.py [COUNT]``.

Random problems with 0 to 3 chargers, every second one with windows, on the energies and times of a
hall. Each row tells whether the answer is proven, the labels that were kept, and the CPU time.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from energyplan.mission.order import OrderProblem, solve

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


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 36)
