"""An HTTP service: plans, comparisons, checks, missions and diagnoses for other programs.

It needs the extra ``serve`` (FastAPI and uvicorn). ``energyplan serve FOLDER`` starts it on the
loopback address; `create_app` gives the application to any other ASGI server.
"""

from __future__ import annotations

from typing import Any

from energyplan.errors import MissingDependencyError
from energyplan.serve.run import run

__all__ = ["create_app", "run"]


def __getattr__(name: str) -> Any:
    if name != "create_app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        from energyplan.serve.api import create_app
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "the service needs FastAPI; pip install 'energyplan[serve]'"
        ) from error
    return create_app
