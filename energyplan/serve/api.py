"""The HTTP application: which requests there are, and what answers them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException

from energyplan import __version__
from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.cost.speeds import asked_speed
from energyplan.diagnosis import diagnose
from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    InvalidInputError,
    MissingDependencyError,
    NoPathError,
    TimeLimitError,
)
from energyplan.fit import identify
from energyplan.io.energy_map import contours_document
from energyplan.io.logs import read_log
from energyplan.io.mission import mission_from, read_mission
from energyplan.io.topics import topic_map_of
from energyplan.limits.feasibility import check
from energyplan.logs import DriveLog
from energyplan.mission import Mission, Routes, evaluate
from energyplan.output import documents
from energyplan.path import Pose, Trajectory
from energyplan.planning import PlanningProblem, plan
from energyplan.planning import planners as known_planners
from energyplan.serve.requests import (
    CheckRequest,
    DiagnoseRequest,
    Guard,
    IdentifyRequest,
    MissionRequest,
    PlanRequest,
    RangeRequest,
    problem,
)
from energyplan.serve.store import KINDS, Store, UnknownFileError
from energyplan.serve.work import BusyError, Job, Pool
from energyplan.studies.comparison import compare
from energyplan.studies.doubt import energy_of_charge
from energyplan.studies.energy_map import energy_map
from energyplan.terrain import OccupancyGrid

STATUS: tuple[tuple[type[Exception], int], ...] = (
    (UnknownFileError, 404),
    (BusyError, 429),
    (CancelledError, 499),
    (MissingDependencyError, 501),
    (TimeLimitError, 503),
    (InvalidInputError, 422),
    (EnergyPlanError, 409),
)
"""Which status an error of the library has; the first that fits."""


def _of(error: Exception) -> JSONResponse:
    status = next((code for kind, code in STATUS if isinstance(error, kind)), 500)
    detail = " ".join(str(error).split()) if status != 500 else "the service failed; see its log"
    more = {"retry_after": 1} if status == 429 else {}
    answer = problem(status, type(error).__name__.removesuffix("Error"), detail, **more)
    if status == 429:
        answer.headers["Retry-After"] = "1"
    return answer


def create_app(
    folder: str | Path,
    token: str | None = None,
    workers: int | None = None,
    waiting: int = 32,
    hosts: tuple[str, ...] = ("localhost", "127.0.0.1", "[::1]", "testserver"),
) -> FastAPI:
    """Return the service as an ASGI application."""
    store, pool = Store(Path(folder)), Pool(workers, waiting)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        yield
        pool.close()

    app = FastAPI(
        title="energyplan", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None,
        description="Energy-aware path planning for wheeled skid-steer robots.",
    )  # fmt: skip
    app.add_middleware(Guard, token=token, hosts=hosts)
    app.state.pool, app.state.store = pool, store

    @app.exception_handler(EnergyPlanError)
    async def _library(request: Request, error: EnergyPlanError) -> Response:
        return _of(error)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> Response:
        places = [
            f"{'.'.join(str(part) for part in found['loc'])}: {found['msg']}"
            for found in error.errors()
        ]
        return problem(422, "InvalidRequest", "; ".join(places))

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> Response:
        return problem(error.status_code, str(error.detail), str(error.detail))

    @app.exception_handler(Exception)
    async def _failed(request: Request, error: Exception) -> Response:
        return _of(error)

    async def answer(request: Request, work: Callable[[Job], dict[str, Any]]) -> Response:
        """Have work done; stop it when the client goes away; stream events where asked."""
        job = pool.submit(work)
        if "text/event-stream" in request.headers.get("accept", ""):
            return StreamingResponse(_stream(request, job), media_type="text/event-stream")
        waiting = asyncio.wrap_future(job.future)
        while not waiting.done():
            await asyncio.wait({waiting}, timeout=0.1)
            if not waiting.done() and await request.is_disconnected():
                job.cancelled.set()
                return _of(CancelledError("the client went away"))
        return JSONResponse(waiting.result())

    def priced(name: str, battery: bool) -> EnergyCost:
        model = store.model(name)
        return EnergyCost(model, battery=battery, speed=asked_speed(None, model.vehicle))

    def asked_problem(asked: PlanRequest) -> PlanningProblem:
        cost = priced(asked.model, asked.battery)
        grid = store.map(asked.map)
        return PlanningProblem(
            _masked(grid, store.map(asked.keepout)) if asked.keepout else grid,
            cost, Pose(*asked.start), Pose(*asked.goal),
            surfaces=store.surfaces(asked.surfaces) if asked.surfaces else None,
            heights=store.heights(asked.heights) if asked.heights else None,
            objective=asked.objective, clearance=asked.clearance,
        )  # fmt: skip

    def planned(
        run: Callable[..., Any], document: Callable[[Any], dict[str, Any]], asked: PlanRequest
    ) -> Callable[[Job], dict[str, Any]]:
        def work(job: Job) -> dict[str, Any]:
            query = asked_problem(asked)
            job.say("planning")
            options: dict[str, Any] = {"planner": asked.planner, "time_limit": asked.time_limit}
            if asked.effort is not None:
                options["effort"] = asked.effort
            try:
                found = document(run(query, **options))
                if asked.keepout:
                    note = store.map(asked.map).note_of_mask(store.map(asked.keepout))
                    found["notes"] = [*found.get("notes", ()), *([note] if note else [])]
                return found
            except NoPathError as error:  # an answer, as on the command line
                return documents.no_path(error)

        return work

    @app.get("/api/health")
    async def health() -> dict[str, Any]:
        """Tell that the service is there, and how busy it is."""
        return {"version": __version__, "workers": pool.workers, "load": pool.load}

    @app.get("/api/files")
    async def listing() -> dict[str, list[str]]:
        """List the data folder by kind, and the planners."""
        found = {kind: await asyncio.to_thread(store.names, kind) for kind in KINDS}
        return {**found, "planners": list(known_planners())}

    @app.put("/api/files/{name:path}", status_code=201)
    async def upload(name: str, request: Request) -> dict[str, Any]:
        """Add a file to the data folder; one that is there is never replaced."""
        if not any(name.endswith(ends) for ends in (*sum(KINDS.values(), ()), ".png", ".pgm")):
            raise InvalidInputError(f"{name!r} does not end like a file that the service reads")
        content = await request.body()
        await asyncio.to_thread(store.save, name, content)
        return {"name": name, "bytes": len(content)}

    @app.get("/api/maps/{name:path}")
    async def map_document(name: str) -> dict[str, Any]:
        """Return size, resolution [m], origin and occupied cells (as runs) of a map."""
        grid = await asyncio.to_thread(store.map, name)
        return await asyncio.to_thread(_map_document, grid)

    @app.get("/api/surfaces/{name:path}")
    async def surface_document(name: str) -> Response:
        """Return the polygons of surfaces as they are."""
        await asyncio.to_thread(store.surfaces, name)
        return FileResponse(store.path(name), media_type="application/geo+json")

    @app.get("/api/models/{name}")
    async def model_document(name: str) -> dict[str, Any]:
        """Return a model's terms, and its vehicle's footprint [m]."""
        model = await asyncio.to_thread(store.model, name)
        return {
            "terms": documents.terms(model),
            "footprint": documents.plain(model.vehicle.footprint),
            "mass": model.vehicle.mass,
        }

    @app.post("/api/plan")
    async def plan_route(asked: PlanRequest, request: Request) -> Response:
        """Plan the route of least energy."""
        return await answer(request, planned(plan, documents.plan, asked))

    @app.post("/api/compare")
    async def compare_routes(asked: PlanRequest, request: Request) -> Response:
        """Compare the route of least energy with the shortest one."""
        return await answer(request, planned(compare, documents.comparison, asked))

    @app.post("/api/range")
    async def range_of(asked: RangeRequest, request: Request) -> Response:
        """Tell how far an energy, or the charge of a battery, leads."""
        if (asked.energy is None) == (asked.pack is None):
            raise InvalidInputError("give either energy or pack, the name of a battery")

        def work(job: Job) -> dict[str, Any]:
            cost = priced(asked.model, asked.pack is not None)
            start = Pose(*asked.start)
            question = PlanningProblem(
                store.map(asked.map), cost, start, start,
                surfaces=store.surfaces(asked.surfaces) if asked.surfaces else None,
            )  # fmt: skip
            there_is = asked.energy
            if asked.pack:
                there_is = energy_of_charge(cost, Battery.preset(asked.pack), asked.soc)
            assert there_is is not None
            usable = (1.0 - asked.reserve) * there_is
            job.say("searching")
            found = energy_map(
                question, energy=usable, back=asked.back, confidence=asked.confidence,
                coefficient_spread=asked.coefficient_spread,
            )  # fmt: skip
            areas = found.areas(usable)
            return {**documents.energy_map(found, areas), "areas": contours_document(areas)}

        return await answer(request, work)

    @app.post("/api/check")
    async def check_trajectory(asked: CheckRequest, request: Request) -> Response:
        """Check whether the motors can drive a trajectory."""

        def work(job: Job) -> dict[str, Any]:
            columns = {name: np.asarray(getattr(asked, name), float) for name in _COLUMNS}
            if len({len(column) for column in columns.values()}) > 1:
                lengths = {name: len(column) for name, column in columns.items()}
                raise InvalidInputError(f"the columns have different lengths: {lengths}")
            return documents.feasibility(check(Trajectory(**columns), store.model(asked.model)))

        return await answer(request, work)

    routes = Routes()

    @app.post("/api/mission")
    async def mission(asked: MissionRequest, request: Request) -> Response:
        """Tell which tasks of a mission can be done, with what energy, and why not."""
        if (asked.mission is None) == (asked.document is None):
            raise InvalidInputError("give either mission, the name of a file, or document")

        def work(job: Job) -> dict[str, Any]:
            told = evaluate(_read_mission(store, asked), routes=routes)
            line = told.timeline
            along = {name: documents.plain(getattr(line, name)) for name in _TIMELINE}
            return {**documents.mission(told), "timeline": along}

        return await answer(request, work)

    @app.post("/api/identify")
    async def identify_logs(asked: IdentifyRequest, request: Request) -> Response:
        """Find a robot's power parameters from its drive logs."""

        def work(job: Job) -> dict[str, Any]:
            logs = [_read_log(store.path(name), asked.vehicle) for name in asked.logs]
            job.say("identifying")
            return documents.identification(identify(logs, store.vehicle(asked.vehicle)))

        return await answer(request, work)

    @app.post("/api/diagnose")
    async def diagnose_logs(asked: DiagnoseRequest, request: Request) -> Response:
        """Trace the residual of the power model to an effect."""

        def work(job: Job) -> dict[str, Any]:
            logs = [_read_log(store.path(name), asked.vehicle) for name in asked.logs]
            judging = [_read_log(store.path(name), asked.vehicle) for name in asked.holdout]
            told = diagnose(
                logs, holdout=judging, vehicle=store.vehicle(asked.vehicle),
                progress=partial(_diagnosing, job),
            )  # fmt: skip
            return documents.diagnosis(told)

        return await answer(request, work)

    page = files("energyplan.serve") / "page"
    app.mount("/", StaticFiles(directory=str(page), html=True), name="page")
    return app


@lru_cache(maxsize=8)
def _read_log(file: Path, vehicle: str) -> DriveLog:
    """Read a drive log; of a bag the vehicle tells the topics and the radius of the wheels."""
    return read_log(file, topics=topic_map_of(vehicle))


def _masked(grid: OccupancyGrid, mask: OccupancyGrid) -> OccupancyGrid:
    """Return a map with a keep-out mask; the same object, with its tables, for the same two."""
    return grid.with_mask(mask)


_COLUMNS = ("t", "x", "y", "yaw", "v", "omega")
_TIMELINE = ("t", "x", "y", "soc", "soc_lower", "soc_upper", "power")


def _diagnosing(job: Job, fraction: float, note: str = "") -> None:
    job.say("diagnosing", fraction=fraction, note=note)


def _read_mission(store: Store, asked: MissionRequest) -> Mission:
    if asked.mission is not None:
        return read_mission(store.path(asked.mission), inside=True)
    assert asked.document is not None
    return mission_from(asked.document, store.folder)


def _map_document(grid: Any) -> dict[str, Any]:
    """Return a map with its occupied cells as runs of each row: row, first, one past the last."""
    occupied = np.asarray(grid.occupied, np.int8)
    edges = np.diff(np.pad(occupied, ((0, 0), (1, 1))), axis=1)
    rows, first = np.nonzero(edges == 1)
    _, last = np.nonzero(edges == -1)
    return {
        "rows": occupied.shape[0],
        "columns": occupied.shape[1],
        "resolution": grid.resolution,
        "origin": documents.plain(tuple(grid.origin)),
        "runs": np.column_stack([rows, first, last]).tolist(),
    }


async def _stream(request: Request, job: Job) -> AsyncIterator[str]:
    """Yield what a job says as server-sent events, its answer last."""
    try:
        async for event in job.events():
            yield f"event: progress\ndata: {json.dumps(event)}\n\n"
            if await request.is_disconnected():
                break
        if job.future.done():
            error = job.future.exception()
            if error is None:
                yield f"event: answer\ndata: {json.dumps(job.future.result())}\n\n"
            elif isinstance(error, Exception):
                body = bytes(_of(error).body).decode()
                yield f"event: problem\ndata: {body}\n\n"
    finally:
        job.cancelled.set()
