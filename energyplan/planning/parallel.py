"""Work side by side in threads: kernels do not hold Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, NamedTuple, TypeVar

from energyplan.planning.budget import Budget

Result = TypeVar("Result")


def workers() -> int:
    """Return how many threads can work at once: the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(len(os.sched_getaffinity(0)), 1)
    return os.cpu_count() or 1


def side_by_side(
    budget: Budget, tasks: Sequence[Callable[[Budget], Result]], units: float | Sequence[float]
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
    units : float or sequence of float
        Units of work that each may spend at most. Where there are not as many, those that ask for
        more than an equal part share what the others leave. By the clock, tasks that take turns get
        their part of the time that is left.

    Returns
    -------
    list
        What the tasks return, in their order.
    """
    if not tasks:
        return []
    threads = min(workers(), len(tasks))
    turns = threads if budget.effort is None else 1
    wanted = units if isinstance(units, Sequence) else [units] * len(tasks)
    shares = _shares([min(own, budget.left) for own in wanted], turns * budget.left)
    counted = [budget.apart(share) for share in shares]

    def run(k: int) -> Result:
        if budget.effort is None:
            counted[k] = budget.apart(shares[k])  # its time begins when it does
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


class Work(NamedTuple):
    """A piece of work among others that are done at once.

    Attributes
    ----------
    run : callable
        Does it within a budget, and touches nothing that others touch.
    units : float
        Units of work that it may spend at most.
    take : callable
        Takes what it returns, when all is done.
    """

    run: Callable[[Budget], Any]
    units: float
    take: Callable[[Any], None]


def do_together(budget: Budget, works: Sequence[Work]) -> None:
    """Do some work at once, then take what came of it in the order given; see `side_by_side`."""
    results = side_by_side(budget, [work.run for work in works], [work.units for work in works])
    for work, result in zip(works, results, strict=True):
        work.take(result)


def _shares(wanted: Sequence[float], total: float) -> list[float]:
    """Return what each gets of a total: what it wants, or an equal part of what others leave."""
    shares = [0.0] * len(wanted)
    for rank, k in enumerate(sorted(range(len(wanted)), key=wanted.__getitem__)):
        shares[k] = min(wanted[k], total / (len(wanted) - rank))
        total -= shares[k]
    return shares
