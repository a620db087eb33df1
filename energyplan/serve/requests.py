"""What requests hold, with bounds of all numbers, and which are refused before they are read."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import re
import time
from typing import Annotated, Any, Literal
from urllib.parse import quote

import numpy as np
from fastapi.exceptions import HTTPException, RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from energyplan.errors import InvalidInputError
from energyplan.io.documents import MAX_NODES
from energyplan.io.sites import SiteFile
from energyplan.path import FloatArray
from energyplan.planning.goal import HEADINGS, Goal, as_goals

LONGEST, MOST_EFFORT = 60.0, 5_000_000
"""Largest time limit [s] and effort that a request may ask for."""

MOST_ROWS, MOST_TASKS, MOST_KEYS = 200_000, 500, 100
"""Largest number of samples of a trajectory in a request, of tasks of a mission, and of keys."""

MOST_GOALS = 20
"""Largest number of goals of a request, of which one is reached."""

MOST_NUMBERS = 6 * MOST_ROWS
"""Most numbers of a trajectory in a request."""

PoseRow = Annotated[list[float], Field(min_length=3, max_length=3, examples=[[2.0, 2.0, 0.0]])]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _few_keys(cls, given: Any) -> Any:
        if isinstance(given, dict) and len(given) > MOST_KEYS:
            raise ValueError(f"it has more than {MOST_KEYS} keys")
        return given


class _OnSite(SiteFile, _Asked):
    model: Name = Field(examples=["quadriga:full:concrete"])
    start: PoseRow
    reverse: bool | None = Field(None, description="may it drive backwards; as its vehicle has it")


def _goals(value: Any) -> tuple[Goal, ...]:
    """Return the goals that a request names."""
    if isinstance(value, list) and len(value) > MOST_GOALS:
        raise ValueError(f"give {MOST_GOALS} goals at most")
    return as_goals(value)


_PLACE = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}
_GOAL = {
    "anyOf": [
        _PLACE,
        {
            "type": "object",
            "properties": {
                **{name: {"type": "number"} for name in ("x", "y", "yaw", "radius")},
                "heading": {"enum": list(HEADINGS)},
            },
            "required": ["x", "y"],
        },
    ]
}
Goals = Annotated[
    Any,
    PlainValidator(_goals),
    WithJsonSchema(
        {
            "anyOf": [*_GOAL["anyOf"], {"type": "array", "items": _GOAL, "maxItems": MOST_GOALS}],
            "description": "a pose x, y, yaw; a place x, y, at any heading; an object with heading "
            "given, either or any, and a radius; or a list of these, of which one is reached",
            "examples": [[20.0, 12.0, 1.57], [20.0, 12.0]],
        }
    ),
]


class _WithPack(BaseModel):
    pack: Name | dict[str, Any] | None = Field(None, description="battery, as a mission's file has")
    soc: float = Field(1.0, gt=0, le=1)


class PlanRequest(_OnSite, _WithPack):
    """A planning problem; files are named as the data folder has them."""

    goal: Goals
    battery: bool = False
    costmap_weight: float = Field(0.0, ge=0)
    objective: Literal["energy", "length", "time"] = "energy"
    planner: Name = "lattice"
    time_limit: float | None = Field(None, gt=0, le=LONGEST)
    effort: int | None = Field(None, ge=1, le=MOST_EFFORT)


class RangeRequest(_OnSite, _WithPack):
    """From where, and what there is: an energy [J], or the charge of a battery."""

    back: Goals | None = Field(None, description="where to get back to, such as a charger, as goal")
    energy: float | None = Field(None, gt=0)
    reserve: float = Field(
        0.0, ge=0, lt=1, description="state of charge to keep; of an energy, the part to keep"
    )
    confidence: float | None = Field(None, gt=0, lt=1)
    coefficient_spread: float = Field(0.0, ge=0, lt=1)


def _column(value: Any) -> FloatArray:
    """Return a column of a trajectory."""
    if not isinstance(value, list) or len(value) > MOST_ROWS:
        raise ValueError(f"give a list of numbers, {MOST_ROWS} at most")
    if not {*map(type, value)} <= {int, float}:
        raise ValueError("give numbers alone")
    return np.array(value, float)


Column = Annotated[
    Any,
    PlainValidator(_column),
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "maxItems": MOST_ROWS}),
]


class CheckRequest(_Asked, _WithPack):
    """A trajectory by its columns, and the model whose motors drive it."""

    model: Name
    t: Column
    x: Column
    y: Column
    yaw: Column
    v: Column
    omega: Column


def complaint(error: RequestValidationError) -> str:
    """Return what is wrong with a request, place by place."""
    found = []
    for one in error.errors():
        place = ".".join(str(part) for part in one["loc"][1:])
        message = one["msg"]
        if one["type"] == "json_invalid":
            place, message = "", f"Invalid JSON: {one['ctx']['error']}"
        found.append(f"{place or 'the body'}: {message}")
    return "; ".join(found[:20])


_STRING = re.compile(rb'"(?:[^"\\]|\\.)*"', re.DOTALL)
_EMPTY = re.compile(rb"\[\s*\]|\{\s*\}")
_LONG_NUMBER = re.compile(rb"\d{19}")


def read_body(content: bytes, given: type[BaseModel]) -> BaseModel:
    """Return what a body of JSON holds; values are counted before any is built."""
    try:
        _few(content, MOST_NUMBERS if issubclass(given, CheckRequest) else 0)
        value = json.loads(
            content, object_pairs_hook=_keys_once,
            parse_int=_int64 if _LONG_NUMBER.search(content) else None,
        )  # fmt: skip
        return given.model_validate(value)
    except ValidationError as error:
        every = [{**one, "loc": ("body", *one["loc"])} for one in error.errors()]
        raise InvalidInputError(complaint(RequestValidationError(every))) from None
    except json.JSONDecodeError as error:
        raise InvalidInputError(f"the body: Invalid JSON: {error}") from None
    except RecursionError:
        raise InvalidInputError("the body: it is nested too deeply") from None
    except ValueError as error:
        raise InvalidInputError(f"the body: {error}") from None


def _few(content: bytes, numbers: int) -> None:
    """Refuse JSON of more values than a file may hold, beside numbers of columns."""
    if not _many(content, content, numbers):
        return
    plain = _STRING.sub(b"0", content)
    if _many(plain, _EMPTY.sub(b"0", plain), numbers):
        raise ValueError(f"it holds more than {MAX_NODES + numbers} values")


def _many(content: bytes, filled: bytes, numbers: int) -> bool:
    """Return whether JSON may hold too much: each value but the first follows one of its marks."""
    nests = content.count(b"[") + content.count(b"{")
    inner = filled.count(b"[") + filled.count(b"{")
    return nests > MAX_NODES or inner + filled.count(b",") > MAX_NODES + numbers


def _keys_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object, whose keys stand once."""
    found = dict(pairs)
    if len(found) < len(pairs):
        seen = set[str]()
        for key, _ in pairs:
            if key in seen:
                raise ValueError(f"{key[:60]!r} stands twice; drop one")
            seen.add(key)
    return found


def _int64(digits: str) -> int:
    """Return a whole number of 64 bits."""
    if len(digits) > 20 or not -(2**63) <= (value := int(digits)) < 2**63:
        raise ValueError(f"{digits[:30]} is beyond 64 bits")
    return value


class MissionRequest(_Asked):
    """A mission: a file of the data folder, or what one would hold; with both, in its place."""

    mission: Name | None = None
    document: dict[str, Any] | None = None
    time_limit: float = Field(LONGEST, gt=0, le=LONGEST)


class RobotMeasures(_Asked):
    """A robot whose logs nobody mapped yet, as its owner knows it; the rest is guessed."""

    track: Annotated[float, Field(gt=0, le=50)] | None = None
    wheelbase: Annotated[float, Field(gt=0, le=50)] | None = None
    mass: Annotated[float, Field(gt=0, le=1e6)] | None = None
    wheel_radius: Annotated[float, Field(gt=0, le=5)] | None = None
    like: Name | None = Field(None, description="a vehicle to take the rest from")
    columns: Annotated[str, Field(max_length=4000)] | None = None  # those that are known
    unsigned: bool = False  # whether the sensors of its powers see no sign


class StartRequest(_Asked):
    """A drive log of the data folder, and what is known of its robot."""

    log: Name
    robot: RobotMeasures


class IdentifyRequest(_Asked):
    """Drive logs of the data folder, and whose they are: a vehicle's, or a robot's."""

    logs: list[Name] = Field(min_length=1, max_length=100)
    vehicle: Name | None = None
    robot: RobotMeasures | None = None


class DiagnoseRequest(IdentifyRequest):
    """Drive logs to learn from and to judge by."""

    holdout: list[Name] = Field(min_length=1, max_length=100)


LARGEST = {"POST": 2**20, "PUT": 64 * 2**20, "/api/check": 6 * 2**20}
"""Largest body of a request by its method or its path [byte]."""
HELD = 128 * 2**20
"""Largest sum of the bodies of all requests in hand [byte]."""
DEADLINE = 30.0
"""Time in which the body of a request must come [s]."""
_LOG = logging.getLogger("energyplan.serve")
_HEADERS = [
    (b"content-security-policy", b"default-src 'none'; script-src 'self'; style-src 'self'; "
     b"img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
     b"frame-ancestors 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
]  # fmt: skip


def problem(status: int, title: str, detail: str, **more: Any) -> JSONResponse:
    """Return an error as RFC 9457 has it."""
    body = {"type": "about:blank", "title": title, "status": status, "detail": detail, **more}
    return JSONResponse(body, status, media_type="application/problem+json")


def _largest(scope: Scope) -> int:
    """Return the size of the largest body that a request may have [byte]."""
    method = scope["method"]
    return LARGEST.get(scope["path"] if method == "POST" else method, LARGEST.get(method, 0))


class Access:
    """Writes a line of the log for each request, and the headers that keep other sites out."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun, status = time.perf_counter(), 500

        async def sealed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message = {**message, "headers": [*message["headers"], *_HEADERS]}
            await send(message)

        try:
            await self.app(scope, receive, sealed)
        finally:
            client, port = scope.get("client") or ("-", 0)
            request, seconds = f"{scope['method']} {quote(scope['path'])}", time.perf_counter()
            _LOG.info('%s:%s "%s" %d %.3f s', client, port, request, status, seconds - begun)


class Guard:
    """Refuses requests without the token, too large or too slow."""

    def __init__(self, app: ASGIApp, token: str | None, deadline: float = DEADLINE) -> None:
        self.app, self.token, self.deadline = app, token, deadline
        self.held = 0  # bytes of the bodies of all requests in hand

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        refused = self._refusal(scope)
        if refused is not None:
            await refused(scope, receive, send)
            return
        most = _largest(scope)
        until = asyncio.get_running_loop().time() + self.deadline
        held, whole = 0, False

        async def bounded() -> Message:
            nonlocal held, whole
            if whole:  # what comes next is that the client leaves
                return await receive()
            try:
                async with asyncio.timeout_at(until):
                    message = await receive()
            except TimeoutError:
                text = f"the body did not come within {self.deadline:g} s"
                raise HTTPException(408, text, {"Connection": "close"}) from None
            if message["type"] == "http.disconnect":
                raise HTTPException(499, "the client went away")
            size = len(message.get("body", b""))
            held, self.held = held + size, self.held + size
            whole = not message.get("more_body", False)
            if held > most:
                raise HTTPException(413, f"the body is larger than {most} bytes")
            if self.held > HELD:
                text = "the bodies of other requests take all the room there is; try again"
                raise HTTPException(429, text, {"Connection": "close", "Retry-After": "1"})
            return message

        try:
            await self.app(scope, bounded, send)
        finally:
            self.held -= held

    def _refusal(self, scope: Scope) -> JSONResponse | None:
        headers = Headers(scope=scope)
        if self.token is not None and scope["path"].startswith(("/api/", "/openapi.json")):
            scheme, _, given = headers.get("authorization", "").partition(" ")
            right = hmac.compare_digest(given.strip().encode(), self.token.encode())
            if scheme.lower() != "bearer" or not right:
                return problem(401, "Unauthorized", "send the token as 'Authorization: Bearer'")
        if "transfer-encoding" in headers and "content-length" in headers:  # which is right?
            text = "give Content-Length or Transfer-Encoding, not both"
            refusal = problem(400, "TwoLengths", text)
            refusal.headers["Connection"] = "close"
            return refusal
        kind = headers.get("content-type", "")
        if scope["method"] == "POST" and not kind.startswith("application/json"):
            return problem(415, "WrongType", "send JSON, as Content-Type: application/json")
        size, most = headers.get("content-length", "0"), _largest(scope)
        if size.isdigit() and int(size) > most:
            return problem(413, "TooLarge", f"the body is larger than {most} bytes")
        return None
