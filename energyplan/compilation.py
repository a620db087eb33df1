"""Numba's kernels: compiled for the types of their annotations, and kept on disk.

A kernel's annotations are its one signature, so what must be compiled is known before anything
runs, and `compile_kernels` does so before a clock starts. Machine code is kept under a digest of
all its sources: Numba's own cache looks at the file of the function alone, and would hand out old
machine code after an edit of a kernel that this one calls.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import stat
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, NamedTuple, ParamSpec, TypeVar, cast, get_args, get_origin
from typing import get_type_hints as hints_of

import numpy as np
from numba import types
from numba.core import caching, config, event, sigutils
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from numba.np import numpy_support
from numpy.typing import NDArray

from energyplan.sources import ROOT, kernels_of, module_of, source_digest, sources

P = ParamSpec("P")
R = TypeVar("R")

READONLY, STRIDED = "read-only", "strided"
"""Marks of annotations: the array cannot be written; it need not be contiguous."""

Floats = Annotated[NDArray[np.float64], 1]
FloatTable = Annotated[NDArray[np.float64], 2]
FloatBlock = Annotated[NDArray[np.float64], 3]
WideBlock = Annotated[NDArray[np.float64], 4]
Singles = Annotated[NDArray[np.float32], 1]
SingleTable = Annotated[NDArray[np.float32], 2]
Ints = Annotated[NDArray[np.int64], 1]
IntTable = Annotated[NDArray[np.int64], 2]
ShortInts = Annotated[NDArray[np.int32], 1]
ShortIntTable = Annotated[NDArray[np.int32], 2]
Bytes = Annotated[NDArray[np.uint8], 1]
ByteTable = Annotated[NDArray[np.uint8], 2]
States = Annotated[NDArray[np.int8], 1]
Words = Annotated[NDArray[np.uint64], 1]
WordTable = Annotated[NDArray[np.uint64], 2]
WordBlock = Annotated[NDArray[np.uint64], 3]
Flags = Annotated[NDArray[np.bool_], 1]
FlagTable = Annotated[NDArray[np.bool_], 2]
"""A table has two dimensions, a block three, a wide block four."""

Column = Annotated[NDArray[np.float64], 1, STRIDED, READONLY]
AnyTable = Annotated[NDArray[np.float64], 2, STRIDED, READONLY]
AnyInts = Annotated[NDArray[np.int64], 1, STRIDED, READONLY]
"""What is read alone may have any layout, as the columns of a table do."""

FOLDER_VARIABLE = "ENERGYPLAN_CACHE_DIR"
"""Environment variable that names another folder for compiled kernels."""

KERNELS: dict[str, Kernel] = {}  # all kernels of the modules imported so far, by module and name
SELDOM = 100_000  # objects created between two garbage collections while kernels are compiled
FEW = 4  # kernels up to which another process does not pay
LOOK = 0.5  # time between two looks at what the other process has compiled [s]

_SCALARS = {float: types.float64, int: types.int64, bool: types.boolean}
_OPTIONS = {"nopython": True, "nogil": True, "no_cfunc_wrapper": True, "_nrt": True}


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be kept, so that every process compiles anew."""


def cache_folder() -> Path:
    """Return where compiled kernels are kept, whether it exists or not."""
    if chosen := os.environ.get(FOLDER_VARIABLE):
        return Path(chosen)
    shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if shared.is_absolute():  # the specification has others ignored
        return shared / "energyplan"
    with suppress(RuntimeError):
        if os.environ.get("HOME") != "":
            return Path.home() / ".cache" / "energyplan"
    user = f"-{os.getuid()}" if hasattr(os, "getuid") else ""  # no home; temporary files are shared
    return Path(tempfile.gettempdir()) / f"energyplan{user}"


@cache
def _distrust(folder: Path) -> str:
    """Return why a folder keeps no machine code, which runs when loaded; it is created here."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about, itself = folder.stat(), folder.lstat()  # of what a link names, and of the link
        with os.scandir(folder) as entries:
            inside = [one.stat(follow_symlinks=False) for one in entries]
    except OSError as error:
        return str(error.strerror)
    if not hasattr(os, "getuid"):  # Windows has no such owners
        return ""
    trusted = (os.getuid(), 0)
    if about.st_uid not in trusted:
        return f"user {about.st_uid} owns it, and could have this one run what lies there"
    if itself.st_uid not in trusted:
        return f"user {itself.st_uid} owns the link, and could have this one run what lies there"
    if about.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "others may write there; delete it with all that it holds"
    files = (one.st_uid for one in inside if not stat.S_ISDIR(one.st_mode))
    if (owner := next((one for one in files if one not in trusted), None)) is not None:
        return f"user {owner} owns a file in it; delete it with all that it holds"
    return ""


@cache
def kernel_digests() -> dict[str, str]:
    """Return digests of the sources of all kernels, by module and name; they are kept on disk."""
    everything = hashlib.sha256()
    for file in sources():
        everything.update(f"{file.relative_to(ROOT)}:".encode() + file.read_bytes())
    kept = cache_folder() / f"{everything.hexdigest()[:24]}.json"
    trusted = not _distrust(cache_folder())
    with suppress(OSError, ValueError):
        if trusted:
            return dict(json.loads(kept.read_text(encoding="utf-8")))
    found = {
        f"{module_of(file)}.{name}": source_digest(file, name)
        for file in sources()
        for name in kernels_of(file)
    }
    with suppress(OSError):
        if trusted:
            with tempfile.NamedTemporaryFile("w", dir=kept.parent, delete=False) as new:
                json.dump(found, new)
            Path(new.name).replace(kept)
    return found


@cache
def _compiler() -> str:
    """Return what decides machine code besides the sources."""
    options = [getattr(config, name, None) for name in ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")]
    return repr([sys.version, *map(version, ("numba", "llvmlite", "numpy")), options, _OPTIONS])


class _Locator(caching.UserWideCacheLocator):
    """Where the machine code of a module's functions lies; Numba's index there has processors."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        self._cache_path = str(cache_folder() / "kernels")
        name = f"{function.__module__}.{function.__qualname__}"
        source = function.__code__.co_name
        made_of = kernel_digests().get(f"{function.__module__}.{source}") or source_digest(
            Path(file), source
        )
        kind = type(KERNELS.get(name)).__name__
        made_of = f"{name}:{kind}:{made_of}:{_compiler()}"
        self._digest = hashlib.sha256(made_of.encode()).hexdigest()[:24]

    def get_source_stamp(self) -> str:
        """Return the digest of all that the machine code depends on."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return the same digest, for the names of files."""
        return self._digest

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> _Locator | None:
        """Return the place; None without a file of the source, or where no folder is to be had."""
        if not Path(file).is_file():
            return None
        locator = cls(function, file)
        if why := _distrust(cache_folder()) or _distrust(Path(locator._cache_path)):
            _say_not_kept(why)
            return None
        return locator


class _Results(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    _impl_class = _Results

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return machine code from disk; whatever is wrong with its file, it is compiled anew."""
        with suppress(Exception):
            # Numba would first import all that it compiles with; machine code needs its runtime
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        with suppress(OSError):
            self.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep machine code where it can be."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _say_not_kept(str(error.strerror))

    @property
    def file(self) -> Path:
        """Index of what is kept."""
        return Path(self._cache_file._index_path)


@cache
def _say_not_kept(why: str) -> None:
    warnings.warn(
        f"compiled kernels cannot be kept in {cache_folder()} ({why}), so each process compiles "
        f"them anew; name a folder that can be written with {FOLDER_VARIABLE}",
        KernelCacheWarning,
        stacklevel=2,
    )


def _can_be_kept() -> bool:
    """Return whether machine code can be kept; where it cannot, a warning says why."""
    why = _distrust(cache_folder())
    if not why:
        try:
            tempfile.TemporaryFile(dir=cache_folder()).close()
        except OSError as error:
            why = str(error.strerror)
    if why:
        _say_not_kept(why)
    return not why


class Kernel(CPUDispatcher):
    """A function that is compiled for the types of its annotations, whatever it is called with."""

    def __init__(self, function: Callable[..., object], **options: bool) -> None:
        super().__init__(function, targetoptions=_OPTIONS | options)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._kept = False

    @cached_property
    def declared(self) -> tuple[Any, ...]:
        """Types of the arguments, as they are annotated."""
        hints = hints_of(self.py_func, include_extras=True)
        names = self.py_func.__code__.co_varnames[: self.py_func.__code__.co_argcount]
        return tuple(_numba_type(hints[name]) for name in names)

    @cached_property
    def disk(self) -> _Cache | None:
        """Its machine code on disk; None where its source is in no file."""
        with suppress(RuntimeError, OSError):
            self._cache = _Cache(self.py_func)
            return self._cache
        return None

    @property
    def kept(self) -> bool:
        """Whether its machine code is loaded, or there was a file of it."""
        if not self._kept:
            on_disk = self.disk is not None and self.disk.file.is_file()
            self._kept = on_disk or bool(self.overloads)
        return self._kept

    def compile(self, sig: Any = None) -> Any:
        """Compile it for the declared types, or load it; for others where these do not convert."""
        given, _ = sigutils.normalize_signature(sig or self.declared)
        if given != self.declared and not self._converts(given):
            return super().compile(given)
        _ = self.disk  # from where Numba loads it
        with _uncollected():
            entry = super().compile(self.declared)
        literal = any(isinstance(kind, types.Literal | types.Omitted) for kind in given)
        if given != self.declared and not literal:  # a second entry would be ambiguous
            insert: Any = self._insert  # type: ignore[attr-defined]
            insert([kind._code for kind in given], entry, False)  # next time found at once
        return entry

    def _converts(self, given: tuple[Any, ...]) -> bool:
        """Return whether these types become the declared ones without loss."""
        convert = self.targetdescr.typing_context.can_convert
        return len(given) == len(self.declared) and all(
            convert(a, b) is not None
            and not (isinstance(a, types.Float) and isinstance(b, types.Integer))
            for a, b in zip(given, self.declared, strict=True)
        )


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector off, which takes a sixth of what compiling takes."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class InnerKernel(Kernel):
    """A kernel for other kernels: without the entry for Python, which takes long to compile."""

    def __init__(self, function: Callable[..., object], **options: bool) -> None:
        super().__init__(function, no_cpython_wrapper=True, **options)

    @cached_property
    def entry(self) -> Kernel:
        """The same function with an entry for Python, compiled where that is needed after all."""
        other = FunctionType(self.py_func.__code__, self.py_func.__globals__)
        other.__qualname__ = f"{self.py_func.__qualname__}.entry"
        other.__module__, other.__annotations__ = self.__module__, self.py_func.__annotations__
        return Kernel(other)

    def __call__(self, *arguments: Any) -> Any:
        """Run it from Python."""
        return self.entry(*arguments)


class LeanKernel(InnerKernel):
    """An inner kernel that neither creates nor returns arrays, and so counts no references.

    What calls it holds the arrays meanwhile. Counting is atomic: of a record of ten arrays it takes
    longer than a step of a search.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function, _nrt=False)


def njit(function: Callable[P, R], kind: type[Kernel] = Kernel) -> Callable[P, R]:
    """Compile a function to machine code that holds no GIL, for the types of its annotations."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    kernel = kind(function)
    KERNELS[kernel.name] = kernel
    return cast("Callable[P, R]", kernel)


def inner(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function as `njit` does, for being called by kernels."""
    return njit(function, InnerKernel)


def lean(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function as `inner` does that neither creates nor returns arrays."""
    return njit(function, LeanKernel)


def _numba_type(annotation: Any) -> Any:
    """Return the Numba type that an annotation stands for."""
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    if get_origin(annotation) is Annotated:
        array, *about = get_args(annotation)
        number = get_args(array)[-1]  # of an alias from NumPy 2.5 on, before that of a dtype
        dtype = np.dtype(*(get_args(number) or [number]))
        layout = "A" if STRIDED in about else "C"
        array_of: Any = types.Array
        item = numpy_support.from_dtype(dtype)
        return array_of(item, about[0], layout, readonly=READONLY in about)
    if isinstance(annotation, type) and issubclass(annotation, np.generic):
        return numpy_support.from_dtype(np.dtype(annotation))
    if isinstance(annotation, type) and issubclass(annotation, tuple):
        fields = hints_of(annotation, include_extras=True)
        parts = [_numba_type(fields[name]) for name in annotation._fields]  # type: ignore[attr-defined]
        return types.BaseTuple.from_types(parts, annotation)
    if get_origin(annotation) is tuple:
        return types.BaseTuple.from_types([_numba_type(part) for part in get_args(annotation)])
    raise TypeError(f"{annotation} is no type of a kernel's argument")


def kernel_modules() -> list[str]:
    """Return the names of all modules of this package that define kernels."""
    return [module_of(file) for file in sources() if kernels_of(file)]


class Compiling(NamedTuple):
    """How far kernels are compiled that are not on disk yet."""

    done: int  # kernels of this time
    total: int  # kernels to compile
    left: float | None  # time that the others will take, at the same pace [s]; None at first

    def __str__(self) -> str:
        """Return it in words."""
        left = "" if self.left is None else f", about {self.left:.0f} s left"
        return f"compiling kernels, once: {self.done} of {self.total}{left}"


_show: ContextVar[Callable[[Compiling], object] | None] = ContextVar("show", default=None)
"""Whom to show how far compiling is."""


@contextmanager
def compiling_shown(show: Callable[[Compiling], object]) -> Iterator[None]:
    """Show how far compiling is, each time that kernels are compiled ahead during a block.

    Parameters
    ----------
    show : callable
        Called with a `Compiling` before the first kernel and after each; ``print`` will do.
    """
    token = _show.set(show)
    try:
        yield
    finally:
        _show.reset(token)


class _Count:
    """Counts kernels that are compiled, by this process or the other one, and shows it."""

    def __init__(self, kernels: list[Kernel]) -> None:
        self.kernels, self.begun, self.shown = kernels, time.perf_counter(), -1

    def show(self) -> None:
        """Show how many there are by now, where that has changed."""
        if (show := _show.get()) is None or not self.kernels:
            return
        done, total = sum(kernel.kept for kernel in self.kernels), len(self.kernels)
        if done != self.shown:
            took = time.perf_counter() - self.begun
            show(Compiling(done, total, took / done * (total - done) if done > FEW else None))
            self.shown = done


class Preparation(NamedTuple):
    """What was compiled ahead."""

    compiled: tuple[str, ...]  # names of the kernels that were compiled
    found: int  # number of kernels that were on disk, or loaded, already
    kept: bool  # whether machine code can be kept on disk
    processes: int  # number of processes that took part
    seconds: float  # time it took [s]


def compile_kernels(*modules: str, processes: int = 2, load: bool = False) -> Preparation:
    """Compile those kernels of some modules, or packages, that are not on disk yet.

    Two processes begin at either end of the list and meet where all has been kept. What is on disk
    is loaded when it is first called, or at once where a clock is about to start.
    """
    begun = time.perf_counter()
    inside = tuple(f"{module}." for module in modules)
    wanted = [kernel for name, kernel in KERNELS.items() if name.startswith(inside)]
    missing = [kernel for kernel in wanted if not kernel.kept]
    kept = not missing or _can_be_kept()
    processes = min(processes, 2, processors()) if kept and len(missing) > FEW else 1
    names = [kernel.name for kernel in missing]
    count = _Count(missing)
    count.show()
    with _helping(names[::-1], count.show) if processes > 1 else nullcontext():
        _compile_missing(missing, count.show)
    for kernel in wanted if load else ():
        if not (isinstance(kernel, InnerKernel) or kernel.overloads):
            kernel.compile()
    seconds = time.perf_counter() - begun
    return Preparation(tuple(names), len(wanted) - len(names), kept, processes, seconds)


def processors() -> int:
    """Return how many threads can run at once: the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _helping(names: list[str], show: Callable[[], None]) -> Iterator[None]:
    """Have another process compile kernels during a block, and wait for it at the end."""
    code = "import sys; from energyplan.compilation import work; work(sys.argv[1:])"
    path = os.pathsep.join(map(os.path.abspath, sys.path))
    process: subprocess.Popen[bytes] | None = None
    with suppress(OSError):  # where it cannot start, this one does it all
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", code, *names],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    try:
        yield
        while process and process.poll() is None:
            show()
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK)
        show()
    finally:
        if process:
            process.kill()
            process.wait()


def work(names: list[str]) -> None:
    """Compile the kernels of these names that nobody has compiled yet."""
    for name in names:
        import_module(name.rpartition(".")[0])
    _compile_missing([KERNELS[name] for name in names])


def _compile_missing(kernels: list[Kernel], show: Callable[[], None] = lambda: None) -> None:
    """Compile those kernels that nobody has compiled yet, and show it after each."""
    pace = gc.get_threshold()
    gc.set_threshold(max(pace[0], SELDOM) if pace[0] else 0, *pace[1:])
    try:
        for kernel in kernels:
            if not kernel.kept:
                kernel.compile()
                show()
    finally:
        gc.set_threshold(*pace)


@contextmanager
def telling(say: Callable[[str], None]) -> Iterator[None]:
    """Have every kernel named that this process begins to compile."""
    listener = _Listener(say)
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)


class _Listener(event.Listener):
    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def on_start(self, event: Any) -> None:
        """Name the kernel."""
        self._say(getattr(event.data["dispatcher"], "name", ""))

    def on_end(self, event: Any) -> None:
        """Say nothing."""
