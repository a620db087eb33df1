"""Who charges when: chargers serve those first who come first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from energyplan.fleet.problem import RobotProblem, Status, arrive, begin, charge, do_task, end


class Docks:
    """Chargers with so many places each; robots are served in the order of their arrival.

    Parameters
    ----------
    places : sequence of int
        Places of each charger.
    """

    def __init__(self, places: Sequence[int]) -> None:
        self._free = [np.full(count, -np.inf) for count in places]

    def wait(self, charger: int, arrival: float) -> float:
        """Return how long a robot that arrives now waits for a place [s]."""
        return max(float(self._free[charger].min()) - arrival, 0.0)

    def occupy(self, charger: int, until: float) -> None:
        """Take the place that is free first until a time [s]."""
        self._free[charger][int(self._free[charger].argmin())] = until


class Outcome(NamedTuple):
    """What comes of sequences of stops.

    Parameters
    ----------
    energy : float
        Energy of all robots [J].
    waited : float
        Time spent waiting for chargers [s].
    """

    energy: float
    waited: float


def run(
    problems: Sequence[RobotProblem], sequences: Sequence[tuple[int, ...]], places: Sequence[int]
) -> Outcome | None:
    """Run sequences of stops together.

    Parameters
    ----------
    problems : sequence of RobotProblem
        Each robot's part.
    sequences : sequence of tuple of int
        Each robot's stops: nodes of tasks and chargers.
    places : sequence of int
        Places of each charger.

    Returns
    -------
    Outcome or None
        None where a charge does not suffice or a window is missed.
    """
    docks, waited = Docks(places), 0.0
    left = [list(stops) for stops in sequences]
    states: list[Status | None] = [
        _to_charger(problem, begin(problem), stops)
        for problem, stops in zip(problems, left, strict=True)
    ]
    while True:
        if any(state is None for state in states):
            return None
        waiting = [(state.time, r) for r, state in enumerate(states) if state and left[r]]
        if not waiting:
            break
        arrival, r = min(waiting)
        state, problem = states[r], problems[r]
        charger = left[r].pop(0) - 1 - problem.tasks
        wait = docks.wait(charger, arrival)
        waited += wait
        full = None if state is None else charge(problem, state, wait)
        if full is not None:
            docks.occupy(charger, full.time)
            full = _to_charger(problem, full, left[r])
        states[r] = full
    ended = [end(p, s) for p, s in zip(problems, states, strict=True) if s is not None]
    if any(state is None for state in ended):
        return None
    return Outcome(sum(state.spent for state in ended if state is not None), waited)


def _to_charger(problem: RobotProblem, status: Status, stops: list[int]) -> Status | None:
    """Do tasks up to the arrival at the next charger, which stays in the list."""
    here: Status | None = status
    while stops and here is not None:
        if stops[0] > problem.tasks:
            return arrive(problem, here, stops[0])
        here = do_task(problem, here, stops.pop(0) - 1)
    return here
