"""Writing files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from energyplan.errors import InvalidInputError


def atomic_write(path: str | Path, content: bytes | str) -> Path:
    """Write a file so that it is never seen half written.

    The content goes to a temporary file in the same folder, which then takes the file's place. A
    run that is killed leaves the old file whole.

    Parameters
    ----------
    path : str or Path
        The file; its folder is made where it is absent.
    content : bytes or str
        The content; text is written as UTF-8.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InvalidInputError
        If the file cannot be written.
    """
    file = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        target = file.resolve()  # through a symbolic link, which stays one
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        handle, name = tempfile.mkstemp(prefix=f".{target.name[:100]}.", dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            Path(name).chmod(mode)
            Path(name).replace(target)
        finally:
            Path(name).unlink(missing_ok=True)
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise InvalidInputError(
            f"{str(file)!r} cannot be written: {reason}; choose another place"
        ) from None
    return file


def is_file(path: str | Path) -> bool:
    """Tell whether there is a file of that name; one that no file can bear is none.

    Parameters
    ----------
    path : str or Path
        The name.

    Returns
    -------
    bool
        Whether there is.
    """
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def _umask() -> int:
    """Permissions that new files do not get; the system tells them only when they are set."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
