"""Machine code on disk, under a digest of all that it was made from.

Numba's own cache looks only at the file of the function that is compiled: after a change in a file
that this one calls, it hands out the old machine code. Here a kernel is kept under a digest of all
sources that it can reach within this package, of the versions of Python, Numba and NumPy, and of
the processor. So what runs is always what the sources say.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
from llvmlite.binding import parse_assembly
from numba.core import caching, config
from numba.core.serialize import dumps

FOLDER_VARIABLE = "ENERGYPLAN_CACHE_DIR"
"""Environment variable that names another folder for compiled kernels."""

KEPT_UNUSED = 30 * 24 * 3600.0
"""Machine code of sources that are no more is deleted when unused for so long [s]."""

ADDRESSED: dict[str, str] = {}
"""Kernels whose machine code others call instead of copying it: their names, by their symbols."""

_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(r"^[ \t]*from energyplan([.\w]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be kept, so that every process compiles anew."""


def cache_folder() -> Path:
    """Return where compiled kernels are kept, whether it exists or not.

    It is ``$ENERGYPLAN_CACHE_DIR``, or ``energyplan`` in ``$XDG_CACHE_HOME`` or ``~/.cache``, or a
    folder for temporary files where there is no home.
    """
    if chosen := os.environ.get(FOLDER_VARIABLE):
        return Path(chosen)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "energyplan"
    try:
        return Path.home() / ".cache" / "energyplan"
    except RuntimeError:  # no home folder; temporary files are other users' too, where these exist
        user = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
        return Path(tempfile.gettempdir()) / f"energyplan{user}"


def source_digest(file: Path) -> str:
    """Return a digest of a module's source and of all sources of the package that it imports."""
    found: dict[Path, bytes] = {}
    pending = [file]
    while pending:
        source = pending.pop()
        if source not in found:
            found[source] = source.read_bytes()
            pending += _imported(found[source].decode())
    digest = hashlib.sha256(_versions().encode())
    for source in sorted(found):
        digest.update(f"{source.name}:{len(found[source])}:".encode() + found[source])
    return digest.hexdigest()[:24]


@cache
def _imported(text: str) -> tuple[Path, ...]:
    """Return the files of this package that a source names in its import statements."""
    files = list[Path]()
    for match in _IMPORT.finditer(text):
        base = _ROOT.joinpath(*match[1].split("."))
        names = re.findall(r"(\w+)(?: as \w+)?", match[2])
        for place in (base, *(base / name for name in names)):
            candidates = place.with_suffix(".py"), place / "__init__.py"
            files += [c for c in candidates if c.is_file() and c != _ROOT / "__init__.py"]
    return tuple(files)


@cache
def _versions() -> str:
    options = [getattr(config, name, None) for name in ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")]
    return f"{sys.version} {numba.__version__} {version('llvmlite')} {version('numpy')} {options}"


@cache
def _digest_once(file: str) -> str | None:
    """Return the digest of a module as it was when its first kernel was defined."""
    try:
        return source_digest(Path(file))
    except OSError:  # no source on disk, as in a zip file
        return None


class _Reduced(caching.CompileResultCacheImpl):
    """Numba's way of turning machine code into bytes and back."""

    def __init__(self, function: Callable[..., object]) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = SimpleNamespace(_py_file=function.__code__.co_filename)


class _Kept(NamedTuple):
    """What a file holds."""

    reduced: tuple[Any, ...]  # machine code, as Numba reduces it
    addressed: bool  # whether others call it by its address
    calls: tuple[tuple[str, str], ...]


class KernelCache(caching.FunctionCache):
    """Machine code of one kernel, a file for each signature and processor."""

    def __init__(
        self,
        function: Callable[..., object],
        missed: Callable[[], bool],
        load_called: Callable[[str], None],
    ) -> None:
        self._py_func = function
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._digest = _digest_once(function.__code__.co_filename)
        self._impl = _Reduced(function)
        self._missed = missed
        self._load_called = load_called
        self.enable()

    @property
    def cache_path(self) -> str:
        """Folder of the machine code made from these sources."""
        return str(cache_folder() / str(self._digest))

    def _file(self, signature: object, codegen: Any) -> Path:
        _, processor, code = self._index_key(signature, codegen)
        # types are told by their text: their pickles differ from process to process
        key = hashlib.sha256(repr((signature, processor, code)).encode()).hexdigest()[:16]
        name = re.sub(r"[^\w.]", "", self._name)
        return Path(self.cache_path) / f"{name}-{key}.nbc"

    def holds(self, sig: object, target_context: Any) -> bool:
        """Tell whether there is a file for a signature."""
        return self._digest is not None and self._file(sig, target_context.codegen()).is_file()

    def load_overload(self, sig: object, target_context: Any) -> object:
        """Return the machine code for a signature; None where there is none that can be used."""
        target_context.refresh()
        found = self._load(sig, target_context)
        if found is None and self._missed():
            found = self._load(sig, target_context)
        return found

    def _load(self, sig: object, target_context: Any) -> object:
        if self._enabled and self._digest is not None:
            file = self._file(sig, target_context.codegen())
            # whatever is wrong with the file, the kernel can be compiled
            with suppress(Exception):
                kept = _Kept(*pickle.loads(file.read_bytes()))
                for name, symbol in kept.calls:
                    self._load_called(name)
                    if symbol not in ADDRESSED:  # compiled anew: LLVM would end the process
                        return None
                found: Any = self._impl.rebuild(target_context, kept.reduced)
                if kept.addressed:
                    ADDRESSED[found.fndesc.llvm_func_name] = self._name
                _mark_used(file.parent)
                return found
        return None

    def save_overload(self, sig: object, data: Any) -> None:
        """Keep machine code."""
        if not self._enabled or self._digest is None or not self._impl.check_cachable(data):
            return
        try:
            _write(self._file(sig, data.codegen), dumps(tuple(self._kept(data))))
        except OSError as error:
            _say_not_kept(str(error.strerror or error))

    def _kept(self, result: Any) -> _Kept:
        reduced = self._impl.reduce(result)
        addressed = result.fndesc.llvm_func_name in ADDRESSED
        if addressed:  # nobody copies it: of its text only the name that Python asks for is needed
            (name, kind, (code, _)), *rest = reduced
            wrapper = result.fndesc.llvm_cpython_wrapper_name
            wrapped = result.library.get_pointer_to_function(wrapper)
            named = parse_assembly(f'define void @"{wrapper}"() {{ ret void }}' if wrapped else "")
            reduced = (name, kind, (code, named.as_bitcode())), *rest
        calls = {
            (ADDRESSED[function.name], function.name)
            for function in result.library._final_module.functions
            if function.is_declaration and function.name in ADDRESSED
        }
        return _Kept(reduced, addressed, tuple(sorted(calls)))

    def flush(self) -> None:
        """Delete the machine code made from these sources."""
        shutil.rmtree(self.cache_path, ignore_errors=True)


def _write(file: Path, content: bytes) -> None:
    """Write a file of machine code whole or not at all."""
    if not file.parent.is_dir():
        _delete_unused(file.parent.parent)
        file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as partial:
        try:
            partial.write(content)
            partial.close()
            Path(partial.name).replace(file)
        except BaseException:
            partial.close()
            Path(partial.name).unlink(missing_ok=True)
            raise


def can_be_kept() -> bool:
    """Tell whether machine code can be kept; where it cannot, a warning says why."""
    file = cache_folder() / "writable"
    try:
        _write(file, b"")
        file.unlink(missing_ok=True)
    except OSError as error:
        _say_not_kept(str(error.strerror or error))
        return False
    return True


@cache
def _mark_used(folder: Path) -> None:
    with suppress(OSError):
        os.utime(folder)


def _delete_unused(folder: Path) -> None:
    """Delete machine code that no process has used for long."""
    if folder.is_dir():
        for entry in folder.iterdir():
            with suppress(OSError):
                if time.time() - entry.stat().st_mtime > KEPT_UNUSED:
                    shutil.rmtree(entry)


@cache
def _say_not_kept(why: str) -> None:
    warnings.warn(
        f"compiled kernels cannot be kept in {cache_folder()} ({why}), so each process compiles "
        f"them anew; name a folder that can be written with {FOLDER_VARIABLE}",
        KernelCacheWarning,
        stacklevel=2,
    )
