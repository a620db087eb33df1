"""Kernels that several processes compile side by side: who compiles which, and when."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from energyplan.compilation.kernel import Kernel


class Pool:
    """Kernels to compile, handed out when all that they call is there.

    This process and others take from it. What this process calls before its turn it compiles at
    once, or waits for where another process has begun with it: nothing is compiled twice.
    """

    def __init__(self, say: Callable[[str, int, int], None]) -> None:
        self.seconds: dict[Kernel, float] = {}
        """Time [s] that each kernel took which was handed out and is done."""
        self._say = say
        self._condition = threading.Condition()
        self._stopped = False
        self._waiting: dict[Kernel, set[Kernel]] = {}
        self._here: set[Kernel] = set()
        self._elsewhere: set[Kernel] = set()
        self._rank: dict[Kernel, tuple[bool, int]] = {}

    @property
    def total(self) -> int:
        """How many kernels there are, with those that are done."""
        begun = len(self._here) + len(self._elsewhere)
        return len(self.seconds) + begun + len(self._waiting)

    def add(self, kernels: Collection[Kernel], *, urgent: bool) -> None:
        """Add kernels that are not there yet, each after those that it calls."""
        with self._condition:
            # how much there is to do from a kernel to the end, by the size of the sources
            rest: dict[Kernel, int] = {}
            for kernel in reversed(list(kernels)):
                after = [rest[k] for k in rest if kernel in k.called]
                rest[kernel] = len(kernel.py_func.__code__.co_code) + max(after, default=0)
                before, _ = self._rank.get(kernel, (False, 0))
                self._rank[kernel] = urgent or before, rest[kernel]
            new = set(kernels) - self._elsewhere - self._waiting.keys() - self.seconds.keys()
            unfinished = new | self._elsewhere | self._waiting.keys()
            for kernel in kernels:
                if kernel in new:
                    self._here.discard(kernel)  # who was at it has failed, or is about to end it
                    self._waiting[kernel] = {c for c in kernel.called if c in unfinished}
            self._condition.notify_all()

    def take(self, until: Collection[Kernel] | None = None) -> Kernel | None:
        """Return the next kernel, as soon as one can be compiled."""
        begun = self._elsewhere if until is None else self._here
        with self._condition:
            while not self._stopped:
                if until is not None and not self._unfinished(until):
                    return None
                ready = [kernel for kernel, needs in self._waiting.items() if not needs]
                if ready:
                    kernel = max(ready, key=lambda k: self._rank[k])
                    del self._waiting[kernel]
                    begun.add(kernel)
                    self._say(kernel.name, len(self.seconds), self.total)
                    return kernel
                self._condition.wait()
            return None

    def _unfinished(self, kernels: Collection[Kernel]) -> bool:
        return any(k in self._waiting or k in self._elsewhere for k in kernels)

    def end(self, kernel: Kernel, seconds: float | None = None) -> None:
        """Note that a kernel is compiled, and how long that took [s]."""
        with self._condition:
            self._here.discard(kernel)
            self._elsewhere.discard(kernel)
            if seconds is not None:
                self.seconds[kernel] = seconds
            for needs in self._waiting.values():
                needs.discard(kernel)
            self._condition.notify_all()

    def give_back(self, kernel: Kernel) -> None:
        """Leave a kernel to others."""
        with self._condition:
            self._elsewhere.discard(kernel)
            self._waiting[kernel] = set()
            self._condition.notify_all()

    def claim(self, kernel: Kernel) -> bool:
        """Say that this process is about to compile a kernel, as it has been called."""
        with self._condition:
            begun = kernel in self._elsewhere
            self._condition.wait_for(lambda: self._stopped or kernel not in self._elsewhere)
            if self._waiting.pop(kernel, None) is None:
                return begun
            self._here.add(kernel)
            return False

    def stop(self) -> None:
        """Hand out no more."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()


_current: list[Pool] = []


def current() -> Pool | None:
    """Return the pool that is being worked at; None where there is none."""
    return _current[-1] if _current else None


@contextmanager
def working_at(pool: Pool) -> Iterator[None]:
    """Have a pool worked at, until the end of a block."""
    _current.append(pool)
    try:
        yield
    finally:
        pool.stop()
        _current.remove(pool)
