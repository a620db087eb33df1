"""Lines of a file that grows, is cut or is replaced, or of a pipe."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from energyplan.errors import DriveLogError

_BLOCK = 1 << 16
MAX_LINE = 1 << 16
"""Longest line that is read [bytes]."""


@dataclass(frozen=True)
class Line:
    r"""A line of a log.

    Parameters
    ----------
    number : int
        Its number in the file; the first is 1.
    text : str
        Its text, without the end of line.
    whole : bool
        Whether its end has been written.

    Examples
    --------
    >>> import io
    >>> next(lines_of(io.BytesIO(b"t,power\n0,12\n")))
    Line(number=1, text='t,power', whole=True)
    """

    number: int
    text: str
    whole: bool = True


@dataclass(frozen=True)
class Restart:
    """The file begins anew.

    Parameters
    ----------
    reason : str
        What happened to it.

    Examples
    --------
    >>> Restart("the file was cut").reason
    'the file was cut'
    """

    reason: str


def follow(path: str | Path, wait: Callable[[], bool] | None = None) -> Iterator[Line | Restart]:
    """Yield the lines of a file, and those that are added to it.

    Parameters
    ----------
    path : str or Path
        The file.
    wait : callable, optional
        Called where there is nothing new; it waits a moment, and returns whether to go on. Where
        not given, the end of the file ends it.

    Yields
    ------
    Line or Restart
        The lines; a `Restart` where the file was cut or another took its place.

    Raises
    ------
    DriveLogError
        If the file cannot be read, or a line is too long.

    Examples
    --------
    >>> from energyplan.io.bundled import bundled
    >>> next(follow(bundled("warehouse.yaml"))).number
    1
    """
    file = Path(path)
    stream = _open(file)
    try:
        pending, number = b"", 0
        while True:
            block = stream.read(_BLOCK)
            if block:
                *ended, pending = (pending + block).split(b"\n")
                for raw in ended:
                    number += 1
                    yield Line(number, _text(raw))
                _limit(pending, file, number + 1)
                continue
            reason = _begun_anew(file, stream)
            if reason:
                if pending:
                    yield Line(number + 1, _text(pending), whole=False)
                stream.close()
                stream = _open(file)
                pending, number = b"", 0
                yield Restart(reason)
            elif wait is None or not wait():
                break
        if pending:
            yield Line(number + 1, _text(pending), whole=False)
    finally:
        stream.close()


def lines_of(stream: BinaryIO | Iterable[bytes]) -> Iterator[Line | Restart]:
    r"""Yield the lines of a pipe until it ends.

    Parameters
    ----------
    stream : iterable of bytes
        An open binary file, such as ``sys.stdin.buffer``, or lines with their ends.

    Yields
    ------
    Line
        The lines.

    Raises
    ------
    DriveLogError
        If a line is too long.

    Examples
    --------
    >>> import io
    >>> [line.text for line in lines_of(io.BytesIO(b"t,power\n0,12\n"))]
    ['t,power', '0,12']
    """
    read = getattr(stream, "readline", None)
    raws = iter(stream) if read is None else iter(lambda: read(MAX_LINE + 1), b"")
    for number, raw in enumerate(raws, start=1):
        _limit(raw, Path("-"), number)
        yield Line(number, _text(raw), raw.endswith(b"\n"))


def _open(file: Path) -> BinaryIO:
    try:
        return file.open("rb")
    except OSError as problem:
        raise DriveLogError(f"{file} cannot be read: {problem.strerror or problem}") from None


def _begun_anew(file: Path, stream: BinaryIO) -> str:
    """Tell what happened to the file; empty where nothing did, or where it is not there now."""
    try:
        there = file.stat()
    except OSError:
        return ""
    ours = os.fstat(stream.fileno())
    if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
        return "another file took its place"
    return "the file was cut" if there.st_size < stream.tell() else ""


def _limit(raw: bytes, file: Path, number: int) -> None:
    if len(raw) > MAX_LINE:
        raise DriveLogError(
            f"{file}, line {number} is longer than {MAX_LINE >> 10} KiB; this is no table of "
            "numbers in text"
        )


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace").rstrip("\r\n")
