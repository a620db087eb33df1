"""Numba's compiler with types: kernels are compiled once, without the GIL, and cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def njit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel to machine code at its first call.

    Parameters
    ----------
    function : callable
        A function of scalars and arrays in Numba's subset of Python.

    Returns
    -------
    callable
        The compiled function; ``.py_func`` is the plain one.
    """
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True)(function))
