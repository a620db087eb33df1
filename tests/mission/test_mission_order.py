"""Orders against brute force, and the search against the exact solution."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from energyplan.mission import order as orders
from energyplan.mission._tour_bound import orders_at_least
from energyplan.mission.order import OrderProblem, loads_of, shared, solve

Stops = tuple[int, ...]


def problem(
    seed: int,
    tasks: int,
    *,
    budget: float = 12.0,
    chargers: int = 0,
    windows: bool = False,
    payload: bool = False,
    required: float = 0.3,
    load: float = 3.0,
) -> OrderProblem:
    """A random problem; asymmetric energies, dearer with more payload."""
    rng = np.random.default_rng(seed)
    size = 1 + tasks + chargers
    places = rng.uniform(0, 3, (size, 2))
    base = np.linalg.norm(places[:, None] - places[None], axis=-1)
    base = base * rng.uniform(1.0, 1.4, base.shape)
    blocked = rng.uniform(size=base.shape) < 0.05
    base[blocked & (np.arange(size)[:, None] != np.arange(size))] = np.inf
    change = rng.uniform(-1, 1, tasks) if payload else np.zeros(tasks)

    loads = loads_of(load, change)
    energy = np.array([[base * (1.0 + 0.2 * carried)] for carried in loads])
    window = np.tile([0.0, np.inf], (tasks, 1))
    if windows:
        window[:, 0] = rng.uniform(0, 8, tasks)
        window[:, 1] = window[:, 0] + rng.uniform(2, 8, tasks)
    time = np.where(np.isfinite(base), base, 1e3)
    service, service_time = rng.uniform(0, 0.5, tasks), rng.uniform(0, 1.0, tasks)
    prize = rng.integers(1, 6, tasks).astype(float)
    return OrderProblem(
        option=np.arange(tasks),
        loads=loads,
        energy=energy,
        floor=np.zeros_like(energy),
        finish=energy[:, 0, :, 0],
        time=time[None],
        finish_time=time[:, 0],
        service=service,
        service_time=service_time,
        idle=np.zeros(tasks),
        payload=load,
        change=change,
        prize=prize + (1.0 + prize.sum()) * (rng.uniform(size=tasks) < required),
        window=window,
        budget=budget,
        capacity=np.full(chargers, 15.0),
        charge_power=np.full(chargers, 5.0),
    )


def scheduled(p: OrderProblem, stops: tuple[int, ...], hurried: tuple[bool, ...]) -> float | None:
    """Energy of a tour whose charges may stop at any time, or None: a linear programme.

    Its variables are the seconds at each charger and the begin of each stop.
    """
    n, m, load, node = p.tasks, len(stops), p.payload, 0
    rows, limits, energy = [], [], 0.0
    left, rate = np.zeros(2 * m), p.budget  # charge on board: coefficients and constant

    def at_most(row: np.ndarray, limit: float) -> None:
        rows.append(row)
        limits.append(limit)

    clock, begun = np.zeros(2 * m), p.start_time  # time on leaving the stop before
    for k, (stop, quick) in enumerate(zip(stops, hurried, strict=True)):
        use, way = p.energy[p.at(load), int(quick), node, stop], p.time[int(quick), node, stop]
        if not np.isfinite(use):
            return None
        energy, rate = energy + use, rate - use
        at_most(-left, rate)
        row = clock.copy()
        row[m + k] -= 1.0
        at_most(row, -begun - way)
        clock, begun = np.eye(2 * m)[m + k], 0.0
        if stop <= n:
            at_most(-clock, -p.window[stop - 1, 0])
            at_most(clock, min(p.window[stop - 1, 1], 1e9))
            energy, rate = energy + p.service[stop - 1], rate - p.service[stop - 1]
            at_most(-left, rate)
            begun = p.service_time[stop - 1]
            load += p.change[stop - 1]
            if load < -1e-3:
                return None
        else:
            left, clock = left.copy(), clock.copy()
            left[k] += p.charge_power[stop - 1 - n]
            clock[k] += 1.0
            at_most(left, max(p.capacity[stop - 1 - n] - rate, 0.0))
        node = stop
    home = p.finish[p.at(load), node]
    if not np.isfinite(home):
        return None
    at_most(-left, rate - home)
    if m == 0:
        return energy + home if rate >= home else None
    solved = linprog(np.zeros(2 * m), A_ub=np.array(rows), b_ub=np.array(limits))
    return energy + home if solved.status == 0 else None


def best_tour(
    p: OrderProblem, energy_of: Callable[[OrderProblem, Stops], float | None]
) -> tuple[float, float]:
    """Worth and energy of the best tour: every order of every subset, with every charge."""
    chargers = range(p.tasks + 1, p.tasks + 1 + len(p.capacity))
    best = (-1.0, np.inf)
    for count in range(p.tasks + 1):
        for order in permutations(range(1, p.tasks + 1), count):
            worth = worth_of(p, order)
            if worth < best[0] - 1e-9 or (p.given and list(order) != sorted(order)):
                continue
            for charges in product((0, *chargers), repeat=count + 1):
                pairs = zip(charges, (*order, 0), strict=True)
                energy = energy_of(p, tuple(stop for pair in pairs for stop in pair if stop))
                if energy is not None and (worth > best[0] + 1e-9 or energy < best[1]):
                    best = worth, energy
    return best


def best_scheduled(p: OrderProblem, stops: Stops) -> float | None:
    """Energy of a tour by the best way of driving each of its legs."""
    ways = product((False, True)[: len(p.time)], repeat=len(stops))
    found = [energy for way in ways if (energy := scheduled(p, stops, way)) is not None]
    return min(found, default=None)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "options",
    [
        {"tasks": 3, "chargers": 1, "budget": 4.0},
        {"tasks": 2, "chargers": 2, "budget": 3.0},
        {"tasks": 3, "budget": 5.0, "payload": True},
        {"tasks": 3, "chargers": 1, "budget": 4.0, "payload": True},
    ],
    ids=["one charger", "two chargers", "hurry", "payload"],
)
def test_charging_stops_early_and_hurry_pays_where_windows_press(seed, options):
    p = problem(seed, windows=True, **options)
    rng = np.random.default_rng(seed)
    window = p.window.copy()
    window[:, 1] = window[:, 0] + rng.uniform(0.5, 4.0, p.tasks)
    changes = {"window": window, "charge_power": rng.uniform(1.0, 6.0, len(p.capacity))}
    if not options.get("chargers"):
        changes |= {"energy": np.concatenate([p.energy, 1.5 * p.energy], axis=1),
                    "time": np.concatenate([p.time, 0.6 * p.time])}  # fmt: skip
    p = p._replace(**changes)
    order = solve(p)
    assert order is not None
    worth, energy = best_tour(p, best_scheduled)
    assert worth_of(p, order.stops) == pytest.approx(max(worth, 0.0))
    if worth >= 0:
        assert order.energy == pytest.approx(energy)
        assert scheduled(p, order.stops, order.hurried) == pytest.approx(energy)


def driven(p: OrderProblem, stops: Stops) -> float | None:
    """Energy of a tour with whole charges, or None where it cannot be driven."""
    left, spent, clock, load, node = p.budget, 0.0, p.start_time, p.payload, 0
    for stop in stops:
        use = p.energy[p.at(load), 0, node, stop]
        clock += p.time[0, node, stop]
        if stop <= p.tasks:
            use += p.service[stop - 1]
        if use > left:
            return None
        left, spent = left - use, spent + use
        if stop <= p.tasks:
            earliest, latest = p.window[stop - 1]
            if clock > latest:
                return None
            clock = max(clock, earliest) + p.service_time[stop - 1]
            load += p.change[stop - 1]
            if load < -1e-3:
                return None
        else:
            filled = max(left, p.capacity[stop - 1 - p.tasks])
            clock += (filled - left) / p.charge_power[stop - 1 - p.tasks]
            left = filled
        node = stop
    home = p.finish[p.at(load), node]
    return None if home > left else spent + home


def worth_of(p: OrderProblem, stops: tuple[int, ...]) -> float:
    return float(sum(p.prize[s - 1] for s in stops if s <= p.tasks))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "options",
    [
        {"tasks": 6, "budget": 6.0},
        {"tasks": 5, "budget": 9.0, "windows": True},
        {"tasks": 5, "budget": 9.0, "payload": True},
        {"tasks": 5, "budget": 30.0, "payload": True, "load": 0.2},
        {"tasks": 3, "budget": 4.0, "chargers": 2},
    ],
    ids=["plain", "windows", "payload", "precedence", "chargers"],
)
def test_equals_brute_force(seed, options):
    p = problem(seed, **options)
    order = solve(p)
    worth, energy = best_tour(p, driven)
    assert order.proven
    assert worth_of(p, order.stops) == pytest.approx(max(worth, 0.0))
    if worth >= 0:
        assert order.energy == pytest.approx(energy)
        assert driven(p, order.stops) == pytest.approx(energy)


def test_nine_tasks_equal_the_best_of_all_orders():
    p = problem(1, 9, budget=1e3, required=1.0)
    # Without a binding budget the answer is the shortest tour, which Held and Karp give.
    matrix = p.energy[0, 0]
    nodes = range(1, 10)
    table = {(1 << (j - 1), j): matrix[0, j] + p.service[j - 1] for j in nodes}
    for mask in range(1, 2**9):
        for j in nodes:
            if (mask, j) in table:
                for k in nodes:
                    if not mask >> (k - 1) & 1:
                        key = (mask | 1 << (k - 1), k)
                        value = table[mask, j] + matrix[j, k] + p.service[k - 1]
                        table[key] = min(table.get(key, np.inf), value)
    best = min(table[2**9 - 1, j] + matrix[j, 0] for j in nodes)
    order = solve(p)
    assert sorted(order.stops) == list(nodes)
    assert order.energy == pytest.approx(best)


@pytest.mark.parametrize("near", [2, 3])
def test_a_far_task_is_reached_from_charger_to_charger(near):
    """There and back over both chargers in a row, whichever of them is listed first."""
    far = 5 - near
    at = np.array([0.0, 8.0, 3.0, 6.0] if near == 2 else [0.0, 8.0, 6.0, 3.0])
    way = np.abs(at[:, None] - at)
    p = small(way.tolist(), budget=4.0, capacity=np.full(2, 4.0))
    found = solve(p)
    assert found.stops == (near, far, 1, far, near)
    assert found.energy == 16.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("options", [{"budget": 1e3}, {"budget": 9.0, "chargers": 1}])
def test_a_search_that_is_not_proven_comes_close(seed, options, monkeypatch):
    p = problem(seed, 11, **options)
    exact = solve(p)
    monkeypatch.setattr(orders, "EXACT", 6)
    found = solve(p)
    assert driven(p, found.stops) == pytest.approx(found.energy)
    assert worth_of(p, found.stops) >= 0.95 * worth_of(p, exact.stops)
    if worth_of(p, found.stops) == worth_of(p, exact.stops):
        assert exact.energy - 1e-9 <= found.energy <= 1.03 * exact.energy
    assert not found.proven


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("options", [{"payload": True}, {"windows": True}, {"chargers": 1}])
def test_a_given_order_is_the_best_that_overtakes_nothing(seed, options):
    """Against every subset in its order, with every charge before, between and after."""
    p = problem(seed, 5, budget=6.0, **options)._replace(given=True)
    found, best = solve(p), best_tour(p, driven)
    assert worth_of(p, found.stops) == pytest.approx(max(best[0], 0.0))
    if not options.get("windows"):  # a charge may stop early for a window
        assert found.energy <= best[1] + 1e-6 or best[0] < 0
    tasks = [s for s in found.stops if s <= p.tasks]
    assert tasks == sorted(tasks)


@pytest.mark.parametrize("seed", range(8))
def test_tasks_given_to_robots_take_little_more_than_the_best_of_all_ways(seed):
    """Nothing is proven: one of these ways may take up to 0.3 % more than the best one."""
    robots = [problem(10 * seed + r, 5, budget=1e3) for r in range(3)]
    ways = [np.nan_to_num(p.energy, posinf=14.4) / 1.6 for p in robots]  # with nothing on board
    robots = [
        p._replace(energy=way, finish=way[:, 0, :, 0]) for p, way in zip(robots, ways, strict=True)
    ]
    worth = np.ones(5)

    def alone(p: OrderProblem, tasks: tuple[int, ...]) -> float:
        tours = [driven(p, tuple(t + 1 for t in order)) for order in permutations(tasks)]
        return min((tour for tour in tours if tour is not None), default=np.inf)

    best = min(
        sum(alone(p, tuple(t for t in range(5) if who[t] == r)) for r, p in enumerate(robots))
        for who in product(range(3), repeat=5)
    )
    own, left = shared(robots, worth)
    assert left == []
    told = [driven(p, tuple(t + 1 for t in tasks)) for p, tasks in zip(robots, own, strict=True)]
    found = sum(tour for tour in told if tour is not None)
    assert best - 1e-9 <= found <= 1.003 * best


def test_a_robot_that_must_do_something_hides_no_tour_of_another_that_cannot_be_driven():
    """Only the first robot brings what it picked up; the second one must not end where it starts.

    To pick up takes the second robot less, but then the first one has nothing to bring.
    """
    p = problem(0, 3, budget=1e3, load=0.0)
    way = np.ones((4, 4))
    other = np.where(np.arange(4) == 2, np.inf, 0.1 * way)  # it does not get to where things go
    first, second = (
        p._replace(
            loads=np.array([0.0, 1.0]), energy=np.tile(e, (2, 1, 1, 1)),
            finish=np.tile(e[:, 0], (2, 1)), floor=np.zeros((2, 1, 4, 4)),
            time=np.ones((1, 4, 4)), finish_time=np.ones(4),
            change=np.array([1.0, -1.0, 0.0]), prize=np.ones(3),
        )
        for e in (np.where(np.eye(4) > 0, 0.0, way), np.where(np.eye(4) > 0, 0.0, other))
    )  # fmt: skip
    nowhere = second.finish.copy()
    nowhere[:, 0] = np.inf
    own, left = shared([first, second._replace(finish=nowhere)], np.ones(3))
    assert left == []
    assert own == [[0, 1], [2]]


def everywhere(seed: int, tasks: int, chargers: int = 0, battery: float = 1e3) -> OrderProblem:
    """A problem all of whose tasks can be done, as energies are everywhere finite."""
    p = problem(seed, tasks, budget=battery, chargers=chargers, required=1.0)
    blocked = 1.6 * 4.0 * 1.4
    return p._replace(
        energy=np.nan_to_num(p.energy, posinf=blocked),
        finish=np.nan_to_num(p.finish, posinf=blocked),
        capacity=np.full(chargers, battery),
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("chargers", [0, 2])
def test_no_order_of_all_tasks_takes_less_than_the_bound(seed, chargers):
    p = everywhere(seed, 6, chargers, 14.0 if chargers else 1e3)
    best = solve(p)
    assert best.proven
    assert _tasks_done(best.stops, 6) == 6
    bound = orders_at_least([p], [range(6)], best.energy)
    assert 0.6 * best.energy <= bound <= best.energy * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_no_robots_that_share_all_tasks_take_less_than_the_bound(seed):
    """Against all ways to share them: each robot may have any set, in its best order."""
    robots = [everywhere(10 * seed + r, 5) for r in range(2)]
    best = np.inf
    for who in product(range(2), repeat=5):
        given = [[t for t in range(5) if who[t] == r] for r in range(2)]
        best = min(best, sum(
            solve(p.some(own)).energy for p, own in zip(robots, given, strict=True) if own
        ))  # fmt: skip
    bound = orders_at_least(robots, [range(5)] * 2, best)
    assert 0.7 * best <= bound <= best * (1 + 1e-9)


@pytest.mark.parametrize(("seed", "tasks"), [(0, 31), (1, 31), (2, 61)])
def test_an_order_of_many_tasks_is_little_above_the_bound(seed, tasks):
    p = everywhere(seed, tasks)
    found = solve(p)
    assert _tasks_done(found.stops, tasks) == tasks
    assert found.energy <= 1.02 * orders_at_least([p], [range(tasks)], found.energy)


def _tasks_done(stops: tuple[int, ...], tasks: int) -> int:
    return len({stop for stop in stops if stop <= tasks})


def pressed(seed: int, tasks: int, chargers: int) -> OrderProblem:
    """A problem whose battery needs charging, with windows on some tasks."""
    p = problem(seed, tasks, budget=6.0, chargers=chargers, windows=True)
    rng = np.random.default_rng(seed)
    window = np.where(rng.random((tasks, 1)) < 0.5, [0.0, np.inf], p.window + np.array([0.0, 10.0]))
    return p._replace(window=window, capacity=np.full(chargers, 6.0))


@pytest.mark.parametrize(("tasks", "chargers"), [(13, 3), (14, 1), (15, 2)])
def test_many_tasks_with_chargers_and_windows_are_proven(tasks, chargers):
    p = pressed(tasks, tasks, chargers)
    order = solve(p)
    assert order.proven
    assert order.bound == pytest.approx(order.energy)
    assert len(order.stops) > 5
    assert scheduled(p, order.stops, order.hurried) == pytest.approx(order.energy)


def test_an_order_without_room_for_its_labels_tells_a_bound():
    bounds, open_ones = 0, 0
    for seed, widths in product(range(8), ((1,), (1, 2), (2, 3))):
        p = pressed(seed, 9, 2)
        best, found = solve(p), solve(p, widths)
        assert best.proven
        if found.stops:
            alone = scheduled(p, found.stops, found.hurried)
            assert alone == pytest.approx(found.energy)
        assert worth_of(p, found.stops) <= worth_of(p, best.stops) + 1e-9
        if not np.isnan(found.bound):
            # the bound tells that no order is worth more
            assert worth_of(p, found.stops) == pytest.approx(worth_of(p, best.stops))
            assert found.bound <= best.energy + 1e-9
            assert best.energy <= found.energy + 1e-9
            bounds += not found.proven
        if found.proven:
            assert found.energy == pytest.approx(best.energy)
        open_ones += not found.proven
    assert bounds > 0
    assert open_ones > bounds  # of some not even the worth is known


def small(energy: list[list[float]], **changes: Any) -> OrderProblem:
    """One task to be visited with no time pressing: nodes are the start, it, and a charger."""
    way = np.array(energy, float)
    return problem(0, 1, chargers=len(way) - 2)._replace(
        energy=way[None, None], finish=way[None, :, 0], time=np.abs(way)[None],
        finish_time=np.abs(way[:, 0]), service=np.zeros(1), service_time=np.zeros(1), **changes,
    )  # fmt: skip


def test_round_trips_that_give_energy_away_are_no_reason_to_leave_anything_out():
    """Down to the charger and up again gives a joule: only a model can do that, but it may."""
    p = small([[0, 2, -3], [2, 0, 2], [2, 2, 0]], capacity=np.array([4.5]), budget=1.0)
    order = solve(p)
    assert order.stops == (2, 1)
    assert order.energy == pytest.approx(-3 + 2 + 2)


@pytest.mark.parametrize(("full", "possible"), [(np.inf, True), (12.0, True), (10.5, False)])
def test_what_comes_back_finds_no_room_in_a_full_battery(full, possible):
    """Down to the task gives 2, up again takes 11.5 of the 10 at the start."""
    p = small([[0, -2], [11.5, 0]], budget=10.0, full=full)
    assert solve(p).stops == ((1,) if possible else ())


@pytest.mark.parametrize("seed", range(6))
def test_a_quicker_way_that_takes_more_helps_only_where_windows_end(seed):
    p = problem(seed, 6, budget=7.0, chargers=1)
    p = p._replace(window=np.column_stack([np.full(6, 3.0), np.full(6, np.inf)]))
    rng = np.random.default_rng(seed)
    dearer = rng.uniform(1.0, 1.5, p.time.shape)
    quicker = rng.uniform(0.3, 1.0, p.time.shape)
    both = p._replace(
        energy=np.concatenate([p.energy, dearer * p.energy], axis=1),
        time=np.concatenate([p.time, quicker * p.time]),
    )
    one, two = solve(p), solve(both)
    assert worth_of(p, two.stops) == worth_of(p, one.stops)
    assert two.energy == pytest.approx(one.energy)


def test_a_charger_that_nothing_leads_to_is_no_trouble():
    p = problem(0, 3, chargers=1, budget=20.0)
    away = p.energy[0, 0].copy()
    away[np.isinf(away)] = 5.0
    away[:4, 4] = away[4, :4] = np.inf
    told = solve(p._replace(energy=away[None, None], finish=away[None, :, 0]))
    assert told.proven
    assert sorted(told.stops) == [1, 2, 3]
