"""Command line: argument parsing only; every command is one library call."""

from __future__ import annotations

import _thread
import errno
import functools
import io
import sys
import threading
import warnings
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer
from typer.main import get_command
from typer.models import CommandInfo

from energyplan.cli import (
    _fitting,
    _interop,
    _loop,
    _mission,
    _planning,
    _watch,
)
from energyplan.cli.answers import INTERRUPTED, answer, give_up_stdout, progress, warn
from energyplan.cli.app import app, misuse
from energyplan.cli.options import Json, writes_folder
from energyplan.errors import EnergyPlanError, MissingDependencyError, TimeLimitError

__all__ = ["app", "commands", "main"]

_COMMANDS = (
    _fitting, _planning, _interop, _mission, _loop, _watch,
)  # fmt: skip
"""Modules that register commands when they are imported."""

_FIRST = (
    "start", "identify", "diagnose", "plan", "compare", "check", "range", "mission", "watch",
    "drive", "close-the-loop", "design", "serve", "warmup", "demo",
)  # fmt: skip
"""Commands in the order of the help: what a newcomer needs first stands first."""


@app.command(epilog="Example: energyplan demo --out demo")
def demo(
    out: Annotated[Path, typer.Option(callback=writes_folder, help="Folder for the files.")] = Path(
        "demo"
    ),
    json: Json = False,
) -> None:
    """Run the whole chain on bundled input.

    Makes pictures and a web page.
    """
    from energyplan.demo import run

    files = run(out, say=(lambda text: None) if json else warn)
    names = [str(name) for name in files]
    answer({"files": names}, [*names, f"open {out / 'index.html'} in a browser"], json=json)


@app.command(epilog="Example: energyplan serve maps --port 8321")
def serve(
    folder: Annotated[Path, typer.Argument(help="Folder with maps, models, missions and logs.")],
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port.")] = 8321,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="ENERGYPLAN_TOKEN",
            help="Secret that each request must carry. Default: a random one, printed with the "
            "address.",
        ),
    ] = None,
    no_token: Annotated[
        bool, typer.Option("--no-token", help="Let all users of this machine ask without one.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Requests worked on at once. Default: one a core.")
    ] = None,
    waiting: Annotated[
        int, typer.Option(min=0, help="Requests that may wait; further ones are refused.")
    ] = 32,
) -> None:
    """Serve plans and missions over HTTP.

    Also serves checks and diagnoses, and a page to try them on.
    """
    from energyplan.serve import run

    run(folder, host, port, token, workers, waiting, no_token)


@app.command(epilog="Example: energyplan warmup --json")
def warmup(
    processes: Annotated[
        int, typer.Option(min=1, max=2, help="Processes that share the work.")
    ] = 2,
    json: Json = False,
) -> None:
    """Compile all kernels ahead.

    In a container image or on a test machine, later commands then start at once.
    """
    from importlib import import_module

    from energyplan.compilation import cache_folder, compile_kernels, kernel_modules

    modules = kernel_modules()
    with progress("compiling"):
        for module in modules:
            import_module(module)
        made = compile_kernels(*modules, processes=processes)
    document = {
        "folder": str(cache_folder()),
        "compiled": list(made.compiled),
        "found": made.found,
        "kept": made.kept,
        "processes": made.processes,
        "seconds": made.seconds,
    }
    text = (
        f"{len(made.compiled)} kernels compiled in {made.seconds:.1f} s by {made.processes} "
        f"process{'es' if made.processes > 1 else ''}, {made.found} found; "
    )
    where = f"kept in {cache_folder()}" if made.kept else "not kept: the next process compiles too"
    answer(document, [text + where], json=json)


def _place(command: CommandInfo) -> int:
    name = command.name or getattr(command.callback, "__name__", "").replace("_", "-")
    return _FIRST.index(name) if name in _FIRST else len(_FIRST)


app.registered_commands.sort(key=_place)


@functools.cache
def commands() -> Any:
    """Return the group of all commands, built from `app` once a process: it takes a while."""
    return get_command(app)


def main() -> None:
    """Entry point: map errors to exit codes and one line on stderr."""
    warnings.showwarning = _show_warning
    if sys.unraisablehook is sys.__unraisablehook__:  # not that of a program around this one
        sys.unraisablehook = _interrupt_again
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = commands()(prog_name="energyplan", standalone_mode=False) or 0
        if sys.stdout is not None:
            sys.stdout.flush()
    except (TimeLimitError, MissingDependencyError) as error:
        code = _fail(str(error), 1)
    except BrokenPipeError:
        code = _silent("the standard output was closed before the answer was written")
    except (EnergyPlanError, OSError) as error:
        full = isinstance(error, OSError) and error.errno == errno.ENOSPC
        code = _silent("the answer cannot be written: the disk is full") if full else 0
        code = code or _fail(str(error), 2)
    except typer.TyperException as error:
        code = _fail(misuse(error), error.exit_code)
    if code == INTERRUPTED:  # typer turns Ctrl-C into an exit with this code
        _fail("interrupted; files are as they were", code)
    sys.exit(code)


def _interrupt_again(lost: sys.UnraisableHookArgs) -> None:
    """Let Ctrl-C end the command where Python drops it, such as while a kernel is loaded."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Timer(0.05, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(lost)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Say a warning of the library in one line, and leave out where in its sources it arose."""
    warn("energyplan: " + " ".join(str(message).split()))


def _silent(message: str) -> int:
    """Say that the answer is lost."""
    give_up_stdout()
    return _fail(message, 1)


def _fail(message: str, code: int) -> int:
    warn("energyplan: " + " ".join(message.split()))
    return code
