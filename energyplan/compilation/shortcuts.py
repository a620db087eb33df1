"""What Numba would do for each kernel anew is done once, or not at all where nothing needs it.

A third of the time of compiling went into questions that had been answered: for each `+` and each
subscript of each kernel Numba tries all that has ever been registered for it, tells its own options
apart by comparing all of them each time, and has LLVM read a type to learn its size. It sets up an
optimiser for every function that a kernel names, though only those with a body can be optimised,
and wraps its own functions for callers in C, of which there are none. The machine code is the same
with these shortcuts as without them, and they are not taken with releases of Numba not tried yet.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
from llvmlite.binding import ModuleRef
from llvmlite.ir import Type
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Flags
from numba.core.cpu import CPUContext
from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction

TRIED = (0, 60), (0, 68)
"""The first and the last release of Numba whose insides are known to be as the shortcuts need."""


class Options(Flags):
    """Numba's options for compiling a kernel, compared faster."""

    __slots__ = ()

    def __hash__(self) -> int:
        return _HASH

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Options) and self._values == other._values:
            return True
        return bool(super().__eq__(other))  # the same may be set, or be the default


_HASH = hash(Flags())
"""Numba's hash is that of the options' names, the same for all."""

_search: Any = BaseFunction.get_call_type
_found: dict[tuple[Any, ...], tuple[BaseFunction, Any]] = {}
"""Signatures by the function and types of arguments; the function is named by its address."""


def _find_once(function: BaseFunction, context: Any, args: Any, kws: Any) -> Any:
    """Return the signature of a call, as Numba finds it, or has found it."""
    if kws or any(_may_be_inlined(template) for template in function.templates):
        return _search(function, context, args, kws)
    key = id(function), id(context), tuple(args), ConfigStack.top_or_none()
    if key not in _found:
        _found[key] = function, _search(function, context, args, kws)
    return _found[key][1]


def _may_be_inlined(template: Any) -> bool:
    inline = getattr(template, "_inline", None)
    return inline is not None and not inline.is_never_inline


_size: Any = Type.get_abi_size
_sizes: dict[tuple[str, str], int] = {}
"""Sizes of types [byte], by their text and how data are laid out."""


def _size_once(kind: Type, layout: Any, context: Any = None) -> int:
    """Return the size of a type, as LLVM tells it, or has told it."""
    key = str(kind), str(layout)
    if context is not None or "%" in key[0]:  # it has a name, which may come to mean another type
        return int(_size(kind, layout, context))
    if key not in _sizes:
        _sizes[key] = _size(kind, layout)
    return _sizes[key]


class _Defined(ModuleRef):
    """A module that shows only the functions that have a body."""

    @property
    def functions(self) -> Iterator[Any]:
        return (function for function in super().functions if not function.is_declaration)


_optimise: Any = CPUCodeLibrary._optimize_functions


def _optimise_defined(library: CPUCodeLibrary, module: Any) -> None:
    """Optimise the functions of a module that have a body."""
    module.__class__ = _Defined
    try:
        _optimise(library, module)
    finally:
        module.__class__ = ModuleRef


def _not_for_c(*_: object, **__: object) -> None:
    """Leave out the wrapper for callers in C."""


_SHORTCUTS: tuple[tuple[Any, str, Any], ...] = (
    (BaseFunction, "get_call_type", _find_once),
    (Type, "get_abi_size", _size_once),
    (CPUCodeLibrary, "_optimize_functions", _optimise_defined),
    (CPUContext, "create_cfunc_wrapper", _not_for_c),
)


@contextmanager
def taking_shortcuts() -> Iterator[None]:
    """Have Numba take them. Whoever enters holds the compiler's lock."""
    if not TRIED[0] <= tuple(int(part) for part in numba.__version__.split(".")[:2]) <= TRIED[1]:
        yield
        return
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in _SHORTCUTS]
    for owner, name, shortcut in _SHORTCUTS:
        setattr(owner, name, shortcut)
    try:
        yield
    finally:
        for owner, name, former in before:
            setattr(owner, name, former)
