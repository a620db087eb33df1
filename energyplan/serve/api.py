"""The HTTP application: which requests there are, and what answers them."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Sequence
from contextlib import aclosing, asynccontextmanager
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse
from fastapi.routing import APIRoute
from fastapi.staticfiles import StaticFiles
from pydantic import BaseModel
from shapely.geometry import mapping
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware

from energyplan import __version__
from energyplan.battery import PRESETS as BATTERY_PRESETS
from energyplan.battery import Battery
from energyplan.comparison import compare
from energyplan.compilation import compile_kernels
from energyplan.diagnosis import diagnose
from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    InvalidInputError,
    MissingDependencyError,
    NoPathError,
    StorageError,
    TimeLimitError,
)
from energyplan.fit import identify
from energyplan.io.bags import topic_map_of
from energyplan.io.config import Project, model_text, read_model, read_vehicle
from energyplan.io.documents import load
from energyplan.io.geojson import read_surfaces
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.mission import mission_from, read_battery, read_mission
from energyplan.io.sites import (
    NotedProblem,
    SiteFile,
    models_of,
    on_site,
    problem_from,
    with_presets,
)
from energyplan.io.start import Start
from energyplan.io.start import start as start_of
from energyplan.io.tables import contours_document
from energyplan.limits.drive import Ground, Traversal
from energyplan.limits.feasibility import check
from energyplan.logs import DriveLog
from energyplan.mission import Mission, MissionReport, Routes, evaluate
from energyplan.output import documents
from energyplan.path import Trajectory, as_pose
from energyplan.planning import Plan, plan
from energyplan.planning import planners as known_planners
from energyplan.power import PowerModel
from energyplan.power.presets import MODEL_PRESETS
from energyplan.reach import UsableCharge, energy_map
from energyplan.records import unusual
from energyplan.serve import answers, requests
from energyplan.serve.requests import MOST_EFFORT, MOST_TASKS, Access, Guard, complaint, problem
from energyplan.serve.store import BusyError, Job, Pool, StoppingError, Store, UnknownFileError
from energyplan.vehicle import Vehicle

STATUS: tuple[tuple[type[Exception], int], ...] = (
    (UnknownFileError, 404),
    (StoppingError, 503),
    (BusyError, 429),
    (CancelledError, 499),
    (StorageError, 507),
    (MissingDependencyError, 501),
    (TimeLimitError, 503),
    (InvalidInputError, 422),
    (EnergyPlanError, 409),
)
"""Which status an error of the library has; the first that fits."""
MOST = 32 * 2**20
"""Largest answer [byte]."""
Document = dict[str, Any]


def application(
    folder: Path, token: str | None, workers: int | None, waiting: int, hosts: tuple[str, ...]
) -> FastAPI:
    """Return the service as an ASGI application."""
    service = _Service(Store(folder), Pool(workers, waiting))

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        yield
        service.pool.close()

    schema = {"schema": answers.PROBLEM.model_json_schema()}
    refusal = {"description": "RFC 9457", "content": {"application/problem+json": schema}}
    app = FastAPI(
        title="energyplan", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None,
        description="Energy-aware path planning for wheeled skid-steer robots.",
        responses={"default": refusal},
    )  # fmt: skip
    app.state.stop = service.pool.close
    app.add_middleware(Guard, token=token)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False)
    app.add_middleware(Access)  # the outermost
    app.add_exception_handler(Exception, service.failed)
    for kind in (EnergyPlanError, HTTPException, RequestValidationError):
        app.add_exception_handler(kind, service.failed)
    for router in (_files(service), _routes(service), _missions(service), _logs(service)):
        app.include_router(router, prefix="/api")

    @app.get("/health", include_in_schema=False)
    async def alive() -> Response:
        return PlainTextResponse("ok")

    page = files("energyplan.serve") / "page"
    app.mount("/", StaticFiles(directory=str(page), html=True), name="page")
    return app


class _Service:
    """The data folder, who works on requests, and how requests and answers are written."""

    def __init__(self, store: Store, pool: Pool) -> None:
        self.store, self.pool = store, pool

    async def failed(self, request: Request, error: Exception) -> Response:
        """Return an error as a client reads it."""
        return self.problem(error)

    def problem(self, error: BaseException) -> Response:
        """Return an error of the library, or of the service itself, with its status."""
        if isinstance(error, HTTPException):
            refusal = problem(error.status_code, str(error.detail), str(error.detail))
            refusal.headers.update(error.headers or {})
            return refusal
        if isinstance(error, RequestValidationError):
            error = InvalidInputError(complaint(error))
        if isinstance(error, CancelledError) and self.pool.closing:
            error = StoppingError("the service is ending; try again in a while")
        status = next((code for kind, code in STATUS if isinstance(error, kind)), 500)
        if isinstance(error, TimeLimitError) and error.remedy == "effort":
            status = 422  # it is the same each time
        detail = " ".join(str(error).split()).replace(f"{self.store.folder}/", "")
        if status == 500:
            return problem(500, "Error", "the service failed; see its log")
        answer = problem(status, type(error).__name__.removesuffix("Error"), detail)
        if isinstance(error, BusyError):
            answer.headers["Retry-After"] = "1"
        return answer

    def answers(
        self, router: APIRouter, path: str, given: type[BaseModel], shape: Any,
        work: Callable[[Job, Any], Document],
    ) -> None:  # fmt: skip
        """Have a path answered by work, which gets the request."""

        class BodyRequest(Request):
            """A request whose body is read before FastAPI asks for it."""

            given: BaseModel

            async def json(self) -> Any:
                return self.given

        class Reading(APIRoute):
            """A path whose requests are read in a thread, while others are heard."""

            def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
                handle = super().get_route_handler()

                async def handler(request: Request) -> Response:
                    read = BodyRequest(request.scope, request.receive)
                    content = await read.body()
                    read.given = await asyncio.to_thread(requests.read_body, content, given)
                    return await handle(read)

                return handler

        async def endpoint(body: Any, request: Request) -> Response:
            return await self.answer(request, lambda job: work(job, body))

        endpoint.__annotations__["body"] = given
        router.add_api_route(
            path, endpoint, methods=["POST"], response_model=shape, summary=given.__doc__,
            name=path.strip("/"), route_class_override=Reading,
        )  # fmt: skip

    async def answer(self, request: Request, work: Callable[[Job], Document]) -> Response:
        """Have work done, until the client goes away; stream events if it wants them."""
        job = self.pool.submit(lambda job: _written(work(job)))
        if "text/event-stream" in request.headers.get("accept", ""):
            return StreamingResponse(self._events(request, job), media_type="text/event-stream")
        async for _ in self._progress(request, job):
            pass
        return Response(job.future.result(), media_type="application/json")

    async def _progress(self, request: Request, job: Job) -> AsyncGenerator[Document]:
        """Yield what a job says until it is done; end it where nobody waits for it."""
        waiting, count = asyncio.wrap_future(job.future), 0
        waiting.add_done_callback(lambda done: done.cancelled() or done.exception())
        try:
            while not waiting.done() or count < len(job.said):
                if self.pool.closing or await request.is_disconnected():
                    raise CancelledError("the client went away")
                for event in job.said[count:]:
                    count += 1
                    yield event
                await asyncio.wait({waiting}, timeout=0.1)
        finally:
            job.cancelled.set()

    async def _events(self, request: Request, job: Job) -> AsyncIterator[str]:
        """Yield what a job says as server-sent events, its answer last."""
        try:
            async with aclosing(self._progress(request, job)) as progress:
                async for event in progress:
                    yield f"event: progress\ndata: {json.dumps(event)}\n\n"
            yield f"event: answer\ndata: {job.future.result().decode()}\n\n"
        except Exception as error:  # noqa: BLE001  the answer has begun: a status comes too late
            yield f"event: problem\ndata: {bytes(self.problem(error).body).decode()}\n\n"


def _written(document: Document) -> bytes:
    """Write an answer, numbers all finite, up to a size; others are heard meanwhile."""
    parts, size = list[str](), 0
    for part in json.JSONEncoder(separators=(",", ":"), allow_nan=False).iterencode(document):
        parts.append(part)
        size += len(part)
        if size > MOST:
            raise EnergyPlanError(f"the answer has over {MOST >> 20} MiB; ask for less")
    return "".join(parts).encode()


def _whole(found: Document, notes: Sequence[str], model: PowerModel, *more: PowerModel) -> Document:
    """Add to an answer its notes, and which of its models are presets."""
    notes = [*found.get("notes", ()), *notes, *unusual(model.vehicle, "vehicle")]
    return with_presets({**found, "notes": notes} if notes else found, (model, *more))


def _files(service: _Service) -> APIRouter:
    router, store, pool = APIRouter(), service.store, service.pool

    @router.get("/health", response_model=answers.HEALTH)
    async def health() -> Document:
        """Report that the service is running, and how busy it is."""
        return {"version": __version__, "workers": pool.workers, "load": pool.load}

    @router.get("/files", response_model=answers.FILES)
    async def listing() -> Document:
        """List the data folder by kind, and the planners."""
        presets = {"models": [*MODEL_PRESETS], "batteries": [*BATTERY_PRESETS]}
        names, unreadable = await asyncio.to_thread(store.names)
        return {
            **names,
            "unreadable": unreadable,
            "presets": presets,
            "planners": [*known_planners()],
        }

    @router.put("/files/{name:path}", status_code=201, response_model=answers.SAVED)
    async def upload(name: str, request: Request) -> Document:
        """Add a file to the data folder; one that is there is never replaced."""
        content = await request.body()
        await asyncio.to_thread(store.save, name, content)
        return {"name": name, "bytes": len(content)}

    @router.get("/maps/{name:path}", response_model=answers.MAP)
    async def map_document(name: str, request: Request) -> Response:
        """Return size, resolution [m], origin and a picture of a map's occupied cells."""
        return await service.answer(
            request, lambda job: _map_document(store.site(SiteFile(map=name)).grid)
        )

    @router.get("/surfaces/{name:path}", response_model=dict[str, Any])
    async def surface_document(name: str) -> Response:
        """Return the polygons of surfaces as they are."""
        await asyncio.to_thread(store.read, name, read_surfaces)
        return FileResponse(store.path(name), media_type="application/geo+json")

    return router


def _map_document(grid: Any) -> Document:
    """Return a map with its occupied cells as a PNG, black where occupied, else transparent.

    The first row of the picture is the one at the map's origin.
    """
    from PIL import Image

    occupied = np.asarray(grid.occupied, bool)
    picture = Image.fromarray(occupied.astype(np.uint8), "L").convert("P")
    picture.putpalette([255, 255, 255, 0, 0, 0])
    stream = io.BytesIO()
    picture.save(stream, "PNG", bits=1, transparency=0)
    return {
        "rows": occupied.shape[0], "columns": occupied.shape[1], "resolution": grid.resolution,
        "origin": documents.plain(tuple(grid.origin)),
        "image": f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}",
    }  # fmt: skip


def _problem(
    store: Store,
    given: requests.PlanRequest | requests.RangeRequest,
    battery: bool,
    goal: Any,
    **more: Any,
) -> NotedProblem:
    """Return what is to be planned on a site of the store."""
    ends = as_pose(given.start, "start"), goal
    model = store.named(given.model, read_model)
    return problem_from(
        store.site(given), model, ends, battery=battery, reverse=given.reverse, **more
    )


def _battery(
    store: Store, given: requests.PlanRequest | requests.RangeRequest | requests.CheckRequest
) -> Battery | None:
    """Return the battery that a request names, if it names one."""
    return None if given.pack is None else store.named(given.pack, read_battery)


def _routes(service: _Service) -> APIRouter:
    router, store = APIRouter(), service.store

    def planned(
        run: Callable[..., Any],
        document: Callable[..., Document],
        plans: Callable[[Any], tuple[Plan, ...]],
        job: Job,
        given: requests.PlanRequest,
    ) -> Document:
        pack = _battery(store, given)
        query = _problem(
            store, given, given.battery or pack is not None, given.goal, objective=given.objective,
            costmap_weight=given.costmap_weight,
        )  # fmt: skip
        job.say("planning")
        limit = math.inf if given.time_limit is None else given.time_limit
        try:
            result = run(query.problem, given.planner, limit, effort=given.effort)
            runs = (one.drawn(pack, given.soc) for one in plans(result)) if pack else ()
            found = document(result, *runs)
        except NoPathError as error:  # an answer, as on the command line
            found = documents.no_path(error)
        notes = (*query.notes, *(pack.notes if pack else ()))
        return _whole(found, notes, *models_of(query.problem))

    def reach(job: Job, given: requests.RangeRequest) -> Document:
        if (given.energy is None) == (given.pack is None):
            raise InvalidInputError("give either energy or pack, the name of a battery")
        pack = _battery(store, given)
        problem, notes = _problem(store, given, pack is not None, given.start)
        usable: float | UsableCharge
        if pack is not None:
            usable = UsableCharge(problem.cost, pack, given.soc, given.reserve)
            notes += pack.notes
        else:
            usable = (1.0 - given.reserve) * (given.energy or 0.0)
        job.say("searching")
        found = energy_map(
            problem, energy=usable, back=given.back, confidence=given.confidence,
            coefficient_spread=given.coefficient_spread,
        )  # fmt: skip
        areas = found.areas(usable)
        document = {**documents.energy_map(found, areas), "areas": contours_document(areas)}
        return _whole(document, notes, *models_of(problem))

    def checked(job: Job, given: requests.CheckRequest) -> Document:
        pack = _battery(store, given)
        columns = {name: column for name, column in given if isinstance(column, np.ndarray)}
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            raise InvalidInputError(f"the columns have different lengths: {lengths}")
        model, _, notes = on_site(store.named(given.model, read_model), None)
        drive, law, run = Trajectory(**columns), model, None
        if pack is not None:
            law, notes = model.battery_side(), (*notes, *pack.notes)
            run = Traversal(drive, Ground(law)).drawn(pack, given.soc)
        return _whole(documents.feasibility(check(drive, law), run), notes, model)

    routed = partial(planned, plan, documents.plan, lambda found: (found,))
    service.answers(router, "/plan", requests.PlanRequest, answers.PLAN, routed)
    compared = partial(
        planned, compare, documents.comparison, lambda found: (found.energy_optimal, found.shortest)
    )
    service.answers(router, "/compare", requests.PlanRequest, answers.COMPARISON, compared)
    service.answers(router, "/range", requests.RangeRequest, answers.RANGE, reach)
    service.answers(router, "/check", requests.CheckRequest, answers.CHECK, checked)
    return router


def _timeline(report: MissionReport) -> Document:
    names = ("t", "x", "y", "soc", "soc_lower", "soc_upper", "power")
    found = {name: documents.plain(getattr(report.timeline, name)) for name in names}
    return {**found, "reserve": [report.mission.reserve] * len(report.timeline.t)}


@cache
def _compiled() -> None:
    """Compile what the service may call, once, which no limit of time counts."""
    compile_kernels("energyplan")


def _mission(file: Path) -> Mission:
    return read_mission(file, inside=True)


def _missions(service: _Service) -> APIRouter:
    router, store, routes = APIRouter(), service.store, Routes()

    read = partial(store.read, read=_mission, keep=False)

    def opened(job: Job, name: str) -> Document:
        """Return what the page shows of a mission's file, and what the file holds."""
        mission = read(name)
        shapes = [
            {"type": "Feature", "properties": {"surface": name}, "geometry": mapping(area)}
            for name, area in (mission.surfaces.polygons if mission.surfaces else ())
        ]
        keys = ("start", "soc", "reserve", "coefficient_spread", "tasks", "chargers")
        return {
            "document": documents.plain(load(store.path(name), InvalidInputError).data),
            **{key: documents.plain(getattr(mission, key)) for key in keys},
            "robots": [
                {"name": one.name, "start": documents.plain(one.start)} for one in mission.parts
            ],
            "map": _map_document(mission.map),
            "areas": {"type": "FeatureCollection", "features": shapes},
        }

    @router.get("/missions/{name:path}", response_model=answers.PREPARED)
    async def mission_document(name: str, request: Request) -> Response:
        """Return what a mission's file holds, its numbers in SI units, and a picture of its map."""
        return await service.answer(request, lambda job: opened(job, name))

    def evaluated(job: Job, given: requests.MissionRequest) -> Document:
        if given.mission is None and given.document is None:
            raise InvalidInputError("give mission, the name of a file, or document")
        job.limit(given.time_limit)
        mission = (
            read(given.mission) if given.mission is not None and given.document is None
            else mission_from(
                given.document or {},
                (store.path(given.mission) if given.mission else store.folder / "mission").parent,
            )
        )  # fmt: skip
        if len(mission.tasks) > MOST_TASKS or (mission.planning_effort or 0) > MOST_EFFORT:
            raise InvalidInputError(
                f"the mission has more than {MOST_TASKS} tasks, or a planning_effort above "
                f"{MOST_EFFORT}; energyplan mission has no such limit"
            )
        with job.untimed():
            _compiled()
        report = evaluate(mission, job.say, routes=routes)
        found = documents.mission(report, trajectories=True)
        for one, robot in zip(report.robots, found.get("robots", ()), strict=True):
            robot["timeline"] = _timeline(one)
        if not report.robots:
            found["timeline"] = _timeline(report)
        models = [model for part in mission.parts or (mission,) for model in models_of(part)]
        return with_presets(found, models)

    service.answers(router, "/mission", requests.MissionRequest, answers.MISSION, evaluated)
    return router


def _logs(service: _Service) -> APIRouter:
    router, store = APIRouter(), service.store

    def begun(name: str, robot: requests.RobotMeasures) -> Start:
        known = robot.model_dump(exclude_none=True, exclude={"like"})
        like = store.named(robot.like, read_vehicle) if robot.like else None
        return start_of(store.path(name), Given(**known, like=like, name="" if like else "robot"))

    def robot_of(given: requests.IdentifyRequest) -> tuple[Vehicle, Project | None]:
        """Return whose the logs are; a log that contradicts a robot of one's own is refused."""
        if (given.vehicle is None) == (given.robot is None):
            raise InvalidInputError("give either vehicle, the name of one, or robot, its measures")
        if given.robot is None:
            return store.named(given.vehicle, read_vehicle), None
        result = begun(given.logs[0], given.robot)
        if not result.sound:
            raise InvalidInputError("; ".join(str(one) for one in result.checks if not one.ok))
        return result.project.vehicle, result.project

    def read(name: str, given: requests.IdentifyRequest, project: Project | None) -> DriveLog:
        columns = None if project is None else dict(project.columns) or None
        topics = topic_map_of(given.vehicle or "") if project is None else project.topics
        # what reads a log is part of what is kept of it
        reader = partial(read_log, columns=columns, topics=topics)
        return store.read(name, reader, given.vehicle, repr(columns), repr(topics))

    def identified(job: Job, given: requests.IdentifyRequest) -> Document:
        vehicle, project = robot_of(given)
        logs = [read(name, given, project) for name in given.logs]
        job.say("identifying")
        found = identify(logs, vehicle)
        return {**documents.identification(found), "model_file": model_text(found.model)}

    def diagnosed(job: Job, given: requests.DiagnoseRequest) -> Document:
        def say(fraction: float, note: str = "") -> None:
            job.say("diagnosing", fraction=fraction, note=note)

        vehicle, project = robot_of(given)
        logs, judging = (
            [read(name, given, project) for name in names] for names in (given.logs, given.holdout)
        )
        found = diagnose(logs, holdout=judging, vehicle=vehicle, progress=say)
        return {**documents.diagnosis(found), "model_file": model_text(found.model)}

    def started(job: Job, given: requests.StartRequest) -> Document:
        result = begun(given.log, given.robot)
        return {**documents.start(result), "sound": result.sound}

    service.answers(router, "/start", requests.StartRequest, answers.START, started)
    service.answers(
        router, "/identify", requests.IdentifyRequest, answers.IDENTIFICATION, identified
    )
    service.answers(router, "/diagnose", requests.DiagnoseRequest, answers.DIAGNOSIS, diagnosed)
    return router
