"""Many evaluations over processes, over a Dask cluster, or over any executor.

Results come as they are ready. An item that fails is reported and the rest go on; a worker that
dies is replaced, and what it was at is done again. What all items have in common travels once to
each worker.
"""

from __future__ import annotations

import os
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass, replace
from importlib import import_module
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from energyplan.errors import EnergyPlanError, MissingDependencyError

# every worker imports this module, and what is run there may be anything: missions are imported
# where they are evaluated
if TYPE_CHECKING:
    from energyplan.mission import Mission, MissionReport
    from energyplan.mission.foresight import RouteKey

T = TypeVar("T")
R = TypeVar("R")

_STRIKES = 2
"""Worker deaths after which an item that was in flight runs on its own."""


class BatchError(EnergyPlanError):
    """An item of a batch failed; the message is that of its error."""


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """What came of one item."""

    index: int  # place of the item among all
    _value: tuple[R, ...]
    error: str = ""  # kind and message of its error
    trace: str = ""  # where the error came from

    @property
    def ok(self) -> bool:
        """Whether it went well."""
        return not self.error

    @property
    def value(self) -> R:
        """The result."""
        if self.error:
            raise BatchError(f"item {self.index} failed: {self.error}")
        return self._value[0]


def run(
    function: Callable[..., R],
    items: Iterable[T],
    *,
    shared: Any = None,
    executor: Executor | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Outcome[R]]:
    """Apply a function to many items, and yield what comes of each as it is ready."""
    place = _place(function, shared, executor, scheduler, workers)
    try:
        yield from _counted(_Flow(place, iter(enumerate(items))), progress)
    finally:
        place.close()


def _counted(
    outcomes: Iterable[Outcome[R]], progress: Callable[[int, int], None] | None
) -> Iterator[Outcome[R]]:
    done = failed = 0
    for outcome in outcomes:
        done, failed = done + 1, failed + (not outcome.ok)
        if progress is not None:
            progress(done, failed)
        yield outcome


def evaluate_variants(
    mission: Mission,
    variants: Iterable[Mapping[str, Any]],
    *,
    executor: Executor | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Outcome[MissionReport]]:
    """Evaluate a mission many times, each time with some of its values changed.

    The routes that the mission will need are planned first, each by one worker, and travel to all
    of them. What a variant needs beyond travels with its report to those that begin later.
    """
    from energyplan.mission.foresight import known_routes, learn_routes

    place = _place(_step, mission, executor, scheduler, workers)
    try:
        routes = known_routes(mission.map)
        wanted = [(pair, ()) for pair in _wanted(mission)]
        for planned in _Flow(place, iter(enumerate(wanted))):
            if planned.ok:
                routes |= planned.value[1]
        learn_routes(mission.map, routes)
        common = place.broadcast(routes)
        late: dict[RouteKey, Any] = {}
        items = ((changes, (common, dict(late))) for changes in variants)
        for outcome in _counted(_Flow(place, iter(enumerate(items))), progress):
            if outcome.ok:
                report, found = outcome.value
                late |= {key: route for key, route in found.items() if key not in routes}
                yield Outcome(outcome.index, (report,))
            else:
                yield outcome
    finally:
        place.close()


def _wanted(mission: Mission) -> list[tuple[int, int, bool]]:
    """Return the routes to plan first; none where the mission as such cannot be evaluated."""
    from energyplan.mission.foresight import routes_wanted

    try:
        return routes_wanted(mission)
    except EnergyPlanError:
        return []  # each variant tells for itself what is wrong


def _step(item: tuple[Any, Any], mission: Mission) -> tuple[Any, dict[RouteKey, Any]]:
    """Plan one route, or evaluate one variant; return what came of it, and the routes planned."""
    from energyplan.mission import evaluate
    from energyplan.mission.foresight import known_routes, learn_routes
    from energyplan.mission.legs import Legs

    asked, routes = item
    for told in routes:
        learn_routes(mission.map, told)
    before = known_routes(mission.map).keys()
    if isinstance(asked, tuple):
        result: Any = None
        start, goal, hurried = asked
        Legs(mission).leg(start, goal, mission.payload, hurried)
    else:
        result = evaluate(replace(mission, **asked))
    known = known_routes(mission.map)
    return result, {key: route for key, route in known.items() if key not in before}


def _place(
    function: Callable[..., Any],
    shared: Any,
    executor: Executor | None,
    scheduler: str | None,
    workers: int | None,
) -> _Place:
    if scheduler is not None:
        return _Cluster(function, shared, scheduler)
    if executor is not None:
        return _Foreign(function, shared, executor)
    return _Pool(function, shared, workers or os.cpu_count() or 1)


# -- where items run -----------------------------------------------------------------------------


class _Place:
    """Where items run."""

    width = 1

    def submit(self, item: Any) -> Future[Any]:
        """Start an item."""
        raise NotImplementedError

    def submit_alone(self, item: Any) -> Future[Any]:
        """Start an item where it can harm no other."""
        return self.submit(item)

    def broadcast(self, value: Any) -> Any:
        """Return what stands for a value in items, so that it travels as seldom as can be."""
        return value

    def mend(self) -> None:
        """Replace what broke."""

    def close(self) -> None:
        """Let go of what was opened."""


class _Pool(_Place):
    """Processes of our own; fresh ones take the place of a pool that broke."""

    def __init__(self, function: Callable[..., Any], shared: Any, workers: int) -> None:
        self._function, self._shared, self.width = function, shared, workers
        self._pool = self._open(workers)

    def _open(self, workers: int) -> ProcessPoolExecutor:
        # Threads of numerical libraries do not survive a fork.
        return ProcessPoolExecutor(
            workers, get_context("spawn"), _install, (self._function, self._shared)
        )

    def submit(self, item: Any) -> Future[Any]:
        return self._pool.submit(_apply_installed, item)

    def submit_alone(self, item: Any) -> Future[Any]:
        with self._open(1) as pool:
            future = pool.submit(_apply_installed, item)
            wait([future])
            return future

    def mend(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._open(self.width)

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)


class _Foreign(_Place):
    """An executor that somebody else opened."""

    def __init__(self, function: Callable[..., Any], shared: Any, executor: Executor) -> None:
        self._function, self._shared, self._executor = function, shared, executor
        self.width = os.cpu_count() or 1

    def submit(self, item: Any) -> Future[Any]:
        return self._executor.submit(_apply, self._function, item, self._shared)


class _Cluster(_Place):
    """A Dask cluster; it moves the items of a worker that died to the others by itself."""

    def __init__(self, function: Callable[..., Any], shared: Any, address: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise MissingDependencyError(
                "a Dask cluster needs dask.distributed; install energyplan[cluster]"
            ) from error
        self._client = distributed.Client(address)
        self._executor = self._client.get_executor(pure=False)
        self.width = max(len(self._client.scheduler_info(n_workers=-1)["workers"]), 1)
        self._function = function
        self._shared = self._client.scatter([shared], broadcast=True)[0]

    def submit(self, item: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(_apply, self._function, item, self._shared)
        return future

    def broadcast(self, value: Any) -> Any:
        return self._client.scatter([value], broadcast=True)[0]

    def close(self) -> None:
        self._client.close()


_installed: list[tuple[Callable[..., Any], Any]] = []
"""The function and what its items share, in a worker process."""


def _install(function: Callable[..., Any], shared: Any) -> None:
    _installed[:] = [(function, shared)]


def _apply_installed(item: Any) -> Any:
    function, shared = _installed[0]
    return _apply(function, item, shared)


def _apply(function: Callable[..., Any], item: Any, shared: Any) -> Any:
    return function(item) if shared is None else function(item, shared)


# -- how they flow -------------------------------------------------------------------------------


@dataclass
class _Flight:
    index: int
    item: Any
    strikes: int = 0


class _Flow:
    """Keeps workers busy and sees to it that every item comes back once."""

    def __init__(self, place: _Place, items: Iterator[tuple[int, Any]]) -> None:
        self._place = place
        self._items = items
        self._again: deque[_Flight] = deque()
        self._flying: dict[Future[Any], _Flight] = {}

    def __iter__(self) -> Iterator[Outcome[Any]]:
        while True:
            yield from self._fill()
            if not self._flying:
                return
            done, _ = wait(self._flying, return_when=FIRST_COMPLETED)
            broken = False
            for future in done:
                flight = self._flying.pop(future)
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    self._again.append(flight)
                    flight.strikes += 1
                    broken = True
                else:
                    yield _outcome(flight.index, future)
            if broken:
                yield from self._rescue()

    def _rescue(self) -> Iterator[Outcome[Any]]:
        """Save what is done from a broken pool, and line up the rest again."""
        wait(self._flying)
        for future, flight in self._flying.items():
            if isinstance(future.exception(), BrokenExecutor):
                flight.strikes += 1
                self._again.append(flight)
            else:
                yield _outcome(flight.index, future)
        self._flying.clear()
        self._place.mend()

    def _fill(self) -> Iterator[Outcome[Any]]:
        """Start items until there is work ahead for every worker."""
        while len(self._flying) < 2 * self._place.width + 2:
            if self._again:
                flight = self._again.popleft()
            else:
                fresh = next(self._items, None)
                if fresh is None:
                    return
                flight = _Flight(*fresh)
            if flight.strikes >= _STRIKES:
                yield _outcome(flight.index, self._place.submit_alone(flight.item))
                continue
            try:
                self._flying[self._place.submit(flight.item)] = flight
            except BrokenExecutor:
                self._again.appendleft(flight)
                if self._flying:
                    return
                self._place.mend()


def _outcome(index: int, future: Future[Any]) -> Outcome[Any]:
    error = future.exception()
    if error is None:
        return Outcome(index, (future.result(),))
    trace = "".join(traceback.format_exception(error))
    return Outcome(index, (), f"{type(error).__name__}: {error}", trace)
