"""Kernels compiled ahead of their first call, by several processes side by side.

What calls another kernel is compiled after it, and takes its machine code from disk, whichever
process wrote it there. The longest chain of calls goes first.
"""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from energyplan.compilation.cache import can_be_kept
from energyplan.compilation.kernel import KERNELS, Compiling, Kernel, say_compiling
from energyplan.compilation.pool import Pool, current, working_at

MOST_PROCESSES = 4
"""More have nothing to do: some kernels wait for others."""

FEW = 4
"""Kernels up to which another process does not pay."""


class Compiled(NamedTuple):
    """A kernel that was compiled, and how long that took [s]."""

    name: str
    seconds: float


class Preparation(NamedTuple):
    """What was compiled ahead."""

    compiled: tuple[Compiled, ...]  # the kernels that were compiled
    found: int  # number of kernels that were on disk, or loaded, already
    kept: bool  # whether machine code can be kept on disk
    processes: int  # number of processes that took part
    seconds: float  # time it took [s]


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
    """Compile all kernels of some modules, or load them from disk."""
    begun = time.perf_counter()
    with _one_at_a_time:
        wanted = list(dict.fromkeys([*_kernels(modules), *_all_ahead]))
        outer = [kernel for kernel in wanted if not kernel.inner]
        missing = _missing(outer)
        done: dict[Kernel, float] = {}
        count, kept = 1, True
        if missing:
            kept = can_be_kept()
            if len(missing) > FEW and kept:
                count = min(_processes() if processes is None else max(processes, 1), len(missing))
            with _pool(missing, count - 1, urgent=True) as pool, _without_full_collections():
                while (kernel := pool.take(missing)) is not None:
                    since = time.perf_counter()
                    kernel.prepare()
                    pool.end(kernel, time.perf_counter() - since)
                done = {k: pool.seconds[k] for k in missing if k in pool.seconds}
                say_compiling(Compiling("", len(pool.seconds), pool.total))
        for kernel in outer:
            kernel.prepare()
        compiled = tuple(Compiled(kernel.name, seconds) for kernel, seconds in done.items())
        seconds = time.perf_counter() - begun
        return Preparation(compiled, len(wanted) - len(compiled), kept, count, seconds)


_all_ahead: list[Kernel] = []
"""Kernels that are compiled whenever any are compiled ahead."""


@contextmanager
def compiling_beside(*modules: str, all_ahead: bool = False) -> Iterator[None]:
    """Have other processes compile kernels while this one does something else.

    What this process calls meanwhile it compiles itself; where another process has begun with it,
    it waits for that one. At the end of the block the others stop, after an error at once. Where
    there is one processor, or machine code cannot be kept on disk, kernels are compiled when they
    are called.
    """
    wanted = [kernel for kernel in _kernels(modules) if not kernel.inner]
    missing = _missing(wanted)
    count = _processes() - 1 if len(missing) > FEW else 0
    before = list(_all_ahead)
    _all_ahead.extend(wanted if all_ahead else ())
    try:
        if count and can_be_kept():
            with _pool(missing, count, urgent=False):
                yield
        else:
            yield
    finally:
        _all_ahead[:] = before


def _kernels(modules: tuple[str, ...]) -> list[Kernel]:
    """Return the kernels of some modules, or packages, as far as these are imported."""
    return [
        kernel
        for kernel in KERNELS.values()
        if kernel.declared is not None and not kernel.within.isdisjoint(modules)
    ]


@contextmanager
def _pool(missing: list[Kernel], helpers: int, *, urgent: bool) -> Iterator[Pool]:
    """Yield the pool that is being worked at, or one with helpers, with some kernels in it."""
    pool = current()
    if pool is not None:
        pool.add(missing, urgent=urgent)
        yield pool
        return
    pool = Pool(lambda name, done, total: say_compiling(Compiling(name, done, total)))
    pool.add(missing, urgent=urgent)
    started: list[subprocess.Popen[str]] = []
    threads = [threading.Thread(target=_help, args=(pool, started)) for _ in range(helpers)]
    for thread in threads:
        thread.start()
    try:
        with working_at(pool):
            yield pool
    except BaseException:
        for process in started:
            process.terminate()
        raise
    finally:
        for thread in threads:
            thread.join()


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


_WORK = "from energyplan.compilation.ahead import work; work()"


def _help(pool: Pool, started: list[subprocess.Popen[str]]) -> None:
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
    started.append(process)
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        try:
            while (kernel := pool.take()) is not None:
                answer = ""
                try:
                    process.stdin.write(kernel.name + "\n")
                    process.stdin.flush()
                    answer = process.stdout.readline()
                    seconds = float(answer)
                except (OSError, ValueError):
                    pool.give_back(kernel)
                    return
                pool.end(kernel, seconds)
            process.stdin.close()
        finally:
            process.terminate()


def work() -> None:
    """Compile the kernels named on stdin, and answer with the time each took."""
    with _without_full_collections():
        for line in sys.stdin:
            module, _, _ = line.strip().rpartition(".")
            import_module(module)
            since = time.perf_counter()
            KERNELS[line.strip()].prepare()
            sys.stdout.write(f"{time.perf_counter() - since}\n")
            sys.stdout.flush()


@contextmanager
def _without_full_collections() -> Iterator[None]:
    """Have the garbage collector leave alone what has lived long.

    The compiler allocates so much that Python would look through everything again and again, which
    takes a twentieth of the time and frees next to nothing.
    """
    before = gc.get_threshold()
    gc.set_threshold(*before[:2], 1_000_000)
    try:
        yield
    finally:
        gc.set_threshold(*before)
