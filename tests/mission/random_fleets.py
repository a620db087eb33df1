"""Small fleets by chance, and what is best for them: every share in every order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np
from worlds import tiny

from energyplan.mission import Charger, Mission, MissionReport, Robot, Spreads, Task, evaluate
from energyplan.mission.order import finish
from energyplan.mission.routes import Legs, Routes
from energyplan.mission.single import Evaluation
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel
from energyplan.terrain import OccupancyGrid

HALL = OccupancyGrid(np.zeros((60, 120), bool), 0.25)
PLACES = tuple(
    Pose(*row) for row in np.random.default_rng(1).uniform((2, 2, -3), (28, 13, 3), (9, 3)).tolist()
)
ROUTES = Routes()
"""One map, a few places on it and their routes for all fleets, so that each is planned once."""

MODELS = tuple(
    PowerModel.preset(f"quadriga:{load}:{ground}").with_term(HOTEL, watts)
    for load, ground, watts in (("empty", "marble", 10.0), ("full", "concrete", 30.0))
)


class Best(NamedTuple):
    """What robots that never wait for each other can do at best."""

    prize: float  # of all tasks that are done
    energy: float  # that this takes at least [J]


def fleet(seed: int) -> Mission:
    """Return 2 to 4 unlike robots with 3 or 4 tasks: chargers, windows, skills, prizes."""
    rng = np.random.default_rng(seed)
    places = [PLACES[k] for k in rng.permutation(len(PLACES))]
    count = int(rng.integers(2, 5))
    starts = places.pop(), places.pop()
    tasks = []
    for k in range(int(rng.integers(3, 5))):
        window = (0.0, np.inf)
        if rng.random() < 0.3:
            opens = float(rng.choice([0.0, rng.uniform(0.0, 120.0)]))
            window = (opens, opens + float(rng.uniform(40.0, 400.0)))
        tasks.append(
            Task(
                f"t{k}", places.pop(), float(rng.choice([0.0, 60.0])),
                float(rng.choice([0.0, 40.0])), window=window,
                prize=float(rng.integers(1, 4)), required=bool(rng.random() < 0.3),
                needs=("arm",) if k and rng.random() < 0.25 else (),
            )
        )  # fmt: skip
    docks = tuple(
        Charger(f"c{k}", places.pop(), float(rng.uniform(200.0, 600.0)), until=1.0)
        for k in range(int(rng.integers(1, 3)))
    )
    robots = tuple(
        Robot(
            f"r{k}", ("arm",) if k == 0 or rng.random() < 0.5 else (),
            {
                "start": starts[k % 2], "model": MODELS[int(rng.integers(2))],
                "battery": tiny(float(rng.uniform(2e3, 10e3))), "soc": float(rng.uniform(0.6, 1.0)),
            },
        )
        for k in range(count)
    )  # fmt: skip
    return Mission(
        MODELS[0], HALL, tiny(1e4), starts[0], tuple(tasks), docks, robots=robots, order="free",
        return_to="start", reserve=0.1, confidence=0.5, spreads=Spreads.none(),
        planning_effort=150,
    )  # fmt: skip


def best(mission: Mission) -> Best:
    """Return the best of all shares in all orders, each robot as though it were alone."""
    parts = [_least(part) for part in mission.parts]
    found = Best(0.0, 0.0)
    names = [task.name for task in mission.tasks]
    extra = 1.0 + sum(task.prize for task in mission.tasks)  # required ones go first
    prize = {task.name: task.prize + extra * task.required for task in mission.tasks}
    for owners in product(range(-1, len(parts)), repeat=len(names)):
        energy = sum(
            part.get(frozenset(n for n, o in zip(names, owners, strict=True) if o == r), np.inf)
            for r, part in enumerate(parts)
        )
        gained = sum(prize[n] for n, o in zip(names, owners, strict=True) if o >= 0)
        if energy < np.inf and (-gained, energy) < (-found.prize, found.energy):
            found = Best(gained, float(energy))
    return found


def _least(part: Mission) -> dict[frozenset[str], float]:
    """Return the least energy of each set of tasks that one robot can do, over all orders [J]."""
    found = {frozenset[str](): 0.0}
    for size in range(1, len(part.tasks) + 1):
        for tasks in combinations(part.tasks, size):
            names = frozenset(task.name for task in tasks)
            if any(names - {name} not in found for name in names):
                continue  # not even some of them
            least = min(_driven(part, order) for order in permutations(tasks))
            if least < np.inf:
                found[names] = least
    return found


def _driven(part: Mission, tasks: Sequence[Task]) -> float:
    """Return the energy of tasks in an order; infinite where they cannot all be done [J]."""
    mission = replace(part, tasks=tuple(tasks), order="given")
    one = Evaluation(mission, None, Legs(mission, None, ROUTES))
    one.go()
    last = finish(one.sim, one.end)
    return np.inf if last is None or len(one.done) < len(tasks) else last.total.mean


def prize_of(report: MissionReport) -> float:
    """Return the prize of the tasks that are done, required ones first."""
    tasks = report.mission.tasks
    extra = 1.0 + sum(task.prize for task in tasks)
    left = {task.name for task in report.left_out}
    return sum(task.prize + extra * task.required for task in tasks if task.name not in left)


def double_booked(report: MissionReport) -> list[str]:
    """Return the chargers at which more robots charge at once than have a place there."""
    found = []
    for charger in report.mission.chargers:
        changes = []
        for one in report.robots:
            for stay in one.charges:
                if stay.goal == charger.name and stay.arrival > stay.departure:
                    changes += [(round(stay.departure, 6), 1), (round(stay.arrival, 6), -1)]
        inside = np.cumsum([change for _, change in sorted(changes)])
        if np.any(inside > charger.places):
            found.append(charger.name)
    return found


class Compared(NamedTuple):
    """A fleet's answer beside the best that is possible."""

    seed: int
    robots: int
    tasks: int
    excess: float  # energy above the best of the same prize, as a fraction; NaN for another prize
    lost: float  # prize that the best has beyond
    waiting: float  # time that robots wait for chargers [s]
    charges: int
    booked: tuple[str, ...]  # chargers that are double booked
    bound_holds: bool  # whether the best is within the gap


def compared(seed: int) -> Compared:
    """Return how a fleet's answer compares."""
    mission = fleet(seed)
    report, least = evaluate(mission, routes=ROUTES), best(mission)
    lost = least.prize - prize_of(report)
    same = abs(lost) < 1e-9
    excess = report.energy / least.energy - 1.0 if same and least.energy > 0 else np.nan
    holds = np.isnan(report.gap) or not same or (
        least.energy >= (1.0 - report.gap) * report.energy * (1.0 - 1e-6)
    )  # fmt: skip
    return Compared(
        seed, len(mission.robots), len(mission.tasks), excess, lost,
        sum(one.waiting for one in report.robots),
        sum(len(one.charges) for one in report.robots), tuple(double_booked(report)),
        bool(holds),
    )  # fmt: skip
