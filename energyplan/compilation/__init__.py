"""Numba's compiler with types: kernels are compiled once, without the GIL, and kept on disk.

A kernel's annotations are its signature, and there is no other: it is compiled for them, whatever
the caller's numbers are, so what must be compiled is known before anything runs. All kernels of a
package can be compiled ahead, side by side (`compile_kernels`), or while something else is done
(`compiling_beside`).
"""

from energyplan.compilation.ahead import (
    Compiled,
    Preparation,
    compile_kernels,
    compiling_beside,
    kernel_modules,
)
from energyplan.compilation.cache import FOLDER_VARIABLE, KernelCacheWarning, cache_folder
from energyplan.compilation.kernel import Compiling, inner, njit, on_compile

__all__ = [
    "FOLDER_VARIABLE",
    "Compiled",
    "Compiling",
    "KernelCacheWarning",
    "Preparation",
    "cache_folder",
    "compile_kernels",
    "compiling_beside",
    "inner",
    "kernel_modules",
    "njit",
    "on_compile",
]
