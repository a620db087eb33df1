"""The library's own files; writing files whole or not at all, and never over what is read."""

from __future__ import annotations

import errno
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from energyplan.errors import InvalidInputError, StorageError, UnknownNameError
from energyplan.io.documents import load

_PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> dict[str, Path]:
    """Return the files that come with the library by name: the package's, or the checkout's."""
    checkout = [_PACKAGE.parent / name for name in ("maps", "examples")]
    packed = _PACKAGE / "bundle"  # is in every installed package, and in no checkout
    folders = [packed] if packed.is_dir() else checkout
    return {file.name: file for folder in folders if folder.is_dir() for file in folder.iterdir()}


def bundled(name: str) -> Path:
    """Return the path of a file that comes with the library."""
    files = bundle()
    if name not in files:
        raise UnknownNameError("bundled file", name, files)
    return files[name]


_PROBE = bytes(1 << 16)  # what a place must be able to take before work for it begins
_LARGEST_JSON = 1 << 25  # bytes of a file of surfaces that is searched for names of files
_OF_THE_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # whatever the name of the file
_MOST_FILES = 1000  # of a folder that is read as one thing


def atomic_write(path: str | Path, content: bytes | str, *, anew: bool = False) -> Path:
    """Write a file so that it is never seen half written; `anew` it never replaces another."""
    file = Path(path)
    data = _utf8(content) if isinstance(content, str) else content
    with _writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        target = _regular(file)
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        handle, name = tempfile.mkstemp(prefix=f".{target.name[:100]}.", dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            Path(name).chmod(mode)
            if anew:
                target.hardlink_to(name)
            else:
                Path(name).replace(target)
        finally:
            Path(name).unlink(missing_ok=True)
    return file


def _utf8(text: str) -> bytes:
    """Encode text, with a mark in place of what UTF-8 does not have."""
    known = re.sub("[\ud800-\udc7f\udd00-\udfff]", "\ufffd", text)
    return known.encode("utf-8", "surrogateescape").decode("utf-8", "replace").encode()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Say of what goes wrong that a file or folder cannot be written."""
    try:
        yield
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        ours = isinstance(problem, OSError) and problem.errno in _OF_THE_DISK
        raise (StorageError if ours else InvalidInputError)(
            f"{str(path)!r} cannot be written: {reason}; "
            f"{'make room, or ' if ours else ''}choose another place"
        ) from None


def _regular(file: Path) -> Path:
    """Return what a name stands for, through a symbolic link, which stays one."""
    target = file.resolve()
    if target.is_dir():
        raise ValueError("it is a folder")
    if target.exists() and not target.is_file():  # such as /dev/full, which is not to be replaced
        raise ValueError("it is no regular file")
    return target


def check_output(path: str | Path, suffixes: Sequence[str] = ()) -> None:
    """Refuse a file that could not be written, before the work for it begins."""
    file = Path(path)
    if suffixes and file.suffix.lower() not in suffixes:
        raise InvalidInputError(
            f"{str(file)!r} cannot be written: its name must end with {' or '.join(suffixes)}"
        )
    with _writing(file):
        target = _regular(file)
        if not target.parent.is_dir():
            raise ValueError(f"there is no folder {str(file.parent)!r}")
        if target.exists() and not os.access(target, os.W_OK):
            raise ValueError("it is protected against writing")
        _probe(target.parent)


def check_output_folder(path: str | Path) -> None:
    """Refuse an output folder that could not be created or filled, before the work begins."""
    folder = Path(path)
    with _writing(folder):
        there = folder.resolve()
        while not there.exists() and there != there.parent:
            there = there.parent
        if not there.is_dir():
            raise ValueError(f"{str(there)!r} is no folder")
        _probe(there)


def _probe(folder: Path) -> None:
    """Write a little to a folder, and take it away again."""
    with tempfile.NamedTemporaryFile(prefix=".energyplan.", dir=folder) as stream:
        stream.write(_PROBE)
        stream.flush()
        os.fsync(stream.fileno())


def refuse_overwriting(outputs: Sequence[str | Path], inputs: Iterable[str | Path]) -> None:
    """Refuse an output that is an input, or that is another output."""
    written = [Path(output) for output in outputs]
    for k, output in enumerate(written):
        if any(same_file(output, other) for other in written[:k]):
            raise InvalidInputError(
                f"{str(output)!r} is to be written twice; give every output a file of its own"
            )
    if not written:
        return
    for source in inputs:
        for file in files_behind(source):
            for output in written:
                if same_file(output, file):
                    owner = "" if same_file(file, Path(source)) else f" (it belongs to {source})"
                    raise InvalidInputError(
                        f"{str(output)!r} is read{owner}, and would be lost; write to another file"
                    )


def same_file(one: Path, other: Path) -> bool:
    """Whether two names mean one file, through links too."""
    try:
        if one.exists() and other.exists():
            return one.samefile(other)
        return one.resolve() == other.resolve()
    except (OSError, ValueError):
        return False


def files_behind(source: str | Path) -> list[Path]:
    """Return the files that reading one may read: itself, and those that it names."""
    found: dict[Path, None] = {}
    try:
        if isinstance(source, Path) and source.is_dir():
            found = {inner: None for inner in sorted(source.iterdir()) if inner.is_file()}
        elif is_file(source):
            _follow(Path(source), found)
    except OSError:
        return []
    return list(found)


def strings_behind(source: str | Path) -> set[str]:
    """Return the strings in a configuration file and in those that it names."""
    return {text for file in files_behind(source) for text in _strings(_content(file))}


def _follow(file: Path, found: dict[Path, None]) -> None:
    """Take a file, and those that it names."""
    if file in found or len(found) >= _MOST_FILES or not is_file(file):
        return
    found[file] = None
    beside = file.with_name(file.name.replace("pro_", "imu_", 1))  # of a Husky's wheel file
    names = [beside.name] if beside != file else []
    for name in (*names, *_strings(_content(file))):
        near = file.parent / name
        _follow(near if is_file(near) else bundle().get(name, near), found)


def _content(file: Path) -> Any:
    """Return a configuration file's content; None of what is none, or is malformed."""
    try:
        if file.suffix.lower() in (".yaml", ".yml"):
            return load(file, InvalidInputError).data
        if file.suffix.lower() in (".json", ".geojson") and file.stat().st_size <= _LARGEST_JSON:
            return json.loads(file.read_bytes())
    except (InvalidInputError, OSError, ValueError, RecursionError):
        pass  # whoever reads it will say what is wrong
    return None


def _strings(content: Any) -> Iterator[str]:
    """Yield the strings that could be names of files."""
    waiting = [content]
    while waiting:
        item = waiting.pop()
        if isinstance(item, dict):
            waiting += item.values()
        elif isinstance(item, list):
            waiting += item
        elif isinstance(item, str) and 0 < len(item) < 4096 and "\0" not in item:
            yield item


def is_file(path: str | Path) -> bool:
    """Return whether a file of that name exists; False for a name that no file can have."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: str | Path) -> bool:
    """Return whether a folder of that name exists; False for a name that no folder can have."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def _umask() -> int:
    """Permissions that new files do not get; the system returns them only when they are set."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
