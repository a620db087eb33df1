"""Kernels compiled ahead of their first call, by several processes side by side.

What calls another kernel is compiled after it, and takes its machine code from disk, whichever
process wrote it there. The longest chain of calls goes first.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from energyplan.compilation.cache import can_be_kept
from energyplan.compilation.kernel import KERNELS, Compiling, Kernel, say_compiling

MOST_PROCESSES = 4
"""More have nothing to do: some kernels wait for others."""

FEW = 4
"""Kernels up to which another process does not pay."""


class Compiled(NamedTuple):
    """A kernel that was compiled, and how long that took [s]."""

    name: str
    seconds: float


class Preparation(NamedTuple):
    """What was compiled ahead.

    Attributes
    ----------
    compiled : tuple of Compiled
        The kernels that were compiled.
    found : int
        Number of kernels that were on disk, or loaded, already.
    kept : bool
        Whether machine code can be kept on disk.
    processes : int
        Number of processes that took part.
    seconds : float
        Time it took [s].
    """

    compiled: tuple[Compiled, ...]
    found: int
    kept: bool
    processes: int
    seconds: float


def kernel_modules() -> list[str]:
    """Return the names of all modules of this package that define kernels."""
    root = Path(__file__).parents[1]
    names = []
    for file in sorted(root.rglob("*.py")):
        if re.search(r"^@(njit|inner)$", file.read_text(encoding="utf-8"), re.MULTILINE):
            inside = file.relative_to(root.parent).with_suffix("")
            names.append(".".join(inside.parts).removesuffix(".__init__"))
    return names


_one_at_a_time = threading.Lock()


def compile_kernels(*modules: str, processes: int | None = None) -> Preparation:
    """Compile all kernels of some modules, or load them from disk.

    Parameters
    ----------
    *modules : str
        Modules, or packages of which all modules that are imported count.
    processes : int, optional
        How many processes share the work; as many as there are processors, up to
        `MOST_PROCESSES`, where not given. One where machine code cannot be kept on disk.

    Returns
    -------
    Preparation
        What was compiled.
    """
    with _one_at_a_time:
        return _compile(modules, processes)


def _compile(modules: tuple[str, ...], processes: int | None) -> Preparation:
    begun = time.perf_counter()
    wanted = [
        kernel
        for name, kernel in KERNELS.items()
        if kernel.declared is not None and any(name.startswith(f"{module}.") for module in modules)
    ]
    outer = [kernel for kernel in wanted if not kernel.inner]
    missing = _missing(outer)
    compiled: list[Compiled] = []
    count, kept = 1, True
    if missing:
        count = _processes() if processes is None else max(processes, 1)
        kept = can_be_kept()
        count = 1 if len(missing) <= FEW or not kept else min(count, len(missing))
        jobs = _Jobs(missing)
        helpers = [threading.Thread(target=_help, args=(jobs,)) for _ in range(count - 1)]
        for helper in helpers:
            helper.start()
        try:
            while (kernel := jobs.take()) is not None:
                since = time.perf_counter()
                kernel.prepare()
                jobs.end(kernel, time.perf_counter() - since)
        finally:
            jobs.stop()
            for helper in helpers:
                helper.join()
        compiled = jobs.compiled
        say_compiling(Compiling("", len(compiled), len(compiled)))
    for kernel in outer:
        kernel.prepare()
    found = len(wanted) - len(compiled)
    return Preparation(tuple(compiled), found, kept, count, time.perf_counter() - begun)


def _processes() -> int:
    if hasattr(os, "sched_getaffinity"):
        return min(len(os.sched_getaffinity(0)), MOST_PROCESSES)
    return min(os.cpu_count() or 1, MOST_PROCESSES)


def _missing(kernels: Iterable[Kernel]) -> list[Kernel]:
    """Return the kernels without machine code, and those that they call, the called ones first."""
    found: dict[Kernel, None] = {}

    def visit(kernel: Kernel) -> None:
        if kernel in found or kernel.declared is None or kernel.kept:
            return
        for called in kernel.called:
            visit(called)
        found[kernel] = None

    for kernel in kernels:
        visit(kernel)
    return list(found)


class _Jobs:
    """Kernels to compile, handed out when all that they call is there."""

    def __init__(self, kernels: list[Kernel]) -> None:
        self.compiled: list[Compiled] = []
        self._total = len(kernels)
        self._waiting = {k: {c for c in k.called if c in set(kernels)} for k in kernels}
        self._condition = threading.Condition()
        self._running = 0
        # how much there is to do from a kernel to the end, by the size of the sources
        self._rest: dict[Kernel, int] = {}
        for kernel in reversed(kernels):
            after = [self._rest[k] for k in self._rest if kernel in k.called]
            self._rest[kernel] = len(kernel.py_func.__code__.co_code) + max(after, default=0)

    def take(self) -> Kernel | None:
        """Return the next kernel, as soon as one can be compiled; None where none is left."""
        with self._condition:
            while True:
                ready = [kernel for kernel, needs in self._waiting.items() if not needs]
                if ready:
                    kernel = max(ready, key=lambda k: self._rest[k])
                    del self._waiting[kernel]
                    self._running += 1
                    say_compiling(Compiling(kernel.name, len(self.compiled), self._total))
                    return kernel
                if not self._waiting:
                    return None
                self._condition.wait()

    def end(self, kernel: Kernel, seconds: float) -> None:
        """Note that a kernel is compiled."""
        with self._condition:
            self._running -= 1
            self.compiled.append(Compiled(kernel.name, seconds))
            for needs in self._waiting.values():
                needs.discard(kernel)
            self._condition.notify_all()

    def give_back(self, kernel: Kernel) -> None:
        """Leave a kernel to others."""
        with self._condition:
            self._running -= 1
            self._waiting[kernel] = set()
            self._condition.notify_all()

    def stop(self) -> None:
        """Hand out no more."""
        with self._condition:
            self._waiting.clear()
            self._condition.notify_all()


_WORK = "from energyplan.compilation.ahead import work; work()"


def _help(jobs: _Jobs) -> None:
    """Have another process compile kernels, one after the other, as long as it lives."""
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", _WORK],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        )
    except OSError:  # this process does it alone
        return
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        try:
            while (kernel := jobs.take()) is not None:
                answer = ""
                try:
                    process.stdin.write(kernel.name + "\n")
                    process.stdin.flush()
                    answer = process.stdout.readline()
                    seconds = float(answer)
                except (OSError, ValueError):
                    jobs.give_back(kernel)
                    return
                jobs.end(kernel, seconds)
            process.stdin.close()
        finally:
            process.terminate()


def work() -> None:
    """Compile the kernels named on stdin, and answer with the time each took."""
    for line in sys.stdin:
        module, _, _ = line.strip().rpartition(".")
        import_module(module)
        since = time.perf_counter()
        KERNELS[line.strip()].prepare()
        sys.stdout.write(f"{time.perf_counter() - since}\n")
        sys.stdout.flush()
