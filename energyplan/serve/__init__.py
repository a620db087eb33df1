"""An HTTP service: plans, comparisons, checks, missions and diagnoses for other programs.

It needs the extra ``serve`` (FastAPI and uvicorn). ``energyplan serve FOLDER`` starts it on the
loopback address; `create_app` gives the application to any other ASGI server.
"""

from __future__ import annotations

import ipaddress
import logging
import secrets
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from energyplan.errors import InvalidInputError, needs_extra

if TYPE_CHECKING:
    from fastapi import FastAPI

__all__ = ["create_app", "run"]

LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_MOST = 512  # connections at once, where the system lets a process open three times as many files


class ConnectionLimits(NamedTuple):
    """What a connection may hold, and how long it may rest."""

    # bytes of answers that the system keeps for a client that does not read them
    unread: int = 1 << 18
    rest: int = 1 << 20  # bytes of bodies that were refused, after which a connection ends
    # time between two looks at a connection, which is to have moved by then [s]
    patience: float = 10.0


_CONNECTION = ConnectionLimits()
_LOGGERS = {"energyplan.serve": "INFO", "uvicorn": "WARNING", "py.warnings": "WARNING"}
_LOGGING = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"line": {"format": "%(asctime)s %(message)s", "datefmt": "%Y-%m-%dT%H:%M:%S%z"}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "line"}},
    "loggers": {
        name: {"handlers": ["stderr"], "level": level, "propagate": False}
        for name, level in _LOGGERS.items()
    },
}


def create_app(
    folder: str | Path,
    token: str | None = None,
    workers: int | None = None,
    waiting: int = 32,
    hosts: tuple[str, ...] = LOOPBACK,
) -> FastAPI:
    """Return the service as an ASGI application."""
    if token is not None and not token.strip():
        raise InvalidInputError("the token is empty; give a secret, or None to serve everybody")
    with needs_extra("serve", "the service"):
        from energyplan.serve.api import application
    return application(Path(folder), token, workers, waiting, hosts)


def is_loopback(host: str) -> bool:
    """Return whether an address is reached from this machine alone."""
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

    Without a token a random one is printed with the address, unless the service is `open_to_all`
    of this machine.
    """
    if open_to_all and not is_loopback(host):
        raise InvalidInputError(
            f"{host} can be reached by others; leave --no-token out, or listen on 127.0.0.1"
        )
    secret = None if open_to_all else token or secrets.token_urlsafe(16)
    app = create_app(folder, secret, workers, waiting, LOOPBACK if is_loopback(host) else ("*",))
    service = server(app)
    listening = listen(host, port)
    address = f"http://{host}:{listening.getsockname()[1]}/"
    address += f"#token={secret}" if secret else ""
    sys.stderr.write(f"serving {Path(folder).resolve()} at {address}\n")
    sys.stderr.flush()
    sys.setswitchinterval(1e-3)  # so that requests are accepted while others are worked on
    logging.captureWarnings(True)
    service.run(sockets=[listening])


def listen(host: str, port: int) -> socket.socket:
    """Return the socket of an address; connections have its limits."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host.strip("[]"), port), family=family)
    except OSError as problem:
        raise InvalidInputError(
            f"{host}, port {port}, cannot be listened on: {problem.strerror}; give another --port"
        ) from None
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _CONNECTION.unread)
    return listening


def _most_connections() -> int:
    """Return how many connections there may be at once."""
    with suppress(ImportError):  # Windows has no such limit
        import resource

        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        return min(_MOST, files // 3) if files > 0 else _MOST
    return _MOST


def server(app: FastAPI) -> Any:
    """Return what serves an application; it stops all work when it ends."""
    with needs_extra("serve", "the service"):
        import uvicorn
        from uvicorn.protocols.http.h11_impl import H11Protocol

    most = _most_connections()

    class Bounded(H11Protocol):
        """A connection that ends where nothing moves, as uvicorn has no end to an unread answer.

        Of too many, the one whose client has kept the service waiting longest makes room: uvicorn's
        limit would turn away the newest, whoever holds the others.
        """

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._heard = self.loop.time()
            self._seen: tuple[float, int] | None = None
            self._rest = 0
            if len(self.connections) > most:
                every: list[Any] = [one for one in self.connections if one is not self]
                others = [one for one in every if one.waits and not one.transport.is_closing()]
                min(others, key=lambda one: one._heard, default=self).transport.abort()
            self.loop.call_later(_CONNECTION.patience, self._look)

        def data_received(self, data: bytes) -> None:
            self._heard = self.loop.time()
            cycle = self.cycle
            if cycle is not None and cycle.response_complete and cycle.more_body:
                self._rest += len(data)  # of a body that was refused
                if self._rest > _CONNECTION.rest:
                    self.transport.abort()
                    return
            super().data_received(data)

        @property
        def waits(self) -> bool:
            """Whether it is the client's turn, to send a request or to read an answer."""
            cycle = self.cycle
            idle = cycle is None or cycle.response_complete or cycle.more_body
            return idle or self.flow.write_paused

        def _look(self) -> None:
            if self not in self.connections:
                return
            seen = (self._heard, self.transport.get_write_buffer_size()) if self.waits else None
            if seen is not None and seen == self._seen:
                self.transport.abort()
                return
            self._seen = seen
            self.loop.call_later(_CONNECTION.patience, self._look)

        def shutdown(self) -> None:
            if self.waits:
                self.transport.abort()
            super().shutdown()

    class Server(uvicorn.Server):
        async def shutdown(self, sockets: Any = None) -> None:
            app.state.stop()
            await super().shutdown(sockets)

    config = uvicorn.Config(
        app, log_config=_LOGGING, access_log=False, timeout_graceful_shutdown=3, http=Bounded,
        backlog=1024,
    )  # fmt: skip
    return Server(config)
