"""Compressed parts of bags, unpacked to no more than a part may hold.

rosbags unpacks a part in full before it looks at its size, and a few kilobytes can hold gigabytes.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from bz2 import BZ2Decompressor
from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace, TracebackType
from typing import Any, BinaryIO

LARGEST = 1 << 28
"""Most that a part of a bag holds when unpacked [bytes]. Recorders end a part after a few MiB, and
no message is as large."""
LARGEST_RATIO = 1000
"""Most that a file grows which is compressed as a whole; what sensors see does not repeat so."""


def unpacked(make: Callable[[], Any], data: bytes, most: int = LARGEST) -> bytes:
    """Unpack a compressed part of a bag."""
    most = min(most, LARGEST)
    parts: list[bytes] = []
    while data or not parts:
        one = make()
        try:
            part = one.decompress(data, max_length=most - sum(map(len, parts)) + 1)
        except (OSError, EOFError, RuntimeError, _zstd_error()) as problem:
            raise ValueError(f"a compressed part is damaged ({problem})") from None
        parts.append(part)
        if sum(map(len, parts)) > most:
            raise ValueError(f"a compressed part holds more than the {most} bytes it may hold")
        if not one.eof:
            raise ValueError("a compressed part ends early")
        data = one.unused_data or b""
    return b"".join(parts)


class UnpackedFile:
    """A compressed file as it is unpacked, with an end to its size."""

    def __init__(self, stream: BinaryIO, most: int) -> None:
        self._stream, self._left = stream, most

    def __enter__(self) -> UnpackedFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stream.close()

    def read(self, size: int) -> bytes:
        """Return the next bytes, at most so many."""
        try:
            data = self._stream.read(size)
        except _zstd_error() as problem:
            raise ValueError(f"a compressed file is damaged ({problem})") from None
        self._left -= len(data)
        if self._left < 0:
            raise ValueError("a compressed file is too large when unpacked, for a bag or this disk")
        return data


def bound_unpacking() -> None:
    """Have rosbags unpack by `unpacked`, in the whole process; doing so again changes nothing."""
    zstd = _zstd()
    lz4 = import_module("lz4.frame")
    mcap = import_module("rosbags.rosbag2.storage_mcap")
    makers = {"lz4": lz4.LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor}
    for name, make in makers.items():
        mcap.DECOMPRESSORS[name] = lambda data, size, make=make: unpacked(make, data, size)
    first = import_module("rosbags.rosbag1.reader")
    for name, make in {"lz4": makers["lz4"], "bz2": BZ2Decompressor}.items():
        first.decompressors[name] = lambda data, make=make: unpacked(make, data)

    def unpacked_file(stream: BinaryIO, mode: str) -> UnpackedFile:
        most = LARGEST_RATIO * os.fstat(stream.fileno()).st_size
        free = shutil.disk_usage(tempfile.gettempdir()).free
        return UnpackedFile(zstd.open(stream, mode), min(most, free // 2))

    second: Any = import_module("rosbags.rosbag2.reader")
    second.zstd = SimpleNamespace(
        open=unpacked_file, decompress=lambda data: unpacked(zstd.ZstdDecompressor, data)
    )


def _zstd() -> Any:
    """Return the module of Zstandard that rosbags brings along."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")


def _zstd_error() -> type[Exception]:
    error: type[Exception] = _zstd().ZstdError
    return error
