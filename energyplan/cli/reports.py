"""Reports of commands: what they were made from stands at their end."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from energyplan.output.report import Page

_command: ContextVar[tuple[str, tuple[str | Path, ...]]] = ContextVar("command", default=("", ()))
"""The command in hand as a shell takes it, and what it was given to read."""


def remember_command(words: Sequence[str], inputs: Sequence[str | Path]) -> None:
    """Keep the command in hand, and what it was given to read, for its report."""
    _command.set((shlex.join(words), tuple(inputs)))


def write_report(page: Page, file: Path) -> None:
    """Write a report, with the command and the files read at its end."""
    from energyplan.io.files import atomic_write, files_behind

    call, inputs = _command.get()
    read = dict.fromkeys(source for value in inputs for source in files_behind(value))
    page.made_from(call=call, files=read)
    atomic_write(file, page.html())
