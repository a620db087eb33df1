"""What planning may spend, and work that is done side by side within it.

It is units of work, so that the same query gives the same plan under any load; a limit of time is a
cap on top. Threads run in parallel: kernels release Python's global interpreter lock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from math import inf, isfinite
from typing import Any, NamedTuple, TypeVar

from energyplan.compilation import processors
from energyplan.errors import CancelledError, InvalidInputError, TimeLimitError
from energyplan.records import checked

Result = TypeVar("Result")

EFFORT = 30_000  # default units of work for a plan

_MOST_OF_DEFAULT = 4.0  # times the default effort that a plan spends at most while it gains

PACE = 50_000
"""Units of work that count as a second where the two are compared.

A unit is about 20 microseconds of one core: three expansions of a search, or attempts at a path."""


class Units(NamedTuple):
    """Measured units of work per operation."""

    join: float = 0.35  # two poses that are joined, or that are tried to be
    steer: float = 0.04  # two poses whose least cost is looked up
    follow: float = 1.0  # a motion along poses that lie close together
    expansion: float = 0.3  # of the lattice
    state: float = 0.05  # of the search for routes
    step: float = 0.025  # of the search for straight routes
    pose: float = 0.03  # a pose that is tested for collision
    motion: float = 0.07  # a motion that is tested for collision
    drive: float = 350.0  # a path that is timed
    reshaped: float = 150.0  # a path whose turns get other shapes, tested for collision
    nodes: float = 120.0  # of the cost-to-go, for one unit
    steps: float = 12_000.0  # of the lower bound, for one unit


UNITS = Units()


class Shares(NamedTuple):
    """The rule by which what is left of a budget is divided."""

    stage: float = 0.5  # for what every plan needs
    aside: float = 0.25  # for what some plans need, or gain by


SHARES = Shares()

_unwanted: ContextVar[Callable[[], bool]] = ContextVar("unwanted", default=lambda: False)


@contextmanager
def cancellable(unwanted: Callable[[], bool]) -> Iterator[None]:
    """End all planning inside by a `CancelledError` as soon as its result is unwanted.

    Budgets created inside call `unwanted` at every operation, from several threads.
    """
    token = _unwanted.set(unwanted)
    try:
        yield
    finally:
        _unwanted.reset(token)


def end_if_unwanted() -> None:
    """Raise `CancelledError` where what is worked on is unwanted."""
    if _unwanted.get()():
        raise CancelledError("the request was cancelled")


class Budget:
    """What planning may spend.

    Searches and refinements get a budget, spend their work from it, and stop when it is over.
    Parts of a budget spend from the whole.

    Parameters
    ----------
    time_limit : float
        Time from now on [s]; where it is left out, the clock is not read.
    effort : int, optional
        Units of work to spend; where it is left out, the time limit alone counts.

    Raises
    ------
    InvalidInputError
        If either is not positive.

    Examples
    --------
    >>> budget = Budget(effort=1000)
    >>> half = budget.part(0.5)
    >>> half.spend(500)
    >>> half.over, budget.left
    (True, 500.0)
    """

    @checked()
    def __init__(self, time_limit: float = inf, *, effort: int | None = None) -> None:
        if not time_limit > 0:
            raise InvalidInputError(f"time_limit is {time_limit} s; give a positive number")
        if effort is not None and not effort >= 1:
            raise InvalidInputError(
                f"effort is {effort}; give a number of units of work, 1 or more ({PACE} take about "
                "as long as a second)"
            )
        self._begun = time.perf_counter()
        self._spent = [0.0]
        self._grown = [0.0]  # units that a default effort has more, shared by the parts
        self._share = 1.0  # part of these that is this budget's
        self._extended = [0.0]  # units of these that were added since, shared by the parts
        self._grows = False
        self._hurried = [False]
        self._unwanted = _unwanted.get()
        self.effort = effort
        """Units of work to spend; None by the clock."""
        self._end = inf if effort is None else float(effort)
        self._deadline = self._begun + time_limit

    @property
    def spent(self) -> float:
        """Units of work spent, by this budget and all those that share its whole."""
        return self._spent[0]

    @property
    def _whole(self) -> float:
        """Units of work at which the budget ends."""
        return self._end + self._share * self._grown[0]

    @property
    def left(self) -> float:
        """Units of work left; no more than the time left is enough for."""
        units = max(self._whole - self._spent[0], 0.0)
        if not isfinite(self._deadline):
            return units
        timed = max(self._deadline - time.perf_counter(), 0.0) * PACE
        if timed < units:
            self._hurried[0] = True
        return min(units, timed)

    @property
    def hurried(self) -> bool:
        """Whether the clock, not the work, has ended something in this budget or its parts."""
        return self._hurried[0]

    @property
    def over(self) -> bool:
        """Whether nothing is left."""
        return not self.left > 0

    @property
    def elapsed(self) -> float:
        """Time since the budget was created [s]: for reports, never for a decision."""
        return time.perf_counter() - self._begun

    def spend(self, units: float) -> None:
        """Count work that was done, or raise `CancelledError`; see `cancellable`."""
        self._spent[0] += units
        if self._unwanted():
            raise CancelledError("the planning was cancelled")

    def spend_on_map(self, units: float) -> None:
        """Count work that grows with a map; a default effort grows by what exceeds its quarter."""
        if self._grows:
            self._grown[0] += max(units - SHARES.aside * (self.effort or 0), 0.0)
        self.spend(units)

    def extend(self) -> bool:
        """Add half as much again to a default effort, up to four times; return whether it was."""
        units = SHARES.stage * (self.effort or 0)
        most = (_MOST_OF_DEFAULT - 1.0) * (self.effort or 0)
        if not self._grows or self._share < 1.0 or self._extended[0] + units > most:
            return False
        self._extended[0] += units
        self._grown[0] += units
        return True

    @property
    def limit(self) -> int | None:
        """Units of work that may be spent, with those for a large map; None by the clock."""
        return None if self.effort is None else self.effort + round(self._grown[0])

    def _until(self, end: float, deadline: float) -> Budget:
        other = object.__new__(Budget)
        other.__dict__.update(self.__dict__, _end=end, _deadline=deadline)
        return other

    def part(self, share: float) -> Budget:
        """Return a budget that ends when this share of what is left has been used."""
        end, deadline, rest = self._whole, self._deadline, 1.0 - share
        if isfinite(end):
            end -= rest * max(end - self.spent, 0.0)
        if isfinite(deadline):
            deadline -= rest * max(deadline - time.perf_counter(), 0.0)
        other = self._until(end - share * self._share * self._grown[0], deadline)
        other._share = share * self._share
        return other

    def apart(self, units: float) -> Budget:
        """Return a separate budget for work that runs in parallel with other work.

        It ends after so many units, and by the clock when this one does, if that is sooner. What
        it has spent does not count here until it is spent here too, in a fixed order: so the
        result does not depend on the order in which threads run.
        """
        if self.effort is not None:
            other = self._until(min(units, self.left), self._deadline)
        else:
            other = self._until(inf, min(self._deadline, time.perf_counter() + units / PACE))
        other._spent, other._grown = [0.0], [0.0]
        return other

    def beside(self, make: Callable[[], Result]) -> Result:
        """Return a result shared by many plans; the time to compute it extends the deadline."""
        begun = time.perf_counter()
        made = make()
        self._deadline += time.perf_counter() - begun
        return made

    def check(self, done: str) -> None:
        """Raise a `TimeLimitError` that says how far one has got if nothing is left."""
        if self.over:
            raise TimeLimitError(
                f"{self.name} was over when {done}; give more {self.remedy}", self.remedy
            )

    @property
    def name(self) -> str:
        """What ends the budget, in messages: ``time`` or ``the effort``."""
        return "time" if self.effort is None or self.hurried else "the effort"

    @property
    def remedy(self) -> str:
        """The option that gives more: ``time_limit`` or ``effort``."""
        return "effort" if self.name == "the effort" else "time_limit"

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say of a plan that the clock has ended."""
        if self.limit is None or not self.hurried or self.spent >= self.limit:
            return ()
        return (
            f"stopped by the clock after {self.elapsed:.1f} s, with {self.spent:.0f} of "
            f"{self.limit} units of work done; a larger time_limit goes on",
        )


def plan_budget(time_limit: float, effort: int | None, counts: bool = True) -> Budget:
    """Return the budget of a plan, with the default effort where none is given."""
    if effort is None and counts:
        budget = Budget(time_limit, effort=EFFORT)
        budget._grows = True
        return budget
    if effort is None and not isfinite(time_limit):
        time_limit = EFFORT / PACE
    return Budget(time_limit, effort=effort)


UNLIMITED = Budget()  # a budget without end, for work that nobody limits


def side_by_side(
    budget: Budget, tasks: Sequence[Callable[[Budget], Result]], units: float | Sequence[float]
) -> list[Result]:
    """Run some tasks in parallel, each with its own budget.

    The results do not depend on the number of threads, nor on which of them ends first, as long as
    the budget is one of effort.
    """
    if not tasks:
        return []
    threads = min(processors(), len(tasks))
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
    """A task that runs in parallel with others."""

    run: Callable[[Budget], Any]  # does it within a budget, and touches nothing that others touch
    units: float  # units of work that it may spend at most
    take: Callable[[Any], object]  # takes what it returns, when all is done


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
