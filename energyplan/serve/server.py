"""Starts the service."""

from __future__ import annotations

import ipaddress
import sys
from pathlib import Path

from energyplan.errors import InvalidInputError, MissingDependencyError


def is_loopback(host: str) -> bool:
    """Tell whether an address is reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def run(
    folder: str | Path,
    host: str = "127.0.0.1",
    port: int = 8321,
    token: str | None = None,
    workers: int | None = None,
    waiting: int = 32,
) -> None:
    """Serve a data folder until interrupted."""
    if not is_loopback(host) and not token:
        raise InvalidInputError(
            f"{host} can be reached by others; give --token, or listen on 127.0.0.1"
        )
    try:
        import uvicorn
    except ImportError as error:
        raise MissingDependencyError(
            "the service needs uvicorn; pip install 'energyplan[serve]'"
        ) from error
    from energyplan.serve import create_app

    hosts = ("localhost", "127.0.0.1", "[::1]") if is_loopback(host) else ("*",)
    app = create_app(folder, token, workers, waiting, hosts)
    server = uvicorn.Server(
        uvicorn.Config(app, host=host, port=port, log_level="warning", timeout_graceful_shutdown=3)
    )
    sys.stderr.write(f"serving {Path(folder).resolve()} at http://{host}:{port}/\n")
    server.run()
