"""What commands give: the answer, text with it, progress, and reports."""

from __future__ import annotations

import json as jsonlib
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from energyplan.output.pages import Page


presets_used: ContextVar[dict[str, str]] = ContextVar("presets", default={})  # noqa: B039
"""Preset models that the current command uses, with their sources; never changed in place."""
short_names: ContextVar[list[str]] = ContextVar("names", default=[])  # noqa: B039
"""What the short names of vehicles stand for, in the current command; never changed in place."""
NO, INTERRUPTED = 3, 130
"""Exit codes of a negative answer with ``--strict``, and of Ctrl-C."""
_ESCAPED = {
    code: f"\\u{code:04x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"
}
"""Control characters as JSON writes them: a name from a file gives a terminal no command."""


def printable(text: str) -> str:
    """Return text without control characters other than line breaks and tabs."""
    return text.translate(_ESCAPED)


def say(text: str) -> None:
    """Print a line of the answer."""
    sys.stdout.write(printable(text) + "\n")


def give_up_stdout() -> None:
    """Write no more answers: Python, when it ends, must not try to write to what was closed."""
    sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115


def warn(text: str) -> None:
    """Print a line that is no part of the answer."""
    sys.stderr.write(printable(text) + "\n")


def answer(document: dict[str, Any], text: object, *, json: bool, then: str = "") -> None:
    """Print the answer, as JSON or as text, of which a list holds parts; JSON names presets.

    Text ends with the command that one would give next.
    """
    warn_with_answer()
    if json:
        if presets_used.get():
            from energyplan.io.sites import with_presets

            document = with_presets(document, presets_used.get())
        say(jsonlib.dumps(document, indent=1, allow_nan=False))
    else:
        say("\n".join(map(str, text)) if isinstance(text, list) else str(text))
        if then:
            say(f"next: {then}")


def warn_with_answer() -> None:
    """Name the presets with the answer, so that an error stays one line."""
    for note in short_names.get():
        warn(note)
    for name, source in presets_used.get().items():
        warn(f"preset {name} was not measured on this robot; source: {source}")


def verdict(yes: bool, strict: bool) -> None:
    """End with another exit code where the answer is no and ``--strict`` was given."""
    if strict and not yes:
        raise typer.Exit(NO)


@contextmanager
def progress(text: str) -> Iterator[Any]:
    """Show on stderr that work goes on; yields ``update(fraction, text)``."""
    if not sys.stderr.isatty():
        yield lambda fraction, note="": None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from energyplan.compilation import Compiling, compiling_shown, telling

    # A bar without a total moves to and fro, until the work reports its progress.
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=None)

        def compiling(how_far: Compiling) -> None:
            bar.update(task, description=str(how_far), total=how_far.total, completed=how_far.done)
            if how_far.done == how_far.total:
                bar.update(task, description=text, total=None, completed=0)

        def late(name: str) -> None:
            note = name.removeprefix("energyplan.")
            if note and not bar.tasks[task].total:
                bar.update(task, description=f"compiling, once: {note}")

        with compiling_shown(compiling), telling(late):
            yield lambda fraction, note="": bar.update(
                task, total=1.0, completed=fraction, description=printable(note or text)
            )


_command: ContextVar[tuple[tuple[str, ...], tuple[str | Path, ...]]] = ContextVar(
    "command", default=((), ())
)
"""The words of the command in hand, and what it was given to read."""


def remember_command(words: Sequence[str], inputs: Sequence[str | Path]) -> None:
    """Keep the command in hand, and what it was given to read."""
    _command.set((tuple(words), tuple(inputs)))


FLAGS = "--at-battery", "--unsigned"
"""Options without a value, of those that the next command takes too."""


def following(command: str, *words: str | Path, keep: str) -> str:
    """Return a command as a shell takes it, with some options of the one in hand."""
    given, kept, known = _command.get()[0], list[str](), keep.split()
    for k, word in enumerate(given):
        name, joined, _ = word.partition("=")
        if name in known:
            kept += [word] if joined or name in FLAGS else [word, *given[k + 1 : k + 2]]
    return f"energyplan {command} {shlex.join([*map(str, words), *kept])}"


def write_report(page: Page, file: Path) -> None:
    """Write a report, with the command and the files read at its end."""
    from energyplan.io.files import atomic_write, files_behind

    words, inputs = _command.get()
    read = dict.fromkeys(source for value in inputs for source in files_behind(value))
    page.made_from(call=shlex.join(words), files=read)
    atomic_write(file, page.html())
