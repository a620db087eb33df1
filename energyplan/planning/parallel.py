"""Work side by side in threads: kernels do not hold Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from energyplan.planning.budget import Budget

Result = TypeVar("Result")


def workers() -> int:
    """Return how many threads can work at once: the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(len(os.sched_getaffinity(0)), 1)
    return os.cpu_count() or 1


def side_by_side(
    budget: Budget, tasks: Sequence[Callable[[Budget], Result]], units: float
) -> list[Result]:
    """Do some tasks at once, each with a budget of its own.

    What they do does not depend on how many threads there are, nor on which of them ends first, as
    long as the budget is one of effort.

    Parameters
    ----------
    budget : Budget
        What they may spend together; they spend from it in their order.
    tasks : sequence of callable
        The tasks. None may touch what another one does.
    units : float
        Units of work that each may spend at most. By the clock, tasks that take turns get their
        part of the time that is left.

    Returns
    -------
    list
        What the tasks return, in their order.
    """
    if not tasks:
        return []
    threads = min(workers(), len(tasks))
    turns = threads if budget.effort is None else 1
    share = min(units, budget.left * turns / len(tasks))
    counted = [budget.apart(share) for _ in tasks]

    def run(k: int) -> Result:
        if budget.effort is None:
            counted[k] = budget.apart(share)  # its time begins when it does
        return tasks[k](counted[k])

    if threads == 1:
        results = [run(k) for k in range(len(tasks))]
    else:
        with ThreadPoolExecutor(threads) as pool:
            contexts = [copy_context() for _ in tasks]
            results = list(pool.map(lambda k: contexts[k].run(run, k), range(len(tasks))))
    for own in counted:
        budget.spend(own.spent)
    return results
