"""Kernels: functions with one signature each, that of their annotations."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, NamedTuple, ParamSpec, TypeVar, cast, get_args, get_origin
from typing import get_type_hints as hints_of

import numpy as np
from numba import types
from numba.core import config, sigutils
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.np import numpy_support

from energyplan.compilation.arrays import READONLY, STRIDED
from energyplan.compilation.cache import ADDRESSED, KernelCache
from energyplan.compilation.pool import current
from energyplan.compilation.shortcuts import Options, taking_shortcuts

P = ParamSpec("P")
R = TypeVar("R")

_SCALARS = {float: types.float64, int: types.int64, bool: types.boolean}

KERNELS: dict[str, Kernel] = {}
"""All kernels of the modules imported so far, by module and name."""

COPIED = 100
"""Lines of LLVM's language up to which a kernel is copied into those that call it.

LLVM would not inline a longer one anyway, but optimise it once more in each of its callers: these
call its machine code instead.
"""


class Compiling(NamedTuple):
    """What is about to be compiled."""

    name: str  # module and name of the kernel
    done: int = 0  # how many kernels of those compiled ahead are done, and their number
    total: int = 0  # how many kernels of those compiled ahead are done, and their number


_listeners: list[Callable[[Compiling], None]] = []


def on_compile(listener: Callable[[Compiling], None]) -> Callable[[], None]:
    """Have a function told of every kernel that is about to be compiled."""
    _listeners.append(listener)
    return lambda: _listeners.remove(listener)


def say_compiling(what: Compiling) -> None:
    """Tell all listeners what is about to be compiled."""
    for listener in tuple(_listeners):
        listener(what)


def njit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel to machine code, at its first call or ahead."""
    return _kernel(function, inner=False)


def inner(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel for other kernels to call.

    The wrapper that Python calls a kernel through takes as long to compile as the kernel itself, so
    this one has none: called from Python it runs as plain Python.
    """
    return _kernel(function, inner=True)


def _kernel(function: Callable[P, R], *, inner: bool) -> Callable[P, R]:
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    made = (InnerKernel if inner else Kernel)(function)
    KERNELS[made.name] = made
    return cast("Callable[P, R]", made)


def _load(name: str) -> None:
    """Load a kernel that another one calls, or compile it."""
    kernel = KERNELS[name]
    kernel._compile(kernel.declared)


class Kernel(CPUDispatcher):
    """A function that is compiled for the types of its annotations."""

    inner = False
    """Whether only other kernels call it."""

    def __init__(self, function: Callable[..., object]) -> None:
        options = {"nopython": True, "nogil": True, "no_cfunc_wrapper": True}
        super().__init__(function, targetoptions={**options, "no_cpython_wrapper": self.inner})
        self.name = f"{function.__module__}.{function.__qualname__}"
        parts = function.__module__.split(".")
        self.within = frozenset(".".join(parts[: k + 1]) for k in range(len(parts)))
        """Its module, and the packages that this is in."""
        self._announced = False
        self.loaded = False
        """Whether there is machine code for the declared types."""
        self._cache = KernelCache(function, self._missed, _load)
        self._compiler._customize_flags = Options  # type: ignore[attr-defined]

    def _missed(self) -> bool:
        """Tell whether another process has made the machine code meanwhile; else it comes here."""
        if (pool := current()) is not None and pool.claim(self):
            return True
        if not self._announced:
            say_compiling(Compiling(self.name))
        return False

    def _compile(self, sig: Any) -> Any:
        try:
            with global_compiler_lock, taking_shortcuts():
                return super().compile(sig)
        finally:
            if (pool := current()) is not None:
                pool.end(self)

    def add_overload(self, cres: Any) -> None:
        """Note machine code, and how others come to it: by a copy, or by its address."""
        super().add_overload(cres)
        self.loaded |= cres.signature.args == self.declared
        symbol = cres.fndesc.llvm_func_name
        if cres.metadata is not None and cres.signature.args == self.declared:  # not from disk
            lines = str(cres.library.get_function(symbol)).count("\n")
            if lines > COPIED:
                ADDRESSED[symbol] = self.name
        if symbol in ADDRESSED:
            self.targetctx.remove_user_function(cres.entry_point)
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc)

    @cached_property
    def declared(self) -> tuple[Any, ...] | None:
        """Types of the arguments, as they are annotated; None where one stands for no one type."""
        hints = hints_of(self.py_func, include_extras=True)
        names = self.py_func.__code__.co_varnames[: self.py_func.__code__.co_argcount]
        try:
            return tuple(_numba_type(hints[name]) for name in names)
        except TypeError:
            return None

    @cached_property
    def called(self) -> tuple[Kernel, ...]:
        """The kernels that this one calls by name."""
        places = self.py_func.__globals__
        found = (places.get(name) for name in self.py_func.__code__.co_names)
        return tuple(k for k in found if isinstance(k, Kernel) and k is not self)

    @property
    def kept(self) -> bool:
        """Whether its machine code is loaded, or there is a file of it."""
        return self.loaded or self._cache.holds(self.declared, self.targetctx)

    def prepare(self) -> None:
        """Compile it for its declared types, or load it from disk."""
        if self.declared is not None and not self.loaded:
            self._announced = True  # whoever compiles ahead says so
            self._compile(self.declared)
            self._announced = False

    def compile(self, sig: Any) -> Any:
        """Compile it for the declared types; for others only where these cannot be converted."""
        given, _ = sigutils.normalize_signature(sig)
        if self.declared is None or given == self.declared or not self._converts(given):
            return self._compile(given)
        entry = self._compile(self.declared)
        if not any(isinstance(a, (types.Literal, types.Omitted)) for a in given):
            # from now on a call from Python with these types finds it at once
            insert: Any = self._insert  # type: ignore[attr-defined]
            insert([a._code for a in given], entry, False)
        return entry

    def _converts(self, given: tuple[Any, ...]) -> bool:
        """Tell whether these types can be made into the declared ones without loss."""
        convert = self.targetdescr.typing_context.can_convert
        assert self.declared is not None
        return len(given) == len(self.declared) and all(
            convert(a, b) is not None
            and not (isinstance(a, types.Float) and isinstance(b, types.Integer))
            for a, b in zip(given, self.declared, strict=True)
        )


class InnerKernel(Kernel):
    """A kernel that only other kernels call."""

    inner = True

    def __call__(self, *args: object, **kwargs: object) -> object:
        """Run the plain function: Python, which has no way into the machine code, seldom calls."""
        return self.py_func(*args, **kwargs)


def _numba_type(annotation: Any) -> Any:
    """Return the Numba type that an annotation stands for."""
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    if get_origin(annotation) is Annotated:
        array, *about = get_args(annotation)
        if about and isinstance(about[0], int):
            number = get_args(array)[-1]  # of an alias from NumPy 2.5 on, before that of a dtype
            dtype = np.dtype(*(get_args(number) or [number]))
            array_of: Any = types.Array
            return array_of(
                numpy_support.from_dtype(dtype),
                about[0],
                "A" if STRIDED in about else "C",
                readonly=READONLY in about,
            )
    if isinstance(annotation, type) and issubclass(annotation, np.generic):
        return numpy_support.from_dtype(np.dtype(annotation))
    if isinstance(annotation, type) and issubclass(annotation, tuple):
        fields = hints_of(annotation, include_extras=True)
        parts = [_numba_type(fields[name]) for name in annotation._fields]  # type: ignore[attr-defined]
        return types.BaseTuple.from_types(parts, annotation)
    if get_origin(annotation) is tuple:
        return types.BaseTuple.from_types([_numba_type(part) for part in get_args(annotation)])
    raise TypeError(annotation)
