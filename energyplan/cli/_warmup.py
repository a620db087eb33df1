"""The command warmup."""

from __future__ import annotations

from typing import Annotated

import typer

from energyplan.cli.answers import answer, progress
from energyplan.cli.app import app
from energyplan.cli.options import Json


@app.command(epilog="Example: energyplan warmup --json")
def warmup(
    processes: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that share the work; by default all processors'."),
    ] = None,
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
        "compiled": [kernel._asdict() for kernel in made.compiled],
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
