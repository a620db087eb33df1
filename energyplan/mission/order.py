"""The best order and subset of tasks, and where to charge: one search, checked by the simulation.

The search (`energyplan.mission._order_kernel`) adds energies up. It begins with what is expected of
each drive and a battery that loses nothing: no order can be better than its answer, and where the
simulated battery lasts for it, it is proven. If not, energies and losses are taken at their bounds,
and then between the two as long as the battery lasts. Routes are planned only where the best order
may use them: energies between places start as lower bounds, the order that is best on them names
the routes to plan, and the order is solved again until it uses planned routes only.

Stages of a free order of up to `EXACT` tasks are the sets of tasks done (the dynamic programme of
Held and Karp, with resources). Beyond, tasks are put in one by one, and then orders near the one
found are searched, in which a task overtakes few others; that is not proven. A given order is one
in which no task overtakes another: its stages are the last tasks done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise, product
from typing import Any, NamedTuple, TypeVar

import numpy as np

from energyplan.mission._order_kernel import (
    Known,
    OrderProblem,
    Rest,
    Stages,
    completions,
    search,
)
from energyplan.mission._tour_bound import orders_at_least
from energyplan.mission._tours_kernel import Tours, share
from energyplan.mission.drive import Attempt, Simulation, Status, Visit
from energyplan.mission.energy import Estimate
from energyplan.mission.routes import Leg, Progress
from energyplan.mission.types import Task
from energyplan.path import ROUNDING, FloatArray

Record = TypeVar("Record", OrderProblem, Stages)

EXACT = 15  # largest number of tasks whose free order is proven


class Ordering(NamedTuple):
    """Constants of the search for an order."""

    most_labels: int = 2**22  # labels of a stage and place that a search keeps at most
    narrow: tuple[int, int] = (1, 8)  # the same of each search beyond `EXACT` tasks
    stages: int = 2**19  # most stages times options squared, beyond `EXACT` tasks
    visits: int = 6  # visits to chargers that bounds distinguish
    least: float = 1e-8  # least difference of prizes
    earlier: float = 1e-5  # prize that the first task of a given order has beyond the last one
    rounds: int = 25  # most rounds of solving and planning
    few_rounds: int = 3  # the same beyond `EXACT` tasks
    shares: int = 8000  # rounds in which tasks are taken out and put in anew, at most
    shares_each: int = 500  # the same for each task
    halves: int = 3  # cautions that are tried between none and full
    least_scale: float = 0.8  # part of its energy that a battery is trusted with at least
    smaller: float = 0.98  # steps down to it
    late: float = 0.5  # share of the bounds of times held back first: few come together
    levels: int = 3  # payloads at which legs are priced where there are many
    most_loads: int = 1024  # payloads that are distinguished at most
    each: int = 64  # most payloads of a problem, and most that each leg is priced with
    alike: float = (
        1e-3  # part of the range of payloads by which those differ that are priced as one
    )
    same: float = 1e-6  # part of an energy by which orders differ that count as one
    # parts of a charge whose mean power counts; those after the first one where time presses
    paces: tuple[tuple[float, float], ...] = ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0))
    lossless: float = 1.0  # power at which a battery loses nothing to its resistance [W]


ORDERING = Ordering()

_WIDTHS = (*ORDERING.narrow, ORDERING.most_labels)  # up to `EXACT` tasks the last one keeps all
_NO_REST = Rest(np.empty((0, 1)), np.empty(0), 0.0)
"""Bound for a prize above that of all tasks: nothing reaches it."""


def prizes(tasks: Sequence[Task]) -> FloatArray:
    """Return the prizes of tasks; that of any required one exceeds all optional ones together."""
    prize = np.array([task.prize for task in tasks], float)
    required = np.array([task.required for task in tasks], bool)
    return prize + np.where(required, 1.0 + prize.sum(), 0.0)


@dataclass(frozen=True)
class Order:
    """An order: nodes in the sequence of their visits, start and end left out."""

    stops: tuple[int, ...] = ()  # nodes
    hurried: tuple[bool, ...] = ()  # whether the way to each stop is driven as quickly as may be
    energy: float = np.inf  # energy of the whole tour [J]
    proven: bool = False  # whether no better order exists on the routes known
    bound: float = np.nan  # energy that no order of this prize undercuts [J]
    gap: float = np.nan  # by which fraction of its energy a better order may exist at most
    visits: tuple[Visit, ...] = field(default=(), compare=False)  # as simulated; none if it fails
    end: Status | None = field(default=None, compare=False)  # None where the battery does not last
    true: bool = False  # whether the search took energies and times of each leg at its payload

    def answer(self, gap: float = np.nan) -> Order:
        """Return the order with its gap."""
        return replace(self, proven=bool(gap <= ORDERING.same), gap=gap)


def solve(problem: OrderProblem, widths: Sequence[int] = _WIDTHS) -> Order:
    """Find the order of greatest prize, and of least energy among those."""
    n = problem.tasks
    if problem.given or n <= EXACT:
        return _searched(problem, widths, 1 if problem.given else n)
    (sequence,), left = shared([problem], problem.prize)
    return _completed(problem, sequence, left)


def _completed(problem: OrderProblem, sequence: Sequence[int], left: Sequence[int]) -> Order:
    """Improve a sequence of more than `EXACT` tasks, those that it leaves out included."""
    n = problem.tasks
    reach = max(int(np.log2(ORDERING.stages / len(problem.option) ** 2)), 1) + 1
    best, prize = Order(), -1.0
    while True:
        turn = _with_left(problem, sequence, left)
        found = _searched(problem.some(turn), ORDERING.narrow, reach)
        options = problem.options(turn)
        stops = tuple(int(options[s - 1]) + 1 if s <= len(options) else s for s in found.stops)
        done = _tasks(problem, stops)
        gained = float(problem.prize[done].sum())
        if gained < prize - ORDERING.least or (
            gained < prize + ORDERING.least and found.energy >= best.energy * (1 - ORDERING.same)
        ):
            return best
        prize, best = gained, replace(found, stops=stops, proven=False, bound=np.nan)
        sequence, left = done, sorted(set(range(n)) - set(done))


def _tasks(problem: OrderProblem, stops: Sequence[int]) -> list[int]:
    """Return the tasks among stops, in their order."""
    return [int(problem.option[s - 1]) for s in stops if s <= len(problem.option)]


def shared(
    problems: Sequence[OrderProblem], prize: FloatArray, own: Sequence[Sequence[int]] | None = None
) -> tuple[list[list[int]], list[int]]:
    """Give tasks to robots by insertion; `own` are the numbers of each one's tasks among all."""
    n = len(prize)
    own = [range(n)] * len(problems) if own is None else own
    tours = _tours(problems, prize, own)
    task = tours.option
    rounds = min(ORDERING.shares, ORDERING.shares_each * n)

    def price(given: list[list[int]]) -> tuple[float, float]:
        """Price what is given by the search for each robot's order, with its charges."""
        energy, done = 0.0, 0.0
        for problem, mine, tasks in zip(problems, given, own, strict=True):
            part = problem.some([list(tasks).index(task) for task in mine])
            found = solve(part._replace(given=len(mine) > EXACT), ORDERING.narrow)
            energy += found.energy
            done += float(sum(prize[mine[task]] for task in _tasks(part, found.stops)))
        return round(-done, 6), energy

    tried = [
        [list(map(int, task[row[:k]])) for row, k in zip(*found, strict=True)]
        for found in (
            share(tours, rounds, 0, open_to_all)
            for open_to_all in ((True, False) if len(problems) > 1 else (True,))
        )
    ]
    best = min(tried, key=price)
    if len(problems) > 1:
        best = _offered(problems, prize, own, best)
    return best, _left(n, best)


def _left(n: int, given: Sequence[Sequence[int]]) -> list[int]:
    """Return the tasks that no robot has."""
    return sorted(set(range(n)) - {task for tasks in given for task in tasks})


def _offered(
    problems: Sequence[OrderProblem], prize: FloatArray, own: Sequence[Sequence[int]],
    given: Sequence[Sequence[int]],
) -> list[list[int]]:  # fmt: skip
    """Offer what is left out to each robot, until none gains a prize by it.

    Insertion has a robot charge once at most between two tasks, to the full or to half of that; the
    search for a robot's order also finds the way over several chargers.
    """
    shares = [list(tasks) for tasks in given]
    r, refused = 0, 0
    while refused < len(problems):
        left = set(_left(len(prize), shares))
        whole = [*shares[r], *(task for task in own[r] if task in left)]
        refused += 1
        if len(whole) > len(shares[r]):
            numbers = list(own[r])
            part = problems[r].some([numbers.index(task) for task in whole])._replace(given=False)
            if len(whole) <= EXACT:
                found = solve(part, ORDERING.narrow)
            else:
                known = len(shares[r])
                found = _completed(part, range(known), range(known, len(whole)))
            done = [whole[task] for task in _tasks(part, found.stops)]
            if prize[done].sum() > prize[shares[r]].sum() + ORDERING.least:
                shares[r], refused = done, 0
        r = (r + 1) % len(problems)
    return shares


def _tours(
    problems: Sequence[OrderProblem], prize: FloatArray, own: Sequence[Sequence[int]]
) -> Tours:
    """Return robots as the insertion reads them; payloads are priced as at the start."""
    n, m, robots = len(prize), len(problems[0].capacity), len(problems)
    each = np.ones(n, int)  # options of each task
    for one, numbers in zip(problems, own, strict=True):
        each[np.array(numbers, int)] = np.bincount(one.option, minlength=one.tasks)
    option = np.repeat(np.arange(n), each)
    size = 1 + len(option) + m
    energy, time = np.full((2, robots, size, size), np.inf)
    finish = np.full((robots, size), np.inf)
    service, idle = np.zeros((2, robots, len(option)))
    window, change = np.tile([0.0, np.inf], (n, 1)), np.zeros(n)
    for r, (one, numbers) in enumerate(zip(problems, own, strict=True)):
        mine = np.array(numbers, int)
        ways = np.concatenate([np.zeros(0, int), *(np.flatnonzero(option == k) for k in mine)])
        nodes = np.array([0, *(ways + 1), *range(1 + len(option), size)])
        load, between = one.at(one.payload), np.ix_(nodes, nodes)
        energy[r][between], time[r][between] = one.energy[load, 0], one.time[0]
        energy[r][:, ways + 1] += one.service
        finish[r, nodes] = one.finish[load]
        service[r, ways], idle[r, ways] = one.service_time, one.idle
        window[mine], change[mine] = one.window, one.change
    # the prize of a task is more than all that any sequence takes
    largest = np.where(np.isfinite(energy), np.abs(energy), 0.0).max(axis=(0, 1)).sum()
    least = float(prize[prize > 0].min()) if np.any(prize > 0) else 1.0
    return Tours(
        option=option,
        energy=energy,
        time=time,
        finish=finish,
        service_time=service,
        window=window,
        idle=idle,
        change=change,
        prize=2.0 * max(float(largest), 1.0) / least * np.asarray(prize, float),
        budget=np.array([one.budget for one in problems], float),
        capacity=np.array([one.capacity for one in problems], float).reshape(robots, m),
        charge_power=np.array([one.charge_power for one in problems], float).reshape(robots, m),
        start_time=np.array([one.start_time for one in problems], float),
        payload=np.array([one.payload for one in problems], float),
    )


def _with_left(problem: OrderProblem, sequence: Sequence[int], left: Sequence[int]) -> list[int]:
    """Return a sequence with the tasks that are left out put in where they add least."""
    energy = _between_tasks(problem)
    whole = list(sequence)
    for task in left:
        nodes = np.array([0, *(k + 1 for k in whole)])
        more = energy[nodes, task + 1]
        if len(nodes) > 1:
            onward = energy[task + 1, nodes[1:]] - energy[nodes[:-1], nodes[1:]]
            more = more + np.append(onward, 0.0)
        whole.insert(int(np.argmin(np.nan_to_num(more, nan=np.inf))), task)
    return whole


def _between_tasks(problem: OrderProblem) -> FloatArray:
    """Return the least energies from start and tasks to each other, over their options."""
    first = 1 + np.searchsorted(problem.option, np.arange(problem.tasks))
    starts, inside = [0, *first], 1 + len(problem.option)
    energy = problem.energy[problem.at(problem.payload), 0, :inside, :inside]
    least = np.minimum.reduceat(np.minimum.reduceat(energy, starts, axis=0), starts, axis=1)
    return np.asarray(least)


def _searched(problem: OrderProblem, widths: Sequence[int], reach: int) -> Order:
    """Find the best order in which a task overtakes fewer than `reach` others."""
    problem, stages = _staged(problem, reach)
    nearest = stages.energy.min(axis=(0, 1))[1 : 1 + len(problem.option)]
    whole = float(problem.prize[np.unique(problem.option[np.isfinite(nearest)])].sum())
    # the first search looks for an order that does everything, and takes what it finds
    more = completions(problem, stages, -1.0)
    known = Known(-1.0, np.inf, np.inf, completions(problem, stages, whole), more, -1.0)
    best, proven, bound = known, False, np.nan
    stops, hurried = np.empty(0, int), np.empty(0, int)
    for width in widths:
        found = search(problem, stages._replace(width=width), known)
        if found.better:
            bound = bound if found.prize < best.prize + ORDERING.least else np.nan
            best = best._replace(prize=found.prize, energy=found.energy, time=found.time)
            stops, hurried = found.stops, found.ways
        if not found.open or best.prize > whole - ORDERING.least:
            bound = np.nanmax([found.bound, bound])
        proven = bool(bound >= best.energy - ROUNDING * abs(best.energy))
        if proven:
            break
        if best.prize >= 0:
            all_of_it = best.prize >= whole - ORDERING.least
            beyond = best.prize + ORDERING.least
            more = _NO_REST if all_of_it else completions(problem, stages, beyond)
            known = best._replace(
                same=completions(problem, stages, best.prize), more=more, beyond=beyond
            )
    energy = best.energy if best.prize >= 0 else 0.0
    nodes, ways = tuple(map(int, stops)), tuple(map(bool, hurried))
    return Order(nodes, ways, energy, proven, bound)


def _sets(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stages of a free order: sets of tasks; for each, what follows, is done, may be."""
    stage = np.arange(2**n)[:, None]
    done = (stage >> np.arange(n) & 1).astype(bool)
    return np.where(done, -1, stage | 1 << np.arange(n)), done, done


def _near(n: int, reach: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the stages of orders in which a task overtakes fewer than `reach` others."""
    wide = 1 << (reach - 1)
    stage, task = np.arange(1 + n * wide)[:, None], np.arange(n)
    last, below = (stage - 1) // wide, (stage - 1) % wide
    last[0], below[0] = -1, 0
    ahead, behind = task - last - 1, last - task - 1
    known = (behind >= 0) & (behind < reach - 1)
    bit = 1 << np.where(known, behind, 0)
    done = (task == last) | (known & (below & bit > 0))
    passed = (task < last) & ~known
    shift = np.clip(ahead, 0, reach)
    grown = np.where(last < 0, 0, ((below << 1 | 1) << shift) & (wide - 1))
    after = np.where(ahead >= 0, 1 + task * wide + grown, np.where(
        known & ~done, 1 + last * wide + (below | bit), -1))  # fmt: skip
    return after, done, done | passed


def _staged(problem: OrderProblem, reach: int) -> tuple[OrderProblem, Stages]:
    """Return the problem without ways that no battery lasts for, and its stages."""
    n, m, options = problem.tasks, len(problem.capacity), len(problem.option)
    free = reach >= n and not problem.given
    after, there, done = _sets(n) if free else _near(n, reach)
    prize, change, service = problem.prize, problem.change, problem.service
    if problem.given:
        prize = prize + ORDERING.earlier * (1.0 - np.arange(n) / max(n, 1))
    loads = np.full(len(after), np.inf)
    index = np.full(len(after), len(problem.loads))
    if free or not change.any():
        loads = problem.payload + done @ change
        index = problem.at(loads)
    energy = np.where(np.isinf(problem.floor), np.inf, problem.energy)
    places = np.arange(1 + options + m)
    energy[..., places, places] = np.inf
    least = energy.min(axis=(0, 1))
    closed = _closed(least)
    need, left = _need(closed, problem.finish.min(axis=0), options), _most_left(problem, closed)
    # no battery lasts for a way from which nothing can be reached
    needed = least + (need + np.concatenate([[0.0], service, np.zeros(m)]))[None, :]
    room = ROUNDING * np.where(np.isfinite(left), np.maximum(np.abs(left), 1.0), 0.0)
    energy[:, :, needed > (left + room)[:, None]] = np.inf
    ends = np.isfinite(problem.window[:, 1])
    idle = np.zeros(n)
    np.maximum.at(idle, problem.option, problem.idle)
    opens = np.where(idle > 0, problem.window[:, 0], -np.inf)
    reached = np.column_stack(
        [np.arange(len(after)) == 0, there[:, problem.option], np.ones((len(after), m), bool)]
    )
    stages = Stages(
        after=after.reshape(len(after), n),
        there=reached,
        done=done @ prize,
        ahead=~done @ prize,
        load=loads,
        load_index=index,
        pressing=np.any(~done & ends, axis=1),
        opening=np.where(done, -np.inf, opens).max(axis=1, initial=-np.inf),
        need=need,
        energy=energy.min(axis=0),
        finish=problem.finish.min(axis=0),
        idle=float(problem.idle.max(initial=0.0)),
        visits=ORDERING.visits,
        most=ORDERING.most_labels,
        width=ORDERING.most_labels,
    )
    return _contiguous(problem._replace(energy=energy, prize=prize)), _contiguous(stages)


def _contiguous(record: Record) -> Record:
    """Return a record whose arrays are as the kernels read them."""
    values: list[Any] = [
        np.require(value, requirements=["C", "W"]) if isinstance(value, np.ndarray) else value
        for value in record
    ]
    return type(record)(*values)


def loads_of(payload: float, change: FloatArray) -> FloatArray:
    """Return the payloads that there may be [kg], or levels between them where they are many."""
    loads = {round(payload, 9)}
    for step in change[change != 0]:
        loads |= {round(load + step, 9) for load in loads}
        if len(loads) > ORDERING.most_loads:
            low, high = change[change < 0].sum(), change[change > 0].sum()
            return np.linspace(max(payload + low, 0.0), payload + high, ORDERING.most_loads)
    return np.array(sorted(loads))


def alike(loads: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest of each group of payloads that hardly differ [kg].

    Rows of nearly one length leave as many payloads as there are sets of them.
    """
    near = ORDERING.alike * float(np.ptp(loads))
    first = [0]
    for k, load in enumerate(loads):
        if load - loads[first[-1]] > near:
            first.append(k)
    return loads[first], loads[[*(k - 1 for k in first[1:]), len(loads) - 1]]


def _through(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Return at some places the polynomials through points; y has shape (n, ...)."""
    others = ~np.eye(len(x), dtype=bool)
    shares = [
        np.prod([(at - b) / (a - b) for b in x[other]], axis=0)
        for a, other in zip(x, others, strict=True)
    ]
    return np.asarray(np.tensordot(np.transpose(shares), y, axes=1))


def _closed(energy: FloatArray) -> FloatArray | None:
    """Return the least energies from place to place over any others; None where nothing is least.

    A round trip that gives energy away may be driven again and again.
    """
    ways = energy.copy()
    np.fill_diagonal(ways, 0.0)
    for k in range(len(ways)):
        ways = np.minimum(ways, ways[:, k : k + 1] + ways[k : k + 1, :])
    return None if np.any(np.diag(ways) < 0) else np.asarray(ways)


def _need(ways: FloatArray | None, finish: FloatArray, options: int) -> FloatArray:
    """Return the charge without which no charger and no end is reached from each place [J]."""
    if ways is None:
        return np.zeros(len(finish))
    last = np.concatenate([finish[: 1 + options], np.zeros(len(finish) - 1 - options)])
    return np.asarray(np.maximum((ways + last[None, :]).min(axis=1), 0.0))


def _most_left(problem: OrderProblem, ways: FloatArray | None) -> FloatArray:
    """Return the charge with which each place can be left at most [J]."""
    size = problem.time.shape[1]
    if ways is None:
        return np.full(size, np.inf)
    full = np.concatenate([[problem.budget], problem.capacity])
    options = len(problem.option)
    most = (full[:, None] - ways[[0, *range(1 + options, size)]]).max(axis=0)
    most[1 : 1 + options] -= problem.service
    return np.asarray(most)


# -- from the simulation to the search, and back -----------------------------------------------


def best_stops(
    sim: Simulation, state: Status | None = None, tasks: Sequence[int] | None = None,
    progress: Progress = None,
) -> Order:  # fmt: skip
    """Find which of some tasks to do in which order from a state on, and where to charge."""
    state = sim.start if state is None else state
    tasks = range(len(sim.mission.tasks)) if tasks is None else tasks
    stops = tuple(node for task in tasks for node in sim.legs.ways(task))
    if sim.mission.order == "given" and len(stops) == len(tasks):
        straight = (False,) * len(stops)
        last, visits = sim.follow(state, stops, straight)
        if sim.arrives(last):
            return Order(stops, straight, proven=True, gap=0.0, visits=visits)
    trials = OrderSearch(sim, state, tuple(tasks), progress)
    if not trials.exact:
        found = trials.at_bounds()
        return found.answer(trials.gap_to_bound(found))
    hope = trials.tried(0.0, ideal=True)
    found, low, high = hope, 0.0, 1.0
    if not trials.gap(hope, hope) <= ORDERING.same:
        found = min(hope, trials.at_bounds(), key=trials.rank)
    for _ in range(ORDERING.halves if sim.quantile > 0 else 0):
        if trials.gap(found, hope) <= ORDERING.same:
            break
        middle = 0.5 * (low + high)
        tried = trials.tried(middle)
        low, high = (middle, high) if tried.end is None else (low, middle)
        found = min(found, tried, key=trials.rank)
    if sim.timed and sim.stations:
        # a charge is the faster the emptier the battery is: other parts of it than the whole
        for pace in ORDERING.paces[1:]:
            if trials.gap(found, hope) <= ORDERING.same:
                break
            others = (trials.tried(caution, pace=pace) for caution in sorted({0.0, low, high}))
            found = min(found, *others, key=trials.rank)
    return found.answer(trials.gap(found, hope))


class OrderSearch:
    """Tries of one search at several cautions, each checked by the simulation."""

    def __init__(
        self, sim: Simulation, state: Status, tasks: tuple[int, ...], progress: Progress
    ) -> None:
        self.sim, self.state, self.tasks, self.progress = sim, state, tasks, progress
        given = sim.mission.order == "given"
        self.exact = given or len(tasks) <= EXACT
        prize = prizes([sim.mission.tasks[k] for k in tasks])
        self._prizes = {
            node: float(one)
            for k, one in zip(tasks, prize, strict=True)
            for node in sim.legs.ways(k)
        }

    def tried(
        self,
        caution: float,
        scale: float = 1.0,
        late: float | None = None,
        ideal: bool = False,
        pace: tuple[float, float] = ORDERING.paces[0],
    ) -> Order:
        """Solve at a caution, plan what is used, and drive what was found."""
        matrix = Matrix(self.sim, self.state, self.tasks, caution, scale, late, ideal, pace)
        order = matrix.solved(self.progress)
        last, visits = self.sim.follow(self.state, order.stops, order.hurried)
        return replace(order, visits=visits, end=self.sim.arrives(last), true=matrix.true)

    def at_bounds(self) -> Order:
        """Return what is found at the bounds of all energies; less battery while it does not last.

        The order is found on energies that add up; the battery holds less at high power.
        """
        scale, found = 1.0, self.tried(1.0, late=ORDERING.late if self.sim.timed else None)
        if found.end is None and self.sim.timed:
            found = self.tried(1.0)
        while found.end is None and found.stops and scale > ORDERING.least_scale:
            scale *= ORDERING.smaller
            found = self.tried(1.0, scale)
        return found

    def prize(self, order: Order) -> float:
        """Return the prize of an order."""
        return float(sum(self._prizes.get(stop, 0.0) for stop in order.stops))

    def rank(self, order: Order) -> tuple[bool, float, float]:
        """Sort what can be driven by its prize and energy."""
        if order.end is None:
            return True, 0.0, 0.0
        return False, -round(self.prize(order), 6), order.end.total.mean

    def gap(self, found: Order, hope: Order) -> float:
        """Return by which fraction of an order's energy a better one may exist at most."""
        if (
            found.end is None
            or not hope.true
            or self.prize(found) < self.prize(hope) - ORDERING.same
        ):
            return float(np.nan)
        spent = found.end.total.mean - self.state.total.mean
        if spent <= 0:
            return 0.0 if spent <= hope.bound + ORDERING.same else float(np.nan)
        return max(1.0 - hope.bound / spent, 0.0)

    def gap_to_bound(self, found: Order) -> float:
        """Return the gap of an order of all tasks to a bound of any such order."""
        whole = sum(prizes([self.sim.mission.tasks[k] for k in self.tasks]))
        if found.end is None or self.prize(found) < whole - ORDERING.same:
            return float(np.nan)
        matrix = Matrix(self.sim, self.state, self.tasks, 0.0, ideal=True)
        spent = found.end.total.mean - self.state.total.mean
        return gap_of([matrix], [range(len(self.tasks))], spent)


def gap_of(matrices: Sequence[Matrix], own: Sequence[Sequence[int]], spent: float) -> float:
    """Return by which fraction of what was spent on all tasks robots may do with less at most."""
    if not (spent > 0 and all(one.bounds_loads for one in matrices)):
        return float(np.nan)
    bound = orders_at_least([one.problem() for one in matrices], own, spent)
    return max(1.0 - bound / spent, 0.0) if np.isfinite(bound) else float(np.nan)


class Matrix:
    """Energies between places, known or bounded, and the energy that the battery holds.

    With a caution of 0 all is as expected; with 1 all is at its bound, as the battery feels it.
    Times may have a caution of their own, `late`. An ideal battery loses nothing, and waiting for
    a window then takes nothing: that bounds all orders.
    """

    def __init__(
        self, sim: Simulation, state: Status, tasks: Sequence[int], caution: float,
        scale: float = 1.0, late: float | None = None, ideal: bool = False,
        pace: tuple[float, float] = ORDERING.paces[0],
    ) -> None:  # fmt: skip
        self._sim, self._state, self._tasks = sim, state, tuple(tasks)
        self._caution, self._scale, self._ideal = caution, scale, ideal
        self._late = caution if late is None else late
        each = [sim.legs.ways(task) for task in tasks]
        self._option = np.repeat(np.arange(len(each)), [len(ways) for ways in each])
        self._ways = [node for ways in each for node in ways]  # nodes of the options
        self.nodes = [state.node, *self._ways, *sim.stations]
        self.exact = sim.mission.order == "given" or len(tasks) <= EXACT
        self._change = np.array([sim.mission.tasks[task].change for task in tasks], float)
        least, self._loads = alike(loads_of(state.payload, self._change))
        # the lighter one bounds all orders; what cannot be carried is never reached
        self._able = np.maximum(least if ideal else self._loads, 0.0)
        self._inflation = 1.0
        self._power = sim.legs.driving_power
        self._pace = pace
        self._places = sorted({*self.nodes, *sim.ends})
        self._at = {node: k for k, node in enumerate(self._places)}
        self._inner = np.array([self._at[node] for node in self.nodes])
        self._ends = np.array([self._at[node] for node in sim.ends])
        size = len(self._places)
        # of each way to drive them; NaN where no route is planned
        self._known = np.full((len(sim.ways), len(self._able), size, size), np.nan)
        self._left = np.zeros(self._known.shape)  # charge to be left after each [J]
        self._lasting = self._straight()
        pairs = product(self._places, repeat=2)
        self._fill((i, j) for i, j in pairs if sim.legs.planned(i, j))

    @property
    def true(self) -> bool:
        """Whether energies and times of an order are those of its legs at each payload."""
        each = len(self._able) <= ORDERING.each or self._lighter
        return len(self._able) == 1 or (self.exact and each and not self._sim.timed)

    @property
    def _lighter(self) -> bool:
        """Whether no energy rises where the payload falls."""
        return self._sim.mission.heights is None

    @property
    def bounds_loads(self) -> bool:
        """Whether no energy is less than that with the smallest payload."""
        return len(self._able) == 1 or self._lighter

    # -- energies ---------------------------------------------------------------------------------

    def _fill(self, routes: Iterable[tuple[int, int]]) -> None:
        """Take over energies, charges to be left and times of routes that are planned."""
        legs, sim = self._sim.legs, self._sim
        slower = 1.0 + self._late * sim.quantile * sim.mission.spreads.speed
        for i, j in routes:
            a, b = self._at[i], self._at[j]
            if not np.isnan(self._known[0, 0, a, b]):
                continue
            for way, quick in enumerate(sim.ways):
                priced = self._over_loads(partial(self._leg, i, j, quick))
                self._known[way, :, a, b], self._left[way, :, a, b] = priced
                duration = legs.leg(i, j, self._state.payload, quick).duration
                self._lasting[way, a, b] = slower * duration

    def _leg(self, i: int, j: int, quick: bool, payload: float) -> Leg:
        return self._sim.legs.leg(i, j, payload, quick)

    def _over_loads(
        self, price: Callable[[float], Leg], least: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return the energy of a drive with each payload, and the charge to be left after it [J].

        The energy is a polynomial of the payload where the drive is timed alike: few payloads are
        priced, and the others follow where one more agrees with them. `least` is what the drive
        needs on board [kg].
        """
        loads, same = np.unique(np.maximum(self._able, least), return_inverse=True)
        known = dict[int, Leg]()

        def felt(k: int) -> FloatArray:
            if k not in known:
                known[k] = price(float(loads[k]))
            energy = known[k].energy
            if self._caution and np.isfinite(energy.mean):
                energy = self._sim.legs.from_battery(energy)
            return np.array([energy.mean, energy.noise, *energy.sensitivity])

        def between(first: int, last: int) -> FloatArray:
            if last - first <= ORDERING.levels:
                return np.array([felt(k) for k in range(first, last + 1)])
            middle = (first + last) // 2
            few = np.array([first, middle, last])
            there = np.array([felt(k) for k in few.tolist()])
            if np.isfinite(there).all():
                found = _through(loads[few], there, loads[first : last + 1])
                if not self.exact:
                    return found
                tried = (first + middle) // 2
                now, then = felt(tried)[0], found[tried - first, 0]
                if abs(now - then) <= ROUNDING * abs(then):
                    return found
            elif not self.exact:
                return np.full((last - first + 1, there.shape[1]), np.inf)
            return np.concatenate([between(first, middle)[:-1], between(middle, last)])

        energies, few = between(0, len(loads) - 1), sorted(known)
        spread = np.sqrt((energies[:, 2:] ** 2).sum(axis=1) + energies[:, 1])
        prices = energies[:, 0] + self._caution * self._sim.quantile * spread
        power, after = np.transpose([self._peak(known[k]) for k in few])
        floors = self._floor(power) - after
        below = np.searchsorted(few, np.arange(len(loads)), "right") - 1
        left = floors[below]
        if not self._ideal:
            above = floors[np.searchsorted(few, np.arange(len(loads)))]
            finite = np.isfinite(left) & np.isfinite(above)
            between_them = np.interp(loads, loads[few], np.nan_to_num(floors, posinf=0.0))
            left = np.where(finite, between_them, np.maximum(left, above))
        return prices[same], left[same]

    @cached_property
    def _bounds(self) -> FloatArray:
        """Energies that no route undercuts, with each payload, shape (L, P, P)."""
        legs, grid, loads = self._sim.legs, np.ix_(self._places, self._places), self._able
        few = len(loads) <= (ORDERING.each if self.exact else ORDERING.levels)
        count = ORDERING.each if self.exact else ORDERING.levels
        levels = loads if few else np.linspace(loads[0], loads[-1], count)
        bounds = np.array([legs.lower_bounds(float(level))[grid] for level in levels])
        if self.exact and self._lighter:
            return np.asarray(bounds[np.searchsorted(levels, loads, "right") - 1])
        blocked = np.isinf(bounds).any(axis=0)
        found = _through(levels, np.where(blocked, 0.0, bounds), loads) if not few else bounds
        return np.where(blocked, np.inf, found)

    @cached_property
    def _rows(self) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Energies of the drives along paths, and charges to be left, by place."""
        found = {}
        for k, node in zip(self._option, self._ways, strict=True):
            if self._sim.legs.row(node, self._state.payload) is not None:
                price = partial(self._row, node)
                found[self._at[node]] = self._over_loads(price, max(-self._change[k], 0.0))
        return found

    def _row(self, node: int, payload: float) -> Leg:
        row = self._sim.legs.row(node, payload)
        assert row is not None
        return row

    def _between(self) -> tuple[FloatArray, FloatArray]:
        """Energies from place to place, and charges to be left after each; (M, L, P, P).

        Those of a way to a path include the drive along it.
        """
        known, left = self._known, self._left.copy()
        energy = np.where(np.isnan(known), self._inflation * self._bounds, known)
        service = dict(zip(self._ways, self._fixed["service"], strict=True))
        for j, (more, after) in self._rows.items():
            energy[..., j] += more[:, None]
            last = after + service[self._places[j]]
            before = left[..., j] - np.where(np.isfinite(more), more, 0.0)[:, None]
            left[..., j] = np.maximum(before, last[:, None])
        energy[np.isinf(left)] = np.inf
        return energy, np.maximum(left, 0.0)

    def _peak(self, leg: Leg) -> tuple[float, float]:
        """Return the largest power of a drive [W], and the energy that it takes after it [J]."""
        if leg.trajectory is None or leg.trouble:
            return 0.0, 0.0
        load, spans = leg.consumption, np.diff(leg.trajectory.t)
        power = load.power + self._caution * self._sim.quantile * load.spread
        last = int(power.argmax())
        return float(power[last]), float(power[last:] @ spans[last:])

    def _floor(self, power: FloatArray, lasting: FloatArray | float = 0.0) -> FloatArray:
        """Return the energy on board at which the battery delivers powers [J]; above the reserve.

        It is infinite where not even a full battery does.
        """
        supply, reserve = self._sim.legs.supply, self._sim.mission.reserve
        least = supply.least_charge(power, 0.0 if self._ideal else lasting)
        floor = np.where(np.isinf(least), np.inf, 0.0)
        some = (least > reserve) & np.isfinite(least)
        if some.any():
            floor[some] = self._scale * (self._held(least[some]) - self._stored(reserve, reserve))
        return np.maximum(floor, 0.0)

    def _priced(self, energy: Estimate) -> float:
        """Return what an energy counts, as the battery feels it."""
        if not self._caution or not np.isfinite(energy.mean):
            return energy.mean
        felt = self._sim.legs.from_battery(energy)
        return felt.upper(self._caution * self._sim.quantile)

    def _straight(self) -> FloatArray:
        """Return the times between places straight on at full speed, for each way to drive."""
        legs = self._sim.legs
        speed = legs.scene(self._state.payload).cost.admissible_speed(0.0)
        starts, goals = (np.array(ends)[self._places, :2] for ends in (legs.exits, legs.poses))
        distance = np.linalg.norm(starts[:, None] - goals[None], axis=-1)
        slower = self._sim.quantile * self._sim.mission.spreads.speed
        return np.array(
            [distance / float(speed) * (1.0 + self._late * slower)] * len(self._sim.ways)
        )

    # -- the problem ------------------------------------------------------------------------------

    @cached_property
    def _fixed(self) -> dict[str, FloatArray]:
        """What no route and no payload changes: energies and times of the options."""
        sim, mission, payload = self._sim, self._sim.mission, self._state.payload
        models, service, lasting, idle = sim.legs.models, [], [], []
        for node in self._ways:
            region, k = sim.legs.region(node), sim.legs.task_at(node)
            done = models.waited(region, k, payload) + models.work(region, k, payload)
            service.append(self._priced(done))
            seconds, late = sim.legs.lasting(node, payload)
            spread = np.linalg.norm(models.waiting_time(k) + late)
            more = self._late * sim.quantile * float(spread)
            lasting.append(mission.waiting + seconds + more)
            idle.append(0.0 if self._ideal else self._priced(models.idle(region, 1.0, payload)))
        return {"service": np.array(service, float), "service_time": np.array(lasting, float),
                "idle": np.array(idle, float)}  # fmt: skip

    @cached_property
    def _of_tasks(self) -> FloatArray:
        """Charge with which each option must end for the battery to deliver its power [J]."""
        sim, power, lasting = self._sim, [], []
        models, upper = sim.legs.models, self._caution * sim.quantile
        for node in self._ways:
            k = sim.legs.task_at(node)
            dwell = sim.mission.tasks[k].dwell
            work = models.work(sim.legs.region(node), k, self._state.payload)
            power.append(work.upper(upper) / dwell if dwell > 0 else 0.0)
            lasting.append(dwell)
        return self._floor(np.array(power, float), np.array(lasting, float))

    @cached_property
    def _chargers(self) -> tuple[FloatArray, FloatArray]:
        """Energy with which each charger is left at most, and energy stored in a second there."""
        sim, supply, full, rate = self._sim, self._sim.legs.supply, [], []
        reserve = self._stored(sim.mission.reserve, sim.mission.reserve)
        for node in sim.stations:
            one = sim.mission.chargers[node - sim.legs.chargers.start]
            until = one.until + self._caution * (sim.at_least(one.until) - one.until)
            if self._ideal:
                full.append(self._stored(until, until) - reserve)
                rate.append(supply.fastest(one))
                continue
            filled = supply.charge(min(sim.mission.reserve, until), until, one)
            full.append(float(self._held(filled.charge[-1])) - reserve)
            # the mean of the part of the charge that is concerned
            ends = filled.charge[0] + np.ptp(filled.charge) * np.array(self._pace)
            spans = np.interp(ends, filled.charge, filled.time)
            held = self._held(ends)
            fallback = supply.fastest(one) * sim.mission.battery.charge_efficiency
            typical = spans[1] > spans[0] and held[1] > held[0]
            rate.append(float(np.diff(held)[0] / np.diff(spans)[0]) if typical else fallback)
        return self._scale * np.array(full, float), np.array(rate, float)

    def problem(self) -> OrderProblem:
        """Return the order problem on what is known now."""
        sim, mission, state = self._sim, self._sim.mission, self._state
        tasks = [mission.tasks[k] for k in self._tasks]
        reserve = self._stored(mission.reserve, mission.reserve)
        here = self._inner[:, None]
        late = self._late * sim.quantile * state.time_spread
        energy, left = (np.swapaxes(one, 0, 1) for one in self._between())
        floor, options = left[..., here, self._inner], slice(1, 1 + len(self._ways))
        floor[..., options] -= self._fixed["service"]
        floor[..., options] = np.maximum(floor[..., options], self._of_tasks)
        return OrderProblem(
            **self._fixed,
            option=self._option,
            loads=self._loads,
            energy=energy[..., here, self._inner],
            finish=energy[:, 0][..., here, self._ends].min(axis=-1),
            time=self._lasting[..., here, self._inner],
            finish_time=self._lasting[0][here, self._ends].min(axis=-1),
            payload=state.payload,
            change=self._change,
            prize=prizes(tasks),
            window=np.array([task.window for task in tasks], float).reshape(-1, 2),
            budget=self._scale * (self._stored(state.expected.soc, state.worst.soc) - reserve),
            capacity=self._chargers[0],
            charge_power=self._chargers[1],
            floor=floor,
            start_time=state.time + late,
            full=self._scale * (self._stored(1.0, 1.0) - reserve),
            given=mission.order == "given",
        )  # fmt: skip

    def _stored(self, expected: float, least: float) -> float:
        """Return the energy that the battery gives from a state of charge to empty [J]."""
        return float(self._held(np.asarray(expected + self._caution * (least - expected))))

    def _held(self, charge: FloatArray) -> FloatArray:
        """Return the energies that the battery gives from states of charge on [J]."""
        power = ORDERING.lossless if self._ideal else self._power
        return self._sim.legs.supply.stored(power, charge)

    # -- routes -----------------------------------------------------------------------------------

    def used(self, problem: OrderProblem, order: Order) -> list[tuple[int, int]]:
        """Routes that an order uses, the way to its end included."""
        here = [0, *order.stops]
        done = [self._option[s - 1] for s in order.stops if s <= len(self._ways)]
        load = problem.at(self._state.payload + self._change[done].sum())
        finish = self._between()[0][0, load][self._inner[here[-1]], self._ends]
        places = [self.nodes[k] for k in here]
        return [*pairwise(places), (places[-1], self._sim.ends[int(finish.argmin())])]

    def plan(self, wanted: Sequence[tuple[int, int]]) -> None:
        """Plan some routes."""
        legs, payload, ratios = self._sim.legs, float(self._able[-1]), []
        for i, j in wanted:
            leg, bound = self._leg(i, j, False, payload), self._bounds[-1, self._at[i], self._at[j]]
            if np.isfinite(leg.energy.mean) and bound > 0:
                ratios.append(self._priced(leg.energy) / bound)
        both = [*wanted, *((j, i) for i, j in wanted)]  # one plan may serve both
        self._fill(one for one in both if legs.planned(*one))
        if not self.exact and ratios:
            # a search cannot wait for all bounds to become true: let them be typical instead
            self._inflation = float(np.median(ratios))

    def missing(self, problem: OrderProblem, order: Order) -> list[tuple[int, int]]:
        """Return the routes of an order that are not planned."""
        return [
            (i, j)
            for i, j in self.used(problem, order)
            if np.isnan(self._known[0, 0, self._at[i], self._at[j]])
        ]

    def solved(self, progress: Progress) -> Order:
        """Solve and plan the routes of the answer until it uses planned routes only.

        The answer is proven where that point is reached with an exact order. Its stops are nodes.
        """
        order, missing = Order(), []
        for turn in range(ORDERING.rounds if self.exact else ORDERING.few_rounds):
            problem = self.problem()
            order = solve(problem)
            missing = self.missing(problem, order)
            if progress is not None:
                progress(
                    f"order {turn + 1}: {len(order.stops)} stops, {order.energy / 3600:.1f} Wh, "
                    f"{len(missing)} routes to plan"
                )
            if not missing:
                break
            self.plan(missing)
        nodes = tuple(self.nodes[stop] for stop in order.stops)
        return replace(order, stops=nodes, proven=order.proven and not missing)


def attempt(sim: Simulation, state: Status, task: int) -> Attempt:
    """Try a task, in a hurry or after charging where it cannot be done otherwise."""
    best = sim.nearest(state, task)
    if best.reason == "late" and len(sim.ways) > 1:
        hurried = sim.nearest(state, task, hurried=True)
        best = best if hurried.reason == "late" else hurried
    if best.reason != "battery" or not sim.stations:
        return best
    found = best_stops(sim, state, (task,))
    ways = sim.legs.ways(task)
    for at in (k for k, stop in enumerate(found.stops) if stop in ways):
        ready, _ = sim.follow(state, found.stops[:at], found.hurried[: at + 1], found.stops[at])
        done = best if ready is None else sim.attempt(ready, found.stops[at], found.hurried[at])
        if done.reason == "none":
            return done
    # what is missing is reported from where the least is
    for charger in sim.stations:
        docked = sim.dock(state, charger)
        if docked is not None:
            tried = sim.nearest(sim.charge(docked), task)
            best = min(best, tried, key=sim.missing)
    return best


def finish(sim: Simulation, state: Status) -> Status | None:
    """Drive to where the mission may end, charging on the way if need be; None if it cannot."""
    last = sim.arrives(state)
    if last is not None or not sim.stations:
        return last
    found = best_stops(sim, state, ())
    return sim.arrives(sim.follow(state, found.stops, found.hurried)[0])
