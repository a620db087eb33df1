"""Command line: argument parsing only; every command is one library call."""

from __future__ import annotations

import errno
import functools
import io
import sys
import warnings
from typing import Any

import typer
from typer.main import get_command

from energyplan.cli import learn, loop, programs, routes
from energyplan.cli.answers import INTERRUPTED, give_up_stdout, warn
from energyplan.cli.app import app, misuse
from energyplan.errors import EnergyPlanError, TimeLimitError

__all__ = ["app", "commands", "main"]

_REGISTERED = (learn, routes, loop, programs)
"""Modules that register commands when they are imported."""


@functools.cache
def commands() -> Any:
    """Return the group of all commands, built from `app` once a process: it takes a while."""
    return get_command(app)


def main() -> None:
    """Entry point: map errors to exit codes and one line on stderr."""
    warnings.showwarning = _show_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = commands()(prog_name="energyplan", standalone_mode=False) or 0
        if sys.stdout is not None:
            sys.stdout.flush()
    except TimeLimitError as error:
        code = _fail(str(error), 1)
    except BrokenPipeError:
        give_up_stdout()
        code = _fail("the standard output was closed before the answer was written", 1)
    except (EnergyPlanError, OSError) as error:
        full = isinstance(error, OSError) and error.errno == errno.ENOSPC
        if full:
            give_up_stdout()
        message = "the answer cannot be written: the disk is full" if full else str(error)
        code = _fail(message, 1 if full else 2)
    except typer.TyperException as error:
        code = _fail(misuse(error), error.exit_code)
    if code == INTERRUPTED:  # typer turns Ctrl-C into an exit with this code
        _fail("interrupted; no file is half written", code)
    sys.exit(code)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Say a warning of the library in one line, and leave out where in its sources it arose."""
    warn("energyplan: " + " ".join(str(message).split()))


def _fail(message: str, code: int) -> int:
    warn("energyplan: " + " ".join(message.split()))
    return code
