"""What Numba finds out about calls is found out once.

A third of the time of compiling went into questions that had been answered: for each `+` and each
subscript of each kernel Numba tries all that has ever been registered for it, and tells its own
options apart by comparing all of them each time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.compiler import Flags
from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction


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

_found: dict[tuple[Any, ...], tuple[BaseFunction, Any]] = {}
"""Signatures by the function and types of arguments; the function is named by its address."""

_NUMBAS: Any = BaseFunction
_search = _NUMBAS.get_call_type


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


@contextmanager
def resolving_once() -> Iterator[None]:
    """Have Numba remember how calls were resolved. Whoever enters holds the compiler's lock."""
    before = _NUMBAS.get_call_type
    _NUMBAS.get_call_type = _find_once
    try:
        yield
    finally:
        _NUMBAS.get_call_type = before
