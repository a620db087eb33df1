"""What requests hold, with bounds of all numbers, and which are refused before they are read."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LONGEST, MOST_EFFORT = 60.0, 5_000_000
"""Largest time limit [s] and effort that a request may ask for."""

MOST_ROWS = 200_000
"""Largest number of samples of a trajectory in a request."""

PoseRow = Annotated[list[float], Field(min_length=3, max_length=3, examples=[[2.0, 2.0, 0.0]])]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class PlanRequest(_Asked):
    """A planning problem; files are named as the data folder has them."""

    map: Name
    model: Name = Field(examples=["quadriga:full:concrete"])
    start: PoseRow
    goal: PoseRow
    surfaces: Name | None = None
    heights: Name | None = None
    battery: bool = False
    clearance: float = Field(0.0, ge=0, le=100)
    keepout: Name | None = None
    objective: Literal["energy", "length", "time"] = "energy"
    planner: Name = "lattice"
    time_limit: float = Field(1.0, gt=0, le=LONGEST)
    effort: int | None = Field(None, ge=1, le=MOST_EFFORT)


class RangeRequest(_Asked):
    """From where, and what there is: an energy [J], or the charge of a battery."""

    map: Name
    model: Name = Field(examples=["quadriga:full:concrete"])
    start: PoseRow
    back: PoseRow | None = Field(None, description="a pose to get back to, such as a charger's")
    energy: float | None = Field(None, gt=0)
    pack: Name | None = Field(None, description="name of a battery", examples=["quadriga"])
    soc: float = Field(1.0, gt=0, le=1)
    reserve: float = Field(0.0, ge=0, lt=1)
    confidence: float | None = Field(None, gt=0, lt=1)
    coefficient_spread: float = Field(0.0, ge=0, lt=1)
    surfaces: Name | None = None


class CheckRequest(_Asked):
    """A trajectory by its columns, and the model whose motors drive it."""

    model: Name
    t: list[float] = Field(min_length=2, max_length=MOST_ROWS)
    x: list[float] = Field(max_length=MOST_ROWS)
    y: list[float] = Field(max_length=MOST_ROWS)
    yaw: list[float] = Field(max_length=MOST_ROWS)
    v: list[float] = Field(max_length=MOST_ROWS)
    omega: list[float] = Field(max_length=MOST_ROWS)


class MissionRequest(_Asked):
    """A mission: a file of the data folder, or what such a file would hold."""

    mission: Name | None = None
    document: dict[str, Any] | None = None


class IdentifyRequest(_Asked):
    """Drive logs of the data folder."""

    logs: list[Name] = Field(min_length=1, max_length=100)
    vehicle: Name


class DiagnoseRequest(IdentifyRequest):
    """Drive logs to learn from and to judge by."""

    holdout: list[Name] = Field(min_length=1, max_length=100)


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
