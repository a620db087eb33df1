"""Who does what and charges when, held against an enumeration of everything there is."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from energyplan.fleet.bound import least_energy
from energyplan.fleet.exact import is_small, solve
from energyplan.fleet.problem import RobotProblem
from energyplan.fleet.search import solve_by_search

# -- the enumeration, which shares no code with the library ---------------------------------------


def chargings(tasks: int, chargers: int) -> list[tuple[tuple[int, ...], ...]]:
    """Every way to charge at up to two chargers in a row before, between and after the tasks."""
    one = [(), *((c,) for c in range(chargers)), *permutations(range(chargers), 2)]
    return list(product(one, repeat=tasks + 1))


def plans_of(robot: RobotProblem, tasks: tuple[int, ...]) -> list[list[tuple[str, int]]]:
    """Every order of the tasks with every way to charge that this robot alone could drive."""
    found = []
    if not np.isfinite(robot.energy[:, [1 + task for task in tasks]]).any(axis=0).all():
        return found
    for order in permutations(tasks):
        for stops in chargings(len(order), len(robot.capacity)):
            plan = [("charge", c) for c in stops[0]]
            for task, after in zip(order, stops[1:], strict=True):
                plan += [("task", task), *(("charge", c) for c in after)]
            if simulated([robot], [plan], [99] * len(robot.capacity)) is not None:
                found.append(plan)
    return found


def simulated(
    robots: list[RobotProblem], plans: list[list[tuple[str, int]]], places: list[int]
) -> float | None:
    """Energy of plans that are driven together: an event list in order of time."""
    now = [
        {"at": 0, "left": r.budget, "used": 0.0, "t": r.start_time, "plan": list(plan)}
        for r, plan in zip(robots, plans, strict=True)
    ]
    busy: list[list[float]] = [[] for _ in places]
    n = robots[0].tasks

    def drive(r: int, node: int, energy: float, time: float) -> None:
        one = now[r]
        one["left"] -= energy
        one["used"] += energy
        one["t"] += time
        one["at"] = node

    def until_charger(r: int) -> bool:
        robot, one = robots[r], now[r]
        while one["plan"] and one["plan"][0][0] == "task":
            task = one["plan"].pop(0)[1]
            drive(r, 1 + task, robot.energy[one["at"], 1 + task], robot.time[one["at"], 1 + task])
            if one["t"] > robot.window[task, 1]:
                return False
            rest = max(robot.window[task, 0] - one["t"], 0.0)
            drive(r, 1 + task, robot.idle[1 + task] * rest, rest)
            drive(r, 1 + task, robot.service[task], robot.service_time[task])
            if one["left"] < robot.refuge[1 + task] - 1e-9:
                return False
        if one["plan"]:
            node = 1 + n + one["plan"][0][1]
            drive(r, node, robot.energy[one["at"], node], robot.time[one["at"], node])
        return bool(np.isfinite(one["used"]))

    if not all(until_charger(r) for r in range(len(robots))):
        return None
    while any(one["plan"] for one in now):
        _, r = min((one["t"], r) for r, one in enumerate(now) if one["plan"])
        robot, one = robots[r], now[r]
        charger = one["plan"].pop(0)[1]
        inside = sorted(t for t in busy[charger] if t > one["t"])
        rest = inside[-places[charger]] - one["t"] if len(inside) >= places[charger] else 0.0
        drive(r, one["at"], robot.idle[one["at"]] * rest, rest)
        if one["left"] < -1e-9:
            return None
        full = max(robot.capacity[charger], one["left"])
        one["t"] += (full - one["left"]) / robot.charge_power[charger]
        one["left"] = full
        busy[charger].append(one["t"])
        if not until_charger(r):
            return None
    for r, robot in enumerate(robots):
        last = robot.finish[now[r]["at"]]
        if now[r]["left"] < last - 1e-9:
            return None
        now[r]["used"] += last
    return float(sum(one["used"] for one in now))


def enumerated(
    robots: list[RobotProblem], worth: np.ndarray, places: list[int]
) -> tuple[float, float]:
    """Greatest worth, and least energy with it, of all that can be done."""
    n = len(worth)
    plans = [
        {
            tasks: [
                (simulated([r], [plan], [99] * len(places)), plan) for plan in plans_of(r, tasks)
            ]
            for size in range(n + 1)
            for tasks in _subsets(n, size)
        }
        for r in robots
    ]
    best = (0.0, np.inf)
    for who in product(range(len(robots) + 1), repeat=n):
        value = float(sum(w for w, r in zip(worth, who, strict=True) if r < len(robots)))
        if value < best[0]:
            continue
        mine = [plans[r][tuple(k for k in range(n) if who[k] == r)] for r in range(len(robots))]
        for chosen in product(*mine):
            alone = sum(energy for energy, _ in chosen)
            if (-value, alone) >= (-best[0], best[1]):
                continue  # nobody is quicker for the others being there
            energy = simulated(robots, [plan for _, plan in chosen], places)
            if energy is not None and (-value, energy) < (-best[0], best[1]):
                best = (value, energy)
    return best


def _subsets(n: int, size: int) -> list[tuple[int, ...]]:
    return [s for s in product(range(n), repeat=size) if list(s) == sorted(set(s))]


# -- problems ------------------------------------------------------------------------------------


def drawn(
    rng: np.random.Generator, robots: int, tasks: int, chargers: int, *, budget: float,
    windows: bool = False, idle: float = 0.0, able: float = 0.8,
) -> list[RobotProblem]:  # fmt: skip
    """Robots of different thirst on a plane; the way home is the way back to the start."""
    places = rng.uniform(0, 10, (tasks, 2))
    docks = rng.uniform(3, 7, (chargers, 2))
    service, service_time = rng.uniform(1, 4, tasks), rng.uniform(1, 5, tasks)
    window = np.tile([0.0, np.inf], (tasks, 1))
    if windows:
        window[:, 0] = rng.uniform(0, 15, tasks)
        window[:, 1] = window[:, 0] + rng.uniform(3, 30, tasks)
    found = []
    for _ in range(robots):
        home = rng.uniform(0, 10, 2)
        nodes = np.vstack([home, places, docks])
        apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=-1)
        energy = apart * rng.uniform(1, 2)
        energy[:, 1 : 1 + tasks] += rng.uniform(0, 0.5, tasks)  # not the same back
        back = energy[:, 0]
        energy[:, 1 : 1 + tasks][:, rng.random(tasks) > able] = np.inf
        found.append(
            RobotProblem(
                energy=energy,
                time=apart,
                finish=back,
                finish_time=apart[:, 0],
                refuge=np.minimum(back, energy[:, 1 + tasks :].min(axis=1, initial=np.inf)),
                service=service,
                service_time=service_time,
                idle=np.full(len(nodes), idle),
                window=window,
                budget=budget * rng.uniform(0.6, 1.4),
                capacity=np.full(chargers, 1.2 * budget),
                charge_power=np.full(chargers, 2.0),
            )
        )
    return found


CASES = [
    # robots, tasks, chargers, budget, windows, idle, able, seeds, whether a shared charger matters
    (2, 3, 1, 22.0, False, 0.0, 0.8, range(12), False),
    (2, 3, 1, 18.0, True, 0.3, 0.8, range(12), True),
    (2, 2, 2, 14.0, True, 0.5, 0.8, range(12), False),
    (3, 3, 1, 14.0, False, 0.8, 0.8, range(12), True),
    (3, 4, 0, 40.0, True, 0.2, 0.8, range(8), False),
    pytest.param(3, 7, 0, 45.0, False, 0.0, 0.8, range(1), False, marks=pytest.mark.nightly),
    pytest.param(3, 7, 1, 22.0, False, 0.5, 0.4, range(1), False, marks=pytest.mark.nightly),
    (3, 7, 1, 22.0, True, 0.5, 0.35, range(2, 3), True),
]


@pytest.mark.parametrize(
    ("robots", "tasks", "chargers", "budget", "windows", "idle", "able", "seeds", "matters"), CASES
)
def test_exact_answers_are_those_of_an_enumeration(
    robots: int, tasks: int, chargers: int, budget: float, windows: bool, idle: float, able: float,
    seeds: range, matters: bool,
) -> None:  # fmt: skip
    shared = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        problems = drawn(
            rng, robots, tasks, chargers, budget=budget, windows=windows, idle=idle, able=able
        )
        worth = rng.integers(1, 4, tasks).astype(float)
        value, energy = enumerated(problems, worth, [1] * chargers)
        found = solve(problems, worth, [1] * chargers)
        assert found.proven
        assert found.worth == pytest.approx(value), seed
        assert found.energy == pytest.approx(energy), seed
        roomy = solve(problems, worth, [robots] * chargers)
        shared.append((roomy.worth, roomy.energy) != (found.worth, found.energy))
    assert any(shared) is matters


@pytest.mark.parametrize("seed", range(6))
def test_a_search_is_near_the_best_and_its_bound_below_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problems = drawn(rng, 3, 7, 1, budget=30.0)
    worth = np.ones(7)
    best = solve(problems, worth, [1])
    found = solve_by_search(problems, worth, [1], effort=300)
    assert found.worth == best.worth
    assert best.energy <= found.energy + 1e-9 <= 1.1 * best.energy
    assert not found.proven
    for known in (np.inf, found.energy):
        bound = least_energy(problems, np.arange(7), known)
        assert bound <= best.energy + 1e-6
        assert bound >= 0.5 * best.energy


def test_the_bound_is_tight_where_one_robot_goes_round_a_ring() -> None:
    """Twelve tasks on a ring: the tour along it is the best, and no cut is missing."""
    angle = 2 * np.pi * np.arange(12) / 12
    nodes = np.column_stack([np.cos(angle), np.sin(angle)])
    apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=-1)
    rng = np.random.default_rng(0)
    [one] = drawn(rng, 1, 11, 0, budget=100.0)
    ring = replace(one, energy=apart, finish=apart[:, 0], refuge=apart[:, 0], service=np.zeros(11))
    assert least_energy([ring], np.arange(11)) == pytest.approx(12 * apart[0, 1])
    assert least_energy([ring], np.arange(0)) == 0.0


def test_what_nobody_can_do_is_left_out_and_what_is_worth_less_gives_way() -> None:
    rng = np.random.default_rng(3)
    problems = drawn(rng, 2, 3, 0, budget=100.0, able=1.0)
    far = [replace(p, energy=np.where(np.arange(4) == 2, np.inf, p.energy)) for p in problems]
    found = solve(far, np.ones(3), [])
    assert sorted(stop for stops in found.sequences for stop in stops) == [1, 3]
    weak = [replace(p, budget=0.0) for p in problems]
    assert solve(weak, np.ones(3), []).sequences == ((), ())
    assert is_small(3, 7)
    assert not is_small(10, 60)


def test_the_bound_counts_each_robot_at_its_own_price() -> None:
    """One robot can do the left half of a ring, one of three times its thirst the right half."""
    angle = 2 * np.pi * np.arange(12) / 12
    nodes = np.column_stack([np.cos(angle), np.sin(angle)])
    apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=-1)
    [one] = drawn(np.random.default_rng(0), 1, 11, 0, budget=100.0)
    whole = replace(one, energy=apart, finish=apart[:, 0], refuge=apart[:, 0], service=np.zeros(11))
    left = np.arange(12) > 6
    right = (np.arange(12) <= 6) & (np.arange(12) > 0)
    frugal = replace(whole, energy=np.where(right[None, :] | right[:, None], np.inf, apart))
    thirsty = replace(
        whole, energy=np.where(left[None, :] | left[:, None], np.inf, 3 * apart),
        finish=3 * apart[:, 0], refuge=3 * apart[:, 0],
    )  # fmt: skip
    step, half = apart[0, 1], apart[0, 6]
    alone = step * 5 + apart[0, 7]  # from 0 over 11 to 7, and back across
    other = 3 * (step * 6 + half)
    bound = least_energy([frugal, thirsty], np.arange(11))
    assert bound == pytest.approx(alone + other)
    assert solve([frugal, thirsty], np.ones(11), []).energy == pytest.approx(alone + other)
