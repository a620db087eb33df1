"""Starts the service."""

from __future__ import annotations

import ipaddress
import sys
from pathlib import Path

from energyplan.errors import InvalidInputError, MissingDependencyError


def is_loopback(host: str) -> bool:
    """Tell whether an address is reached from this machine alone.

    Examples
    --------
    >>> is_loopback("127.0.0.1"), is_loopback("0.0.0.0")
    (True, False)
    """
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
    """Serve a data folder until interrupted.

    Parameters
    ----------
    folder : str or Path
        Maps, models, missions and logs, named in requests.
    host : str
        Address to listen on; another than the loopback address needs a token.
    port : int
        Port; 0 takes a free one, which is printed.
    token : str, optional
        What requests must carry as ``Authorization: Bearer``.
    workers, waiting : int
        Requests worked on at once, and requests that may wait.

    Raises
    ------
    InvalidInputError
        If the folder is none, or the address can be reached by others and no token is given.
    MissingDependencyError
        If the extra ``serve`` is not installed.

    Examples
    --------
    >>> run(".", host="0.0.0.0")
    Traceback (most recent call last):
        ...
    energyplan.errors.InvalidInputError: 0.0.0.0 can be reached by others; give --token, or ...
    """
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
