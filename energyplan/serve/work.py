"""Work that a service does: as much at once as there are cores, the rest in a bounded queue."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from energyplan.errors import CancelledError, EnergyPlanError
from energyplan.planning.budget import cancellable


class BusyError(EnergyPlanError):
    """As much work waits as may wait; try again later."""


class Job:
    """A piece of work: its answer, what it says on its way, and whether it is still wanted."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()
        self.future: Future[Any] = Future()
        self._said: list[dict[str, Any]] = []
        self._changed = threading.Condition()

    def say(self, event: str, **values: Any) -> None:
        """Tell who waits how far the work is; ends the work where nobody waits."""
        if self.cancelled.is_set():
            raise CancelledError("the request was cancelled")
        with self._changed:
            self._said.append({"event": event, **values})
            self._changed.notify_all()

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        """Yield what the work says until it is done."""
        told = 0
        while True:
            with self._changed:
                fresh = self._said[told:]
            for event in fresh:
                yield event
            told += len(fresh)
            if self.future.done() and told == len(self._said):
                return
            await asyncio.sleep(0.05)


class Pool:
    """Threads for work that releases the GIL, with a bounded queue."""

    def __init__(self, workers: int | None = None, waiting: int = 32) -> None:
        self.workers = workers or os.cpu_count() or 1
        self.waiting = waiting
        self._threads = ThreadPoolExecutor(self.workers, thread_name_prefix="energyplan")
        self._held = 0
        self._lock = threading.Lock()

    @property
    def load(self) -> int:
        """Pieces of work that are done or wait."""
        return self._held

    def submit(self, work: Callable[[Job], Any]) -> Job:
        """Have a piece of work done."""
        with self._lock:
            if self._held >= self.workers + self.waiting:
                raise BusyError(f"{self.waiting} requests wait already; try again in a while")
            self._held += 1
        job = Job()

        def run() -> None:
            try:
                if job.cancelled.is_set():
                    raise CancelledError("the request was cancelled")
                job.say("started")
                with cancellable(job.cancelled.is_set):
                    job.future.set_result(work(job))
            except BaseException as error:  # noqa: BLE001  whoever waits is told
                job.future.set_exception(error)
            finally:
                with self._lock:
                    self._held -= 1

        job.say("queued")
        self._threads.submit(run)
        return job

    def close(self) -> None:
        """End it; work that has not begun is dropped."""
        self._threads.shutdown(wait=False, cancel_futures=True)
