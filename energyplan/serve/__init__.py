"""An HTTP service: plans, comparisons, checks, missions and diagnoses for other programs.

It needs the extra ``serve`` (FastAPI and uvicorn). ``energyplan serve FOLDER`` starts it on the
loopback address; `create_app` gives the application to any other ASGI server.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from energyplan.errors import InvalidInputError, MissingDependencyError

if TYPE_CHECKING:
    from fastapi import FastAPI

__all__ = ["create_app", "run"]

LOOPBACK = ("localhost", "127.0.0.1", "[::1]", "testserver")
_MOST = 256  # connections at once
_PATIENCE = 15.0  # time after which a connection is looked at, and closed the second time [s]


def create_app(
    folder: str | Path,
    token: str | None = None,
    workers: int | None = None,
    waiting: int = 32,
    hosts: tuple[str, ...] = LOOPBACK,
) -> FastAPI:
    """Return the service as an ASGI application."""
    try:
        from energyplan.serve.api import application
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "the service needs FastAPI; pip install 'energyplan[serve]'"
        ) from error
    return application(Path(folder), token, workers, waiting, hosts)


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
    open_to_all: bool = False,
) -> None:
    """Serve a data folder until interrupted.

    Without a token one is made up and printed with the address, unless the service is `open_to_all`
    of this machine.
    """
    if open_to_all and not is_loopback(host):
        raise InvalidInputError(
            f"{host} can be reached by others; leave --no-token out, or listen on 127.0.0.1"
        )
    try:
        import uvicorn
    except ImportError as error:
        raise MissingDependencyError(
            "the service needs uvicorn; pip install 'energyplan[serve]'"
        ) from error
    secret = None if open_to_all else token or secrets.token_urlsafe(16)
    app = create_app(folder, secret, workers, waiting, LOOPBACK if is_loopback(host) else ("*",))
    config = uvicorn.Config(
        app, log_level="warning", timeout_graceful_shutdown=3, http=_protocol(), backlog=16
    )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host.strip("[]"), port), family=family, backlog=64)
    except OSError as problem:
        raise InvalidInputError(
            f"{host}, port {port}, cannot be listened on: {problem.strerror}; give another --port"
        ) from None
    address = f"http://{host}:{listening.getsockname()[1]}/"
    address += f"#token={secret}" if secret else ""
    sys.stderr.write(f"serving {Path(folder).resolve()} at {address}\n")
    sys.stderr.flush()
    sys.setswitchinterval(1e-3)  # so that requests are accepted while others are worked on
    uvicorn.Server(config).run(sockets=[listening])


def _protocol() -> Any:
    """Return uvicorn's protocol with an end to connections, and to waiting for a request's head."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    most = _MOST
    try:
        import resource
    except ImportError:  # Windows has no such limit
        pass
    else:
        most = max(1, min(_MOST, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 4))

    class Bounded(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._since, self._idle = self.loop.time(), False
            if len(self.connections) > most:
                # The one that waits longest makes room; where all are at work, there is none.
                others: list[Any] = [one for one in self.connections if one is not self]
                resting = [one for one in others if one.rests()]
                min(resting, key=lambda one: one._since, default=self).transport.abort()
            self.loop.call_later(_PATIENCE, self._look)

        def rests(self) -> bool:
            """Whether there is no request that is being answered."""
            return self.cycle is None or self.cycle.response_complete

        def _look(self) -> None:
            """Close the connection where it rested at the last look, and does now."""
            if self.transport.is_closing():
                return
            if self._idle and self.rests():
                self.transport.abort()
                return
            self._idle = self.rests()
            self.loop.call_later(_PATIENCE, self._look)

    return Bounded
