"""The service: the answers of the library, and nothing that a request must not reach."""

from __future__ import annotations

import asyncio
import base64
import errno
import gc
import gzip
import http.client
import io
import json
import logging
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
import shapely
import yaml
from PIL import Image
from scipy.sparse.csgraph import dijkstra

import energyplan as ep
from energyplan import simulate
from energyplan.errors import CancelledError, InvalidInputError, UnknownNameError
from energyplan.io import documents as io_documents
from energyplan.io.config import write_model
from energyplan.io.files import bundled
from energyplan.io.maps import write_map
from energyplan.io.mission import mission_from
from energyplan.io.tables import write_log
from energyplan.mission.routes import shortest_ways
from energyplan.output import documents
from energyplan.planning.budget import EFFORT, cancellable
from energyplan.power import HOTEL

pytest.importorskip("fastapi", reason="the service needs the extra serve")
from fastapi.testclient import TestClient
from starlette.exceptions import HTTPException

from energyplan.serve import create_app, is_loopback, run, server
from energyplan.serve.requests import Guard
from energyplan.serve.store import BusyError, Job, Pool, Store

ROOT = Path(__file__).resolve().parents[2]
MODEL = "quadriga:full:concrete"
LOCAL = "http://localhost"
OUTSIDE = ("../secret.yaml", "/etc/passwd", "link.yaml", "a/../../secret.yaml", ".hidden.yaml",
           "a\0b.yaml")  # fmt: skip
QUERY = {"map": "warehouse.yaml", "model": MODEL, "start": [2, 2, 0], "goal": [5, 2, 0]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("data")
    for name in ("warehouse.yaml", "warehouse.png", "warehouse_surfaces.geojson"):
        shutil.copy(ROOT / "maps" / name, place)
    (place / "round.yaml").write_text(
        f"model: {MODEL}\nmap: room.yaml\nbattery: quadriga\nstart: [1, 2, 0]\n"
        "coefficient_spread: 5 %\nplanning_effort: 1000\ntasks:\n- {name: look, pose: [4, 2, 0]}\n"
        "- {name: wash, pose: [2, 3, 0], dwell: 2 h, power: 450 W, required: false}\n"
    )
    truth = ep.PowerModel.preset("quadriga:full:marble").with_term(HOTEL, 40.0)
    for seed, name in enumerate(("a.csv", "b.csv")):
        write_log(simulate.validation_drive(truth, seed=seed, power_noise=5.0), place / name)
    walls = np.zeros((40, 100), bool)
    walls[:, 50] = True
    write_map(ep.OccupancyGrid(walls, 0.1), place / "room.yaml")
    (place.parent / "secret.yaml").write_text("image: secret.png\nresolution: 0.1\n")
    (place / "link.yaml").symlink_to(place.parent / "secret.yaml")
    return place


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[TestClient]:
    with TestClient(create_app(folder), LOCAL, raise_server_exceptions=False) as made:
        yield made


def test_what_is_unusual_is_said_and_what_is_impossible_is_refused(
    client: TestClient, folder: Path
) -> None:
    (folder / "heavy.yaml").write_text(
        "vehicle: {preset: jackal, mass: 17000}\n"
        "terms: [{name: slip_friction, value: 0.5}, {name: traction_resistance, value: 10}]\n"
    )
    told = client.post("/api/plan", json={**QUERY, "model": "heavy.yaml", "effort": 100}).json()
    again = client.post("/api/plan", json={**QUERY, "model": "heavy.yaml", "effort": 100}).json()
    for answer in (told, again):  # the model is read once
        assert any("vehicle.loads.0: 41692" in note for note in answer["notes"]), answer["notes"]
    document = {
        "model": MODEL, "map": "room.yaml", "battery": "12.8 V 20 Ah LiFePO4 at -5 degC",
        "start": [1, 2, 0], "planning_effort": 1000, "coefficient_spread": 0.05,
        "tasks": [{"name": "look", "pose": [4, 2, 0], "power": 1e5, "dwell": 1}],
        "chargers": [{"name": "dock", "pose": [1, 2, 0], "power": 200}],
    }  # fmt: skip
    warnings = client.post("/api/mission", json={"document": document}).json()["warnings"]
    assert any(one.startswith("mission, tasks.0.power: 100000 is unusual") for one in warnings)
    assert any("no charge at 'dock'" in one and "indoors, above 0 degC" in one for one in warnings)
    for change, words in (
        ({"start": [None, 2.0, "90deg"]}, "start: pose [None, 2.0, '90deg'] is not X,Y,YAW"),
        ({"battery": {"preset": "quadriga", "temperature": 300}}, "(not kelvin), not '300'"),
        ({"tasks": [{**document["tasks"][0], "power": 1e9}]}, "tasks.0.power: give 0 to 1e+06 W"),
    ):
        refused = client.post("/api/mission", json={"document": {**document, **change}})
        assert refused.status_code == 422
        assert words in refused.json()["detail"]


def test_a_plan_and_a_check_say_what_a_drive_asks_of_a_battery(client: TestClient) -> None:
    asked = {"map": "room.yaml", "model": MODEL, "start": [1, 2, 0], "goal": [4, 2, 0],
             "effort": 1000}  # fmt: skip
    pack = {"pack": "24 V 20 Ah lead-acid", "soc": 0.8}
    assert client.post("/api/plan", json=asked).json()["battery"] is None
    told = client.post("/api/plan", json={**asked, **pack}).json()
    assert told["battery"]["peak_power"] > told["energy_driven"] / told["duration"]
    assert 0.79 < told["battery"]["soc_end"] < 0.8
    assert any("is typical of its chemistry" in note for note in told["notes"])
    compared = client.post("/api/compare", json={**asked, **pack}).json()
    assert compared["energy_optimal"]["battery"]["peak_current"] > 0
    rows = {"t": [0, 1, 2], "x": [0, 0.5, 1], "y": [0, 0, 0], "yaw": [0, 0, 0], "v": [0.5] * 3,
            "omega": [0, 0, 0]}  # fmt: skip
    checked = client.post("/api/check", json={"model": MODEL, **rows, **pack}).json()
    assert checked["battery"]["peak_power"] == pytest.approx(checked["energy"] / 2.0)


def test_a_range_holds_the_places_that_plans_reach(client: TestClient) -> None:
    asked = {"map": "warehouse.yaml", "model": MODEL, "start": [2, 2, 0], "energy": 4000.0}
    told = client.post("/api/range", json=asked).json()
    areas = [shapely.geometry.shape(f["geometry"]) for f in told["areas"]["features"]]
    assert [f["properties"]["energy"] for f in told["areas"]["features"]] == pytest.approx(
        [800.0, 1600.0, 2400.0, 3200.0, 4000.0]
    )
    assert all(a.area <= b.area for a, b in pairwise(areas))
    plan = client.post("/api/plan", json=QUERY).json()
    assert areas[-1].contains(shapely.Point(5, 2)) is (plan["energy"] < 4000.0)
    back = client.post("/api/range", json={**asked, "back": [2, 2, 0]}).json()
    assert back["area"] < told["area"]
    docks = {**asked, "back": [[2, 2, 0], {"x": 6, "y": 2, "radius": 0.5}]}
    assert back["area"] < client.post("/api/range", json=docks).json()["area"] < told["area"]
    charged = {**asked, "energy": None, "pack": "quadriga", "soc": 0.5}
    assert client.post("/api/range", json=charged).json()["area"] > told["area"]
    neither = client.post("/api/range", json={**asked, "energy": None})
    assert (neither.status_code, "either energy or pack" in neither.json()["detail"]) == (422, True)


def test_a_map_is_a_picture_of_its_cells(client: TestClient) -> None:
    told = client.get("/api/maps/warehouse.yaml").json()
    grid = ep.read_map(ROOT / "maps" / "warehouse.yaml")
    kind, _, content = told["image"].partition(",")
    assert kind == "data:image/png;base64"
    picture = Image.open(io.BytesIO(base64.b64decode(content))).convert("RGBA")
    assert np.array_equal(np.asarray(picture)[..., 3] > 0, grid.occupied)
    assert (told["rows"], told["columns"]) == grid.occupied.shape


def test_an_edited_file_is_read_anew(tmp_path: Path) -> None:
    """The image of a map and the model that surfaces name, whatever their times say."""
    room = np.zeros((40, 100), bool)
    write_map(ep.OccupancyGrid(room, 0.1), tmp_path / "room.yaml")
    area = [[[0, 0], [10, 0], [10, 4], [0, 4], [0, 0]]]
    ground = {"type": "Feature", "properties": {"model": "soft.yaml"},
              "geometry": {"type": "Polygon", "coordinates": area}}  # fmt: skip
    (tmp_path / "ground.geojson").write_text(
        json.dumps({"type": "FeatureCollection", "features": [ground]})
    )
    model = ep.PowerModel.preset(MODEL)
    write_model(model, tmp_path / "soft.yaml")
    asked = {**QUERY, "map": "room.yaml", "goal": [7, 2, 0], "effort": 2000}
    with TestClient(create_app(tmp_path), LOCAL) as client:

        def energy(**more: Any) -> float:
            told = client.post("/api/plan", json={**asked, **more}).json()
            return float(told["energy"]) if told["path"] else np.inf

        before = energy(), energy(surfaces="ground.geojson")
        write_model(model.with_coefficients(3.0 * model.coefficients), tmp_path / "soft.yaml")
        assert energy(surfaces="ground.geojson") == pytest.approx(3.0 * before[1], rel=1e-6)
        room[:, 50] = True
        write_map(ep.OccupancyGrid(room, 0.1), tmp_path / "wall.yaml")
        image = next(file for file in tmp_path.glob("room.p*"))
        times = image.stat()
        shutil.copy(tmp_path / f"wall{image.suffix}", image)
        os.utime(image, ns=(times.st_atime_ns, times.st_mtime_ns))
        assert before[0] < energy() == np.inf


def test_a_log_that_is_replaced_is_read_anew(tmp_path: Path) -> None:
    found = []
    with TestClient(create_app(tmp_path), LOCAL) as client:
        for ground in ("marble", "concrete"):
            truth = ep.PowerModel.preset(f"quadriga:full:{ground}")
            write_log(simulate.validation_drive(truth, seed=1, power_noise=5.0), tmp_path / "a.csv")
            asked = {"logs": ["a.csv"], "vehicle": "quadriga:full"}
            found.append(client.post("/api/identify", json=asked).json()["terms"][0]["value"])
    assert abs(found[0] - found[1]) > 0.05


def test_a_log_of_a_robot_of_ones_own_is_read_as_start_reads_it(tmp_path: Path) -> None:
    """It is never fitted to another robot in silence."""
    log = simulate.identification_drive(ep.PowerModel.preset(MODEL), seed=1, power_noise=5.0)
    made = {"stamp": log.t, "left_speed": log.channel("v_left"), "power_W": log.power,
            "right_speed": log.channel("v_right"), "gyro_z": log.channel("yaw_rate")}  # fmt: skip
    pd.DataFrame(made).to_csv(tmp_path / "own.csv", index=False)
    robot = {"track": 0.5, "wheelbase": 0.475, "mass": 147.1}
    with TestClient(create_app(tmp_path), LOCAL) as client:
        told = client.post("/api/start", json={"log": "own.csv", "robot": robot}).json()
        assert told["columns"]["v_left"] == "left_speed" and told["sound"]
        found = client.post("/api/identify", json={"logs": ["own.csv"], "robot": robot})
        assert {term["name"] for term in found.json()["terms"]} >= {"slip_friction"}, found.text
        assert yaml.safe_load(found.json()["model_file"])["name"] == "robot, own"
        both: dict[str, Any] = {"robot": robot, "vehicle": "quadriga:full"}
        for wrong in ({}, both):
            answer = client.post("/api/identify", json={"logs": ["own.csv"], **wrong})
            assert answer.status_code == 422 and "give either vehicle" in answer.json()["detail"]
        heavy = {**robot, "mass": 147100.0}
        answer = client.post("/api/identify", json={"logs": ["own.csv"], "robot": heavy})
        assert answer.status_code == 422 and "(not grams)" in answer.json()["detail"]


def guarded(guard: Guard, *messages: Any, gate: asyncio.Event | None = None) -> Any:
    """Have a body come in messages, its end at a gate if there is one; return the status."""
    statuses: list[int] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        try:
            while (await receive())["more_body"]:
                pass
            statuses.append(200)
        except HTTPException as error:
            statuses.append(error.status_code)
            assert error.status_code != 429 or (error.headers or {})["Retry-After"] == "1"

    async def refusal(message: Any) -> None:
        statuses.append(message.get("status", 0))

    async def ask() -> int:
        left = list(messages)

        async def receive() -> Any:
            if not left:
                await (gate.wait() if gate else asyncio.sleep(60.0))
            return left.pop(0) if left else {"type": "http.request", "more_body": False}

        headers = [(b"authorization", b"bearer right")]
        guard.app = app
        scope = {"type": "http", "method": "PUT", "path": "/api/files/a", "headers": headers}
        await guard(scope, receive, refusal)
        return statuses[0]

    return ask()


def test_a_body_that_does_not_come_is_not_waited_for() -> None:
    """Nor is one without the token, which is refused before any of it."""
    with ThreadPoolExecutor(1) as pool:  # the browser's tests leave a loop in this thread
        for token, status in (("right", 408), ("other", 401)):
            guard = Guard(Mock(), token, deadline=0.05)
            assert pool.submit(asyncio.run, guarded(guard)).result() == status


def test_bodies_under_way_have_a_limit_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("energyplan.serve.requests.HELD", 150)
    part = {"type": "http.request", "body": bytes(100), "more_body": True}

    async def three() -> list[int]:
        guard, gate = Guard(Mock(), None), asyncio.Event()
        first = asyncio.create_task(guarded(guard, part, gate=gate))
        await asyncio.sleep(0)
        beside = await guarded(guard, part, gate=gate)
        gate.set()
        return [beside, await first, await guarded(guard, part, gate=gate)]

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(asyncio.run, three()).result() == [429, 200, 200]


class Wires:
    """Connections to the service, as the event loop would hand them over, and their timers."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
        monkeypatch.setattr("energyplan.serve._MOST", most)
        self.now, self.timers = 0.0, list[Any]()
        self.loop = Mock(
            call_later=lambda delay, look: self.timers.append(look), time=lambda: self.now,
            create_task=lambda work, **_: Mock(closed=work.close()),
        )  # fmt: skip
        self.config = server(Mock()).config
        self.config.app = Mock()
        self.config.load()
        self.state = Mock(connections=set(), tasks=set())
        self.made: list[Any] = []

    def connect(self, head: bytes = b"") -> Any:
        """Open a connection that sends the beginning of a request."""
        self.now += 1.0
        made = self.config.http_protocol_class(self.config, self.state, {}, self.loop)
        wire = Mock(is_closing=lambda: wire.abort.called, get_extra_info=lambda name: None)
        wire.get_write_buffer_size.return_value = 0
        wire.abort.side_effect = lambda: self.state.connections.discard(made)
        made.connection_made(wire)
        if head:
            made.data_received(head)
        self.made.append(made)
        return made

    def look(self) -> None:
        """Let the time between two looks pass for all connections."""
        timers, self.timers[:] = self.timers[:], []
        for timer in timers:
            timer()

    @property
    def ended(self) -> list[bool]:
        """Which connections were ended."""
        return [one.transport.abort.called for one in self.made]


HALF = b"GET / HTTP/1.1\r\nHost: x\r\nX-a: "
WHOLE = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


def test_connections_on_which_nothing_moves_are_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the second look, whether no head comes or no answer is read; work is waited for."""
    wires = Wires(monkeypatch, most=10)
    unread, read, works = (wires.connect(WHOLE) for _ in range(3))
    _, trickles = (wires.connect(HALF) for _ in range(2))
    for one in (unread, read):  # more is written than the client has read
        one.cycle.more_body = False
        one.pause_writing()
        one.transport.get_write_buffer_size.return_value = 70_000
    works.cycle.more_body = False
    for k in range(4):
        read.transport.get_write_buffer_size.return_value -= 1
        wires.now += 10.0
        trickles.data_received(b"a")
        assert wires.ended == [k > 1, False, False, k > 1, False]
        wires.look()
    works.cycle.response_complete = True
    for _ in range(3):
        wires.look()
    assert works.transport.abort.called


def test_who_waits_for_its_client_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """The longest first: greedy clients that read nothing lock nobody out, nor do slow ones."""
    wires = Wires(monkeypatch, most=3)
    works, unread, half = wires.connect(WHOLE), wires.connect(WHOLE), wires.connect(HALF)
    for one in (works, unread):
        one.cycle.more_body = False
    unread.pause_writing()
    for k in range(3):
        wires.connect(WHOLE).cycle.more_body = False
        # at last all others are at work, and the new one has to go
        assert wires.ended == [False, True, k > 0, False, False, k > 1][: 4 + k]
    assert not works.transport.abort.called and half.transport.abort.called


@pytest.mark.parametrize(
    ("change", "status", "told"),
    [
        ({"map": "none.yaml"}, 404, "no file"),
        ({"start": [2, 2]}, 422, "start"),
        ({"start": [2, 2, "x"]}, 422, "start"),
        ({"start": [2, 2, 90]}, 422, "in degrees"),
        ({"time_limit": 1e9}, 422, "time_limit"),
        ({"time_limit": 0}, 422, "time_limit"),
        ({"effort": 10**12}, 422, "effort"),
        ({"strange": 1}, 422, "strange"),
        ({"model": "quadriga:full:lava"}, 422, "lava"),
        ({"planner": "none"}, 422, "none"),
        ({"start": [-50, 2, 0]}, 409, "outside the map"),
        ({"start": [1e308, 2, 0]}, 409, "the start (1e+308, 2.000, 0.0 deg) lies outside"),
        *[({key: name}, 404, "") for key in ("map", "model") for name in OUTSIDE],
    ],
)
def test_bad_requests_are_told_what_is_wrong(
    client: TestClient, change: dict[str, Any], status: int, told: str
) -> None:
    answer = client.post("/api/plan", json={**QUERY, **change})
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert told in answer.json()["detail"]
    assert {"type", "title", "status", "detail"} <= set(answer.json())


def test_other_bodies_are_refused(client: TestClient) -> None:
    assert "the body: Invalid" in client.post("/api/plan", content=b"{", headers=_JSON).text
    assert client.post("/api/plan", content=b"a=1").status_code == 415
    large = client.post("/api/plan", content=b"", headers={**_JSON, "Content-Length": "999999999"})
    assert large.status_code == 413
    pieces = client.post("/api/plan", content=iter([bytes(2**20)] * 7), headers=_JSON)
    assert (pieces.status_code, "larger than" in pieces.text) == (413, True)  # its size untold
    keys = client.post("/api/plan", json={f"k{k}": 0 for k in range(30_000)})
    assert (keys.status_code, keys.json()["detail"]) == (
        422, "the body: Value error, it has more than 100 keys",
    )  # fmt: skip
    assert client.get("/api/none").status_code == 404


_JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        *[(path, {"Authorization": given}, status)
          for path in ("/api/health", "/openapi.json")
          for given, status in (("Bearer secret", 200), ("bearer secret", 200), ("secret", 401),
                                ("Bearer secreT", 401), ("Basic secret", 401))],
        ("/api/health", {}, 401), ("/health", {}, 200), ("/health", {"Host": "testserver"}, 400),
        *[("/health", {"Host": name}, 200) for name in ("LOCALHOST:8321", "127.0.0.1", "[::1]:1")],
    ],
)  # fmt: skip
def test_who_is_answered(folder: Path, path: str, headers: dict[str, str], status: int) -> None:
    """Health needs no secret; the names of this machine are known in any case, and no others."""
    with TestClient(create_app(folder, token="secret"), LOCAL) as client:
        answer = client.get(path, headers=headers)
    assert answer.status_code == status
    assert (answer.text == "ok") == (path == "/health" and status == 200)
    policy = answer.headers["content-security-policy"]  # no other site frames or scripts the page
    assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy


def test_uploads_replace_nothing(client: TestClient, folder: Path) -> None:
    before = (folder / "a.csv").read_bytes()
    assert client.put("/api/files/a.csv", content=b"x").status_code == 422
    assert (folder / "a.csv").read_bytes() == before
    assert client.put("/api/files/new/c.csv", content=b"t,v\n").status_code == 201
    assert (folder / "new" / "c.csv").read_bytes() == b"t,v\n"
    assert client.put("/api/files/evil.py", content=b"x").status_code == 422
    assert client.put("/api/files/a.csv/b.csv", content=b"x").status_code == 422
    assert client.put(f"/api/files/{'n' * 300}.csv", content=b"x").status_code == 404
    assert client.put("/api/files/OWN.CSV", content=b"x").status_code == 201
    assert not list(folder.glob(".*"))
    assert client.put("/api/files/..%2Fout.csv", content=b"x").status_code == 404
    assert not (folder.parent / "out.csv").exists()


def test_events_end_with_the_answer(client: TestClient) -> None:
    with client.stream(
        "POST", "/api/plan", json=QUERY, headers={"Accept": "text/event-stream"}
    ) as answer:
        lines = [line for line in answer.iter_lines() if line]
    events = [line.removeprefix("event: ") for line in lines if line.startswith("event")]
    assert events[-1] == "answer"
    assert events[:-1] == ["progress"] * (len(events) - 1)
    assert json.loads(lines[-1].removeprefix("data: "))["energy"] > 0


def test_as_much_waits_as_may_wait() -> None:
    pool, gate, begun = Pool(workers=1, waiting=1), threading.Event(), threading.Event()

    def work(job: Job) -> str:
        begun.set()
        gate.wait(30)
        return "done"

    first = pool.submit(work)
    assert begun.wait(30)
    second = pool.submit(work)
    with pytest.raises(BusyError, match="1 requests wait"):
        pool.submit(work)
    second.cancelled.set()
    gate.set()
    assert first.future.result(30) == "done"
    with pytest.raises(ep.errors.EnergyPlanError, match="cancelled"):
        second.future.result(30)
    pool.submit(work).future.result(30)  # there is room again
    pool.close()


def test_a_plan_that_nobody_waits_for_ends() -> None:
    pool, begun = Pool(workers=1, waiting=1), threading.Event()
    grid = ep.read_map(ROOT / "maps" / "warehouse.yaml")
    cost = ep.EnergyCost(ep.PowerModel.preset(MODEL))
    aisles = ep.PlanningProblem(grid, cost, (2, 2, 0), (20, 12, 1.5))

    def work(job: Job) -> ep.Plan:
        begun.set()
        return ep.plan(aisles, effort=10**9, gap=0.0)

    job = pool.submit(work)
    assert begun.wait(300)
    job.cancelled.set()
    with pytest.raises(ep.errors.CancelledError):
        job.future.result(300)
    pool.close()


def test_others_are_served_only_with_a_token(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="leave --no-token out"):
        run(folder, host="0.0.0.0", open_to_all=True)
    with pytest.raises(InvalidInputError, match="no folder"):
        create_app(tmp_path / "none")
    assert [is_loopback(h) for h in ("127.0.0.1", "localhost", "::1", "0.0.0.0", "robot")] == [
        True, True, True, False, False,
    ]  # fmt: skip


def test_a_line_of_the_log_tells_who_asked_what_and_what_came_of_it(
    folder: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a service that another test has started in this process hands its lines on to nobody, and
    # pytest then listens to its logger as well
    said = io.StringIO()
    logger = logging.getLogger("energyplan.serve")
    monkeypatch.setattr(logger, "handlers", [logging.StreamHandler(said)])
    caplog.set_level("INFO", "energyplan.serve")
    with TestClient(create_app(folder, token="secret"), LOCAL) as client:
        client.get("/health")
        client.post("/api/plan%0A", json={})
        client.get("/health", headers={"Host": "elsewhere.example"})
    lines = said.getvalue().splitlines()
    assert [re.sub(r"\d\.\d{3} s$", "TIME", line) for line in lines] == [
        'testclient:50000 "GET /health" 200 TIME',
        'testclient:50000 "POST /api/plan%0A" 401 TIME',
        'testclient:50000 "GET /health" 400 TIME',
    ]


def test_a_mission_has_bounds(client: TestClient, folder: Path) -> None:
    content = yaml.safe_load((folder / "round.yaml").read_text())

    def refused(**change: Any) -> str:
        document = {**content, **change}
        answer = client.post("/api/mission", json={"document": document, "time_limit": 1e-3})
        return f"{answer.status_code} {answer.json()['detail']}"

    many = [{"name": f"t{k}", "pose": [2, 2, 0]} for k in range(501)]
    assert refused(strange=[0] * 50_000) == ("422 the body: it holds more than 50000 values")
    assert "422 the mission has more than 500 tasks" in refused(tasks=many)
    assert "planning_effort above" in refused(planning_effort=6_000_000)
    assert refused(start=[1.5, 2.5, 0]).startswith("503 time was over before the answer")
    (folder / "much.yaml").write_text(yaml.safe_dump({**content, "tasks": many}))
    answer = client.post("/api/mission", json={"mission": "much.yaml"})
    assert (answer.status_code, "500 tasks" in answer.text) == (422, True)


def test_others_are_heard_while_the_ways_of_many_tasks_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """SciPy holds Python's lock during a call; so many places at once took seconds."""
    places: list[int] = []

    def counted(graph: Any, *, indices: Any, **more: Any) -> Any:
        places.append(len(indices))
        return dijkstra(graph, indices=indices, **more)

    grid = ep.OccupancyGrid(np.zeros((40, 40), bool), 0.5)
    points = np.random.default_rng(1).uniform(5, 15, (50, 2))
    vehicle = ep.Vehicle.preset("quadriga")
    monkeypatch.setattr("energyplan.mission.routes.dijkstra", counted)
    shortest_ways(grid, vehicle, points)
    assert sum(places) == 50 and max(places) <= 8


def test_a_mission_of_several_robots_is_opened_and_answered(
    client: TestClient, folder: Path
) -> None:
    shutil.copy(bundled("fleet_warehouse.yaml"), folder)
    assert "fleet_warehouse.yaml" in client.get("/api/files").json()["missions"]
    opened = client.get("/api/missions/fleet_warehouse.yaml").json()
    fleet = yaml.safe_load((folder / "fleet_warehouse.yaml").read_text())
    names = [robot["name"] for robot in fleet["robots"]]
    assert [robot["name"] for robot in opened["robots"]] == names
    fleet["planning_effort"] = 100
    answer = client.post("/api/mission", json={"document": fleet})
    assert answer.status_code == 200, answer.text
    told = answer.json()
    own = documents.mission(ep.evaluate(mission_from(fleet, folder)), trajectories=True)
    for robot in told["robots"]:
        timeline = robot.pop("timeline")
        assert timeline["reserve"] == [0.2] * len(timeline["t"]) and len(timeline["t"]) > 1
    assert told.pop("preset") and told == json.loads(json.dumps(own))
    assert [robot["name"] for robot in told["robots"]] == names
    assert sum(len(robot["tasks"]) for robot in told["robots"]) == len(fleet["tasks"])


def fits(value: Any, schema: dict[str, Any], known: dict[str, Any], place: str = "") -> list[str]:
    """Return where a value is not what its schema says, keys that it does not name included."""
    if "$ref" in schema:
        return fits(value, known[schema["$ref"].rpartition("/")[2]], known, place)
    if "anyOf" in schema:
        found = [fits(value, one, known, place) for one in schema["anyOf"]]
        return min(found, key=len)
    kinds = {"object": dict, "array": list, "number": (int, float), "integer": int, "string": str,
             "boolean": bool, "null": type(None)}  # fmt: skip
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return [f"{place}: {value!r} is no {schema['type']}"]
    wrong = []
    if properties := schema.get("properties"):
        wrong = [
            f"{place}.{key}" for key in {*schema["required"]} - {*value} | {*value} - {*properties}
        ]
        for key in {*properties} & {*value}:
            wrong += fits(value[key], properties[key], known, f"{place}.{key}")
    elif isinstance(value, list):
        for item in value:
            wrong += fits(item, schema["items"], known, f"{place}[]")
    elif isinstance(value, dict) and isinstance(schema.get("additionalProperties"), dict):
        for key, item in value.items():
            wrong += fits(item, schema["additionalProperties"], known, f"{place}.{key}")
    return wrong


def test_requests_and_answers_are_what_openapi_says(client: TestClient, folder: Path) -> None:
    described = client.get("/openapi.json").json()
    known = described["components"]["schemas"]
    said_of = {"type", "$ref", "anyOf", "enum", "const"}
    for kind in known.values():  # nothing is left open
        assert all(said_of & {*one} for one in kind.get("properties", {}).values()), kind
    logs = {"logs": ["a.csv"], "vehicle": "quadriga:full"}
    robot = {"track": 0.5, "wheelbase": 0.475, "mass": 147.1}
    t = [0.0, 1.0, 2.0]
    columns = {"t": t, "x": t, "y": [0.0] * 3, "yaw": [0.0] * 3, "v": [1.0] * 3, "omega": [0.0] * 3}
    fleet = yaml.safe_load(bundled("fleet_warehouse.yaml").read_text()) | {"planning_effort": 100}
    boxed = {**QUERY, "map": "room.yaml", "goal": [7, 2, 0], "effort": 300}
    asked: list[tuple[str, Any]] = [
        ("plan", QUERY), ("plan", boxed), ("compare", {**QUERY, "effort": 300}), ("compare", boxed),
        ("range", {"map": "room.yaml", "model": MODEL, "start": [1, 1, 0], "energy": 900.0}),
        ("check", {"model": MODEL, **columns}), ("mission", {"mission": "round.yaml"}),
        ("mission", {"document": fleet}), ("start", {"log": "a.csv", "robot": robot}),
        ("identify", logs), ("diagnose", {**logs, "holdout": ["b.csv"]}), ("health", None),
        ("files", None), ("maps/room.yaml", None), ("missions/round.yaml", None),
    ]  # fmt: skip
    for path, body in asked:
        name = f"/api/{path}" if "/" not in path else f"/api/{path.partition('/')[0]}/{{name}}"
        said = described["paths"][name]["get" if body is None else "post"]
        if body is None:
            answer = client.get(f"/api/{path}")
        else:
            answer = client.post(f"/api/{path}", json=body)
            sent = said["requestBody"]["content"]["application/json"]["schema"]
            assert {*body} <= {*known[sent["$ref"].rpartition("/")[2]]["properties"]}
        assert answer.status_code == 200, answer.text
        content = said["responses"]["200"]["content"]["application/json"]["schema"]
        assert fits(answer.json(), content, known, path) == []
        assert "422" not in said["responses"]  # one form of all refusals
    assert client.post("/api/plan", json=QUERY).json()["effort_limit"] == EFFORT
    refused = client.post("/api/check", json={"model": MODEL, **columns, "x": [0.0]})
    assert (refused.status_code, "different lengths" in refused.text) == (422, True)
    refusal = said["responses"]["default"]["content"][refused.headers["content-type"]]
    assert fits(refused.json(), refusal["schema"], known) == []


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_full_disk_is_the_services_fault(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def full(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("energyplan.io.files.os.fsync", full)
    answer = client.put("/api/files/d.csv", content=b"t,v\n")
    assert answer.status_code == 507
    assert answer.json()["detail"].startswith(f"'d.csv' cannot be written: {os.strerror(number)}")
    assert not [file for file in folder.iterdir() if "d.csv" in file.name]


def test_files_of_the_folder_itself_come_before_those_of_its_subfolders(tmp_path: Path) -> None:
    names = ["a/first.yaml", "a/b/second.yaml", "round.yaml", "z/last.yaml"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("tasks: []\n")
    found = Store(tmp_path).names()[0]["missions"]
    assert found == ["round.yaml", "a/first.yaml", "z/last.yaml", "a/b/second.yaml"]


def test_a_map_is_read_once_for_all_who_wait_for_it(folder: Path) -> None:
    store, both, count = Store(folder), threading.Barrier(2), []

    def read(file: Path) -> str:
        count.append(file)
        with suppress(threading.BrokenBarrierError):
            both.wait(0.5)  # for another who reads it too
        return "read"

    with ThreadPoolExecutor(2) as pool:
        found = [pool.submit(store.read, "room.yaml", read) for _ in range(2)]
        assert [one.result() for one in found] == ["read", "read"]
    assert len(count) == 1


def test_the_service_reads_maps_up_to_a_size(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("energyplan.serve.store._CELLS", 40 * 100 - 1)
    with TestClient(create_app(folder), LOCAL) as client:
        answer = client.get("/api/maps/room.yaml")
    assert (answer.status_code, "at most 3999 cells" in answer.text) == (422, True)


def test_a_stop_ends_all_work_and_says_come_again(folder: Path) -> None:
    app = create_app(folder, workers=1)
    asked = {**QUERY, "goal": [20, 12, 1.5], "effort": 5_000_000, "planner": "rrtstar"}
    with TestClient(app, LOCAL) as client, ThreadPoolExecutor(3) as pool:
        waiting = [pool.submit(client.post, "/api/plan", json=asked) for _ in range(2)]
        stream = pool.submit(
            client.post, "/api/plan", json=asked, headers={"Accept": "text/event-stream"}
        )
        while client.get("/api/health").json()["load"] < 3:
            pass
        app.state.stop()
        answers = [one.result(60) for one in waiting]
        answers.append(client.post("/api/plan", json=asked))
        assert [one.status_code for one in answers] == [503] * 3
        assert all("is ending" in one.text and one.headers["Retry-After"] for one in answers)
        assert stream.result(60).text.splitlines()[-3] == "event: problem"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_service_without_a_traceback(folder: Path, number: int) -> None:
    command = [sys.executable, "-m", "energyplan", "serve", str(folder), "--port", "0"]
    process = subprocess.Popen([*command, "--no-token"], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    port = int(process.stderr.readline().rpartition(":")[2].strip("/\n"))
    asked = {**QUERY, "goal": [20, 12, 1.5], "effort": 5_000_000, "planner": "rrtstar"}
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    link.request("POST", "/api/plan", json.dumps(asked), _JSON)
    with socket.create_connection(("127.0.0.1", port), 60) as half:
        half.sendall(b"POST /api/plan HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n"
                     b"Content-Type: application/json\r\n\r\n{")  # fmt: skip
        load = 0
        while load < 1:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/health") as answer:
                load = json.load(answer)["load"]
        process.send_signal(number)
        assert link.getresponse().status == 503
        _, log = process.communicate(timeout=120)
    assert "Traceback" not in log and "POST /api/plan" in log, log


def test_maps_that_are_kept_have_a_limit_together(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("energyplan.serve.store._MOST", 3 * 40 * 100)
    store, read = Store(folder), list[str]()

    def made(name: str) -> Any:
        def build(file: Path) -> ep.OccupancyGrid:
            read.append(name)
            return ep.OccupancyGrid(np.zeros((40, 100), bool), 0.1)

        return store.read("room.yaml", build, name)

    for name in "abcabc":
        made(name)
    assert read == ["a", "b", "c"]
    for name in "dbca":  # the oldest went
        made(name)
    assert read == ["a", "b", "c", "d", "a"]


def test_a_file_that_cannot_be_opened_hides_no_other(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Path.open

    def guarded(self: Path, *args: Any, **more: Any) -> Any:
        if self.name == "secret.yaml":
            raise PermissionError(13, "Permission denied")
        return opened(self, *args, **more)

    (folder / "secret.yaml").write_text("image: a.png\n")
    with TestClient(create_app(folder), base_url="http://localhost") as client:
        monkeypatch.setattr(Path, "open", guarded)
        answer = client.get("/api/files")
    (folder / "secret.yaml").unlink()
    assert answer.status_code == 200 and answer.json()["maps"]
    assert "secret.yaml" not in answer.json()["maps"]
    assert answer.json()["unreadable"] == {"secret.yaml": "Permission denied"}


def test_an_empty_token_is_refused(folder: Path) -> None:
    with pytest.raises(InvalidInputError, match="token is empty"):
        create_app(folder, "")


BOMB = "image: [" + "[]," * 300_000 + "[]]"


def parses(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of all files that are parsed from now on."""
    found, parse = list[str](), io_documents.parse

    def counted(content: Any, source: str, error: Any) -> Any:
        found.append(source)
        return parse(content, source, error)

    monkeypatch.setattr(io_documents, "parse", counted)
    return found


@pytest.mark.parametrize("path", ["maps/bomb.yaml", "missions/bomb.yaml"])
def test_a_file_that_cannot_be_read_is_parsed_once(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By all who ask for it, until it changes."""
    (tmp_path / "bomb.yaml").write_text(BOMB)
    seen = parses(monkeypatch)
    with TestClient(create_app(tmp_path), LOCAL) as client:
        told = {client.get(f"/api/{path}").text for _ in range(3)}
        assert len(told) == 1 and "too many values" in told.pop()
        assert seen == ["bomb.yaml"]
        (tmp_path / "bomb.yaml").write_text("strange: 1\n")
        assert "too many values" not in client.get(f"/api/{path}").text
    assert seen == ["bomb.yaml"] * 2


def test_what_passes_is_not_kept_as_a_fault_of_a_file(folder: Path) -> None:
    store, count = Store(folder), 0

    def read(file: Path) -> str:
        nonlocal count
        count += 1
        if count == 1:
            try:
                raise OSError(errno.EMFILE, "Too many open files")
            except OSError:
                raise InvalidInputError("cannot be read") from None
        return "read"

    with pytest.raises(InvalidInputError):
        store.read("room.yaml", read)
    assert store.read("room.yaml", read) == "read"


def test_a_fault_that_is_kept_stays_what_it_was(folder: Path) -> None:
    store, fault = Store(folder), UnknownNameError("preset", "lava", ["grass"])

    def read(file: Path) -> None:
        raise fault

    for _ in range(2):
        with pytest.raises(UnknownNameError, match=f"^{re.escape(str(fault))}$"):
            store.read("room.yaml", read)


def test_who_waits_for_a_file_may_be_cancelled(folder: Path) -> None:
    store, begun, end = Store(folder), threading.Event(), threading.Event()

    def read(file: Path) -> None:
        begun.set()
        end.wait(30)

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(store.read, "room.yaml", read)
        begun.wait()
        try:
            with cancellable(lambda: True), pytest.raises(CancelledError):
                store.read("room.yaml", read)
        finally:
            end.set()
        first.result()


def test_nothing_is_kept_of_who_has_read_a_file(folder: Path) -> None:
    store = Store(folder)
    for k in range(100):
        store.read("room.yaml", lambda file: "read", f"columns {k}")
    gc.collect()
    assert len(store._turns) == 0


def test_a_body_is_counted_before_it_is_built(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And read in a thread, so that others are heard meanwhile."""
    built, loads = list[str](), json.loads

    def counted(content: Any, **more: Any) -> Any:
        built.append(threading.current_thread().name)
        return loads(content, **more)

    monkeypatch.setattr("json.loads", counted)
    nests = "[" + "[]," * 60_000 + "[]]"
    for path, body in (
        ("plan", '{"start":' + nests + "}"),
        ("range", '{"pack":{"a":' + nests + "}}"),
        ("mission", '{"document":{"a":' + nests + "}}"),
        ("check", '{"t":' + nests + "}"),
        ("identify", '{"logs":[' + '"a",' * 60_000 + '"a"]}'),
        ("plan", "{" + ",".join(f'"{k}":0' for k in range(60_000)) + "}"),
    ):
        answer = client.post(f"/api/{path}", content=body, headers=_JSON)
        assert (answer.status_code, "more than" in answer.text) == (422, True), path
    assert not built
    text = json.dumps({**QUERY, "map": "," * 60_000 + "[" * 60_000})  # text holds no values
    assert client.post("/api/plan", content=text, headers=_JSON).status_code == 404
    assert built[0].startswith("asyncio_")


def test_bodies_have_a_size_by_what_they_hold(client: TestClient) -> None:
    for path, size, status in (
        ("plan", 2**20, 422), ("plan", 2**20 + 1, 413), ("mission", 2**20 + 1, 413),
        ("check", 6 * 2**20, 422), ("check", 6 * 2**20 + 1, 413),
    ):  # fmt: skip
        body = b"{}".ljust(size)
        assert client.post(f"/api/{path}", content=body, headers=_JSON).status_code == status


@pytest.mark.parametrize(
    ("path", "body", "told"),
    [
        ("plan", '{"map": "a.yaml", "map": "b.yaml"}', "'map' stands twice"),
        ("mission", '{"document": {"tasks": [{"name": "a", "name": "b"}]}}', "'name' stands twice"),
        ("mission", '{"document": {"planning_effort": 1%s}}' % ("0" * 401), "beyond 64 bits"),
        ("mission", '{"document": {"chargers": [{"places": 18446744073709551616}]}}', "64 bits"),
        ("check", '{"t": [-1%s]}' % ("0" * 30), "beyond 64 bits"),
        ("plan", "[" * 40_000, "nested too deeply"),
        ("plan", "[]", "body"),
        ("plan", "null", "body"),
        ("plan", "\xff", "body"),
    ],
)
def test_strange_json_is_refused(client: TestClient, path: str, body: str, told: str) -> None:
    answer = client.post(f"/api/{path}", content=body.encode("latin-1"), headers=_JSON)
    assert (answer.status_code, told in answer.json()["detail"]) == (422, True), answer.text


def test_too_little_effort_is_no_reason_to_try_again(client: TestClient) -> None:
    goal = [20, 12, 1.5]
    answer = client.post("/api/plan", json={**QUERY, "goal": goal, "effort": 1})
    assert (answer.status_code, "give more effort" in answer.json()["detail"]) == (422, True)


def test_a_body_of_two_lengths_is_refused_and_ends_the_connection(client: TestClient) -> None:
    headers = {**_JSON, "Content-Length": "2", "Transfer-Encoding": "chunked"}
    answer = client.post("/api/plan", content=b"{}", headers=headers)
    assert (answer.status_code, answer.headers.get("connection")) == (400, "close")


def test_a_body_that_was_refused_does_not_go_on_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    wires = Wires(monkeypatch, most=10)
    wire = wires.connect(b"PUT /a HTTP/1.1\r\nHost: x\r\nContent-Length: 999999999\r\n\r\n")
    wire.cycle.response_complete = True
    for _ in range(16):
        wire.data_received(bytes(2**16))
    assert wires.ended == [False]
    wire.data_received(b"0")
    assert wires.ended == [True]


def test_links_to_themselves_are_no_files(tmp_path: Path) -> None:
    (tmp_path / "loop.yaml").symlink_to(tmp_path / "loop.yaml")
    with TestClient(create_app(tmp_path), LOCAL) as client:
        assert client.get("/api/files").status_code == 200
        assert client.get("/api/maps/loop.yaml").status_code == 404


def test_the_service_unpacks_logs_up_to_a_size(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("energyplan.serve.store._UNPACKED", 2**20)
    (folder / "long.csv.gz").write_bytes(gzip.compress(b"t,x\n" + b"1,2\n" * 2**18))
    asked = {"log": "long.csv.gz", "robot": {"track": 0.5, "mass": 50}}
    with TestClient(create_app(folder), LOCAL) as client:
        answer = client.post("/api/start", json=asked)
    (folder / "long.csv.gz").unlink()
    assert (answer.status_code, "more than 1 MiB" in answer.text) == (422, True)


def test_time_that_does_not_count_leaves_the_limit() -> None:
    job = Job()
    job.limit(-1.0)
    assert job.unwanted()
    with job.untimed():
        assert not job.unwanted()
    assert job.unwanted()
