"""Refuses requests before they are read: another host, no token, too large a body."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable
from typing import Any

from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST_BODY = 64 * 2**20
"""Largest body of a request [byte]."""


def problem(status: int, title: str, detail: str, **more: Any) -> JSONResponse:
    """Return an error as RFC 9457 has it."""
    body = {"type": "about:blank", "title": title, "status": status, "detail": detail, **more}
    return JSONResponse(body, status, media_type="application/problem+json")


class Guard:
    """Refuses requests by another host name, without the token, or with too large a body."""

    def __init__(self, app: ASGIApp, token: str | None, hosts: tuple[str, ...]) -> None:
        self.app, self.token, self.hosts = app, token, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = {
            key.decode("latin-1"): value.decode("latin-1") for key, value in scope["headers"]
        }
        refused = self._refusal(scope, headers)
        if refused is not None:
            await refused(scope, receive, send)
            return
        held = 0

        async def bounded() -> Message:
            nonlocal held
            message = await receive()
            held += len(message.get("body", b""))
            if held > LARGEST_BODY:
                raise HTTPException(413, f"the body is larger than {LARGEST_BODY} bytes")
            return message

        await self.app(scope, bounded, send)

    def _refusal(
        self, scope: Scope, headers: dict[str, str]
    ) -> Callable[[Scope, Receive, Send], Awaitable[None]] | None:
        host = headers.get("host", "")
        name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
        if "*" not in self.hosts and name not in self.hosts:
            return problem(421, "WrongHost", f"the service is not called {name!r}")
        if self.token is not None and scope["path"].startswith("/api/"):
            given = headers.get("authorization", "").removeprefix("Bearer ")
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return problem(401, "Unauthorized", "send the token as 'Authorization: Bearer'")
        if scope["method"] == "POST" and not headers.get("content-type", "").startswith(
            "application/json"
        ):
            return problem(415, "WrongType", "send JSON, as Content-Type: application/json")
        size = headers.get("content-length", "0")
        if size.isdigit() and int(size) > LARGEST_BODY:
            return problem(413, "TooLarge", f"the body is larger than {LARGEST_BODY} bytes")
        return None
