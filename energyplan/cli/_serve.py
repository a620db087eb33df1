"""The command serve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli.app import app


@app.command(epilog="Example: energyplan serve maps --port 8321")
def serve(
    folder: Annotated[Path, typer.Argument(help="Folder with maps, models, missions and logs.")],
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port.")] = 8321,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="ENERGYPLAN_TOKEN",
            help="Secret that each request must carry; required for any other host.",
        ),
    ] = None,
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
    from energyplan.serve.server import run

    run(folder, host, port, token, workers, waiting)
