"""The data folder of a service, read once for each state of its files; who works on requests."""

from __future__ import annotations

import errno
import os
import re
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from weakref import WeakValueDictionary

import numpy as np

from energyplan.compilation import compiling_shown
from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    InvalidInputError,
    TimeLimitError,
)
from energyplan.io.bags import BAG_SUFFIXES
from energyplan.io.documents import parsed_once
from energyplan.io.files import atomic_write, files_behind, is_file
from energyplan.io.flight import FLIGHT_SUFFIXES
from energyplan.io.maps import at_most
from energyplan.io.mission import read_battery
from energyplan.io.sites import SiteFile, load_site
from energyplan.logs.tables import unpacked_at_most
from energyplan.planning.budget import cancellable, end_if_unwanted
from energyplan.serve.requests import LONGEST
from energyplan.terrain import Site

T = TypeVar("T")

KINDS = {
    "maps": (".yaml", ".yml", ".map"),
    "models": (".yaml", ".yml"),
    "vehicles": (".yaml", ".yml"),
    "batteries": (".yaml", ".yml"),
    "missions": (".yaml", ".yml"),
    "logs": (".csv", ".csv.gz", ".parquet", *BAG_SUFFIXES, *FLIGHT_SUFFIXES),
    "surfaces": (".geojson", ".json"),
    "heights": (".asc", ".tif", ".tiff"),
}
"""What a data folder holds, and how the names end."""

_TELLING: tuple[tuple[str, set[str]], ...] = (
    ("missions", {"tasks"}), ("maps", {"map", "image"}),
    ("models", {"terms"}), ("vehicles", {"vehicle", "contacts", "track", "mass", "icr"}),
    ("batteries", {"chemistry", "unit_capacity", "capacity", "health", "preset"}),
)  # fmt: skip
"""Keys of which any shows what a YAML file is; the first kind that fits."""
_NAME = re.compile(r"[\w][\w .+-]*(/[\w][\w .+-]*)*")


class StoreLimits(NamedTuple):
    """What the store keeps."""

    name: int = 200  # letters of a name
    files: int = 32  # files whose content is kept
    # time between two looks whether who waits for a file is still waited for [s]
    look: float = 0.05


_STORE = StoreLimits()
_CELLS, _MOST = 2**24, 2**25  # most cells of a map, and of all that is kept but the newest
_UNPACKED, _TABLE = 2**26, 2**24  # most bytes of a table, after decompression, and cells
_Stamp = tuple[tuple[Path, int, int, int, int], ...]


class UnknownFileError(InvalidInputError):
    """The data folder has no such file."""


class Store:
    """Files of a folder by name; what was read is kept until one of the files behind it changes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        if not self.folder.is_dir():
            raise InvalidInputError(f"the data folder {folder} is no folder; create it first")
        self._kept: dict[Hashable, tuple[_Stamp, Any]] = {}
        self._lock = threading.Lock()
        self._turns: WeakValueDictionary[Hashable, threading.Lock] = WeakValueDictionary()

    def names(self) -> tuple[dict[str, list[str]], dict[str, str]]:
        """Return the names of all files by kind, and why others cannot be read.

        Those of the folder itself come before subfolders'. Maps, models, vehicles and missions are
        all YAML: their keys distinguish them.
        """
        found: dict[str, list[str]] = {kind: [] for kind in KINDS}
        unreadable: dict[str, str] = {}
        for file in sorted(self.folder.rglob("*"), key=lambda one: (len(one.parts), one)):
            name = file.relative_to(self.folder).as_posix()
            kinds = [kind for kind, ends in KINDS.items() if name.lower().endswith(ends)]
            if not kinds or not _NAME.fullmatch(name):
                continue
            try:
                if not file.is_file():
                    continue
                if not os.access(file, os.R_OK):
                    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
                yaml = file.suffix.lower() in (".yaml", ".yml")
                right = kind_of(file) if yaml else None
            except OSError as problem:  # such as of another user's file: the others are listed
                unreadable[name] = problem.strerror or str(problem)
                continue
            for kind in kinds:
                if right in (None, kind):
                    found[kind].append(name)
        return found, unreadable

    def path(self, name: str) -> Path:
        """Return the file of a name."""
        file = self._inside(name)
        if not is_file(file):
            raise UnknownFileError(f"the data folder has no file {name!r}")
        return file

    def _inside(self, name: str) -> Path:
        if len(name) > _STORE.name or not _NAME.fullmatch(name):
            raise UnknownFileError(f"{name[:80]!r} is no name of a file in the data folder")
        try:
            file = (self.folder / name).resolve()
        except (OSError, RuntimeError):  # such as a link to itself
            raise UnknownFileError(f"{name!r} cannot be followed") from None
        if not file.is_relative_to(self.folder):
            raise UnknownFileError(f"{name!r} lies outside the data folder")
        return file

    def site(self, named: SiteFile) -> Site:
        """Return a site; its map is the same object, with its tables, while its files are."""
        return load_site(named, lambda key, name, read: self.read(name, read), inside=True)

    def named(self, name: Any, read: Callable[[Any], T]) -> T:
        """Return what a file of the folder holds, or what a name stands for; paths are refused."""
        if isinstance(name, str) and name.endswith(KINDS["models"]):
            return self.read(name, read)
        if read is not read_battery and not re.fullmatch(r"[\w:-]+", name):
            raise UnknownFileError(f"{name!r} is neither a preset nor a file of the data folder")
        return read(name)

    def save(self, name: str, content: bytes) -> Path:
        """Write a new file, whole or not at all; one that is there is never replaced."""
        if not name.lower().endswith((*sum(KINDS.values(), ()), ".png", ".pgm")):
            raise InvalidInputError(f"{name!r} does not end like a file that the service reads")
        return atomic_write(self._inside(name), content, anew=True)

    def read(self, name: str, read: Callable[[Path], T], *more: Hashable, keep: bool = True) -> T:
        """Return what a file holds, read anew where it, or a file that it names, has changed.

        That it cannot be read is kept too; with `keep` false, nothing but that.
        """
        file = self.path(name)
        key = (more or read, file)
        with self._turn(key):  # who comes next finds what the first has read
            known = self._kept.get(key)
            if known is None or _stamp([part[0] for part in known[0]]) != known[0]:
                stamp = _stamp([file, *files_behind(file)])  # before: what changes then is seen
                self._kept.pop(key, None)
                content: T | _Refusal
                try:
                    content = read(file)
                except InvalidInputError as problem:
                    if not _lasts(problem):
                        raise
                    content = _Refusal(type(problem), str(problem), vars(problem))
                if not keep and not isinstance(content, _Refusal):
                    return content
                known = stamp, content
                with self._lock:
                    self._kept[key] = known
                    kept = self._kept
                    while len(kept) > _STORE.files or (len(kept) > 1 and _cells(kept) > _MOST):
                        kept.pop(next(iter(kept)))
        found: T | _Refusal = known[1]
        if isinstance(found, _Refusal):
            raise found.error()
        return found

    @contextmanager
    def _turn(self, key: Hashable) -> Iterator[None]:
        """Have only one read a file at a time; who waits may be cancelled."""
        with self._lock:
            turn = self._turns.setdefault(key, threading.Lock())  # until nobody holds it
        while not turn.acquire(timeout=_STORE.look):
            end_if_unwanted()
        try:
            yield
        finally:
            turn.release()


class _Refusal(NamedTuple):
    """Why a file cannot be read, without what its reading held."""

    kind: type[InvalidInputError]
    message: str
    values: dict[str, Any]

    def error(self) -> InvalidInputError:
        """Return it as an error."""
        error = self.kind.__new__(self.kind, self.message)
        vars(error).update(self.values)
        return error


def _lasts(problem: BaseException | None) -> bool:
    """Return whether a file is wrong, and not what reads it: of files, memory or disk."""
    while problem is not None:
        if isinstance(problem, OSError | MemoryError | ImportError):
            return False
        problem = problem.__context__
    return True


def _cells(kept: dict[Hashable, tuple[_Stamp, Any]]) -> int:
    """Return how many cells the maps, costs and heights of some content have."""
    count = 0
    for _, content in kept.values():
        for part in vars(content).values() if isinstance(content, Site) else (content,):
            for name in ("occupied", "costs", "heights"):
                count += np.size(getattr(part, name, ()))
    return count


def _stamp(files: list[Path]) -> _Stamp:
    """Return what changes when one of some files does."""
    found = []
    for file in dict.fromkeys(files):
        try:
            stat = file.stat()
            state = stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns
        except OSError:
            state = 0, 0, 0, 0
        found.append((file, *state))
    return tuple(found)


def kind_of(file: Path) -> str:
    """Return which kind of YAML file this is, by its keys; not each is one of `KINDS`."""
    with file.open("rb") as stream:
        text = stream.read(65536).decode("utf-8", "replace")
    keys = set(re.findall(r"^(\w+)\s*:", text, re.MULTILINE))
    return next((kind for kind, telling in _TELLING if telling & keys), "others")


# -- work ---------------------------------------------------------------------------------------


class BusyError(EnergyPlanError):
    """As much work waits as may wait; try again later."""


class StoppingError(BusyError):
    """The service is ending; another one, or the next, has the answer."""


class Job:
    """A job: its answer, its messages on the way, and whether it is still wanted."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()
        self.future: Future[Any] = Future()
        self.said: list[dict[str, Any]] = []
        self._until = inf

    def say(self, event: str, **values: Any) -> None:
        """Report progress; raise `CancelledError` where the work is unwanted."""
        if self.unwanted():
            raise CancelledError("the request was cancelled")
        self.said.append({"event": event, **values})

    def limit(self, seconds: float) -> None:
        """Have the work end within a time from now on [s]."""
        self._until = time.monotonic() + seconds

    @contextmanager
    def untimed(self) -> Iterator[None]:
        """Have what is done inside not count."""
        left, self._until = self._until - time.monotonic(), inf
        yield
        self._until = time.monotonic() + left

    @property
    def late(self) -> bool:
        """Whether its time is over."""
        return time.monotonic() > self._until

    def unwanted(self) -> bool:
        """Whether to end."""
        return self.cancelled.is_set() or self.late


class Pool:
    """Threads for work that releases the GIL, with a bounded queue."""

    def __init__(self, workers: int | None = None, waiting: int = 32) -> None:
        self.workers = workers or os.cpu_count() or 1
        self.waiting = waiting
        self.closing = False
        self._jobs: set[Job] = set()  # that are done or wait
        self._threads = ThreadPoolExecutor(self.workers, thread_name_prefix="energyplan")
        self._lock = threading.Lock()

    @property
    def load(self) -> int:
        """Number of pieces of work that are done or wait."""
        return len(self._jobs)

    def submit(self, work: Callable[[Job], Any]) -> Job:
        """Submit a job."""
        job = Job()
        with self._lock:
            if self.closing:
                raise StoppingError("the service is ending; try again in a while")
            if self.load >= self.workers + self.waiting:
                raise BusyError(f"{self.waiting} requests wait already; try again in a while")
            self._jobs.add(job)
            job.say("queued")
            self._threads.submit(self._run, job, work)
        return job

    def _run(self, job: Job, work: Callable[[Job], Any]) -> None:
        try:
            job.say("started")
            with (
                cancellable(job.unwanted), at_most(_CELLS), unpacked_at_most(_UNPACKED, _TABLE),
                parsed_once(), compiling_shown(lambda far: job.say("compiling", **far._asdict())),
            ):  # fmt: skip
                job.future.set_result(work(job))
        except BaseException as error:  # noqa: BLE001  for whoever waits
            if isinstance(error, CancelledError) and job.late and not job.cancelled.is_set():
                error = TimeLimitError(
                    "time was over before the answer; give less effort, or a "
                    f"time_limit of up to {LONGEST:g} s"
                )
            job.future.set_exception(error)
        finally:
            with self._lock:
                self._jobs.discard(job)

    def close(self) -> None:
        """End all work, and take no more."""
        with self._lock:
            self.closing = True
            for job in self._jobs:
                job.cancelled.set()
        self._threads.shutdown(wait=False)
