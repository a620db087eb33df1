"""An HTTP service: plans, comparisons, checks, missions and diagnoses for other programs.

It needs the extra ``serve`` (FastAPI and uvicorn). ``energyplan serve FOLDER`` starts it on the
loopback address; `create_app` gives the application to any other ASGI server.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from energyplan.errors import MissingDependencyError
from energyplan.serve.server import run

if TYPE_CHECKING:
    from fastapi import FastAPI

__all__ = ["create_app", "run"]


def create_app(
    folder: str | Path,
    token: str | None = None,
    workers: int | None = None,
    waiting: int = 32,
    hosts: tuple[str, ...] = ("localhost", "127.0.0.1", "[::1]", "testserver"),
) -> FastAPI:
    """Return the service as an ASGI application; see `energyplan.serve.api.create_app`."""
    try:
        from energyplan.serve.api import create_app
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "the service needs FastAPI; pip install 'energyplan[serve]'"
        ) from error
    return create_app(folder, token, workers, waiting, hosts)
