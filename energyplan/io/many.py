"""One function over many files, on a cluster: an answer for each as it is ready, none twice."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from energyplan import __version__
from energyplan.compilation import processors
from energyplan.errors import EnergyPlanError, InvalidInputError, needs_extra
from energyplan.io.documents import MAX_BYTES, read_bytes
from energyplan.io.files import atomic_write, files_behind

Line = dict[str, Any]


_TRIES = 3
"""How many processes may be killed at one file, as in Dask."""


class _Local(ThreadPoolExecutor):
    """A thread on each core, with a process each: a killed one loses no other's work."""

    def __init__(self) -> None:
        super().__init__(processors())
        self._own = threading.local()
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        return super().submit(self._run, fn, *args, **named)

    def _run(self, fn: Callable[..., Any], *args: Any, **named: Any) -> Any:
        for _ in range(_TRIES):
            if (pool := getattr(self._own, "pool", None)) is None:
                spawned = multiprocessing.get_context("spawn")  # no threads are copied
                pool = self._own.pool = ProcessPoolExecutor(1, mp_context=spawned)
                self._pools.append(pool)
            try:
                return pool.submit(fn, *args, **named).result()
            except BrokenExecutor:
                self._own.pool = None
        raise EnergyPlanError(
            f"its process was killed {_TRIES} times, perhaps since memory is short; try it alone"
        )

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        super().shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)


@contextmanager
def cluster(
    address: str,
    *,
    insecure: bool = False,
    ca: str | Path | None = None,
    certificate: str | Path | None = None,
    key: str | Path | None = None,
) -> Iterator[Executor]:
    """Start a process on each core (``local``), or connect to Dask's scheduler at an address.

    Parameters
    ----------
    address : str
        ``local``, or the address of a scheduler, as ``tls://HOST:8786``.
    insecure : bool
        Allow an address without TLS: whoever reaches such a scheduler or its workers runs code as
        their user.
    ca, certificate, key : str or Path, optional
        Files in PEM of the authority, and of the certificate and key to show. What is not given is
        that of Dask's configuration (``distributed.comm.tls``).

    Yields
    ------
    concurrent.futures.Executor
        For `answers`. A local process that is killed is replaced; only its own file is repeated.

    Raises
    ------
    InvalidInputError
        If the address is not encrypted, no cluster answers there, or it wants a certificate.
    """
    files = {"tls_ca_file": ca, "tls_client_cert": certificate, "tls_client_key": key}
    given = {name: str(file) for name, file in files.items() if file is not None}
    if given and not address.startswith("tls://"):
        raise InvalidInputError(f"{address!r} uses no certificates; give tls://HOST:PORT")
    if address == "local":
        pool = _Local()
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    if not (insecure or address.startswith("tls://")):
        raise InvalidInputError(
            f"{address!r} is not encrypted, and whoever reaches it runs code as you; give "
            "tls://HOST:PORT, or --insecure-cluster (insecure=True in Python) in a network where "
            "you trust everybody"
        )
    with needs_extra("cluster", "a cluster"):
        from distributed import Client
        from distributed.security import Security
    for file in given.values():
        read_bytes(Path(file), MAX_BYTES, InvalidInputError, "give a file in PEM")
    try:
        security = Security(require_encryption=not insecure, **given)
        client = Client(address, timeout=10, security=security)
    except TypeError:  # of Dask, without a certificate
        raise InvalidInputError(
            f"{address!r} wants a certificate; give --cluster-ca, --cluster-cert and --cluster-key "
            "(ca, certificate and key in Python)"
        ) from None
    except (OSError, ValueError) as problem:
        why = " ".join(str(problem).split())
        raise InvalidInputError(
            f"no cluster answers at {address!r} ({why}); start one with dask scheduler, or write "
            "local for the cores of this machine"
        ) from None
    with client:
        yield client.get_executor(pure=False)


def answers(
    work: Callable[[Path], Mapping[str, Any]],
    files: Iterable[str | Path],
    executor: Executor,
    results: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Iterator[Line]:
    """Apply a function to many files; yield each answer when it is ready.

    Parameters
    ----------
    work : callable
        Answers one file by a dictionary that JSON can hold.
    files : iterable of str or Path
        The files, which workers read by the same names.
    executor : concurrent.futures.Executor
        Who works: that of `cluster`, or any other.
    results : str or Path, optional
        A file of JSON lines that each answer is added to. Files that it has an answer of are
        skipped, unless they, or files that they name, or the settings have changed since.
    settings : mapping, optional
        What else the answers depend on.

    Yields
    ------
    dict
        The ``file``, the ``checksum`` of all that was read, and the answer, or the ``error``.
    """
    checksums = {str(file): _checksum(file, settings or {}) for file in files}
    target = None if results is None else Path(results)
    kept = {} if target is None else _kept(target, checksums)
    if target is not None:
        atomic_write(target, "".join(kept.values()))
    pending = {executor.submit(work, Path(one)): one for one in checksums if one not in kept}
    for future in as_completed(pending):
        name = pending.pop(future)
        line: Line = {"file": name, "checksum": checksums[name]}
        try:
            line = {**line, **future.result()}
            text = json.dumps(line, allow_nan=False)
        except Exception as error:  # noqa: BLE001  a file that fails stops no other
            line = {**line, "error": " ".join(str(error).split()) or type(error).__name__}
            text = json.dumps(line)
        if target is not None:
            with target.open("a", encoding="utf-8") as stream:
                stream.write(f"{text}\n")
        yield line


def _checksum(file: str | Path, settings: Mapping[str, Any]) -> str:
    """Return a checksum of all that the answer to a file depends on."""
    found = hashlib.sha256(repr((__version__, sorted(settings.items()))).encode())
    for value in (file, *settings.values()):
        for part in files_behind(value) if isinstance(value, str | Path) else ():
            found.update(hashlib.sha256(part.read_bytes()).digest())
    return found.hexdigest()


def _kept(results: Path, checksums: Mapping[str, str]) -> dict[str, str]:
    """Return the lines of a file of results that still hold, by file; none that was cut off."""
    kept = {}
    try:
        lines = results.read_text(encoding="utf-8").split("\n") if results.exists() else [""]
    except UnicodeDecodeError:
        raise InvalidInputError(
            f"{results} is no text in UTF-8; name another file of results"
        ) from None
    if _cut_off(lines[-1]):
        lines.pop()
    for number, line in enumerate(lines, 1):
        try:
            found = json.loads(line)
            holds = found["checksum"] == checksums.get(found["file"], found["checksum"])
        except (ValueError, TypeError, KeyError):
            raise InvalidInputError(
                f"{results}, line {number} is no answer to a file; name another file of results"
            ) from None
        if holds and "error" not in found:
            kept[found["file"]] = f"{line}\n"
    return kept


def _cut_off(line: str) -> bool:
    """Return whether the last line is empty, or the beginning of an answer."""
    begin = '{"file": '
    if not (line.startswith(begin) or begin.startswith(line)):
        return False
    try:
        json.loads(line)
    except ValueError:
        return True
    return False
